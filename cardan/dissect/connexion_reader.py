"""3Dconnexion reports in a usbmon capture: a line per report, and figures per endpoint.

A device is known by the device descriptor in the capture (libpcap asks for the descriptors of
the devices on the bus when it starts). Without one it is taken for a 3Dconnexion device once it
has sent a pair of reports 1 and 2 of 7 bytes or a report 1 of 13 bytes with possible counts.
"""

from __future__ import annotations

import struct
from collections import Counter, deque
from collections.abc import Iterable, Iterator

from cardan.dissect import usbmon
from cardan.dissect._scapy import Packet
from cardan.dissect.capture import CapturedPacket, Direction
from cardan.dissect.connexion import (
    ONE_BYTES,
    SPLIT_BYTES,
    BrokenReport,
    ConnexionFeature,
    ConnexionInput,
    ConnexionOutput,
    MotionReport,
    RotationReport,
    TranslationReport,
    UnknownReport,
)
from cardan.dissect.connexion_text import describe
from cardan.dissect.network import Segment
from cardan.dissect.reader import CUT, PacketLine, ProtocolReader
from cardan.dissect.statistics import Intervals, tallies, tally
from cardan.dissect.usbmon import Urb

VENDOR_3DCONNEXION, VENDOR_LOGITECH = 0x256F, 0x046D
LOGITECH_ERA = {
    0xC603: "SpaceMouse Plus XT",
    0xC605: "CADman",
    0xC606: "SpaceMouse Classic",
    0xC621: "Spaceball 5000",
    0xC623: "SpaceTraveler",
    0xC625: "SpacePilot",
    0xC626: "SpaceNavigator",
    0xC627: "SpaceExplorer",
    0xC628: "SpaceNavigator for Notebooks",
    0xC629: "SpacePilot Pro",
    0xC62B: "SpaceMouse Pro",
}
THREEDCONNEXION = {
    0xC62E: "SpaceMouse Wireless (cable)",
    0xC62F: "SpaceMouse Wireless receiver",
    0xC631: "SpaceMouse Pro Wireless (cable)",
    0xC632: "SpaceMouse Pro Wireless receiver",
    0xC633: "SpaceMouse Enterprise",
    0xC635: "SpaceMouse Compact",
    0xC636: "SpaceMouse Module",
    0xC638: "SpaceMouse Pro Wireless Bluetooth Edition",
    0xC63A: "SpaceMouse Wireless Bluetooth Edition",
    0xC652: "Universal Receiver",
    0xC65A: "Universal Receiver 2",
    0xC65C: "Universal Receiver 2",
}
NOT_6DOF = {*range(0xC650, 0xC652), *range(0xC654, 0xC659), 0xC664, 0xC665, 0xC668, 0xC671}
"""CadMouse, keyboards and numeric pads of the same vendor."""

MOST_COUNTS = 512
"""Largest deflection known of any device; nominal full scale is 350."""
HELD_PACKETS = 8
"""Packets held of a device that is not identified yet."""
SILENCE_NS = 100_000_000
"""Six periods of the slower family: a deflected device would have sent by then."""
MOTION = (TranslationReport, RotationReport, MotionReport)
GET_DEVICE_DESCRIPTOR = b"\x80\x06\x00\x01"
SET_REPORT = b"\x21\x09"
OUTPUT_TYPE, FEATURE_TYPE = 2, 3


class _Endpoint:
    """The reports of one endpoint of one device."""

    def __init__(self) -> None:
        self.reports: Counter[str] = Counter()
        self.malformed: Counter[str] = Counter()
        self.unknown: Counter[str] = Counter()
        self.failed: Counter[str] = Counter()
        self.silences = 0
        self._intervals: dict[type[Packet], Intervals] = {}
        self._deflected: dict[type[Packet], bool] = {}

    def add(self, report: Packet, time_ns: int) -> None:
        if isinstance(report, BrokenReport):
            self.malformed[report.reason] += 1
        elif isinstance(report, UnknownReport):
            self.unknown[f"0x{report.id:02x}"] += 1
        else:
            kind = type(report)
            self.reports[kind.__name__] += 1
            if kind in MOTION:
                self._motion(kind, any(_axes(report)), time_ns)

    def _motion(self, kind: type[Packet], deflected: bool, time_ns: int) -> None:
        intervals = self._intervals.setdefault(kind, Intervals())
        if not self._deflected.get(kind):
            intervals.pause()  # a device at rest is silent
        interval = intervals.add(time_ns)
        self.silences += interval is not None and interval > SILENCE_NS
        self._deflected[kind] = deflected

    def summary(self) -> Iterator[str]:
        yield f"    {tally(self.reports) or 'no reports'}"
        for kind, intervals in self._intervals.items():
            yield f"    {kind.__name__} while deflected: {intervals}"
        if self.silences:
            limit = SILENCE_NS // 10**6
            yield f"    silent for more than {limit} ms while deflected: {self.silences}"
        yield from tallies(
            "    ",
            ("malformed", self.malformed),
            ("unknown report ids", self.unknown),
            ("failed transfers", self.failed),
        )


