"""Variables that an RTDE recipe may name, with their types and the first versions that have them.

Source: UR's RTDE guide, and UR's public client library for names that the guide got later.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

REGISTERS: Final = 48
"""Count of integer and double registers in each direction; 0 to 23 are shared with fieldbuses and
PLCs."""
UPPER_REGISTERS: Final = 24
"""First register that is reserved for RTDE clients."""
BIT_REGISTERS: Final = 128
UPPER_BIT_REGISTERS: Final = 64
"""First bit register with its own name; lower ones come 32 at a time."""


class Variable(NamedTuple):
    """Type of a variable, and the software versions that have it."""

    type: str
    cb3: tuple[int, int] | None = (3, 2)
    """First version of a CB3's software, if the guide has it; None: no CB3 has the variable."""
    e_series: tuple[int, int] = (5, 0)
    """First version of an e-Series' software, likewise."""

    def since(self, major: int) -> tuple[int, int] | None:
        """Return the first version of a series that has it: 3 is a CB3, all others count as
        e-Series."""
        return self.cb3 if major == 3 else self.e_series


_ALWAYS: Final = Variable("")
_ADDED: Final[Sequence[tuple[str, Variable]]] = (
    ("elbow_position elbow_velocity", Variable("VECTOR3D", (3, 5))),
    ("safety_status", Variable("INT32", (3, 10), (5, 4))),
    ("payload", Variable("DOUBLE", (3, 11), (5, 5))),
    ("payload_cog", Variable("VECTOR3D", (3, 11), (5, 5))),
    ("tcp_offset", Variable("VECTOR6D", (3, 12), (5, 5))),
    ("script_control_line", Variable("UINT32", (3, 14), (5, 9))),
    ("payload_inertia", Variable("VECTOR6D", (3, 15), (5, 11))),
    (
        "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode",
        Variable("UINT8", None, (5, 2)),
    ),
    ("ft_raw_wrench", Variable("VECTOR6D", None, (5, 9))),
    ("collision_detection_ratio", Variable("DOUBLE", None, (5, 15))),
    ("time_scale_source", Variable("INT32", None, (5, 17))),
    ("actual_current_as_torque", Variable("VECTOR6D", None, (5, 23))),
    (
        "actual_robot_energy_consumed actual_robot_braking_energy_dissipated",
        Variable("DOUBLE", None, (5, 23)),
    ),
    (
        "wrench_calc_from_currents actual_TCP_acceleration target_TCP_acceleration",
        Variable("VECTOR6D", None, (5, 23)),
    ),
    ("target_execution_time", Variable("DOUBLE", None, (5, 23))),
    (
        "actual_configurable_digital_input_bits actual_configurable_digital_output_bits",
        Variable("UINT64", None, (5, 23)),
    ),
    ("encoder0_raw encoder1_raw", Variable("INT32", None, (5, 23))),
    ("target_gravity", Variable("VECTOR3D", None, (5, 26))),
    ("target_base_acceleration target_base_wrench", Variable("VECTOR6D", None, (5, 26))),
    ("control_step", Variable("UINT64", None, (5, 26))),
)
"""Variables that later versions added. If the guide gives no version, it is the first public
list's."""

LATER: Final = frozenset(name for names, _ in _ADDED for name in names.split())
"""Names of these."""

_FIRST: Final[Mapping[str, str]] = {
    "DOUBLE": """timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum
        actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0
        standard_analog_input1 standard_analog_output0 standard_analog_output1 io_current
        euromap67_24V_voltage euromap67_24V_current tool_analog_input0 tool_analog_input1
        tool_output_current tool_temperature tcp_force_scalar joint_position_deviation_ratio""",
    "VECTOR6D": """target_q target_qd target_qdd target_current target_moment actual_q actual_qd
        actual_current actual_current_window joint_control_output actual_TCP_pose actual_TCP_speed
        actual_TCP_force target_TCP_pose target_TCP_speed joint_temperatures
        actual_joint_voltage""",
    "VECTOR3D": "actual_tool_accelerometer",
    "VECTOR6INT32": "joint_mode",
    "INT32": "robot_mode safety_mode tool_output_voltage",
    "UINT32": """runtime_state robot_status_bits safety_status_bits analog_io_types
        euromap67_input_bits euromap67_output_bits tool_mode tool_analog_input_types""",
    "UINT64": "actual_digital_input_bits actual_digital_output_bits",
}
"""Variables of every controller with RTDE, by type."""


def _registers(way: str) -> Iterator[tuple[str, Variable]]:
    lower, upper = _ALWAYS._replace(cb3=(3, 4)), _ALWAYS._replace(cb3=(3, 9), e_series=(5, 3))
    for first in range(0, UPPER_BIT_REGISTERS, 32):
        yield f"{way}_bit_registers{first}_to_{first + 31}", lower._replace(type="UINT32")
    for number in range(UPPER_BIT_REGISTERS, BIT_REGISTERS):
        yield f"{way}_bit_register_{number}", upper._replace(type="BOOL")
    for kind, type_name in (("int", "INT32"), ("double", "DOUBLE")):
        for number in range(REGISTERS):
            since = lower if number < UPPER_REGISTERS else upper
            yield f"{way}_{kind}_register_{number}", since._replace(type=type_name)


OUTPUT_VARIABLES: Final[Mapping[str, Variable]] = {
    **{name: Variable(kind) for kind, names in _FIRST.items() for name in names.split()},
    **{name: found for names, found in _ADDED for name in names.split()},
    **dict(_registers("output")),
    **dict(_registers("input")),
}
"""Variables that a controller sends, by name."""

INPUT_VARIABLES: Final[Mapping[str, Variable]] = {
    "speed_slider_mask": Variable("UINT32"),
    "speed_slider_fraction": Variable("DOUBLE"),
    "standard_digital_output_mask": Variable("UINT8"),
    "configurable_digital_output_mask": Variable("UINT8"),
    "standard_digital_output": Variable("UINT8"),
    "configurable_digital_output": Variable("UINT8"),
    "tool_digital_output_mask": Variable("UINT8"),
    "tool_digital_output": Variable("UINT8"),
    "standard_analog_output_mask": Variable("UINT8"),
    "standard_analog_output_type": Variable("UINT8"),
    "standard_analog_output_0": Variable("DOUBLE"),
    "standard_analog_output_1": Variable("DOUBLE"),
    "external_force_torque": Variable("VECTOR6D"),
    **dict(_registers("input")),
}
"""Variables that a client may write, by name."""

OUTPUTS: Final[Mapping[str, str]] = {name: found.type for name, found in OUTPUT_VARIABLES.items()}
"""Types of the variables that a controller sends; a controller's version may lack some."""
INPUTS: Final[Mapping[str, str]] = {name: found.type for name, found in INPUT_VARIABLES.items()}
"""Types of the variables that a client may write."""


def of_series(variables: Mapping[str, Variable], major: int) -> dict[str, str]:
    """Return the types of the variables of a series by its major version, whatever its minor
    one."""
    return {name: found.type for name, found in variables.items() if found.since(major) is not None}
