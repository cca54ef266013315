"""EGM traffic in a capture: a line per datagram, and what each flow was like."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from cardan.dissect.capture import CapturedPacket
from cardan.dissect.egm import (
    CORRECTION,
    PATH_CORRECTION,
    EgmFromPc,
    EgmRobot,
    malformed,
    message_type,
    remarks,
)
from cardan.dissect.egm_text import describe
from cardan.dissect.network import Endpoint, Segment
from cardan.dissect.protobuf import ProtoMessage
from cardan.dissect.reader import Options, PacketLine, ProtocolReader
from cardan.dissect.statistics import Intervals, Latencies, Sequence, tally

PENDING = 256
"""Datagrams of the controller a late reply is looked for among: one second at 250 Hz."""
SHOWN_BYTES = 24
"""Of a malformed datagram; the first fields tell what it was meant to be."""
QUIET = ("first", "next")


class _Direction:
    """What went one way in a flow."""

    def __init__(self) -> None:
        self.datagrams = 0
        self.sequence = Sequence()
        self.intervals = Intervals()
        self.malformed: Counter[str] = Counter()
        self.remarks: Counter[str] = Counter()

    def add(self, message: ProtoMessage, time_ns: int) -> str:
        """One good datagram; what its seqno says."""
        self.remarks.update(remarks(message))
        if message.header is None or message.header.seqno is None:
            return "next"
        verdict = self.sequence.add(message.header.seqno, message.original)
        if verdict == "restart":
            self.intervals.pause()
        if verdict in ("first", "next", "gap", "restart"):
            self.intervals.add(time_ns)
        return verdict


class _Pending:
    """A datagram of the controller that may yet be answered."""

    def __init__(self, tm: int | None, time_ns: int) -> None:
        self.tm, self.time_ns, self.answered = tm, time_ns, False


class _Flow:
    """One controller socket and one PC socket."""

    def __init__(self, controller: Endpoint, pc: Endpoint, follows: Endpoint | None) -> None:
        self.controller, self.pc, self.follows = controller, pc, follows
        self.robot, self.replies = _Direction(), _Direction()
        self.latencies = Latencies()
        self.questions = self.matched_by_tm = self.extra = 0
        self._pending: deque[_Pending] = deque(maxlen=PENDING)

    def asked(self, message: ProtoMessage, time_ns: int) -> None:
        """The controller sent a datagram that a PC would answer."""
        tm = message.header.tm if message.header is not None else None
        self.questions += 1
        self._pending.append(_Pending(tm, time_ns))

    def replied(self, message: ProtoMessage, time_ns: int) -> None:
        """The PC sent one: the answer to the datagram whose tm it echoes, else to the newest."""
        tm = message.header.tm if message.header is not None else None
        echoed = None
        if tm:
            echoed = next((p for p in reversed(self._pending) if p.tm == tm), None)
        asked = echoed or (self._pending[-1] if self._pending else None)
        if asked is None or asked.answered:
            self.extra += 1
            return
        asked.answered = True
        self.matched_by_tm += echoed is not None
        self.latencies.add(time_ns - asked.time_ns)

    def summary(self) -> Iterator[str]:
        yield f"EGM flow controller {self.controller} -> PC {self.pc}"
        if self.follows:
            yield f"  new session: the controller's port was {self.follows.port} before"
        restarts = self.robot.sequence.restarts
        yield from _direction("controller", self.robot, f", session restarts {restarts}")
        yield from _direction("PC", self.replies, "")
        unanswered = self.questions - len(self.latencies)
        line = f"  replies: unanswered datagrams {unanswered}, latency {self.latencies}"
        if self.latencies:
            line += f" ({self.matched_by_tm} of {len(self.latencies)} matched by tm)"
        yield line + (f", more than one per datagram {self.extra}" if self.extra else "")


def _direction(sender: str, direction: _Direction, more: str) -> Iterator[str]:
    yield (
        f"  from {sender}: {direction.datagrams} datagrams, {direction.sequence}, "
        f"{direction.intervals}{more}"
    )
    if direction.malformed:
        yield f"    malformed: {tally(direction.malformed)}"
    if direction.remarks:
        yield f"    remarks: {tally(direction.remarks)}"


class _Route(NamedTuple):
    controller: Endpoint
    pc: Endpoint
    from_controller: bool


class EgmReader(ProtocolReader):
    """UDP datagrams to and from the ports a PC listens at."""

    name = "EGM"

    def __init__(self, options: Options) -> None:
        super().__init__(options)
        self._ports = options.egm_ports
        self._flows: dict[tuple[Endpoint, Endpoint], _Flow] = {}

    def feed(self, frame: CapturedPacket, network: Segment | str) -> Iterable[PacketLine]:
        if not isinstance(network, Segment) or network.protocol != "UDP":
            return
        route = self._route(network)
        if route is None:
            return
        self.frames += 1
        self.messages += 1
        flow = self._flow(route)
        direction = flow.robot if route.from_controller else flow.replies
        direction.datagrams += 1
        message = (EgmRobot if route.from_controller else EgmFromPc)(network.payload)
        reason = "cut by the capture" if network.cut else malformed(message)
        if reason:
            self.malformed[reason] += 1
            direction.malformed[reason] += 1
            start = network.payload[:SHOWN_BYTES].hex(" ")
            text = (
                f"MALFORMED {type(message).__name__}: {reason} ({len(network.payload)} B: {start}"
            )
            text += " ...)" if len(network.payload) > SHOWN_BYTES else ")"
        else:
            verdict = direction.add(message, frame.time_ns)
            if not route.from_controller:
                flow.replied(message, frame.time_ns)
            elif verdict != "duplicate":
                flow.asked(message, frame.time_ns)
            text = describe(message) + ("" if verdict in QUIET else f" | SEQNO {verdict.upper()}")
        yield frame, f"{network.source} > {network.destination} {text}"

    def _route(self, segment: Segment) -> _Route | None:
        to_pc = segment.destination.port in self._ports
        from_pc = segment.source.port in self._ports
        if to_pc and from_pc:
            # The controller's local port happens to be one of ours: mtype decides.
            to_pc = message_type(segment.payload) not in (CORRECTION, PATH_CORRECTION)
        if to_pc:
            return _Route(segment.source, segment.destination, True)
        return _Route(segment.destination, segment.source, False) if from_pc else None

    def _flow(self, route: _Route) -> _Flow:
        key = route.controller, route.pc
        flow = self._flows.get(key)
        if flow is None:
            earlier = [c for c, pc in self._flows if pc == route.pc and c.host == key[0].host]
            flow = self._flows[key] = _Flow(*key, earlier[-1] if earlier else None)
        return flow

    def summary(self) -> Iterable[str]:
        if self.messages and self.messages == self.malformed.total():
            ports = " ".join(map(str, sorted(self._ports)))
            yield f"no datagram on the EGM ports ({ports}) is an EGM message"
        for flow in self._flows.values():
            yield from flow.summary()
