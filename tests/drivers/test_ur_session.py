"""The UR driver's session with a simulated controller, including the wire, in virtual time."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np
import pytest

from cardan.drivers.ur_rtde import UrRtdeOptions
from cardan.drivers.ur_rtde.session import ANSWER_S, SLOWEST_SHARE, UrSession
from cardan.errors import CommandError, OptionError
from cardan.protocols.ur.primary import text_message
from cardan.protocols.ur.program import FIRST_WAIT_S, ProgramCommand, program
from cardan.protocols.ur.script import Program, parse
from cardan.protocols.ur.states import SafetyMode
from cardan.types import (
    CommandKind,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    RobotLink,
    TorqueCommand,
)
from tests.drivers.ur_bench import SessionBench

pytestmark = pytest.mark.matrix

SPEED = 0.3
ACCELERATION = 5.0
STOP = 5.0
TURN = JointVelocityCommand((SPEED, 0.0, 0.0, 0.0, 0.0, 0.0))


def turning(**controller):
    """Return a robot that has turned joint 1 at SPEED for half a second."""
    driver = {"acceleration_rad_s2": (ACCELERATION,) * 6, **controller.pop("driver", {})}
    bench = SessionBench(driver, lambda state: TURN, **controller)
    bench.ready()
    bench.run(0.6)
    return bench


def speeds(bench, since_s=0.0):
    """Return the commanded speeds of joint 1 in the controller, rad/s, frame by frame."""
    rows = [(t, q[0]) for t, q, _ in bench.trace if t >= since_s]
    times, joint = np.array(rows).T
    return np.diff(joint) / np.diff(times)


def place(bench):
    return bench.controller.motion.target_q[0]


def events(bench):
    return [text for _, text in bench.controller.events]


# -- starting --------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
def test_a_robot_without_power_is_started_and_nothing_moves(robot):
    bench = SessionBench(robot=robot, running=False)
    before = tuple(bench.controller.motion.target_q)
    bench.ready()
    assert bench.session.phase == "moving"
    assert {row[1] for row in bench.trace} == {before}
    said = {state.hold_reason for state in bench.states}
    assert {"starting: power is coming on", "starting: the program is being started"} < said
    assert bench.states[-1].joints == pytest.approx(before)
    rate_hz = 500.0 if robot == "ur5e" else 125.0
    assert bench.session.capabilities.period_s == pytest.approx(1.0 / rate_hz)


def test_nothing_is_started_unless_it_is_asked_for():
    bench = SessionBench(running=False).run(3.0)
    assert bench.session.phase == "idle"
    assert bench.states[-1].hold_reason == "power is off; motion is not enabled"
    assert "dashboard" not in bench.numbers
    assert "primary" not in bench.numbers


def test_at_start_is_once():
    bench = SessionBench({"enable": "at-start"}).run(1.0)
    assert bench.states[-1].ready
    bench.unplug("rtde")
    bench.run(3.0)
    assert bench.states[-1].link is RobotLink.LIVE
    assert not bench.states[-1].ready
    assert bench.session.starts == 1
    assert bench.session.metrics()["reconnects"] == 1.0


def test_two_connections_are_closed_once_the_program_runs():
    bench = SessionBench().ready()
    assert set(bench.numbers) == {"rtde"}


REFUSED = {
    "local": ({"remote": False}, "local control: choose remote control"),
    "protective stop": (
        {"faults": {"protective-stop": 0.1}},
        "protective stop: look for its cause",
    ),
    "emergency stop": ({"faults": {"estop": 0.1}}, "emergency stop at the robot: release"),
    "guard": ({"faults": {"safeguard-stop": 0.1}}, "safeguard stop: close the guard"),
    "busy": (
        {"faults": {"no-script": 1.0}},
        "not started within 2 s: the program is being started",
    ),
}


@pytest.mark.parametrize("why", REFUSED)
def test_a_start_that_is_refused_says_why(why):
    controller, words = REFUSED[why]
    bench = SessionBench({"start_timeout_s": 2.0}, **controller).run(0.5)
    bench.session.ask("enable", bench.now_s)
    bench.run(2.5)
    assert bench.session.phase == "idle"
    assert words in bench.states[-1].hold_reason
    assert words in bench.session.diagnosis(bench.now_s)[0]
    assert set(bench.numbers) == {"rtde"}


def test_another_program_is_not_stopped():
    bench = SessionBench(faults={"other-program": 0.1}).run(0.5)
    bench.session.ask("enable", bench.now_s)
    bench.run(2.0)
    assert "another program runs at the controller" in bench.states[-1].hold_reason
    assert bench.controller.program_name == "other"


def test_a_program_that_the_controller_does_not_understand_is_named(monkeypatch):
    monkeypatch.setattr(
        "cardan.drivers.ur_rtde.session.program",
        lambda *a: "def cardan():\n  modbus_add_signal([0])\nend\n",
    )
    bench = SessionBench().run(0.5)
    bench.session.ask("enable", bench.now_s)
    bench.run(1.0)
    assert "line 2: compile_error_name_not_found:modbus_add_signal:" in bench.states[-1].hold_reason


def test_text_of_a_urcap_during_a_start_is_none_of_its_failures():
    bench = SessionBench().run(0.5)
    bench.session.ask("enable", bench.now_s)

    def said():
        bench.controller.messages.append(text_message(bench.now_s, "URCap: gripper ready"))
        return bench.states[-1].ready

    bench.run(5.0, until=said)
    assert bench.states[-1].ready, bench.states[-1].hold_reason


@pytest.mark.parametrize("channel", ["dashboard", "primary"])
def test_a_start_without_one_of_the_ports(channel):
    bench = SessionBench().run(0.5)
    connect = bench._connect

    def fails(name):
        if name == channel:
            bench.session.connect_failed(name, "Connection refused", bench.now_s)
        else:
            connect(name)

    bench._connect = fails
    bench.session.ask("enable", bench.now_s)
    bench.run(0.5)
    port = bench.options.dashboard_port if channel == "dashboard" else bench.options.primary_port
    assert f"port {port}: Connection refused" in bench.states[-1].hold_reason


def test_a_line_without_end_at_the_dashboard_ends_a_start():
    bench = SessionBench(running=False).run(0.5)
    bench.session.ask("enable", bench.now_s)
    bench.run(1.0, until=lambda: "dashboard" in bench.numbers)
    bench.session.received("dashboard", b"x" * 100_000, bench.now_s)
    assert "dashboard" in bench.session.closing()
    assert "closed its connection: a line" in bench.session.hold_reason


def test_registers_that_a_fieldbus_has():
    bench = SessionBench(faults={"in-use": 1.0}).run(1.0)
    assert bench.states[-1].link is RobotLink.WAITING
    assert "a fieldbus, has the registers input_int_register_24" in bench.states[-1].hold_reason


def test_two_drivers_at_one_controller():
    bench = SessionBench().ready()
    other = bench.servers.accepted("rtde", bench.now_s)
    from cardan.protocols.ur.rtde import ask_inputs, ask_version

    bench.servers.data(other, ask_version(), bench.now_s)
    bench.servers.data(other, ask_inputs(["input_int_register_24"]), bench.now_s)
    answers = b"".join(data for number, data in bench.servers.outgoing() if number == other)
    assert b"IN_USE" in answers


def test_nobody_listens():
    bench = SessionBench()
    bench.reachable = False
    bench.run(1.0)
    assert (
        bench.states[-1].hold_reason == "no RTDE connection to 127.0.0.1:30004: Connection refused"
    )
    gaps = np.diff([state.stamp_s for state in bench.states])
    assert gaps.max() < 0.1
    bench.reachable = True
    bench.run(2.5)
    assert bench.states[-1].link is RobotLink.LIVE


# -- moving ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
def test_a_speed_is_followed(robot):
    bench = turning(robot=robot)
    assert speeds(bench)[-10:] == pytest.approx(SPEED, rel=1e-3)
    assert bench.session.diagnosis(bench.now_s) == ()
    assert bench.session.metrics()["lost"] == 0.0


@pytest.mark.parametrize("registers", ["upper", "lower"])
def test_a_place_is_reached_within_the_limits(registers):
    goal = (0.5, -1.2, 1.2, -1.3, -1.4, 0.4)
    bench = SessionBench(
        {"acceleration_rad_s2": (ACCELERATION,) * 6, "registers": registers},
        lambda state: JointCommand(goal),
    ).ready()
    bench.run(3.0)
    first = 24 if registers == "upper" else 0
    assert bench.controller.registers.input_int[first] == bench.session._token
    assert bench.controller.motion.actual_q == pytest.approx(goal, abs=1e-4)
    path = np.array([q for _, q, _ in bench.trace])
    rates = np.diff(path, axis=0) / bench.controller.period_s
    assert np.abs(rates).max() <= max(bench.options.limits.velocity) * 1.001
    assert np.abs(np.diff(rates, axis=0)).max() / bench.controller.period_s <= ACCELERATION * 1.05


def test_a_far_goal_is_no_jump():
    bench = SessionBench(answer=lambda state: JointCommand((3.0, *HOME[1:]))).ready().run(0.01)
    assert place(bench) < 0.01


def test_a_goal_outside_of_the_ranges_stays_inside():
    bench = SessionBench(
        answer=lambda state: JointCommand((0.0, -1.57, 9.0, -1.57, -1.57, 0.0))
    ).ready()
    bench.run(3.0)
    assert bench.session.phase == "moving"
    assert bench.controller.motion.target_q[2] == pytest.approx(
        bench.options.limits.upper[2], abs=1e-3
    )


def test_a_hold_brakes_and_stays():
    bench = turning()
    bench.answer = lambda state: HoldCommand()
    bench.run(0.5)
    at = place(bench)
    bench.run(0.5)
    assert place(bench) == pytest.approx(at, abs=1e-6)
    assert bench.session.phase == "moving"


def test_what_the_robot_cannot_take():
    bench = SessionBench().ready()
    take = bench.session.command
    with pytest.raises(CommandError, match="takes no torque"):
        take(TorqueCommand((0.0,) * 6), bench.now_s)
    with pytest.raises(CommandError, match="5 values for 6 joints"):
        take(JointCommand((0.0,) * 5), bench.now_s)
    with pytest.raises(CommandError, match="finite"):
        take(JointCommand((float("nan"),) * 6), bench.now_s)
    assert CommandKind.TORQUE not in bench.session.capabilities.commands


def test_a_state_is_answered_once():
    bench = SessionBench(answer=lambda state: None).ready()
    before = bench.session.commands
    bench.session.command(HoldCommand(), bench.now_s)
    bench.session.command(HoldCommand(), bench.now_s)
    assert bench.session.commands == before + 1


@pytest.mark.parametrize("fault", [{"split": 1.0}, {"garbage": 0.3}, {"skip": 0.2}, {"late": 4.0}])
def test_a_bad_line_does_not_keep_the_arm_from_moving(fault):
    bench = turning(faults=fault)
    assert bench.session.phase == "moving"
    assert speeds(bench, bench.now_s - 0.2) == pytest.approx(SPEED, rel=0.1)
    assert (bench.session.metrics()["ignored"] > 0.0) == ("garbage" in fault)
    assert (bench.session.metrics()["lost"] > 0.0) == ("skip" in fault)


def test_the_program_is_understood_with_every_option():
    for options in (
        UrRtdeOptions(),
        UrRtdeOptions(registers="lower", watchdog_s=0.5, gain=2000, lookahead_s=0.2),
    ):
        text = program(options.servoing, 2**31 - 1, 0.002)
        assert isinstance(parse(text), Program)
        used = re.findall(r"(read|write)_(?:input|output)_integer_register\((\d+)", text)
        first = 0 if options.registers == "lower" else 24
        writes, reads = (1, 3, 2), (1, 2, 1)
        assert Counter((how, int(number) - first) for how, number in used) == {
            **{("write", n): times for n, times in enumerate(writes)},
            **{("read", n): times for n, times in enumerate(reads)},
        }


# -- causes of a stop ------------------------------------------------------------------------------

EVENTS = {
    "protective stop": (lambda c: c.protective_stop("a person"), "protective stop: look for"),
    "emergency stop": (lambda c: c.emergency_stop(), "emergency stop at the robot"),
    "guard": (lambda c: c.safeguard_stop(), "safeguard stop"),
    "power off": (lambda c: c.power_off(), "power is off"),
    "program stopped": (lambda c: c.stop_program(), "program was stopped at the controller"),
    "program paused": (lambda c: c.pause(), "program was paused at the controller"),
    "another program": (
        lambda c: c.upload("def other():\n while True:\n  sync()\n end\nend\n"),
        "enable again",
    ),
    "restart": (lambda c: c.restart(), "enable again"),
}


@pytest.mark.parametrize("event", EVENTS)
def test_what_the_controller_stops_for(event):
    bench = turning()
    act, words = EVENTS[event]
    act(bench.controller)
    bench.run(1.0)
    assert words in bench.states[-1].hold_reason
    assert bench.states[-1].hold_reason.count("enable again") == 1
    assert not bench.states[-1].ready
    at = place(bench)
    bench.run(1.0)
    assert place(bench) == pytest.approx(at, abs=1e-9)


def test_after_a_protective_stop_nothing_moves_until_it_is_enabled_again():
    bench = turning()
    bench.controller.protective_stop("a person")
    bench.run(6.0)
    at, session = place(bench), bench.states[-1].session
    assert bench.controller.unlock_protective_stop() == "Protective stop releasing"
    bench.run(1.0)
    assert bench.controller.safety is SafetyMode.NORMAL
    assert "protective stop" in bench.states[-1].hold_reason
    assert place(bench) == pytest.approx(at, abs=1e-9)
    began = bench.now_s
    bench.answer = lambda state: HoldCommand()
    bench.session.ask("enable", bench.now_s)
    bench.run(1.0)
    assert bench.states[-1].ready
    assert bench.states[-1].session > session
    assert np.abs(speeds(bench, began)).max() < 1e-6


def test_the_driver_can_unlock_a_protective_stop_where_it_is_asked_to():
    bench = turning()
    bench.controller.protective_stop("a person")
    bench.run(1.0)
    bench.session.ask("unlock", bench.now_s)
    bench.run(0.5)
    assert bench.controller.safety is SafetyMode.PROTECTIVE_STOP
    assert "until 5s after" in bench.session.end_reason
    bench.run(5.0)
    bench.session.ask("unlock", bench.now_s)
    bench.run(0.5)
    assert bench.controller.safety is SafetyMode.NORMAL
    assert bench.states[-1].hold_reason == "motion is not enabled"


def test_a_program_that_is_resumed_at_the_pendant_ends():
    bench = turning()
    bench.controller.pause()
    bench.run(0.5)
    at = place(bench)
    bench.controller.resume()
    bench.run(1.0)
    assert not bench.controller.has_program
    assert place(bench) == pytest.approx(at, abs=0.02)
    assert not bench.states[-1].ready


def test_a_dead_computer_is_noticed_by_the_program():
    bench = turning()
    at, from_s = place(bench), bench.now_s
    bench.alive = False
    bench.run(1.0)
    assert not bench.controller.has_program
    far = place(bench) - at
    braking = SPEED**2 / (2.0 * STOP)
    assert far == pytest.approx(SPEED * (bench.options.watchdog_s + 0.004) + braking, abs=0.004)
    assert np.abs(speeds(bench, from_s)).max() <= SPEED * 1.01
    assert np.abs(np.diff(speeds(bench, from_s))).max() / bench.controller.period_s <= STOP * 1.05


def test_a_computer_that_comes_back_too_late_is_reported():
    bench = turning()
    bench.stall(0.5)
    at = place(bench)
    bench.run(1.0)
    assert "no command came in time" in bench.states[-1].hold_reason
    assert place(bench) == pytest.approx(at, abs=1e-9)


@pytest.mark.parametrize("gap_ms", [10, 20, 40, 80])
def test_time_that_was_lost_is_not_made_up_for(gap_ms):
    began = []

    def follow(state):
        began.append(state.stamp_s)
        moved = SPEED * (state.stamp_s - began[0])
        return JointCommand((moved, *HOME[1:]), (SPEED, 0.0, 0.0, 0.0, 0.0, 0.0))

    bench = SessionBench({"acceleration_rad_s2": (ACCELERATION,) * 6})
    bench.ready()
    bench.answer = follow
    bench.run(0.6)
    from_s = bench.now_s
    bench.stall(1e-3 * gap_ms)
    bench.run(0.6)
    assert bench.session.phase == "moving"
    after = speeds(bench, from_s)
    assert after.max() <= SPEED * 1.05
    assert after.min() >= 0.0
    assert np.abs(np.diff(after)).max() / bench.controller.period_s <= ACCELERATION * 1.05


HOME = (0.0, -np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, 0.0)


def test_an_application_that_stops_during_a_gap_brakes():
    bench = turning()
    bench.stall(0.05)
    bench.answer = lambda state: HoldCommand()
    bench.run(0.5)
    assert abs(speeds(bench)[-1]) < 1e-6


# -- sessions --------------------------------------------------------------------------------------


def test_a_lost_connection_ends_motion_and_its_program():
    bench = turning()
    at, value = place(bench), bench.servers.telemetry.value
    bench.unplug("rtde")
    # Its clock restarts, as may happen between connections.
    bench.servers.telemetry.value = lambda name: (
        value(name) - 50.0 if name == "timestamp" else value(name)
    )
    bench.run(3.0)
    assert not any("clock" in state.hold_reason for state in bench.states)
    assert not bench.controller.has_program
    assert place(bench) - at < SPEED * 0.13 + SPEED**2 / (2.0 * STOP) + 0.01
    assert bench.states[-1].link is RobotLink.LIVE
    assert "enable again" in bench.states[-1].hold_reason
    began = bench.now_s
    bench.session.ask("enable", bench.now_s)
    bench.answer = lambda state: HoldCommand()
    bench.run(1.0)
    assert bench.states[-1].ready
    assert np.abs(speeds(bench, began)).max() < 1e-6


def test_a_program_of_an_earlier_connection_obeys_no_later_one():
    bench = turning()
    bench.unplug("rtde")
    bench.run(0.001)
    token = bench.controller.registers.output_int[24]
    bench.run(0.6)
    assert bench.controller.registers.input_int[24] == 0 != token


def test_a_command_that_was_meant_for_an_earlier_run_does_not_act():
    bench = turning()
    old = bench.controller.registers.input_int[24]
    bench.controller.stop_program()
    bench.run(0.5)
    bench.answer = lambda state: HoldCommand()
    bench.ready()
    at = place(bench)
    bench.alive = False
    registers = bench.controller.registers
    for beat in range(100):
        registers.input_int[24:27] = [old, 10_000 + beat, ProgramCommand.FOLLOW]
        registers.input_double[24:36] = [at + 0.001 * beat, *HOME[1:], 0.5, 0.0, 0.0, 0.0, 0.0, 0.0]
        bench.run(0.002)
    assert place(bench) == pytest.approx(at, abs=1e-6)
    assert "no command" not in bench.states[-1].hold_reason
    assert not bench.controller.has_program


def test_a_state_of_before_is_not_answered_after_a_new_start():
    bench = turning()
    bench.answer = lambda state: None
    bench.run(0.01)
    assert bench.session.reply_pending
    bench.controller.stop_program()
    bench.run(0.05)
    before = bench.session.commands
    bench.session.command(TURN, bench.now_s)
    assert bench.session.commands == before


def test_a_jump_in_the_registers_ends_the_program():
    bench = turning()
    registers = bench.controller.registers
    bench.stall(0.001)  # data in transit arrives
    bench.alive = False
    token, beat = registers.input_int[24:26]
    registers.input_int[24:27] = [token, beat + 1, ProgramCommand.FOLLOW]
    registers.input_double[24] = place(bench) + 0.5
    bench.run(0.5)
    assert not bench.controller.has_program
    assert bench.controller.safety is SafetyMode.NORMAL
    bench.alive = True
    bench.run(0.2)
    assert "too far from the one before" in bench.states[-1].hold_reason


def test_a_program_that_gets_no_first_command_ends():
    bench = SessionBench(answer=lambda state: None)
    bench.run(0.5)
    bench.session.ask("enable", bench.now_s)
    bench.run(0.5, until=lambda: bench.controller.registers.output_int[25] == 1)
    bench.alive = False
    bench.run(FIRST_WAIT_S + 0.3)
    assert not bench.controller.has_program


@pytest.mark.parametrize("slider", [1.0, 0.25])
def test_a_program_that_answers_no_more_is_noticed(slider):
    bench = turning(faults={"slider": slider})
    # Another client's program, which leaves the registers as they are.
    bench.controller._program = None
    bench.run(0.8 * ANSWER_S / slider)
    assert bench.session.enabled
    bench.run(0.4 * ANSWER_S / slider)
    assert bench.session.phase == "idle"
    assert "does not answer" in bench.states[-1].hold_reason


# -- the speed slider ------------------------------------------------------------------------------


def test_the_slider_scales_the_highest_speeds():
    bench = SessionBench(
        {"velocity_rad_s": (1.0,) * 6},
        lambda state: JointVelocityCommand((2.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        faults={"slider": 0.25},
    ).ready()
    bench.run(1.0)
    assert speeds(bench)[-20:].mean() == pytest.approx(0.25, rel=0.01)
    assert speeds(bench).max() < 0.26
    assert "the speed slider is at 25 %" in bench.session.diagnosis(bench.now_s)[0]


@pytest.mark.parametrize(
    ("own", "fraction", "share"),
    [(0.0, 0.5, 0.5), (0.4, 0.5, 0.2), (1.0, 0.5, 0.5), (1.5, 0.5, 0.5), (1.0, 1.5, 1.0)],
)
def test_the_controllers_own_scaling_counts_while_it_slows(own, fraction, share):
    bench = SessionBench(answer=lambda state: TURN).ready()
    value = bench.servers.telemetry.value
    scaled = {"speed_scaling": own, "target_speed_fraction": fraction}
    bench.servers.telemetry.value = lambda name: scaled.get(name) or value(name)
    bench.session.feed._compiled = None
    bench.run(0.5)
    sent = bench.controller.registers.input_double[30]
    assert sent == pytest.approx(SPEED / share, rel=1e-3)


def test_a_slow_speed_is_followed_with_the_slider_down():
    bench = turning(faults={"slider": 0.5})
    assert speeds(bench)[-20:].mean() == pytest.approx(SPEED, rel=0.01)


def test_the_slider_at_zero():
    bench = turning()
    session = bench.states[-1].session
    bench.controller.slider = 0.0
    bench.run(0.5)
    assert "the speed slider is at 0" in bench.states[-1].hold_reason
    at = place(bench)
    bench.controller.slider = 1.0
    bench.answer = lambda state: HoldCommand()
    bench.run(0.5)
    assert bench.states[-1].ready
    assert bench.states[-1].session == session + 1
    assert place(bench) == pytest.approx(at, abs=1e-3)


# -- the end ---------------------------------------------------------------------------------------


def test_leaving_brakes_and_ends_the_program():
    bench = turning()
    from_s = bench.now_s
    bench.session.leave(bench.now_s)
    bench.run(1.0, until=lambda: bench.session.left)
    assert bench.session.left
    assert "the arm is brought to rest" in {state.hold_reason for state in bench.states}
    bench.run(0.2)
    assert not bench.controller.has_program
    assert np.abs(np.diff(speeds(bench, from_s))).max() / bench.controller.period_s <= 5.1
    assert abs(speeds(bench)[-1]) < 1e-6


def test_leaving_ends_with_the_slider_down_and_says_what_else_ended_it():
    bench = turning()
    bench.controller.slider = 2.0 * SLOWEST_SHARE
    bench.run(0.1)
    bench.session.leave(bench.now_s)
    bench.run(bench.session.braking_s + 0.4)
    assert not bench.session.left
    bench.run(0.3)
    assert bench.controller.registers.input_int[26] == ProgramCommand.END
    bench = turning()
    bench.session.leave(bench.now_s)
    bench.run(0.01)
    bench.controller.stop_program()
    bench.run(0.1)
    assert "program was stopped at the controller" in bench.states[-1].hold_reason


def test_disabling_and_enabling_again():
    bench = turning()
    bench.session.ask("disable", bench.now_s)
    bench.run(1.0)
    assert bench.states[-1].hold_reason == "motion is not enabled"
    bench.ready()
    bench.run(0.5)
    assert speeds(bench)[-10:] == pytest.approx(SPEED, rel=1e-3)


def test_a_start_that_is_left_moves_nothing():
    bench = SessionBench(running=False).run(0.5)
    bench.session.ask("enable", bench.now_s)
    bench.run(0.05)
    bench.session.leave(bench.now_s)
    assert bench.session.left
    bench.run(3.0)
    assert not bench.controller.has_program


# -- silence and bad numbers -----------------------------------------------------------------------

ARRAYS = ("actual_q", "target_q", "actual_qd", "target_qd")


def test_a_silent_controller_is_lost():
    bench = turning(faults={"silent": 2.0})
    bench.run(2.0)
    assert bench.states[-1].link is RobotLink.LOST
    assert "no state from 127.0.0.1:30004 for 0.1 s" in bench.states[-1].hold_reason
    late = [state.stamp_s for state in bench.states[-10:]]
    assert np.diff(late).max() < 0.1
    assert bench.session.next_s > bench.now_s  # the session does not busy-wait


@pytest.mark.parametrize("number", [float("nan"), 1e11])
@pytest.mark.parametrize("name", ["timestamp", *ARRAYS, "speed_scaling", "target_speed_fraction"])
def test_numbers_that_no_robot_measures_are_no_state(name, number):
    bench = SessionBench().run(0.5)
    value, wrong = bench.servers.telemetry.value, (*HOME[1:], number)
    bench.servers.telemetry.value = lambda asked: (
        value(asked) if asked != name else wrong if name in ARRAYS else number
    )
    bench.run(0.2)
    assert bench.session.protocol_errors()["implausible"] > 0
    assert bench.states[-1].link is RobotLink.LOST
    assert name in " ".join(bench.session.diagnosis(bench.now_s))


@pytest.mark.parametrize(
    ("accepts", "words"),
    [(b"\0\4V\1", "no RTDE of version 2"), (b"\0\4S\1", "does not begin to send states")],
)
def test_a_controller_that_refuses_to_begin(accepts, words):
    bench = SessionBench()
    received = bench.session.received
    bench.session.received = lambda channel, data, now_s: received(
        channel, data.replace(accepts, accepts[:3] + b"\0"), now_s
    )
    bench.run(0.5)
    assert words in bench.states[-1].hold_reason


def test_replies_may_come_byte_by_byte():
    bench = SessionBench()
    received = bench.session.received
    bench.session.received = lambda channel, data, now_s: [
        received(channel, data[n : n + 1], now_s) for n in range(len(data))
    ]
    bench.run(0.5)
    assert bench.states[-1].link is RobotLink.LIVE


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"robot": "pr2_left_arm"}, "an arm of 6 joints"),
        ({"rtde_port": 29999}, "another one than the others"),
        ({"watchdog_s": 0.02, "rate_hz": 125.0}, "five periods"),
        ({"velocity_rad_s": (1.0,)}, "6 numbers, or none"),
        ({"lookahead_s": 0.5}, "servoj takes no other"),
    ],
)
def test_options_that_are_refused(options, words):
    with pytest.raises(OptionError, match=words):
        UrRtdeOptions(**options)


# -- messages --------------------------------------------------------------------------------------


def test_reduced_mode_is_said_and_stops_nothing():
    bench = turning()
    bench.controller.safety = SafetyMode.REDUCED
    bench.run(0.2)
    assert bench.states[-1].ready
    assert any("reduced mode" in each for each in bench.session.diagnosis(bench.now_s))
    bench.session.ask("disable", bench.now_s)
    bench.run(1.0)
    assert "reduced mode" in bench.states[-1].hold_reason


@pytest.mark.parametrize(
    ("robot", "peer", "words"),
    [
        ("ur5e", "ur5", 'set robot = "ur5"'),
        ("ur5", "ur5e", 'set robot = "ur5e"'),
        ("ur5e", "ur5e", ""),
        ("ur5", "ur5", ""),
    ],
)
def test_an_arm_of_another_generation_is_said(robot, peer, words):
    bench = SessionBench({"robot": robot, "rate_hz": 125.0}, robot=peer).run(0.5)
    said = [each for each in bench.session.diagnosis(bench.now_s) if "set robot" in each]
    assert [words in each for each in said] == [True] * bool(words)


def test_an_arm_of_another_size_is_said_once_the_controller_has_reported():
    bench = SessionBench()
    received = bench.session.received
    bench.session.received = lambda channel, data, now_s: received(
        channel, data.replace(b"UR5\n", b"UR10\n"), now_s
    )
    bench.ready()
    (said,) = bench.session.diagnosis(bench.now_s)
    assert said.startswith("the controller's arm is a UR10, and is driven as ur5e")


FOREIGN = {
    "HTTP": b"HTTP/1.1 400 Bad Request\r\n\r\n",
    "RTSP": b"RTSP/1.0 400 Bad Request\r\n\r\n",
    "SSH": b"SSH-2.0-OpenSSH_9.6\r\n",
    "TLS": bytes.fromhex("15030300020246"),
    "dashboard": b"Connected: Universal Robots Dashboard Server\n",
    "primary interface": bytes.fromhex("0000003714ffffffffffffffff"),
}


@pytest.mark.parametrize("protocol", FOREIGN)
def test_another_protocol_at_the_port_is_said_and_not_tried_for_ever(protocol):
    session = UrSession(UrRtdeOptions())
    session.connected("rtde", 1.0)
    session.received("rtde", FOREIGN[protocol], 1.1)
    assert session.closing() == ["rtde"]
    assert re.search("RTDE( server)?; it says", session.hold_reason)
    assert "is rtde_port the controller's (30004)?" in session.hold_reason
    assert not session.wants("rtde", 1e6)
    session.ask("enable", 2.0)
    assert session.wants("rtde", 2.0)


def test_braking_takes_as_long_as_its_slowest_joint():
    options = UrRtdeOptions(acceleration_rad_s2=(8.0, 8.0, 1.0, 8.0, 8.0, 8.0))
    limits = options.limits
    expected = limits.velocity[2] / limits.acceleration[2]
    assert UrSession(options).braking_s == pytest.approx(expected)
    assert expected > 2.0 * limits.velocity[0] / limits.acceleration[0]


def test_a_server_that_closes_without_a_word_is_said_to_be_another():
    session = UrSession(UrRtdeOptions())
    for count in (1, 2, 3):
        assert "does not seem to speak RTDE" not in session.hold_reason
        session.connected("rtde", float(count))
        session.disconnected("rtde", "the controller closed it", float(count))
        assert session.outgoing() == []  # no data is left for the next connection
    assert "3 times without an answer: it does not seem to speak RTDE" in session.hold_reason


def test_an_arm_that_is_off_its_target_for_good_ends_motion():
    bench = turning()
    value = bench.servers.telemetry.value
    off = {"rad": 0.3}
    bench.servers.telemetry.value = lambda name: (
        tuple(q + off["rad"] for q in value(name)) if name == "actual_q" else value(name)
    )
    bench.run(0.2)
    assert bench.states[-1].ready
    bench.run(0.2)
    assert "0.3" in bench.states[-1].hold_reason
    assert "from its target" in bench.states[-1].hold_reason
    assert not bench.session.enabled
    assert bench.session.metrics()["ends"] == 1.0
    assert bench.controller.registers.input_int[26] == ProgramCommand.END


def test_a_wrong_clock_is_said_and_is_not_enabled_with():
    bench = turning()
    value = bench.servers.telemetry.value
    began_s = bench.now_s
    bench.servers.telemetry.value = lambda name: (
        value(name) + (0.6 * (bench.now_s - began_s) if name == "timestamp" else 0.0)
        if name == "timestamp"
        else value(name)
    )
    bench.run(1.2)
    assert "1.6 times as fast" in bench.states[-1].hold_reason
    assert bench.states[-1].hold_reason.count("enable again") == 1
    bench.session.ask("enable", bench.now_s)
    bench.run(1.0)
    assert bench.session.phase == "idle"


@pytest.mark.parametrize("simulated", [False, True])
def test_a_simulation_at_half_speed_moves_with_the_option_and_is_reported_it_without(simulated):
    bench = turning(driver={"simulated_time": simulated})
    value = bench.servers.telemetry.value
    began_s = bench.now_s
    bench.servers.telemetry.value = lambda name: (
        value(name) - 0.5 * (bench.now_s - began_s) if name == "timestamp" else value(name)
    )
    bench.run(2.0)
    assert bench.states[-1].ready is simulated
    assert ("simulated_time = true" in bench.states[-1].hold_reason) is not simulated
