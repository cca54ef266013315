"""Planning of motions before they start: their end, and that their whole path is free. It has
kinematics of its own and takes milliseconds, so it runs beside the control loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

from cardan.common.arm_libraries import np, pin
from cardan.common.bounds import SAFETY_DISTANCE_M
from cardan.common.options import Options
from cardan.errors import (
    CollisionError,
    JointLimitError,
    MotionRefusedError,
    OutOfReachError,
)
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import SE3, FloatArray, to_se3
from cardan.gateway.kinematics.collision import CollisionModel, Obstacle
from cardan.gateway.kinematics.singularity import SINGULAR, UNBENT
from cardan.gateway.motion.trajectories import LineTrajectory
from cardan.robots import ArmModel, BodyShape, JointKind
from cardan.robots.arm_bodies import CHARACTERISTIC_LENGTH_M
from cardan.spatial import norm, rotation_between, subtract
from cardan.types import Pose

REACHED_M = 1e-4
REACHED_RAD = 1e-3
"""Tolerance within which a pose counts as reached by an arm with too few joints for every pose."""

WAY_TOLERANCE_M = 1e-3
"""Largest distance of such an arm from a line between the line's ends."""

LINE_STEP_M = 0.005
LINE_STEP_RAD = 0.02
"""Longest joint motion between two samples of a dry run. Joints move straight between them in the
sweep."""

MOST_SAMPLES = 2000

LARGEST_JUMP_RAD = 0.5
"""Largest step of a joint between two samples of a line: more is a change of branch."""

WORKSPACE_SAMPLES = 32

NEAREST_TRIES = 6
"""Downhill searches for arms with too few joints, the first from the arm's position."""

BOUNDLESS = 1e3
"""Range, rad or m, beyond any joint's."""


Workspace = tuple[
    tuple[float, float] | None, tuple[float, float] | None, tuple[float, float] | None
]


@dataclass(frozen=True, kw_only=True)
class Margins(Options):
    """Distances, m, that a planned motion keeps. Raises OptionError."""

    obstacle_m: Annotated[float, SAFETY_DISTANCE_M] = 0.01
    own_body_m: Annotated[float, SAFETY_DISTANCE_M] = 0.005


class DryRun(NamedTuple):
    """Share of the speed at which the joints can follow a line."""

    pace: float
    """Share of the wanted speed that the slowest joint allows, at most 1."""
    slowest: str
    """Name of that joint."""


SPARE_RESTARTS = 12
"""Restarts of the inverse for streams of redundant arms; it finds nearly all within five."""


