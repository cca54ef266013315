"""Supervision of a robot: all checks that stop an arm. Once a tick, before any request, `look`
checks the robot's reports: does it act on commands, did its position jump, does it follow? The
result is one :class:`StopReason`, the gravest; the controller acts on it in one place. The operator
device is judged by its own source (:mod:`cardan.gateway.operator.input`), the streams by their
silence limit. All by local monotonic time."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

from cardan.common import bounds
from cardan.common.options import CODE_ONLY, Options
from cardan.gateway.arm.commanded_arm import CommandedArm, FollowingError
from cardan.gateway.arm.motions.base import CommandedMotion
from cardan.gateway.motion.speed_limited_reference import Reference
from cardan.types import NEVER_S, RobotLink, RobotState

LONGEST_STEP_PERIODS = 2.5
"""Periods of the robot by which one tick advances at most. A datagram that is lost, or two that
come at once, are made up for: the robot itself went on meanwhile; time beyond that is lost."""

JOINT_ERROR = bounds.Range(
    0.0,
    1.5,
    "rad or m",
    "a joint a quarter turn off is not following",
    above=True,
)
TRUST_AFTER_S = 0.5
"""Time for which readings must have been plausible before a confirmation accepts them again."""

_LIVE = RobotLink.LIVE
"""A look-up of an enum's member takes longer than what is done with it in a cycle."""


@dataclass(frozen=True, kw_only=True)
class Watchdogs(Options):
    """``[watchdogs]``: limits on age and error; each trips into a braking ramp. All by local
    monotonic time."""

    device_age_s: Annotated[float, bounds.BLIND_S] = 0.1
    """Oldest report that may still drive motion: six missed reports of a 62 Hz device."""
    stall_s: Annotated[float, bounds.BLIND_S] = field(default=0.1, metadata=CODE_ONLY)
    """Longest time between two ticks: after more, the robot may have moved."""
    following_error_m: Annotated[float, bounds.MAX_LEAD_M] = 0.1
    """Distance between reference and robot beyond which the arm counts as held by something else.
    """
    following_error_rad: Annotated[float, bounds.MAX_LEAD_RAD] = 0.6
    following_error_joint: Annotated[float, JOINT_ERROR] = field(default=0.5, metadata=CODE_ONLY)
    """Difference between commanded and measured joints if joints are commanded, rad or m. At the
    full speed of an arm's wrist a position loop lags by 0.3 rad."""
    heartbeat_s: Annotated[float, bounds.BLIND_S] = field(default=0.5, metadata=CODE_ONLY)
    """Longest silence of the process that supervises a session."""
    recovery: bool = True
    """Bring a command back to a robot that did not follow it, slowly and within the maximum lead.
    """

    def error_limit(self) -> FollowingError:
        """The following error that trips."""
        return FollowingError(
            self.following_error_m, self.following_error_rad, self.following_error_joint
        )


class Cause(enum.Enum):
    """Finding of a check of the robot."""

    FIRST = "the robot is ready for the first time"
    LOST = "the controller fell silent"
    NOT_READY = "the controller is heard, but does not act on commands, or reports nonsense"
    RETURNED = "the robot is ready again"
    NEW_SESSION = "the controller started a new session"
    STALLED = "no state came in time, though the robot is heard"
    JUMPED = "the measured position is implausible"
    ALARM = "the driver reports an alarm: the robot must not be driven"
    HELD = "the robot is not where it is commanded to be"
    SILENT = "the source of the stream fell silent"


class StopReason(NamedTuple):
    """Reason to stop the arm, with the text for the operator."""

    cause: Cause
    reason: str


