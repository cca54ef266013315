"""Reports compared with worked bytes and their inverses, and decoded from arbitrary bytes."""

import pytest
from hypothesis import example, given, strategies as st

from cardan.protocols.connexion.reports import (
    Battery,
    ButtonBits,
    KeysDown,
    LedOutput,
    LongPress,
    LongPressBits,
    MotionReport,
    Rotation,
    Translation,
    decode_input,
    decode_output,
    encode_battery,
    encode_buttons,
    encode_keys_down,
    encode_led,
    encode_long_press,
    encode_motion,
    encode_rotation,
    encode_translation,
    from_robot_axes,
    from_serial_axes,
    to_robot_axes,
)
from cardan.protocols.hid import MalformedReport

INPUT_VALUES = (
    Translation, Rotation, MotionReport, ButtonBits, KeysDown, LongPress, LongPressBits, Battery,
    MalformedReport,
)  # fmt: skip

WORKED = [
    ("01 78 00 d3 ff 2c 01", Translation(120, -45, 300)),
    ("02 a2 fe 08 00 40 00", Rotation(-350, 8, 64)),
    ("01 2e ff 21 00 ff ff 5e 01 a2 fe 80 00", MotionReport(-210, 33, -1, 350, -350, 128)),
    ("03 00 10 00 02 00 00", ButtonBits(1 << 12 | 1 << 25)),
    ("03 03 00", ButtonBits(0b11)),
    ("1c 0d 00 67 00 00 00 00 00 00 00 00 00", KeysDown((13, 103))),
    ("1d 07 00 00 00 00 00 00 00 00 00 00 00", LongPress((7,))),
    ("16 05 00 00 40", LongPressBits(1 << 30 | 0b101)),
    ("17 55 00", Battery(85, False)),
    ("17 64 01", Battery(100, True)),
]

counts = st.integers(-32768, 32767)
codes = st.lists(st.integers(1, 65535), max_size=6).map(tuple)


@pytest.mark.judged(device="SpaceMouse", transport="HID reports", by="worked bytes")
@pytest.mark.parametrize(("text", "value"), WORKED)
def test_worked_bytes(text, value):
    assert decode_input(bytes.fromhex(text)) == value
    assert type(decode_input(bytes.fromhex(text))) is type(value)


def test_worked_bytes_are_what_we_encode():
    assert encode_translation(120, -45, 300).hex(" ") == WORKED[0][0]
    assert encode_rotation(-350, 8, 64).hex(" ") == WORKED[1][0]
    assert encode_motion(-210, 33, -1, 350, -350, 128).hex(" ") == WORKED[2][0]
    assert encode_buttons(1 << 12 | 1 << 25, 7).hex(" ") == WORKED[3][0]
    assert encode_buttons(0b11, 3).hex(" ") == WORKED[4][0]
    assert encode_keys_down((13, 103)).hex(" ") == WORKED[5][0]
    assert encode_long_press((7,)).hex(" ") == WORKED[6][0]
    assert encode_battery(85, False).hex(" ") == WORKED[8][0]
    assert encode_led(True).hex(" ") == "04 01"


def test_worked_robot_frame():
    axes = to_robot_axes((120, -45, 300, -350, 8, 64), 350)
    assert axes == pytest.approx((0.1286, -0.3429, -0.8571, -0.0229, 1.0, -0.1829), abs=1e-4)


@pytest.mark.parametrize("size", range(1, 7))
@pytest.mark.parametrize("report_id", [1, 2])
def test_short_motion_is_malformed(report_id, size):
    value = decode_input(bytes([report_id, *range(1, size)]))
    assert value == MalformedReport("too short", report_id)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", MalformedReport("empty", -1)),
        ("2a 01 02 03", MalformedReport("of an unknown id", 0x2A)),
        ("03", MalformedReport("too short", 3)),
        ("16 01 00", MalformedReport("too short", 0x16)),
        ("17 55", MalformedReport("too short", 0x17)),
        ("17 65 00", MalformedReport("with an impossible value", 0x17)),
        ("1c 0d 00 67 00", MalformedReport("too short", 0x1C)),
        ("1d 0d 00", MalformedReport("too short", 0x1D)),
    ],
)
def test_unusable_reports_are_named(text, value):
    assert decode_input(bytes.fromhex(text)) == value


def test_length_tells_the_family():
    split, one = encode_translation(1, 2, 3), encode_motion(1, 2, 3, 4, 5, 6)
    assert decode_input(split) == Translation(1, 2, 3)
    assert decode_input(split + bytes(5)) == MalformedReport("too short", 0x01)
    assert decode_input(split + bytes(6)) == MotionReport(1, 2, 3, 0, 0, 0)
    assert decode_input(one[:12]) == MalformedReport("too short", 0x01)
    assert decode_input(one + bytes(51)) == MotionReport(1, 2, 3, 4, 5, 6)