class _Device:
    """One address on one bus."""

    def __init__(self) -> None:
        self.ids: tuple[int, int] | None = None
        self.ours: bool | None = None  # None: not known yet
        self.held: deque[tuple[CapturedPacket, Urb]] = deque(maxlen=HELD_PACKETS)
        self.endpoints: dict[str, _Endpoint] = {}

    def identify(self, vendor: int, product: int) -> None:
        self.ids = vendor, product
        if vendor == VENDOR_3DCONNEXION:
            self.ours = product not in NOT_6DOF
        else:
            self.ours = vendor == VENDOR_LOGITECH and product in LOGITECH_ERA
        self.held.clear()

    @property
    def name(self) -> str:
        if self.ids is None:
            return "by the look of its reports (no device descriptor in the capture)"
        vendor, product = self.ids
        names = LOGITECH_ERA if vendor == VENDOR_LOGITECH else THREEDCONNEXION
        return f"{vendor:04x}:{product:04x} {names.get(product, 'unknown 3Dconnexion device')}"


class ConnexionReader(ProtocolReader):
    """Reports of 6-DoF devices on USB."""

    def __init__(self) -> None:
        super().__init__()
        self._devices: dict[tuple[int, int], _Device] = {}
        self._asked: dict[int, None] = {}  # ids of URBs that asked for a device descriptor

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Iterable[PacketLine]:
        urb = usbmon.parse(packet)
        if urb is None:
            return
        device = self._devices.setdefault((urb.bus, urb.device), _Device())
        self._descriptor(device, urb)
        if device.ours is None:
            yield from self._recognise(device, packet, urb)
        elif device.ours:
            yield from self._take(device, packet, urb)

    def _descriptor(self, device: _Device, urb: Urb) -> None:
        if urb.event == "S" and urb.setup and urb.setup.startswith(GET_DEVICE_DESCRIPTOR):
            self._asked[urb.id] = None
        elif urb.event == "C" and urb.id in self._asked:
            del self._asked[urb.id]
            if len(urb.data) >= 12 and urb.data[1] == 1:
                device.identify(*struct.unpack_from("<HH", urb.data, 8))

    def _recognise(self, device: _Device, packet: CapturedPacket, urb: Urb) -> Iterator[PacketLine]:
        if not (_is_input(urb) and urb.data):
            return
        device.held.append((packet, urb))
        if _looks_right([held.data for _, held in device.held if held.endpoint == urb.endpoint]):
            device.ours = True
            for earlier in device.held:
                yield from self._take(device, *earlier)
            device.held.clear()

    def _take(self, device: _Device, packet: CapturedPacket, urb: Urb) -> Iterator[PacketLine]:
        self.packets += 1
        end = f"endpoint {urb.endpoint} {urb.direction.value}"
        where = f"USB {urb.bus}.{urb.device} {end}"
        endpoint = device.endpoints.setdefault(end, _Endpoint())
        if urb.transfer == usbmon.INTERRUPT and urb.event != "S" and urb.status:
            endpoint.failed[f"status {urb.status}"] += 1
            yield packet, f"{where} transfer failed, status {urb.status}"
            return
        layer = _layer(urb)
        if layer is None or not (urb.data or urb.cut):
            return
        self.messages += 1
        if urb.cut:
            self.count_malformed(CUT, endpoint.malformed)
            yield packet, f"{where} MALFORMED {CUT}: {urb.data.hex(' ')}"
            return
        report = layer(urb.data)
        endpoint.add(report, packet.time_ns)
        if isinstance(report, BrokenReport):
            self.count_malformed(report.reason)
        yield packet, f"{where} {describe(report)}"

    def summary(self) -> Iterable[str]:
        for (bus, address), device in self._devices.items():
            if device.endpoints:
                yield f"3Dconnexion device USB {bus}.{address} {device.name}"
                for name, endpoint in device.endpoints.items():
                    yield f"  {name}"
                    yield from endpoint.summary()


def _is_input(urb: Urb) -> bool:
    completed_in = (urb.event, urb.direction) == ("C", Direction.FROM_DEVICE)
    return completed_in and urb.transfer == usbmon.INTERRUPT


def _layer(urb: Urb) -> type[Packet] | None:
    """The kind of report in a request block, None where there is none."""
    if _is_input(urb):
        return ConnexionInput
    submitted_out = (urb.event, urb.direction) == ("S", Direction.TO_DEVICE)
    if submitted_out and urb.transfer == usbmon.INTERRUPT:
        return ConnexionOutput
    if urb.event == "S" and urb.setup and urb.setup.startswith(SET_REPORT):
        return {OUTPUT_TYPE: ConnexionOutput, FEATURE_TYPE: ConnexionFeature}.get(urb.setup[3])
    return None


def _axes(report: Packet) -> list[int]:
    return [report.getfieldval(f.name) for f in report.fields_desc[1:]]


def _looks_right(reports: list[bytes]) -> bool:
    """Whether an endpoint's reports can only be motion of a 6-DoF device."""
    kinds = set()
    for data in reports:
        report = ConnexionInput(data)
        if not isinstance(report, MOTION):
            continue
        if len(data) not in (SPLIT_BYTES, ONE_BYTES) or max(map(abs, _axes(report))) > MOST_COUNTS:
            return False
        kinds.add(type(report))
    return MotionReport in kinds or kinds == {TranslationReport, RotationReport}
