"""The session against the simulated controller, in virtual time."""

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings, strategies as st

from cardan.drivers.motoros.feedback import StateFeed
from cardan.drivers.motoros.motion import START_TRIES
from cardan.drivers.motoros.motion_control import STOP_TRIES, MotionPhase
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.session import MotorosSession
from cardan.errors import CommandError
from cardan.protocols.simple_message.codec import WireFormat, wire
from cardan.protocols.simple_message.codes import MotionCommand
from cardan.protocols.simple_message.framing import ByteOrder
from cardan.protocols.simple_message.messages import ZEROS, JointFeedback, RobotStatus, topic
from cardan.robots import load_arm
from cardan.types import (
    IDENTITY_POSE,
    CommandKind,
    JointCommand,
    JointVelocityCommand,
    PoseCommand,
    RobotLink,
)
from tests.drivers.motoros_bench import SessionBench
from tests.examples import examples

HOME = load_arm("gp8").home
MODES = ("velocity", "stream")
STATUS = RobotStatus(1, 0, 0, 0, 0, 2, 1)


def bench(mode="auto", answer=None, start_s=100.0, driver=None, **controller):
    return SessionBench(
        {"mode": mode, **(driver or {})}, answer, start_s, tick_s=1e-3, **controller
    )


def turning(bench, speed=0.4):
    """Return a session whose joint 1 turns at `speed`, rad/s."""
    bench.answer = lambda state: JointVelocityCommand((speed,) + (0.0,) * 5)
    return bench


def commanded_speeds(bench, of=0.004):
    """Return the speeds of joint 1 that the controller commands, over steps of `of` s."""
    found, (then, where) = [], bench.trace[0][:2]
    for now, position, _ in bench.trace:
        if now - then >= of - 1e-9:
            found.append((now, (position - where) / (now - then)))
            then, where = now, position
    return found


# -- connecting -----------------------------------------------------------------------------------


def test_after_connecting_it_asks_and_starts_nothing():
    run = bench("auto").run(1.0)
    session = run.session
    assert session.phase is MotionPhase.IDLE
    assert session.control.velocity_info.axes == 6
    assert not session.control.enabled
    texts = " ".join(text for _, text in run.controller.events)
    assert "START" not in texts
    assert {state.link for state in run.states[5:]} == {RobotLink.LIVE}
    assert "not enabled" in run.states[-1].hold_reason
    assert run.states[-1].joints == pytest.approx(run.controller.measured_rad(0), abs=1e-6)
    assert run.servers.counters.pipelined == 0


def test_an_idle_connection_is_checked_every_second_and_its_loss_is_named():
    run = bench("auto").ready()
    run.session.stop(run.now_s)
    requests = run.session.control.requests
    run.run(0.1)
    asked_s = set()
    run.run(4.0, until=lambda: asked_s.add(requests.asked_s))
    gaps = [after - before for before, after in pairwise(sorted(asked_s))]
    assert gaps == pytest.approx([1.0] * 4, abs=0.01)
    run.servers.data = lambda key, data, now_s: None
    words = "no reply to CHECK_MOTION_READY for 0.5 s"
    run.run(2.0, until=lambda: words in run.states[-1].hold_reason)
    assert words in run.states[-1].hold_reason


def test_states_come_at_least_every_tenth_of_a_second():
    for run in (bench("stream").run(2.0), bench("stream")):
        if not run.states:
            run.reachable = False
            run.run(2.0)
            assert {state.link for state in run.states} == {RobotLink.WAITING}
            assert "refused" in run.states[-1].hold_reason
            assert run.session.diagnosis(run.now_s)[0] == run.states[-1].hold_reason
        stamps = [state.stamp_s for state in run.states]
        gaps = [b - a for a, b in pairwise(stamps)]
        assert max(gaps) <= 0.1 + 1e-6
        assert min(gaps) > 0.02  # one for each status, and none twice


def test_a_refused_connection_is_tried_again_later_and_later():
    session = MotorosSession(MotorosOptions())
    tried, now_s = [], 10.0
    while now_s < 20.0:
        session.advance(now_s)
        if session.wants("state", now_s):
            tried.append(now_s)
            session.connect_failed("state", "Connection refused", now_s)
        now_s += 0.01
    gaps = [b - a for a, b in pairwise(tried)]
    assert gaps[:4] == pytest.approx([0.25, 0.5, 1.0, 2.0], abs=0.02)
    assert gaps[4:] == pytest.approx([2.0] * len(gaps[4:]), abs=0.02)
    assert not session.wants("motion", now_s)


