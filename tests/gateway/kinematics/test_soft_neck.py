"""TEO's soft neck: comparison with its published table, and forward against inverse kinematics."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from cardan.errors import ConfigurationError
from cardan.gateway.kinematics.base import Kinematics
from cardan.gateway.kinematics.soft_neck import SoftNeck, _arc, load_soft_neck
from cardan.robots import arm_names

NECK = SoftNeck()
inclinations = st.floats(0.0, NECK.inclination_limit_rad * 0.999)
azimuths = st.floats(-math.pi, math.pi)
co_contractions = st.floats(-0.01, 0.01)


def plain_model(inclination_rad, orientation_rad):
    """The model in the form of its reference, by rotation matrices."""
    theta, phi = max(inclination_rad, 1e-9), orientation_rad - math.radians(30)
    rz, ry = lambda a: pin.rpy.rpyToMatrix(0, 0, a), lambda a: pin.rpy.rpyToMatrix(0, a, 0)
    rotation = rz(phi) @ ry(theta) @ rz(-phi)
    bend = 1.0 - math.cos(theta)
    center = (0.1085 / theta) * np.array(
        (bend * math.cos(phi), bend * math.sin(phi), math.sin(theta))
    )
    q = []
    for degrees in (330, 90, 210):
        angle = math.radians(degrees)
        anchor = 0.052 * np.array((math.cos(angle), math.sin(angle), 0.0))
        q.append(0.1085 + 0.003 - np.linalg.norm(center + rotation @ anchor - anchor))
    turn = rz(math.radians(30))
    return np.array(q), turn @ rotation @ turn.T, turn @ center


# Inclination and orientation in deg, tendons in mm, platform in mm in the frame turned by -30 deg.
TABLE = [
    (0, 0, (3.001, 3.000, 3.000), (0.00, 0.00, 108.50)),
    (20, 10, (21.335, -2.627, -8.058), (17.61, -6.41, 106.31)),
    (30, 120, (-9.223, 31.152, -9.223), (0.00, 27.76, 103.61)),
    (40, -90, (5.190, -25.615, 35.995), (-18.18, -31.49, 99.90)),
]


@pytest.mark.parametrize(("inclination", "orientation", "tendons_mm", "position_mm"), TABLE)
def test_worked_table(inclination, orientation, tendons_mm, position_mm):
    q = NECK.tendons(math.radians(inclination), math.radians(orientation))
    # The reference uses 0.001 deg instead of zero, as in the first row.
    assert 1e3 * q == pytest.approx(tendons_mm, abs=1.5e-3 if inclination == 0 else 6e-4)
    turned = pin.rpy.rpyToMatrix(0, 0, math.radians(-30)) @ NECK.forward(q).translation
    assert 1e3 * turned == pytest.approx(position_mm, abs=6e-3)


@pytest.mark.parametrize("t2", [9.9e-4, 5e-4])
def test_the_series_of_small_leans_are_those_of_their_functions(t2):
    def series(first, slope=False):
        powers = [2 * k * t2 ** (k - 1) if slope else t2**k for k in range(8)]
        return sum(
            (-1) ** k * each / math.factorial(2 * k + first) for k, each in enumerate(powers)
        )

    exact = series(1), series(2), series(1, slope=True), series(2, slope=True), series(3)
    assert _arc(t2) == pytest.approx(exact, rel=0.0, abs=1e-13)


@given(inclinations, azimuths)
def test_model_is_the_reference_s(inclination, orientation):
    q, rotation, center = plain_model(inclination, orientation)
    assert NECK.tendons(inclination, orientation) == pytest.approx(q, abs=1e-9)
    platform = NECK.forward(NECK.tendons(inclination, orientation))
    np.testing.assert_allclose(platform.rotation, rotation, atol=1e-8)
    np.testing.assert_allclose(platform.translation, center, atol=1e-9)


@given(inclinations, azimuths, co_contractions)
def test_tendons_and_shape_undo_each_other(inclination, orientation, co_contraction):
    shape = NECK.shape(NECK.tendons(inclination, orientation, co_contraction))
    assert shape.inclination_rad == pytest.approx(inclination, abs=1e-9)
    assert shape.co_contraction_m == pytest.approx(co_contraction, abs=1e-12)
    if inclination > 1e-6:
        turned = shape.orientation_rad - orientation
        assert inclination * math.sin(turned) == pytest.approx(0.0, abs=1e-9)
        assert math.cos(turned) > 0.0


@given(st.floats(0.0, 1e-3) | inclinations, azimuths, co_contractions)
def test_jacobian_is_the_derivative(inclination, orientation, co_contraction):
    neck = SoftNeck()
    q = neck.tendons(inclination, orientation, co_contraction)
    neck.update(q)
    here, step = neck.placement.copy(), 1e-6
    for tendon in range(3):
        ahead, behind = q.copy(), q.copy()
        ahead[tendon] += step
        behind[tendon] -= step
        if max(neck.shape(ahead)[0], neck.shape(behind)[0]) > 0.99 * neck.inclination_limit_rad:
            return
        moved = pin.log6(here.actInv(neck.forward(ahead))).vector
        moved = moved - pin.log6(here.actInv(neck.forward(behind))).vector
        np.testing.assert_allclose(neck.jacobian[:, tendon], moved / (2 * step), atol=1e-5)


def test_straight_up_is_regular_and_co_contraction_moves_nothing():
    neck = SoftNeck()
    neck.update(neck.tendons(0.0, 1.0, 0.002))
    np.testing.assert_allclose(neck.placement.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(neck.placement.translation, (0.0, 0.0, 0.1085), atol=1e-12)
    assert np.linalg.matrix_rank(neck.jacobian, tol=1e-9) == 2
    np.testing.assert_allclose(neck.jacobian @ np.ones(3), np.zeros(6), atol=1e-9)


@given(inclinations, azimuths, co_contractions)
def test_no_combination_of_tendons_turns_about_z_of_a_straight_neck(inclination, orientation, c):
    neck = SoftNeck()
    neck.update(neck.tendons(inclination, orientation, c))
    rotation = neck.placement.rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert pin.log3(rotation)[2] == pytest.approx(0.0, abs=1e-9)


@given(st.tuples(*[st.floats(-0.1, 0.1)] * 3))
def test_any_tendons_give_a_shape_inside_the_model(q):
    neck = SoftNeck()
    neck.update(np.array(q))
    assert np.isfinite(neck.jacobian).all()
    shape = neck.shape(np.array(q))
    assert shape.inclination_rad <= neck.inclination_limit_rad * (1.0 + 1e-12)
    again = neck.inverse(neck.placement, np.array(q))
    if again is not None:
        assert neck.shape(again).inclination_rad == pytest.approx(shape.inclination_rad, abs=1e-6)


@given(st.floats(0.0, 1.0), azimuths, co_contractions)
def test_inverse_keeps_the_co_contraction(inclination, orientation, co_contraction):
    q = NECK.tendons(inclination, orientation, co_contraction)
    near = NECK.tendons(0.5, 0.0, co_contraction)
    np.testing.assert_allclose(NECK.inverse(NECK.forward(q), near), q, atol=1e-9)


def test_inverse_relaxes_where_the_travel_ends():
    q = NECK.tendons(0.7, 0.3, 0.0)
    found = NECK.inverse(NECK.forward(q), NECK.tendons(0.0, 0.0, 0.09))
    assert (found <= NECK.upper).all()
    assert found.max() == pytest.approx(0.1)
    assert NECK.shape(found)[:2] == pytest.approx((0.7, 0.3))


@pytest.mark.parametrize("vector", [(0.0, 0.0, 1e-3), (0.2, 0.1, -0.01), (2.5, 0.0, 0.0)])
def test_inverse_refuses_what_a_neck_cannot_do(vector):
    target = pin.SE3(pin.exp3(np.array(vector)), np.zeros(3))
    assert NECK.inverse(target, np.zeros(3)) is None


def test_inverse_refuses_what_the_tendons_cannot_reach():
    data = load_soft_neck()
    neck = SoftNeck(replace(data, limits=replace(data.limits, travel_m=0.01)))
    target = pin.SE3(pin.exp3(np.array((0.0, 0.7, 0.0))), np.zeros(3))
    assert neck.inverse(target, np.zeros(3)) is None
    assert NECK.inverse(target, np.zeros(3)) is not None


def test_different_anchor_circles():
    neck = SoftNeck(replace(load_soft_neck(), platform_anchor_radius_m=0.04))
    q = neck.tendons(0.6, 2.0, 0.001)
    assert neck.shape(q) == pytest.approx((0.6, 2.0, 0.001))
    rotation = neck.forward(q).rotation
    center = neck.forward(q).translation
    for k, angle in enumerate(np.radians((0.0, 120.0, 240.0))):
        direction = np.array((math.cos(angle), math.sin(angle), 0.0))
        length = np.linalg.norm(center + rotation @ (0.04 * direction) - 0.052 * direction)
        assert q[k] == pytest.approx(0.1085 + 0.003 - length + 0.001)


def test_it_is_what_the_servo_takes():
    neck: Kinematics = SoftNeck()
    assert (neck.joints, neck.names) == (3, ("q1", "q2", "q3"))
    assert neck.upper.tolist() == [0.1] * 3
    assert neck.lower.tolist() == [-0.1] * 3
    assert neck.velocity.tolist() == [0.03] * 3
    assert neck.acceleration.tolist() == pytest.approx([0.15] * 3)
    assert not neck.continuous.any()
    assert "teo_soft_neck" not in arm_names()


@pytest.mark.parametrize("inclination", [-0.1, 3.0, math.nan])
def test_impossible_inclinations_are_named(inclination):
    with pytest.raises(ValueError, match=r"inclination .* is outside 0 to 1\.56"):
        NECK.tendons(inclination, 0.0)


OWN = """
base_anchor_radius_m = 0.052
platform_anchor_radius_m = 0.052
link_length_m = {length}
tendon_offset_m = 0.003
winch_radius_m = 0.0075
tendon = [
  {{ name = "a", azimuth_deg = 0.0 }},
  {{ name = "b", azimuth_deg = {second} }},
  {{ name = "c", azimuth_deg = 240.0 }},
]
[limits]
travel_m = 0.1
speed_m_s = 0.03
reference_speed_m_s = 0.01
reference_acceleration_m_s2 = 0.01
"""


def test_a_neck_of_one_s_own(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(OWN.format(length=0.2, second=120.0))
    neck = SoftNeck(load_soft_neck(str(path)))
    assert neck.names == ("a", "b", "c")
    assert neck.placement.translation[2] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            OWN.format(length=-1.0, second=120.0),
            "mine.toml:4:1: link_length_m: -1.0 .*above 0, at most 100 m",
        ),
        (OWN.format(length="nan", second=120.0), "link_length_m: nan .*above 0"),
        (OWN.format(length=0.2, second=0.5), "spread around the circle"),
        (OWN.format(length=0.2, second=120.0).replace('"b"', '"a"'), "tendon: .* that differ"),
        ("a = ", "mine.toml:1:5: is not TOML"),
        ("", "mine.toml: base_anchor_radius_m: is missing"),
    ],
)
def test_errors_say_what_is_wrong(tmp_path, text, words):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=words):
        load_soft_neck(str(path))


def test_a_neck_that_is_not_there():
    with pytest.raises(ConfigurationError, match=r"cannot read .*no_neck\.toml: No such file"):
        load_soft_neck("no_neck")


def test_relaxing_takes_the_co_contraction_away_and_nothing_else():
    neck = SoftNeck()
    tight = neck.tendons(0.4, 1.0, 0.004)
    assert neck.relaxed(tight) == pytest.approx(neck.tendons(0.4, 1.0), abs=1e-9)
