"""An arm in virtual time for the reproductions: a simulated robot, its driver, a record.

The robot is the driver of the simulated arm: commands pass through its protocol and act one cycle
after the state that they answer. Drive "ideal" has no dynamics; "dynamic" is the rigid-body plant
with its position servo, friction and sag.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeVar

from cardan.common.arm_libraries import np, npt, pin
from cardan.drivers.sim_arm import SimArm
from cardan.drivers.sim_arm.options import SimArmOptions
from cardan.gateway.arm.joint_space_arm import JointSpaceArm
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.verb_methods import ArmVerbs
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import SE3, to_pose
from cardan.gateway.kinematics.collision import CollisionModel, Obstacle
from cardan.gateway.motion.shaping import PoseShaper, PoseShaperLimits
from cardan.gateway.motion.speed_limited_reference import Reference, ReferenceLimits
from cardan.gateway.servo.choice import choose_servo
from cardan.robots import load_arm
from cardan.sim_peers.arm.options import SimulatedArmOptions
from cardan.types import ZERO3, ZERO_TWIST, CommandKind, Pose, RobotCommand, RobotState, Twist

Array = npt.NDArray[np.float64]
Drive = Literal["ideal", "dynamic"]
Found = TypeVar("Found")
DRIVES: tuple[Drive, ...] = ("ideal", "dynamic")

DT_S = 0.002
SETTLE_S = 0.6
"""Settling time before the record begins, for the sag of the dynamic arm."""


JERK_M_S3 = 1000.0

STIFF = ControllerOptions(
    streams=ReferenceLimits(
        linear_acceleration_m_s2=5.0,
        linear_jerk_m_s3=JERK_M_S3,
        angular_speed_rad_s=3.4,
        angular_acceleration_rad_s2=30.0,
        angular_jerk_rad_s3=6000.0,
    )
)
"""Stream limits near the arms' own; the package's defaults are for arms with people nearby."""


class Row(NamedTuple):
    """A row of a table."""

    what: str
    published: str
    ideal: str
    dynamic: str
    aim: str = ""
    met: bool | None = None
    """Result of the ideal drive; None without an aim."""


class Trace(NamedTuple):
    """Record of a run, a row for each cycle; positions in the base frame."""

    times_s: Array
    """Time since the start of the record."""
    measured_m: Array
    """TCP position from the measured joints."""
    rotations: Array
    """Orientation of the measured TCP, 3×3 each."""
    commanded_m: Array
    """TCP position commanded in the cycle."""
    joints: Array
    """Measured joint positions."""
    obstacle_m: Array
    """Smallest distance of the measured arm from an obstacle; infinite without any."""
    own_m: Array
    """Smallest distance between bodies of the measured arm."""
    path_speed: Array

    @property
    def speed_m_s(self) -> Array:
        """Speed of the measured TCP."""
        found: Array = np.linalg.norm(np.gradient(self.measured_m, DT_S, axis=0), axis=1)
        return found


class Streams:
    """Drives the arm by streams of the Cartesian controller."""

    def __init__(
        self,
        robot: str,
        driver: SimArm,
        obstacles: Iterable[Obstacle],
        options: ControllerOptions,
        stream: str,
        timeout_s: float = 0.1,
    ) -> None:
        """`stream`: code of the type, pose or twst; `timeout_s`: timeout of the stream."""
        model = load_arm(robot)
        self.verbs = ArmVerbs.alone(model, driver.capabilities, options, obstacles=obstacles)
        self.servo = self.verbs.servo
        self._stream, self._timeout_s = stream, timeout_s
        self.refusals: list[str] = []
        """Reasons of refused stream commands."""

    def begin(self) -> None:
        """Select the stream type; call it after the first tick."""
        self.verbs.set_parameters({"cpsc": self._stream, "cpst": self._timeout_s})

    def pose(self, position: Array, rotation: Array, **how: float) -> str:
        """Stream a pose (m; rotation matrix). Returns the reason of a refusal, or an empty text."""
        answer = self.verbs.stream("pose", pose_of(position, rotation), **how)  # type: ignore[arg-type]
        if answer:
            self.refusals.append(answer)
        return answer

    def twist(self, linear: Sequence[float]) -> None:
        """Stream a twist without rotation, m/s in the base frame."""
        answer = self.verbs.stream("twist", (*linear, 0.0, 0.0, 0.0))
        if answer:
            self.refusals.append(answer)

    def tick(self, state: RobotState) -> RobotCommand:
        """Run the controller's tick."""
        return self.verbs.controller.tick(state)


