"""A session's control loop: its calls of the drivers, and its reports."""

import dataclasses
import gc
import json
import math
import socket
import sys
from importlib.metadata import EntryPoint
from types import ModuleType, SimpleNamespace

import pytest

from cardan.common.bounds import LONGEST_BLIND_S
from cardan.common.options import Options
from cardan.drivers import registry
from cardan.errors import ConfigurationError, DeviceNotFoundError, DriverError
from cardan.gateway.operator.filters import TwistFilter
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.network import SessionNetwork
from cardan.gateway.session.session import make_session
from cardan.gateway.session.snapshot import MAX_SNAPSHOT_BYTES, Snapshot
from cardan.types import DeviceCapabilities, DeviceLink, PoseCommand
from tests.gateway.fakes import FakeDevice, FakeRobot
from tests.snapshots import changed
from tests.test_docs import blocks, text

TABLE = {
    "device": {"driver": "fake_device"},
    "robot": {"driver": "fake_robot"},
    "mapping": {"deadman": "go"},
    "gripper": {"toggle": "grip"},
    "watchdogs": {"device_age_s": LONGEST_BLIND_S},
}


FEW = {"robot": {"cycles": 60}}
"""Enough cycles for tests of single cycles or of the end, too few for a motion."""


def session(channel=None, **tables):
    merged = {key: {**TABLE.get(key, {}), **tables.get(key, {})} for key in {*TABLE, *tables}}
    made = make_session(parse_config(merged), channel)
    # These tests do not depend on pauses of the computer.
    supervision = made.controller.supervision
    supervision.watchdogs = dataclasses.replace(supervision.watchdogs, stall_s=LONGEST_BLIND_S)
    return made


def test_a_session_from_rest_to_motion(fake_drivers):
    s = session()
    last = s.run()
    assert last.finished
    assert last.loop.cycles == 500
    assert len(s.robot.commands) == 500
    assert last.tracking.path_m > 0.15
    assert s.robot.commands[-1].pose.position.x - 0.5 == pytest.approx(
        last.tracking.path_m, rel=1e-6
    )
    assert last.gripper_closed
    assert s.robot.outputs == [(True, ())]
    assert last.diagnosis == ["the device is fake"]
    assert not s.device.is_open
    assert not s.robot.is_open
    assert s.device.led[-1] is False


def test_what_its_program_has_frozen_stays_so(fake_drivers):
    gc.freeze()
    before = gc.get_freeze_count()
    session(**FEW).run()
    assert gc.isenabled()
    assert gc.get_freeze_count() > 0.9 * before > 1000


def test_gripper_on_an_analog_output(fake_drivers):
    s = session(gripper={"output": 2, "closed_value": 7.5}, **FEW)
    s.run()
    # the program's value for the other outputs is kept
    assert s.robot.outputs == [(None, (7.0, 0.0, 7.5))]


def test_the_operators_button_makes_the_robot_ready(fake_drivers):
    s = session(
        mapping={"enable": "grip", "deadman": ""},
        gripper={"toggle": ""},
        device={"deflection": 0.0},
        **FEW,
    )
    s.run()
    assert s.robot.enabled == 1


def test_a_hand_that_moves_makes_nothing_ready(fake_drivers):
    s = session(mapping={"enable": "grip"}, gripper={"toggle": ""}, **FEW)
    s.run()
    assert s.robot.enabled == 0


def test_a_robot_that_is_made_ready_elsewhere_has_no_button_for_it(fake_drivers, monkeypatch):
    monkeypatch.delattr(FakeRobot, "enable")
    with pytest.raises(ConfigurationError, match=r"mapping\.enable: .* at its own controller"):
        session(mapping={"enable": "grip"}, gripper={"toggle": ""}).run()


def test_stop_brakes_before_it_leaves(fake_drivers):
    s = session(robot={"cycles": 100_000})
    send = s.robot.send

    def stop_on_the_way(command):
        send(command)
        if len(s.robot.commands) == 200:
            s.stop("enough")

    s.robot.send = stop_on_the_way
    last = s.run()
    speeds = [c.twist.linear.x for c in s.robot.commands if isinstance(c, PoseCommand)]
    assert speeds[199] == pytest.approx(0.1)
    assert speeds[-1] == 0.0
    assert len(speeds) < 240
    assert last.arm.message == "enough"


