"""What moves the commanded joints, one control period at a time. Every motion starts at rest.

All of them act through the servo, so that position, speed and acceleration of every joint stay
inside limits whatever the motion wants. A path is followed by a clock of its own: it runs slower
where the arm cannot keep up, and braking slows it to a stop, so the TCP stops on its path.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from cardan.errors import MotionRefusedError
from cardan.gateway.arm.codes import State
from cardan.gateway.arm.planner import Line
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import FloatArray, Kinematics, to_pose, to_se3
from cardan.gateway.motion.reference import Reference, ReferenceLimits
from cardan.gateway.motion.shaping import PoseShaper
from cardan.gateway.servo.servo import Servo
from cardan.robots import ArmModel
from cardan.spatial import (
    add,
    dot,
    from_rotation_vector,
    limit_norm,
    multiply,
    norm,
    normalized,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import (
    NEVER_S,
    ZERO3,
    ZERO_TWIST,
    Frame,
    Pose,
    TorqueCommand,
    Twist,
    Vector3,
    Wrench,
)

SETTLE_S = 1.0
"""Longest time for the last fraction of a millimetre."""

ARRIVED_RAD = 1e-5
"""A joint motion has arrived when no joint is farther off, rad or m."""

AT_REST_RAD_S = 2e-4
"""All joints slower than this can stop within one period."""

TOLERANCE_M = 1e-3
TOLERANCE_RAD = 5e-3
"""A line that ends farther from its goal than this has failed."""

STUCK_SHARE = 0.01
"""Of the wanted speed: an arm that gets no more than this is stuck."""

STUCK_S = 0.5
"""For which it has to last."""

RESTING_M_S = 1e-6
"""Or rad/s: what rounding leaves of a reference at rest."""

VELOCITY_TIME_S = 0.1
"""Time constant of the velocity that streamed poses are predicted by: noise of single poses must
not be thrown forward."""

LONGEST_BETWEEN_S = 0.3
"""Poses farther apart in time have no velocity in common."""

HELD_SHARE = 0.95
"""Of the wanted speed: a reference whose arm gets less goes on from what it got."""


class Deceleration(NamedTuple):
    """Of a braking ramp."""

    linear_m_s2: float
    angular_rad_s2: float
    joint_share: float
    """Of the acceleration of each joint."""


class Progress(NamedTuple):
    """How a motion stands after a tick."""

    over: bool
    reason: str = ""
    """Why it did not arrive; empty when it did, or goes on."""


GOING = Progress(False)
ARRIVED = Progress(True)


class Activity(Protocol):
    """A motion that the servo carries out."""

    state: State

    def tick(self, dt_s: float) -> Progress:
        """Move on by one period."""

    def brake(self) -> None:
        """Come to rest from now on; `tick` says when that is done."""


class PathClock:
    """The time of a path, s, which runs at 0 to 1 times real time."""

    def __init__(self, duration_s: float) -> None:
        self.duration_s = duration_s
        self.time_s = 0.0
        self._rate, self._decay_1_s = 1.0, 0.0
        self._stuck_s = 0.0

    @property
    def braking(self) -> bool:
        """True once it was told to stop."""
        return self._decay_1_s > 0.0

    @property
    def over(self) -> bool:
        """True at the end of the path, or where it was stopped."""
        return self.time_s >= self.duration_s or self._rate <= 0.0

    @property
    def stuck(self) -> bool:
        """True when nothing went on for `STUCK_S` although it should."""
        return self._stuck_s >= STUCK_S

    def brake(self, time_s: float) -> None:
        """Stop within `time_s`."""
        if not self.braking:
            self._decay_1_s = self._rate / max(time_s, 1e-6)

    def next_step(self, dt_s: float) -> float:
        """How much of the path's time the next period should take."""
        self._rate = max(0.0, self._rate - self._decay_1_s * dt_s)
        return min(self._rate * dt_s, self.duration_s - self.time_s)

    def advance(self, step_s: float, share: float, dt_s: float) -> None:
        """The period went by, and `share` of the step could be done."""
        self.time_s += share * step_s
        if self.duration_s - self.time_s < 1e-9:
            self.time_s = self.duration_s
        slow = step_s > 0.0 and share < STUCK_SHARE
        self._stuck_s = self._stuck_s + dt_s if slow else 0.0


