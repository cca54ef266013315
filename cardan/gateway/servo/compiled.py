"""The servo compiled: the tick of :mod:`cardan.gateway.servo.servo` in C, one call each.

The kernel owns the commanded joints and its workspace; `q`, `v` and `twist` here are views of its
memory. docs/servo.md describes its input and its sources.
"""

from __future__ import annotations

import ctypes
import math
import struct
import weakref
from collections.abc import Callable, Sequence
from typing import Any

from cardan.common.arm_libraries import np
from cardan.common.native import native_call
from cardan.errors import ConfigurationError
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import SE3, FloatArray, to_se3
from cardan.gateway.kinematics.collision import Closest, CollisionModel, HalfSpace, Solid
from cardan.gateway.servo import kernel_layout as layout, native
from cardan.gateway.servo.bounds import JointBounds
from cardan.gateway.servo.options import Policy, ServoOptions
from cardan.gateway.servo.servo import (
    TwistParts,
    closing_decelerations,
    safety_distances,
)
from cardan.gateway.servo.status import ServoStatus
from cardan.robots import Capsule, JointKind, OrientedBox, SixWeights
from cardan.spatial import norm, subtract
from cardan.types import Frame, Pose, Quaternion, Vector3

_unpack_pose = struct.Struct("7d").unpack_from

_SPHERE_M = 1e-9
"""Length below which capsules are spheres, the same as in CollisionModel."""

_ALIGNED = 1.0 - 1e-12
"""Cosine from which an axis counts as aligned with one of the frame's, the same as in
ArmKinematics."""

REFUSED = {
    layout.GOOD: "",
    layout.BAD_INPUT: "a goal, twist, rate or posture that is not a number: braked",
    layout.BAD_PERIOD: "a period that is not above 0 and at most 10 s: nothing moved",
    layout.NO_SOLUTION: "the program has no solution: braked",
}


class _Memory(ctypes.c_char * ctypes.sizeof(layout.CState)):  # type: ignore[misc]
    """State of a kernel; it lives as long as any view of it."""


