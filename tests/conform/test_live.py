"""Suites against simulated peers over real sockets."""

from __future__ import annotations

import socket
import sys
import time

import pytest

from cardan.conform import Exchange, Level, registry, run
from cardan.errors import AddressError, ConfigurationError, DeviceAccessError
from cardan.sim_peers.motoros_controller import MotorosControllerOptions, MotorosControllerPeer


@pytest.mark.real
def test_a_controller_is_judged_over_tcp():
    reported = []
    with MotorosControllerPeer(MotorosControllerOptions(base_port=0)) as peer:
        ports = {"motion": peer.motion_port, "state": peer.state_port, "io": peer.io_port}
        suite = registry.load("motoros")
        from cardan.conform.transports import TcpPorts

        suite.wires = lambda target: TcpPorts(target, ports)
        report, timeline = run.at(suite, "127.0.0.1", Level.LISTEN, reported.append, seconds=1.5)
    assert timeline.end_s >= 0.5
    outcomes = {each.id: each.outcome.value for each in report.results}
    # Requirements on timing are left out: this computer may stand still at any moment.
    for requirement in ("MOTO-001", "MOTO-002", "MOTO-005", "MOTO-006", "MOTO-007", "MOTO-009"):
        assert outcomes[requirement] == "passed", report.as_text()
    assert not report.simulated
    assert reported == []


def test_a_target_that_is_not_there_is_an_error():
    with pytest.raises(AddressError, match=r"cannot connect to 127\.0\.0\.1:"):
        run.at(registry.load("motoros"), "127.0.0.1:1", Level.LISTEN, print)
    with pytest.raises(DeviceAccessError, match=r"nothing-here cannot be opened"):
        run.at(registry.load("3dconnexion"), "/dev/nothing-here", Level.LISTEN, print)


@pytest.mark.parametrize("target", ["host:none", "host:0", "host:65536", "host:"])
def test_a_target_without_a_port_after_its_colon_is_refused(target):
    with pytest.raises(ConfigurationError, match="no port of 1 to 65535"):
        registry.load("motoros").wires(target)


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's stamps are Linux's")
def test_a_datagram_is_stamped_when_it_comes_not_when_it_is_read():
    """A late reader must not report its own delay as a pause of the sender."""
    from cardan.conform.transports import UdpPort

    wire = UdpPort("127.0.0.1", 0, listens=True).open("")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        port = wire._socket.getsockname()[1]
        # Kernel timestamps begin a little after their request; until then the read sets the stamp.
        for _ in range(3000):
            sender.sendto(b"", ("127.0.0.1", port))
            time.sleep(0.01)
            if any(wire.late_s >= 0.01 for _ in wire.read()):
                break
        start_s = time.monotonic()
        sender.sendto(b"one", ("127.0.0.1", port))
        time.sleep(0.05)
        sender.sendto(b"two", ("127.0.0.1", port))
        time.sleep(0.05)
        reading_s = time.monotonic()
        lain = [(data, wire.late_s) for data, _ in wire.read()]
        end_s = time.monotonic()
    wire.close()
    (one, one_s), (two, two_s) = lain
    assert (one, two) == (b"one", b"two")
    assert 0.05 <= two_s < one_s <= end_s - start_s
    # The second is read later than the first.
    assert one_s - two_s >= 0.05 - (end_s - reading_s)


def test_a_timeline_has_when_things_came_and_how_late_its_computer_was():
    exchange = Exchange(registry.load("egm").scenario(Level.LISTEN, 1.0))
    exchange.due(0.0)
    exchange.heard(0.5, "", b"x", late_s=0.2)
    (came,) = (each for each in exchange.timeline if each.data)
    assert came.time_s == 0.3
    assert exchange.timeline.late_s == 0.2


def test_a_device_file_is_read_report_by_report(tmp_path):
    import os

    from cardan.conform.transports import FileWire

    reading, writing = os.pipe()
    wire = FileWire(reading)
    assert list(wire.read()) == []
    os.write(writing, b"\x01\x02")
    assert list(wire.read()) == [(b"\x01\x02", "")]
    os.close(writing)
    assert list(wire.read()) == []
    assert wire.ended
    wire.close()
