"""The simulated arm's driver: in process in virtual time, and over UDP with a served arm."""

from __future__ import annotations

import dataclasses
import math
import re
import time
from itertools import count, islice, pairwise
from types import SimpleNamespace

import pytest

from cardan.drivers import registry
from cardan.drivers.sim_arm import SimArm, SimArmOptions, SimArmSession
from cardan.errors import AddressError, CommandError, NotOpenError
from cardan.protocols.joint_stream.codec import ArmState, ControlMode, decode_command, encode_state
from cardan.sim_peers.arm.faults import FAULTS
from cardan.sim_peers.arm.options import PlantOptions, SimulatedArmOptions
from cardan.sim_peers.arm.udp import SimulatedArmPeer
from cardan.types import (
    IDENTITY_POSE,
    CommandKind,
    Frame,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    PoseCommand,
    RobotLink,
    TorqueCommand,
)
from tests.serving import in_a_thread
from tests.test_docs import rows, section, text, written
from tests.waiting import WITHIN_S

pytestmark = pytest.mark.matrix

ROBOT = "gofa_crb15000_5"
START = tuple(map(math.radians, (0.0, 40.0, 0.0, 0.0, 30.0, 0.0)))
SPEED = JointVelocityCommand((0.2, 0.0, 0.0, 0.0, 0.0, 0.0))


def arm(**options):
    return SimArm(SimArmOptions(**{"robot": ROBOT, "pacing": "virtual", "start": START, **options}))


def drive(robot, cycles, command=None):
    """Run some cycles with the result of `command` for each state; return the states."""
    states = []
    for state in islice(robot.cycles(), cycles):
        states.append(state)
        if command is not None:
            robot.send(command(state))
    return states


def test_states_in_virtual_time():
    with arm() as robot:
        states = drive(robot, 100, lambda _: HoldCommand())
        first, last = states[0], states[-1]
        assert [round(s.stamp_s / 0.002) for s in states] == list(range(1, 101))
        assert all(s.link is RobotLink.LIVE and s.ready and s.session == 1 for s in states)
        assert all(b.period_s == pytest.approx(0.002) for _, b in pairwise(states))
        assert first.joints == pytest.approx(START, abs=1e-6)
        assert last.pose.frame is Frame.BASE
        assert last.pose == robot.arm.plant.pose
        assert last.wrench.force == (0.0, 0.0, 0.0)
        assert len(last.velocities) == len(last.torques) == 6
        assert abs(last.torques[1]) > 5.0
        assert robot.link is RobotLink.LIVE
        assert robot.metrics()["states"] == 100.0
        assert robot.diagnosis() == ()


def test_virtual_time_is_repeatable():
    def play():
        with arm(faults=("noise-deg", "drop"), seed=5) as robot:
            return drive(robot, 100, lambda _: SPEED)

    assert play() == play()


def test_every_kind_of_command_moves_it():
    target = tuple(q + 0.05 for q in START)
    with arm(gravity_feedforward=True) as robot:
        assert drive(robot, 500, lambda _: JointCommand(target))[-1].joints == pytest.approx(
            target, abs=1e-3
        )
        last = drive(robot, 250, lambda _: SPEED)[-1]
        assert last.velocities[0] == pytest.approx(0.2, abs=0.01)
        falling = drive(robot, 50, lambda _: TorqueCommand((0.0,) * 6))[-1]
        assert falling.velocities[1] > 0.05
        assert drive(robot, 300, lambda _: HoldCommand())[-1].velocities == pytest.approx(
            (0.0,) * 6, abs=5e-3
        )


def test_ideal_drives_are_where_they_were_asked_to_be_at_the_next_state():
    target = tuple(q + 0.05 for q in START)
    with arm(drive="ideal") as robot:
        states = drive(robot, 2, lambda _: JointCommand(target, (0.1,) * 6))
        assert states[1].joints == target
        assert states[1].velocities == (0.1,) * 6
        assert CommandKind.TORQUE not in robot.capabilities.commands
        with pytest.raises(CommandError, match="takes no torque"):
            robot.send(TorqueCommand((0.0,) * 6))


