import pytest

from cardan.drivers import registry


@pytest.fixture
def fake_drivers(monkeypatch):
    """Make the drivers of fakes.py loadable by name."""
    for name, target in (("fake_device", "FakeDevice"), ("fake_robot", "FakeRobot")):
        monkeypatch.setitem(registry.BUILT_IN, name, f"tests.gateway.fakes:{target}")
