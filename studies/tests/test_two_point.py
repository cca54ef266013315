"""Two-point trajectories: against scripted replies, and in the driver's session."""

import pytest

from cardan.conform.motoros_driver import simulated
from cardan.drivers.motoros.motion_control import MotionPhase
from cardan.drivers.motoros.trajectory_limiter import JointTrajectoryLimiter
from cardan.protocols.simple_message.messages import joints10
from studies.motoros.two_point import TwoPointMoves, TwoPointSession, two_point_time_s
from tests.conform.test_motoros_driver import (
    test_a_client_of_trajectories_meets_what_concerns_it as meets_what_concerns_it,
)
from tests.drivers import test_motoros_session as driver_session
from tests.drivers.motoros_bench import SessionBench
from tests.drivers.test_motoros_streaming import HOME, LIMITS, Bench, moved
from tests.test_motoros_faults import AT_ONCE, assert_rests_until_enabled_anew


def at_goal(bench):
    bench.position = list(bench.accepted()[-1].pos[:6])


def test_every_goal_is_one_trajectory_from_rest_to_rest():
    bench = Bench(TwoPointMoves).start()
    assert bench.points == []
    for _ in range(40):
        bench.now_s += 0.025
        bench.publish()
        bench.run(1e-3, moved(0.2))
        if len(bench.points) == 2:
            break
    (_, first, _), (_, second, _) = bench.points
    assert (first.sequence, second.sequence) == (0, 1)
    assert first.vel == second.vel == joints10(())
    assert first.pos[:6] == pytest.approx(HOME, abs=1e-6)
    # During a motion no other one is begun, however many goals arrive.
    for _ in range(10):
        bench.now_s += 0.025
        bench.publish(in_motion=1)
        bench.run(1e-3, moved(0.3))
    assert len(bench.points) == 2
    at_goal(bench)
    for _ in range(10):
        bench.now_s += 0.1
        bench.publish()
        bench.run(1e-3, moved(0.3))
    assert bench.accepted()[2].pos == second.pos
    assert bench.accepted()[-1].pos[0] > second.pos[0]


def test_the_same_goal_is_not_moved_to_again():
    bench = Bench(TwoPointMoves).start()
    for _ in range(10):
        bench.now_s += 0.025
        bench.publish()
        bench.run(1e-3, moved(0.0))
    assert bench.points == []


def test_a_controller_that_is_not_ready_gets_no_point():
    bench = Bench(TwoPointMoves).start()
    bench.ready = False
    bench.now_s += 0.025
    bench.publish()
    bench.run(2e-3, moved(0.2))
    bench.run(2e-3, moved(0.2))
    assert bench.points == []
    assert "servo" in bench.motion.ended.lower()


def test_the_time_of_a_move_keeps_speed_and_acceleration():
    for way in (1e-4, 0.01, 0.3, 2.5):
        time_s = two_point_time_s([0.0] * 6, [way] + [0.0] * 5, JointTrajectoryLimiter(*LIMITS))
        assert 1.5 * way / time_s <= 2.0 + 1e-9
        assert 6.0 * way / time_s**2 <= 10.0 + 1e-9
    assert two_point_time_s([0.0] * 6, [0.0] * 6, JointTrajectoryLimiter(*LIMITS)) == 0.0


@pytest.mark.parametrize(
    "test",
    [
        driver_session.test_enabling_makes_a_new_session_whose_commands_move_the_robot,
        driver_session.test_unanswered_states_are_holds,
        driver_session.test_braking_that_nobody_answers_ends_all_the_same,
        driver_session.test_leaving_ends_at_rest_and_in_time,
    ],
)
def test_its_session_does_what_the_drivers_does(test, monkeypatch):
    monkeypatch.setattr(SessionBench, "kind_of_session", TwoPointSession)
    test(mode="stream")


def way_commanded(faults):
    run = driver_session.turning(driver_session.bench("stream", faults=faults).ready()).run(0.8)
    run.trace.clear()
    run.run(1.0)
    assert run.session.control.enabled
    (begin_s, begin, _), (end_s, end, _) = run.trace[0], run.trace[-1]
    # Each trajectory is from rest to rest: the speed is kept on average, and at no moment.
    assert (end - begin) / (end_s - begin_s) == pytest.approx(0.4, rel=0.05)
    return list(dict.fromkeys(position for _, position, _ in run.trace))


@pytest.mark.parametrize("fault", ["split", "merge", "strict-recv"])
def test_how_bytes_are_cut_makes_no_difference(fault, monkeypatch):
    monkeypatch.setattr(SessionBench, "kind_of_session", TwoPointSession)
    way = way_commanded({})
    assert len(way) > 200
    assert way_commanded({fault: 1.0}) == way


@pytest.mark.parametrize("event", AT_ONCE)
def test_what_the_controller_stops_for(event, monkeypatch):
    monkeypatch.setattr(SessionBench, "kind_of_session", TwoPointSession)
    act, words = AT_ONCE[event]
    run = driver_session.turning(driver_session.bench("stream").ready()).run(0.5)
    act(run.controller, run.now_s)
    run.run(0.06)
    assert not run.session.control.enabled
    run.run(0.3)
    assert words in run.states[-1].hold_reason
    assert_rests_until_enabled_anew(run)


def test_a_robot_slowed_by_its_safety_unit_goes_on(monkeypatch):
    monkeypatch.setattr(SessionBench, "kind_of_session", TwoPointSession)
    run = driver_session.bench("stream", faults={"fsu": 0.02}).ready()
    driver_session.turning(run, 1.0).run(1.0)
    assert run.session.control.enabled
    fastest = max(speed for _, speed in driver_session.commanded_speeds(run, 0.04))
    assert fastest == pytest.approx(0.02 * run.peer_options.axis_speeds[0], rel=0.1)


@pytest.mark.parametrize("times", [1, 3, 1000])
def test_a_refused_first_point_is_followed_by_no_other(times, monkeypatch):
    monkeypatch.setattr(SessionBench, "kind_of_session", TwoPointSession)
    driver_session.test_a_refused_first_point_is_followed_by_no_other(times)


def test_disabling_leaves_the_mode(monkeypatch):
    monkeypatch.setattr(SessionBench, "kind_of_session", TwoPointSession)
    run = driver_session.turning(driver_session.bench("stream").ready()).run(0.5)
    run.trace.clear()
    run.session.disable(run.now_s)
    run.run(1.5)
    assert run.session.phase is MotionPhase.IDLE
    assert "disabled" in run.states[-1].hold_reason
    assert driver_session.commanded_speeds(run)[-1][1] == 0.0
    assert run.controller.active_mode != 2
    assert not run.controller.ready


def test_a_client_that_sends_them_meets_what_concerns_it(monkeypatch):
    monkeypatch.setattr(simulated, "MotorosSession", TwoPointSession)
    meets_what_concerns_it()
