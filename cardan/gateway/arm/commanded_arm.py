"""Commanded state of a robot: carries out motions and computes the robot's commands.

A robot whose arm has a model is moved joint by joint (:mod:`cardan.gateway.arm.joint_space_arm`);
one that is sent poses and has no model moves as a free pose.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from cardan.gateway.motion.speed_limited_reference import Reference, ReferenceLimits
from cardan.gateway.servo.status import ServoStatus
from cardan.spatial import (
    add,
    dot,
    is_finite,
    limit_norm,
    moved,
    norm,
    normalized,
    rotation_between,
    scale,
    subtract,
    turned_by,
)
from cardan.types import (
    IDENTITY_POSE,
    ZERO3,
    ZERO_TWIST,
    CommandKind,
    Frame,
    Pose,
    PoseCommand,
    RobotCommand,
    RobotState,
    Twist,
    Vector3,
)

FARTHEST_M = 100.0
"""Largest plausible distance of a TCP from its base, the longest gantries included."""

FASTEST_TCP_M_S = 5.0
FASTEST_TCP_RAD_S = 15.0
"""Largest plausible speed of an industrial arm's TCP, also when a person pushes it. A faster
reading is wrong, or belongs to another tool or frame."""

READING_NOISE_M, READING_NOISE_RAD = 0.01, 0.05
"""Tolerance added to the distance at that speed: a reading may be late, and the next one early."""

SHORTEST_S = 1e-4
"""Shortest time between two readings from which a speed is computed."""

APPROACH_TIME_S = 0.2
"""Time constant with which a command is brought back to a robot that did not follow it."""

APPROACH_SPEED_M_S, APPROACH_SPEED_RAD_S = 0.05, 0.3
"""Highest TCP speed of a motion that no operator asks for (invariant 5 of the design)."""

_new = tuple.__new__
"""Makes a named tuple in half the time of its constructor, for those of every cycle."""

_BASE, _POSE = Frame.BASE, CommandKind.POSE
"""A look-up of an enum's member takes longer than what is done with it in a cycle."""


class FollowingError(NamedTuple):
    """Distance between a robot and its command."""

    linear_m: float
    angular_rad: float
    joint_error: float = 0.0
    """Error of the worst joint: rad, or m for a prismatic one; 0 without an arm's model."""
    joint: str = ""
    """That joint's name."""

    def exceeds(self, limit: FollowingError, share: float = 1.0) -> bool:
        """Return whether one of the three is larger than `share` of its value in `limit`."""
        return (
            self.linear_m > share * limit.linear_m
            or self.angular_rad > share * limit.angular_rad
            or self.joint_error > share * limit.joint_error
        )

    def in_words(self, relation: str) -> str:
        """Return a message such as "the robot is 12 mm and 0.10 rad behind its reference (joint_2
        by 0.10)"."""
        if not self.linear_m and not self.angular_rad and self.joint:
            away = f"{self.joint_error:.3f} rad {relation}"
            return f"{self.joint} is {away} where it was commanded to be"
        joint = f" ({self.joint} by {self.joint_error:.2f})" if self.joint else ""
        return (
            f"the robot is {self.linear_m * 1e3:.0f} mm and {self.angular_rad:.2f} rad {relation} "
            f"its reference{joint}"
        )


def equal_steps(dt_s: float, longest_s: float) -> list[float]:
    """`dt_s` in equal steps of at most `longest_s`; none where no time has passed."""
    if dt_s <= 0.0:
        return []
    count = max(1, math.ceil(dt_s / longest_s - 1e-9))
    return [dt_s / count] * count


