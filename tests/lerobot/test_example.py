"""Example of cardan-learning's README.md, run by LeRobot if installed, else by records; and the
message if LeRobot cannot be installed."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.lerobot import interface

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "lerobot" / "three_episodes.py"


@pytest.mark.matrix
def test_the_example_records_and_loads(tmp_path):
    folder = tmp_path / "out"
    done = subprocess.run(
        [sys.executable, EXAMPLE, folder, "--episodes", "1", "--seconds", "6"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    by = "LeRobot" if interface.is_installed() else "Cardan"
    assert f"{folder / 'dataset'}, recorded by {by} and loaded again:" in done.stdout
    (frames,) = re.findall(r"episode 0: (\d+) frames; the TCP went \d+ mm up", done.stdout)
    info = json.loads((folder / "dataset/meta/info.json").read_text())
    assert (info["total_episodes"], info["total_frames"]) == (1, int(frames))
    assert info["features"]["observation.state"]["names"][6:9] == ["ee.x", "ee.y", "ee.z"]


def test_a_python_without_lerobot_is_said_aloud(tmp_path):
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nexit 1\n")
    python.chmod(0o755)
    done = subprocess.run(
        [ROOT / "tools/lerobot", python], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0
    assert f"SKIPPED: {python} is none that LeRobot" in done.stdout
    assert "nothing was tested against LeRobot" in done.stdout