def test_an_unanswered_state_is_answered_with_a_hold():
    with arm() as robot:
        drive(robot, 100, lambda _: SPEED)
        states = drive(robot, 300)
        assert abs(states[-1].velocities[0]) < 1e-3
        assert robot.arm.counters.timeouts == 0


def test_the_mode_ends_with_the_loop():
    with arm() as robot:
        for k, _ in enumerate(robot.cycles()):
            robot.send(SPEED)
            if k == 50:
                break
        drive(robot, 1)
        assert robot.arm.state().mode is ControlMode.HOLD


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (JointCommand((0.0,) * 5), "positions: 5 values for 6 joints"),
        (JointCommand((9.0, 0.0, 0.0, 0.0, 0.0, 0.0)), "positions: joint 1 at 9; allowed: -3.16"),
        (JointCommand((math.nan,) * 6), "joint 1 at nan"),
        (JointCommand((0.0,) * 6, (99.0,) * 6), "velocities: joint 1 at 99"),
        (JointCommand((0.0,) * 6, None, (0.1,)), "external_axes: the simulated arm has none"),
        (JointVelocityCommand((0.0,) * 5 + (-99.0,)), "velocities: joint 6 at -99"),
        (TorqueCommand((math.inf,) * 6), "torques: joint 1 at inf"),
        (PoseCommand(IDENTITY_POSE), "takes no pose; it takes hold, joint, joint velocity, torque"),
    ],
)
def test_what_it_cannot_take_is_refused_and_nothing_is_sent(command, reason):
    with arm() as robot:
        for _ in islice(robot.cycles(), 3):
            taken = robot.arm.counters.taken
            with pytest.raises(CommandError, match=reason):
                robot.send(command)
            assert robot.arm.counters.taken == taken


def test_a_restart_is_silence_and_then_a_new_session():
    with arm(faults=("restart=0.2",)) as robot:
        states = drive(robot, 400, lambda _: SPEED)
        links = [s.link for s in states]
        assert RobotLink.LOST in links
        lost = [s for s in states if s.link is RobotLink.LOST]
        assert all(not s.ready and s.pose is None for s in lost)
        assert all(b.stamp_s - a.stamp_s <= 0.1021 for a, b in pairwise(states))
        assert states[-1].session == 2
        assert states[-1].link is RobotLink.LIVE
        assert states[-1].velocities[0] == pytest.approx(0.2, abs=0.01)


def test_the_network_may_be_bad():
    faults = ("drop", "duplicate", "reorder", "jitter", "garbage")
    with arm(faults=faults) as robot:
        states = drive(robot, 500, lambda _: SPEED)
        numbers = [s.sequence for s in states]
        assert numbers == sorted(set(numbers))
        assert states[-1].velocities[0] == pytest.approx(0.2, abs=0.02)
        assert robot.metrics()["ignored"] > 10
        assert any("datagrams ignored" in line for line in robot.diagnosis())


def test_an_emergency_stop_is_a_hold_reason():
    with arm(faults=("estop=0.1",)) as robot:
        state = drive(robot, 100, lambda _: SPEED)[-1]
        assert state.hold_reason == "emergency stop"
        assert robot.diagnosis() == ("emergency stop",)


def test_contact_is_reported():
    with arm(drive="ideal") as robot:
        tcp = drive(robot, 1)[0].pose.position
    plane = (0.0, 0.0, tcp.z, 0.0, 0.0, 1.0)
    with arm(drive="ideal", planes=(plane,)) as robot:
        assert drive(robot, 1)[0].wrench.force.z == pytest.approx(-200.0)  # 2 cm · 10 N/mm
    with arm(drive="ideal", spheres=((tcp.x, tcp.y, tcp.z - 0.11, 0.1),)) as robot:
        assert drive(robot, 1)[0].wrench.force.z == pytest.approx(-100.0)


@pytest.mark.real
def test_real_time_keeps_an_absolute_schedule():
    with arm(pacing="real-time", drive="ideal", period_s=0.004) as robot:
        start_s = time.monotonic()
        states = drive(robot, 50, lambda _: HoldCommand())
        assert time.monotonic() - start_s >= 49 * 0.004 - 0.001
        assert start_s <= states[0].stamp_s < states[-1].stamp_s <= time.monotonic()


