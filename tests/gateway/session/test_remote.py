"""A session in a separate process, moved by verbs and by an operator device."""

import io
import math
import runpy
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cardan.drivers import registry
from cardan.drivers.base import OperatorDevice
from cardan.errors import (
    CollisionError,
    ConfigurationError,
    DriverError,
    MotionLoopError,
    MotionRefusedError,
)
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.arm.vocab import State
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.session import remote
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.remote import session_arm
from cardan.gateway.session.session import make_session
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import SessionExit, SessionProcess
from cardan.gateway.session.supervisor_heartbeat import BEAT_PERIOD_S
from cardan.robots import load_arm
from cardan.sim_peers.arm.options import PlantOptions, SimulatedArmOptions
from cardan.sim_peers.arm.udp import SimulatedArmPeer
from cardan.types import DeviceCapabilities, DeviceLink, DeviceState
from tests.serving import PATIENT, in_a_thread
from tests.waiting import STOOD_STILL, WITHIN_S, done_again, until

pytestmark = pytest.mark.matrix

EXAMPLE = Path(__file__).parents[3] / "examples" / "verbs-ur5-simulated.toml"
QUICK = {"cpts": 0.2, "cpta": 1.0, "cprs": 1.0, "cpra": 4.0}
TIMEOUT_S = WITHIN_S
HEARTBEAT_S = 0.5
BRAKING_S = 0.3
"""Braking time from 0.25 m/s at 1 m/s²."""

TABLE = {
    "robot": {"driver": "sim_arm", "robot": "ur5", "drive": "ideal", "period_s": 0.008},
    "arm": {"model": "ur5"},
    "obstacles": [{"name": "table", "plane": [[0.0, 0.0, 1.0], -0.05]}],
}


def until_at(arm, pose, tolerance_m=1e-3):
    """Wait until the arm's measured pose is there: the command is there a few cycles earlier."""
    until(lambda: np.allclose(arm.stat().pose[:3], pose[:3], atol=tolerance_m), "the arrival")


def by(pose, *step):
    return [*(np.array(pose[:3]) + step), *pose[3:]]


# -- in a thread of this process ------------------------------------------------------------------


@dataclass(frozen=True)
class HandOptions:
    """No options."""


class Hand(OperatorDevice):
    """An operator device whose state the test sets."""

    Options = HandOptions
    capabilities = DeviceCapabilities(False, ("go",), frozenset(), False)
    axes, buttons = (0.0,) * 6, frozenset()

    def open(self):
        """Always connected."""

    def close(self):
        """No resource to close."""

    def diagnosis(self):
        return ()

    def state(self):
        return DeviceState(time.monotonic(), DeviceLink.LIVE, Hand.axes, Hand.buttons)

    def button_events(self):
        return []


class ThreadProcess(SessionProcess):
    """A session in a thread, whose parts the test can access."""

    newest = None
    shown = Snapshot()

    @staticmethod
    def show(snapshot):
        ThreadProcess.shown = snapshot

    def __init__(self, config):
        self._config, self._stopping, self._give_up_s = config, False, math.inf
        self._router_promised = lambda _address: False
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        theirs.setblocking(False)
        self.session = make_session(config, theirs)
        self._process = SimpleNamespace(
            stdin=io.BytesIO(), terminate=lambda: self.session.stop("stopped on request")
        )

        def run():
            with theirs:
                self.session.run()

        self._thread = threading.Thread(target=run, daemon=True)
        self._thread.start()
        ThreadProcess.newest = self

    def _reap(self, last):
        self._thread.join(TIMEOUT_S)
        self._channel.close()
        return SessionExit(0, last)


@pytest.fixture
def in_thread(monkeypatch):
    monkeypatch.setattr(remote, "SessionProcess", ThreadProcess)
    monkeypatch.setitem(registry.BUILT_IN, "handheld", f"{__name__}:Hand")
    monkeypatch.setattr(ThreadProcess, "shown", Snapshot())
    monkeypatch.setattr(Hand, "axes", (0.0,) * 6)
    monkeypatch.setattr(Hand, "buttons", frozenset())

    def make(source="verbs", **tables):
        config = parse_config({**TABLE, "watchdogs": PATIENT, **tables}, from_file=False)
        return session_arm(config, source=source, show=ThreadProcess.show)

    return make


WITH_HAND = {"device": {"driver": "handheld"}, "mapping": {"deadman": "go"}}


