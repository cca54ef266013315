"""Real ROS 2 of a distribution, as `tools/ros2` installs it away from our environment."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.judge_node import JudgeNode

ROOT = Path(__file__).parents[2]
DISTRIBUTIONS = ("jazzy", "kilted")
NODE = Path(__file__).with_name("rclpy_node.py")
KEPT = ("HOME", "PATH", "LANG", "TMPDIR")


def python_of(environment: str) -> Path:
    """The Python of a judge; skips where it cannot be had."""
    made = ROOT / "build" / "ros2" / environment
    lock = ROOT / "locks" / "ros2" / f"{environment}.txt"
    if not (made / ".ready").exists() or (made / ".ready").read_bytes() != lock.read_bytes():
        found = subprocess.run(
            [ROOT / "tools" / "find-python", "3.12"], stdout=subprocess.DEVNULL, check=False
        )
        if found.returncode:
            pytest.skip("no Python 3.12 on this machine, which ROS 2's wheels are for")
        pytest.skip(f"ROS 2 {environment} is not installed: tools/ros2 {environment}")
    return made / "bin" / "python"


def own_environment(folder: Path, **more: str) -> dict[str, str]:
    """Variables for it: nothing of ours reaches it, nor what it sets for itself us."""
    kept = {name: os.environ[name] for name in KEPT if name in os.environ}
    return {**kept, "ROS_HOME": str(folder), "PYTHONDONTWRITEBYTECODE": "", **more}


class RclpyNode(JudgeNode):
    """A node of rclpy, over its default middleware."""

    def __init__(self, distribution: str, domain: int, folder: Path, name: str = "judge") -> None:
        env = own_environment(
            folder, ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST"
        )
        super().__init__([python_of(distribution), NODE, name], env)

    def do(self, what: str, **how: Any) -> None:
        """Have it carry out a command of rclpy_node.py."""
        self.say(json.dumps({"do": what, **how}))

    def newest(self, topic: str) -> Any:
        """The newest message of a topic, or None."""
        found = self.found("sample", topic=topic)
        return found[-1]["message"] if found else None
