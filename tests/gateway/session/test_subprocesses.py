"""Output of a launched command before, with and after READY, in pieces of any size."""

import sys

import pytest

from cardan.errors import DriverError
from cardan.gateway.session.subprocesses import CardanSubprocess


@pytest.fixture
def command(tmp_path, monkeypatch):
    """Run a shell script instead of ``cardan``: `command(script)`."""

    def write(script):
        path = tmp_path / "cardan"
        path.write_text(f"#!/bin/sh\n{script}\n")
        path.chmod(0o755)
        monkeypatch.setattr(sys, "executable", str(path))

    return write


@pytest.mark.parametrize(
    "script",
    [
        r"printf 'certificate\nREADY here\nafter\nla'",
        r"printf certi; sleep 0.1; printf 'ficate\nREADY here\nafter\nla'",
    ],
    ids=["at once", "in pieces"],
)
def test_its_lines_are_distinguished_however_they_come(command, script):
    command(f"trap 'printf st; exit 7' TERM; {script}; while :; do sleep 0.05; done")
    command = CardanSubprocess("net", "server", "console", ready_within_s=5.0)
    assert command.endpoint == "here"
    assert command.before == ["certificate"]
    command.end()
    assert command.lines == ("after", "last")
    assert command.code == 7


def test_one_that_ends_before_it_serves_is_an_error_with_its_words(command, capsys):
    command("echo certificate; echo 'no port' >&2; exit 3")
    with pytest.raises(DriverError, match="`cardan net server console` ended before it served"):
        CardanSubprocess("net", "server", "console")
    assert "no port" in capsys.readouterr().err
