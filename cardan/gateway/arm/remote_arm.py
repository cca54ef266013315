"""The Cartesian interface of an arm whose loop runs in another process: verbs as packets.

A connection carries the packets: the channel of a session that this process has started, the
daemon's socket, or the network.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Callable
from typing import Any

from cardan.common.forks import IN_CHILD, give_up_in_children
from cardan.errors import CardanError, MotionLoopError, OptionError
from cardan.gateway.arm.interface import CartesianArm
from cardan.gateway.arm.loop_link import NOT_OPEN
from cardan.gateway.arm.requests import (
    MotionNote,
    PacketError,
    Reply,
    Request,
    decode_answer,
    encode_request,
    result_of,
)
from cardan.gateway.arm.status import OPERATOR, VERBS
from cardan.gateway.arm.validation import LONGEST_NAME
from cardan.gateway.arm.verb_results import Motion, Outcome

ANSWER_TIMEOUT_S = 30.0
"""Longest time for a verb to plan and wait for rest; beyond, the session does not answer."""

STOP_TIMEOUT_S = 2.0
"""Longest time for `stop` and `release`, which are done at once."""

EARLY_NOTES = 64
"""Most notes of ended motions that are kept while replies are due: on a network a motion's end may
arrive before the reply about its beginning."""

Send = Callable[[Request, bytes], None]
"""Sends a request, encoded as the packet. Raises OSError where it cannot be sent."""

_TIMEOUTS_S = {"wait": None, "stop": STOP_TIMEOUT_S, "release": STOP_TIMEOUT_S}


class _Pending:
    """A request that waits for its reply."""

    def __init__(self, verb: str) -> None:
        self.verb = verb
        self.done = threading.Event()
        self.result: Any = None
        self.error: CardanError | None = None


class RemoteArm(CartesianArm):
    """Client of an arm by packets (:mod:`cardan.gateway.arm.requests`). Motions are updated as
    notes arrive.

    :func:`cardan.gateway.session.remote.session_arm` makes one of a session in a process of its
    own, :func:`cardan.gateway.daemon.client.daemon_arm` of one that the daemon runs, and
    :func:`cardan.gateway.bus.remote.network_arm` of one on the network.
    """

    def __init__(
        self, connect: Callable[[RemoteArm], Callable[[], None]], source: str = VERBS
    ) -> None:
        """`connect` connects the arm: it calls `begin`, then in any thread `take`, `fail` and
        `end`, and returns what disconnects it again. `source`: name of this client, which gets the
        authority. Raises ConfigurationError."""
        if source == OPERATOR or not 0 < len(source) <= LONGEST_NAME:
            allowed = f"a name, 1 to {LONGEST_NAME} characters, other than {OPERATOR!r}, the device"
            raise OptionError("source", source, allowed)
        self.source = source
        self._connect = connect
        self._disconnect: Callable[[], None] | None = None
        self._send: Send
        self._lock = threading.Lock()
        self._ids = itertools.count(1)
        self._pending: dict[int, _Pending] = {}
        self._motions: dict[int, Motion] = {}
        self._early: dict[int, MotionNote] = {}
        self._ended = NOT_OPEN
        self._rests = True
        """True if the arm is at rest after the end of its session."""

    def open(self) -> None:
        """Connect; opening twice is fine. Raises the errors of the connection."""
        if self._disconnect is not None:
            return
        give_up_in_children(self)
        try:
            self._disconnect = self._connect(self)
        finally:
            if self._disconnect is None:
                self._ended, self._rests = NOT_OPEN, True

    def close(self) -> None:
        """Disconnect. Never raises; idempotent."""
        disconnect, self._disconnect = self._disconnect, None
        if disconnect is not None:
            disconnect()
            self._ended, self._rests = NOT_OPEN, True

    def after_fork(self) -> None:
        """Leave the connection to the parent in a forked child: `close` does not touch it there,
        and all verbs are errors."""
        self._disconnect, self._lock = None, threading.Lock()
        self.end(f"the arm is not open in this process: {IN_CHILD}", rests=False)

    # -- for the connection ----------------------------------------------------------------------

    def begin(self, send: Send) -> None:
        """Mark the connection as ready: `send` sends packets."""
        self._send = send
        self._ended, self._rests = "", True
        self._early.clear()

    @property
    def endless(self) -> bool:
        """True while a motion of this client without an end is under way."""
        with self._lock:
            return any(not each.ends for each in self._motions.values())

    def take(self, packet: bytes) -> bool:
        """Handle a received packet; return False if it is no answer. Raises PacketError for a
        malformed one."""
        answer = decode_answer(packet)
        if answer is not None:
            self._take_answer(answer)
        return answer is not None

    def fail(self, number: int | None, reason: str) -> None:
        """End the request with the id `number`, which gets no reply."""
        self._take_answer(Reply(number, None, MotionLoopError(reason)))

    def _take_answer(self, answer: Reply | MotionNote) -> None:
        with self._lock:
            if isinstance(answer, MotionNote):
                self._note(answer)
            elif answer.id is not None and answer.id in self._pending:
                for note in answer.ended:
                    self._note(note)
                self._answer(self._pending.pop(answer.id), answer)

    def end(self, reason: str, *, rests: bool = True) -> None:
        """End all requests and motions after the end of the connection. `rests`: the arm is at
        rest; else `stop` is an error from now on."""
        with self._lock:
            if self._ended:
                return
            self._ended, self._rests = reason, rests
            for pending in self._pending.values():
                pending.error = MotionLoopError(reason)
                pending.done.set()
            for motion in self._motions.values():
                motion.outcome, motion.reason = Outcome.ABORTED, reason
            self._pending.clear()
            self._motions.clear()

    # -- requests --------------------------------------------------------------------------------

    def _ask(
        self, verb: str, value: Any = None, *, source: str = "", sequence: int | None = None
    ) -> Any:
        request = Request(next(self._ids), source or self.source, verb, value, sequence)
        with self._lock:
            if self._ended:
                return self._asked_too_late(verb)
        packet = encode_request(request)
        pending = _Pending(verb)
        with self._lock:
            if self._ended:
                return self._asked_too_late(verb)
            self._pending[request.id] = pending
        try:
            self._send(request, packet)
        except OSError as error:
            # The reader finds the end, and reports why.
            if isinstance(error, BlockingIOError) or not pending.done.wait(STOP_TIMEOUT_S):
                self._forget(request.id)
                raise MotionLoopError(f"the session takes no requests: {error.strerror}") from None
        timeout_s = _TIMEOUTS_S.get(verb, ANSWER_TIMEOUT_S)
        if not pending.done.wait(timeout_s):
            self._forget(request.id)
            raise MotionLoopError(f"{verb}: the session has not answered for {timeout_s:g} s")
        if pending.error is not None:
            if verb == "stop" and self._ended:
                return self._asked_too_late(verb)
            raise pending.error
        return pending.result

    def _asked_too_late(self, verb: str) -> None:
        if verb != "stop" or not self._rests:
            raise MotionLoopError(self._ended)

    def _answer(self, pending: _Pending, reply: Reply) -> None:
        pending.error = reply.error
        try:
            if reply.error is None:
                result = result_of(pending.verb, reply.result)
                pending.result = self._update(result) if isinstance(result, MotionNote) else result
        except PacketError as error:
            pending.error = error
        pending.done.set()

    def _note(self, note: MotionNote) -> None:
        """Update the motion that a note is about; it may be that of another client, or of a reply
        that has not arrived yet."""
        if note.id in self._motions:
            self._update(note)
        elif self._pending:
            if len(self._early) >= EARLY_NOTES:
                del self._early[next(iter(self._early))]
            self._early[note.id] = note

    def _update(self, note: MotionNote) -> Motion:
        """Update the motion that a reply or a note is about."""
        note = self._early.pop(note.id, note)
        motion = self._motions.get(note.id)
        if motion is None:
            motion = self._motions[note.id] = Motion(note.verb, note.ends, note.source)
        note.update(motion)
        if motion.over:
            self._motions.pop(note.id)
        return motion

    def _forget(self, number: int) -> None:
        with self._lock, contextlib.suppress(KeyError):
            del self._pending[number]