class Supervision:
    """Watches one robot from tick to tick."""

    def __init__(self, watchdogs: Watchdogs, period_s: float = 0.0) -> None:
        """`period_s` is the robot's own; 0: unknown."""
        self.watchdogs = watchdogs
        self._period_s = period_s
        self._longest_step_s = LONGEST_STEP_PERIODS * period_s if period_s > 0.0 else math.inf
        self.limit = watchdogs.error_limit()
        self.error = FollowingError(0.0, 0.0)
        """Following error of the last tick in which the robot was ready."""
        self.implausible = ""
        """Why the measured position is implausible; empty while it is plausible."""
        self.newest: RobotState | None = None
        """The newest state whose reading was checked."""
        self.previous: RobotState | None = None
        """The state before it."""
        self.acted = True
        """True if the robot executed commands continuously from `previous` to `newest`."""
        self.gap_s = 0.0
        """Time between the last two ticks."""
        self.step_s = 0.0
        """Time by which this tick advances, without lost time."""
        self._ticked_s = NEVER_S
        self._session: int | None = None
        self.ready = False
        """True if the newest state is of a robot that acts on commands."""
        self._not_acting = False
        """True if the robot has reported since `newest` that commands do not act."""
        self._plausible_s = NEVER_S
        """Time since when readings have not jumped."""

    @property
    def trustworthy(self) -> bool:
        """Return whether rejected readings have been plausible for long enough."""
        return self._ticked_s - self._plausible_s >= TRUST_AFTER_S

    def trust(self) -> None:
        """Accept the readings again, after re-arming."""
        self.implausible = ""

    def look(self, state: RobotState, commanded: CommandedArm) -> StopReason | None:
        """Return the gravest finding about this state before it is compared with the command; None
        when all is well."""
        stamp_s, period_s, hold_reason = state.stamp_s, state.period_s, state.hold_reason
        self.gap_s, self._ticked_s = stamp_s - self._ticked_s, stamp_s
        if 0.0 < period_s < math.inf:
            longest_s = self._longest_step_s
            self.step_s = period_s if period_s < longest_s else longest_s
        else:
            # A robot whose clock stands still goes on moving, and is braked by the local clock.
            self.step_s = max(0.0, min(self._period_s, self.gap_s))
        new_session = state.session != self._session
        began, self.ready = not self.ready, False
        live = state.link is _LIVE
        self._not_acting = self._not_acting or not live or bool(hold_reason)
        if not live:
            return StopReason(Cause.LOST, hold_reason or f"the robot is {state.link.value}")
        wrong = hold_reason or commanded.obstacle(state, new_session or began)
        if wrong:
            if new_session and self._session is not None:
                return StopReason(Cause.NEW_SESSION, wrong)
            return StopReason(Cause.NOT_READY, wrong)
        self.ready = True
        first, self._session = self._session is None, state.session
        self.previous = before = self.newest
        self.newest = state
        self.acted, self._not_acting = not self._not_acting, False
        if new_session:
            self.implausible = ""
            self._plausible_s = stamp_s
            return StopReason(Cause.FIRST if first else Cause.NEW_SESSION, "")
        if before is not None:
            # The longer of the two clocks: a state that waited in a queue was measured earlier.
            time_s = stamp_s - before.stamp_s
            if period_s > time_s:
                time_s = period_s
            if time_s < 0.0:
                time_s = 0.0
            jump = commanded.jump(before, state, time_s)
            if jump:
                self._plausible_s = stamp_s
                self.implausible = jump
                return StopReason(Cause.JUMPED, jump)
        if began:
            return StopReason(Cause.RETURNED, "")
        if self.gap_s > self.watchdogs.stall_s:
            stood = f"this computer or the network stalled for {self.gap_s:.1f} s"
            return StopReason(Cause.STALLED, stood)
        return None

    def compare(
        self,
        state: RobotState,
        commanded: CommandedArm,
        own: Reference | None,
        motion: CommandedMotion | None,
        engaged: bool,
    ) -> StopReason | None:
        """Give the measured TCP to the reference for comparison: that of `motion`, or without a
        motion the arm's `own`; None if only joints count. Return the gravest finding about an
        `engaged` robot and its commands, None without any."""
        reference = own if motion is None else motion.reference
        error = commanded.following_error(state, reference, observe=True)
        if not engaged:
            return None
        self.error = error
        if error.exceeds(self.limit):
            held = f"{error.in_words('away from')}: something else holds it"
            return StopReason(Cause.HELD, held)
        if state.alarm:
            return StopReason(Cause.ALARM, state.alarm)
        if motion is not None:
            age_s = state.stamp_s - motion.heard_s
            if age_s > motion.silence_s and motion.driven:
                return StopReason(Cause.SILENT, f"the stream was silent for {age_s:.3f} s")
        return None
