"""Faults between the MotoROS driver and its controller: the driver stops, and reports the reason.

The rows of the tables in docs/motoman.md and docs/protocols/simple-message.md, with the
bytes of the wire between both sides and time as an argument.
"""

from __future__ import annotations

import numpy as np
import pytest

from cardan.protocols.simple_message.codes import ActiveMode
from cardan.types import JointVelocityCommand, RobotLink
from tests.drivers.motoros_bench import SessionBench

SPEED = 0.3
IPC_S = 0.004
MODES = ("velocity", "stream")
ACCELERATION = 5.0
ONE_PULSE = 1.0
"""rad/s² that a commanded speed of whole pulses seems to have."""


def moving(mode, faults=None, **driver):
    """Return a robot that has turned joint 1 at SPEED for half a second."""
    bench = SessionBench(
        {"mode": mode, "acceleration_rad_s2": (ACCELERATION,) * 6, **driver},
        lambda state: JointVelocityCommand((SPEED, 0.0, 0.0, 0.0, 0.0, 0.0)),
        faults=faults or {},
        acceleration_limits=(ACCELERATION,) * 6,
    )
    bench.ready()
    bench.run(0.6)
    assert speed(bench) == pytest.approx(SPEED, rel=0.05)
    return bench


def speed(bench, window_s=0.02):
    """Return the speed of the controller's command over the last periods."""
    times = np.array([row[0] for row in bench.trace])
    command = np.array([row[1] for row in bench.trace])
    first = int(np.searchsorted(times, times[-1] - window_s))
    return (command[-1] - command[first]) / (times[-1] - times[first])


def hardest(bench, since_s):
    """Return the largest change of the commanded speed between interpolation periods, rad/s²."""
    times = np.array([row[0] for row in bench.trace])
    command = np.array([row[1] for row in bench.trace])
    grid = np.arange(since_s - 0.1, times[-1], IPC_S)
    held = command[np.searchsorted(times, grid, "right") - 1]
    return np.abs(np.diff(held, 2)).max() / IPC_S**2


def traveled(bench, since_s):
    times = np.array([row[0] for row in bench.trace])
    command = np.array([row[1] for row in bench.trace])
    return command[-1] - command[int(np.searchsorted(times, since_s))]


BRAKING_RAD = SPEED**2 / (2.0 * ACCELERATION)

AT_ONCE = {
    "e-stop": (lambda c, now: c.emergency_stop(now), "emergency stop is pressed"),
    "alarm": (lambda c, now: c.alarm(4107, now), "alarm 4107 is active"),
    "teach": (lambda c, now: c.mode("teach", now), "key is on TEACH"),
    "not remote": (lambda c, now: c.remote(False, now), "key is on PLAY"),
    "hold": (lambda c, now: c.hold(True, now), "not ready: the robot is on HOLD"),
    "drives off": (lambda c, now: c.servo(False, now), "servos are off"),
    "job stopped": (lambda c, now: c.job_stop(now), "job INIT_ROS does not run"),
    "collaborative stop": (lambda c, now: c.collaborative_stop(now), "touched something"),
}


def later(cases):
    """Return the cases of the matrix; with every change, each is tried in one mode."""
    return [f"{case}-{MODES[number % 2]}" for number, case in enumerate(cases)]


@pytest.mark.matrix(*later(AT_ONCE))
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("event", AT_ONCE)
def test_what_the_controller_stops_for(mode, event):
    act, words = AT_ONCE[event]
    bench = moving(mode)
    at_s = bench.now_s
    act(bench.controller, at_s)
    bench.run(0.5)
    # Within 10 ms of status polling and one period more; no ramp.
    assert traveled(bench, at_s) <= SPEED * (0.010 + 2 * IPC_S) + 1e-4
    assert bench.controller.active_mode is ActiveMode.NONE
    state = bench.states[-1]
    assert not state.ready
    assert words in state.hold_reason
    assert state.hold_reason.isprintable()
    assert not bench.session.control.enabled
    assert_moves_only_when_enabled_anew(bench)


