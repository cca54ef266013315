"""The joint stream's bytes: round trip, worked bytes, and malformed data."""

import math
import struct

import pytest
from hypothesis import given, strategies as st

from cardan.protocols.joint_stream.codec import (
    MAX_DATAGRAM_BYTES,
    MAX_JOINTS,
    MAX_REASON_BYTES,
    ArmCommand,
    ArmState,
    ControlMode,
    MalformedDatagram,
    decode_command,
    decode_state,
    encode_command,
    encode_state,
    is_newer,
)

NUMBER = st.floats(allow_nan=False, allow_infinity=False)
WORD = st.integers(0, 2**32 - 1)


def vector(count):
    return st.tuples(*[NUMBER] * count)


@st.composite
def states(draw):
    joints = draw(st.integers(1, MAX_JOINTS))
    angle = draw(st.floats(0.0, 3.0))
    turn = (math.cos(angle), math.sin(angle), 0.0, 0.0)
    return ArmState(
        draw(WORD),
        draw(WORD),
        draw(NUMBER),
        draw(st.sampled_from(ControlMode)),
        draw(WORD),
        draw(st.floats(1e-4, 1.0)),
        draw(vector(joints)),
        draw(vector(joints)),
        draw(vector(joints)),
        (*draw(vector(3)), *turn),
        draw(vector(6)),
        draw(st.text(max_size=40)),
    )


@st.composite
def commands(draw):
    joints = draw(st.integers(1, MAX_JOINTS))
    mode = draw(st.sampled_from(ControlMode))
    values = () if mode is ControlMode.HOLD else draw(vector(joints))
    speeds = draw(vector(joints)) if mode is ControlMode.POSITION else ()
    return ArmCommand(draw(WORD), draw(WORD), draw(NUMBER), mode, values, speeds), joints


@given(states())
def test_states_come_back(state):
    data = encode_state(state)
    assert decode_state(data) == state
    assert len(data) <= MAX_DATAGRAM_BYTES
    assert isinstance(decode_command(data), MalformedDatagram)


@given(commands())
def test_commands_come_back(case):
    command, joints = case
    data = encode_command(command, joints)
    assert decode_command(data) == command
    assert isinstance(decode_state(data), MalformedDatagram)


@given(st.binary(max_size=600))
def test_junk_is_a_reason(data):
    assert isinstance(decode_state(data), MalformedDatagram)
    assert isinstance(decode_command(data), MalformedDatagram)


@given(states(), st.data())
def test_cut_or_damaged_never_raises(state, data):
    whole = bytearray(encode_state(state))
    cut = data.draw(st.integers(0, len(whole) - 1))
    assert isinstance(decode_state(bytes(whole[:cut])), MalformedDatagram)
    assert isinstance(decode_state(bytes(whole) + b"x"), MalformedDatagram)
    whole[cut] ^= data.draw(st.integers(1, 255))
    decode_state(bytes(whole))
    decode_command(bytes(whole))


def test_worked_bytes_of_a_command():
    command = ArmCommand(7, 9, 1.5, ControlMode.VELOCITY, (0.25, -0.5))
    wanted = (
        b"CJST\x01\x02\x02\x02"
        + b"\x07\x00\x00\x00\x09\x00\x00\x00"
        + b"\x00\x00\x00\x00\x00\x00\xf8\x3f"
        + b"\x00\x00\x00\x00\x00\x00\xd0\x3f"
        + b"\x00\x00\x00\x00\x00\x00\xe0\xbf"
    )
    assert encode_command(command, 2) == wanted
    assert decode_command(wanted) == command


def test_positions_without_speeds_travel_with_zeros():
    data = encode_command(ArmCommand(1, 1, 0.0, ControlMode.POSITION, (1.0,)), 1)
    assert decode_command(data) == ArmCommand(1, 1, 0.0, ControlMode.POSITION, (1.0,), (0.0,))


@pytest.mark.parametrize(
    ("offset", "byte", "reason"),
    [
        (0, 0x58, "not a joint stream"),
        (4, 2, "version 2, not 1"),
        (5, 1, "kind 1, not 2"),
        (6, 4, "there is no mode 4"),
        (7, 0, "0 joints, not 1 to 16"),
        (7, 17, "17 joints, not 1 to 16"),
        (7, 2, "a TORQUE command of 2 joints in 32 bytes"),
    ],
)
def test_a_wrong_header_is_named(offset, byte, reason):
    data = bytearray(encode_command(ArmCommand(1, 1, 0.0, ControlMode.TORQUE, (1.0,)), 1))
    data[offset] = byte
    assert decode_command(bytes(data)) == MalformedDatagram(reason)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_malformed(bad):
    data = encode_command(ArmCommand(1, 1, 0.0, ControlMode.TORQUE, (bad,)), 1)
    assert decode_command(data) == MalformedDatagram("a number is not finite")
    data = encode_command(ArmCommand(1, 1, bad, ControlMode.HOLD), 1)
    assert decode_command(data) == MalformedDatagram("the stamp is not finite")


ONE = ArmState(
    1, 2, 0.0, ControlMode.HOLD, 0, 0.002, (0.0,), (0.0,), (0.0,), (0, 0, 0, 1, 0, 0, 0), (0,) * 6
)


def test_a_bad_state_is_malformed():
    for change in ({"period_s": 0.0}, {"pose": (0, 0, 0, 2, 0, 0, 0)}, {"velocities": (math.nan,)}):
        assert isinstance(decode_state(encode_state(ONE._replace(**change))), MalformedDatagram)
    data = encode_state(ONE._replace(reason="x"))
    assert decode_state(data[:-1] + b"\xff") == MalformedDatagram("the reason is not UTF-8")


def test_a_long_reason_is_cut_between_characters():
    decoded = decode_state(encode_state(ONE._replace(reason="é" * 200)))
    assert decoded.reason == "é" * (MAX_REASON_BYTES // 2)


def test_wrong_lengths_are_the_programmers():
    with pytest.raises(ValueError, match="1 to 16 joints"):
        encode_state(ONE._replace(torques=()))
    with pytest.raises(ValueError, match="2 values do not fit a VELOCITY"):
        encode_command(ArmCommand(1, 1, 0.0, ControlMode.VELOCITY, (1.0, 2.0)), 3)
    with pytest.raises(ValueError, match="no feed-forward"):
        encode_command(ArmCommand(1, 1, 0.0, ControlMode.TORQUE, (1.0,), (1.0,)), 1)


def test_sequences_wrap():
    assert is_newer(2, 1)
    assert is_newer(0, 2**32 - 1)
    assert not is_newer(1, 1)
    assert not is_newer(2**32 - 1, 0)
    assert struct.calcsize("<4sBBBBIId") == 24
