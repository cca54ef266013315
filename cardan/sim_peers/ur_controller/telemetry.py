"""What the simulated controller tells over RTDE, by the names of the variables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
from cardan.sim_peers.kinematics import UR_LINKS, forward
from cardan.sim_peers.ur_controller.controller import UrController
from cardan.spatial import to_rotation_vector

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


class Telemetry:
    """Values of variables, and writing them."""

    def __init__(self, controller: UrController) -> None:
        self._controller = controller
        self.inputs = controller.io
        self._links = UR_LINKS[controller.options.robot]
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
        return getattr(self._controller.registers, f"{way}_{kind}")[number]

    def write(self, values: Mapping[str, Any]) -> None:
        """What a client's data package brought."""
        registers = self._controller.registers
        self._controller.watchdogs.fed(values, self._controller.time_s)
        for name, value in values.items():
            if name.startswith("input_int_register_"):
                registers.input_int[int(name[19:])] = value
            elif name.startswith("input_double_register_"):
                registers.input_double[int(name[22:])] = value
            elif name.startswith("input_bit_register_"):
                registers.input_bit[int(name[19:])] = value
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
        controller, servo, inputs = self._controller, self._controller.servo, self.inputs
        return {
            "timestamp": lambda: controller.time_s,
            "target_q": lambda: servo.target_q,
            "target_qd": lambda: servo.target_qd,
            "actual_q": lambda: servo.actual_q,
            "actual_qd": lambda: servo.actual_qd,
            "actual_TCP_pose": lambda: self._tcp_pose(servo.actual_q),
            "target_TCP_pose": lambda: self._tcp_pose(servo.target_q),
            "robot_mode": lambda: controller.mode,
            "safety_mode": lambda: controller.safety,
            "safety_status": lambda: controller.safety,
            "runtime_state": lambda: controller.runtime,
            "robot_status_bits": self._status_bits,
            "safety_status_bits": self._safety_bits,
            "joint_mode": self._joint_modes,
            "speed_scaling": lambda: 1.0 if controller.runtime is RuntimeState.PLAYING else 0.0,
            "target_speed_fraction": lambda: controller.slider,
            "actual_digital_input_bits": lambda: inputs.digital_inputs,
            "actual_digital_output_bits": lambda: inputs.digital_outputs,
            "standard_analog_output0": lambda: inputs.analog_outputs[0],
            "standard_analog_output1": lambda: inputs.analog_outputs[1],
            "actual_main_voltage": lambda: 48.0,
            "actual_robot_voltage": lambda: 48.0 if controller.mode >= RobotMode.POWER_ON else 0.0,
        }

    def _tcp_pose(self, joints: Sequence[float]) -> tuple[float, ...]:
        """x y z in m and the rotation vector in rad, of tool0 in the controller's base."""
        pose = forward(joints, self._links).pose
        return (*pose.position, *to_rotation_vector(pose.orientation))

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
        return (_JOINT_RUNNING if running else _JOINT_OFF,) * len(self._controller.servo.target_q)