def assert_rests_until_enabled_anew(bench):
    """Remove the cause; assert that nothing moves by itself, and enable a new session."""
    controller, now_s = bench.controller, bench.now_s
    controller.release_emergency_stop(now_s)
    controller.reset_alarm(now_s)
    controller.mode("play", now_s)
    controller.remote(True, now_s)
    controller.hold(False, now_s)
    bench.run(3.0)
    assert traveled(bench, now_s) == 0.0
    assert not bench.states[-1].ready
    sessions = bench.session.sessions
    bench.ready()
    assert bench.session.sessions == sessions + 1


def assert_moves_only_when_enabled_anew(bench):
    assert_rests_until_enabled_anew(bench)
    bench.run(0.6)
    assert speed(bench) == pytest.approx(SPEED, rel=0.05)


@pytest.mark.matrix
def test_velocity_mode_ramps_when_the_motion_connection_is_cut():
    bench = moving("velocity")
    at_s = bench.now_s
    bench.unplug("motion")
    bench.run(0.2)
    assert speed(bench) == 0.0
    assert hardest(bench, at_s) <= ACCELERATION + ONE_PULSE
    assert traveled(bench, at_s) <= BRAKING_RAD + SPEED * 3 * IPC_S
    assert bench.controller.active_mode is not ActiveMode.VELOCITY
    assert "motion connection was lost" in bench.session.control.end_reason
    assert_moves_only_when_enabled_anew(bench)


def test_stock_firmware_plays_for_50_ms_when_the_motion_connection_is_cut():
    bench = moving("stream")
    at_s = bench.now_s
    bench.unplug("motion")
    bench.run(0.3)
    assert speed(bench) == 0.0
    assert traveled(bench, at_s) <= SPEED * (0.050 + 2 * IPC_S)
    assert "motion connection was lost" in bench.session.control.end_reason
    assert "motion connection was lost" in bench.states[-1].hold_reason
    # Points left in the queue are not executed after the driver's return: it stops first.
    assert_moves_only_when_enabled_anew(bench)
    assert bench.session.metrics(bench.now_s)["reconnects"] == 1.0
    assert not [words for words in bench.session.diagnosis(bench.now_s) if "motion ended" in words]
    bench.unplug("motion")
    bench.run(0.2)
    assert "motion ended 2 times" in " ".join(bench.session.diagnosis(bench.now_s))


@pytest.mark.matrix
@pytest.mark.parametrize("mode", MODES)
def test_a_half_open_connection(mode):
    bench = moving(mode, faults={"silent": 3.0})
    # Since the start of the controller's clock.
    bench.run(3.0, until=lambda: bench.servers.silent)
    at_s = bench.now_s
    bench.run(0.4)
    assert speed(bench) == 0.0
    if mode == "velocity":
        assert hardest(bench, at_s) <= ACCELERATION + ONE_PULSE
        assert traveled(bench, at_s) <= SPEED * (0.100 + 2 * IPC_S) + BRAKING_RAD
    else:
        assert traveled(bench, at_s) <= SPEED * 0.060
    state = bench.states[-1]
    assert state.link is RobotLink.LOST
    assert "no state" in state.hold_reason or "no state" in bench.session.control.end_reason


@pytest.mark.matrix
def test_the_watchdog_of_velocity_mode_when_the_program_is_dead():
    bench = moving("velocity")
    at_s = bench.now_s
    bench.stall(0.5)
    assert speed(bench) == 0.0
    assert hardest(bench, at_s) <= ACCELERATION + ONE_PULSE
    assert SPEED * 0.095 <= traveled(bench, at_s) <= SPEED * (0.100 + 3 * IPC_S) + BRAKING_RAD
    assert bench.controller.status().motion_possible == 0
    # The process continues without noticing its pause: the latch holds.
    woken_s = bench.now_s
    bench.run(0.5)
    assert traveled(bench, woken_s) == 0.0
    assert not bench.session.control.enabled
    assert_moves_only_when_enabled_anew(bench)


def test_a_stream_runs_out_when_the_program_is_dead():
    bench = moving("stream")
    at_s = bench.now_s
    bench.stall(0.5)
    assert speed(bench) == 0.0
    assert traveled(bench, at_s) <= SPEED * 0.045


@pytest.mark.parametrize("mode", MODES)
def test_a_second_client_is_refused_while_the_robot_moves(mode):
    bench = moving(mode)
    assert bench.servers.accepted("motion", bench.now_s) is None
    bench.run(0.3)
    assert speed(bench) == pytest.approx(SPEED, rel=0.05)
    assert bench.session.control.enabled