def test_the_hand_takes_the_arm_from_a_verb_and_gives_it_back(in_thread):
    with in_thread(source="program", **WITH_HAND) as arm:
        arm.set_parameters({"cpts": 0.02, "cpta": 0.5})
        start = arm.stat().pose
        line = arm.movl(by(start, 0.0, 0.0, -0.1))
        assert line.outcome is Outcome.RUNNING
        assert arm.status().authority.owner == "program"
        Hand.buttons = frozenset({"go"})
        until(lambda: line.over, "the end of the line")
        assert (line.outcome, line.reason) == (Outcome.ABORTED, "the operator device took over")
        assert arm.wait() is False
        assert arm.status().authority.owner == "device"
        with pytest.raises(MotionRefusedError, match="'device' has authority"):
            arm.movl(start)
        with pytest.raises(MotionRefusedError, match="'device' has authority"):
            arm.set_parameter("cpsc", "twst")
        Hand.axes = (0.0, 0.5, 0.0, 0.0, 0.0, 0.0)
        until(lambda: arm.stat().pose[1] > start[1] + 0.01, "the hand's motion")
        Hand.axes, Hand.buttons = (0.0,) * 6, frozenset()
        arm.stop()  # A stop needs no authority, and ends the operator's.
        assert arm.status().authority.owner == ""
        arm.set_parameters(QUICK)
        assert arm.movl(start).source == "program"
        assert arm.wait() is True
        until_at(arm, start)
        until(lambda: ThreadProcess.shown.arm.authority == "program")


def test_the_sessions_limits_are_the_verbs(in_thread):
    limits = {
        "linear_speed_m_s": 0.05,
        "linear_acceleration_m_s2": 0.5,
        "workspace_z_m": [0.2, 2.0],
    }
    with in_thread(limits=limits) as arm:
        arm.set_parameters({"cpts": 1.0, "cpta": 5.0, "cpjs": 1.0, "cpja": 1.0})
        start = arm.stat().pose
        down, up = by(start, 0.0, 0.0, -0.05), by(start, 0.0, 0.0, 0.0)
        line = arm.movl(down)
        assert line.duration_s == pytest.approx(0.05 / 0.05 + 0.05 / 0.5)
        arm.wait()
        joints = arm.movj(up)
        assert "TCP's speed" in joints.note
        assert joints.duration_s > 1.0
        arm.wait()
        with pytest.raises(MotionRefusedError, match="outside of the workspace"):
            arm.movj(by(start, 0.0, 0.0, -0.3))
        controller = ThreadProcess.newest.session.controller
        kinematics = ArmKinematics(load_arm("ur5"))
        fastest, motion = 0.0, arm.movj(down)
        while not motion.over:
            with controller.lock:
                q, v = controller.commanded.servo.q.copy(), controller.commanded.servo.v.copy()
            kinematics.update(q)
            fastest = max(fastest, float(np.linalg.norm((kinematics.jacobian @ v)[:3])))
        assert 0.04 < fastest < 0.0505


def test_the_sessions_tool_is_the_verbs(in_thread):
    tooled = {"arm": {"model": "ur5", "tool_xyz_m": [0.0, 0.0, 0.1], "tcp_tolerance_m": 0.2}}
    with in_thread() as arm:
        bare = np.array(arm.stat().pose)
    with in_thread(**tooled) as arm:
        pose = np.array(arm.stat().pose)
        assert np.linalg.norm(pose[:3] - bare[:3]) == pytest.approx(0.1, abs=1e-6)
        arm.set_parameters(QUICK)
        arm.movl(by(pose, 0.0, 0.0, 0.05))
        assert arm.wait() is True
        until_at(arm, by(pose, 0.0, 0.0, 0.05))
        arm.tool([0.0] * 6)
        flange = np.array(arm.stat().pose[:3])
        assert np.linalg.norm(flange - by(pose, 0.0, 0.0, 0.05)[:3]) == pytest.approx(0.1, abs=1e-3)
        until(
            lambda: np.allclose(ThreadProcess.shown.robot.pose[:3], flange, atol=1e-3),
            "the new tool",
        )


def test_a_gripper_on_the_robots_output_is_everybodys(in_thread, monkeypatch):
    done = []
    with in_thread() as arm, pytest.raises(MotionRefusedError, match="has no gripper"):
        arm.act("accg")
    from cardan.drivers.sim_arm import SimArm

    able = SimArm.capabilities.fget
    monkeypatch.setattr(
        SimArm, "capabilities", property(lambda robot: able(robot)._replace(digital_outputs=1))
    )
    monkeypatch.setattr(SimArm, "set_outputs", lambda _robot, **outputs: done.append(outputs))
    with in_thread(**WITH_HAND) as arm:
        arm.act("accg")
        assert done == [{"digital": True}]
        until(lambda: ThreadProcess.shown.gripper_closed, "the news of it")
        assert ThreadProcess.newest.session.controller.operator.mapping.gripper_closed
        with pytest.raises(MotionRefusedError, match="half way"):
            arm.act("acsg")
        arm.release()
        Hand.buttons = frozenset({"go"})
        until(lambda: ThreadProcess.shown.arm.authority == "device")
        with pytest.raises(MotionRefusedError, match="'device' has authority"):
            arm.act("acog")
    assert done == [{"digital": True}]