class CompiledServo:
    """Compiled counterpart of :class:`cardan.gateway.servo.servo.Servo`, for serial arms of up to 9
    joints. Raises NativePartError if the kernel cannot be loaded, ConfigurationError if it cannot
    take the arm, and ValueError for joint positions, rates and postures of a wrong length or that
    are not numbers."""

    not_compiled = ""

    def __init__(
        self,
        kinematics: ArmKinematics,
        collision: CollisionModel | None = None,
        options: ServoOptions | None = None,
        weights: SixWeights = (1.0,) * 6,
    ) -> None:
        """`weights` of x y z rx ry rz along TCP axes; 0 leaves a direction free."""
        library = native.kernel_library()
        self.kinematics = kinematics
        self.collision = collision
        self.options = options = options or ServoOptions()
        n = self.joints = kinematics.joints
        self.bounds = JointBounds(kinematics, options.speed_share, options.acceleration_share)
        self._handle = _create(library, kinematics, self.bounds, collision, options, weights)
        address = library.kernel_state(self._handle)
        self._state: Any = layout.CState.from_address(address)
        self._memory: Any = _Memory.from_address(address)
        weakref.finalize(self._memory, library.kernel_destroy, self._handle).atexit = False
        self._library = library
        held = self._handle, Pose, Vector3, Quaternion, Frame.BASE, n
        self.record_command: Callable[[float], None]
        """Take the commanded joints for those of a stamp, s, as :meth:`Servo.record_command`
        does."""
        self.moved: Callable[[Pose, float], Pose]
        """Return a pose after a time, s, at `twist`."""
        self.targets: Callable[[], tuple[tuple[float, ...], tuple[float, ...]]]
        """Return the commanded joints and their velocities."""
        self._measure, self._tick, self.moved, self.targets, self.record_command = (
            native_call(library, f"kernel_call_{name}", *held)
            for name in ("measure", "tick", "moved", "targets", "note")
        )
        self.projects = min(sum(1 for weight in weights if weight), n) < 6
        self.q = self._window("q", n)
        self.v = self._window("v", n)
        self.twist = self._window("twist", 6).reshape(2, 3)
        self._motion = self._window("motion", 6).reshape(2, 3)
        self._posture = self._window("posture", n)
        self._expected = self._window("pose_joints", n)
        self._joint_rate = layout.CState.joint_rate.offset
        self._goal_joints = layout.CState.goal_joints.offset
        self._goal_rate = layout.CState.goal_rate.offset
        self._pose_joints = layout.CState.pose_joints.offset
        self._pose_position = layout.CState.pose_position.offset
        self._reachable = layout.CState.reachable_position.offset
        self._turns = sum(int(turns) << i for i, turns in enumerate(kinematics.continuous.tolist()))
        self.keep_past(0.0)
        self._pack_joints = struct.Struct(f"{n}d").pack_into
        movers = 0 if collision is None else len(collision.solids) - collision.first_mover
        self._placements, self._grown_m = np.zeros((movers, 12)), np.zeros(movers)
        self.policy = options.policy
        self._tool: Pose | None = None
        self._take_tool()
        self.place(np.array(kinematics.arm.home))

    def _window(self, field: str, count: int) -> FloatArray:
        offset = getattr(layout.CState, field).offset
        found: FloatArray = np.frombuffer(self._memory, dtype=float, count=count, offset=offset)
        return found

    def _take_tool(self) -> None:
        """Fix the tool of the kinematics to the last body."""
        tool = self.kinematics.tool
        tcp = to_se3(self.kinematics.arm.tcp) * to_se3(tool)
        if not self._library.kernel_set_tool(
            self._handle, native.numbers(tcp.rotation.ravel()), native.numbers(tcp.translation)
        ):
            raise ConfigurationError("", f"the tool {tool} is not a pose")
        self._tool = tool

    def _checked(self, what: str, values: Any) -> Any:
        """Return `values`, one for each joint, as the kernel takes them."""
        if len(values) != self.joints:
            raise ValueError(f"{what}: {len(values)} values for {self.joints} joints")
        return native.numbers(values)

    def _write(self, what: str, offset: int, values: Any) -> None:
        """Write `values`, one for each joint, into the kernel's input."""
        given = values.tolist() if isinstance(values, np.ndarray) else values
        try:
            self._pack_joints(self._memory, offset, *given)
        except struct.error as error:
            if len(given) != self.joints:
                text = f"{what}: {len(given)} values for {self.joints} joints"
            else:
                text = f"{what}: {given} are not numbers: {error}"
            raise ValueError(text) from None

    def place(self, q: FloatArray) -> None:
        """Start from the joint positions `q`, at rest. Only while nothing is commanded."""
        if self.kinematics.tool is not self._tool:
            self._take_tool()
        if not self._library.kernel_place(self._handle, self._checked("joint positions", q)):
            raise ValueError(f"joint positions {list(q)} are not numbers of at most 1e9")

    def move(self, first: int, frames: Sequence[SE3], grown_m: Sequence[float]) -> None:
        """Move the kernel's bodies between two ticks, as CollisionModel.move does; `collision`,
        which the kernel does not read, stays. Raises ValueError for an invalid placement or
        distance."""
        if self.collision is None:
            return
        placements, grown = self._placements[: len(frames)], self._grown_m[: len(grown_m)]
        for row, frame in zip(placements, frames, strict=True):
            row[:9], row[9:] = frame.rotation.ravel(), frame.translation
        grown[:] = grown_m
        if not self._library.kernel_move(
            self._handle,
            self.collision.first_mover + first,
            len(frames),
            placements.ctypes.data,
            grown.ctypes.data,
        ):
            raise ValueError("placements must be finite, and grown_m finite and not negative")
        self.collision.grow(first, grown_m)

    @property
    def placement(self) -> SE3:
        """Commanded TCP in the base."""
        return self.kinematics.forward(self.q)

    @property
    def pose(self) -> Pose:
        """Commanded TCP in the base."""
        if self.kinematics.tool is not self._tool:
            self._take_tool()
        self._library.kernel_pose(self._handle)
        return self._read_pose(self._pose_position)

    def pose_at(self, q: Sequence[float]) -> Pose:
        """Return the TCP in the base for the joint positions `q`."""
        if self.kinematics.tool is not self._tool:
            self._take_tool()
        self._pack_joints(self._memory, self._pose_joints, *q)
        self._library.kernel_pose_at(self._handle)
        x, y, z, w, i, j, k = _unpack_pose(self._memory, self._pose_position)
        return Pose(Vector3(x, y, z), Quaternion(w, i, j, k))

    def keep_past(self, lag_s: float) -> None:
        """Set the robot's lag, as :meth:`Servo.keep_past` does."""
        self._library.kernel_keep_past(self._handle, lag_s, self._turns)

    def measure(self, joints: Sequence[float]) -> tuple[Pose, float, int]:
        """Return the measured TCP and the joints' error, as :meth:`Servo.measure` does."""
        if self.kinematics.tool is not self._tool:
            self._take_tool()
        found: tuple[Pose, float, int] = self._measure(joints)
        return found

    def expected(self, joints: Sequence[float]) -> FloatArray:
        """Return the expected joint positions, as :meth:`Servo.expected` does."""
        self.measure(joints)
        found: FloatArray = self._expected.copy()
        return found

    def _read_pose(self, offset: int) -> Pose:
        x, y, z, w, i, j, k = _unpack_pose(self._memory, offset)
        return Pose(Vector3(x, y, z), Quaternion(w, i, j, k))

    @property
    def reachable(self) -> Pose | None:
        """The goal of the last tick in the directions that the arm has, as in Servo."""
        if not self.projects:
            return None
        pose = self._read_pose(self._reachable)
        return pose if any(pose.orientation) else None  # None was computed so far.

    @property
    def motion(self) -> FloatArray:
        """Linear and angular velocity of the TCP at `v`, 2×3, base axes, by the Jacobian of the
        last tick or placement."""
        self._library.kernel_motion(self._handle)
        return self._motion

    @property
    def path_speed(self) -> float:
        """Share of the commanded speed that was possible in the last tick, 0..1."""
        share: float = self._state.path_speed
        return share

    @property
    def moving(self) -> bool:
        """True until all joints are at rest."""
        return bool(self._state.moving)

    @property
    def policy(self) -> Policy:
        """Policy if the arm cannot follow."""
        return Policy.REACH if self._state.reach else Policy.PATH

    @policy.setter
    def policy(self, policy: Policy) -> None:
        self._state.reach = Policy(policy) is Policy.REACH

    @property
    def posture(self) -> FloatArray | None:
        """Preferred joint positions for the task's free directions; None: none."""
        return self._posture if self._state.has_posture else None

    @posture.setter
    def posture(self, posture: FloatArray | None) -> None:
        if posture is not None:
            self._posture[:] = self._checked("posture", posture)
        self._state.has_posture = posture is not None

    def move_at(self, v: FloatArray) -> None:
        """Continue at the joint velocities `v` (n) from the next tick on."""
        if not self._library.kernel_move_at(self._handle, self._checked("joint velocities", v)):
            raise ValueError(f"joint velocities {list(v)} are not numbers of at most 1e9")

    def tick(
        self,
        goal: Pose,
        twist: TwistParts,
        dt_s: float,
        joint_rate: FloatArray | None = None,
        slide: bool = False,
    ) -> float:
        """Do the tick of :meth:`Servo.tick`. An invalid number, or a period that is not above 0,
        brakes."""
        if self.kinematics.tool is not self._tool:
            self._take_tool()
        flags = layout.SLIDE if slide else 0
        if joint_rate is not None:
            self._write("joint rates", self._joint_rate, joint_rate)
            flags |= layout.WITH_RATE
        linear, angular = twist
        try:
            share: float = self._tick(goal, linear, angular, dt_s, flags)
        except TypeError as error:
            float(dt_s)  # Raises TypeError if that is the one that is not a number.
            raise ValueError(f"{goal}, {twist}: not a pose and 2×3 numbers: {error}") from None
        return share

    def tick_joints(self, goal: FloatArray, rate: FloatArray, dt_s: float) -> float:
        """Do the tick of :meth:`Servo.tick_joints`. An invalid number, or a period that is not
        above 0, brakes."""
        self._write("joint goal", self._goal_joints, goal)
        self._write("joint rates", self._goal_rate, rate)
        share: float = self._library.kernel_tick_joints(self._handle, dt_s)
        return share

    def brake(self, dt_s: float) -> None:
        """Slow every joint down as fast as it can, obstacles in the braking path included."""
        self._library.kernel_brake(self._handle, dt_s)

    def status(self) -> ServoStatus:
        """Numbers of the last tick."""
        state, names = self._state, self.kinematics.names
        self._library.kernel_status(self._handle)
        closest, collision = Closest(math.inf, ("", "")), self.collision
        if collision is not None and state.nearest >= 0:
            nearest = state.nearest
            closest = Closest(
                state.distance_m, collision.pairs[nearest], collision.grown_of(nearest)
            )
        limiting = state.limiting
        return ServoStatus(
            state.path_speed,
            state.smallest_singular_value,
            state.damping,
            tuple(name for i, name in enumerate(names) if limiting >> i & 1) if limiting else (),
            closest.distance_m,
            closest.names,
            state.active,
            state.error_m,
            state.error_rad,
            state.unreachable_m_s,
            state.unreachable_rad_s,
            state.failures,
            state.most_iterations,
            True,
            REFUSED[state.problem],
            closest.grown_m,
        )


