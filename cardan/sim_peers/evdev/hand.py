"""Scripted hands: what an operator does to the simulated pad or keyboard, as a function of time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from cardan.errors import ScriptError
from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.evdev.core import NEUTRAL, Controls, Frame, SimulatedInput

HAND_PERIOD_S = 0.004
"""How often a moving hand is sampled: as often as a pad is polled."""

SCRIPT_VERBS: Mapping[str, str] = {
    "sticks": "sticks LX LY RX RY [over SECONDS]",
    "triggers": "triggers LEFT RIGHT [over SECONDS]",
    "swing": "swing LX LY RX RY over SECONDS [times N] [phase DEGREES]",
    "neutral": "neutral [over SECONDS]",
    "press": "press LABEL",
    "release": "release LABEL",
    "hold": "hold LABEL for SECONDS",
    "unplug": "unplug",
    "replug": "replug",
    "silence": "silence",
    "resume": "resume",
    "loop": "loop",
}
"""Usage of each verb of a script. Sticks are -1..1 to the right and up, triggers 0..1.

``sticks`` and ``triggers`` ramp linearly from where they are; ``swing`` adds N whole sine periods
of SECONDS each on top; ``neutral`` ends all of these. ``silence`` stops the device's events until
``resume``; ``loop`` starts the script again.
"""

GAMEPAD_SCRIPTS: Mapping[str, str] = {
    "rest": """
        # touched once, then left alone
        0.3  hold start for 0.1
    """,
    "demo": """
        # 24 s of everything; ends where it began
        0.3   hold start for 0.1                 # touch it: the driver has to hear of it once
        1.0   press left-shoulder                # the dead-man
        1.2   swing 0 0.7 0 0 over 3             # forward and back
        4.2   swing -0.7 0 0 0 over 3            # left and back
        7.2   swing 0 0 0 0.7 over 2.6           # up and down
        9.8   swing 0 0 -0.7 0 over 3            # yaw
        12.9  press right-shoulder               # shift to the other rotations
        13.0  swing 0.7 0 0 0 over 2.4           # roll
        15.4  swing 0 0.7 0 0 over 2.4           # pitch
        17.9  release right-shoulder
        18.0  hold south for 0.3                 # gripper
        18.6  sticks 0 0.7 0 0 over 0.5          # forward ...
        19.8  release left-shoulder              # ... and the dead-man goes: brake
        20.2  neutral over 0.3
        21.0  press left-shoulder                # a new grip, from neutral
        21.3  sticks 0 -0.7 0 0 over 0.5         # back by as much
        22.25 neutral over 0.5
        23.0  hold south for 0.3
        23.6  release left-shoulder
    """,
    "short": """
        # 5 s of the same kind
        0.1   hold start for 0.1
        0.4   press left-shoulder
        0.6   swing 0 0.6 0 0 over 1.2
        1.8   swing -0.6 0 0 0.4 over 1.2
        3.0   swing 0 0 -0.6 0 over 1.2
        4.3   hold south for 0.2
        4.6   sticks 0 0 0 -0.5 over 0.2
        4.9   release left-shoulder
        5.1   neutral over 0.2
    """,
    "circle": """
        # a circle to the left; the ramp that takes the hand there is dropped as the sine begins
        0.3   hold start for 0.1
        1.0   press left-shoulder
        1.2   sticks -0.5 0 0 0 over 0.4
        1.6   sticks 0 0 0 0
        1.6   swing 0 0.6 0 0 over 5
        1.6   swing -0.6 0 0 0 over 5 phase 90
        6.6   neutral
        7.0   release left-shoulder
    """,
}
"""The built-in scripts of a gamepad."""

KEYBOARD_SCRIPTS: Mapping[str, str] = {
    "rest": """
        # touched once, then left alone
        0.3  hold left-shift for 0.1
    """,
    "demo": """
        # 16 s: each axis there and back, the dead-man let go in mid-motion
        0.3   hold left-shift for 0.1            # touch it: the driver has to hear of it once
        1.0   press space
        1.2   hold a for 1.2                     # forward
        2.6   hold z for 1.2                     # back
        4.0   hold s for 1                       # left
        5.2   hold x for 1                       # right
        6.4   hold d for 1                       # up
        7.6   hold c for 1                       # down
        8.8   hold h for 0.8                     # yaw
        9.8   hold n for 0.8
        10.8  hold k for 0.2                     # gripper
        11.2  press a
        12.2  release space                      # the dead-man goes: brake
        12.6  release a
        13.2  press space                        # a new grip
        13.4  hold z for 1
        15.0  release space
    """,
    "short": """
        # 3 s
        0.1   hold left-shift for 0.1
        0.3   press space
        0.5   hold a for 0.8
        1.4   hold z for 0.8
        2.4   hold k for 0.2
        2.8   release space
    """,
    "taps": """
        # buttons only, for ever
        0.5   hold space for 0.2
        1.0   hold k for 0.2
        1.5   hold enter for 0.2
        2.0   loop
    """,
}
"""The built-in scripts of a keyboard."""

SCRIPTS: Mapping[str, Mapping[str, str]] = {
    "gamepad": GAMEPAD_SCRIPTS,
    "keyboard": KEYBOARD_SCRIPTS,
}
"""The built-in scripts of each kind of device. All begin with a touch, since a driver believes a
device only after it has heard of it."""


class _Ramp(NamedTuple):
    target: tuple[float | None, ...]
    """Six controls; None: this one stays where it is going."""
    over_s: float
    ends_swings: bool


class _Swing(NamedTuple):
    amplitude: tuple[float, ...]
    period_s: float
    times: int
    phase_rad: float


class _Button(NamedTuple):
    label: str
    pressed: bool


class _Plug(NamedTuple):
    verb: str


class _Loop(NamedTuple):
    pass


_Action = _Ramp | _Swing | _Button | _Plug | _Loop


class ScriptedHand:
    """Plays the steps of a script on `device`; afterwards it stays as it is.

    Raises ScriptError, naming the step, for arguments that its verb does not take.
    """

    def __init__(self, steps: Sequence[ScriptStep], device: SimulatedInput) -> None:
        actions: list[tuple[float, _Action]] = []
        for index, step in enumerate(steps):
            if step.verb == "loop" and (step.time_s <= 0.0 or index + 1 < len(steps)):
                raise ScriptError(f"{step.time_s:g} s loop: must be the last step, after 0 s")
            actions += _compile(step, device)
        # A hold that lasts beyond the loop is let go at the loop.
        end_s = steps[-1].time_s if steps and steps[-1].verb == "loop" else math.inf
        self._actions = sorted(
            ((min(time_s, end_s), action) for time_s, action in actions),
            key=lambda pair: (pair[0], isinstance(pair[1], _Loop)),
        )
        self._next = 0
        self._offset_s = 0.0
        self._now_s = 0.0
        self._start: Controls = NEUTRAL
        self._goal: Controls = NEUTRAL
        self._begin_s = self._end_s = 0.0
        self._swings: list[tuple[float, _Swing]] = []

    @property
    def next_due_s(self) -> float:
        """When `advance` has something to do next, s; inf after the end."""
        due_s = math.inf
        if self._next < len(self._actions):
            due_s = self._offset_s + self._actions[self._next][0]
        ends_s = [begin_s + swing.period_s * swing.times for begin_s, swing in self._swings]
        if self._now_s < self._end_s:
            ends_s.append(self._end_s)
        if ends_s:
            due_s = min(due_s, self._now_s + HAND_PERIOD_S, *ends_s)
        return due_s

    def advance(self, now_s: float, device: SimulatedInput) -> None:
        """Do every step that is due until `now_s`, then hold the device as it is at `now_s`."""
        while self._next < len(self._actions):
            time_s, action = self._actions[self._next]
            time_s += self._offset_s
            if time_s > now_s:
                break
            self._next += 1
            self._act(time_s, action, device)
        self._now_s = now_s
        self._swings = [
            (begin_s, swing)
            for begin_s, swing in self._swings
            if now_s < begin_s + swing.period_s * swing.times
        ]
        device.set_controls(self._deflection(now_s))

    def _act(self, time_s: float, action: _Action, device: SimulatedInput) -> None:
        if isinstance(action, _Ramp):
            start = self._deflection(time_s) if action.ends_swings else self._ramped(time_s)
            if action.ends_swings:
                self._swings.clear()
            self._start = start
            self._goal = _six(
                new if new is not None else old
                for new, old in zip(action.target, self._goal, strict=True)
            )
            self._begin_s, self._end_s = time_s, time_s + action.over_s
        elif isinstance(action, _Swing):
            self._swings.append((time_s, action))
        elif isinstance(action, _Button):
            if action.pressed:
                device.press(action.label)
            else:
                device.release(action.label)
        elif isinstance(action, _Plug):
            getattr(device, action.verb)()
        else:
            self._offset_s = time_s
            self._next = 0

    def _ramped(self, at_s: float) -> Controls:
        if at_s >= self._end_s:
            return self._goal
        share = (at_s - self._begin_s) / (self._end_s - self._begin_s)
        return _six(a + (b - a) * share for a, b in zip(self._start, self._goal, strict=True))

    def _deflection(self, at_s: float) -> Controls:
        controls = self._ramped(at_s)
        for begin_s, swing in self._swings:
            if begin_s <= at_s < begin_s + swing.period_s * swing.times:
                sine = math.sin(math.tau * (at_s - begin_s) / swing.period_s + swing.phase_rad)
                amplitudes = (*swing.amplitude, 0.0, 0.0)
                controls = _six(a + b * sine for a, b in zip(controls, amplitudes, strict=True))
        return controls


def play(device: SimulatedInput, hand: ScriptedHand, until_s: float) -> list[Frame]:
    """Move `device` by `hand` until `until_s`, each at its due times; the frames it reported."""
    frames: list[Frame] = []
    while (due_s := min(device.next_due_s, hand.next_due_s)) <= until_s:
        hand.advance(due_s, device)
        frames += device.frames(due_s)
    return frames


def _six(values: Iterable[float]) -> Controls:
    lx, ly, rx, ry, lt, rt = values
    return (lx, ly, rx, ry, lt, rt)


def _compile(step: ScriptStep, device: SimulatedInput) -> list[tuple[float, _Action]]:
    """Turn the words of one step into what it does, and when."""
    where = f"{step.time_s:g} s {step.verb}"
    usage = SCRIPT_VERBS[step.verb]
    words = list(step.args)

    def number(name: str, lowest: float, highest: float = math.inf) -> float:
        if not words:
            raise ScriptError(f"{where}: {name} is missing; usage: {usage}")
        text = words.pop(0)
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not lowest <= value <= highest or math.isinf(value):
            limit = "" if math.isinf(highest) else f" to {highest:g}"
            raise ScriptError(
                f"{where}: {name} is {text!r}, must be a number from {lowest:g}{limit}"
            )
        return value

    def keyword(name: str) -> bool:
        found = words[:1] == [name]
        del words[: int(found)]
        return found

    def needs(name: str) -> None:
        if not keyword(name):
            raise ScriptError(f"{where}: {name!r} is missing; usage: {usage}")

    def label() -> str:
        if not words:
            raise ScriptError(f"{where}: LABEL is missing; usage: {usage}")
        word = words.pop(0)
        if word not in device.labels:
            raise ScriptError(
                f"{where}: {device.model.name} has no button {word!r}; "
                f"it has: {', '.join(device.labels)}"
            )
        return word

    if step.verb in ("sticks", "triggers", "swing") and not device.model.is_gamepad:
        raise ScriptError(f"{where}: {device.model.name} has no sticks and no triggers")
    actions: list[tuple[float, _Action]]
    if step.verb in ("sticks", "triggers", "neutral"):
        target: list[float | None] = [0.0] * 6
        if step.verb == "sticks":
            target = [*(number(name, -1.0, 1.0) for name in ("LX", "LY", "RX", "RY")), None, None]
        elif step.verb == "triggers":
            target = [None] * 4 + [number(name, 0.0, 1.0) for name in ("LEFT", "RIGHT")]
        over_s = number("SECONDS", 0.0) if keyword("over") else 0.0
        actions = [(step.time_s, _Ramp(tuple(target), over_s, step.verb == "neutral"))]
    elif step.verb == "swing":
        amplitude = tuple(number(name, -1.0, 1.0) for name in ("LX", "LY", "RX", "RY"))
        needs("over")
        period_s = number("SECONDS", HAND_PERIOD_S)
        times = int(number("N", 1.0)) if keyword("times") else 1
        phase_rad = math.radians(number("DEGREES", -360.0, 360.0)) if keyword("phase") else 0.0
        actions = [(step.time_s, _Swing(amplitude, period_s, times, phase_rad))]
    elif step.verb in ("press", "release"):
        actions = [(step.time_s, _Button(label(), step.verb == "press"))]
    elif step.verb == "hold":
        held = label()
        needs("for")
        end_s = step.time_s + number("SECONDS", 0.0)
        actions = [(step.time_s, _Button(held, True)), (end_s, _Button(held, False))]
    else:
        actions = [(step.time_s, _Loop() if step.verb == "loop" else _Plug(step.verb))]
    if words:
        raise ScriptError(f"{where}: {' '.join(words)!r} is too much; usage: {usage}")
    return actions
