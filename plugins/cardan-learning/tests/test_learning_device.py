"""A device as a source of actions, in virtual time: shares of full speed, displacement since the
clutch was taken, the gripper, and episode events by buttons."""

import math

import pytest

from cardan.errors import ConfigurationError
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.mapping import GripperOptions, MappingOptions, Mode, Orientation
from cardan.types import (
    IDENTITY,
    ButtonEvent,
    DeviceLink,
    DeviceState,
    Frame,
    Pose,
    Vector3,
)
from cardan_learning.device_actions import DeviceActions, EventButtons, turns_with_tool
from cardan_learning.features import ActionKind

DT_S = 1 / 30
REST = (0.0,) * 6
FORWARD = (1.0, 0.0, 0.0, 0.0, 0.0, 0.5)


class Held:
    """A device with the dead-man held, read thirty times a second."""

    def __init__(self, kind="delta", gripper=None, buttons=None, **mapping):
        mapping.setdefault("deadman", "left")
        self.actions = DeviceActions(
            ActionKind(kind),
            MappingOptions(**mapping),
            gripper or GripperOptions(toggle="right"),
            ReferenceLimits(),
            0.1,
            buttons,
        )
        self.now_s = 10.0
        self.update()

    def update(self, axes=REST, *held, press=(), link=DeviceLink.LIVE, place=None, dt_s=DT_S):
        self.now_s += dt_s
        pose = None if place is None else Pose(Vector3(*place), IDENTITY)
        state = DeviceState(self.now_s, link, axes, frozenset(held), pose)
        self.actions.update(state, [ButtonEvent(self.now_s, b, True) for b in press], self.now_s)

    def action(self, *arguments, **keywords):
        self.update(*arguments, **keywords)
        return self.actions.action()


def moves(action):
    return [number for name, number in action.items() if "gripper" not in name]


def test_deflections_are_shares_of_full_speed():
    held = Held(scale=(1.0, 0.5, 1.0, 1.0, 1.0, 1.0))
    assert moves(held.action((0.4, 0.6, 0, 0, 0, 0))) == [0.0] * 6  # the dead-man is released
    held.update(REST)
    held.update(REST, "left")
    action = held.action((0.4, 0.6, -1.0, 0, 0, 0.2), "left")
    assert moves(action) == pytest.approx([0.4, 0.3, -1.0, 0.0, 0.0, 0.2])
    assert moves(held.action((0.4, 0.6, -1.0, 0, 0, 0.2))) == [0.0] * 6


def test_a_lost_device_asks_for_rest_until_rearming():
    held = Held()
    held.update(REST, "left")
    assert moves(held.action(FORWARD, "left"))[0] == 1.0
    assert moves(held.action(REST, "left", link=DeviceLink.LOST)) == [0.0] * 6
    assert moves(held.action(FORWARD, "left")) == [0.0] * 6
    assert "let go of the device and of 'left'" in held.actions.advice()
    held.update(REST)
    held.update(REST, "left")
    assert moves(held.action(FORWARD, "left"))[0] == 1.0
    assert held.actions.advice() == ""


def test_the_way_since_it_took_hold():
    held = Held("target", linear_speed_m_s=0.3, angular_speed_rad_s=0.6)
    assert moves(held.action()) == [0.0] * 7
    held.update(REST, "left")
    for _ in range(30):
        action = held.action(FORWARD, "left")
    enabled, x, y, z, *turn = moves(action)
    assert enabled == 1.0
    assert (x, y, z) == pytest.approx((0.3, 0.0, 0.0))
    assert turn == pytest.approx([0.0, 0.0, 0.3])
    assert moves(held.action(REST)) == [0.0] * 7
    held.update(REST, "left")
    assert moves(held.action(FORWARD, "left"))[1] == pytest.approx(0.3 * DT_S)


