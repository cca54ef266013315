"""JR3 boards in a capture of a CAN bus: a line per frame, and figures per board.

The identifiers of the boards are in use on any CANopen bus as well. A node is taken for a board
when its FORCES are followed by its MOMENTS with the same counter, then with the frames from and to
it shortly before; or when the user names it.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator

from cardan.dissect import can
from cardan.dissect.can import CapturedCanFrame
from cardan.dissect.capture import CapturedPacket
from cardan.dissect.jr3_can import (
    ACKNOWLEDGED,
    COUNTER_MODULUS,
    OPCODE_MASK,
    SAMPLE_PERIOD_S,
    SYNC_IDENTIFIER,
    AckFrame,
    BootupFrame,
    BrokenFrame,
    ForcesFrame,
    FullScalesAckFrame,
    GetForceScalesFrame,
    GetMomentScalesFrame,
    Jr3Frame,
    MomentsFrame,
    dissect,
    malformed,
    split,
)
from cardan.dissect.jr3_can_text import Scales, describe, overrange
from cardan.dissect.network import Segment
from cardan.dissect.reader import CUT, PacketLine, ProtocolReader
from cardan.dissect.statistics import Intervals, Latencies, tallies, tally

HELD_PACKETS = 64
"""Packets held of a node not identified yet: the handshake before its first sample, and more."""
FIRST_OPCODE = 0x100
"""Lower ones are no board's."""
FORCES_OPCODE, MOMENTS_OPCODE = ForcesFrame.opcode, MomentsFrame.opcode


class _Board:
    """One node of the bus."""

    def __init__(self, node: int, ours: bool) -> None:
        self.node = node
        self.ours = ours
        self.held: deque[tuple[CapturedPacket, CapturedCanFrame]] = deque(maxlen=HELD_PACKETS)
        self.frames: Counter[str] = Counter()
        self.malformed: Counter[str] = Counter()
        self._force_scales: Scales | None = None
        self._moment_scales: Scales | None = None
        self._asked: tuple[Jr3Frame, int] | None = None  # the command and its time in ns
        self._commands = self._unasked = self._not_ready = 0
        self._latencies = Latencies()
        self._forces_counter: int | None = None  # of FORCES whose MOMENTS have not come
        self._newest_counter: int | None = None
        self._samples = self._halves = self._duplicates = self._overranges = 0
        self._steps: Counter[int] = Counter()
        self._intervals = Intervals()

    def take(self, frame: Jr3Frame, time_ns: int) -> Iterator[str]:
        """A good frame: its values, and remarks on them."""
        self.frames[frame.title] += 1
        if isinstance(frame, ForcesFrame | MomentsFrame):
            forces = isinstance(frame, ForcesFrame)
            yield describe(frame, self._force_scales if forces else self._moment_scales)
            yield from self._forces(frame) if forces else self._moments(frame, time_ns)
            return
        yield describe(frame)
        if isinstance(frame, AckFrame | FullScalesAckFrame):
            yield from self._acknowledged(frame, time_ns)
        elif isinstance(frame, BootupFrame):
            self._asked = None
            self._pause()
        elif isinstance(frame, ACKNOWLEDGED):
            self._commands += 1
            self._asked = frame, time_ns
            self._pause()

    def _pause(self) -> None:
        """The counter and the period of the samples may start anew."""
        self._intervals.pause()
        self._newest_counter = None

    def _forces(self, frame: Jr3Frame) -> Iterator[str]:
        self._overranges += overrange(frame)
        if self._forces_counter is not None:
            self._halves += 1
            yield "NO MOMENTS BEFORE"
        self._forces_counter = frame.counter

    def _moments(self, frame: Jr3Frame, time_ns: int) -> Iterator[str]:
        self._overranges += overrange(frame)
        counter, self._forces_counter = self._forces_counter, None
        if counter != frame.counter:
            self._halves += 1 if counter is None else 2
            yield "NO FORCES OF THIS COUNTER"
            return
        self._samples += 1
        self._intervals.add(time_ns)
        if self._newest_counter is not None:
            step = (frame.counter - self._newest_counter) % COUNTER_MODULUS
            if step:
                self._steps[step] += 1
            else:
                self._duplicates += 1
                yield "SAME SAMPLE AGAIN"
        self._newest_counter = frame.counter

    def _acknowledged(self, frame: Jr3Frame, time_ns: int) -> Iterator[str]:
        if frame.state:
            self._not_ready += 1
        if self._asked is None:
            self._unasked += 1
            yield "NOT ASKED FOR"
            return
        (command, asked_ns), self._asked = self._asked, None
        self._latencies.add(time_ns - asked_ns)
        yield f"of {command.title}"
        if isinstance(frame, FullScalesAckFrame) and not frame.state:
            scales = (frame.x, frame.y, frame.z)
            if isinstance(command, GetForceScalesFrame):
                self._force_scales = scales
            elif isinstance(command, GetMomentScalesFrame):
                self._moment_scales = scales

    def summary(self) -> Iterator[str]:
        yield f"JR3 board, node {self.node}: {tally(self.frames) or 'no frames'}"
        if self._samples:
            yield f"  samples {self._samples}, {self._intervals}"
        if self._steps:
            mean = sum(n * count for n, count in self._steps.items()) / self._steps.total()
            mean_ms = mean * SAMPLE_PERIOD_S * 1e3
            yield f"  counter steps {mean:.2f} a sample, {mean_ms:.3f} ms of the sensor's time"
        for label, count in (
            ("halves without the other", self._halves),
            ("samples sent again", self._duplicates),
            ("halves beyond full scale", self._overranges),
            ("ACKs that nothing asked for", self._unasked),
            ("ACKs that say not initialised", self._not_ready),
        ):
            if count:
                yield f"  {label}: {count}"
        if self._commands:
            yield (
                f"  commands answered {len(self._latencies)} of {self._commands}, "
                f"latency {self._latencies}"
            )
        for label, scales, unit in (
            ("forces", self._force_scales, "N"),
            ("moments", self._moment_scales, "0.1 N·m"),
        ):
            if scales is not None:
                yield f"  full scales of {label} {' '.join(map(str, scales))} {unit}"
        yield from tallies("  ", ("malformed", self.malformed))


