"""Statistics of a flow's datagrams."""

from __future__ import annotations

import math
from array import array
from collections import Counter, OrderedDict, deque
from collections.abc import Iterator

SEQNO_MODULUS = 2**32
RESTART_JUMP = 2**16
"""A seqno this far ahead is another session, not loss: over four minutes at 250 Hz."""
REMEMBERED = 1024
"""Datagrams remembered to tell duplicates and late ones; four seconds at 250 Hz."""


class Intervals:
    """Mean, minimum and maximum of the times between instants."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._count = self._sum_ns = self._max_ns = 0
        self._min_ns: int | None = None

    def add(self, time_ns: int) -> int | None:
        """One more instant; the interval that ends there."""
        last, self._last_ns = self._last_ns, time_ns
        if last is None:
            return None
        interval = time_ns - last
        self._count += 1
        self._sum_ns += interval
        self._max_ns = max(self._max_ns, interval)
        self._min_ns = interval if self._min_ns is None else min(self._min_ns, interval)
        return interval

    def pause(self) -> None:
        """The next interval is not one."""
        self._last_ns = None

    def __str__(self) -> str:
        if self._min_ns is None:
            return "period -"
        mean = milliseconds(self._sum_ns / self._count)
        extremes = f"min {milliseconds(self._min_ns)} max {milliseconds(self._max_ns)}"
        return f"period mean {mean} {extremes} ms"


class Latencies:
    """Median and 99th percentile of durations."""

    def __init__(self) -> None:
        self._ns = array("q")

    def add(self, duration_ns: int) -> None:
        """One more duration."""
        self._ns.append(duration_ns)

    def __len__(self) -> int:
        return len(self._ns)

    def quantile_ns(self, fraction: float) -> int:
        """The smallest duration that `fraction` of all do not exceed."""
        return sorted(self._ns)[max(0, math.ceil(fraction * len(self._ns)) - 1)]

    def __str__(self) -> str:
        if not self._ns:
            return "-"
        median, p99 = (milliseconds(self.quantile_ns(q)) for q in (0.5, 0.99))
        return f"median {median} p99 {p99} ms"


class Sequence:
    """Tells loss, duplicates, reordering and restarts from sequence numbers modulo 2**32."""

    def __init__(self) -> None:
        self.duplicates = self.repeated = self.late = self.restarts = 0
        self._last: int | None = None
        self._seen: OrderedDict[int, int] = OrderedDict()  # seqno -> hash of its datagram
        self._missing: deque[int] = deque(maxlen=REMEMBERED)
        self._steps: Counter[int] = Counter()
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
        step = (seqno - self._last + SEQNO_MODULUS // 2) % SEQNO_MODULUS - SEQNO_MODULUS // 2
        if 0 < step < RESTART_JUMP:
            self._steps[step] += 1
            for skipped in range(max(1, step - REMEMBERED), step):
                self._missing.append((self._last + skipped) % SEQNO_MODULUS)
            return "next" if step == self.step else "gap"
        if self._seen.get(seqno) == content:
            return "duplicate"
        if step == 0:
            return "repeated"
        return "late" if step < 0 and seqno in self._missing else "restart"

    @property
    def step(self) -> int:
        """The usual step; some older Python clients count by two."""
        return self._steps.most_common(1)[0][0] if self._steps else 1

    @property
    def lost(self) -> int:
        """Datagrams that never came, by the usual step."""
        skipped = sum(max(0, step // self.step - 1) * n for step, n in self._steps.items())
        return max(0, skipped - self._recovered)

    def __str__(self) -> str:
        text = f"lost {self.lost} duplicate {self.duplicates} out of order {self.late}"
        if self.repeated:
            text += f" repeated with other content {self.repeated}"
        return text + (f" (seqno steps by {self.step})" if self.step > 1 else "")


def milliseconds(duration_ns: float) -> str:
    """A duration with three digits after the point, without unit."""
    return f"{duration_ns / 1e6:.3f}"


def tally(counter: Counter[str]) -> str:
    """Texts and how often each was seen, the most frequent first."""
    return ", ".join(f"{text} x{count}" for text, count in counter.most_common())


def tallies(indent: str, *labelled: tuple[str, Counter[str]]) -> Iterator[str]:
    """A line for each counter that counted something."""
    for label, counter in labelled:
        if counter:
            yield f"{indent}{label}: {tally(counter)}"