class Shaped:
    """Drives the arm by absolute poses through the jerk-limited shaper and the servo."""

    def __init__(
        self, robot: str, obstacles: Iterable[Obstacle], limits: PoseShaperLimits, damping: float
    ) -> None:
        kinematics = ArmKinematics(load_arm(robot))
        collision = CollisionModel(kinematics, obstacles)
        self.servo = choose_servo(kinematics, collision, weights=kinematics.arm.task.weights)
        self._follower = JointSpaceArm(self.servo, frozenset({CommandKind.JOINT}))
        self._shaper = PoseShaper(limits, damping=damping)
        self._home = np.array(kinematics.arm.home)
        self.target: Pose | None = None
        self.refusals: list[str] = []
        """Always empty: this interface refuses nothing."""

    def begin(self) -> None:
        """Do nothing: there is no stream type to select."""

    def pose(self, position: Array, rotation: Array) -> None:
        """Move to this pose from now on."""
        self.target = to_pose(pin.SE3(rotation, position))

    def tick(self, state: RobotState) -> RobotCommand:
        """Compute the command of one control instant."""
        servo, shaper = self.servo, self._shaper
        if shaper.pose is None:
            self._follower.place(state)
            shaper.place(servo.pose)
        assert shaper.pose is not None
        goal = shaper.pose
        if self.target is not None:
            shaper.advance(self.target, state.period_s)
        # A continuous joint has no posture to return to.
        servo.posture = np.where(servo.kinematics.continuous, servo.q, self._home)
        twist = shaper.twist.linear, shaper.twist.angular
        servo.tick(goal, twist, state.period_s)
        return self._follower.command(state, state.period_s)


@dataclass(frozen=True)
class _Counterbalanced(SimArmOptions):
    """An arm with gravity compensation by springs, like the PR2's: its drives could not carry its
    weight."""

    @property
    def arm_options(self) -> SimulatedArmOptions:
        options = super().arm_options
        return replace(options, plant=replace(options.plant, gravity_m_s2=ZERO3))


class Session:
    """Drives the arm by twists like a session: reference, servo, sliding along obstacles."""

    def __init__(self, robot: str, obstacles: Iterable[Obstacle], limits: ReferenceLimits) -> None:
        kinematics = ArmKinematics(load_arm(robot))
        collision = CollisionModel(kinematics, obstacles)
        self.servo = choose_servo(kinematics, collision, weights=kinematics.arm.task.weights)
        self._follower = JointSpaceArm(self.servo, frozenset({CommandKind.JOINT}))
        self._reference = Reference(limits)
        self.target: Twist = ZERO_TWIST
        self._placed = False

    def begin(self) -> None:
        """Do nothing: there is no stream type to select."""

    def tick(self, state: RobotState) -> RobotCommand:
        """Compute the command of one control instant."""
        if not self._placed:
            self._follower.place(state)
            self._reference.place(self._follower.measured(state))
            self._placed = True
        self._reference.observe(self._follower.measured(state))
        self._reference.shape(self.target, state.period_s)
        self._follower.follow(self._reference, state.period_s)
        return self._follower.command(state, state.period_s)


Driving = Streams | Shaped | Session