class CommandedArm(ABC):
    """The commanded state of one robot, moved one control period at a time."""

    placed = False
    """True since the first `place`."""
    longest_step_s = math.inf
    """Longest period for `follow` and `brake`."""

    @property
    @abstractmethod
    def pose(self) -> Pose:
        """Commanded TCP pose, base frame. Only once placed."""

    @property
    def tool(self) -> Pose:
        """The commanded TCP in the arm's own; the identity where no model tells them apart."""
        return IDENTITY_POSE

    @property
    @abstractmethod
    def twist(self) -> Twist:
        """Velocity of the commanded TCP in the last period, base axes."""

    @property
    @abstractmethod
    def moving(self) -> bool:
        """True until the commanded motion is at rest."""

    @property
    @abstractmethod
    def settled(self) -> bool:
        """True if the rest of the motion can be stopped within one period."""

    @abstractmethod
    def obstacle(self, state: RobotState, new: bool) -> str:
        """Return why the robot cannot be commanded in this state; empty when it can. `new`: the
        robot was not commanded before, so tool and model are compared as well."""

    def place_neighbor(self, index: int, joints: Sequence[float], ways_m: Sequence[float]) -> None:
        """Keep away from neighbor number `index`, whose joints are at `joints` (rad or m) and whose
        bodies may each move by `ways_m`. Only an arm's model has neighbors."""
        raise IndexError(f"there is no neighbor {index}")

    @abstractmethod
    def measured(self, state: RobotState) -> Pose:
        """Measured TCP pose, base frame; for a robot that lags, the pose that it will have caught
        up with."""

    @abstractmethod
    def reported(self, state: RobotState) -> Pose | None:
        """TCP pose as the robot reports it now, base frame."""

    @abstractmethod
    def jump(self, before: RobotState, state: RobotState, time_s: float) -> str:
        """Message about a motion within `time_s` that is longer than an arm can make; empty if
        none."""

    @abstractmethod
    def place(
        self, state: RobotState, before: RobotState | None = None, time_s: float = 0.0
    ) -> None:
        """Start from the measured position, at rest. With `before`, the state `time_s` ago, start
        at the robot's speed since then, at most the one commanded last and only in its direction:
        to be braked from."""

    @abstractmethod
    def following_error(
        self, state: RobotState, reference: Reference | None, observe: bool = False
    ) -> FollowingError:
        """Return the distance between robot and command; the TCP's part if a `reference` observes
        it. `observe`: give the reference, if it is placed, the measured TCP first."""

    @abstractmethod
    def follow(
        self,
        reference: Reference,
        dt_s: float,
        rates: Mapping[str, float] | None = None,
        slide: bool = True,
    ) -> float:
        """Move for `dt_s` with the reference's twist, and the reference as far as that is possible.
        `rates`: wanted speeds of joints by name, rad/s or m/s, in addition. With `slide` an
        obstacle takes away only the part of the twist that points into it. Return the share of the
        wanted speed that was possible."""

    @abstractmethod
    def brake(self, dt_s: float) -> None:
        """Slow down as fast as limits allow."""

    @abstractmethod
    def halt(self) -> None:
        """Set the commanded motion to rest at once: the robot obeys no command any more."""

    @abstractmethod
    def approach(self, state: RobotState, dt_s: float) -> None:
        """Move slowly towards the measured position."""

    @abstractmethod
    def command(
        self, state: RobotState, dt_s: float, approaching: bool = False, blind: bool = False
    ) -> RobotCommand:
        """Return the robot's command for this period of `dt_s`.

        `approaching`: keep the robot from following the motion. `blind`: the measurements in
        `state` are ignored.
        """

    def status(self) -> ServoStatus | None:
        """Numbers of the servo's last tick; None without an arm's model."""
        return None

    def held_by(self) -> str:
        """Reason why the arm does not continue; empty when none is known."""
        return ""


