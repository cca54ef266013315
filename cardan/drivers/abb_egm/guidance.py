"""From a command to the message that says it: one guidance per mode of EGM.

A guidance owns the limited reference that is sent. It is set to what the robot measures while
commands do not act, and from there moves only through its limiters.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence

from cardan.drivers.abb_egm.limits import JointLimiter, OrientationLimiter, PointLimiter
from cardan.drivers.abb_egm.options import AbbEgmOptions
from cardan.drivers.lost_time import LostTime
from cardan.errors import CommandError
from cardan.protocols.egm import (
    EgmHeader,
    EgmMotion,
    EgmPose,
    EgmSensor,
    EgmSensorPathCorr,
    EgmSpeedRef,
    MessageType,
    encode_joint_reply,
    encode_path_corr,
    encode_pose_reply,
    encode_sensor,
)
from cardan.spatial import (
    add,
    from_rotation_vector,
    multiply,
    normalized,
    rotation_between,
)
from cardan.types import (
    ZERO3,
    ZERO_TWIST,
    CommandKind,
    Frame,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    PathCorrectionCommand,
    Pose,
    PoseCommand,
    Quaternion,
    RobotCommand,
    RobotState,
    Twist,
    TwistCommand,
    Vector3,
)

LONGEST_STEP_PERIODS = 4
"""No period counts as longer than so many nominal ones."""

_DELAY_S = 0.02
"""From writing a reference to its effect on the robot (EGM manual): how far measurements lag."""

_new = tuple.__new__
"""A named tuple in half the time of its own constructor, for what is made in every cycle."""

_ABSURD = 1e6
_SENSIBLE = "every value must be finite and below a million"


class Guidance(ABC):
    """What the session needs to answer datagrams in one mode."""

    kinds: frozenset[CommandKind]
    """The kinds of commands that can be told in this mode."""

    @abstractmethod
    def check(self, command: RobotCommand) -> None:
        """Raise CommandError, saying what is allowed, unless `step` can take `command`."""

    @abstractmethod
    def reset(self, state: RobotState) -> None:
        """Make the reference what `state` measures, at rest."""

    @abstractmethod
    def coast(self, gap_s: float) -> None:
        """The controller has gone on as it was told for `gap_s`, and so does the reference."""

    @abstractmethod
    def resync(
        self,
        heading: RobotState,
        before: RobotState,
        answered: RobotState,
        dt_s: float,
        gap_s: float,
    ) -> None:
        """Take the reference along with the controller, and give it the speed that it has.

        It is `heading` for something by itself, was for `before` `dt_s` earlier, and for `answered`
        when it was answered last, which is `gap_s` too long ago.
        """

    @abstractmethod
    def near(self, state: RobotState) -> bool:
        """True when the reference is one that a robot at `state` may be following."""

    @abstractmethod
    def step(self, command: RobotCommand | None, state: RobotState, dt_s: float) -> None:
        """Move the reference by one control period as `command` says.

        A hold brakes. So does None, which is nobody's command: the next one goes on from there.
        """

    @abstractmethod
    def encode(self, seqno: int, tm_ms: int, suffix: bytes, still: bool = False) -> bytes:
        """The message for the present reference; `still` tells a speed of zero."""

    @property
    @abstractmethod
    def moving(self) -> bool:
        """True while the reference has a speed."""

    @abstractmethod
    def progress(self, heading: RobotState) -> tuple[Sequence[float], Sequence[float]] | None:
        """The reference, and what the controller is `heading` for; None without a reference."""


def guidance_for(options: AbbEgmOptions) -> Guidance:
    """The guidance of the mode in `options`."""
    if options.mode == "joint":
        return JointGuidance(options)
    if options.mode == "pose":
        return PoseGuidance(options)
    return PathGuidance(options)


def _refusal(command: object, kinds: Iterable[CommandKind], mode: str) -> CommandError:
    kind = getattr(command, "kind", None)
    name = f"a {kind.value} command" if isinstance(kind, CommandKind) else repr(command)
    allowed = ", ".join(sorted(kind.value for kind in kinds))
    return CommandError(f"{name} cannot be sent in {mode} mode; it takes: {allowed}")


def _check_numbers(what: str, values: Sequence[float], count: int) -> None:
    if len(values) != count:
        raise CommandError(f"{what} has {len(values)} values; this robot needs {count}")
    if not sum(map(abs, values)) < _ABSURD:  # NaN is not below anything
        raise CommandError(f"{what} is {tuple(values)}; {_SENSIBLE}")


def _header(seqno: int, tm_ms: int) -> EgmHeader:
    return EgmHeader(seqno, tm_ms, MessageType.CORRECTION)


class _Externals:
    """The external axes that are guided along with the arm."""

    def __init__(self, options: AbbEgmOptions) -> None:
        self.count = count = options.external_axes
        self.to_wire = wire_factors(options)[:count]
        self.limiter = JointLimiter(
            (-math.inf,) * count,
            (math.inf,) * count,
            (options.external_axis_speed,) * count,
            (options.external_axis_acceleration,) * count,
            LONGEST_STEP_PERIODS * options.period_s,
        )

    def check(self, values: Sequence[float]) -> None:
        if values:
            if self.count == 0:
                raise CommandError(
                    "external_axes are given but option external_axes is 0; set it to their number"
                )
            _check_numbers("external_axes", values, self.count)

    def step(self, values: Sequence[float], dt_s: float) -> None:
        if values:
            self.limiter.track(values, None, dt_s)
        else:
            self.limiter.brake(dt_s)

    def resync(self, heading: RobotState, before: RobotState, dt_s: float) -> None:
        now, then = heading.external_axes[: self.count], before.external_axes[: self.count]
        self.limiter.reset(now, _speeds(now, then, dt_s))

    def on_wire(self, values: Sequence[float]) -> tuple[float, ...]:
        return tuple(v * factor for v, factor in zip(values, self.to_wire, strict=True))


def wire_factors(options: AbbEgmOptions) -> tuple[float, ...]:
    """Per external axis: wire units (degrees or mm) per rad or m."""
    return tuple(
        1000.0 if axis in options.linear_external_axes else math.degrees(1.0) for axis in range(6)
    )


def _speeds(now: Sequence[float], before: Sequence[float], dt_s: float) -> tuple[float, ...] | None:
    if len(now) != len(before) or not dt_s > 0.0:
        return None
    return tuple((a - b) / dt_s for a, b in zip(now, before, strict=True))


def _between(before: Sequence[float], now: Sequence[float]) -> list[float]:
    return [b - a for a, b in zip(before, now, strict=True)]


def _beyond(
    heading: Sequence[float],
    answered: Sequence[float],
    speeds: Sequence[float],
    period_s: float,
) -> list[float]:
    """How far the controller went between its last answer and the period before this one.

    The reference is as far ahead of it as before: controllers act on what they are sent some
    periods later.
    """
    return [b - a - v * period_s for a, b, v in zip(answered, heading, speeds, strict=True)]


def _departed(
    went: Sequence[float], told: Sequence[float], speeds: Sequence[float], gap_s: float
) -> tuple[list[float], list[float]]:
    """How far from where the speeds it was told would have brought it, and how much faster."""
    return (
        [way - v * gap_s for way, v in zip(went, told, strict=True)],
        [now - v for now, v in zip(speeds, told, strict=True)],
    )


_FOLLOWS_S, _FOLLOWS = 0.1, 0.01
"""So far behind its reference in time, and in rad or m besides, an arm is that follows it."""


def _follows(
    measured: Sequence[float], reference: Sequence[float], velocities: Sequence[float]
) -> bool:
    return len(measured) == len(reference) and all(
        abs(q - r) <= _FOLLOWS + _FOLLOWS_S * abs(v)
        for q, r, v in zip(measured, reference, velocities, strict=True)
    )


class JointGuidance(Guidance):
    """Joint mode: EGMRunJoint."""

    def __init__(self, options: AbbEgmOptions) -> None:
        self._count = count = options.joints
        self._speed_only = options.speed_reference == "only"
        self._with_speed = options.speed_reference != "none"
        self.kinds = frozenset(
            (CommandKind.HOLD, CommandKind.JOINT_VELOCITY)
            if self._speed_only
            else (CommandKind.HOLD, CommandKind.JOINT)
        )
        self._period_s = options.period_s
        limits = options.joint_limits
        acceleration = math.radians(options.joint_acceleration_deg_s2)
        self._limiter = JointLimiter(
            limits.lower if limits else (-math.inf,) * count,
            limits.upper if limits else (math.inf,) * count,
            options.joint_speeds_rad_s,
            (acceleration,) * count,
            LONGEST_STEP_PERIODS * options.period_s,
        )
        self._externals = _Externals(options)
        self._plain = count == 6 and not self._externals.count and not self._speed_only
        self._lost = LostTime(count)
        self._gap_s = 0.0
        self._asked: JointCommand | None = None
        """The command before, if it was one of positions."""

    def check(self, command: RobotCommand) -> None:
        if isinstance(command, HoldCommand):
            return
        if not self._speed_only and isinstance(command, JointCommand):
            _check_numbers("positions", command.positions, self._count)
            if command.velocities is not None:
                _check_numbers("velocities", command.velocities, self._count)
            self._externals.check(command.external_axes)
        elif self._speed_only and isinstance(command, JointVelocityCommand):
            _check_numbers("velocities", command.velocities, self._count)
        else:
            raise _refusal(command, self.kinds, "joint" + " speed" * self._speed_only)

    def reset(self, state: RobotState) -> None:
        self._limiter.reset(state.joints)
        self._externals.limiter.reset(state.external_axes[: self._externals.count])
        self._forget()

    def _forget(self) -> None:
        self._asked = None
        self._gap_s = 0.0
        self._lost.reset()

    def coast(self, gap_s: float) -> None:
        self._limiter.coast(gap_s)
        self._externals.limiter.coast(gap_s)
        self._gap_s = gap_s
        self._lost.passed(gap_s)

    def resync(
        self,
        heading: RobotState,
        before: RobotState,
        answered: RobotState,
        dt_s: float,
        gap_s: float,
    ) -> None:
        limiter = self._limiter
        told = tuple(limiter.velocities)
        speeds = _speeds(heading.joints, before.joints, dt_s) or told
        went = _beyond(heading.joints, answered.joints, speeds, self._period_s)
        limiter.reset([q + way for q, way in zip(limiter.positions, went, strict=True)], speeds)
        self._externals.resync(heading, before, dt_s)
        self._gap_s = gap_s
        self._lost.passed(gap_s, *_departed(went, told, speeds, gap_s))

    def near(self, state: RobotState) -> bool:
        limiter = self._limiter
        return _follows(state.joints, limiter.positions, limiter.velocities)

    def step(self, command: RobotCommand | None, state: RobotState, dt_s: float) -> None:
        if self._speed_only:
            velocities = self._limiter.velocities
            heading = zip(state.joints, velocities, strict=True)
            self._limiter.relocate([q + v * _DELAY_S for q, v in heading])
        if isinstance(command, JointCommand):
            self._track(command, dt_s)
            if self._externals.count:
                self._externals.step(command.external_axes, dt_s)
            return
        if command is None:
            self._brake(dt_s)
            return
        self._forget()
        if isinstance(command, JointVelocityCommand):
            self._limiter.drive(command.velocities, dt_s)
        else:
            self._limiter.brake(dt_s)
        self._externals.limiter.brake(dt_s)

    def _brake(self, dt_s: float) -> None:
        limiter = self._limiter
        place, speeds = list(limiter.positions), list(limiter.velocities)
        limiter.brake(dt_s)
        self._externals.limiter.brake(dt_s)
        if self._asked is not None:
            went, slower = limiter.positions, limiter.velocities
            self._lost.passed(0.0, _between(place, went), _between(speeds, slower))

    def _track(self, command: JointCommand, dt_s: float) -> None:
        """One period towards `command`, of which time that was lost is not made up for."""
        target: Sequence[float] = command.positions
        velocities: Sequence[float] | None = command.velocities
        asked, self._asked = self._asked, command
        gap_s, self._gap_s = self._gap_s, 0.0
        lost = self._lost
        if lost.working:
            moved = None if asked is None else _between(asked.positions, target)
            if velocities is None or asked is None or asked.velocities is None or moved is None:
                lost.reset()
                if velocities is None and moved is not None:
                    # As it was seen to move, over all the time that has passed.
                    velocities = [way / (gap_s + dt_s) for way in moved]
            else:
                lost.step(moved, asked.velocities, velocities, dt_s)
                target = [q + ahead for q, ahead in zip(target, lost.offset, strict=True)]
                velocities = [v + more for v, more in zip(velocities, lost.rate, strict=True)]
        self._limiter.track(target, velocities, dt_s)

    def encode(self, seqno: int, tm_ms: int, suffix: bytes, still: bool = False) -> bytes:
        limiter = self._limiter
        positions: Sequence[float] = limiter.positions
        velocities: Sequence[float] | None = limiter.velocities if self._with_speed else None
        if still and velocities is not None:
            velocities = (0.0,) * self._count
        if self._plain:
            return encode_joint_reply(seqno, tm_ms, positions, velocities, suffix)
        external = self._externals.limiter
        planned = speed_ref = None
        if not self._speed_only:
            joints, outside = self._split(positions, external.positions)
            planned = EgmMotion(joints=joints, external_joints=outside)
        if velocities is not None:
            rates = (0.0,) * self._externals.count if still else external.velocities
            joints, outside = self._split(velocities, rates)
            speed_ref = EgmSpeedRef(joints=joints, external_joints=outside)
        return encode_sensor(EgmSensor(_header(seqno, tm_ms), planned, speed_ref)) + suffix

    def _split(
        self, joints: Sequence[float], externals: Sequence[float]
    ) -> tuple[tuple[float, ...], tuple[float, ...] | None]:
        """Joints and external axes as the protocol groups them: a seventh joint is external."""
        outside = self._externals.on_wire(externals)
        if self._count == 7:
            outside = (math.degrees(joints[2]), *outside)
            joints = (*joints[:2], *joints[3:])
        return tuple(joints), outside or None

    @property
    def moving(self) -> bool:
        return self._limiter.moving or self._externals.limiter.moving

    def progress(self, heading: RobotState) -> tuple[Sequence[float], Sequence[float]] | None:
        return None if self._speed_only else (self._limiter.positions, heading.joints)


_NORM_TOLERANCE = 0.02
"""Of a quaternion's squared length: rounding does no harm, anything else is a mistake."""


