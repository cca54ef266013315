"""The suite of a 3Dconnexion device that speaks HID."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.connexion.decoded import ConnexionTraffic
from cardan.conform.connexion.requirements import requires
from cardan.conform.connexion.scenario import ConnexionScenario
from cardan.conform.suite import Suite, SuiteTransport
from cardan.conform.transports import DeviceFile, Wires


class ConnexionSuite(Suite[ConnexionTraffic]):
    """A 3Dconnexion device such as a SpaceMouse, report by report."""

    name = "3dconnexion"
    judges = "the device"
    speaks = "HID reports, 125 or 62.5 a second"
    target = "/dev/hidrawN of the device, which `cardan devices` names"
    peer = "spacemouse"
    requirements = requires.all()
    transport = SuiteTransport("other")
    dissector = "connexion"
    decode = ConnexionTraffic
    scenario = ConnexionScenario
    simulation = "cardan.conform.connexion.simulated:ConnexionSimulation"
    seconds = 1.2
    # Times, s, before the first release of the cap; the silence does not end.
    fault_test_values: ClassVar[Mapping[str, float]] = {
        "silence": 0.9,
        "unplug": 1.0,
        "replug": 1.5,
    }
    undetectable_faults: ClassVar[Mapping[str, str]] = {
        "newest-lost": "the queue is the host's, and only a host that does not read sees which "
        "of its reports are lost",
    }

    def wires(self, target: str) -> Wires:
        return DeviceFile(target)
