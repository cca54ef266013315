"""The UR driver's session with a simulated controller, wire and all, in virtual time."""

from __future__ import annotations

import numpy as np
import pytest

from cardan.drivers.ur_rtde import UrRtdeOptions
from cardan.drivers.ur_rtde.session import UrSession
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
from tests.drivers.ur_rig import Rig

pytestmark = pytest.mark.matrix

SPEED = 0.3
ACCELERATION = 5.0
STOP = 5.0
TURN = JointVelocityCommand((SPEED, 0.0, 0.0, 0.0, 0.0, 0.0))
SERVO = 0.03
"""Lag of servoj behind a ramp, s."""


def turning(**controller):
    """A robot that turns joint 1 at SPEED, and has for half a second."""
    driver = {"acceleration_rad_s2": (ACCELERATION,) * 6, **controller.pop("driver", {})}
    rig = Rig(driver, lambda state: TURN, **controller)
    rig.ready()
    rig.run(0.6)
    return rig


def speeds(rig, since_s=0.0):
    """Of joint 1's command in the controller, rad/s, frame by frame."""
    rows = [(t, q[0]) for t, q, _ in rig.trace if t >= since_s]
    times, joint = np.array(rows).T
    return np.diff(joint) / np.diff(times)


def place(rig):
    return rig.controller.motion.target_q[0]


def events(rig):
    return [text for _, text in rig.controller.events]


# -- starting --------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
def test_a_robot_without_power_is_started_and_nothing_moves(robot):
    rig = Rig(robot=robot, running=False)
    before = tuple(rig.controller.motion.target_q)
    rig.ready()
    assert rig.session.phase == "moving"
    assert {row[1] for row in rig.trace} == {before}
    said = {state.hold_reason for state in rig.states}
    assert {"starting: power is coming on", "starting: the program is being started"} < said
    assert rig.states[-1].joints == pytest.approx(before)
    rate_hz = 500.0 if robot == "ur5e" else 125.0
    assert rig.session.capabilities.period_s == pytest.approx(1.0 / rate_hz)


def test_nothing_is_started_unless_it_is_asked_for():
    rig = Rig(running=False).run(3.0)
    assert rig.session.phase == "idle"
    assert rig.states[-1].hold_reason == "power is off; motion is not enabled"
    assert "dashboard" not in rig.numbers
    assert "primary" not in rig.numbers


def test_at_start_is_once():
    rig = Rig({"enable": "at-start"}).run(1.0)
    assert rig.states[-1].ready
    rig.unplug("rtde")
    rig.run(3.0)
    assert rig.states[-1].link is RobotLink.LIVE
    assert not rig.states[-1].ready
    assert rig.session.starts == 1


def test_two_connections_are_closed_once_the_program_runs():
    rig = Rig().ready()
    assert set(rig.numbers) == {"rtde"}


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
    rig = Rig({"start_timeout_s": 2.0}, **controller).run(0.5)
    rig.session.ask("enable", rig.now_s)
    rig.run(2.5)
    assert rig.session.phase == "idle"
    assert words in rig.states[-1].hold_reason
    assert words in rig.session.diagnosis(rig.now_s)[0]
    assert set(rig.numbers) == {"rtde"}


def test_another_program_is_not_stopped():
    rig = Rig(faults={"other-program": 0.1}).run(0.5)
    rig.session.ask("enable", rig.now_s)
    rig.run(2.0)
    assert "another program runs at the controller" in rig.states[-1].hold_reason
    assert rig.controller.program_name == "other"


def test_a_program_that_the_controller_does_not_understand_is_named(monkeypatch):
    monkeypatch.setattr(
        "cardan.drivers.ur_rtde.session.program",
        lambda *a: "def cardan():\n  optimovej([0])\nend\n",
    )
    rig = Rig().run(0.5)
    rig.session.ask("enable", rig.now_s)
    rig.run(1.0)
    assert "line 2: optimovej() is not supported" in rig.states[-1].hold_reason


