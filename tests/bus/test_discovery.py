"""Discovery on the bus lists the nodes, or advises what to do if there are none."""

import pytest

from cardan.bus.discovery import Discovery, discover, reachable, remedies, unseen
from cardan.bus.zenoh_network import BusNetwork
from cardan.gateway.bus.options import BusOptions, NetworkOptions
from tests.serving import free_endpoint

NOBODY = Discovery((), {}, {}, 0, 0)


def advice(found, **options):
    return " ".join(remedies(BusOptions(**options), found))


def test_where_somebody_was_met_nothing_is_to_be_done():
    assert advice(NOBODY._replace(nodes=("/arm",))) == ""


def test_where_only_a_router_answers_a_peer_is_reported_both_remedies():
    said = advice(NOBODY._replace(routers=1))
    assert "forwards nothing between them" in said
    assert 'mode = "peer"' in said
    assert 'listen = ["tcp/127.0.0.1:0"]' in said
    assert 'mode = "client"' in said


def test_a_client_is_not_asked_to_become_one():
    said = advice(NOBODY._replace(routers=1), mode="client")
    assert "mode" not in said
    assert "no node is connected" in said


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "`cardan net server router`, or rmw_zenohd"),
        (
            {"router": "tcp/127.0.0.1:7448"},
            "`cardan net server router --endpoint tcp/127.0.0.1:7448`",
        ),
        ({"router": "tcp/10.0.0.1:7447"}, "beyond its own computer"),
        ({"router": ""}, "there is no router"),
        ({"zenoh_config": "mine.json5"}, "as mine.json5 has it"),
    ],
)
def test_where_nobody_answers_it_says_what_to_start(options, words):
    assert words in advice(NOBODY, **options)


def test_where_dds_is_joined_it_says_what_is_not_seen():
    assert unseen(NOBODY._replace(nodes=("/arm",))) == ""
    said = unseen(NOBODY._replace(nodes=("/arm", "/cardan_dds_server")))
    assert "have a subscriber on the bus" in said
    assert "recorded" in said


def test_another_session_of_zenoh_without_a_node_is_said_so():
    assert "no node of ROS 2" in advice(NOBODY._replace(peers=1))


def test_a_session_is_met_by_its_router_or_else_at_its_own_endpoint():
    by_router = reachable(NetworkOptions(router="tcp/127.0.0.1:1", listen=("tcp/127.0.0.1:2",)))
    assert by_router == BusOptions(router="tcp/127.0.0.1:1")
    direct = reachable(
        NetworkOptions(router="", listen=("tcp/127.0.0.1:0", "tcp/127.0.0.1:2"), domain=3)
    )
    assert direct == BusOptions(router="tcp/127.0.0.1:2", domain=3)


@pytest.mark.matrix
def test_a_node_on_the_bus_is_found_and_the_one_that_looks_is_not():
    endpoint = free_endpoint()
    with BusNetwork(BusOptions(router="", listen=(endpoint,)), "talker") as talker:
        publisher = talker.advertise("/chatter", "std_msgs/msg/String", latched=False)
        options = BusOptions(router=endpoint)
        found = discover(options)
        publisher.close()
    assert list(found.nodes) == ["/talker"]
    assert found.topics["/chatter"].publishers == ("/talker",)
    assert remedies(options, found) == []
