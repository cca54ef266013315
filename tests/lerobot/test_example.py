"""The example of docs/lerobot.md: by LeRobot where it is installed, else by records."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.lerobot import interface

EXAMPLE = Path(__file__).parents[2] / "examples" / "lerobot" / "three_episodes.py"


@pytest.mark.once
@pytest.mark.realtime
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
