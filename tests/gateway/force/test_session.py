"""Sessions with a haptic device: scripted robots in virtual time, and the simulated Omni."""

from __future__ import annotations

import threading
import time

import pytest
from rich.console import Console

from cardan.common.haptics import HapticState, OperatingState
from cardan.common.tables import read_table
from cardan.drivers import registry
from cardan.drivers.base import RobotDriver
from cardan.errors import ConfigurationError
from cardan.gateway.session.assembly import make_robot
from cardan.gateway.session.config import ForceConfig, parse_config
from cardan.gateway.session.driver_assembly import make_device
from cardan.gateway.session.force_assembly import make_force
from cardan.gateway.session.force_node import run_force_node
from cardan.gateway.session.parts import Forces
from cardan.gateway.session.session import make_session
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.terminal_view import plain, render, summary
from cardan.types import (
    IDENTITY,
    CommandKind,
    Pose,
    PoseCommand,
    RobotCapabilities,
    Vector3,
)
from tests.gateway.fakes import FakeRobotOptions
from tests.gateway.force.fakes import PERIOD_S, robot_state
from tests.snapshots import changed

pytestmark = pytest.mark.matrix

SPHERE = {"shape": "sphere", "center_m": [0.3, 0.0, 0.4], "radius_m": 0.1, "stiffness_n_m": 100.0}
START = Vector3(0.5, 0.0, 0.4)
TABLE = {
    "device": {"driver": "fake_haptic"},
    "robot": {"driver": "scripted"},
    "mapping": {"mode": "position", "clutch": "button_2", "orientation": "fixed"},
}


class ScriptedRobot(RobotDriver):
    """An ideal robot in virtual time; `script` gets each cycle before it is yielded."""

    Options = FakeRobotOptions
    capabilities = RobotCapabilities(
        frozenset({CommandKind.POSE}), PERIOD_S, 6, None, 0, 0, None, None
    )

    def __init__(self, options=None):
        super().__init__(options)
        self.script = lambda k, now_s, place: {}
        self.place = START

    def open(self):
        pass

    def close(self):
        pass

    def diagnosis(self):
        return ()

    def cycles(self):
        for k in range(self.options.cycles):
            now_s = 100.0 + k * PERIOD_S
            yield robot_state(now_s, self.place, **self.script(k, now_s, self.place))

    def send(self, command):
        if isinstance(command, PoseCommand):
            self.place = command.pose.position


@pytest.fixture(autouse=True)
def drivers(monkeypatch):
    for name, target in (
        ("fake_haptic", "tests.gateway.force.fakes:FakeHaptic"),
        ("fake_sensor", "tests.gateway.force.fakes:FakeSensor"),
        ("scripted", "tests.gateway.force.test_session:ScriptedRobot"),
    ):
        monkeypatch.setitem(registry.BUILT_IN, name, target)


def session(cycles=400, script=None, **tables):
    """A session whose operator clutches in at cycle 200, and then moves at 50 mm/s along x."""
    merged = {key: {**TABLE.get(key, {}), **tables.get(key, {})} for key in TABLE}
    merged["robot"]["cycles"] = cycles
    s = make_session(parse_config({**tables, **merged}))
    hand = s.device

    def act(k, now_s, place):
        hand.now_s = now_s
        if k == 200:
            hand.press("button_2")
        moved = max(0, k - 210) * 0.05 * PERIOD_S
        hand.pose = Pose(Vector3(-moved, 0.0, 0.0), IDENTITY)
        return {} if script is None else script(k, now_s, place)

    s.robot.script = act
    return s


def test_a_session_renders_fixtures_from_clutch_in_on():
    s = session(fixtures=[SPHERE])
    last = s.run()
    commands = s.device.commands
    assert len(commands) == 400
    assert [c.engaged for c in commands].index(True) == 200
    assert all(c.engaged for c in commands[200:])
    assert s.device.calls == ["open", "enable", "disable", "close"]
    # the map gives the commanded TCP for the hand's position
    world, hand = commands[-1].world, s.device.pose.position
    assert world.offset.x + hand.x == pytest.approx(s.robot.place.x, abs=5e-3)
    assert s.robot.place.x < 0.47
    assert [c.sequence for c in commands] == list(range(1, 401))
    assert last.force.state == "enabled"
    assert last.diagnosis == []


