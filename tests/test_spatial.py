"""Rotations, compared with worked values and with each other."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan import spatial
from cardan.types import IDENTITY, Quaternion, Vector3

angles = st.floats(-math.pi, math.pi)
components = st.floats(-10.0, 10.0)
vectors = st.builds(Vector3, components, components, components)
quaternions = st.builds(spatial.from_rotation_vector, vectors)


def same_rotation(a: Quaternion, b: Quaternion) -> bool:
    return spatial.norm(spatial.rotation_between(a, b)) < 1e-7


def test_euler_worked_example():
    q = spatial.from_euler_zyx(*map(math.radians, (10, 20, 30)))
    assert q == pytest.approx((0.95154852, 0.03813458, 0.18930786, 0.23929834), abs=1e-8)


@pytest.mark.parametrize(
    ("euler_deg", "expected"),
    [
        ((0, 90, 0), (0.70710678, 0, 0.70710678, 0)),
        ((180, 60, 180), (0.5, 0, 0.8660254, 0)),
        ((118.700811, -13.841726, 126.359980), (0.13582068, 0.44015072, 0.73444697, 0.49840519)),
    ],
)
def test_euler_of_gofa_poses(euler_deg, expected):
    q = spatial.from_euler_zyx(*map(math.radians, euler_deg))
    assert same_rotation(q, Quaternion(*expected))


@given(quaternions)
def test_euler_round_trip(q):
    assert same_rotation(spatial.from_euler_zyx(*spatial.to_euler_zyx(q)), q)


@given(vectors)
def test_logarithm_undoes_exponential(v):
    q = spatial.from_rotation_vector(v)
    back = spatial.to_rotation_vector(q)
    assert spatial.norm(back) <= math.pi + 1e-12
    assert same_rotation(spatial.from_rotation_vector(back), q)


def test_tiny_rotations_keep_their_size():
    v = Vector3(1e-12, -2e-12, 3e-12)
    assert spatial.to_rotation_vector(spatial.from_rotation_vector(v)) == pytest.approx(v, rel=1e-9)


@given(quaternions, quaternions, vectors)
def test_product_rotates_in_turn(a, b, v):
    once = spatial.rotate(a, spatial.rotate(b, v))
    assert spatial.rotate(spatial.multiply(a, b), v) == pytest.approx(once, abs=1e-9)
    assert spatial.norm(once) == pytest.approx(spatial.norm(v), abs=1e-9)


@given(quaternions, quaternions)
def test_rotation_between_is_in_the_outer_frame(a, b):
    turn = spatial.rotation_between(a, b)
    assert same_rotation(spatial.multiply(spatial.from_rotation_vector(turn), a), b)


@given(quaternions, quaternions)
def test_hemisphere_keeps_the_rotation(q, reference):
    flipped = spatial.same_hemisphere(q, reference)
    assert sum(x * y for x, y in zip(flipped, reference, strict=True)) >= 0
    assert same_rotation(flipped, q)


@pytest.mark.parametrize("bad", [(0, 0, 0, 0), (math.nan, 0, 0, 1), (math.inf, 0, 0, 0)])
def test_nothing_to_normalize(bad):
    with pytest.raises(ValueError, match="no direction"):
        spatial.normalized(Quaternion(*bad))


@pytest.mark.parametrize("length", [0.0, 1e-9, 0.3, 3.0])
def test_an_orientation_turned_by_a_vector_is_the_product(length):
    by = spatial.scale(Vector3(0.36, -0.48, 0.8), length)
    q = spatial.normalized(Quaternion(0.3, -0.5, 0.7, 0.4))
    expected = spatial.multiply(spatial.from_rotation_vector(by), q)
    assert spatial.turned_by(q, by) == pytest.approx(expected, abs=1e-15)


def test_limit_norm_keeps_direction():
    assert spatial.limit_norm(Vector3(3, 4, 0), 1.0) == pytest.approx((0.6, 0.8, 0))
    assert spatial.limit_norm(Vector3(0.3, 0.4, 0), 1.0) == (0.3, 0.4, 0)


def test_conjugate_is_the_inverse():
    q = spatial.from_rotation_vector(Vector3(0.3, -0.2, 0.5))
    assert spatial.multiply(q, spatial.conjugate(q)) == pytest.approx(IDENTITY)
