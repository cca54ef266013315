"""Rules that must hold at all times under any fault. Time is an argument; no clock is read.

All times are monotonic s. The true motion of the robots is compared with the soak's own requests
and with the sessions' reports. Each violation is reported once.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

REST_RAD_S: Final = 0.005
"""Speed below which a joint is at rest: servos settle, and measured positions are rounded."""

AT_REST_S: Final = 3.0
"""Time from the end of the last request for motion until the arm must be at rest. Ramps take less
than 1 s, and the slowest controller detects the end of its session within 1 s; the rest is margin
for a busy computer."""

REPORT_S: Final = 1.5
"""Longest delay of a session's report of a motion: reports are sent ten times a second and pass
through two other processes."""

RECOVERED_S: Final = 180.0
"""Longest recovery after a fault. The daemon waits up to 30 s between starts, and a session takes
as long to start on a busy computer."""

ANSWER_S: Final = 10.0
"""Time limit for an answer of the daemon, as its own clients have it."""

MOVED: Final = frozenset({"braking", "recovering"})
"""Phases in which an arm moves although no source has the authority."""

ENGAGED: Final = frozenset({"holding", "moving"})
"""Phases of an arm that a source moves, or may move immediately."""


class Violation(NamedTuple):
    """Violation of a rule."""

    time_s: float
    rule: str
    who: str
    why: str


Found = Callable[[Violation], None]


class SessionReport(NamedTuple):
    """Report of a session's state."""

    time_s: float
    pid: int
    authority: str
    phase: str


class ArmRules:
    """The rules of one arm."""

    def __init__(self, name: str, sources: frozenset[str], found: Found) -> None:
        """`sources`: names that may have the authority over the arm."""
        self.name, self._sources, self._found = name, sources, found
        self._asking: set[str] = set()
        self._nobody_s = -math.inf
        """Time since which no source requests motion."""
        self._act_s = -math.inf
        """Time when a source last began to request motion."""
        self._reports: deque[SessionReport] = deque(maxlen=400)
        self._began_s: dict[int, float] = {}
        """Time of the first report of each process of the session."""
        self._broken: set[str] = set()
        """Rules that are broken now."""
        self.moving_s = 0.0
        self.moves = 0
        self._measured_s = -math.inf
        self._moving = False
        self._moving_since_s = -math.inf
        self._motions: dict[str, float] = {}

    # -- the soak's own actions
    # ----------------------------------------------------------------------

    def asks(self, who: str, now_s: float) -> None:
        """Note that a source re-arms the arm and may move it from now on."""
        self._asking.add(who)
        self._act_s = now_s

    def lets_go(self, who: str, now_s: float) -> None:
        """Note that the source no longer requests motion."""
        if who in self._asking:
            self._asking.discard(who)
            if not self._asking:
                self._nobody_s = now_s

    def void(self, now_s: float) -> None:
        """Note that a fault has ended all requests: motion needs a new re-arming."""
        for who in tuple(self._asking):
            self.lets_go(who, now_s)

    def resumes(self, now_s: float) -> None:
        """Note that the robot was stopped and now continues its remaining motion."""
        self._nobody_s = max(self._nobody_s, now_s)
        self._moving = False

    def accepted(self, source: str, now_s: float) -> None:
        """Note that a source was given an endless motion."""
        others = [each for each in self._motions if each != source]
        self._motions[source] = now_s
        if others:
            self._break("two sources", now_s, f"{source} moves it beside {', '.join(others)}")
        else:
            self._mend("two sources")

    def over(self, source: str) -> None:
        """Note that the source's motion has ended."""
        self._motions.pop(source, None)

    # -- observations
    # --------------------------------------------------------------------------------

    def begins(self, now_s: float) -> None:
        """Note that the robot is a new process: its position may differ."""
        self._measured_s = now_s
        self._moving = False

    def measured(self, now_s: float, speed_rad_s: float) -> None:
        """Check the robot's true speed: that of its fastest joint."""
        moving = speed_rad_s > REST_RAD_S
        if moving:
            if not self._moving:
                self.moves += 1
                self._moving_since_s = now_s
            if self._measured_s > -math.inf:
                self.moving_s += min(now_s - self._measured_s, REPORT_S)
        self._moving, self._measured_s = moving, now_s
        if not moving:
            self._mend("moves unasked")
            self._mend("moves without authority")
            return
        if not self._asking and now_s - self._nobody_s > AT_REST_S:
            since_s = now_s - self._nobody_s
            self._break(
                "moves unasked",
                now_s,
                f"at {speed_rad_s:.3f} rad/s, {since_s:.1f} s after the last one asked; "
                f"{self._state()}",
            )
        lately = [each for each in self._reports if each.time_s > now_s - REPORT_S]
        covered = len(lately) >= 2 and lately[0].time_s < now_s - REPORT_S / 2
        whole = now_s - self._moving_since_s > REPORT_S
        if covered and whole and not any(each.authority or each.phase in MOVED for each in lately):
            self._break(
                "moves without authority", now_s, f"at {speed_rad_s:.3f} rad/s; {self._state()}"
            )

    def on_report(self, report: SessionReport) -> None:
        """Check a new snapshot of the arm's session."""
        began_s = self._began_s.setdefault(report.pid, report.time_s)
        self._reports.append(report)
        if report.authority and report.authority not in self._sources:
            self._break("unknown source", report.time_s, f"{report.authority!r} has the authority")
        else:
            self._mend("unknown source")
        engaged = bool(report.authority) and report.phase in ENGAGED
        if engaged and not self._asking and self._act_s < began_s:
            self._break(
                "armed by itself",
                report.time_s,
                f"{report.authority!r} has it, {report.phase}, though nobody acted since process "
                f"{report.pid} began {report.time_s - began_s:.1f} s ago",
            )
        elif not engaged:
            self._mend("armed by itself")

    def _state(self) -> str:
        if not self._reports:
            return "its session has told nothing"
        last = self._reports[-1]
        return f"told at {last.time_s:.1f}: authority {last.authority!r}, {last.phase}"

    def _break(self, rule: str, now_s: float, why: str) -> None:
        if rule not in self._broken:
            self._broken.add(rule)
            self._found(Violation(now_s, rule, self.name, why))

    def _mend(self, rule: str) -> None:
        self._broken.discard(rule)


