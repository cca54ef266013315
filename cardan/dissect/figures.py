"""Figures of the messages from one sender to one receiver."""

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Iterator

from cardan.common.histogram import LatencyHistogram
from cardan.dissect.reader import Message

MODULUS = 2**32
RESTART_JUMP = 2**16
"""A number this far ahead is of another session, not loss: over four minutes at 250 Hz."""
REMEMBERED = 1024
"""Datagrams remembered to tell duplicates and late ones; four seconds at 250 Hz."""
PENDING = 256
"""Messages that an answer is looked for among: one second at 250 Hz."""
MOST_TEXTS = 64
"""Different texts that are counted each; what comes after them is counted together."""


class Intervals:
    """Mean, minimum and maximum of the times between instants."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._count = self._sum_ns = self._max_ns = 0
        self._min_ns: int | None = None

    def add(self, time_ns: int) -> None:
        """One more instant."""
        last, self._last_ns = self._last_ns, time_ns
        if last is None:
            return
        interval = time_ns - last
        self._count += 1
        self._sum_ns += interval
        self._max_ns = max(self._max_ns, interval)
        self._min_ns = interval if self._min_ns is None else min(self._min_ns, interval)

    def pause(self) -> None:
        """The next interval is not one."""
        self._last_ns = None

    def __str__(self) -> str:
        if self._min_ns is None:
            return ""
        mean = milliseconds(self._sum_ns / self._count)
        extremes = f"min {milliseconds(self._min_ns)} max {milliseconds(self._max_ns)}"
        return f", period mean {mean} {extremes} ms"


class Sequence:
    """Tells loss, duplicates, reordering and restarts from sequence numbers modulo 2**32."""

    def __init__(self) -> None:
        self.duplicates = self.repeated = self.late = self.restarts = 0
        self._last: int | None = None
        self._seen: OrderedDict[int, int] = OrderedDict()  # seqno -> hash of its datagram
        self._missing: deque[int] = deque(maxlen=REMEMBERED)
        self._steps: Counter[int] = Counter()
        self.step = 1
        """The usual step; some older Python clients count by two."""
        self._recovered = 0

    def add(self, seqno: int, datagram: bytes) -> str:
        """One more datagram: "first", "next", "gap", "duplicate", "repeated" (the seqno, with
        other content), "late" or "restart"."""
        content = hash(datagram)
        verdict = self._judge(seqno, content)
        if verdict == "restart":
            self.restarts += 1
            self._seen.clear()
            self._missing.clear()
        elif verdict == "duplicate":
            self.duplicates += 1
        elif verdict == "repeated":
            self.repeated += 1
        elif verdict == "late":
            self.late += 1
            self._recovered += 1
            self._missing.remove(seqno)
        if verdict in ("first", "next", "gap", "restart"):
            self._last = seqno
        self._seen[seqno] = content
        if len(self._seen) > REMEMBERED:
            self._seen.popitem(last=False)
        return verdict

    def _judge(self, seqno: int, content: int) -> str:
        if self._last is None:
            return "first"
        half = MODULUS // 2
        step = (seqno - self._last + half) % MODULUS - half
        if 0 < step < RESTART_JUMP:
            self._steps[step] += 1
            if step != self.step:
                self.step = self._steps.most_common(1)[0][0]
            for skipped in range(max(1, step - REMEMBERED), step):
                self._missing.append((self._last + skipped) % MODULUS)
            return "next" if step == self.step else "gap"
        if self._seen.get(seqno) == content:
            return "duplicate"
        if step == 0:
            return "repeated"
        return "late" if step < 0 and seqno in self._missing else "restart"

    @property
    def lost(self) -> int:
        """Datagrams that never came, by the usual step."""
        skipped = sum(max(0, step // self.step - 1) * n for step, n in self._steps.items())
        return max(0, skipped - self._recovered)

    def __str__(self) -> str:
        text = f"lost {self.lost} duplicate {self.duplicates} out of order {self.late}"
        if self.repeated:
            text += f" repeated with other content {self.repeated}"
        text += f" restarts {self.restarts}"
        return text + (f" (steps by {self.step})" if self.step > 1 else "")


def milliseconds(duration_ns: float) -> str:
    """A duration with three digits after the point, without unit."""
    return f"{duration_ns / 1e6:.3f}"


def tally(counter: Counter[str]) -> str:
    """Texts and how often each was seen, the most frequent first."""
    return ", ".join(f"{text} x{count}" for text, count in counter.most_common())


def count(counter: Counter[str], text: str) -> str:
    """One more of `text`, or of others: a damaged capture has a new text in every message."""
    counted = text if text in counter or len(counter) < MOST_TEXTS else "others"
    counter[counted] += 1
    return counted


class Figures:
    """How many messages there were, how often, what was lost, and how long answers took."""

    def __init__(self) -> None:
        self._messages = 0
        self._kinds: Counter[str] = Counter()
        self._intervals: dict[str, Intervals] = {}
        self._malformed: Counter[str] = Counter()
        self._remarks: Counter[str] = Counter()
        self._sequences: dict[str, Sequence] = {}
        self._answers = LatencyHistogram()
        self._asked_ns: dict[int | None, int] = {}
        """When messages came that were not answered yet; None: the newest of them."""

    def add(self, message: Message, title: str, other_way: Figures | None) -> tuple[str, ...]:
        """One more; what is to be said of it."""
        decoded, time_ns = message.decoded, message.packet.time_ns
        self._messages += 1
        if decoded.fault:
            count(self._malformed, decoded.fault.partition(":")[0])
            return ()
        kind = count(self._kinds, title)
        for remark in decoded.remarks:
            count(self._remarks, remark)
        verdict = ""
        if decoded.sequence is not None:
            sequence = self._sequences.get(kind)
            if sequence is None:
                sequence = self._sequences[kind] = Sequence()
            verdict = sequence.add(decoded.sequence, message.data)
        if kind == title:
            intervals = self._intervals.get(title)
            if intervals is None:
                intervals = self._intervals[title] = Intervals()
            if verdict == "restart":
                intervals.pause()
            if verdict not in ("duplicate", "repeated", "late"):
                intervals.add(time_ns)
        if verdict != "duplicate":
            self._asked_ns.pop(None, None)
            if decoded.asks is not None:
                self._asked_ns[decoded.asks] = time_ns
            self._asked_ns[None] = time_ns
            if len(self._asked_ns) > PENDING:
                del self._asked_ns[next(iter(self._asked_ns))]
        if other_way is not None:
            asked_ns = other_way._asked_ns.pop(decoded.answers, None)
            if asked_ns is not None:
                self._answers.add((time_ns - asked_ns) / 1e9)
        return () if verdict in ("", "first", "next") else (f"SEQUENCE {verdict.upper()}",)

    def __iter__(self) -> Iterator[str]:
        yield f"  {self._messages} messages"
        for kind, number in self._kinds.most_common():
            sequence = f", {self._sequences[kind]}" if kind in self._sequences else ""
            yield f"  {kind} x{number}{self._intervals.get(kind, '')}{sequence}"
        for label, counter in (("malformed", self._malformed), ("remarks", self._remarks)):
            if counter:
                yield f"  {label}: {tally(counter)}"
        if self._answers.count:
            median, p99 = (milliseconds(1e9 * self._answers.percentile(p)) for p in (50, 99))
            yield f"  answers x{self._answers.count}, after: median {median} p99 {p99} ms"