class Planner:
    """Inverse kinematics and dry runs of one arm, with reasons for impossible motions."""

    def __init__(
        self,
        model: ArmModel,
        *,
        obstacles: Iterable[Obstacle] = (),
        tool_shapes: Iterable[BodyShape] = (),
        movers: Iterable[Sequence[BodyShape]] = (),
        mover_frames: Callable[[], Sequence[SE3]] = tuple,
        ignored: Collection[tuple[str, str]] = (),
        workspace: Workspace = (None, None, None),
        margins: Margins | None = None,
    ) -> None:
        """`movers` and `ignored` as for CollisionModel; `mover_frames` returns the present frames
        of the movers, which are assumed to stay."""
        self.model = model
        self.kinematics = ArmKinematics(model)
        boundless = tuple(
            joint._replace(lower=-BOUNDLESS, upper=BOUNDLESS)
            if joint.kind is not JointKind.CONTINUOUS
            else joint
            for joint in model.joints
        )
        self._boundless = ArmKinematics(model._replace(joints=boundless))
        self.collision = CollisionModel(self.kinematics, obstacles, tool_shapes, movers, ignored)
        self._mover_frames = mover_frames
        self.workspace = workspace
        self.margins = margins or Margins()
        self.names = model.joint_names
        length = CHARACTERISTIC_LENGTH_M
        weights = np.array(model.task.weights)
        self._any_pose = len(model.joints) >= 6 and bool(np.all(weights > 0.0))
        self._nearby_restarts = SPARE_RESTARTS if len(model.joints) > 6 else 0
        self.followed = weights > 0.0
        """Directions that the arm follows, x y z rx ry rz along TCP axes."""
        lengths = (1.0, 1.0, 1.0, length, length, length)
        self._weights = np.where(self.followed, 1.0, 0.0) * lengths
        self._weights_on_way = weights * lengths
        # On the way an arm with few joints keeps the directions that its task counts most.
        self._retained_on_way = weights >= 0.5 * weights.max()
        can_all = np.count_nonzero(self.followed) <= len(model.joints)
        self.retained = self.followed if can_all else self._retained_on_way
        """Directions in which a line must end at its goal: all that the arm follows, or those with
        the highest weight in its task if it has too few joints."""
        self._units = tuple(
            "m" if joint.kind is JointKind.PRISMATIC else "rad" for joint in model.joints
        )

    def set_tool(self, tool: Pose) -> None:
        """Set the TCP to `tool`, relative to the arm's own TCP."""
        self.kinematics.set_tool(tool)
        self._boundless.set_tool(tool)

    def forward(self, q: FloatArray) -> SE3:
        """Return the TCP in the base for `q`."""
        return self.kinematics.forward(q)

    # -- one pose ------------------------------------------------------------------------------

    def inverse(self, verb: str, target: Pose, near: FloatArray) -> FloatArray:
        """Return joint positions on the branch nearest to `near`, rad or m. Raises OutOfReachError
        or JointLimitError."""
        placement = to_se3(target)
        found = self._inverse(placement, near)
        if found is None:
            raise self._why_not(verb, placement, near)
        return found

    def inverse_nearby(self, verb: str, target: Pose, near: FloatArray) -> FloatArray:
        """Return the result of `inverse` on the branch of `near` only, for streams. A redundant arm
        has no branches: the servo chooses its posture."""
        placement = to_se3(target)
        found = (
            self.kinematics.inverse(placement, near, restarts=self._nearby_restarts)
            if self._any_pose
            else self._nearest(self.kinematics, placement, near, 1)
        )
        if found is None:
            raise self._why_not(verb, placement, near)
        return found

    def _inverse(self, placement: SE3, near: FloatArray) -> FloatArray | None:
        if self._any_pose:
            found: FloatArray | None = self.kinematics.inverse(placement, near)
            return found
        return self._nearest(self.kinematics, placement, near, NEAREST_TRIES)

    def _nearest(
        self, kinematics: ArmKinematics, placement: SE3, near: FloatArray, tries: int
    ) -> FloatArray | None:
        random = np.random.default_rng(0)
        low = np.maximum(kinematics.lower, near - math.pi)
        high = np.minimum(kinematics.upper, near + math.pi)
        start = near
        for _ in range(tries):
            q, tcp = kinematics.nearest(placement, start, self._weights)
            if self._arrived(tcp, placement):
                turned = kinematics.nearest_turns(q, near)
                return turned if kinematics.within_limits(turned) else q
            start = random.uniform(np.minimum(low, high), np.maximum(low, high))
        return None

    def _arrived(self, tcp: SE3, placement: SE3) -> bool:
        """Return whether the TCP is at `placement` in all directions that the arm follows."""
        distance, angle = self._miss(tcp, placement)
        return distance < REACHED_M and angle < REACHED_RAD

    def _miss(self, tcp: SE3, placement: SE3) -> tuple[float, float]:
        difference = tcp.actInv(placement)
        distance = np.linalg.norm(difference.translation[self.followed[:3]])
        angle = np.linalg.norm(pin.log3(difference.rotation)[self.followed[3:]])
        return float(distance), float(angle)

    def _why_not(
        self, verb: str, placement: SE3, near: FloatArray, where: str = "", instead: str = ""
    ) -> MotionRefusedError:
        """Return the error for a `placement` without joint positions inside the limits, and what to
        do `instead`; empty: choose another pose."""
        beyond = (
            self._boundless.inverse(placement, near, restarts=0)
            if self._any_pose
            else self._nearest(self._boundless, placement, near, 1)
        )
        if beyond is not None:
            error = self._limit_error(verb, beyond, where)
            if error is not None:
                return error
        _, tcp = self.kinematics.nearest(placement, near, self._weights)
        distance, angle = self._miss(tcp, placement)
        missed = [f"{distance * 1e3:.1f} mm"] if distance >= REACHED_M else []
        if angle >= REACHED_RAD:
            missed.append(f"{angle:.3f} rad")
        if not missed:
            return MotionRefusedError(
                f"{verb}: the pose is at the edge of what the arm reaches{where}; "
                f"{instead or 'choose one nearer to the base'}"
            )
        x, y, z = tcp.translation
        return OutOfReachError(
            f"{verb}: the pose is out of reach by {' and '.join(missed)}{where}; "
            f"{instead or f'choose one near ({x:.2f}, {y:.2f}, {z:.2f}) m'}",
            distance,
            angle,
        )

    def _limit_error(self, verb: str, q: FloatArray, where: str) -> JointLimitError | None:
        """Return the error for the joint that is farthest outside its range at `q`."""
        below, above = self.kinematics.lower - q, q - self.kinematics.upper
        worst = int(np.argmax(np.maximum(below, above)))
        if max(below[worst], above[worst]) <= 1e-9:
            return None
        bounds = self.kinematics.lower if below[worst] > above[worst] else self.kinematics.upper
        limit, value = float(bounds[worst]), float(q[worst])
        name, unit = self.names[worst], self._units[worst]
        return JointLimitError(
            f"{verb}: {name} would have to be at {value:.4f} {unit}{where}; "
            f"its limit is {limit:.4f} {unit}: choose another pose",
            name,
            value,
            limit,
        )

    # -- a joint motion ------------------------------------------------------------------------

    def joint_goal(
        self, verb: str, target: Pose, start: FloatArray, speeds: FloatArray
    ) -> FloatArray:
        """Return the joint goal for `target`: the quickest branch that is free all the way. Raises
        OutOfReachError, JointLimitError, CollisionError or MotionRefusedError."""
        placement = to_se3(target)
        candidates = self.kinematics.branches(placement, start) if self._any_pose else []
        candidates = [q for q in candidates if self.kinematics.within_limits(q)]
        nearest = self._inverse(placement, start)
        if nearest is not None:
            candidates.append(nearest)
        if not candidates:
            raise self._why_not(verb, placement, start)
        self._place_movers()
        candidates.sort(key=lambda q: float((np.abs(q - start) / speeds).max()))
        first: MotionRefusedError | None = None
        for goal in candidates:
            try:
                self._check_joint_path(verb, start, goal)
            except MotionRefusedError as error:
                first = first or error
            else:
                return goal
        assert first is not None
        raise first

    def _check_joint_path(self, verb: str, start: FloatArray, goal: FloatArray) -> None:
        share, pair = self._free_share(start, goal)
        if pair is not None:
            raise self._collision(verb, pair, share)
        if any(self.workspace):
            rows = np.linspace(start, goal, WORKSPACE_SAMPLES + 1)
            for index in range(1, len(rows)):
                where = f" after {index / WORKSPACE_SAMPLES:.0%} of the way"
                self._check_entered(verb, rows[index - 1], rows[index], where)

    def check_joint_samples(self, verb: str, positions: FloatArray) -> None:
        """Check that straight joint motions from row to row of `positions` are free. Raises
        JointLimitError, CollisionError or MotionRefusedError, with the place."""
        self._place_movers()
        last = max(1, len(positions) - 1)
        for index in range(1, len(positions)):
            before, q = positions[index - 1], positions[index]
            where = f" after {index / last:.0%} of the way"
            outside = self._limit_error(verb, q, where)
            if outside is not None and not _returns(self.kinematics, before, q):
                raise outside
            along, pair = self._free_share(before, q)
            if pair is not None:
                raise self._collision(verb, pair, (index - 1 + along) / last)
            if any(self.workspace):
                self._check_entered(verb, before, q, where)
        goal = self.forward(positions[-1]).translation.tolist()
        check_workspace(verb, goal, self.workspace)

    def _check_entered(self, verb: str, before: FloatArray, q: FloatArray, where: str) -> None:
        """Check that the TCP is in the workspace at `q`, or was outside of it already."""
        before_m, now_m = (self.forward(each).translation.tolist() for each in (before, q))
        try:
            check_workspace(verb, before_m, self.workspace)
        except MotionRefusedError:
            return
        check_workspace(verb, now_m, self.workspace, where)

    def _place_movers(self) -> None:
        frames = self._mover_frames()
        self.collision.move(0, frames, [0.0] * len(frames))

    def _free_share(
        self, start: FloatArray, end: FloatArray
    ) -> tuple[float, tuple[str, str] | None]:
        share, pair = self.collision.free_share(start, end, self.margins.obstacle_m)
        if pair is None:
            return share, pair
        index = self.collision.pairs.index(pair)
        if self.collision.with_obstacle[index]:
            return share, pair
        return self.collision.free_share(start, end, self.margins.own_body_m)

    def _collision(self, verb: str, pair: tuple[str, str], share: float) -> CollisionError:
        to, comes = pair
        solids = self.collision.pair_solids[self.collision.pairs.index(pair)]
        if solids[0] >= self.collision.first_mover:
            to += ", where that is now,"
        return CollisionError(
            f"{verb}: {comes} would come too near to {to} after {share:.0%} of the way; "
            "go around it",
            pair,
            share,
        )

    # -- a line --------------------------------------------------------------------------------

    def dry_run(self, verb: str, path: LineTrajectory, start: FloatArray) -> DryRun:
        """Follow `path` from the joint positions `start` without moving anything.

        Raises JointLimitError, CollisionError, OutOfReachError or MotionRefusedError, with the
        place on the line.
        """
        self._place_movers()
        begin, end = path.at(0.0)[0], path.at(path.duration_s)[0]
        way_m = norm(subtract(end.position, begin.position))
        angle = norm(rotation_between(begin.orientation, end.orientation))
        # The peak of a profile is at most twice its mean.
        count = math.ceil(2.0 * max(way_m / LINE_STEP_M, angle / LINE_STEP_RAD)) + 8
        count = min(count, MOST_SAMPLES)
        times = np.linspace(0.0, path.duration_s, count + 1)
        before, pace, slowest = start, 1.0, 0
        velocity, step_s = self.kinematics.velocity, path.duration_s / count
        for index in range(1, count + 1):
            pose = path.at(float(times[index]))[0]
            q = self._continue(pose, before)
            if way_m > 0.0:
                share = norm(subtract(pose.position, begin.position)) / way_m
            else:
                share = norm(rotation_between(begin.orientation, pose.orientation)) / (angle or 1.0)
            where = f" after {share:.0%} of the line"
            if q is None:
                goal = to_se3(end)
                begun, value = (
                    self.kinematics.smallest_singular_value(each, self.model.task.weights)
                    for each in (start, before)
                )
                if begun >= SINGULAR and self._inverse(goal, before) is None:
                    beyond = f", from {share:.0%} of the line on"
                    error = self._why_not(verb, goal, before, beyond)
                    if isinstance(error, OutOfReachError):
                        raise error
                error = self._why_not(verb, to_se3(pose), before, where, "go there by movj")
                if value < SINGULAR and not isinstance(error, JointLimitError):
                    raise MotionRefusedError(f"{verb}: no way on{where}: {UNBENT.format(value)}")
                raise error
            outside = self._limit_error(verb, q, where)
            if outside is not None and not _returns(self.kinematics, before, q):
                raise outside
            jump = np.abs(q - before)
            worst = int(np.argmax(jump))
            if jump[worst] > LARGEST_JUMP_RAD:
                raise MotionRefusedError(
                    f"{verb}: the line passes a singularity: {self.names[worst]} would have to "
                    f"jump by {jump[worst]:.2f} rad{where}; go there by movj"
                )
            along, pair = self._free_share(before, q)
            if pair is not None:
                raise self._collision(verb, pair, (index - 1 + along) / count)
            with np.errstate(divide="ignore"):
                allowed = velocity * step_s / jump
            worst = int(np.argmin(allowed))
            if allowed[worst] < pace:
                pace, slowest = float(allowed[worst]), worst
            before = q
        return DryRun(pace, self.names[slowest] if pace < 1.0 else "")

    def _continue(self, pose: Pose, near: FloatArray) -> FloatArray | None:
        placement = to_se3(pose)
        if self._any_pose:
            found: FloatArray | None = self._boundless.inverse(placement, near, restarts=0)
            return found
        q, tcp = self._boundless.nearest(placement, near, self._weights_on_way)
        missed = np.abs(tcp.actInv(placement).translation[self._retained_on_way[:3]])
        return q if float(missed.max(initial=0.0)) < WAY_TOLERANCE_M else None


def check_workspace(
    verb: str, position: Sequence[float], workspace: Workspace, where: str = ""
) -> None:
    """Raise MotionRefusedError for a position (base axes, m) outside of the box."""
    for axis, value, bounds in zip("xyz", position, workspace, strict=True):
        if bounds is not None and not bounds[0] <= value <= bounds[1]:
            raise MotionRefusedError(
                f"{verb}: {axis} = {value:.4f} m{where} is outside of the workspace, "
                f"{bounds[0]:.4f} to {bounds[1]:.4f} m"
            )


def _returns(kinematics: ArmKinematics, before: FloatArray, q: FloatArray) -> bool:
    """Return whether each joint that is outside its range moves nearer to it."""
    outside_before = np.maximum(kinematics.lower - before, before - kinematics.upper)
    outside = np.maximum(kinematics.lower - q, q - kinematics.upper)
    return bool(np.all((outside <= 1e-9) | (outside <= outside_before)))
