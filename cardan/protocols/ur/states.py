"""States of a Universal Robots controller, by number and by the dashboard server's names."""

from __future__ import annotations

import enum


class RobotMode(enum.IntEnum):
    """RTDE `robot_mode`; the dashboard's `robotmode` uses the names."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    """Power is on, the brakes are engaged."""
    BACKDRIVE = 6
    RUNNING = 7
    """The brakes are released; this causes no motion."""
    UPDATING_FIRMWARE = 8


class SafetyMode(enum.IntEnum):
    """RTDE `safety_mode`; the dashboard's `safetystatus` uses the names."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    VALIDATE_JOINT_ID = 10
    UNDEFINED_SAFETY_MODE = 11
    AUTOMATIC_MODE_SAFEGUARD_STOP = 12
    SYSTEM_THREE_POSITION_ENABLING_STOP = 13


class RuntimeState(enum.IntEnum):
    """RTDE `runtime_state`, the state of the program."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class StatusBit(enum.IntFlag):
    """RTDE `robot_status_bits`."""

    POWER_ON = 1
    PROGRAM_RUNNING = 2
    TEACH_BUTTON = 4
    POWER_BUTTON = 8


class SafetyBit(enum.IntFlag):
    """RTDE `safety_status_bits`."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 4
    RECOVERY = 8
    SAFEGUARD_STOP = 16
    SYSTEM_EMERGENCY_STOP = 32
    ROBOT_EMERGENCY_STOP = 64
    EMERGENCY_STOP = 128
    VIOLATION = 256
    FAULT = 512
    STOPPED_FOR_SAFETY = 1024


MOVES_IN = frozenset({SafetyMode.NORMAL, SafetyMode.REDUCED})
"""Safety modes in which a program may move the arm."""