@pytest.mark.parametrize("big_endian", [False, True])
def test_the_byte_order_is_the_state_ports(big_endian):
    run = turning(bench(big_endian=big_endian).ready()).run(0.5)
    assert run.session.feed.byte_order is (ByteOrder.BIG if big_endian else ByteOrder.LITTLE)
    assert commanded_speeds(run, 0.02)[-1][1] == pytest.approx(0.4, rel=0.05)


def test_a_byte_order_that_is_reported_wrongly_is_named():
    run = bench("stream", driver={"byte_order": "big"}).run(1.0)
    assert run.session.phase is MotionPhase.DOWN
    assert any("prefix" in words for words in run.session.diagnosis(run.now_s))


def test_reals_of_eight_bytes_are_not_motoros():
    feed = StateFeed(MotorosOptions())
    body = JointFeedback(0, 2, 0.0, ZEROS, ZEROS, ZEROS)
    feed.received(WireFormat(ByteOrder.LITTLE, 8).encode(topic(body)), 1.0)
    assert "8 bytes" in feed.failure
    assert not feed.heard


def test_a_stock_controller_is_streamed_to():
    run = bench("auto", velocity_mode=False).ready()
    assert run.session.control.velocity_info is None
    assert run.states[-1].period_s == pytest.approx(0.020)
    assert run.session.capabilities.period_s == pytest.approx(0.020)


def test_velocity_mode_is_refused_in_words_where_there_is_none():
    run = bench("velocity", velocity_mode=False).run(0.5)
    run.session.enable(run.now_s)
    run.run(0.5)
    assert run.session.phase is MotionPhase.IDLE
    assert "no velocity mode" in run.states[-1].hold_reason


def test_another_group_than_there_is_gives_no_state():
    run = bench("stream", driver={"group": 2}).run(1.0)
    assert run.states[-1].link is RobotLink.WAITING
    assert "group 2" in run.states[-1].hold_reason


def test_the_second_of_two_groups_is_moved_alone():
    run = bench("stream", driver={"group": 1}, groups=2).ready()
    turning(run).run(0.5)
    start = run.peer_options.arm.home
    assert run.controller.command_rad(0) == pytest.approx(start, abs=1e-3)
    assert run.controller.command_rad(1)[0] > start[0] + 0.1


# -- motion ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_enabling_makes_a_new_session_whose_commands_move_the_robot(mode):
    run = bench(mode).run(0.5)
    before = run.session.sessions
    run.ready()
    assert (before, run.session.sessions) == (1, 2)
    start = run.controller.measured_rad(0)
    target = (start[0] + 0.2, start[1] - 0.1, *start[2:])
    run.answer = lambda state: JointCommand(target)
    run.run(3.0)
    assert run.controller.measured_rad(0) == pytest.approx(target, abs=3e-4)
    assert run.session.control.enabled
    assert run.servers.counters.pipelined == 0
    run.session.disable(run.now_s)
    run.run(1.0)
    run.ready()
    jitter = run.session.jitter
    assert jitter.count > 50
    assert jitter.max < 0.05, "the pause between two starts is none"


@pytest.mark.parametrize("mode", MODES)
def test_added_latency_is_small(mode):
    """Latency from a control instant to the middle of the motion commanded for it."""
    run = bench(mode).ready()
    start_s, home = run.now_s, run.states[-1].joints
    run.trace.clear()

    def goal(time_s):
        return 0.2 * (1.0 - math.cos(math.pi * 0.5 * time_s))

    def answer(state):
        time_s = state.stamp_s - start_s
        speed = 0.2 * 0.5 * math.pi * math.sin(math.pi * 0.5 * time_s)
        return JointCommand((home[0] + goal(time_s), *home[1:]), (speed,) + (0.0,) * 5)

    run.answer = answer
    run.run(4.0)
    rows = [(t - start_s, p - home[0]) for t, p, _ in run.trace[::10] if t - start_s > 1.0]

    def error(lag_s):
        return sum((goal(t - lag_s) - p) ** 2 for t, p in rows)

    lag_s = min((1e-3 * ms for ms in range(100)), key=error)
    assert lag_s <= (0.010 if mode == "velocity" else 0.040)
    assert run.session.control.counters.underruns == 0


