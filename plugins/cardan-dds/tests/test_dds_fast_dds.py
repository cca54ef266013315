"""Traffic on DDS, judged by the DDS implementation of ROS 2's default middleware."""

from __future__ import annotations

import dataclasses
import logging
import time

import pytest

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed: pip install cardan[dds]")

from cardan.bus.network import Failure
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.type_hash import type_hash
from cardan_dds.network import DdsNetwork
from tests.dds_network import OPTIONS, STRING, TRIGGER, encoded, network
from tests.fastdds import FastNode, user_data
from tests.waiting import until

pytestmark = pytest.mark.matrix

DOMAIN = OPTIONS.number
JOINTS = "sensor_msgs/msg/JointState"
HUMBLE = dataclasses.replace(OPTIONS, dds_distribution="humble")


@pytest.fixture
def ours():
    with network("ours") as found:
        yield found


@pytest.mark.parametrize("discovery", ["whitelist", "unicast"])
@pytest.mark.parametrize("first", ["ours", "theirs"])
def test_topics_both_ways_however_it_looks_for_others(discovery, first):
    message = {"name": ["a"], "position": [0.5], "velocity": [], "effort": [0.25]}
    names = {"theirs": FastNode(DOMAIN, discovery), "ours": network("ours")}
    heard = []
    with names[first], names["theirs" if first == "ours" else "ours"]:
        ours, theirs = names["ours"], names["theirs"]
        theirs.subscribe("/arm/joints", JOINTS)
        theirs.advertise("/arm/name", STRING)
        publisher = ours.advertise("/arm/joints", JOINTS, False)
        ours.subscribe("/arm/name", STRING, lambda cdr, _ns: heard.append(cdr))

        def reported():
            # Messages published before discovery are lost.
            publisher.publish(encoded(JOINTS, **message))
            return theirs.found("sample", topic="/arm/joints")

        until(reported)
        reported = theirs.heard("/arm/joints", JOINTS)
        assert {key: reported[key] for key in message} == message
        # The length is no multiple of four: the padding must be removed.
        theirs.publish("/arm/name", STRING, {"data": "hello"}, count=300, period_ms=10)
        assert until(lambda: heard)[0] == encoded(STRING, data="hello")


def test_endpoints_are_those_of_ros_2(ours):
    ours.advertise("/arm/joints", JOINTS, False)
    ours.advertise("/arm/description", STRING, True)
    ours.subscribe("/arm/name", STRING, print)
    ours.serve("/arm/stop", TRIGGER, print)
    with FastNode(DOMAIN) as theirs:
        seen = theirs.wait("participant_seen", what="found")
        assert user_data(seen) == {"enclave": "/"}
        assert seen["guid"].startswith("0110"), "Cyclone DDS"
        assert seen["guid"] == ours.hub.participant.guid.hex()
        for topic, kind, type_name, durability in (
            ("rt/arm/joints", "writer", JOINTS, "volatile"),
            ("rt/arm/description", "writer", STRING, "transient_local"),
            ("rt/arm/name", "reader", STRING, "volatile"),
        ):
            seen = theirs.wait("endpoint_seen", topic=topic, kind=kind)
            package, _, name = type_name.split("/")
            assert seen["type"] == f"{package}::msg::dds_::{name}_"
            assert user_data(seen) == {"typehash": type_hash(type_name)}
            assert (seen["reliability"], seen["durability"]) == ("reliable", durability)
            assert seen["representations"] in (0, 1), "XCDR1 only, listed or by default"
        request = theirs.wait("endpoint_seen", topic="rq/arm/stopRequest", kind="reader")
        reply = theirs.wait("endpoint_seen", topic="rr/arm/stopReply", kind="writer")
        assert request["type"] == "std_srvs::srv::dds_::Trigger_Request_"
        assert user_data(request)["typehash"] == type_hash(f"{TRIGGER}_Request")
        assert user_data(reply)["typehash"] == type_hash(f"{TRIGGER}_Response")
        assert user_data(request)["serviceid"] == user_data(reply)["serviceid"]


@pytest.mark.parametrize(("options", "length"), [(OPTIONS, 16), (HUMBLE, 24)])
def test_nodes_know_each_other_by_name(options, length):
    with DdsNetwork(options, "ours") as ours, FastNode(DOMAIN, gid_length=length) as theirs:
        until(lambda: "/fast" in ours.nodes())
        publisher = ours.advertise("/arm/joints", JOINTS, False)
        seen = theirs.wait("endpoint_seen", topic="rt/arm/joints", kind="writer")
        named = f"{seen['guid']}{'00' * (length - 16)}"
        until(lambda: any(named in each["cdr"] for each in theirs.found("graph")))
        # Wait for a full snapshot: the participant, a node, its endpoints.
        reported = next(each["cdr"] for each in theirs.found("graph") if named in each["cdr"])
        assert reported.startswith(
            f"00010000{ours.hub.participant.guid.hex()}{'00' * (length - 16)}01000000"
        )
        assert b"ours\0".hex() in reported
        publisher.close()
        theirs.wait("endpoint_gone", topic="rt/arm/joints", kind="writer")
        assert named not in theirs.wait("graph")["cdr"], "still in the snapshot"
        theirs.advertise("/arm/name", STRING)
        until(lambda: "/fast" in ours.topics().get("/arm/name", ((), ()))[1])
    assert length == len(named) // 2


