"""Unix sockets that stand for a device."""

from __future__ import annotations

import os
import selectors
import socket

import pytest

from cardan.errors import AddressError
from cardan.sim_peers.carriers.server import PacketClient
from cardan.sim_peers.carriers.unix_socket import Advice, PacketServer, PacketSocket


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


class TestPath:
    def test_is_taken_and_removed(self, path):
        taken = PacketSocket(path)
        assert os.path.exists(path)
        taken.close()
        taken.close()
        assert not os.path.exists(path)

    def test_a_socket_left_behind_is_replaced(self, path):
        PacketSocket(path).sock.close()
        PacketSocket(path).close()
        assert not os.path.exists(path)

    def test_another_programs_is_refused_and_left_alone(self, path):
        served = PacketSocket(path)
        served.sock.listen()
        with pytest.raises(AddressError) as error:
            PacketSocket(path, Advice(served="go away"))
        assert str(error.value) == f"another program serves {path!r} (it answers); go away"
        connected(path).close()
        served.close()

    def test_another_kind_is_refused_and_left_alone(self, path, tmp_path):
        (tmp_path / "device").write_text("mine")
        with pytest.raises(AddressError) as error:
            PacketSocket(path)
        assert str(error.value) == f"{path!r} exists and is not a socket; give another path"
        assert (tmp_path / "device").read_text() == "mine"
        with pytest.raises(AddressError, match="socket; give another directory"):
            PacketSocket(path, Advice(no_socket="give another directory"))

    @pytest.mark.parametrize("name", ["no/such/device", "d" * 150])
    def test_one_that_cannot_be_made_is_refused(self, tmp_path, name):
        with pytest.raises(AddressError, match="give a short path in a directory"):
            PacketSocket(str(tmp_path / name))

    def test_only_what_is_still_ours_is_removed(self, path):
        first = PacketSocket(path)
        os.unlink(path)
        second = PacketSocket(path)
        first.close()
        assert os.path.exists(path)
        second.close()
        assert not os.path.exists(path)


class Queue(PacketClient):
    def send(self, packet: bytes) -> None:
        self._queue.append(packet)


class Bench:
    """A server that notes what it hears."""

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
