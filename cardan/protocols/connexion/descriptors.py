"""HID report descriptors of 3Dconnexion's six-axis devices.

The vendor-defined, unused feature reports are left out. Source: the published descriptors of a
SpaceNavigator and a SpaceMouse Wireless; USB HID 1.11, section 6.2.2.
"""

from __future__ import annotations

from cardan.protocols.connexion.devices import Family, Model
from cardan.protocols.connexion.reports import (
    BATTERY_ID,
    BUTTONS_ID,
    KEY_SLOTS,
    KEYS_DOWN_ID,
    LED_ID,
    LONG_PRESS_ID,
    ROTATION_ID,
    TRANSLATION_ID,
)

_MULTI_AXIS = bytes.fromhex("0501 0908 a101")
_END = b"\xc0"
_AXES = b"".join(bytes((0x09, usage)) for usage in range(0x30, 0x36))
_PHYSICAL = bytes.fromhex("3688fa 467805 550c 6511")  # -1400..1400, cm, exponent -4
_RELATIVE, _ABSOLUTE = b"\x81\x06", b"\x81\x02"
_LED = bytes((0xA1, 0x02, 0x85, LED_ID)) + bytes.fromhex(
    "0508 094b 1500 2501 9501 7501 9102 9501 7507 9103 c0"
)
_BATTERY = bytes((0xA1, 0x02, 0x85, BATTERY_ID)) + bytes.fromhex(
    "1500 2564 5500 6500 050609207508 950181021500 2501 0600ff 0927 7501 9501 8102 7507 8103 c0"
)


def descriptor_for(model: Model) -> bytes:
    """Return the report descriptor of a device of `model`."""
    parts = [_MULTI_AXIS]
    span = model.full_scale
    limits = (
        b"\x16" + (-span).to_bytes(2, "little", signed=True)
        + b"\x26" + span.to_bytes(2, "little", signed=True)
    )  # fmt: skip
    if model.family is Family.SPLIT:
        # Absolute deflections, although these devices declare them as relative.
        size = bytes.fromhex("7510 9503") + _RELATIVE
        parts += [
            bytes((0xA1, 0x00, 0x85, TRANSLATION_ID)), limits, _PHYSICAL, _AXES[:6], size, _END,
            bytes((0xA1, 0x00, 0x85, ROTATION_ID)), _AXES[6:], size, _END,
        ]  # fmt: skip
    else:
        size = bytes.fromhex("7510 9506") + _ABSOLUTE
        parts += [
            bytes((0xA1, 0x00, 0x85, TRANSLATION_ID)), limits, _PHYSICAL, _AXES, size, _END,
        ]  # fmt: skip
    if model.buttons and model.button_report_bytes:
        parts.append(_buttons(model))
    if model.key_array:
        parts += [_key_array(KEYS_DOWN_ID), _key_array(LONG_PRESS_ID)]
    if model.led:
        parts.append(_LED)
    if model.battery:
        parts.append(_BATTERY)
    return b"".join((*parts, _END))


def full_scale_of(descriptor: bytes) -> int | None:
    """Return the counts at full deflection that `descriptor` declares for the X axis; None if it
    does not.

    Never raises, whatever the bytes.
    """
    logical_max = 0
    usage_page = 0
    saw_x = False
    position = 0
    while position < len(descriptor):
        prefix = descriptor[position]
        if prefix == 0xFE:  # long item: size, tag, data
            position += 3 + (descriptor[position + 1] if position + 1 < len(descriptor) else 0)
            continue
        size = (0, 1, 2, 4)[prefix & 3]
        data = descriptor[position + 1 : position + 1 + size]
        if len(data) < size:
            return None
        position += 1 + size
        tag = prefix & 0xFC
        if tag == 0x04:
            usage_page = int.from_bytes(data, "little")
        elif tag == 0x24:
            logical_max = int.from_bytes(data, "little", signed=True)
        elif tag == 0x08:
            usage = int.from_bytes(data, "little")
            saw_x |= (usage_page, usage) == (0x01, 0x30) or usage == 0x0001_0030
        elif tag == 0x80:
            if saw_x:
                return logical_max if logical_max > 0 else None
        elif tag == 0xA0:
            saw_x = False
    return None


def _buttons(model: Model) -> bytes:
    """Make report 3: runs of buttons, with constant bits between them."""
    parts = [bytes((0xA1, 0x02, 0x85, BUTTONS_ID)), bytes.fromhex("0509 1500 2501 3500 4501 7501")]
    total = 8 * (model.button_report_bytes - 1)
    bit = 0
    while bit < total:
        first = bit
        is_button = bit in model.buttons
        while bit < total and (bit in model.buttons) == is_button:
            bit += 1
        count = bytes((0x95, bit - first))
        if is_button:
            parts.append(bytes((0x19, first + 1, 0x29, bit)) + count + b"\x81\x02")
        else:
            parts.append(count + b"\x81\x03")
    return b"".join((*parts, _END))


def _key_array(report_id: int) -> bytes:
    return (
        bytes((0xA1, 0x02, 0x85, report_id))
        + bytes.fromhex("0509 1500 26ff00 1900 2aff00 7510")
        + bytes((0x95, KEY_SLOTS, 0x81, 0x00))
        + _END
    )
