"""A killed demo leaves no process and no folder behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from pathlib import Path

import pytest

from cardan.gateway.session.subprocesses import cardan_subprocess
from tests.waiting import TRIES, WITHIN_S

pytestmark = pytest.mark.matrix  # Whole programs: all time limits are generous.

GONE_WITHIN_S = WITHIN_S
MOVING, STOPPED = b"moving", b"stopped before"
MARK = "CARDAN_TEST_MARK"
ENDS_WITH_PARENT = (sys.executable, "-m", "cardan.gateway.session.parent_death")


def marked(mark):
    """Processes with `mark` in their environment."""
    found = []
    for process in Path("/proc").iterdir():
        if process.name.isdigit():
            try:
                if f"{MARK}={mark}".encode() in (process / "environ").read_bytes():
                    found.append(int(process.name))
            except OSError:
                continue
    return found


def until(condition):
    """Wait for a condition to hold repeatedly, because a process has no environment for a moment
    during exec; return false after a time limit."""
    give_up_s = time.monotonic() + GONE_WITHIN_S
    in_a_row = 0
    while in_a_row < 10 and time.monotonic() < give_up_s:
        in_a_row = in_a_row + 1 if condition() else 0
        time.sleep(0.02)
    return in_a_row == 10


@pytest.fixture
def mark():
    made = uuid.uuid4().hex
    yield made
    for process in marked(made):
        os.kill(process, signal.SIGKILL)


@pytest.fixture
def folder():
    """Folder with a short path, because socket paths have at most 107 bytes."""
    with tempfile.TemporaryDirectory() as made:
        yield Path(made)


@pytest.mark.real("gofa-0-KILL")
@pytest.mark.parametrize(
    ("name", "early", "number"),
    [
        *((name, early, "KILL") for name in ("gofa", "omni", "omni-sphere") for early in (0, 1)),
        ("gofa", 0, "QUIT"),
    ],
)
def test_a_killed_demo_takes_everything_with_it(name, early, number, mark, folder, tmp_path):
    # If a pause of the computer ends a demo before it moves, another demo follows.
    assert any(killed(name, early, number, mark, folder, tmp_path) for _ in range(TRIES))


def killed(name, early, number, mark, folder, tmp_path):
    """Kill a demo, check that it leaves nothing, and return whether it was killed at the intended
    moment."""
    environment = {**os.environ, MARK: mark, "TMPDIR": str(folder)}
    with subprocess.Popen(
        [sys.executable, "-m", "cardan", "demo", name, "--seconds", "60"],
        env=environment,
        cwd=tmp_path,  # for a core dump, if one is written
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as demo:
        if early:
            while len(marked(mark)) < 2:
                assert demo.poll() is None
        else:
            while not any(each in (line := demo.stdout.readline()) for each in (MOVING, STOPPED)):
                assert line, "the demo has ended"
            assert len(marked(mark)) > 2
        demo.send_signal(signal.Signals[f"SIG{number}"])
    assert until(lambda: not marked(mark))
    assert os.listdir(folder) == []
    return early or MOVING in line


def test_a_command_whose_launcher_is_gone_already_ends(tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    done = subprocess.run(
        [*ENDS_WITH_PARENT, str(folder), "sim", "spacemouse", "--hid", "s"],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=GONE_WITHIN_S,
    )
    assert done.returncode in (0, 128 + signal.SIGTERM)
    assert not folder.exists()


def test_a_launcher_that_ends_it_keeps_its_folder(tmp_path):
    with cardan_subprocess("sim", "spacemouse", "--hid", "s", folder=tmp_path):
        assert (tmp_path / "s").exists()
    assert os.listdir(tmp_path) == []
