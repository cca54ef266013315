"""How the simulated arm moves: what a program asks for, frame by frame, and the arm behind it.

UR publishes the speed profile of its moves (a trapezoid) and where a blend begins, and neither
servoj's law nor the arm's. Here `servoj` moves the target towards the joints asked for with
`lookahead_time` as its time constant, whatever the gain, which is what a ramp is behind by; and the
arm follows its target with 8 ms.

A move with a blend radius is done for its program once the TCP is that near to the waypoint. A move
that comes then begins at once, and what is left of the first is added to it until it is over, each
with half of the acceleration. Nothing has to be known ahead for that: until another comes, the
first is on its way to rest at its waypoint.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from cardan.sim_peers.kinematics import AXES
from cardan.sim_peers.ur_controller.actions import (
    Action,
    Move,
    MoveC,
    MoveJ,
    MoveL,
    ServoJ,
    SpeedJ,
    SpeedL,
    StopJ,
    StopL,
    Wait,
)
from cardan.sim_peers.ur_controller.contact import Compliance, ForceMode, Plane
from cardan.sim_peers.ur_controller.kinematics import Kinematics, pose_of
from cardan.sim_peers.ur_controller.paths import (
    Course,
    JointPath,
    LinePath,
    ToolPath,
    arc_or_line,
    joints_on,
    length_within,
    ramp,
    tcp_on,
)
from cardan.sim_peers.ur_controller.values import Pose
from cardan.spatial import (
    add,
    conjugate,
    cross,
    from_rotation_vector,
    multiply,
    norm,
    normalized,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import IDENTITY_POSE, Pose as Frame, Vector3

KEPT_POSITIONS: Final = 1000
"""Frames back to which `get_actual_joint_positions_history` knows the joints."""
HARDEST_N: Final = 150.0
"""Force of a contact at which the safety system stops the arm."""
TOUCHED_N: Final = 5.0
"""Force from which `tool_contact` sees a contact."""
STEADY_S: Final = 0.5
GRAVITY: Final = (0.0, 0.0, 9.82)

_ARM_LAG_S: Final = 0.008
_STOP_RAD_S2: Final = 15.0
"""Of a stop that is not the program's."""
_SLIDER_PER_S: Final = 4.0
"""How fast the speed follows the slider, and comes back after a pause."""
_AT_REST: Final = 1e-9
_TOO_FAST: Final = 1.05
"""Of a joint's highest speed: here the safety system stops the arm."""
_ROUNDING: Final = 1e-9


class ControlMode(enum.IntEnum):
    """How the arm is controlled; the primary interface has the numbers."""

    POSITION = 0
    TEACH = 1
    FORCE = 2
    TORQUE = 3


@dataclass
class Payload:
    """What the arm is told it carries, kg and m from the flange."""

    mass: float = 0.0
    cog: tuple[float, ...] = (0.0, 0.0, 0.0)
    inertia: tuple[float, ...] = (0.0,) * 6


class _StopError(Exception):
    """Why the safety system has to stop the arm."""


@dataclass(eq=False)
class _Run:
    """A move on its way."""

    action: Move
    path: JointPath | ToolPath
    course: Course
    tcp: Frame
    released_at: float
    """The length at which the program goes on."""
    waypoint: Pose


@dataclass(eq=False)
class _Tail:
    """What is left of the move before."""

    run: _Run
    course: Course
    joints: list[float]
    """At its waypoint."""


