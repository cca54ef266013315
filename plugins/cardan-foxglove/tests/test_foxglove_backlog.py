"""Messages that a client sends faster than the Foxglove server handles them are dropped."""

from __future__ import annotations

import pytest

pytest.importorskip("foxglove", reason="foxglove-sdk: pip install ./plugins/cardan-foxglove")

from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import default_message
from foxglove_pair import foxglove_client, foxglove_server
from tests.gateway.servers.memory_network import MemoryNetwork
from tests.gateway.servers.test_backlog import TWIST, stall
from tests.waiting import until

pytestmark = pytest.mark.matrix


def test_what_waited_at_foxglove_is_dropped():
    network = MemoryNetwork()
    network.send = lambda *_given: None  # Otherwise the server would receive its own messages.
    with foxglove_server(network) as running, foxglove_client(running) as client:
        number = client.advertise("/cmd", TWIST)
        until(lambda: network.publishers)
        stall(running)
        client.publish(number, codec_of(TWIST).encode(default_message(TWIST)))
        client.settle()
        assert network.published == []
        assert running.server.counts["stale"] == 1
        client.publish(number, codec_of(TWIST).encode(default_message(TWIST)))
        until(lambda: len(network.published) == 1)


def test_calls_that_waited_at_foxglove_are_refused():
    network, called = MemoryNetwork(), []
    network.offer("/arm/movl", "std_srvs/srv/Trigger", lambda _asked: called.append(1) or {})
    with foxglove_server(network) as running, foxglove_client(running) as client:
        client.settle()
        client.service("/arm/movl")
        request = "std_srvs/srv/Trigger_Request"
        data = codec_of(request).encode(default_message(request))
        stall(running)
        assert "not executed" in client.call("/arm/movl", data)["message"]
        assert called == []
        client.call("/arm/movl", data)
        assert called == [1]