def _create(
    library: Any,
    kinematics: ArmKinematics,
    bounds: JointBounds,
    collision: CollisionModel | None,
    options: ServoOptions,
    weights: SixWeights,
) -> int:
    if not 1 <= kinematics.joints <= layout.MAX_JOINTS:
        raise _refused(kinematics, layout.BAD_JOINTS)
    solids: list[Solid] = [] if collision is None else collision.solids
    shapes = (layout.CShape * len(solids))(*map(_shape, solids))
    pairs = (layout.CPair * (0 if collision is None else len(collision.pairs)))()
    if collision is not None:
        safety = safety_distances(options, collision)
        decelerations = closing_decelerations(options, bounds, collision).tolist()
        for pair, (first, second), clearance_m, deceleration, sweep in zip(
            pairs,
            collision.pair_solids,
            safety,
            decelerations,
            collision.sweeps.tolist(),
            strict=True,
        ):
            pair.first, pair.second = first, second
            pair.safety_m, pair.deceleration_m_s2 = clearance_m, deceleration
            pair.sweep[: len(sweep)] = sweep
    given = layout.COptions(**{name: getattr(options, name) for name in layout.OPTIONS})
    reason = ctypes.c_int32()
    handle: int | None = library.kernel_create(
        ctypes.byref(_arm(kinematics, bounds, weights)),
        ctypes.byref(given),
        shapes,
        len(shapes),
        pairs,
        len(pairs),
        ctypes.byref(reason),
    )
    if not handle:
        raise _refused(kinematics, reason.value)
    return handle


