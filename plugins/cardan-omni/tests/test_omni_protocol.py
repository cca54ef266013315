"""HDAPI's values: Python compared with C, and both with an independent table."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from cardan.spatial import conjugate, from_rotation_vector, multiply, rotate
from cardan.types import Vector3
from cardan_omni import protocol as hdapi
from cardan_omni.protocol import (
    Button,
    Calibration,
    CalibrationStyle,
    CallbackCode,
    Capability,
    Error,
    ErrorClass,
    Info,
    State,
    WaitCode,
)

HEADER = Path(hdapi.__file__).with_name("hdapi.h")

# Typed from the interface's description, with another order and layout than the header.
REFERENCE = """
0000 SUCCESS
0100 INVALID_ENUM INVALID_VALUE INVALID_OPERATION INVALID_INPUT_TYPE BAD_HANDLE
0200 WARM_MOTORS EXCEEDED_MAX_FORCE EXCEEDED_MAX_FORCE_IMPULSE EXCEEDED_MAX_VELOCITY FORCE_ERROR
0300 DEVICE_FAULT DEVICE_ALREADY_INITIATED COMM_ERROR COMM_CONFIG_ERROR TIMER_ERROR
0400 ILLEGAL_BEGIN ILLEGAL_END FRAME_ERROR
0500 INVALID_PRIORITY SCHEDULER_FULL
0600 INVALID_LICENSE
2000 CURRENT_BUTTONS CURRENT_SAFETY_SWITCH CURRENT_INKWELL_SWITCH
2010 CURRENT_ENCODER_VALUES CURRENT_PINCH_VALUE LAST_PINCH_VALUE
2050 CURRENT_POSITION CURRENT_VELOCITY CURRENT_TRANSFORM CURRENT_ANGULAR_VELOCITY CURRENT_JACOBIAN
2100 CURRENT_JOINT_ANGLES
2150 CURRENT_GIMBAL_ANGLES
2200 LAST_BUTTONS LAST_SAFETY_SWITCH LAST_INKWELL_SWITCH
2210 LAST_ENCODER_VALUES
2250 LAST_POSITION LAST_VELOCITY LAST_TRANSFORM LAST_ANGULAR_VELOCITY LAST_JACOBIAN
2300 LAST_JOINT_ANGLES
2350 LAST_GIMBAL_ANGLES
2500 VERSION DEVICE_MODEL_TYPE DEVICE_DRIVER_VERSION DEVICE_VENDOR DEVICE_SERIAL_NUMBER
2505 DEVICE_FIRMWARE_VERSION
2550 MAX_WORKSPACE_DIMENSIONS USABLE_WORKSPACE_DIMENSIONS TABLETOP_OFFSET INPUT_DOF OUTPUT_DOF
2555 CALIBRATION_STYLE
2600 UPDATE_RATE INSTANTANEOUS_UPDATE_RATE NOMINAL_MAX_STIFFNESS NOMINAL_MAX_FORCE
2604 NOMINAL_MAX_CONTINUOUS_FORCE MOTOR_TEMPERATURE SOFTWARE_VELOCITY_LIMIT
2607 SOFTWARE_FORCE_IMPULSE_LIMIT FORCE_RAMPING_RATE NOMINAL_MAX_DAMPING
2620 NOMINAL_MAX_TORQUE_STIFFNESS NOMINAL_MAX_TORQUE_DAMPING NOMINAL_MAX_TORQUE_FORCE
2623 NOMINAL_MAX_TORQUE_CONTINUOUS_FORCE
2700 CURRENT_FORCE CURRENT_TORQUE JOINT_ANGLE_REFERENCES CURRENT_JOINT_TORQUE
2704 CURRENT_GIMBAL_TORQUE
2750 CURRENT_MOTOR_DAC_VALUES
2800 LAST_FORCE LAST_TORQUE LAST_JOINT_TORQUE LAST_GIMBAL_TORQUE
2850 LAST_MOTOR_DAC_VALUES
2900 USER_STATUS_LIGHT
4000 FORCE_OUTPUT MAX_FORCE_CLAMPING FORCE_RAMPING SOFTWARE_FORCE_LIMIT ONE_FRAME_LIMIT
5000 CALIBRATION_OK CALIBRATION_NEEDS_UPDATE CALIBRATION_NEEDS_MANUAL_INPUT
"""
OTHERS = {
    "HD_FALSE": 0,
    "HD_TRUE": 1,
    "HD_CALLBACK_DONE": 0,
    "HD_CALLBACK_CONTINUE": 1,
    "HD_WAIT_CHECK_STATUS": 0,
    "HD_WAIT_INFINITE": 1,
    "HD_MIN_SCHEDULER_PRIORITY": 0,
    "HD_MAX_SCHEDULER_PRIORITY": 65535,
    "HD_DEFAULT_SCHEDULER_PRIORITY": 32767,
    "HD_INVALID_HANDLE": 4294967295,
    "HD_CALIBRATION_ENCODER_RESET": 1,
    "HD_CALIBRATION_AUTO": 2,
    "HD_CALIBRATION_INKWELL": 4,
    "HD_DEVICE_BUTTON_1": 1,
    "HD_DEVICE_BUTTON_2": 2,
    "HD_DEVICE_BUTTON_3": 4,
    "HD_DEVICE_BUTTON_4": 8,
}


def in_reference():
    values = dict(OTHERS)
    for line in REFERENCE.split("\n"):
        first, *names = line.split() or ("0",)
        values |= {f"HD_{name}": int(first, 16) + index for index, name in enumerate(names)}
    return values


def in_python():
    groups = {
        "HD_": (Error, State, Info, Capability),
        "HD_CALLBACK_": (CallbackCode,),
        "HD_WAIT_": (WaitCode,),
        "HD_CALIBRATION_": (Calibration, CalibrationStyle),
        "HD_DEVICE_": (Button,),
    }
    values = {
        f"{prefix}{member.name}": int(member)
        for prefix, enums in groups.items()
        for each in enums
        for member in each
    }
    for name in dir(hdapi):
        value = getattr(hdapi, name)
        if name.isupper() and type(value) is int:
            values[f"HD_{name.removeprefix('HD_')}"] = value
    return values


def in_c():
    text = HEADER.read_text(encoding="utf-8")
    found = re.findall(r"^#define (HD_\w+) (0[xX][0-9A-Fa-f]+|\d+)u?$", text, re.MULTILINE)
    assert len(found) == len(dict(found)) == len(re.findall(r"^#define HD_", text, re.M)) - 1
    return {name: int(value, 0) for name, value in found}


def test_python_and_c_have_the_same_values():
    assert in_python() == in_c()


def test_both_have_the_values_of_the_interface():
    assert in_python() == in_reference()


def test_every_number_of_a_group_has_one_name():
    for group in (Error, State, Info, Capability, Calibration):
        assert len(group.__members__) == len(list(group))


def test_the_trap_of_stiffness_force_and_continuous_force():
    assert (Info.NOMINAL_MAX_STIFFNESS, Info.NOMINAL_MAX_FORCE) == (0x2602, 0x2603)
    assert Info.NOMINAL_MAX_CONTINUOUS_FORCE == 0x2604


def test_classes_of_errors():
    force = {error for error in Error if hdapi.is_force_error(error)}
    assert force == {
        Error.WARM_MOTORS,
        Error.EXCEEDED_MAX_FORCE,
        Error.EXCEEDED_MAX_FORCE_IMPULSE,
        Error.EXCEEDED_MAX_VELOCITY,
        Error.FORCE_ERROR,
    }
    assert hdapi.is_force_error(0x02FF)
    fatal = {error for error in Error if hdapi.is_scheduler_fatal(error)}
    assert fatal == {Error.DEVICE_FAULT, Error.COMM_ERROR, Error.TIMER_ERROR}
    assert [error for error in Error if hdapi.error_class(error) is None] == [Error.SUCCESS]
    assert hdapi.error_class(Error.BAD_HANDLE) is ErrorClass.PROGRAMMING
    assert hdapi.error_class(Error.COMM_ERROR) is ErrorClass.DEVICE
    assert hdapi.error_class(Error.FRAME_ERROR) is ErrorClass.FRAME
    assert hdapi.error_class(Error.SCHEDULER_FULL) is ErrorClass.SCHEDULER
    assert hdapi.error_class(Error.INVALID_LICENSE) is ErrorClass.LICENSE
    assert hdapi.error_class(0xFFFFFFFF) is None


def test_names_of_errors():
    assert hdapi.error_name(0x0302) == "HD_COMM_ERROR"
    assert hdapi.error_name(Error.SUCCESS) == "HD_SUCCESS"
    assert hdapi.error_name(0x0777) == "HDAPI error 0x0777"


def test_the_error_is_three_ints_without_padding():
    assert hdapi.ERROR_INFO.size == 12 == 3 * struct.calcsize("i")
    assert hdapi.ERROR_INFO.unpack(struct.pack("IiI", 0x302, -28, 0)) == (0x302, -28, 0)


# -- frames ------------------------------------------------------------------------------------

components = st.floats(-3.0, 3.0)
vectors = st.builds(Vector3, components, components, components)


def test_axes():
    assert hdapi.to_hand((1.0, 0.0, 0.0)) == (0.0, -1.0, 0.0)  # right is -y
    assert hdapi.to_hand((0.0, 1.0, 0.0)) == (0.0, 0.0, 1.0)  # up is z
    assert hdapi.to_hand((0.0, 0.0, 1.0)) == (-1.0, 0.0, 0.0)  # to the operator is -x


def test_the_matrix_is_a_proper_rotation_and_is_what_the_functions_do():
    (a, b, c), (d, e, f), (g, h, i) = hdapi.HAND_FROM_DEVICE
    assert a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) == 1.0
    v = (1.0, 2.0, 3.0)
    rows = hdapi.HAND_FROM_DEVICE
    assert hdapi.to_hand(v) == tuple(
        sum(x * y for x, y in zip(row, v, strict=True)) for row in rows
    )


@given(vectors)
def test_there_and_back(v):
    assert hdapi.to_device(hdapi.to_hand(v)) == v
    assert hdapi.to_hand(hdapi.to_device(v)) == v


@given(vectors, vectors)
def test_rotations_go_along(turn, v):
    q = from_rotation_vector(turn)
    there = hdapi.rotation_to_device(q)
    assert hdapi.rotation_to_hand(there) == q
    assert rotate(there, hdapi.to_device(v)) == pytest.approx(
        hdapi.to_device(rotate(q, v)), abs=1e-9
    )
    assert multiply(there, conjugate(there)).w == pytest.approx(1.0)
