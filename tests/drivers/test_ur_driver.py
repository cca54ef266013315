"""The UR driver on real sockets, with the simulated controller on them."""

from __future__ import annotations

import socket
import threading

import pytest

from cardan.drivers.ur_rtde import UrRtde
from cardan.errors import AddressError, NotOpenError
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
    # A process may stand still for seconds where tests run: the watchdog is as long as it can be.
    ports = {f"{kind}_port": peer.port(kind) for kind in ("rtde", "primary", "dashboard")}
    return UrRtde(rate_hz=125.0, watchdog_s=0.5, robot=peer.options.robot, **{**ports, **options})


@pytest.mark.real
@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
def test_it_starts_moves_and_leaves(robot):
    with any_ports(robot=robot, boot_s=0.1, release_s=0.1) as peer:
        home = tuple(peer.controller.servo.target_q)
        with driver_of(peer, enable="at-start") as driver:
            began = False
            for state in driver.cycles():
                if not state.ready and not began:
                    continue
                if not state.ready:
                    # This computer stood still for too long.
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
        until(lambda: not peer.controller.servo.moving, "the arm's rest")
        assert peer.controller.servo.target_q[1:] == pytest.approx(home[1:], abs=1e-6)


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
                    lambda: next((s for s in (next(states),) if "no RTDE" in s.hold_reason), None),
                    "the reason",
                )
                assert "a packet of 0 bytes: this is no RTDE" in found.hold_reason
            states.close()


def test_a_name_that_nobody_has():
    with pytest.raises(AddressError, match=r"host nowhere\.invalid"):
        UrRtde(host="nowhere.invalid").open()
    with pytest.raises(NotOpenError):
        UrRtde().send(HoldCommand())


def test_what_the_doctor_may_look_at():
    ports = {each.port for each in UrRtde().endpoints()}
    assert ports == {30004, 29999}