class Jr3CanReader(ProtocolReader):
    """Frames of boards with a JR3 sensor."""

    def __init__(self, jr3_nodes: frozenset[int] = frozenset()) -> None:
        super().__init__()
        self._boards = {node: _Board(node, True) for node in sorted(jr3_nodes)}
        self._found = bool(self._boards)
        self._syncs = Intervals()
        self._sync_count = 0

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Iterable[PacketLine]:
        captured = can.parse(packet)
        if captured is None:
            return
        opcode, node = split(captured.identifier)
        if captured.identifier == SYNC_IDENTIFIER:
            if self._found:
                yield self._sync(packet)
            return
        if opcode < FIRST_OPCODE or not node:
            return
        board = self._boards.setdefault(node, _Board(node, False))
        if board.ours:
            yield self._take(board, packet, captured)
            return
        before = board.held[-1][1] if board.held else None
        board.held.append((packet, captured))
        if before is not None and _is_sample(before, captured):
            board.ours = self._found = True
            for earlier, held in board.held:
                yield self._take(board, earlier, held)
            board.held.clear()

    def _sync(self, packet: CapturedPacket) -> PacketLine:
        self.packets += 1
        self.messages += 1
        self._sync_count += 1
        self._syncs.add(packet.time_ns)
        return packet, f"CAN 0x{SYNC_IDENTIFIER:03x} SYNC to every node"

    def _take(self, board: _Board, packet: CapturedPacket, frame: CapturedCanFrame) -> PacketLine:
        self.packets += 1
        self.messages += 1
        where = f"CAN 0x{frame.identifier:03x} JR3 node {board.node}"
        reason = CUT if frame.cut else None
        layer = dissect(frame.identifier, frame.data)
        if reason is None and isinstance(layer, BrokenFrame):
            reason = malformed(frame.identifier, frame.data)
        if reason:
            self.count_malformed(reason, board.malformed)
            return packet, f"{where} MALFORMED {reason}: {frame.data.hex(' ')}".rstrip()
        return packet, f"{where} " + " | ".join(board.take(layer, packet.time_ns))

    def summary(self) -> Iterable[str]:
        for board in self._boards.values():
            if board.ours:
                yield from board.summary()
        if self._sync_count:
            yield f"SYNC of the CAN bus: {self._sync_count}, {self._syncs}"


def _is_sample(first: CapturedCanFrame, second: CapturedCanFrame) -> bool:
    """Whether two frames of one node that follow each other are a board's sample."""
    return (
        first.identifier & OPCODE_MASK == FORCES_OPCODE
        and second.identifier & OPCODE_MASK == MOMENTS_OPCODE
        and len(first.data) == len(second.data) == ForcesFrame.least_bytes
        and first.data[6:] == second.data[6:]
    )
