"""Sub-packages of a robot state, after the modes, which a controller sends ten times a second.

Each is a table of fields with their format (big-endian, for `struct`) and content: a variable of
RTDE (``name.3`` is its bit 3), a name specific to these interfaces, or a constant. Source: UR's
guide to the primary and secondary interfaces (public); sizes and order as in a state of URSim 5.8
that UR's client library has among its tests.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from cardan.protocols.ur.primary import ROBOT_STATE, PrimaryPackage

JOINTS: Final = 6

_HEAD = struct.Struct(">iB")

Values = Callable[[str], Any]
"""Value of a variable by its name; a vector is a sequence."""


class SubPackageField(NamedTuple):
    """A field of a sub-package."""

    code: str
    source: str | float


class SubPackage(NamedTuple):
    """A sub-package."""

    kind: int
    fields: tuple[SubPackageField, ...]
    each_joint: bool = False
    """True: the fields repeat for each joint, with one element of each vector."""
    e_series: bool = False
    """True: a CB3 has none."""

    @property
    def form(self) -> str:
        """Format of the whole sub-package for `struct`."""
        once = "".join(field.code for field in self.fields)
        return ">iB" + once * (JOINTS if self.each_joint else 1)

    @property
    def size(self) -> int:
        """Bytes of its fields, without its size and kind; later versions may append to them."""
        return struct.calcsize(self.form) - _HEAD.size

    def pack(self, values: Values) -> bytes:
        """Encode the sub-package."""
        found: list[Any] = []
        if self.each_joint:
            read = [_value(field.source, values) for field in self.fields]
            for joint in range(JOINTS):
                found += [each[joint] if isinstance(each, tuple) else each for each in read]
        else:
            for field in self.fields:
                value = _value(field.source, values)
                found += value if isinstance(value, tuple) else [value]
        return struct.pack(self.form, struct.calcsize(self.form), self.kind, *found)


def _value(source: str | float, values: Values) -> Any:
    if not isinstance(source, str):
        return source
    name, dot, bit = source.partition(".")
    value = values(name)
    if dot:
        return int(value) >> int(bit) & 1
    return value if isinstance(value, (int, float)) else tuple(value)


_F = SubPackageField

JOINT_DATA: Final = SubPackage(
    1,
    (
        _F("d", "actual_q"),
        _F("d", "target_q"),
        _F("d", "actual_qd"),
        _F("f", "actual_current"),
        _F("f", "actual_joint_voltage"),
        _F("f", "joint_temperatures"),
        _F("f", 0.0),
        _F("B", "joint_mode"),
    ),
    each_joint=True,
)
CARTESIAN_INFO: Final = SubPackage(4, (_F("6d", "actual_TCP_pose"), _F("6d", "tcp_offset")))
KINEMATICS_INFO: Final = SubPackage(
    5,
    (
        _F("6I", "kinematics_checksum"),
        _F("6d", "dh_theta"),
        _F("6d", "dh_a"),
        _F("6d", "dh_d"),
        _F("6d", "dh_alpha"),
        _F("I", "calibration_status"),
    ),
)
CALIBRATION_DATA: Final = SubPackage(9, (_F("6d", "calibration_forces"),))
"""Used by UR's software only."""
MASTERBOARD_DATA: Final = SubPackage(
    3,
    (
        _F("I", "actual_digital_input_bits"),
        _F("I", "actual_digital_output_bits"),
        _F("B", "analog_io_types.0"),
        _F("B", "analog_io_types.1"),
        _F("d", "standard_analog_input0"),
        _F("d", "standard_analog_input1"),
        _F("b", "analog_io_types.2"),
        _F("b", "analog_io_types.3"),
        _F("d", "standard_analog_output0"),
        _F("d", "standard_analog_output1"),
        _F("f", "masterboard_temperature"),
        _F("f", "actual_robot_voltage"),
        _F("f", "actual_robot_current"),
        _F("f", "io_current"),
        _F("B", "safety_mode"),
        _F("B", "safety_status_bits.1"),
        # No Euromap 67: its four fields, which follow, are left out.
        _F("B", 0),
        _F("I", 0),
        _F("B", "operational_mode"),
        _F("B", "three_position_enabling_device"),
        _F("B", 0),
    ),
)
TOOL_DATA: Final = SubPackage(
    2,
    (
        _F("B", "tool_analog_input_types.0"),
        _F("B", "tool_analog_input_types.1"),
        _F("d", "tool_analog_input0"),
        _F("d", "tool_analog_input1"),
        _F("f", "actual_robot_voltage"),
        _F("B", "tool_output_voltage"),
        _F("f", "tool_output_current"),
        _F("f", "tool_temperature"),
        _F("B", "tool_mode"),
    ),
)
CONFIGURATION_DATA: Final = SubPackage(
    6,
    (
        _F("12d", "joint_limits"),
        _F("12d", "joint_motion_limits"),
        # Defaults: joints in rad/s and rad/s², the tool in m/s and m/s²; then m per rad.
        _F("d", 1.0471975511965976),
        _F("d", 1.3962634015954636),
        _F("d", 0.25),
        _F("d", 1.2),
        _F("d", 0.25),
        _F("6d", "dh_a"),
        _F("6d", "dh_d"),
        _F("6d", "dh_alpha"),
        _F("6d", "dh_theta"),
        _F("i", "masterboard_version"),
        _F("i", "controller_box_type"),
        _F("i", "robot_type"),
        _F("i", "robot_subtype"),
    ),
)
FORCE_MODE_DATA: Final = SubPackage(7, (_F("6d", "actual_TCP_force"), _F("d", "robot_dexterity")))
ADDITIONAL_INFO: Final = SubPackage(
    8,
    (
        _F("B", "robot_status_bits.2"),
        _F("B", "freedrive_button_enabled"),
        _F("B", 0),
        _F("B", 0),
    ),
)
TOOL_COMMUNICATION_INFO: Final = SubPackage(
    11,
    (
        _F("B", "tool_communication_enabled"),
        # Defaults: bits/s, no parity, stop bits, idle characters.
        _F("i", 115_200),
        _F("i", 0),
        _F("i", 1),
        _F("f", 1.5),
        _F("f", 3.5),
    ),
    e_series=True,
)
TOOL_MODE_INFO: Final = SubPackage(
    12,
    (
        _F("B", "tool_output_mode"),
        _F("B", "tool_digital_output0_mode"),
        _F("B", "tool_digital_output1_mode"),
    ),
    e_series=True,
)
SINGULARITY_INFO: Final = SubPackage(
    13, (_F("B", "singularity_severity"), _F("B", "singularity_type")), e_series=True
)