class Braking:
    """Brings every joint to rest as fast as it can."""

    state = State.NOT_CONTROLLING

    def __init__(self, servo: Servo) -> None:
        self._servo = servo

    def tick(self, dt_s: float) -> Progress:
        """Brake on."""
        self._servo.brake(dt_s)
        return GOING if self._servo.moving else ARRIVED

    def brake(self) -> None:
        """It does."""


class JointMotionPath(Protocol):
    """What a joint motion follows."""

    @property
    def duration_s(self) -> float:
        """Time until rest, s."""

    def at(self, t_s: float, /) -> tuple[FloatArray, FloatArray]:
        """Joint positions and velocities at `t_s` since the start; the next call may reuse them."""


class FollowJoints:
    """movj and relj: all joints along one path variable."""

    state = State.MOVJ

    def __init__(self, servo: Servo, path: JointMotionPath, deceleration: Deceleration) -> None:
        self._servo, self._path = servo, path
        self._clock = PathClock(path.duration_s)
        self._slowing = deceleration.joint_share * servo.kinematics.acceleration
        self._resting = False
        self._over_s = 0.0
        self._reason = ""

    def brake(self) -> None:
        """Stop along the path."""
        velocity = np.abs(self._path.at(self._clock.time_s)[1])
        self._clock.brake(float((velocity / self._slowing).max()))

    def tick(self, dt_s: float) -> Progress:
        """Move on by one period."""
        servo, clock = self._servo, self._clock
        if self._resting:
            servo.brake(dt_s)
            return GOING if servo.moving else Progress(True, self._reason)
        step_s = clock.next_step(dt_s)
        goal = self._path.at(clock.time_s)[0].copy()
        rate = (self._path.at(clock.time_s + step_s)[0] - goal) / dt_s
        share = servo.tick_joints(goal, rate, dt_s)
        clock.advance(step_s, share, dt_s)
        if clock.over:
            self._over_s += dt_s
            off = float(np.abs(self._path.at(clock.time_s)[0] - servo.q).max())
            if off < ARRIVED_RAD or self._over_s > SETTLE_S:
                self._resting = True
                if off > TOLERANCE_RAD and not clock.braking:
                    self._reason = f"a joint came to rest {off:.4f} rad away from its goal"
        elif clock.stuck and not clock.braking:
            self._reason = _stuck(servo, clock.time_s / clock.duration_s)
            self._resting = True
        return GOING


class FollowLine:
    """movl: the TCP along a line."""

    state = State.MOVL

    def __init__(
        self,
        servo: Servo,
        path: Line,
        followed: npt.NDArray[np.bool_],
        deceleration: Deceleration,
    ) -> None:
        """`followed` (6): directions that the arm follows, x y z rx ry rz along TCP axes."""
        self._servo, self._path = servo, path
        self._followed = followed
        self._deceleration = deceleration
        self._clock = PathClock(path.duration_s)
        self._twist = np.zeros((2, 3))
        self._resting = False
        self._over_s = 0.0
        self._reason = ""

    def brake(self) -> None:
        """Stop along the line."""
        twist = self._path.at(self._clock.time_s)[1]
        self._clock.brake(
            max(
                norm(twist.linear) / self._deceleration.linear_m_s2,
                norm(twist.angular) / self._deceleration.angular_rad_s2,
            )
        )

    def tick(self, dt_s: float) -> Progress:
        """Move on by one period."""
        servo, clock = self._servo, self._clock
        if self._resting:
            servo.brake(dt_s)
            return GOING if servo.moving else Progress(True, self._reason)
        step_s = clock.next_step(dt_s)
        here = self._path.at(clock.time_s)[0]
        there = self._path.at(clock.time_s + step_s)[0]
        gain = 1.0 / dt_s
        self._twist[0] = scale(subtract(there.position, here.position), gain)
        self._twist[1] = scale(rotation_between(here.orientation, there.orientation), gain)
        share = servo.tick(to_se3(here), self._twist, dt_s)
        clock.advance(step_s, share, dt_s)
        if clock.over:
            self._over_s += dt_s
            if self._over_s > SETTLE_S or float(np.abs(servo.v).max()) < AT_REST_RAD_S:
                self._finish()
        elif clock.stuck and not clock.braking:
            self._reason = _stuck(servo, clock.time_s / clock.duration_s)
            self._resting = True
        return GOING

    def _finish(self) -> None:
        self._resting = True
        difference = self._servo.placement.actInv(to_se3(self._path.at(self._clock.time_s)[0]))
        distance = np.linalg.norm(difference.translation[self._followed[:3]])
        angle = np.linalg.norm(pin.log3(difference.rotation)[self._followed[3:]])
        if (distance > TOLERANCE_M or angle > TOLERANCE_RAD) and not self._clock.braking:
            self._reason = (
                f"the TCP came to rest {distance * 1e3:.1f} mm and {angle:.3f} rad away from "
                "the goal"
            )