@pytest.mark.parametrize("mode", MODES)
def test_what_is_commanded_keeps_the_limits_whatever_is_asked(mode):
    run = bench(mode).ready()
    arm = run.peer_options.arm
    run.trace.clear()
    run.answer = lambda state: JointVelocityCommand(
        (99.0 if state.sequence % 40 < 20 else -99.0,) * 6
    )
    run.run(2.0)
    pulse = 1.0 / 30_000.0 / 0.004
    speeds = [speed for _, speed in commanded_speeds(run)]
    assert max(map(abs, speeds)) <= arm.velocity[0] + 2 * pulse
    for joint, position in zip(arm.joints, run.controller.command_rad(0), strict=True):
        assert joint.lower - 1e-4 <= position <= joint.upper + 1e-4
    assert run.session.control.enabled


@pytest.mark.parametrize("mode", MODES)
def test_unanswered_states_are_holds(mode):
    run = bench(mode).ready()
    where = run.controller.command_rad(0)
    run.run(1.0)
    assert run.controller.command_rad(0) == pytest.approx(where, abs=1e-4)
    assert run.session.control.enabled


def test_at_start_motion_is_enabled_once_and_never_again():
    run = bench("stream", driver={"enable": "at-start"}).run(2.0)
    assert run.session.control.enabled
    run.unplug("motion")
    run.run(4.0)
    assert run.session.phase is MotionPhase.IDLE
    assert "enable" in run.states[-1].hold_reason


def test_enabling_without_a_connection_is_refused_and_not_remembered():
    run = bench("stream")
    run.reachable = False
    run.run(0.5)
    run.session.enable(run.now_s)
    run.reachable = True
    run.run(4.0)
    assert run.session.phase is MotionPhase.IDLE


@pytest.mark.matrix("stream")
@pytest.mark.parametrize("mode", MODES)
def test_the_guide_and_the_robot_agree_after_rest(mode):
    """Integrated velocities drift by fractions of a period; rest corrects this."""
    run = bench(mode).ready()
    start = run.states[-1].joints
    run.answer = lambda state: JointVelocityCommand((0.7 if state.sequence % 30 < 15 else 0.1,) * 6)
    run.run(1.0)
    target = (start[0] + 0.1, *start[1:])
    run.answer = lambda state: JointCommand(target)
    run.run(3.0)
    assert run.controller.measured_rad(0) == pytest.approx(target, abs=3e-4)


# -- causes of its end ----------------------------------------------------------------------------


def test_a_start_that_is_refused_says_why():
    run = bench("stream").run(0.5)
    run.controller.mode("teach", run.now_s)
    run.run(0.2)
    run.session.enable(run.now_s)
    run.run(6.0)
    assert run.session.phase is MotionPhase.IDLE
    assert "TEACH" in run.states[-1].hold_reason


def misplace(run, times):
    """Offset the arm by 0.005 rad from the client's position at its next `times` points 0; return
    the subcodes in the replies."""
    (group,) = run.controller._groups
    begin, answers = group.begin, []

    def begin_elsewhere(time_s, joints, speeds):
        away = 0.005 if len(answers) < times else 0.0
        answers.append(int(begin(time_s, [q + away for q in joints], speeds)))
        return answers[-1]

    group.begin = begin_elsewhere
    return answers


@pytest.mark.matrix("3")
@pytest.mark.parametrize("times", [1, 3, 1000])
def test_a_refused_first_point_is_followed_by_no_other(times):
    """The controller has stored its target: the next point would make the arm jump there."""
    run = turning(bench("stream").run(1.0))
    answers = misplace(run, times)
    run.session.enable(run.now_s)
    run.run(3.0)
    refused = min(times, START_TRIES + 1)
    assert answers[:refused] == [3011] * refused
    assert answers[refused:] == [0] * len(answers[refused:])
    turned = run.controller.command_rad(0)[0] - run.trace[0][1]
    if times == 1000:
        assert turned == 0.0
        assert "30 pulses" in run.states[-1].hold_reason
    else:
        assert turned > 0.2
    assert max(abs(speed) for _, speed in commanded_speeds(run)) < 0.9  # 0.005 in 4 ms: 1.25
    assert run.controller.command_rad(0)[1] == pytest.approx(HOME[1], abs=1e-4)