class TaskSpaceArm(CommandedArm):
    """The TCP of a robot that is sent poses: moves freely within the reference's limits."""

    def __init__(self, limits: ReferenceLimits) -> None:
        self.limits = limits
        self._pose = IDENTITY_POSE
        self._twist = ZERO_TWIST

    @property
    def pose(self) -> Pose:
        return self._pose

    @property
    def twist(self) -> Twist:
        return self._twist

    @property
    def moving(self) -> bool:
        return self._twist != ZERO_TWIST

    @property
    def settled(self) -> bool:
        return True

    def obstacle(self, state: RobotState, new: bool) -> str:
        pose = state.pose
        if pose is None:
            return "the robot reports no pose"
        (x, y, z), (w, i, j, k), _ = pose
        # A single comparison for all: a NaN is not below anything.
        if x * x + y * y + z * z + w * w + i * i + j * j + k * k < FARTHEST_M * FARTHEST_M:
            return ""
        if not is_finite((x, y, z, w, i, j, k)):
            return "the robot reports a pose that is not numbers"
        return f"the robot reports a TCP {norm(pose.position):.3g} m away, farther than any reach"

    def measured(self, state: RobotState) -> Pose:
        assert state.pose is not None
        return state.pose

    def reported(self, state: RobotState) -> Pose | None:
        return state.pose

    def jump(self, before: RobotState, state: RobotState, time_s: float) -> str:
        if before.pose is None or state.pose is None:
            return ""
        (x, y, z), (w, i, j, k), _ = state.pose
        (u, v, s), (a, b, c, d), _ = before.pose
        x, y, z = x - u, y - v, z - s
        farthest_m = READING_NOISE_M + FASTEST_TCP_M_S * time_s
        half_rad = 0.5 * (READING_NOISE_RAD + FASTEST_TCP_RAD_S * time_s)
        # The cosine of half the angle, by its series, which is accurate enough.
        if (
            x * x + y * y + z * z <= farthest_m * farthest_m
            and abs(w * a + i * b + j * c + k * d) >= 1.0 - 0.5 * half_rad * half_rad
        ):
            return ""
        way_m = norm(subtract(state.pose.position, before.pose.position))
        turn_rad = norm(rotation_between(before.pose.orientation, state.pose.orientation))
        return (
            f"the measured pose jumped by {way_m * 1e3:.0f} mm and {turn_rad:.2f} rad in "
            f"{time_s * 1e3:.0f} ms"
        )

    def place(
        self, state: RobotState, before: RobotState | None = None, time_s: float = 0.0
    ) -> None:
        measured = self.measured(state)
        last, self._twist = self._twist, ZERO_TWIST
        self._pose = Pose(measured.position, normalized(measured.orientation), Frame.BASE)
        self.placed = True
        if (
            before is None
            or before.pose is None
            or time_s < SHORTEST_S
            or self.jump(before, state, time_s)
        ):
            return
        way = scale(subtract(measured.position, before.pose.position), 1.0 / time_s)
        turn = scale(rotation_between(before.pose.orientation, measured.orientation), 1.0 / time_s)
        self._twist = Twist(_along(way, last.linear), _along(turn, last.angular), Frame.BASE)

    def following_error(
        self, state: RobotState, reference: Reference | None, observe: bool = False
    ) -> FollowingError:
        if reference is None:
            return FollowingError(0.0, 0.0)
        if observe and reference.pose is not None:
            reference.observe(self.measured(state))
        return _new(FollowingError, (reference.ahead_m, reference.ahead_rad, 0.0, ""))

    def follow(
        self,
        reference: Reference,
        dt_s: float,
        rates: Mapping[str, float] | None = None,
        slide: bool = True,
    ) -> float:
        linear, angular = reference.linear, reference.angular
        assert reference.pose is not None
        self._pose = reference.pose = moved(reference.pose, linear, angular, dt_s)
        self._twist = _new(Twist, (linear, angular, _BASE))
        return 1.0

    def brake(self, dt_s: float) -> None:
        self._approach(ZERO_TWIST, dt_s)

    def halt(self) -> None:
        self._twist = ZERO_TWIST

    def approach(self, state: RobotState, dt_s: float) -> None:
        pose, measured = self._pose, self.measured(state)
        way = scale(subtract(measured.position, pose.position), 1.0 / APPROACH_TIME_S)
        turn = scale(
            rotation_between(pose.orientation, measured.orientation), 1.0 / APPROACH_TIME_S
        )
        self._approach(
            Twist(limit_norm(way, APPROACH_SPEED_M_S), limit_norm(turn, APPROACH_SPEED_RAD_S)), dt_s
        )

    def _approach(self, wanted: Twist, dt_s: float) -> None:
        pose, twist, limits = self._pose, self._twist, self.limits
        most_m_s = limits.linear_acceleration_m_s2 * dt_s
        most_rad_s = limits.angular_acceleration_rad_s2 * dt_s
        linear = add(twist.linear, limit_norm(subtract(wanted.linear, twist.linear), most_m_s))
        angular = add(
            twist.angular, limit_norm(subtract(wanted.angular, twist.angular), most_rad_s)
        )
        self._twist = Twist(linear, angular, Frame.BASE)
        self._pose = Pose(
            add(pose.position, scale(linear, dt_s)),
            turned_by(pose.orientation, scale(angular, dt_s)),
            Frame.BASE,
        )

    def command(
        self, state: RobotState, dt_s: float, approaching: bool = False, blind: bool = False
    ) -> RobotCommand:
        return _new(PoseCommand, (self._pose, self._twist, (), _POSE))


def _along(velocity: Vector3, commanded: Vector3) -> Vector3:
    """The part of `velocity` along `commanded`, no faster than that."""
    fastest = norm(commanded)
    if fastest == 0.0:
        return ZERO3
    share = dot(velocity, commanded) / (fastest * fastest)
    return scale(commanded, min(1.0, max(0.0, share)))
