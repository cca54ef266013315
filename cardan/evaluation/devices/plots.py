"""The picture of the devices. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence

from cardan.evaluation.devices.sessions import Driven, age_s, within
from cardan.evaluation.plotting import plt
from cardan.evaluation.result import Drawn


def draw(found: Sequence[Driven]) -> list[Drawn]:
    """How old the newest report is in a control instant, and how fast the session answers."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.4), layout="constrained")
    names = [each.device.name for each in found]
    for each in found:
        points = within(each.runs[-1])
        ages_ms = [1e3 * age for age, _ in points]
        left.plot(ages_ms, [100.0 * share for _, share in points], ".-", label=each.device.name)
    left.set(xscale="log", xlabel="age of the newest report, ms, at most", ylabel="cycles, %")
    left.set_title("how old the hand's motion is when it is used")
    left.legend(fontsize=8)
    places = range(len(found))
    last = [each.runs[-1] for each in found]
    right.barh([p + 0.2 for p in places], [1e3 * (age_s(x) or 0.0) for x in last], 0.35)
    right.barh([p - 0.2 for p in places], [1e3 * x.tick_p99_s for x in last], 0.35)
    right.set(yticks=list(places), yticklabels=names, xlabel="ms")
    right.set_title("mean age of the report (blue), the session's answer, p99 (orange)")
    right.title.set_fontsize(9)
    return [Drawn("devices", "Each device through the one controller", figure)]
