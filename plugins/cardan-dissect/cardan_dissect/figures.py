"""Figures of the messages from one sender to one receiver."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator, Mapping

from cardan.common.histogram import LatencyHistogram
from cardan_dissect.reader import Message

MODULUS = 2**32
HALF = MODULUS // 2
RESTART_JUMP = 2**16
"""A number this far ahead belongs to another session and is not loss: over four minutes at 250
Hz."""
REMEMBERED = 1024
"""Numbers remembered to detect duplicates and late ones; four seconds at 250 Hz."""
PENDING = 256
"""Messages searched for the request of an answer: one second at 250 Hz."""
MOST_TEXTS = 64
"""Most different texts that are counted separately; further ones are counted together."""
OTHERS = "others"


class Intervals:
    """Mean, minimum and maximum of the times between instants."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._count = self._sum_ns = self._max_ns = 0
        self._min_ns = math.inf

    def add(self, time_ns: int) -> None:
        """Add an instant."""
        last, self._last_ns = self._last_ns, time_ns
        if last is None:
            return
        interval = time_ns - last
        self._count += 1
        self._sum_ns += interval
        if interval > self._max_ns:
            self._max_ns = interval
        if interval < self._min_ns:
            self._min_ns = interval

    def pause(self) -> None:
        """Exclude the next interval."""
        self._last_ns = None

    def __str__(self) -> str:
        if not self._count:
            return ""
        mean = milliseconds(self._sum_ns / self._count)
        extremes = f"min {milliseconds(self._min_ns)} max {milliseconds(self._max_ns)}"
        return f", period mean {mean} {extremes} ms"


