"""Starts a session in a process of its own and hands its snapshots to whoever shows them."""

from __future__ import annotations

import contextlib
import json
import math
import selectors
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from types import FrameType
from typing import NamedTuple

from cardan.gateway.session.config import SessionConfig
from cardan.gateway.session.heartbeat import BEAT, BEAT_PERIOD_S
from cardan.gateway.session.session import BRAKE_TIMEOUT_S, EXIT_INTERNAL
from cardan.gateway.session.snapshot import MAX_SNAPSHOT_BYTES, Snapshot
from cardan.types import NEVER_S

KILL_AFTER_S = BRAKE_TIMEOUT_S + 3.0
"""A session that has not left this long after it was asked is ended by force."""


_ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)
"""SIGTSTP too: Ctrl-Z would leave a moving robot with nobody at the terminal."""


class Outcome(NamedTuple):
    """How a session ended."""

    exit_code: int
    last: Snapshot


@contextlib.contextmanager
def _on_interrupt(action: Callable[[], None]) -> Iterator[None]:
    def handler(_number: int, _frame: FrameType | None) -> None:
        action()

    previous = {number: signal.signal(number, handler) for number in _ENDING_SIGNALS}
    try:
        yield
    finally:
        for number, old in previous.items():
            signal.signal(number, old)


def supervise(
    config: SessionConfig,
    seconds: float = math.inf,
    show: Callable[[Snapshot], None] = lambda _snapshot: None,
    poll: Callable[[], bool] = lambda: True,
    through: Sequence[str] = (),
) -> Outcome:
    """Run a session as configured until it ends; `show` gets each snapshot.

    SIGINT, SIGTERM, SIGHUP and SIGTSTP ask it to brake, hold and leave; so does `poll`, called
    several times a second, by returning False, and an exception in `show`, which goes on after.
    `through` is a command that runs the command after it in an environment of its making, hands
    signals on to it and ends with its code, as ``cardan sim omni --`` does.
    """
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        process = subprocess.Popen(
            [
                *through,
                sys.executable,
                "-m",
                "cardan.gateway.session.session",
                f"--channel-fd={theirs.fileno()}",
                f"--seconds={seconds}",
            ],
            stdin=subprocess.PIPE,
            pass_fds=(theirs.fileno(),),
            # Ctrl-C is ours to translate into an orderly stop.
            start_new_session=True,
        )
        theirs.close()
        stopping = False
        give_up_s = math.inf

        def stop() -> None:
            nonlocal stopping, give_up_s
            if not stopping:
                stopping = True
                give_up_s = time.monotonic() + KILL_AFTER_S
                process.terminate()

        def go_on() -> bool:
            if not poll():
                stop()
            return time.monotonic() < give_up_s

        last = Snapshot()
        with _on_interrupt(stop):
            try:
                assert process.stdin is not None
                with contextlib.suppress(BrokenPipeError), process.stdin as stdin:
                    stdin.write(json.dumps(config.model_dump(mode="json")).encode())
                for snapshot in _snapshots(ours, go_on):
                    last = snapshot
                    show(snapshot)
            except BaseException:
                # A view that fails must not cost the robot its braking ramp.
                stop()
                raise
            finally:
                patience_s = min(KILL_AFTER_S, give_up_s - time.monotonic())
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(max(0.0, patience_s))
                if process.poll() is None:
                    process.kill()
                code = process.wait()
        if stopping and code in (-signal.SIGTERM, 128 + signal.SIGTERM):
            # It was asked before it had begun: nothing was open yet.
            code, last.message = 0, "stopped before it began"
        if code != 0 and not last.error:
            last.error = f"the session's process ended with status {code}"
            if code < 0:
                last.error += (
                    "; only its controller stops a robot that moved (EGM: CommTimeout; MotoROS: "
                    "watchdog, or an empty queue)"
                )
        return Outcome(code if code >= 0 else EXIT_INTERNAL, last)


def _snapshots(channel: socket.socket, go_on: Callable[[], bool]) -> Iterator[Snapshot]:
    """Snapshots as they come, until the session closes its end or `go_on` says no.

    Beats meanwhile: a supervisor that is stopped, or whose view hangs, falls silent.
    """
    beat_s = NEVER_S
    with selectors.DefaultSelector() as selector:
        selector.register(channel, selectors.EVENT_READ)
        while go_on():
            now_s = time.monotonic()
            if now_s - beat_s >= BEAT_PERIOD_S:
                beat_s = now_s
                with contextlib.suppress(OSError):
                    channel.send(BEAT, socket.MSG_DONTWAIT)
            if not selector.select(BEAT_PERIOD_S):
                continue
            try:
                packet = channel.recv(MAX_SNAPSHOT_BYTES)
            except ConnectionResetError:
                # It ended with beats unread; what it said last is still there to be read.
                continue
            if not packet:
                return
            yield Snapshot.from_bytes(packet)
