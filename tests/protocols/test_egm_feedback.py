"""Partial decoders of the fields that an answer needs, in full and by likeness, compared with the
full decoder."""

import math

import pytest
from hypothesis import given, settings, strategies as st

from cardan.drivers.abb_egm.compiled import CompiledReader
from cardan.protocols.egm import reader
from cardan.protocols.egm.decode import decode_feedback, decode_robot
from cardan.protocols.egm.encode import encode_robot
from cardan.protocols.egm.messages import (
    EgmFeedback,
    EgmHeader,
    EgmMeasuredForce,
    EgmMessageType,
    EgmMotion,
    EgmRobot,
    Fault,
    MalformedEgmMessage,
    MCIState,
    MotorState,
    RapidState,
)
from cardan.protocols.egm.reader import FeedbackReader
from cardan.spatial import from_euler_zyx
from tests.examples import examples
from tests.protocols.worked import F6, F7, R0, R1

from . import egm_values as values
from .egm_wire import double, messages, spoilt, tagged, varint

bounded = settings(max_examples=examples(150), derandomize=True)

FORCE = (1.5, -2.25, 10.0, 0.125, 0.0, -0.5)
USUAL = decode_robot(R1)
assert isinstance(USUAL, EgmRobot)


def same(found, expected):
    """Return whether both are equal; NaN equals NaN."""
    return repr(found) == repr(expected)


def feedback_of(robot):
    """Return the expected result of `decode_feedback`; None if it must refuse."""
    header, motion = robot.header, robot.feed_back
    if header is None or header.seqno is None or motion is None:
        return None
    pos = orient = None
    if motion.cartesian is not None:
        pos, orient, euler = motion.cartesian
        if orient is None and euler is not None:
            orient = from_euler_zyx(*euler)
    return EgmFeedback(
        header.seqno,
        header.tm_ms,
        motion.joints or (),
        pos,
        orient,
        motion.external_joints or (),
        motion.time_us,
        tuple(
            0 if state is None else int(state)
            for state in (robot.motor_state, robot.mci_state, robot.rapid_exec_state)
        ),
        robot.measured_force.force if robot.measured_force else (),
        robot.utilization_rate,
    )


def agree(data):
    """Return whether the short decoder agrees with the full one, where both return a message."""
    full, short = decode_robot(data), decode_feedback(data)
    if isinstance(full, EgmRobot):
        expected = feedback_of(full)
        return isinstance(short, MalformedEgmMessage) if expected is None else same(short, expected)
    return True


@bounded
@given(values.robot | values.usual_robot)
def test_any_robot_is_the_same_both_ways(robot):
    assert agree(encode_robot(robot))


@bounded
@given(messages | spoilt(values.usual_robot.map(encode_robot)))
def test_any_bytes_are_the_same_both_ways(data):
    assert isinstance(decode_feedback(data), EgmFeedback | MalformedEgmMessage)
    assert agree(data)


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (b"", Fault.EMPTY),
        (R1 + tagged(15, bytes(2048)), Fault.OVERSIZED),
        (R1[:-1], Fault.TRUNCATED),
        (R1.replace(b"\x18\x02", b"\x18\x03", 1), Fault.WRONG_TYPE),
        (R1[10:], Fault.WRONG_TYPE),
        (R1[:10] + tagged(3, b""), Fault.WRONG_TYPE),
        (R1[:10] + tagged(2, b"") + tagged(3, tagged(2, tagged(1, b""))), Fault.WRONG_TYPE),
        (R1.replace(double(30.0), double(math.nan), 1), Fault.NOT_FINITE),
        (R1.replace(double(597.5), double(math.inf), 1), Fault.NOT_FINITE),
        (R1.replace(double(0.5), double(math.nan), 1), Fault.NOT_FINITE),
        (R1.replace(double(-2.25), double(math.nan), 1), Fault.NOT_FINITE),
        (R1 + tagged(2, tagged(3, b"\x09" + double(math.nan))), Fault.NOT_FINITE),
        (R1 + tagged(2, tagged(1, b"\x09" + double(0.0))), Fault.WRONG_COUNT),
        (R1 + tagged(2, tagged(3, (b"\x09" + double(0.0)) * 7)), Fault.WRONG_COUNT),
        (R1 + tagged(9, b"\x11" + double(0.0)), Fault.WRONG_COUNT),
    ],
)
def test_what_no_answer_may_depend_on_is_refused(data, fault):
    taught = FeedbackReader()
    taught.read(R1)
    taught.learn()
    for refused in (decode_feedback(data), taught.read(data)):
        assert isinstance(refused, MalformedEgmMessage)
        assert refused.fault is fault
        assert refused.detail


