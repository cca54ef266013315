"""Supervisor of a session: starts it in a process of its own and passes its snapshots to a view."""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
import selectors
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from cardan.bus.router import RouterKeeper
from cardan.common.logs import LogFormat
from cardan.common.signals import ENDING_SIGNALS, on_ending, signal_name
from cardan.common.tables import as_table
from cardan.gateway.session.config import SessionConfig
from cardan.gateway.session.session import BRAKE_TIMEOUT_S, EXIT_INTERNAL
from cardan.gateway.session.snapshot import FIGURES, MAX_SNAPSHOT_BYTES, Snapshot
from cardan.gateway.session.supervisor_heartbeat import BEAT, BEAT_PERIOD_S
from cardan.types import NEVER_S

KILL_AFTER_S = BRAKE_TIMEOUT_S + 3.0
"""Time after which a session that was requested to end is killed."""

LAST_OUTPUT_S = 0.5
"""Longest wait for the last lines of an ended session on standard error."""

_BEFORE_IT_BEGAN = {code for each in ENDING_SIGNALS for code in (-each, 128 + each)}
"""Exit codes of a session, or of a command around it, that an ending signal has ended: it handles
them before it opens anything."""

_log = logging.getLogger(__name__)


class SessionExit(NamedTuple):
    """Outcome of a session's process."""

    exit_code: int
    last: Snapshot


def _to_stderr(data: bytes) -> None:
    with contextlib.suppress(OSError):
        os.write(2, data)


class SessionProcess:
    """A session in a process of its own, from its start to its end.

    While `follow` reads its packets, it sends beats: if this process is stopped, or its view hangs,
    the session's arm brakes and holds. It also runs the router of the session's network, if that is
    on this computer and no other process serves it.
    """

    def __init__(
        self,
        config: SessionConfig,
        seconds: float = math.inf,
        through: Sequence[str] = (),
        say: Callable[[bytes], None] = _to_stderr,
        has_device: bool = True,
        log_format: LogFormat = LogFormat.TEXT,
        router_promised: Callable[[tuple[str, int]], bool] = lambda _address: False,
    ) -> None:
        """Start it; `through` as in :func:`supervise`. `has_device`: whether it begins with its
        operator device, or waits until TAKE is sent. `say` gets its standard output and standard
        error, in a thread of its own: if that blocks or fails the output is lost, and nothing waits
        for it. It logs at the level of the logger ``cardan`` of this process, each line in
        `log_format`. `router_promised`: as `promised` of RouterKeeper."""
        self._config, self._router_promised = config, router_promised
        self._stopping = False
        self._give_up_s = math.inf
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs, contextlib.ExitStack() as undone:
            # When files are short this is tried again and again: nothing may be left open by that.
            undone.callback(self._channel.close)
            said, saying = os.pipe()
            undone.callback(os.close, said)
            # Its loop waits for no terminal, whatever writes to these: a library in C, too.
            os.set_blocking(saying, False)
            saying_file = undone.enter_context(os.fdopen(saying, "wb"))
            self._process = subprocess.Popen(
                [
                    *through,
                    sys.executable,
                    "-m",
                    "cardan.common.resource_errors",
                    "cardan.gateway.session.session",
                    f"--channel-fd={theirs.fileno()}",
                    f"--seconds={seconds}",
                    f"--log-level={logging.getLogger('cardan').getEffectiveLevel()}",
                    f"--log-format={log_format.value}",
                    *([] if has_device else ["--without-device"]),
                ],
                stdin=subprocess.PIPE,
                stdout=saying_file,
                stderr=saying_file,
                pass_fds=(theirs.fileno(),),
                # This process translates Ctrl-C into an orderly stop.
                start_new_session=True,
            )
            saying_file.close()
            undone.pop_all()
        _log.info("the session is process %d", self._process.pid)
        self._relay = threading.Thread(
            target=_relay, args=(said, say), name="cardan-session-output", daemon=True
        )
        self._relay.start()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def send(self, packet: bytes) -> None:
        """Send a request. Raises OSError if the process has ended, or does not read any more."""
        self._channel.send(packet, socket.MSG_DONTWAIT)

    def stop(self) -> None:
        """Request that it brake, hold and leave. Safe in a signal handler."""
        if not self._stopping:
            self._stopping = True
            self._give_up_s = time.monotonic() + KILL_AFTER_S
            self._process.terminate()

    def follow(
        self,
        take: Callable[[bytes], Snapshot | None],
        poll: Callable[[], bool] = lambda: True,
        shown: Callable[[], bool] = lambda: True,
    ) -> SessionExit:
        """Send beats until it ends, and wait for its end; call it once. `take` gets each packet
        that it sends, and returns the snapshot if it is one; an exception in it requests the
        session's end and is raised afterwards. So does `poll`, called several times a second, by
        returning False. No beat is sent while `shown` returns False."""
        last = Snapshot()
        keeper = RouterKeeper(self._config.network, promised=self._router_promised)
        with contextlib.closing(keeper) as router:

            def run_due() -> bool:
                router.poll()
                return poll()

            try:
                for packet in self._packets(run_due, shown):
                    last = take(packet) or last
            except BaseException:
                # A view that fails must not cost the robot its braking ramp.
                self.stop()
                raise
            finally:
                outcome = self._reap(last)
        return outcome

    def _packets(self, poll: Callable[[], bool], shown: Callable[[], bool]) -> Iterator[bytes]:
        """Yield packets until the session closes its end, or is to be killed."""
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
                    if shown():
                        with contextlib.suppress(OSError):
                            self.send(BEAT)
                if not selector.select(BEAT_PERIOD_S):
                    continue
                try:
                    packet = self._channel.recv(MAX_SNAPSHOT_BYTES)
                except ConnectionResetError:
                    continue  # It left beats unread; its last packets are still to come.
                if not packet:
                    return
                yield packet

    def _reap(self, last: Snapshot) -> SessionExit:
        """Return its outcome; it is killed if it does not end by itself."""
        process = self._process
        patience_s = min(KILL_AFTER_S, self._give_up_s - time.monotonic())
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(max(0.0, patience_s))
        if process.poll() is None:
            process.kill()
        code = process.wait()
        self._channel.close()
        self._relay.join(LAST_OUTPUT_S)
        _log.info("the session's process has ended with status %d", code)
        if code in _BEFORE_IT_BEGAN and last.elapsed_s == 0.0 and not last.error:
            code, last.arm = 0, replace(last.arm, message="stopped before it began")
        if code != 0 and not last.error:
            last.error = f"the session's process ended with status {code}"
            if code < 0:
                last.error += (
                    "; only its controller stops a robot that moved (EGM: CommTimeout; MotoROS: "
                    "watchdog, or an empty queue)"
                )
        return SessionExit(code if code >= 0 else EXIT_INTERNAL, last)


