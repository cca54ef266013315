"""Wii Remotes in captures, for ``cardan dissect``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from cardan_dissect.capture import CapturedPacket, Direction
from cardan_dissect.dissectors.devices import hid_report
from cardan_dissect.network import Segment
from cardan_dissect.reader import Dissector, Found, Message, Note
from cardan_wiimote import bluetooth, protocol
from cardan_wiimote.bluetooth import Links, Payload

CONTROL, INTERRUPT = 0x11, 0x13
CHANNELS = {CONTROL: "control", INTERRUPT: "interrupt"}
INPUT, OUTPUT, SET_OUTPUT = 0xA1, 0xA2, 0x52
WAYS = {
    INPUT: Direction.FROM_DEVICE,
    OUTPUT: Direction.TO_DEVICE,
    SET_OUTPUT: Direction.TO_DEVICE,
}
NAMES_BEGIN = "Nintendo RVL-"


class Wiimote(Dissector):
    """Nintendo's Wii Remotes on classic Bluetooth, from a capture of the adapter.

    A report travels behind one byte, the HID transaction: a1 from the remote and a2 to it on the
    interrupt channel (PSM 0x13), 52 to it on the control channel (PSM 0x11). The set-up of the
    connection assigns PSMs to channels; without it the byte identifies them. A remote is recognized
    by the name of the device, or by the first report with the id and length of a remote's.
    """

    name = "Wiimote"
    page = "../plugins/cardan-wiimote/README.md"
    link_types = bluetooth.LINK_TYPES

    def __init__(self, numbers: Mapping[str, frozenset[int]]) -> None:
        super().__init__(numbers)
        self._links = Links()
        self._remotes: dict[int, str] = {}
        self._device_names: dict[str, str] = {}

    def feed(self, packet: CapturedPacket, network: Segment | str) -> Found:
        for found in self._links.feed(packet):
            if isinstance(found, int):  # The connection ended, or another begins with its handle.
                self._remotes.pop(found, None)
                continue
            if not found.data or found.psm not in (None, CONTROL, INTERRUPT):
                continue
            if found.handle not in self._remotes:
                if not self._is_remote(found):
                    continue
                self._remotes[found.handle] = self._links.name(found.handle)
            yield from self._take(self._remotes[found.handle], found, packet)

    def _is_remote(self, payload: Payload) -> bool:
        way, data = _way(payload), payload.data
        name = self._links.device_name(payload.handle)
        if name is not None or way is None:
            return name is not None and name.startswith(NAMES_BEGIN) and way is not None
        from_remote = way is Direction.FROM_DEVICE
        sizes = protocol.INPUT_SIZES if from_remote else protocol.OUTPUT_SIZES
        return not payload.cut and len(data) > 1 and len(data) - 2 == sizes.get(data[1])

    def _take(self, remote: str, payload: Payload, packet: CapturedPacket) -> Iterator[Any]:
        transaction, data = payload.data[0], payload.data[1:]
        way = _way(payload)
        if way is None and payload.psm is None:
            return  # Of any channel.
        self.packets += 1
        psm = payload.psm or (CONTROL if transaction == SET_OUTPUT else INTERRUPT)
        shown = way or payload.direction
        where = f"Wiimote {remote} {CHANNELS[psm]}{f' {shown.value}' if shown else ''}"
        if name := self._links.device_name(payload.handle):
            self._device_names[where] = name
        if way is None:
            yield Note(packet, where, f"HID transaction {payload.data.hex(' ')}")
            return
        decode = protocol.decode_input if way is Direction.FROM_DEVICE else protocol.decode_output
        yield Message(packet, where, hid_report(decode(data), data, payload.cut), data)

    def about(self, where: str) -> str:
        return self._device_names.get(where, "")


def _way(payload: Payload) -> Direction | None:
    """Return the direction of the report behind the transaction byte; None: no report."""
    way = WAYS.get(payload.data[0])
    return None if payload.direction not in (None, way) else way
