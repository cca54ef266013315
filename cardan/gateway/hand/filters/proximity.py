"""Stops or slows the operator's motion when something is near the arm.

The published rule of the AMOR arm (Łukawski, Victores and Balaguer 2023, after Oña et al. 2020):
the level is the largest value of all proximity sensors; above one threshold the motion stops,
above a lower one it is half as fast.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from cardan import bounds
from cardan.gateway.hand.filters.base import TwistFilter
from cardan.gateway.hand.filters.listener import DatagramListener
from cardan.gateway.hand.filters.readings import Malformed, decode_proximity
from cardan.options import Options, require
from cardan.spatial import scale
from cardan.types import NEVER_S, ZERO_TWIST, RobotState, Twist

PEAK_READINGS = 5
"""Length of the peak filter's history."""

PEAK_FACTOR = 5.0
"""Factor on the oldest value of the history above which a value is a peak."""


class PeakFilter:
    """Holds back single spikes: a real rise passes when it has lasted for five readings.

    A value of more than five times the oldest of the last five readings is replaced by that
    oldest one, unless the four readings between are that large too. The published filter keeps
    its own output as the history, so that a rise it has held back once is held back for ever;
    this one keeps what the sensors said.
    """

    def __init__(self) -> None:
        self._history: deque[tuple[float, ...]] = deque(maxlen=PEAK_READINGS)

    def apply(self, values: tuple[float, ...]) -> tuple[float, ...]:
        """The reading without its spikes; a reading of another length starts anew."""
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


@dataclass(frozen=True, kw_only=True)
class ProximityOptions(Options):
    """Options of the filter ``proximity``."""

    host: Annotated[str, bounds.IPV4] = "127.0.0.1"
    """Address to listen on."""
    port: Annotated[int, bounds.PORT] = 6601
    """UDP port to listen on."""
    alert_high: Annotated[float, bounds.SENSOR_LEVEL] = 800.0
    """Level above which the motion stops."""
    alert_low: Annotated[float, bounds.SENSOR_LEVEL] = 100.0
    """Level above which the motion is half as fast."""
    half_speed: bool = True
    """False: nothing happens between the two levels."""
    peak_filter: bool = True
    """Single spikes are held back, which makes a real rise four readings late."""
    max_age_s: Annotated[float, bounds.READING_AGE_S] = 0.3
    """Oldest reading that still counts."""
    when_stale: Literal["stop", "half", "pass"] = "stop"
    """What happens without a reading that counts; half: half speed."""

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.alert_low, self.alert_high
        require(low <= high, "alert_low", low, f"0 to alert_high, which is {high:g}")


class ProximityFilter(TwistFilter):
    """Stop above the high level, half speed above the low one, stop without a fresh reading."""

    Options = ProximityOptions

    def __init__(self, options: ProximityOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self.listener = DatagramListener(self.options.host, self.options.port, self._take)
        self._peaks = PeakFilter() if self.options.peak_filter else None
        self._level = 0.0
        self._level_s = NEVER_S
        self._now_s = NEVER_S

    def open(self) -> None:
        """Listen for readings. Raises AddressError when the port cannot be had."""
        self.listener.open()

    def close(self) -> None:
        """Stop listening and forget the readings."""
        self.listener.close()
        self._level_s = NEVER_S

    def _take(self, data: bytes, received_s: float) -> Malformed | None:
        values = decode_proximity(data)
        if isinstance(values, Malformed):
            return values
        if self._peaks is not None:
            values = self._peaks.apply(values)
        self._level, self._level_s = max(values), received_s
        return None

    @property
    def _stale(self) -> bool:
        # Written so that a time that is not a number is stale.
        return not self._now_s - self._level_s <= self.options.max_age_s

    def _factor(self) -> float:
        """The share of the operator's speed that is left."""
        options = self.options
        if self._stale:
            return {"stop": 0.0, "half": 0.5}.get(options.when_stale, 1.0)
        if self._level > options.alert_high:
            return 0.0
        return 0.5 if options.half_speed and self._level > options.alert_low else 1.0

    def apply(self, twist: Twist, robot: RobotState) -> Twist:
        """`twist`, half of it, or none of it."""
        self._now_s = robot.stamp_s
        self.listener.drain(robot.stamp_s)
        factor = self._factor()
        if factor == 1.0:
            return twist
        if factor == 0.0:
            return ZERO_TWIST
        return Twist(scale(twist.linear, factor), scale(twist.angular, factor), twist.frame)

    def status(self) -> str:
        """Why the motion is slower than asked."""
        result = {0.0: "stopped", 0.5: "half speed"}.get(self._factor(), "")
        if self._stale:
            if self._level_s == NEVER_S:
                why = "no proximity reading yet"
            else:
                age_s = self._now_s - self._level_s
                why = f"the proximity sensors have been silent for {age_s:.1f} s"
            return f"{why}: {result or 'not watched'}"
        if not result:
            return ""
        limit = self.options.alert_high if result == "stopped" else self.options.alert_low
        return f"proximity {self._level:.0f}, above {limit:g}: {result}"

    def describe(self) -> str:
        """Thresholds, port, and what happens without readings."""
        options = self.options
        slow = f"half speed above {options.alert_low:g}, " if options.half_speed else ""
        without = {"stop": "stop", "half": "half speed"}.get(options.when_stale, "full speed")
        return (
            f"stop above {options.alert_high:g}, {slow}{without} without a reading for "
            f"{options.max_age_s:g} s, readings on UDP {options.host}:{options.port}"
        )

    def diagnosis(self) -> tuple[str, ...]:
        """What is wrong with the sensors' datagrams."""
        return self.listener.diagnosis("proximity sensors")
