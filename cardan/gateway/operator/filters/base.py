"""The interface of a filter for shared control, between the mapping and the reference. It gets the
twist that the operator requests and returns the one to be used; every limit, the maximum lead and
the workspace apply after it, so it cannot make a motion unsafe in speed, acceleration or position.
Filters are found by name like drivers; third parties add theirs through the entry-point group
``cardan.filters``."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from cardan.drivers.base import Driver
from cardan.types import RobotState, Twist


class TwistFilter(Driver):
    """Changes the operator's twist, usually by readings of its own sensor.

    It has a driver's options, open(), close() and diagnosis(). While its sensor is not fresh, its
    effect must be safe, and status() must say so.
    """

    def __init__(self, options: Any = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self.name = type(self).__name__
        """Its name in messages; a session sets the configured name."""

    @abstractmethod
    def apply(self, twist: Twist, robot: RobotState) -> Twist:
        """Return the twist to request instead of `twist` (base or tool axes), once in every tick.

        It is also called when no operator drives or the robot is silent, with a twist of zero and
        perhaps without `robot.pose`, so that the sensor is always read; its result is then not
        used, because a filter cannot start a motion. Now is `robot.stamp_s`. Never blocks, never
        raises, never gives a value that is not finite: either of the last two disengages
        teleoperation.
        """

    @abstractmethod
    def status(self) -> str:
        """Return the effect on the operator's motion now; empty if there is none."""

    def describe(self) -> str:
        """Return the configured effect in one line; works without open()."""
        return ""

    def diagnosis(self) -> tuple[str, ...]:
        """Faults and warnings, worst first."""
        return ()
