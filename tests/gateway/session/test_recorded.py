"""Messages of `cardan run --record` about a recorder that ended early."""

import contextlib
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from cardan import cli
from cardan.gateway.session import recorded as recording, supervisor
from cardan.gateway.session.recorded import why_incomplete
from cardan.gateway.session.snapshot import Snapshot

TEXT = """
[robot]
driver = "sim_arm"
[arm]
model = "ur5"
[network]
"""


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run `cardan run --record` with a session that ends normally and a recorder that exits with
    `code`; return the exit code and the text of standard error."""

    def run(code):
        recorder = SimpleNamespace(code=code, complaints="", lines=())
        outcome = SimpleNamespace(last=Snapshot(), exit_code=0)
        monkeypatch.setattr(
            recording, "recorded", lambda *_: contextlib.nullcontext(recorder), raising=True
        )
        monkeypatch.setattr(supervisor, "supervise", lambda *_, **__: outcome)
        file = tmp_path / "session.toml"
        file.write_text(TEXT)
        words = ["cardan", "run", str(file), "--record", "out.mcap"]
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return ended.value.code or 0, capsys.readouterr().err

    return run


@pytest.mark.parametrize(("code", "name"), [(-9, "SIGKILL"), (-11, "SIGSEGV")])
def test_a_recorder_that_is_killed_makes_4_and_is_reported(run, code, name):
    ended, said = run(code)
    assert ended == 4
    assert f"the recorder was ended by {name}: out.mcap has what came" in said
    assert "`cardan net record --repair out.mcap`" in said


@pytest.mark.parametrize(("code", "expected"), [(0, 0), (4, 4), (1, 4), (143, 4)])
def test_every_other_end_of_it_but_a_good_one_makes_4(run, code, expected):
    ended, said = run(code)
    assert ended == expected
    assert "ended by" not in said


def test_a_signal_without_a_name_is_reported_by_its_number():
    assert "ended by signal 99:" in why_incomplete(SimpleNamespace(code=-99), Path("r.mcap"))
