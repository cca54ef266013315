"""A session and a force node, connected by a socket."""

import contextlib
import os
import socket
import threading
import time

import pytest
from typer.testing import CliRunner

from cardan import cli
from cardan.common.haptics import WorldMap
from cardan.common.tables import read_table
from cardan.errors import AddressError, DriverError
from cardan.gateway.force.link import RefusalMessage, StateMessage, decode
from cardan.gateway.force.service import RemoteSource
from cardan.gateway.force.sources import MeasuredSource
from cardan.gateway.session.config import ForceConfig
from cardan.gateway.session.force_node import ForceNode, run_force_node
from cardan.spatial import norm
from cardan.types import IDENTITY, Frame, Pose, Vector3, Wrench
from tests.gateway.force.fakes import PERIOD_S, robot_state
from tests.waiting import WITHIN_S

pytestmark = pytest.mark.matrix

SPHERE = {"shape": "sphere", "center_m": [0.3, 0.0, 0.4], "radius_m": 0.1, "stiffness_n_m": 100.0}
SURFACE = {"shape": "plane", "at": "start", "normal": [0.0, 0.0, 1.0], "stiffness_n_m": 100.0}


def config(source="none", fixtures=(), **force):
    return read_table(
        ForceConfig, {"force": {"source": source, **force}, "fixtures": list(fixtures)}
    )


def message(stamp_s, place, force=None, world=None, ready=True):
    wrench = None if force is None else Wrench(Vector3(*force), Vector3(0.0, 0.0, 0.0), Frame.BASE)
    pose = Pose(Vector3(*place), IDENTITY)
    return StateMessage(round(stamp_s / PERIOD_S), stamp_s, ready, pose, wrench, world)


def test_a_node_evaluates_the_papers_sphere_on_the_tcp():
    node = ForceNode(config(fixtures=[SPHERE]), None)
    outside, inside = message(1.0, (0.45, 0.0, 0.4)), message(1.004, (0.385, 0.0, 0.4))
    assert node.force(outside) == (1, 1.0, (0.0, 0.0, 0.0))
    assert node.force(inside) == (2, 1.004, pytest.approx((1.5, 0.0, 0.0)))
    assert node.reason == ""


def test_a_nodes_surface_is_where_the_tcp_was_when_it_was_ready():
    node = ForceNode(config(fixtures=[SURFACE]), None)
    node.force(message(1.0, (0.5, 0.0, 0.9), ready=False))
    assert norm(node.force(message(1.1, (0.5, 0.0, 0.3))).force) == 0.0
    assert node.force(message(1.2, (0.5, 0.0, 0.29))).force == pytest.approx((0.0, 0.0, 1.0))


def test_a_nodes_measured_force_is_tared_scaled_and_turned_round():
    node = ForceNode(config("measured", scale=0.1, deadband_n=0.0), MeasuredSource())
    for k in range(200):
        sent = node.force(message(1.0 + k * PERIOD_S, (0.5, 0.0, 0.4), (1.0, 0.0, -5.0)))
        if k < 100:
            assert sent.force == (0.0, 0.0, 0.0)
            assert "zero is being taken" in node.reason
    assert node.reason == ""
    for k in range(200, 300):
        at = message(1.0 + k * PERIOD_S, (0.5, 0.0, 0.4), (1.0, 0.0, -15.0), WorldMap())
        sent = node.force(at)
    assert sent.force == pytest.approx((0.0, 0.0, 1.0))
    assert sent.stamp_s == at.stamp_s
    assert node.force(message(3.0, (0.5, 0.0, 0.4))).force == (0.0, 0.0, 0.0)
    assert node.reason == "the robot reports none"


def cycles(source, seconds, until=lambda: False, world=None):
    """Run the session's loop as fast as possible; return the last reading."""
    reading, end_s = None, time.monotonic() + seconds
    while (now_s := time.monotonic()) < end_s and not until():
        state = robot_state(now_s, (0.385, 0.0, 0.4))
        source.publish(state, state.pose, world, now_s)
        reading = source.read(state, state.pose)
        if reading is not None and norm(reading.force) > 0.0:
            break
        time.sleep(0.001)
    return reading


def run_node(path, results, **options):
    def run():
        try:
            results.append(run_force_node(config(fixtures=[SPHERE]), path, **options))
        except Exception as error:
            results.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