def test_a_session_feels_what_the_robot_measures():
    def touch(k, now_s, place):
        return {"force": (0.0, 0.0, -2.0 if k < 250 else -12.0)}  # a bias, then a contact

    force = {"source": "measured", "scale": 0.05, "contact_target_n": 8.0}
    s = session(600, touch, force=force)
    last = s.run()
    assert s.device.commands[199].measured is None
    assert s.device.commands[240].measured.force == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert s.device.commands[-1].measured.force == pytest.approx((0.0, 0.0, 0.495))
    assert last.contact.force_n == pytest.approx(10.0)
    # the contact pushes up: positive z
    assert last.force.measured_n == pytest.approx([0.0, 0.0, 0.495])
    assert last.contact.rms_error_n == pytest.approx(2.0, rel=0.1)
    assert last.contact.path_m > 0.05


def test_a_robot_that_stops_is_not_felt():
    def stop(k, now_s, place):
        return {"hold_reason": "motors are off"} if k >= 300 else {}

    s = session(400, stop, fixtures=[SPHERE])
    s.run()
    assert s.device.commands[299].engaged
    assert not any(c.engaged for c in s.device.commands[300:])


def forces(session):
    """Return the session's force renderer."""
    return next(part._force for part in session._parts if isinstance(part, Forces))


def test_a_sensor_that_is_lost_is_felt_no_more():
    force = {"source": "sensor", "sensor": {"driver": "fake_sensor"}, "scale": 0.1}

    def sense(k, now_s, place):
        sensor = forces(s).measured.source.device
        if k < 300:
            sensor.measure(now_s, 0.0, 0.0, 0.0 if k < 160 else 10.0)
        else:
            sensor.sensed = sensor.sensed._replace(wrench=None, reason="unplugged")
        return {}

    s = session(500, sense, force=force)
    last = s.run()
    commands = s.device.commands
    assert commands[299].measured.force == pytest.approx((0.0, 0.0, 0.78), abs=0.01)
    assert commands[300].measured is None
    assert commands[300].engaged
    assert "no measured force: unplugged" in last.diagnosis
    # disengaged 0.1 s after the last reading has become too old
    out = next(k for k in range(300, 500) if not commands[k].engaged)
    assert (out - 300) * PERIOD_S == pytest.approx(0.2, abs=2 * PERIOD_S)
    assert (last.arm.trips, last.force.losses) == (1, 1)
    assert "stopped before: the measured force is lost" in last.arm.message
    assert "unplugged" in last.arm.message
    assert "press 'button_2' to move" in last.arm.message
    assert forces(s).measured.source.device.calls == ["open", "close"]


@pytest.mark.parametrize(
    ("haptic_state", "within_s", "words"),
    [
        ({"state": OperatingState.FAULT, "reason": "fault: it flew"}, 0.0, "fault: it flew"),
        ({"state": OperatingState.DISABLED, "reason": "not enabled"}, 0.0, "not enabled"),
        ({"state": OperatingState.PAUSED, "reason": "it oscillated"}, 0.15, "it oscillated"),
        ({"thermal_derating": 0.15}, 0.0, "limited to 15%"),
        (
            {
                "thermal_derating": 0.3,
                "force": Vector3(0.5, 0, 0),
                "force_commanded": Vector3(0.9, 0, 0),
            },
            0.15,
            "limited to 30%",
        ),
    ],
)
def test_a_force_that_vanishes_takes_the_hand_off_the_robot(haptic_state, within_s, words):
    def vanish(k, now_s, place):
        if k == 300:
            s.device.haptic_state = s.device.haptic_state._replace(**haptic_state)
        if k == 450:
            s.device.haptic_state = HapticState(
                state=OperatingState.ENABLED,
                command_sequence=s.device.haptic_state.command_sequence,
            )
        if k == 500:
            s.device.press("button_2")
        return {}

    s = session(600, vanish, fixtures=[SPHERE])
    last = s.run()
    engaged = [c.engaged for c in s.device.commands]
    assert all(engaged[200:300])
    out = engaged.index(False, 300)
    assert (out - 300) * PERIOD_S == pytest.approx(within_s, abs=3 * PERIOD_S)
    assert not any(engaged[out:500])  # not by itself, although a force is available again
    assert all(engaged[500:])
    assert (last.arm.trips, last.force.losses) == (1, 1)
    assert words in last.force.lost_reason


def test_the_robot_brakes_when_the_force_is_lost_and_says_so():
    places, messages = [], []

    def fault(k, now_s, place):
        if k == 300:
            s.device.haptic_state = HapticState(state=OperatingState.FAULT, reason="fault: it flew")
        places.append(place.x)
        messages.append(s.controller.status().message)
        return {}

    s = session(500, fault, fixtures=[SPHERE])
    s.run()
    speed_m_s = (places[299] - places[300]) / PERIOD_S
    assert speed_m_s == pytest.approx(0.05, rel=0.1)
    assert places[330] == places[499]  # the hand keeps moving at 50 mm/s all the time
    assert places[300] - places[499] < 0.005
    assert messages[-1] == (
        "stopped before: the force is lost: fault: it flew; press 'button_2' to move"
    )


