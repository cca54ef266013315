"""Every command on every page: it exists, and a test runs it."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.core import TyperGroup

from tests.command_line import the_command_line
from tests.docs_commands import AT_ONCE, BY_HAND, PEER, ROOT, RUN, commands
from tests.serving import free_tcp_port, free_udp_port

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

COMMANDS = commands()
OURS = [each for each in COMMANDS if re.match(r"(sudo )?cardan ", each.line)]
LINES = [each.line for each in COMMANDS]


def by(tables, line):
    """Return the patterns of the tables that match a command."""
    return [pattern for pattern in tables if re.match(pattern, line)]


def plugged_in(line):
    """Return commands of the template packages, which other tests install."""
    return re.search(r"\blever\b", line)


def ran_here(line):
    return (AT_ONCE.match(line) or PEER.match(line)) and not plugged_in(line)


def of_a_tutorial(line):
    """Return whether it checks a file on its own page: tests/test_tutorials.py."""
    return line.startswith("cardan check ") and not re.search(r"check (my-robot|session)", line)


# -- the ledger --------------------------------------------------------------------------------


@pytest.mark.parametrize("command", COMMANDS, ids=lambda each: each.line[:60])
def test_every_command_is_run_by_a_test_or_says_why_not(command):
    assert ran_here(command.line) or by(RUN, command.line) or by(BY_HAND, command.line), (
        f"{command.page}: {command.line}: which test runs it? tests/docs_commands.py"
    )


def test_what_the_ledger_has_is_on_a_page():
    assert [each for each in (*RUN, *BY_HAND) if not any(re.match(each, a) for a in LINES)] == []


@pytest.mark.parametrize("test", sorted(set(RUN.values())))
def test_what_the_ledger_names_is_there(test):
    path, _, name = test.partition("::")
    assert (ROOT / path).exists()
    assert not name or re.search(rf"^def {name}\b", (ROOT / path).read_text("utf-8"), re.MULTILINE)


# -- commands of Cardan ------------------------------------------------------------------------


@pytest.mark.parametrize("command", OURS, ids=lambda each: each.line[:60])
def test_the_command_line_takes_it(command):
    """Names, options and values, as far as these can be checked without running it."""
    if plugged_in(command.line):
        return
    words = shlex.split(command.line.removeprefix("sudo ").partition(" | ")[0])[1:]
    found, names = the_command_line(), ["cardan"]
    while isinstance(found, TyperGroup):
        if not words or words[0].startswith("-"):
            break
        names.append(words.pop(0))
        found = found.get_command(None, names[-1])
    if words == ["--install-completion"]:
        return
    with found.make_context(names[-1], words):
        pass


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Return a folder with the files that commands name."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    for name in ("my-robot.toml", "session.toml"):
        shutil.copy(ROOT / "examples" / "spacemouse-gofa.toml", tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(line, capsys):
    """Run the command; return its output."""
    with contextlib.suppress(SystemExit):
        assert the_command_line()(shlex.split(line)[1:], standalone_mode=False) in (None, 0), line
    return capsys.readouterr().out


@pytest.mark.parametrize(
    "line",
    [each for each in LINES if AT_ONCE.match(each) and ran_here(each) and not of_a_tutorial(each)],
)
def test_a_command_that_is_done_at_once(line, here, capsys):
    assert run(line, capsys)


@pytest.mark.matrix
@pytest.mark.parametrize("line", [each for each in LINES if PEER.match(each) and ran_here(each)])
def test_a_simulated_peer_serves(line, here, capsys, monkeypatch):
    """On free ports, in this folder, and without real-time scheduling."""
    monkeypatch.setattr(os, "sched_setscheduler", lambda *_: None)
    line = re.sub(r"--to 127\.0\.0\.1:\d+", f"--to 127.0.0.1:{free_udp_port()}", line)
    line = re.sub(r"--port \d+", f"--port {free_tcp_port()}", line)
    line = re.sub(r"(--listen 127\.0\.0\.1:)\d+", lambda m: f"{m[1]}{free_tcp_port()}", line)
    line = line.replace("/run/user/1000/", f"{here}/")
    assert "READY" in run(f"{line} --seconds 0.3", capsys)


# -- others ------------------------------------------------------------------------------------


@pytest.mark.parametrize("line", [each for each in LINES if each.startswith("make")])
def test_make_knows_what_to_do(line, tmp_path):
    words = shlex.split(line)
    done = subprocess.run(
        [words[0], "--dry-run", f"VENV={tmp_path / 'venv'}", *words[1:]],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("line", [each for each in LINES if each.startswith("pip install")])
def test_what_pip_installs_is_there(line):
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"][
        "optional-dependencies"
    ]
    for named in re.findall(r"\[([\w,]+)\]", line):
        assert set(named.split(",")) <= set(extras)


NAMES_FILES = re.compile(r"(sudo )?(python \w+/|cp |tools/|cardan run (ex|plugins/))")
FOLDER = re.compile(r"(examples|plugins|tools|tests)/")


@pytest.mark.parametrize("line", [each for each in LINES if NAMES_FILES.match(each)])
def test_the_files_that_a_command_names_are_there(line):
    named = [word for word in shlex.split(line) if FOLDER.match(word)]
    assert named
    assert [word for word in named if not Path(ROOT, word).exists()] == []
