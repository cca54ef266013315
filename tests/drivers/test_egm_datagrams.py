"""The compiled `recvfrom` and `sendto` compared with Python's."""

import os
import signal
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from cardan.common.native import NativePartError
from cardan.drivers.abb_egm import compiled


def bound(wait_s: float = 5.0) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    limit = struct.pack("@ll", int(wait_s), int(wait_s % 1.0 * 1e6))
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, limit)
    return sock


@pytest.fixture
def sock() -> Iterator[socket.socket]:
    with bound() as made:
        yield made


@pytest.fixture
def peers() -> Iterator[list[socket.socket]]:
    made = [bound(), bound()]
    yield made
    for each in made:
        each.close()


def test_they_do_as_those_of_python(sock: socket.socket, peers: list[socket.socket]) -> None:
    recvfrom, sendto = compiled.datagrams(sock)
    assert recvfrom != sock.recvfrom
    own = sock.getsockname()
    for size, peer in ((0, 0), (1, 1), (1, 0), (300, 1), (300, 1), (2049, 0), (2050, 0)):
        data = os.urandom(size)
        found = []
        for receive in (recvfrom, sock.recvfrom):
            peers[peer].sendto(data, own)
            found.append(receive(2049))
        assert found[0] == found[1] == (data[:2049], peers[peer].getsockname())
        assert [*map(type, found[0][1])] == [str, int]
        for send in (sendto, sock.sendto):
            assert send(data, found[0][1]) == size
            assert peers[peer].recvfrom(3000) == (data, own)


def test_a_sender_that_is_heard_again_is_the_same_object(
    sock: socket.socket, peers: list[socket.socket]
) -> None:
    recvfrom, _ = compiled.datagrams(sock)
    heard = []
    for peer in (0, 0, 1, 1, 0):
        peers[peer].sendto(b"x", sock.getsockname())
        heard.append(recvfrom(9)[1])
    assert heard[0] is heard[1]
    assert heard[2] is heard[3]
    assert heard[4] == heard[0] != heard[2]


def test_what_fails_is_said_as_python_says_it(sock: socket.socket) -> None:
    with bound(wait_s=0.01) as quick:
        recvfrom, sendto = compiled.datagrams(quick)
        with pytest.raises(BlockingIOError):
            recvfrom(2049)
        for receive in (recvfrom, quick.recvfrom):
            with pytest.raises((TypeError, ValueError)):
                receive(-1)
        for send in (sendto, quick.sendto):
            with pytest.raises(OSError, match="too long"):
                send(bytes(70_000), sock.getsockname())
            with pytest.raises(TypeError):
                send("text", sock.getsockname())
        with pytest.raises(OSError, match="Invalid argument"):
            sendto(b"x", ("localhost", 9))
        with pytest.raises(TypeError):
            sendto(b"x")
    for call in (lambda: recvfrom(9), lambda: sendto(b"x", ("127.0.0.1", 9))):
        with pytest.raises(OSError, match="Bad file descriptor"):
            call()


def test_a_signal_is_handled_while_it_waits(
    sock: socket.socket, peers: list[socket.socket]
) -> None:
    recvfrom, _ = compiled.datagrams(sock)
    main, handled = threading.get_ident(), []

    def after(act: Callable[[], Any]) -> None:
        threading.Timer(0.05, act).start()

    def handle(number: int, frame: object) -> None:
        handled.append(number)
        if len(handled) == 2:
            raise KeyboardInterrupt
        after(lambda: peers[0].sendto(b"x", sock.getsockname()))

    before = signal.signal(signal.SIGUSR1, handle)
    try:
        after(lambda: signal.pthread_kill(main, signal.SIGUSR1))
        assert recvfrom(9)[0] == b"x"
        after(lambda: signal.pthread_kill(main, signal.SIGUSR1))
        with pytest.raises(KeyboardInterrupt):
            recvfrom(9)
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert len(handled) == 2


def test_other_threads_run_while_it_waits(sock: socket.socket, peers: list[socket.socket]) -> None:
    recvfrom, _ = compiled.datagrams(sock)
    found: list[Any] = []
    waiting = threading.Thread(target=lambda: found.append(recvfrom(9)))
    waiting.start()
    peers[0].sendto(b"x", sock.getsockname())
    waiting.join(5.0)
    assert found == [(b"x", peers[0].getsockname())]


def test_other_sockets_have_their_own(sock: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    class Other(socket.socket):
        pass

    sock.settimeout(1.0)
    with Other(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for each in (sock, other):
            assert compiled.datagrams(each) == (each.recvfrom, each.sendto)

    def missing() -> None:
        raise NativePartError("not there")

    monkeypatch.setattr(compiled, "egm_library", missing)
    with bound() as each:
        assert compiled.datagrams(each) == (each.recvfrom, each.sendto)