def test_snapshots_go_out_and_a_reader_that_sleeps_is_not_waited_for(fake_drivers):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        theirs.setblocking(False)
        session(theirs, robot={"cycles": 3000}).run()
        first = Snapshot.from_bytes(ours.recv(MAX_SNAPSHOT_BYTES))
        assert first.robot.link == "live"
        assert len(first.robot.pose) == 7


def test_a_session_whose_starter_is_gone_stops(fake_drivers):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    theirs.setblocking(False)
    ours.close()
    with theirs:
        last = session(theirs, robot={"cycles": 1_000_000}).run()
    assert "gone" in last.arm.message
    assert last.loop.cycles < 1000


def test_buttons_that_do_not_exist_are_refused(fake_drivers):
    with pytest.raises(ConfigurationError, match=r"mapping\.deadman: .* 'left'; it has: go, grip"):
        session(mapping={"deadman": "left"}).run()


def test_a_clutch_button_that_does_not_exist_is_refused(fake_drivers):
    with pytest.raises(ConfigurationError, match=r"mapping\.clutch: .* 'left'; it has: go, grip"):
        session(mapping={"clutch": "left"}).run()


def test_a_missing_device_leaves_nothing_open(fake_drivers):
    s = session(device={"present": False})
    with pytest.raises(DeviceNotFoundError):
        s.run()
    assert not s.robot.is_open


def test_snapshots_survive_figures_that_are_not_numbers():
    snapshot = Snapshot.of(
        {
            "robot": {"metrics": {"period_s": float("nan")}, "pose": [1.0] * 7},
            "arm": {"message": "é"},
        }
    )
    back = Snapshot.from_bytes(snapshot.to_bytes())
    assert back.robot.metrics == {"period_s": None}
    assert back.arm.message == "é"
    assert back == changed(snapshot, robot__metrics={"period_s": None})


def test_a_published_snapshot_is_json_whatever_its_figures():
    reported = []
    topics = SimpleNamespace(
        put_snapshot=lambda text, _now_ns: reported.append(text),
        put_diagnostics=lambda *_arguments: None,
        log=lambda *_arguments: None,
    )
    network = SimpleNamespace(_topics=topics, _server=None, _haptic=None, _verbs=None, _logged="")
    SessionNetwork.tell(
        network, Snapshot.of({"robot": {"metrics": {"period_s": float("nan")}}}), 0.0, 0
    )
    (text,) = reported
    assert json.loads(text, parse_constant=pytest.fail)["robot"]["metrics"] == {"period_s": None}


@pytest.mark.parametrize("unprintable", ["\x1b[2J", "\n", "\x7f", "\u202e", '"\x07'])
def test_what_a_snapshot_tells_is_printable(unprintable):
    snapshot = Snapshot.of(
        {
            "arm": {"message": f"a{unprintable}b"},
            "robot": {"metrics": {unprintable: 1.0}},
            "device": {"buttons": ["left"]},
        }
    )
    back = Snapshot.from_bytes(snapshot.to_bytes())
    assert back.arm.message.isprintable()
    assert back.device.buttons == ("left",)
    assert all(name.isprintable() for name in back.robot.metrics)
    # Another program may send it like this.
    plain = json.dumps({"arm": {"message": f"a{unprintable}b"}}, ensure_ascii=False).encode()
    assert Snapshot.from_bytes(plain).arm.message.isprintable()


def test_of_a_snapshot_of_another_version_what_both_know_is_read():
    table = {"phase": "moving", "device": "spacemouse", "trips": 3, "elapsed_s": 2.0, "pose": None}
    table |= {"arm": {"phase": "holding", "unheard_of": 1, "twist": None}, "loop": {"cycles": 7}}
    read = Snapshot.from_bytes(json.dumps(table).encode())
    assert read == changed(Snapshot(), elapsed_s=2.0, arm__phase="holding", loop__cycles=7)


def test_a_button_that_a_device_may_have_beside_those_it_tells_is_taken(fake_drivers, monkeypatch):
    capabilities = FakeDevice.capabilities._replace(further_buttons=("button-23",))
    monkeypatch.setattr(FakeDevice, "capabilities", capabilities)
    assert session(mapping={"deadman": "button-23"}, **FEW).run().finished
    with pytest.raises(ConfigurationError, match=r"'button-24'; it has: go, grip"):
        session(mapping={"deadman": "button-24"}).run()