@pytest.mark.matrix("velocity-merge", "velocity-strict-recv", "stream-split")
@pytest.mark.parametrize(
    "fault",
    [{"split": 1.0}, {"merge": 1.0}, {"strict-recv": 1.0}],
    ids=lambda each: next(iter(each)),
)
@pytest.mark.parametrize("mode", MODES)
def test_how_bytes_are_cut_makes_no_difference(mode, fault):
    run = turning(bench(mode, faults=fault).ready()).run(0.8)
    run.trace.clear()
    run.run(0.2)
    assert run.session.control.enabled
    for _, speed in commanded_speeds(run, 0.04):
        assert speed == pytest.approx(0.4, rel=0.05)
    assert run.controller.command_rad(0)[0] > 0.2


def test_replies_too_late_for_a_stream_end_it_without_a_step_at_rest():
    run = turning(bench("stream", faults={"late": 30.0}).ready(), 0.1).run(4.0)
    assert not run.session.control.enabled
    assert run.session.control.counters.underruns >= 3
    assert "too slow for a stream" in run.session.control.end_reason
    assert run.servers.counters.pipelined == 0
    where = run.controller.command_rad(0)
    run.run(1.0)
    assert run.controller.command_rad(0) == where


def test_garbage_between_states_is_named_and_survived():
    run = bench("stream", faults={"garbage": 0.05}).run(6.0)
    assert run.session.feed.ignored
    assert run.session.protocol_errors()["malformed"] >= 1
    assert run.session.metrics(run.now_s)["reconnects"] >= 1.0
    assert run.states[-1].joints


@pytest.mark.matrix
def test_a_stream_slowed_by_the_safety_unit_is_stretched_and_loses_nothing():
    run = bench("stream", faults={"fsu": 0.02}).ready()
    start = run.states[-1].joints
    target = (start[0] + 0.2, *start[1:])
    run.answer = lambda state: JointCommand(target)
    run.run(0.2 / (0.02 * run.peer_options.axis_speeds[0]))
    assert run.controller.command_rad(0)[0] < target[0] - 1e-3
    run.run(0.2)
    assert run.session.control.enabled
    assert run.controller.command_rad(0) == pytest.approx(target, abs=3e-4)


def test_the_controllers_own_limits_count_where_they_are_narrower():
    run = turning(bench("velocity", speed_limits=(0.3,) * 6).ready(), 2.0)
    run.trace.clear()
    run.run(1.0)
    assert max(speed for _, speed in commanded_speeds(run, 0.04)) <= 0.3 + 1e-3
    assert run.session.control.counters.speed_limited == 0  # the speed limiter had no effect


@pytest.mark.parametrize(
    ("mode", "controller", "words"),
    [
        ("velocity", {"robot": "asibot"}, "axes"),
        ("stream", {"robot": "amor", "start": (0.1,) * 7}, "more axes"),
    ],
)
def test_another_arm_than_the_controllers_is_refused(mode, controller, words):
    run = bench(mode, **controller).run(0.5)
    run.session.enable(run.now_s)
    run.run(0.5)
    assert run.session.phase is MotionPhase.IDLE
    assert not run.session.control.enabled
    assert words in run.states[-1].hold_reason


def test_what_hinders_a_start_is_said_before_it():
    run = bench("stream").run(0.5)
    run.session.feed.other_axis = 8
    assert "axis 8 of group 0 is not at zero" in run.session.control.hold_reason
    run.session.feed.other_axis = 0
    # A value that the controller does not report hinders nothing.
    run.session.feed.status = STATUS._replace(motion_possible=0, mode=-1, drives_powered=0)
    assert run.session.control.hold_reason == "motion is not enabled"
    run.session.feed.status = STATUS._replace(motion_possible=0, e_stopped=1)
    assert "emergency stop" in run.session.control.hold_reason


