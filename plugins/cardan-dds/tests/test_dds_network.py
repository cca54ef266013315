"""Discovery of nodes on DDS: topics, services, the graph, and refused clients."""

import logging
import threading

import pytest

pytest.importorskip("cyclonedds", reason='cyclonedds is not installed: "cardan[dds]"')


from cardan.bus.dds_options import DdsOptions
from cardan.bus.network import Failure, NetworkError
from cardan.errors import CardanError, ConfigurationError, ExtraMissingError
from cardan.protocols.ros2.zenoh import Qos
from cardan_dds import cyclone
from cardan_dds.cyclone import LOOPBACK, Participant
from cardan_dds.wire import Announcement, Endpoint, NodeInfo, ServicePacket
from tests.dds_network import OPTIONS, STRING, TIMEOUT_S, TRIGGER, encoded, network
from tests.waiting import until

pytestmark = pytest.mark.matrix

HELLO = encoded(STRING, data="hello")
REQUEST = encoded(f"{TRIGGER}_Request")
REPLY = encoded(f"{TRIGGER}_Response", success=True, message="ok")
FAST_GUID = b"\x01\x0f" + bytes(14)


@pytest.fixture
def pair():
    with network("talker") as talker, network("listener") as listener:
        until(lambda: "/listener" in talker.nodes() and "/talker" in listener.nodes())
        yield talker, listener


def hears(subscriber, topic, type_name=STRING):
    heard = []
    handle = subscriber.subscribe(topic, type_name, lambda cdr, ns: heard.append((cdr, ns)))
    return heard, handle


@pytest.mark.real
def test_a_message_arrives_as_it_was_sent(pair):
    talker, listener = pair
    heard, handle = hears(listener, "/chatter")
    publisher = talker.advertise("/chatter", STRING, latched=False)
    until(lambda: publisher.heard)
    publisher.publish(HELLO)
    until(lambda: heard)
    assert heard[0][0] == HELLO
    topic = until(lambda: (found := listener.topics()["/chatter"]).publishers and found)
    assert topic == (STRING, ("/talker",), ("/listener",), False)
    assert listener.topics(others=True)["/chatter"].subscribers == ()
    handle.close()
    publisher.close()
    until(lambda: "/chatter" not in talker.topics())


def test_a_latched_topic_begins_with_what_was_published_and_its_type_may_be_unknown(pair):
    talker, listener = pair
    publisher = talker.advertise("/description", "acme_msgs/msg/Thing", latched=True)
    data = b"\0\1\0\0" + bytes(range(8))
    publisher.publish(data)
    until(lambda: "/description" in listener.topics())
    assert listener.topics()["/description"].latched
    heard, _ = hears(listener, "/description", None)
    assert until(lambda: heard)[0][0] == data


def test_a_subscription_waits_for_a_type_and_fits_publishers_that_come_later(pair):
    talker, listener = pair
    heard, _ = hears(listener, "/later", None)
    quick = talker.hub.participant.writer(
        "rt/later", "std_msgs::msg::dds_::String_", Qos(reliable=False)
    )
    until(quick.matched)
    quick.write(HELLO)
    assert until(lambda: heard)[0][0] == HELLO
    quick.close()


def test_one_that_is_deaf_does_not_hear_itself(pair):
    _, listener = pair
    with network("parrot", deaf=True) as parrot:
        own, _ = hears(parrot, "/echo")
        others, _ = hears(listener, "/echo")
        publisher = parrot.advertise("/echo", STRING, latched=False)
        until(lambda: publisher.heard)
        publisher.publish(HELLO)
        until(lambda: others)
        assert own == []


@pytest.mark.real
def test_a_service_answers(pair):
    talker, listener = pair
    served = talker.serve("/ready", TRIGGER, lambda request, answer: answer((request, REPLY)[1]))
    assert listener.wait_for_service("/ready", TIMEOUT_S)
    replies = []
    for count in range(1, 4):
        listener.call("/ready", TRIGGER, REQUEST, replies.append, TIMEOUT_S)
        until(lambda count=count: len(replies) == count)
    assert replies == [REPLY] * 3
    # The name of a server's node is published on a separate topic.
    found = until(
        lambda: (found := listener.services()["/ready"]).servers == ("/talker",) and found
    )
    assert found == (TRIGGER, ("/talker",))
    served.close()
    until(lambda: "/ready" not in listener.services())