def test_missing_button_bytes_are_zero():
    assert decode_input(b"\x03\x05") == ButtonBits(5)


@given(st.binary(max_size=70))
@example(b"")
def test_any_bytes_decode(data):
    assert isinstance(decode_input(data), INPUT_VALUES)
    assert isinstance(decode_output(data), (LedOutput, MalformedReport))


@given(st.sampled_from([1, 2, 3, 0x16, 0x17, 0x1C, 0x1D]), st.binary(max_size=70))
def test_any_bytes_after_a_known_id_decode(report_id, data):
    value = decode_input(bytes([report_id]) + data)
    assert isinstance(value, INPUT_VALUES)
    if isinstance(value, MalformedReport):
        assert value.report_id == report_id
        assert value.reason != "of an unknown id"


@given(st.tuples(counts, counts, counts, counts, counts, counts))
def test_motion_round_trip(six):
    assert decode_input(encode_motion(*six)) == six
    assert decode_input(encode_translation(*six[:3])) == six[:3]
    assert decode_input(encode_rotation(*six[3:])) == six[3:]


@given(codes)
def test_key_array_round_trip(keys):
    assert decode_input(encode_keys_down(keys)) == KeysDown(keys)
    assert decode_input(encode_long_press(keys)) == LongPress(keys)


@given(st.integers(0, (1 << 48) - 1))
def test_buttons_round_trip(mask):
    assert decode_input(encode_buttons(mask, 7)) == ButtonBits(mask)


@given(st.integers(0, 100), st.booleans())
def test_battery_round_trip(percent, external):
    assert decode_input(encode_battery(percent, external)) == Battery(percent, external)


@pytest.mark.parametrize("on", [False, True])
def test_led_round_trip(on):
    assert decode_output(encode_led(on)) == LedOutput(on)


@pytest.mark.parametrize(
    ("text", "reason"), [("", "empty"), ("04", "too short"), ("05 01", "of an unknown id")]
)
def test_unusable_output_is_named(text, reason):
    assert decode_output(bytes.fromhex(text)).reason == reason


@pytest.mark.parametrize(
    "encode",
    [
        lambda: encode_translation(40000, 0, 0),
        lambda: encode_motion(0, 0, 0, 0, 0, -40000),
        lambda: encode_buttons(1 << 16, 3),
        lambda: encode_keys_down(range(1, 8)),
        lambda: encode_keys_down([70000]),
        lambda: encode_battery(101, False),
    ],
)
def test_encoders_refuse_what_does_not_fit(encode):
    with pytest.raises(ValueError, match=r"\d"):
        encode()


@given(st.tuples(*[st.integers(-350, 350)] * 6))
def test_robot_axes_round_trip(raw):
    assert from_robot_axes(to_robot_axes(raw, 350), 350) == raw


@given(st.tuples(*[counts] * 6), st.floats(1.0, 1000.0))
def test_robot_axes_are_clamped(raw, full_scale):
    assert all(-1.0 <= u <= 1.0 for u in to_robot_axes(raw, full_scale))


@pytest.mark.parametrize(
    ("raw", "axis", "sign"),
    [
        ((0, -100, 0, 0, 0, 0), 0, 1),  # away from the operator: forward
        ((-100, 0, 0, 0, 0, 0), 1, 1),  # to the left
        ((0, 0, 100, 0, 0, 0), 2, -1),  # pushed down
        ((0, 0, 0, 0, 100, 0), 3, -1),  # left edge down: rolls left, about -x
        ((0, 0, 0, 100, 0, 0), 4, -1),  # near edge down: nose up, about -y
        ((0, 0, 0, 0, 0, 100), 5, -1),  # clockwise from above, about -z
    ],
)
def test_gestures(raw, axis, sign):
    axes = to_robot_axes(raw, 200)
    assert axes[axis] == sign * 0.5
    assert [u for i, u in enumerate(axes) if i != axis] == [0.0] * 5


def test_serial_axes_are_right_up_away():
    forward_up_left = (-30, 20, 10, 0, 0, 0)
    assert to_robot_axes(from_serial_axes(forward_up_left), 100)[:3] == (0.1, 0.3, 0.2)
    # The frame is left-handed: positive rotations have the opposite sense.
    assert from_serial_axes((0, 0, 0, 1, 2, 3))[3:] == (1, -3, -2)
