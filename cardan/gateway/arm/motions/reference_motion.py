"""Motions in which the TCP follows a reference point: by an operator, by a stream, to rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from cardan.gateway.arm.commanded_arm import CommandedArm
from cardan.gateway.arm.motions.base import ARRIVED, GOING, CommandedMotion, Deceleration, Progress
from cardan.gateway.motion.speed_limited_reference import Reference, ReferenceLimits
from cardan.types import ZERO3, ZERO_TWIST, RobotState


class ReferenceMotion(CommandedMotion):
    """Motion of a TCP that follows a reference point, beginning at its commanded position."""

    slides = True
    """True if an obstacle leaves the part of the motion along its surface."""
    wanted = ZERO_TWIST
    """Twist that it approaches while it does not brake."""
    rates: Mapping[str, float] | None = None
    """Joint speeds wanted in addition, rad/s or m/s; None: none."""
    smooth = True
    """True if its jerk is limited while it does not brake."""

    def __init__(
        self,
        commanded: CommandedArm,
        reference: Reference,
        deceleration: Deceleration | None = None,
    ) -> None:
        """`deceleration`: for stops, if higher than the reference's own acceleration."""
        self._commanded = commanded
        self.reference: Reference = reference
        if not commanded.moving:
            reference.place(commanded.pose)
        self._stopping: ReferenceLimits | None = None
        """Its limits while it brakes; None: the usual ones."""
        if deceleration is not None:
            limits = reference.limits
            self._stopping = replace(
                limits,
                linear_acceleration_m_s2=max(
                    deceleration.linear_m_s2, limits.linear_acceleration_m_s2
                ),
                angular_acceleration_rad_s2=max(
                    deceleration.angular_rad_s2, limits.angular_acceleration_rad_s2
                ),
                linear_jerk_m_s3=None,
                angular_jerk_rad_s3=None,
            )
        self.braking = False
        self._resting = False
        self.share = 1.0
        """Share of the wanted speed that the arm reached in the last tick."""

    def brake(self) -> None:
        """Ramp to zero speed."""
        self.braking = True
        if self._stopping is not None:
            self.reference.limits = self._stopping

    @property
    def idle(self) -> bool:
        return not self.driven and not self.reference.moving and not self._commanded.moving

    def tick(self, robot: RobotState, dt_s: float) -> Progress:
        """Move reference and arm for `dt_s`; it ends once the arm has braked to rest."""
        commanded, reference, rates = self._commanded, self.reference, self.rates
        if self._resting:
            commanded.brake(dt_s)
            return GOING if commanded.moving else ARRIVED
        if (
            reference.linear == reference.angular == ZERO3
            and (self.braking or self.wanted == ZERO_TWIST)
            and not rates
            and (not (moving := commanded.moving) or commanded.settled)
        ):
            # Without a request nothing is solved: no creeping on rounding errors.
            if moving:
                commanded.brake(dt_s)
            self._resting = self.braking
            return GOING
        if self.braking:
            reference.shape(ZERO_TWIST, dt_s, smooth=False)
            rates = None
        else:
            reference.shape(self.wanted, dt_s, self.smooth)
        self.share = commanded.follow(reference, dt_s, rates, self.slides)
        if self.braking and not reference.moving:
            self._resting = True
        return GOING


class FollowOperator(ReferenceMotion):
    """Moves the TCP by the newest request of an operator device."""

    follows_operator = True

    @property
    def driven(self) -> bool:
        return self.wanted != ZERO_TWIST or self.rates is not None


class Brake(ReferenceMotion):
    """Ramps the TCP from its present speed to rest within the reference's limits."""

    def __init__(self, commanded: CommandedArm, reference: Reference) -> None:
        super().__init__(commanded, reference)
        reference.place(commanded.pose)
        twist = commanded.twist
        reference.linear, reference.angular = twist.linear, twist.angular
        self.brake()

    @property
    def idle(self) -> bool:
        return False


class FollowTwistStream(ReferenceMotion):
    """Streamed twists."""

    @property
    def driven(self) -> bool:
        return self.wanted != ZERO_TWIST and not self.braking
