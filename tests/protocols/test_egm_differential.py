"""The codec compared with protobuf's own parser and an independent schema."""

from contextlib import suppress

import pytest
from hypothesis import example, given, settings, strategies as st

from cardan.protocols.egm.decode import decode_from_pc, decode_robot
from cardan.protocols.egm.encode import encode_path_corr, encode_robot, encode_sensor
from cardan.protocols.egm.messages import MalformedEgmMessage
from tests.examples import examples
from tests.protocols.worked import C1, F6, F7, R0, R1, S1, S2, S3, S4

from . import egm_oracle as oracle, egm_values as values
from .egm_wire import double, messages, spoilt, tagged, varint

bounded = settings(max_examples=examples(250), derandomize=True)


def agree(data, decode, expect):
    """Return True if both accept `data` with equal values, False if both refuse it."""
    found = decode(data)
    try:
        expected = expect(data)
    except oracle.RefusedError:
        assert isinstance(found, MalformedEgmMessage), found
        return False
    oracle.assert_same(found, expected)
    return True


def agree_on_robot(data):
    return agree(data, decode_robot, oracle.robot)


def agree_from_pc(data):
    return agree(data, decode_from_pc, oracle.from_pc)


robots = values.robot.map(encode_robot) | values.usual_robot.map(encode_robot)
from_pc = values.sensor.map(encode_sensor) | values.path_corr.map(encode_path_corr)


@bounded
@given(robots)
def test_robots_that_the_encoder_writes(data):
    assert agree_on_robot(data)


@bounded
@given(from_pc)
def test_messages_from_a_pc_that_the_encoder_writes(data):
    assert agree_from_pc(data)


@bounded
@given(spoilt(robots))
def test_spoilt_robots(data):
    agree_on_robot(data)


@bounded
@given(spoilt(from_pc))
def test_spoilt_messages_from_a_pc(data):
    agree_from_pc(data)


@bounded
@given(st.lists(robots | messages, min_size=1, max_size=3).map(b"".join))
@example(tagged(2, b"") + tagged(9, tagged(1, bytes(7))))
@example(tagged(2, b"") + tagged(9, b"\x08\x01" + tagged(1, double(1.0))))
@example(tagged(2, b"") + tagged(9, b"\x11" + double(1.0) + b"\x09" + double(2.0)))
@example(tagged(2, b"") + tagged(9, b""))
@example(R1 + tagged(4, b""))
@example(R1 + tagged(3, tagged(2, tagged(1, b""))))
def test_robots_merged_with_others_and_with_strange_fields(data):
    agree_on_robot(data)


@bounded
@given(st.lists(from_pc | messages, min_size=1, max_size=3).map(b"".join))
def test_messages_from_a_pc_merged_with_others_and_with_strange_fields(data):
    agree_from_pc(data)


@pytest.mark.parametrize("depth", [97, 98, 99, 100, 101])
@pytest.mark.parametrize("start", [R0, R1, b"\x12\x00"], ids=["R0", "R1", "feedBack"])
def test_groups_nested_as_deep_as_protobuf_takes_them(start, depth):
    agree_on_robot(start + b"\x7b" * depth + b"\x7c" * depth)


@pytest.mark.parametrize("data", [R1, R0 + F6, R0 + F7], ids=["R1", "F6", "F7"])
def test_robots_with_any_one_bit_turned(data):
    accepted = [agree_on_robot(turned) for turned in one_bit_turned(data)]
    assert 0.5 < sum(accepted) / len(accepted) < 1


@pytest.mark.parametrize("data", [S1, S2, S3, S4, C1], ids=["S1", "S2", "S3", "S4", "C1"])
def test_messages_from_a_pc_with_any_one_bit_turned(data):
    accepted = [agree_from_pc(turned) for turned in one_bit_turned(data)]
    assert 0.5 < sum(accepted) / len(accepted) < 1


def one_bit_turned(data):
    for at in range(len(data)):
        for bit in range(8):
            yield data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :]


def test_every_cut():
    accepted = {end for end in range(len(R1) + 1) if agree_on_robot(R1[:end])}
    # Data cut at the end of a top-level field from feedBack on is still complete.
    assert sorted(accepted) == [179, 348, 352, 356, 358, 362, 420, 429, 431]
    for data in (S4, C1):
        for end in range(len(data) + 1):
            agree_from_pc(data[:end])


@pytest.mark.parametrize("padding", range(10))
@pytest.mark.parametrize("number", [0, 1, 127, 128, 2**28, 2**32 - 1, 2**32, 2**64 - 1])
def test_varints_of_every_length(number, padding):
    padded = varint(number, padding)
    for field in (1, 2):
        header = varint(field << 3) + padded + b"\x18\x02"
        agree_on_robot(tagged(1, header) + R1[10:])
        agree_from_pc(tagged(1, header) + S1[10:])
    both = b"\x08" + padded + b"\x10" + padded + b"\x18\x02"
    agree_on_robot(tagged(1, both) + R1[10:])
    for top_level in (3, 6, 11):
        agree_on_robot(R1 + varint(top_level << 3) + padded)
    clock = tagged(4, b"\x08" + padded + b"\x10" + padded)
    agree_on_robot(tagged(1, b"\x18\x02") + tagged(2, R1[13:167] + clock))


def test_the_oracle_can_refuse_and_accept():
    with suppress(oracle.RefusedError):
        pytest.fail(f"accepted: {oracle.robot(R1[:-1])}")
    assert oracle.robot(R1).move_index == 1