def test_a_call_that_nobody_answers_ends(pair):
    _, listener = pair
    assert listener.wait_for_service("/nothing", 0.0) is False
    replies = []
    listener.call("/nothing", TRIGGER, REQUEST, replies.append, 0.05)
    assert "no server offers it" in until(lambda: replies)[0].reason
    listener.call("/nothing", TRIGGER, REQUEST, replies.append, None)
    listener.close()
    assert "closed" in until(lambda: replies[1:])[0].reason


def stranger(number, writes):
    """An endpoint of /ready with the GUID of a Fast DDS participant."""
    guid = FAST_GUID[:12] + number.to_bytes(4, "big")
    part = "Request"
    kind = f"std_srvs::srv::dds_::Trigger_{part}_"
    return Endpoint(guid, FAST_GUID, writes, f"rq/ready{part}", kind, number)


def test_a_server_of_another_dds_is_sent_nothing(pair):
    _, listener = pair
    listener.hub.graph.add(stranger(1, writes=False))
    replies = []
    listener.call("/ready", TRIGGER, REQUEST, replies.append, TIMEOUT_S)
    reason = until(lambda: replies)[0].reason
    assert "/ready is not called, as its server is of Fast DDS" in reason
    assert "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp" in reason


def test_a_client_of_another_dds_is_warned_of_once(pair, caplog):
    talker, _ = pair
    server = talker.serve("/ready", TRIGGER, lambda _request, _answer: None)
    until(lambda: "/ready" in talker.services())
    with caplog.at_level(logging.WARNING), talker.hub.lock:
        for number in (1, 2):
            talker.hub._warn_of(stranger(number, writes=True))
    (warning,) = [each.message for each in caplog.records]
    assert "a client of /ready is of Fast DDS, and gets no answer" in warning
    assert "rosbridge" in warning
    server.close()


def test_what_a_client_of_another_dds_sends_is_no_request(pair, monkeypatch):
    talker, listener = pair
    asked = []
    server = talker.serve("/ready", TRIGGER, lambda request, _answer: asked.append(request))
    client = listener.hub.participant.writer(
        "rq/readyRequest", "std_srvs::srv::dds_::Trigger_Request_", Qos()
    )
    until(client.matched)
    own = until(lambda: talker.hub.by_handle(client.handle))
    senders, there = [own._replace(guid=FAST_GUID), own], threading.Event()

    def writer_of(_sample):
        there.set()
        return senders[0]

    monkeypatch.setattr(talker.hub, "writer_of", writer_of)
    client.write(ServicePacket(1, 1, REQUEST).encode())
    assert there.wait(TIMEOUT_S)
    del senders[0]
    client.write(ServicePacket(1, 2, REQUEST).encode())
    assert until(lambda: asked) == [REQUEST]
    server.close()
    client.close()


def test_a_part_is_a_node_of_its_own_that_takes_all_with_it(pair):
    talker, listener = pair
    part = talker.part("client")
    part.advertise("/wave", STRING, latched=False)
    part.serve("/ready", TRIGGER, lambda _request, _answer: None)
    until(lambda: "/ready" in listener.services() and "/wave" in listener.topics())
    until(lambda: listener.topics()["/wave"].publishers == ("/client",))
    part.close()
    until(lambda: "/client" not in listener.nodes() and "/ready" not in listener.services())
    assert "/talker" in listener.nodes()
    part.close()


def test_a_participant_that_leaves_is_reported(pair):
    _, listener = pair
    gone = []
    with network("guest") as guest:
        until(lambda: "/guest" in listener.nodes())
        listener.watch_departures(gone.append)
        guid = guest.hub.participant.guid
    until(lambda: guid in gone)
    assert "/guest" not in listener.nodes()
    guest.close()


