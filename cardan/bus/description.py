"""Reads a robot's description from the bus, where ROS 2's robot_state_publisher publishes it."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from cardan.bus.discovery import met_by, published
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.common.files import MODEL_BYTES
from cardan.common.inbox import Inbox, InboxEmptyError
from cardan.errors import ConfigurationError
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.names import RosNameError, checked_name

TOPIC: Final = "/robot_description"
"""Topic of robot_state_publisher."""

TYPE: Final = "std_msgs/msg/String"

ARRIVES_WITHIN_S: Final = 5.0
"""Longest wait for the text of a known publisher: a latched text arrives at once, and other
publishers send theirs about once a second."""

OTHERS_WITHIN_S: Final = 1.0
"""How long other publishers are awaited after the first text: peers that learn of each other from a
router connect within a second."""

MAX_TEXTS: Final = 20

OPTION: Final = "--from-topic"
"""Command option that requests it."""

_BEFORE_ROBOT = re.compile(r"\A[\ufeff\s]*(<\?xml.*?\?>\s*)?", re.DOTALL)
"""An XML declaration describes the encoding of the file that the text was read from."""


class Description(NamedTuple):
    """Robot description and its origin."""

    text: str
    origin: str
    """Topic, nodes and how they were met, in words."""


def topic_of(name: str) -> str:
    """Return a topic's full name. Raises ConfigurationError."""
    try:
        return checked_name(name or TOPIC)
    except RosNameError as error:
        raise ConfigurationError(OPTION, f"takes a topic in FILE's place; {error}") from None


def describe(topic: str, options: BusOptions) -> Description:
    """Return the text that is published on `topic`.

    Raises ConfigurationError if no node publishes one in time, or several that differ;
    ExtraMissingError, DriverError.
    """
    heard: Inbox[bytes] = Inbox(MAX_TEXTS)
    with BusNetwork(options, f"cardan_robots_{time.time_ns() % 10**9}") as network:
        remedy = (
            "start robot_state_publisher with RMW_IMPLEMENTATION=rmw_zenoh_cpp, or write the text "
            "to a file and give that: `ros2 param get --hide-type /robot_state_publisher "
            "robot_description > robot.urdf`"
        )
        known = published(network, topic, OPTION, remedy)
        if known.type != TYPE:
            raise ConfigurationError(OPTION, f"{topic} is of {known.type}, and must be of {TYPE}")
        network.subscribe(topic, TYPE, lambda data, _stamp_ns: heard.put(data))
        try:
            messages = [heard.get(ARRIVES_WITHIN_S)]
        except InboxEmptyError:
            raise ConfigurationError(
                OPTION,
                f"{_by(known.publishers)} published nothing as {topic} within "
                f"{ARRIVES_WITHIN_S:g} s {met_by(options)}: later subscribers receive "
                "an earlier message only if it is transient local (latched); restart the "
                "publisher, or make it transient local",
            ) from None
        end_s = time.monotonic() + OTHERS_WITHIN_S
        while (left_s := end_s - time.monotonic()) > 0.0:
            try:
                messages.append(heard.get(left_s))
            except InboxEmptyError:
                break
        publishers = network.topics().get(topic, known).publishers or known.publishers
    origin = f"{topic} of {_by(publishers)}, {met_by(options)}"
    return Description(agreed(topic, publishers, messages), origin)


def agreed(topic: str, publishers: Sequence[str], messages: Iterable[bytes]) -> str:
    """Return the common text of all messages, without an XML declaration, or raise
    ConfigurationError."""
    texts = dict.fromkeys(_text(topic, publishers, data) for data in messages)
    if len(texts) > 1:
        raise ConfigurationError(
            OPTION,
            f"{len(texts)} different texts were published as {topic}, by {_by(publishers)}: stop "
            "all publishers but one, or give each its own topic",
        )
    (text,) = texts
    return text


def _text(topic: str, publishers: Sequence[str], data: bytes) -> str:
    if len(data) > MODEL_BYTES:
        raise ConfigurationError(
            OPTION, f"the text published as {topic} is longer than {MODEL_BYTES / 2**20:g} MiB"
        )
    message = codec_of(TYPE).decode(data)
    if isinstance(message, MalformedCdr):
        raise ConfigurationError(OPTION, f"the message on {topic} is malformed: {message.reason}")
    text = _BEFORE_ROBOT.sub("", message["data"])
    if not text:
        raise ConfigurationError(
            OPTION,
            f"the text that {_by(publishers)} published as {topic} is empty: the publisher's "
            "parameter robot_description has to be the robot's URDF",
        )
    return text


def _by(nodes: Sequence[str]) -> str:
    return " and ".join(nodes)