def test_without_a_force_to_lose_nothing_is_lost():
    def fault(k, now_s, place):
        s.device.haptic_state = HapticState(state=OperatingState.FAULT, reason="fault: it flew")
        return {}

    s = session(400, fault)
    last = s.run()
    assert last.arm.trips == 0
    assert s.robot.place.x < 0.47


def test_a_clutch_in_deep_in_a_fixture_ends_within_a_second():
    waited = []

    def gate(k, now_s, place):
        s.device.lets_out = k >= 500
        if k == 500:
            waited.append(place.x)
        s.device.haptic_state = s.device.haptic_state._replace(
            reason="too large to engage with", force_commanded=Vector3(-5.0, 0.0, 0.0)
        )
        if k == 600:
            s.device.press("button_2")
        return {}

    s = session(1000, gate, fixtures=[SPHERE])
    last = s.run()
    engaged = [c.engaged for c in s.device.commands]
    out = engaged.index(False, 200)
    assert (out - 200) * PERIOD_S == pytest.approx(1.0, abs=3 * PERIOD_S)
    assert "move out of the fixture, then clutch in" in last.force.lost_reason
    assert waited == [START.x]  # the robot moved no deeper meanwhile
    assert all(engaged[600:])
    assert (last.arm.trips, last.force.losses) == (1, 1)


def test_a_force_that_cannot_be_enabled_lets_nobody_drive():
    s = session(500, fixtures=[SPHERE])
    s.device.obstacle = "the device is not calibrated"
    last = s.run()
    engaged_s = sum(c.engaged for c in s.device.commands) * PERIOD_S
    assert engaged_s == pytest.approx(1.0, abs=3 * PERIOD_S)
    assert "there is no force: the device is not calibrated" in last.arm.message
    assert s.robot.place == START


def test_the_reason_of_a_reduced_force_is_reported_while_the_hand_is_followed():
    def limit(k, now_s, place):
        s.device.haptic_state = s.device.haptic_state._replace(reason="limited to spare the motors")
        return {}

    s = session(300, limit, fixtures=[SPHERE])
    assert "force: limited to spare the motors" in s.run().diagnosis
    s = session(150, limit, fixtures=[SPHERE])
    assert s.run().diagnosis == []


def test_a_computed_contact_is_felt():
    contact = {
        "shape": "plane",
        "point_m": [0.48, 0.0, 0.0],
        "normal": [1.0, 0.0, 0.0],
        "stiffness_n_m": 1000.0,
    }
    s = session(500, force={"source": "contact", "contact": [contact], "scale": 0.1})
    last = s.run()
    felt = s.device.commands[-1].measured.force
    assert felt.x == pytest.approx(0.1 * (1000.0 * (0.48 - s.robot.place.x) - 0.1), rel=0.2)
    assert last.contact.force_n > 10.0


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"fixtures": [SPHERE]}, "fixtures: 'leap' gives no force back"),
        ({"force": {"source": "measured"}}, r"force\.source: 'leap' gives no force back"),
    ],
)
def test_a_device_without_force_is_refused(tables, words):
    config = parse_config({**TABLE, **tables, "device": {"driver": "leap"}})
    with pytest.raises(ConfigurationError, match=words):
        make_force(config, make_device(config), make_robot(config))


def test_a_device_of_another_computer_feels_force_where_that_is_asked_for():
    remote = {"driver": "remote", "device": "omni", "force": True}
    config = parse_config({**TABLE, "device": remote, "force": {"source": "measured"}})
    renderer = make_force(config, make_device(config), make_robot(config))
    assert renderer.device.options.force
    config = parse_config({**TABLE, "device": remote | {"force": False}, "fixtures": [SPHERE]})
    with pytest.raises(
        ConfigurationError, match="'remote' without force = true gives no force back"
    ):
        make_force(config, make_device(config), make_robot(config))


