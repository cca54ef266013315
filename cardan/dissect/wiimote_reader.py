"""Wii Remotes in a capture of a Bluetooth adapter: a line per report, and figures per connection.

A report travels behind one byte, the HID transaction: a1 from the remote and a2 to it on the
interrupt channel (PSM 0x13), 52 to it on the control channel (PSM 0x11). The set-up of the
connection says which channel has which PSM; where that is not in the capture, the byte does. A
connection is taken for a remote's by the name of the device, or by the first report whose id and
length are those of a remote.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

from cardan.dissect._scapy import Packet
from cardan.dissect.bluetooth import Links, Payload
from cardan.dissect.capture import CapturedPacket, Direction
from cardan.dissect.network import Segment
from cardan.dissect.reader import CUT, PacketLine, ProtocolReader
from cardan.dissect.statistics import Intervals, Latencies, tallies, tally
from cardan.dissect.wiimote import (
    DATA_MODES,
    EEPROM,
    ERRORS,
    INPUT_LAYERS,
    NO_SPACE,
    OUTPUT_LAYERS,
    AccelerometerCalibration,
    AcknowledgeReport,
    BrokenReport,
    CameraCalibration,
    DataModeReport,
    MotionPlusCalibration,
    NunchukCalibration,
    ReadReport,
    ReadRequestReport,
    StatusReport,
    UnknownReport,
    WiimoteInput,
    WiimoteOutput,
    WriteReport,
)
from cardan.dissect.wiimote_text import (
    MOTION_PLUS_INACTIVE,
    NUNCHUK,
    describe,
    describe_block,
    identity,
)

CONTROL, INTERRUPT = 0x11, 0x13
CHANNELS = {CONTROL: "control", INTERRUPT: "interrupt"}
INPUT, OUTPUT, SET_OUTPUT = 0xA1, 0xA2, 0x52
DIRECTIONS = {
    INPUT: Direction.FROM_DEVICE,
    OUTPUT: Direction.TO_DEVICE,
    SET_OUTPUT: Direction.TO_DEVICE,
}
LAYERS = {Direction.FROM_DEVICE: WiimoteInput, Direction.TO_DEVICE: WiimoteOutput}
HANDSHAKES = {
    0x00: "ok",
    0x01: "not ready",
    0x02: "invalid report id",
    0x03: "unsupported request",
    0x04: "invalid parameter",
    0x0E: "unknown error",
    0x0F: "fatal error",
}
NAMES_BEGIN = "Nintendo RVL-"
EXTENSION_PORT, MOTION_PLUS_PORT = 0xA4, 0xA6
IDENTITY, CALIBRATION, CALIBRATION_COPY = 0xFA, 0x20, 0x30
IDENTITY_BYTES, NUNCHUK_BYTES, MOTION_PLUS_BYTES = 6, 16, 32
EEPROM_BLOCKS: tuple[tuple[int, int, type[Packet]], ...] = (
    (0x0000, 11, CameraCalibration),
    (0x000B, 11, CameraCalibration),
    (0x0016, 10, AccelerometerCalibration),
    (0x0020, 10, AccelerometerCalibration),
)
"""Address, bytes and layer of the known blocks of memory."""
NO_DEVICE = 7
WRITE_ID = 0x16


class _Remote:
    """One connection."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.extension: str | None = None
        self.inputs: Counter[str] = Counter()
        self.outputs: Counter[str] = Counter()
        self.errors: Counter[str] = Counter()
        self.malformed: Counter[str] = Counter()
        self.unknown: Counter[str] = Counter()
        self._intervals: dict[int, Intervals] = {}
        self._reading: tuple[Packet, int] | None = None  # request and its time in ns
        self._pieces = b""
        self._writing: int | None = None  # time in ns
        self._memory_requests = 0
        self._latencies = Latencies()

    def sent(self, report: Packet, time_ns: int) -> None:
        """A good report to the remote."""
        self.outputs[type(report).__name__] += 1
        if isinstance(report, ReadRequestReport):
            self._memory_requests += 1
            self._reading, self._pieces = (report, time_ns), b""
            self._pause()  # reading goes before data reports
        elif isinstance(report, WriteReport):
            self._memory_requests += 1
            self._writing = time_ns
        elif isinstance(report, DataModeReport):
            self._pause()

    def _pause(self) -> None:
        """The time until the next data report is no period of theirs."""
        for intervals in self._intervals.values():
            intervals.pause()

    def received(self, report: Packet, time_ns: int) -> Iterator[str]:
        """A good report from the remote; what is to be said of it besides its values."""
        self.inputs[type(report).__name__] += 1
        if isinstance(report, ReadReport):
            yield from self._read(report, time_ns)
        elif isinstance(report, AcknowledgeReport):
            if report.error:
                error = ERRORS.get(report.error, str(report.error))
                self.errors[f"report 0x{report.of:02x} {error}"] += 1
            if report.of == WRITE_ID and self._writing is not None:
                self._latencies.add(time_ns - self._writing)
                self._writing = None
        elif isinstance(report, StatusReport):
            self._pause()  # after one that was not asked for data wait for their mode
            if not report.extension_connected:
                self.extension = None
        elif report.id in DATA_MODES:
            self._intervals.setdefault(report.id, Intervals()).add(time_ns)

    def _read(self, report: ReadReport, time_ns: int) -> Iterator[str]:
        if self._reading is None:
            yield "NOT ASKED FOR"
            return
        request, asked_ns = self._reading
        if report.address != (request.address + len(self._pieces)) & 0xFFFF:
            yield "NOT THE PIECE THAT COMES NEXT"
            return
        if not self._pieces:
            self._latencies.add(time_ns - asked_ns)
        if report.error:
            self.errors[f"read {ERRORS.get(report.error, report.error)}"] += 1
            if _is_identity(request) and report.error == NO_DEVICE:
                self.extension = None
            self._reading = None
            return
        self._pieces += report.content
        if len(self._pieces) < request.size:
            return
        self._reading = None
        if request.size > report.length_less_1 + 1:
            yield f"all {request.size} bytes from 0x{request.address:06x}"
        yield from self._known(request)

    def _known(self, request: Packet) -> Iterator[str]:
        """What the bytes just read are."""
        data, start = self._pieces, request.address & 0xFFFF
        if request.space == EEPROM:
            for address, size, layer in EEPROM_BLOCKS:
                if start <= address and address + size <= start + len(data):
                    yield describe_block(layer(data[address - start : address - start + size]))
            return
        device, start = request.address >> 16 & 0xFE, request.address & 0xFF
        if request.space == NO_SPACE or device not in (EXTENSION_PORT, MOTION_PLUS_PORT):
            return
        if start == IDENTITY and len(data) == IDENTITY_BYTES:
            name = identity(data)
            if device == EXTENSION_PORT:
                self.extension = name
            yield name
        elif start in (CALIBRATION, CALIBRATION_COPY):
            on_port = MOTION_PLUS_INACTIVE if device == MOTION_PLUS_PORT else self.extension
            if on_port == NUNCHUK and len(data) >= NUNCHUK_BYTES:
                yield describe_block(NunchukCalibration(data[:NUNCHUK_BYTES]))
            elif on_port and on_port.startswith("MotionPlus") and len(data) >= MOTION_PLUS_BYTES:
                yield describe_block(MotionPlusCalibration(data[:MOTION_PLUS_BYTES]))

    def summary(self, device_name: str | None) -> Iterator[str]:
        extension = f", extension {self.extension}" if self.extension else ""
        yield f"Wii Remote {self.name}{f' {device_name}' if device_name else ''}{extension}"
        yield f"  from the remote: {tally(self.inputs) or 'no reports'}"
        for report_id, intervals in self._intervals.items():
            yield f"    data 0x{report_id:02x}: {intervals}"
        yield f"  to the remote: {tally(self.outputs) or 'no reports'}"
        if self._memory_requests:
            yield (
                f"  memory requests answered {len(self._latencies)} of {self._memory_requests}, "
                f"latency {self._latencies}"
            )
        yield from tallies(
            "  ",
            ("errors", self.errors),
            ("malformed", self.malformed),
            ("unknown report ids", self.unknown),
        )


