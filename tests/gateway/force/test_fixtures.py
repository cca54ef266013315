"""Fixtures: configuration, placement and evaluation."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.common.haptics import Box, Cylinder, Plane, Sphere, Spring, Viscous, WorldMap
from cardan.gateway.force.fixtures import (
    FixtureSet,
    fixture_force,
    matrix_of,
    turned,
    turned_back,
    world_point,
)
from cardan.gateway.force.tables import (
    BoxTable,
    CylinderTable,
    PlaneTable,
    SphereTable,
    SpringTable,
    ViscousTable,
)
from cardan.spatial import from_euler_zyx, norm, rotate, subtract
from cardan.types import ZERO3, Vector3

SPHERE = SphereTable(center_m=(0.3, 0.0, 0.4), radius_m=0.1, stiffness_n_m=100.0)
SURFACE = PlaneTable(at="start", normal=(0.0, 0.0, 2.0), stiffness_n_m=200.0)
places = st.builds(Vector3, *(st.floats(-0.5, 0.5) for _ in range(3)))


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
def test_the_papers_sphere(tcp, force):
    assert fixture_force(SPHERE.made(), Vector3(*tcp)) == pytest.approx(force, abs=1e-6)


def test_the_middle_of_a_sphere_has_a_way_out_too():
    force = fixture_force(SPHERE.made(), Vector3(0.3, 0.0, 0.4))
    assert norm(force) == pytest.approx(3.0)


def test_a_surface_grows_with_motion_beyond_the_start():
    fixtures = FixtureSet([SPHERE, SURFACE])
    assert fixtures.fixtures == (SPHERE.made(),)
    fixtures.place("clutch-in", Vector3(9.0, 9.0, 9.0))
    assert len(fixtures.fixtures) == 1
    fixtures.place("start", Vector3(0.5, 0.1, 0.3))
    plane = fixtures.fixtures[1]
    assert plane == Plane(Vector3(0.5, 0.1, 0.3), Vector3(0.0, 0.0, 1.0), 200.0)
    assert fixture_force(plane, Vector3(0.7, 0.0, 0.3)) == ZERO3
    assert fixture_force(plane, Vector3(0.7, 0.0, 0.295)) == pytest.approx((0.0, 0.0, 1.0))
    assert fixture_force(plane, Vector3(0.7, 0.0, 0.2)) == pytest.approx((0.0, 0.0, 3.0))


def test_what_is_placed_at_clutch_in_moves_with_every_clutch_in():
    fixtures = FixtureSet([SpringTable(at="clutch-in", stiffness_n_m=50.0)])
    for place in (Vector3(0.1, 0.0, 0.0), Vector3(0.2, 0.0, 0.0)):
        fixtures.place("clutch-in", place)
        assert fixtures.fixtures == (Spring(place, 50.0),)


def test_every_shape_is_made_with_units_and_axes_of_the_world():
    box = (
        BoxTable(
            center_m=(0.1, 0.2, 0.3),
            half_sides_m=(0.1, 0.2, 0.3),
            rpy_deg=(0.0, 0.0, 90.0),
            stiffness_n_m=100.0,
            cap_n=1.0,
        )
    ).made()
    assert isinstance(box, Box)
    assert turned(box.rotation, Vector3(1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0))
    assert box.cap_n == 1.0
    cylinder = (
        CylinderTable(
            point_m=(0.0, 0.0, 0.0),
            axis=(0.0, 3.0, 4.0),
            radius_m=0.05,
            stiffness_n_m=100.0,
            inside=True,
        )
    ).made()
    assert isinstance(cylinder, Cylinder)
    assert cylinder.axis == pytest.approx((0.0, 0.6, 0.8))
    assert cylinder.inside
    assert ViscousTable(damping_n_s_m=2.0).made() == Viscous(2.0)


def test_a_box_pushes_out_through_its_nearest_side_and_a_hollow_one_holds_each_axis():
    turn = matrix_of(from_euler_zyx(0.0, 0.0, math.pi / 2))
    solid = Box(ZERO3, Vector3(0.1, 0.2, 0.3), 100.0, 9.0, rotation=turn)
    # the box's x face points along the world's y
    assert fixture_force(solid, Vector3(0.0, 0.09, 0.0)) == pytest.approx((0.0, 1.0, 0.0))
    hollow = solid._replace(inside=True)
    assert fixture_force(hollow, Vector3(-0.22, 0.11, 0.0)) == pytest.approx((2.0, -1.0, 0.0))
    assert fixture_force(hollow, Vector3(0.0, 0.05, 0.1)) == ZERO3


def test_damping_never_pulls_and_never_pushes_beyond_the_cap():
    wall = Plane(ZERO3, Vector3(0.0, 0.0, 1.0), 100.0, 3.0, 10.0)
    inside = Vector3(0.0, 0.0, -0.01)
    assert fixture_force(wall, inside, Vector3(0.0, 0.0, 5.0)) == ZERO3
    assert fixture_force(wall, inside, Vector3(0.0, 0.0, -5.0)).z == 3.0
    drag = fixture_force(Viscous(2.0), ZERO3, Vector3(1.0, 0.0, 0.0))
    assert drag == pytest.approx((-2.0, 0.0, 0.0))


@given(places, places)
def test_no_fixture_is_stronger_than_its_cap_and_solid_ones_push_outwards(place, velocity):
    sphere = Sphere(ZERO3, 0.3, 200.0, 2.0, 1.0)
    force = fixture_force(sphere, place, velocity)
    assert norm(force) <= 2.0 + 1e-9
    assert sum(f * p for f, p in zip(force, place, strict=True)) >= -1e-6
    for inside in (False, True):
        box = Box(ZERO3, Vector3(0.2, 0.1, 0.3), 200.0, 2.0, 1.0, inside)
        assert norm(fixture_force(box, place, velocity)) <= 2.0 + 1e-9


@given(places, st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
def test_matrices_turn_as_quaternions_do(v, roll, pitch, yaw):
    q = from_euler_zyx(roll, pitch, yaw)
    there = turned(matrix_of(q), v)
    assert norm(subtract(there, rotate(q, v))) < 1e-12
    assert norm(subtract(turned_back(matrix_of(q), there), v)) < 1e-12
    assert world_point(WorldMap(matrix_of(q), v), ZERO3) == pytest.approx(v)