def test_text_of_a_urcap_during_a_start_is_none_of_its_failures():
    rig = Rig().run(0.5)
    rig.session.ask("enable", rig.now_s)

    def said():
        rig.controller.messages.append(text_message(rig.now_s, "URCap: gripper ready"))
        return rig.states[-1].ready

    rig.run(5.0, until=said)
    assert rig.states[-1].ready, rig.states[-1].hold_reason


@pytest.mark.parametrize("channel", ["dashboard", "primary"])
def test_a_start_without_one_of_the_ports(channel):
    rig = Rig().run(0.5)
    connect = rig._connect

    def fails(name):
        if name == channel:
            rig.session.connect_failed(name, "Connection refused", rig.now_s)
        else:
            connect(name)

    rig._connect = fails
    rig.session.ask("enable", rig.now_s)
    rig.run(0.5)
    port = rig.options.dashboard_port if channel == "dashboard" else rig.options.primary_port
    assert f"port {port}: Connection refused" in rig.states[-1].hold_reason


def test_registers_that_a_fieldbus_has():
    rig = Rig(faults={"in-use": 1.0}).run(1.0)
    assert rig.states[-1].link is RobotLink.WAITING
    assert "a fieldbus, has the registers input_int_register_24" in rig.states[-1].hold_reason


def test_two_drivers_at_one_controller():
    rig = Rig().ready()
    other = rig.servers.accepted("rtde", rig.now_s)
    from cardan.protocols.ur.rtde import ask_inputs, ask_version

    rig.servers.data(other, ask_version(), rig.now_s)
    rig.servers.data(other, ask_inputs(["input_int_register_24"]), rig.now_s)
    answers = b"".join(data for number, data in rig.servers.outgoing() if number == other)
    assert b"IN_USE" in answers


def test_nobody_listens():
    rig = Rig()
    rig.reachable = False
    rig.run(1.0)
    assert rig.states[-1].hold_reason == "no RTDE connection to 127.0.0.1:30004: Connection refused"
    gaps = np.diff([state.stamp_s for state in rig.states])
    assert gaps.max() < 0.1
    rig.reachable = True
    rig.run(2.5)
    assert rig.states[-1].link is RobotLink.LIVE


# -- moving ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
def test_a_speed_is_followed(robot):
    rig = turning(robot=robot)
    assert speeds(rig)[-10:] == pytest.approx(SPEED, rel=1e-3)
    assert rig.session.diagnosis(rig.now_s) == ()
    assert rig.session.metrics()["lost"] == 0.0


@pytest.mark.parametrize("registers", ["upper", "lower"])
def test_a_place_is_reached_within_the_limits(registers):
    goal = (0.5, -1.2, 1.2, -1.3, -1.4, 0.4)
    rig = Rig(
        {"acceleration_rad_s2": (ACCELERATION,) * 6, "registers": registers},
        lambda state: JointCommand(goal),
    ).ready()
    rig.run(3.0)
    assert rig.controller.motion.actual_q == pytest.approx(goal, abs=1e-4)
    path = np.array([q for _, q, _ in rig.trace])
    rates = np.diff(path, axis=0) / rig.controller.period_s
    assert np.abs(rates).max() <= max(rig.options.limits.velocity) * 1.001
    assert np.abs(np.diff(rates, axis=0)).max() / rig.controller.period_s <= ACCELERATION * 1.05


def test_a_far_goal_is_no_jump():
    rig = Rig(answer=lambda state: JointCommand((3.0, *HOME[1:]))).ready().run(0.01)
    assert place(rig) < 0.01


def test_a_goal_outside_of_the_ranges_stays_inside():
    rig = Rig(answer=lambda state: JointCommand((0.0, -1.57, 9.0, -1.57, -1.57, 0.0))).ready()
    rig.run(3.0)
    assert rig.session.phase == "moving"
    assert rig.controller.motion.target_q[2] == pytest.approx(rig.options.limits.upper[2], abs=1e-3)


def test_a_hold_brakes_and_stays():
    rig = turning()
    rig.answer = lambda state: HoldCommand()
    rig.run(0.5)
    at = place(rig)
    rig.run(0.5)
    assert place(rig) == pytest.approx(at, abs=1e-6)
    assert rig.session.phase == "moving"


