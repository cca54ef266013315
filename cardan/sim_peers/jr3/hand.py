"""Scripted loads: what acts on the simulated sensor, as a function of time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from cardan.errors import ScriptError
from cardan.protocols.jr3_can import Frame, Six
from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.jr3.core import NO_WRENCH, SimulatedJr3

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


class _Ramp(NamedTuple):
    target: Six
    over_s: float
    ends_swings: bool


class _Swing(NamedTuple):
    amplitude: Six
    period_s: float
    times: int
    phase_rad: float


class _Overload(NamedTuple):
    component: int
    over_s: float


class _Act(NamedTuple):
    verb: str


class _Loop(NamedTuple):
    pass


_Action = _Ramp | _Swing | _Overload | _Act | _Loop

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
        self._actions = tuple((step.time_s, _compile(step)) for step in steps)
        for index, (time_s, action) in enumerate(self._actions):
            if isinstance(action, _Loop) and (time_s <= 0.0 or index + 1 < len(steps)):
                raise ScriptError(f"{time_s:g} s loop: must be the last step, after 0 s")
        self._next = 0
        self._offset_s: float | None = None
        self._now_s = 0.0
        self._ramp = (0.0, NO_WRENCH, _Ramp(NO_WRENCH, 0.0, False))
        self._swings: list[tuple[float, _Swing]] = []

    @property
    def next_due_s(self) -> float:
        """When `advance` has something to do next, s; inf before the start and after the end."""
        if self._offset_s is None:
            return math.inf
        due_s = math.inf
        if self._next < len(self._actions):
            due_s = self._offset_s + self._actions[self._next][0]
        start_s, _, ramp = self._ramp
        ends_s = [begin_s + swing.period_s * swing.times for begin_s, swing in self._swings]
        ends_s += [start_s + ramp.over_s] * (self._now_s < start_s + ramp.over_s)
        if ends_s:
            due_s = min(due_s, self._now_s + HAND_PERIOD_S, *ends_s)
        return due_s

    def start(self, now_s: float) -> None:
        """Begin, unless it has begun."""
        if self._offset_s is None:
            self._offset_s = self._now_s = now_s

    def advance(self, now_s: float, sensor: SimulatedJr3) -> None:
        """Do every step that is due until `now_s`, then hold the load as it is at `now_s`."""
        while self._offset_s is not None and self._next < len(self._actions):
            time_s, action = self._actions[self._next]
            time_s += self._offset_s
            if time_s > now_s:
                break
            self._next += 1
            self._act(time_s, action, sensor)
        self._now_s = now_s
        self._swings = [
            (begin_s, swing)
            for begin_s, swing in self._swings
            if now_s < begin_s + swing.period_s * swing.times
        ]
        sensor.set_wrench(self._load(now_s))

    def _act(self, time_s: float, action: _Action, sensor: SimulatedJr3) -> None:
        if isinstance(action, _Ramp):
            start = self._load(time_s) if action.ends_swings else self._ramped(time_s)
            if action.ends_swings:
                self._swings.clear()
            self._ramp = (time_s, start, action)
        elif isinstance(action, _Swing):
            self._swings.append((time_s, action))
        elif isinstance(action, _Overload):
            start = self._ramped(time_s)
            force, moment = sensor.scales.forces_n, sensor.scales.moments_dnm
            full = (*force, *(0.1 * value for value in moment))[action.component]
            target = list(start)
            target[action.component] = OVERLOAD * full
            self._ramp = (time_s, start, _Ramp(_six(target), action.over_s, False))
        elif isinstance(action, _Act):
            _ACTS[action.verb](sensor)
        else:
            self._offset_s = time_s
            self._next = 0

    def _ramped(self, at_s: float) -> Six:
        start_s, start, ramp = self._ramp
        if at_s >= start_s + ramp.over_s:
            return ramp.target
        share = (at_s - start_s) / ramp.over_s
        return _six([a + (b - a) * share for a, b in zip(start, ramp.target, strict=True)])

    def _load(self, at_s: float) -> Six:
        load = self._ramped(at_s)
        for begin_s, swing in self._swings:
            if begin_s <= at_s < begin_s + swing.period_s * swing.times:
                turn = math.tau * (at_s - begin_s) / swing.period_s + swing.phase_rad
                sine = math.sin(turn)
                load = _six([a + b * sine for a, b in zip(load, swing.amplitude, strict=True)])
        return load


def play(sensor: SimulatedJr3, hand: ScriptedHand, until_s: float) -> list[Frame]:
    """Let `sensor` and `hand` run until `until_s`, each at its due times; the frames it sent."""
    frames: list[Frame] = []
    while (due_s := min(sensor.next_due_s, hand.next_due_s)) <= until_s:
        frames += sensor.frames(due_s)
        if sensor.starts:
            hand.start(due_s)
        hand.advance(due_s, sensor)
    return frames


def _six(values: Sequence[float]) -> Six:
    a, b, c, d, e, f = values
    return (a, b, c, d, e, f)


def _compile(step: ScriptStep) -> _Action:
    """Turn the words of one step into what it does."""
    where = f"{step.time_s:g} s {step.verb}"
    usage = f"usage: {SCRIPT_VERBS[step.verb]}"
    words = list(step.args)

    def number(name: str, lowest: float, highest: float = math.inf) -> float:
        if not words:
            raise ScriptError(f"{where}: {name} is missing; {usage}")
        text = words.pop(0)
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not lowest <= value <= highest or math.isinf(value):
            limits = f"from {lowest:g}" + ("" if math.isinf(highest) else f" to {highest:g}")
            raise ScriptError(f"{where}: {name} is {text!r}, must be a number {limits}")
        return value

    def load() -> Six:
        return _six([number(name, -1e6, 1e6) for name in COMPONENTS])

    def over() -> float:
        if words[:1] != ["over"]:
            return 0.0
        del words[0]
        return number("SECONDS", 0.0)

    action: _Action
    if step.verb == "wrench":
        action = _Ramp(load(), over(), False)
    elif step.verb == "release":
        action = _Ramp(NO_WRENCH, over(), True)
    elif step.verb == "swing":
        amplitude = load()
        if words[:1] != ["over"]:
            raise ScriptError(f"{where}: 'over' is missing; {usage}")
        del words[0]
        period_s = number("SECONDS", HAND_PERIOD_S)
        times, phase_rad = 1, 0.0
        if words[:1] == ["times"]:
            del words[0]
            times = int(number("N", 1.0))
        if words[:1] == ["phase"]:
            del words[0]
            phase_rad = math.radians(number("DEGREES", -360.0, 360.0))
        action = _Swing(amplitude, period_s, times, phase_rad)
    elif step.verb == "overload":
        name = words.pop(0).upper() if words else ""
        if name not in COMPONENTS:
            raise ScriptError(f"{where}: {name!r} is no component; {usage}")
        action = _Overload(COMPONENTS.index(name), over())
    else:
        action = _Loop() if step.verb == "loop" else _Act(step.verb)
    if words:
        raise ScriptError(f"{where}: {' '.join(words)!r} is too much; {usage}")
    return action
