"""HDAPI's values (OpenHaptics 3.x), as hdapi.h has them for C.

A member's name in C is its name here behind its group's prefix: ``Error.COMM_ERROR`` is
HD_COMM_ERROR, ``Calibration.OK`` is HD_CALIBRATION_OK. Lengths are in mm, forces in N, torques in
mN·m, angles in rad, in the device frame: x right, y up, z to the operator.
"""

from __future__ import annotations

import enum
import struct

HD_FALSE = 0
HD_TRUE = 1
MIN_SCHEDULER_PRIORITY = 0
MAX_SCHEDULER_PRIORITY = 65535
"""Priority of the callback that runs first in a tick."""
DEFAULT_SCHEDULER_PRIORITY = 32767
INVALID_HANDLE = 0xFFFFFFFF
"""Result of hdInitDevice when it fails. 0 is a valid handle, BAD_HANDLE is not."""

ERROR_INFO = struct.Struct("@IiI")
"""HDErrorInfo, which hdGetError returns by value: errorCode (an Error), internalErrorCode (of the
device's driver), hHD (the handle); 12 bytes without padding."""


class CallbackCode(enum.IntEnum):
    """Results of a scheduled callback. Prefix HD_CALLBACK_."""

    DONE = 0
    """End the callback."""
    CONTINUE = 1
    """Call it again in the next tick."""


class WaitCode(enum.IntEnum):
    """Modes of hdWaitForCompletion. Prefix HD_WAIT_."""

    CHECK_STATUS = 0
    """Do not wait: true while the callback is scheduled."""
    INFINITE = 1


class ErrorClass(enum.Enum):
    """Classes of errors, by subject."""

    PROGRAMMING = "programming"
    FORCE = "force"
    """Codes 0x02xx: the amplifier is off temporarily; the scheduler continues."""
    DEVICE = "device"
    FRAME = "frame"
    SCHEDULER = "scheduler"
    LICENSE = "license"


class Error(enum.IntEnum):
    """Codes of HDErrorInfo.errorCode. Prefix HD_."""

    SUCCESS = 0x0000
    INVALID_ENUM = 0x0100
    INVALID_VALUE = 0x0101
    INVALID_OPERATION = 0x0102
    INVALID_INPUT_TYPE = 0x0103
    BAD_HANDLE = 0x0104
    WARM_MOTORS = 0x0200
    EXCEEDED_MAX_FORCE = 0x0201
    EXCEEDED_MAX_FORCE_IMPULSE = 0x0202
    EXCEEDED_MAX_VELOCITY = 0x0203
    FORCE_ERROR = 0x0204
    """Kinds of force that exclude each other, in one frame."""
    DEVICE_FAULT = 0x0300
    DEVICE_ALREADY_INITIATED = 0x0301
    COMM_ERROR = 0x0302
    COMM_CONFIG_ERROR = 0x0303
    TIMER_ERROR = 0x0304
    ILLEGAL_BEGIN = 0x0400
    ILLEGAL_END = 0x0401
    FRAME_ERROR = 0x0402
    """A value was set outside a frame."""
    INVALID_PRIORITY = 0x0500
    SCHEDULER_FULL = 0x0501
    INVALID_LICENSE = 0x0600


_CLASSES = {
    0x01: ErrorClass.PROGRAMMING,
    0x02: ErrorClass.FORCE,
    0x03: ErrorClass.DEVICE,
    0x04: ErrorClass.FRAME,
    0x05: ErrorClass.SCHEDULER,
    0x06: ErrorClass.LICENSE,
}

SCHEDULER_FATAL = frozenset({Error.DEVICE_FAULT, Error.COMM_ERROR, Error.TIMER_ERROR})
"""The device is unreachable: a callback that sees this returns DONE."""


def error_class(code: int) -> ErrorClass | None:
    """Return the class of a code, whether or not it has a name; None for SUCCESS and codes of no
    class."""
    return _CLASSES.get(code >> 8)


def is_force_error(code: int) -> bool:
    """Return True if a limit of the force or the motors' temperature was reached."""
    return error_class(code) is ErrorClass.FORCE


def is_scheduler_fatal(code: int) -> bool:
    """Return True if the servo loop must end."""
    return code in SCHEDULER_FATAL


def error_name(code: int) -> str:
    """Return the name in C; the number in hex for an unknown code."""
    try:
        return f"HD_{Error(code).name}"
    except ValueError:
        return f"HDAPI error 0x{code:04X}"