def test_what_the_robot_cannot_take():
    rig = Rig().ready()
    take = rig.session.command
    with pytest.raises(CommandError, match="takes no torque"):
        take(TorqueCommand((0.0,) * 6), rig.now_s)
    with pytest.raises(CommandError, match="5 values for 6 joints"):
        take(JointCommand((0.0,) * 5), rig.now_s)
    with pytest.raises(CommandError, match="finite"):
        take(JointCommand((float("nan"),) * 6), rig.now_s)
    assert CommandKind.TORQUE not in rig.session.capabilities.commands


def test_a_state_is_answered_once():
    rig = Rig(answer=lambda state: None).ready()
    before = rig.session.commands
    rig.session.command(HoldCommand(), rig.now_s)
    rig.session.command(HoldCommand(), rig.now_s)
    assert rig.session.commands == before + 1


@pytest.mark.parametrize("fault", [{"split": 1.0}, {"garbage": 0.3}, {"skip": 0.2}, {"late": 4.0}])
def test_a_bad_line_does_not_keep_the_arm_from_moving(fault):
    rig = turning(faults=fault)
    assert rig.session.phase == "moving"
    assert speeds(rig, rig.now_s - 0.2) == pytest.approx(SPEED, rel=0.1)
    assert (rig.session.metrics()["ignored"] > 0.0) == ("garbage" in fault)
    assert (rig.session.metrics()["lost"] > 0.0) == ("skip" in fault)


def test_the_program_is_understood_with_every_option():
    for options in (
        UrRtdeOptions(),
        UrRtdeOptions(registers="lower", watchdog_s=0.5, gain=2000, lookahead_s=0.2),
    ):
        assert isinstance(parse(program(options.servoing, 2**31 - 1, 0.002)), Program)


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
    rig = turning()
    act, words = EVENTS[event]
    act(rig.controller)
    rig.run(1.0)
    assert words in rig.states[-1].hold_reason
    assert "enable again" in rig.states[-1].hold_reason
    assert not rig.states[-1].ready
    at = place(rig)
    rig.run(1.0)
    assert place(rig) == pytest.approx(at, abs=1e-9)


def test_after_a_protective_stop_nothing_moves_until_it_is_enabled_again():
    rig = turning()
    rig.controller.protective_stop("a person")
    rig.run(6.0)
    at, session = place(rig), rig.states[-1].session
    assert rig.controller.unlock_protective_stop() == "Protective stop releasing"
    rig.run(1.0)
    assert rig.controller.safety is SafetyMode.NORMAL
    assert "protective stop" in rig.states[-1].hold_reason
    assert place(rig) == pytest.approx(at, abs=1e-9)
    began = rig.now_s
    rig.answer = lambda state: HoldCommand()
    rig.session.ask("enable", rig.now_s)
    rig.run(1.0)
    assert rig.states[-1].ready
    assert rig.states[-1].session > session
    assert np.abs(speeds(rig, began)).max() < 1e-6


def test_the_driver_can_unlock_a_protective_stop_where_it_is_asked_to():
    rig = turning()
    rig.controller.protective_stop("a person")
    rig.run(1.0)
    rig.session.ask("unlock", rig.now_s)
    rig.run(0.5)
    assert rig.controller.safety is SafetyMode.PROTECTIVE_STOP
    assert "until 5s after" in rig.session.end_reason
    rig.run(5.0)
    rig.session.ask("unlock", rig.now_s)
    rig.run(0.5)
    assert rig.controller.safety is SafetyMode.NORMAL
    assert rig.states[-1].hold_reason == "motion is not enabled"


def test_a_program_that_is_resumed_at_the_pendant_ends():
    rig = turning()
    rig.controller.pause()
    rig.run(0.5)
    at = place(rig)
    rig.controller.resume()
    rig.run(1.0)
    assert not rig.controller.has_program
    assert place(rig) == pytest.approx(at, abs=0.02)
    assert not rig.states[-1].ready