def test_instants_that_were_missed_are_counted_and_left_out(monkeypatch):
    """Only a sleep and the application advance the clock."""
    now_s = 100.0

    def sleep(seconds):
        nonlocal now_s
        now_s += seconds + 20e-6

    clock = SimpleNamespace(sleep=sleep)
    monkeypatch.setattr("cardan.drivers.sim_arm.driver._monotonic", lambda: now_s)
    monkeypatch.setattr("cardan.drivers.sim_arm.driver.time", clock)
    with arm(pacing="real-time", drive="ideal", period_s=0.001) as robot:
        stamps = []
        for number, state in enumerate(islice(robot.cycles(), 200)):
            stamps.append(state.stamp_s)
            robot.send(SPEED)
            now_s += 0.0034 if number == 99 else 0.0004
        metrics = robot.metrics()
    assert metrics["superseded"] == 2
    assert metrics["instants"] == 202
    assert metrics["late_p50_s"] == pytest.approx(20e-6, rel=0.03)
    assert metrics["late_max_s"] == pytest.approx(2.42e-3)
    assert stamps[-1] == pytest.approx(100.0 + 202 * 0.001 + 20e-6)
    assert "late_p50_s" not in arm().metrics()  # no latency in virtual time


def test_open_and_close():
    robot = arm()
    assert robot.arm is None
    assert robot.diagnosis() == ("the simulated arm's driver is not open",)
    with pytest.raises(NotOpenError):
        robot.cycles()
    with pytest.raises(NotOpenError):
        robot.send(HoldCommand())
    robot.open()
    robot.open()
    states = robot.cycles()
    assert next(states).link is RobotLink.LIVE
    robot.close()
    robot.close()
    assert list(states) == []
    with robot:
        assert drive(robot, 1)[0].session == 1


def test_capabilities_are_the_arms():
    capabilities = arm().capabilities
    assert capabilities.joints == 6
    assert capabilities.period_s == 0.002
    assert capabilities.limits.upper[2] == pytest.approx(math.radians(85.0), abs=1e-4)
    assert CommandKind.TORQUE in capabilities.commands
    assert registry.load("sim_arm") is SimArm


@pytest.mark.parametrize(
    "options",
    [
        {"robot": "nosuch"},
        {"transport": "carrier pigeon"},
        {"pacing": "slow"},
        {"endpoint": "nowhere"},
        {"period_s": 0.0},
        {"period_s": 1.0},
        {"start": (0.0,)},
        {"start": (math.nan,) * 6},
        {"planes": ((0.0, 0.0),)},
        {"spheres": ((0.0, 0.0, 0.0, -1.0),)},
        {"faults": ("nosuch",)},
        {"transport": "udp", "pacing": "virtual"},
        {"transport": "udp", "pacing": "real-time", "payload_kg": 1.0},
    ],
)
def test_bad_options(options):
    with pytest.raises(ValueError):  # noqa: PT011 - any of them names its key itself
        arm(**options)


def test_the_page_tells_every_option_and_fault():
    table = rows(section(text("simulated-peers.md"), "Options"))
    defaults = {f.name: written(f.default) for f in dataclasses.fields(SimArmOptions)}
    assert {name: cells[0] for name, cells in table.items() if name in defaults} == defaults
    page = section(text("simulated-peers.md"), "The arm: `cardan sim arm`")
    switches = {switch.name: f"{switch.default:g}" for switch in FAULTS}
    reported = rows(section(page, "Its faults"))
    assert {name: cells[0] for name, cells in reported.items()} == switches


# -- the session --------------------------------------------------------------------------------

