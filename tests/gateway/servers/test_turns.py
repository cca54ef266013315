"""A client with many queued messages does not delay the other clients."""

import threading

import pytest

from tests.gateway.servers.bench import plain_client, rosbridge
from tests.gateway.servers.memory_network import MemoryNetwork

pytestmark = pytest.mark.matrix

FRAMES = 300


def test_a_client_that_sends_much_at_once_has_one_turn_after_the_other():
    network = MemoryNetwork()
    turns = []
    before = threading.Event()
    with rosbridge(network) as running, plain_client(running) as client:
        advertise = network.advertise

        def note(*asked):
            if not turns:
                before.wait(20.0)
            turns.append("client")
            if len(turns) == 2:  # all others arrived together with it
                running.loop.call_soon_threadsafe(turns.append, "other")
            return advertise(*asked)

        network.advertise = note
        for number in range(FRAMES):
            client.send("advertise", topic=f"/t{number}", type="std_msgs/String")
        before.set()
        client.settle()
    assert turns.count("client") == FRAMES
    assert turns.index("other") < 5
