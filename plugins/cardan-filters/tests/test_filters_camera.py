"""Camera-directed motion in virtual time."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.spatial import (
    add,
    conjugate,
    dot,
    from_euler_zyx,
    from_rotation_vector,
    norm,
    rotate,
    scale,
)
from cardan.types import IDENTITY, ZERO3, ZERO_TWIST, Frame, Twist, Vector3
from cardan_filters.camera import CameraFilter, CameraOptions
from cardan_filters.listener import Sender
from filter_states import robot_at

TURNED = from_rotation_vector(Vector3(0.0, math.pi / 2, 0.0))


def camera(target=b"0.4 -0.3", at_s=10.0, **options):
    made = CameraFilter(CameraOptions(**options))
    if target:
        made.listener.take(target, at_s)
    return made


def close(twist, linear, angular, frame=Frame.BASE):
    assert twist.frame is frame
    assert twist.linear == pytest.approx(linear, abs=1e-12)
    assert twist.angular == pytest.approx(angular, abs=1e-12)


def test_published_check_value():
    asked = Twist(Vector3(0.02, 0.01, -0.005), Vector3(0.3, 0.2, 0.1))
    made = camera()
    close(made.apply(asked, robot_at(10.1, TURNED)), (0.02, 0, 0), (0, 0.04, -0.03))
    assert made.status() == "the camera gives the direction"


@pytest.mark.parametrize("linear", [(-0.02, 0.01, 0), (0, 0.1, 0.1), (0, 0, 0)])
def test_without_an_advance_nothing_changes(linear):
    asked = Twist(Vector3(*linear), Vector3(0.3, 0.2, 0.1))
    made = camera()
    assert made.apply(asked, robot_at(10.1, TURNED)) is asked
    assert made.status() == ""


def test_a_target_that_was_lost_leaves_the_motion_to_the_operator():
    asked = Twist(Vector3(0.02, 0.0, 0.0), ZERO3)
    made = camera(permanence_s=0.5)
    assert made.apply(asked, robot_at(10.5, TURNED)) is not asked
    assert made.apply(asked, robot_at(10.6, TURNED)) is asked
    assert made.status() == ""
    assert camera(target=b"").apply(asked, robot_at(10.0, TURNED)) is asked
    assert camera().apply(asked, robot_at(math.nan, TURNED)) is asked


def test_malformed_targets_change_nothing():
    made = camera()
    made.listener.take(b"2 2", 10.4)
    asked = Twist(Vector3(0.02, 0.0, 0.0), ZERO3)
    close(made.apply(asked, robot_at(10.1, TURNED)), (0.02, 0, 0), (0, 0.04, -0.03))
    assert made.apply(asked, robot_at(10.7, TURNED)) is asked
    assert "2 is outside" in made.diagnosis()[0]


def test_closing_forgets():
    made = camera()
    made.close()
    asked = Twist(Vector3(0.02, 0.0, 0.0), ZERO3)
    assert made.apply(asked, robot_at(10.1, TURNED)) is asked


def test_without_a_pose_only_tool_axes_can_be_directed():
    forward = Vector3(0.0, 0.0, 0.05)
    base, tool = Twist(forward, ZERO3), Twist(forward, ZERO3, Frame.TOOL)
    assert camera().apply(base, robot_at(10.1, pose=False)) is base
    close(camera().apply(tool, robot_at(10.1, pose=False)), forward, (0.03, 0.04, 0.0), Frame.TOOL)


numbers = st.floats(-1, 1)
vectors = st.builds(Vector3, numbers, numbers, numbers)
angles = st.tuples(*[st.floats(-180, 180)] * 3)


@given(vectors, vectors, vectors, angles, numbers, numbers)
def test_base_and_tool_axes_say_the_same(linear, angular, turn, rpy_deg, x, y):
    orientation = from_rotation_vector(turn)
    target = f"{x:.6f} {y:.6f}".encode()
    robot = robot_at(10.1, orientation)
    tool = camera(target, camera_rpy_deg=rpy_deg).apply(Twist(linear, angular, Frame.TOOL), robot)
    base = camera(target, camera_rpy_deg=rpy_deg).apply(
        Twist(rotate(orientation, linear), rotate(orientation, angular)), robot
    )
    axis = rotate(from_euler_zyx(*map(math.radians, rpy_deg)), Vector3(0.0, 0.0, 1.0))
    if abs(dot(linear, axis)) > 1e-8:
        assert rotate(conjugate(orientation), base.linear) == pytest.approx(tool.linear, abs=1e-9)
        assert rotate(conjugate(orientation), base.angular) == pytest.approx(tool.angular, abs=1e-9)


@given(vectors, numbers, numbers)
def test_an_advance_is_never_faster_and_turns_no_more_than_its_gain(linear, x, y):
    made = camera(f"{x:.6f} {y:.6f}".encode(), gain_rad_s=0.2)
    asked = Twist(linear, ZERO3, Frame.TOOL)
    got = made.apply(asked, robot_at(10.1))
    assert norm(got.linear) <= norm(linear) + 1e-12
    assert norm(got.angular) <= 0.2 * math.sqrt(2) + 1e-9


@given(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9), angles)
def test_turning_brings_the_target_to_the_middle(x, y, rpy_deg):
    """A distant target moves in the image opposite to the camera's turn, for any mounting."""
    made = camera(f"{x:.6f} {y:.6f}".encode(), camera_rpy_deg=rpy_deg)
    mounted = from_euler_zyx(*map(math.radians, rpy_deg))
    axis = rotate(mounted, Vector3(0.0, 0.0, 1.0))
    turn = made.apply(Twist(scale(axis, 0.1), ZERO3, Frame.TOOL), robot_at(10.1)).angular
    sight = rotate(mounted, Vector3(x, y, 1.0))
    turned = add(axis, Vector3(*cross(turn, axis)))
    assert dot(turned, sight) / norm(turned) >= dot(axis, sight) - 1e-9


