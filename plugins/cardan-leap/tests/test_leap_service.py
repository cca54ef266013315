"""The simulated service on a real port, used by a third-party WebSocket client."""

from __future__ import annotations

import json
import socket
import time

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from cardan.errors import AddressError, ConfigurationError, ScriptError
from cardan_leap.driver.connection import Connection, ServiceClosedError
from cardan_leap.peer import LeapPeer, LeapPeerOptions
from cardan_leap.peer.websocket import MAX_CLIENTS
from tests.serving import in_a_thread

pytestmark = pytest.mark.matrix

TIMEOUT_S = 10.0
CLOSE_TIMEOUT_S = 0.1
"""Close timeout: this client does not see the end while frames are unread."""


def serving(script="rest", **options):
    return in_a_thread(LeapPeer(LeapPeerOptions(port=0, script=script, **options)))


def client(peer, path="/v6.json", **options):
    return connect(
        f"ws://127.0.0.1:{peer.backend.port}{path}",
        compression=None,
        proxy=None,
        open_timeout=TIMEOUT_S,
        close_timeout=CLOSE_TIMEOUT_S,
        **options,
    )


def next_json(connection):
    return json.loads(connection.recv(timeout=TIMEOUT_S))


def drain(connection, timeout_s):
    """Read messages until an error."""
    take = connection.recv if hasattr(connection, "recv") else connection.receive
    while True:
        take(timeout_s)


def test_a_session_of_messages():
    with serving(script="short") as peer, client(peer) as leap:
        assert peer.endpoint == f"ws://127.0.0.1:{peer.backend.port}/v6.json"
        assert next_json(leap) == {"serviceVersion": "2.3.1+33747", "version": 6}
        assert next_json(leap)["event"]["state"]["streaming"] is True
        leap.send('{"background":true}')
        frame = next_json(leap)
        assert frame["hands"] == []
        while not frame["hands"]:
            frame = next_json(leap)
        assert frame["hands"][0]["type"] == "right"
        assert len(frame["pointables"]) == 5
        leap.ping().wait(TIMEOUT_S)


def test_the_script_starts_with_the_first_options():
    with serving() as peer, client(peer) as leap:
        next_json(leap)
        next_json(leap)
        with pytest.raises(TimeoutError):
            leap.recv(timeout=0.1)
        leap.send('{"focused":true}')
        assert next_json(leap)["id"] < 5


def test_frames_keep_their_rate():
    with serving() as peer, client(peer, "/") as leap:
        assert next_json(leap)["version"] == 1
        ids, stamps = [], []
        for _ in range(60):
            frame = next_json(leap)
            ids.append(frame["id"])
            stamps.append(frame["timestamp"])
        assert ids == sorted(set(ids))
        gap_us = (stamps[-1] - stamps[0]) / (ids[-1] - ids[0])
        assert gap_us == pytest.approx(1e6 / 110.0, rel=0.05)


def test_unsupported_versions_and_paths():
    with serving(faults={"highest-version": 3.0}) as peer:
        for version in (4, 6, 9):
            with client(peer, f"/v{version}.json") as leap:
                with pytest.raises(ConnectionClosed) as closed:
                    leap.recv(timeout=TIMEOUT_S)
                assert closed.value.rcvd.code == 1001
        with client(peer, "/v3.json") as leap:
            assert next_json(leap)["version"] == 3
        with pytest.raises(InvalidStatus, match="404"):
            client(peer, "/leap")


def test_no_extension_is_agreed_on():
    with serving() as peer:
        url = f"ws://127.0.0.1:{peer.backend.port}/v6.json"
        with connect(url, proxy=None) as leap:  # offers permessage-deflate
            assert leap.protocol.extensions == []


@pytest.mark.real
def test_several_clients_and_the_focus():
    with serving() as peer, client(peer) as first, client(peer, "/v4.json") as second:
        for leap in (first, second):
            next_json(leap)
        first.send('{"focused":true}')
        next_json(first)  # the device
        assert "hands" in next_json(first)
        second.send('{"focused":true}')
        assert "hands" in next_json(second)
        with pytest.raises(TimeoutError):
            drain(first, 0.2)
        first.send('{"background":true}')
        assert "hands" in next_json(first)


def test_a_restart_cuts_every_connection_and_comes_back(tmp_path):
    script = tmp_path / "restart.script"
    script.write_text("0.2 restart 0.3")
    with serving(script=str(script)) as peer:
        with client(peer) as leap:
            leap.send('{"background":true}')
            with pytest.raises(ConnectionClosed):
                drain(leap, TIMEOUT_S)
        end_s = time.monotonic() + TIMEOUT_S
        while True:
            try:
                with client(peer) as leap:
                    assert next_json(leap)["version"] == 6
                break
            except (OSError, ConnectionClosed):
                assert time.monotonic() < end_s
                time.sleep(0.01)


def test_refuse():
    with serving(faults={"refuse": float("inf")}) as peer, pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", peer.backend.port), TIMEOUT_S)


def test_a_client_that_does_not_read_is_left_behind_and_nobody_else():
    with serving(rate_hz=1000.0) as peer, client(peer, "/", max_queue=1) as slow:
        next_json(slow)
        with client(peer, "/") as quick:
            newest = [next_json(quick) for _ in range(200)][-1]
        assert newest["id"] > 100


def test_too_many_clients():
    with serving() as peer:
        address = ("127.0.0.1", peer.backend.port)
        crowd = [socket.create_connection(address) for _ in range(MAX_CLIENTS)]
        extra = socket.create_connection(address)
        extra.settimeout(TIMEOUT_S)
        assert extra.recv(1) == b""
        for connection in (*crowd, extra):
            connection.close()


def test_junk_instead_of_a_handshake():
    with serving() as peer:
        for junk in (b"\x00" * 100, b"GET / HTTP/1.1\r\n\r\n", b"\r\n\r\n"):
            with socket.create_connection(
                ("127.0.0.1", peer.backend.port), TIMEOUT_S
            ) as connection:
                connection.sendall(junk)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(4096):
                    pass
        with client(peer) as leap:
            assert next_json(leap)["version"] == 6


def test_an_address_that_is_taken():
    with serving() as peer:
        other = LeapPeer(LeapPeerOptions(port=peer.backend.port))
        with pytest.raises(AddressError, match="cannot listen"):
            other.open()
        other.close()
        other.close()


def test_closing_says_good_bye():
    peer = LeapPeer(LeapPeerOptions(port=0, script="rest"))
    with in_a_thread(peer):
        leap = Connection("127.0.0.1", peer.backend.port, 6, time.monotonic() + TIMEOUT_S)
        assert leap.receive(TIMEOUT_S)
    with pytest.raises(ServiceClosedError) as closed:
        drain(leap, TIMEOUT_S)
    assert closed.value.code == 1001
    leap.close()


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"port": 70000}, ConfigurationError, "port: 70000 is not allowed"),
        ({"rate_hz": 0.0}, ConfigurationError, "rate_hz"),
        ({"jitter": 1.0}, ConfigurationError, "jitter"),
        ({"script": "nosuch"}, ScriptError, "nosuch"),
        ({"faults": {"nosuch": 1.0}}, ScriptError, "there is no fault"),
    ],
)
def test_nonsense(options, error, words):
    with pytest.raises(error, match=words):
        LeapPeer(LeapPeerOptions(**options))
