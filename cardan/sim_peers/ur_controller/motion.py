"""Motion of the simulated arm: the program's target, frame by frame, and the arm's lag.

UR publishes the speed profile of its moves (a trapezoid) and the start of a blend, but neither
servoj's law nor the arm's. Here `servoj` moves the target to the commanded joints with the time
constant `lookahead_time` for any gain, which is the lag behind a ramp; the arm follows its target
with 8 ms.

A move with a blend radius is done for its program once the TCP is within it of the waypoint. The
next move begins at once, and the rest of the first is superimposed until its end, each with half of
the acceleration. This needs no look-ahead: without a next move the first comes to rest at its
waypoint.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from cardan.sim_peers.kinematics import AXES, Differential, forward
from cardan.sim_peers.ur_controller.actions import (
    Action,
    DirectTorque,
    Move,
    MoveC,
    MoveJ,
    MoveL,
    ServoJ,
    Sleep,
    SpeedJ,
    SpeedL,
    StopJ,
    StopL,
)
from cardan.sim_peers.ur_controller.contact import UP, Compliance, ContactPlane, ForceMode
from cardan.sim_peers.ur_controller.dynamics import Dynamics, RigidBody
from cardan.sim_peers.ur_controller.kinematics import UrKinematics, pose_of
from cardan.sim_peers.ur_controller.paths import (
    Course,
    MovejPath,
    MovelPath,
    ToolPath,
    arc_or_line,
    joints_on,
    length_within,
    ramp,
    tcp_on,
)
from cardan.sim_peers.ur_controller.values import UrPose
from cardan.spatial import (
    add,
    conjugate,
    cross,
    from_rotation_vector,
    multiply,
    norm,
    normalized,
    rotate,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import IDENTITY_POSE, Pose as Frame, Vector3

MAX_POSITIONS: Final = 1000
"""Frames of history for `get_actual_joint_positions_history`."""
HARDEST_N: Final = 150.0
"""Contact force at which the safety system stops the arm."""
TOUCHED_N: Final = 5.0
"""Force from which `tool_contact` detects a contact."""
STEADY_S: Final = 0.5
GRAVITY: Final = (0.0, 0.0, 9.82)

_ARM_LAG_S: Final = 0.008
_STOP_RAD_S2: Final = 15.0
"""Deceleration of a stop that the program has not commanded."""
_SLIDER_PER_S: Final = 4.0
"""Rate at which the speed follows the slider, and recovers after a pause."""
_AT_REST: Final = 1e-9
_TOO_FAST: Final = 1.05
"""Multiple of a joint's highest speed at which the safety system stops the arm."""
_ROUNDING: Final = 1e-9
_SAMPLES: Final = 32
"""Parts of a path whose joint speeds are compared."""


SENSED_STIFFNESS_N_M: Final = 20_000.0
"""Stiffness that force mode assumes for contacts measured by an external sensor (chosen)."""

_IN_TOOL_SPACE: Final = (MoveL, MoveC, SpeedL)


class UrControlMode(enum.IntEnum):
    """Control mode of the arm; the numbers are the primary interface's."""

    POSITION = 0
    TEACH = 1
    FORCE = 2
    TORQUE = 3


@dataclass
class Payload:
    """Payload set by the program, kg and m from the flange."""

    mass: float = 0.0
    cog: tuple[float, ...] = (0.0, 0.0, 0.0)
    inertia: tuple[float, ...] = (0.0,) * 6


@dataclass
class ExternalSensor:
    """External force sensor, whose measurements a client of RTDE writes."""

    place: tuple[float, ...]
    """Position from the flange, m."""
    turned: bool
    """Levers have the opposite sign, as with `enable_external_ft_sensor`."""


class _StopError(Exception):
    """Reason why the safety system has to stop the arm."""


@dataclass(eq=False)
class _Run:
    """Active move."""

    action: Move
    path: MovejPath | ToolPath
    course: Course
    tcp: Frame
    released_at: float
    """Length at which the program continues."""
    waypoint: UrPose
    released: bool = False
    """The program has continued, or may."""

    @property
    def done(self) -> bool:
        """True at rest at its waypoint."""
        return self.course.done


@dataclass(eq=False)
class _Tail:
    """Rest of the previous move."""

    run: _Run
    course: Course
    joints: list[float]
    """Joints at its waypoint."""


