"""Certificates that the console generates, and addresses printed for users."""

from __future__ import annotations

import datetime
import os
import ssl
import subprocess

import pytest

from cardan.common.certificates import read_certificate
from cardan.common.files import read_text
from cardan.errors import ConfigurationError, OptionError
from cardan.gateway.servers.console import address, certificate
from cardan.gateway.servers.console.address import (
    own_addresses,
    own_names,
    page_address,
    picture,
    reachable_host,
)
from cardan.gateway.servers.console.certificate import (
    RENEW_DAYS,
    by_cryptography,
    by_openssl,
    own_certificate,
)
from cardan.gateway.servers.console.server import ConsoleOptions
from cardan.gateway.servers.web import tls_context

NAMES = ["robot", "robot.local", "localhost", "192.168.1.10", "fd00::10", "127.0.0.1"]
NOW = datetime.datetime.now(datetime.timezone.utc)


def day(number):
    return NOW + datetime.timedelta(days=number)


@pytest.fixture(params=[by_cryptography, by_openssl])
def maker(request):
    if request.param is by_cryptography:
        pytest.importorskip("cryptography", reason="pip install cryptography")
    return request.param


def test_one_is_made_for_names_and_addresses_and_is_kept(tmp_path, maker):
    own = own_certificate(NAMES, NOW, tmp_path / "state", [maker])
    found = read_certificate(read_text(own.certificate))
    assert found.names == tuple(NAMES)
    assert found.ends - found.begins < datetime.timedelta(days=398)
    assert found.begins <= datetime.datetime.now(datetime.timezone.utc)
    assert os.stat(own.key).st_mode & 0o777 == 0o600
    assert own.why_new
    again = own_certificate(NAMES[:3], day(1), tmp_path / "state", [maker])
    assert again == own._replace(why_new="")
    assert tls_context(str(own.certificate), str(own.key)) is not None


def test_its_fingerprint_is_what_openssl_says(tmp_path, maker):
    own = own_certificate(NAMES, NOW, tmp_path, [maker])
    said = subprocess.run(
        ["openssl", "x509", "-in", own.certificate, "-noout", "-fingerprint", "-sha256"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert said.stdout.strip().partition("=")[2] == own.fingerprint


def test_a_browser_that_trusts_it_is_content_with_its_names(tmp_path, maker):
    own = own_certificate(NAMES, NOW, tmp_path, [maker])
    server = tls_context(str(own.certificate), str(own.key))
    for name in ("robot.local", "192.168.1.10", "fd00::10"):
        client = ssl.create_default_context(cafile=str(own.certificate))
        to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
        there = client.wrap_bio(to_client, to_server, server_hostname=name)
        here = server.wrap_bio(to_server, to_client, server_side=True)
        done = set()
        for _ in range(10):
            for end in (there, here):
                try:
                    end.do_handshake()
                    done.add(end)
                except ssl.SSLWantReadError:
                    pass
        assert done == {there, here}


def test_it_is_made_anew_in_time(tmp_path):
    first = own_certificate(NAMES, NOW, tmp_path)
    ends = read_certificate(read_text(first.certificate)).ends
    early = ends - datetime.timedelta(days=RENEW_DAYS + 1)
    assert own_certificate(NAMES, early, tmp_path).why_new == ""
    late = ends - datetime.timedelta(days=RENEW_DAYS - 1)
    renewed = own_certificate(NAMES, late, tmp_path)
    assert "ends on" in renewed.why_new
    assert renewed.fingerprint != first.fingerprint


def test_it_is_made_anew_for_a_new_address_and_keeps_the_old_ones(tmp_path):
    own_certificate(NAMES, NOW, tmp_path)
    moved = own_certificate(["robot", "10.0.0.5"], NOW, tmp_path)
    assert "10.0.0.5" in moved.why_new
    assert set(NAMES) < set(read_certificate(read_text(moved.certificate)).names)
    assert own_certificate(NAMES, NOW, tmp_path).why_new == ""


@pytest.mark.parametrize("spoil", ["key", "certificate", "mode", "pair"])
def test_one_that_cannot_be_used_is_made_anew(tmp_path, spoil):
    first = own_certificate(NAMES, NOW, tmp_path)
    if spoil == "mode":
        first.key.chmod(0o644)
    elif spoil == "pair":
        other = own_certificate(NAMES, NOW, tmp_path / "other")
        first.key.write_bytes(other.key.read_bytes())
    else:
        getattr(first, spoil).write_text("nothing")
    again = own_certificate(NAMES, NOW, tmp_path)
    assert again.fingerprint != first.fingerprint
    assert os.stat(again.key).st_mode & 0o777 == 0o600


def test_without_a_program_that_makes_one_it_says_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "cryptography", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ConfigurationError, match="apt install openssl") as raised:
        own_certificate(NAMES, NOW, tmp_path / "state")
    assert "no program openssl" in str(raised.value)


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "state").write_text("a file")
    with pytest.raises(ConfigurationError, match="can be kept in"):
        own_certificate(NAMES, NOW, tmp_path / "state")


