"""ioctl requests of an evdev node: numbers, computed as in the kernel, and arguments.

Numbers are those of the generic _IOC (x86, ARM, RISC-V); MIPS, PowerPC and SPARC have another.
Source: linux/input.h, linux/uinput.h and asm-generic/ioctl.h.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

from cardan.protocols.evdev.codes import ABS_COUNT, FF_COUNT, FF_RUMBLE, KEY_COUNT
from cardan.protocols.evdev.events import EVENT_BYTES, NO_CALL, MalformedPacket

_NONE, _WRITE, _READ = 0, 1, 2

_INT = struct.Struct("@i")
_ID = struct.Struct("@4H")
_ABSINFO = struct.Struct("@6i")
_EFFECT_HEAD = struct.Struct("@HhH2H2H")
_RUMBLE = struct.Struct("@2H")
# The union of effects is aligned for a pointer (ff_periodic_effect has one).
_UNION_AT = struct.calcsize("@HhH2H2H0P")
EFFECT_BYTES = _UNION_AT + struct.calcsize("@2H2hH4HIP")


def ioc(direction: int, kind: str, number: int, size: int) -> int:
    """Return the number of a request whose argument has `size` bytes."""
    return direction << 30 | size << 16 | ord(kind) << 8 | number


def argument_bytes(request: int) -> int:
    """Return the length of the argument of `request`, bytes."""
    return request >> 16 & 0x3FFF


NAME_BYTES = 128
EVIOCGID = ioc(_READ, "E", 0x02, _ID.size)
EVIOCGNAME = ioc(_READ, "E", 0x06, NAME_BYTES)
EVIOCGKEY = ioc(_READ, "E", 0x18, KEY_COUNT // 8)
"""Read the pressed keys, one bit each."""
EVIOCSFF = ioc(_WRITE, "E", 0x80, EFFECT_BYTES)
"""Upload an effect, and get its id. Replaces an existing effect (id not -1)."""
EVIOCRMFF = ioc(_WRITE, "E", 0x81, _INT.size)
EVIOCGEFFECTS = ioc(_READ, "E", 0x84, _INT.size)
EVIOCGRAB = ioc(_WRITE, "E", 0x90, _INT.size)
"""Grab: 1: only this program gets the events; 0: all programs do."""

BY_VALUE = frozenset({EVIOCRMFF, EVIOCGRAB})
"""Requests whose argument is the number itself, not a pointer to it."""

BITS_BYTES = {0x00: 4, 0x01: KEY_COUNT // 8, 0x03: ABS_COUNT // 8, 0x15: FF_COUNT // 8}
"""Bytes of the bit mask of each queried event type; type 0: of the types themselves."""


def eviocgbit(event_type: int) -> int:
    """Return the request for the device's codes of `event_type`."""
    return ioc(_READ, "E", 0x20 + event_type, BITS_BYTES[event_type])


def eviocgabs(code: int) -> int:
    """Return the request for range and value of an absolute axis."""
    return ioc(_READ, "E", 0x40 + code, _ABSINFO.size)


class InputId(NamedTuple):
    """Bus, vendor, product and version of a device."""

    bustype: int
    vendor: int
    product: int
    version: int


BUS_USB, BUS_BLUETOOTH, BUS_VIRTUAL = 0x03, 0x05, 0x06


class AbsInfo(NamedTuple):
    """An absolute axis: its value, range, noise, dead zone and units per mm or rad."""

    value: int
    minimum: int
    maximum: int
    fuzz: int
    flat: int
    resolution: int


class Rumble(NamedTuple):
    """A rumble effect. `id` -1: a new one."""

    id: int
    strong: int
    """Strength of the heavy motor, 0..65535."""
    weak: int
    """Strength of the light motor, 0..65535."""
    length_ms: int
    """Duration, ms; 0: unlimited."""


def encode_int(value: int) -> bytes:
    """Encode an int argument."""
    return _INT.pack(value)


