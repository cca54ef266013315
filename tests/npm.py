"""JavaScript packages for interoperability tests, installed by npm once per user."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

INSTALL_TIMEOUT_S = 45.0


def installed(name: str, version: str) -> Path:
    """Return the folder in which node finds the package; skip if it cannot be installed."""
    if not shutil.which("node") or not shutil.which("npm"):
        pytest.skip("node and npm are not installed (Debian: nodejs, npm)")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = cache / "cardan-tests" / f"{name}-{version}"
    package = folder / "node_modules" / name / "package.json"
    if not package.exists():
        folder.mkdir(parents=True, exist_ok=True)
        command = ["npm", "install", "--prefix", str(folder), "--no-audit", "--no-fund"]
        try:
            result = subprocess.run(
                [*command, "--ignore-scripts", f"{name}@{version}"],
                capture_output=True,
                text=True,
                timeout=INSTALL_TIMEOUT_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            pytest.skip(f"npm could not install {name} in {INSTALL_TIMEOUT_S:.0f} s")
        if result.returncode != 0 or not package.exists():
            pytest.skip(f"npm could not install {name} {version}: {result.stderr.strip()[-200:]}")
    assert json.loads(package.read_text())["version"] == version
    return folder
