"""Shell of simulated controllers that exchange datagrams: schedule, network, sockets."""

from __future__ import annotations

import contextlib
import socket
import time

import pytest

from cardan.common.sockets import DRAIN_AT_MOST, opened, waiting
from cardan.errors import AddressError
from cardan.sim_peers.datagrams import DatagramPeer

pytestmark = pytest.mark.matrix


class Echo(DatagramPeer):
    """Sends its cycle's number in each cycle, and records received datagrams."""

    def __init__(self, to: tuple[str, int], period_s: float = 0.002, **network) -> None:
        super().__init__(period_s, **network)
        self.to = to
        self.scheduled: list[float] = []
        self.received: list[bytes] = []
        self.heard: list[bool] = []

    @property
    def endpoint(self) -> str:
        return f"{self.to[0]}:{self.to[1]}"

    def _connect(self) -> socket.socket:
        return opened(*self.to, socket.SOCK_DGRAM, socket.socket.connect, "cannot send")

    def _cycle(self, now_s: float, scheduled_s: float) -> None:
        self.scheduled.append(scheduled_s)
        self._send(b"%d" % len(self.scheduled), now_s)

    def _receive(self, data: bytes, source: object, now_s: float) -> None:
        self.received.append(data)

    def _heard(self, somebody: bool) -> None:
        self.heard.append(somebody)

    def _transmit(self, data: bytes) -> None:
        assert self._socket is not None
        try:
            self._socket.send(data)
        except ConnectionRefusedError:
            self._heard(False)


def peer_open(peer: Echo):
    peer.open()
    peer.open()
    return contextlib.closing(peer)


@pytest.fixture
def listener():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(5.0)
        yield sock


def test_cycles_keep_to_the_schedule_after_a_stall(listener):
    peer = Echo(listener.getsockname())
    peer.open()
    peer.step(time.monotonic() + 0.02)
    first = len(peer.scheduled)
    until_s = time.monotonic() + 0.05
    while time.monotonic() < until_s:
        pass
    peer.step(time.monotonic() + 0.02)
    peer.close()
    steps = [b - a for a, b in zip(peer.scheduled, peer.scheduled[1:], strict=False)]
    assert all(abs(step / 0.002 - round(step / 0.002)) < 1e-6 for step in steps)
    assert steps[first - 1] >= 0.04


def test_both_ways(listener):
    peer = Echo(listener.getsockname())
    with peer_open(peer):
        peer.step(time.monotonic() + 0.01)
        data, source = listener.recvfrom(100)
        assert data == b"1"
        listener.sendto(b"answer", source)
        peer.step(time.monotonic() + 0.02)
    assert peer.received == [b"answer"]
    assert True in peer.heard


def test_a_bad_network_loses_everything(listener):
    peer = Echo(listener.getsockname(), faults={"drop": 1.0})
    with peer_open(peer):
        peer.step(time.monotonic() + 0.02)
    listener.setblocking(False)
    assert peer.scheduled
    with pytest.raises(BlockingIOError):
        listener.recvfrom(100)


def test_nobody_listens(listener):
    address = listener.getsockname()
    listener.close()
    peer = Echo(address)
    with peer_open(peer):
        peer.step(time.monotonic() + 0.05)
    assert False in peer.heard


def test_a_closed_one_does_nothing(listener):
    peer = Echo(listener.getsockname())
    peer.step(time.monotonic() + 1.0)
    assert peer.scheduled == []
    peer.close()


def test_a_flood_does_not_keep_a_cycle_waiting(listener):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(listener.getsockname())
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        for _ in range(3 * DRAIN_AT_MOST):
            sender.send(b"x")
    listener.setblocking(False)
    assert len(list(waiting(listener, 10))) <= DRAIN_AT_MOST


@pytest.mark.parametrize(("host", "port"), [("192.0.2.1", 1), ("x" * 70, 1)])
def test_an_address_that_is_none(host, port):
    with pytest.raises(AddressError, match=r"^cannot listen: "):
        opened(host, port, socket.SOCK_STREAM, socket.socket.bind, "cannot listen")


@pytest.mark.parametrize("host", ["224.0.0.1", "255.255.255.255", "127.255.255.255"])
@pytest.mark.parametrize("join", [socket.socket.bind, socket.socket.connect])
def test_an_address_of_many(host, join):
    with pytest.raises(AddressError, match=f"^no way: {host} is a (multicast|broadcast) address"):
        opened(host, 6510, socket.SOCK_DGRAM, join, "no way")


def test_an_address_that_stands_for_all_is_one_to_listen_on():
    opened("0.0.0.0", 0, socket.SOCK_DGRAM, socket.socket.bind, "no way").close()
    with pytest.raises(AddressError, match="a wildcard address"):
        opened("0.0.0.0", 6510, socket.SOCK_DGRAM, socket.socket.connect, "no way")
