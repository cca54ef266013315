"""Scripted loads: what acts on the simulated sensor, as a function of time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.jr3.core import NO_WRENCH, SimulatedJr3
from cardan.sim_peers.scripted import StepWords, Timeline
from cardan.sim_peers.strokes import Ramp, Swing, VectorMotion

HAND_PERIOD_S = 0.002
"""How often a changing load is sampled."""

COMPONENTS = ("FX", "FY", "FZ", "MX", "MY", "MZ")
OVERLOAD = 1.5
"""An overload is so many full scales."""

SCRIPT_VERBS: Mapping[str, str] = {
    "wrench": "wrench FX FY FZ MX MY MZ [over SECONDS]",
    "swing": "swing FX FY FZ MX MY MZ over SECONDS [times N] [phase DEGREES]",
    "release": "release [over SECONDS]",
    "overload": "overload FX|FY|FZ|MX|MY|MZ [over SECONDS]",
    "sensor-unplug": "sensor-unplug",
    "sensor-plug": "sensor-plug",
    "power-off": "power-off",
    "power-on": "power-on",
    "silence": "silence",
    "resume": "resume",
    "loop": "loop",
}
"""Usage of each verb of a script. Forces in N, moments in N·m, in the sensor's own axes.

``wrench`` ramps linearly from what acts now; ``swing`` adds N whole sine periods of SECONDS each
on top; ``release`` ends both. ``overload`` ramps one component to 1.5 times its full scale.
``silence`` hangs the board until ``resume``; ``loop`` starts the script again.
"""

SCRIPTS: Mapping[str, str] = {
    "rest": """
        # nobody touches the sensor
        0    release
    """,
    # The first 2.5 s belong to the host: it waits for the filter, takes zero and sees rest.
    "demo": """
        # 16 s of guiding by hand: each direction there and back, then two turns
        2.5  swing 8 0 0 0 0 0 over 3
        5.5  swing 0 8 0 0 0 0 over 3
        8.5  swing 0 0 8 0 0 0 over 3
        11.5 swing 0 0 0 0 0 1.2 over 2
        13.5 swing 6 6 0 0 0.8 0 over 2.5
    """,
    "push": """
        # a steady push forward, then the hand lets go
        2.5  wrench 6 0 0 0 0 0 over 0.4
        4.5  release over 0.3
    """,
    "wiggle": """
        # small pushes in all directions, for ever
        2.5  swing 5 0 0 0 0 0.8 over 2
        3.5  swing 0 5 0 0 0.8 0 over 2
        4.5  swing 0 0 5 0.8 0 0 over 2
        7.0  loop
    """,
    "overload": """
        # a blow beyond the full scale, then a push
        2.5  overload FZ over 0.02
        2.8  release over 0.02
        4.0  wrench 6 0 0 0 0 0 over 0.4
        5.0  release over 0.3
    """,
    "brownout": """
        # the power fails during a push; the hand goes on pushing, and lets go later
        2.5  wrench 6 0 0 0 0 0 over 0.4
        4.0  power-off
        4.5  power-on
        5.0  release over 0.3
    """,
}
"""The built-in scripts. Time 0 is when the board is first told to acquire."""


class _Overload(NamedTuple):
    component: int
    over_s: float


class _Act(NamedTuple):
    verb: str


_Action = Ramp | Swing | _Overload | _Act

_ACTS = {
    "sensor-unplug": SimulatedJr3.unplug_sensor,
    "sensor-plug": SimulatedJr3.plug_sensor,
    "power-off": SimulatedJr3.power_off,
    "power-on": SimulatedJr3.power_on,
    "silence": SimulatedJr3.hang,
    "resume": SimulatedJr3.recover,
}


class ScriptedHand:
    """Plays the steps of a script on a sensor; afterwards the load stays as it is.

    Time 0 of the script is when the board is first told to acquire. Raises ScriptError, naming the
    step, for arguments that its verb does not take.
    """

    def __init__(self, steps: Sequence[ScriptStep]) -> None:
        self._timeline = Timeline(
            steps, SCRIPT_VERBS, lambda words: [(words.time_s, _read(words))], math.inf
        )
        self._motion = VectorMotion(NO_WRENCH, HAND_PERIOD_S)

    @property
    def next_due_s(self) -> float:
        """When `advance` has something to do next, s; inf before the start and after the end."""
        return min(self._timeline.next_due_s, self._motion.next_due_s)

    def start(self, now_s: float) -> None:
        """Begin, unless it has begun."""
        self._timeline.start(now_s)

    def advance(self, now_s: float, sensor: SimulatedJr3) -> None:
        """Do every step that is due until `now_s`, then hold the load as it is at `now_s`."""
        for due_s, action in self._timeline.due(now_s):
            if isinstance(action, _Act):
                _ACTS[action.verb](sensor)
            elif isinstance(action, _Overload):
                force, moment = sensor.scales.forces_n, sensor.scales.moments_dnm
                full = (*force, *(0.1 * value for value in moment))[action.component]
                load = list(self._motion.without_swings(due_s))
                load[action.component] = OVERLOAD * full
                self._motion.start(due_s, Ramp(tuple(load), action.over_s))
            else:
                self._motion.start(due_s, action)
        sensor.set_wrench(self._motion.advance(now_s))


def _read(words: StepWords) -> _Action:
    """Turn the words of one step into what it does."""
    action: _Action
    if words.verb == "wrench":
        action = Ramp(words.numbers(COMPONENTS, -1e6, 1e6), words.over())
    elif words.verb == "release":
        action = Ramp(NO_WRENCH, words.over(), ends_swings=True)
    elif words.verb == "swing":
        action = words.swing(words.numbers(COMPONENTS, -1e6, 1e6), HAND_PERIOD_S)
    elif words.verb == "overload":
        name = words.left.pop(0).upper() if words.left else ""
        if name not in COMPONENTS:
            raise words.error(f"{name!r} is no component; usage: {words.usage}")
        action = _Overload(COMPONENTS.index(name), words.over())
    else:
        action = _Act(words.verb)
    words.end()
    return action
