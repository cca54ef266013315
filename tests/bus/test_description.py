"""Robot description read from the bus, and the errors if none arrives."""

import contextlib
import time

import pytest

from cardan.bus import description, discovery
from cardan.bus.description import TOPIC, TYPE, agreed, describe, topic_of
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.common.files import MODEL_BYTES
from cardan.errors import ConfigurationError
from cardan.protocols.ros2.cdr import codec_of
from tests.serving import free_endpoint

NODES = ("/left", "/right")
ROBOT = '<robot name="vendor"/>'


def message(text):
    return codec_of(TYPE).encode({"data": text})


def refused(*messages):
    """Return the reason why no description arrived."""
    with pytest.raises(ConfigurationError) as raised:
        agreed(TOPIC, NODES, messages)
    assert raised.value.key == "--from-topic"
    return raised.value.message


@pytest.mark.parametrize(
    "text",
    [
        ROBOT,
        f'<?xml version="1.0" ?>\n{ROBOT}',
        f'\n  <?xml version="1.0" encoding="ISO-8859-1"?>{ROBOT}',
        f"\ufeff{ROBOT}",
    ],
)
def test_the_text_comes_without_a_declaration_of_what_file_it_was(text):
    assert agreed(TOPIC, NODES, [message(text)]) == ROBOT


def test_two_publishers_of_one_text_are_fine_and_of_two_they_are_named():
    assert agreed(TOPIC, NODES, [message(ROBOT)] * 2) == ROBOT
    said = refused(message(ROBOT), message('<robot name="other"/>'))
    assert "2 different texts were published as /robot_description" in said
    assert "by /left and /right: stop all publishers but one" in said


def test_empty_wrong_and_endless_texts_are_refused():
    for empty in ("", " \n", '<?xml version="1.0"?>\n'):
        assert "published as /robot_description is empty" in refused(message(empty))
    assert "are too few" in refused(message(ROBOT)[:-3])
    assert "longer than 16 MiB" in refused(bytes(MODEL_BYTES + 1))


def test_topics_have_one_by_default_and_are_checked():
    assert topic_of("") == "/robot_description"
    assert topic_of("left/robot_description") == "/left/robot_description"
    with pytest.raises(ConfigurationError, match=r"--from-topic: .*'arm.urdf' is not a ROS name"):
        topic_of("arm.urdf")


@contextlib.contextmanager
def publishing(*texts, type_name=TYPE, latched=True):
    """Publish each text from a separate node; yield options that join their bus."""
    endpoint, retained = free_endpoint(), []
    with contextlib.ExitStack() as opened:
        options = BusOptions(router="", listen=(endpoint,))
        for number, text in enumerate(texts):
            node = opened.enter_context(BusNetwork(options, f"publisher_{number}"))
            retained.append(node.advertise(TOPIC, type_name, latched))
            if text is not None:
                retained[-1].publish(message(text))
            options = BusOptions(router=endpoint)
        yield BusOptions(router=endpoint)


@pytest.mark.matrix
def test_what_was_published_once_before_is_taken():
    with publishing(f'<?xml version="1.0"?>{ROBOT}') as options:
        found = describe(TOPIC, options)
    assert found.text == ROBOT
    assert found.origin == f"{TOPIC} of /publisher_0, by the router {options.router}"


@pytest.mark.matrix
def test_two_publishers_are_both_heard():
    with publishing(ROBOT, ROBOT) as options:
        assert describe(TOPIC, options).text == ROBOT
    with (
        publishing(ROBOT, "<robot/>") as options,
        pytest.raises(ConfigurationError, match="by /publisher_0 and /publisher_1: stop all"),
    ):
        describe(TOPIC, options)


@pytest.mark.matrix
def test_where_nothing_comes_in_time_it_says_how_long_and_what_to_do(monkeypatch):
    monkeypatch.setattr(discovery, "APPEARS_WITHIN_S", 1.0)
    monkeypatch.setattr(description, "ARRIVES_WITHIN_S", 0.5)
    began_s = time.monotonic()
    options = BusOptions(router=free_endpoint())
    with pytest.raises(ConfigurationError) as raised:
        describe(TOPIC, options)
    assert 1.0 <= time.monotonic() - began_s < 15.0
    assert f"--from-topic: no node publishes {TOPIC}" in str(raised.value)
    assert f"waited for 1 s, by the router {options.router}" in raised.value.message
    assert "ros2 param get --hide-type /robot_state_publisher" in raised.value.message
    with (
        publishing(ROBOT, latched=False) as options,
        pytest.raises(ConfigurationError, match=r"/publisher_0 published nothing as .* 0\.5 s"),
    ):
        describe(TOPIC, options)


@pytest.mark.matrix
def test_a_topic_of_another_type_is_said():
    with (
        publishing(None, type_name="std_msgs/msg/Bool") as options,
        pytest.raises(ConfigurationError, match="is of std_msgs/msg/Bool, and must be of"),
    ):
        describe(TOPIC, options)
