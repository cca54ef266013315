"""Checks of third-party drivers; errors name the driver."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence, Set as AbstractSet
from numbers import Real
from types import TracebackType
from typing import Any

from cardan.common.context import Openable
from cardan.common.plugins import reason
from cardan.common.resource_errors import shortage
from cardan.drivers.base import RobotDriver
from cardan.errors import CardanError, DriverError
from cardan.types import ButtonEvent, DeviceLink, DeviceState, Pose, RobotLink, RobotState

_log = logging.getLogger(__name__)

FAILURES = (Exception, SystemExit)
"""Exceptions caught from a driver; SystemExit, too, so that `sys.exit()` ends no session
silently."""


class RobotCalls:
    """Context for calls of a robot's driver: converts errors that are not Cardan's to a DriverError
    that names the driver."""

    def __init__(self, robot: RobotDriver) -> None:
        self._name = type(robot).__name__

    def __enter__(self) -> None:
        pass

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if isinstance(error, FAILURES):
            self.check(error)

    def check(self, error: BaseException) -> None:
        """Raise a DriverError for an error of a driver's call, unless the error is Cardan's."""
        if not isinstance(error, CardanError) and not shortage(error):
            _log.debug("it failed here", exc_info=error)
            raise self.failed(reason(error)) from error

    def failed(self, problem: str) -> DriverError:
        """Make the error for a driver that breaks its interface."""
        return DriverError(f"the robot's driver {self._name} failed: {problem}")


def close_in_order(opened: Openable) -> None:
    """Close a driver or filter. Log its name if it raises, so that the caller can close the
    others."""
    try:
        opened.close()
    except FAILURES:
        _log.exception("%s could not be closed properly", type(opened).__name__)


def is_foreign(driver: object) -> bool:
    """True for a driver of another package: its results are checked in each cycle."""
    return type(driver).__module__.partition(".")[0] != "cardan"


def device_problem(state: Any, events: Any) -> str:
    """Explain how results of a device's `state()` and `button_events()` are invalid; empty if
    valid."""
    if not isinstance(state, DeviceState):
        return f"state() returned {state!r:.60}"
    if not isinstance(state.link, DeviceLink):
        return f"state() returned the link {state.link!r:.60}"
    if not _numbers(state.axes) or len(state.axes) != 6:
        return f"state() returned the axes {state.axes!r:.60}, which are not six numbers"
    if not isinstance(state.buttons, AbstractSet):
        return f"state() returned the buttons {state.buttons!r:.60}, not a set"
    if not isinstance(state.masked, AbstractSet):
        return f"state() returned the masked buttons {state.masked!r:.60}, not a set"
    if not _numbers((state.stamp_s,)) or state.stamp_s != state.stamp_s:
        return f"state() returned the time {state.stamp_s!r:.60}"
    if state.pose is not None and not isinstance(state.pose, Pose):
        return f"state() returned the pose {state.pose!r:.60}"
    if not isinstance(events, Sequence):
        return f"button_events() returned {events!r:.60}"
    for event in events:
        if not isinstance(event, ButtonEvent):
            return f"button_events() returned {event!r:.60} for an event"
    return ""


def robot_problem(state: Any) -> str:
    """Explain how a result of a robot's `cycles()` is invalid; empty if valid. Joints may be NaN,
    which the arm's model refuses; an invalid time would make a silent robot seem alive."""
    if not isinstance(state, RobotState):
        return f"cycles() returned {state!r:.60}"
    if not isinstance(state.link, RobotLink):
        return f"cycles() returned the link {state.link!r:.60}"
    if not isinstance(state.hold_reason, str):
        return f"cycles() returned the hold_reason {state.hold_reason!r:.60}"
    for name in ("stamp_s", "period_s"):
        value = getattr(state, name)
        if not _numbers((value,)) or not math.isfinite(value):
            return f"cycles() returned the {name} {value!r:.60}, which is not a finite number"
    for name in ("joints", "velocities", "torques"):
        values = getattr(state, name)
        if not _numbers(values):
            return f"cycles() returned the {name} {values!r:.60}, which are not numbers"
    return ""


def checked_lines(lines: Any) -> list[str]:
    """Return the lines of a `diagnosis()`. Raises TypeError for any other result."""
    wrong = [lines] if isinstance(lines, str) else [each for each in lines if type(each) is not str]
    if wrong:
        raise TypeError(f"diagnosis() returned {wrong[0]!r:.60}, not lines of text")
    return list(lines)


def counted(metrics: Any) -> Any:
    """Return the checked result of `metrics()`. Raises TypeError for a value that is no number."""
    for name, value in metrics.items():
        if not isinstance(value, Real):
            raise TypeError(f"metrics() returned {value!r:.60} for {name!r}, not a number")
    return metrics


def _numbers(values: Any) -> bool:
    return isinstance(values, (tuple, list)) and all(
        type(value) is float or isinstance(value, Real) for value in values
    )