def test_names_and_types_that_are_none_are_refused(pair):
    talker, _ = pair
    with pytest.raises(NetworkError, match="is not a ROS name"):
        talker.advertise("/a b", STRING, latched=False)
    with pytest.raises(NetworkError, match="is not a type"):
        talker.advertise("/a", "String", latched=False)
    with pytest.raises(NetworkError, match="is not a type"):
        talker.serve("/a", "Trigger!", lambda _request, _answer: None)
    with pytest.raises(NetworkError, match="not open"):
        network("closed").advertise("/a", STRING, latched=False)


def test_a_server_that_fails_refuses_with_the_reason_and_logs_it(pair, caplog):
    talker, listener = pair
    talker.serve("/ready", TRIGGER, lambda _request, answer: answer(Failure("it is broken")))
    replies = []
    assert listener.wait_for_service("/ready", TIMEOUT_S)
    listener.call("/ready", TRIGGER, REQUEST, replies.append, TIMEOUT_S)
    until(lambda: replies)
    assert replies == [encoded(f"{TRIGGER}_Response", success=False, message="it is broken")]
    assert any("it is broken" in each.message for each in caplog.records)


def test_nothing_is_published_with_a_description_of_its_type(pair):
    talker, listener = pair
    talker.advertise("/plain", STRING, latched=False)
    talker.serve("/plain", TRIGGER, lambda _request, _answer: None)
    until(lambda: "/plain" in listener.services() and "/plain" in listener.topics())
    with listener.hub.lock:
        found = [e for e in listener.hub.graph._endpoints.values() if e.ros]
    assert found
    assert not any(each.described for each in found)


def test_where_types_cannot_be_hidden_they_are_those_of_ros(pair, monkeypatch):
    talker, listener = pair
    publisher = talker.advertise("/states", "sensor_msgs/msg/JointState", latched=False)
    monkeypatch.setattr(cyclone._library(), "_table", None)
    monkeypatch.setattr(cyclone._library(), "find_table", lambda _topic: None)
    monkeypatch.setattr(cyclone, "_HIDDEN", [])
    with network("other") as other:
        assert not other.hub.participant.typeless
        heard, _ = hears(other, "/states", "sensor_msgs/msg/JointState")
        until(lambda: publisher.heard)
        data = encoded("sensor_msgs/msg/JointState", name=["a", "b"], position=[1.0, 2.0])
        publisher.publish(data)
        assert until(lambda: heard)[0][0] == data
        states = until(lambda: listener.others("/states")[1])
        assert [each.described for each in states] == [True]
        with pytest.raises(NetworkError, match="is not a type that Cardan knows"):
            other.advertise("/thing", "acme_msgs/msg/Thing", latched=False)


def test_humble_has_longer_ids_and_is_understood():
    options = DdsOptions(dds_domain=OPTIONS.dds_domain, dds_distribution="humble")
    from cardan_dds.network import DdsNetwork

    with DdsNetwork(options, "old") as old, network("new") as new, DdsNetwork(options, "peer") as p:
        until(lambda: "/peer" in old.nodes() and "/old" in p.nodes())
        assert "/old" not in new.nodes()


def test_what_is_left_open_when_the_network_is_closed_can_still_be_closed():
    with network("brief") as brief:
        part = brief.part("client")
        given = [
            brief.advertise("/wave", STRING, latched=False),
            part.subscribe("/wave", None, lambda _cdr, _ns: None),
            part.serve("/ready", TRIGGER, lambda _request, _answer: None),
        ]
    for each in (part, *given):
        each.close()
    given[0].publish(HELLO)
    brief.close()


