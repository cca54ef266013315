"""Calibrations, extensions, MotionPlus and camera: worked bytes and round trips."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given, strategies as st

from cardan_wiimote.protocol import (
    DEFAULT_ACCELEROMETER,
    DEFAULT_MOTION_PLUS,
    EXTENSION_IDS,
    SENSITIVITY_LEVEL_3,
    AccelerometerCalibration,
    CalibrationSource,
    Extension,
    IrDot,
    IrFormat,
    MotionPlusCalibration,
    MotionPlusData,
    MotionPlusRange,
    NunchukCalibration,
    NunchukData,
    camera_start,
    camera_stop,
    decode_accelerometer_calibration,
    decode_dots,
    decode_input,
    decode_motion_plus,
    decode_motion_plus_calibration,
    decode_nunchuk,
    decode_nunchuk_calibration,
    decode_nunchuk_pass_through,
    encode_accelerometer_calibration,
    encode_dots,
    encode_motion_plus,
    encode_motion_plus_calibration,
    encode_nunchuk,
    encode_nunchuk_calibration,
    encode_nunchuk_pass_through,
    encode_output,
    extension_of,
    from_g,
    from_operator_axes,
    from_rad_s,
    is_motion_plus_frame,
    motion_plus_activate,
    read_accelerometer_calibration,
    roll_and_pitch_rad,
    stick_deflection,
    to_g,
    to_operator_axes,
    to_rad_s,
)

BLOCK = bytes.fromhex("84 82 86 30 9f 9d 9f 02 40 2e")
REAL = AccelerometerCalibration((531, 520, 536), (636, 628, 638))
GYRO_BLOCK = bytes.fromhex(
    "7983 7354 72E8 30C3 CC4A 34FC C8 4F CC5B 7749 75A4 739A 3552 CA22 3726 2D E5 B5A2"
)
GYRO = MotionPlusCalibration(
    MotionPlusRange((31107, 29524, 29416), (12483, 52298, 13564), 1200),
    MotionPlusRange((30537, 30116, 29594), (13650, 51746, 14118), 270),
    (0x4F, 0xE5),
)

counts = st.tuples(*[st.integers(0, 1023)] * 3)
bytes_ = st.integers(0, 255)


# -- accelerometer -------------------------------------------------------------------------------


@pytest.mark.judged(device="Wiimote", transport="EEPROM", by="worked bytes")
def test_worked_calibration():
    assert decode_accelerometer_calibration(BLOCK) == REAL
    assert encode_accelerometer_calibration(REAL) == BLOCK


@pytest.mark.parametrize(
    ("report", "force_g", "roll_deg", "pitch_deg"),
    [
        ("31 60 48 91 82 9c", (0.495, 0.0, 0.882), 29.3, 0.0),
        ("31 70 e4 84 74 9c", (0.0, -0.5, 0.882), 0.0, 29.5),
        ("31 60 4c 84 82 9f", (0.0, 0.0, 1.0), 0.0, 0.0),
    ],
)
def test_worked_tilts(report, force_g, roll_deg, pitch_deg):
    raw = decode_input(bytes.fromhex(report)).accelerometer
    measured = to_g(raw, REAL.zero, REAL.one_g)
    assert measured == pytest.approx(force_g, abs=1e-3)
    roll, pitch = map(math.degrees, roll_and_pitch_rad(measured))
    assert (roll, pitch) == pytest.approx((roll_deg, pitch_deg), abs=0.05)


def test_copies_stand_in_for_one_another():
    bad = BLOCK[:9] + bytes((BLOCK[9] ^ 1,))
    other = encode_accelerometer_calibration(REAL._replace(volume=0))
    assert read_accelerometer_calibration(BLOCK + other) == (REAL, CalibrationSource.FIRST)
    assert read_accelerometer_calibration(bad + BLOCK) == (REAL, CalibrationSource.SECOND)
    default = (DEFAULT_ACCELEROMETER, CalibrationSource.DEFAULT)
    for useless in (bad + bad, b"", b"\xff" * 20, bytes(20), BLOCK[:9]):
        assert read_accelerometer_calibration(useless) == default


@pytest.mark.parametrize("zero", [(439, 520, 536), (531, 601, 536)])
def test_implausible_calibrations_are_refused(zero):
    block = encode_accelerometer_calibration(AccelerometerCalibration(zero, (636, 628, 638)))
    assert decode_accelerometer_calibration(block) is None


def test_calibration_without_a_span_is_refused():
    block = encode_accelerometer_calibration(REAL._replace(one_g=REAL.zero))
    assert decode_accelerometer_calibration(block) is None
    with pytest.raises(ValueError, match="1024"):
        encode_accelerometer_calibration(REAL._replace(zero=(0, 0, 1024)))


@given(counts)
def test_counts_and_g_are_inverse(raw):
    assert from_g(to_g(raw, REAL.zero, REAL.one_g), REAL.zero, REAL.one_g) == raw


def test_counts_are_clipped():
    assert from_g((9.0, -9.0, 0.0), REAL.zero, REAL.one_g) == (1023, 0, 536)


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_operator_axes_are_a_rotation(vector):
    assert from_operator_axes(to_operator_axes(vector)) == vector


def test_operator_axes():
    assert to_operator_axes((1.0, 0.0, 0.0)) == (0.0, 1.0, 0.0)  # left
    assert to_operator_axes((0.0, 1.0, 0.0)) == (-1.0, 0.0, 0.0)  # the tail is backwards
    assert to_operator_axes((0.0, 0.0, 1.0)) == (0.0, 0.0, 1.0)


# -- extensions ----------------------------------------------------------------------------------


@pytest.mark.parametrize("extension", EXTENSION_IDS)
def test_ids(extension):
    assert extension_of(EXTENSION_IDS[extension]) is extension


@pytest.mark.parametrize(
    ("identity", "extension"),
    [
        ("0100a4200405", Extension.MOTION_PLUS),  # built in
        ("0000a6200405", Extension.MOTION_PLUS_INACTIVE),  # once active
        ("ffffffffffff", Extension.UNINITIALIZED),
        ("0000a420ffff", Extension.UNINITIALIZED),
        ("0000a4209999", Extension.UNKNOWN),
        ("000000000000", Extension.UNKNOWN),
        ("0000a420", Extension.UNKNOWN),
    ],
)
def test_other_ids(identity, extension):
    assert extension_of(bytes.fromhex(identity)) is extension


@pytest.mark.judged(device="Wiimote", transport="Nunchuk", by="worked bytes")
def test_worked_nunchuk():
    value = NunchukData(128, 192, (513, 510, 727), True, False)
    assert decode_nunchuk(bytes.fromhex("80 c0 80 7f b5 e5")) == value
    assert encode_nunchuk(value) == bytes.fromhex("80 c0 80 7f b5 e5")


@given(bytes_, bytes_, counts, st.booleans(), st.booleans(), st.booleans())
def test_nunchuk_round_trips(x, y, accelerometer, c, z, plugged):
    value = NunchukData(x, y, accelerometer, c, z)
    data = encode_nunchuk(value)
    assume(any(data) and data != b"\xff" * 6)
    assert decode_nunchuk(data + bytes(10)) == value
    passed = encode_nunchuk_pass_through(value, plugged)
    assume(any(passed))
    assert not is_motion_plus_frame(passed)
    ax, ay, az = accelerometer
    coarse = (ax & ~1, ay & ~1, az & ~1)
    assert decode_nunchuk_pass_through(passed) == value._replace(accelerometer=coarse)


@pytest.mark.parametrize("data", [b"", bytes(5), bytes(6), b"\xff" * 6, b"\xff" * 16])
def test_no_extension_is_no_nunchuk(data):
    assert decode_nunchuk(data) is None
    assert decode_nunchuk_pass_through(data) is None
    assert decode_motion_plus(data) is None


@given(st.binary(max_size=20))
def test_nothing_raises(data):
    for decode in (
        decode_nunchuk,
        decode_nunchuk_pass_through,
        decode_motion_plus,
        decode_nunchuk_calibration,
        decode_accelerometer_calibration,
        extension_of,
        is_motion_plus_frame,
    ):
        decode(data)
    for ir_format in IrFormat:
        assert len(decode_dots(data, ir_format)) == 4


@given(st.binary(min_size=32, max_size=40))
def test_arbitrary_calibrations_do_not_raise(data):
    assert decode_motion_plus_calibration(data[:31]) is None
    decode_motion_plus_calibration(data)


def test_nunchuk_calibration():
    value = NunchukCalibration((510, 514, 518), (714, 716, 720), (35, 128, 228), (27, 128, 220))
    block = encode_nunchuk_calibration(value)
    assert len(block) == 16
    assert decode_nunchuk_calibration(block) == value
    for position in range(16):
        bad = bytearray(block)
        bad[position] ^= 0x10
        assert decode_nunchuk_calibration(bytes(bad)) is None
    backwards = value._replace(stick_x=(228, 128, 35))
    assert decode_nunchuk_calibration(encode_nunchuk_calibration(backwards)) is None
    assert decode_nunchuk_calibration(b"\xff" * 16) is None


def test_stick():
    calibration = (35, 128, 228)
    assert [stick_deflection(value, calibration) for value in (35, 128, 178, 228)] == [
        -1.0, 0.0, 0.5, 1.0,
    ]  # fmt: skip
    assert stick_deflection(0, calibration) == -1.0
    assert stick_deflection(255, calibration) == 1.0


# -- MotionPlus ----------------------------------------------------------------------------------


@pytest.mark.judged(device="Wiimote", transport="MotionPlus", by="worked bytes")
def test_worked_motion_plus():
    calibration = decode_motion_plus_calibration(GYRO_BLOCK)
    assert calibration == GYRO
    assert encode_motion_plus_calibration(GYRO) == GYRO_BLOCK
    frame = bytes.fromhex("fd 5e fc 6e 5a 52")
    data = decode_motion_plus(frame)
    assert data == MotionPlusData(7165, 5726, 5372, True, True, False, False)
    assert encode_motion_plus(data) == frame
    rates = [math.degrees(rate) for rate in to_rad_s(data, calibration)]
    assert rates == pytest.approx((-600.2, -90.0, -30.0), abs=0.05)


def test_default_scale_is_the_usual_one():
    data = decode_motion_plus(bytes.fromhex("fd 5e fc 6e 5a 52"))
    rates = [math.degrees(rate) for rate in to_rad_s(data, DEFAULT_MOTION_PLUS)]
    assert rates == pytest.approx((-688, -132, -55), abs=0.6)


def test_raw_above_rest_is_nose_down_roll_left_yaw_left():
    rest = [round(zero / 4) for zero in GYRO.slow.zero]
    data = MotionPlusData(rest[0] + 500, rest[1] + 500, rest[2] + 500, True, True, True, False)
    nose_down, roll_left, yaw_left = to_rad_s(data, GYRO)
    # About +x (left), +y (tail), +z (up), by the right-hand rule.
    assert min(nose_down, roll_left, yaw_left) > 0.3


@given(
    st.tuples(*[st.floats(-15.0, 15.0)] * 3),
    st.sampled_from([GYRO, DEFAULT_MOTION_PLUS]),
)
def test_rates_round_trip(rates, calibration):
    data = from_rad_s(rates, calibration)
    assert decode_motion_plus(encode_motion_plus(data)) == data
    assert to_rad_s(data, calibration) == pytest.approx(rates, abs=0.005)


def test_fine_range_where_it_fits():
    slow = from_rad_s((0.5, 0.5, 0.5), GYRO)
    assert (slow.yaw_slow, slow.roll_slow, slow.pitch_slow) == (True, True, True)
    fast = from_rad_s((20.0, 0.5, 0.5), GYRO)
    assert (fast.yaw_slow, fast.roll_slow, fast.pitch_slow) == (True, True, False)
    clipped = from_rad_s((1e3, -1e3, 1e3), GYRO)
    assert {0, 16383} >= {clipped.yaw, clipped.roll, clipped.pitch}


def test_frames_that_are_not_its_own():
    frame = bytearray.fromhex("fd 5e fc 6e 5a 52")
    frame[5] |= 1
    assert decode_motion_plus(bytes(frame)) is None  # invalid
    frame[5] &= ~3
    assert decode_motion_plus(bytes(frame)) is None  # passed through
    assert decode_motion_plus(bytes(frame[:5])) is None
    with pytest.raises(ValueError, match="16383"):
        encode_motion_plus(MotionPlusData(16384, 0, 0, True, True, True, False))


@given(st.integers(0, 31), st.integers(1, 255))
def test_broken_gyroscope_calibration_is_refused(position, change):
    bad = bytearray(GYRO_BLOCK)
    bad[position] ^= change
    assert decode_motion_plus_calibration(bytes(bad)) is None


def test_gyroscope_calibration_without_a_span_is_refused():
    for fast in (GYRO.fast._replace(scale=GYRO.fast.zero), GYRO.fast._replace(degrees_s=0)):
        block = encode_motion_plus_calibration(GYRO._replace(fast=fast))
        assert decode_motion_plus_calibration(block) is None
    with pytest.raises(ValueError, match="multiple of 6"):
        encode_motion_plus_calibration(GYRO._replace(fast=GYRO.fast._replace(degrees_s=100)))
    with pytest.raises(ValueError, match="cannot encode"):
        encode_motion_plus_calibration(GYRO._replace(fast=GYRO.fast._replace(degrees_s=6000)))


def test_activation():
    assert encode_output(motion_plus_activate(5))[:7] == bytes.fromhex("16 04 a6 00 fe 01 05")


# -- camera --------------------------------------------------------------------------------------


@pytest.mark.judged(device="Wiimote", transport="camera", by="worked bytes")
def test_worked_dots():
    extended = decode_dots(bytes.fromhex("bc 2c 63"), IrFormat.EXTENDED)
    assert extended == (IrDot(700, 300, 3), None, None, None)
    basic = decode_dots(bytes.fromhex("bc 2c 68 c8 08"), IrFormat.BASIC)
    assert basic == (IrDot(700, 300), IrDot(200, 520), None, None)


dots = st.none() | st.builds(
    IrDot,
    st.integers(0, 1023),
    st.integers(0, 767),
    st.integers(0, 15),
    st.tuples(*[st.integers(0, 127)] * 4),
    bytes_,
)


@given(st.lists(dots, max_size=4))
def test_dots_round_trip(seen):
    four = (*seen, *(None,) * (4 - len(seen)))
    assert decode_dots(encode_dots(seen, IrFormat.FULL), IrFormat.FULL) == four
    for ir_format, fields in ((IrFormat.EXTENDED, 3), (IrFormat.BASIC, 2)):
        expected = tuple(dot and IrDot(*dot[:fields]) for dot in four)
        assert decode_dots(encode_dots(seen, ir_format), ir_format) == expected


@pytest.mark.parametrize(
    ("seen", "words"),
    [
        ([None] * 5, "5 dots"),
        ([IrDot(1024, 0)], "1024 x 768"),
        ([IrDot(0, 0, 16)], "size 16"),
        ([IrDot(0, 0, 1, (0, 0, 0, 128))], "0..127"),
    ],
)
def test_dots_that_do_not_fit(seen, words):
    with pytest.raises(ValueError, match=words):
        encode_dots(seen, IrFormat.FULL)


def test_camera_start_and_stop():
    reports = [encode_output(value).hex(" ") for value in camera_start(IrFormat.EXTENDED)]
    assert reports[:2] == ["13 06", "1a 06"]
    assert [report[6:17] for report in reports[2:]] == [
        "b0 00 30 01", "b0 00 00 09", "b0 00 1a 02", "b0 00 33 01", "b0 00 30 01",
    ]  # fmt: skip
    assert SENSITIVITY_LEVEL_3[0].hex(" ") in reports[3]
    assert reports[5][18:20] == "03"
    assert [encode_output(value).hex(" ") for value in camera_stop()] == ["13 02", "1a 02"]
