"""The server knows the client of a motion by its liveliness tokens, until the last of them
vanishes."""

from cardan.bus.node import Received, gid_of_token
from cardan.gateway.bus.liveliness import LivelinessMonitor
from cardan.protocols.ros2.zenoh import CLIENT, NODE, PUBLISHER, Attachment, Entity
from tests.gateway.bus.fakes import Stamp

OWN, OTHER = "a0", "b0"


def token(entity_id, zid=OTHER, node_id="0", kind=PUBLISHER, node="user"):
    entity = Entity(
        zid, node_id, entity_id, kind, "/", node, "/chatter", "std_msgs/msg/String", "RIHS01_0"
    )
    return entity.token(0)


def known(*tokens):
    liveliness = LivelinessMonitor(OWN)
    for each in tokens:
        liveliness.take(each, True, 0.0)
    return liveliness


def test_a_gid_is_rmw_zenohs_hash_of_the_token():
    # XXH3_128bits of the empty string is 99aa06d3014798d8 6001c324468d497f, high half first
    # (xxHash's own sanity checks). rmw_zenoh puts the low half first, each half in the processor's
    # byte order.
    assert gid_of_token("").hex(" ", 8) == "7f498d4624c30160 d8984701d306aa99"


def test_an_endpoint_is_there_until_its_token_vanishes():
    mine, others = token("1"), token("2")
    liveliness = known(mine, others)
    endpoint = liveliness.endpoint(gid_of_token(mine))
    assert endpoint.there()
    liveliness.take(others, False, 0.0)
    assert endpoint.there()
    liveliness.take(mine, False, 0.0)
    assert not endpoint.there()
    assert liveliness.endpoint(gid_of_token(mine)) is None


def test_a_node_is_there_while_it_has_any_token():
    client, node = token("1", kind=CLIENT), token("0", kind=NODE)
    liveliness = known(node, client, token("5", node_id="4", node="another"))
    asked = liveliness.node(gid_of_token(client))
    liveliness.take(client, False, 0.0)
    assert asked.there()
    liveliness.take(node, False, 0.0)
    assert not asked.there()
    assert liveliness.session(OTHER).there()


def test_a_session_is_there_while_any_of_its_nodes_is():
    tokens = token("1"), token("5", node_id="4")
    liveliness = known(*tokens)
    session = liveliness.session(OTHER)
    liveliness.take(tokens[0], False, 0.0)
    assert session.there()
    liveliness.take(tokens[1], False, 0.0)
    assert not session.there()
    assert liveliness.session(OTHER) is None


def test_who_comes_back_is_somebody_else():
    mine = token("1")
    liveliness = known(mine)
    before = liveliness.endpoint(gid_of_token(mine)), liveliness.session(OTHER)
    liveliness.take(mine, False, 0.0)
    liveliness.take(mine, True, 0.0)
    assert not any(each.there() for each in before)
    assert liveliness.endpoint(gid_of_token(mine)).there()


def test_tokens_that_come_twice_or_leave_without_having_come_count_once():
    mine = token("1")
    liveliness = known(mine, mine)
    session = liveliness.session(OTHER)
    liveliness.take(token("7"), False, 0.0)
    assert session.there()
    liveliness.take(mine, False, 0.0)
    assert not session.there()
    liveliness.take(mine, False, 0.0)


def test_what_is_no_token_of_ros_is_nobody():
    liveliness = known("@ros2_lv/0", "@/b0/session", "", "@ros2_lv/0/b0/0")
    assert liveliness.session(OTHER) is None


def test_the_listeners_own_session_is_nobody_who_asks():
    liveliness = known(token("1", zid=OWN))
    assert liveliness.session(OWN) is None
    assert liveliness.endpoint(gid_of_token(token("1", zid=OWN))) is None


def sent(gid=None, zid=""):
    attachment = None if gid is None else Attachment(1, 1, gid)
    return Received(b"", "", attachment, Stamp(zid) if zid else None)


def test_who_sent_a_message_is_known_by_its_node():
    mine, another = token("1", node="joystick"), token("2", node="joystick")
    liveliness = known(mine, another)
    found = liveliness.identity(sent(gid_of_token(mine), OTHER))
    assert found.node == "/joystick"
    assert found.presence.there()
    assert liveliness.identity(sent(gid_of_token(another))) == found


def test_who_sends_without_a_known_gid_is_its_session_and_else_the_gid():
    liveliness = known(token("1", node="joystick"))
    session = liveliness.identity(sent(b"x" * 16, OTHER))
    assert (session.node, session.presence) == ("/joystick", liveliness.session(OTHER))
    nobody = liveliness.identity(sent(b"x" * 16))
    assert (nobody.key, nobody.node, nobody.presence) == (b"x" * 16, "", None)


def test_who_gives_another_sessions_gid_is_its_own_session():
    mine = token("1", node="joystick")
    liveliness = known(mine, token("1", zid="c0", node="liar"))
    assert liveliness.identity(sent(gid_of_token(mine), "c0")).node == "/liar"
    # A router that adds timestamps has no node.
    assert liveliness.identity(sent(gid_of_token(mine), "d0")).node == "/joystick"