def _stuck(servo: Servo, share: float) -> str:
    status = servo.status()
    why = f"stuck after {share:.0%} of the time"
    if status.limiting_joints:
        why += f"; at a limit: {', '.join(status.limiting_joints)}"
    if status.active_pairs:
        why += f"; {' and '.join(status.nearest_pair)} are {status.distance_m * 1e3:.1f} mm apart"
    return why


class _ReferenceMotion:
    """A TCP that follows a virtual reference point."""

    state = State.NOT_CONTROLLING
    slides = False
    """Whether an obstacle leaves the part of the motion that goes along it."""

    def __init__(self, servo: Servo, limits: ReferenceLimits, deceleration: Deceleration) -> None:
        self._servo = servo
        self.reference = Reference(limits)
        self.reference.place(to_pose(servo.placement))
        self._stopping = ReferenceLimits(
            linear_speed_m_s=limits.linear_speed_m_s,
            linear_acceleration_m_s2=max(deceleration.linear_m_s2, limits.linear_acceleration_m_s2),
            angular_speed_rad_s=limits.angular_speed_rad_s,
            angular_acceleration_rad_s2=max(
                deceleration.angular_rad_s2, limits.angular_acceleration_rad_s2
            ),
            leash_m=limits.leash_m,
            leash_rad=limits.leash_rad,
            workspace_m=limits.workspace_m,
        )
        self.braking = False
        self._resting = False
        self._twist = np.zeros((2, 3))
        self.share = 1.0
        """Of the wanted speed that the arm managed in the last tick."""

    def brake(self) -> None:
        """Ramp to zero speed."""
        self.braking = True
        self.reference.limits = self._stopping

    def _advance(self, wanted: Twist, dt_s: float) -> bool:
        """Move the reference and the arm; True once it is braked to rest."""
        servo, reference = self._servo, self.reference
        if self._resting:
            servo.brake(dt_s)
            return not servo.moving
        if (
            not reference.moving
            and (self.braking or wanted == ZERO_TWIST)
            and float(np.abs(servo.v).max()) < AT_REST_RAD_S
        ):
            # Nothing is asked for, so nothing is solved for: no creeping on rounding errors.
            if servo.moving:
                servo.brake(dt_s)
            self._resting = self.braking
            return False
        reference.observe(to_pose(servo.placement))
        reference.shape(ZERO_TWIST if self.braking else wanted, dt_s, smooth=not self.braking)
        self._follow(reference.linear, reference.angular, dt_s)
        if self.braking and not reference.moving:
            self._resting = True
        return False

    def _follow(self, linear: Vector3, angular: Vector3, dt_s: float) -> None:
        """Move the arm with the reference, and the reference as far as the arm can."""
        servo, reference = self._servo, self.reference
        assert reference.pose is not None
        self._twist[0], self._twist[1] = linear, angular
        self.share = servo.tick(to_se3(reference.pose), self._twist, dt_s, slide=self.slides)
        if servo.reachable is not None:
            reference.pose = to_pose(servo.reachable)
        moved = servo.twist.tolist()
        reference.move(Vector3(*moved[0]), Vector3(*moved[1]), dt_s)


