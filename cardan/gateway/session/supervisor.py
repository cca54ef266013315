"""Starts a session in a process of its own and passes its snapshots to a view."""

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
from cardan.tables import as_table
from cardan.types import NEVER_S

KILL_AFTER_S = BRAKE_TIMEOUT_S + 3.0
"""How long after it was asked to end a session is killed."""


_ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)
"""SIGTSTP too: Ctrl-Z would leave a moving robot without an operator at the terminal."""


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


class SessionProcess:
    """A session in a process of its own, from its start to its end.

    While `follow` reads its packets, beats are sent: if this process is stopped, or its view hangs,
    the session's arm brakes and holds.
    """

    def __init__(
        self, config: SessionConfig, seconds: float = math.inf, through: Sequence[str] = ()
    ) -> None:
        """Start it; `through` as :func:`supervise` has it."""
        self._config = config
        self._stopping = False
        self._give_up_s = math.inf
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [
                    *through,
                    sys.executable,
                    "-m",
                    "cardan.shortage",
                    "cardan.gateway.session.session",
                    f"--channel-fd={theirs.fileno()}",
                    f"--seconds={seconds}",
                ],
                stdin=subprocess.PIPE,
                pass_fds=(theirs.fileno(),),
                # Ctrl-C is ours to translate into an orderly stop.
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def send(self, packet: bytes) -> None:
        """Send a request. Raises OSError where the process has ended, or does not read any more."""
        self._channel.send(packet, socket.MSG_DONTWAIT)

    def stop(self) -> None:
        """Ask it to brake, hold and leave. Safe in a signal handler."""
        if not self._stopping:
            self._stopping = True
            self._give_up_s = time.monotonic() + KILL_AFTER_S
            self._process.terminate()

    def follow(
        self,
        take: Callable[[bytes], Snapshot | None],
        poll: Callable[[], bool] = lambda: True,
    ) -> Outcome:
        """Beat until it ends, and wait for its end; to be called once.

        `take` gets each packet that it sends, and answers with the snapshot where it is one; an
        exception in it asks the session to leave and goes on after. So does `poll`, called several
        times a second, by returning False.
        """
        last = Snapshot()
        try:
            for packet in self._packets(poll):
                last = take(packet) or last
        except BaseException:
            # A view that fails must not cost the robot its braking ramp.
            self.stop()
            raise
        finally:
            outcome = self._reap(last)
        return outcome

    def _packets(self, poll: Callable[[], bool]) -> Iterator[bytes]:
        """Packets until it closes its end, or is to be killed."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError), self._process.stdin as stdin:
            stdin.write(json.dumps(as_table(self._config, from_file=False)).encode())
        beat_s = NEVER_S
        with selectors.DefaultSelector() as selector:
            selector.register(self._channel, selectors.EVENT_READ)
            while True:
                if not poll():
                    self.stop()
                now_s = time.monotonic()
                if now_s >= self._give_up_s:
                    return
                if now_s - beat_s >= BEAT_PERIOD_S:
                    beat_s = now_s
                    with contextlib.suppress(OSError):
                        self.send(BEAT)
                if not selector.select(BEAT_PERIOD_S):
                    continue
                try:
                    packet = self._channel.recv(MAX_SNAPSHOT_BYTES)
                except ConnectionResetError:
                    continue  # It left beats unread; what it said last is still to come.
                if not packet:
                    return
                yield packet

    def _reap(self, last: Snapshot) -> Outcome:
        """How it ended; it is killed where it does not end by itself."""
        process = self._process
        patience_s = min(KILL_AFTER_S, self._give_up_s - time.monotonic())
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(max(0.0, patience_s))
        if process.poll() is None:
            process.kill()
        code = process.wait()
        self._channel.close()
        if self._stopping and code in (-signal.SIGTERM, 128 + signal.SIGTERM):
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
    process = SessionProcess(config, seconds, through)

    def take(packet: bytes) -> Snapshot:
        snapshot = Snapshot.from_bytes(packet)
        show(snapshot)
        return snapshot

    with _on_interrupt(process.stop):
        return process.follow(take, poll)