@pytest.mark.matrix
def test_a_second_client_takes_over_at_rest_and_that_is_said():
    bench = moving("velocity")
    bench.answer = lambda state: JointVelocityCommand((0.0,) * 6)
    bench.run(0.5)
    thief = bench.servers.accepted("motion", bench.now_s)
    assert thief is not None
    bench.answer = lambda state: JointVelocityCommand((SPEED, 0.0, 0.0, 0.0, 0.0, 0.0))
    at_s = bench.now_s
    bench.run(0.2)
    assert traveled(bench, at_s) == 0.0
    assert "closed it" in bench.session.control.end_reason
    assert not bench.session.control.enabled
    bench.servers.eof(thief, bench.now_s)
    assert_moves_only_when_enabled_anew(bench)


NETWORK = {
    "cut": ({"cut": 3.0}, "motion connection was lost: the controller closed it"),
    "reset": ({"reset": 3.0}, "state connection was lost: the controller closed it"),
    "late": ({"late": 700.0}, ""),
    "all replies stale": ({"stale-reply": 1.0}, "while there was no connection"),
    "some replies stale": ({"stale-reply": 0.2}, "motion connection was lost: the answer to"),
    "some replies lost": ({"drop-reply": 0.2}, "motion connection was lost: no reply to"),
}


@pytest.mark.matrix(*later(NETWORK))
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("case", NETWORK)
def test_a_network_or_a_server_that_fails(mode, case):
    faults, words = NETWORK[case]
    bench = SessionBench(
        {"mode": mode},
        lambda state: JointVelocityCommand((SPEED, 0.0, 0.0, 0.0, 0.0, 0.0)),
        faults=faults,
    )
    bench.run(1.0, until=lambda: bench.session.phase.name == "IDLE")
    bench.session.enable(bench.now_s)
    bench.run(5.0)
    assert speed(bench) == 0.0
    assert not bench.session.control.enabled
    assert words in bench.session.control.end_reason
    assert bench.states[-1].hold_reason
    at_s = bench.now_s
    bench.run(1.0)
    assert traveled(bench, at_s) == 0.0


@pytest.mark.matrix("velocity")
@pytest.mark.parametrize("mode", MODES)
def test_a_pause_of_the_state_port_ends_motion(mode):
    bench = moving(mode, faults={"state-pause": 0.3})
    bench.run(8.0, until=lambda: not bench.session.control.enabled)
    at_s = bench.now_s
    bench.run(0.2)
    assert speed(bench) == 0.0
    assert hardest(bench, at_s) <= ACCELERATION + ONE_PULSE
    assert "no state" in bench.session.control.end_reason
    bench.run(0.3)
    state = bench.states[-1]
    assert state.link is RobotLink.LIVE
    assert "enable" in state.hold_reason
    at_s = bench.now_s
    bench.run(1.0)
    assert traveled(bench, at_s) == 0.0


@pytest.mark.matrix
@pytest.mark.parametrize("mode", MODES)
def test_the_safety_unit_slows_the_arm_and_nothing_is_caught_up(mode):
    bench = moving(mode)
    bench.controller.speed_limit(0.02, bench.now_s)
    slow_s = bench.now_s
    bench.run(1.0)
    allowed = 0.02 * bench.peer_options.axis_speeds[0]
    assert allowed < SPEED
    assert speed(bench) == pytest.approx(allowed, rel=0.1)
    bench.controller.speed_limit(None, bench.now_s)
    bench.run(0.5)
    assert speed(bench) <= SPEED * 1.05
    assert traveled(bench, slow_s) > 0.0


def test_every_velocity_is_sent_and_accepted_to_the_last():
    bench = moving("velocity")
    bench.session.disable(bench.now_s)
    bench.run(0.5)
    assert bench.session.control.counters.commands == bench.controller.velocities_accepted
    assert bench.controller.velocities_refused == 0
    assert speed(bench) == 0.0


@pytest.mark.matrix
def test_a_stream_that_ran_empty_begins_anew_from_rest():
    bench = moving("stream")
    bench.stall(0.06)
    assert speed(bench, 0.008) == 0.0
    at_s = bench.now_s
    bench.run(1.5)
    assert bench.session.control.enabled
    assert speed(bench) == pytest.approx(SPEED, rel=0.05)
    assert bench.session.control.counters.underruns == 1
    # No segment began at the speed of the last point before the pause.
    assert hardest(bench, at_s + 0.1) <= ACCELERATION + 3 * ONE_PULSE


