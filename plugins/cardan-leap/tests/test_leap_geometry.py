"""Conversion of the tracker's axes to the operator's."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, strategies as st

from cardan.spatial import (
    dot,
    from_rotation_vector,
    norm,
    normalized,
    rotate,
    rotation_between,
    scale,
)
from cardan.types import IDENTITY, Quaternion, Vector3
from cardan_leap.protocol import (
    direction_and_normal,
    hand_orientation,
    pitch_yaw_roll,
    position_from_leap,
    position_to_leap,
    vector_from_leap,
    vector_to_leap,
)

FLAT = (Vector3(0.0, 0.0, -1.0), Vector3(0.0, -1.0, 0.0))
vectors = st.builds(Vector3, *[st.floats(-1000.0, 1000.0)] * 3)
quaternions = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda q: math.hypot(*q) > 0.1)
    .map(lambda q: normalized(Quaternion(*q)))
)


def test_axes():
    assert vector_from_leap(Vector3(0.0, 0.0, -1.0)) == (1.0, 0.0, 0.0)
    assert vector_from_leap(Vector3(-1.0, 0.0, 0.0)) == (0.0, 1.0, 0.0)
    assert vector_from_leap(Vector3(0.0, 1.0, 0.0)) == (0.0, 0.0, 1.0)


@pytest.mark.judged(device="Leap Motion", transport="WebSocket", by="worked bytes")
def test_the_minimal_frame_is_ahead_right_and_above():
    position = position_from_leap(Vector3(12.5, 210.0, -30.0))
    assert position == pytest.approx((0.03, -0.0125, 0.21))
    assert hand_orientation(*FLAT) == IDENTITY
    assert pitch_yaw_roll(*FLAT) == (0.0, 0.0, 0.0)


@pytest.mark.judged(device="Leap Motion", transport="WebSocket", by="worked bytes")
@pytest.mark.parametrize(
    ("direction", "normal"),
    [
        ((0.490721, 0.425143, -0.760557), (0.141838, -0.900216, -0.411695)),
        ((0.158462, 0.627121, -0.762633), (0.116439, -0.778872, -0.61628)),
        ((0.695266, 0.560133, -0.450396), (-0.219856, 0.762338, 0.608691)),
    ],
)
def test_recorded_hands_keep_both_vectors(direction, normal):
    orientation = hand_orientation(Vector3(*direction), Vector3(*normal))
    assert orientation is not None
    again = direction_and_normal(orientation)
    assert again[0] == pytest.approx(direction, abs=2e-6)
    assert again[1] == pytest.approx(normal, abs=2e-6)


@pytest.mark.parametrize(
    ("direction", "normal", "turn"),
    [
        ((0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (0.0, -math.pi / 2, 0.0)),  # fingers up
        ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -math.pi / 2)),  # fingers to the right
        ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (-math.pi / 2, 0.0, 0.0)),  # left edge down
    ],
)
def test_turns_are_right_handed_about_the_operators_axes(direction, normal, turn):
    orientation = hand_orientation(Vector3(*direction), Vector3(*normal))
    assert orientation is not None
    assert rotation_between(IDENTITY, orientation) == pytest.approx(turn, abs=1e-9)


def test_the_three_angles():
    c, s = math.cos(0.3), math.sin(0.3)
    assert pitch_yaw_roll(Vector3(0.0, s, -c), FLAT[1])[0] == pytest.approx(0.3)
    assert pitch_yaw_roll(Vector3(s, 0.0, -c), FLAT[1])[1] == pytest.approx(0.3)
    assert pitch_yaw_roll(FLAT[0], Vector3(s, -c, 0.0))[2] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("direction", "normal"),
    [
        ((0.0, 0.0, 0.0), (0.0, -1.0, 0.0)),
        ((0.0, 0.0, -1.0), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, -1.0), (0.0, 0.0, 1.0)),
        ((0.0, 0.0, -1.0), (0.0, 1e-5, -1.0)),
        ((0.0, 0.0, -100.0), (0.0, -1.0, 0.0)),
        ((math.nan, 0.0, -1.0), (0.0, -1.0, 0.0)),
    ],
)
def test_vectors_that_span_no_hand(direction, normal):
    assert hand_orientation(Vector3(*direction), Vector3(*normal)) is None


@given(vectors)
def test_positions_round_trip(v):
    assert position_to_leap(position_from_leap(v)) == pytest.approx(v)
    assert vector_to_leap(vector_from_leap(v)) == v


@given(quaternions, st.floats(0.5, 2.0), st.floats(-0.3, 0.3))
def test_orientations_round_trip(q, length, skew):
    direction, normal = direction_and_normal(q)
    # Neither unit length nor a right angle is needed; the direction counts.
    bent = Vector3(*(length * n + skew * d for n, d in zip(normal, direction, strict=True)))
    again = hand_orientation(scale(direction, length), bent)
    assert again is not None
    assert norm(rotation_between(q, again)) < 1e-6
    assert norm(Vector3(*again[1:])) <= 1.0 + 1e-15
    assert again.w >= 0.0


@given(quaternions)
def test_direction_and_normal_are_the_hands_forward_and_down(q):
    direction, normal = direction_and_normal(q)
    assert vector_from_leap(direction) == pytest.approx(rotate(q, Vector3(1, 0, 0)), abs=1e-9)
    assert vector_from_leap(normal) == pytest.approx(rotate(q, Vector3(0, 0, -1)), abs=1e-9)
    assert dot(direction, normal) == pytest.approx(0.0, abs=1e-9)


def test_half_turns():
    for axis in ((math.pi, 0, 0), (0, math.pi, 0), (0, 0, math.pi)):
        q = from_rotation_vector(Vector3(*axis))
        again = hand_orientation(*direction_and_normal(q))
        assert again is not None
        assert norm(rotation_between(q, again)) < 1e-6
