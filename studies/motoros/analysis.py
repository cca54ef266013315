"""Delays and stops of a recording, phase by phase as in the paper."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from cardan.common.arm_libraries import np
from studies.metrics import delay_by_correlation, delay_by_least_error, stop_phases
from studies.motoros.published import Delays, mean
from studies.motoros.recording import GRID_S, HOLD_S, PUSH_S, RAMP_S, Array, Recording

LONGEST_S = 1.2
"""Upper limit for the delay of each stage."""
BEFORE_S = 0.1
LEAD_S = 0.06
"""Lead of a goal ahead of the mouse: the goal of a stream is the joint's position a spacing
later."""
Find = Callable[[float, Array, Array, float], float]


class PushDelays(NamedTuple):
    """Delays of one push."""

    delays: Delays
    device_to_command_s: float
    goal_to_command_s: float
    correlated_total_s: float
    """Delay from device to measured joint by the correlation of velocities, for comparison."""
    stops: int
    stopped_s: float


class Result(NamedTuple):
    """Result of a run."""

    mode: str
    plant: str
    phases: tuple[PushDelays, ...]

    @property
    def delays(self) -> tuple[Delays, ...]:
        """Delays of each phase."""
        return tuple(phase.delays for phase in self.phases)

    @property
    def mean(self) -> Delays:
        """Mean delays over the phases."""
        return mean(self.delays)

    def average(self, name: str) -> float:
        """Mean of one of a phase's figures."""
        return float(sum(getattr(phase, name) for phase in self.phases) / len(self.phases))

    @property
    def stops(self) -> int:
        """Number of stops in all phases."""
        return sum(phase.stops for phase in self.phases)

    @property
    def stopped_s(self) -> float:
        """Total time of the stops in all phases."""
        return sum(phase.stopped_s for phase in self.phases)


def analyze(recording: Recording) -> Result:
    """Analyze every phase of `recording`. Raises ValueError if the joint did not follow a push."""
    try:
        phases = tuple(_phase(recording, start_s) for start_s in recording.pushes)
    except ValueError as error:
        last = recording.snapshot
        raise ValueError(f"{error} ({last.robot.hold_reason or last.arm.message})") from None
    return Result(recording.mode, recording.plant, phases)


def _phase(recording: Recording, start_s: float) -> PushDelays:
    first = int(np.searchsorted(recording.times_s, start_s - BEFORE_S))
    last = int(np.searchsorted(recording.times_s, start_s - BEFORE_S + PUSH_S))
    window = slice(first, last)
    lead = round(LEAD_S / GRID_S)
    early = slice(first - lead, last - lead)

    def late(one: Array, two: Array, find: Find = delay_by_least_error) -> float:
        """Return the shift with the best fit of the shape, without gain and curve of the mouse."""
        a, b = _normalized(one[window])[:, None], _normalized(two[early])[:, None]
        return find(GRID_S, a, b, LONGEST_S + LEAD_S) - LEAD_S

    device, goal = recording.device, recording.goal
    command, measured = recording.command, recording.measured

    pushed = slice(first, first + round((BEFORE_S + RAMP_S + HOLD_S) / GRID_S))
    stops = stop_phases(
        recording.times_s[pushed],
        goal[pushed, None],
        _delayed(measured, pushed, late(goal, measured))[:, None],
    )
    return PushDelays(
        Delays(late(device, goal), late(goal, measured), late(device, measured)),
        late(device, command),
        late(goal, command),
        late(device, measured, delay_by_correlation),
        stops.count,
        stops.total_s,
    )


def _normalized(signal: Array) -> Array:
    travel = signal[-1] - signal[0]
    if abs(travel) < 0.01:
        raise ValueError(f"the joint moved {travel:.4f} rad in a push")
    found: Array = (signal - signal[0]) / travel
    return found


def _delayed(signal: Array, window: slice, delay_s: float) -> Array:
    """Return `signal` in `window`, moved back by its delay, so that its own start does not count as
    a stop."""
    shift = round(delay_s / GRID_S)
    return signal[window.start + shift : window.stop + shift]
