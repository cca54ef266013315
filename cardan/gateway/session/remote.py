"""The Cartesian interface of a session in a process of its own.

The session's loop has its own interpreter: what the user's program does beside does not delay it.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
from pathlib import Path
from typing import Any

from cardan.errors import (
    CardanError,
    ConfigurationError,
    DriverError,
    MotionLoopError,
    MotionRefusedError,
)
from cardan.gateway.arm.authority import HAND, VERBS
from cardan.gateway.arm.interface import CartesianArm
from cardan.gateway.arm.motion import Motion, Outcome as MotionOutcome
from cardan.gateway.session.assembly import load_config, why_no_verbs
from cardan.gateway.session.config import SessionConfig
from cardan.gateway.session.requests import (
    SEQUENCED,
    MotionNote,
    PacketError,
    Reply,
    Request,
    decode_answer,
    encode_request,
    result_of,
)
from cardan.gateway.session.session import EXIT_CANNOT_OPEN, EXIT_CONFIGURATION
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import Outcome, SessionProcess

ANSWER_TIMEOUT_S = 30.0
"""Longest time for a verb to plan and wait for rest; beyond, the session does not answer."""

STOP_TIMEOUT_S = 2.0
"""Longest time for `stop`, which is done at once."""


class _Pending:
    """A request without its reply yet."""

    def __init__(self, verb: str) -> None:
        self.verb = verb
        self.done = threading.Event()
        self.result: Any = None
        self.error: CardanError | None = None


class RemoteArm(CartesianArm):
    """A session as configured, in a process of its own that begins with `open`, and its verbs.

    ::

        with RemoteArm("verbs-ur5-simulated.toml") as arm:
            arm.movj([0.4, 0.1, 0.4, 3.14, 0.0, 0.0])
            arm.wait()

    While this process is stopped or gone, the arm brakes and holds, and verbs have to be asked for
    anew. An operator device in the configuration moves the arm beside the verbs, and takes it from
    them as [authority] says. A Motion is updated without being asked.
    """

    def __init__(self, config: SessionConfig | Path | str, *, source: str = VERBS) -> None:
        """`source`: name of this source, which gets the authority. Raises ConfigurationError."""
        self.config = config if isinstance(config, SessionConfig) else load_config(Path(config))
        if why := why_no_verbs(self.config):
            raise ConfigurationError("arm", why)
        if not source or source == HAND:
            raise ConfigurationError("source", f"{source!r} is not allowed; {HAND!r} is the device")
        self.source = source
        self._process: SessionProcess | None = None
        self._reader: threading.Thread | None = None
        self._lock = threading.Lock()
        self._ids = itertools.count(1)
        self._pending: dict[int, _Pending] = {}
        self._motions: dict[int, Motion] = {}
        self._snapshot = Snapshot()
        self._ended = "the arm is not open"
        self._outcome: Outcome | None = None

    @property
    def snapshot(self) -> Snapshot:
        """The newest snapshot of the session, a tenth of a second old at most while it runs."""
        return self._snapshot

    # -- open and close --------------------------------------------------------------------------

    def open(self) -> None:
        """Start the session; returns when the robot's first state is there.

        Raises ConfigurationError or DriverError where the session cannot open what it needs.
        """
        if self._process is not None:
            return
        self._snapshot, self._ended, self._outcome = Snapshot(), "", None
        self._process = process = SessionProcess(self.config)
        self._reader = threading.Thread(
            target=self._read, args=(process,), name="session", daemon=True
        )
        self._reader.start()
        try:
            self.status()
        except BaseException as error:
            self.close()
            outcome = self._outcome
            if not isinstance(error, MotionLoopError) or outcome is None or not outcome.exit_code:
                raise
            raise _why_it_ended(outcome) from None

    def close(self) -> None:
        """Brake to rest and end the session. Never raises; twice is fine."""
        process, reader = self._process, self._reader
        if process is None or reader is None:
            return
        process.stop()
        reader.join()
        self._process = self._reader = None
        self._ended = "the arm is not open"

    def _read(self, process: SessionProcess) -> None:
        """Send beats, and handle the session's packets, until it ends."""
        why = ""
        try:
            self._outcome = outcome = process.follow(self._take)
            why = outcome.last.error or outcome.last.message
        finally:
            self._end(why)

    def _take(self, packet: bytes) -> Snapshot | None:
        answer = decode_answer(packet)
        if answer is None:
            self._snapshot = Snapshot.from_bytes(packet)
            return self._snapshot
        with self._lock:
            if isinstance(answer, MotionNote):
                self._update(answer)
            elif answer.id is not None and answer.id in self._pending:
                self._answer(self._pending.pop(answer.id), answer)
        return None

    def _answer(self, pending: _Pending, reply: Reply) -> None:
        pending.error = reply.error
        try:
            if reply.error is None:
                result = result_of(pending.verb, reply.result)
                pending.result = self._update(result) if isinstance(result, MotionNote) else result
        except PacketError as error:
            pending.error = error
        pending.done.set()

    def _update(self, note: MotionNote) -> Motion:
        """Update the motion that a note is about."""
        motion = self._motions.get(note.id)
        if motion is None:
            motion = self._motions[note.id] = Motion(note.verb, note.ends, note.source)
        note.update(motion)
        if motion.over:
            self._motions.pop(note.id)
        return motion

    def _end(self, why: str) -> None:
        """End all requests and motions: the session has ended."""
        reason = f"the session has ended: {why}" if why else "the session has ended"
        with self._lock:
            self._ended = reason
            for pending in self._pending.values():
                pending.error = MotionLoopError(reason)
                pending.done.set()
            for motion in self._motions.values():
                motion.outcome, motion.reason = MotionOutcome.ABORTED, reason
            self._pending.clear()
            self._motions.clear()

    # -- requests --------------------------------------------------------------------------------

    def _ask(
        self, verb: str, value: Any = None, *, source: str = "", sequence: int | None = None
    ) -> Any:
        request = Request(next(self._ids), source or self.source, verb, value, sequence)
        try:
            return self._asked(request)
        except MotionRefusedError as error:
            if verb in SEQUENCED:
                return str(error)
            raise

    def _asked(self, request: Request) -> Any:
        verb = request.verb
        if verb != "stop" and self._ended:
            raise MotionLoopError(self._ended)
        packet = encode_request(request)
        pending = _Pending(verb)
        with self._lock:
            if self._ended or self._process is None:
                if verb == "stop":
                    return None  # It rests already.
                raise MotionLoopError(self._ended)
            self._pending[request.id] = pending
            process = self._process
        try:
            process.send(packet)
        except OSError as error:
            # The reader sees the end for itself, and says why.
            if isinstance(error, BlockingIOError) or not pending.done.wait(STOP_TIMEOUT_S):
                self._forget(request.id)
                raise MotionLoopError(f"the session takes no requests: {error.strerror}") from None
        timeout_s = {"wait": None, "stop": STOP_TIMEOUT_S}.get(verb, ANSWER_TIMEOUT_S)
        if not pending.done.wait(timeout_s):
            self._forget(request.id)
            raise MotionLoopError(f"{verb}: the session has not answered for {timeout_s:g} s")
        if pending.error is not None and not (verb == "stop" and self._ended):
            raise pending.error
        return pending.result

    def _forget(self, number: int) -> None:
        with self._lock, contextlib.suppress(KeyError):
            del self._pending[number]


def _why_it_ended(outcome: Outcome) -> CardanError:
    """The error that the session's own process raised, as far as its end shows."""
    words = outcome.last.error
    if outcome.exit_code == EXIT_CONFIGURATION:
        key, _, rest = words.partition(": ")
        return ConfigurationError(key, rest) if " " not in key else ConfigurationError("", words)
    if outcome.exit_code == EXIT_CANNOT_OPEN:
        return DriverError(words)
    return MotionLoopError(words)
