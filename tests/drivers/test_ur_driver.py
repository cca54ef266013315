"""The UR driver on real sockets, with the simulated controller."""

from __future__ import annotations

import math
import multiprocessing
import select
import socket
import struct
import threading

import pytest

from cardan.drivers.ur_rtde import UrRtde
from cardan.errors import AddressError, NotOpenError
from cardan.protocols.ur.rtde import PacketType
from cardan.sim_peers.ur_controller import UrControllerOptions, UrControllerPeer
from cardan.types import HoldCommand, JointVelocityCommand, RobotLink
from tests.serving import free_tcp_port
from tests.waiting import until

pytestmark = pytest.mark.matrix

SPEED = 0.3


def any_ports(**options):
    return UrControllerPeer(
        UrControllerOptions(rtde_port=0, primary_port=0, dashboard_port=0, **options)
    )


def driver_of(peer, **options):
    # A process may stand still for seconds where tests run: the watchdog has its longest value.
    ports = {f"{kind}_port": peer.port(kind) for kind in ("rtde", "primary", "dashboard")}
    return UrRtde(rate_hz=125.0, watchdog_s=0.5, robot=peer.options.robot, **{**ports, **options})


@pytest.mark.real
@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
def test_it_starts_moves_and_leaves(robot):
    with any_ports(robot=robot, boot_s=0.1, release_s=0.1) as peer:
        home = tuple(peer.controller.motion.target_q)
        with driver_of(peer, enable="at-start") as driver:
            began = False
            for state in driver.cycles():
                if not state.ready and not began:
                    continue
                if not state.ready:
                    # This computer was paused for too long.
                    driver.enable()
                    continue
                if not began:
                    assert state.joints == pytest.approx(home, abs=1e-6)
                    began = True
                driver.send(JointVelocityCommand((SPEED, 0.0, 0.0, 0.0, 0.0, 0.0)))
                if state.joints[0] > 0.1:
                    break
            assert driver.metrics()["commands"] > 10.0
            assert driver.protocol_errors() == {"implausible": 0, "malformed": 0}
        until(lambda: not peer.controller.has_program, "the program's end")
        until(lambda: not peer.controller.motion.moving, "the arm's rest")
        assert peer.controller.motion.target_q[1:] == pytest.approx(home[1:], abs=1e-6)


class LyingProxy:
    """RTDE proxy in its own process; the time in states is wrong once `lies` is set."""

    def __init__(self, port, clock):
        context = multiprocessing.get_context("spawn")
        self.lies = context.Event()
        ours, theirs = context.Pipe()
        self._process = context.Process(target=_pass_on, args=(port, clock, self.lies, theirs))
        self._process.start()
        self.port = ours.recv()

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._process.terminate()
        self._process.join()


def _pass_on(port, clock, lies, reported):
    jump_s, share = clock
    with socket.create_server(("127.0.0.1", 0)) as listener:
        reported.send(listener.getsockname()[1])
        while True:
            client, _ = listener.accept()
            server = socket.create_connection(("127.0.0.1", port))
            with client, server:
                pending, began_s = b"", None
                while True:
                    ready = select.select([client, server], [], [])[0]
                    data = ready[0].recv(65536)
                    if not data:
                        break
                    if ready[0] is client:
                        server.sendall(data)
                        continue
                    pending += data
                    out = b""
                    while len(pending) >= 3 and len(pending) >= (
                        size := _SIZE.unpack_from(pending)[0]
                    ):
                        packet, pending = bytearray(pending[:size]), pending[size:]
                        if packet[2] == PacketType.DATA and lies.is_set():
                            (time_s,) = _TIME.unpack_from(packet, 4)
                            began_s = time_s if began_s is None else began_s
                            lied_s = time_s + jump_s + share * (time_s - began_s)
                            _TIME.pack_into(packet, 4, lied_s)
                        out += packet
                    client.sendall(out)


_SIZE, _TIME = struct.Struct(">H"), struct.Struct(">d")


