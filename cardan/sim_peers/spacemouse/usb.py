"""A simulated 3Dconnexion device as a USB device: its descriptors and its control requests.

No I/O. Source: USB 2.0, chapter 9; USB HID 1.11, chapter 7; the published descriptors of a
SpaceNavigator.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from cardan.protocols.connexion.descriptors import descriptor_for
from cardan.protocols.connexion.devices import Family, Model
from cardan.sim_peers.backends.usbip import (
    SetupPacket,
    Speed,
    UsbFunction,
    UsbIdentity,
    UsbInterface,
)

RECEIVER_INTERFACES = 5
"""A Universal Receiver has one per paired device."""
RECEIVER_SPEAKS = 0
"""The interface that a SpaceMouse Pro Wireless was seen on."""

_GET_STATUS, _CLEAR_FEATURE, _SET_FEATURE, _SET_ADDRESS = 0, 1, 3, 5
_GET_DESCRIPTOR, _GET_CONFIGURATION, _SET_CONFIGURATION = 6, 8, 9
_GET_INTERFACE, _SET_INTERFACE = 10, 11
_DEVICE, _CONFIGURATION, _STRING, _INTERFACE, _ENDPOINT = 1, 2, 3, 4, 5
_HID, _REPORT = 0x21, 0x22
_HID_GET_IDLE, _HID_SET_REPORT, _HID_SET_IDLE = 0x02, 0x09, 0x0A
_TO_HOST, _CLASS, _RECIPIENT = 0x80, 0x20, 0x1F
_TO_INTERFACE = 1
_OUTPUT_REPORT = 2
_RELEASE = 0x0431
_ENGLISH = 0x0409
_HID_CLASS = UsbInterface(0x03, 0, 0)
_BUS_POWERED = 0x80
_INTERVAL_MS = 8


class SpaceMouseUsb(UsbFunction):
    """The USB side of a device of `model`; output reports go to `on_output`, id first."""

    def __init__(self, model: Model, on_output: Callable[[bytes], None]) -> None:
        split = model.family is Family.SPLIT
        interfaces = RECEIVER_INTERFACES if model.receiver else 1
        self.identity = UsbIdentity(
            model.vendor_id,
            model.product_id,
            _RELEASE,
            Speed.LOW if split and interfaces == 1 else Speed.FULL,
            (_HID_CLASS,) * interfaces,
        )
        self.endpoint = 1 + (RECEIVER_SPEAKS if model.receiver else 0)
        """Number of the interrupt endpoint that carries the reports."""
        self.packet_bytes = 8 if split else 32
        self._on_output = on_output
        self._configuration = 0
        self._idle = [0] * interfaces
        self._report_descriptor = descriptor_for(model)
        self._strings = ("", "3Dconnexion", model.name)

    def control(self, setup: SetupPacket, data: bytes) -> bytes | None:
        """Execute a standard or HID request; None for any other."""
        if setup.request_type & 0x60 == _CLASS:
            return self._class_request(setup, data)
        if setup.request_type & 0x60:
            return None
        if setup.request == _GET_DESCRIPTOR:
            return self._descriptor(setup)
        if setup.request == _GET_CONFIGURATION:
            return bytes((self._configuration,))
        if setup.request == _SET_CONFIGURATION:
            if setup.value > 1:
                return None
            self._configuration = setup.value
            return b""
        if setup.request == _GET_STATUS:
            return b"\0\0"
        if setup.request == _GET_INTERFACE:
            return b"\0"
        if setup.request == _SET_INTERFACE:
            return None if setup.value else b""
        if setup.request in (_CLEAR_FEATURE, _SET_FEATURE, _SET_ADDRESS):
            return b""
        return None

    def _class_request(self, setup: SetupPacket, data: bytes) -> bytes | None:
        interface = setup.target & 0xFF
        if setup.request_type & _RECIPIENT != _TO_INTERFACE or interface >= len(self._idle):
            return None
        if setup.request == _HID_SET_IDLE:
            self._idle[interface] = setup.value >> 8
            return b""
        if setup.request == _HID_GET_IDLE:
            return bytes((self._idle[interface],))
        if setup.request == _HID_SET_REPORT and setup.value >> 8 == _OUTPUT_REPORT:
            self._on_output(data)
            return b""
        return None

    def _descriptor(self, setup: SetupPacket) -> bytes | None:
        kind, index = setup.value >> 8, setup.value & 0xFF
        if setup.request_type & _RECIPIENT == _TO_INTERFACE:
            if kind == _REPORT and setup.target < len(self._idle):
                return self._report_descriptor
            return self._hid() if kind == _HID else None
        if kind == _DEVICE:
            identity = self.identity
            return struct.pack(
                "<BBHBBBBHHHBBBB", 18, _DEVICE, 0x0110, 0, 0, 0,
                8 if identity.speed is Speed.LOW else 64,
                identity.vendor_id, identity.product_id, identity.release, 1, 2, 0, 1,
            )  # fmt: skip
        if kind == _CONFIGURATION and index == 0:
            return self._configuration_descriptor()
        if kind == _STRING:
            if index == 0:
                return struct.pack("<BBH", 4, _STRING, _ENGLISH)
            if index < len(self._strings):
                text = self._strings[index].encode("utf-16-le")
                return bytes((2 + len(text), _STRING)) + text
        return None

    def _configuration_descriptor(self) -> bytes:
        parts = []
        for number, interface in enumerate(self.identity.interfaces):
            parts.append(bytes((9, _INTERFACE, number, 0, 1, *interface, 0)))
            parts.append(self._hid())
            parts.append(
                struct.pack(
                    "<BBBBHB", 7, _ENDPOINT, 0x81 + number, 3, self.packet_bytes, _INTERVAL_MS
                )
            )
        body = b"".join(parts)
        count = len(self.identity.interfaces)
        head = struct.pack(
            "<BBHBBBBB", 9, _CONFIGURATION, 9 + len(body), count, 1, 0, _BUS_POWERED, 50
        )
        return head + body

    def _hid(self) -> bytes:
        return struct.pack("<BBHBBBH", 9, _HID, 0x0111, 0, 1, _REPORT, len(self._report_descriptor))