def test_a_dead_computer_is_noticed_by_the_program():
    rig = turning()
    at, from_s = place(rig), rig.now_s
    rig.alive = False
    rig.run(1.0)
    assert not rig.controller.has_program
    far = place(rig) - at
    braking = SPEED**2 / (2.0 * STOP)
    assert far == pytest.approx(SPEED * (rig.options.watchdog_s + 0.004) + braking, abs=0.004)
    assert np.abs(speeds(rig, from_s)).max() <= SPEED * 1.01
    assert np.abs(np.diff(speeds(rig, from_s))).max() / rig.controller.period_s <= STOP * 1.05


def test_a_computer_that_comes_back_too_late_is_told():
    rig = turning()
    rig.stall(0.5)
    at = place(rig)
    rig.run(1.0)
    assert "no command came in time" in rig.states[-1].hold_reason
    assert place(rig) == pytest.approx(at, abs=1e-9)


@pytest.mark.parametrize("gap_ms", [10, 20, 40, 80])
def test_time_that_was_lost_is_not_made_up_for(gap_ms):
    began = []

    def follow(state):
        began.append(state.stamp_s)
        moved = SPEED * (state.stamp_s - began[0])
        return JointCommand((moved, *HOME[1:]), (SPEED, 0.0, 0.0, 0.0, 0.0, 0.0))

    rig = Rig({"acceleration_rad_s2": (ACCELERATION,) * 6})
    rig.ready()
    rig.answer = follow
    rig.run(0.6)
    from_s = rig.now_s
    rig.stall(1e-3 * gap_ms)
    rig.run(0.6)
    assert rig.session.phase == "moving"
    after = speeds(rig, from_s)
    assert after.max() <= SPEED * 1.05
    assert after.min() >= 0.0
    assert np.abs(np.diff(after)).max() / rig.controller.period_s <= ACCELERATION * 1.05


HOME = (0.0, -np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, 0.0)


def test_an_application_that_stops_during_a_gap_brakes():
    rig = turning()
    rig.stall(0.05)
    rig.answer = lambda state: HoldCommand()
    rig.run(0.5)
    assert abs(speeds(rig)[-1]) < 1e-6


# -- sessions --------------------------------------------------------------------------------------


def test_a_lost_connection_ends_motion_and_its_program():
    rig = turning()
    at = place(rig)
    rig.unplug("rtde")
    rig.run(3.0)
    assert not rig.controller.has_program
    assert place(rig) - at < SPEED * 0.13 + SPEED**2 / (2.0 * STOP) + 0.01
    assert rig.states[-1].link is RobotLink.LIVE
    assert "enable again" in rig.states[-1].hold_reason
    began = rig.now_s
    rig.session.ask("enable", rig.now_s)
    rig.answer = lambda state: HoldCommand()
    rig.run(1.0)
    assert rig.states[-1].ready
    assert np.abs(speeds(rig, began)).max() < 1e-6


def test_a_program_of_an_earlier_connection_obeys_no_later_one():
    rig = turning()
    rig.unplug("rtde")
    rig.run(0.001)
    token = rig.controller.registers.output_int[24]
    rig.run(0.6)
    assert rig.controller.registers.input_int[24] == 0 != token


def test_a_command_that_was_meant_for_an_earlier_run_does_not_act():
    rig = turning()
    old = rig.controller.registers.input_int[24]
    rig.controller.stop_program()
    rig.run(0.5)
    rig.answer = lambda state: HoldCommand()
    rig.ready()
    at = place(rig)
    rig.alive = False
    registers = rig.controller.registers
    for beat in range(100):
        registers.input_int[24:27] = [old, 10_000 + beat, ProgramCommand.FOLLOW]
        registers.input_double[24:36] = [at + 0.001 * beat, *HOME[1:], 0.5, 0.0, 0.0, 0.0, 0.0, 0.0]
        rig.run(0.002)
    assert place(rig) == pytest.approx(at, abs=1e-6)
    assert "no command" not in rig.states[-1].hold_reason
    assert not rig.controller.has_program


def test_a_state_of_before_is_not_answered_after_a_new_start():
    rig = turning()
    rig.answer = lambda state: None
    rig.run(0.01)
    assert rig.session.reply_pending
    rig.controller.stop_program()
    rig.run(0.05)
    before = rig.session.commands
    rig.session.command(TURN, rig.now_s)
    assert rig.session.commands == before