def test_of_buttons_that_are_known_once_the_device_is_there_the_operator_is_reported(
    fake_drivers, monkeypatch
):
    known = FakeDevice.capabilities
    unknown = known._replace(buttons=())
    monkeypatch.setattr(
        FakeDevice,
        "capabilities",
        property(lambda device: known if device.looks else unknown),
    )
    s, seen = session(mapping={"deadman": "Go"}, **FEW), []
    publish = s._publish

    def seen_publish(*of_cycle):
        publish(*of_cycle)
        seen.append(dataclasses.replace(s.snapshot))

    monkeypatch.setattr(s, "_publish", seen_publish)
    last = s.run()
    reported = (
        "mapping.deadman: the device has no button 'Go'; it has: go, grip; did you mean 'go'?"
    )
    assert reported in {snapshot.arm.message for snapshot in seen}
    assert last.tracking.path_m == 0.0


def test_each_part_of_a_session_says_what_it_costs(fake_drivers):
    costs = session().run().part_cost_s
    assert {"figures", "gripper", "operator", "feedback"} <= costs.keys()
    assert all(0.0 < cost_s < 1.0 for cost_s in costs.values())


def test_what_the_hand_feels_ends_with_the_session(fake_drivers, monkeypatch):
    felt = []
    monkeypatch.setattr(
        FakeDevice,
        "capabilities",
        DeviceCapabilities(False, ("go", "grip"), frozenset({"rumble"}), False),
    )
    monkeypatch.setattr(
        FakeDevice, "_feedback", lambda device, reported: felt.append(reported.rumble)
    )
    walls = {"workspace_x_m": [0.4, 0.501]}
    table = {"feedback": {"rumble": ["limit"]}, "limits": walls, "robot": {"cycles": 100_000}}
    s = session(**table)
    send = s.robot.send

    def until_felt(command):
        send(command)
        if felt:
            s.stop("enough")

    s.robot.send = until_felt
    s.run(seconds=20.0)
    assert felt[0] == pytest.approx(0.4)
    assert felt[-1] == 0.0


class TestTheJoystickOfThePage:
    """The first driver that docs/adding-a-driver.md shows, unchanged."""

    @pytest.fixture
    def joystick(self, monkeypatch):
        (shown,) = (
            b
            for b in blocks(text("adding-a-driver.md"), "python")
            if "class Joystick(OperatorDevice)" in b
        )
        module = ModuleType("my_joystick")
        monkeypatch.setitem(sys.modules, module.__name__, module)
        exec(shown, vars(module))
        point = EntryPoint("joystick", "my_joystick:Joystick", registry.ENTRY_POINT_GROUP)
        monkeypatch.setattr(registry.FINDER, "_installed", lambda: [point])
        return module.Joystick

    def session(self, **options):
        tables = {**TABLE, "device": {"driver": "joystick", **options}}
        return make_session(
            parse_config({**tables, "mapping": {"deadman": "trigger"}, "gripper": {}})
        )

    def test_it_runs(self, fake_drivers, joystick, tmp_path):
        port = tmp_path / "js0"
        port.touch()
        made = self.session(path=str(port))
        last = made.run(0.3)
        assert last.device.link == "live"
        assert last.loop.cycles > 0
        assert made.device.state().link is DeviceLink.CLOSED

    def test_its_device_is_not_there(self, fake_drivers, joystick, tmp_path):
        made = self.session(path=str(tmp_path / "js9"))
        with pytest.raises(DeviceNotFoundError, match="no joystick at"):
            made.run(0.3)

    def test_one_that_cannot_be_opened_is_named(self, fake_drivers, joystick, monkeypatch):
        def fail(self):
            raise ZeroDivisionError("boom")

        monkeypatch.setattr(joystick, "open", fail)
        with pytest.raises(
            ConfigurationError, match=r"device.driver: driver 'joystick' cannot be used: ZeroDiv"
        ):
            self.session().run(0.3)


