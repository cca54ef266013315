"""Devices on USB."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Mapping
from typing import Any

from cardan.protocols.connexion import devices, reports as connexion_reports
from cardan.protocols.connexion.devices import MULTI_AXIS_CONTROLLER
from cardan.protocols.hid import EMPTY, TOO_SHORT, MalformedReport
from cardan_dissect import usbmon
from cardan_dissect.capture import CapturedPacket, Direction
from cardan_dissect.network import Segment
from cardan_dissect.reader import CUT, Decoded, Dissector, Found, Message, Note
from cardan_dissect.usbmon import Urb

MOST_COUNTS = 512
"""Largest known deflection of any device; nominal full scale is 350."""
HELD_REPORTS = 8
"""Most packets held back of a device that is not identified yet."""
MOST_ASKED = 1024
"""Most remembered requests for device descriptors."""
GET_DEVICE_DESCRIPTOR, SET_OUTPUT_REPORT = b"\x80\x06\x00\x01", b"\x21\x09"
OUTPUT_TYPE = 2
MOTION = (connexion_reports.Translation, connexion_reports.Rotation, connexion_reports.MotionReport)


def hid_report(value: Any, report: bytes, cut: bool) -> Decoded:
    """Return a HID report that a codec decoded. Reports unknown to the codec are shown in hex."""
    if cut:
        return Decoded(None, "report", CUT)
    if not isinstance(value, MalformedReport):
        return Decoded(value)
    if value.reason in (EMPTY, TOO_SHORT):
        size = f"0x{report[0]:02x} {value.reason}: {len(report)} bytes" if report else EMPTY
        return Decoded(None, "report", size)
    return Decoded({"data": report[1:]}, f"report 0x{value.report_id:02x} {value.reason}")


class _UsbDevice:
    """Device at its address on a bus."""

    def __init__(self) -> None:
        self.name = "by the look of its reports (no device descriptor in the capture)"
        self.ours: bool | None = None  # None: not known yet.
        self.held: deque[tuple[CapturedPacket, Urb]] = deque(maxlen=HELD_REPORTS)

    def identify(self, vendor: int, product: int) -> None:
        model = devices.find_model(vendor, product)
        name = model.name if model else "unknown 3Dconnexion device"
        self.name = f"{vendor:04x}:{product:04x} {name}"
        self.ours = devices.is_candidate(vendor, product, *MULTI_AXIS_CONTROLLER)
        self.held.clear()


class Connexion(Dissector):
    """3Dconnexion's reports on USB, from usbmon.

    A device is identified by the device descriptor in the capture (libpcap requests those of the
    bus at its start); without one, by a pair of reports 1 and 2 or a report 1 of all axes with
    possible counts.
    """

    name = "3Dconnexion"
    page = "spacemouse.md"
    link_types = usbmon.LINK_TYPES
    always = True

    def __init__(self, numbers: Mapping[str, frozenset[int]]) -> None:
        super().__init__(numbers)
        self._devices: dict[str, _UsbDevice] = {}
        self._asked: deque[int] = deque(maxlen=MOST_ASKED)

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Found:
        urb = usbmon.parse(packet)
        if urb is None:
            return
        address = f"USB {urb.bus}.{urb.device}"
        device = self._devices.setdefault(address, _UsbDevice())
        if urb.event == "S" and urb.setup and urb.setup.startswith(GET_DEVICE_DESCRIPTOR):
            self._asked.append(urb.id)
        elif urb.event == "C" and urb.id in self._asked:
            self._asked.remove(urb.id)
            if len(urb.data) >= 12 and urb.data[1] == 1:
                device.identify(*struct.unpack_from("<HH", urb.data, 8))
        if device.ours is None and _is_input(urb) and urb.data:
            device.held.append((packet, urb))
            same = [each.data for _, each in device.held if each.endpoint == urb.endpoint]
            device.ours = _looks_right(same) or None
            if device.ours:
                for held in device.held:
                    yield from self._take(address, *held)
        elif device.ours:
            yield from self._take(address, packet, urb)

    def _take(self, address: str, packet: CapturedPacket, urb: Urb) -> Found:
        self.packets += 1
        where = f"{address} endpoint {urb.endpoint} {urb.direction.value}"
        if urb.transfer == usbmon.INTERRUPT and urb.event != "S" and urb.status:
            yield Note(packet, where, f"transfer failed, status {urb.status}")
        elif urb.data or urb.cut:
            control = bool(urb.setup and urb.setup.startswith(SET_OUTPUT_REPORT))
            if _is_input(urb):
                value = connexion_reports.decode_input(urb.data)
                yield Message(packet, where, hid_report(value, urb.data, urb.cut), urb.data)
            elif urb.event == "S" and (control or _is_interrupt(urb, Direction.TO_DEVICE)):
                decoded = hid_report(connexion_reports.decode_output(urb.data), urb.data, urb.cut)
                if control and urb.setup and urb.setup[3] != OUTPUT_TYPE and not decoded.fault:
                    decoded = Decoded({"data": urb.data}, "feature report")
                yield Message(packet, where, decoded, urb.data)

    def about(self, where: str) -> str:
        return self._devices[where.partition(" endpoint")[0]].name


def _is_interrupt(urb: Urb, direction: Direction) -> bool:
    return urb.transfer == usbmon.INTERRUPT and urb.direction is direction


def _is_input(urb: Urb) -> bool:
    return urb.event == "C" and _is_interrupt(urb, Direction.FROM_DEVICE)


def _looks_right(reports: list[bytes]) -> bool:
    """Return True if an endpoint's reports can only be motion of a six-axis device."""
    kinds = set()
    for data in reports:
        report = connexion_reports.decode_input(data)
        if not isinstance(report, MOTION):
            continue
        lengths = (connexion_reports.HALF_BYTES, connexion_reports.MOTION_BYTES)
        if len(data) not in lengths or max(map(abs, report)) > MOST_COUNTS:
            return False
        kinds.add(type(report))
    return connexion_reports.MotionReport in kinds or kinds == {
        connexion_reports.Translation,
        connexion_reports.Rotation,
    }
