"""Publishes a record onto the bus, under the original names with the original spacing.

What could move an arm is held back unless it is asked for. Then it comes as from any other program:
whoever takes it decides, a session by its arming sequence and its authority.
"""

from __future__ import annotations

import fnmatch
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from cardan.bus.network import NetworkError, Publisher
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.common.serving import interruptible
from cardan.errors import CaptureError, OptionError
from cardan.gateway.bus.commands import ASK_SERVICE
from cardan.recording.arms import CONFIGURATION
from cardan.recording.mcap_file import (
    RecordedMessage,
    RecordedTopic,
    RecordReader,
    known_definition,
)

NAME = "cardan_replay"

SHOWING_TYPES = frozenset(
    {
        "diagnostic_msgs/msg/DiagnosticArray",
        "rcl_interfaces/msg/Log",
        "sensor_msgs/msg/CameraInfo",
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/Imu",
        "sensor_msgs/msg/LaserScan",
        "sensor_msgs/msg/PointCloud2",
        "tf2_msgs/msg/TFMessage",
        "visualization_msgs/msg/Marker",
        "visualization_msgs/msg/MarkerArray",
    }
)
"""Types that show something and command nothing, whoever publishes them."""

COMMANDS_WORDS = (
    "with --commands: a live session treats these topics like any other source of the network: it "
    "takes from them what its arming sequence and its authority allow"
)

MEET_S = 2.0
"""Longest wait for other nodes, before anything is published."""

SETTLE_S = 0.3
"""After that: how long others take to subscribe to topics that are new to them."""


class ReplayReport(NamedTuple):
    """What was published."""

    messages: int
    topics: tuple[str, ...]
    held_back: Mapping[str, str]
    """Topics that were not published, and why."""
    problems: tuple[str, ...] = ()
    """What is wrong with the file: damage, and why it has no end."""

    @property
    def complete(self) -> bool:
        """Whether there were messages, and nothing is wrong with the file."""
        return self.messages > 0 and not self.problems

    def lines(self) -> list[str]:
        """For people."""
        return [f"{self.messages} messages of {len(self.topics)} topics", *self.problems]


class _Contents(NamedTuple):
    topics: list[RecordedTopic]
    first_ns: int


def _look_through(path: Path) -> _Contents:
    topics: dict[RecordedTopic, None] = {}
    first_ns = None
    reader = RecordReader(path)
    for message in reader:
        topics.setdefault(message.topic)
        if first_ns is None or message.log_ns < first_ns:
            first_ns = message.log_ns
    if first_ns is None:
        why = "; ".join(("", *reader.problems))
        raise CaptureError(f"{path} has no messages{why}")
    return _Contents(list(topics), first_ns)


def arms_of(topics: Iterable[RecordedTopic]) -> frozenset[str]:
    """The nodes of a record that are sessions of Cardan's."""
    return frozenset(
        publisher
        for topic in topics
        for publisher in topic.publishers
        if topic.name == publisher + CONFIGURATION
    )


def why_held_back(topic: RecordedTopic, arms: frozenset[str], network: BusNetwork | None) -> str:
    """Why a topic is not published unless it is asked for; empty where it is."""
    if network is not None:
        there = network.topics().get(topic.name)
        if there is not None:
            live = [node for node in there.publishers if node != network.node.full_name]
            if live:
                return f"{', '.join(live)} publishes it now"
            sessions = {
                name.removesuffix(f"/{ASK_SERVICE}")
                for name in network.services()
                if name.endswith(f"/{ASK_SERVICE}")
            }
            if taken := sessions.intersection(there.subscribers):
                return f"{', '.join(sorted(taken))} takes commands from it"
    if topic.publishers and arms.issuperset(topic.publishers):
        return ""
    if topic.type_name in SHOWING_TYPES:
        return ""
    return "it may command something: no arm of the record published it to show its state"


def replay(
    path: Path,
    options: BusOptions,
    *,
    rate: float = 1.0,
    topics: Sequence[str] = (),
    commands: bool = False,
    say: Callable[[str], None] = print,
) -> ReplayReport:
    """Publish a record until its end, SIGINT or SIGTERM.

    `rate`: 2: twice as fast; `topics`: names, where * stands for anything; none: all. `commands`:
    those, too, that are held back otherwise. `say` is told what is held back before anything is
    published. Raises CaptureError, OptionError, or what opening the bus raises.
    """
    if not 0.0 < rate < math.inf:
        raise OptionError("--rate", rate, "a number above 0")
    contents = _look_through(path)
    wanted = [topic for topic in contents.topics if _is_among(topic.name, topics)]
    if not wanted:
        names = ", ".join(sorted({topic.name for topic in contents.topics}))
        raise OptionError("--topics", ", ".join(topics), f"topics of the record: {names}")
    arms = arms_of(contents.topics)
    with interruptible() as interrupted, BusNetwork(options, NAME) as network:
        _meet(network, interrupted)
        held_back: dict[str, str] = {}
        publishers: dict[RecordedTopic, Publisher] = {}
        for topic in wanted:
            why = "" if commands else why_held_back(topic, arms, network)
            try:
                if not why:
                    publishers[topic] = _advertise(network, topic)
            except NetworkError as error:
                why = str(error)
            if why:
                held_back[topic.name] = why
        for name, why in sorted(held_back.items()):
            say(f"not published: {name}: {why}" + ("" if commands else " (--commands)"))
        if commands:
            say(COMMANDS_WORDS)
        interrupted.wait(SETTLE_S)
        reader = RecordReader(path)
        whole = until_damage(reader) if commands else iter(reader)
        count = _publish(whole, publishers, contents.first_ns, rate, interrupted)
        problems = reader.problems
        if commands and reader.damage:
            problems.append("no command is replayed from there on (--commands)")
        published = tuple(sorted(each.name for each in publishers))
        return ReplayReport(count, published, held_back, tuple(problems))


def until_damage(reader: RecordReader) -> Iterator[RecordedMessage]:
    """What comes before the first damage: an arm that misses commands does others than recorded."""
    for message in reader:
        if reader.damage:
            return
        yield message


def _is_among(name: str, topics: Sequence[str]) -> bool:
    return not topics or any(fnmatch.fnmatchcase(name, each) for each in topics)


def _meet(network: BusNetwork, interrupted: threading.Event) -> None:
    end_s = time.monotonic() + MEET_S
    while network.lonely() and time.monotonic() < end_s and not interrupted.wait(0.05):
        pass
    interrupted.wait(SETTLE_S)  # What there is comes one by one.


def _advertise(network: BusNetwork, topic: RecordedTopic) -> Publisher:
    known = known_definition(topic.type_name, topic.type_hash)
    mark = "" if known else topic.type_hash
    return network.advertise(topic.name, topic.type_name, topic.latched, mark)


def _publish(
    messages: Iterable[RecordedMessage],
    publishers: Mapping[RecordedTopic, Publisher],
    first_ns: int,
    rate: float,
    interrupted: threading.Event,
) -> int:
    began_s, count = time.monotonic(), 0
    for message in messages:
        publisher = publishers.get(message.topic)
        if publisher is None:
            continue
        due_s = began_s + (message.log_ns - first_ns) / (1e9 * rate)
        left_s = due_s - time.monotonic()
        if left_s > 0.0:
            interrupted.wait(left_s)
        if interrupted.is_set():
            break
        publisher.publish(message.data)
        count += 1
    return count