def test_a_session_that_verbs_cannot_move_is_refused_at_once():
    with pytest.raises(ConfigurationError, match=r"need an \[arm\]"):
        session_arm(parse_config({"robot": {"driver": "abb_egm"}}))
    neck = {"robot": {"driver": "sim_arm", "robot": "ur5"}, "arm": {"model": "teo_soft_neck"}}
    with pytest.raises(ConfigurationError, match="rigid links"):
        session_arm(parse_config(neck))
    with pytest.raises(ConfigurationError, match="'device'"):
        session_arm(parse_config(TABLE), source="device")


# -- in a separate process ------------------------------------------------------------------------


def test_verbs_streams_and_stop_on_the_simulated_arm():
    shown = []
    with session_arm(EXAMPLE, show=shown.append) as arm:
        arm.set_parameters(QUICK)
        start = arm.stat().pose
        motion = arm.movj(by(start, 0.0, 0.0, -0.05))
        assert arm.stat().state is State.MOVJ
        assert arm.wait(20.0) is True
        assert motion.outcome is Outcome.DONE
        until_at(arm, by(start, 0.0, 0.0, -0.05), 5e-3)

        with pytest.raises(CollisionError) as met:
            arm.movl(by(start, 0.0, 0.0, -start[2] - 0.04))
        assert "table" in met.value.pair

        arm.set_parameter("cpsc", "twst")
        before = arm.stat().pose
        while arm.stat().pose[2] < before[2] + 0.02:
            assert arm.twist([0.0, 0.0, 0.05, 0.0, 0.0, 0.0]) == ""
        assert arm.status().moving
        arm.stop()
        until(lambda: not arm.status().moving)
        assert "select twist" in arm.twist([0.0] * 6)

        arm.movv([0.0, 0.0, -0.02, 0.0, 0.0, 0.0])
        assert arm.get_parameter("streamingCommand") == arm.get_parameters()["streamingCommand"]
        until(lambda: shown[-1].arm.phase == "moving")
    assert shown[-1].finished
    with pytest.raises(MotionLoopError, match="not open"):
        arm.stat()
    arm.stop()
    arm.close()


def test_the_example_of_the_page_runs(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["verbs.py", str(EXAMPLE)])
    runpy.run_path(str(EXAMPLE.with_name("verbs.py")), run_name="__main__")
    said = capsys.readouterr().out
    assert "movj arrived: True" in said
    assert "movl arrived: True" in said
    assert int(said.rsplit("streamed ", 1)[1].split()[0]) > 10


def test_what_the_session_cannot_open_comes_as_its_own_error():
    table = {**TABLE, "robot": {"driver": "sim_arm", "robot": "ur5", "transport": "udp"}}
    table["device"] = {"driver": "spacemouse", "transport": "socket", "path": "/nowhere/hid"}
    with pytest.raises(DriverError, match="/nowhere/hid"):
        session_arm(parse_config(table)).open()


@pytest.mark.real
def test_a_session_that_dies_ends_motions_and_requests(monkeypatch):
    made = []
    monkeypatch.setattr(
        remote, "SessionProcess", lambda config: made.append(SessionProcess(config)) or made[-1]
    )
    with session_arm(EXAMPLE) as arm:
        motion = arm.movv([0.0, 0.0, -0.01, 0.0, 0.0, 0.0])
        made[0]._process.kill()
        until(lambda: motion.over)
        assert motion.outcome is Outcome.ABORTED
        assert "ended with status -9" in motion.reason
        with pytest.raises(MotionLoopError, match="ended with status -9"):
            arm.stat()
        arm.stop()


# -- pauses of the supervising process ------------------------------------------------------------

PROGRAM = """
import sys
from cardan.gateway.session.remote import session_arm

def say(*words):
    # In one piece: print() of two threads is mixed.
    sys.stdout.write(" ".join(map(str, words)) + "\\n")
    sys.stdout.flush()

with session_arm(sys.argv[1], show=lambda shown: say(shown.to_bytes().decode())) as arm:
    line = arm.movv([0.0, 0.0, -0.02, 0.0, 0.0, 0.0])
    sys.stdin.readline()
    say("MOTION", line.outcome.value, line.reason)
    say("STREAM", arm.twist([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]))
    arm.movv([0.0, 0.0, 0.02, 0.0, 0.0, 0.0])
    sys.stdin.readline()
"""


