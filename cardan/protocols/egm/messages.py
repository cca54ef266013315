"""EGM's messages as values, in SI units, with the protocol's own names.

Lengths are in m, angles in rad, quaternions scalar first; forces are in N and N·m as on the wire.
`None` means that the field was absent (proto2 has presence): zero and absent differ.

Source: ABB Application manual, Externally Guided Motion, RobotWare 7.16 (3HAC073318-001), and the
published ``egm.proto`` of RobotWare 6.08 to 7.16.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

from cardan.types import Quaternion, Vector3

MAX_DATAGRAM_BYTES = 2048
"""Size limit: the largest real datagram has 1113 bytes, and anything longer is not EGM."""

DNUM_MAX = 40
"""Most values of an EgmRAPIDdata."""


class EgmMessageType(enum.IntEnum):
    """EgmHeader.mtype."""

    UNDEFINED = 0
    COMMAND = 1
    DATA = 2
    """Message from the controller."""
    CORRECTION = 3
    """Message from the PC: position or speed guidance."""
    PATH_CORRECTION = 4
    """Message from the PC: path correction."""


class MotorState(enum.IntEnum):
    """EgmMotorState.state."""

    UNDEFINED = 0
    ON = 1
    OFF = 2


class MCIState(enum.IntEnum):
    """EgmMCIState.state: the motion correction interface, that is EGM itself."""

    UNDEFINED = 0
    ERROR = 1
    STOPPED = 2
    RUNNING = 3


class RapidState(enum.IntEnum):
    """EgmRapidCtrlExecState.state: execution state of the RAPID program."""

    UNDEFINED = 0
    STOPPED = 1
    RUNNING = 2


class EgmHeader(NamedTuple):
    """Sequence number (modulo 2^32), sender's clock in ms (modulo 2^32), kind of message."""

    seqno: int | None
    tm_ms: int | None
    mtype: int
    """An EgmMessageType if known; unknown numbers are kept."""


class EgmPose(NamedTuple):
    """A Cartesian pose as on the wire; the quaternion is not normalized."""

    pos: Vector3 | None
    """m."""
    orient: Quaternion | None
    euler: Vector3 | None = None
    """rad, R = Rz(z)·Ry(y)·Rx(x). Controllers prefer it to `orient`."""


class EgmMotion(NamedTuple):
    """EgmFeedBack (measured) or EgmPlanned (reference)."""

    joints: tuple[float, ...] | None = None
    """rad. A 7-axis robot's third axis travels as external_joints[0]."""
    cartesian: EgmPose | None = None
    external_joints: tuple[float, ...] | None = None
    """External axes as on the wire: degrees, or mm for a linear axis, which only the user knows."""
    time_us: int | None = None
    """The controller's clock, µs since the Unix epoch."""
    time_stamp_ns: int | None = None
    """PTP time, ns (RobotWare 7, late, optional)."""


class EgmMeasuredForce(NamedTuple):
    """Contact force in N and torque in N·m, in the order Fx Fy Fz Tx Ty Tz."""

    force: tuple[float, ...]
    fc_active: bool | None
    """Force control active; None in the RobotWare 6 layout, which has no such field."""


class EgmCollisionInfo(NamedTuple):
    """Collision detection (RobotWare 7.6 and later)."""

    collision_triggered: bool | None
    """Spelled collsionTriggered in ABB's schema."""
    coll_det_quota: tuple[float, ...]
    """Per axis."""


class EgmRapidData(NamedTuple):
    """I/O exchanged with the RAPID program (RobotWare 7.7 and later)."""

    dig_val: bool | None
    dnum: tuple[float, ...]
    """At most DNUM_MAX values."""


class EgmRobot(NamedTuple):
    """Controller to PC."""

    header: EgmHeader | None = None
    feed_back: EgmMotion | None = None
    planned: EgmMotion | None = None
    motor_state: int | None = None
    """A MotorState if known; likewise the two states below."""
    mci_state: int | None = None
    mci_convergence_met: bool | None = None
    test_signals: tuple[float, ...] | None = None
    rapid_exec_state: int | None = None
    measured_force: EgmMeasuredForce | None = None
    utilization_rate: float | None = None
    """Percent, as on the wire."""
    move_index: int | None = None
    collision_info: EgmCollisionInfo | None = None
    rapid_from_robot: EgmRapidData | None = None
    torque_ref: tuple[float, ...] | None = None
    """Joint torques as on the wire."""


class EgmFeedback(NamedTuple):
    """Part of an EgmRobot that an answer depends on."""

    seqno: int
    tm_ms: int | None
    joints: tuple[float, ...]
    """Joint positions, rad; empty if absent."""
    pos: Vector3 | None
    """m."""
    orient: Quaternion | None
    """Computed from the Euler angles if only they are present; not normalized."""
    external_joints: tuple[float, ...]
    """External axes as on the wire; empty if absent."""
    time_us: int | None
    states: tuple[int, int, int]
    """Motors, MCI, RAPID execution; UNDEFINED if absent."""
    force: tuple[float, ...]
    """Measured force; empty if absent."""
    utilization_rate: float | None
    """Percent, as on the wire."""


class EgmSpeedRef(NamedTuple):
    """Speed reference."""

    joints: tuple[float, ...] | None = None
    """Joint speeds, rad/s."""
    cartesians: tuple[float, ...] | None = None
    """vx vy vz in m/s, wx wy wz in rad/s."""
    external_joints: tuple[float, ...] | None = None
    """Speeds of external axes as on the wire: deg/s or mm/s."""


class EgmSensor(NamedTuple):
    """PC to controller: guidance."""

    header: EgmHeader | None = None
    planned: EgmMotion | None = None
    speed_ref: EgmSpeedRef | None = None
    rapid_to_robot: EgmRapidData | None = None


class EgmSensorPathCorr(NamedTuple):
    """PC to controller: path correction."""

    header: EgmHeader | None
    pos: Vector3
    """m, in the sensor tool frame; only y and z act."""
    age_ms: int
    """Age of the measurement."""


class Fault(enum.Enum):
    """Reason why a datagram was refused."""

    EMPTY = "empty"
    OVERSIZED = "oversized"
    TRUNCATED = "truncated or not protobuf"
    WRONG_TYPE = "not the expected EGM message"
    NOT_FINITE = "NaN or infinity"
    WRONG_COUNT = "wrong number of values"


class MalformedEgmMessage(NamedTuple):
    """An invalid datagram, as a value: decoding never raises."""

    fault: Fault
    detail: str
