"""Released files of ``make dist``, and commands run outside of the checkout."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

UNREACHABLE = "Could not find a version that satisfies"
"""pip's message if there is no package registry."""


def clean_environment() -> dict[str, str]:
    """Return environment variables that lead to nothing in the checkout."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    return {**own, "NO_COLOR": "1", "COLUMNS": "200"}


def run(
    *words: object,
    codes: tuple[int, ...] = (0,),
    folder: Path | None = None,
    environment: Mapping[str, str] | None = None,
    longest_s: float | None = None,
) -> str:
    """Return the output of a command run outside of the checkout; it must exit with one of
    `codes`."""
    done = subprocess.run(
        [str(word) for word in words],
        cwd=folder,
        env=clean_environment() if environment is None else environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=longest_s,
        check=False,
    )
    said = done.stdout + done.stderr
    if done.returncode not in codes and UNREACHABLE in said:
        pytest.skip("no package registry is reached, and nothing is installed without one")
    assert done.returncode in codes, f"{words}: {done.returncode}\n{said}"
    return said


def made_once(base: Path) -> Path:
    """Return the folder in `base` that ``make dist`` fills; of several processes the first one
    makes it, and the others wait."""
    if shutil.which(os.environ.get("CC", "cc")) is None:
        pytest.skip("there is no C compiler")
    folder = base / "dist"
    with (base / "dist.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            begun = base / "dist.begun"
            run(ROOT / "tools/dist", sys.executable, begun)
            begun.rename(folder)
    return folder