class Supervising:
    """A process that supervises a session, and all snapshots that it received."""

    def __init__(self, program, config):
        self.snapshots, self.words = [], {}
        self._process = subprocess.Popen(
            [sys.executable, "-c", program, str(config)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self):
        for line in self._process.stdout:
            if line.startswith("{"):
                self.snapshots.append(Snapshot.from_bytes(line.encode()))
            else:
                word, _, rest = line.strip().partition(" ")
                self.words[word] = rest

    def __enter__(self):
        return self

    def __exit__(self, *_exception):
        self._process.send_signal(signal.SIGCONT)
        self._process.terminate()
        self._process.wait(TIMEOUT_S)
        self._reader.join(TIMEOUT_S)
        for stream in (self._process.stdin, self._process.stdout):
            stream.close()

    def kill(self):
        self._process.kill()
        self._process.wait(TIMEOUT_S)

    @property
    def returncode(self):
        return self._process.returncode

    def say(self):
        self._process.stdin.write("\n")
        self._process.stdin.flush()

    def is_moving(self):
        return bool(self.snapshots) and self.snapshots[-1].arm.phase == "moving"

    @property
    def stood_still(self):
        """The session's message about a pause; empty if there was none."""
        said = (each.arm.message for each in self.snapshots)
        return next((each for each in said if STOOD_STILL in each), "")

    def until(self, found, what):
        """Wait until `found` returns a true value, or the session reports a pause; return true
        without such a report."""
        until(lambda: found() or self.stood_still, what)
        return not self.stood_still

    def stop_for(self, seconds):
        """Stop the process for this time; return the snapshots that it read afterwards."""
        at_s, known = self.snapshots[-1].elapsed_s, len(self.snapshots)
        self._process.send_signal(signal.SIGSTOP)
        threading.Event().wait(seconds)
        self._process.send_signal(signal.SIGCONT)
        until(lambda: self.snapshots[-1].elapsed_s > at_s + seconds + 0.3, "the going on")
        return at_s, self.snapshots[known:]


def assert_it_rested(at_s, said, seconds):
    """Check that the arm is disarmed and at rest within half a second plus its braking, and reports
    why."""
    while_stopped = [each for each in said if each.elapsed_s <= at_s + seconds]
    late_s = at_s + BEAT_PERIOD_S + HEARTBEAT_S + BRAKING_S + 0.15
    resting = [each for each in while_stopped if each.elapsed_s > late_s]
    assert len(resting) >= 3
    for each in resting:
        assert each.arm.phase == "disarmed", each
        assert each.arm.twist == (0.0,) * 6
        assert "was silent for" in each.arm.message
        assert each.arm.authority != "device"
    assert while_stopped[0].arm.phase == "moving"


@pytest.mark.real
def test_an_arm_moved_by_verbs_rests_while_its_program_is_stopped():
    def stopped():
        with Supervising(PROGRAM, EXAMPLE) as program:
            if not program.until(program.is_moving, "motion"):
                return program.stood_still
            reported = program.stop_for(1.6)
            if program.stood_still:
                return program.stood_still
            assert_it_rested(*reported, 1.6)
            assert not program.is_moving()
            program.say()
            until(lambda: "STREAM" in program.words)
            assert program.words["MOTION"].startswith(
                "aborted the process that supervises this session"
            )
            assert "select twist streaming first" in program.words["STREAM"]
            program.until(program.is_moving, "motion that was asked for anew")
            return program.stood_still

    assert done_again(stopped) == ""


STREAMING = """
import sys
from cardan.gateway.session.remote import session_arm

with session_arm(sys.argv[1]) as arm:
    arm.set_parameter("streamingCommand", "twst")
    while True:
        arm.twist([0.0, 0.0, -0.02, 0.0, 0.0, 0.0])
"""


@pytest.mark.parametrize("program", [PROGRAM, STREAMING], ids=["movv", "twist"])
def test_an_arm_moved_by_verbs_rests_when_its_program_is_killed(program, tmp_path):
    options = SimulatedArmOptions(robot="ur5", port=0, plant=PlantOptions(drive="ideal"))
    peer = SimulatedArmPeer(options)
    config = tmp_path / "session.toml"
    with in_a_thread(peer):
        config.write_text(
            '[robot]\ndriver = "sim_arm"\nrobot = "ur5"\ntransport = "udp"\n'
            f'endpoint = "{peer.endpoint}"\n[arm]\nmodel = "ur5"\n'
        )

        def moves():
            return any(abs(each) > 1e-3 for each in peer.core.plant.velocities)

        with Supervising(program, config) as killed:
            until(moves, "motion")
            before = peer.core.plant.positions
            killed.kill()
            until(lambda: not moves(), "rest")
            assert killed.returncode == -signal.SIGKILL
        way = max(abs(b - a) for a, b in zip(before, peer.core.plant.positions, strict=True))
        assert way < 0.05  # rad; 0.02 m/s for half a second, with tolerance for a busy computer
