"""Simulated network: it delays each direction, keeps the order, and forwards the end."""

from __future__ import annotations

import contextlib
import socket
import time

import pytest

from cardan.sim_peers.network import DelayedStream, SimulatedNetworkOptions, SimulatedNetworkPeer


def test_a_chunk_arrives_after_the_delay_and_not_before():
    way = DelayedStream(SimulatedNetworkOptions(delay_ms=40.0), 1)
    way.carry(b"abc", 2.0)
    assert (way.next_due_s, way.under_way) == (2.04, 3)
    assert way.arrived(2.0399) == []
    assert way.arrived(2.04) == [b"abc"]
    assert way.under_way == 0


def test_jitter_delays_within_its_bound_and_keeps_the_order():
    way = DelayedStream(SimulatedNetworkOptions(delay_ms=10.0, jitter_ms=20.0), 1)
    latest_s, delays_s = 0.0, []
    for index in range(200):
        sent_s = 1e-3 * index
        way.carry(bytes([index]), sent_s)
    arrived = []
    while way.next_due_s < 10.0:
        due_s = way.next_due_s
        assert due_s >= latest_s
        latest_s = due_s
        for chunk in way.arrived(due_s):
            arrived.append(chunk[0])
            delays_s.append(due_s - 1e-3 * chunk[0])
    assert arrived == list(range(200))
    assert min(delays_s) >= 0.01 - 1e-9
    assert 0.02 < max(delays_s) <= 0.03 + 1e-9


def test_a_burst_holds_everything_back_until_its_end():
    way = DelayedStream(SimulatedNetworkOptions(delay_ms=0.0, faults={"burst": 0.5}), 1)
    way.carry(b"x", 0.6)  # The second interval is from 0.5 to 1 s.
    assert way.arrived(0.99) == []
    assert way.arrived(1.0) == [b"x"]


@pytest.fixture
def server():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(5.0)
        yield listening


@contextlib.contextmanager
def joined(server, **options):
    """Return both ends of a connection through the peer."""
    port = server.getsockname()[1]
    with SimulatedNetworkPeer(SimulatedNetworkOptions(port=0, to_port=port, **options)) as peer:
        host, _, own = peer.endpoint.rpartition(":")
        with socket.create_connection((host, int(own)), 5.0) as near:
            far, _ = server.accept()
            far.settimeout(5.0)
            with far:
                yield near, far


def test_bytes_and_the_end_of_the_stream_pass_both_ways_late(server):
    with joined(server, delay_ms=30.0) as (near, far):
        began_s = time.monotonic()
        near.sendall(b"there")
        assert far.recv(100) == b"there"
        far.sendall(b"back")
        assert near.recv(100) == b"back"
        assert time.monotonic() - began_s >= 0.06
        near.shutdown(socket.SHUT_WR)
        assert far.recv(100) == b""
        far.sendall(b"still open")
        assert near.recv(100) == b"still open"


def test_more_than_may_be_under_way_arrives_whole(server):
    sent = bytes(range(256)) * 12_000
    with joined(server, delay_ms=1.0) as (near, far):
        near.settimeout(10.0)
        got = bytearray()
        view = memoryview(sent)
        near.setblocking(False)
        far.setblocking(False)
        until_s = time.monotonic() + 20.0
        while len(got) < len(sent) and time.monotonic() < until_s:
            with contextlib.suppress(BlockingIOError):
                view = view[near.send(view) :]
            with contextlib.suppress(BlockingIOError):
                got += far.recv(65536)
        assert bytes(got) == sent


def test_a_connection_ends_where_the_other_side_is_not_there():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
    with SimulatedNetworkPeer(SimulatedNetworkOptions(port=0, to_port=port)) as peer:
        host, _, own = peer.endpoint.rpartition(":")
        with socket.create_connection((host, int(own)), 5.0) as near:
            near.settimeout(5.0)
            assert near.recv(1) == b""


@pytest.mark.parametrize("cut", [False, True])
def test_nothing_passes_a_link_that_is_cut(server, cut):
    port = server.getsockname()[1]
    faults = {"cut": 0.0} if cut else {}
    peer = SimulatedNetworkPeer(SimulatedNetworkOptions(port=0, to_port=port, faults=faults))
    with contextlib.ExitStack() as stack:
        peer.open()
        stack.callback(peer.close)
        host, _, own = peer.endpoint.rpartition(":")
        stack.enter_context(socket.create_connection((host, int(own)), 5.0))
        peer.step(time.monotonic() + 0.1)
        server.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            stack.enter_context(server.accept()[0])
            assert not cut
            return
        assert cut