class Bench:
    """A simulated robot with a record of its motion."""

    def __init__(
        self,
        robot: str,
        drive: Drive,
        start: Sequence[float] | Array = (),
        obstacles: Sequence[Obstacle] = (),
        counterbalanced: bool = False,
    ) -> None:
        """`start`: joints, rad; empty: home position."""
        self.robot, self.obstacles = robot, tuple(obstacles)
        options = _Counterbalanced if counterbalanced else SimArmOptions
        self.driver = SimArm(
            options(robot=robot, pacing="virtual", drive=drive, start=tuple(start))
        )
        self.driver.open()
        self._cycles = self.driver.cycles()
        self._kinematics = ArmKinematics(load_arm(robot))
        self._collision = CollisionModel(self._kinematics, self.obstacles)
        with_obstacle = self._collision.with_obstacle
        self._to_obstacles = np.flatnonzero(with_obstacle)
        self._own = np.flatnonzero(~with_obstacle)

    def streams(
        self, stream: str, options: ControllerOptions | None = None, timeout_s: float = 0.1
    ) -> Streams:
        """Return the Cartesian controller, engaged and settled, with its stream selected."""
        options = options or STIFF
        made = Streams(self.robot, self.driver, self.obstacles, options, stream, timeout_s)
        self._engage(made)
        return made

    def session(self, limits: ReferenceLimits) -> Session:
        """Return a session's control tick, engaged and settled."""
        made = Session(self.robot, self.obstacles, limits)
        self._engage(made)
        return made

    def shaped(self, limits: PoseShaperLimits, damping: float = 1.0) -> Shaped:
        """Return shaper and servo, engaged and settled."""
        made = Shaped(self.robot, self.obstacles, limits, damping)
        self._engage(made)
        return made

    def _engage(self, driving: Driving) -> None:
        self.driver.send(driving.tick(next(self._cycles)))
        driving.begin()
        for _ in range(round(SETTLE_S / DT_S)):
            self.driver.send(driving.tick(next(self._cycles)))

    def placement(self, driving: Driving) -> SE3:
        """Return the commanded placement of the TCP."""
        return driving.servo.placement

    def run(self, driving: Driving, seconds: float, operator: Callable[[float], None]) -> Trace:
        """Run for `seconds`; return the record. `operator` acts before each tick, with the time
        since the start."""
        count = round(seconds / DT_S)
        n = self._kinematics.joints
        times: Array = np.arange(count, dtype=np.float64)
        times *= DT_S
        speeds = np.ones(count)
        measured, commanded = np.zeros((count, 3)), np.zeros((count, 3))
        rotations, joints = np.zeros((count, 3, 3)), np.zeros((count, n))
        obstacle, own = np.full(count, math.inf), np.full(count, math.inf)
        for i in range(count):
            state = next(self._cycles)
            operator(times[i])
            self.driver.send(driving.tick(state))
            q = joints[i] = state.joints
            placement = self._kinematics.forward(np.asarray(q))
            measured[i], rotations[i] = placement.translation, placement.rotation
            commanded[i] = driving.servo.placement.translation
            speeds[i] = driving.servo.path_speed
            distances = np.array(self._collision.at(joints[i]))
            if len(self._to_obstacles):
                obstacle[i] = distances[self._to_obstacles].min()
            if len(self._own):
                own[i] = distances[self._own].min()
        return Trace(times, measured, rotations, commanded, joints, obstacle, own, speeds)


def pose_of(position: Array, rotation: Array) -> tuple[float, ...]:
    """Return a pose as six numbers: m and rotation vector, rad."""
    return (*(float(c) for c in position), *pin.log3(rotation).tolist())


class Metronome:
    """Schedule of a sender with a fixed rate."""

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._next = 0

    def due(self, now_s: float) -> float | None:
        """Return the nominal time of the command that is due, s; None: none is due."""
        if now_s < self._next * self._period_s - 1e-9:
            return None
        due_s = self._next * self._period_s
        self._next += 1
        return due_s


PUBLISHED_LOOP_S = 0.1
PUBLISHED_TRAJECTORY_S = 0.5


