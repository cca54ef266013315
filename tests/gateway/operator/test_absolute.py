"""Absolute control: a place of the hand is a place of the TCP, reached without a step."""

import math

import pytest
from hypothesis import given, settings, strategies as st

from cardan.gateway.arm.status import Phase
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.mapping import Mode, Orientation
from cardan.spatial import add, from_euler_zyx, multiply, norm, rotate, rotation_between, subtract
from cardan.types import DeviceLink, Vector3
from tests.examples import examples
from tests.gateway.device_pose_rig import HAND, DevicePoseRig, close, displaced
from tests.gateway.operator.test_differential import plans, play, rpys

pytestmark = pytest.mark.matrix

ORIGIN = Vector3(0.45, 0.05, 0.35)
CENTER = Vector3(0.1, -0.1, 0.2)


def absolute(**options):
    options = {"origin_m": ORIGIN, "device_center_m": CENTER, **options}
    return DevicePoseRig(mode=Mode.ABSOLUTE, **options).run()


def test_nothing_moves_before_the_clutch():
    rig = absolute().send_pose(displaced(x=0.1)).run(1.0)
    assert rig.moved == (0, 0, 0)
    assert rig.core.phase is Phase.DISARMED


@settings(max_examples=15)
@given(rpys, st.floats(-180.0, 180.0), st.floats(0.3, 1.5))
def test_the_tcp_goes_where_the_hand_is(rpy, yaw, factor):
    scale = (factor, 0.5, 1.0, 1.0, 1.0, 1.0)
    rig = absolute(device_rpy_deg=rpy, yaw_deg=yaw, scale=scale).tap("button_2").run(15.0)
    align = from_euler_zyx(*(math.radians(angle) for angle in rpy))
    turn = from_euler_zyx(0.0, 0.0, math.radians(yaw))

    def place(hand):
        x, y, z = rotate(align, subtract(hand.position, CENTER))
        return add(ORIGIN, rotate(turn, Vector3(x * factor, y * 0.5, z)))

    assert close(rig.tcp.position, place(HAND))
    rig.send_pose(displaced(0.03, 0.02, -0.04)).run(3.0)
    assert close(rig.tcp.position, place(rig.device.pose))
    assert close(rig.mapped_device, rig.tcp.position)
    assert close(rig.turned, (0, 0, 0))


def test_it_approaches_slowly_and_follows_at_speed_once_there():
    rig = absolute(approach_speed_m_s=0.03).press("button_2").run()
    fastest = 0.0
    while rig.message:
        assert rig.message == "the TCP is on its way to where the device is"
        rig.run()
        fastest = max(fastest, norm(rig.velocity[0]))
    for _ in range(100):
        rig.run()
        fastest = max(fastest, norm(rig.velocity[0]))
    assert fastest == pytest.approx(0.03)
    rig.send_pose(displaced(x=0.12)).run(0.3)
    assert norm(rig.velocity[0]) > 0.2


def test_a_hand_that_is_too_far_ahead_is_approached_again():
    rig = absolute(slip_m=0.1).tap("button_2").run(8.0)
    assert rig.message == ""
    rig.send_pose(displaced(x=0.3)).run(1.0)
    assert rig.message == "the TCP is on its way to where the device is"
    assert norm(rig.velocity[0]) == pytest.approx(0.05)
    rig.run(8.0)
    assert rig.message == ""
    assert close(rig.tcp.position, rig.mapped_device)


def test_taking_the_hand_up_elsewhere_goes_there_and_letting_go_brakes():
    rig = absolute().tap("button_2").run(6.0).tap("button_2")
    where = rig.tcp
    rig.send_pose(displaced(y=0.2)).run(1.0)
    assert close(rig.tcp.position, where.position, 1e-9)
    rig.tap("button_2").run(0.5)
    assert 0.01 < rig.tcp.position.y - where.position.y < 0.03
    rig.press("button_2").run(0.2)
    assert rig.core.at_rest
    assert rig.tcp.position.y - where.position.y < 0.03


def test_a_hand_outside_the_workspace_is_met_at_its_edge():
    limits = ReferenceLimits(workspace_x_m=(0.3, 0.5), workspace_z_m=(0.2, 0.6))
    rig = absolute(limits=limits, orientation=Orientation.FIXED)
    rig.send_pose(displaced(x=0.2, y=0.05, z=0.5)).run(0.5).tap("button_2").run(15.0)
    assert rig.message == "the device is outside the workspace: the TCP stays at its edge"
    assert rig.core.reference.at_workspace_limit
    expected = (0.5, rig.mapped_device.y, 0.6)
    assert close(rig.tcp.position, expected, 1e-4)
    assert rig.tcp.position.x <= 0.5 + 1e-9
    assert close(rig.mapped_device, rig.tcp.position, 1e-4)
    rig.send_pose(displaced(x=-0.08)).run(8.0)
    assert rig.message == ""
    assert close(rig.tcp.position, rig.mapped_device)


def test_the_tool_stands_as_the_hand_does():
    rig = absolute(
        orientation=Orientation.ABSOLUTE,
        device_rpy_deg=(0.0, 0.0, 90.0),
        yaw_deg=30.0,
        device_to_tool_rpy_deg=(180.0, 0.0, 0.0),
    )
    rig.tap("button_2").run(15.0)
    for turn in (0.0, 0.4):
        rig.send_pose(displaced(rx=turn)).run(3.0)
        in_base = multiply(from_euler_zyx(0, 0, math.radians(120.0)), rig.device.pose.orientation)
        expected = multiply(in_base, from_euler_zyx(math.pi, 0.0, 0.0))
        assert norm(rotation_between(rig.tcp.orientation, expected)) < 1e-6


def test_a_relative_orientation_beside_an_absolute_place():
    rig = absolute(orientation=Orientation.FOLLOW_BASE).tap("button_2").run(6.0)
    assert close(rig.turned, (0, 0, 0))
    rig.send_pose(displaced(rz=0.3)).run(2.0)
    assert close(rig.turned, (0, 0, 0.3))


def test_a_lost_hand_brakes_and_a_leap_is_not_followed():
    rig = absolute().tap("button_2").run(6.0).put_device(displaced(x=0.3)).run(0.5)
    assert rig.core.at_rest
    assert "the device's pose jumped" in rig.message
    rig.tap("button_2").run(0.3)
    assert rig.core.following
    rig.device = rig.device._replace(link=DeviceLink.LOST)
    rig.run(0.5)
    assert rig.core.at_rest
    assert not rig.core.following


@settings(max_examples=examples(50))
@given(
    plans,
    st.sampled_from([{"clutch": "button_2"}, {"clutch": "button_2", "deadman": ("grip",)},
                     {"deadman": ("grip",)}]),
    st.sampled_from([None, *Orientation]),
    rpys,
    st.tuples(*[st.floats(0.1, 3.0)] * 3),
    st.floats(0.01, 2.0),
)  # fmt: skip
def test_never_a_step(plan, buttons, orientation, rpy, factors, approach):
    rig = absolute(
        limits=ReferenceLimits(workspace_x_m=(0.3, 0.8), workspace_z_m=(0.2, 0.7)),
        orientation=orientation,
        device_rpy_deg=rpy,
        scale=(*factors, 1.0, 1.0, 1.0),
        approach_speed_m_s=approach,
        **buttons,
    )
    play(rig.press("grip").run().tap("button_2"), plan)