def _relay(said: int, say: Callable[[bytes], None]) -> None:
    """Pass on a session's output until it has ended."""
    with os.fdopen(said, "rb", buffering=0) as pipe:
        while data := pipe.read(4096):
            say(data)


def _say(data: bytes) -> None:
    # Not to the file descriptor: a live view stands in for sys.stderr, and makes room for it.
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(data.decode(errors="backslashreplace"))
        sys.stderr.flush()


def supervise(
    config: SessionConfig,
    seconds: float = math.inf,
    show: Callable[[Snapshot], None] = lambda _snapshot: None,
    poll: Callable[[], bool] = lambda: True,
    through: Sequence[str] = (),
    shown: Callable[[], bool] = lambda: True,
) -> SessionExit:
    """Run a session as configured until it ends; `show` gets each snapshot. Every signal that would
    end this process requests that the session brake, hold and leave, and so do Ctrl-Z, `poll`,
    called several times a second, by returning False, and an exception in `show`, which is raised
    afterwards. While `shown` returns False the arm brakes and holds: it is not displayed. `through`
    is a command that runs the command after it in an environment of its own, forwards signals to it
    and ends with its code, such as ``cardan sim omni --``."""
    process: SessionProcess | None = None
    signals: list[int] = []
    logged = _Logged()

    def stop(number: int) -> None:
        signals.append(number)
        if process is not None:
            process.stop()

    def take(packet: bytes) -> Snapshot:
        snapshot = Snapshot.from_bytes(packet)
        logged.log(snapshot)
        show(snapshot)
        return snapshot

    # Ctrl-Z would leave a moving robot without an operator at the terminal.
    with on_ending(stop, also=(signal.SIGTSTP,)):
        process = SessionProcess(config, seconds, through, _say)
        if signals:
            process.stop()
        outcome = process.follow(take, poll, shown)
    for number in signals:
        _log.info("ending on %s", signal_name(number))
    return outcome


class _Logged:
    """Logs changes between two snapshots."""

    def __init__(self) -> None:
        self._said: dict[str, str] = {}

    def log(self, snapshot: Snapshot) -> None:
        for what, now in (
            ("arm", snapshot.arm.phase),
            ("device", " ".join((snapshot.device.link, snapshot.device.reason))),
            ("robot", snapshot.robot.link),
            ("authority", snapshot.arm.authority),
            ("message", snapshot.arm.message),
        ):
            words = FIGURES.sub("", now).strip()
            if words != self._said.get(what, ""):
                self._said[what] = words
                _log.info("%s: %s", what, now or "none")
