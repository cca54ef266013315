"""EGM traffic in a capture: a line per datagram, and figures per flow."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

from cardan.dissect.capture import Direction
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
from cardan.dissect.flows import DatagramFlow, DatagramReader, Dissected
from cardan.dissect.network import Endpoint, Segment
from cardan.dissect.ports import EGM_PORTS
from cardan.dissect.protobuf import ProtoMessage
from cardan.dissect.statistics import Latencies

PENDING = 256
"""Datagrams of the controller a late reply is looked for among: one second at 250 Hz."""
QUIET = ("first", "next")


class _Pending:
    """A datagram of the controller that may yet be answered."""

    def __init__(self, tm: int | None, time_ns: int) -> None:
        self.tm, self.time_ns, self.answered = tm, time_ns, False


class _Flow(DatagramFlow):
    """One controller socket and one PC socket."""

    follows: Endpoint | None = None
    """The controller's end of the session before."""

    def __init__(self, controller: Endpoint, pc: Endpoint) -> None:
        super().__init__(controller, pc)
        self.latencies = Latencies()
        self.questions = self.matched_by_tm = self.extra = 0
        self._pending: deque[_Pending] = deque(maxlen=PENDING)

    def take(self, direction: Direction, layer: ProtoMessage, time_ns: int) -> Iterator[str]:
        yield describe(layer)
        sender, header = self.senders[direction], layer.header
        sender.remarks.update(remarks(layer))
        seqno, tm = (None, None) if header is None else (header.seqno, header.tm)
        verdict = "next" if seqno is None else sender.add(seqno, layer.original, time_ns)
        if direction is Direction.TO_DEVICE:
            self._replied(tm, time_ns)
        elif verdict != "duplicate":
            self.questions += 1
            self._pending.append(_Pending(tm, time_ns))
        if verdict not in QUIET:
            yield f"SEQNO {verdict.upper()}"

    def _replied(self, tm: int | None, time_ns: int) -> None:
        """The PC's answer to the datagram whose tm it echoes, else to the newest."""
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
        yield f"EGM flow controller {self.device} -> PC {self.client}"
        if self.follows:
            yield f"  new session: the controller's port was {self.follows.port} before"
        robot = self.senders[Direction.FROM_DEVICE]
        yield from robot.summary("controller", f", session restarts {robot.sequence.restarts}")
        yield from self.senders[Direction.TO_DEVICE].summary("PC")
        unanswered = self.questions - len(self.latencies)
        line = f"  replies: unanswered datagrams {unanswered}, latency {self.latencies}"
        if self.latencies:
            line += f" ({self.matched_by_tm} of {len(self.latencies)} matched by tm)"
        yield line + (f", more than one per datagram {self.extra}" if self.extra else "")


class EgmReader(DatagramReader[_Flow]):
    """UDP datagrams to and from the ports a PC listens at."""

    def __init__(self, egm_ports: frozenset[int] = frozenset(EGM_PORTS)) -> None:
        super().__init__()
        self._ports = egm_ports

    def dissect(self, segment: Segment) -> Dissected | None:
        to_pc = segment.destination.port in self._ports
        from_pc = segment.source.port in self._ports
        if to_pc and from_pc:
            # The controller's local port happens to be one of ours: mtype decides.
            to_pc = message_type(segment.payload) not in (CORRECTION, PATH_CORRECTION)
        if not to_pc and not from_pc:
            return None
        layer = (EgmRobot if to_pc else EgmFromPc)(segment.payload)
        direction = Direction.FROM_DEVICE if to_pc else Direction.TO_DEVICE
        return Dissected(layer, direction, type(layer).__name__, malformed(layer))

    def open(self, device: Endpoint, client: Endpoint) -> _Flow:
        earlier = [c for c, pc in self.flows if pc == client and c.host == device.host]
        flow = _Flow(device, client)
        flow.follows = earlier[-1] if earlier else None
        return flow

    def summary(self) -> Iterable[str]:
        if self.messages and self.messages == self.malformed.total():
            ports = " ".join(map(str, sorted(self._ports)))
            yield f"no datagram on the EGM ports ({ports}) is an EGM message"
        yield from super().summary()
