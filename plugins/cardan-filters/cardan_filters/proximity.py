"""Stops or slows the operator's motion when something is near the arm.

The published rule of the AMOR arm (Łukawski, Victores and Balaguer 2023, after Oña et al. 2020):
the level is the largest value of all proximity sensors; above one threshold the motion stops, above
a lower one it is half as fast.

Each program that sends readings is a sender of its own, with a newest reading and an age. The most
cautious one decides, and one that falls silent counts as a silent sensor even if others send:
otherwise a program that sends "nothing near" would replace a dead sensor. A silent sender is
dropped only while the operator requests no motion, so that the arm never continues by itself.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from cardan.common.bounds import Range
from cardan.common.options import require
from cardan.gateway.operator.filters.base import TwistFilter
from cardan.spatial import scale
from cardan.types import NEVER_S, ZERO_TWIST, RobotState, Twist
from cardan_filters.listener import (
    DatagramListener,
    ListenerOptions,
    Sender,
    shown_place,
)
from cardan_filters.readings import Malformed, decode_proximity

SENSOR_LEVEL = Range(0.0, 1e6, "", "no sensor's raw numbers are larger")
READING_AGE_S = Range(
    0.0, 1.0, "s", "at 0.25 m/s the arm is 25 cm further than what was measured", above=True
)

PEAK_READINGS = 5
"""Length of the peak filter's history."""

PEAK_FACTOR = 5.0
"""Factor on the oldest value of the history above which a value is a peak."""


class PeakFilter:
    """Filter that suppresses single spikes: a real rise passes when it has lasted for five
    readings.

    A value of more than five times the oldest of the last five readings is replaced by that oldest
    one, unless the four readings between are that large too. The published filter keeps its own
    output as the history, so that a rise suppressed once is suppressed forever; this filter keeps
    the sensors' readings.
    """

    def __init__(self) -> None:
        self._history: deque[tuple[float, ...]] = deque(maxlen=PEAK_READINGS)

    def apply(self, values: tuple[float, ...]) -> tuple[float, ...]:
        """Return the reading without its spikes; a reading of another length restarts the
        history."""
        history = self._history
        if history and len(history[0]) != len(values):
            history.clear()
        smooth = values
        if len(history) == PEAK_READINGS:
            oldest, *later = history
            smooth = tuple(
                was
                if value > PEAK_FACTOR * was
                and not all(reading[index] > PEAK_FACTOR * was for reading in later)
                else value
                for index, (value, was) in enumerate(zip(values, oldest, strict=True))
            )
        history.append(values)
        return smooth


MAX_SENDERS = 8
"""Most senders whose readings are distinguished; readings of a further sender stop the motion."""

FORGET_AFTER_S = 2.0
"""Silence after which a sender may be dropped: a restarting program takes less."""

REST_S = 1.0
"""Time without requested motion before a silent sender is dropped: longer than a pause of the
operator's hand during a motion."""


class _Sender:
    """Newest reading of a program, and its time."""

    __slots__ = ("level", "level_s", "peaks")

    def __init__(self, peaks: PeakFilter | None) -> None:
        self.level = 0.0
        self.level_s = NEVER_S
        self.peaks = peaks


@dataclass(frozen=True, kw_only=True)
class ProximityOptions(ListenerOptions):
    """Options of the filter ``proximity``."""

    alert_high: Annotated[float, SENSOR_LEVEL] = 800.0
    """Level above which the motion stops."""
    alert_low: Annotated[float, SENSOR_LEVEL] = 100.0
    """Level above which the motion is half as fast."""
    half_speed: bool = True
    """False: nothing happens between the two levels."""
    peak_filter: bool = True
    """Suppress single spikes, which delays a real rise by four readings."""
    max_age_s: Annotated[float, READING_AGE_S] = 0.3
    """Age of the oldest reading that is still valid."""
    when_stale: Literal["stop", "half", "pass"] = "stop"
    """Reaction if no reading is valid; half: half speed."""

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.alert_low, self.alert_high
        require(low <= high, "alert_low", low, f"0 to alert_high, which is {high:g}")