class PoseGuidance(Guidance):
    """Pose mode: EGMRunPose."""

    def __init__(self, options: AbbEgmOptions) -> None:
        self._speed_only = options.speed_reference == "only"
        self._with_speed = options.speed_reference != "none"
        self.kinds = frozenset(
            (CommandKind.HOLD, CommandKind.TWIST)
            if self._speed_only
            else (CommandKind.HOLD, CommandKind.POSE)
        )
        box = (options.workspace_lower_m, options.workspace_upper_m)
        self._point = PointLimiter(
            options.linear_speed_m_s,
            options.linear_acceleration_m_s2,
            box if options.workspace_lower_m else None,
        )
        self._turn = OrientationLimiter(
            math.radians(options.angular_speed_deg_s),
            math.radians(options.angular_acceleration_deg_s2),
        )
        self._externals = _Externals(options)
        self._plain = not self._externals.count and not self._speed_only
        self._period_s = options.period_s
        self._lost = LostTime(3)
        self._lost_turn = LostTime(3)
        self._gap_s = 0.0
        self._asked: PoseCommand | None = None
        """The command before, if it was one of poses."""

    def check(self, command: RobotCommand) -> None:
        if isinstance(command, HoldCommand):
            return
        if not self._speed_only and isinstance(command, PoseCommand):
            (x, y, z), (qw, qx, qy, qz), frame = command.pose
            if frame is not Frame.BASE:
                raise CommandError(f"the pose is in the {frame.value} frame; it must be in base")
            if not abs(x) + abs(y) + abs(z) < _ABSURD:
                raise CommandError(f"the position is {(x, y, z)}; {_SENSIBLE}")
            squared = qw * qw + qx * qx + qy * qy + qz * qz
            if not abs(squared - 1.0) <= _NORM_TOLERANCE:
                raise CommandError(
                    f"the orientation {(qw, qx, qy, qz)} has the length {math.sqrt(squared):g}; "
                    "a rotation has length 1"
                )
            if command.twist is not None:
                _check_twist(command.twist)
            if command.external_axes:
                self._externals.check(command.external_axes)
        elif self._speed_only and isinstance(command, TwistCommand):
            _check_twist(command.twist)
        else:
            raise _refusal(command, self.kinds, "pose" + " speed" * self._speed_only)

    def reset(self, state: RobotState) -> None:
        assert state.pose is not None
        self._point.reset(state.pose.position)
        self._turn.reset(state.pose.orientation)
        self._externals.limiter.reset(state.external_axes[: self._externals.count])
        self._forget()

    def _forget(self) -> None:
        self._asked = None
        self._gap_s = 0.0
        self._lost.reset()
        self._lost_turn.reset()

    def coast(self, gap_s: float) -> None:
        self._point.coast(gap_s)
        self._turn.coast(gap_s)
        self._externals.limiter.coast(gap_s)
        self._gap_s = gap_s
        self._lost.passed(gap_s)
        self._lost_turn.passed(gap_s)

    def resync(
        self,
        heading: RobotState,
        before: RobotState,
        answered: RobotState,
        dt_s: float,
        gap_s: float,
    ) -> None:
        now, then, old = heading.pose, before.pose, answered.pose
        assert now is not None
        then, old = then or now, old or now
        point, turn = self._point, self._turn
        linear, angular = point.velocity, turn.velocity
        speeds = _speeds(now.position, then.position, dt_s) or linear
        turned = rotation_between(then.orientation, now.orientation)
        rates = [angle / dt_s for angle in turned] if dt_s > 0.0 else list(angular)
        went = _beyond(now.position, old.position, speeds, self._period_s)
        about = _beyond(
            rotation_between(old.orientation, now.orientation), ZERO3, rates, self._period_s
        )
        self._lost.passed(gap_s, *_departed(went, linear, speeds, gap_s))
        self._lost_turn.passed(gap_s, *_departed(about, angular, rates, gap_s))
        point.reset(add(point.position, Vector3(*went)), speeds)
        turn.reset(_turned(turn.orientation, about), rates)
        self._externals.resync(heading, before, dt_s)
        self._gap_s = gap_s

    def near(self, state: RobotState) -> bool:
        return state.pose is not None and _follows(
            state.pose.position, self._point.position, self._point.velocity
        )

    def step(self, command: RobotCommand | None, state: RobotState, dt_s: float) -> None:
        point = self._point
        turn = self._turn
        if self._speed_only and state.pose is not None:
            x, y, z = state.pose.position
            vx, vy, vz = point.velocity
            point.relocate(Vector3(x + vx * _DELAY_S, y + vy * _DELAY_S, z + vz * _DELAY_S))
            turn.relocate(state.pose.orientation)
        if isinstance(command, PoseCommand):
            self._track(command, dt_s)
            if self._externals.count:
                self._externals.step(command.external_axes, dt_s)
            return
        if command is None:
            self._brake(dt_s)
            return
        self._forget()
        if isinstance(command, TwistCommand):
            point.drive(command.twist.linear, dt_s)
            turn.drive(command.twist.angular, dt_s)
        else:
            point.brake(dt_s)
            turn.brake(dt_s)
        self._externals.limiter.brake(dt_s)

    def _brake(self, dt_s: float) -> None:
        point, turn = self._point, self._turn
        (place, speed), (orientation, rate) = (
            (point.position, point.velocity),
            (turn.orientation, turn.velocity),
        )
        point.brake(dt_s)
        turn.brake(dt_s)
        self._externals.limiter.brake(dt_s)
        if self._asked is not None:
            self._lost.passed(0.0, _between(place, point.position), _between(speed, point.velocity))
            self._lost_turn.passed(
                0.0,
                rotation_between(orientation, turn.orientation),
                _between(rate, turn.velocity),
            )

    def _track(self, command: PoseCommand, dt_s: float) -> None:
        """One period towards `command`, of which time that was lost is not made up for."""
        (position, orientation, _), twist, _, _ = command
        linear: Sequence[float] | None
        angular: Sequence[float] | None
        linear, angular = (None, None) if twist is None else twist[:2]
        asked, self._asked = self._asked, command
        gap_s, self._gap_s = self._gap_s, 0.0
        lost, lost_turn = self._lost, self._lost_turn
        if lost.working or lost_turn.working:
            if asked is None:
                lost.reset()
                lost_turn.reset()
            else:
                moved = _between(asked.pose.position, position)
                turned = rotation_between(asked.pose.orientation, orientation)
                if twist is None or asked.twist is None:
                    lost.reset()
                    lost_turn.reset()
                    if twist is None:
                        # As it was seen to move, over all the time that has passed.
                        linear = [way / (gap_s + dt_s) for way in moved]
                        angular = [angle / (gap_s + dt_s) for angle in turned]
                else:
                    lost.step(moved, asked.twist.linear, twist.linear, dt_s)
                    lost_turn.step(turned, asked.twist.angular, twist.angular, dt_s)
                    position = add(position, Vector3(*lost.offset))
                    orientation = _turned(orientation, lost_turn.offset)
                    linear = add(twist.linear, Vector3(*lost.rate))
                    angular = add(twist.angular, Vector3(*lost_turn.rate))
        self._point.track(position, linear, dt_s)
        self._turn.track(orientation, angular, dt_s)

    def encode(self, seqno: int, tm_ms: int, suffix: bytes, still: bool = False) -> bytes:
        point = self._point
        turn = self._turn
        twist = None
        if self._with_speed:
            if still:
                twist = ZERO_TWIST
            else:
                twist = _new(Twist, (point.velocity, turn.velocity, Frame.BASE))
        if self._plain:
            pose = _new(Pose, (point.position, turn.orientation, Frame.BASE))
            return encode_pose_reply(seqno, tm_ms, pose, twist, suffix)
        external = self._externals.limiter
        outside = self._externals.on_wire(external.positions)
        planned = speed_ref = None
        if not self._speed_only:
            cartesian = EgmPose(point.position, turn.orientation)
            planned = EgmMotion(cartesian=cartesian, external_joints=outside or None)
        if twist is not None:
            rates = (0.0,) * self._externals.count if still else external.velocities
            speed_ref = EgmSpeedRef(
                cartesians=(*twist.linear, *twist.angular),
                external_joints=self._externals.on_wire(rates) or None,
            )
        return encode_sensor(EgmSensor(_header(seqno, tm_ms), planned, speed_ref)) + suffix

    @property
    def moving(self) -> bool:
        return self._point.moving or self._turn.moving or self._externals.limiter.moving

    def progress(self, heading: RobotState) -> tuple[Sequence[float], Sequence[float]] | None:
        if self._speed_only or heading.pose is None:
            return None
        return self._point.position, heading.pose.position