class RecoveryRule:
    """Checks that every session and server recovers within RECOVERED_S after a fault."""

    def __init__(self, found: Found) -> None:
        self._found = found
        self._unwell_s: dict[str, float] = {}
        self._reports: set[str] = set()
        self.took_s: list[tuple[str, float]] = []
        """Every recovery: name and duration."""

    def seen(self, who: str, problem: str, excused: bool, now_s: float) -> None:
        """Check a state: `problem` is empty if all is well; `excused`: a fault makes a problem
        inevitable."""
        if not problem:
            since_s = self._unwell_s.pop(who, None)
            self._reports.discard(who)
            if since_s is not None and since_s < now_s:
                self.took_s.append((who, now_s - since_s))
            return
        if excused:
            self._unwell_s[who] = now_s
            return
        since_s = self._unwell_s.setdefault(who, now_s)
        if now_s - since_s > RECOVERED_S and who not in self._reports:
            self._reports.add(who)
            self._found(
                Violation(now_s, "does not recover", who, f"{problem} for {now_s - since_s:.0f} s")
            )


def problem_of(row: Mapping[str, Any], device_there: bool) -> str:
    """Return the problem of a session or server from its row; empty: none. A device is expected to
    be live if it is `device_there` and held by this session."""
    if row["state"] != "running":
        return f"{row['state']}: {row['reason']}"
    if row["kind"] == "server":
        return "" if row["endpoint"] else "it does not serve"
    if row["robot_link"] != "live":
        return f"robot {row['robot_link'] or 'not heard of'}"
    if row["phase"] in ("", "no robot"):
        return f"the robot is not ready: {row['why']}"
    if device_there and row["device_held"] and row["device_link"] != "live":
        return f"device {row['device_link'] or 'not heard of'}"
    return ""


class Limit(NamedTuple):
    """Largest growth of a figure from the first quarter of a process's life to the last."""

    share: float
    more: float
    why: str

    def exceeded(self, first: float, last: float) -> bool:
        """Return True if the figure has grown by more."""
        return last > first * (1.0 + self.share) + self.more


LIMITS: Final = {
    "rss_mb": Limit(0.05, 2.0, "memory: a leak of 1 kB a second is 7 MB in two hours"),
    "fds": Limit(0.0, 4.0, "descriptors: connections that come and go are a few at a time"),
    "threads": Limit(0.0, 2.0, "threads: one for a connection that is just being closed"),
    "p99_ms": Limit(1.0, 2.0, "p99 of the cycle: other programs share the processors"),
}
"""Growth limits; a figure is its median over a quarter of the process's life."""

WARM_UP_S: Final = 120.0
"""Time at the start that is ignored: processes import modules and fill buffers of limited size."""

LONG_S: Final = 600.0
"""Shortest life of a process whose growth is judged."""


class Drift(NamedTuple):
    """Change of a figure over a process's life."""

    who: str
    pid: int
    figure: str
    lived_s: float
    first: float
    last: float
    exceeded: bool


def drifts(
    who: str, pid: int, samples: Sequence[tuple[float, Mapping[str, float]]], long_s: float = LONG_S
) -> list[Drift]:
    """Return the changes of a process's figures; `samples`: its samples by time."""
    if not samples or samples[-1][0] - samples[0][0] < long_s:
        return []
    begin_s = samples[0][0] + min(WARM_UP_S, long_s / 4)
    end_s = samples[-1][0]
    quarter_s = (end_s - begin_s) / 4
    found = []
    for figure, limit in LIMITS.items():
        first = [
            s[figure] for t, s in samples if begin_s <= t <= begin_s + quarter_s if figure in s
        ]
        last = [s[figure] for t, s in samples if t >= end_s - quarter_s if figure in s]
        if first and last:
            a, b = median(first), median(last)
            lived_s = end_s - samples[0][0]
            found.append(Drift(who, pid, figure, lived_s, a, b, limit.exceeded(a, b)))
    return found


def median(values: list[float]) -> float:
    """Return the median; of an even number of values the upper one."""
    return sorted(values)[len(values) // 2]


def quantile_s(before: list[int], now: list[int], count: int, bounds_s: tuple[float, ...],
               share: float) -> float:  # fmt: skip
    """Return the quantile of the durations counted between two states of a cumulative histogram, s.
    It is interpolated between bounds, and is the last bound beyond that. `count`: number of all
    durations, including those beyond the bounds; without any the result is NaN."""
    if count <= 0:
        return math.nan
    wanted, below, lower_s = share * count, 0, 0.0
    for bound_s, old, new in zip(bounds_s, before, now, strict=True):
        within = new - old
        if within >= wanted:
            return lower_s + (bound_s - lower_s) * (wanted - below) / max(within - below, 1)
        below, lower_s = within, bound_s
    return bounds_s[-1]