class State(enum.IntEnum):
    """Values that a frame reads and writes. Prefix HD_.

    CURRENT_ is of this tick, LAST_ of the one before. Forces and torques can be set; they are zero
    at the beginning of each frame. Vectors have three components unless said.
    """

    CURRENT_BUTTONS = 0x2000
    """1 int, a mask of Button."""
    CURRENT_SAFETY_SWITCH = 0x2001
    """1 bool."""
    CURRENT_INKWELL_SWITCH = 0x2002
    """1 bool: the stylus is docked."""
    CURRENT_ENCODER_VALUES = 0x2010
    """6 long, counts."""
    CURRENT_PINCH_VALUE = 0x2011
    LAST_PINCH_VALUE = 0x2012
    CURRENT_POSITION = 0x2050
    """mm, the gimbal's center."""
    CURRENT_VELOCITY = 0x2051
    """mm/s, smoothed by the library."""
    CURRENT_TRANSFORM = 0x2052
    """16, by columns; the translation, mm, at 12 to 14."""
    CURRENT_ANGULAR_VELOCITY = 0x2053
    """rad/s, of the gimbal."""
    CURRENT_JACOBIAN = 0x2054
    """Undocumented by the vendor."""
    CURRENT_JOINT_ANGLES = 0x2100
    """rad: turret to the left, thigh up, shin up, the latter two against the base."""
    CURRENT_GIMBAL_ANGLES = 0x2150
    """rad, against the forearm: right, down, clockwise positive. No roll, pitch and yaw."""
    LAST_BUTTONS = 0x2200
    LAST_SAFETY_SWITCH = 0x2201
    LAST_INKWELL_SWITCH = 0x2202
    LAST_ENCODER_VALUES = 0x2210
    LAST_POSITION = 0x2250
    LAST_VELOCITY = 0x2251
    LAST_TRANSFORM = 0x2252
    LAST_ANGULAR_VELOCITY = 0x2253
    LAST_JACOBIAN = 0x2254
    LAST_JOINT_ANGLES = 0x2300
    LAST_GIMBAL_ANGLES = 0x2350
    CURRENT_FORCE = 0x2700
    """Force, N."""
    CURRENT_TORQUE = 0x2701
    """mN·m; deprecated."""
    JOINT_ANGLE_REFERENCES = 0x2702
    """Undocumented by the vendor."""
    CURRENT_JOINT_TORQUE = 0x2703
    """mN·m; set before CURRENT_FORCE of the same frame."""
    CURRENT_GIMBAL_TORQUE = 0x2704
    """mN·m; in addition to CURRENT_FORCE."""
    CURRENT_MOTOR_DAC_VALUES = 0x2750
    """3 or 6 long, -32767 to 32766; deprecated."""
    LAST_FORCE = 0x2800
    LAST_TORQUE = 0x2801
    LAST_JOINT_TORQUE = 0x2802
    LAST_GIMBAL_TORQUE = 0x2803
    LAST_MOTOR_DAC_VALUES = 0x2850
    USER_STATUS_LIGHT = 0x2900
    """1 int, 0 to 7."""


class Info(enum.IntEnum):
    """The device's identity and limits. Prefix HD_."""

    VERSION = 0x2500
    """String, of the API."""
    DEVICE_MODEL_TYPE = 0x2501
    """String."""
    DEVICE_DRIVER_VERSION = 0x2502
    """String."""
    DEVICE_VENDOR = 0x2503
    """String."""
    DEVICE_SERIAL_NUMBER = 0x2504
    """String."""
    DEVICE_FIRMWARE_VERSION = 0x2505
    """1 double."""
    MAX_WORKSPACE_DIMENSIONS = 0x2550
    """6 double, mm: lowest x, y, z, then highest."""
    USABLE_WORKSPACE_DIMENSIONS = 0x2551
    """6 double, mm, as above; forces are reliable within."""
    TABLETOP_OFFSET = 0x2552
    """1 float, mm."""
    INPUT_DOF = 0x2553
    """1 int."""
    OUTPUT_DOF = 0x2554
    """1 int."""
    CALIBRATION_STYLE = 0x2555
    """1 int, a mask of CalibrationStyle."""
    UPDATE_RATE = 0x2600
    """1 int, Hz."""
    INSTANTANEOUS_UPDATE_RATE = 0x2601
    """1 int, Hz."""
    NOMINAL_MAX_STIFFNESS = 0x2602
    """1 double, N/mm."""
    NOMINAL_MAX_FORCE = 0x2603
    """1 double, N."""
    NOMINAL_MAX_CONTINUOUS_FORCE = 0x2604
    """1 double, N."""
    MOTOR_TEMPERATURE = 0x2605
    """3 or 6 double, 0 cold to 1 hottest: a prediction."""
    SOFTWARE_VELOCITY_LIMIT = 0x2606
    """1 double, mm/s; can be set."""
    SOFTWARE_FORCE_IMPULSE_LIMIT = 0x2607
    """1 double, N/ms; can be set."""
    FORCE_RAMPING_RATE = 0x2608
    """1 double, N/s; can be set."""
    NOMINAL_MAX_DAMPING = 0x2609
    """1 double, N·s/mm."""
    NOMINAL_MAX_TORQUE_STIFFNESS = 0x2620
    """1 double; devices with torque only, as the next three."""
    NOMINAL_MAX_TORQUE_DAMPING = 0x2621
    NOMINAL_MAX_TORQUE_FORCE = 0x2622
    NOMINAL_MAX_TORQUE_CONTINUOUS_FORCE = 0x2623


class Capability(enum.IntEnum):
    """Arguments of hdEnable and hdDisable. Prefix HD_."""

    FORCE_OUTPUT = 0x4000
    MAX_FORCE_CLAMPING = 0x4001
    """A force above the highest is scaled down."""
    FORCE_RAMPING = 0x4002
    """Ramp the force up after a start, an error, and the inkwell."""
    SOFTWARE_FORCE_LIMIT = 0x4003
    ONE_FRAME_LIMIT = 0x4004
    """Allow at most one frame per device and tick."""


class Calibration(enum.IntEnum):
    """Results of hdCheckCalibration. Prefix HD_CALIBRATION_."""

    OK = 0x5000
    NEEDS_UPDATE = 0x5001
    """hdUpdateCalibration is due; the position may jump."""
    NEEDS_MANUAL_INPUT = 0x5002
    """The stylus must be docked first."""


class CalibrationStyle(enum.IntFlag):
    """Ways of calibrating a device. Prefix HD_CALIBRATION_."""

    ENCODER_RESET = 1
    AUTO = 2
    INKWELL = 4


class Button(enum.IntFlag):
    """Bits of CURRENT_BUTTONS. Prefix HD_DEVICE_."""

    BUTTON_1 = 1
    """The front one, dark gray."""
    BUTTON_2 = 2
    """The rear one, white."""
    BUTTON_3 = 4
    BUTTON_4 = 8