@pytest.mark.real
def test_what_is_latched_comes_to_who_is_late(ours):
    ours.advertise("/arm/description", STRING, True).publish(encoded(STRING, data="<robot/>"))
    with FastNode(DOMAIN) as theirs:
        theirs.subscribe("/arm/description", STRING, latched=True)
        assert theirs.heard("/arm/description", STRING) == {"data": "<robot/>"}
        theirs.advertise("/their/description", STRING, latched=True)
        theirs.publish("/their/description", STRING, {"data": "<arm/>"})
        heard = []
        ours.subscribe("/their/description", STRING, lambda cdr, _ns: heard.append(cdr))
        assert until(lambda: heard) == [encoded(STRING, data="<arm/>")]


def test_a_publisher_that_is_found_while_a_subscription_is_made_is_not_missed(ours, monkeypatch):
    follow = ours.hub.follow
    with FastNode(DOMAIN) as theirs:

        def late(given):
            theirs.advertise("/their/description", STRING, latched=True)
            theirs.publish("/their/description", STRING, {"data": "<arm/>"})
            # Fast DDS no longer reports the endpoint once its node has been announced.
            until(lambda: "/fast" in ours.topics().get("/their/description", ((), ()))[1])
            follow(given)

        monkeypatch.setattr(ours.hub, "follow", late)
        heard = []
        ours.subscribe("/their/description", STRING, lambda cdr, _ns: heard.append(cdr))
        assert until(lambda: heard) == [encoded(STRING, data="<arm/>")]


@pytest.mark.parametrize("reliable", [True, False])
def test_a_publisher_is_heard_whatever_its_reliability(ours, reliable):
    heard = []
    ours.subscribe("/arm/name", STRING, lambda cdr, _ns: heard.append(cdr))
    with FastNode(DOMAIN) as theirs:
        theirs.advertise("/arm/name", STRING, reliable=reliable)
        theirs.publish("/arm/name", STRING, {"data": "x"}, count=300, period_ms=10)
        until(lambda: len(heard) > 20)
    assert set(heard) == {encoded(STRING, data="x")}


def test_who_has_crashed_holds_nobody_up(ours):
    topics = [f"/arm/topic_{number}" for number in range(20)]
    publishers = [ours.advertise(topic, STRING, False) for topic in topics]
    with FastNode(DOMAIN) as theirs:
        for topic in topics:
            theirs.subscribe(topic, STRING)
        until(lambda: all(publisher.heard for publisher in publishers))
        theirs.kill()
    for publisher in publishers:
        publisher.publish(encoded(STRING, data="nobody acknowledges this"))
    begun_s = time.monotonic()
    for publisher in publishers:
        publisher.close()
    assert time.monotonic() - begun_s < 5.0


def test_bytes_that_are_no_message_are_passed_on_as_they_are(ours):
    heard = []
    ours.subscribe("/arm/name", STRING, lambda cdr, _ns: heard.append(cdr))
    with FastNode(DOMAIN) as theirs:
        theirs.advertise("/arm/name", STRING)
        theirs.publish("/arm/name", STRING, {"data": "before"}, count=300, period_ms=10)
        until(lambda: encoded(STRING, data="before") in heard)
        for junk in (b"\0\1\0\0\xff\xff\xff\xff", b"\0\1\0\0", b"\0\1\0\0" + bytes(4096)):
            theirs.publish("/arm/name", STRING, junk)
        theirs.publish("/arm/name", STRING, {"data": "after"})
        until(lambda: encoded(STRING, data="after") in heard)
    others = [codec_of(STRING).decode(each) for each in heard]
    assert sum(isinstance(each, MalformedCdr) or each == {"data": ""} for each in others) <= 3


def test_a_client_of_a_service_is_reported_what_to_do_and_gets_no_answer(ours, caplog):
    asked = []
    ours.serve("/arm/stop", TRIGGER, lambda request, answered: asked.append(request))
    with caplog.at_level(logging.WARNING), FastNode(DOMAIN) as theirs:
        theirs.do("client", "/arm/stop", TRIGGER)
        theirs.wait("matched", topic="rq/arm/stopRequest", kind="writer")
        theirs.wait("matched", topic="rr/arm/stopReply", kind="reader")
        theirs.request("/arm/stop", TRIGGER, {})
        theirs.wait("requested", written=1)
        until(lambda: "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp" in caplog.text)
        theirs.request("/arm/stop", TRIGGER, {})
        theirs.wait("requested", 2, written=1)
        # Messages published after the request arrive after it.
        heard = []
        ours.subscribe("/arm/name", STRING, lambda cdr, _ns: heard.append(cdr))
        theirs.advertise("/arm/name", STRING)
        theirs.publish("/arm/name", STRING, {"data": "x"}, count=300, period_ms=10)
        until(lambda: heard)
        assert theirs.found("reply") == []
    assert asked == []
    warned = [each for each in caplog.records if "rmw_cyclonedds_cpp" in each.getMessage()]
    assert len(warned) == 1


def test_a_server_is_never_sent_a_request(ours):
    with FastNode(DOMAIN) as theirs:
        theirs.serve("/their/stop", TRIGGER, {"success": True})
        assert ours.wait_for_service("/their/stop", 20.0)
        answers = []
        ours.call("/their/stop", TRIGGER, encoded(f"{TRIGGER}_Request"), answers.append, 20.0)
        until(lambda: answers)
        assert isinstance(answers[0], Failure)
        assert "Fast DDS" in answers[0].reason
        assert "rmw_cyclonedds_cpp" in answers[0].reason
        theirs.wait("matched", topic="rq/their/stopRequest", kind="reader")
        assert theirs.found("request") == []
