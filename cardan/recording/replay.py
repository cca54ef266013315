"""Replay of a record onto the bus, with the original names and timing.

Commands that could move an arm are withheld unless the user requests them. The receiver then treats
them like any other program's: a session checks its arming sequence and authority.
"""

from __future__ import annotations

import fnmatch
import itertools
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from cardan.bus.network import NetworkError, PublisherHandle
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
"""Types that only report, and command nothing, from any publisher."""

COMMANDS_WORDS = (
    "with --commands: a live session treats these topics like any other source of the network: it "
    "takes from them what its arming sequence and its authority allow"
)

MEET_S = 2.0
"""Longest wait for other nodes before publishing, s."""

STEP_NS = 1_000_000_000
"""Shortest step of a record's time that may be a clock adjustment: threads and disks delay messages
written in succession by less."""

LONGEST_PAUSE_S = 60.0
"""Default of the longest pause that is replayed, s."""

MOST_STEPS = 5
"""Most steps that are reported one by one."""

SETTLE_S = 0.3
"""Time for other nodes to subscribe to new topics after that, s."""


class ReplayReport(NamedTuple):
    """Summary of the published messages."""

    messages: int
    topics: tuple[str, ...]
    held_back: Mapping[str, str]
    """Topics that were not published, and the reasons."""
    problems: tuple[str, ...] = ()
    """Problems of the file: damage, a missing end, and steps of its time."""

    @property
    def complete(self) -> bool:
        """True if there were messages and the file has no fault."""
        return self.messages > 0 and not self.problems

    def lines(self) -> list[str]:
        """Return the summary as lines of text."""
        return [f"{self.messages} messages of {len(self.topics)} topics", *self.problems]


def _topics_in(path: Path) -> list[RecordedTopic]:
    topics: dict[RecordedTopic, None] = {}
    reader = RecordReader(path)
    for message in reader:
        topics.setdefault(message.topic)
    if not topics:
        why = "; ".join(("", *reader.problems))
        raise CaptureError(f"{path} has no messages{why}")
    return list(topics)


class Schedule:
    """Due times of messages: as recorded, except at steps of the record's time that are no
    pause."""

    def __init__(self, longest_pause_s: float = LONGEST_PAUSE_S) -> None:
        self._longest_ns = longest_pause_s * 1e9
        self._words: list[str] = []
        self._steps = 0

    @property
    def steps(self) -> list[str]:
        """Steps that were skipped, in words."""
        more = self._steps - len(self._words)
        return [*self._words, f"and {more} more steps of its time"] if more else self._words

    def of(self, messages: Iterable[RecordedMessage]) -> Iterator[tuple[float, RecordedMessage]]:
        """Yield messages with their due times, s after the first."""
        first_ns = newest_ns = None
        for message, following in _with_following(messages):
            log_ns = message.log_ns
            if first_ns is None or newest_ns is None:
                first_ns = newest_ns = log_ns
            step_ns = log_ns - newest_ns
            if why := self._why_none(step_ns, log_ns, following):
                self._tell((newest_ns - first_ns) / 1e9, step_ns / 1e9, why)
                first_ns += step_ns
                newest_ns = log_ns
            newest_ns = max(newest_ns, log_ns)
            yield (log_ns - first_ns) / 1e9, message

    def _why_none(self, step_ns: int, log_ns: int, following: RecordedMessage | None) -> str:
        if step_ns < -STEP_NS:
            return "a clock was set"
        if step_ns > STEP_NS and following is not None and following.log_ns < log_ns - STEP_NS:
            return "the next message has an earlier time: a clock was set"
        if step_ns > self._longest_ns:
            return "a clock was set, or nothing was published (--longest-pause)"
        return ""

    def _tell(self, at_s: float, step_s: float, why: str) -> None:
        self._steps += 1
        if len(self._words) < MOST_STEPS:
            self._words.append(
                f"its clock steps by {step_s:+.1f} s after {at_s:.1f} s, and replay does not "
                f"wait for it: {why}"
            )


