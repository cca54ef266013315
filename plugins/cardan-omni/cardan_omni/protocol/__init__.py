"""HDAPI, the C interface of the OpenHaptics library libHD: its names and values.

hdapi.h, beside this file, has the same for C.
"""

from cardan_omni.protocol.constants import (
    DEFAULT_SCHEDULER_PRIORITY as DEFAULT_SCHEDULER_PRIORITY,
    ERROR_INFO as ERROR_INFO,
    HD_FALSE as HD_FALSE,
    HD_TRUE as HD_TRUE,
    INVALID_HANDLE as INVALID_HANDLE,
    MAX_SCHEDULER_PRIORITY as MAX_SCHEDULER_PRIORITY,
    MIN_SCHEDULER_PRIORITY as MIN_SCHEDULER_PRIORITY,
    SCHEDULER_FATAL as SCHEDULER_FATAL,
    Button as Button,
    Calibration as Calibration,
    CalibrationStyle as CalibrationStyle,
    CallbackCode as CallbackCode,
    Capability as Capability,
    Error as Error,
    ErrorClass as ErrorClass,
    Info as Info,
    State as State,
    WaitCode as WaitCode,
    error_class as error_class,
    error_name as error_name,
    is_force_error as is_force_error,
    is_scheduler_fatal as is_scheduler_fatal,
)
from cardan_omni.protocol.frames import (
    HAND_FROM_DEVICE as HAND_FROM_DEVICE,
    rotation_to_device as rotation_to_device,
    rotation_to_hand as rotation_to_hand,
    to_device as to_device,
    to_hand as to_hand,
)
