"""Explanations of a Universal Robots controller's states, with advice."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from cardan.protocols.ur.program import ProgramStatus
from cardan.protocols.ur.rtde import CB3_MAJOR
from cardan.protocols.ur.states import RobotMode, SafetyMode

SAFETY: Final[Mapping[int, str]] = {
    SafetyMode.PROTECTIVE_STOP: (
        "protective stop: look for its cause, then unlock it at the pendant, and enable again"
    ),
    SafetyMode.RECOVERY: "recovery mode: a joint is beyond its limits; move it back at the pendant",
    SafetyMode.SAFEGUARD_STOP: "safeguard stop: close the guard and reset it, then enable again",
    SafetyMode.SYSTEM_EMERGENCY_STOP: ("emergency stop of the cell: release it, then enable again"),
    SafetyMode.ROBOT_EMERGENCY_STOP: (
        "emergency stop at the robot: release the button, then enable again"
    ),
    SafetyMode.VIOLATION: "safety violation: look at the pendant, which shows how to go on",
    SafetyMode.FAULT: "safety fault: look at the pendant; the controller has to be restarted",
    SafetyMode.VALIDATE_JOINT_ID: "a joint's identity has to be confirmed at the pendant",
    SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP: (
        "safeguard stop of automatic mode: close the guard and reset it, then enable again"
    ),
    SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP: (
        "the three-position switch stops the robot: hold it in the middle, or choose automatic mode"
    ),
}

MODES: Final[Mapping[int, str]] = {
    RobotMode.NO_CONTROLLER: "the controller is not running",
    RobotMode.DISCONNECTED: "the controller has no connection to its arm",
    RobotMode.CONFIRM_SAFETY: "the safety configuration has to be confirmed at the pendant",
    RobotMode.BOOTING: "the arm is starting",
    RobotMode.POWER_OFF: "power is off",
    RobotMode.POWER_ON: "power is coming on",
    RobotMode.IDLE: "the brakes hold the arm",
    RobotMode.BACKDRIVE: "the arm is in backdrive: end it at the pendant",
    RobotMode.UPDATING_FIRMWARE: "the arm's firmware is being updated: wait for its end",
}

STARTABLE: Final = frozenset(
    (
        RobotMode.POWER_OFF,
        RobotMode.POWER_ON,
        RobotMode.BOOTING,
        RobotMode.IDLE,
        RobotMode.RUNNING,
    )
)
"""Modes from which the driver gets to RUNNING by itself, or by waiting."""

ENDS: Final[Mapping[int, str]] = {
    ProgramStatus.ENDED_BY_ORDER: "motion was ended",
    ProgramStatus.ENDED_BY_WATCHDOG: (
        "no command came in time, and the program at the controller has stopped the arm"
    ),
    ProgramStatus.ENDED_BY_JUMP: (
        "a command was too far from the one before, and the program at the controller has stopped "
        "the arm"
    ),
}


NOT_ENABLED: Final = "motion is not enabled"
_AGAIN: Final = "enable again"


def again(reason: str) -> str:
    """Append advice to `reason`, unless it has some."""
    return reason if _AGAIN in reason else f"{reason}; {_AGAIN}"


REDUCED: Final = (
    "reduced mode: the controller keeps to its reduced limits, and stops an arm that is commanded "
    "beyond them; what reduces it (a plane, an input) is in its safety configuration"
)

_CB3: Final = frozenset({"ur3", "ur5", "ur10"})


_NUMBER: Final = re.compile(r"ur(\d+)", re.ASCII | re.IGNORECASE)


def other_arm(robot: str, major: int, model: str) -> str:
    """Explain why a controller of this software that reports the arm `model` (empty: unknown)
    cannot have this arm; empty: it can, or the arm is not a known model."""
    ours, theirs = _NUMBER.match(robot), _NUMBER.match(model)
    if ours is not None and theirs is not None and ours[1] != theirs[1]:
        return (
            f"the controller's arm is a UR{theirs[1]}, and is driven as {robot}: poses and limits "
            f"are wrong; set robot to the model of a UR{theirs[1]}"
        )
    if major <= CB3_MAJOR and robot.removesuffix("e") in _CB3 and robot.endswith("e"):
        return (
            f"the controller is a CB3 (PolyScope {major}), and {robot} is an e-Series arm: poses "
            f'and limits are wrong; set robot = "{robot.removesuffix("e")}"'
        )
    if major > CB3_MAJOR and robot in _CB3:
        return (
            f"the controller is an e-Series (PolyScope {major}), and {robot} is an arm of a CB3: "
            f'poses and limits are wrong; set robot = "{robot}e"'
        )
    return ""


def safety_words(mode: int) -> str:
    """Explain why nothing may move in a safety mode."""
    return SAFETY.get(mode, f"safety mode {mode}: look at the pendant")


def mode_words(mode: int) -> str:
    """Explain a robot mode other than RUNNING."""
    return MODES.get(mode, f"robot mode {mode}: look at the pendant")
