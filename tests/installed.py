"""Third-party packages that look installed: the targets of their entry points are found."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

LARGE_S = 50.0
"""Longer than any command of a test takes."""


def add_metadata(site: Path, name: str, entry_points: Mapping[str, Mapping[str, str]]) -> None:
    """Write a package's pip metadata in `site`: its name, and its entry points by group."""
    folder = site / f"{name.replace('-', '_')}-1.0.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = []
    for group, targets in entry_points.items():
        lines += [f"[{group}]", *(f"{each} = {target}" for each, target in targets.items())]
    (folder / "entry_points.txt").write_text("\n".join(lines) + "\n")


def environment(*sites: Path) -> dict[str, str]:
    """Return the environment of a process in which the packages in `sites` are installed."""
    path = os.pathsep.join(filter(None, [*map(str, sites), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path, "COLUMNS": "200", "NO_COLOR": "1"}


def cardan(*words: str, sites: tuple[Path, ...]) -> tuple[int, str]:
    """Run ``cardan WORDS`` with `sites`; return its exit code and output."""
    done = subprocess.run(
        [sys.executable, "-m", "cardan", *words],
        capture_output=True,
        text=True,
        timeout=LARGE_S,
        env=environment(*sites),
        check=False,
    )
    return done.returncode, done.stdout + done.stderr
