"""Differential control: buttons that toggle the clutch and recapture the references."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from cardan.gateway.arm.states import Inhibit
from cardan.gateway.arm.status import Phase
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.mapping import MappingOptions, Mode, Orientation
from cardan.gateway.operator.position import unfollowed
from cardan.gateway.session.assembly import make_controller, make_robot
from cardan.gateway.session.config import parse_config
from cardan.spatial import (
    add,
    conjugate,
    from_euler_zyx,
    from_rotation_vector,
    multiply,
    norm,
    rotate,
    rotation_between,
    scale,
    subtract,
)
from cardan.types import (
    IDENTITY,
    ButtonEvent,
    DeviceLink,
    DeviceState,
    Frame,
    JointCommand,
    Pose,
    RobotLink,
    Vector3,
)
from tests.examples import examples
from tests.gateway.device_pose_bench import DEFLECTIONS, HAND, DevicePoseBench, close, displaced

pytestmark = pytest.mark.matrix

NAN_AXES = (math.nan,) * 6


def engaged(**options):
    bench = DevicePoseBench(recapture="button_1", **options).run().tap("button_2")
    assert bench.core.following
    return bench


# -- the control law -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frame", "expected"), [(Frame.BASE, (0.26, -0.32, 0.12)), (Frame.TOOL, (0.32, -0.32, 0.14))]
)
def test_the_papers_check_value(frame, expected):
    start = Pose(Vector3(0.3, -0.35, 0.1), from_rotation_vector(Vector3(0.0, math.pi / 2, 0.0)))
    bench = DevicePoseBench(
        start=start, frame=frame, device_rpy_deg=(90.0, 0.0, 90.0), orientation=Orientation.FIXED
    )
    bench.put_device(Pose(Vector3(0.0, -0.02, 0.05), IDENTITY)).run().tap("button_2")
    bench.send_pose(Pose(Vector3(0.03, 0.0, 0.01), from_euler_zyx(0.3, 0.2, 0.1))).run(2.0)
    assert close(bench.tcp.position, expected)
    assert close(bench.turned, (0.0, 0.0, 0.0))
    assert close(bench.mapped_device, expected)


def test_the_scale_multiplies_the_displacement():
    bench = engaged(scale=(0.5, 2.0, 1.0, 1.0, 1.0, 1.0))
    bench.send_pose(displaced(0.04, 0.03, 0.02)).run(2.0)
    assert close(bench.moved, (0.02, 0.06, 0.02))


angles = st.floats(-0.25, 0.25)
turns = st.builds(Vector3, angles, angles, angles)
rpys = st.tuples(*[st.floats(-180.0, 180.0)] * 3)


@settings(max_examples=examples(25))
@given(
    turns,
    rpys,
    st.sampled_from([Orientation.FOLLOW_BASE, Orientation.FOLLOW_TOOL]),
    st.sampled_from(list(Frame)),
)
def test_orientation_follows_as_the_reference_has_it(turn, rpy, kind, frame):
    bench = engaged(device_rpy_deg=rpy, orientation=kind, frame=frame)
    bench.send_pose(displaced(rx=turn.x, ry=turn.y, rz=turn.z)).run(2.0)
    align = from_euler_zyx(*(math.radians(angle) for angle in rpy))
    hand, start = bench.device.pose.orientation, bench.start.orientation
    if kind is Orientation.FOLLOW_BASE:
        increment = multiply(hand, conjugate(HAND.orientation))
    else:
        increment = multiply(conjugate(HAND.orientation), hand)
    aligned = multiply(multiply(align, increment), conjugate(align))
    both = (aligned, start) if kind is Orientation.FOLLOW_BASE else (start, aligned)
    assert norm(rotation_between(multiply(*both), bench.tcp.orientation)) < 1e-6


@pytest.mark.parametrize("frame", list(Frame))
def test_without_a_word_on_orientation_the_frame_decides(frame):
    bench = engaged(frame=frame)
    bench.send_pose(displaced(rx=0.2, ry=-0.1)).run(2.0)
    turn = Vector3(0.2, -0.1, 0.0)
    assert close(
        bench.turned, turn if frame is Frame.BASE else rotate(bench.start.orientation, turn)
    )


def test_a_fixed_orientation_minds_no_flick_of_the_gimbal():
    bench = engaged(orientation=Orientation.FIXED)
    bench.put_device(displaced(x=0.01, rx=2.0)).run(1.0)
    assert close(bench.moved, (0.01, 0.0, 0.0))
    assert bench.core.phase is Phase.HOLDING


# -- the buttons -----------------------------------------------------------------------------------


def test_each_press_toggles_and_holding_means_nothing():
    bench = DevicePoseBench().run().press("button_2").run(0.5)
    assert bench.core.following
    bench.send_pose(displaced(x=0.02)).run(1.0)
    bench.release("button_2").run(0.1)
    assert bench.core.following
    bench.press("button_2").run(0.5)
    assert not bench.core.following
    assert bench.message == "let go of 'button_2', then press 'button_2' to move"
    bench.send_pose(displaced(x=-0.2)).run(0.5).release("button_2").run(0.5)
    assert close(bench.moved, (0.02, 0.0, 0.0))
    bench.tap("button_2").send_pose(displaced(x=-0.19)).run(1.0)
    assert close(bench.moved, (0.03, 0.0, 0.0))


def test_recapture_forgets_slip_and_lag():
    bench = engaged(slip_m=0.1)
    bench.send_pose(displaced(y=0.4)).run(0.15)
    assert "slips" in bench.message
    bench.run(0.2)
    before = bench.velocity[0].y
    assert before > 0.2
    bench.press("button_1").run()
    assert bench.core.following
    assert bench.message == ""
    assert 0.0 < bench.velocity[0].y < before
    y = bench.moved.y
    way = 0.0
    for _ in range(250):
        bench.run()
        # The hand's motion during braking does not move the arm back.
        assert bench.velocity[0].y >= -1e-9
        way = bench.moved.y - y
    assert bench.core.at_rest
    assert way == pytest.approx(before**2 / 2.0, abs=2e-3)
    assert close(bench.mapped_device, bench.tcp.position)


def test_recapture_without_a_clutch_held_does_nothing():
    bench = DevicePoseBench(recapture="button_1").run().tap("button_1")
    assert bench.core.phase is Phase.DISARMED
    bench = DevicePoseBench(deadman=("grip",), recapture="button_1").run().press("grip").run()
    bench.send_pose(displaced(x=0.2)).run(0.3).press("button_1").run(1.0)
    assert bench.core.following
    assert 0.0 < bench.moved.x < 0.15


@pytest.mark.parametrize(
    ("order", "follows"),
    [(("button_1", "button_2"), False), (("button_2", "button_1"), False)],
)
def test_both_buttons_in_one_tick_while_following(order, follows):
    bench = engaged().send_pose(displaced(x=0.3)).run(0.3)
    bench.press(*order).run(1.0)
    assert bench.core.following is follows
    assert bench.core.at_rest


@pytest.mark.parametrize("order", [("button_1", "button_2"), ("button_2", "button_1")])
def test_both_buttons_in_one_tick_while_clutched_out(order):
    bench = DevicePoseBench(recapture="button_1").run().press(*order).run(0.1)
    assert bench.core.following
    assert bench.moved == (0, 0, 0)


@given(st.lists(st.booleans(), max_size=7))
@settings(max_examples=examples(50))
def test_a_chattering_button_counts_its_presses(edges):
    """All presses are in one tick. Debouncing is the driver's task, and this has no other
    effect."""
    bench = DevicePoseBench().run()
    down, presses = False, 0
    for pressed in edges:
        if pressed is not down:
            (bench.press if pressed else bench.release)("button_2")
            down, presses = pressed, presses + pressed
    bench.run()
    assert bench.core.following is (presses % 2 == 1)
    assert bench.moved == (0, 0, 0)


def test_out_and_in_again_in_one_tick_takes_the_references_anew():
    bench = engaged().send_pose(displaced(x=0.1)).run(0.2)
    bench.press("button_2").release("button_2").press("button_2").run(1.0)
    assert bench.core.following
    assert 0.0 < bench.moved.x < 0.06
    assert close(bench.mapped_device, bench.tcp.position)


def test_clutch_and_dead_man_together_are_both_needed():
    bench = DevicePoseBench(deadman=("button_1",), clutch="button_2").run()
    assert bench.message == "press 'button_2', with 'button_1' held, to move"
    bench.press("button_1").send_pose(displaced(x=0.05)).run(0.5)
    assert bench.moved == (0, 0, 0)
    bench.tap("button_2").send_pose(displaced(x=0.08)).run(1.0)
    assert close(bench.moved, (0.03, 0, 0))
    bench.release("button_1").run(0.5).send_pose(displaced()).run(0.5)
    assert close(bench.moved, (0.03, 0, 0))
    assert bench.core.phase is Phase.HOLDING
    bench.press("button_1").run().send_pose(displaced(x=0.01)).run(1.0)
    assert close(bench.moved, (0.04, 0, 0))


# -- disengaging faults, and actions that do not re-engage -----------------------------------------


@pytest.mark.parametrize("link", [DeviceLink.LOST, DeviceLink.STALE, DeviceLink.NEEDS_NEUTRAL])
@pytest.mark.parametrize("reported_anew", [False, True])
def test_a_button_held_through_a_loss_is_not_pressed_anew(link, reported_anew):
    bench = DevicePoseBench().run().press("button_2").run(0.1).send_pose(displaced(x=0.1)).run(0.2)
    live = bench.device
    bench.device = live._replace(link=link, buttons=frozenset())
    bench.run(0.5)
    assert bench.core.at_rest
    assert not bench.core.following
    bench.device = live._replace(pose=bench.device_goal)
    if reported_anew:
        bench.press("button_2")
    bench.run(0.5)
    assert not bench.core.following
    assert bench.message.endswith("let go of 'button_2', then press 'button_2' to move")
    where = bench.moved
    bench.release("button_2").run().tap("button_2").run(0.2)
    assert bench.core.following
    assert bench.moved == where


@pytest.mark.parametrize("trouble", ["lost", "alarm", "silent robot", "stopping"])
def test_a_press_while_something_is_wrong_begins_nothing_later(trouble):
    bench = DevicePoseBench().run()
    good_device, good_robot = bench.device, bench.robot
    if trouble == "lost":
        bench.device = bench.device._replace(link=DeviceLink.LOST, reason="unplugged")
    elif trouble == "alarm":
        bench.robot = bench.robot._replace(alarm="the port is flooded")
    elif trouble == "silent robot":
        bench.robot = bench.robot._replace(link=RobotLink.LOST)
    else:
        bench.core.inhibit("the session's time limit is reached", Inhibit.FOR_GOOD)
    bench.run().tap("button_2").run(0.1)
    bench.device = good_device._replace(stamp_s=bench.now_s)
    bench.robot = good_robot
    bench.send_pose(displaced(x=0.1)).run(0.5)
    assert not bench.core.following
    assert bench.moved == (0, 0, 0)
    assert bench.core.status().trips == 0


def test_somebody_else_may_take_the_hand_off_the_robot():
    bench = engaged().send_pose(displaced(x=0.1)).run(0.2)
    bench.core.inhibit("the force is lost", Inhibit.ONCE)
    bench.press("button_2").run()  # no re-arming in the same tick
    assert not bench.core.following
    assert bench.core.phase is Phase.BRAKING
    assert bench.message.startswith("stopped before: the force is lost; ")
    bench.run(1.0)
    assert bench.core.at_rest
    bench.release("button_2").run().tap("button_2").run(0.5)
    assert bench.core.following
    assert bench.core.status().trips == 1


def test_a_hand_that_is_suspended_is_waited_for_and_then_followed_without_a_step():
    bench = engaged().send_pose(displaced(x=0.1)).run(0.15)
    before = bench.moved
    for _ in range(50):
        bench.core.inhibit("the force is in doubt", Inhibit.MOTION_IGNORED)
        bench.run()
    assert bench.core.at_rest
    assert bench.core.following
    assert bench.moved.x - before.x < 0.03
    bench.run(2.0)
    assert close(bench.moved, (0.1, 0.0, 0.0))


def test_a_press_from_before_a_stall_begins_nothing():
    bench = DevicePoseBench().run().press("button_2")
    bench.run(0.3, dt_s=0.3)
    assert not bench.core.following
    bench.run(1.0)
    assert not bench.core.following


@pytest.mark.parametrize("held", [False, True])
def test_no_hand_is_taken_up_while_the_robot_is_far_behind(held):
    button = "grip" if held else "button_2"
    limits = ReferenceLimits(max_lead_m=0.09)
    bench = DevicePoseBench(limits=limits, **({"deadman": ("grip",)} if held else {})).run()
    bench.press(button).run().send_pose(displaced(x=0.14))
    bench.stuck = True
    bench.run(0.6)
    assert bench.core.following
    bench.release(button).run()
    if not held:
        bench.press(button).run().release(button).run()
    assert not bench.core.following
    bench.press(button).run()
    assert not bench.core.following
    assert "the clutch was not engaged: the robot is" in bench.message
    assert "behind its reference" in bench.message
    bench.run(2.0)
    bench.stuck = False
    bench.release(button).run(0.5).press(button).run()
    assert bench.core.following


def test_an_old_press_begins_nothing_but_still_ends():
    bench = DevicePoseBench().run()
    bench.events.append(ButtonEvent(bench.now_s - 0.7, "button_2", True))
    bench.run()
    assert "it was pressed 0.7 s ago" in bench.message
    bench.tap("button_2")
    assert bench.core.following
    bench.events.append(ButtonEvent(bench.now_s - 0.7, "button_2", True))
    bench.run()
    assert not bench.core.following


def test_letting_go_brakes_at_the_braking_limits_and_not_as_softly_as_the_motion_was():
    limits = ReferenceLimits(linear_jerk_m_s3=5.0)
    ways = []
    for ends in ("clutch", "deadman", "trip"):
        held = {"deadman": ("grip",)} if ends == "deadman" else {}
        bench = DevicePoseBench(limits=limits, **held).run()
        if held:
            bench.press("grip").run()
        else:
            bench.tap("button_2")
        bench.send_pose(displaced(x=0.14)).run(0.4)
        x = bench.moved.x
        if ends == "trip":
            bench.device = bench.device._replace(link=DeviceLink.LOST)
        elif held:
            bench.release("grip")
        else:
            bench.press("button_2")
        bench.run(1.0)
        assert bench.core.at_rest
        ways.append(bench.moved.x - x)
    speed_m_s = limits.linear_speed_m_s
    assert max(ways) <= speed_m_s**2 / (2.0 * limits.linear_acceleration_m_s2) + 2e-3
    assert max(ways) - min(ways) < 2e-3


# -- the map of rendered forces --------------------------------------------------------------------


def determinant(m):
    a, b, c, d, e, f, g, h, i = m
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


@settings(max_examples=examples(25))
@given(
    rpys,
    st.sampled_from(list(Frame)),
    st.tuples(*[st.floats(0.1, 2.0)] * 3),
    st.sampled_from(
        [("x", "y", "z"), ("y", "z", "x"), ("-x", "-y", "z"), ("y", "-x", "fixed"), ("fixed",) * 3]
    ),
)
def test_the_map_is_where_the_tcp_goes(rpy, frame, factors, axes):
    bench = engaged(
        device_rpy_deg=rpy,
        frame=frame,
        scale=(*factors, 1.0, 1.0, 1.0),
        axes=(*axes, "rx", "ry", "rz"),
    )
    assert close(bench.mapped_device, bench.start.position, 1e-12)
    bench.send_pose(displaced(0.02, -0.03, 0.01, rz=0.2)).run(3.0)
    assert close(bench.mapped_device, bench.tcp.position)
    rotation = bench.core.device_map().rotation
    assert determinant(rotation) == pytest.approx(1.0)
    columns = [rotation[i::3] for i in range(3)]
    for i, a in enumerate(columns):
        for j, b in enumerate(columns):
            assert sum(u * v for u, v in zip(a, b, strict=True)) == pytest.approx(
                float(i == j), abs=1e-12
            )
    if axes == ("x", "y", "z") and frame is Frame.BASE:
        align = from_euler_zyx(*(math.radians(angle) for angle in rpy))
        for column, unit in zip(columns, ((1, 0, 0), (0, 1, 0), (0, 0, 1)), strict=True):
            assert close(column, rotate(align, Vector3(*unit)), 1e-12)


def test_the_map_moves_with_a_slip():
    bench = engaged(slip_m=0.1).send_pose(displaced(y=0.4)).run(5.0)
    assert close(bench.mapped_device, bench.tcp.position)
    assert bench.moved.y < 0.2


def test_the_map_ends_where_the_workspace_ends():
    """The TCP cannot reach a virtual wall beyond its workspace, so the map must not lead there."""
    limits = ReferenceLimits(workspace_x_m=(0.45, 0.55))
    bench = DevicePoseBench(limits=limits, recapture="button_1", slip_m=0.15).run().tap("button_2")
    bench.send_pose(displaced(x=0.03, y=0.03)).run(2.0)
    assert close(bench.mapped_device, bench.tcp.position)
    bench.send_pose(displaced(x=0.12, y=0.05)).run(2.0)
    assert close(bench.tcp.position, (0.55, 0.05, 0.4), 1e-4)
    assert close(bench.mapped_device, (0.55, 0.05, 0.4), 1e-4)
    bench.put_device(displaced(x=0.2, y=0.06))  # until the next tick, along the edge alone
    assert close(bench.mapped_device, (0.55, 0.06, 0.4), 1e-4)
    bench.put_device(displaced(x=0.12, y=0.05)).send_pose(displaced(x=0.02)).run(2.0)
    assert close(bench.mapped_device, bench.tcp.position)
    assert close(bench.tcp.position, (0.52, 0.0, 0.4), 1e-4)


@pytest.mark.parametrize(
    ("options", "still"),
    [
        ({}, ()),
        ({"scale": (0.1, -2.0, 1.0, 0.0, 0.0, 0.0)}, ()),
        ({"scale": (1.0, 1.0, 0.0, 1.0, 1.0, 1.0)}, ("z",)),
        ({"axes": ("fixed", "y", "rx", "rx", "ry", "rz")}, ("x", "z")),
    ],
)
def test_directions_that_no_place_of_the_hand_moves(options, still):
    assert unfollowed(MappingOptions(**options)) == still


# -- no steps --------------------------------------------------------------------------------------

numbers = st.floats(-1.0, 1.0)
actions = st.one_of(
    st.tuples(st.just("tap"), st.sampled_from(["button_1", "button_2", "grip"])),
    st.tuples(st.just("press"), st.sampled_from(["button_1", "button_2", "grip"])),
    st.tuples(st.just("release"), st.sampled_from(["button_1", "button_2", "grip"])),
    st.tuples(st.just("both"), st.permutations(["button_1", "button_2", "grip"])),
    st.tuples(st.just("send"), st.tuples(*[st.floats(-0.4, 0.4)] * 3, *[numbers] * 3)),
    st.tuples(st.just("send"), st.tuples(*[st.floats(-0.4, 0.4)] * 3, *[numbers] * 3)),
    st.tuples(st.just("jump"), st.tuples(*[st.floats(-0.4, 0.4)] * 3, *[numbers] * 3)),
    st.tuples(st.just("link"), st.sampled_from([DeviceLink.LOST, DeviceLink.LIVE])),
    st.tuples(st.just("fresh"), st.booleans()),
    st.tuples(st.just("stuck"), st.booleans()),
    st.tuples(st.just("alarm"), st.sampled_from(["", "flooded"])),
    st.tuples(st.just("axes"), st.sampled_from([DEFLECTIONS, (0.0,) * 6, NAN_AXES])),
)
plans = st.lists(
    st.tuples(actions, st.integers(1, 60), st.sampled_from([0.002, 0.004, 0.012])),
    min_size=5,
    max_size=25,
)


def play(bench, plan):
    for (kind, value), ticks, dt_s in plan:
        if kind == "tap":
            bench.tap(value)
        elif kind == "press":
            bench.press(value)
        elif kind == "release":
            bench.release(value)
        elif kind == "both":
            bench.press(*value).release(*value).press(value[0])
        elif kind == "send":
            bench.send_pose(displaced(*value))
        elif kind == "jump":
            bench.put_device(displaced(*value))
        elif kind == "link":
            bench.device = bench.device._replace(link=value)
        elif kind == "fresh":
            bench.fresh = value
        elif kind == "stuck":
            bench.stuck = value
        elif kind == "alarm":
            bench.robot = bench.robot._replace(alarm=value)
        else:
            bench.device = bench.device._replace(axes=value)
        for _ in range(ticks):
            bench.run(dt_s, dt_s)
            world = bench.core.device_map()
            pose_mode = bench.core.operator.mapping.options.mode is not Mode.RATE
            assert (world is not None) is (bench.core.following and pose_mode)
    return bench


@settings(max_examples=examples(100))
@given(
    plans,
    st.sampled_from([{"clutch": "button_2"}, {"clutch": "button_2", "deadman": ("grip",)},
                     {"deadman": ("grip",)}]),
    st.sampled_from(list(Frame)),
    st.sampled_from([None, Orientation.FOLLOW_BASE, Orientation.FOLLOW_TOOL, Orientation.FIXED]),
    rpys,
    st.tuples(*[st.floats(0.1, 3.0)] * 6),
    st.sampled_from([None, 4.0]),
)  # fmt: skip
def test_never_a_step(plan, buttons, frame, orientation, rpy, factors, jerk):
    """The bench checks every command, and that clutching in at rest causes no motion."""
    bench = DevicePoseBench(
        limits=ReferenceLimits(
            linear_jerk_m_s3=jerk, workspace_x_m=(0.3, 0.8), workspace_z_m=(0.2, 0.7)
        ),
        frame=frame,
        orientation=orientation,
        device_rpy_deg=rpy,
        scale=factors,
        recapture="button_1",
        **buttons,
    )
    play(bench.run().press("grip").run().tap("button_2"), plan)


@settings(max_examples=examples(30))
@given(plans)
def test_nothing_moves_without_a_following_hand(plan):
    """The robot is at its command, so that no recovery moves it."""
    plan = [step for step in plan if step[0][0] != "stuck"]
    bench = DevicePoseBench(recapture="button_1").run().tap("button_2")
    play(bench, plan)
    bench.device = bench.device._replace(link=DeviceLink.LOST)
    bench.run(0.3)
    where = bench.tcp
    assert bench.core.at_rest
    bench.send_pose(displaced(x=0.2)).run(0.2)
    assert norm(subtract(bench.tcp.position, where.position)) == 0.0
    assert norm(scale(rotation_between(bench.tcp.orientation, where.orientation), 1.0)) < 1e-12


# -- with the model of an arm ----------------------------------------------------------------------


def test_an_arm_follows_by_its_joints_and_a_new_reference_moves_it_by_no_step():
    config = parse_config(
        {
            "device": {"driver": "leap"},
            "robot": {
                "driver": "sim_arm", "robot": "gofa_crb15000_5", "pacing": "virtual",
                "drive": "ideal",
            },
            "arm": {"model": "gofa_crb15000_5"},
            "mapping": {"mode": "position", "clutch": "button_2", "recapture": "button_1"},
        }
    )  # fmt: skip
    robot = make_robot(config)
    engine = make_controller(config, robot)
    robot.open()
    cycles, period_s = robot.cycles(), robot.options.period_s
    joints, x = [], 0.0

    def go(seconds, speed=0.0, *presses):
        nonlocal x
        for tick in range(round(seconds / period_s)):
            state = next(cycles)
            x += speed * period_s
            buttons = frozenset(presses if tick == 0 else ())
            events = [ButtonEvent(state.stamp_s, button, True) for button in buttons]
            pose = displaced(x=x)
            hand = DeviceState(state.stamp_s, DeviceLink.LIVE, DEFLECTIONS, buttons, pose)
            command = engine.tick(state, hand, events)
            robot.send(command)
            if isinstance(command, JointCommand):
                joints.append(command.positions)
        return engine.reference.pose.position

    start = go(0.1)
    assert go(0.1, 0.0, "button_2") == start
    assert engine.following
    assert close(subtract(go(0.5, -0.2), start), (-0.1, 0.0, 0.0), 0.02)
    recaptured = go(1.5, 0.0, "button_1")
    assert engine.following
    assert engine.at_rest
    end = add(recaptured, Vector3(0.05, 0.0, 0.0))
    assert close(go(1.0, 0.05), end, 3e-3)
    go(0.5, 0.0, "button_2")
    assert not engine.following
    speeds = np.diff(np.array(joints), axis=0) / period_s
    bends = np.abs(np.diff(speeds, axis=0)) / period_s
    kinematics = engine.commanded.servo.kinematics
    assert (np.abs(speeds) <= kinematics.velocity + 1e-6).all()
    assert (bends <= kinematics.acceleration * (1 + 1e-6) + 1e-6).all()