def published_mechanism(
    command_times_s: Array, commands: Array, times_s: Array, phase_s: float = 0.025
) -> Array:
    """Simulate the published interface with `commands` (time × axes), on an ideal arm.

    Every 0.1 s the newest command becomes a trajectory of one point, at rest there 0.5 s later,
    replacing the previous one: a quintic from the present position, speed and acceleration (the
    interpolation of the joint trajectory controller). `phase_s`: phase of the loop relative to the
    commands.
    """
    total = PUBLISHED_TRAJECTORY_S
    position = commands[0].copy()
    velocity, acceleration = np.zeros_like(position), np.zeros_like(position)
    found = np.empty((len(times_s), len(position)))
    coefficients = np.zeros((6, len(position)))
    coefficients[0] = position
    begun_s, next_s = times_s[0], times_s[0] + phase_s
    for i, now_s in enumerate(times_s):
        t = min(now_s - begun_s, total)
        powers = t ** np.arange(6)
        position = powers @ coefficients
        if now_s >= next_s - 1e-9:
            velocity = (np.arange(1, 6) * powers[:5]) @ coefficients[1:]
            acceleration = (np.array((2.0, 6.0, 12.0, 20.0)) * powers[:4]) @ coefficients[2:]
            if t >= total:
                velocity, acceleration = 0.0 * velocity, 0.0 * acceleration
            newest = int(np.searchsorted(command_times_s, now_s + 1e-9)) - 1
            if newest >= 0:
                coefficients = _quintic(position, velocity, acceleration, commands[newest], total)
                begun_s = now_s
            next_s += PUBLISHED_LOOP_S
        found[i] = position
    return found


def _quintic(p: Array, v: Array, a: Array, goal: Array, total_s: float) -> Array:
    """Coefficients, lowest first, of the quintic from p, v, a to rest at `goal`."""
    rest = goal - p - v * total_s - 0.5 * a * total_s**2
    speed = -v - a * total_s
    t3, t4, t5 = total_s**3, total_s**4, total_s**5
    system = np.array(
        (
            (t3, t4, t5),
            (3.0 * total_s**2, 4.0 * t3, 5.0 * t4),
            (6.0 * total_s, 12.0 * total_s**2, 20.0 * t3),
        )
    )
    tail: Array = np.linalg.solve(system, np.stack((rest, speed, -a)))
    return np.concatenate((np.stack((p, v, 0.5 * a)), tail))


def signed_delays(
    command_times_s: Array, commands: Array, times_s: Array, measured: Array, longest_s: float
) -> Array:
    """For each command, return the time until the output is nearest to it, s; negative: the output
    was early.

    For paths on which noise moves the output ahead or behind. The search covers 0.3 s before the
    command to `longest_s` after.
    """
    found = np.full(len(commands), np.nan)
    for index, (at_s, command) in enumerate(zip(command_times_s, commands, strict=True)):
        first = int(np.searchsorted(times_s, at_s - 0.3))
        last = int(np.searchsorted(times_s, at_s + longest_s))
        if last > first:
            distance = np.linalg.norm(measured[first:last] - command, axis=1)
            found[index] = times_s[first + int(np.argmin(distance))] - at_s
    return found


def quantiles_ms(delays_s: Array) -> str:
    """Format the 5, 50, 95 and 100 % quantiles of the delays, ms."""
    known = delays_s[np.isfinite(delays_s)]
    if not len(known):
        return "none"
    return " / ".join(f"{1e3 * q:.0f}" for q in np.quantile(known, (0.05, 0.5, 0.95, 1.0)))


def both(text: Callable[[Found], str], ideal: Found, dynamic: Found) -> tuple[str, str]:
    """Return a figure for each of the two drives."""
    return text(ideal), text(dynamic)


def table(title: str, rows: Sequence[Row]) -> str:
    """Format rows as text."""
    heads = Row("", "published", "ours, ideal", "ours, dynamic", "aim")
    lines = [heads, *rows]
    widths = [max(len(str(row[i])) for row in lines) for i in range(5)]
    text = [f"\n{title}\n"]
    for row in lines:
        cells = "  ".join(str(row[i]).ljust(widths[i]) for i in range(5))
        verdict = "" if row.met is None else ("met" if row.met else "MISSED")
        text.append(f"{cells}  {verdict}".rstrip())
    return "\n".join(text)
