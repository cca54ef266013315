"""Findings about the daemon."""

from pathlib import Path

import pytest

from cardan.doctor import daemon
from cardan.doctor.base import Subject
from cardan.doctor.daemon import Running, check_absent, check_units
from cardan.gateway.daemon.service import SystemdUnit, make_service
from tests.doctor.levels_and_codes import levels_and_codes


def row(name, state, reason="", kind="session"):
    return {"name": name, "kind": kind, "state": state, "reason": reason}


def test_units():
    rows = [
        row("gofa", "running"),
        row("gp8", "failed", "given up after 8 starts in a row: it died"),
        row("ur5", "waiting", "the port is taken"),
        row("web", "stopped", "stopped by hand", "server"),
    ]
    found = list(check_units(rows))
    assert levels_and_codes(Running, found) == [
        ("good", "unit"),
        ("failure", "unit-failed"),
        ("caution", "unit-waiting"),
        ("good", "unit"),
    ]
    assert found[1].what == "session gp8 has failed: given up after 8 starts in a row: it died"
    assert found[1].mend == "cardan daemon log gp8, then: cardan daemon restart gp8"


def test_no_daemon():
    service = SystemdUnit(Path("/etc/systemd/system/cardan.service"), "", False)
    assert levels_and_codes(Running, check_absent("no daemon runs here (x)", [])) == [
        ("good", "daemon")
    ]
    silent = check_absent("the daemon at x does not answer: Permission denied", [])
    assert levels_and_codes(Running, silent) == [("failure", "daemon")]
    installed = check_absent("no daemon runs here (x)", [service])
    assert levels_and_codes(Running, installed) == [("failure", "service")]
    assert installed.mend == "systemctl status cardan, then: systemctl restart cardan"


def test_where_none_runs(tmp_path, monkeypatch):
    none = SystemdUnit(tmp_path / "none", "", True)
    monkeypatch.setattr(daemon, "installed", lambda system: none)
    found = Running.look(Subject(socket=str(tmp_path / "cardan.sock")))
    assert levels_and_codes(Running, found) == [("good", "daemon")]


@pytest.mark.parametrize(
    "start",
    ["python -m cardan serve /etc/cardan", "/usr/bin/cardan  serve", "/bin/cardan -v serve a.toml"],
)
def test_a_unit_of_before_the_command_had_its_name(start, tmp_path, monkeypatch):
    units = [SystemdUnit(tmp_path / name, "", name == "mine") for name in ("mine", "system")]
    monkeypatch.setattr(daemon, "installed", lambda system: units[system])
    subject = Subject(socket=str(tmp_path / "cardan.sock"))
    for unit in units:
        unit.path.write_text(f"ExecStart={start}\n")
    found = list(Running.look(subject))
    outdated = [("failure", "service-outdated")] * 2
    assert levels_and_codes(Running, found) == [*outdated, ("failure", "service")]
    assert found[0].mend.startswith("cardan daemon service install FILE...")
    assert found[1].mend.startswith("sudo cardan daemon service install --system FILE...")
    file = tmp_path / "a.toml"
    file.touch()
    text = make_service([file], system=False, account="x").text
    for unit in units:
        unit.path.write_text(text)
    assert levels_and_codes(Running, Running.look(subject)) == [("failure", "service")]
