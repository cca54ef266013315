"""``cardan doctor`` for users and for programs."""

import json
import signal
import socket

import pytest

from cardan.doctor.base import Subject
from cardan.doctor.ports import bound_sockets
from tests import installed
from tests.programs import Program, until
from tests.test_cli import cardan

pytestmark = pytest.mark.matrix

ROBOT = '[robot]\ndriver = "abb_egm"\nlisten_port = {port}\n'

CHECK = '''
from cardan.doctor.base import Check, failure


class Lever(Check):
    """The lever."""

    group, tells = "lever", ("stuck",)

    @classmethod
    def look(cls, subject):
        yield failure("stuck", f"stuck in {list(subject.sessions)}", "it \\x1b[31m jams", "oil it")


class Broken(Check):
    """Broken."""

    @classmethod
    def look(cls, subject):
        raise RuntimeError("out of order")
'''


@pytest.fixture
def taken(tmp_path):
    """Return a file whose port another program uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        file = tmp_path / "gofa.toml"
        file.write_text(ROBOT.format(port=other.getsockname()[1]))
        yield file


def doctor(file, *words, code=4):
    return cardan("doctor", file, "--socket", file.parent / "none.sock", *words, code=code)


def test_what_fails_stands_with_why_and_the_command_that_mends_it(taken):
    lines = doctor(taken).splitlines()
    at = next(number for number, line in enumerate(lines) if "[port]" in line)
    assert lines[at].startswith("  ✗ UDP port ")
    assert lines[at + 1].startswith("      why   ")
    assert lines[at + 2].startswith("      mend  kill ")
    groups = [line for line in lines if not line.startswith(" ")][:-1]
    assert groups == list(dict.fromkeys(groups))
    assert {"installation", "system", "devices", "files", "ports", "daemon"} <= {*groups}
    assert lines[-1].endswith("docs/troubleshooting.md explains each")


@pytest.mark.real
def test_for_programs(taken):
    reported = json.loads(doctor(taken, "--json"))
    assert reported["level"] == "failure"
    (port,) = (each for each in reported["findings"] if each["code"] == "port")
    assert port["level"] == "failure"
    assert port["mend"].startswith("kill ")


def test_for_an_issue(taken):
    text = doctor(taken, "--report")
    assert text.startswith("```\ncardan ")
    assert "FAILURE [port] UDP port " in text
    assert "why" not in text


def test_a_file_that_is_wrong(tmp_path):
    file = tmp_path / "wrong.toml"
    file.write_text(ROBOT.format(port='"x"'))
    assert "[file, S004]" in doctor(file)


def test_one_form_at_a_time(tmp_path):
    assert "give one of them" in doctor(tmp_path / "none.toml", "--json", "--report", code=2)


def test_without_files_and_with_plain_characters(tmp_path, monkeypatch):
    monkeypatch.setitem(installed.os.environ, "PYTHONIOENCODING", "ascii")
    code, text = installed.cardan("doctor", "--socket", str(tmp_path / "none"), sites=())
    assert code in (0, 4), text
    assert "  + extras: " in text


def test_what_the_daemon_runs_is_known(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    own, file = f"{tmp_path}/cardan.sock", tmp_path / "lab.toml"
    file.write_text(
        f'[daemon]\nsocket = "{own}"\nevent_log = "none"\n[[sessions]]\nname = "gofa"\n'
        f'robot = {{ driver = "abb_egm", listen_port = {port} }}\n'
    )
    with Program("daemon", "run", file) as program:
        program.wait_for("READY ")
        bound = ("udp", "127.0.0.1", port)
        until(lambda: bound in {each[:3] for each in bound_sockets(Subject())}, "its port")
        text = cardan("doctor", file, "--socket", own)
        assert program.end(signal.SIGTERM) == 0
    assert f"✓ UDP port {port} of robot of gofa: Cardan has it already, " in text
    assert f"✓ UDP port {port} of robot of gofa is in use: not checked" in text
    assert f"✓ the daemon at {own} runs" in text
    assert "✓ session gofa is running" in text


def test_checks_of_other_packages(tmp_path):
    site, file = tmp_path / "site", tmp_path / "gofa.toml"
    site.mkdir()
    (site / "lever.py").write_text(CHECK)
    checks = {"lever": "lever:Lever", "broken": "lever:Broken", "absent": "nowhere:Check"}
    installed.add_metadata(site, "cardan-lever", {"cardan.checks": checks})
    file.write_text(ROBOT.format(port=0))
    words = ("doctor", str(file), "--socket", str(tmp_path / "none"))
    code, text = installed.cardan(*words, sites=(site,))
    assert code == 4, text
    assert "lever\n  ✗ stuck in ['gofa']  [stuck]\n      why   it \\x1b[31m jams\n" in text
    assert "the check 'broken' itself failed: RuntimeError: out of order  [check]" in text
    assert "check 'absent' cannot be loaded: ModuleNotFoundError" in text
