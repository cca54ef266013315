"""Feedback to the operator through the device's light and its motor.

Rumble is for devices without force feedback: Łukawski, Victores and Balaguer 2023 name it for the
Wiimote. Strength 0..1; the driver renders it as its motor can.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from cardan.common import bounds
from cardan.common.options import Options
from cardan.spatial import norm
from cardan.types import DeviceFeedback, RobotState

FEEDBACK_PERIOD_S = 0.05
"""Shortest time between changes: a motor needs 50 ms to start and to stop."""

RENEW_S = 0.4
"""Period of repeating a lasting rumble: drivers end it by themselves after 1 s without."""

TRIP_PULSE_S = 0.5
"""Duration of the rumble after a trip."""

LIMIT_LEVEL = 0.4

LEAD_FROM = 0.3
"""Share of the maximum lead below which nothing rumbles: gravity sag and servo lag reach that
much."""

STEP = 0.05
"""Smallest change of strength that is sent."""

RumbleSource = Literal["trip", "limit", "max_lead", "force", "network"]


@dataclass(frozen=True, kw_only=True)
class FeedbackOptions(Options):
    """``[feedback]``: light and rumble of the operator device."""

    led: bool = True
    """The device's light is on while teleoperation is engaged."""
    rumble: tuple[RumbleSource, ...] = ("trip", "limit", "network")
    """Causes of rumble: trip, teleoperation was disengaged; limit, the end of the workspace or the
    arm's range; max_lead, the lag of the robot; force, the measured force; network, requests on
    `joy/set_feedback`. The strongest counts."""
    full_force_n: Annotated[float, bounds.ROBOT_FORCE_N] = 20.0
    """Measured force that rumbles at full strength."""


class ArmFeedback(NamedTuple):
    """State of the arm for feedback."""

    engaged: bool
    """True while teleoperation is engaged."""
    trips: int
    """Count of disengagements by a watchdog or fault."""
    limited: bool
    """True if the operator requests a motion beyond the workspace or the arm's range."""
    lead_used: float
    asked: float = 0.0
    """Level requested from the network, 0..1."""


class OperatorFeedback:
    """Chooses the feedback; `channels` are the device's."""

    def __init__(self, options: FeedbackOptions, channels: Collection[str]) -> None:
        self._sources = options.rumble if "rumble" in channels else ()
        self._led_wanted = options.led and "led" in channels
        self._full_force_n = options.full_force_n
        self._led: bool | None = None
        self._rumble = 0.0
        self._due_s = self._renewed_s = self._tripped_s = float("-inf")
        self._trips = 0

    @property
    def useful(self) -> bool:
        """False if the device has no light or motor to use."""
        return bool(self._sources) or self._led_wanted

    def due(self, now_s: float) -> bool:
        """Return whether `update` may have something new."""
        return now_s >= self._due_s

    def update(
        self, arm_feedback: ArmFeedback, robot: RobotState, now_s: float
    ) -> DeviceFeedback | None:
        """Return the feedback to send now; None if nothing is new."""
        self._due_s = now_s + FEEDBACK_PERIOD_S
        led = rumble = None
        if self._led_wanted and arm_feedback.engaged is not self._led:
            led = self._led = arm_feedback.engaged
        if self._sources:
            level = self._level(arm_feedback, robot, now_s)
            changed = abs(level - self._rumble) >= STEP or (level == 0.0) is not (
                self._rumble == 0.0
            )
            if changed or (level > 0.0 and now_s - self._renewed_s >= RENEW_S):
                rumble = self._rumble = level
                self._renewed_s = now_s
        return None if led is None and rumble is None else DeviceFeedback(led, rumble)

    def last(self) -> DeviceFeedback | None:
        """Return the feedback that turns light and motor off at the end; None if both are off."""
        led = False if self._led else None
        rumble = 0.0 if self._rumble > 0.0 else None
        self._led, self._rumble = (False if led is not None else self._led), 0.0
        return None if led is None and rumble is None else DeviceFeedback(led, rumble)

    def _level(self, arm_feedback: ArmFeedback, robot: RobotState, now_s: float) -> float:
        if arm_feedback.trips != self._trips:
            self._trips, self._tripped_s = arm_feedback.trips, now_s
        level = 0.0
        sources = self._sources
        if "trip" in sources and now_s - self._tripped_s < TRIP_PULSE_S:
            return 1.0
        if "limit" in sources and arm_feedback.limited:
            level = LIMIT_LEVEL
        if "max_lead" in sources:
            level = max(level, (arm_feedback.lead_used - LEAD_FROM) / (1.0 - LEAD_FROM))
        if "force" in sources and robot.wrench is not None:
            level = max(level, norm(robot.wrench.force) / self._full_force_n)
        if "network" in sources:
            level = max(level, arm_feedback.asked)
        return min(1.0, level)
