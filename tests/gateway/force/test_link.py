"""Packets between a session and a force node, and authority over the force."""

import math
import re
from pathlib import Path

from hypothesis import given, strategies as st

from cardan.common.haptics import WorldMap
from cardan.gateway.force.lease import LEASE_S, Lease
from cardan.gateway.force.link import (
    FORCE_BYTES,
    MAX_PACKET_BYTES,
    STATE_BYTES,
    ForceMessage,
    RefusalMessage,
    StateMessage,
    decode,
    encode_force,
    encode_refusal,
    encode_state,
)
from cardan.types import IDENTITY, ZERO3, Frame, Pose, Quaternion, RobotLink, Vector3, Wrench

TURNED = Quaternion(0.6, 0.0, -0.8, 0.0)
numbers = st.floats(-100.0, 100.0)
vectors = st.builds(Vector3, numbers, numbers, numbers)
nines = st.tuples(*[numbers] * 9)
states = st.builds(
    StateMessage,
    st.integers(0, 2**64 - 1),
    st.floats(0.0, 1e9),
    st.booleans(),
    st.none() | st.builds(Pose, vectors, st.just(TURNED), st.just(Frame.BASE)),
    st.none() | st.builds(Wrench, vectors, vectors, st.sampled_from([Frame.BASE, Frame.TOOL])),
    st.none() | st.builds(WorldMap, nines, vectors, nines),
)


def test_a_worked_force():
    packet = bytes.fromhex(
        "43444e46 01 02 0000"  # "CDNF", version 1, kind 2
        "0700000000000000"  # message 7
        "0000000000 00f83f"  # of 1.5 s
        "0000000000 00e03f"  # x 0.5 N
        "0000000000 00d0bf"  # y -0.25 N
        "0000000000 000040"  # z 2 N
    )
    message = ForceMessage(7, 1.5, Vector3(0.5, -0.25, 2.0))
    assert encode_force(message) == packet
    assert decode(packet) == message
    assert FORCE_BYTES == 48


def test_the_page_has_the_worked_force():
    page = (Path(__file__).parents[3] / "docs" / "force-feedback.md").read_text(encoding="utf-8")
    found = re.search(r"^43444e46 01 02 .*\n.*$", page, re.MULTILINE)
    assert decode(bytes.fromhex(found[0])) == ForceMessage(7, 1.5, Vector3(0.5, -0.25, 2.0))
    for size, kind in ((STATE_BYTES, 1), (FORCE_BYTES, 2)):
        assert re.search(rf"^\| {kind} \| \w+ \| {size} \|", page, re.MULTILINE)


def test_a_worked_state():
    pose = Pose(Vector3(0.5, 0.0, 0.0), IDENTITY)
    packet = encode_state(StateMessage(3, 2.0, True, pose, None, None))
    assert packet[:32] == bytes.fromhex(
        "43444e46 01 01 11 00"  # "CDNF", version 1, kind 1, ready and a pose
        "0300000000000000"  # message 3
        "0000000000000040"  # of 2 s
        "000000000000e03f"  # x 0.5 m
    )
    assert len(packet) == STATE_BYTES == 296
    assert not any(packet[88:])


def test_a_worked_refusal():
    packet = encode_refusal(RefusalMessage("no: é"))
    assert packet == b"CDNF\x01\x03\0\0no: \xc3\xa9"
    assert decode(packet) == RefusalMessage("no: é")
    assert len(encode_refusal(RefusalMessage("x" * 5000))) == MAX_PACKET_BYTES


@given(states)
def test_states_go_there_and_back(message):
    assert decode(encode_state(message)) == message


@given(st.integers(0, 2**64 - 1), st.floats(0.0, 1e9), vectors)
def test_forces_go_there_and_back(sequence, stamp_s, force):
    message = ForceMessage(sequence, stamp_s, force)
    assert decode(encode_force(message)) == message


@given(st.binary(max_size=400))
def test_garbage_is_no_message(data):
    assert decode(data) is None
    decode(b"CDNF\x01" + data)  # no bytes raise another error


@given(states, st.data())
def test_a_message_that_is_cut_or_changed_does_not_raise(message, data):
    packet = bytearray(encode_state(message))
    packet[data.draw(st.integers(0, len(packet) - 1))] ^= data.draw(st.integers(1, 255))
    changed = decode(bytes(packet))
    if isinstance(changed, StateMessage):
        assert math.isfinite(changed.stamp_s)
    assert decode(bytes(packet[: data.draw(st.integers(0, len(packet) - 1))])) is None


def test_numbers_that_are_none_are_no_force():
    for force in ((math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (0.0, 0.0, 1e9)):
        assert decode(encode_force(ForceMessage(1, 1.0, Vector3(*force)))) is None
    assert decode(encode_force(ForceMessage(1, math.nan, ZERO3))) is None
    mad = Pose(ZERO3, Quaternion(2.0, 0.0, 0.0, 0.0))
    assert decode(encode_state(StateMessage(1, 1.0, True, mad, None, None))) is None


def test_a_state_message_is_a_robots_state():
    state = StateMessage(5, 2.0, False, None, None, None).robot_state()
    assert (state.link, state.ready, state.stamp_s) == (RobotLink.LIVE, False, 2.0)


def force(sequence, stamp_s):
    return ForceMessage(sequence, stamp_s, Vector3(1.0, 0.0, 0.0))


def test_one_node_owns_the_force():
    lease = Lease(0.1)
    assert lease.ask(1, 0.0) == ""
    assert "another force node" in lease.ask(2, 0.5)
    assert not lease.take(2, force(1, 0.5), 0.5)
    assert lease.take(1, force(1, 0.5), 0.5)
    assert lease.refused == 1
    # After a long silence the node may be replaced, and its force has ended.
    assert "another" in lease.ask(3, 0.5 + 0.9 * LEASE_S)
    assert lease.ask(4, 0.5 + LEASE_S) == ""
    assert lease.newest is None
    assert not lease.take(1, force(2, 1.5), 1.5)


def test_a_node_that_leaves_takes_its_force_with_it():
    lease = Lease(0.1)
    lease.ask(1, 0.0)
    lease.take(1, force(1, 0.0), 0.0)
    lease.leave(2)
    assert lease.newest is not None
    lease.leave(1)
    assert lease.newest is None
    assert lease.ask(2, 0.01) == ""


def test_stale_forces_and_those_out_of_order_are_dropped():
    lease = Lease(0.1)
    lease.ask(1, 0.0)
    assert lease.take(1, force(5, 1.0), 1.0)
    assert not lease.take(1, force(5, 1.01), 1.01)  # duplicate
    assert not lease.take(1, force(4, 1.02), 1.02)  # out of order
    assert not lease.take(1, force(6, 0.99), 1.02)  # computed from an older state
    assert not lease.take(1, force(7, 1.0), 1.2)  # late
    assert not lease.take(1, force(8, 2.0), 1.2)  # from another clock
    assert lease.newest == force(5, 1.0)
    assert lease.dropped == 5
    assert lease.take(1, force(9, 1.2), 1.2)
