from pathlib import Path

import pytest

from cardan.drivers import registry
from tests.released import made_once


@pytest.fixture
def fake_drivers(monkeypatch):
    """Make the drivers of fakes.py loadable by name."""
    for name, target in (("fake_device", "FakeDevice"), ("fake_robot", "FakeRobot")):
        monkeypatch.setitem(registry.BUILT_IN, name, f"tests.gateway.fakes:{target}")


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