def test_a_jump_in_the_registers_ends_the_program():
    rig = turning()
    registers = rig.controller.registers
    rig.stall(0.001)  # what is underway arrives
    rig.alive = False
    token, beat = registers.input_int[24:26]
    registers.input_int[24:27] = [token, beat + 1, ProgramCommand.FOLLOW]
    registers.input_double[24] = place(rig) + 0.5
    rig.run(0.5)
    assert not rig.controller.has_program
    assert rig.controller.safety is SafetyMode.NORMAL
    rig.alive = True
    rig.run(0.2)
    assert "too far from the one before" in rig.states[-1].hold_reason


def test_a_program_that_gets_no_first_command_ends():
    rig = Rig(answer=lambda state: None)
    rig.run(0.5)
    rig.session.ask("enable", rig.now_s)
    rig.run(0.5, until=lambda: rig.controller.registers.output_int[25] == 1)
    rig.alive = False
    rig.run(FIRST_WAIT_S + 0.3)
    assert not rig.controller.has_program


def test_a_program_that_answers_no_more_is_noticed():
    rig = turning()
    # Another client's program, which leaves the registers as they are.
    rig.controller._program = None
    rig.run(1.0)
    assert rig.session.phase == "idle"
    assert "does not answer" in rig.states[-1].hold_reason


# -- the speed slider ------------------------------------------------------------------------------


