"""Mapping of deflections and buttons to motion requests."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.errors import ConfigurationError, OptionError
from cardan.gateway.operator.mapping import (
    AXES,
    ENABLE_WITHIN_S,
    GripperOptions,
    MappingOptions,
    Mode,
    Orientation,
    TwistMapping,
)
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
    # two presses between two ticks count as two
    assert mapping.take_gripper(edges("1", "-1", "1")) is False
    assert mapping.take_gripper(edges("left")) is False


def test_making_the_robot_ready_takes_a_hand_at_rest():
    mapping = TwistMapping(MappingOptions(deadman=("left",), enable="right"))
    rest = state()
    assert mapping.presses_enable(edges("right"), 0.1)
    assert mapping.presses_enable(edges("right", "-right"), 0.1)
    assert not mapping.presses_enable(edges("-right"), 0.1)
    assert not mapping.presses_enable(edges("left"), 0.1)
    assert not TwistMapping(MappingOptions()).presses_enable(edges("right"), 0.1)
    assert not mapping.presses_enable(edges("right"), 0.6)
    assert mapping.not_at_rest(rest) == ""
    assert mapping.not_at_rest(state("left")) == "'left' is held"
    assert (
        mapping.not_at_rest(rest._replace(axes=(0, 0, 0.1, 0, 0, 0))) == "the device is deflected"
    )
    assert mapping.not_at_rest(rest._replace(link=DeviceLink.STALE)) == "the device is stale"


def test_where_the_pose_is_followed_deflections_do_not_keep_the_robot_from_being_made_ready():
    options = MappingOptions(mode=Mode.POSITION, clutch="button_2", enable="right")
    mapping = TwistMapping(options)
    assert mapping.not_at_rest(state()._replace(axes=(0.3,) * 6)) == ""


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
    assert MappingOptions(deadman=deadman).deadman_buttons == buttons


@pytest.mark.parametrize("yaw_deg", [90.0, 1.0])
def test_yaw_turns_rotations_about_the_base_s_axes_only(yaw_deg):
    sine, cosine = math.sin(math.radians(yaw_deg)), math.cos(math.radians(yaw_deg))
    for frame, turned in ((Frame.BASE, True), (Frame.MIXED, False), (Frame.TOOL, False)):
        options = MappingOptions(
            linear_speed_m_s=1.0, angular_speed_rad_s=1.0, yaw_deg=yaw_deg, frame=frame
        )
        twist = TwistMapping(options).twist((1, 0, 0, 1, 0, 0))
        ahead, aside = (1, 0, 0), (cosine, sine, 0)
        assert twist.linear == pytest.approx(ahead if frame is Frame.TOOL else aside)
        assert twist.angular == pytest.approx(aside if turned else ahead)


def test_a_press_that_enables_counts_until_and_at_its_age():
    mapping = TwistMapping(MappingOptions(enable="right"))
    edge = [ButtonEvent(10.0, "right", True)]
    assert mapping.presses_enable(edge, 10.0 + ENABLE_WITHIN_S)
    assert not mapping.presses_enable(edge, 10.001 + ENABLE_WITHIN_S)


def test_a_press_of_its_button_passes_the_device_on():
    mapping = TwistMapping(MappingOptions(pass_on="menu"))
    assert mapping.passes_on(edges("menu"))
    assert mapping.passes_on(edges("left", "menu", "-menu"))
    assert not mapping.passes_on(edges("-menu"))
    assert not mapping.passes_on(edges("left"))
    assert not mapping.passes_on([])
    assert not TwistMapping(MappingOptions()).passes_on(edges("menu"))


# -- options ---------------------------------------------------------------------------------------

POSITION = {"mode": Mode.POSITION, "deadman": "left"}
ABSOLUTE = {"mode": Mode.ABSOLUTE, "deadman": "left", "origin_m": (0.5, 0.0, 0.3)}
WHOLE = {**ABSOLUTE, "orientation": Orientation.ABSOLUTE}


def test_what_is_so_by_itself():
    options = MappingOptions()
    assert options.mode is Mode.RATE
    assert (options.linear_speed_m_s, options.angular_speed_rad_s) == (0.1, 0.4)
    assert (options.approach_speed_m_s, options.approach_speed_rad_s) == (0.05, 0.3)
    assert (options.slip_m, options.slip_rad) == (0.15, 0.6)
    assert options.joint_speed_rad_s == 0.4
    assert (GripperOptions().closed_value, GripperOptions().open_value) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("key", "known"),
    [
        ("linear_speed_m_s", {"linear_speed_m_s": -1.0}),
        ("axes", {"axes": ("x", "y", "z", "rx", "ry", "up")}),
        ("axes", {"axes": ("x", "y", "z", "rx", "ry", "--rz")}),
        ("joints", {"joints": {"up": "rail"}}),
        ("joints", {"joints": {"fixed": "rail"}}),
        ("device_rpy_deg", {"device_rpy_deg": (0.0, 0.0, 90.0)}),
        ("orientation", {"orientation": Orientation.FIXED}),
        ("deadman", {"mode": Mode.POSITION}),
        ("joints", {**POSITION, "joints": {"x": "rail"}}),
        ("recapture", {"recapture": "grip"}),
        ("recapture", {**ABSOLUTE, "recapture": "grip"}),
        ("origin_m", {**POSITION, "origin_m": (0.5, 0.0, 0.3)}),
        ("device_center_m", {**POSITION, "device_center_m": (0.0, 0.0, 0.1)}),
        ("device_to_tool_rpy_deg", {**POSITION, "device_to_tool_rpy_deg": (0.0, 0.0, 90.0)}),
        ("orientation", {**POSITION, "orientation": Orientation.ABSOLUTE}),
        (
            "device_to_tool_rpy_deg",
            {**WHOLE, **POSITION, "origin_m": None, "device_to_tool_rpy_deg": (0.0, 0.0, 90.0)},
        ),
        ("origin_m", {"mode": Mode.ABSOLUTE, "deadman": "left"}),
        ("frame", {**ABSOLUTE, "frame": Frame.TOOL}),
        ("orientation", {**WHOLE, "axes": ("x", "y", "z", "-rx", "ry", "rz")}),
        ("orientation", {**WHOLE, "axes": ("x", "y", "z", "rx", "ry", "-rz")}),
        ("orientation", {**WHOLE, "scale": (1.0, 1.0, 1.0, 0.5, 1.0, 1.0)}),
        ("orientation", {**WHOLE, "scale": (1.0, 1.0, 1.0, 1.0, 1.0, 0.5)}),
        ("device_to_tool_rpy_deg", {**ABSOLUTE, "device_to_tool_rpy_deg": (0.0, 0.0, 90.0)}),
    ],
)
def test_options_that_do_not_go_together_are_refused(key, known):
    with pytest.raises(ConfigurationError) as refused:
        MappingOptions(**known)
    assert refused.value.key == key


@pytest.mark.parametrize(
    "known",
    [
        {},
        {"axes": ("x", "-y", "fixed", "rz", "ry", "rx"), "joints": {"-rz": "rail"}},
        {"mode": Mode.POSITION, "clutch": "left", "recapture": "grip"},
        {**POSITION, "device_rpy_deg": (0.0, 0.0, 90.0), "orientation": Orientation.FIXED},
        {**POSITION, "frame": Frame.TOOL},
        {**ABSOLUTE, "device_center_m": (0.0, 0.0, 0.1)},
        WHOLE,
        {**WHOLE, "device_to_tool_rpy_deg": (0.0, 0.0, 90.0)},
        {**WHOLE, "axes": ("y", "x", "z", "rx", "ry", "rz")},
        {**WHOLE, "scale": (2.0, 2.0, 0.5, 1.0, 1.0, 1.0)},
        {**ABSOLUTE, "axes": ("x", "y", "z", "-rx", "ry", "rz")},
    ],
)
def test_options_that_go_together_are_taken(known):
    assert TwistMapping(MappingOptions(**known)).options.mode is known.get("mode", Mode.RATE)


def test_deflections_that_are_changed_in_place_give_another_twist():
    mapping, axes = TwistMapping(MappingOptions()), [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    before = mapping.twist(axes)
    axes[0] = 0.0
    assert mapping.twist(axes).linear.x == 0.0 != before.linear.x
    still = tuple(axes)
    assert mapping.twist(still) is mapping.twist(still)
    assert mapping.twist(still) == mapping.twist(axes)
