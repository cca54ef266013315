"""Absolute control: a position of the device is a position of the TCP, reached without a step."""

import math

import pytest
from hypothesis import given, settings, strategies as st

from cardan.gateway.arm.status import Phase
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.mapping import Mode, Orientation
from cardan.spatial import add, from_euler_zyx, multiply, norm, rotate, rotation_between, subtract
from cardan.types import DeviceLink, Vector3
from tests.examples import examples
from tests.gateway.device_pose_bench import HAND, DevicePoseBench, close, displaced
from tests.gateway.operator.test_differential import plans, play, rpys

ORIGIN = Vector3(0.45, 0.05, 0.35)
CENTER = Vector3(0.1, -0.1, 0.2)


def absolute(**options):
    options = {"origin_m": ORIGIN, "device_center_m": CENTER, **options}
    return DevicePoseBench(mode=Mode.ABSOLUTE, **options).run()


def test_nothing_moves_before_the_clutch():
    bench = absolute().send_pose(displaced(x=0.1)).run(1.0)
    assert bench.moved == (0, 0, 0)
    assert bench.core.phase is Phase.DISARMED


@pytest.mark.matrix
@settings(max_examples=15)
@given(rpys, st.floats(-180.0, 180.0), st.floats(0.3, 1.5))
def test_the_tcp_goes_where_the_hand_is(rpy, yaw, factor):
    scale = (factor, 0.5, 1.0, 1.0, 1.0, 1.0)
    bench = absolute(device_rpy_deg=rpy, yaw_deg=yaw, scale=scale).tap("button_2").run(15.0)
    align = from_euler_zyx(*(math.radians(angle) for angle in rpy))
    turn = from_euler_zyx(0.0, 0.0, math.radians(yaw))

    def place(hand):
        x, y, z = rotate(align, subtract(hand.position, CENTER))
        return add(ORIGIN, rotate(turn, Vector3(x * factor, y * 0.5, z)))

    assert close(bench.tcp.position, place(HAND))
    bench.send_pose(displaced(0.03, 0.02, -0.04)).run(3.0)
    assert close(bench.tcp.position, place(bench.device.pose))
    assert close(bench.mapped_device, bench.tcp.position)
    assert close(bench.turned, (0, 0, 0))


def test_it_approaches_slowly_and_follows_at_speed_once_there():
    bench = absolute(approach_speed_m_s=0.03).press("button_2").run()
    fastest = 0.0
    while bench.message:
        assert bench.message == "the TCP is on its way to where the device is"
        bench.run()
        fastest = max(fastest, norm(bench.velocity[0]))
    for _ in range(100):
        bench.run()
        fastest = max(fastest, norm(bench.velocity[0]))
    assert fastest == pytest.approx(0.03)
    bench.send_pose(displaced(x=0.12)).run(0.3)
    assert norm(bench.velocity[0]) > 0.2


def test_a_hand_that_is_too_far_ahead_is_approached_again():
    bench = absolute(slip_m=0.1).tap("button_2").run(8.0)
    assert bench.message == ""
    bench.send_pose(displaced(x=0.3)).run(1.0)
    assert bench.message == "the TCP is on its way to where the device is"
    assert norm(bench.velocity[0]) == pytest.approx(0.05)
    bench.run(8.0)
    assert bench.message == ""
    assert close(bench.tcp.position, bench.mapped_device)


def test_taking_the_hand_up_elsewhere_goes_there_and_letting_go_brakes():
    bench = absolute().tap("button_2").run(6.0).tap("button_2")
    where = bench.tcp
    bench.send_pose(displaced(y=0.2)).run(1.0)
    assert close(bench.tcp.position, where.position, 1e-9)
    bench.tap("button_2").run(0.5)
    assert 0.01 < bench.tcp.position.y - where.position.y < 0.03
    bench.press("button_2").run(0.2)
    assert bench.core.at_rest
    assert bench.tcp.position.y - where.position.y < 0.03


@pytest.mark.matrix
def test_a_hand_outside_the_workspace_is_met_at_its_edge():
    limits = ReferenceLimits(workspace_x_m=(0.3, 0.5), workspace_z_m=(0.2, 0.6))
    bench = absolute(limits=limits, orientation=Orientation.FIXED)
    bench.send_pose(displaced(x=0.2, y=0.05, z=0.5)).run(0.5).tap("button_2").run(15.0)
    assert bench.message == "the device is outside the workspace: the TCP stays at its edge"
    assert bench.core.reference.at_workspace_limit
    expected = (0.5, bench.mapped_device.y, 0.6)
    assert close(bench.tcp.position, expected, 1e-4)
    assert bench.tcp.position.x <= 0.5 + 1e-9
    assert close(bench.mapped_device, bench.tcp.position, 1e-4)
    bench.send_pose(displaced(x=-0.08)).run(8.0)
    assert bench.message == ""
    assert close(bench.tcp.position, bench.mapped_device)


@pytest.mark.matrix
def test_the_tool_stands_as_the_hand_does():
    bench = absolute(
        orientation=Orientation.ABSOLUTE,
        device_rpy_deg=(0.0, 0.0, 90.0),
        yaw_deg=30.0,
        device_to_tool_rpy_deg=(180.0, 0.0, 0.0),
    )
    bench.tap("button_2").run(15.0)
    for turn in (0.0, 0.4):
        bench.send_pose(displaced(rx=turn)).run(3.0)
        in_base = multiply(from_euler_zyx(0, 0, math.radians(120.0)), bench.device.pose.orientation)
        expected = multiply(in_base, from_euler_zyx(math.pi, 0.0, 0.0))
        assert norm(rotation_between(bench.tcp.orientation, expected)) < 1e-6


def test_a_relative_orientation_beside_an_absolute_place():
    bench = absolute(orientation=Orientation.FOLLOW_BASE).tap("button_2").run(6.0)
    assert close(bench.turned, (0, 0, 0))
    bench.send_pose(displaced(rz=0.3)).run(2.0)
    assert close(bench.turned, (0, 0, 0.3))


def test_a_lost_hand_brakes_and_a_leap_is_not_followed():
    bench = absolute().tap("button_2").run(6.0).put_device(displaced(x=0.3)).run(0.5)
    assert bench.core.at_rest
    assert "the device's pose jumped" in bench.message
    bench.tap("button_2").run(0.3)
    assert bench.core.following
    bench.device = bench.device._replace(link=DeviceLink.LOST)
    bench.run(0.5)
    assert bench.core.at_rest
    assert not bench.core.following


@pytest.mark.matrix
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
    bench = absolute(
        limits=ReferenceLimits(workspace_x_m=(0.3, 0.8), workspace_z_m=(0.2, 0.7)),
        orientation=orientation,
        device_rpy_deg=rpy,
        scale=(*factors, 1.0, 1.0, 1.0),
        approach_speed_m_s=approach,
        **buttons,
    )
    play(bench.press("grip").run().tap("button_2"), plan)
