"""Worker for stops and other requests to a session, beside its loop, which only passes packets on.
Two threads, which begin with the first request: one decodes and carries out quick requests, so that
`stop` acts at once during any other; the other plans or waits for rest, one request after the
other."""

from __future__ import annotations

import gc
import itertools
import math
import queue
import select
import socket
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from cardan.common.resource_errors import shortage
from cardan.errors import CardanError, MotionRefusedError
from cardan.gateway.arm.backlog import STREAMED_S
from cardan.gateway.arm.loop_link import LoopLink
from cardan.gateway.arm.requests import (
    CANCELED,
    LATE_S,
    MotionNote,
    PacketError,
    Request,
    decode_request,
    encode_error,
    encode_note,
    encode_reply,
)
from cardan.gateway.arm.verb_results import Motion, Outcome
from cardan.gateway.arm.verb_server import VerbServer
from cardan.gateway.arm.verb_table import ENDLESS, NEW_MOTION, QUICK, SEQUENCED
from cardan.gateway.arm.vocab import Begins
from cardan.types import NEVER_S

if TYPE_CHECKING:  # Imports Pinocchio, which sessions without an arm's model do without.
    from cardan.gateway.arm.verb_methods import ArmVerbs

GONE = "the node that sent the request is gone"
"""Reason for ending or not beginning a motion without end."""

MAX_PENDING = 32
"""Largest number of requests that wait for earlier ones: more are refused."""

MAX_WAITS = 8
"""Largest number of requests that wait for a motion's end, each in a thread of its own."""

MALFORMED, VERB, BUSY = "malformed", "verb", "busy"
REFUSALS = (MALFORMED, VERB, BUSY)
"""Kinds of refusals: malformed requests, verbs that cannot be done now, and too many waiting
requests."""

SEND_TIMEOUT_S = 1.0
"""Longest wait of a reply for its reader; a reader silent for half of it blocks the arm."""

_BEGINNING = SEQUENCED & QUICK
"""Streamed commands that plan only to begin their stream."""


class Requester(Protocol):
    """Origin of requests and receiver of their answers. Called by the worker's threads."""

    def decode(self, packet: Any) -> Request | None:
        """Return the request in an offered packet; None if it is answered already. Raises
        PacketError."""

    def done(self, request: Request, result: Any) -> None:
        """Report that a request was carried out; `result` is the verb's, a motion as its note."""

    def refused(self, number: int | None, error: CardanError) -> None:
        """Report that the request with this id, or a malformed one, was refused."""

    def ended(self, note: MotionNote) -> None:
        """Report the end of a motion that `done` reported."""


class ChannelClient:
    """The client at the other end of a socket of packets: the supervisor."""

    def __init__(self, channel: socket.socket) -> None:
        self._channel = channel

    def decode(self, packet: Any) -> Request:
        """Decode from one packet. Raises PacketError."""
        return decode_request(packet)

    def done(self, request: Request, result: Any) -> None:
        """Send the reply."""
        self.send(encode_reply(request.id, result))

    def refused(self, number: int | None, error: CardanError) -> None:
        """Send the refusal."""
        self.send(encode_error(number, error))

    def ended(self, note: MotionNote) -> None:
        """Send the state of a motion."""
        self.send(encode_note(note))

    def send(self, packet: bytes) -> None:
        """Send a packet; it is lost if the supervisor has ended, or does not read."""
        try:
            self._channel.send(packet)
        except BlockingIOError:
            if select.select((), (self._channel,), (), SEND_TIMEOUT_S)[1]:
                self.send(packet)
        except OSError:
            pass  # The supervisor is gone; the loop finds the same.


class _Begun(NamedTuple):
    """A motion that is not over."""

    motion: Motion
    client: Requester
    there: Callable[[], bool] | None
    """Return whether its client is connected, as in the request."""


class _Packet(NamedTuple):
    """Packet of a client; None: the ends of motions are to be reported."""

    client: Requester
    packet: Any
    received_s: float
    late_s: float
    """Longest time that it may have waited before it was received."""


_ENDED = {
    "stop": "the arm was stopped before it began",
    "release": "its source gave up its authority before it began",
}
"""Verbs that cancel earlier motions that have not begun, with the reason."""


@dataclass(eq=False)
class _Job:
    client: Requester
    request: Request
    received_s: float
    late_s: float
    """Longest time that it may have waited before it was received."""
    ended_by: str = ""
    """Verb of _ENDED that came after it; empty: none."""


