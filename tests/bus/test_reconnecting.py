"""Peers whose connection breaks: two nodes and a router on loopback."""

import contextlib
import json
import logging
import os
import socket
import stat
from unittest.mock import Mock

import pytest

zenoh = pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')

from cardan.bus.node import BusNode, close_session, router_config  # noqa: E402
from cardan.bus.options import BusOptions  # noqa: E402
from cardan.bus.reconnecting import LOOK_S, THIRD, Reconnector  # noqa: E402
from cardan.protocols.ros2.cdr import codec_of  # noqa: E402
from tests.serving import free_endpoint  # noqa: E402
from tests.waiting import until  # noqa: E402

STRING = "std_msgs/msg/String"
TEXT = codec_of(STRING).encode({"data": "on"})


@pytest.fixture
def router():
    endpoint = free_endpoint()
    session = zenoh.open(router_config([endpoint], [], ""))
    yield endpoint
    close_session(session)


@pytest.fixture
def pair(router):
    """Two connected nodes."""
    options = BusOptions(router=router)
    with BusNode(options, "robot") as robot, BusNode(options, "operator") as operator:
        until(lambda: _connections(robot, operator), "a connection of the two")
        yield robot, operator


def _links(node):
    return node._opened().info.links()


def _port(end):
    return int(str(end).rpartition(":")[2])


def _connections(one, other):
    """Return the ports of each connection between two nodes."""
    return [
        {_port(link.src), _port(link.dst)} for link in _links(one) if str(link.zid) == other.zid
    ]


def _break(connections):
    """Shut connections of this process down, like those of a computer that was suspended."""
    for number in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError, IndexError):  # closed, or not a TCP connection
            if stat.S_ISSOCK(os.fstat(int(number)).st_mode):
                with socket.socket(fileno=os.dup(int(number))) as each:
                    if {each.getsockname()[1], each.getpeername()[1]} in connections:
                        each.shutdown(socket.SHUT_RDWR)


def _ended(before, pair):
    return not any(each in before for each in _connections(*pair))


def _reported(caplog, words):
    return [each.getMessage() for each in caplog.records if words in each.getMessage()]


@pytest.mark.real
def test_peers_whose_connection_breaks_are_connected_again_and_both_say_so(pair, caplog):
    robot, operator = pair
    heard = operator.subscription("/command", STRING, 1)
    publisher = robot.publisher("/command", STRING)
    until(lambda: publisher.put(TEXT, 0) or heard.poll(), "a message")
    before = _connections(robot, operator)
    _break(before)
    until(lambda: _ended(before, pair), "the end of the connection")
    until(lambda: heard.poll() is None, "the last of what was sent before")
    until(lambda: publisher.put(TEXT, 0) or heard.poll(), "a message again")
    until(lambda: len(_reported(caplog, "again, after")) == 2, "words of both")
    lost = [
        _reported(caplog, f"connection to Zenoh session {each.zid} ({name}) is lost")
        for each, name in ((robot, "/robot"), (operator, "/operator"))
    ]
    # The first to reconnect logs the loss; the other one may not have noticed it by then.
    assert sorted(map(len, lost)) in ([0, 1], [1, 1])
    for each in (robot, operator):
        assert len(_reported(caplog, f"connected to Zenoh session {each.zid} again")) == 1
    assert all(each.levelno == logging.WARNING for each in caplog.records)


@pytest.mark.matrix
def test_peers_that_lose_their_router_too_are_connected_again(pair):
    robot, operator = pair
    before = _connections(robot, operator)
    _break([{_port(link.src), _port(link.dst)} for node in pair for link in _links(node)])
    until(lambda: _ended(before, pair), "the end of the connection")
    until(lambda: _connections(robot, operator), "a connection again")


@pytest.mark.matrix
def test_a_node_that_leaves_is_let_go(pair, router, caplog):
    caplog.set_level(logging.INFO)
    robot, _ = pair
    with BusNode(BusOptions(router=router), "guest") as guest:
        until(lambda: _connections(robot, guest), "a connection to the guest")
    until(lambda: robot._reconnector._thread is None, "the end of the search")
    assert not robot._reconnector._lost
    assert not caplog.records


@pytest.mark.matrix
def test_peers_whose_file_has_endpoints_by_mode_are_connected_again(router, tmp_path):
    file = tmp_path / "zenoh.json5"
    config = {
        "connect": {"endpoints": {"peer": [router], "router": []}},
        "listen": {"endpoints": ["tcp/127.0.0.1:0"]},
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}},
        "timestamping": {"enabled": True},
    }
    file.write_text(json.dumps(config))
    options = BusOptions(zenoh_config=str(file))
    with BusNode(options, "robot") as robot, BusNode(options, "operator") as operator:
        until(lambda: _connections(robot, operator), "a connection of the two")
        before = _connections(robot, operator)
        _break(before)
        until(lambda: _ended(before, (robot, operator)), "the end of the connection")
        until(lambda: _connections(robot, operator), "a connection again")


@pytest.mark.matrix
def test_a_third_peer_that_goes_is_not_looked_for(pair):
    robot, _ = pair
    zid = THIRD + 24 * "1"
    peers = robot._opened().info.peers_zid
    # A third peer that listened would stay connected to peers that were about to connect to it.
    with robot._reconnector._joined("peer", zid):
        until(lambda: zid in map(str, peers()), "a connection to the third peer")
    until(lambda: zid not in map(str, peers()), "its end")
    assert robot._reconnector._thread is None


def test_a_later_loss_is_looked_for_as_soon_as_the_first():
    reconnector = Reconnector(zenoh, Mock(), Mock())
    reconnector._session.info.routers_zid.return_value = []
    reconnector._pause_s = LOOK_S[1]
    transport = Mock(whatami=zenoh.WhatAmI.PEER, zid="1f")
    reconnector._hear(Mock(transport=transport, kind=zenoh.SampleKind.DELETE))
    assert reconnector._pause_s < LOOK_S[1]
    reconnector.close()


def test_one_that_is_found_again_before_it_was_missed_is_worth_a_word(caplog):
    """Only once: a peer that was never lost is new."""
    reconnector = Reconnector(zenoh, Mock(), Mock())
    reconnector._thread = Mock()  # no search runs
    transport = Mock(whatami=zenoh.WhatAmI.PEER, zid="1f")
    for kind in (zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE, zenoh.SampleKind.PUT):
        reconnector._hear(Mock(transport=transport, kind=kind))
    assert [each.getMessage() for each in caplog.records] == [
        "connected to Zenoh session 1f again, after 0.0 s"
    ]
    reconnector.close()


def test_one_that_a_slow_router_does_not_tell_of_is_still_looked_for():
    """Missing answers arrive as an error."""
    reconnector = Reconnector(zenoh, Mock(), Mock())
    reconnector._lost["1f"] = 0.0
    client = Mock()
    reconnector._joined = Mock(return_value=contextlib.nullcontext(client))
    client.liveliness().get.return_value = [Mock(ok=None)]
    reconnector._look()
    assert reconnector._lost
    client.liveliness().get.return_value = []
    reconnector._look()
    assert not reconnector._lost
