"""Random motion scripts of each device, as by an operator; they begin and end at rest."""

from __future__ import annotations

import random
from typing import Any, Final, NamedTuple

TOUCH_S: Final = 0.5
"""Time of the press: by then the driver has received data and has seen the device at rest."""


class Episode(NamedTuple):
    """A script for a device, and the interval in it in which the operator requests motion."""

    script: list[list[Any]]
    begins_s: float
    ends_s: float


def _puck(rng: random.Random, lasts_s: float, *, lets_go_in_motion: bool) -> list[list[Any]]:
    amplitude = [round(rng.uniform(-0.7, 0.7), 2) for _ in range(6)]
    for axis in rng.sample(range(6), rng.randint(2, 5)):
        amplitude[axis] = 0.0
    steps: list[list[Any]] = [
        [0.0, "neutral"], [0.0, "release", "left"],
        [0.05, "axes", 0, 0, 0.2, 0, 0, 0, "over", 0.05], [0.15, "neutral", "over", 0.05],
        [TOUCH_S, "press", "left"],
        [TOUCH_S + 0.2, "swing", *amplitude, "over", round(lasts_s / 2, 2), "times", 2],
    ]  # fmt: skip
    end_s = TOUCH_S + 0.2 + lasts_s * (0.6 if lets_go_in_motion else 1.05)
    return [*steps, [end_s, "release", "left"], [end_s + 0.3, "neutral", "over", 0.1]]


def _pad(rng: random.Random, lasts_s: float, *, lets_go_in_motion: bool) -> list[list[Any]]:
    sticks = [round(rng.uniform(-0.7, 0.7), 2) for _ in range(4)]
    steps: list[list[Any]] = [
        [0.0, "neutral"], [0.0, "release", "left-shoulder"], [0.05, "hold", "start", "for", 0.1],
        [TOUCH_S, "press", "left-shoulder"],
        [TOUCH_S + 0.2, "swing", *sticks, "over", round(lasts_s / 2, 2), "times", 2],
    ]  # fmt: skip
    end_s = TOUCH_S + 0.2 + lasts_s * (0.6 if lets_go_in_motion else 1.05)
    return [*steps, [end_s, "release", "left-shoulder"], [end_s + 0.3, "neutral", "over", 0.1]]


def _remote(rng: random.Random, lasts_s: float, *, lets_go_in_motion: bool) -> list[list[Any]]:
    buttons = rng.choice((("a",), ("b",), ("a", "b")))
    tilt = [round(rng.uniform(-25, 25), 1), round(rng.uniform(-20, 20), 1), 0]
    end_s = TOUCH_S + 0.2 + lasts_s * (0.6 if lets_go_in_motion else 1.05)
    return [
        [0.0, "level"], [0.0, "release", "a"], [0.0, "release", "b"],
        *([TOUCH_S, "press", each] for each in buttons),
        [TOUCH_S + 0.2, "swing", *tilt, "over", round(lasts_s / 2, 2), "times", 2],
        *([end_s, "release", each] for each in buttons),
        [end_s + 0.3, "level", "over", 0.1],
    ]  # fmt: skip


_OF: Final = {"mouse": _puck, "pad": _pad, "remote": _remote}

LET_GO: Final[dict[str, list[list[Any]]]] = {
    "mouse": [[0.0, "release", "left"], [0.0, "neutral"]],
    "pad": [[0.0, "release", "left-shoulder"], [0.0, "neutral"]],
    "remote": [[0.0, "release", "a"], [0.0, "release", "b"], [0.0, "level"]],
}
"""Steps that release all buttons and return to rest."""

UNPLUG: Final = {"mouse": "unplug", "pad": "unplug", "remote": "power-off"}
PLUG: Final = {"mouse": "replug", "pad": "replug", "remote": "power-on"}
"""Script verbs of each device for absence and return."""


def episode(device: str, rng: random.Random) -> Episode:
    """Choose the next motion script of a device."""
    lasts_s = round(rng.uniform(2.0, 10.0), 1)
    in_motion = rng.random() < 0.3
    script = _OF[device](rng, lasts_s, lets_go_in_motion=in_motion)
    ends_s = max(step[0] for step in script if step[1] == "release")
    return Episode(script, TOUCH_S, ends_s)
