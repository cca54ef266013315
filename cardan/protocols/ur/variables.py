"""Variables that an RTDE recipe may name, with their types.

Source: UR's RTDE guide, and the names that UR's public client library asks for.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

REGISTERS: Final = 48
"""Integer and double registers of each direction; 0 to 23 are for fieldbuses and PLCs, too."""
UPPER_REGISTERS: Final = 24
"""The first of those that only RTDE clients use."""
BIT_REGISTERS: Final = 128

_DOUBLES = [
    "timestamp",
    "actual_execution_time",
    "speed_scaling",
    "target_speed_fraction",
    "actual_momentum",
    "actual_main_voltage",
    "actual_robot_voltage",
    "actual_robot_current",
    "standard_analog_input0",
    "standard_analog_input1",
    "standard_analog_output0",
    "standard_analog_output1",
    "io_current",
    "euromap67_24V_voltage",
    "euromap67_24V_current",
    "tool_analog_input0",
    "tool_analog_input1",
    "tool_output_current",
    "tool_temperature",
    "tcp_force_scalar",
    "payload",
    "actual_robot_energy_consumed",
    "collision_detection_ratio",
]
_VECTORS = [
    "target_q",
    "target_qd",
    "target_qdd",
    "target_current",
    "target_moment",
    "actual_q",
    "actual_qd",
    "actual_current",
    "actual_current_window",
    "joint_control_output",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
    "target_TCP_pose",
    "target_TCP_speed",
    "joint_temperatures",
    "actual_joint_voltage",
    "ft_raw_wrench",
    "payload_inertia",
    "tcp_offset",
    "actual_current_as_torque",
]
_THREES = ["actual_tool_accelerometer", "elbow_position", "elbow_velocity", "payload_cog"]
_UNSIGNED = [
    "runtime_state",
    "robot_status_bits",
    "safety_status_bits",
    "analog_io_types",
    "euromap67_input_bits",
    "euromap67_output_bits",
    "tool_mode",
    "tool_analog_input_types",
    "output_bit_registers0_to_31",
    "output_bit_registers32_to_63",
    "input_bit_registers0_to_31",
    "input_bit_registers32_to_63",
]
_SIGNED = ["robot_mode", "safety_mode", "safety_status", "tool_output_voltage"]

OUTPUTS: Final[Mapping[str, str]] = {
    **dict.fromkeys(_DOUBLES, "DOUBLE"),
    **dict.fromkeys(_VECTORS, "VECTOR6D"),
    **dict.fromkeys(_THREES, "VECTOR3D"),
    **dict.fromkeys(_UNSIGNED, "UINT32"),
    **dict.fromkeys(_SIGNED, "INT32"),
    "joint_mode": "VECTOR6INT32",
    "actual_digital_input_bits": "UINT64",
    "actual_digital_output_bits": "UINT64",
    "tool_output_mode": "UINT8",
    "tool_digital_output0_mode": "UINT8",
    "tool_digital_output1_mode": "UINT8",
    **{
        f"{way}_{kind}_register_{n}": type_name
        for way in ("output", "input")
        for kind, type_name, count in (
            ("bit", "BOOL", BIT_REGISTERS),
            ("int", "INT32", REGISTERS),
            ("double", "DOUBLE", REGISTERS),
        )
        for n in range(count)
    },
}
"""What a controller sends; a controller's own version may lack some, or have more."""

INPUTS: Final[Mapping[str, str]] = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "external_force_torque": "VECTOR6D",
    "input_bit_registers0_to_31": "UINT32",
    "input_bit_registers32_to_63": "UINT32",
    **{f"input_bit_register_{n}": "BOOL" for n in range(64, BIT_REGISTERS)},
    **{f"input_int_register_{n}": "INT32" for n in range(REGISTERS)},
    **{f"input_double_register_{n}": "DOUBLE" for n in range(REGISTERS)},
}
"""What a client may write."""
