"""Commands to EGM messages: one reference generator per EGM mode.

A reference generator owns the limited reference that is sent. While commands do not act, the
reference equals the measured position; from there it moves only through its limiters.
"""

from __future__ import annotations

import contextlib
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from typing import Any, Generic, TypeVar

from cardan.common.bounds import (
    ANGULAR_VELOCITY_RAD_S,
    COORDINATE_M,
    JOINT_POSITION,
    JOINT_VELOCITY,
    LINEAR_VELOCITY_M_S,
)
from cardan.common.native import NativePartError
from cardan.drivers.abb_egm.compiled import (
    AnsweringLimiter,
    AnsweringPose,
    CompiledCycle,
    ReplyFunction,
    no_answer,
)
from cardan.drivers.abb_egm.options import AbbEgmOptions
from cardan.drivers.limiters import JointLimiter, OrientationLimiter, PointLimiter
from cardan.drivers.missed_cycles import SlipCompensation
from cardan.drivers.robot_core import check_numbers, no_rotation, outside, wrong_kind
from cardan.errors import CommandError
from cardan.protocols.egm.encode import encode_path_corr, encode_sensor
from cardan.protocols.egm.messages import (
    EgmHeader,
    EgmMessageType,
    EgmMotion,
    EgmPose,
    EgmSensor,
    EgmSensorPathCorr,
    EgmSpeedRef,
)
from cardan.protocols.egm.replies import encode_joint_reply, encode_pose_reply
from cardan.spatial import (
    add,
    rotation_between,
    turned_by,
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
"""Longest period of one reference step, in nominal periods."""

_DELAY_S = 0.02
"""Lag from sending a reference to its effect on the robot (EGM manual)."""

_new = tuple.__new__
"""Makes a named tuple in half the time of its constructor, for objects made in every cycle."""


References = tuple[RobotState, RobotState, RobotState]
"""The controller's own reference at three times."""


class ReferenceGenerator(ABC):
    """Generator of a session's answers in one mode."""

    kinds: frozenset[CommandKind]
    """Kinds of commands that this mode takes."""

    @abstractmethod
    def check(self, command: RobotCommand) -> None:
        """Raise CommandError, saying what is allowed, unless `step` can take `command`."""

    @abstractmethod
    def reset(self, state: RobotState) -> None:
        """Set the reference to the measurement in `state`, at rest."""

    @abstractmethod
    def coast(self, gap_s: float) -> None:
        """Advance the reference by `gap_s`, in which the controller continued at its last speed."""

    @abstractmethod
    def resync(self, references: References, dt_s: float, gap_s: float) -> None:
        """Move the reference with the controller's own reference, and take over its speed.

        `references` are the controller's: now, `dt_s` earlier, and at the last answer, which is
        `gap_s` late.
        """

    @abstractmethod
    def near(self, state: RobotState) -> bool:
        """True if a robot at `state` can be following the reference."""

    @abstractmethod
    def step(self, command: RobotCommand | None, state: RobotState, dt_s: float) -> None:
        """Move the reference by one control period by `command`.

        A hold brakes, and so does None (no command came); the next command continues from there.
        """

    @abstractmethod
    def encode(self, seqno: int, tm_ms: int, suffix: bytes, still: bool = False) -> bytes:
        """Message with the present reference; `still` sends a speed of zero."""

    answer: ReplyFunction
    """`check`, `step` and `encode` of a command in one compiled call, if available and nothing is
    unusual."""

    asked: RobotCommand | None = None
    """Previous command; None if the next one does not continue from it."""

    @property
    def steady(self) -> bool:
        """True if `answer` is available and no difference has to be made up for."""
        return False

    @property
    @abstractmethod
    def moving(self) -> bool:
        """True while the reference has a speed."""

    @abstractmethod
    def progress(self, heading: RobotState) -> tuple[Sequence[float], Sequence[float]] | None:
        """The reference and the controller's own, `heading`; None without a reference."""


def reference_generator_for(
    options: AbbEgmOptions, cycle: CompiledCycle | None = None
) -> ReferenceGenerator:
    """Make the reference generator of the mode in `options`; `cycle` allows it compiled answers."""
    if options.mode == "joint":
        return JointReferenceGenerator(options, cycle)
    if options.mode == "pose":
        return PoseReferenceGenerator(options, cycle)
    return PathCorrectionGenerator(options)


def _header(seqno: int, tm_ms: int) -> EgmHeader:
    return EgmHeader(seqno, tm_ms, EgmMessageType.CORRECTION)


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
            check_numbers("external_axes", values, JOINT_POSITION, self.count, "axes")

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
    """Wire units (degrees or mm) per rad or m, by external axis."""
    return tuple(
        1000.0 if axis in options.linear_external_axes else math.degrees(1.0) for axis in range(6)
    )


def _said(options: AbbEgmOptions) -> tuple[bool, float]:
    """Fields of answers: whether they have the speed, and in speed control its delay."""
    only = options.speed_reference == "only"
    return options.speed_reference != "none", _DELAY_S if only else 0.0


def _speeds(now: Sequence[float], before: Sequence[float], dt_s: float) -> tuple[float, ...] | None:
    if len(now) != len(before) or not dt_s > 0.0:
        return None
    return tuple((a - b) / dt_s for a, b in zip(now, before, strict=True))


_FOLLOWS_S, _FOLLOWS = 0.1, 0.01
"""Largest lag of an arm that follows its reference: a time, plus a distance in rad or m."""


def _follows(
    measured: Sequence[float], reference: Sequence[float], velocities: Sequence[float]
) -> bool:
    return len(measured) == len(reference) and all(
        abs(q - r) <= _FOLLOWS + _FOLLOWS_S * abs(v)
        for q, r, v in zip(measured, reference, velocities, strict=True)
    )


class _Followed(SlipCompensation):
    """One part of the reference: its limiter, and its compensation of missed cycles."""

    __slots__ = ("limiter",)

    def __init__(self, axes: int, limiter: Any) -> None:
        super().__init__(axes)
        self.limiter = limiter

    def coast(self, gap_s: float) -> None:
        """Advance by a gap; see `ReferenceGenerator`."""
        self.limiter.coast(gap_s)
        self.passed(gap_s)

    def resync(
        self, heading: Any, before: Any, answered: Any, dt_s: float, gap_s: float, period_s: float
    ) -> None:
        """Resynchronize; see `ReferenceGenerator`, with positions instead of states.

        The reference keeps the lead over the controller that it had at the last answer, because
        controllers execute commands some periods later.
        """
        commanded = speeds = tuple(self.limiter.velocity)
        if dt_s > 0.0:
            speeds = tuple([way / dt_s for way in self._displacement(before, heading)])
        went = [
            way - v * period_s
            for way, v in zip(self._displacement(answered, heading), speeds, strict=True)
        ]
        self.limiter.reset(self._advanced(self.limiter.reference, went), speeds)
        # Differences from the position and speed that the commanded speeds would have given.
        self.passed(
            gap_s,
            [way - v * gap_s for way, v in zip(went, commanded, strict=True)],
            [now - v for now, v in zip(speeds, commanded, strict=True)],
        )

    def brake(self, dt_s: float) -> None:
        """Slow down for one period between two targets."""
        limiter = self.limiter
        place, speeds = copy(limiter.reference), tuple(limiter.velocity)
        limiter.brake(dt_s)
        self.passed(
            0.0,
            self._displacement(place, limiter.reference),
            [now - v for now, v in zip(limiter.velocity, speeds, strict=True)],
        )


class _FollowedPoint(_Followed):
    def _advanced(self, place: Vector3, by: Sequence[float]) -> Vector3:
        return add(place, Vector3(*by))


class _FollowedTurn(_Followed):
    def _displacement(self, start: Quaternion, end: Quaternion) -> list[float]:
        return list(rotation_between(start, end))

    def _advanced(self, place: Quaternion, by: Sequence[float]) -> Quaternion:
        if not any(by):
            return place
        return turned_by(place, Vector3(*by))


_TargetT = TypeVar("_TargetT", JointCommand, PoseCommand)
_SpeedT = TypeVar("_SpeedT", JointVelocityCommand, TwistCommand)


class _PositionGenerator(ReferenceGenerator, Generic[_TargetT, _SpeedT]):
    """Joint and pose mode: a reference of one or two parts, and external axes beside it."""

    target_type: type[_TargetT]
    speed_type: type[_SpeedT]

    def __init__(
        self, options: AbbEgmOptions, cycle: CompiledCycle | None, *parts: _Followed
    ) -> None:
        self._mode = options.mode
        self._speed_only = options.speed_reference == "only"
        self._with_speed = options.speed_reference != "none"
        self._taken: type[Any] = self.speed_type if self._speed_only else self.target_type
        self.kinds = frozenset((CommandKind.HOLD, self._taken._field_defaults["kind"]))
        self._period_s = options.period_s
        self._parts = parts
        self._externals = _Externals(options)
        self._gap_s = 0.0
        compiled = self._compiled
        if cycle is None or compiled is None:
            self.answer = no_answer
        else:
            self.answer = compiled.compiled_reply(cycle)

    _compiled: AnsweringLimiter | AnsweringPose | None = None

    @abstractmethod
    def _measured_parts(self, state: RobotState) -> Sequence[Any]:
        """Measured position of each part in `state`."""

    @abstractmethod
    def _check_target(self, command: _TargetT) -> None: ...

    @abstractmethod
    def _check_speed(self, command: _SpeedT) -> None: ...

    @abstractmethod
    def _relocate(self, state: RobotState) -> None:
        """Move the reference to a position that has an effect at once (speed control)."""

    @abstractmethod
    def _track(self, command: _TargetT, asked: _TargetT | None, dt_s: float, seen_s: float) -> None:
        """Advance one period towards `command`, which comes `seen_s` after `asked`."""

    @abstractmethod
    def _drive(self, command: _SpeedT, dt_s: float) -> None: ...

    def check(self, command: RobotCommand) -> None:
        if isinstance(command, HoldCommand):
            return
        if not self._speed_only and isinstance(command, self.target_type):
            self._check_target(command)
            if command.external_axes:
                self._externals.check(command.external_axes)
        elif self._speed_only and isinstance(command, self.speed_type):
            self._check_speed(command)
        else:
            speed = " speed" * self._speed_only
            raise wrong_kind(f"EGM in {self._mode}{speed} mode", command, self.kinds)

    @property
    def steady(self) -> bool:
        return self._compiled is not None and not (
            self._gap_s or any(part.working for part in self._parts)
        )

    def reset(self, state: RobotState) -> None:
        for part, place in zip(self._parts, self._measured_parts(state), strict=True):
            part.limiter.reset(place)
        self._externals.limiter.reset(state.external_axes[: self._externals.count])
        self._forget()

    def _forget(self) -> None:
        self.asked = None
        self._gap_s = 0.0
        for part in self._parts:
            part.reset()

    def coast(self, gap_s: float) -> None:
        for part in self._parts:
            part.coast(gap_s)
        self._externals.limiter.coast(gap_s)
        self._gap_s = gap_s

    def resync(self, references: References, dt_s: float, gap_s: float) -> None:
        for part, *each in zip(self._parts, *map(self._measured_parts, references), strict=True):
            part.resync(*each, dt_s, gap_s, self._period_s)
        self._externals.resync(*references[:2], dt_s)
        self._gap_s = gap_s

    def step(self, command: RobotCommand | None, state: RobotState, dt_s: float) -> None:
        if self._speed_only:
            self._relocate(state)
        if isinstance(command, self.target_type):
            before, self.asked = self.asked, command
            asked = before if isinstance(before, self.target_type) else None
            gap_s, self._gap_s = self._gap_s, 0.0
            self._track(command, asked, dt_s, gap_s + dt_s)
            if self._externals.count:
                self._externals.step(command.external_axes, dt_s)
            return
        if command is not None:
            self._forget()
        if isinstance(command, self.speed_type):
            self._drive(command, dt_s)
        else:
            for part in self._parts:
                if isinstance(self.asked, self.target_type):
                    part.brake(dt_s)
                else:
                    part.limiter.brake(dt_s)
        self._externals.limiter.brake(dt_s)


class JointReferenceGenerator(_PositionGenerator[JointCommand, JointVelocityCommand]):
    """Joint mode: EGMRunJoint."""

    target_type = JointCommand
    speed_type = JointVelocityCommand

    def __init__(self, options: AbbEgmOptions, cycle: CompiledCycle | None) -> None:
        self._count = count = options.joints
        limits = options.joint_limits
        acceleration = math.radians(options.joint_acceleration_deg_s2)
        given = (
            limits.lower if limits else (-math.inf,) * count,
            limits.upper if limits else (math.inf,) * count,
            options.joint_speeds_rad_s,
            (acceleration,) * count,
            LONGEST_STEP_PERIODS * options.period_s,
        )
        arm = count == 6 and not options.external_axes
        self._plain = arm and options.speed_reference != "only"
        self._limiter = JointLimiter(*given)
        if arm:
            with contextlib.suppress(NativePartError):
                self._limiter = self._compiled = AnsweringLimiter(*given, *_said(options))
        self._joints = _Followed(count, self._limiter)
        super().__init__(options, cycle, self._joints)

    def _measured_parts(self, state: RobotState) -> Sequence[Any]:
        return (state.joints,)

    def _check_target(self, command: JointCommand) -> None:
        check_numbers("positions", command.positions, JOINT_POSITION, self._count)
        if command.velocities is not None:
            check_numbers("velocities", command.velocities, JOINT_VELOCITY, self._count)

    def _check_speed(self, command: JointVelocityCommand) -> None:
        check_numbers("velocities", command.velocities, JOINT_VELOCITY, self._count)

    def near(self, state: RobotState) -> bool:
        return _follows(state.joints, self._limiter.reference, self._limiter.velocity)

    def _relocate(self, state: RobotState) -> None:
        heading = zip(state.joints, self._limiter.velocity, strict=True)
        self._limiter.relocate([q + v * _DELAY_S for q, v in heading])

    def _track(
        self, command: JointCommand, asked: JointCommand | None, dt_s: float, seen_s: float
    ) -> None:
        target: Sequence[float] = command.positions
        speeds: Sequence[float] | None = command.velocities
        if self._joints.working:
            before = None if asked is None else asked[:2]
            target, speeds = self._joints.follow(before, target, speeds, dt_s, seen_s)
        self._limiter.track(target, speeds, dt_s)

    def _drive(self, command: JointVelocityCommand, dt_s: float) -> None:
        self._limiter.drive(command.velocities, dt_s)

    def encode(self, seqno: int, tm_ms: int, suffix: bytes, still: bool = False) -> bytes:
        limiter = self._limiter
        positions: Sequence[float] = limiter.reference
        velocities: Sequence[float] | None = limiter.velocity if self._with_speed else None
        if still and velocities is not None:
            velocities = (0.0,) * self._count
        if self._plain:
            return encode_joint_reply(seqno, tm_ms, positions, velocities, suffix)
        external = self._externals.limiter
        planned = speed_ref = None
        if not self._speed_only:
            joints, outside = self._split(positions, external.reference)
            planned = EgmMotion(joints=joints, external_joints=outside)
        if velocities is not None:
            rates = (0.0,) * self._externals.count if still else external.velocity
            joints, outside = self._split(velocities, rates)
            speed_ref = EgmSpeedRef(joints=joints, external_joints=outside)
        return encode_sensor(EgmSensor(_header(seqno, tm_ms), planned, speed_ref)) + suffix

    def _split(
        self, joints: Sequence[float], externals: Sequence[float]
    ) -> tuple[tuple[float, ...], tuple[float, ...] | None]:
        """Group joints and external axes as in the protocol: a seventh joint is external."""
        outside = self._externals.on_wire(externals)
        if self._count == 7:
            outside = (math.degrees(joints[2]), *outside)
            joints = (*joints[:2], *joints[3:])
        return tuple(joints), outside or None

    @property
    def moving(self) -> bool:
        return self._limiter.moving or self._externals.limiter.moving

    def progress(self, heading: RobotState) -> tuple[Sequence[float], Sequence[float]] | None:
        return None if self._speed_only else (self._limiter.reference, heading.joints)


class PoseReferenceGenerator(_PositionGenerator[PoseCommand, TwistCommand]):
    """Pose mode: EGMRunPose."""

    target_type = PoseCommand
    speed_type = TwistCommand

    def __init__(self, options: AbbEgmOptions, cycle: CompiledCycle | None) -> None:
        box = (options.workspace_lower_m, options.workspace_upper_m)
        point = (
            options.linear_speed_m_s,
            options.linear_acceleration_m_s2,
            box if options.workspace_lower_m else None,
        )
        turn = (
            math.radians(options.angular_speed_deg_s),
            math.radians(options.angular_acceleration_deg_s2),
        )
        self._point = PointLimiter(*point)
        self._turn = OrientationLimiter(*turn)
        if not options.external_axes:
            with contextlib.suppress(NativePartError):
                self._compiled = AnsweringPose(point, turn, *_said(options))
                self._point, self._turn = self._compiled.point, self._compiled.turn
        self._positions = _FollowedPoint(3, self._point)
        self._orientations = _FollowedTurn(3, self._turn)
        super().__init__(options, cycle, self._positions, self._orientations)
        self._plain = not self._externals.count and not self._speed_only

    def _measured_parts(self, state: RobotState) -> Sequence[Any]:
        assert state.pose is not None
        return state.pose[:2]

    def _check_target(self, command: PoseCommand) -> None:
        position, orientation, frame = command.pose
        if frame is not Frame.BASE:
            raise CommandError(f"the pose is in the {frame.value} frame; it must be in base")
        x, y, z = position
        if refused := (
            outside("position", (x, y, z), COORDINATE_M) or no_rotation("orientation", orientation)
        ):
            raise CommandError(refused)
        if command.twist is not None:
            _check_twist(command.twist)

    def _check_speed(self, command: TwistCommand) -> None:
        _check_twist(command.twist)

    def near(self, state: RobotState) -> bool:
        return state.pose is not None and _follows(
            state.pose.position, self._point.reference, self._point.velocity
        )

    def _relocate(self, state: RobotState) -> None:
        if state.pose is not None:
            x, y, z = state.pose.position
            vx, vy, vz = self._point.velocity
            self._point.relocate(Vector3(x + vx * _DELAY_S, y + vy * _DELAY_S, z + vz * _DELAY_S))
            self._turn.relocate(state.pose.orientation)

    def _track(
        self, command: PoseCommand, asked: PoseCommand | None, dt_s: float, seen_s: float
    ) -> None:
        (position, orientation, _), twist, _, _ = command
        linear: Sequence[float] | None
        angular: Sequence[float] | None
        linear, angular = (None, None) if twist is None else twist[:2]
        if self._positions.working or self._orientations.working:
            before = before_turn = None
            if asked is not None:
                old = asked.twist
                before = (asked.pose.position, None if old is None else old.linear)
                before_turn = (asked.pose.orientation, None if old is None else old.angular)
            position, linear = self._positions.follow(before, position, linear, dt_s, seen_s)
            orientation, angular = self._orientations.follow(
                before_turn, orientation, angular, dt_s, seen_s
            )
        self._point.track(position, linear, dt_s)
        self._turn.track(orientation, angular, dt_s)

    def _drive(self, command: TwistCommand, dt_s: float) -> None:
        self._point.drive(command.twist.linear, dt_s)
        self._turn.drive(command.twist.angular, dt_s)

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
            pose = _new(Pose, (point.reference, turn.reference, Frame.BASE))
            return encode_pose_reply(seqno, tm_ms, pose, twist, suffix)
        external = self._externals.limiter
        outside = self._externals.on_wire(external.reference)
        planned = speed_ref = None
        if not self._speed_only:
            cartesian = EgmPose(point.reference, turn.reference)
            planned = EgmMotion(cartesian=cartesian, external_joints=outside or None)
        if twist is not None:
            rates = (0.0,) * self._externals.count if still else external.velocity
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
        return self._point.reference, heading.pose.position


def _check_twist(twist: Twist) -> None:
    (vx, vy, vz), (wx, wy, wz), frame = twist
    if frame is not Frame.BASE:
        raise CommandError(f"the twist is in the {frame.value} frame; it must be in base")
    if refused := (
        outside("linear", (vx, vy, vz), LINEAR_VELOCITY_M_S)
        or outside("angular", (wx, wy, wz), ANGULAR_VELOCITY_RAD_S)
    ):
        raise CommandError(refused)


_AGE_MS_MAX = 2**32 - 1


class PathCorrectionGenerator(ReferenceGenerator):
    """Path correction: EGMMoveL and EGMMoveC. The reference is the offset from the path."""

    kinds = frozenset((CommandKind.HOLD, CommandKind.PATH_CORRECTION))

    def __init__(self, options: AbbEgmOptions) -> None:
        reach = options.path_offset_m
        self._offset = PointLimiter(
            options.linear_speed_m_s,
            options.linear_acceleration_m_s2,
            ((0.0, -reach, -reach), (0.0, reach, reach)),
        )
        self.answer = no_answer

    def check(self, command: RobotCommand) -> None:
        if isinstance(command, HoldCommand):
            return
        if not isinstance(command, PathCorrectionCommand):
            raise wrong_kind("EGM in path-correction mode", command, self.kinds)
        check_numbers("offset", command.offset, COORDINATE_M, 3, "axes")
        if not 0.0 <= command.age_s * 1000.0 <= _AGE_MS_MAX:
            raise CommandError(f"age_s is {command.age_s}; it must be 0 or more")

    def reset(self, state: RobotState) -> None:
        self._offset.reset(ZERO3)
        self._age_ms = 0

    def coast(self, gap_s: float) -> None:
        pass  # A controller goes to the last offset and stops there.

    def resync(self, references: References, dt_s: float, gap_s: float) -> None:
        self._offset.reset(self._offset.reference)

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
        header = EgmHeader(seqno, tm_ms, EgmMessageType.PATH_CORRECTION)
        return encode_path_corr(EgmSensorPathCorr(header, self._offset.reference, self._age_ms))

    @property
    def moving(self) -> bool:
        return self._offset.moving

    def progress(self, heading: RobotState) -> tuple[Sequence[float], Sequence[float]] | None:
        return None