def test_enabling_while_the_connection_is_set_up_is_for_this_connection_only():
    def greet(run):
        return run.run(1.0, until=lambda: run.session.phase is MotionPhase.GREETING)

    run = greet(bench("stream"))
    run.session.enable(run.now_s)
    run.run(1.0)
    assert run.session.control.enabled
    run = greet(bench("stream"))
    run.session.enable(run.now_s)
    run.unplug("motion")
    run.run(3.0)
    assert run.session.phase is MotionPhase.IDLE


def test_disabling_while_motion_is_being_started():
    run = bench("stream", servo_on=False).run(0.5)
    run.session.enable(run.now_s)
    run.run(0.1)
    assert run.session.phase is MotionPhase.STARTING
    run.session.disable(run.now_s)
    run.run(3.0)
    assert run.session.phase is MotionPhase.IDLE
    assert not run.controller.ready


def test_a_connection_that_is_lost_while_motion_is_being_started():
    run = bench("stream", servo_on=False).run(0.5)
    run.session.enable(run.now_s)
    run.run(0.1)
    run.unplug("motion")
    run.run(4.0)
    assert run.session.phase is MotionPhase.IDLE
    assert "lost" in run.states[-1].hold_reason


@pytest.mark.matrix("velocity")
@pytest.mark.parametrize("mode", MODES)
def test_braking_that_nobody_answers_ends_all_the_same(mode):
    run = turning(bench(mode).ready()).run(0.5)
    run.session.disable(run.now_s)
    received = run.session.received
    run.session.received = lambda channel, data, now_s: (
        received(channel, data, now_s) if channel == "state" else None
    )
    run.run(3.0)
    del run.session.received
    run.run(5.0)
    assert run.session.phase is MotionPhase.IDLE
    where = run.controller.command_rad(0)
    run.run(0.5)
    assert run.controller.command_rad(0) == where


def test_a_refused_end_of_a_mode_is_tried_again_so_often(monkeypatch):
    run = turning(bench("velocity").ready()).run(0.5)
    control, asked = run.session.control, []
    send = control.requests.control
    with monkeypatch.context() as refusing:
        refusing.setattr(control, "_failure", lambda answer: "refused")
        refusing.setattr(
            control.requests,
            "control",
            lambda *request: asked.append((request[0], run.now_s)) or send(*request),
        )
        run.session.disable(run.now_s)
        run.run(3.0, until=lambda: run.session.phase is MotionPhase.IDLE)
    ways = (MotionCommand.STOP_VEL_MODE, MotionCommand.STOP_TRAJ_MODE)
    assert [way for way, _ in asked] == [way for way in ways for _ in range(STOP_TRIES + 1)]
    gaps_s = [after - before for (_, before), (_, after) in pairwise(asked[: STOP_TRIES + 1])]
    assert gaps_s == pytest.approx([0.05] * STOP_TRIES, abs=0.01)
    assert "refused" in run.session.diagnosis(run.now_s)
    # A stop ends these tries, too: none of them disturbs the next start.
    turning(run.ready()).run(0.3)
    run.session.disable(run.now_s)
    with monkeypatch.context() as refusing:
        refusing.setattr(control, "_failure", lambda answer: "refused")
        run.run(5.0, until=lambda: control.phase is MotionPhase.LEAVING and control.requests.idle)
    run.session.stop(run.now_s)
    run.session.enable(run.now_s)
    assert run.ready(0.5).states[-1].ready


@pytest.mark.parametrize("trust", [True, False])
def test_measured_speeds_are_reported_where_they_are_trusted(trust):
    run = turning(bench("velocity", driver={"trust_velocity": trust}).ready()).run(0.5)
    expected = pytest.approx((0.4,) + (0.0,) * 5, abs=0.02) if trust else ()
    assert run.states[-1].velocities == expected


def test_a_robot_that_takes_its_time_is_waited_for():
    """Servos off: the start takes a second, and states continue meanwhile."""
    run = bench("stream", servo_on=False).run(0.5)
    run.session.enable(run.now_s)
    run.states.clear()
    run.run(0.5)
    assert {state.hold_reason for state in run.states} == {MotionPhase.STARTING.value}
    run.run(2.0)
    assert run.session.control.enabled


def test_another_client_that_takes_the_place_is_not_fought_for_ever():
    run = bench("stream").run(1.0)
    taken = 0
    for _ in range(400):
        if "motion" in run.numbers and run.session.phase is MotionPhase.IDLE:
            taken += 1
            run.unplug("motion")
        run.run(0.025)
    assert taken <= 9  # within 10 s, finally at intervals of 2 s


