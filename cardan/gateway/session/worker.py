"""Carries out the requests to a session beside its loop, which only passes packets on.

Two threads, which begin with the first request: one decodes and does what is quick, so that `stop`
acts at once whatever is under way; the other does what plans or waits for rest, one request after
the other.
"""

from __future__ import annotations

import gc
import itertools
import queue
import select
import socket
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from cardan.errors import CardanError, MotionRefusedError
from cardan.gateway.arm.desk import VerbDesk
from cardan.gateway.arm.link import LoopLink
from cardan.gateway.arm.motion import Motion, Outcome
from cardan.gateway.session.requests import (
    MotionNote,
    PacketError,
    Request,
    decode_request,
    encode_error,
    encode_note,
    encode_reply,
)
from cardan.types import NEVER_S

if TYPE_CHECKING:  # Imports Pinocchio, which sessions without an arm's model do without.
    from cardan.gateway.arm.verbs import ArmVerbs

MAX_PENDING = 32
"""Largest number of requests that wait for the ones before them: more are refused."""

MAX_WAITS = 8
"""Largest number of requests that wait for a motion's end, each in a thread of its own."""

STALE_S = 0.3
"""Longest wait of a streamed command for its turn: after more it is not executed."""

SEND_TIMEOUT_S = 1.0
"""Longest wait of a reply for its reader; one that is silent for half of it holds the arm."""

_QUICK = frozenset(
    {"stat", "twist", "wrench", "joints", "acknowledge", "hand_over", "release", "status"}
    | {"get_parameter", "get_parameters"}
)
"""Verbs that neither plan nor wait."""

_NEW_MOTION = frozenset({"movj", "relj", "movl", "movv", "gcmp", "forc"})
_STREAMED = frozenset({"pose", "jog", "twist", "wrench", "joints"})


class _Job(NamedTuple):
    request: Request
    received_s: float
    stops: int
    """Number of the arm's stops when the request came."""