class WiimoteReader(ProtocolReader):
    """Reports of Wii Remotes over Bluetooth."""

    def __init__(self) -> None:
        super().__init__()
        self._links = Links()
        self._remotes: dict[int, _Remote] = {}
        self._done: list[tuple[_Remote, str | None]] = []

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Iterable[PacketLine]:
        for found in self._links.feed(packet):
            if isinstance(found, int):  # the connection ended, or another begins with its handle
                self._end(found)
                continue
            if not found.data or found.psm not in (None, CONTROL, INTERRUPT):
                continue
            if found.handle not in self._remotes:
                if not self._is_remote(found):
                    continue
                self._remotes[found.handle] = _Remote(self._links.name(found.handle))
            for text in self._take(self._remotes[found.handle], found, packet.time_ns):
                yield packet, text

    def _end(self, handle: int) -> None:
        if handle in self._remotes:
            remote = self._remotes.pop(handle)
            self._done.append((remote, self._links.device_name_of(remote.name)))

    def _is_remote(self, payload: Payload) -> bool:
        name = self._links.device_name(payload.handle)
        if name is not None:
            return name.startswith(NAMES_BEGIN) and _layer(payload) is not None
        layer = _layer(payload)
        if layer is None or payload.cut or len(payload.data) < 2:
            return False
        layers = INPUT_LAYERS if layer is WiimoteInput else OUTPUT_LAYERS
        report = layers.get(payload.data[1])
        return report is not None and len(payload.data) == 1 + report.least_bytes

    def _take(self, remote: _Remote, payload: Payload, time_ns: int) -> Iterator[str]:
        transaction, data = payload.data[0], payload.data[1:]
        layer = _layer(payload)
        if layer is None and payload.psm is None:
            return  # of any channel
        self.packets += 1
        psm = payload.psm or (CONTROL if transaction == SET_OUTPUT else INTERRUPT)
        way = payload.direction if layer is None else DIRECTIONS[transaction]
        where = f"Wiimote {remote.name} {CHANNELS[psm]}{f' {way.value}' if way else ''}"
        if layer is None:
            yield f"{where} {_other_transaction(payload)}"
            return
        self.messages += 1
        report = layer(data)
        reason = CUT if payload.cut else None
        if reason is None and isinstance(report, BrokenReport):
            reason = report.reason
        if reason:
            self.count_malformed(reason, remote.malformed)
            yield f"{where} MALFORMED {reason}: {data.hex(' ')}"
            return
        remarks: Iterable[str] = ()
        if isinstance(report, UnknownReport):
            remote.unknown[f"0x{report.id:02x}"] += 1
        elif layer is WiimoteInput:
            remarks = remote.received(report, time_ns)
        else:
            remote.sent(report, time_ns)
        yield f"{where} " + " | ".join((describe(report, remote.extension), *remarks))

    def summary(self) -> Iterable[str]:
        for remote, device_name in self._done:
            yield from remote.summary(device_name)
        for handle, remote in self._remotes.items():
            yield from remote.summary(self._links.device_name(handle))


def _layer(payload: Payload) -> type[Packet] | None:
    """The kind of report behind the transaction byte, None where there is none."""
    if not payload.data:
        return None
    direction = DIRECTIONS.get(payload.data[0])
    if direction is None or payload.direction not in (None, direction):
        return None
    return LAYERS[direction]


def _other_transaction(payload: Payload) -> str:
    if len(payload.data) == 1 and payload.data[0] in HANDSHAKES:
        return f"handshake {HANDSHAKES[payload.data[0]]}"
    return f"HID transaction {payload.data.hex(' ')}"


def _is_identity(request: Packet) -> bool:
    register, device = request.address & 0xFF, request.address >> 16 & 0xFE
    return (
        request.space not in (EEPROM, NO_SPACE)
        and device == EXTENSION_PORT
        and register == IDENTITY
    )
