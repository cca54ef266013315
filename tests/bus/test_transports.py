"""Nodes on other transports than Zenoh come from plug-ins; a missing plug-in is reported."""

import pytest

from cardan.bus import transports
from cardan.drivers.ros2_arm import Ros2Arm
from cardan.errors import ConfigurationError
from cardan.sim_peers.ros2_arm import RosArmOptions, RosArmPeer

WORDS = "transport: 'dds' is in the folder plugins/cardan-dds .*: run `pip install ./plugins"


@pytest.fixture
def bare(monkeypatch):
    """Hide all installed plug-ins."""
    monkeypatch.setattr(transports.FINDER, "_installed", list)


@pytest.mark.usefixtures("bare")
def test_a_driver_and_a_peer_say_what_to_install():
    with pytest.raises(ConfigurationError, match=WORDS):
        Ros2Arm(transport="dds").open()
    with pytest.raises(ConfigurationError, match=WORDS):
        RosArmPeer(RosArmOptions(transport="dds")).open()


@pytest.mark.usefixtures("bare")
def test_one_that_nobody_has():
    with pytest.raises(ConfigurationError, match="there is no transport 'pigeon'"):
        transports.load("pigeon")
    assert transports.load_all().classes == {}
