"""Messages about a router whose TLS fails: one for each cause, and none for a router that works or
is absent."""

import json
import socket
import ssl
import threading

import pytest

from cardan.bus import tls
from cardan.bus.tls import TlsWatch, tls_obstacle
from cardan.gateway.bus.sharing import News
from tests.certificates import pair
from tests.waiting import until

HOST = "127.0.0.1"
REMEDY = ": no message passes; give the file of the present pair (zenoh_config), or pair both "


class Settings:
    """Zenoh's configuration, reduced to the keys that are read."""

    def __init__(self, endpoints, tls=None):
        self._values = {"connect/endpoints": endpoints, "mode": "client", "transport/link/tls": tls}

    def get_json(self, key):
        return json.dumps(self._values[key], default=str)


class Router:
    """A TLS server that wants a client's certificate, and then waits for its first message."""

    def __init__(self, files):
        self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self._context.load_cert_chain(files["robot"], files["robot-key"])
        self._context.load_verify_locations(files["authority"])
        self._context.verify_mode = ssl.CERT_REQUIRED
        self._listener = socket.create_server((HOST, 0))
        self.port = self._listener.getsockname()[1]
        self.received = b""
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_exception):
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(30.0)

    def _serve(self):
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            try:
                with self._context.wrap_socket(client, server_side=True) as connection:
                    self.received += connection.recv(100)
            except OSError:
                pass


def client(files, **changes):
    return {
        "root_ca_certificate": files["authority"],
        "connect_certificate": files["operator"],
        "connect_private_key": files["operator-key"],
        "enable_mtls": True,
        "verify_name_on_connect": None,
        **changes,
    }


def said_of(router_files, settings, protocol="tls", more=""):
    with Router(router_files) as router:
        said = tls_obstacle(Settings([f"{protocol}/{HOST}:{router.port}{more}"], settings))
        assert router.received == b""
    return said


@pytest.fixture
def quick(monkeypatch):
    """Shorten the wait for an alert of the router, which ends a successful handshake."""
    monkeypatch.setattr(tls, "PROBE_S", 0.3)


def test_of_certificates_that_are_taken_nothing_is_said(tmp_path, quick):
    ours = pair(tmp_path / "ours")
    assert said_of(ours, client(ours)) == ""


@pytest.mark.parametrize("issuer", ["Cardan pair", "another"])
def test_another_pairs_certificate_is_named(tmp_path, issuer):
    ours, others = pair(tmp_path / "ours"), pair(tmp_path / "others", issuer=issuer)
    said = said_of(ours, client(others))
    assert f"is not signed by {others['authority']}{REMEDY}" in said
    forged = client(others, root_ca_certificate=ours["authority"])
    said = said_of(ours, forged, "quic", "?mixed_rel=1")
    assert f"refuses the certificate {others['operator']}, which is of another pair{REMEDY}" in said


def test_a_configuration_without_certificate_is_reported_that_one_is_asked_for(tmp_path):
    ours = pair(tmp_path / "ours")
    for none in ({"enable_mtls": False}, {"connect_certificate": None}):
        said = said_of(ours, client(ours, **none))
        assert f"asks for a certificate, and none is given{REMEDY}" in said


def test_expired_certificates_are_distinguished(tmp_path):
    ours = pair(tmp_path / "ours", operator_days=0)
    said = said_of(ours, client(ours))
    # The certificate expires as it is made, so that no clock has to advance.
    assert said.startswith(f"the certificate {ours['operator']} has expired on 2")
    theirs = pair(tmp_path / "theirs", robot_days=0)
    said = said_of(theirs, client(theirs))
    assert "the certificate of the router at 127.0.0.1 port" in said
    assert f"has expired{REMEDY}" in said


def test_a_certificate_of_the_future_means_a_wrong_clock(tmp_path, monkeypatch):
    ours = pair(tmp_path / "ours")
    monkeypatch.setattr(tls.time, "time", lambda: 0.0)
    said = tls_obstacle(Settings(["tls/127.0.0.1:1"], client(ours)))
    assert f"the certificate {ours['operator']} begins on 2" in said
    assert "UTC: set the clock: no message passes" in said


def test_a_router_at_another_name_is_reported(tmp_path, quick):
    ours = pair(tmp_path / "ours", names=["robot.example"])
    assert "is not for this address" in said_of(ours, client(ours))
    assert said_of(ours, client(ours, verify_name_on_connect=False)) == ""


def test_files_that_are_none_are_named(tmp_path):
    ours = pair(tmp_path / "ours")
    gone = str(tmp_path / "gone.pem")
    settings = client(ours, connect_certificate=gone)
    assert f"the certificate {gone} cannot be read" in said_of(ours, settings)
    settings = client(ours, connect_private_key=gone)
    assert "the certificates of the configuration cannot be used" in said_of(ours, settings)


@pytest.mark.parametrize("endpoints", [[], ["tcp/127.0.0.1:1"], ["tls/127.0.0.1:1"], ["tls/x"]])
def test_where_no_router_with_certificates_answers_nothing_is_said(tmp_path, endpoints):
    ours = pair(tmp_path / "ours")
    assert tls_obstacle(Settings(endpoints, client(ours))) == ""
    by_mode = {"client": [{"endpoint": each} for each in endpoints]}
    assert tls_obstacle(Settings(by_mode, client(ours))) == ""


def test_a_loop_is_reported_without_waiting_and_once_the_router_is_back_no_more():
    looks, go_on = [], threading.Event()

    def look():
        looks.append(None)
        assert go_on.wait(30.0)
        return f"obstacle {len(looks)}"

    watch = TlsWatch(look)
    assert watch.obstacle(0.0, routed=True) == ""
    assert looks == []
    assert watch.obstacle(1.0, routed=False) == ""
    go_on.set()
    until(lambda: watch.obstacle(1.5, routed=False))
    assert watch.obstacle(5.9, routed=False) == "obstacle 1"
    assert len(looks) == 1
    until(lambda: watch.obstacle(6.1, routed=False) == "obstacle 2")
    assert watch.obstacle(6.2, routed=True) == ""
    assert len(looks) == 2


def test_who_shares_is_reported_each_obstacle_once():
    news = News("", routed=True)
    assert len(news.of_bus([], routed=False)) == 1
    assert news.of_bus([], routed=False, obstacle="expired") == ["expired"]
    assert news.of_bus([], routed=False, obstacle="expired") == []
    assert news.of_bus([], routed=False, obstacle="other") == ["other"]
    assert news.of_bus([], routed=True) == ["the router is there again"]
    assert len(news.of_bus([], routed=False, obstacle="other")) == 2