class ArmMotion:
    """The joints, commanded (`target_q`) and measured (`actual_q`), rad and rad/s."""

    def __init__(
        self,
        kinematics: UrKinematics,
        start: Sequence[float],
        speed: Sequence[float],
        low: Sequence[float],
        high: Sequence[float],
        dynamics: Dynamics,
        *,
        plane: ContactPlane | None = None,
        say: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.kinematics, self._dynamics = kinematics, dynamics
        self.target_q = list(start)
        self.target_qd = [0.0] * AXES
        self.target_qdd = [0.0] * AXES
        self.actual_q = list(start)
        self.actual_qd = [0.0] * AXES
        self.actual_qdd = [0.0] * AXES
        self.steps = 0
        """Frames so far."""
        self.tcp = IDENTITY_POSE
        """In the flange's frame."""
        self.payload = Payload()
        self.gravity: tuple[float, ...] = GRAVITY
        self.freedrive = False
        self.paused = False
        """The program is paused: the arm rests on its path."""
        self.force = ForceMode()
        self.sensor: ExternalSensor | None = None
        """Sensor that replaces the arm's own; None: no replacement."""
        self.sensed: tuple[float, ...] = (0.0,) * AXES
        """Its measurement written by a client: force (N) and torque (N·m), flange axes."""
        self._by_torque = False
        """A program drives the joints by torques in this frame."""
        self.scale = 1.0
        """Speed of a program's motion as a share; it follows the slider."""
        self._fresh = True
        self._speed, self._low, self._high = speed, low, high
        self._plane, self._say = plane, say
        self._zero = Vector3(0.0, 0.0, 0.0)
        self._contact_frames = 0
        self._hard = False
        self._rest_s = 0.0
        self._past: deque[tuple[float, ...]] = deque([tuple(start)], maxlen=MAX_POSITIONS)
        self._q = list(start)
        """Joints commanded by the program's motion, rad; force mode adds to them."""
        self._qd = [0.0] * AXES
        self._run: _Run | None = None
        self._tail: _Tail | None = None
        self._skipped: Move | None = None
        self._apart = False
        """True if force mode has moved the arm off the program's motion."""
        self._rate = 1.0
        """Rate of a move's time while it is held."""
        self._twist: list[float] | None = None
        """TCP speed set by a program."""
        self._line: Frame | None = None
        """Pose that the TCP has reached by it."""

    # -- queries ----------------------------------------------------------------------------------

    @property
    def moving(self) -> bool:
        """True if the target moves."""
        return any(abs(v) > _AT_REST for v in self.target_qd)

    @property
    def load(self) -> RigidBody:
        """Payload as a rigid body."""
        return RigidBody(self.payload.mass, self.payload.cog, self.payload.inertia)

    @property
    def resuming(self) -> bool:
        """True if a move speeds up again after it was held on its path."""
        return self._run is not None and not self.paused and self._rate < 1.0

    @property
    def steady(self) -> bool:
        """True if the target has been at rest for half a second."""
        return self._rest_s >= STEADY_S - _ROUNDING

    @property
    def control_mode(self) -> UrControlMode:
        """Present control mode of the arm."""
        if self.freedrive:
            return UrControlMode.TEACH
        if self._by_torque:
            return UrControlMode.TORQUE
        return UrControlMode.POSITION if self.force.asked is None else UrControlMode.FORCE

    @property
    def tcp_offset(self) -> UrPose:
        """TCP in the flange's frame."""
        return pose_of(self.tcp)

    def target_tcp_pose(self) -> UrPose:
        """Forward kinematics of the commanded joints."""
        return pose_of(self.kinematics.forward(self.target_q, self.tcp))

    def actual_tcp_pose(self) -> UrPose:
        """Forward kinematics of the measured joints."""
        return pose_of(self.kinematics.forward(self.actual_q, self.tcp))

    def target_tcp_speed(self) -> UrPose:
        """TCP speed of the commanded joints, base frame, m/s over rad/s."""
        return UrPose(self.kinematics.speed(self.target_q, self.target_qd, self.tcp))

    def actual_tcp_speed(self) -> UrPose:
        """TCP speed of the measured joints, base frame, m/s over rad/s."""
        return UrPose(self.kinematics.speed(self.actual_q, self.actual_qd, self.tcp))

    def waypoint(self) -> UrPose:
        """Target of the present move; without one, the target pose of the TCP."""
        run = self._run
        return self.target_tcp_pose() if run is None or run.done else run.waypoint

    def in_range(self, q: Sequence[float]) -> bool:
        """Return True if all joints are in range."""
        return all(
            low <= each <= high for low, each, high in zip(self._low, q, self._high, strict=True)
        )

    def is_singular(self, threshold: float) -> bool:
        """Return True if the smallest singular value of the arm's Jacobian is below `threshold`."""
        return Differential(forward(self.actual_q, self.kinematics.links)).is_singular(threshold)

    def fastest_on(
        self, path: MovejPath | ToolPath, start_q: Sequence[float] | None = None
    ) -> float:
        """Return the highest speed along a path from `start_q` (default: the target) at which no
        joint is too fast."""
        q = self.target_q if start_q is None else start_q
        length, fastest = path.length / _SAMPLES, math.inf
        for sample in range(1, _SAMPLES + 1):
            found = joints_on(self.kinematics, path, sample * length, q, self.tcp)
            if found is None:  # The move itself says so, once it gets there.
                break
            for before, after, speed in zip(q, found, self._speed, strict=True):
                if after != before:
                    fastest = min(fastest, speed * length / abs(after - before))
            q = found
        return fastest if math.isfinite(fastest) else min(self._speed)

    def tcp_force(self) -> UrPose:
        """Return the force on the tool (N, N·m) about the flange, base frame: from the external
        sensor, or `contact_force`."""
        sensor = self.sensor
        if sensor is None:
            return self.contact_force()
        turn = self.kinematics.forward(self.actual_q).orientation
        force = Vector3(*self.sensed[:3])
        way = -1.0 if sensor.turned else 1.0
        lever = scale(cross(Vector3(*sensor.place), force), way)
        force, torque = rotate(turn, force), rotate(turn, add(Vector3(*self.sensed[3:]), lever))
        # It measures the load's weight, which is subtracted.
        held = scale(Vector3(*self.gravity), self.payload.mass)
        center = rotate(turn, Vector3(*self.payload.cog))
        return UrPose((*add(force, held), *add(torque, scale(cross(center, held), way))))

    def contact_force(self) -> UrPose:
        """Return the contact force since zeroing (N, N·m) about the flange, base frame."""
        force = self._contact_force()
        if not any(force):
            return UrPose((0.0,) * AXES)
        tip = self.kinematics.forward(self.actual_q, self.tcp).position
        flange = self.kinematics.forward(self.actual_q).position
        return UrPose((*force, *cross(subtract(tip, flange), force)))

    def joint_torques(self) -> list[float]:
        """Torques by which the joints resist the contact, N·m."""
        return self._joint_torques(self.actual_q)

    def _joint_torques(self, q: Sequence[float]) -> list[float]:
        pushed = self._pushed(q)
        return [column[2] * pushed for column in self.kinematics.jacobian(q, self.tcp)]

    def zero_force(self) -> None:
        """Zero the sensor at its present force."""
        self._zero = Vector3(0.0, 0.0, self.pushed())

    def touched(self, direction: Sequence[float]) -> int:
        """Return the frames since the start of a contact against `direction`; 0: no contact."""
        if self.pushed() < TOUCHED_N or (any(direction[:3]) and direction[2] >= 0.0):
            return 0
        return self._contact_frames

    def position_before(self, frames: int) -> list[float]:
        """Return the measured joints `frames` frames ago."""
        return list(self._past[-1 - frames])

    @property
    def positions_retained(self) -> int:
        """Number of positions for `position_before`."""
        return len(self._past)

    def pushed(self) -> float:
        """Upward contact force on the TCP, N."""
        return self._pushed(self.actual_q)

    def _pushed(self, q: Sequence[float]) -> float:
        if self._plane is None:
            return 0.0
        return self._plane.force(self.kinematics.forward(q, self.tcp).position)

    def _contact_force(self) -> Vector3:
        return subtract(Vector3(0.0, 0.0, self.pushed()), self._zero)

    # -- instructions that take no time -----------------------------------------------------------

    def begin_force(self, asked: Compliance) -> None:
        """Enter force mode."""
        self.force.begin(asked)

    def set_tcp(self, tcp: Frame) -> None:
        """Set the TCP in the flange's frame."""
        self.tcp = tcp
        self._twist = self._line = None

    def end_force(self) -> None:
        """Leave force mode: the arm keeps its offset until a new move begins."""
        self._apart = self._apart or self.force.asked is not None
        self.force.end()

    def end_modes(self) -> None:
        """End the modes of a program at its end."""
        self.end_force()
        self.freedrive = False

    def halt(self) -> None:
        """Stop the active motion: the arm brakes."""
        self.freedrive = False
        self._drop()

    def _drop(self) -> None:
        self._run = self._tail = None
        self._twist = self._line = None
        self._rate = 1.0
        self._apart = False
        self.force.halt()
        self._q, self._qd = list(self.target_q), list(self.target_qd)

    # -- frames -----------------------------------------------------------------------------------

    def left_of(self, action: Action, dt_s: float) -> Action | None:
        """Return the rest of an action after the last frame; None if it has ended."""
        if isinstance(action, MoveJ | MoveL | MoveC):
            return None if self._released(action) else action
        if isinstance(action, DirectTorque):
            return None
        if isinstance(action, StopJ | StopL):
            return action if self.moving else None
        if isinstance(action, SpeedJ | SpeedL) and action.left_s == 0.0:
            return None if self._at_speed(action) else action
        assert isinstance(action, ServoJ | SpeedJ | SpeedL)
        left_s = action.left_s - dt_s * self.scale
        return None if left_s <= _ROUNDING else action._replace(left_s=left_s)

    def _released(self, action: Move) -> bool:
        run = self._run
        return action is self._skipped or (
            run is not None and run.action is action and run.released
        )

    def _at_speed(self, action: SpeedJ | SpeedL) -> bool:
        if isinstance(action, SpeedJ):
            now, wanted = self._qd, action.qd
        else:
            now, wanted = self._twist or [math.inf] * AXES, action.xd
        return all(
            abs(v - self.scale * aim) <= _AT_REST for v, aim in zip(now, wanted, strict=True)
        )

    def step(self, action: Action | None, dt_s: float, scale: float) -> str:
        """Run a frame of `dt_s`, the program's time running `scale` times as fast as real time.

        Action None brakes. Returns the reason for a stop by the safety system; empty: none.
        """
        if self._fresh:
            self.scale, self._fresh = scale, False
        most = _SLIDER_PER_S * dt_s
        self.scale += min(max(scale - self.scale, -most), most)
        self._by_torque = isinstance(action, DirectTorque)
        why = ""
        try:
            q = self._asked(action, dt_s)
            self._check_speeds(self._q, q, dt_s, isinstance(action, _IN_TOOL_SPACE))
            target = q
            if self.force.asked is not None or self._apart:
                target = self._bent(q, dt_s)
                self._check_speeds(self.target_q, target, dt_s, True)
        except _StopError as error:
            why = str(error)
            self._drop()
            q = target = self._braked(dt_s)
        for joint, each in enumerate(target):
            if not self._low[joint] <= each <= self._high[joint]:
                why = why or f"joint {joint + 1} is at the end of its range"
                target = [*target[:joint], self.target_q[joint], *target[joint + 1 :]]
                self._drop()
        if why:
            q = target
        speeds = [(a - b) / dt_s for a, b in zip(target, self.target_q, strict=True)]
        self._qd = [(a - b) / dt_s for a, b in zip(q, self._q, strict=True)]
        self.target_qdd = [(a - b) / dt_s for a, b in zip(speeds, self.target_qd, strict=True)]
        self._q, self.target_q, self.target_qd = list(q), list(target), speeds
        self._rest_s = 0.0 if self.moving else self._rest_s + dt_s
        self._meet()
        self._follow(dt_s)
        return self._touch() or why

    def _check_speeds(
        self, before: Sequence[float], after: Sequence[float], dt_s: float, tool_space: bool
    ) -> None:
        words = "too fast for the joints, as near a singularity: " if tool_space else ""
        for number, (a, b, most) in enumerate(zip(after, before, self._speed, strict=True)):
            if abs(a - b) > _TOO_FAST * most * dt_s:
                raise _StopError(
                    f"{words}joint {number + 1} was asked for {(a - b) / dt_s:.2f} rad/s, "
                    f"beyond {most:.2f}"
                )

    def _meet(self) -> None:
        """Continue the program's motion from the place to which force mode has moved the arm."""
        if self._run is not None and not (self._run.done and self._tail is None):
            return
        if self.force.asked is not None or self._apart:
            self._q, self._line = list(self.target_q), None
            self._apart = self._apart and self.force.moves

    def _follow(self, dt_s: float) -> None:
        self.steps += 1
        share = dt_s / (_ARM_LAG_S + dt_s)
        for joint, goal in enumerate(self.target_q):
            change = share * (goal - self.actual_q[joint])
            self.actual_q[joint] += change
            speed = change / dt_s
            self.actual_qdd[joint] = (speed - self.actual_qd[joint]) / dt_s
            self.actual_qd[joint] = speed
        self._past.append(tuple(self.actual_q))

    def _touch(self) -> str:
        pushed = self.pushed()
        self._contact_frames = self._contact_frames + 1 if pushed else 0
        was_hard, self._hard = self._hard, pushed > HARDEST_N
        if self._hard and not was_hard:
            return f"the arm touches something with {pushed:.0f} N, beyond {HARDEST_N:.0f} N"
        return ""

    # -- motion of the program --------------------------------------------------------------------

    def _asked(self, action: Action | None, dt_s: float) -> list[float]:
        """Return the commanded joints at the end of the frame."""
        if isinstance(action, MoveJ | MoveL | MoveC):
            self._twist = self._line = None
            return self._moved(action, dt_s)
        if action is None or isinstance(action, Sleep):
            self._twist = self._line = None
            if self._run is not None:
                return self._along(self._run, dt_s, held=self.paused or not self._run.released)
            return self._braked(dt_s)
        self._run = self._tail = None
        self._rate = 1.0
        if isinstance(action, SpeedL):
            scaled = self.scale * dt_s
            aims = [self.scale * v for v in action.xd]
            return self._lined(aims, action.a * scaled, action.a_rot * scaled, dt_s)
        if isinstance(action, StopL):
            try:
                rest = [0.0] * AXES
                return self._lined(rest, action.a * dt_s, action.a_rot * dt_s, dt_s)
            except _StopError:
                return self._braked(dt_s)
        self._twist = self._line = None
        if isinstance(action, DirectTorque):
            return self._driven(action.torques, dt_s)
        if isinstance(action, ServoJ):
            share = -math.expm1(-dt_s * self.scale / action.lookahead_s)
            return [q + (goal - q) * share for goal, q in zip(action.q, self._q, strict=True)]
        if isinstance(action, SpeedJ):
            aims = [self.scale * v for v in action.qd]
            return self._toward(aims, action.acceleration * self.scale * dt_s, dt_s)
        assert isinstance(action, StopJ)
        return self._toward([0.0] * AXES, action.deceleration * dt_s, dt_s)

    def _driven(self, torques: Sequence[float], dt_s: float) -> list[float]:
        q, qd = self._q, self._qd
        if self._plane is not None:
            # Use the target, and not the lagging arm: with a late contact it would bounce ever
            # higher.
            torques = [a + b for a, b in zip(torques, self._joint_torques(q), strict=True)]
        changes = self._dynamics.acceleration(q, qd, torques, self.load)
        return [
            at + (v + change * dt_s) * dt_s for at, v, change in zip(q, qd, changes, strict=True)
        ]

    def _braked(self, dt_s: float) -> list[float]:
        return self._toward([0.0] * AXES, _STOP_RAD_S2 * dt_s, dt_s)

    def _toward(self, speeds: Sequence[float], change: float, dt_s: float) -> list[float]:
        """Change the speeds by at most `change`, all by the same fraction."""
        difference = [aim - v for aim, v in zip(speeds, self._qd, strict=True)]
        largest = max(map(abs, difference))
        share = 1.0 if largest <= change else change / largest
        return [
            q + (v + share * each) * dt_s
            for q, v, each in zip(self._q, self._qd, difference, strict=True)
        ]

    def _lined(
        self, aims: Sequence[float], change: float, turning: float, dt_s: float
    ) -> list[float]:
        """Change the TCP's speed by at most `change` and `turning`, m/s and rad/s."""
        now = self._twist or list(self.kinematics.speed(self._q, self._qd, self.tcp))
        twist: list[float] = []
        for first, most in ((0, change), (3, turning)):
            part = Vector3(*now[first : first + 3])
            difference = subtract(Vector3(*aims[first : first + 3]), part)
            length = norm(difference)
            twist += add(part, scale(difference, 1.0 if length <= most else most / length))
        here = self._line or self.kinematics.forward(self._q, self.tcp)
        if not any(twist):
            self._twist, self._line = twist, here
            return list(self._q)
        way, turn = Vector3(*twist[:3]), Vector3(*twist[3:])
        return self._held_on(_displaced(here, scale(way, dt_s), scale(turn, dt_s)), twist)

    def _held_on(self, there: Frame, twist: list[float]) -> list[float]:
        q = self.kinematics.inverse(there, self._q, self.tcp)
        if q is None:
            raise _StopError("the arm does not reach as far as the program asks")
        self._twist, self._line = twist, there
        return q

    def _bent(self, q: Sequence[float], dt_s: float) -> list[float]:
        """Return the program's joints modified by force mode."""
        before, after = (self.kinematics.forward(each, self.tcp) for each in (self._q, q))
        way = subtract(after.position, before.position)
        turn = rotation_between(before.orientation, after.orientation)
        here = self.kinematics.forward(self.target_q, self.tcp)
        if self.sensor is None:
            contact_force, touched = self._contact_force(), (0.0, UP)
            if self._plane is not None and self.pushed() > 0.0:
                touched = (self._plane.stiffness_n_m, UP)
        else:
            contact_force = Vector3(*self.tcp_force()[:3])
            size = norm(contact_force)
            touched = (
                (SENSED_STIFFNESS_N_M, scale(contact_force, 1.0 / size)) if size else (0.0, UP)
            )
        way, turn = self.force.motion(here, (way, turn), contact_force, touched, dt_s)
        if not any(way) and not any(turn):
            return list(self.target_q)
        found = self.kinematics.inverse(_displaced(here, way, turn), self.target_q, self.tcp)
        if found is None:
            raise _StopError("the arm does not reach as far as force mode wants")
        return found

    # -- moves ------------------------------------------------------------------------------------

    def _moved(self, action: Move, dt_s: float) -> list[float]:
        run = self._run
        if run is not None and (run.action is action or action is self._skipped):
            return self._along(run, dt_s)
        self._skipped = None
        if run is not None and not run.released:
            self._run = self._tail = run = None
        if run is None and any(abs(v) > _AT_REST for v in self._qd):
            return self._braked(dt_s)
        before = None if run is None or run.done else run
        if before is None and self._apart and self.force.asked is None:
            if self.force.moves:
                return list(self._q)
            self._q, self._apart = list(self.target_q), False
        begun = self._begun(action, before, dt_s)
        return self._along(begun, dt_s)

    def _along(self, run: _Run, dt_s: float, held: bool = False) -> list[float]:
        """Run a frame along the path; if `held`, the arm comes to rest on it."""
        if run.done and self._tail is None:
            run.released = True
            return list(self._q)
        if held:
            fastest = max(map(abs, self._qd))
            less = _STOP_RAD_S2 * dt_s / fastest if fastest > _AT_REST else 1.0
            self._rate = max(self._rate * (1.0 - less), 0.0)
        else:
            self._rate = min(self._rate + _SLIDER_PER_S * dt_s, 1.0)
        passed_s = dt_s * self.scale * self._rate
        run.course.advance(passed_s)
        tail = self._tail
        if tail is not None:
            tail.course.advance(passed_s)
        q = self._place(run, tail)
        if q is None:
            raise _StopError("the arm does not reach a point of the path")
        if tail is not None and tail.course.done:
            self._tail = None
        if self._tail is None:
            run.released = run.done or run.course.s >= run.released_at - _ROUNDING
        return q

    def _place(self, run: _Run, tail: _Tail | None) -> list[float] | None:
        kinematics, path, s = self.kinematics, run.path, run.course.s
        if tail is None:
            return joints_on(kinematics, path, s, self._q, run.tcp)
        before, left = tail.run, tail.course.s
        if (
            not isinstance(path, MovejPath)
            and not isinstance(before.path, MovejPath)
            and run.tcp == before.tcp
        ):
            first, second, corner = before.path.at(left), path.at(s), path.start
            there = Frame(
                add(first.position, subtract(second.position, corner.position)),
                normalized(
                    multiply(
                        multiply(first.orientation, conjugate(corner.orientation)),
                        second.orientation,
                    )
                ),
            )
            return kinematics.inverse(there, self._q, run.tcp)
        one = joints_on(kinematics, before.path, left, self._q, before.tcp)
        two = joints_on(kinematics, path, s, self._q, run.tcp)
        if one is None or two is None:
            return None
        return [a + b - c for a, b, c in zip(one, two, tail.joints, strict=True)]

    def _begun(self, action: Move, before: _Run | None, dt_s: float) -> _Run:
        """Return the new move's run, or the previous one, which then skips it."""
        tcp = self.tcp
        start_q: list[float] | None = list(self._q)
        if before is not None:
            start_q = joints_on(
                self.kinematics, before.path, before.path.length, self._q, before.tcp
            )
        if start_q is None:
            raise _StopError("the arm does not reach a point of the path")
        start = self.kinematics.forward(start_q, tcp)
        path = _path(action, start_q, start)
        length = path.length
        goal = tcp_on(self.kinematics, path, length, tcp)
        reached = isinstance(path, MovejPath) or self.kinematics.inverse(goal, start_q, tcp)
        if not reached:
            raise _StopError("the pose that a move leads to is out of the arm's reach")
        way = norm(subtract(goal.position, start.position))
        if before is not None and action.r > 0.0 and before.action.r + action.r > way:
            self._say("Overlapping Blends: a move is skipped")
            self._skipped = action
            return before
        a, most = self._limits(action, path, start_q)
        within = 0.0
        if action.r > 0.0 and way > _ROUNDING:
            within = length_within(self.kinematics, path, action.r, tcp)
        # Limit the speed such that two moves with a common corner stay within its acceleration, for
        # any angle and up to two frames of delay.
        entry = math.sqrt((a * dt_s) ** 2 + a * within) - a * dt_s
        self._tail = None
        pieces: list[tuple[float, float]] = []
        v, free = 0.0, length - within
        if before is not None and before.course.v > _AT_REST:
            left, now = before.path.length - before.course.s, before.course.v
            takes_s = 2.0 * left / now
            same = isinstance(path, MovejPath) is isinstance(before.path, MovejPath)
            spare = max(a - now / takes_s, 0.0) if same else 0.5 * a
            slows = a * takes_s
            v = min(
                most,
                spare * takes_s,
                2.0 * free / takes_s,
                0.5 * (math.sqrt(slows * slows + 4.0 * (2.0 * a * free + entry * entry)) - slows),
            )
            tail = Course(before.course.s, now, before.path.length, [(takes_s, -now / takes_s)])
            self._tail = _Tail(before, tail, start_q)
            pieces.append((takes_s, v / takes_s))
            free -= 0.5 * v * takes_s
        part, at_blend = ramp(free, v, entry, most, a)
        pieces += part
        pieces += ramp(within, at_blend, 0.0, at_blend or most, a)[0]
        if before is None:
            self._rate = 1.0
        self._run = _Run(
            action, path, Course(0.0, 0.0, length, pieces), tcp, length - within, pose_of(goal)
        )
        if not within:
            self._run.released_at = math.inf
        return self._run

    def _limits(
        self, action: Move, path: MovejPath | ToolPath, start_q: Sequence[float]
    ) -> tuple[float, float]:
        """Return acceleration and highest speed along a path. A move for whose time the joints are
        too slow takes longer."""
        if not isinstance(action, MoveC) and action.t > 0.0:
            v = max(path.length / (0.75 * action.t), _AT_REST)
            share = min(self.fastest_on(path, start_q) / v, 1.0) if path.length else 1.0
            return max(v * share * share / (0.25 * action.t), _AT_REST), v * share
        most = action.v
        if isinstance(path, MovejPath):
            for change, limit in zip(path.change, self._speed, strict=True):
                if abs(change) > _ROUNDING:
                    most = min(most, limit * path.length / abs(change))
        elif math.isfinite(path.radius):
            # Along the path and across it: together they are the requested acceleration.
            a = action.a * math.sqrt(0.5)
            return a, min(most, math.sqrt(a * path.radius))
        return action.a, most


def _path(action: Move, start_q: Sequence[float], start: Frame) -> MovejPath | ToolPath:
    if isinstance(action, MoveJ):
        return MovejPath(start_q, action.q)
    if isinstance(action, MoveL):
        return MovelPath(start, action.goal)
    return arc_or_line(start, action.via, action.goal, action.fixed)


def _displaced(frame: Frame, way: Vector3, turn: Vector3) -> Frame:
    """Return a frame moved and turned in the base frame."""
    orientation = normalized(multiply(from_rotation_vector(turn), frame.orientation))
    return Frame(add(frame.position, way), orientation)