def cross(a, b):
    return (a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"port": 70000}, "port: 70000 is not allowed"),
        ({"camera_rpy_deg": (0, 0, math.nan)}, "camera_rpy_deg: (0, 0, nan) is not allowed"),
        ({"gain_rad_s": 0}, "gain_rad_s: 0 is not allowed"),
        ({"gain_rad_s": math.inf}, "gain_rad_s: inf is not allowed"),
        ({"permanence_s": 0}, "permanence_s: 0 is not allowed"),
        ({"permanence_s": 3}, "permanence_s: 3 is not allowed"),
    ],
)
def test_options_are_checked(options, words):
    with pytest.raises(ValueError, match="allowed") as caught:
        CameraOptions(**options)
    assert words in str(caught.value)


def test_it_says_what_it_would_do():
    assert "up to 0.1 rad/s" in camera().describe()
    assert "targets on UDP 127.0.0.1:6602" in camera(port=6602).describe()
    assert camera().apply(ZERO_TWIST, robot_at(10.0, IDENTITY)) is ZERO_TWIST


def test_of_two_that_send_targets_none_is_followed():
    made = camera(b"0.4 0")
    advance = Twist(Vector3(0.0, 0.0, 0.01), ZERO3, Frame.TOOL)
    assert made.apply(advance, robot_at(10.1)) != advance
    made.listener.take(b"-0.4 0", 10.2, Sender("", 7))
    for tick in range(4):
        now_s = 10.2 + 0.1 * tick
        assert made.apply(advance, robot_at(now_s)) is advance
        assert made.status() == "two programs send targets: the camera gives no direction"
        made.listener.take(b"0.4 0", now_s)
    for tick in range(12):
        made.listener.take(b"0.4 0", 10.6 + 0.1 * tick)
    assert made.apply(advance, robot_at(11.7)) != advance
    assert made.status() == "the camera gives the direction"


def test_a_cameras_program_that_starts_anew_is_followed():
    made = camera(b"0.4 0")
    made.listener.take(b"0.4 0", 10.6, Sender("", 7))
    advance = Twist(Vector3(0.0, 0.0, 0.01), ZERO3, Frame.TOOL)
    assert made.apply(advance, robot_at(10.7)) != advance
