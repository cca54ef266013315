"""Robot of examples/packages/cardan-rail in virtual time: its axes stop after every failure.

The driver, the gateway's controller, the simulated controller and a bad network between them; only
sockets, threads and clocks are missing. Checks of every template package are elsewhere.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import pytest

from cardan.errors import CommandError
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.mapping import MappingOptions
from cardan.gateway.session.arm_assembly import make_arm
from cardan.gateway.session.config import parse_config
from cardan.sim_peers.link import FaultyLink
from cardan.types import (
    NEUTRAL,
    DeviceLink,
    DeviceState,
    HoldCommand,
    JointCommand,
    RobotLink,
    TorqueCommand,
)
from tests.controllers import controller_for_device
from tests.test_docs import blocks, text

PACKAGE = Path(__file__).parents[1] / "examples" / "packages" / "cardan-rail"
sys.path.insert(0, str(PACKAGE))

from cardan_rail.driver import Rail, RailSession  # noqa: E402
from cardan_rail.protocol import (  # noqa: E402
    BRAKES_AFTER_S,
    PERIOD_S,
    Condition,
    RailCommand,
    RailState,
    decode_command,
    decode_state,
    encode_command,
    encode_state,
)
from cardan_rail.simulated import FAULTS, RailController  # noqa: E402

SPEED_M_S = 0.1
ACCELERATION_M_S2 = 1.0
GRIPS_S, PUSHES_S, FAILS_S, RESTS_S, ENDS_S = 0.4, 0.6, 1.5, 2.7, 4.5
"""Times when the dead-man is pressed, the device is deflected, a fault begins, both are released,
and the run ends."""

REST_M_S = 0.001
"""Same value as in tests/fault_benches.py. After the release, lost time is compensated at a lower
speed."""

Y = 1


class Wire:
    """Driver's transport: a faulty network with the simulated controller behind it."""

    def __init__(self, faults=None):
        faults = faults or {}
        self.core = RailController(faults)
        self.to_pc, self.to_rail = FaultyLink(faults, 2, garbage=True), FaultyLink(faults, 3)
        self.now_s = 0.0
        self.killed = False
        """True once the gateway's process is dead."""
        self.path = []
        self.ready = []

    def now(self):
        return self.now_s

    def send(self, data):
        if not self.killed:
            self.to_rail.push(self.now_s, data)

    def wait(self):
        until_s = self.now_s + 0.1
        while not self.ready and self.now_s < until_s:
            self.pass_cycle()
        return self.waiting()

    def waiting(self):
        found, self.ready = self.ready, []
        return found

    def close(self):
        pass

    def pass_cycle(self):
        self.now_s += PERIOD_S
        for data in self.to_rail.pop(self.now_s):
            self.core.receive(data, "pc")
        if (state := self.core.cycle()) is not None:
            self.to_pc.push(self.now_s, state)
        self.ready += self.to_pc.pop(self.now_s)
        self.path.append(self.core.positions[Y])

    def run_on(self, seconds):
        """Stop the gateway's process for that time."""
        for _ in range(round(seconds / PERIOD_S)):
            self.pass_cycle()

    def speeds(self):
        return [(b - a) / PERIOD_S for a, b in itertools.pairwise(self.path)]

    def fastest_m_s(self):
        return max(map(abs, self.speeds()))

    def hardest_m_s2(self):
        speeds = self.speeds()
        return max(abs(b - a) / PERIOD_S for a, b in itertools.pairwise(speeds))

    def rests(self, for_s=0.5):
        there = self.path[-round(for_s / PERIOD_S) :]
        return max(there) - min(there) <= REST_M_S * for_s


class WiredRail(Rail):
    def __init__(self, wire):
        super().__init__()
        self.wire = wire

    def _join(self):
        return self.wire


def hand(now_s):
    """Return a device that presses the dead-man, deflects to the left, and releases both."""
    y = 1.0 if PUSHES_S <= now_s < RESTS_S else 0.0
    held = frozenset({"left"} if GRIPS_S <= now_s < RESTS_S else ())
    return DeviceState(now_s, DeviceLink.LIVE, NEUTRAL._replace(y=y), held)


