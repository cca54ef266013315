"""A resource that the computer lacks is reported in one line."""

from __future__ import annotations

import errno
import subprocess
import sys
from pathlib import Path

import pytest

from cardan.common.plugins import reason
from cardan.common.resource_errors import run, shortage

EXAMPLES = Path(__file__).parents[1] / "examples"
UNMAPPED = "libx.so: failed to map segment from shared object"


def caused(cause):
    error = ValueError("what it led to")
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError(), "too little memory"),
        (SystemError("error return without exception set"), "too little memory"),
        (ImportError(UNMAPPED), "too little memory"),
        (OSError(errno.ENOMEM, "no"), "too little memory"),
        (OSError(errno.EMFILE, "no"), "`ulimit -n` shows the limit"),
        (OSError(errno.ENFILE, "no"), "too many files are open"),
        (RuntimeError("can't start new thread"), "no more threads"),
        (caused(MemoryError()), "too little memory"),
    ],
)
def test_what_is_short_is_named(error, words):
    assert words in shortage(error)
    assert reason(error) == shortage(error)


@pytest.mark.parametrize(
    "error",
    [
        None,
        OSError("no number"),
        OSError(errno.ENOENT, "no"),
        BlockingIOError(errno.EAGAIN, "later"),
        ImportError("no module named x"),
        RuntimeError("a mistake"),
        caused(KeyError("x")),
    ],
)
def test_other_errors_are_none(error):
    assert shortage(error) == ""


def test_causes_in_a_circle_end():
    first, second = ValueError(), ValueError()
    first.__cause__, second.__cause__ = second, first
    assert shortage(first) == ""


def test_a_mistake_keeps_its_traceback(monkeypatch):
    monkeypatch.setattr("cardan.cli.main", lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run("cardan.cli")


def test_ctrl_c_during_the_import_is_no_mistake(monkeypatch, tmp_path, capsys):
    (tmp_path / "interrupted.py").write_text("raise KeyboardInterrupt\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(SystemExit) as end:
        run("interrupted")
    assert end.value.code == 130
    assert capsys.readouterr() == ("", "")


@pytest.mark.matrix
@pytest.mark.parametrize("limit", ["-n 8", "-v 40960"])
@pytest.mark.parametrize(
    "words",
    [
        ("run", "--seconds", "1", EXAMPLES / "verbs-ur5-simulated.toml"),
        ("run", "--seconds", "1", EXAMPLES / "spacemouse-gofa-simulated.toml"),
        ("demo", "--seconds", "3"),
    ],
    ids=("run", "run without a model", "demo"),
)
def test_a_command_ends_in_a_line(limit, words):
    done = subprocess.run(
        ["sh", "-c", f'ulimit {limit}; exec "$@"', "sh", sys.executable, "-m", "cardan", *words],
        capture_output=True,
        text=True,
        timeout=60,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 1
    assert done.stderr.startswith(
        ("cardan: there is too little memory", "cardan: too many files", "cardan: no more threads")
    )
    assert f"`ulimit {limit.split()[0]}`" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.matrix
@pytest.mark.parametrize("kilobytes", [49152, 61440])
def test_with_a_little_more_memory_a_demo_ends_in_lines(kilobytes):
    """The interpreter determines whether the failure is at a driver's import or at its peers."""
    done = subprocess.run(
        ("sh", "-c", f"ulimit -v {kilobytes}; exec {sys.executable} -m cardan demo --seconds 3"),
        capture_output=True,
        text=True,
        timeout=60,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode in (1, 2, 3)
    assert done.stderr
    assert all(line.startswith("cardan: ") for line in done.stderr.splitlines()), done.stderr
