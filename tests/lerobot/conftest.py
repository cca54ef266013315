"""Fixtures that load the distributions as if installed, with LeRobot or a stand-in for it."""

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.lerobot import interface

PLUGINS = Path(__file__).parents[2] / "plugins"
FOLDERS = sorted(file.parent for file in PLUGINS.glob("lerobot_*/pyproject.toml"))

collect_ignore = [] if interface.is_installed() else ["test_interface.py"]
"""Tests that need LeRobot itself: `make test-lerobot`."""


def forget():
    """Drop the loaded distributions, so that the next import uses another stand-in."""
    for name in [*sys.modules]:
        if name.partition(".")[0] in {folder.name for folder in FOLDERS}:
            del sys.modules[name]


@pytest.fixture
def lerobot(monkeypatch, tmp_path):
    """Provide the modules of LeRobot that the distributions import: its own, or stand-ins."""
    if not interface.is_installed():
        for name, module in interface.stand_ins().items():
            monkeypatch.setitem(sys.modules, name, module)
    return SimpleNamespace(
        robots=importlib.import_module("lerobot.robots"),
        teleoperators=importlib.import_module("lerobot.teleoperators"),
        errors=importlib.import_module("lerobot.utils.errors"),
        events=importlib.import_module("lerobot.teleoperators.utils").TeleopEvents,
        cameras=importlib.import_module("lerobot.cameras"),
        calibration=tmp_path / "calibration",
    )


@pytest.fixture
def plugins(lerobot, monkeypatch):
    """Return the distributions' modules, and LeRobot's."""
    for folder in FOLDERS:
        monkeypatch.syspath_prepend(folder)
    yield SimpleNamespace(
        teleoperator=importlib.import_module("lerobot_teleoperator_cardan"),
        robot=importlib.import_module("lerobot_robot_cardan"),
        lerobot=lerobot,
    )
    if not interface.is_installed():
        forget()
