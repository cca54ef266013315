import sys
from pathlib import Path

import pytest

from cardan import cli
from cardan.drivers import registry
from tests.released import made_once


@pytest.fixture
def fake_drivers(monkeypatch):
    """Make the drivers of fakes.py loadable by name."""
    for name, target in (("fake_device", "FakeDevice"), ("fake_robot", "FakeRobot")):
        monkeypatch.setitem(registry.BUILT_IN, name, f"tests.gateway.fakes:{target}")


@pytest.fixture
def cardan(monkeypatch, capsys):
    """Run the command in this process; return its output."""

    def run(*words, code=0):
        monkeypatch.setattr(sys, "argv", ["cardan", *map(str, words)])
        monkeypatch.setenv("COLUMNS", "200")
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        assert (ended.value.code or 0) == code, said
        return said.out if code == 0 else said.err

    return run


@pytest.fixture(scope="session")
def released(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder that ``make dist`` fills, once for all workers of a run."""
    base = tmp_path_factory.getbasetemp()
    return made_once(base.parent if base.name.startswith("popen-") else base)


@pytest.fixture(scope="session")
def wheel(released: Path) -> Path:
    (file,) = released.glob("*.whl")
    return file


@pytest.fixture(scope="session")
def sdist(released: Path) -> Path:
    (file,) = released.glob("*.tar.gz")
    return file