def test_time_that_was_lost_is_lost():
    held = Held("target", linear_speed_m_s=0.3)
    held.update(REST, "left")
    action = held.action(FORWARD, "left", dt_s=5.0)
    assert moves(action)[1] <= 0.3 * 0.1 + 1e-9


def test_along_the_tools_axes_the_way_turns_with_the_tool():
    held = Held("target", frame=Frame.TOOL, linear_speed_m_s=0.3, angular_speed_rad_s=math.pi / 2)
    held.update(REST, "left")
    for _ in range(30):
        held.update((0, 0, 0, 0, 0, 1.0), "left")
    for _ in range(30):
        action = held.action((1.0, 0, 0, 0, 0, 0), "left")
    assert moves(action)[1:4] == pytest.approx([0.0, 0.3, 0.0], abs=1e-9)


def test_a_hands_pose_is_followed_from_where_it_took_hold():
    held = Held("target", mode=Mode.POSITION)
    place = [0.2, 0.1, 0.5]
    held.update(REST, place=place)
    held.update(REST, "left", place=place)
    for _ in range(30):
        place[1] += 0.002
        held.update(REST, "left", place=place)
    for _ in range(30):
        action = held.action(REST, "left", place=place)
    assert moves(action) == pytest.approx([1.0, 0.0, 0.06, 0.0, 0.0, 0.0, 0.0], abs=2e-3)


@pytest.mark.parametrize(("kind", "name"), [("delta", "gripper"), ("target", "gripper_vel")])
def test_the_gripper_is_reported_once(kind, name):
    close, stay, open_ = (0.0, 1.0, 2.0) if kind == "delta" else (-1.0, 0.0, 1.0)
    held = Held(kind)
    held.update(REST, "left")
    assert held.action(REST, "left")[name] == stay
    # An additional update, as by get_teleop_events(), loses nothing.
    held.update(REST, "left", press=("right",))
    assert held.action(REST, "left")[name] == close
    assert held.action(REST, "left")[name] == stay
    assert held.action(REST, "left", press=("right",))[name] == open_


def test_what_buttons_say_of_an_episode():
    held = Held(buttons=EventButtons("a", "b", "c"))
    assert held.actions.events() == (False, False, False, False)
    held.update(REST, "left")
    assert held.actions.events().intervenes
    for press, reported in (("a", (True, True, False)), ("b", (True, False, False))):
        held.update(press=(press,))
        held.update()
        assert held.actions.events()[1:] == reported
        assert held.actions.events()[1:] == (False, False, False)
    held.update(press=("c",))
    assert held.actions.events()[1:] == (True, False, True)


def test_no_button_is_none():
    held = Held()
    held.update(press=("",))
    assert held.actions.events()[1:] == (False, False, False)


@pytest.mark.parametrize(
    ("kind", "mapping", "why"),
    [
        ("delta", {"mode": Mode.POSITION}, "'delta'|\"delta\" is for deflections"),
        ("target", {"mode": Mode.ABSOLUTE, "origin_m": (0.4, 0, 0.4)}, "needs to know where"),
        ("delta", {"joints": {"rz": "joint_6"}}, "no single joints"),
    ],
)
def test_a_mapping_that_gives_no_actions_is_refused(kind, mapping, why):
    with pytest.raises(ConfigurationError, match=why):
        Held(kind, **mapping)


@pytest.mark.parametrize(
    ("frame", "orientation", "with_tool"),
    [
        (Frame.BASE, None, False),
        (Frame.TOOL, None, True),
        (Frame.MIXED, None, True),
        (Frame.BASE, Orientation.FOLLOW_TOOL, True),
        (Frame.TOOL, Orientation.FOLLOW_BASE, False),
    ],
)
def test_about_which_axes_it_turns(frame, orientation, with_tool):
    options = MappingOptions(
        mode=Mode.POSITION, deadman="left", frame=frame, orientation=orientation
    )
    assert turns_with_tool(options) is with_tool
