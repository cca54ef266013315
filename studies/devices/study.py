"""The generic controller with low-cost devices (2023): every device and every arm with one
controller."""

from __future__ import annotations

from collections.abc import Iterator

from studies.devices import arms, sessions
from studies.result import Drawn, Result

SECONDS, TURNS = 15.0, 2
QUICK_S = 3.0
QUICK_ARMS = ("asibot", "teo_right_arm")

HOW = (
    "Devices: real time, each simulated device in a process of its own, speaking its protocol over "
    "the kind of transport that it has, and a session as `cardan demo` runs it with a simulated "
    "UR5. Arms: virtual time, 30 mm up by commands 50 times a second, with ideal drives and with "
    "dynamics."
)


def run(quick: bool) -> Result:
    """Run the study."""
    moved = arms.measure(QUICK_ARMS if quick else arms.ARMS)
    if quick:
        driven = sessions.measure(sessions.PUBLISHED, QUICK_S, 1)
    else:
        driven = sessions.measure((*sessions.PUBLISHED, *sessions.others()), SECONDS, TURNS)

    def draw() -> Iterator[Drawn]:
        from studies.devices import plots

        return plots.draw(driven)

    others = ", ".join(each.name for each in sessions.others())
    shortened = (
        f"{QUICK_S:g} s of each device once instead of {SECONDS:g} s {TURNS} times: no spread",
        f"left out: {others}; all arms but two",
    )
    return Result(
        HOW,
        (sessions.table(driven), arms.table(moved)),
        (*sessions.figures(driven), *arms.figures(moved)),
        draw,
        shortened=shortened if quick else (),
    )
