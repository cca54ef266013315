"""Player of a record for display, with seek and rate.

Nothing is published on the bus, and no arm can move by it. As a program, ``python -m
cardan.recording.player FILE``, it reads commands from standard input and writes the messages to
show to standard output, one JSON object per line (docs/recording.md).
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, TextIO

from cardan.common.inbox import Inbox, InboxEmptyError
from cardan.common.text_sanitizer import printable
from cardan.errors import CaptureError, CardanError
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.interfaces import InterfaceError
from cardan.protocols.ros2.messages import json_text
from cardan.recording.mcap_file import RecordedMessage, RecordedTopic, RecordReader

TICK_S: Final = 1 / 30
"""Display period, s; the newest message of each topic is shown."""

BEFORE_NS: Final = 2_000_000_000
"""Span searched for the newest messages before a time: state is published more often."""

MOST_MESSAGE: Final = 2**20
"""Largest message that is shown, bytes: pages draw arms, not point clouds."""

MOST_LATCHED: Final = 16 * 2**20
"""Most bytes of latched messages that are kept."""

MOST_TEXT: Final = 8 * 2**20
"""Most characters shown at once."""

MOST_TOPICS: Final = 1000

NICE: Final = 10
"""Nice value of the process: displaying a record must not delay a process that moves an arm."""

RATES: Final = (0.1, 16.0)
"""Slowest and fastest rate, as a multiple of real time."""


class Contents(NamedTuple):
    """Contents of a record."""

    first_ns: int
    last_ns: int
    """Log times of its first and last messages, ns since the epoch."""
    topics: Mapping[str, tuple[str, int]]
    """Type and message count by topic."""
    cut_off: str
    """Reason why the end of the file is missing; empty if it has one."""
    damage: str
    """Damaged parts that are skipped, in words."""

    @property
    def duration_s(self) -> float:
        """Time from the first message to the last, s."""
        return 1e-9 * (self.last_ns - self.first_ns)


class Show:
    """Position in a record, and the messages to show there. Not thread-safe; has no clock."""

    def __init__(self, path: Path) -> None:
        """Read the file once from end to end. Raises CaptureError if it is no record, or empty."""
        self._reader = RecordReader(path)
        self._latched: list[RecordedMessage] = []
        self.contents = self._look_through()
        self.wanted: frozenset[str] = frozenset()
        """Names of the topics that are shown."""
        self.at_s = 0.0
        """Time since the first message, s."""
        self._coming: Iterator[RecordedMessage] = iter(())
        self._next: RecordedMessage | None = None

    def _look_through(self) -> Contents:
        first_ns, last_ns, retained = 0, -1, 0
        types: dict[str, str] = {}
        counts: Counter[str] = Counter()
        for message in self._reader:
            topic, log_ns = message.topic, message.log_ns
            first_ns = log_ns if last_ns < 0 else min(first_ns, log_ns)
            last_ns = max(last_ns, log_ns)
            if topic.name in types or len(types) < MOST_TOPICS:
                types.setdefault(topic.name, topic.type_name)
                counts[topic.name] += 1
            size = len(message.data)
            if topic.latched and size <= MOST_MESSAGE and retained + size <= MOST_LATCHED:
                retained += size
                self._latched.append(message)
        if last_ns < 0:
            why = "; ".join(("", *self._reader.problems))
            raise CaptureError(f"{self._reader.path.name} has no messages{why}")
        topics = {name: (type_name, counts[name]) for name, type_name in sorted(types.items())}
        return Contents(
            first_ns, last_ns, topics, self._reader.cut_off, "; ".join(self._reader.damage)
        )

    @property
    def over(self) -> bool:
        """True at the end of the record."""
        return self.at_s >= self.contents.duration_s

    def seek(self, at_s: float) -> list[str]:
        """Go to a time, s since the first message; return the newest messages, like `forward`."""
        first_ns = self.contents.first_ns
        self.at_s = min(max(at_s, 0.0), self.contents.duration_s)
        until_ns = first_ns + round(1e9 * self.at_s)
        places = [each for each in self._reader.places if each.log_ns <= until_ns - BEFORE_NS]
        # The first position is read from, too: there are no messages before it.
        place = places[-1] if places else next(iter(self._reader.places), None)
        self._coming = self._reader.messages(place) if place is not None else iter(())
        self._next = next(self._coming, None)
        before = [each for each in self._latched if each.log_ns <= until_ns]
        shown = _texts(each for each in before if each.topic.name in self.wanted)
        latched = {each.topic for each in before}
        return shown + self._newest(until_ns, without=latched)

    def forward(self, to_s: float) -> list[str]:
        """Advance to a time; return the newest message of each topic since, as JSON: [topic,
        message]."""
        self.at_s = min(to_s, self.contents.duration_s)
        return self._newest(self.contents.first_ns + round(1e9 * self.at_s))

    def _newest(self, until_ns: int, without: set[RecordedTopic] | None = None) -> list[str]:
        newest: dict[str, RecordedMessage] = {}
        message = self._next
        while message is not None and message.log_ns <= until_ns:
            topic = message.topic
            if topic.name in self.wanted and not (without and topic in without):
                newest[topic.name] = message
            message = next(self._coming, None)
        self._next = message
        return _texts(newest.values())


def _texts(messages: Iterable[RecordedMessage]) -> list[str]:
    """Decode messages to JSON, up to MOST_TEXT characters; omit undecodable ones."""
    found: list[str] = []
    left = MOST_TEXT
    for each in messages:
        topic = each.topic
        if len(each.data) > MOST_MESSAGE:
            continue
        try:
            decoded = codec_of(topic.type_name).decode(each.data)
        except InterfaceError:
            continue
        if isinstance(decoded, MalformedCdr):
            continue
        text = f"[{json.dumps(topic.name)},{json_text(topic.type_name, decoded)}]"
        left -= len(text)
        if left >= 0:
            found.append(text)
    return found


class Player:
    """Playback of a record by commands, with the time as an argument."""

    def __init__(self, show: Show) -> None:
        self.playing = False
        self._show, self._rate = show, 1.0
        self._began_s = self._from_s = 0.0
        """Clock time at which playback was at `_from_s` of the record."""
        self._changed = False

    def order(self, order: Mapping[str, Any], now_s: float) -> list[str]:
        """Apply a command with the optional keys "topics", "at_s", "rate", "playing". Return the
        messages to show. Raises ValueError for a wrong value."""
        show = self._show
        topics, at_s = order.get("topics"), order.get("at_s")
        rate, playing = order.get("rate"), order.get("playing")
        if topics is not None:
            if not isinstance(topics, list) or not all(isinstance(each, str) for each in topics):
                raise ValueError("topics must be a list of names")
            show.wanted = frozenset(topics[:MOST_TOPICS])
        if rate is not None:
            self._rate = _number("rate", rate, *RATES)
        shown: list[str] = []
        if at_s is not None or topics is not None:
            there = show.at_s if at_s is None else _number("at_s", at_s, 0.0, float("inf"))
            shown = show.seek(there)
        if playing is not None:
            if playing and show.over:
                shown = show.seek(0.0)
            self.playing = bool(playing)
        self._began_s, self._from_s, self._changed = now_s, show.at_s, True
        return shown

    def tick(self, now_s: float) -> list[str]:
        """Return the messages to show now."""
        if not self.playing:
            return []
        shown = self._show.forward(self._from_s + (now_s - self._began_s) * self._rate)
        self._changed = True
        self.playing = not self._show.over
        return shown

    def line(self, shown: Sequence[str]) -> str:
        """Return the page's line with the state and the messages `shown`; empty if nothing
        changed."""
        if not self._changed:
            return ""
        self._changed = False
        state = json.dumps(
            {"at_s": round(self._show.at_s, 4), "playing": self.playing, "rate": self._rate}
        )
        return f'{state[:-1]}, "messages": [{",".join(shown)}]}}'


def _number(name: str, value: object, least: float, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{name} must be a number")
    if not least <= value <= most:
        raise ValueError(f"{name} is {value:g}, must be {least:g} to {most:g}")
    return float(value)


def run(path: Path, orders: TextIO, out: TextIO) -> None:
    """Show a record until the input ends. The first line has its contents, or the problem."""
    try:
        show = Show(path)
    except CardanError as error:
        out.write(json.dumps({"error": printable(str(error))}) + "\n")
        out.flush()
        return
    contents = show.contents
    about = {
        "duration_s": round(contents.duration_s, 4),
        "began_s": round(1e-9 * contents.first_ns, 3),
        "topics": {name: list(each) for name, each in contents.topics.items()},
        "cut_off": printable(contents.cut_off),
        "damage": printable(contents.damage),
    }
    out.write(json.dumps(about) + "\n")
    out.flush()
    waiting: Inbox[str | None] = Inbox()

    def read() -> None:
        for line in orders:
            waiting.put(line)
        waiting.put(None)

    threading.Thread(target=read, name="cardan-commands", daemon=True).start()
    player = Player(show)
    while True:
        try:
            line = waiting.get(TICK_S if player.playing else None)
        except InboxEmptyError:
            said = player.line(player.tick(time.monotonic()))
        else:
            if line is None:
                return
            try:
                order = json.loads(line)
                said = player.line(player.order(order, time.monotonic()))
            except (ValueError, AttributeError) as error:
                said = json.dumps({"refused": printable(str(error))})
        if said:
            out.write(said + "\n")
            out.flush()


if __name__ == "__main__":
    with contextlib.suppress(OSError, AttributeError):
        os.nice(NICE)
    run(Path(sys.argv[1]), sys.stdin, sys.stdout)