class FollowTwist(_ReferenceMotion):
    """movv: a constant twist, without end."""

    state = State.MOVV

    def __init__(
        self,
        servo: Servo,
        limits: ReferenceLimits,
        deceleration: Deceleration,
        twist: Twist,
    ) -> None:
        """`twist` in base axes."""
        super().__init__(servo, limits, deceleration)
        self.twist = twist
        self._stuck_s = 0.0
        self._reason = ""

    def tick(self, dt_s: float) -> Progress:
        """Move on by one period."""
        if self._advance(self.twist, dt_s):
            return Progress(True, self._reason)
        reference = self.reference
        if not self.braking:
            walled = reference.at_workspace_limit and norm(reference.linear) < 1e-4
            slow = self.share < STUCK_SHARE or walled
            self._stuck_s = self._stuck_s + dt_s if slow else 0.0
            if self._stuck_s > STUCK_S:
                self._reason = (
                    "the TCP is at the limit of the workspace" if walled else _blocked(self._servo)
                )
                self.brake()
        return GOING


def _blocked(servo: Servo) -> str:
    status = servo.status()
    if status.active_pairs and status.distance_m < 0.02:
        return f"{' and '.join(status.nearest_pair)} are {status.distance_m * 1e3:.1f} mm apart"
    margin = np.minimum(servo.q - servo.kinematics.lower, servo.kinematics.upper - servo.q)
    nearest = int(np.argmin(margin))
    if margin[nearest] < 0.02:
        return f"{servo.kinematics.names[nearest]} is at its limit, {servo.q[nearest]:.4f} rad"
    return "the arm cannot go on in this direction"


class FollowTwistStream(_ReferenceMotion):
    """Streamed twists."""

    slides = True

    def __init__(self, servo: Servo, limits: ReferenceLimits, deceleration: Deceleration) -> None:
        super().__init__(servo, limits, deceleration)
        self.target = ZERO_TWIST

    @property
    def driven(self) -> bool:
        """True while silence would let something go on."""
        return self.target != ZERO_TWIST and not self.braking

    def tick(self, dt_s: float) -> Progress:
        """Move on by one period."""
        return ARRIVED if self._advance(self.target, dt_s) else GOING


class FollowPoseStream(_ReferenceMotion):
    """Streamed poses: the reference chases the newest in bounded jerk, and can stop at it."""

    slides = True

    def __init__(
        self,
        servo: Servo,
        limits: ReferenceLimits,
        deceleration: Deceleration,
        shaper: PoseShaper,
        prediction_s: float = 0.0,
    ) -> None:
        """With `prediction_s` the reference goes on for so long as the last poses went, so that
        it is not a whole message late; it may pass a target that stops by what it predicted."""
        super().__init__(servo, limits, deceleration)
        self.target: Pose | None = None
        self._shaper = shaper
        self._prediction_s = prediction_s
        self._linear = self._angular = ZERO3
        self._aimed_s = NEVER_S
        self._since_s = 0.0
        assert self.reference.pose is not None
        shaper.place(self.reference.pose)

    @property
    def driven(self) -> bool:
        """True while silence would let something go on."""
        pose = self.reference.pose
        if self.target is None or self.braking or pose is None:
            return False
        reference = self.reference
        return (
            norm(reference.linear) > RESTING_M_S
            or norm(reference.angular) > RESTING_M_S
            or norm(subtract(self.target.position, pose.position)) > 1e-6
            or norm(rotation_between(pose.orientation, self.target.orientation)) > 1e-5
            or self._predicting
        )

    def aim(self, target: Pose, now_s: float) -> None:
        """Go to `target` from now on; between two that are predicted, where they lead to."""
        if self._prediction_s > 0.0 and self.target is not None:
            since_s = now_s - self._aimed_s
            if 0.0 < since_s < LONGEST_BETWEEN_S:
                share = (1.0 - math.exp(-since_s / VELOCITY_TIME_S)) / since_s
                keep = 1.0 - share * since_s
                way = subtract(target.position, self.target.position)
                turn = rotation_between(self.target.orientation, target.orientation)
                self._linear = add(scale(self._linear, keep), scale(way, share))
                self._angular = add(scale(self._angular, keep), scale(turn, share))
            elif since_s > 0.0:
                self._linear = self._angular = ZERO3
        self.target, self._aimed_s, self._since_s = target, now_s, 0.0

    @property
    def _predicting(self) -> bool:
        moving = norm(self._linear) > RESTING_M_S or norm(self._angular) > RESTING_M_S
        return moving and self._since_s < self._prediction_s

    def _predicted(self, target: Pose, dt_s: float) -> Pose:
        """Where the target is going to be, as far as that may be guessed."""
        self._since_s += dt_s
        ahead_s = min(self._since_s, self._prediction_s)
        if ahead_s <= 0.0:
            return target
        turn = from_rotation_vector(scale(self._angular, ahead_s))
        return Pose(
            add(target.position, scale(self._linear, ahead_s)),
            normalized(multiply(turn, target.orientation)),
            Frame.BASE,
        )

    def tick(self, dt_s: float) -> Progress:
        """Move on by one period."""
        reference, shaper = self.reference, self._shaper
        if self.braking or self.target is None or not self.driven:
            return ARRIVED if self._advance(ZERO_TWIST, dt_s) else GOING
        here = reference.pose
        assert here is not None
        target = self._predicted(self.target, dt_s)
        now = shaper.twist
        to_go = subtract(target.position, here.position)
        to_turn = rotation_between(here.orientation, target.orientation)
        back = dot(now.linear, to_go) < 0.0 or dot(now.angular, to_turn) < 0.0
        if back and self.share < HELD_SHARE:
            # Pushed against what holds it, the arm did not gain the speed it would have to lose.
            linear, angular = (Vector3(*row) for row in self._servo.twist.tolist())
            shaper.adopt(here, Twist(linear, angular, Frame.BASE))
        else:
            shaper.adopt(here)
        there = shaper.advance(target, dt_s)
        linear = scale(subtract(there.position, here.position), 1.0 / dt_s)
        angular = scale(rotation_between(here.orientation, there.orientation), 1.0 / dt_s)
        reference.linear, reference.angular = linear, angular
        self._follow(linear, angular, dt_s)
        return GOING