def _with_following(
    messages: Iterable[RecordedMessage],
) -> Iterator[tuple[RecordedMessage, RecordedMessage | None]]:
    newest = None
    for message in messages:
        if newest is not None:
            yield newest, message
        newest = message
    if newest is not None:
        yield newest, None


def arms_of(topics: Iterable[RecordedTopic]) -> frozenset[str]:
    """Nodes of a record that are Cardan sessions."""
    return frozenset(
        publisher
        for topic in topics
        for publisher in topic.publishers
        if topic.name == publisher + CONFIGURATION
    )


def why_held_back(topic: RecordedTopic, arms: frozenset[str], network: BusNetwork | None) -> str:
    """Return the reason why a topic is not published by default; empty if it is."""
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
    longest_pause_s: float = LONGEST_PAUSE_S,
    say: Callable[[str], None] = print,
) -> ReplayReport:
    """Publish a record until its end, SIGINT or SIGTERM.

    `rate`: 2 is twice as fast. `topics`: names with the wildcard *; empty: all. `commands`: True
    publishes withheld topics, too. `longest_pause_s`: longer pauses of the record are skipped.
    `say` receives the withheld topics before any message is published. Raises CaptureError,
    OptionError, or an error of opening the bus.
    """
    if not 0.0 < rate < math.inf:
        raise OptionError("--rate", rate, "a number above 0")
    if not longest_pause_s > 0.0:
        raise OptionError("--longest-pause", longest_pause_s, "a number above 0")
    recorded = _topics_in(path)
    wanted = [topic for topic in recorded if _is_among(topic.name, topics)]
    if not wanted:
        names = ", ".join(sorted({topic.name for topic in recorded}))
        raise OptionError("--topics", ", ".join(topics), f"topics of the record: {names}")
    arms = arms_of(recorded)
    with interruptible() as interrupted, BusNetwork(options, NAME) as network:
        _meet(network, interrupted)
        held_back: dict[str, str] = {}
        publishers: dict[RecordedTopic, Iterator[PublisherHandle]] = {}
        for topic in wanted:
            why = "" if commands else why_held_back(topic, arms, network)
            try:
                if not why:
                    publishers[topic] = itertools.cycle(_advertise(network, topic))
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
        schedule = Schedule(longest_pause_s)
        count = _publish(schedule.of(whole), publishers, rate, interrupted)
        problems = [*reader.problems, *schedule.steps]
        if commands and reader.damage:
            problems.append("no command is replayed from there on (--commands)")
        published = tuple(sorted({each.name for each in publishers}))
        return ReplayReport(count, published, held_back, tuple(problems))


def until_damage(reader: RecordReader) -> Iterator[RecordedMessage]:
    """Yield messages before the first damage: without lost commands an arm would move
    differently."""
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
    interrupted.wait(SETTLE_S)  # Peers are discovered one by one.


def _advertise(network: BusNetwork, topic: RecordedTopic) -> list[PublisherHandle]:
    """Declare publishers: one, or, if several nodes published a latched topic, one for each, so
    that late subscribers get each one's last message."""
    known = known_definition(topic.type_name, topic.type_hash)
    mark = "" if known else topic.type_hash
    count = len(topic.publishers) if topic.latched else 1
    return [
        network.advertise(topic.name, topic.type_name, topic.latched, mark)
        for _ in range(max(1, count))
    ]


def _publish(
    messages: Iterable[tuple[float, RecordedMessage]],
    publishers: Mapping[RecordedTopic, Iterator[PublisherHandle]],
    rate: float,
    interrupted: threading.Event,
) -> int:
    began_s, count = time.monotonic(), 0
    for due_s, message in messages:
        turns = publishers.get(message.topic)
        if turns is None:
            continue
        left_s = began_s + due_s / rate - time.monotonic()
        if left_s > 0.0:
            interrupted.wait(left_s)
        if interrupted.is_set():
            break
        next(turns).publish(message.data)
        count += 1
    return count
