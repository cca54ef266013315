"""The MotoROS driver over real loopback sockets. No test sleeps: selects have deadlines."""

import contextlib
import csv
import socket
import threading
import time

import pytest

from cardan.drivers import registry
from cardan.drivers.motoros import Motoros, MotorosOptions
from cardan.errors import AddressError, CommandError, NotOpenError
from cardan.sim_peers.motoros_controller import MotorosControllerOptions, MotorosControllerPeer
from cardan.types import HoldCommand, JointVelocityCommand, RobotLink
from tests.serving import in_a_thread
from tests.waiting import WITHIN_S

pytestmark = pytest.mark.matrix

PATIENCE_S = WITHIN_S
TURN = JointVelocityCommand((0.4, 0.0, 0.0, 0.0, 0.0, 0.0))


@contextlib.contextmanager
def controller(**options):
    """Simulated controller, served by a thread."""
    options.setdefault("servo_on", True)
    peer = MotorosControllerPeer(MotorosControllerOptions(base_port=0, **options))
    with in_a_thread(peer):
        yield peer


def driver(peer, **options):
    return Motoros(
        MotorosOptions(
            motion_port=peer.motion_port,
            state_port=peer.state_port,
            io_port=peer.io_port,
            **options,
        )
    )


def wants_enable_again(state):
    """Return whether this computer stalled for so long that motion ended."""
    return state.link is RobotLink.LIVE and "enable motion again" in state.hold_reason


def run(robot, command, until, limit_s=PATIENCE_S):
    """Answer with `command` until `until` is true of a state; return that state."""
    end_s = time.monotonic() + limit_s
    for state in robot.cycles():
        if until(state):
            return state
        assert time.monotonic() < end_s, (state, robot.diagnosis())
        if wants_enable_again(state):
            robot.enable()
        if state.ready:
            robot.send(command)
    raise AssertionError("the loop ended")


def ready(state):
    return state.ready


@pytest.mark.real
@pytest.mark.parametrize("mode", ["velocity", "stream"])
def test_it_connects_is_enabled_moves_and_leaves_the_robot_at_rest(mode):
    begin_s = time.monotonic()
    with controller() as peer, driver(peer, mode=mode) as robot:
        states = robot.cycles()
        end_s = begin_s + PATIENCE_S
        first = start = None
        for state in states:
            assert time.monotonic() < end_s, robot.diagnosis()
            if state.link is RobotLink.LIVE and first is None and "enable" in state.hold_reason:
                first = state
                robot.enable()
            elif wants_enable_again(state):
                robot.enable()
            if state.ready:
                start = state.joints[0] if start is None else start
                robot.send(TURN)
                if state.joints[0] - start > 0.1 and robot.enabled:
                    break
        assert first is not None
        assert robot.enabled
        states.close()  # brakes; the controller may still have a few points to execute
        assert not robot.enabled
        end_s = time.monotonic() + PATIENCE_S
        while abs(peer.controller.velocity_rad_s(0)[0]) > 1e-3:
            assert time.monotonic() < end_s, peer.controller.velocity_rad_s(0)
            time.sleep(0.004)
        assert peer.servers.counters.pipelined == 0
        assert peer.servers.counters.pieces == 0
        metrics = robot.metrics()
        assert metrics["commands"] > 2
        # Requests are sequential: half took p50 or longer; the histogram is 5 % coarse.
        requests = robot._session.requests.latency.count
        lasted_s = time.monotonic() - begin_s
        assert 0.0 < metrics["request_p50_s"] * requests / 2 < 1.05 * lasted_s


def test_the_loop_can_be_entered_again_after_it_was_left():
    with controller() as peer, driver(peer, mode="stream", enable="at-start") as robot:
        run(robot, TURN, ready)
        run(
            robot,
            TURN,
            lambda state: state.link is RobotLink.LIVE and "enable" in state.hold_reason,
        )
        robot.enable()
        run(robot, TURN, ready)


def test_close_from_another_thread_ends_the_loop_and_brakes():
    with controller() as peer:
        robot = driver(peer, mode="velocity", enable="at-start")
        robot.open()
        moving = threading.Event()

        def loop():
            for state in robot.cycles():
                if wants_enable_again(state):
                    robot.enable()
                robot.send(TURN)
                if state.ready and state.joints[0] > 0.05:
                    moving.set()

        thread = threading.Thread(target=loop, daemon=True)
        thread.start()
        assert moving.wait(PATIENCE_S)
        robot.close()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()
        assert "not open" in robot.diagnosis()[0]
        robot.close()


