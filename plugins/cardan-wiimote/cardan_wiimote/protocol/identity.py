"""Nintendo's remotes: ids and names, L2CAP channels, and the HID report descriptor.

Source: WiiBrew (Wiimote), the Linux kernel's hid-wiimote, and the descriptor of a real remote.
"""

from __future__ import annotations

from typing import NamedTuple

NINTENDO = 0x057E
"""Vendor id."""

CONTROL_PSM = 0x11
INTERRUPT_PSM = 0x13
"""L2CAP channels: a host opens the control channel first."""

INPUT_HEADER = 0xA1
"""First byte on the interrupt channel, remote to host; the report follows."""
OUTPUT_HEADER = 0xA2
"""First byte on the interrupt channel, host to remote."""
SET_REPORT_HEADER = 0x52
"""First byte on the control channel, host to remote (for older remotes)."""
HANDSHAKE_OK = 0x00
"""The answer on the control channel to a report sent there."""


class Model(NamedTuple):
    """Description of a kind of remote."""

    key: str
    """Name for command lines and configuration files."""
    bluetooth_name: str
    product_id: int
    device_class: int
    """Bluetooth class of device."""
    set_report: bool
    """True if it accepts output reports on the control channel too."""


MODELS: tuple[Model, ...] = (
    Model("wiimote", "Nintendo RVL-CNT-01", 0x0306, 0x002504, True),
    Model("wiimote-tr", "Nintendo RVL-CNT-01-TR", 0x0330, 0x000508, False),
    Model("balance-board", "Nintendo RVL-WBC-01", 0x0306, 0x002504, True),
    Model("pro-controller", "Nintendo RVL-CNT-01-UC", 0x0330, 0x000508, False),
)
"""Every device with this protocol. The last two are not remotes; only their names distinguish
them."""

WIIMOTE, WIIMOTE_TR = MODELS[0], MODELS[1]

PRODUCT_IDS: frozenset[int] = frozenset(model.product_id for model in MODELS)


def model_of(bluetooth_name: str, product_id: int) -> Model | None:
    """Return the model of this name; for an unknown name the remote of this product id, else
    None."""
    for model in MODELS:
        if model.bluetooth_name == bluetooth_name:
            return model
    for model in (WIIMOTE, WIIMOTE_TR):
        if model.product_id == product_id:
            return model
    return None


RUMBLE_ID = 0x10
LEDS_ID = 0x11
DATA_MODE_ID = 0x12
IR_ENABLE_1_ID = 0x13
SPEAKER_ENABLE_ID = 0x14
STATUS_REQUEST_ID = 0x15
WRITE_MEMORY_ID = 0x16
READ_MEMORY_ID = 0x17
SPEAKER_DATA_ID = 0x18
SPEAKER_MUTE_ID = 0x19
IR_ENABLE_2_ID = 0x1A
OUTPUT_SIZES: dict[int, int] = {
    RUMBLE_ID: 1, LEDS_ID: 1, DATA_MODE_ID: 2, IR_ENABLE_1_ID: 1, SPEAKER_ENABLE_ID: 1,
    STATUS_REQUEST_ID: 1, WRITE_MEMORY_ID: 21, READ_MEMORY_ID: 6, SPEAKER_DATA_ID: 21,
    SPEAKER_MUTE_ID: 1, IR_ENABLE_2_ID: 1,
}  # fmt: skip
"""Bytes of each output report after its id."""

STATUS_ID = 0x20
READ_DATA_ID = 0x21
ACK_ID = 0x22
FIRST_HALF_ID = 0x3E
SECOND_HALF_ID = 0x3F

INPUT_SIZES: dict[int, int] = {
    STATUS_ID: 6, READ_DATA_ID: 21, ACK_ID: 4,
    0x30: 2, 0x31: 5, 0x32: 10, 0x33: 17, 0x34: 21, 0x35: 21, 0x36: 21, 0x37: 21,
    0x3D: 21, FIRST_HALF_ID: 21, SECOND_HALF_ID: 21,
}  # fmt: skip
"""Bytes of each input report after its id."""

LONGEST_REPORT_BYTES = 22
"""Including the id; one more with the header byte of L2CAP."""


def report_descriptor() -> bytes:
    """Return the remote's HID report descriptor, 217 bytes: every report is an array of vendor
    bytes."""
    parts = [bytes.fromhex("0501 0905 a101")]
    for report_id, size in OUTPUT_SIZES.items():
        first = report_id == RUMBLE_ID
        parts.append(bytes((0x85, report_id)))
        parts.append(bytes.fromhex("1500 26ff00 7508") if first else b"")
        parts.append(bytes((0x95, size)))
        parts.append(bytes.fromhex("0600ff") if first else b"")
        parts.append(bytes.fromhex("0901 9100"))
    for report_id, size in INPUT_SIZES.items():
        parts.append(bytes((0x85, report_id, 0x95, size)) + bytes.fromhex("0901 8100"))
    return b"".join((*parts, b"\xc0"))