class ProximityFilter(TwistFilter):
    """Stop above the high level, half speed above the low one, stop without a fresh reading."""

    Options = ProximityOptions

    def __init__(self, options: ProximityOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self.listener = DatagramListener(self.options.place("proximity"), self._take)
        self._senders: dict[Sender, _Sender] = {}
        self._crowded_s = NEVER_S
        """Time of a reading from one sender too many."""
        self._rest_s = math.nan
        """Time since which the operator requests no motion; NaN: motion is requested."""
        self._forget()
        self._now_s = NEVER_S

    def open(self) -> None:
        """Listen for readings. Raises AddressError if that is not possible."""
        self.listener.open()

    def close(self) -> None:
        """Stop listening and discard the readings."""
        self.listener.close()
        self._forget()

    def _forget(self) -> None:
        self._senders.clear()
        self._crowded_s = NEVER_S
        self._level = 0.0
        """Largest level of the valid readings."""
        self._level_s = NEVER_S
        """Time of the newest reading of any sender."""
        self._silent = True
        """True if a sender is silent, or none was heard."""
        self._silent_s = NEVER_S
        """Time of the last reading of the sender that has been silent longest."""

    def _take(self, data: bytes, received_s: float, sender: Sender) -> Malformed | None:
        values = decode_proximity(data)
        if isinstance(values, Malformed):
            return values
        known = self._senders.get(sender)
        if known is None:
            if received_s == NEVER_S:
                return None  # It was queued before listening began, so its age is unknown.
            if len(self._senders) == MAX_SENDERS:
                self._crowded_s = max(self._crowded_s, received_s)
                return None
            known = self._senders[sender] = _Sender(
                PeakFilter() if self.options.peak_filter else None
            )
        if known.peaks is not None:
            values = known.peaks.apply(values)
        known.level, known.level_s = max(values), received_s
        return None

    def _is_old(self, time_s: float) -> bool:
        # Written so that a time that is not a number is old.
        return not self._now_s - time_s <= self.options.max_age_s

    @property
    def _crowded(self) -> bool:
        return not self._is_old(self._crowded_s)

    def _check(self) -> None:
        """Compute level and silence of all senders at this time."""
        self._level, self._level_s = 0.0, NEVER_S
        self._silent, self._silent_s = not self._senders, math.inf
        for each in self._senders.values():
            self._level_s = max(self._level_s, each.level_s)
            if self._is_old(each.level_s):
                self._silent = True
                self._silent_s = min(self._silent_s, each.level_s)
            else:
                self._level = max(self._level, each.level)

    def _rest(self, twist: Twist) -> None:
        """Drop silent senders if the operator rests and another sender is active."""
        if any(twist.linear) or any(twist.angular):
            self._rest_s = math.nan
            return
        if math.isnan(self._rest_s):
            self._rest_s = self._now_s
        if not (self._silent and self._now_s - self._rest_s >= REST_S):
            return
        if self._is_old(self._level_s) and not self._crowded:
            return
        for sender, each in tuple(self._senders.items()):
            if self._now_s - each.level_s > FORGET_AFTER_S:
                del self._senders[sender]
        self._check()

    def _factor(self) -> float:
        """Return the remaining share of the operator's speed."""
        options = self.options
        if self._crowded:
            return 0.0
        silent = {"stop": 0.0, "half": 0.5}.get(options.when_stale, 1.0) if self._silent else 1.0
        if self._level > options.alert_high:
            return 0.0
        near = 0.5 if options.half_speed and self._level > options.alert_low else 1.0
        return min(silent, near)

    def apply(self, twist: Twist, robot: RobotState) -> Twist:
        """Return `twist`, half of it, or zero."""
        self._now_s = robot.stamp_s
        self.listener.drain(robot.stamp_s)
        self._check()
        self._rest(twist)
        factor = self._factor()
        if factor == 1.0:
            return twist
        if factor == 0.0:
            return ZERO_TWIST
        return Twist(scale(twist.linear, factor), scale(twist.angular, factor), twist.frame)

    def status(self) -> str:
        """Explain why the motion is slower than requested."""
        result = {0.0: "stopped", 0.5: "half speed"}.get(self._factor(), "")
        options = self.options
        if self._crowded:
            return f"more than {MAX_SENDERS} programs send proximity readings: {result}"
        limit = options.alert_high if self._level > options.alert_high else options.alert_low
        near = f"proximity {self._level:.0f}, above {limit:g}: {result}"
        if self._silent and not (self._level > options.alert_high):
            if not self._senders:
                return f"no proximity reading yet: {result or 'not watched'}"
            age_s = self._now_s - self._silent_s
            if self._is_old(self._level_s):
                why = f"the proximity sensors have been silent for {age_s:.1f} s"
                return f"{why}: {result or 'not watched'}"
            if options.when_stale != "pass":
                rest_s = math.ceil(10.0 * max(REST_S, FORGET_AFTER_S - age_s)) / 10.0
                return (
                    f"one of {len(self._senders)} senders of proximity readings has been silent "
                    f"for {age_s:.1f} s: {result}; to go on without it, ask for no motion for "
                    f"{rest_s:g} s"
                )
        return near if result else ""

    def describe(self) -> str:
        """Describe thresholds, address, and the reaction without readings."""
        options = self.options
        slow = f"half speed above {options.alert_low:g}, " if options.half_speed else ""
        without = {"stop": "stop", "half": "half speed"}.get(options.when_stale, "full speed")
        return (
            f"stop above {options.alert_high:g}, {slow}{without} without a reading for "
            f"{options.max_age_s:g} s, readings on {shown_place(options.place('proximity'))}"
        )

    def diagnosis(self) -> tuple[str, ...]:
        """Return the faults of the sensors' datagrams, and their senders if there are several."""
        found = self.listener.diagnosis("proximity sensors")
        if len(self._senders) > 1:
            names = ", ".join(map(str, self._senders))
            found += (f"proximity readings of {names}: the most cautious one counts",)
        return found