PARTS: Final[tuple[SubPackage, ...]] = (
    JOINT_DATA,
    CARTESIAN_INFO,
    KINEMATICS_INFO,
    CALIBRATION_DATA,
    MASTERBOARD_DATA,
    TOOL_DATA,
    CONFIGURATION_DATA,
    FORCE_MODE_DATA,
    ADDITIONAL_INFO,
    TOOL_COMMUNICATION_INFO,
    TOOL_MODE_INFO,
    SINGULARITY_INFO,
)
"""Sub-packages in the order of sending, after the modes."""


def parts(values: Values, e_series: bool) -> bytes:
    """Encode all sub-packages after the modes."""
    return b"".join(part.pack(values) for part in PARTS if e_series or not part.e_series)


def sub_packages(found: PrimaryPackage) -> Mapping[int, bytes] | None:
    """Return the contents of a robot state by kind, without sizes and kinds; None for another
    package, or a truncated one."""
    if found.kind != ROBOT_STATE:
        return None
    content, at, read = found.content, 0, {}
    while at < len(content):
        if len(content) - at < _HEAD.size:
            return None
        size, kind = _HEAD.unpack_from(content, at)
        if not _HEAD.size <= size <= len(content) - at:
            return None
        read[kind] = content[at + _HEAD.size : at + size]
        at += size
    return read
