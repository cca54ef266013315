"""The lag from the commanded to the measured position of an axis.

A series of a pure dead time, the controller's averaging filter, and the servo as a first-order lag.
On a ramp the arm lags by dead_time + (N - 1)/2 · IPC + lag and one IPC, with N entries in the
average.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Annotated, NamedTuple

from cardan.common.bounds import Range

DELAY_S = Range(0.0, 10.0, "s", "no arm is farther behind its command")

_Delay = Annotated[float, DELAY_S]


class PlantModel(NamedTuple):
    """Lag of an arm behind its command. Times in s, rounded to whole IPCs except `lag_s`."""

    dead_time_s: _Delay = 0.0
    average_s: _Delay = 0.0
    """Length of the averaging filter."""
    lag_s: _Delay = 0.0
    """Time constant of the servo."""


PLANTS: Mapping[str, PlantModel] = {
    "ideal": PlantModel(),
    # GP8 on a YRC1000 (Baklouti et al. 2021): 0.268 s behind a ramp fits both of the paper's
    # delays. Its division is not published. The lag, which has no finite end, determines how long
    # the standard driver waits between two trajectories: with 66 ms that driver would be 0.70 s
    # behind its goal and not the published 0.55 s, with 10 ms it is 0.56 s.
    "paper": PlantModel(dead_time_s=0.2, average_s=0.112, lag_s=0.01),
}
"""Presets. ideal: the measured position is the previous IPC's command."""


class Plant:
    """The axes of one group, in pulses.

    Call `step` once an IPC with its command; `measured` and `change` are then the positions of the
    axes and their motion in this IPC.
    """

    def __init__(self, model: PlantModel, ipc_s: float, start: Sequence[int]) -> None:
        self._averaged = max(1, round(model.average_s / ipc_s))
        # Backward Euler: on a ramp the delay is exactly the time constant.
        self._share = ipc_s / (model.lag_s + ipc_s)
        dead = 1 + round(model.dead_time_s / ipc_s)
        first = list(start)
        self._waiting: deque[Sequence[int]] = deque([first] * dead)
        self._window: deque[Sequence[int]] = deque([first] * self._averaged)
        self._sums = [pulses * self._averaged for pulses in first]
        self._settling_ipcs = dead + self._averaged
        self._still = 0
        self.measured = [float(pulses) for pulses in first]
        self.change = [0.0] * len(first)
        """Motion in the last IPC, pulses."""

    def step(self, command: Sequence[int]) -> None:
        """Run one IPC with the command `command`, which is copied."""
        waiting, measured = self._waiting, self.measured
        if command == waiting[-1]:
            self._still += 1
            if self._still > self._settling_ipcs and measured == command:
                for axis in range(len(measured)):
                    self.change[axis] = 0.0
                return
            waiting.append(waiting[-1])
        else:
            self._still = 0
            waiting.append(list(command))
        arrived = waiting.popleft()
        if self._averaged == 1 and self._share == 1.0:
            for axis, target in enumerate(arrived):
                self.change[axis] = target - measured[axis]
                measured[axis] = float(target)
            return
        window, sums = self._window, self._sums
        window.append(arrived)
        left = window.popleft()
        share, count = self._share, self._averaged
        for axis, (new, old) in enumerate(zip(arrived, left, strict=True)):
            total = sums[axis] = sums[axis] + new - old
            change = share * (total / count - measured[axis])
            # An exponential never arrives; a thousandth of a pulse counts as arrival.
            if -1e-3 < change < 1e-3 and new * count == total:
                change = new - measured[axis]
            self.change[axis] = change
            measured[axis] += change