# -- options --------------------------------------------------------------------------------------


def test_loopback_needs_none_and_elsewhere_one_is_made(tmp_path, monkeypatch):
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    here = ConsoleOptions()
    assert here.with_certificate() == (here, None)
    assert here.endpoint(8443, "http") == "http://127.0.0.1:8443"
    there = ConsoleOptions(host="0.0.0.0")
    assert there.encrypted
    made, own = there.with_certificate()
    assert (made.certificate, made.key) == (str(own.certificate), str(own.key))
    assert tmp_path in own.certificate.parents
    assert set(own_names()) <= set(read_certificate(read_text(own.certificate)).names)


def test_a_given_one_is_used_and_plaintext_has_none():
    given = ConsoleOptions(host="0.0.0.0", certificate="cert.pem", key="key.pem")
    assert given.with_certificate() == (given, None)
    plain = ConsoleOptions(host="0.0.0.0", plaintext=True)
    assert plain.with_certificate() == (plain, None)
    assert not plain.encrypted
    with pytest.raises(OptionError, match="key"):
        ConsoleOptions(host="0.0.0.0", certificate="cert.pem")


# -- addresses ------------------------------------------------------------------------------------


def test_the_address_has_its_token_where_browsers_do_not_send_it():
    assert page_address("https", "fd00::1", 8443, "abc") == "https://[fd00::1]:8443/#t=abc"
    assert page_address("http", "localhost", 80, "") == "http://localhost:80/"


def test_all_addresses_are_reached_by_one_of_them():
    assert reachable_host("192.168.1.10") == "192.168.1.10"
    assert reachable_host("robot.local") == "robot.local"
    assert reachable_host("0.0.0.0") in [*own_addresses(), *own_names()]


def test_own_addresses_are_for_others():
    assert not any(each.startswith(("127.", "fe80:", "::1")) for each in own_addresses())
    assert {"localhost", "127.0.0.1", "::1"} <= set(own_names())


def test_a_computer_without_a_network_has_its_name(monkeypatch):
    for source in ("_way_out", "_of_interfaces", "_of_inet6"):
        monkeypatch.setattr(address, source, lambda: iter(()))
    monkeypatch.setattr(address.socket, "gethostname", lambda: "Robot")
    assert reachable_host("0.0.0.0") == "robot"
    assert own_names() == ["robot", "robot.local", "localhost", "127.0.0.1", "::1"]


def test_a_picture_of_the_address():
    pytest.importorskip("segno", reason="pip install cardan[console]")
    assert picture("https://192.168.1.10:8443/#t=abc").count("\n") > 10


def test_without_segno_it_says_how_to_get_one(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "segno", None)
    assert 'pip install "cardan[console]"' in picture("https://192.168.1.10:8443/#t=abc")


def test_makers_are_tried_in_turn(tmp_path):
    def fails(_names, _now):
        raise ImportError("not here")

    own = own_certificate(NAMES, NOW, tmp_path, [fails, certificate.by_openssl])
    assert own.certificate.exists()