def teleoperate(robot, until_s, stall_s=0.0):
    """Let the device move the rail until then; return the states, and the controller.

    The process is stopped once for `stall_s`.
    """
    tables = {"device": {"driver": "spacemouse"}, "robot": {"driver": "sim_arm"}}
    config = parse_config({**tables, "arm": {"model": "cardan_rail:rail.toml"}})
    controller = controller_for_device(
        MappingOptions(
            deadman=("left",),
            axes=("x", "y", "z", "fixed", "fixed", "fixed"),
            linear_speed_m_s=SPEED_M_S,
        ),
        ReferenceLimits(linear_acceleration_m_s2=ACCELERATION_M_S2),
        arm=make_arm(config, robot),
        period_s=PERIOD_S,
    )
    states = []
    for state in robot.cycles():
        states.append(state)
        if stall_s and robot.wire.now_s >= FAILS_S:
            robot.wire.run_on(stall_s)
            stall_s = 0.0
        robot.send(controller.tick(state, hand(state.stamp_s)))
        if robot.wire.now_s >= until_s:
            return states, controller
    raise AssertionError("the loop ended")


def driven(faults=None, until_s=ENDS_S):
    wire = Wire(faults)
    with WiredRail(wire) as robot:
        states, controller = teleoperate(robot, until_s)
    return wire, states, controller


def test_the_hand_moves_it_within_what_was_asked():
    wire, states, controller = driven()
    assert wire.path[-1] - wire.path[0] == pytest.approx(0.2, rel=0.1)
    assert wire.fastest_m_s() <= SPEED_M_S * 1.001
    assert wire.hardest_m_s2() <= ACCELERATION_M_S2 * 1.05
    assert wire.rests()
    assert controller.status().trips == 0
    assert {state.period_s for state in states if state.link is RobotLink.LIVE} == {PERIOD_S}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_leaves_it_at_rest(fault):
    at_a_time = "at this time" in fault.help
    wire, _, _ = driven({fault.name: FAILS_S if at_a_time else fault.default})
    assert wire.rests()
    assert wire.core.condition in (Condition.FOLLOWING, Condition.EMERGENCY_STOP)
    assert wire.fastest_m_s() <= SPEED_M_S * 1.001
    assert wire.path[-1] > wire.path[0] + 0.05


@pytest.mark.parametrize("fault", ["estop", "restart", "mute"])
def test_it_does_not_go_on_by_itself(fault):
    # The device is still deflected when the controller is back.
    wire, states, controller = driven({fault: FAILS_S}, RESTS_S)
    assert wire.rests()
    assert controller.status().trips == 1
    assert {state.session for state in states[-10:]} == {1 if fault == "estop" else 2}
    assert states[-1].hold_reason.startswith("emergency stop") == (fault == "estop")


def test_a_killed_gateway_leaves_it_at_rest():
    wire = Wire()
    robot = WiredRail(wire)
    robot.open()
    for state in robot.cycles():
        robot.send(JointCommand((0.5, SPEED_M_S * state.stamp_s, -0.2)))
        if state.stamp_s >= FAILS_S:
            wire.killed, at = True, wire.path[-1]
            break
    wire.run_on(1.0)
    assert len(set(wire.path[-62:])) == 1
    silent_s = BRAKES_AFTER_S + 3.0 * PERIOD_S  # commands in transit count, too
    assert wire.path[-1] - at <= SPEED_M_S * silent_s + SPEED_M_S**2 / (2.0 * 2.0)
    assert wire.hardest_m_s2() <= 2.0 * 1.001
    assert decode_state(wire.ready[-1]).condition is Condition.FOLLOWING


@pytest.mark.parametrize("seconds", [0.01, 0.024, 0.1])
def test_a_process_that_stands_still_makes_no_step(seconds):
    wire = Wire()
    with WiredRail(wire) as robot:
        _, controller = teleoperate(robot, ENDS_S, seconds)
    assert wire.rests()
    assert wire.fastest_m_s() <= SPEED_M_S * 1.001
    braked = seconds > BRAKES_AFTER_S
    assert wire.hardest_m_s2() <= (2.0 if braked else ACCELERATION_M_S2) * 1.05
    assert controller.status().trips == braked


