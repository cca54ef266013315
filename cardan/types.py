"""Value types that modules share.

Every value is immutable, in SI units (meters, radians, seconds, newtons), and carries the frame
it is expressed in and, where it is a reading or a command, the local monotonic time it belongs to.

They are named tuples because one is made in every control cycle: a frozen dataclass of the same
size costs three to four times as much to create. docs/library.md has their orders and units beside
those of others; what converts to another library imports it when it is called.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import numpy as np

NEVER_S = float("-inf")
"""The stamp of something that has not happened yet: older than any age limit."""


class Frame(enum.Enum):
    """The frame a pose, twist or wrench is expressed in."""

    BASE = "base"
    """The frame the robot reports its poses in: its base, or the active work object (ABB)."""
    TOOL = "tool"
    """The tool center point (TCP), moving with the robot."""
    MIXED = "mixed"
    """Of twists only: linear along the base's axes, angular along the tool's."""


class Vector3(NamedTuple):
    """Three components along right-handed axes; the unit is that of the field that holds it."""

    x: float
    y: float
    z: float

    def to_ros(self) -> dict[str, float]:
        """A geometry_msgs/Vector3, or Point, as a dict."""
        return self._asdict()


class Quaternion(NamedTuple):
    """A rotation as a unit quaternion, scalar first. q and -q are the same rotation.

    Others have the scalar last (ROS, scipy, Pinocchio): give them what names its order.
    """

    w: float
    x: float
    y: float
    z: float

    def wxyz(self) -> tuple[float, float, float, float]:
        """Scalar first: ABB's RAPID and EGM, MuJoCo, Eigen's constructor."""
        return self.w, self.x, self.y, self.z

    def xyzw(self) -> tuple[float, float, float, float]:
        """Scalar last: ROS, scipy, Pinocchio, Eigen's coefficients."""
        return self.x, self.y, self.z, self.w

    @classmethod
    def from_wxyz(cls, numbers: Sequence[float]) -> Quaternion:
        """Make a quaternion of four numbers, scalar first."""
        w, x, y, z = map(float, numbers)
        return cls(w, x, y, z)

    @classmethod
    def from_xyzw(cls, numbers: Sequence[float]) -> Quaternion:
        """Make a quaternion of four numbers, scalar last, as scipy's ``as_quat()`` has them."""
        x, y, z, w = map(float, numbers)
        return cls(w, x, y, z)

    def as_scipy(self) -> Any:
        """A `scipy.spatial.transform.Rotation`. Raises ImportError without scipy."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.xyzw())

    def to_ros(self) -> dict[str, float]:
        """A geometry_msgs/Quaternion as a dict."""
        return {"x": self.x, "y": self.y, "z": self.z, "w": self.w}


ZERO3 = Vector3(0.0, 0.0, 0.0)
IDENTITY = Quaternion(1.0, 0.0, 0.0, 0.0)


class Pose(NamedTuple):
    """Pose of a frame (usually the TCP): position in m, orientation as a unit quaternion."""

    position: Vector3
    orientation: Quaternion
    frame: Frame = Frame.BASE

    def matrix(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """4×4, homogeneous: times a point of the frame that is here it is the point in `frame`.

        Raises ExtraMissingError without numpy.
        """
        try:
            import numpy as np
        except ImportError as error:
            from cardan.common.extras import missing_extra

            raise missing_extra("a pose's matrix", "numpy", "arm", error) from error
        from cardan.spatial import to_rows

        rows = zip(to_rows(self.orientation), self.position, strict=True)
        return np.array([*((*row, p) for row, p in rows), (0.0, 0.0, 0.0, 1.0)])

    @classmethod
    def from_matrix(cls, matrix: Any, frame: Frame = Frame.BASE) -> Pose:
        """Make a pose of a homogeneous 4×4 matrix: of numpy's, or of rows. Raises ValueError for
        one that is no rigid motion (skewed, scaled, mirrored, transposed)."""
        from cardan.spatial import from_rows

        rows = [tuple(map(float, row)) for row in matrix]
        if [len(row) for row in rows] != [4] * 4:
            raise ValueError("a pose's matrix has four rows of four numbers")
        *upper, last = rows
        if last != (0.0, 0.0, 0.0, 1.0):
            raise ValueError(f"the last row of a pose's matrix is 0 0 0 1, not {last}")
        if not all(math.isfinite(row[3]) for row in upper):
            raise ValueError("the position of a pose's matrix is not finite")
        x, y, z = (row[3] for row in upper)
        return cls(Vector3(x, y, z), from_rows([row[:3] for row in upper]), frame)

    def as_se3(self) -> Any:
        """A `pinocchio.SE3`. Raises ExtraMissingError without the extra cardan[arm]."""
        from cardan.common.arm_libraries import np, pin
        from cardan.spatial import normalized

        turn = pin.Quaternion(*normalized(self.orientation).wxyz())
        return pin.SE3(turn, np.array(self.position))

    def to_ros(self) -> dict[str, dict[str, float]]:
        """A geometry_msgs/Pose as a dict; `frame` is the header's business."""
        return {"position": self.position.to_ros(), "orientation": self.orientation.to_ros()}

    @classmethod
    def from_ros(cls, message: Mapping[str, Any]) -> Pose:
        """Make a pose of a geometry_msgs/Pose as a dict, in the base's frame."""
        p, q = message["position"], message["orientation"]
        return cls(Vector3(p["x"], p["y"], p["z"]), Quaternion(q["w"], q["x"], q["y"], q["z"]))


