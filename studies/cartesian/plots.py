"""Picture of the Cartesian interface's latencies. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Iterator

from cardan.common.arm_libraries import np
from studies.cartesian.command import Delays
from studies.plotting import plt
from studies.result import Drawn


def draw(found: dict[str, Delays]) -> Iterator[Drawn]:
    """Cumulative number of commands that moved the robot, over time."""
    figure, axes = plt.subplots(figsize=(7.0, 3.4), layout="constrained")
    for name, each in found.items():
        ordered = 1e3 * np.sort(np.array(each.delays_s))
        share = 100.0 * np.arange(1, len(ordered) + 1) / max(1, len(ordered))
        axes.step(ordered, share, where="post", label=name)
    axes.axvspan(0.0, 20.0, color="tab:red", alpha=0.08, lw=0)
    axes.text(
        19.7, 3.0, "published: a hand's motion\nwaits up to 20 ms (50 Hz)", ha="right", fontsize=8
    )
    axes.set(xlabel="from publishing to the robot's datagram, ms", ylabel="commands, %")
    axes.set_xlim(0.0, 25.0)
    axes.legend(fontsize=8, loc="center right")
    yield Drawn("delays", "From a topic to the robot's datagram", figure)