def test_the_slider_scales_the_highest_speeds():
    rig = Rig(
        {"velocity_rad_s": (1.0,) * 6},
        lambda state: JointVelocityCommand((2.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        faults={"slider": 0.25},
    ).ready()
    rig.run(1.0)
    assert speeds(rig)[-20:].mean() == pytest.approx(0.25, rel=0.01)
    assert speeds(rig).max() < 0.26
    assert "the speed slider is at 25 %" in rig.session.diagnosis(rig.now_s)[0]


def test_a_slow_speed_is_followed_with_the_slider_down():
    rig = turning(faults={"slider": 0.5})
    assert speeds(rig)[-20:].mean() == pytest.approx(SPEED, rel=0.01)


def test_the_slider_at_zero():
    rig = turning()
    session = rig.states[-1].session
    rig.controller.slider = 0.0
    rig.run(0.5)
    assert "the speed slider is at 0" in rig.states[-1].hold_reason
    at = place(rig)
    rig.controller.slider = 1.0
    rig.answer = lambda state: HoldCommand()
    rig.run(0.5)
    assert rig.states[-1].ready
    assert rig.states[-1].session == session + 1
    assert place(rig) == pytest.approx(at, abs=1e-3)


# -- the end ---------------------------------------------------------------------------------------


def test_leaving_brakes_and_ends_the_program():
    rig = turning()
    from_s = rig.now_s
    rig.session.leave(rig.now_s)
    rig.run(1.0, until=lambda: rig.session.left)
    assert rig.session.left
    rig.run(0.2)
    assert not rig.controller.has_program
    assert np.abs(np.diff(speeds(rig, from_s))).max() / rig.controller.period_s <= 5.1
    assert abs(speeds(rig)[-1]) < 1e-6


def test_disabling_and_enabling_again():
    rig = turning()
    rig.session.ask("disable", rig.now_s)
    rig.run(1.0)
    assert rig.states[-1].hold_reason == "motion is not enabled"
    rig.ready()
    rig.run(0.5)
    assert speeds(rig)[-10:] == pytest.approx(SPEED, rel=1e-3)


def test_a_start_that_is_left_moves_nothing():
    rig = Rig(running=False).run(0.5)
    rig.session.ask("enable", rig.now_s)
    rig.run(0.05)
    rig.session.leave(rig.now_s)
    assert rig.session.left
    rig.run(3.0)
    assert not rig.controller.has_program


# -- silence and bad numbers -----------------------------------------------------------------------


def test_a_silent_controller_is_lost():
    rig = turning(faults={"silent": 2.0})
    rig.run(2.0)
    assert rig.states[-1].link is RobotLink.LOST
    assert "no state from 127.0.0.1:30004 for 0.1 s" in rig.states[-1].hold_reason
    late = [state.stamp_s for state in rig.states[-10:]]
    assert np.diff(late).max() < 0.1


def test_numbers_that_no_robot_measures_are_no_state():
    rig = turning()
    rig.controller.motion.actual_q[0] = float("nan")
    rig.run(0.5)
    assert rig.session.protocol_errors()["implausible"] > 0
    assert rig.states[-1].link is RobotLink.LOST
    assert "actual_q" in " ".join(rig.session.diagnosis(rig.now_s))


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


@pytest.mark.parametrize("stop", ["protective_stop", "safeguard_stop"])
def test_what_to_do_is_said_once(stop):
    rig = turning()
    getattr(rig.controller, stop)(*(["a person"] if stop == "protective_stop" else []))
    rig.run(0.5)
    assert rig.session.end_reason.count("enable again") == 1


def test_reduced_mode_is_said_and_stops_nothing():
    rig = turning()
    rig.controller.safety = SafetyMode.REDUCED
    rig.run(0.2)
    assert rig.states[-1].ready
    assert any("reduced mode" in each for each in rig.session.diagnosis(rig.now_s))
    rig.session.ask("disable", rig.now_s)
    rig.run(1.0)
    assert "reduced mode" in rig.states[-1].hold_reason


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
    rig = Rig({"robot": robot, "rate_hz": 125.0}, robot=peer).run(0.5)
    said = [each for each in rig.session.diagnosis(rig.now_s) if "set robot" in each]
    assert [words in each for each in said] == [True] * bool(words)


def test_an_arm_of_another_size_is_said_once_the_controller_has_told():
    rig = Rig()
    received = rig.session.received
    rig.session.received = lambda channel, data, now_s: received(
        channel, data.replace(b"UR5\n", b"UR10\n"), now_s
    )
    rig.ready()
    (said,) = rig.session.diagnosis(rig.now_s)
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
    assert "RTDE; it says" in session.hold_reason
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
        assert session.outgoing() == []  # Nothing is left for the next connection.
    assert "3 times without an answer: it does not seem to speak RTDE" in session.hold_reason


def test_an_arm_that_is_off_its_target_for_good_ends_motion():
    rig = turning()
    value = rig.servers.telemetry.value
    off = {"rad": 0.3}
    rig.servers.telemetry.value = lambda name: (
        tuple(q + off["rad"] for q in value(name)) if name == "actual_q" else value(name)
    )
    rig.run(0.2)
    assert rig.states[-1].ready
    rig.run(0.2)
    assert "0.3" in rig.states[-1].hold_reason
    assert "from its target" in rig.states[-1].hold_reason
    assert not rig.session.enabled


def test_a_wrong_clock_is_said_and_is_not_enabled_with():
    rig = turning()
    value = rig.servers.telemetry.value
    began_s = rig.now_s
    rig.servers.telemetry.value = lambda name: (
        value(name) + (0.6 * (rig.now_s - began_s) if name == "timestamp" else 0.0)
        if name == "timestamp"
        else value(name)
    )
    rig.run(1.2)
    assert "1.6 times as fast" in rig.states[-1].hold_reason
    assert rig.states[-1].hold_reason.count("enable again") == 1
    rig.session.ask("enable", rig.now_s)
    rig.run(1.0)
    assert rig.session.phase == "idle"


@pytest.mark.parametrize("simulated", [False, True])
def test_a_simulation_at_half_speed_moves_with_the_option_and_is_told_of_it_without(simulated):
    rig = turning(driver={"simulated_time": simulated})
    value = rig.servers.telemetry.value
    began_s = rig.now_s
    rig.servers.telemetry.value = lambda name: (
        value(name) - 0.5 * (rig.now_s - began_s) if name == "timestamp" else value(name)
    )
    rig.run(2.0)
    assert rig.states[-1].ready is simulated
    assert ("simulated_time = true" in rig.states[-1].hold_reason) is not simulated
