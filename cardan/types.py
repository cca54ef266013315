"""Value types that modules share.

Every value is immutable, in SI units (meters, radians, seconds, newtons), and carries the frame it
is expressed in and, where it is a reading or a command, its local monotonic time.

They are named tuples because one is made in every control cycle: a frozen dataclass of the same
size costs three to four times as much to create. docs/library.md compares their orders and units
with other libraries'; conversions import the other library when called.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import numpy as np

NEVER_S = float("-inf")
"""Stamp of something that has not happened yet: older than any age limit."""


class Frame(enum.Enum):
    """The frame a pose, twist or wrench is expressed in."""

    BASE = "base"
    """The frame the robot reports its poses in: its base, or the active work object (ABB)."""
    TOOL = "tool"
    """The tool center point (TCP), moving with the robot."""
    MIXED = "mixed"
    """For twists only: linear along the base's axes, angular along the tool's."""


class Vector3(NamedTuple):
    """Three components along right-handed axes; the unit is that of the field that holds it."""

    x: float
    y: float
    z: float

    def to_ros(self) -> dict[str, float]:
        """Convert to a geometry_msgs/Vector3 or Point as a dict."""
        return self._asdict()


class Quaternion(NamedTuple):
    """A rotation as a unit quaternion, scalar first. q and -q are the same rotation.

    ROS, scipy and Pinocchio have the scalar last: use `wxyz` and `xyzw` to be explicit.
    """

    w: float
    x: float
    y: float
    z: float

    def wxyz(self) -> tuple[float, float, float, float]:
        """Components, scalar first: ABB's RAPID and EGM, MuJoCo, Eigen's constructor."""
        return self.w, self.x, self.y, self.z

    def xyzw(self) -> tuple[float, float, float, float]:
        """Components, scalar last: ROS, scipy, Pinocchio, Eigen's coefficients."""
        return self.x, self.y, self.z, self.w

    @classmethod
    def from_wxyz(cls, numbers: Sequence[float]) -> Quaternion:
        """Make a quaternion of four numbers, scalar first."""
        w, x, y, z = map(float, numbers)
        return cls(w, x, y, z)

    @classmethod
    def from_xyzw(cls, numbers: Sequence[float]) -> Quaternion:
        """Make a quaternion of four numbers, scalar last, such as scipy's ``as_quat()``."""
        x, y, z, w = map(float, numbers)
        return cls(w, x, y, z)

    def as_scipy(self) -> Any:
        """Convert to a `scipy.spatial.transform.Rotation`. Raises ImportError without scipy."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.xyzw())

    def to_ros(self) -> dict[str, float]:
        """Convert to a geometry_msgs/Quaternion as a dict."""
        return {"x": self.x, "y": self.y, "z": self.z, "w": self.w}


ZERO3 = Vector3(0.0, 0.0, 0.0)
IDENTITY = Quaternion(1.0, 0.0, 0.0, 0.0)


class Pose(NamedTuple):
    """Pose of a frame (usually the TCP): position in m, orientation as a unit quaternion."""

    position: Vector3
    orientation: Quaternion
    frame: Frame = Frame.BASE

    def matrix(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Homogeneous 4×4 matrix: transforms points of the frame at this pose into `frame`.

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
        """Make a pose of a homogeneous 4×4 matrix (numpy's, or rows). Raises ValueError if it is no
        rigid motion (skewed, scaled, mirrored, transposed)."""
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
        """Convert to a `pinocchio.SE3`. Raises ExtraMissingError without the extra cardan[arm]."""
        from cardan.common.arm_libraries import np, pin
        from cardan.spatial import normalized

        turn = pin.Quaternion(*normalized(self.orientation).wxyz())
        return pin.SE3(turn, np.array(self.position))

    def to_ros(self) -> dict[str, dict[str, float]]:
        """Convert to a geometry_msgs/Pose as a dict, without `frame`, which belongs in a header."""
        return {"position": self.position.to_ros(), "orientation": self.orientation.to_ros()}

    @classmethod
    def from_ros(cls, message: Mapping[str, Any]) -> Pose:
        """Make a pose of a geometry_msgs/Pose as a dict, in frame BASE."""
        p, q = message["position"], message["orientation"]
        return cls(Vector3(p["x"], p["y"], p["z"]), Quaternion(q["w"], q["x"], q["y"], q["z"]))


IDENTITY_POSE = Pose(ZERO3, IDENTITY)


def _equals(self: tuple[Any, ...], other: object) -> bool:
    """Equality that, unlike that of tuples, distinguishes classes with the same fields. Plain
    tuples still compare by value."""
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
        """Convert to a geometry_msgs/Twist as a dict, without `frame`, which belongs in a
        header."""
        return {"linear": self.linear.to_ros(), "angular": self.angular.to_ros()}


ZERO_TWIST = Twist(ZERO3, ZERO3, Frame.BASE)


class Wrench(NamedTuple):
    """Force in N and torque in N·m at the TCP, along the axes of `frame`."""

    force: Vector3
    torque: Vector3
    frame: Frame = Frame.BASE

    __eq__, __ne__, __hash__ = _equals, _differs, tuple.__hash__  # type: ignore[misc]

    def to_ros(self) -> dict[str, dict[str, float]]:
        """Convert to a geometry_msgs/Wrench as a dict, without `frame`, which belongs in a
        header."""
        return {"force": self.force.to_ros(), "torque": self.torque.to_ros()}


# ---------------------------------------------------------------------------------------------
# Operator devices


class DeviceLink(enum.Enum):
    """State of the link to an operator device; its axes count only while it is LIVE."""

    CLOSED = "closed"
    """Not opened, or closed on request."""
    LOST = "lost"
    """Unplugged, not found, or failed to read; the driver keeps trying to open it."""
    STALE = "stale"
    """Open, but silent while deflected: the axes are reported as zero."""
    NEEDS_NEUTRAL = "needs neutral"
    """Reporting, but not seen at rest since opened or lost: the axes are reported as zero."""
    LIVE = "live"
    """Usable: silence means that the operator does not move it."""


class ButtonEvent(NamedTuple):
    """Press or release of a button, in the order in which the device reported it."""

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
    """Angular rates, rad/s; None: the device has no gyroscope, or reports none now."""


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
    """Battery charge, 0..1, if the device reports it."""
    reason: str = ""
    """Reason why `link` is not LIVE; empty when it is."""
    wrench: Wrench | None = None
    """Measured force and torque, for force-torque sensors."""
    inertia: Inertia | None = None
    """Inertial readings, if the device reports them."""
    masked: frozenset[str] = frozenset()
    """Names of buttons pressed while the device was not LIVE, which do not count until they are
    released."""


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
    """Buttons that the device may have besides `buttons`, for which another device's count."""


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
    """Nothing received yet."""
    LIVE = "live"
    LOST = "lost"
    """Received before, silent now."""


class RobotState(NamedTuple):
    """State of a robot at one of its control instants, or report of its silence."""

    stamp_s: float
    """Local monotonic time of reception (of this tick, when the link is not LIVE), s."""
    link: RobotLink
    session: int
    """Count of the controller's sessions. When it changes, earlier targets are void."""
    sequence: int
    """The controller's sequence number of this state."""
    period_s: float
    """Time since the previous control instant, by the robot's clock, s."""
    joints: tuple[float, ...]
    """Measured joint positions in kinematic order, rad."""
    external_axes: tuple[float, ...]
    """Measured external axes, rad (rotary) or m (linear)."""
    pose: Pose | None
    """Measured TCP pose."""
    hold_reason: str
    """Reason why commands would have no effect now ("motors are off"); empty when they do."""
    wrench: Wrench | None = None
    utilization: float | None = None
    """Share of the robot's limits that the last reference needed; above 1 it was shortened."""
    clock_s: float | None = None
    """The controller's own clock, s since the Unix epoch."""
    alarm: str = ""
    """Reason why the robot must not be driven although commands act (the port is flooded)."""
    velocities: tuple[float, ...] = ()
    """Measured joint velocities, rad/s or m/s; empty if the robot does not report them."""
    torques: tuple[float, ...] = ()
    """Measured joint torques, N·m or N; empty if the robot does not report them."""

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
    """Hold the last commanded position with zero speed (before any, the measured one)."""

    kind: CommandKind = CommandKind.HOLD


class JointCommand(NamedTuple):
    """Joint position target for now, with velocity feed-forward."""

    positions: tuple[float, ...]
    """Kinematic order, rad."""
    velocities: tuple[float, ...] | None = None
    """rad/s."""
    external_axes: tuple[float, ...] = ()
    """External axes, rad or m."""
    kind: CommandKind = CommandKind.JOINT


class PoseCommand(NamedTuple):
    """TCP pose target for now, with `twist` as feed-forward; both in frame BASE."""

    pose: Pose
    twist: Twist | None = None
    external_axes: tuple[float, ...] = ()
    kind: CommandKind = CommandKind.POSE


class JointVelocityCommand(NamedTuple):
    """Joint velocities, rad/s, with no position to hold."""

    velocities: tuple[float, ...]
    kind: CommandKind = CommandKind.JOINT_VELOCITY


class TwistCommand(NamedTuple):
    """TCP velocity (frame BASE), with no position to hold."""

    twist: Twist
    kind: CommandKind = CommandKind.TWIST


class TorqueCommand(NamedTuple):
    """Joint torques, gravity compensation included."""

    torques: tuple[float, ...]
    """N·m (N for a prismatic joint), kinematic order."""
    kind: CommandKind = CommandKind.TORQUE


class PathCorrectionCommand(NamedTuple):
    """Shift the programmed path sideways; only y and z of the path frame act."""

    offset: Vector3
    """Offset in the sensor tool frame, m."""
    age_s: float
    """Age of the measurement that it is based on, s."""
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
    """Range, speed and acceleration of each joint, in kinematic order."""

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
        """Return these limits with each speed scaled by `speed_share` and capped by `velocity`, and
        with `acceleration` in place of their own. An empty argument changes nothing."""
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
    """Count of numbers that each command can carry to the controller's program."""
    linear_speed_m_s: float | None = None
    """Highest TCP speed that the driver sends; None: it has no such limit."""
    angular_speed_rad_s: float | None = None
    """Highest angular speed of the TCP that the driver sends; None: it has no such limit."""
    lag_s: float = 0.0
    """Longest normal lag of the measured joints behind the commanded ones, s."""
    robot: str = ""
    """Arm that the driver is configured for: its built-in name, or its file; empty: not known."""