STATE = ArmState(
    session=5,
    sequence=1,
    stamp_s=1.0,
    mode=ControlMode.HOLD,
    acknowledged=0,
    period_s=0.002,
    positions=(0.0,) * 6,
    velocities=(0.0,) * 6,
    torques=(0.0,) * 6,
    pose=(0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
    wrench=(0.0,) * 6,
)


def test_an_arm_that_began_anew_elsewhere_is_commanded_when_it_can_be_there():
    """The same holds for two arms that are received, of which the later one began last."""
    session = SimArmSession(SimArmOptions(robot=ROBOT))
    away = (1.0, *(0.0,) * 5)

    def receive(number, **changes):
        now_s = 0.002 * number
        state = STATE._replace(sequence=number, stamp_s=1.0 + now_s, **changes)
        return session.receive(encode_state(state), now_s)

    assert all(receive(number).ready for number in range(1, 10))
    state = receive(10, session=6, positions=away)
    assert (state.session, state.ready, state.joints) == (1, False, (0.0,) * 6)
    assert state.hold_reason.startswith("joint 1 jumped from 0 to 1, by 1, and its limit is")
    assert receive(10).ready, "the previous process is accepted, too"
    fastest = session.capabilities.limits.velocity[0]
    for number in range(11, 500):
        state = receive(number, session=6, positions=away)
        if state.ready:
            break
    assert 0.002 * (number - 10) == pytest.approx((1.0 - 0.05) / (2.0 * fastest), abs=0.003)
    assert state.joints == away
    assert receive(number + 1, session=5) is None


@pytest.mark.parametrize(("mode", "gap_s"), [(ControlMode.POSITION, 0.05), (ControlMode.HOLD, 0.3)])
def test_a_late_command_goes_on_from_where_the_arm_is(mode, gap_s):
    """An arm without commands goes on for command_timeout_s, and brakes then."""
    session = SimArmSession(SimArmOptions(robot=ROBOT))
    numbers, speed = count(1), 0.2

    def ahead(cycle, skipped=0):
        for number in islice(numbers, skipped + 1):
            now_s = 0.002 * number
            state = STATE._replace(sequence=number, stamp_s=1.0 + now_s, mode=mode)
            session.receive(encode_state(state), now_s)
        place = speed * 0.002 * cycle
        asked = JointCommand((place, *(0.0,) * 5), (speed, *(0.0,) * 5))
        return decode_command(session.command(asked, now_s)).values[0] - place

    assert [ahead(cycle) for cycle in range(10)] == pytest.approx([0.0] * 10)
    went = speed * gap_s
    if mode is ControlMode.HOLD:
        braking = session.capabilities.limits.acceleration[0]
        went = speed * session.options.command_timeout_s + 0.5 * speed**2 / braking
    assert ahead(10, round(gap_s / 0.002)) == pytest.approx(went, abs=5e-4)
    session.command(HoldCommand(), 9.0)
    assert ahead(11) == pytest.approx(0.0), "positions after another command are where they are"


def test_late_double_and_earlier_states_change_nothing():
    session = SimArmSession(SimArmOptions(robot=ROBOT))
    assert session.command(HoldCommand(), 0.0) is None

    def receive(now_s, **changes):
        return session.receive(encode_state(STATE._replace(**changes)), now_s)

    assert receive(0.0, sequence=2).session == 1
    assert receive(0.0, sequence=2) is None
    assert receive(0.0, sequence=1) is None
    assert receive(0.0, session=4, sequence=9) is None
    assert receive(0.0, session=6).session == 2
    assert receive(0.0, sequence=3) is None
    # A controller that was off for long may start at any number.
    assert receive(9.0, session=1).session == 3
    assert (
        receive(9.0, session=1, sequence=2, positions=(0.0,), velocities=(0.0,), torques=(0.0,))
        is None
    )
    assert session.receive(b"junk", 9.0) is None
    assert session.metrics() == {"states": 3.0, "lost": 0.0, "ignored": 6.0, "sessions": 3.0}


def test_a_flood_of_junk_is_an_alarm():
    session = SimArmSession(SimArmOptions(robot=ROBOT))
    for _ in range(60):
        session.receive(b"junk", 0.0)
    state = session.receive(encode_state(STATE), 0.0)
    assert state.alarm == "the port is flooded with other datagrams"
    for number in range(2, 30):
        state = session.receive(encode_state(STATE._replace(sequence=number)), 0.0)
    assert state.alarm == ""


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ({"positions": (1e300,) + (0.0,) * 5}, "joints: .* -2000 to 2000 rad or m"),
        ({"velocities": (-1e9,) + (0.0,) * 5}, "velocities"),
        ({"torques": (1e9,) + (0.0,) * 5}, "torques"),
        ({"pose": (1e9, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)}, "position: .* -100 to 100 m"),
    ],
)
def test_a_state_that_no_robot_measures_is_none(part, words):
    session = SimArmSession(SimArmOptions(robot=ROBOT))
    assert session.receive(encode_state(STATE._replace(**part)), 0.0) is None
    assert (session.sessions, session.message) == (0, None)
    assert session.command(HoldCommand(), 0.0) is None
    assert session.receive(encode_state(STATE), 0.0).session == 1
    assert session.receive(encode_state(STATE._replace(sequence=2, **part)), 0.002) is None
    assert session.state.joints == STATE.positions
    assert session.ignored == {"implausible": 2}
    assert session.protocol_errors() == {"order": 0, "implausible": 2, "malformed": 0}
    assert re.search(f"2 datagrams ignored: implausible .{words}", session.diagnosis(0.002)[-1])