IDENTITY_POSE = Pose(ZERO3, IDENTITY)


def _equals(self: tuple[Any, ...], other: object) -> bool:
    """Equality that tells classes with the same fields apart; that of tuples does not. A plain
    tuple is asked in turn, and compares as tuples do."""
    return tuple.__eq__(self, other) if other.__class__ is self.__class__ else NotImplemented


def _differs(self: tuple[Any, ...], other: object) -> bool:
    return tuple.__ne__(self, other) if other.__class__ is self.__class__ else NotImplemented


class Twist(NamedTuple):
    """Velocity of the TCP: linear in m/s, angular in rad/s, both along the axes of `frame`.

    The linear part is that of the TCP point itself, whatever the frame (no lever-arm terms).
    """

    linear: Vector3
    angular: Vector3
    frame: Frame = Frame.BASE

    __eq__, __ne__, __hash__ = _equals, _differs, tuple.__hash__  # type: ignore[misc]

    def to_ros(self) -> dict[str, dict[str, float]]:
        """A geometry_msgs/Twist as a dict; `frame` is the header's business."""
        return {"linear": self.linear.to_ros(), "angular": self.angular.to_ros()}


ZERO_TWIST = Twist(ZERO3, ZERO3, Frame.BASE)


class Wrench(NamedTuple):
    """Force in N and torque in N·m at the TCP, along the axes of `frame`."""

    force: Vector3
    torque: Vector3
    frame: Frame = Frame.BASE

    __eq__, __ne__, __hash__ = _equals, _differs, tuple.__hash__  # type: ignore[misc]

    def to_ros(self) -> dict[str, dict[str, float]]:
        """A geometry_msgs/Wrench as a dict; `frame` is the header's business."""
        return {"force": self.force.to_ros(), "torque": self.torque.to_ros()}


# ---------------------------------------------------------------------------------------------
# Operator devices


class DeviceLink(enum.Enum):
    """State of the link to an operator device: is its newest state usable?"""

    CLOSED = "closed"
    """Not opened, or closed on request."""
    LOST = "lost"
    """Unplugged, read error, or not to be found; the driver keeps trying to open it again."""
    STALE = "stale"
    """Open, but silent while deflected: the link is in trouble, the axes are given as zero."""
    NEEDS_NEUTRAL = "needs neutral"
    """Talking, but not seen at rest since it was opened or lost: the axes are given as zero."""
    LIVE = "live"
    """Usable: silence now means that the operator holds still."""