def test_a_controller_that_is_not_there_is_reported_and_found_later():
    with controller() as peer:
        ports = (peer.motion_port, peer.state_port, peer.io_port)
    robot = Motoros(MotorosOptions(motion_port=ports[0], state_port=ports[1], io_port=ports[2]))
    with robot:
        state = run(robot, HoldCommand(), lambda state: "refused" in state.hold_reason)
        assert state.link is RobotLink.WAITING
        again = run(robot, HoldCommand(), lambda state: True)
        assert not again.joints


@pytest.mark.real
def test_a_controller_that_vanishes_is_lost():
    with contextlib.ExitStack() as stack:
        with controller() as peer:
            robot = stack.enter_context(driver(peer, mode="stream", enable="at-start"))
            states = robot.cycles()
            for state in states:
                if wants_enable_again(state):
                    robot.enable()
                if state.ready:
                    break
        end_s = time.monotonic() + PATIENCE_S
        for state in states:
            assert time.monotonic() < end_s
            if state.link is RobotLink.LOST:
                break
        assert not robot.enabled
        assert robot.diagnosis()


def test_inputs_and_outputs_are_beside_the_loop():
    with controller() as peer, driver(peer, mode="stream") as robot:
        with pytest.raises(NotOpenError, match="byte order"):
            _ = robot.io
        run(robot, HoldCommand(), lambda state: state.link is RobotLink.LIVE)
        robot.io.write_group(1001, 0b101)
        assert robot.io.read_bit(10010)
        assert not robot.io.read_bit(10011)
        robot.io.write_register(3, 77)
        assert robot.io.read_register(3) == 77
        assert robot.io is robot.io


@pytest.mark.parametrize("mode", ["stream", "velocity"])
def test_a_record_is_written_at_close(tmp_path, mode):
    path = tmp_path / "record.csv"
    options = {"mode": mode, "enable": "at-start", "record": str(path)}
    with controller() as peer, driver(peer, **options) as robot:
        run(robot, TURN, lambda state: bool(state.joints) and state.joints[0] > 0.02)
    rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    kinds = ["point", "start"] if mode == "stream" else ["velocity"]
    assert {row["kind"] for row in rows} == {"feedback", *kinds}
    assert float(rows[-1]["monotonic_s"]) > float(rows[0]["monotonic_s"])
    points = [row for row in rows if row["kind"] == kinds[0]]
    assert float(points[-1]["commanded_1_rad"]) > 0.02


def test_a_record_that_cannot_be_written_is_said_and_close_does_not_raise(tmp_path):
    with controller() as peer:
        robot = driver(peer, record=str(tmp_path / "no" / "where.csv"))
        with robot:
            run(robot, HoldCommand(), lambda state: state.link is RobotLink.LIVE)
        assert any("where.csv" in words for words in robot.diagnosis())


def test_a_bad_command_is_refused_and_the_loop_goes_on():
    with controller() as peer, driver(peer, mode="velocity", enable="at-start") as robot:
        count = 0
        for state in robot.cycles():
            if wants_enable_again(state):
                robot.enable()
            if not state.ready:
                continue
            count += 1
            if count == 1:
                with pytest.raises(CommandError):
                    robot.send(JointVelocityCommand((0.0,) * 5))
            if count > 20:
                break
        assert count > 20


def test_bytes_that_are_no_messages_drop_the_connection_in_words():
    with contextlib.ExitStack() as stack:
        servers = [stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(3)]
        ports = [server.getsockname()[1] for server in servers]
        robot = Motoros(MotorosOptions(motion_port=ports[0], state_port=ports[1], io_port=ports[2]))
        stack.enter_context(robot)
        said = False
        end_s = time.monotonic() + PATIENCE_S
        servers[1].settimeout(PATIENCE_S)
        for state in robot.cycles():
            assert time.monotonic() < end_s
            if not said:
                link = stack.enter_context(servers[1].accept()[0])
                link.sendall(b"\xff" * 64)
                said = True
            if "prefix" in state.hold_reason:
                break
        assert state.link is RobotLink.WAITING


def test_closed_it_cannot_be_used():
    robot = Motoros()
    robot.close()
    for act in (robot.cycles, lambda: robot.send(HoldCommand()), lambda: robot.io):
        with pytest.raises(NotOpenError):
            act()
    assert not robot.enabled
    assert robot.metrics()["commands"] == 0.0


def test_a_host_that_has_no_address():
    with pytest.raises(AddressError, match=r"no\.such\.host\.invalid"):
        Motoros(MotorosOptions(host="no.such.host.invalid")).open()


def test_it_is_found_by_its_name():
    assert registry.load("motoros") is Motoros
