"""Registrations of the installed plug-in."""

import pytest

from cardan.conform import registry as suites
from cardan.demos.examples import find_demos
from cardan.drivers import registry as drivers
from cardan.sim_peers import registry as peers
from cardan_serial_mice.driver import SpaceMouseSerial
from cardan_spnav_server import identity_of
from tests import installed


def test_all_of_it_is_found_by_name():
    assert drivers.load("spacemouse_serial") is SpaceMouseSerial
    assert SpaceMouseSerial.peer in peers.names()
    assert {"magellan", "spaceball", "spaceorb"} <= {*suites.names()}
    assert "spacemouse_serial" in find_demos()["spacemouse-serial"].drivers


def test_programs_of_spacenavd_are_reported_what_it_is():
    assert identity_of(SpaceMouseSerial(model="magellan")).device_type == 0x103


@pytest.mark.matrix
def test_the_demo_runs():
    code, said = installed.cardan("demo", "spacemouse-serial", "--seconds", "8", sites=())
    # A busy machine may miss cycles.
    assert code in (0, 4), said
    assert "followed throughout" in said or "cycles were missed" in said, said