def test_axes_that_mirror_are_refused():
    mapping = {**TABLE["mapping"], "axes": ["-x", "y", "z", "rx", "ry", "rz"]}
    config = parse_config({**TABLE, "mapping": mapping, "fixtures": [SPHERE]})
    with pytest.raises(ConfigurationError, match=r"mapping\.axes: .* not a rotation"):
        make_force(config, make_device(config), make_robot(config))
    make_force(parse_config({**TABLE, "mapping": mapping}), make_device(config), make_robot(config))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"scale": [1, 1, 0, 1, 1, 1]}, r"mapping\.scale: the TCP's z does not follow"),
        ({"axes": ["fixed", "y", "fixed", "rx", "ry", "rz"]}, r"mapping\.axes: the TCP's x and z"),
    ],
)
def test_axes_that_do_not_follow_are_refused(options, words):
    """No motion of the hand could relieve a force along these axes."""
    mapping = {**TABLE["mapping"], **options}
    for force in ({"fixtures": [SPHERE]}, {"force": {"source": "measured"}}):
        config = parse_config({**TABLE, "mapping": mapping, **force})
        with pytest.raises(ConfigurationError, match=words):
            make_force(config, make_device(config), make_robot(config))
    make_force(parse_config({**TABLE, "mapping": mapping}), make_device(config), make_robot(config))


def test_without_force_the_device_is_never_enabled():
    s = session()
    last = s.run()
    assert s.device.commands == []
    assert s.device.calls == ["open", "close"]
    assert last.force.state == "disabled"


def test_what_may_not_be_stable_is_said_at_the_start():
    s = session(
        2,
        device={"hold_s": 0.003},
        mapping={"scale": [2.0, 2.0, 2.0, 1.0, 1.0, 1.0]},
        force={"source": "measured", "environment_stiffness_n_m": 20_000.0},
        fixtures=[{**SPHERE, "stiffness_n_m": 400.0}],
    )
    words = "; ".join(s.run().diagnosis)
    assert "the rendered stiffness is 800 N/m" in words
    assert "fixtures.0 has a rendered stiffness of 800 N/m" in words
    assert "set device.hold_s" in words


def test_the_view_shows_the_force(capsys):
    s = session(force={"source": "measured"})
    s.device.haptic_state = HapticState(
        state=OperatingState.ENABLED,
        force=Vector3(0.0, 0.0, 1.25),
        peak_n=1.5,
        force_age_s=0.004,
        gap_s=0.001,
    )
    last = changed(s.run(), force__measured_n=(0.0, -0.1, 0.2))
    console = Console(width=160)
    console.print(render(last))
    console.print(summary(last))
    print(plain(last))
    shown = capsys.readouterr().out
    for words in ("1.25 N, 1.50 N", "4.0 ms old", "rendered force, peak", "age of measured force"):
        assert words in shown
    assert shown.count("+0.00 -0.10 +0.20 N") == 2
    assert "force 1.25 N" in shown.splitlines()[-1]


def test_the_summary_shows_a_force_that_was_lost(capsys):
    last = Snapshot.of(
        {
            "force": {
                "state": "enabled",
                "energy_given_j": -0.002,
                "energy_given_peak_j": 0.0031,
                "losses": 2,
                "out_s": 0.3,
            }
        }
    )
    Console(width=160).print(summary(last))
    shown = capsys.readouterr().out
    for words in ("at most -2.0 mJ", "at most 3.10 mJ", "2 times; force out for 0.30 s"):
        assert words in shown
    Console(width=160).print(summary(Snapshot.of({"force": {"state": "enabled"}})))
    assert "want of force" not in capsys.readouterr().out


def test_a_force_node_of_another_process_is_felt(tmp_path):
    """In real time: a separate node evaluates the paper's sphere at the robot's TCP."""
    path = str(tmp_path / "force.sock")
    s = session(2000, force={"source": "remote", "socket": path, "cutoff_hz": 100.0})
    node = read_table(ForceConfig, {"fixtures": [{**SPHERE, "center_m": [0.45, 0.0, 0.4]}]})
    thread = threading.Thread(
        target=run_force_node, args=(node, path), kwargs={"seconds": 10.0}, daemon=True
    )
    thread.start()
    act, felt = s.robot.script, []

    def real_time(k, now_s, place):
        time.sleep(0.001)
        fields = act(k, now_s, place)
        if s.device.commands and (measured := s.device.commands[-1].measured) is not None:
            felt.append(measured.force)
            if len(felt) > 200:
                s.stop("enough")
        return fields

    # stamps from the system clock, which two processes on a computer share
    s.robot.cycles = lambda: _now(s.robot, real_time)
    s.run(seconds=10.0)
    thread.join(5.0)
    assert felt
    assert felt[-1].x > 0.5
    assert felt[-1].y == pytest.approx(0.0, abs=1e-6)


def _now(robot, script):
    for k in range(robot.options.cycles):
        now_s = time.monotonic()
        yield robot_state(now_s, robot.place, **script(k, now_s, robot.place))