def test_what_no_answer_depends_on_is_not_looked_at():
    bad = R1 + tagged(3, tagged(3, b"\x09" + double(math.nan)))
    assert isinstance(decode_robot(bad), MalformedEgmMessage)
    assert decode_feedback(bad) == decode_feedback(R1)


# --- by likeness


class LongWayError(Exception):
    """Raised if the full decoder is called in a test that forbids it."""


@pytest.fixture(
    autouse=True,
    scope="module",
    params=[FeedbackReader, CompiledReader],
    ids=["python", "compiled"],
)
def kind(request):
    """Run every test here with both readers."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{__name__}.FeedbackReader", request.param)
        yield request.param


@pytest.fixture
def only_by_likeness(monkeypatch):
    def refuse(data):
        raise LongWayError

    def forbid():
        monkeypatch.setattr(reader, "decode_feedback", refuse)

    return forbid


def taught_by(*datagrams):
    found = FeedbackReader()
    for data in datagrams:
        found.read(data)
        found.learn()
    return found


@pytest.mark.parametrize(
    "robot",
    [
        USUAL,
        USUAL._replace(measured_force=None),
        USUAL._replace(utilization_rate=None),
        USUAL._replace(measured_force=None, utilization_rate=None, planned=None),
        USUAL._replace(header=EgmHeader(2**32 - 1, 0, EgmMessageType.DATA)),
    ],
)
def test_a_datagram_like_one_before_is_known(robot, only_by_likeness):
    data = encode_robot(robot)
    expected = decode_feedback(data)
    taught = taught_by(data)
    only_by_likeness()
    assert same(taught.read(data), expected)


def test_values_may_all_be_others(only_by_likeness):
    other = USUAL._replace(
        header=EgmHeader(9000, 9999, EgmMessageType.DATA),
        feed_back=USUAL.feed_back._replace(joints=FORCE, time_us=1_700_000_999_999_000),
        planned=USUAL.planned._replace(joints=FORCE),
        mci_convergence_met=False,
        measured_force=EgmMeasuredForce(FORCE[::-1], False),
        utilization_rate=0.5,
        move_index=77,
    )
    data = encode_robot(other)
    expected = decode_feedback(data)
    assert len(data) == len(R1)
    taught = taught_by(R1)
    only_by_likeness()
    assert same(taught.read(data), expected)


@pytest.mark.parametrize(
    "change",
    [
        {"motor_state": MotorState.OFF},
        {"mci_state": MCIState.STOPPED},
        {"rapid_exec_state": RapidState.STOPPED},
        {"header": EgmHeader(300, 1210, EgmMessageType.UNDEFINED)},
    ],
)
def test_a_change_of_state_is_seen(change):
    changed = encode_robot(USUAL._replace(**change))
    assert len(changed) == len(R1)
    taught = taught_by(R1)
    for _ in range(2):
        assert same(taught.read(changed), decode_feedback(changed))
        taught.learn()


@bounded
@given(values.usual_robot, st.data())
def test_any_change_of_a_byte_reads_as_the_long_way_does(robot, data):
    one = encode_robot(robot)
    taught = taught_by(one)
    other = bytearray(one)
    for _ in range(data.draw(st.integers(0, 4))):
        other[data.draw(st.integers(0, len(one) - 1))] = data.draw(st.integers(0, 255))
    assert same(taught.read(bytes(other)), decode_feedback(bytes(other)))


@bounded
@given(messages | spoilt(values.robot.map(encode_robot)), st.data())
def test_whatever_was_learned_reads_as_the_long_way_does(one, data):
    taught = taught_by(one)
    other = bytearray(one)
    for _ in range(data.draw(st.integers(0, 3))):
        if other:
            other[data.draw(st.integers(0, len(one) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    assert same(taught.read(bytes(other)), decode_feedback(bytes(other)))


@pytest.mark.parametrize(
    "data",
    [
        R0,
        R0 + F6,
        R0 + F7,
        R1 + tagged(2, tagged(3, b"\x09" + double(5.0))),
        R1 + tagged(14, tagged(1, double(5.0) * 3)),
        R1 + varint(15 << 3) + b"\x05",
        R1 + varint(99 << 3) + b"\x05",
        R1 + b"\x58" + varint(1, padding=5),
        R1[10:] + R1[:10],
        encode_robot(USUAL._replace(feed_back=EgmMotion(FORCE))),
    ],
)
def test_unusual_datagrams_are_read_and_not_studied_again(data):
    taught = taught_by(R1, data)
    assert same(taught.read(data), decode_feedback(data))
    assert taught._unlearned is None
    assert same(taught.read(R1), decode_feedback(R1))


def test_what_is_kept_is_bounded():
    taught = taught_by(R1)
    for size in range(300):
        taught.read(R1 + tagged(15, bytes(size)))
        taught.learn()
    assert len(taught._layouts) <= 64