class Motion:
    """The joints, commanded (`target_q`) and measured (`actual_q`), rad and rad/s."""

    def __init__(
        self,
        kinematics: Kinematics,
        start: Sequence[float],
        speed: Sequence[float],
        low: Sequence[float],
        high: Sequence[float],
        *,
        plane: Plane | None = None,
        say: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.kinematics = kinematics
        self.target_q = list(start)
        self.target_qd = [0.0] * AXES
        self.target_qdd = [0.0] * AXES
        self.actual_q = list(start)
        self.actual_qd = [0.0] * AXES
        self.tcp = IDENTITY_POSE
        """In the flange's frame."""
        self.payload = Payload()
        self.gravity: tuple[float, ...] = GRAVITY
        self.freedrive = False
        self.force = ForceMode()
        self.scale = math.nan
        """How fast a program's motion is, as a share; it follows the slider."""
        self._speed, self._low, self._high = speed, low, high
        self._plane, self._say = plane, say
        self._zero = Vector3(0.0, 0.0, 0.0)
        self._contact_frames = 0
        self._hard = False
        self._rest_s = 0.0
        self._past: deque[tuple[float, ...]] = deque([tuple(start)], maxlen=KEPT_POSITIONS)
        self._q = list(start)
        """What the program's motion asks for; force mode adds to it."""
        self._qd = [0.0] * AXES
        self._run: _Run | None = None
        self._tail: _Tail | None = None
        self._skipped: Move | None = None
        self._rate = 1.0
        """Of a move's time while it is held."""
        self._twist: list[float] | None = None
        """The TCP's speed of a program that sets it."""
        self._line: Frame | None = None
        """Where that has brought the TCP."""

    # -- what others ask --------------------------------------------------------------------------

    @property
    def moving(self) -> bool:
        """Whether the target moves."""
        return any(abs(v) > _AT_REST for v in self.target_qd)

    @property
    def steady(self) -> bool:
        """Whether the target has been at rest for half a second."""
        return self._rest_s >= STEADY_S - _ROUNDING

    @property
    def control_mode(self) -> ControlMode:
        """How the arm is controlled now."""
        if self.freedrive:
            return ControlMode.TEACH
        return ControlMode.POSITION if self.force.asked is None else ControlMode.FORCE

    @property
    def tcp_offset(self) -> Pose:
        """The TCP in the flange's frame."""
        return pose_of(self.tcp)

    def target_tcp_pose(self) -> Pose:
        """Of the commanded joints."""
        return pose_of(self.kinematics.forward(self.target_q, self.tcp))

    def actual_tcp_pose(self) -> Pose:
        """Of the measured joints."""
        return pose_of(self.kinematics.forward(self.actual_q, self.tcp))

    def target_tcp_speed(self) -> Pose:
        """Of the commanded joints, base frame, m/s over rad/s."""
        return Pose(self.kinematics.speed(self.target_q, self.target_qd, self.tcp))

    def actual_tcp_speed(self) -> Pose:
        """Of the measured joints, base frame, m/s over rad/s."""
        return Pose(self.kinematics.speed(self.actual_q, self.actual_qd, self.tcp))

    def waypoint(self) -> Pose:
        """Where the move leads that is on its way; without one, where the TCP is."""
        return self.target_tcp_pose() if self._run is None else self._run.waypoint

    def tcp_force(self) -> Pose:
        """The force on the tool (N, N·m) about the flange, base frame, since it was zeroed."""
        force = self._felt()
        tip = self.kinematics.forward(self.actual_q, self.tcp).position
        flange = self.kinematics.forward(self.actual_q).position
        return Pose((*force, *cross(subtract(tip, flange), force)))

    def joint_torques(self) -> list[float]:
        """What the contact has the joints hold, N·m."""
        columns = self.kinematics.jacobian(self.actual_q, self.tcp)
        return [column[2] * self._pushed() for column in columns]

    def zero_force(self) -> None:
        """What the sensor feels now is none."""
        self._zero = Vector3(0.0, 0.0, self._pushed())

    def touched(self, direction: Sequence[float]) -> int:
        """Frames since a contact began that is against `direction`; 0: there is none."""
        if self._pushed() < TOUCHED_N or (any(direction[:3]) and direction[2] >= 0.0):
            return 0
        return self._contact_frames

    def position_before(self, frames: int) -> list[float]:
        """The measured joints so many frames ago."""
        return list(self._past[-1 - frames])

    @property
    def positions_kept(self) -> int:
        """How many there are for `position_before`."""
        return len(self._past)

    def _pushed(self) -> float:
        if self._plane is None:
            return 0.0
        return self._plane.force(self.kinematics.forward(self.actual_q, self.tcp).position)

    def _felt(self) -> Vector3:
        return subtract(Vector3(0.0, 0.0, self._pushed()), self._zero)

    # -- orders that take no time -----------------------------------------------------------------

    def begin_force(self, asked: Compliance) -> None:
        """Enter force mode."""
        if self.force.asked is None and self._run is None:
            self._q, self._twist = list(self.target_q), None
        self.force.begin(asked)

    def end_force(self) -> None:
        """Leave force mode: the arm is where it is."""
        self.force.end()
        if self._run is None:
            self._absorb()

    def end_modes(self) -> None:
        """A program has ended, and its modes with it."""
        self.end_force()
        self.freedrive = False

    def halt(self) -> None:
        """What was on its way is over: the arm brakes."""
        self._drop()
        self.end_modes()

    def _drop(self) -> None:
        self._run = self._tail = None
        self._rate = 1.0

    def _absorb(self) -> None:
        self._q, self._qd = list(self.target_q), list(self.target_qd)
        self._twist = None

    # -- frames -----------------------------------------------------------------------------------

    def left_of(self, action: Action, dt_s: float) -> Action | None:
        """What of an action is left after the frame that was last."""
        if isinstance(action, MoveJ | MoveL | MoveC):
            return None if self._released(action) else action
        if isinstance(action, StopJ | StopL):
            return action if self.moving else None
        if isinstance(action, SpeedJ | SpeedL) and action.left_s == 0.0:
            return None if self._at_speed(action) else action
        left_s = action.left_s - dt_s * self.scale
        return None if left_s <= _ROUNDING else action._replace(left_s=left_s)

    def _released(self, action: Move) -> bool:
        if action is self._skipped:
            self._skipped = None
            return True
        run = self._run
        if run is None or run.action is not action:
            return False
        if self._tail is not None or run.course.s < run.released_at - _ROUNDING:
            return False
        return run.released_at < run.path.length or run.course.done

    def _at_speed(self, action: SpeedJ | SpeedL) -> bool:
        if isinstance(action, SpeedJ):
            now, wanted = self._qd, action.qd
        else:
            now, wanted = self._twist or [math.inf] * AXES, action.xd
        return all(
            abs(v - self.scale * aim) <= _AT_REST for v, aim in zip(now, wanted, strict=True)
        )

    def step(self, action: Action | None, dt_s: float, scale: float) -> str:
        """One frame of `dt_s`, with the program's time running `scale` times as fast as real time.

        None brakes. Gives why the safety system has to stop the arm; empty: it has not.
        """
        if math.isnan(self.scale):
            self.scale = scale
        most = _SLIDER_PER_S * dt_s
        self.scale += min(max(scale - self.scale, -most), most)
        why = ""
        try:
            q = self._asked(action, dt_s)
            self._check_speeds(self._q, q, dt_s)
            target = q if self.force.asked is None and not self._apart else self._bent(q, dt_s)
            self._check_speeds(self.target_q, target, dt_s)
        except _StopError as error:
            why = str(error)
            self._drop()
            self._twist = None
            self.force.end()
            self._absorb()
            q = target = self._braked(_STOP_RAD_S2 * dt_s, dt_s)
        for joint, each in enumerate(target):
            if not self._low[joint] <= each <= self._high[joint]:
                why = why or f"joint {joint + 1} is at the end of its range"
                target = [*target[:joint], self.target_q[joint], *target[joint + 1 :]]
                q = target
                self._drop()
                self._twist = None
        speeds = [(a - b) / dt_s for a, b in zip(target, self.target_q, strict=True)]
        self._qd = [(a - b) / dt_s for a, b in zip(q, self._q, strict=True)]
        self._q = list(q)
        self.target_qdd = [(a - b) / dt_s for a, b in zip(speeds, self.target_qd, strict=True)]
        self.target_q, self.target_qd = list(target), speeds
        self._rest_s = 0.0 if self.moving else self._rest_s + dt_s
        self._settle()
        self._follow(dt_s)
        return self._touch() or why
