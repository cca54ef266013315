"""The joint stream in a capture: a line per datagram, and what each flow was like."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator

from cardan.dissect._scapy import Packet
from cardan.dissect.capture import CapturedPacket
from cardan.dissect.joint_stream import (
    HOLD,
    MAGIC,
    MODES,
    JointStream,
    JointStreamBroken,
    JointStreamState,
    malformed,
)
from cardan.dissect.joint_stream_text import describe
from cardan.dissect.network import Endpoint, Segment
from cardan.dissect.ports import JOINT_STREAM_PORT
from cardan.dissect.reader import Options, PacketLine, ProtocolReader
from cardan.dissect.statistics import Intervals, Latencies, Sequence, tally

PENDING = 256
"""Commands remembered until a state says that one was taken: half a second at 500 Hz."""
SHOWN_BYTES = 24
"""Of a malformed datagram: its header."""


class _Direction:
    """What went one way in a flow."""

    def __init__(self) -> None:
        self.datagrams = 0
        self.sequence = Sequence()
        self.intervals = Intervals()
        self.malformed: Counter[str] = Counter()

    def add(self, sequence: int, datagram: bytes, time_ns: int) -> str:
        """One good datagram; what its sequence number says."""
        verdict = self.sequence.add(sequence, datagram)
        if verdict == "restart":
            self.intervals.pause()
        if verdict not in ("duplicate", "repeated", "late"):
            self.intervals.add(time_ns)
        return verdict

    def summary(self, sender: str) -> Iterator[str]:
        yield (
            f"  from {sender}: {self.datagrams} datagrams, {self.sequence}, {self.intervals}, "
            f"sequence restarts {self.sequence.restarts}"
        )
        if self.malformed:
            yield f"    malformed: {tally(self.malformed)}"


class _Flow:
    """One arm and one client."""

    def __init__(self, arm: Endpoint, client: Endpoint) -> None:
        self.arm, self.client = arm, client
        self.states, self.commands = _Direction(), _Direction()
        self._session: int | None = None
        self._sessions = 0
        self._taken: int | None = None
        self._asked = self._foreign = 0
        self._latencies = Latencies()
        self._modes: Counter[str] = Counter()
        self._reasons: Counter[str] = Counter()
        self._pending: deque[tuple[int, int]] = deque(maxlen=PENDING)  # sequence, time in ns

    def state(self, state: Packet, time_ns: int) -> Iterator[str]:
        """A good state; what is to be said of it."""
        verdict = self.states.add(state.sequence, state.original, time_ns)
        if verdict not in ("first", "next"):
            yield f"SEQUENCE {verdict.upper()}"
        if verdict in ("duplicate", "late"):
            return
        if state.session != self._session:
            if self._session is not None:
                yield f"SESSION CHANGED FROM {self._session}"
            self._session = state.session
            self._sessions += 1
        if state.reason:
            self._reasons[state.reason.decode()] += 1
        if state.taken != self._taken:
            self._taken = state.taken
            self._acknowledge(state.taken, time_ns)

    def _acknowledge(self, taken: int, time_ns: int) -> None:
        for back, (sequence, asked_ns) in enumerate(reversed(self._pending)):
            if sequence == taken:
                self._latencies.add(time_ns - asked_ns)
                for _ in range(len(self._pending) - back):
                    self._pending.popleft()
                return

    def command(self, command: Packet, time_ns: int) -> Iterator[str]:
        """A good command; what is to be said of it."""
        verdict = self.commands.add(command.sequence, command.original, time_ns)
        if verdict not in ("first", "next"):
            yield f"SEQUENCE {verdict.upper()}"
        if verdict == "duplicate":
            return
        self._asked += 1
        self._modes[MODES[command.mode]] += 1
        self._pending.append((command.sequence, time_ns))
        greeting = command.session == 0 and command.mode == HOLD
        if not greeting and command.session != self._session:
            self._foreign += 1
            yield "NOT THE SESSION OF THE NEWEST STATE"

    def summary(self) -> Iterator[str]:
        yield f"joint stream flow arm {self.arm} -> client {self.client}"
        yield from self.states.summary("arm")
        yield from self.commands.summary("client")
        if self._asked:
            line = f"  commands: {tally(self._modes)}"
            yield line + (f", of another session {self._foreign}" if self._foreign else "")
        yield (
            f"  sessions {self._sessions}, commands that states name as taken "
            f"{len(self._latencies)}, latency {self._latencies}"
        )
        if self._reasons:
            yield f"  reasons of the arm: {tally(self._reasons)}"


class JointStreamReader(ProtocolReader):
    """UDP datagrams that begin with the mark of the protocol, or go to or from its port.

    What goes to or from a port of EGM is left to EGM.
    """

    name = "joint stream"

    def __init__(self, options: Options) -> None:
        super().__init__(options)
        self._egm_ports = options.egm_ports
        self._flows: dict[tuple[Endpoint, Endpoint], _Flow] = {}

    def feed(self, frame: CapturedPacket, network: Segment | str) -> Iterable[PacketLine]:
        if not isinstance(network, Segment) or not self._is_ours(network):
            return
        self.frames += 1
        self.messages += 1
        datagram = JointStream(network.payload)
        flow, from_arm = self._flow(network, datagram)
        direction = flow.states if from_arm else flow.commands
        direction.datagrams += 1
        reason = "cut by the capture" if network.cut else malformed(datagram)
        if reason is None:
            take = flow.state if from_arm else flow.command
            text = " | ".join((describe(datagram), *take(datagram, frame.time_ns)))
        else:
            self.malformed[reason] += 1
            direction.malformed[reason] += 1
            shown = network.payload[:SHOWN_BYTES].hex(" ")
            more = " ..." if len(network.payload) > SHOWN_BYTES else ""
            text = f"MALFORMED {self.name}: {reason} ({len(network.payload)} B: {shown}{more})"
        yield frame, f"{network.source} > {network.destination} {text}"

    def _is_ours(self, segment: Segment) -> bool:
        ports = {segment.source.port, segment.destination.port}
        if segment.protocol != "UDP" or ports & self._egm_ports:
            return False
        return JOINT_STREAM_PORT in ports or segment.payload.startswith(MAGIC)

    def _flow(self, segment: Segment, datagram: Packet) -> tuple[_Flow, bool]:
        """The flow, and whether the arm sent it: by kind, then the flows known, then the port."""
        ways = (segment.source, segment.destination), (segment.destination, segment.source)
        if not isinstance(datagram, JointStreamBroken):
            from_arm = isinstance(datagram, JointStreamState)
        elif ways[0] in self._flows or ways[1] in self._flows:
            from_arm = ways[0] in self._flows
        else:
            from_arm = segment.source.port == JOINT_STREAM_PORT
        key = ways[0] if from_arm else ways[1]
        return self._flows.setdefault(key, _Flow(*key)), from_arm

    def summary(self) -> Iterable[str]:
        for flow in self._flows.values():
            yield from flow.summary()