def _turned(orientation: Quaternion, by: Sequence[float]) -> Quaternion:
    if not any(by):
        return orientation
    return normalized(multiply(from_rotation_vector(Vector3(*by)), orientation))


def _check_twist(twist: Twist) -> None:
    (vx, vy, vz), (wx, wy, wz), frame = twist
    if frame is not Frame.BASE:
        raise CommandError(f"the twist is in the {frame.value} frame; it must be in base")
    if not abs(vx) + abs(vy) + abs(vz) + abs(wx) + abs(wy) + abs(wz) < _ABSURD:
        raise CommandError(f"the twist is {(vx, vy, vz, wx, wy, wz)}; {_SENSIBLE}")


_AGE_MS_MAX = 2**32 - 1


class PathGuidance(Guidance):
    """Path correction: EGMMoveL and EGMMoveC. The reference is the offset from the path."""

    kinds = frozenset((CommandKind.HOLD, CommandKind.PATH_CORRECTION))

    def __init__(self, options: AbbEgmOptions) -> None:
        reach = options.path_offset_m
        self._offset = PointLimiter(
            options.linear_speed_m_s,
            options.linear_acceleration_m_s2,
            ((0.0, -reach, -reach), (0.0, reach, reach)),
        )
        self._age_ms = 0

    def check(self, command: RobotCommand) -> None:
        if isinstance(command, HoldCommand):
            return
        if not isinstance(command, PathCorrectionCommand):
            raise _refusal(command, self.kinds, "path-correction")
        _check_numbers("offset", command.offset, 3)
        if not 0.0 <= command.age_s * 1000.0 <= _AGE_MS_MAX:
            raise CommandError(f"age_s is {command.age_s}; it must be 0 or more")

    def reset(self, state: RobotState) -> None:
        self._offset.reset(ZERO3)
        self._age_ms = 0

    def coast(self, gap_s: float) -> None:
        pass  # A controller goes to the last offset, and no further.

    def resync(
        self,
        heading: RobotState,
        before: RobotState,
        answered: RobotState,
        dt_s: float,
        gap_s: float,
    ) -> None:
        self._offset.reset(self._offset.position)

    def near(self, state: RobotState) -> bool:
        return False

    def step(self, command: RobotCommand | None, state: RobotState, dt_s: float) -> None:
        if isinstance(command, PathCorrectionCommand):
            _, y, z = command.offset
            self._offset.track((0.0, y, z), None, dt_s)
            self._age_ms = round(command.age_s * 1000.0)
        else:
            self._offset.brake(dt_s)

    def encode(self, seqno: int, tm_ms: int, suffix: bytes, still: bool = False) -> bytes:
        header = EgmHeader(seqno, tm_ms, MessageType.PATH_CORRECTION)
        return encode_path_corr(EgmSensorPathCorr(header, self._offset.position, self._age_ms))

    @property
    def moving(self) -> bool:
        return self._offset.moving

    def progress(self, heading: RobotState) -> tuple[Sequence[float], Sequence[float]] | None:
        return None
