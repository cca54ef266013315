"""Values of the simulated controller in robot states, in addition to RTDE's variables."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

from cardan.protocols.ur.primary import ModeData
from cardan.protocols.ur.states import RobotMode, RuntimeState, SafetyMode
from cardan.robots import ArmModel
from cardan.sim_peers.kinematics import UR_LINKS, forward, manipulability
from cardan.sim_peers.ur_controller.controller import JOINT_RANGE, UrController
from cardan.sim_peers.ur_controller.pendant import OPERATIONAL_MODES, Pendant
from cardan.sim_peers.ur_controller.telemetry import Telemetry

_SINGULAR: Final = 0.01
"""Manipulability below which the arm is near a singularity."""
_UNKNOWN_CHECKSUM: Final = 0xFFFFFFFF
"""Checksum of a robot that was never calibrated, like a simulated one."""
_HARDWARE: Final[Mapping[bool, tuple[int, int, int, int]]] = {
    True: (6, 4, 1, 3),
    False: (4, 3, 1, 2),
}
"""Hardware numbers of an e-Series, or of a CB3: board, control box, robot and its sub-type."""


class StateValues:
    """Values by their names in `cardan.protocols.ur.robot_state`."""

    def __init__(self, controller: UrController, telemetry: Telemetry, pendant: Pendant) -> None:
        self._controller, self._telemetry = controller, telemetry
        options = controller.options
        self._links = links = UR_LINKS[options.robot]
        board, box, robot, subtype = _HARDWARE[options.e_series]
        self._fixed: dict[str, Any] = {
            "kinematics_checksum": (_UNKNOWN_CHECKSUM,) * len(links),
            "dh_theta": tuple(link.offset for link in links),
            "dh_a": tuple(link.a for link in links),
            "dh_d": tuple(link.d for link in links),
            "dh_alpha": tuple(math.atan2(link.sin_alpha, link.cos_alpha) for link in links),
            "calibration_status": 0,
            "calibration_forces": (0.0,) * 6,
            "joint_limits": (-JOINT_RANGE, JOINT_RANGE) * len(links),
            "joint_motion_limits": _motion_limits(options.arm),
            "masterboard_version": board,
            "controller_box_type": box,
            "robot_type": robot,
            "robot_subtype": subtype,
            "masterboard_temperature": 24.0,
            "three_position_enabling_device": 1,
            "tool_communication_enabled": 0,
        }
        self._made: dict[str, Callable[[], Any]] = {
            "operational_mode": lambda: OPERATIONAL_MODES.index(pendant.operational_mode),
            "freedrive_button_enabled": lambda: int(controller.mode is RobotMode.RUNNING),
            "robot_dexterity": lambda: self._manipulability() ** 2,
            "singularity_severity": lambda: int(self._manipulability() < _SINGULAR),
            "singularity_type": lambda: 0,
        }

    def __call__(self, name: str) -> Any:
        """Return the value of a name."""
        if name in self._fixed:
            return self._fixed[name]
        made = self._made.get(name)
        return self._telemetry.value(name) if made is None else made()

    def modes(self) -> ModeData:
        """Return the modes, the first part of a robot state."""
        controller, value = self._controller, self._telemetry.value
        return ModeData(
            power_on=controller.mode >= RobotMode.POWER_ON,
            emergency_stopped=controller.safety is SafetyMode.ROBOT_EMERGENCY_STOP,
            protective_stopped=controller.safety is SafetyMode.PROTECTIVE_STOP,
            program_running=controller.runtime is RuntimeState.PLAYING,
            program_paused=controller.runtime is RuntimeState.PAUSED,
            robot_mode=RobotMode(controller.mode),
            speed_fraction=value("target_speed_fraction"),
            speed_scaling=value("speed_scaling"),
        )

    def _manipulability(self) -> float:
        return manipulability(forward(self._controller.motion.actual_q, self._links))


def _motion_limits(arm: ArmModel) -> tuple[float, ...]:
    """Return highest speed and acceleration of each joint, in turn."""
    limits = arm.limits
    pairs = zip(limits.velocity, limits.acceleration, strict=True)
    return tuple(value for pair in pairs for value in pair)
