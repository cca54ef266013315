"""Scripted loads on the simulated sensor, as a function of time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.motion_profile import VectorMotion, VectorRamp
from cardan.sim_peers.scripted import Action, MotionScript, StepWords, calling, moving
from cardan_jr3.peer.core import NO_WRENCH, SimulatedJr3

MOTION_PERIOD_S = 0.002
"""Sampling period of a changing load."""

COMPONENTS = ("FX", "FY", "FZ", "MX", "MY", "MZ")
OVERLOAD = 1.5
"""Load of an overload, in full scales."""

SCRIPT_VERBS: Mapping[str, str] = {
    "wrench": (
        "wrench FX FY FZ MX MY MZ [over SECONDS] (ramp to this load: N, N·m, the sensor's own axes)"
    ),
    "swing": (
        "swing FX FY FZ MX MY MZ over SECONDS [times N] [phase DEGREES] (whole sine periods on top)"
    ),
    "release": "release [over SECONDS] (ends both)",
    "overload": (
        "overload FX|FY|FZ|MX|MY|MZ [over SECONDS] (one component to 1.5 times its full scale)"
    ),
    "sensor-unplug": (
        "sensor-unplug (the sensor's cable: the board repeats the last sample with its counter)"
    ),
    "sensor-plug": "sensor-plug (the sensor's cable is back)",
    "power-off": "power-off (the board's power fails)",
    "power-on": "power-on (the board's power is back)",
    "silence": "silence (the board hangs)",
    "resume": "resume (the board continues)",
    "loop": "loop",
}
"""Usage of each verb of a script. Forces in N, moments in N·m, in the sensor's own axes.

``wrench`` ramps linearly from the present load; ``swing`` adds N whole sine periods of SECONDS each
on top; ``release`` ends both. ``overload`` ramps one component to 1.5 times its full scale.
``silence`` hangs the board until ``resume``; ``loop`` starts the script again.
"""

SCRIPTS: Mapping[str, str] = {
    "rest": """
        # no load on the sensor
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
        # a steady push forward, then it is let go
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
        # the power fails during a push; the push goes on, and ends later
        2.5  wrench 6 0 0 0 0 0 over 0.4
        4.0  power-off
        4.5  power-on
        5.0  release over 0.3
    """,
}
"""Built-in scripts. Time 0 is the board's first command to acquire."""


_ACTS = {
    "sensor-unplug": "unplug_sensor",
    "sensor-plug": "plug_sensor",
    "power-off": "power_off",
    "power-on": "power_on",
    "silence": "hang",
    "resume": "recover",
}


class ScriptedJr3(MotionScript[SimulatedJr3]):
    """Player of a script's steps on a sensor; afterwards the load stays constant. Time 0 of the
    script is the call of `start`, which is for `SimulatedJr3.on_first_start`."""

    def __init__(self, steps: Sequence[ScriptStep]) -> None:
        self._wrench = VectorMotion(NO_WRENCH, MOTION_PERIOD_S)
        super().__init__(steps, SCRIPT_VERBS, [self._wrench], math.inf)

    def _hold(self, device: SimulatedJr3, now_s: float) -> None:
        device.set_wrench(self._wrench.advance(now_s))

    def _read(self, words: StepWords) -> Action[SimulatedJr3]:
        if words.verb == "wrench":
            return moving(
                self._wrench, VectorRamp(words.numbers(COMPONENTS, -1e6, 1e6), words.over())
            )
        if words.verb == "release":
            return moving(self._wrench, VectorRamp(NO_WRENCH, words.over(), ends_swings=True))
        if words.verb == "swing":
            amplitude = words.numbers(COMPONENTS, -1e6, 1e6)
            return moving(self._wrench, words.swing(amplitude, MOTION_PERIOD_S))
        if words.verb == "overload":
            return self._overload(words)
        return calling(_ACTS[words.verb])

    def _overload(self, words: StepWords) -> Action[SimulatedJr3]:
        name = words.left.pop(0).upper() if words.left else ""
        if name not in COMPONENTS:
            raise words.error(f"{name!r} is not a component; usage: {words.usage}")
        component, over_s = COMPONENTS.index(name), words.over()

        def overload(sensor: SimulatedJr3, at_s: float) -> None:
            force, moment = sensor.scales.forces_n, sensor.scales.moments_dnm
            full = (*force, *(0.1 * value for value in moment))[component]
            load = list(self._wrench.without_swings(at_s))
            load[component] = OVERLOAD * full
            self._wrench.start(at_s, VectorRamp(tuple(load), over_s))

        return overload
