"""What deflections and buttons come to mean."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.errors import OptionError
from cardan.gateway.operator.mapping import AXES, GripperOptions, MappingOptions, Mode, TwistMapping
from cardan.spatial import norm
from cardan.types import NEVER_S, ButtonEvent, DeviceLink, DeviceState, Frame

deflections = st.tuples(*[st.floats(-1, 1)] * 6)


def test_full_deflection_is_the_configured_speed():
    mapping = TwistMapping(MappingOptions(linear_speed_m_s=0.2, angular_speed_rad_s=0.5))
    twist = mapping.twist((1, -1, 0.5, -1, 1, 0.5))
    assert twist.linear == pytest.approx((0.2, -0.2, 0.1))
    assert twist.angular == pytest.approx((-0.5, 0.5, 0.25))
    assert twist.frame is Frame.BASE


def test_axes_can_be_swapped_turned_scaled_and_fixed():
    options = MappingOptions(
        linear_speed_m_s=1.0,
        angular_speed_rad_s=1.0,
        axes=("y", "-x", "fixed", "rx", "fixed", "-rz"),
        scale=(1.0, 0.5, 1.0, 2.0, 1.0, 1.0),
    )
    twist = TwistMapping(options).twist((0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    assert (*twist.linear, *twist.angular) == pytest.approx((0.2, -0.05, 0, 0.8, 0, -0.6))


def test_yaw_turns_the_hand_about_the_vertical():
    mapping = TwistMapping(MappingOptions(linear_speed_m_s=1.0, yaw_deg=90.0))
    assert mapping.twist((1, 0, 0, 0, 0, 0)).linear == pytest.approx((0, 1, 0))


def test_yaw_does_not_touch_the_tool_frame():
    mapping = TwistMapping(MappingOptions(linear_speed_m_s=1.0, yaw_deg=90.0, frame=Frame.TOOL))
    assert mapping.twist((1, 0, 0, 0, 0, 0)).linear == pytest.approx((1, 0, 0))


@given(deflections, st.floats(-180, 180))
def test_linear_and_bounded_by_the_scale(axes, yaw_deg):
    mapping = TwistMapping(MappingOptions(yaw_deg=yaw_deg))
    twist, doubled = mapping.twist(axes), mapping.twist(tuple(2 * a for a in axes))
    assert doubled.linear == pytest.approx(tuple(2 * v for v in twist.linear), abs=1e-12)
    assert norm(twist.linear) <= 0.1 * math.sqrt(3) + 1e-12
    assert norm(twist.angular) <= 0.4 * math.sqrt(3) + 1e-12


@given(st.sampled_from(AXES))
def test_each_axis_alone_drives_its_own_component(name):
    index = AXES.index(name)
    axes = tuple(1.0 if i == index else 0.0 for i in range(6))
    twist = TwistMapping(MappingOptions()).twist(axes)
    assert [v != 0 for v in (*twist.linear, *twist.angular)] == [i == index for i in range(6)]


def state(*buttons):
    return DeviceState(NEVER_S, DeviceLink.LIVE, (0.0,) * 6, frozenset(buttons))


def test_deadman():
    assert TwistMapping(MappingOptions()).deadman_held(state())
    mapping = TwistMapping(MappingOptions(deadman=("left",)))
    assert not mapping.deadman_held(state("right"))
    assert mapping.deadman_held(state("right", "left"))


def edges(*names):
    return [ButtonEvent(0.0, name.lstrip("-"), not name.startswith("-")) for name in names]


def test_gripper_buttons_act_when_they_go_down():
    mapping = TwistMapping(MappingOptions(), GripperOptions(toggle="1", close="2", open="3"))
    assert mapping.take_gripper(edges("1")) is True
    assert mapping.gripper_closed
    assert mapping.take_gripper(edges("-1")) is False
    assert mapping.take_gripper(edges("2")) is False
    assert mapping.take_gripper(edges("3", "-3")) is True
    assert not mapping.gripper_closed
    # two presses between two ticks are two presses
    assert mapping.take_gripper(edges("1", "-1", "1")) is False
    assert mapping.take_gripper(edges("left")) is False


def test_making_the_robot_ready_takes_a_hand_at_rest():
    mapping = TwistMapping(MappingOptions(deadman=("left",), enable="right"))
    rest = state()
    assert mapping.asks_to_enable(rest, edges("right"), 0.1)
    assert mapping.asks_to_enable(rest, edges("right", "-right"), 0.1)
    assert not mapping.asks_to_enable(rest, edges("-right"), 0.1)
    assert not mapping.asks_to_enable(rest, edges("left"), 0.1)
    assert not mapping.asks_to_enable(state("left"), edges("right"), 0.1)
    assert not mapping.asks_to_enable(rest._replace(axes=(0, 0, 0.1, 0, 0, 0)), edges("right"), 0.1)
    assert not mapping.asks_to_enable(rest._replace(link=DeviceLink.STALE), edges("right"), 0.1)
    assert not TwistMapping(MappingOptions()).asks_to_enable(rest, edges("right"), 0.1)
    assert not mapping.asks_to_enable(rest, edges("right"), 0.6)


def test_where_the_pose_is_followed_deflections_do_not_keep_the_robot_from_being_made_ready():
    options = MappingOptions(mode=Mode.POSITION, clutch="button_2", enable="right")
    mapping = TwistMapping(options)
    assert mapping.asks_to_enable(state()._replace(axes=(0.3,) * 6), edges("right"), 0.1)


def test_axes_drive_joints_either_way():
    mapping = TwistMapping(MappingOptions(joints={"x": "a", "-ry": "b"}, joint_speed_rad_s=0.5))
    assert mapping.drives_joints
    rates = mapping.joint_rates((1.0, 0.0, 0.0, 0.0, 0.4, 0.0))
    assert rates == {"a": pytest.approx(0.5), "b": pytest.approx(-0.2)}
    assert not TwistMapping(MappingOptions()).drives_joints


@pytest.mark.parametrize("deadman", [("",), ("left", "")])
def test_a_dead_man_without_a_name_is_refused(deadman):
    with pytest.raises(OptionError, match="deadman"):
        MappingOptions(deadman=deadman)


@pytest.mark.parametrize(
    ("deadman", "buttons"), [("", ()), ("left", ("left",)), (("a", "b"), ("a", "b"))]
)
def test_which_buttons_are_the_dead_man(deadman, buttons):
    options = MappingOptions(deadman=deadman)
    assert options.deadman_buttons == buttons
    mapping = TwistMapping(options)
    for held in ((), ("c",), ("a",), ("left", "c")):
        device = DeviceState(0.0, DeviceLink.LIVE, (0.0,) * 6, frozenset(held), None)
        assert mapping.deadman_held(device) is (not buttons or bool({*buttons} & {*held}))