class RequestWorker:
    """Answers the requests of all clients of a session.

    `offer` and `run_due` are for the loop's thread; neither blocks. The loop runs `link` once
    `busy`.
    """

    def __init__(
        self,
        link: LoopLink,
        make_verbs: Callable[[], ArmVerbs],
        stop: Callable[[str, str], None],
        clock: Callable[[], float],
    ) -> None:
        """`make_verbs` is called at the first request, beside the loop; its error is the answer.
        `stop` brakes the arm at once, for a reason and a requesting source ("": none); `clock` is
        that of `offer`."""
        self._refused = dict.fromkeys(REFUSALS, 0)
        """Counts of several threads: under the lock."""
        self._counting = threading.Lock()
        self.busy = False
        """True after the first request."""
        self._link = link
        self._make_verbs, self._stop, self._clock = make_verbs, stop, clock
        self._verb_server: VerbServer | None = None
        self._why_not: CardanError | None = None
        self._packets: queue.SimpleQueue[_Packet | None] = queue.SimpleQueue()
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._pending = threading.BoundedSemaphore(MAX_PENDING)
        self._waits = threading.BoundedSemaphore(MAX_WAITS)
        self._turned_s = NEVER_S
        self._late_s = 0.0
        self._beginning: deque[tuple[Requester, str]] = deque()
        """Senders of streamed commands that wait for their stream to begin, in order."""
        self._under_way: list[_Job] = []
        """Jobs of the planning thread, with the present one."""
        self._ordering = threading.Lock()
        self._motions: dict[int, _Begun] = {}
        """Motions that are not over, by the ids in their notes."""
        self._ids = itertools.count(1)
        self._telling, self._making = threading.Lock(), threading.Lock()
        self._threads: list[threading.Thread] = []

    # -- for the loop ----------------------------------------------------------------------------

    @property
    def verbs(self) -> ArmVerbs | None:
        """The verbs, once a client has requested one."""
        return None if self._verb_server is None else self._verb_server.verbs

    @property
    def full(self) -> bool:
        """True if packets should not be offered for now."""
        return self._packets.qsize() >= MAX_PENDING

    def turn(self, now_s: float) -> None:
        """Mark a cycle, before `offer`: packets offered from now on arrived after the previous
        call."""
        self._late_s = now_s - self._turned_s
        self._turned_s = now_s

    def offer(self, client: Requester, packet: Any, now_s: float) -> None:
        """Take a client's packet; it is decoded beside the loop."""
        if not self.busy:
            self.busy = True
            for name, work in (("requests", self._receive), ("planning", self._work)):
                thread = threading.Thread(target=work, name=name, daemon=True)
                self._threads.append(thread)
                thread.start()
        self._packets.put(_Packet(client, packet, now_s, self._late_s))

    def run_due(self) -> None:
        """Run the verbs' work for the loop once a cycle, find motions that are over, and end those
        without end whose client has disconnected."""
        self._link.run_due()
        for motion, client, there in tuple(self._motions.values()):
            if motion.over:
                if self._packets.empty():
                    self._packets.put(_Packet(client, None, NEVER_S, 0.0))
                    break
            elif there is not None and not motion.ends and not there():
                self._stop(GONE, "")

    def close(self) -> None:
        """Answer all pending requests with the loop's end, and end the threads."""
        self._packets.put(None)
        self._jobs.put(None)
        for thread in self._threads:
            thread.join(SEND_TIMEOUT_S)

    # -- the quick thread ------------------------------------------------------------------------

    def _receive(self) -> None:
        while (item := self._packets.get()) is not None:
            client, packet, received_s, late_s = item
            if received_s == NEVER_S:
                self._report_ended_motions()
                continue
            try:
                request = client.decode(packet)
            except PacketError as error:
                self._count(MALFORMED)
                client.refused(error.request, _cause(error))
                continue
            except Exception as error:  # The thread must stay able to carry out `stop`.
                self._count(MALFORMED)
                client.refused(None, CardanError(repr(error)))
                continue
            if request is None:
                continue
            if request.since_s is not None:
                late_s = max(late_s, received_s - request.since_s)
            self._dispatch(_Job(client, request, received_s, late_s))

    def _dispatch(self, job: _Job) -> None:
        verb = job.request.verb
        if verb in _ENDED:
            with self._ordering:
                for each in self._under_way:
                    own = each.request.source == job.request.source and not each.ended_by
                    if verb == "stop" or own:
                        each.ended_by = verb
        if verb == "stop":
            self._stop("stopped", job.request.source)
            self._reply(job, None)
        elif verb == "wait":
            self._wait(job)
        elif verb in QUICK and (verbs := self.verbs) and not self._waits_to_begin(job, verbs):
            self._perform(job)
        elif not self._pending.acquire(blocking=False):
            self._refuse(job, f"{MAX_PENDING} requests are waiting already")
        else:
            with self._ordering:
                self._under_way.append(job)
                if verb in _BEGINNING:
                    self._beginning.append((job.client, job.request.source))
            self._jobs.put(job)

    def _waits_to_begin(self, job: _Job, verbs: ArmVerbs) -> bool:
        """Return whether a streamed command may choose its preset, which takes as long as planning,
        or follows a waiting one of its sender."""
        request, begins = job.request, job.request.begins
        with self._ordering:
            if request.verb in _BEGINNING and (job.client, request.source) in self._beginning:
                return True
        if begins is Begins.NEW or (begins and verbs.goes_on(begins, request.source)):
            return verbs.may_choose(request.verb, begins, request.source)
        return False

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
            with self._ordering:
                self._under_way.remove(job)
                if job.request.verb in _BEGINNING:
                    self._beginning.popleft()
            # The session's collector is off for the loop's sake, and earlier objects are of the
            # oldest generation: only the garbage of requests is collected here.
            gc.collect(1)

    def _perform(self, job: _Job) -> None:
        """Carry out and answer, in the verb's thread."""
        request = job.request
        try:
            verb_server = self._opened()
            waited_s = self._clock() - job.received_s + job.late_s
            if request.verb in SEQUENCED and waited_s > STREAMED_S:
                self._reply(job, f"{request.verb}: it waited for more than {STREAMED_S:g} s")
                return
            if request.begins is not None and job.ended_by:
                self._reply(job, f"{request.verb}: {_ENDED[job.ended_by]}")
                return
            if request.verb in NEW_MOTION and job.ended_by:
                raise MotionRefusedError(f"{request.verb}: {_ENDED[job.ended_by]}")
            if request.wanted is not None and not request.wanted():
                raise MotionRefusedError(f"{request.verb}: {CANCELED}")
            if request.verb in NEW_MOTION and job.late_s > LATE_S:
                raise MotionRefusedError(f"{request.verb}: {_late(job.late_s)}; ask again")
            if request.verb in ENDLESS and request.there is not None and not request.there():
                raise MotionRefusedError(f"{request.verb}: {GONE}")
            result = verb_server.perform(
                request.verb, request.source, request.value, request.sequence,
                request.stamp_s, request.begins,
            )  # fmt: skip
            if request.verb in NEW_MOTION and job.ended_by == "stop":
                # It came between the last check and the beginning, and is counted.
                self._stop("stopped", "")
            elif request.verb in NEW_MOTION and job.ended_by:
                verb_server.perform(job.ended_by, request.source)
        except Exception as error:
            self._report_ended_motions()
            if not isinstance(error, CardanError):
                error = CardanError(shortage(error) or repr(error))
            self._count(VERB)
            job.client.refused(request.id, error)
            return
        self._reply(job, result)

    def _opened(self) -> VerbServer:
        if self._why_not is not None:
            raise self._why_not
        if self._verb_server is None:
            with self._making:
                if self._verb_server is None:
                    try:
                        self._verb_server = VerbServer(self._make_verbs(), self._link)
                    except CardanError as error:
                        self._why_not = error
                        raise
        return self._verb_server

    def refusals(self) -> dict[str, int]:
        """Refused requests so far, by kind: of REFUSALS."""
        return dict(self._refused)

    def _count(self, kind: str) -> None:
        with self._counting:
            self._refused[kind] += 1

    # -- answers ---------------------------------------------------------------------------------

    def _refuse(self, job: _Job, why: str) -> None:
        self._count(BUSY)
        error = MotionRefusedError(f"{job.request.verb}: {why}")
        job.client.refused(job.request.id, error)

    def _reply(self, job: _Job, result: Any) -> None:
        self._report_ended_motions()
        if not isinstance(result, Motion):
            job.client.done(job.request, result)
            return
        with self._telling:
            note = _note(next(self._ids), result)
            job.client.done(job.request, note)
            if note.outcome is Outcome.RUNNING:
                self._motions[note.id] = _Begun(result, job.client, job.request.there)

    def _report_ended_motions(self) -> None:
        """Report motions that are over; an answer sent earlier arrives earlier."""
        with self._telling:
            for number, (motion, client, _) in tuple(self._motions.items()):
                if motion.over:
                    del self._motions[number]
                    client.ended(_note(number, motion))


def _late(late_s: float) -> str:
    if late_s == math.inf:
        return "it came before the session had begun"
    return f"the session stalled for {late_s:.1f} s when it came"


def _note(number: int, motion: Motion) -> MotionNote:
    return MotionNote(
        number, motion.verb, motion.source, motion.ends, motion.outcome, motion.reason,
        motion.note, motion.duration_s,
    )  # fmt: skip


def _cause(error: PacketError) -> CardanError:
    """Return the sender's error: an invalid argument is refused as by the verb."""
    return error.__cause__ if isinstance(error.__cause__, CardanError) else error