@pytest.mark.matrix
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("seconds", [0.15, 4.0])
def test_a_long_pause_of_this_computer_ends_motion(mode, seconds):
    bench = moving(mode)
    bench.stall(seconds)
    bench.run(0.5)
    at_s = bench.now_s
    bench.run(1.0)
    assert traveled(bench, at_s) == 0.0
    assert not bench.session.control.enabled
    assert bench.states[-1].hold_reason
    assert_moves_only_when_enabled_anew(bench)


@pytest.mark.matrix
def test_a_queue_that_is_not_played_ends_motion_and_is_emptied():
    bench = moving("stream")
    bench.controller.speed_limit(0.0, bench.now_s)
    bench.run(2.0)
    assert not bench.session.control.enabled
    assert "executes nothing" in bench.session.control.end_reason
    bench.controller.speed_limit(None, bench.now_s)
    at_s = bench.now_s
    bench.run(1.0)
    assert traveled(bench, at_s) == 0.0
    assert_moves_only_when_enabled_anew(bench)


@pytest.mark.matrix
@pytest.mark.parametrize("mode", MODES)
def test_energy_saving_is_named_and_ended_by_the_operator(mode):
    bench = moving(mode)
    bench.answer = lambda state: JointVelocityCommand((0.0,) * 6)
    bench.run(1.0)
    bench.controller.energy_saving(True, bench.now_s)
    bench.run(0.3)
    assert not bench.session.control.enabled
    assert "saving energy" in bench.states[-1].hold_reason
    bench.answer = lambda state: JointVelocityCommand((SPEED, 0.0, 0.0, 0.0, 0.0, 0.0))
    bench.ready()
    bench.run(0.6)
    assert speed(bench) == pytest.approx(SPEED, rel=0.05)


@pytest.mark.matrix
@pytest.mark.parametrize("mode", MODES)
def test_servos_are_switched_off_whenever_that_is_asked_for(mode):
    bench = SessionBench({"mode": mode}, lambda state: JointVelocityCommand((0.0,) * 6))
    bench.run(1.0, until=lambda: bench.session.phase.name == "IDLE")
    bench.session.ask("enable", bench.now_s)
    bench.session.ask("servo off", bench.now_s)
    bench.run(3.0)
    assert bench.controller.status().drives_powered == 0
    assert not bench.session.control.enabled


@pytest.mark.matrix
@pytest.mark.parametrize(
    ("driver", "controller"),
    [
        ({}, {"faults": {"late": 2.0}}),
        ({}, {"faults": {"late": 8.0}}),
        ({"ipc_s": 0.008}, {"ipc_s": 0.008}),
        ({"point_spacing_s": 0.008}, {}),
        ({"point_spacing_s": 0.1}, {}),
        ({"queue_low": 2}, {}),
    ],
    ids=str,
)
def test_a_stream_keeps_its_queue_filled(driver, controller):
    bench = SessionBench(
        {"mode": "stream", **driver},
        lambda state: JointVelocityCommand((SPEED, 0.0, 0.0, 0.0, 0.0, 0.0)),
        **controller,
    )
    bench.ready()
    bench.run(0.3)
    at_s = bench.now_s
    bench.run(2.0)
    assert bench.session.control.counters.underruns == 0
    assert traveled(bench, at_s) == pytest.approx(2.0 * SPEED, rel=0.02)


@pytest.mark.matrix
def test_curves_that_the_arms_filter_cuts_are_not_corrected():
    start_s = 0.0

    def circle(state):
        t = state.stamp_s - start_s
        speed = 0.3 * 2.0 * np.pi
        wrist = (speed * np.cos(2.0 * np.pi * t), speed * np.sin(2.0 * np.pi * t))
        return JointVelocityCommand((0.0, 0.0, 0.0, wrist[0], 0.0, wrist[1]))

    bench = SessionBench({"mode": "velocity"}, circle, plant="paper")
    bench.ready()
    start_s = bench.now_s
    bench.run(3.0)
    assert bench.session.control.enabled
    assert bench.session.control.counters.replaced == 0
