"""Dependencies of the studies: their imports of the package, and their requirements at import."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from studies import command
from tests.test_architecture import (
    ARM_LIBRARIES,
    LEAVES,
    assert_no_circles,
    imported,
    said_without_an_arms_model,
)

pytestmark = pytest.mark.matrix

STUDIES = Path(__file__).parents[1]
MODULES = sorted(path for path in STUDIES.rglob("*.py") if STUDIES / "tests" not in path.parents)
MAY_IMPORT = {"demos", "gateway", "drivers", "bus", "protocols", "sim_peers", *LEAVES}
ARM_MODEL = (
    "studies.cartesian.",
    "studies.devices.",
    "studies.haptics.",
    "studies.metrics",
    "studies.motoros.",
    "studies.plotting",
    "studies.thesis.",
)
"""Modules that need the extra cardan[arm]; all others are imported without it."""


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(STUDIES)))
def test_they_import_what_is_below_the_command_line(path):
    allowed = {*MAY_IMPORT, "cli"} if path.stem == "command" else MAY_IMPORT
    for name in imported(path):
        parts = name.split(".")
        assert parts[0] not in ("bench", "tests"), name
        assert parts[0] not in ARM_LIBRARIES, name
        assert parts[0] != "cardan" or len(parts) == 1 or parts[1] in allowed, name


def test_no_import_circles():
    assert_no_circles(MODULES)


def test_only_what_needs_an_arms_model_needs_the_extra():
    said = said_without_an_arms_model(MODULES)
    assert [name for name in said if not name.startswith(ARM_MODEL)] == []
    assert said["studies.thesis.bench"].endswith('pip install "cardan[arm]"')


def test_make_installs_the_command():
    (point,) = entry_points(group="cardan.commands", name="evaluate")
    assert point.load() is command.evaluate


def test_it_is_installed_from_its_folder_alone(tmp_path):
    """Install with `pip install ./studies`, without the source tree and the tests."""
    pip = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
    install = ("install", "--no-deps", "--no-build-isolation", "--target", tmp_path, STUDIES)
    subprocess.run([*pip, *install], check=True, timeout=55)
    there = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("studies/**/*.[pc]*")}
    here = {str(path.relative_to(STUDIES.parent)) for path in MODULES}
    there = {name for name in there if not name.endswith(".pyc") and "__pycache__" not in name}
    assert there == {*here, "studies/haptics/probe.c"}
    program = (
        "import json, sys; from importlib.metadata import entry_points;"
        "(point,) = {*entry_points(group='cardan.commands', name='evaluate')};"
        "point.load(); print(json.dumps(sys.modules[point.module].__file__))"
    )
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert Path(json.loads(done.stdout)).is_relative_to(tmp_path)
