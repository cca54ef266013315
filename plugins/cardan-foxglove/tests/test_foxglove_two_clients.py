"""Two clients of the Foxglove server that stream at once: only one moves the arm."""

from __future__ import annotations

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")
pytest.importorskip("foxglove", reason="foxglove-sdk: pip install ./plugins/cardan-foxglove")

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.gateway.bus.options import DEFAULT_NAME
from foxglove_pair import foxglove_client, foxglove_server
from tests.gateway.servers import test_two_clients as shared
from tests.waiting import until

pytestmark = pytest.mark.matrix


class Foxglove:
    """Two connections to a Foxglove server."""

    def __init__(self, here, stack):
        self.bus = stack.enter_context(BusNetwork(BusOptions(router=here.endpoint), "foxglove"))
        until(lambda: f"/{DEFAULT_NAME}" in self.bus.nodes())
        self.server, self.stack = stack.enter_context(foxglove_server(self.bus)), stack

    def join(self, name):
        client = self.stack.enter_context(foxglove_client(self.server))
        number = client.advertise(shared.TOPIC, shared.TWIST)
        client.settle()
        return lambda *what: client.publish(number, shared.encoded(*what)), client.status

    def source(self, name, number):
        return f"ros2 /foxglove_client_{number}"


def test_the_first_moves_the_arm_and_the_second_is_refused_and_informed():
    shared.test_the_first_moves_the_arm_and_the_second_is_refused_and_informed(Foxglove)


def test_a_client_whose_clock_is_not_known_yet_is_informed_once():
    shared.test_a_client_whose_clock_is_not_known_yet_is_informed_once(Foxglove)


def test_another_one_moves_the_arm_after_the_lease_of_the_one_that_has_gone():
    shared.test_another_one_moves_the_arm_after_the_lease_of_the_one_that_has_gone(Foxglove)
