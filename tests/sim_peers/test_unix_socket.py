"""Unix sockets in place of a device."""

from __future__ import annotations

import selectors
import socket

import pytest

from cardan.sim_peers.backends.server import PacketClient
from cardan.sim_peers.backends.unix_socket import PacketServer


@pytest.fixture
def path(tmp_path):
    return str(tmp_path / "device")


@pytest.fixture
def selector():
    with selectors.DefaultSelector() as made:
        yield made


def connected(path: str) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        sock.connect(path)
    except OSError:
        sock.close()
        raise
    sock.settimeout(2.0)
    return sock


def handle(selector: selectors.BaseSelector) -> None:
    while ready := selector.select(0):
        for key, _ in ready:
            key.data()


class Queue(PacketClient):
    def send(self, packet: bytes) -> None:
        self._queue.append(packet)


class Bench:
    """Server that records received messages."""

    def __init__(self, path: str, selector: selectors.BaseSelector) -> None:
        self.heard: list[bytes] = []
        self.gone = 0
        self.server: PacketServer[Queue] = PacketServer(
            path, selector, 2, meet=Queue, take=self.take, part=self.part
        )

    def take(self, client: Queue, packet: bytes) -> None:
        self.heard.append(packet)
        client.send(packet[::-1])

    def part(self, client: Queue) -> None:
        self.gone += 1


class TestServer:
    def test_refuses_until_it_listens(self, path, selector):
        bench = Bench(path, selector)
        with pytest.raises(ConnectionRefusedError):
            connected(path)
        bench.server.listen()
        connected(path).close()
        bench.server.close()
        with pytest.raises(FileNotFoundError):
            connected(path)

    def test_packets_go_both_ways(self, path, selector):
        bench = Bench(path, selector)
        bench.server.listen()
        with connected(path) as one, connected(path) as other:
            handle(selector)
            one.send(b"abc")
            other.send(b"xyz")
            handle(selector)
            assert sorted(bench.heard) == [b"abc", b"xyz"]
            assert (one.recv(10), other.recv(10)) == (b"cba", b"zyx")
            with connected(path) as third:
                handle(selector)
                assert third.recv(10) == b""
            assert len(bench.server.clients) == 2
            bench.server.close()
            assert (one.recv(10), other.recv(10)) == (b"", b"")
        assert bench.gone == 2
        assert not selector.get_map()

    def test_who_only_looks_or_leaves_is_forgotten(self, path, selector):
        bench = Bench(path, selector)
        bench.server.listen()
        connected(path).close()
        handle(selector)
        assert (bench.server.clients, bench.gone) == ([], 0)
        with connected(path):
            handle(selector)
        handle(selector)
        assert (bench.server.clients, bench.gone) == ([], 1)
        bench.server.close()

    def test_what_a_client_has_no_room_for_waits(self, path, selector):
        bench = Bench(path, selector)
        bench.server.listen()
        with connected(path) as reader:
            handle(selector)
            (client,) = bench.server.clients
            for number in range(100):
                client.send(bytes((number,)))
            bench.server.flush(client)
            assert client.waiting
            read = []
            while len(read) < 100:
                read.append(reader.recv(10)[0])
                handle(selector)
            assert read == list(range(100))
            assert not client.waiting
        bench.server.close()