class ButtonEvent(NamedTuple):
    """Edge of a button, in the order in which the device reported it."""

    stamp_s: float
    button: str
    pressed: bool


class Axes(NamedTuple):
    """Deflections in -1..1: x forward (away from the operator), y left, z up, and right-handed
    rotations about the same axes."""

    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float


NEUTRAL = Axes(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Inertia(NamedTuple):
    """Readings of the accelerometer and the gyroscope of a device, along its own axes: x forward,
    y left, z up, as it lies before the operator."""

    acceleration: Vector3
    """Specific force, m/s²: at rest it is 9.81 upwards."""
    rates: Vector3 | None = None
    """Turning rates, rad/s; None: it has no gyroscope, or it is not heard."""


class DeviceState(NamedTuple):
    """The newest state of an operator device."""

    stamp_s: float
    """Local monotonic time of the newest report, s; NEVER_S before the first."""
    link: DeviceLink
    axes: Axes
    """After calibration, dead zone and curve; all zero unless `link` is LIVE."""
    buttons: frozenset[str]
    """Names of the buttons held down."""
    pose: Pose | None = None
    """Pose of the device, for devices that measure one (frame: the device's base)."""
    battery: float | None = None
    """Charge, 0..1, where the device reports it."""
    reason: str = ""
    """Reason why `link` is not LIVE; empty when it is."""
    wrench: Wrench | None = None
    """Measured force and torque, for force-torque sensors."""
    inertia: Inertia | None = None
    """For devices with an accelerometer, while it is heard."""


class DeviceCapabilities(NamedTuple):
    """Inputs and feedback channels of an operator device."""

    gives_pose: bool
    """True: `DeviceState.pose` is measured (position control)."""
    buttons: tuple[str, ...]
    feedback: frozenset[str]
    """Any of "led", "rumble", "wrench"."""
    battery: bool
    gives_axes: bool = True
    """True: `DeviceState.axes` are deflections (rate control); False: they are always zero."""
    gives_inertia: bool = False
    """True: `DeviceState.inertia` is measured."""
    further_buttons: tuple[str, ...] = ()
    """Buttons that it may have beside `buttons`, which others count for it."""


class DeviceFeedback(NamedTuple):
    """Feedback for the operator, by light, motor and force. None leaves a channel as it is."""

    led: bool | None = None
    rumble: float | None = None
    """0 (off) to 1 (strongest)."""
    wrench: Wrench | None = None


# ---------------------------------------------------------------------------------------------
# Robots


class RobotLink(enum.Enum):
    """State of the link to the robot's controller."""

    WAITING = "waiting"
    """Nothing was ever heard."""
    LIVE = "live"
    LOST = "lost"
    """Heard before, silent now."""


class RobotState(NamedTuple):
    """State of a robot at one of its control instants, or its silence."""

    stamp_s: float
    """Local monotonic time of reception (of this tick, when the link is not LIVE), s."""
    link: RobotLink
    session: int
    """Counts the controller's sessions. When it changes, earlier targets are void."""
    sequence: int
    """The controller's sequence number of this state."""
    period_s: float
    """Time since the control instant before this one, by the robot's clock, s."""
    joints: tuple[float, ...]
    """Measured joint positions in kinematic order, rad."""
    external_axes: tuple[float, ...]
    """Measured external axes, rad (rotary) or m (linear)."""
    pose: Pose | None
    """Measured TCP pose."""
    hold_reason: str
    """Reason why commands would not act now ("motors are off"); empty when they do."""
    wrench: Wrench | None = None
    utilization: float | None = None
    """Share of the robot's ability the last reference needed; above 1 it was shortened."""
    clock_s: float | None = None
    """The controller's own clock, s since the Unix epoch."""
    alarm: str = ""
    """Reason why the robot must not be driven although commands act (the port is flooded)."""
    velocities: tuple[float, ...] = ()
    """Measured joint velocities, rad/s or m/s; empty where the robot does not report them."""
    torques: tuple[float, ...] = ()
    """Measured joint torques, N·m or N; empty where the robot does not report them."""

    @property
    def ready(self) -> bool:
        """True when a command sent now moves the robot."""
        return self.link is RobotLink.LIVE and not self.hold_reason


class CommandKind(enum.Enum):
    """Kind of a command to a robot driver."""

    HOLD = "hold"
    JOINT = "joint"
    POSE = "pose"
    JOINT_VELOCITY = "joint velocity"
    TWIST = "twist"
    TORQUE = "torque"
    PATH_CORRECTION = "path correction"


class HoldCommand(NamedTuple):
    """Stay at the last commanded position with zero speed (the measured one before any)."""

    kind: CommandKind = CommandKind.HOLD


class JointCommand(NamedTuple):
    """Be at `positions` now, moving at `velocities` (feed-forward)."""

    positions: tuple[float, ...]
    """rad, kinematic order."""
    velocities: tuple[float, ...] | None = None
    """rad/s."""
    external_axes: tuple[float, ...] = ()
    """rad or m."""
    kind: CommandKind = CommandKind.JOINT


class PoseCommand(NamedTuple):
    """Have the TCP at `pose` (frame BASE) now, moving at `twist` (feed-forward, frame BASE)."""

    pose: Pose
    twist: Twist | None = None
    external_axes: tuple[float, ...] = ()
    kind: CommandKind = CommandKind.POSE


class JointVelocityCommand(NamedTuple):
    """Move at `velocities`, rad/s, with no position to hold."""

    velocities: tuple[float, ...]
    kind: CommandKind = CommandKind.JOINT_VELOCITY


class TwistCommand(NamedTuple):
    """Move the TCP at `twist` (frame BASE) with no position to hold."""

    twist: Twist
    kind: CommandKind = CommandKind.TWIST


class TorqueCommand(NamedTuple):
    """Exert `torques` at the joints; they have to compensate gravity themselves."""

    torques: tuple[float, ...]
    """N·m (N for a prismatic joint), kinematic order."""
    kind: CommandKind = CommandKind.TORQUE


class PathCorrectionCommand(NamedTuple):
    """Shift the programmed path sideways; only y and z of the path frame act."""

    offset: Vector3
    """m, in the sensor tool frame."""
    age_s: float
    """Age of the measurement behind it, s."""
    kind: CommandKind = CommandKind.PATH_CORRECTION


RobotCommand = (
    HoldCommand
    | JointCommand
    | PoseCommand
    | JointVelocityCommand
    | TwistCommand
    | TorqueCommand
    | PathCorrectionCommand
)


class JointLimits(NamedTuple):
    """Range and speed of each joint, kinematic order."""

    lower: tuple[float, ...]
    """rad."""
    upper: tuple[float, ...]
    """rad."""
    velocity: tuple[float, ...]
    """rad/s."""
    acceleration: tuple[float, ...]
    """rad/s²."""

    def reduced(
        self, velocity: tuple[float, ...], acceleration: tuple[float, ...], speed_share: float
    ) -> JointLimits:
        """These, at `speed_share` of each speed, which is at most that of `velocity`; with
        `acceleration` instead of their own. Empty: as they are."""
        speeds = map(min, velocity or self.velocity, self.velocity)
        return self._replace(
            velocity=tuple(speed_share * speed for speed in speeds),
            acceleration=acceleration or self.acceleration,
        )


class RobotCapabilities(NamedTuple):
    """Commands that a robot driver takes, and their period."""

    commands: frozenset[CommandKind]
    period_s: float
    joints: int
    limits: JointLimits | None = None
    digital_outputs: int = 0
    analog_outputs: int = 0
    """Numbers that travel to the controller's program with each command."""
    linear_speed_m_s: float | None = None
    """Highest TCP speed that the driver sends; None: it has no such limit."""
    angular_speed_rad_s: float | None = None
    """Highest turning speed of the TCP that the driver sends; None: it has no such limit."""
    lag_s: float = 0.0
    """Longest normal delay of measured behind commanded joints, s."""