def test_endpoints_come_and_go_in_many_threads(pair):
    """Takes 3 s on an idle computer, 22 s with 8 competing processes per core: progress per round
    distinguishes a stall from slowness."""
    ones, rounds = (*pair, pair[0]), 30
    done = [0] * len(ones)

    def churn(which):
        one = ones[which]
        for round_ in range(rounds):
            given = [one.advertise(f"/t{round_ % 3}", STRING, bool(round_ % 2)) for _ in range(3)]
            given.append(one.subscribe(f"/t{round_ % 2}", STRING, lambda _cdr, _ns: None))
            given.append(one.serve(f"/s{round_ % 2}", TRIGGER, lambda _r, answer: answer(REPLY)))
            one.call(f"/s{round_ % 2}", TRIGGER, REQUEST, lambda _reply: None, 0.1)
            for each in given[::-1]:
                each.close()
            part = one.part("brief")
            part.advertise("/t1", STRING, latched=False)
            part.close()
            done[which] += 1

    threads = [threading.Thread(target=churn, args=(each,)) for each in range(len(ones))]
    for each in threads:
        each.start()
    for round_ in range(1, rounds + 1):
        until(lambda round_=round_: min(done) >= round_, f"round {round_} in every thread")
    for each in threads:
        each.join()
    until(lambda: pair[1].services(others=True) == {}, "the end of the services of others")


# -- joining ---------------------------------------------------------------------------------------


def test_the_domain_is_that_of_the_environment_unless_it_is_given(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert DdsOptions().number == 7
    assert DdsOptions(dds_domain=3).number == 3
    monkeypatch.setenv("ROS_DOMAIN_ID", "")
    assert DdsOptions().number == 0
    monkeypatch.setenv("ROS_DOMAIN_ID", "233")
    with pytest.raises(ConfigurationError, match="ROS_DOMAIN_ID"):
        _ = DdsOptions().number


def test_a_configuration_that_is_none_is_refused():
    with pytest.raises(ConfigurationError, match="dds_config"):
        Participant(DdsOptions(dds_domain=49, dds_config="<Nonsense>"))


def test_a_domain_is_configured_in_one_way():
    first = Participant(DdsOptions(dds_domain=46))
    with pytest.raises(ConfigurationError, match="configured otherwise in this process"):
        Participant(DdsOptions(dds_domain=46, dds_config="<CycloneDDS/>"))
    first.close()
    first.close()


@pytest.mark.parametrize("config", ["", LOOPBACK])
def test_a_domain_without_room_is_named_and_an_option_only_where_it_was_given(monkeypatch, config):
    library = cyclone._library()

    def full(*given):
        raise library.core.DDSException(-1)

    monkeypatch.setattr(library.domain, "Domain", full)
    with pytest.raises(CardanError) as caught:
        Participant(DdsOptions(dds_domain=77, dds_config=config))
    assert ("dds_config" in str(caught.value)) == bool(config)
    assert ("room for 62 participants" in str(caught.value)) == (not config)


def test_the_last_participant_of_the_highest_domain_has_ports():
    from cardan.bus.options import DOMAIN

    # RTPS: user unicast traffic is at 7400 + 250 * domain + 11 + 2 * index.
    assert 7400 + 250 * DOMAIN.highest + 11 + 2 * cyclone.MOST_PARTICIPANTS == 2**16 - 1


def test_a_configuration_of_the_user_passes_through(monkeypatch):
    configured = []
    library = cyclone._library()
    real = library.domain.Domain
    monkeypatch.setattr(
        library.domain, "Domain", lambda *given: (configured.append(given), real(*given))[1]
    )
    Participant(DdsOptions(dds_domain=48)).close()
    assert configured == [(48, LOOPBACK)]
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    Participant(DdsOptions(dds_domain=47)).close()
    assert configured == [(48, LOOPBACK)]


def test_without_the_package_it_says_which(monkeypatch):
    # A separate library: settings of this process must not reach the other tests.
    monkeypatch.setattr(cyclone, "_library", cyclone._Library)
    monkeypatch.setitem(__import__("sys").modules, "cyclonedds", None)
    with pytest.raises(ExtraMissingError, match=r"cardan\[dds\]"):
        Participant(OPTIONS)


def test_an_announcement_tells_of_nodes_of_others(pair):
    _, listener = pair
    reported = Announcement(FAST_GUID, (NodeInfo("/far/node"),))
    with listener.hub.lock:
        listener.hub.graph.announce(reported)
    assert "/far/node" in listener.nodes()
