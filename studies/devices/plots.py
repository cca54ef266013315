"""Picture of the devices study. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from studies.devices.sessions import Driven, within
from studies.plotting import plt
from studies.result import Drawn


def draw(found: Sequence[Driven]) -> Iterator[Drawn]:
    """Draw the age of the newest report at a control instant, and the session's response time."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.6), layout="constrained")
    for each in found:
        points = within(each.runs[-1])
        ages_ms = [1e3 * age for age, _ in points]
        left.plot(ages_ms, [100.0 * share for _, share in points], ".-", label=each.device.name)
    left.set(xscale="log", xlabel="age of the newest report at most, ms", ylabel="cycles, %")
    left.set_title("how old the hand's motion is when it is used")
    left.legend(fontsize=8)
    places, last = range(len(found)), [each.runs[-1] for each in found]
    for off, name, color, values in (
        (-0.2, "median", "tab:blue", [1e6 * one.loop.tick_p50_s for one in last]),
        (0.2, "p99", "tab:orange", [1e6 * one.loop.tick_p99_s for one in last]),
    ):
        right.barh([place + off for place in places], values, 0.38, color=color, label=name)
    names = [each.device.name for each in found]
    right.set(yticks=list(places), yticklabels=names, xlabel="µs")
    right.invert_yaxis()
    right.set_title("the session's answer to the robot")
    right.legend(fontsize=8)
    yield Drawn("devices", "Each device through the one controller", figure)
