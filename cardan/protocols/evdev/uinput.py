"""uinput: input devices emulated by a program. Source: linux/uinput.h."""

from __future__ import annotations

import struct
from typing import NamedTuple

from cardan.protocols.evdev.requests import (
    EFFECT_BYTES,
    AbsInfo,
    InputId,
    Rumble,
    decode_rumble,
    encode_absinfo,
    encode_id,
    ioc,
)

_NAME_BYTES = 80
_UPLOAD_HEAD = struct.Struct("@Ii")
_UPLOAD_AT = struct.calcsize("@Ii0P")
_UPLOAD_BYTES = _UPLOAD_AT + 2 * EFFECT_BYTES
_ERASE = struct.Struct("@IiI")
_SETUP_BYTES = 8 + _NAME_BYTES + 4
_ABS_SETUP_BYTES = 4 + 24

UI_DEV_CREATE = ioc(0, "U", 1, 0)
UI_DEV_DESTROY = ioc(0, "U", 2, 0)
UI_DEV_SETUP = ioc(1, "U", 3, _SETUP_BYTES)
UI_ABS_SETUP = ioc(1, "U", 4, _ABS_SETUP_BYTES)
SYSNAME_BYTES = 64
UI_GET_SYSNAME = ioc(2, "U", 44, SYSNAME_BYTES)
"""Request for the device's name under /sys/devices/virtual/input ("input7")."""
UI_SET_EVBIT, UI_SET_KEYBIT, UI_SET_ABSBIT, UI_SET_MSCBIT, UI_SET_FFBIT = (
    ioc(1, "U", number, 4) for number in (100, 101, 103, 104, 107)
)
UI_BEGIN_FF_UPLOAD = ioc(3, "U", 200, _UPLOAD_BYTES)
UI_END_FF_UPLOAD = ioc(1, "U", 201, _UPLOAD_BYTES)
UI_BEGIN_FF_ERASE = ioc(3, "U", 202, _ERASE.size)
UI_END_FF_ERASE = ioc(1, "U", 203, _ERASE.size)

UI_FF_UPLOAD, UI_FF_ERASE = 1, 2
"""Codes of EV_UINPUT events, whose value is the number of the kernel's request."""


class EffectUpload(NamedTuple):
    """Upload of an effect by a client, forwarded by the kernel."""

    request_id: int
    effect: Rumble | None
    """Rumble effect; None: another kind of effect."""


def encode_setup(device_id: InputId, name: str, effects: int) -> bytes:
    """Encode the argument of UI_DEV_SETUP; `effects` is the most that the device can hold."""
    text = name.encode()[: _NAME_BYTES - 1].ljust(_NAME_BYTES, b"\0")
    return encode_id(device_id) + text + struct.pack("@I", effects)


def encode_abs_setup(code: int, info: AbsInfo) -> bytes:
    """Encode the argument of UI_ABS_SETUP."""
    return struct.pack("@Hxx", code) + encode_absinfo(info)


def begin_upload(request_id: int) -> bytes:
    """Encode the argument of UI_BEGIN_FF_UPLOAD."""
    return _UPLOAD_HEAD.pack(request_id, 0).ljust(_UPLOAD_BYTES, b"\0")


def decode_upload(argument: bytes) -> EffectUpload:
    """Decode the effect that the kernel filled in."""
    effect = decode_rumble(argument[_UPLOAD_AT : _UPLOAD_AT + EFFECT_BYTES])
    return EffectUpload(
        _UPLOAD_HEAD.unpack_from(argument)[0], effect if isinstance(effect, Rumble) else None
    )


def end_upload(argument: bytes, result: int) -> bytes:
    """Encode the argument of UI_END_FF_UPLOAD: `argument` with the `result` of the upload."""
    request_id, _ = _UPLOAD_HEAD.unpack_from(argument)
    return _UPLOAD_HEAD.pack(request_id, result) + argument[_UPLOAD_HEAD.size :]


def encode_erase(request_id: int, result: int = 0, effect_id: int = 0) -> bytes:
    """Encode the argument of UI_BEGIN_FF_ERASE and UI_END_FF_ERASE."""
    return _ERASE.pack(request_id, result, effect_id)


def decode_erase(argument: bytes) -> int:
    """Decode the id of the effect to erase."""
    return int(_ERASE.unpack_from(argument)[2])
