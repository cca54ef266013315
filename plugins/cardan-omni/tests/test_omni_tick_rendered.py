"""Forces rendered by the tick: fixtures, measured forces, torques."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from cardan.common.haptics import (
    Box,
    Cylinder,
    Fixture,
    MeasuredForce,
    Plane,
    Sphere,
    Spring,
    Viscous,
    WorldMap,
)
from cardan.types import ZERO3, Vector3
from cardan_omni.driver.native import kinematics
from omni_tick_bench import (
    BARE,
    BELOW,
    FLOOR,
    PERIOD_S,
    Bench,
    commanded,
    rotation,
    size,
)


@pytest.mark.parametrize(
    ("tcp", "force"),
    [
        ((0.3, 0.0, 0.45), (0.0, 0.0, 3.0)),
        ((0.385, 0.0, 0.4), (1.5, 0.0, 0.0)),
        ((0.3, -0.08, 0.4), (0.0, -2.0, 0.0)),
        ((0.3, 0.06, 0.34), (0.0, 1.071068, -1.071068)),
        ((0.41, 0.0, 0.4), (0.0, 0.0, 0.0)),
    ],
)
def test_papers_sphere(tcp: tuple[float, ...], force: tuple[float, ...]) -> None:
    sphere = Sphere(Vector3(0.3, 0.0, 0.4), 0.1, 100.0)
    assert commanded(sphere, Vector3(*tcp)) == pytest.approx(force, abs=1e-6)


@pytest.mark.parametrize(
    ("fixture", "at", "force"),
    [
        (Sphere(ZERO3, 0.05, 100.0, inside=True), (0.06, 0.0, 0.0), (-1.0, 0.0, 0.0)),
        (Sphere(ZERO3, 0.05, 100.0, inside=True), (0.04, 0.0, 0.0), (0.0, 0.0, 0.0)),
        (FLOOR, (0.0, 0.1, -0.002), (0.0, 0.0, 1.0)),
        (FLOOR, (0.0, 0.1, 0.002), (0.0, 0.0, 0.0)),
        (FLOOR._replace(cap_n=0.4), (0.0, 0.0, -0.01), (0.0, 0.0, 0.4)),
        (Box(ZERO3, Vector3(0.1, 0.1, 0.02), 100.0), (0.0, 0.05, -0.01), (0.0, 0.0, -1.0)),
        (Box(ZERO3, Vector3(0.1, 0.1, 0.02), 100.0), (0.0, 0.05, -0.03), (0.0, 0.0, 0.0)),
        (
            Box(ZERO3, Vector3(0.02, 0.02, 0.02), 100.0, inside=True),
            (0.03, 0.0, -0.025),
            (-1.0, 0.0, 0.5),
        ),
        (
            Box(ZERO3, Vector3(0.02, 0.1, 0.1), 100.0, rotation=rotation(0, 0, math.pi / 2)),
            (0.0, 0.015, 0.0),
            (0.0, 0.5, 0.0),
        ),
        (
            Cylinder(ZERO3, Vector3(0.0, 1.0, 0.0), 0.02, 100.0),
            (0.01, 0.3, 0.0),
            (1.0, 0.0, 0.0),
        ),
        (
            Cylinder(ZERO3, Vector3(0.0, 1.0, 0.0), 0.02, 100.0, inside=True),
            (0.0, 0.3, 0.03),
            (0.0, 0.0, -1.0),
        ),
        (Spring(Vector3(0.01, 0.0, 0.0), 100.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        (Spring(Vector3(0.3, 0.4, 0.0), 100.0, 2.0), (0.0, 0.0, 0.0), (1.2, 1.6, 0.0)),
        (Viscous(3.0), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0)),
    ],
)
def test_fixture(fixture: Fixture, at: tuple[float, ...], force: tuple[float, ...]) -> None:
    assert commanded(fixture, Vector3(*at)) == pytest.approx(force, abs=1e-9)


@pytest.mark.parametrize(
    "fixture",
    [
        Sphere(ZERO3, 0.05, 50.0),
        Cylinder(ZERO3, Vector3(0.0, 0.0, 1.0), 0.05, 50.0),
        Box(ZERO3, Vector3(0.05, 0.2, 0.2), 50.0),
    ],
)
def test_in_the_very_middle_a_fixture_pushes_where_it_pushed_before(fixture: Fixture) -> None:
    force = commanded(fixture, Vector3(-0.01, 0.0, 0.0), ZERO3)
    assert force == pytest.approx((-2.5, 0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    "fixture", [Sphere(ZERO3, 0.05, 50.0), Cylinder(ZERO3, Vector3(0.0, 0.0, 1.0), 0.05, 50.0)]
)
def test_in_the_very_middle_at_once_it_pushes_somewhere(fixture: Fixture) -> None:
    assert size(commanded(fixture, ZERO3)) == pytest.approx(2.5)


@pytest.mark.parametrize(
    ("fixture", "speed_m_s", "force_z"),
    [
        (FLOOR._replace(stiffness_n_m=100.0, damping_n_s_m=2.0), -0.1, 0.5 + 0.2),
        (FLOOR._replace(stiffness_n_m=100.0, damping_n_s_m=20.0), 0.1, 0.0),
        (Viscous(2.0), 0.1, -0.2),
        (Viscous(20.0, 1.0), 0.1, -1.0),
        (Spring(ZERO3, 0.0, 3.0, 2.0), 0.1, -0.2),
    ],
)
def test_damping_never_pulls_into_a_wall(
    fixture: Fixture, speed_m_s: float, force_z: float
) -> None:
    bench = Bench(**BARE)
    bench.send(fixtures=(fixture,))
    start = -0.005 - 0.2 * speed_m_s
    for k in range(201):
        bench.step(position=Vector3(0.0, 0.0, start + k * PERIOD_S * speed_m_s))
    assert bench.state.velocity.z == pytest.approx(speed_m_s)
    assert bench.state.force_commanded.z == pytest.approx(force_z)


def test_the_world_map_moves_the_point_and_turns_the_force_back() -> None:
    turn = rotation(0.3, -0.4, 1.1)
    r = np.array(turn).reshape(3, 3)
    offset, scale = np.array([0.3, -0.2, 0.4]), 2.0
    normal = np.array([0.36, 0.48, 0.8])
    hand = np.array([0.01, 0.02, -0.03])
    point = scale * r @ hand + offset
    wall = Plane(Vector3(*(point + 0.01 * normal)), Vector3(*normal), 100.0)
    world = WorldMap(tuple(scale * r.flatten()), Vector3(*offset), turn)  # type: ignore[arg-type]
    assert commanded(wall, Vector3(*hand), world=world) == pytest.approx(r.T @ normal, abs=1e-9)


def test_forces_of_all_sources_are_added_and_only_fixtures_are_scaled() -> None:
    bench = Bench(**BARE)
    bench.send(
        fixtures=(FLOOR, FLOOR),
        force_scale=0.5,
        force=Vector3(0.1, 0.0, 0.0),
        measured=MeasuredForce(Vector3(0.0, 0.3, 0.0), bench.now_s),
    )
    bench.step(position=Vector3(0.0, 0.0, -0.001))
    assert bench.state.force_commanded == pytest.approx((0.1, 0.3, 0.5))


def test_the_edge_of_the_workspace_is_a_spring_and_fixtures_fade_beyond_it() -> None:
    bench = Bench(**{**BARE, "workspace_upper_m": (0.05, 1.0, 1.0)})
    bench.send(fixtures=(FLOOR,))
    bench.step(position=Vector3(0.055, 0.0, -0.002))
    assert bench.state.force_commanded == pytest.approx((-1.0, 0.0, 0.75))
    bench.step(position=Vector3(0.1, 0.0, -0.002))
    assert bench.state.force_commanded == pytest.approx((-10.0, 0.0, 0.0))


def test_a_measured_force_goes_on_for_a_bounded_time() -> None:
    bench = Bench(**BARE, extrapolate_s=0.0085, measured_hold_s=0.0495)
    bench.step()
    measured = MeasuredForce(
        Vector3(0.5, 0.0, 0.0), bench.now_s, Vector3(0.0, 10.0, 0.0), ZERO3, 100.0
    )
    bench.send(measured=measured)
    for k in range(1, 50):
        bench.step(position=Vector3(0.0, 0.0, 1e-4 * k))
        state = bench.state
        held = min(k, 8)
        assert state.force_age_s == pytest.approx(k * PERIOD_S)
        assert state.force_commanded == pytest.approx(
            (0.5, 10.0 * held * PERIOD_S, -100.0 * 1e-4 * held)
        ), k
    bench.step()
    assert bench.state.force_commanded == ZERO3, "too old a force is not rendered"


def test_a_measured_force_is_never_above_the_clamp() -> None:
    bench = Bench(**BARE)
    bench.step()
    bench.send(measured=MeasuredForce(Vector3(30.0, 40.0, 0.0), bench.now_s, Vector3(1e4, 0, 0)))
    bench.step()
    assert size(bench.state.force_commanded) == pytest.approx(2.0)


def test_raw_joint_torques_and_nothing_else() -> None:
    bench = Bench(**BARE, engage_ramp_s=0.0)
    joints = Vector3(0.2, 0.742, 0.5531)
    bench.step(position=BELOW, joints_rad=joints)
    bench.engage(fixtures=(FLOOR,), joint_torques_n_m=ZERO3)
    bench.send(joint_torques_n_m=Vector3(0.05, -0.02, 0.03))
    force = bench.run(0.1)
    jacobian = np.array(kinematics(joints)[1]).reshape(3, 3)
    assert jacobian.T @ force == pytest.approx([0.05, -0.02, 0.03], abs=1e-9)
    assert bench.state.reason == ""
    assert bench.tick.details().torques_n_m == pytest.approx((0.05, -0.02, 0.03), abs=1e-9)


@pytest.mark.parametrize("raw", [True, False])
def test_torques_are_limited_as_a_whole_vector(raw: bool) -> None:
    bench = Bench(**BARE, engage_ramp_s=0.0, clamp_n=3.3, slew_fall_n_s=660.0)
    bench.step(joints_rad=Vector3(0.0, 0.742, 0.5531), joint_torque=not raw)
    bench.engage(joint_torques_n_m=ZERO3 if raw else None)
    if raw:
        bench.send(joint_torques_n_m=Vector3(0.7, 0.35, 0.0))
    else:
        bench.send(force=Vector3(0.0, 3.0, 0.0))
    bench.run(0.1)
    assert bench.state.reason == "limited to the largest force"
    torques = bench.tick.details().torques_n_m
    assert abs(torques.x) <= 0.35 + 1e-12
    assert abs(torques.x) == pytest.approx(0.35)
    if raw:
        assert torques.y == pytest.approx(0.175)


def test_kinematics() -> None:
    position, _ = kinematics(ZERO3)
    assert position == pytest.approx((0.035, 0.0, -0.11), abs=1e-9)
    position, _ = kinematics(Vector3(0.0, 0.7420, 0.5531))
    assert position == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)
    position, _ = kinematics(Vector3(0.0, 0.2689, -0.3708))
    assert position == pytest.approx((0.0881142, 0.0, -0.0655107), abs=1e-4)


L1 = L2 = 0.13335
L3, L4 = 0.02335, 0.16835
"""Lengths of an Omni's upper and lower arm, and its shoulder's position, m."""


def inverse(position: Vector3) -> tuple[float, float, float]:
    """Return the joints for a position, elbow up: in closed form, from the lengths."""
    x, y, z = -position.y, position.z, -position.x  # The device frame.
    r, h = math.hypot(x, z + L4), y - L3
    bend = -math.acos((r * r + h * h - L1 * L1 - L2 * L2) / (2.0 * L1 * L2))
    thigh = math.atan2(h, r) - math.atan2(L2 * math.sin(bend), L1 + L2 * math.cos(bend))
    return math.atan2(-x, z + L4), thigh, thigh + bend + 0.5 * math.pi


JOINTS = st.tuples(st.floats(-0.9, 0.9), st.floats(0.0, 1.7), st.floats(-0.8, 1.2))


@given(JOINTS)
def test_the_kinematics_and_their_inverse_are_the_same_to_13_digits(
    joints: tuple[float, float, float],
) -> None:
    _, thigh, shin = joints
    # Elbow up, and away from the singularities: the turret's axis and the stretched arm.
    assume(0.1 < thigh - shin + 0.5 * math.pi < math.pi - 0.1)
    assume(L1 * math.cos(thigh) + L2 * math.sin(shin) > 0.02)
    position, _ = kinematics(Vector3(*joints))
    back = inverse(position)
    assert back == pytest.approx(joints, rel=0, abs=1e-13)
    assert kinematics(Vector3(*back))[0] == pytest.approx(position, rel=0, abs=1e-13)


@given(JOINTS)
def test_the_jacobians_determinant(joints: tuple[float, float, float]) -> None:
    _, thigh, shin = joints
    r = L1 * math.cos(thigh) + L2 * math.sin(shin)
    jacobian = np.array(kinematics(Vector3(*joints))[1]).reshape(3, 3)
    expected = -r * L1 * L2 * math.cos(thigh - shin)
    assert abs(np.linalg.det(jacobian)) == pytest.approx(abs(expected), rel=1e-9, abs=1e-16)


def test_the_jacobians_determinant_in_the_middle() -> None:
    joints = inverse(ZERO3)
    assert joints == pytest.approx((0.0, 0.7420, 0.5531), abs=1e-4)
    jacobian = np.array(kinematics(Vector3(*joints))[1]).reshape(3, 3)
    assert abs(np.linalg.det(jacobian)) == pytest.approx(2.94e-3, abs=5e-6)


@pytest.mark.parametrize(
    ("along", "torque_n_m"),
    [((0.0, 1.0, 0.0), 0.556), ((0.0, 0.0, 1.0), 0.324), ((1.0, 0.0, 0.0), 0.374)],
)
def test_the_torques_of_the_largest_force_in_the_middle(
    along: tuple[float, ...], torque_n_m: float
) -> None:
    jacobian = np.array(kinematics(Vector3(*inverse(ZERO3)))[1]).reshape(3, 3)
    assert np.abs(jacobian.T @ (3.3 * np.array(along))).max() == pytest.approx(torque_n_m, abs=1e-3)


def test_350_millinewton_meters_are_two_newtons_sideways_in_the_middle() -> None:
    bench = Bench(**BARE, engage_ramp_s=0.0, clamp_n=3.3, slew_fall_n_s=660.0)
    bench.step(joints_rad=Vector3(*inverse(ZERO3)), joint_torque=True)
    bench.engage()
    bench.send(force=Vector3(0.0, 3.0, 0.0))
    assert size(bench.run(0.1)) == pytest.approx(2.08, abs=0.01)
    bench.send(force=Vector3(0.0, 0.0, 2.5))
    assert bench.run(0.2).z == pytest.approx(2.5), "not along every axis"


@given(JOINTS)
def test_the_jacobian_is_the_derivative_of_the_position(joints: tuple[float, ...]) -> None:
    _, jacobian = kinematics(Vector3(*joints))
    for column in range(3):
        moved = [list(joints), list(joints)]
        moved[0][column] -= 1e-6
        moved[1][column] += 1e-6
        low, high = (kinematics(Vector3(*m))[0] for m in moved)
        for row in range(3):
            assert jacobian[3 * row + column] == pytest.approx(
                (high[row] - low[row]) / 2e-6, abs=1e-8
            )
