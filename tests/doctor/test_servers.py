"""Findings about servers: tokens, certificates, names."""

import datetime

import pytest

from cardan.common.certificates import Certificate
from cardan.doctor.base import Subject
from cardan.doctor.files import read_files
from cardan.doctor.servers import ServerAccess, check_access, check_certificate
from tests import certificates
from tests.doctor.levels_and_codes import levels_and_codes

NOW = datetime.datetime(2026, 6, 1, tzinfo=datetime.timezone.utc)
DAY = datetime.timedelta(days=1)
TOKEN = "0123456789abcdef0123456789"


@pytest.mark.parametrize(
    ("begins", "ends", "level", "what"),
    [
        (NOW - DAY, NOW + 90 * DAY, "good", "is valid until 2026-08-30"),
        (NOW - DAY, NOW + 29 * DAY, "caution", "ends in 29 days"),
        (NOW - 9 * DAY, NOW - 3 * DAY, "failure", "ended 3 days ago"),
        (NOW + DAY, NOW + 90 * DAY, "failure", "begins only on 2026-06-02"),
    ],
)
def test_how_long_a_certificate_is_valid(begins, ends, level, what):
    found = list(check_certificate("server a", Certificate(begins, ends, ("lab",)), ["lab"], NOW))
    assert levels_and_codes(ServerAccess, found) == [
        (level, "certificate"),
        ("good", "certificate-name"),
    ]
    assert what in found[0].what


@pytest.mark.parametrize(
    ("names", "own", "level"),
    [
        (("lab",), ["LAB", "lab.local"], "good"),
        (("*.local",), ["lab", "lab.local"], "good"),
        (("*.local",), ["a.b.local"], "caution"),
        (("192.0.2.1",), ["lab", "192.0.2.1"], "good"),
        ((), ["lab"], "caution"),
        (("other",), ["lab"], "caution"),
    ],
)
def test_the_names_of_a_certificate(names, own, level):
    certificate = Certificate(NOW - DAY, NOW + 90 * DAY, names)
    found = list(check_certificate("server a", certificate, own, NOW))
    assert levels_and_codes(ServerAccess, found) == [
        ("good", "certificate"),
        (level, "certificate-name"),
    ]


def look(tmp_path, text, now=None):
    file = tmp_path / "lab.toml"
    file.write_text(f"[servers.rosbridge]\n{text}\n[servers.router]\n")
    config, wrong = read_files([file])
    assert not wrong
    if now is None:
        found = list(ServerAccess.look(Subject((file,), config)))
    else:
        found = list(check_access("rosbridge", config.servers["rosbridge"], "lab", now))
    return levels_and_codes(ServerAccess, found), found


@pytest.fixture
def token(tmp_path):
    path = tmp_path / "token"
    path.write_text(TOKEN)
    path.chmod(0o600)
    return path


def test_a_server_of_this_computer_alone(tmp_path):
    levels, found = look(tmp_path, "")
    assert levels == [("good", "server")]
    assert found[0].what == "server rosbridge listens at 127.0.0.1, with no token"


def test_a_server_in_others_reach_without_tls(tmp_path, token):
    text = f'host = "0.0.0.0"\nplaintext = true\ntoken-file = "{token}"'
    levels, found = look(tmp_path, text)
    assert levels == [("caution", "clear")]
    assert TOKEN not in str(found)


def test_a_console_in_others_reach_makes_its_certificate(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text('[servers.console]\nhost = "0.0.0.0"\n')
    config, wrong = read_files([file])
    assert not wrong
    found = list(ServerAccess.look(Subject((file,), config)))
    assert levels_and_codes(ServerAccess, found) == [("good", "server")]
    assert "tokens that it makes" in found[0].what


@pytest.mark.parametrize(
    ("mode", "text", "words"),
    [
        (0o600, 'host = "0.0.0.0"', "unless there is a certificate"),
        (0o644, 'token-file = "TOKEN"', "can be read or changed by other users"),
        (0o600, 'certificate = "none.pem"\nkey = "none.key"', "none.pem cannot be used"),
        (0o600, 'certificate = "none.pem"', "wss needs both certificate and key"),
    ],
)
def test_a_server_that_cannot_start(tmp_path, token, mode, text, words):
    token.chmod(mode)
    levels, found = look(tmp_path, text.replace("TOKEN", str(token)))
    assert levels == [("failure", "server")]
    assert words in found[0].what


def test_a_server_with_tls(tmp_path, token):
    certificate, key = certificates.make(tmp_path)
    text = f'host = "0.0.0.0"\ntoken-file = "{token}"\ncertificate = "{certificate}"\nkey = "{key}"'
    now = datetime.datetime.now(datetime.timezone.utc)
    fine = [("good", "server"), ("good", "certificate"), ("good", "certificate-name")]
    assert look(tmp_path, text, now)[0] == fine
    assert look(tmp_path, text, now + 366 * DAY)[0][1] == ("failure", "certificate")


def test_underscores_are_written_as_in_files(tmp_path, token):
    levels, found = look(tmp_path, f'token_file = "{token}"')
    assert levels == [("good", "server")]
    assert found[0].what == "server rosbridge listens at 127.0.0.1, with tokens"


def test_a_server_makes_its_tokens_when_it_starts_not_when_it_is_looked_at(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    levels, _ = look(tmp_path, 'host = "0.0.0.0"\nplaintext = true')
    assert levels == [("caution", "clear")]
    assert not (tmp_path / "state").exists()
