"""Compiled cycle of the UR driver: one call receives a state, one answers it.

Receiving covers :mod:`cardan.drivers.ur_rtde.feed` and the session's checks of a state in usual
motion. Answering covers the command's range check, what missed cycles have left, the limiter and
the data package: :mod:`cardan.drivers.ur_rtde.motion`. The Python code gives the same result to the
last bit; it handles rare cases, and all cases if nothing was compiled. Clock and limiter stay
Python objects, which both languages use.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from ctypes import c_double, c_int32, c_uint8, c_uint32
from pathlib import Path
from typing import Any, Final

from cardan.common.bounds import JOINT_POSITION, JOINT_VELOCITY
from cardan.common.native import (
    NativePartError,
    allotted,
    layout_of,
    load_own_library,
    native_call,
)
from cardan.drivers import missed_cycles
from cardan.drivers.limiters import JointLimiter
from cardan.drivers.missed_cycles import PAUSE_S, SLACK_S, AgreedTime, SlipCompensation
from cardan.protocols.ur.program import JOINTS, ProgramCommand, ProgramStatus
from cardan.protocols.ur.states import MOVES_IN, RobotMode, RuntimeState
from cardan.types import CommandKind, JointCommand

HEAD: Final = 4
"""First bytes of all data packages of one recipe."""
SLIP: Final = (
    "work_off_s",
    "work_off_share",
    "recent_s",
    "speed_up_s",
    "slow_down_s",
    "nothing",
)
"""Constants of missed_cycles, by which a slip is worked off."""
_SIX, _HEAD = c_double * JOINTS, c_uint8 * HEAD


class CStates(ctypes.Structure):
    """Struct of kernel/cycle.h, as is the next."""

    _fields_ = (
        ("largest_time_s", c_double),
        ("largest_position", c_double),
        ("largest_velocity", c_double),
        ("largest_scale", c_double),
        ("rate_hz", c_double),
        ("period_s", c_double),
        ("slack_s", c_double),
        ("pause_s", c_double),
        ("astray_rad", c_double),
        ("moves_in", c_uint32),
        ("robot_mode", c_int32),
        ("runtime_state", c_uint32),
        ("report", c_int32),
        ("token", c_int32),
        ("head", _HEAD),
    )


class CCommands(ctypes.Structure):
    _fields_ = (
        ("lower", _SIX),
        ("upper", _SIX),
        ("inner_lower", _SIX),
        ("inner_upper", _SIX),
        ("speed", _SIX),
        ("acceleration", _SIX),
        ("largest_position", c_double),
        ("largest_velocity", c_double),
        *((name, c_double) for name in SLIP),
        ("token", c_int32),
        ("order", c_int32),
        ("head", _HEAD),
    )


def expected_layout() -> list[int]:
    """Size and field offsets that the compiled library's `ur_layout` must report."""
    return layout_of(CStates, CCommands)


def library_path() -> Path:
    """Path of the compiled part, whether or not it exists."""
    return Path(__file__).with_name("libcardan_ur.so")


@functools.cache
def ur_library() -> Any:
    """Return the compiled part, loaded once. Raises NativePartError with advice."""
    what = "the compiled part of the UR driver"
    return load_own_library(library_path(), what, "ur", expected_layout())


class CompiledStates:
    """Receiver of states, equivalent to RtdeFeed for usual ones. Raises NativePartError if nothing
    was compiled."""

    def __init__(
        self,
        head: bytes,
        package: type[tuple[Any, ...]],
        clock: AgreedTime,
        rate_hz: float,
        astray_rad: float,
        largest_time_s: float,
        largest_scale: float,
    ) -> None:
        """Set the first bytes of states, `head` (HEAD bytes), their `package` type, and the `clock`
        that counts them. A joint farther than `astray_rad` from its target is left to the
        session."""
        library = ur_library()
        self._shared, memory = allotted(CStates)
        shared = self._shared
        shared.largest_time_s, shared.largest_scale = largest_time_s, largest_scale
        shared.largest_position = JOINT_POSITION.highest
        shared.largest_velocity = JOINT_VELOCITY.highest
        shared.rate_hz, shared.period_s = rate_hz, clock.period_s
        shared.slack_s, shared.pause_s = SLACK_S, PAUSE_S
        shared.astray_rad = astray_rad
        shared.moves_in = sum(1 << mode for mode in MOVES_IN)
        shared.robot_mode, shared.runtime_state = RobotMode.RUNNING, RuntimeState.PLAYING
        shared.report = ProgramStatus.FOLLOWS
        shared.head[:] = head
        self.take: Callable[[bytes, float], tuple[Any, float, bool, float] | None] = native_call(
            library,
            "ur_call_take",
            memory,
            clock,
            package,
            "_controller_s",
            "_local_s",
            "_rose_s",
            "_still",
            "_waited_s",
            "_best_s",
            "_end_s",
            "_credit_s",
            "time_s",
            0,
        )
        """Decode data received at a time: the package, the rate of the controller's time, whether
        the program of `token` runs, may move the arm and has it near its target, and the timestamp.
        None, and no change, for anything but one complete usual state."""

    def follow(self, token: int) -> None:
        """Set the token of the program to be obeyed."""
        self._shared.token = token


AnswerFunction = Callable[[Any, float, int, Any], bytes | None]
"""Answer a command with its period, its beat, and the target before it if the slip is to be added
(else None): one period of slip and limiter, and the data package. None, and no change, for anything
but a valid target, and for a slip that begins or ends."""


def compiled_answer(
    limiter: JointLimiter, lost: SlipCompensation, head: bytes, token: int
) -> AnswerFunction | None:
    """Return the compiled `UrMotion` answer to joint targets, in data packages that begin with
    `head`; None if nothing was compiled."""
    try:
        library = ur_library()
    except NativePartError:
        return None
    shared, memory = allotted(CCommands)
    lower, upper, inner_lower, inner_upper, speed, acceleration = limiter.limits
    shared.lower[:], shared.upper[:] = lower, upper
    shared.inner_lower[:], shared.inner_upper[:] = inner_lower, inner_upper
    shared.speed[:], shared.acceleration[:] = speed, acceleration
    shared.largest_position = JOINT_POSITION.highest
    shared.largest_velocity = JOINT_VELOCITY.highest
    shared.token, shared.order, shared.head[:] = token, ProgramCommand.FOLLOW, head
    for name in SLIP:
        setattr(shared, name, getattr(missed_cycles, name.upper()))
    return native_call(
        library,
        "ur_call_answer",
        memory,
        limiter,
        JointCommand,
        CommandKind.JOINT,
        "reference",
        "velocity",
        "_target",
        lost,
        "_interrupted",
        "_rested_s",
        "_fastest",
        "offset",
        "rate",
    )