def shortest(kinematics: Kinematics, error: FloatArray) -> FloatArray:
    """Joint differences without the whole turns of continuous joints."""
    turns = 2.0 * math.pi * np.rint(error / (2.0 * math.pi))
    return np.where(kinematics.continuous, error - turns, error)


class Recover:
    """After a trip: brake, then bring the command gently back to where the arm is."""

    state = State.NOT_CONTROLLING

    TIME_CONSTANT_S = 0.3
    SPEED_RAD_S = 0.5
    GIVE_UP_S = 3.0
    """Ten time constants: an arm that has not met its command by then is held, or its joints are
    measured wrongly, and would be chased for ever."""

    def __init__(self, servo: Servo, near_rad: float) -> None:
        """Done when no joint is farther than `near_rad` from the measured one."""
        self._servo = servo
        self._near_rad = near_rad
        self.measured: FloatArray = servo.q.copy()
        self._braked = False
        self._back = False
        self._spent_s = 0.0

    def brake(self) -> None:
        """It stops by itself."""

    def tick(self, dt_s: float) -> Progress:
        """Move on by one period."""
        servo = self._servo
        if not self._braked or self._back:
            servo.brake(dt_s)
            if servo.moving:
                return GOING
            self._braked = True
            if self._spent_s > self.GIVE_UP_S:
                return Progress(True, "the arm does not come together with its command")
            return ARRIVED if self._back else GOING
        self._spent_s += dt_s
        error = shortest(servo.kinematics, self.measured - servo.q)
        if self._spent_s > self.GIVE_UP_S:
            self._back = True
            servo.brake(dt_s)
            return GOING
        if float(np.abs(error).max()) < self._near_rad:
            self._back = True
            servo.brake(dt_s)
            return GOING
        rate = np.clip(error / self.TIME_CONSTANT_S, -self.SPEED_RAD_S, self.SPEED_RAD_S)
        servo.tick_joints(servo.q.copy(), rate, dt_s)
        return GOING


class TorqueLimits(NamedTuple):
    """What torque motions may do."""

    force_n: float
    torque_nm: float
    force_slew_n_s: float
    torque_slew_nm_s: float
    speed_share: float
    """Of each joint's speed: an arm that is faster runs away."""