def decode_int(data: bytes) -> int:
    """Decode an int argument; 0 for anything too short."""
    return int(_INT.unpack_from(data)[0]) if len(data) >= _INT.size else 0


def encode_id(value: InputId) -> bytes:
    """Encode the answer to EVIOCGID."""
    return _ID.pack(*value)


def decode_id(data: bytes) -> InputId:
    """Decode the answer to EVIOCGID; zeros for anything too short."""
    return InputId(*(_ID.unpack_from(data) if len(data) >= _ID.size else (0, 0, 0, 0)))


def encode_absinfo(value: AbsInfo) -> bytes:
    """Encode the answer to EVIOCGABS."""
    return _ABSINFO.pack(*value)


def decode_absinfo(data: bytes) -> AbsInfo:
    """Decode the answer to EVIOCGABS; zeros for anything too short."""
    return AbsInfo(*(_ABSINFO.unpack_from(data) if len(data) >= _ABSINFO.size else (0,) * 6))


def encode_bits(codes: Iterable[int], size: int) -> bytes:
    """Encode a bit mask of `size` bytes; codes beyond it are left out, as in the kernel."""
    return (sum(1 << code for code in {*codes} if code < 8 * size)).to_bytes(size, "little")


def decode_bits(data: bytes) -> frozenset[int]:
    """Decode a bit mask to the set codes."""
    mask = int.from_bytes(data, "little")
    return frozenset(code for code in range(mask.bit_length()) if mask >> code & 1)


def encode_rumble(effect: Rumble) -> bytes:
    """Encode a rumble as struct ff_effect. Raises ValueError for a value that does not fit."""
    try:
        head = _EFFECT_HEAD.pack(FF_RUMBLE, effect.id, 0, 0, 0, effect.length_ms, 0)
        body = _RUMBLE.pack(effect.strong, effect.weak)
    except struct.error as error:
        raise ValueError(f"cannot encode {effect}: {error}") from None
    return (head.ljust(_UNION_AT, b"\0") + body).ljust(EFFECT_BYTES, b"\0")


def decode_rumble(data: bytes) -> Rumble | MalformedPacket:
    """Decode the rumble in a struct ff_effect. Never raises."""
    if len(data) < EFFECT_BYTES:
        return MalformedPacket("an effect cut short", len(data))
    kind, effect_id, _, _, _, length_ms, _ = _EFFECT_HEAD.unpack_from(data)
    if kind != FF_RUMBLE:
        return MalformedPacket("an effect that is not a rumble", len(data))
    strong, weak = _RUMBLE.unpack_from(data, _UNION_AT)
    return Rumble(effect_id, strong, weak, length_ms)


# ---------------------------------------------------------------------------------------------
# Requests over a socket that stands for a node


class IoctlCall(NamedTuple):
    """A request, or its answer, in a packet of its own."""

    request: int
    result: int
    """Result: 0 or above: done; below: the negative error number. 0 in a request."""
    argument: bytes


_CALL = struct.Struct("@Ii")


def encode_call(call: IoctlCall) -> bytes:
    """Encode `call` as a packet whose length, unlike that of events, is no multiple of an
    event's."""
    packet = _CALL.pack(call.request, call.result) + call.argument
    return packet + b"\0\0\0\0" if len(packet) % EVENT_BYTES == 0 else packet


def decode_call(packet: bytes) -> IoctlCall | MalformedPacket:
    """Decode the call in a packet that does not consist of whole events. Never raises."""
    if len(packet) < _CALL.size or len(packet) % EVENT_BYTES == 0:
        return MalformedPacket(NO_CALL, len(packet))
    request, result = _CALL.unpack_from(packet)
    end = _CALL.size + argument_bytes(request)
    if len(packet) not in (end, end + 4):
        return MalformedPacket(NO_CALL, len(packet))
    return IoctlCall(request, result, packet[_CALL.size : end])
