"""The drawing task of 2026: a stylus moves a robot's pen, and the hand feels the board."""

from __future__ import annotations

from typing import NamedTuple

from cardan.demos.demo import choose_demo, find_problems, simulated_hardware
from cardan.gateway.session.driver_assembly import make_device
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import supervise

DEMO = "omni"


class Drawing(NamedTuple):
    """Result of a drawing."""

    last: Snapshot
    budget_j: float
    """Energy limit of passivity for one engagement."""
    problems: tuple[str, ...]


def measure(seconds: float) -> Drawing:
    """Run the demo for this time. Raises RuntimeError if its session fails."""
    with simulated_hardware(choose_demo(DEMO), seconds) as (config, through):
        outcome = supervise(config, seconds, through=through)
        options = make_device(config).options
    if not outcome.last.loop.cycles:
        raise RuntimeError(
            f"the drawing did not run: {outcome.last.error or 'no state was received'}"
        )
    return Drawing(
        outcome.last, options.energy_budget_j, tuple(find_problems(outcome.last, options))
    )