class TorqueMotion:
    """gcmp, forc and streamed wrenches: the arm's own weight, and a wrench on the world."""

    def __init__(
        self, state: State, model: ArmModel, kinematics: ArmKinematics, limits: TorqueLimits
    ) -> None:
        """`kinematics` (with the tool) is used in `tick` only. Raises MotionRefusedError."""
        if not any(inertia.mass_kg > 0.0 for inertia in model.inertias):
            raise MotionRefusedError(
                f"the file of {model.name} gives no masses, so its weight is not known"
            )
        self.state = state
        self.limits = limits
        self._kinematics = kinematics
        self._data = kinematics.model.createData()
        self._effort = np.array([joint.effort for joint in model.joints])
        self._fastest = limits.speed_share * kinematics.velocity
        self.target = Wrench(ZERO3, ZERO3)
        self._force, self._torque = ZERO3, ZERO3
        self._in_tcp_axes = np.zeros(6)
        self.share = 1.0
        """Of the wrench that the joints' torques allowed in the last tick."""

    @property
    def driven(self) -> bool:
        """True while silence would let a wrench go on."""
        return self.target.force != ZERO3 or self.target.torque != ZERO3

    def check_weight(self, q: FloatArray) -> None:
        """Raises MotionRefusedError where a joint cannot hold the arm's weight at `q`."""
        model = self._kinematics.model
        gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
        excess = np.abs(gravity) - self._effort
        worst = int(np.argmax(excess))
        if excess[worst] > 0.0:
            raise MotionRefusedError(
                f"{self._kinematics.names[worst]} would need {gravity[worst]:.1f} N·m to hold "
                f"the arm's weight; it has {self._effort[worst]:.1f} N·m"
            )

    def set_wrench(self, wrench: Wrench) -> None:
        """Exert `wrench` on the world; it is approached by the slew limits.

        Raises MotionRefusedError for more than is allowed.
        """
        force, torque = norm(wrench.force), norm(wrench.torque)
        if force > self.limits.force_n or torque > self.limits.torque_nm:
            raise MotionRefusedError(
                f"a wrench of {force:.1f} N and {torque:.1f} N·m is more than the "
                f"{self.limits.force_n:.1f} N and {self.limits.torque_nm:.1f} N·m allowed"
            )
        if wrench.frame is not self.target.frame:
            # Along other axes, so it starts anew.
            self._force = self._torque = ZERO3
        self.target = wrench

    def release(self) -> None:
        """No wrench from the next tick on."""
        self.target = Wrench(ZERO3, ZERO3, self.target.frame)
        self._force = self._torque = ZERO3

    def runaway(self, q: FloatArray, v: FloatArray) -> str:
        """Why the arm has to be stopped; empty while it is slow and inside its limits."""
        kinematics = self._kinematics
        for index in np.flatnonzero(np.abs(v) > self._fastest):
            return (
                f"{kinematics.names[index]} ran away at {v[index]:.2f} rad/s; "
                f"allowed: {self._fastest[index]:.2f} rad/s"
            )
        leaving = ((q >= kinematics.upper) & (v > 0.0)) | ((q <= kinematics.lower) & (v < 0.0))
        for index in np.flatnonzero(leaving):
            return f"{kinematics.names[index]} came to its limit, {q[index]:.4f} rad"
        return ""

    def tick(self, q: FloatArray, dt_s: float) -> TorqueCommand:
        """Torques for the measured joint positions `q`."""
        kinematics, limits = self._kinematics, self.limits
        target = self.target
        self._force = _slewed(self._force, target.force, limits.force_slew_n_s * dt_s)
        self._torque = _slewed(self._torque, target.torque, limits.torque_slew_nm_s * dt_s)
        gravity = pin.computeGeneralizedGravity(kinematics.model, self._data, q)
        kinematics.update(q)
        wrench = self._in_tcp_axes
        wrench[:3], wrench[3:] = self._force, self._torque
        if target.frame is Frame.BASE:
            rotation = kinematics.placement.rotation
            wrench[:3] = wrench[:3].dot(rotation)
            wrench[3:] = wrench[3:].dot(rotation)
        added = kinematics.jacobian.T.dot(wrench)
        room = np.where(added >= 0.0, self._effort - gravity, self._effort + gravity)
        size = np.abs(added)
        self.share = 1.0
        tight = size > np.maximum(room, 0.0)
        if tight.any():
            self.share = float((np.maximum(room[tight], 0.0) / size[tight]).min())
        torques = np.clip(gravity + self.share * added, -self._effort, self._effort)
        return TorqueCommand(tuple(torques.tolist()))


def _slewed(now: Vector3, target: Vector3, most: float) -> Vector3:
    return add(now, limit_norm(subtract(target, now), most))