@pytest.mark.parametrize("clock", [(0.14, 0.0), (1.0, 0.0), (0.0, 0.6), (0.0, 3.0)])
def test_a_proxy_whose_time_stamps_lie_makes_nothing_faster(clock):
    with (
        any_ports(running=True) as peer,
        LyingProxy(peer.port("rtde"), clock) as proxy,
        driver_of(peer, enable="at-start", rtde_port=proxy.port, lookahead_s=0.2) as driver,
    ):
        began_s = before = None
        said_s, fastest = math.inf, 0.0
        for state in driver.cycles():
            if state.ready:
                driver.send(JointVelocityCommand((SPEED, 0.0, 0.0, 0.0, 0.0, 0.0)))
                began_s = state.stamp_s if began_s is None else began_s
            if began_s is None:
                continue
            # The arm's own clock has frames of 2 ms, however late this computer is.
            controller = peer.controller
            now = (controller.frames, controller.motion.actual_q[0])
            if state.stamp_s - began_s > 1.0:
                proxy.lies.set()
                if before is None:
                    before = now
                elif now[0] - before[0] >= 25:
                    frames_s = (now[0] - before[0]) * controller.period_s
                    fastest = max(fastest, (now[1] - before[1]) / frames_s)
                    before = now
                if "the controller's clock" in state.hold_reason:
                    said_s = min(said_s, state.stamp_s)
                if state.stamp_s > min(said_s + 0.5, began_s + 6.0):
                    break
        assert said_s < began_s + 5.0
        assert 0.0 < fastest <= 1.1 * SPEED


def test_nobody_is_there():
    port = free_tcp_port()
    with UrRtde(rtde_port=port) as driver:
        states = driver.cycles()
        found = [next(states) for _ in range(3)]
        assert {state.link for state in found} == {RobotLink.WAITING}
        assert f"127.0.0.1:{port}: Connection refused" in found[-1].hold_reason
        driver.send(HoldCommand())
        states.close()


@pytest.mark.real
def test_a_controller_that_comes_later_and_goes():
    peer = any_ports(running=True)
    peer.open()
    ports = {kind: peer.port(kind) for kind in ("rtde", "primary", "dashboard")}
    peer.close()
    options = {f"{kind}_port": port for kind, port in ports.items()}
    with UrRtde(rate_hz=125.0, **options) as driver:
        links, wanted = [], threading.Event()

        def loop():
            for state in driver.cycles():
                links.append(state.link)
                if wanted.is_set():
                    return

        thread = threading.Thread(target=loop)
        thread.start()
        until(lambda: RobotLink.WAITING in links, "waiting")
        with UrControllerPeer(UrControllerOptions(running=True, **options)):
            until(lambda: RobotLink.LIVE in links, "a state")
        until(lambda: links[-1] is RobotLink.LOST, "the loss")
        with UrControllerPeer(UrControllerOptions(running=True, **options)):
            until(lambda: links[-1] is RobotLink.LIVE, "a state again")
            wanted.set()
            thread.join()


def test_what_speaks_no_rtde():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        with UrRtde(rtde_port=listener.getsockname()[1]) as driver:
            states = driver.cycles()
            next(states)
            theirs, _ = listener.accept()
            with theirs:
                theirs.sendall(b"\0\0HTTP/1.1 400 Bad Request\r\n\r\n")
                found = until(
                    lambda: next(
                        (s for s in (next(states),) if "not an RTDE" in s.hold_reason), None
                    ),
                    "the reason",
                )
                assert "a packet of 0 bytes: not an RTDE server" in found.hold_reason
            states.close()


def test_a_name_that_nobody_has():
    with pytest.raises(AddressError, match=r"host nowhere\.invalid"):
        UrRtde(host="nowhere.invalid").open()
    with pytest.raises(NotOpenError):
        UrRtde().send(HoldCommand())


def test_what_the_doctor_may_look_at():
    ports = {each.port for each in UrRtde().endpoints()}
    assert ports == {30004, 29999}