# -- requests -------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_disabling_brakes_along_a_ramp_and_leaves_the_mode(mode):
    run = turning(bench(mode).ready()).run(0.5)
    run.trace.clear()
    run.session.disable(run.now_s)
    run.run(1.5)
    assert run.session.phase is MotionPhase.IDLE
    assert "disabled" in run.states[-1].hold_reason
    assert commanded_speeds(run)[-1][1] == 0.0
    assert run.controller.active_mode != 2
    if mode != "velocity":
        assert not run.controller.ready
    if mode == "stream":
        steps = [speed for _, speed in commanded_speeds(run)]
        limit = run.options.limits.acceleration[0] * 0.004
        drops = [a - b for a, b in pairwise(steps)]
        assert max(drops) <= 1.3 * limit + 0.02


def test_stop_is_at_once():
    run = turning(bench("stream").ready()).run(0.5)
    run.session.stop(run.now_s)
    run.run(0.03)
    where = run.controller.command_rad(0)
    run.run(1.0)
    assert run.controller.command_rad(0) == where
    assert "stopped" in run.states[-1].hold_reason
    run.session.stop(run.now_s)
    ((_, sent),) = run.session.outgoing()  # In case the arm moves despite that.
    assert MotionCommand.STOP_MOTION.to_bytes(4, "little") in sent
    run.run(0.1)
    run.unplug("state")
    run.run(0.001)
    assert run.states[-1].link is RobotLink.LOST


def test_servos_and_alarms():
    run = bench("stream", servo_on=False).run(0.5)
    run.session.ask("servo on", run.now_s)
    run.run(3.0)
    assert run.controller.status().drives_powered == 1
    run.controller.alarm(4107, run.now_s)
    run.run(0.1)
    assert any("4107" in words for words in run.session.diagnosis(run.now_s))
    run.session.ask("reset alarm", run.now_s)
    run.run(1.0)
    assert run.controller.status().in_error == 0
    run.session.ask("servo off", run.now_s)
    run.run(1.0)
    assert run.controller.status().drives_powered == 0
    run.ready()
    turning(run).run(0.3)
    run.session.ask("servo off", run.now_s)
    run.run(2.0)
    assert run.controller.status().drives_powered == 0
    assert not run.session.control.enabled


@pytest.mark.parametrize("mode", MODES)
def test_leaving_ends_at_rest_and_in_time(mode):
    run = turning(bench(mode).ready()).run(0.5)
    run.session.leave(run.now_s)
    began_s = run.now_s
    run.run(2.0, until=lambda: run.session.control.left)
    assert run.now_s - began_s < 1.5
    run.run(0.02)
    where = run.controller.command_rad(0)
    run.run(0.5)
    assert run.controller.command_rad(0) == where


# -- commands -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (PoseCommand(IDENTITY_POSE), "pose"),
        (JointCommand((0.0,) * 5), "5 values for 6"),
        (JointCommand((math.nan,) * 6), "finite"),
        (JointCommand((0.0,) * 6, (0.0,) * 7), "velocities"),
        (JointCommand((0.0,) * 6, None, (1.0,)), "external_axes"),
        (JointVelocityCommand((math.inf,) * 6), "finite"),
    ],
)
@pytest.mark.parametrize("ready", [True, False])
def test_a_command_that_cannot_be_is_refused_and_changes_nothing(command, words, ready):
    run = bench("velocity")
    if ready:
        run.ready()
    sent = run.session.control.counters.commands
    with pytest.raises(CommandError, match=words):
        run.session.command(command, run.now_s)
    assert run.session.control.counters.commands == sent