class Line:
    """Transport in virtual time that records sent messages and returns one state."""

    def __init__(self, silence_s):
        self.said = []
        self.time_s = 0.0
        self._silence_s = silence_s
        self._states = [encode_state(STATE)]

    def now(self):
        return self.time_s

    def send(self, data):
        self.said.append(decode_command(data).mode)

    def wait(self):
        if self._states:
            return [self._states.pop()]
        self.time_s += self._silence_s
        return []

    def waiting(self):
        return []

    def close(self):
        pass


def test_the_ends_of_the_range_and_any_port_are_taken():
    limits = SimArm(SimArmOptions(robot=ROBOT)).capabilities.limits
    with arm() as robot:
        for goal, _ in zip((limits.lower, limits.upper), robot.cycles(), strict=False):
            robot.send(JointCommand(goal))
    assert SimArmOptions(robot=ROBOT, endpoint="127.0.0.1:65001").address == ("127.0.0.1", 65001)


@pytest.mark.parametrize(("silence_s", "reported"), [(0.45, 1), (0.55, 0)])
def test_an_arm_that_fell_silent_long_ago_is_sent_nothing(monkeypatch, silence_s, reported):
    line = Line(silence_s)
    monkeypatch.setattr(SimArm, "_join", lambda _: line)
    with SimArm(SimArmOptions(robot=ROBOT)) as robot:
        states = robot.cycles()
        assert next(states).link is RobotLink.LIVE
        robot.send(SPEED)
        assert next(states).link is RobotLink.LOST
        line.said.clear()
        robot.send(SPEED)
        assert line.said == []
        states.close()
        assert line.said == [ControlMode.HOLD] * reported
        robot.send(SPEED)
        assert line.said == [ControlMode.HOLD] * reported


# -- over UDP -----------------------------------------------------------------------------------


def served(**options):
    common = {"robot": ROBOT, "plant": PlantOptions(start=START), "port": 0, "period_s": 0.004}
    return in_a_thread(SimulatedArmPeer(SimulatedArmOptions(**common, **options)))


def over_udp(endpoint):
    return SimArm(SimArmOptions(robot=ROBOT, transport="udp", endpoint=endpoint, period_s=0.004))


@pytest.mark.real
def test_over_udp_it_is_the_same_arm():
    with served() as peer, over_udp(peer.endpoint) as robot:
        assert robot.arm is None
        live = []
        end_s = time.monotonic() + WITHIN_S
        for state in robot.cycles():
            assert time.monotonic() < end_s, (len(live), state, peer.core.counters)
            robot.send(SPEED)
            if state.link is not RobotLink.LIVE:
                continue
            live.append(state)
            if (
                len(live) > 90
                and state.velocities[0] == pytest.approx(0.2, abs=0.02)
                and state.joints[0] > 0.03
                and peer.core.counters.taken > 80
            ):
                break


def test_over_udp_silence_is_said():
    with served() as peer:
        endpoint = peer.endpoint
    with over_udp(endpoint) as robot:
        states = drive(robot, 3, lambda _: SPEED)
        assert [s.link for s in states] == [RobotLink.WAITING] * 3
        assert not states[0].ready
        assert robot.link is RobotLink.WAITING
        assert "cardan sim arm" in robot.diagnosis()[0]
    with pytest.raises(AddressError, match=r"endpoint nowhere\.invalid:1"):
        over_udp("nowhere.invalid:1").open()
