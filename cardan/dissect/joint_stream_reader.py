"""The joint stream in a capture: a line per datagram, and figures per flow."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator

from cardan.dissect._scapy import Packet
from cardan.dissect.capture import Direction
from cardan.dissect.flows import DatagramFlow, DatagramReader, Dissected
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
from cardan.dissect.statistics import Latencies, tallies, tally

PENDING = 256
"""Commands remembered until a state says that one was taken: half a second at 500 Hz."""


class _Flow(DatagramFlow):
    """One arm and one client."""

    def __init__(self, arm: Endpoint, client: Endpoint) -> None:
        super().__init__(arm, client)
        self._session: int | None = None
        self._sessions = 0
        self._taken: int | None = None
        self._asked = self._foreign = 0
        self._latencies = Latencies()
        self._modes: Counter[str] = Counter()
        self._reasons: Counter[str] = Counter()
        self._pending: deque[tuple[int, int]] = deque(maxlen=PENDING)  # sequence, time in ns

    def take(self, direction: Direction, layer: Packet, time_ns: int) -> Iterator[str]:
        yield describe(layer)
        verdict = self.senders[direction].add(layer.sequence, layer.original, time_ns)
        if verdict not in ("first", "next"):
            yield f"SEQUENCE {verdict.upper()}"
        if verdict == "duplicate":
            return
        if direction is Direction.TO_DEVICE:
            yield from self._command(layer, time_ns)
        elif verdict != "late":
            yield from self._state(layer, time_ns)

    def _state(self, state: Packet, time_ns: int) -> Iterator[str]:
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

    def _command(self, command: Packet, time_ns: int) -> Iterator[str]:
        self._asked += 1
        self._modes[MODES[command.mode]] += 1
        self._pending.append((command.sequence, time_ns))
        greeting = command.session == 0 and command.mode == HOLD
        if not greeting and command.session != self._session:
            self._foreign += 1
            yield "NOT THE SESSION OF THE NEWEST STATE"

    def summary(self) -> Iterator[str]:
        yield f"joint stream flow arm {self.device} -> client {self.client}"
        for name, sender in zip(("arm", "client"), self.senders.values(), strict=True):
            yield from sender.summary(name, f", sequence restarts {sender.sequence.restarts}")
        if self._asked:
            line = f"  commands: {tally(self._modes)}"
            yield line + (f", of another session {self._foreign}" if self._foreign else "")
        yield (
            f"  sessions {self._sessions}, commands that states name as taken "
            f"{len(self._latencies)}, latency {self._latencies}"
        )
        yield from tallies("  ", ("reasons of the arm", self._reasons))


class JointStreamReader(DatagramReader[_Flow]):
    """UDP datagrams that begin with the mark of the protocol, or go to or from its port."""

    def open(self, device: Endpoint, client: Endpoint) -> _Flow:
        return _Flow(device, client)

    def dissect(self, segment: Segment) -> Dissected | None:
        """Which way it went: by its kind, then by the flows that are known, then by the port."""
        ports = {segment.source.port, segment.destination.port}
        if JOINT_STREAM_PORT not in ports and not segment.payload.startswith(MAGIC):
            return None
        layer = JointStream(segment.payload)
        broken = isinstance(layer, JointStreamBroken)
        direction = self.known_direction(segment) if broken else None
        if direction is None:
            from_port = segment.source.port == JOINT_STREAM_PORT
            from_arm = from_port if broken else isinstance(layer, JointStreamState)
            direction = Direction.FROM_DEVICE if from_arm else Direction.TO_DEVICE
        return Dissected(layer, direction, "joint stream", malformed(layer))