def _refused(kinematics: ArmKinematics, reason: int) -> ConfigurationError:
    return ConfigurationError(
        "",
        f"the compiled servo cannot take the arm {kinematics.arm.name!r}: {layout.REASONS[reason]}",
    )


def _arm(kinematics: ArmKinematics, bounds: JointBounds, weights: SixWeights) -> layout.CArm:
    arm = layout.CArm(joints=kinematics.joints)
    for i, joint in enumerate(kinematics.arm.joints):
        placement = to_se3(joint.placement)
        prismatic = joint.kind is JointKind.PRISMATIC
        axis = tuple(joint.axis)
        if not prismatic and max(axis) > _ALIGNED:
            axis = tuple(float(value > _ALIGNED) for value in axis)
        arm.prismatic[i] = prismatic
        arm.rotation[i][:] = placement.rotation.ravel().tolist()
        arm.position[i][:] = placement.translation.tolist()
        arm.axis[i][:] = axis
    for name in ("lower", "upper", "velocity", "acceleration"):
        getattr(arm, name)[: kinematics.joints] = getattr(bounds, name)
    arm.weights[:] = weights
    return arm


def _shape(solid: Solid) -> layout.CShape:
    shape, made = solid.shape, layout.CShape(body=solid.body)
    if isinstance(shape, Capsule):
        start, end = shape.start, shape.end
        if norm(subtract(end, start)) < _SPHERE_M:
            start = end
        made.kind, made.radius_m = layout.CAPSULE, shape.radius_m
        made.start[:], made.end[:] = start, end
    elif isinstance(shape, OrientedBox):
        placement = to_se3(shape.pose)
        made.kind = layout.BOX
        made.rotation[:] = placement.rotation.ravel().tolist()
        made.position[:] = placement.translation.tolist()
        made.half_m[:] = [0.5 * size for size in shape.size_m]
    elif isinstance(shape, HalfSpace):
        made.kind, made.offset_m = layout.HALF_SPACE, shape.offset_m
        made.normal[:] = shape.normal
    return made