def test_capabilities():
    able = MotorosSession(MotorosOptions(mode="velocity", speed_share=0.5)).capabilities
    assert able.commands == {CommandKind.HOLD, CommandKind.JOINT, CommandKind.JOINT_VELOCITY}
    assert able.period_s == 0.004
    assert able.joints == 6
    assert able.lag_s == 0.4
    assert able.limits.velocity[0] == pytest.approx(0.5 * 7.9412)
    given = MotorosOptions(velocity_rad_s=(0.5,) * 6, acceleration_rad_s2=(0.7,) * 6).limits
    assert (given.velocity, given.acceleration) == ((0.5,) * 6, (0.7,) * 6)


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"mode": "pose"}, "mode"),
        ({"enable": "always"}, "enable"),
        ({"group": 4}, "group"),
        ({"watchdog_ms": 10}, "watchdog_ms"),
        ({"command_period_s": 0.05, "watchdog_ms": 100}, "watchdog_ms"),
        ({"point_spacing_s": 0.004}, "point_spacing_s"),
        ({"ipc_s": 0.0015}, "ipc_s"),
        ({"speed_share": 0.0}, "speed_share"),
        ({"velocity_rad_s": (1.0,) * 5}, "velocity_rad_s"),
        ({"acceleration_rad_s2": (1.0, 1.0, 1.0, 1.0, 1.0, math.nan)}, "acceleration_rad_s2"),
        ({"robot": "nobody"}, "robot"),
        ({"state_port": 50240}, "state_port"),
        ({"request_timeout_s": math.inf}, "request_timeout_s"),
        ({"host": ""}, "host"),
        ({"lag_s": 3.0}, "lag_s"),
        ({"queue_low": True}, "queue_low"),
        ({"queue_low": 60, "ipc_s": 0.01, "point_spacing_s": 0.02}, "queue_low"),
    ],
)
def test_options_that_cannot_be_are_named(options, key):
    with pytest.raises(ValueError, match=f"^{key}"):
        MotorosOptions(**options)


# -- bad bytes ------------------------------------------------------------------------------------


def test_another_protocol_at_the_state_port_is_said():
    feed = StateFeed(MotorosOptions())
    feed.received(b"SSH-2.0-OpenSSH_9.6\r\n", 1.0)
    assert "it does not speak MotoROS; is state_port the controller's?" in feed.failure


def test_a_feedback_that_no_robot_measures_is_ignored():
    feed = StateFeed(MotorosOptions(trust_velocity=True))

    def hear(first, speed, now_s):
        body = JointFeedback(0, 6, 0.0, (first, *ZEROS[1:]), (speed, *ZEROS[1:]), ZEROS)
        feed.received(wire().encode(topic(body)), now_s)

    hear(0.5, 0.1, 1.0)
    assert (feed.positions[0], feed.velocities[0]) == (0.5, pytest.approx(0.1))
    hear(-2001.0, 0.1, 1.1)
    assert (feed.positions[0], feed.feedback_s) == (0.5, 1.0)
    assert feed.ignored == {"a feedback that is beyond any joint's range": 1}
    hear(0.5, 1e9, 1.2)
    assert (feed.velocities, feed.feedback_s) == ((), 1.2)


@pytest.mark.parametrize("good", ["status", "feedback"])
def test_bad_messages_in_a_row_end_a_connection(good):
    feed = StateFeed(MotorosOptions())
    body = JointFeedback(0, 6, 0.0, ZEROS, ZEROS, ZEROS)
    bad, fine = body._replace(valid_fields=0), STATUS if good == "status" else body
    for end in (feed.connected, lambda: feed.received(wire().encode(topic(fine)), 1.0), None):
        for _ in range(7):
            feed.received(wire().encode(topic(bad)), 1.0)
        assert not feed.failure
        if end is not None:
            end()
    feed.received(wire().encode(topic(bad)), 1.0)
    assert "8 bad messages" in feed.failure


@settings(max_examples=examples(60))
@given(st.lists(st.tuples(st.booleans(), st.binary(max_size=200)), max_size=8))
def test_arbitrary_bytes_never_raise_and_send_no_command(pieces):
    session, now_s = MotorosSession(MotorosOptions()), 10.0
    body = JointFeedback(0, 2, 0.0, ZEROS, ZEROS, ZEROS)
    for motion, data in pieces:
        for channel in ("state", "motion"):
            if session.wants(channel, now_s):
                session.connected(channel, now_s)
                if channel == "state":
                    for each in (body, STATUS):
                        session.received("state", wire().encode(topic(each)), now_s)
        session.received("motion" if motion else "state", data, now_s)
        session.advance(now_s)
        session.due_state(now_s)
        session.outgoing()
        now_s += 0.3
    assert session.control.counters.commands == 0
    assert not session.control.enabled
