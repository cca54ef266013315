"""Scripts for the hand that holds the simulated stylus, and their waypoints."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, reject, strategies as st

from cardan.errors import ScriptError
from cardan.sim_peers.base import parse_script
from cardan.spatial import from_euler_zyx
from cardan.types import Vector3
from cardan_omni.peer import (
    INKWELL_M,
    SCRIPT_VERBS,
    SCRIPTS,
    OmniSettings,
    compile_script,
    load_motion,
)
from cardan_omni.protocol import rotation_to_hand, to_hand

pytestmark = pytest.mark.matrix

USABLE_M = Vector3(0.035, 0.08, 0.06)
"""Half the usable workspace, hand frame."""


def motion_of(text):
    return compile_script(parse_script(text, SCRIPT_VERBS))


def hand_at(motion, time_s):
    """Return position, push and stiffness in the hand frame, as computed by the library."""
    points = motion.waypoints
    after = next((p for p in points if p.time_s > time_s), points[-1])
    before = next(p for p in reversed(points) if p.time_s <= time_s)
    span_s = after.time_s - before.time_s
    share = (time_s - before.time_s) / span_s if span_s > 0.0 else 0.0

    def between(a, b):
        return Vector3(*(x + (y - x) * share for x, y in zip(a, b, strict=True)))

    return (
        to_hand(between(before.position_m, after.position_m)),
        to_hand(between(before.push_n, after.push_n)),
        before,
    )


def position_at(motion, time_s):
    return hand_at(motion, time_s)[0]


def derivatives(motion, order):
    """Return the largest derivative of the position between waypoints, m/s^order."""
    times = [p.time_s for p in motion.waypoints]
    values = [p.position_m for p in motion.waypoints]
    for _ in range(order):
        values = [
            tuple((y - x) / (t2 - t1) for x, y in zip(a, b, strict=True))
            for (a, t1), (b, t2) in itertools.pairwise(zip(values, times, strict=True))
        ]
        times = [(a + b) / 2 for a, b in itertools.pairwise(times)]
    return max(math.hypot(*v) for v in values)


def test_axes_of_the_hand_become_those_of_the_device():
    motion = motion_of(
        "0 stiffness 100 200 300 over 0.5\n0 push 1 2 3 over 0.5\n0 move 0.01 0.02 0.03 over 1"
    )
    last = motion.waypoints[-1]
    assert last.position_m == pytest.approx((-0.02, 0.03, -0.01))  # right, up, to the operator
    assert last.push_n == pytest.approx((-2.0, 3.0, -1.0))
    assert last.stiffness_n_m == pytest.approx((200.0, 300.0, 100.0))
    assert (last.gripped, last.buttons, last.docked) == (True, 0, False)


def test_a_move_is_the_one_of_least_jerk():
    motion = motion_of("1 move 0.1 0 0 over 2")
    assert position_at(motion, 0.9) == (0.0, 0.0, 0.0)
    for share in (0.1, 0.25, 0.5, 0.8):
        x = 0.1 * (10 * share**3 - 15 * share**4 + 6 * share**5)
        assert position_at(motion, 1.0 + 2.0 * share).x == pytest.approx(x, abs=1e-5)
    assert motion.waypoints[-1].time_s == 3.0
    assert derivatives(motion, 1) == pytest.approx(1.875 * 0.1 / 2.0, rel=0.01)


def test_a_new_goal_in_mid_motion_makes_no_jump():
    plain = motion_of("1 move 0.1 0 0 over 1")
    turned = motion_of("1 move 0.1 0 0 over 1\n1.5 move 0 0.05 0 over 1")
    assert derivatives(turned, 1) <= 1.2 * derivatives(plain, 1)
    assert derivatives(turned, 2) < 2.5 * derivatives(plain, 2)
    assert position_at(turned, 3.0) == pytest.approx((0.0, 0.05, 0.0), abs=1e-12)


def test_without_over_the_pace_is_gentle():
    motion = motion_of("0 move 0.2 0 0")
    assert motion.waypoints[-1].time_s == pytest.approx(2.0)
    assert motion_of("0 move 0.001 0 0").waypoints[-1].time_s == pytest.approx(0.3)


def test_turns():
    motion = motion_of("0 turn 30 -20 40 over 1")
    turn = from_euler_zyx(*motion.waypoints[-1].turn_rad)
    wanted = from_euler_zyx(*map(math.radians, (30.0, -20.0, 40.0)))
    assert rotation_to_hand(turn) == pytest.approx(wanted)


def test_pure_turns_are_about_the_axis_they_name():
    # Forward is -z of the device, left is -x, up is y.
    for axis, (index, sign) in {0: (2, -1.0), 1: (0, -1.0), 2: (1, 1.0)}.items():
        angles = [0.0, 0.0, 0.0]
        angles[axis] = 25.0
        motion = motion_of(f"0 turn {angles[0]} {angles[1]} {angles[2]} over 1")
        turned = [0.0, 0.0, 0.0]
        turned[index] = sign * math.radians(25.0)
        assert motion.waypoints[-1].turn_rad == pytest.approx(turned, abs=1e-12)


def test_a_swing_starts_and_ends_at_rest_and_reaches_its_amplitude():
    motion = motion_of("1 swing 0.03 0 0 0 0 30 over 2 times 2")
    assert position_at(motion, 1.5).x == pytest.approx(0.03, abs=1e-6)
    assert position_at(motion, 2.5).x == pytest.approx(-0.03, abs=1e-6)
    assert position_at(motion, 4.5).x == pytest.approx(-0.03, abs=1e-6)
    assert position_at(motion, 5.0) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert abs(position_at(motion, 1.02).x) < 1e-5
    assert derivatives(motion, 2) < 1.5


def test_a_circle_goes_round_its_center_counterclockwise():
    motion = motion_of("0 move 0.03 0 -0.02 over 0.5\n1 circle -0.02 0 over 4")
    moving = [p for p in motion.waypoints if 1.0 < p.time_s < 5.0]
    for point in moving:
        x, y, z = to_hand(point.position_m)
        assert math.hypot(x - 0.01, y) == pytest.approx(0.02)
        assert z == pytest.approx(-0.02)
    assert position_at(motion, 3.0) == pytest.approx((-0.01, 0.0, -0.02), abs=1e-9)
    assert position_at(motion, 2.5).y > 0.0 > position_at(motion, 3.5).y  # left first
    assert position_at(motion, 5.0) == pytest.approx((0.03, 0.0, -0.02))


def test_drawing_keeps_the_height_and_shares_the_time_by_length():
    motion = motion_of("0 move 0 0 -0.02 over 1\n2 draw 0.03 0 0.03 0.01 over 4")
    assert position_at(motion, 5.0) == pytest.approx((0.03, 0.0, -0.02))
    assert position_at(motion, 3.5) == pytest.approx((0.015, 0.0, -0.02), abs=1e-6)
    assert motion.waypoints[-1].time_s == pytest.approx(6.0)
    assert position_at(motion, 6.0) == pytest.approx((0.03, 0.01, -0.02))


def test_a_move_ends_a_drawing():
    motion = motion_of("0 draw 0.03 0 0.03 0.03 0 0.03 over 3\n1.5 move 0 0 0 over 1")
    assert motion.waypoints[-1].time_s == pytest.approx(2.5)
    assert position_at(motion, 2.5) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_buttons_and_grip():
    motion = motion_of("1 press 1\n1.2 click 2\n1.5 release 1\n2 grip off\n3 grip on")
    levels = {p.time_s: (p.buttons, p.gripped) for p in motion.waypoints}
    assert levels == {
        0.0: (0, True),
        1.0: (1, True),
        1.2: (3, True),
        1.3: (1, True),
        1.5: (0, True),
        2.0: (0, False),
        3.0: (0, True),
    }


def test_a_flag_changes_in_the_middle_of_a_motion():
    motion = motion_of("0 move 0 0.05 0 over 1\n0.5034 grip off")
    held = [p.gripped for p in motion.waypoints if p.time_s < 0.5034]
    let_go = [p.gripped for p in motion.waypoints if p.time_s >= 0.5034]
    assert all(held)
    assert not any(let_go)


def test_docking():
    motion = motion_of("1 dock over 2\n2 press 1\n5 undock")
    docked = {p.time_s: (p.docked, p.buttons) for p in motion.waypoints}
    assert docked[2.0] == (False, 1)
    assert docked[3.0] == (True, 1)
    assert docked[5.0] == (False, 1)
    assert position_at(motion, 3.0) == pytest.approx(to_hand(INKWELL_M))
    (first, *_) = motion_of("0 dock\n3 undock").waypoints
    assert (first.docked, first.position_m) == (True, pytest.approx(INKWELL_M))


def test_loop():
    motion = motion_of("0 move 0.02 0 0 over 1\n1.5 move 0 0 0 over 1\n3 loop")
    assert motion.loop_s == 3.0
    assert motion.waypoints[-1].time_s == 3.0
    assert motion_of("1 click 1").loop_s is None


def test_an_empty_script_holds_still():
    (only,) = motion_of("").waypoints
    assert only.position_m == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 move 0.1 0", "Z is missing"),
        ("1 move 0.3 0 0", "must be a number from -0.25 to 0.25"),
        ("1 move 0 0 0 over 0", "SECONDS is '0', must be a number from 0.02"),
        ("1 move 0 0 0 quickly", "'quickly' is too much"),
        ("1 turn 90 0 0", "from -80 to 80"),
        ("1 swing 0.1 0 0", "'over' is missing"),
        ("1 swing 0.1 0 0 over 1 times 0", "N is '0'"),
        ("1 draw 0.1 over 1", "Y is 'over'"),
        ("1 draw over 1", "X is 'over'"),
        ("1 draw 0.1 0", "'over' is missing"),
        ("1 stiffness -1 0 0", "KX is '-1'"),
        ("1 push 0 0 nan", "FZ is 'nan'"),
        ("1 press 3", "'3' must be 1 or 2"),
        ("1 click", "1|2 is missing"),
        ("1 grip tight", "must be on or off"),
        ("1 undock now", "'now' is too much"),
        ("1 dance", "after the time comes one of"),
        ("0 loop", "must be the last step, after 0 s"),
        ("1 loop\n2 click 1", "must be the last step"),
        ("0 move 0.1 0 0 over 1\n3 loop", "must be as it was at the start"),
        ("0.5 press 1\n3 loop", "must be as it was at the start"),
        ("0 move 0.25 0 0\n3 circle 0.25 0 over 1", "more than 0.5 m away"),
    ],
)
def test_what_is_wrong_with_a_script(text, words):
    with pytest.raises(ScriptError) as raised:
        motion_of(text)
    assert words in str(raised.value)


components = st.floats(-0.2, 0.2).map(lambda x: round(x, 3))


@given(
    st.lists(
        st.tuples(components, components, components, st.floats(0.3, 2.0), st.floats(0.05, 1.5)),
        min_size=1,
        max_size=5,
    )
)
def test_whatever_the_goals_the_way_is_smooth_and_gets_there(goals):
    time_s, steps = 0.0, []
    for x, y, z, over_s, wait_s in goals:
        steps.append(f"{time_s:.3f} move {x} {y} {z} over {over_s:.3f}")
        time_s += wait_s
    try:
        motion = motion_of("\n".join(steps))
    except ScriptError as error:
        if "more than 0.5 m away" not in str(error):
            raise
        reject()  # A fast motion that turns back slowly would swing far out.
    times = [p.time_s for p in motion.waypoints]
    assert all(b > a for a, b in itertools.pairwise(times))
    assert to_hand(motion.waypoints[-1].position_m) == pytest.approx(goals[-1][:3], abs=1e-9)
    OmniSettings(motion=motion)
    steepest = max(
        math.dist(a.position_m, b.position_m) for a, b in itertools.pairwise(motion.waypoints)
    )
    # 0.7 m in 0.3 s, plus the overshoot of the reversal.
    assert steepest <= 0.01 * 6.0 * 0.7 / 0.3


@pytest.mark.parametrize("name", SCRIPTS)
def test_built_in_scripts_stay_where_a_device_is_good(name):
    motion = load_motion(name)
    assert OmniSettings(motion=motion).text
    for point in motion.waypoints:
        if name != "inkwell":
            placed = zip(to_hand(point.position_m), USABLE_M, strict=True)
            assert all(abs(x) <= limit for x, limit in placed)
    if len(motion.waypoints) > 1:
        assert derivatives(motion, 1) < 0.5
        assert motion.waypoints[-1].buttons == 0
        assert motion.waypoints[-1].stiffness_n_m != (0.0, 0.0, 0.0)


def test_the_drawing_is_a_square_and_a_circle_pressed_down():
    motion = load_motion("drawing")
    drawn = []
    for point in motion.waypoints:
        if to_hand(point.push_n).z == pytest.approx(-0.7):
            assert point.stiffness_n_m == pytest.approx((300.0, 0.0, 300.0), abs=1e-9)
            drawn.append(to_hand(point.position_m))
    xs, ys, zs = zip(*drawn, strict=True)
    assert (min(xs), max(xs)) == pytest.approx((-0.03, 0.03))
    assert (min(ys), max(ys)) == pytest.approx((-0.03, 0.03))
    assert {round(z, 6) for z in zs} == {-0.017}
    path_m = sum(math.dist(a, b) for a, b in itertools.pairwise(drawn))
    assert path_m == pytest.approx(
        0.24 + math.tau * 0.02 + math.dist((0.03, 0.03), (0.02, 0)), 0.01
    )
    presses = [b.buttons and not a.buttons for a, b in itertools.pairwise(motion.waypoints)]
    assert sum(map(bool, presses)) == 2


def test_the_stylus_is_let_go_in_flight():
    motion = load_motion("let-go")
    index = next(i for i, p in enumerate(motion.waypoints) if not p.gripped)
    a, b = motion.waypoints[index - 1 : index + 1]
    assert math.dist(a.position_m, b.position_m) / (b.time_s - a.time_s) > 0.3


def test_a_script_in_a_file(tmp_path):
    (tmp_path / "mine").write_text("0.5 move 0.01 0 0 over 1\n", encoding="utf-8")
    assert load_motion(str(tmp_path / "mine"), 300.0).waypoints[0].stiffness_n_m == (300.0,) * 3
    with pytest.raises(ScriptError, match="drawing"):
        load_motion("nope")