class RequestWorker:
    """Answers the requests of one channel.

    `offer` and `attend` are for the loop's thread; neither blocks. `link` is attended to by the
    loop once `busy`.
    """

    def __init__(
        self,
        channel: socket.socket,
        link: LoopLink,
        make_verbs: Callable[[], ArmVerbs],
        stop: Callable[[], None],
        clock: Callable[[], float],
    ) -> None:
        """`make_verbs` is called at the first request, beside the loop; an error of it is the
        answer. `stop` brakes the arm at once; `clock` is that of `offer`."""
        self.malformed = 0
        """Packets that were no requests."""
        self.busy = False
        """Whether there was a request yet."""
        self._channel, self._link = channel, link
        self._make_verbs, self._stop, self._clock = make_verbs, stop, clock
        self._desk: VerbDesk | None = None
        self._why_not: CardanError | None = None
        self._packets: queue.SimpleQueue[tuple[bytes, float] | None] = queue.SimpleQueue()
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._pending = threading.BoundedSemaphore(MAX_PENDING)
        self._waits = threading.BoundedSemaphore(MAX_WAITS)
        self._stops = 0
        self._motions: dict[int, Motion] = {}
        """Motions that are not over, by their clients' ids."""
        self._ids = itertools.count(1)
        self._telling, self._making = threading.Lock(), threading.Lock()
        self._threads: list[threading.Thread] = []

    # -- for the loop ----------------------------------------------------------------------------

    @property
    def full(self) -> bool:
        """Whether packets should stay in the channel for now."""
        return self._packets.qsize() >= MAX_PENDING

    def offer(self, packet: bytes, now_s: float) -> None:
        """Take a packet that is no heartbeat."""
        if not self.busy:
            self.busy = True
            for name, work in (("requests", self._receive), ("planning", self._work)):
                thread = threading.Thread(target=work, name=name, daemon=True)
                self._threads.append(thread)
                thread.start()
        self._packets.put((packet, now_s))

    def attend(self) -> None:
        """Once a cycle: do what the verbs need the loop for, and find motions that are over."""
        self._link.attend()
        for motion in tuple(self._motions.values()):
            if motion.over and self._packets.empty():
                self._packets.put((b"", NEVER_S))
                break

    def close(self) -> None:
        """The loop has ended: answer all that is under way so, and end the threads."""
        self._packets.put(None)
        self._jobs.put(None)
        for thread in self._threads:
            thread.join(SEND_TIMEOUT_S)

    # -- the quick thread ------------------------------------------------------------------------

    def _receive(self) -> None:
        while (item := self._packets.get()) is not None:
            packet, received_s = item
            if received_s == NEVER_S:
                self._report_ended_motions()
                continue
            try:
                request = decode_request(packet)
            except PacketError as error:
                self.malformed += 1
                self._send(encode_error(error.request, _cause(error)))
                continue
            self._dispatch(_Job(request, received_s, self._stops))

    def _dispatch(self, job: _Job) -> None:
        verb = job.request.verb
        if verb == "stop":
            self._stops += 1
            self._stop()
            self._reply(job.request, None)
        elif verb == "wait":
            self._wait(job)
        elif verb in _QUICK and self._desk is not None:
            self._perform(job)
        elif not self._pending.acquire(blocking=False):
            self._refuse(job, f"{MAX_PENDING} requests are waiting already")
        else:
            self._jobs.put(job)

    def _wait(self, job: _Job) -> None:
        if not self._waits.acquire(blocking=False):
            self._refuse(job, f"{MAX_WAITS} requests are waiting already")
            return

        def wait() -> None:
            try:
                self._perform(job)
            finally:
                self._waits.release()

        threading.Thread(target=wait, name="wait", daemon=True).start()

    # -- the planning thread ---------------------------------------------------------------------

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            self._pending.release()
            self._perform(job)
            # The session's collector is off for the loop's sake, and what was there before is
            # frozen: only what requests leave behind is looked at here.
            gc.collect(1)

    def _perform(self, job: _Job) -> None:
        """Carry out and answer; in the thread that the verb belongs to."""
        request = job.request
        try:
            desk = self._opened()
            if request.verb in _STREAMED and self._clock() - job.received_s > STALE_S:
                self._reply(request, f"{request.verb}: it waited for more than {STALE_S:g} s")
                return
            if request.verb in _NEW_MOTION and job.stops != self._stops:
                raise MotionRefusedError(f"{request.verb}: the arm was stopped before it began")
            result = desk.perform(request.verb, request.source, request.value, request.sequence)
            if request.verb in _NEW_MOTION and job.stops != self._stops:
                self._stop()  # It came between the last check and the beginning.
        except Exception as error:
            self._report_ended_motions()
            told = error if isinstance(error, CardanError) else CardanError(repr(error))
            self._send(encode_error(request.id, told))
            return
        self._reply(request, result)

    def _opened(self) -> VerbDesk:
        if self._why_not is not None:
            raise self._why_not
        if self._desk is None:
            with self._making:
                if self._desk is None:
                    try:
                        self._desk = VerbDesk(self._make_verbs(), self._link)
                    except CardanError as error:
                        self._why_not = error
                        raise
        return self._desk

    # -- answers ---------------------------------------------------------------------------------

    def _refuse(self, job: _Job, why: str) -> None:
        error = MotionRefusedError(f"{job.request.verb}: {why}")
        self._send(encode_error(job.request.id, error))

    def _reply(self, request: Request, result: Any) -> None:
        self._report_ended_motions()
        if not isinstance(result, Motion):
            self._send(encode_reply(request.id, result))
            return
        with self._telling:
            note = _note(next(self._ids), result)
            self._send(encode_reply(request.id, note))
            if note.outcome is Outcome.RUNNING:
                self._motions[note.id] = result

    def _report_ended_motions(self) -> None:
        """Report motions that are over; an answer that was sent before arrives before."""
        with self._telling:
            for number, motion in tuple(self._motions.items()):
                if motion.over:
                    del self._motions[number]
                    self._send(encode_note(_note(number, motion)))

    def _send(self, packet: bytes) -> None:
        try:
            self._channel.send(packet)
        except BlockingIOError:
            if select.select((), (self._channel,), (), SEND_TIMEOUT_S)[1]:
                self._send(packet)
        except OSError:
            pass  # The supervisor is gone; the loop finds the same.


def _note(number: int, motion: Motion) -> MotionNote:
    return MotionNote(
        number, motion.verb, motion.source, motion.ends, motion.outcome, motion.reason,
        motion.note, motion.duration_s,
    )  # fmt: skip


def _cause(error: PacketError) -> CardanError:
    """The sender's mistake: an argument that a verb does not take is refused as the verb would."""
    return error.__cause__ if isinstance(error.__cause__, CardanError) else error