def test_it_is_left_at_rest_by_leaving_the_loop():
    wire = Wire()
    with WiredRail(wire) as robot:
        teleoperate(robot, FAILS_S)
    wire.run_on(0.2)
    assert wire.rests(0.1)
    # It braked at once, not only after 40 ms of silence.
    assert wire.path[-1] - wire.path[-25] <= SPEED_M_S * 3.0 * PERIOD_S + SPEED_M_S**2 / 4.0


def started(session, sequence=1, positions=(0.5, 0.0, -0.2), condition=Condition.FOLLOWING):
    return session.receive(encode_state(RailState(7, sequence, condition, positions)), 1.0)


def test_a_step_is_turned_into_what_the_axes_can():
    session = RailSession()
    before, speed = 0.0, 0.0
    for sequence in range(1, 200):
        started(session, sequence)
        command = decode_command(session.command(JointCommand((0.5, 9.0, -0.2)), 1.0))
        now = (command.positions[Y] - before) / PERIOD_S
        assert abs(now) <= 0.5 + 1e-9
        assert abs(now - speed) <= 2.0 * PERIOD_S + 1e-9
        before, speed = command.positions[Y], now
    assert before == pytest.approx(0.4, abs=1e-3)
    assert before <= 0.4


def test_a_controller_that_starts_anew_with_the_same_number_is_heard_again():
    session = RailSession()
    state = encode_state(RailState(1, 900, Condition.FOLLOWING, (0.5, 0.0, -0.2)))
    again = encode_state(RailState(1, 1, Condition.FOLLOWING, (0.6, 0.0, -0.2)))
    assert session.receive(state, 1.0).session == 1
    assert session.receive(again, 1.05) is None
    assert session.receive(again, 1.2).session == 2
    assert decode_command(session.command(HoldCommand(), 1.2)).positions == (0.6, 0.0, -0.2)
    assert session.metrics()["lost"] == 0.0


def test_a_state_is_answered_once():
    session = RailSession()
    assert session.command(HoldCommand(), 1.0) is None
    started(session)
    assert session.command(HoldCommand(), 1.0) is not None
    assert session.command(HoldCommand(), 1.0) is None


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (TorqueCommand((1.0, 1.0, 1.0)), "the rail takes no torque"),
        (JointCommand((0.5, 0.0)), "2 values for 3 axes"),
        (JointCommand((0.5, float("nan"), -0.2)), "must be finite"),
    ],
)
def test_a_command_that_it_cannot_take_is_refused(command, words):
    session = RailSession()
    started(session)
    with pytest.raises(CommandError, match=words):
        session.command(command, 1.0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "0 bytes; a state has 37"),
        (bytes(37), "not a state of the rail"),
        (encode_state(RailState(1, 1, 9, (0.0, 0.0, 0.0))), "there is no condition 9"),
        (
            encode_state(RailState(1, 1, Condition.FOLLOWING, (float("nan"), 0.0, 0.0))),
            "positions that are not numbers",
        ),
    ],
)
def test_bad_states_are_counted_by_their_reason(data, words):
    session = RailSession()
    assert session.receive(data, 1.0) is None
    assert session.ignored == {words: 1}
    assert f"1 datagrams ignored: {words}" in session.diagnosis(1.0)


def test_the_controller_refuses_too_much_speed_and_strangers():
    core = RailController()
    core.receive(encode_command(RailCommand(0, 0, None)), "pc")
    core.cycle()
    core.receive(encode_command(RailCommand(1, 1, (0.5, 0.3, -0.2))), "stranger")
    core.receive(b"junk", "pc")
    core.cycle()
    assert core.condition is Condition.FOLLOWING
    assert core.client == "pc"
    core.receive(encode_command(RailCommand(1, 2, (0.5, 0.3, -0.2))), "pc")
    core.cycle()
    assert core.condition is Condition.TOO_FAST
    assert core.positions[Y] == 0.0


def test_the_page_shows_what_is_in_the_package():
    source = "".join(file.read_text(encoding="utf-8") for file in PACKAGE.glob("cardan_rail/*.py"))
    shown = [code for code in blocks(text("adding-a-driver.md"), "python") if "class Rail" in code]
    assert len(shown) == 2
    for code in shown:
        assert code in source