class Sequence:
    """Detects loss, duplicates, reordering and restarts by sequence numbers modulo 2**32."""

    def __init__(self) -> None:
        self.duplicates = self.repeated = self.late = self.restarts = 0
        self._last: int | None = None
        self._seen: dict[int, int] = {}
        """Hashes of the datagrams, by their numbers modulo REMEMBERED."""
        self._missing: deque[int] = deque(maxlen=REMEMBERED)
        self._steps: Counter[int] = Counter()
        self.step = 1
        """The usual step; some older Python clients count by two."""
        self._recovered = 0

    def add(self, seqno: int, datagram: bytes) -> str:
        """Add a datagram; return "" (as usual), "gap", "duplicate", "repeated" (the seqno, with
        other content), "late" or "restart"."""
        content, verdict = hash(datagram), ""
        last = self._last
        if last is None:
            self._last = seqno
        elif seqno - last == self.step == 1:
            self._last = seqno
            self._steps[1] += 1
        else:
            step = seqno - last
            if not 0 < step < RESTART_JUMP:
                step = (step + HALF) % MODULUS - HALF
            if 0 < step < RESTART_JUMP:
                self._last, verdict = seqno, self._ahead(last, step)
            else:
                verdict = self._odd(seqno, step, content)
        self._seen[seqno % REMEMBERED] = content
        return verdict

    def _ahead(self, last: int, step: int) -> str:
        self._steps[step] += 1
        if step > 1:
            for skipped in range(max(1, step - REMEMBERED), step):
                self._missing.append((last + skipped) % MODULUS)
        if step != self.step:
            self.step = self._steps.most_common(1)[0][0]
        return "" if step == self.step else "gap"

    def _odd(self, seqno: int, step: int, content: int) -> str:
        if self._seen.get(seqno % REMEMBERED) == content:
            self.duplicates += 1
            return "duplicate"
        if step == 0:
            self.repeated += 1
            return "repeated"
        if step < 0 and seqno in self._missing:
            self.late += 1
            self._recovered += 1
            self._missing.remove(seqno)
            return "late"
        self.restarts += 1
        self._seen.clear()
        self._missing.clear()
        self._last = seqno
        return "restart"

    @property
    def lost(self) -> int:
        """Number of datagrams that never arrived, by the usual step."""
        skipped = sum(max(0, step // self.step - 1) * n for step, n in self._steps.items())
        return max(0, skipped - self._recovered)

    def __str__(self) -> str:
        text = f"lost {self.lost} duplicate {self.duplicates} out of order {self.late}"
        if self.repeated:
            text += f" repeated with other content {self.repeated}"
        text += f" restarts {self.restarts}"
        return text + (f" (steps by {self.step})" if self.step > 1 else "")


def milliseconds(duration_ns: float) -> str:
    """Format a duration with three digits after the point, without unit."""
    return f"{duration_ns / 1e6:.3f}"


def tally(counter: Counter[str]) -> str:
    """Format texts and their counts, the most frequent first."""
    return ", ".join(f"{text} x{count}" for text, count in counter.most_common())


def bounded(counted: Mapping[str, object], text: str) -> str:
    """Return `text`, or others: a damaged capture has a new text in every message."""
    return text if text in counted or len(counted) < MOST_TEXTS else OTHERS


def count(counter: Counter[str], text: str) -> None:
    """Count `text`, separately or with the others."""
    counter[bounded(counter, text)] += 1


class _Kind:
    """Messages of one title."""

    def __init__(self) -> None:
        self.count = 0
        self.intervals = Intervals()
        self.sequence: Sequence | None = None


class Figures:
    """Figures of messages: number, intervals, losses, and times to answers."""

    def __init__(self, other_way: Figures | None) -> None:
        self._other_way = other_way
        """Figures of the messages that are answered."""
        if other_way is not None:
            other_way._other_way = self
        self.messages = 0
        self._kinds: dict[str, _Kind] = {}
        self._malformed: Counter[str] = Counter()
        self._remarks: Counter[str] = Counter()
        self._answers = LatencyHistogram()
        self._asked_ns: dict[int, int] = {}
        """Arrival times of unanswered messages."""
        self._newest_ns: int | None = None
        """Arrival time of the newest of them."""

    def add(self, message: Message) -> tuple[str, ...]:
        """Add a message; return remarks about it."""
        packet, _, (value, title, fault, seqno, asks, answers, remarks), data, _ = message
        self.messages += 1
        if fault:
            count(self._malformed, fault.partition(":")[0])
            return ()
        time_ns = packet.time_ns
        title = title or type(value).__name__
        kind = self._kinds.get(title)
        if kind is None:
            title = bounded(self._kinds, title)
            kind = self._kinds.setdefault(title, _Kind())
        kind.count += 1
        for remark in remarks:
            count(self._remarks, remark)
        verdict = ""
        if seqno is not None:
            if kind.sequence is None:
                kind.sequence = Sequence()
            verdict = kind.sequence.add(seqno, data)
        if verdict == "restart":
            kind.intervals.pause()
        if verdict not in ("duplicate", "repeated", "late"):
            kind.intervals.add(time_ns)
        if verdict != "duplicate":
            if asks is not None:
                self._asked_ns[asks] = time_ns
                if len(self._asked_ns) >= PENDING:
                    del self._asked_ns[next(iter(self._asked_ns))]
            self._newest_ns = time_ns
        other_way = self._other_way
        if other_way is not None:
            if answers is not None:
                asked_ns = other_way._asked_ns.pop(answers, None)
            else:
                asked_ns, other_way._newest_ns = other_way._newest_ns, None
            if asked_ns is not None:
                self._answers.add((time_ns - asked_ns) / 1e9)
        return (f"SEQUENCE {verdict.upper()}",) if verdict else ()

    @property
    def malformed(self) -> int:
        """Number of malformed messages."""
        return self._malformed.total()

    def __iter__(self) -> Iterator[str]:
        yield f"  {self.messages} messages"
        for title, kind in sorted(self._kinds.items(), key=lambda each: -each[1].count):
            intervals = kind.intervals if title != OTHERS else ""
            sequence = f", {kind.sequence}" if kind.sequence is not None else ""
            yield f"  {title} x{kind.count}{intervals}{sequence}"
        for label, counter in (("malformed", self._malformed), ("remarks", self._remarks)):
            if counter:
                yield f"  {label}: {tally(counter)}"
        if self._answers.count:
            median, p99 = (milliseconds(1e9 * self._answers.percentile(p)) for p in (50, 99))
            yield f"  answers x{self._answers.count}, after: median {median} p99 {p99} ms"
