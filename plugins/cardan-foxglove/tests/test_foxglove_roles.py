"""Rights of viewers and operators at the Foxglove server."""

from __future__ import annotations

import pytest

pytest.importorskip("foxglove", reason="foxglove-sdk: pip install ./plugins/cardan-foxglove")

from foxglove_pair import foxglove_client, foxglove_server
from tests.gateway.servers import test_roles as shared
from tests.gateway.servers.test_roles import COMMANDING, ROLES, STRING, speed

pytestmark = pytest.mark.matrix

network, token_file = shared.network, shared.token_file  # Fixtures.

EMPTY = b"\0\1\0\0\0"
"""A request without fields, as CDR."""


@pytest.fixture
def foxglove(network, token_file):
    with foxglove_server(network, token_file=token_file) as running:
        yield lambda role: foxglove_client(running, f"/?t={ROLES[role]}")


def said(client, words):
    """Wait for a reason to reach the client."""
    client.until(lambda frame: words in str(frame))


def test_a_viewer_of_foxglove_reads_and_commands_nothing(network, foxglove):
    with foxglove("viewer") as client:
        number = client.subscribe("/chatter")
        client.settle()
        network.publish("/chatter", STRING, data="hello")
        assert client.message(number)
        client.send("getParameters", parameterNames=["/arm.speed"], id="1")
        (found,) = client.until(op="parameterValues", id="1")["parameters"]
        assert found["value"] == 0.5
        channel = {"id": 1, "topic": "/chatter", "encoding": "cdr", "schemaName": STRING}
        client.send("advertise", channels=[channel])
        said(client, "a viewer may not publish on /chatter")
        client.set(name="/arm.speed", value=1.0)
        said(client, "a viewer may not call /arm/set_parameters")
        answer = client.call("/stop", EMPTY)
        assert "a viewer may not call /stop" in answer["message"]
    assert (network.published, network.done, speed(network)) == ([], [], 0.5)


@pytest.mark.parametrize("role", COMMANDING)
def test_others_of_foxglove_command(network, foxglove, role):
    with foxglove(role) as client:
        client.set(name="/arm.speed", value=1.0)
        client.settle()
        assert client.call("/stop", EMPTY)["op"] == "response"
    assert network.done
    assert speed(network) == 1.0