class TestADriverThatFails:
    """A third-party driver that breaks its interface: the session ends in order, and names the
    driver."""

    @pytest.mark.parametrize("call", ["cycles", "send", "set_outputs"])
    def test_a_robot_s_in_the_loop(self, fake_drivers, call):
        s = session(**FEW)
        setattr(s.robot, call, lambda *_all, **_words: 1 / 0)
        with pytest.raises(DriverError, match="robot's driver FakeRobot failed: ZeroDivisionError"):
            s.run()
        assert not s.robot.is_open
        assert not s.device.is_open

    def test_a_robot_s_loop_that_ends_by_itself(self, fake_drivers):
        assert "ended its cycles() by itself" in session(**FEW).run().ending
        s = session(**FEW)
        s.robot.cycles = lambda: iter(())
        with pytest.raises(
            DriverError, match=r"driver FakeRobot failed: cycles\(\) returned no state"
        ):
            s.run()
        assert not s.robot.is_open
        assert not s.device.is_open

    @pytest.mark.matrix("joints1", "joints2")
    @pytest.mark.parametrize("joints", [(0.0,) * 5, (), (0.0,) * 7, (math.nan,) * 6])
    def test_a_robot_s_joints_that_are_not_the_arms(self, fake_drivers, joints):
        s = session(robot={**FEW["robot"], "takes_poses": False}, arm={"model": "ur5"})
        good = s.robot.cycles
        s.robot.cycles = lambda: (state._replace(joints=joints, pose=None) for state in good())
        last = s.run()
        assert "joints" in last.arm.message
        assert (last.robot.pose, last.tracking.path_m) == ((), 0.0)

    @pytest.mark.parametrize("call", ["diagnosis", "metrics", "protocol_errors"])
    def test_a_robot_s_figures(self, fake_drivers, call):
        s = session(**FEW)
        setattr(s.robot, call, lambda: 1 / 0)
        last = s.run()
        assert last.finished
        assert "the robot's driver failed: ZeroDivisionError: division by zero" in last.diagnosis

    def test_a_device_s_figures(self, fake_drivers):
        s = session(**FEW)
        s.device.metrics = lambda: {"age_s": 0.08}
        assert s.run().device.metrics == {"age_s": 0.08}
        s = session(**FEW)
        s.device.metrics = lambda: {"age_s": "old"}
        last = s.run()
        assert last.device.metrics == {}
        assert any("metrics() returned 'old' for 'age_s'" in line for line in last.diagnosis)

    def test_closing(self, fake_drivers, caplog):
        s = session(**FEW)
        for each in (s.robot, s.device):
            each.close = lambda: 1 / 0
        assert s.run().finished
        reported = [record.getMessage() for record in caplog.records]
        names = ["FakeRobot", "FakeDevice"]
        assert reported == [f"{name} could not be closed properly" for name in names]

    def test_opening(self, fake_drivers, monkeypatch):
        s = session(**FEW)
        s.robot.open = lambda: 1 / 0
        with pytest.raises(ZeroDivisionError):  # one of our own drivers, by its name
            s.run()
        assert not s.device.is_open


class Failing(TwistFilter):
    """A filter that fails in one call."""

    Options = Options

    def open(self):
        pass

    def close(self):
        pass

    def apply(self, twist, robot):
        return twist

    def status(self):
        return ""


class TestAFilterThatFails:
    def run(self, call):
        s = session(**FEW)
        made = Failing()
        made.name = "mine"
        setattr(made, call, lambda: 1 / 0)
        s.controller.operator.filters = (made,)
        return s.run()

    def test_opening(self, fake_drivers):
        with pytest.raises(ConfigurationError) as caught:
            self.run("open")
        words = "filter 'mine' cannot be used: ZeroDivisionError: division by zero"
        assert str(caught.value) == f"filters.0.filter: {words}"

    def test_closing(self, fake_drivers, caplog):
        assert self.run("close").finished
        assert [record.getMessage() for record in caplog.records] == [
            "Failing could not be closed properly"
        ]

    def test_its_words(self, fake_drivers):
        assert any(
            "the filter mine failed: ZeroDiv" in line for line in self.run("status").arm.filters
        )
        reported = self.run("diagnosis").diagnosis
        assert "the filter mine failed: ZeroDivisionError: division by zero" in reported
