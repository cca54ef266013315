"""The daemon, as the doctor sees it."""

from pathlib import Path

from cardan.doctor import daemon
from cardan.doctor.base import Subject
from cardan.doctor.daemon import Running, judge_absent, judge_units
from cardan.gateway.daemon.service import Service
from tests.doctor.told import told


def row(name, state, reason="", kind="session"):
    return {"name": name, "kind": kind, "state": state, "reason": reason}


def test_units():
    rows = [
        row("gofa", "running"),
        row("gp8", "failed", "given up after 8 starts in a row: it died"),
        row("ur5", "waiting", "the port is taken"),
        row("web", "stopped", "stopped by hand", "face"),
    ]
    found = list(judge_units(rows))
    assert told(Running, found) == [
        ("good", "unit"),
        ("failure", "unit-failed"),
        ("caution", "unit-waiting"),
        ("good", "unit"),
    ]
    assert found[1].what == "session gp8 has failed: given up after 8 starts in a row: it died"
    assert found[1].mend == "cardan daemon log gp8, then: cardan daemon restart gp8"


def test_no_daemon():
    service = Service(Path("/etc/systemd/system/cardan.service"), "", False)
    assert told(Running, judge_absent("no daemon runs here (x)", [])) == [("good", "daemon")]
    silent = judge_absent("the daemon at x does not answer: Permission denied", [])
    assert told(Running, silent) == [("failure", "daemon")]
    installed = judge_absent("no daemon runs here (x)", [service])
    assert told(Running, installed) == [("failure", "service")]
    assert installed.mend == "systemctl status cardan, then: systemctl restart cardan"


def test_where_none_runs(tmp_path, monkeypatch):
    none = Service(tmp_path / "none", "", True)
    monkeypatch.setattr(daemon, "installed", lambda system: none)
    found = Running.look(Subject(socket=str(tmp_path / "cardan.sock")))
    assert told(Running, found) == [("good", "daemon")]
