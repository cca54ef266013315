"""What the simulated controller tells over RTDE, by the names of the variables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from cardan.protocols.ur.states import (
    MOVES_IN,
    RobotMode,
    RuntimeState,
    SafetyBit,
    SafetyMode,
    StatusBit,
)
from cardan.protocols.ur.variables import OUTPUTS
from cardan.sim_peers.ur_controller.controller import UrController

_NOTHING: Final[Mapping[str, Any]] = {
    "VECTOR6D": (0.0,) * 6,
    "VECTOR3D": (0.0,) * 3,
    "VECTOR6INT32": (0,) * 6,
    "DOUBLE": 0.0,
    "BOOL": False,
}
_JOINT_RUNNING: Final = 253
_JOINT_OFF: Final = 239

_SAFETY_BITS: Final[Mapping[SafetyMode, SafetyBit]] = {
    SafetyMode.NORMAL: SafetyBit.NORMAL,
    SafetyMode.REDUCED: SafetyBit.REDUCED,
    SafetyMode.PROTECTIVE_STOP: SafetyBit.PROTECTIVE_STOP,
    SafetyMode.SAFEGUARD_STOP: SafetyBit.SAFEGUARD_STOP,
    SafetyMode.ROBOT_EMERGENCY_STOP: SafetyBit.ROBOT_EMERGENCY_STOP | SafetyBit.EMERGENCY_STOP,
}


class Inputs:
    """What clients have written, beside the registers that programs read."""

    def __init__(self) -> None:
        self.digital_outputs = 0
        """Standard in bits 0 to 7, configurable in 8 to 15, tool in 16 and 17."""
        self.analog_outputs = [0.0, 0.0]
        self.bits = [False] * 128


class Telemetry:
    """Values of variables, and writing them."""

    def __init__(self, controller: UrController) -> None:
        self._controller = controller
        self.inputs = Inputs()
        self._made: dict[str, Callable[[], Any]] = self._makers()

    def value(self, name: str) -> Any:
        """Of a variable in `OUTPUTS`; zero for what this robot does not have."""
        made = self._made.get(name)
        if made is not None:
            return made()
        way, _, rest = name.partition("_")
        kind, _, number = rest.partition("_register_")
        if number.isdigit():
            return self._register(way, kind, int(number))
        return _NOTHING.get(OUTPUTS[name], 0)

    def _register(self, way: str, kind: str, number: int) -> Any:
        if kind == "bit":
            return self.inputs.bits[number] if way == "input" else False
        return getattr(self._controller.registers, f"{way}_{kind}")[number]

    def write(self, values: Mapping[str, Any]) -> None:
        """What a client's data package brought."""
        registers = self._controller.registers
        for name, value in values.items():
            if name.startswith("input_int_register_"):
                registers.input_int[int(name[19:])] = value
            elif name.startswith("input_double_register_"):
                registers.input_double[int(name[22:])] = value
            elif name.startswith("input_bit_register_"):
                self.inputs.bits[int(name[19:])] = value
        if values.get("speed_slider_mask", 0) & 1:
            self._controller.slider = min(max(values.get("speed_slider_fraction", 1.0), 0.0), 1.0)
        for kind, shift in (("standard", 0), ("configurable", 8), ("tool", 16)):
            mask = values.get(f"{kind}_digital_output_mask", 0) << shift
            wanted = values.get(f"{kind}_digital_output", 0) << shift
            outputs = self.inputs.digital_outputs
            self.inputs.digital_outputs = (outputs & ~mask) | (wanted & mask)
        mask = values.get("standard_analog_output_mask", 0)
        for number in (0, 1):
            if mask >> number & 1:
                self.inputs.analog_outputs[number] = values[f"standard_analog_output_{number}"]

    def _makers(self) -> dict[str, Callable[[], Any]]:
        controller, motion, inputs = self._controller, self._controller.motion, self.inputs
        return {
            "timestamp": lambda: controller.time_s,
            "target_q": lambda: motion.target_q,
            "target_qd": lambda: motion.target_qd,
            "actual_q": lambda: motion.actual_q,
            "actual_qd": lambda: motion.actual_qd,
            "target_qdd": lambda: motion.target_qdd,
            "actual_TCP_pose": motion.actual_tcp_pose,
            "target_TCP_pose": motion.target_tcp_pose,
            "actual_TCP_speed": motion.actual_tcp_speed,
            "target_TCP_speed": motion.target_tcp_speed,
            "actual_TCP_force": motion.tcp_force,
            "tcp_offset": lambda: motion.tcp_offset,
            "payload": lambda: motion.payload.mass,
            "payload_cog": lambda: motion.payload.cog,
            "payload_inertia": lambda: motion.payload.inertia,
            "robot_mode": lambda: controller.mode,
            "safety_mode": lambda: controller.safety,
            "safety_status": lambda: controller.safety,
            "runtime_state": lambda: controller.runtime,
            "robot_status_bits": self._status_bits,
            "safety_status_bits": self._safety_bits,
            "joint_mode": self._joint_modes,
            "speed_scaling": lambda: 1.0 if controller.runtime is RuntimeState.PLAYING else 0.0,
            "target_speed_fraction": lambda: controller.slider,
            "actual_digital_output_bits": lambda: inputs.digital_outputs,
            "standard_analog_output0": lambda: inputs.analog_outputs[0],
            "standard_analog_output1": lambda: inputs.analog_outputs[1],
            "actual_main_voltage": lambda: 48.0,
            "actual_robot_voltage": lambda: 48.0 if controller.mode >= RobotMode.POWER_ON else 0.0,
        }

    def _status_bits(self) -> int:
        controller = self._controller
        found = StatusBit(0)
        if controller.mode >= RobotMode.POWER_ON:
            found |= StatusBit.POWER_ON
        if controller.runtime is RuntimeState.PLAYING:
            found |= StatusBit.PROGRAM_RUNNING
        return int(found)

    def _safety_bits(self) -> int:
        safety = self._controller.safety
        found = _SAFETY_BITS.get(safety, SafetyBit(0))
        if safety not in MOVES_IN:
            found |= SafetyBit.STOPPED_FOR_SAFETY
        return int(found)

    def _joint_modes(self) -> tuple[int, ...]:
        running = self._controller.mode is RobotMode.RUNNING
        return (_JOINT_RUNNING if running else _JOINT_OFF,) * len(self._controller.motion.target_q)