@pytest.mark.real
def test_a_node_serves_a_session(tmp_path, capsys):
    path, results = str(tmp_path / "force.sock"), []
    thread = run_node(path, results, seconds=20.0)  # started before the session, for which it waits
    with RemoteSource(path, 0.1) as source:
        assert os.stat(path).st_mode & 0o777 == 0o600
        assert source.diagnosis() == ("no measured force: no force node is connected",)
        reading = cycles(source, 10.0)
        assert reading.force == pytest.approx((1.5, 0.0, 0.0))
        assert reading.frame is Frame.BASE
        assert source.diagnosis() == ()
        second = []
        other = run_node(path, second, seconds=20.0)
        end_s = time.monotonic() + WITHIN_S
        while not second and time.monotonic() < end_s:
            state = robot_state(time.monotonic(), (0.5, 0.0, 0.4))
            source.publish(state, state.pose, None, state.stamp_s)
            source.read(state, state.pose)
            time.sleep(0.001)
        other.join(5.0)
        assert isinstance(second[0], DriverError)
        assert "another force node is connected" in str(second[0])
        assert source.diagnosis() == ("1 force nodes refused: another one was connected",)
    thread.join(5.0)
    assert results[0] > 0
    assert not os.path.exists(path)
    assert "the session has ended" in capsys.readouterr().out


@pytest.fixture
def service(tmp_path):
    with RemoteSource(str(tmp_path / "force.sock"), 0.1) as source:
        yield source


def connect(service, tmp_path, now_s=1.0):
    node = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    node.settimeout(1.0)
    node.connect(str(tmp_path / "force.sock"))
    state = robot_state(now_s)
    service.publish(state, state.pose, None, now_s)
    return node


def test_a_node_that_sends_garbage_or_sleeps_holds_nobody_up(service, tmp_path):
    with connect(service, tmp_path) as node:
        assert isinstance(decode(node.recv(1024)), StateMessage)
        for junk in (b"CDNF", b"x" * 600, b"CDNF\x01\x01\0\0"):
            node.send(junk)
        for k in range(2000):  # the session accepts none of them
            state = robot_state(1.0 + k * PERIOD_S)
            service.publish(state, state.pose, WorldMap(), state.stamp_s)
            assert service.read(state, state.pose) is None
        assert service.reason == "the force node is silent"
        assert service.unreadable == 3
        assert "3 packets" in service.diagnosis()[-1]
    service.publish(robot_state(20.0), None, None, 20.0)
    service.read(robot_state(20.0), None)
    assert service.reason == "no force node is connected"


def test_a_second_node_hears_why_it_is_not_taken(service, tmp_path):
    with connect(service, tmp_path), connect(service, tmp_path, 1.1) as second:
        refusal = decode(second.recv(1024))
        assert isinstance(refusal, RefusalMessage)
        assert "end it first" in refusal.reason
        assert second.recv(1024) == b""


def test_a_silent_node_is_replaced(service, tmp_path):
    with connect(service, tmp_path) as first, connect(service, tmp_path, 9.0) as second:
        assert isinstance(decode(second.recv(1024)), StateMessage)
        first.recv(1024)
        assert first.recv(1024) == b""


def test_the_socket_is_not_taken_from_others(service, tmp_path):
    path = str(tmp_path / "force.sock")
    served = r"another program serves .*end that session"
    with pytest.raises(AddressError, match=served), RemoteSource(path, 0.1):
        pass
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(AddressError, match="is not a socket"), RemoteSource(str(file), 0.1):
        pass
    missing = r"cannot create .* no directory /nowhere/at; give force\.socket"
    with pytest.raises(AddressError, match=missing), RemoteSource("/nowhere/at/all", 0.1):
        pass


def test_a_socket_that_a_dead_session_left_is_replaced(tmp_path):
    path = str(tmp_path / "force.sock")
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)) as dead:
        dead.bind(path)
    with RemoteSource(path, 0.1):
        assert os.path.exists(path)


def test_a_node_without_a_session_says_how_to_start_one(tmp_path):
    with pytest.raises(AddressError, match=r'start one with .*source = "remote"'):
        run_force_node(config(fixtures=[SPHERE]), str(tmp_path / "none"), seconds=0.2)


def test_the_command_line_has_the_node(tmp_path, monkeypatch):
    monkeypatch.setattr("cardan.gateway.session.force_node.ask_for_real_time", lambda: "other")
    file, path = tmp_path / "node.toml", str(tmp_path / "force.sock")
    file.write_text(
        '[[fixtures]]\nshape = "sphere"\ncenter_m = [0.3, 0.0, 0.4]\nradius_m = 0.1\n'
        "stiffness_n_m = 100.0\n"
    )
    ended, felt = threading.Event(), []

    def session():
        with RemoteSource(path, 0.1) as source:
            felt.append(cycles(source, 10.0))
            ended.wait(0.1)

    thread = threading.Thread(target=session, daemon=True)
    thread.start()
    arguments = ["devices", "force", str(file), "--connect", path, "--seconds", "10"]
    result = CliRunner().invoke(cli.app, arguments)
    ended.set()
    thread.join(5.0)
    assert felt[0].force == pytest.approx((1.5, 0.0, 0.0))
    assert (result.exit_code, result.output.splitlines()[0]) == (0, f"READY {path}")
    assert "forces sent" in result.output
