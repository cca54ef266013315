"""Scripted hands: what an operator does with the simulated remote, as a function of time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from cardan.errors import ScriptError
from cardan.protocols.wiimote import BUTTONS, IrDot
from cardan.protocols.wiimote.camera import HEIGHT, WIDTH
from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.wiimote.core import EXTENSIONS, ZERO, SimulatedWiimote, Vector

HAND_PERIOD_S = 0.005
"""How often a moving hand is sampled."""

SCRIPT_VERBS: Mapping[str, str] = {
    "tilt": "tilt ROLL PITCH YAW [over SECONDS]",
    "swing": "swing ROLL PITCH YAW over SECONDS [times N] [phase DEGREES]",
    "level": "level [over SECONDS]",
    "push": "push X Y Z over SECONDS [times N]",
    "stick": "stick X Y [over SECONDS]",
    "press": "press LABEL",
    "release": "release LABEL",
    "dots": "dots [X Y ...]",
    "battery": "battery 0..255",
    "plug": "plug nunchuk",
    "unplug": "unplug",
    "power-off": "power-off",
    "power-on": "power-on",
    "leave": "leave",
    "come-back": "come-back",
    "silence": "silence",
    "resume": "resume",
    "loop": "loop",
}
"""Usage of each verb of a script. Angles are in degrees: roll right side down, pitch nose up, yaw
to the left.

``tilt`` ramps the angles from where they are; ``swing`` adds N whole sine periods of SECONDS each
on top; ``level`` ends both. ``push`` accelerates by N sine periods of X forward, Y left, Z up, in
g. ``stick`` is the Nunchuk's, -1..1, right and forward. ``dots`` is what the camera sees, up to
four of X 0..1023 and Y 0..767. ``leave`` and ``come-back`` are about radio range; ``silence``
stops everything but the link until ``resume``; ``loop`` starts the script again.
"""

SCRIPTS: Mapping[str, str] = {
    "rest": """
        # level and still, no buttons
    """,
    # Swings take the remote back to level, A and B alone are held as long as each other, and the
    # tilt that letting go interrupts has the same area as the one back: all integrates to zero.
    "demo": """
        # 24 s: A and B each alone and together, tilts, yaw mode, letting go in mid-tilt
        1.0   press a                                  # the dead-man
        1.1   press b                                  # with both: rotations only
        1.3   swing 25 0 0 over 3                      # roll right and left
        4.3   swing 0 20 0 over 3                      # nose up and down
        7.5   release a
        7.6   release b
        8.0   press a                                  # alone ...
        8.3   swing 15 0 0 over 1.5
        10.0  release a
        10.6  press b                                  # ... and the other one for as long
        10.9  swing 0 15 0 over 1.5
        12.6  release b
        13.0  press 2                                  # yaw mode on
        13.1  release 2
        13.4  press a
        13.5  press b
        13.8  swing 25 0 20 over 3
        17.0  release a
        17.1  release b
        17.4  press 1                                  # and off
        17.5  release 1
        18.0  press a
        18.1  press b
        18.4  tilt 25 0 0 over 0.4                     # tilted ...
        19.3  release b                                # ... and the dead-man goes: stop
        19.3  release a
        19.7  level over 0.4
        20.4  press a                                  # a new grip, from level
        20.5  press b
        20.7  tilt -25 0 0 over 0.4                    # back by as much
        21.4  level over 0.4
        22.0  release a
        22.2  release b
        22.6  press plus
        22.8  release plus
        23.2  press minus
        23.4  release minus
    """,
    "short": """
        # 6 s of the same
        0.4   press a
        0.6   swing 25 0 0 over 1.2
        2.0   release a
        2.3   press b
        2.5   swing 0 20 0 over 1.2
        3.9   release b
        4.1   press a
        4.2   press b
        4.3   swing 20 10 0 over 1
        5.4   release a
        5.5   release b
        5.7   press home
        5.9   release home
    """,
    "circle": """
        # a circle: roll and pitch a quarter period apart, with A and B held
        0.5   tilt 0 20 0 over 0.5
        1.2   press a
        1.2   press b
        1.4   tilt 0 0 0
        1.4   swing 20 0 0 over 5 times 2
        1.4   swing 0 20 0 over 5 times 2 phase 90
        11.4  tilt 0 20 0
        11.4  level over 0.5
        12.2  release a
        12.2  release b
    """,
    "taps": """
        # buttons only, for ever
        0.5   press a
        0.6   release a
        0.9   press b
        1.0   release b
        1.3   press a
        1.4   press b
        1.5   release a
        1.6   release b
        1.9   press home
        2.0   release home
        2.4   loop
    """,
    "wiggle": """
        # tilts that overlap, for ever, no buttons
        0.5   swing 15 0 0 over 2
        1.5   swing 0 15 0 over 2
        2.5   swing 0 0 20 over 2
        5.0   loop
    """,
    "turn": """
        # yaw with A and B held, slow and then too fast for the gyroscopes' fine range
        1.0   press a
        1.0   press b
        1.3   tilt 0 0 90 over 1.5
        3.0   tilt 0 0 0 over 1.5
        5.0   tilt 0 0 180 over 0.3
        6.0   tilt 0 0 0 over 0.3
        7.0   release a
        7.0   release b
    """,
    "nunchuk": """
        # the stick round its corners with Z held, then C; needs the Nunchuk
        1.0   press z
        1.3   stick 0 1 over 0.4
        2.3   stick 1 0 over 0.4
        3.3   stick 0 -1 over 0.4
        4.3   stick -1 0 over 0.4
        5.3   stick 0 0 over 0.3
        6.0   release z
        6.5   press c
        6.7   release c
    """,
    "walk-away": """
        # out of range in mid-tilt for 6 s, then on
        1.0   press a
        1.3   tilt 25 0 0 over 0.4
        3.0   leave
        9.0   come-back
        10.0  level over 0.4
        10.5  release a
        12.0  press a
        12.3  swing 25 0 0 over 2
        14.6  release a
    """,
}
"""The built-in scripts."""


class _Ramp(NamedTuple):
    target: Vector
    over_s: float
    ends_swings: bool = False


class _Swing(NamedTuple):
    amplitude: Vector
    period_s: float
    times: int
    phase_rad: float = 0.0


class _Push(NamedTuple):
    swing: _Swing


class _Stick(NamedTuple):
    x: float
    y: float
    over_s: float


class _Button(NamedTuple):
    label: str
    pressed: bool


class _Dots(NamedTuple):
    dots: tuple[IrDot, ...]


class _Battery(NamedTuple):
    level: int


class _Event(NamedTuple):
    verb: str


class _Loop(NamedTuple):
    pass


_Action = _Ramp | _Swing | _Push | _Stick | _Button | _Dots | _Battery | _Event | _Loop


class ScriptedHand:
    """Plays the steps of a script on a remote; afterwards it stays as it is.

    Raises ScriptError, naming the step, for arguments that its verb does not take, and for steps
    that need a Nunchuk when `extension` is not one and the script plugs none.
    """

    def __init__(self, steps: Sequence[ScriptStep], extension: str = "") -> None:
        has_nunchuk = extension == "nunchuk"
        actions: list[tuple[float, _Action]] = []
        for index, step in enumerate(steps):
            action = _compile(step)
            has_nunchuk |= step.verb == "plug"
            needs = step.verb == "stick" or (
                isinstance(action, _Button) and action.label in ("c", "z")
            )
            if needs and not has_nunchuk:
                raise ScriptError(
                    f"{step.time_s:g} s {step.verb}: there is no Nunchuk; "
                    f"choose the extension {EXTENSIONS[1]!r}"
                )
            if isinstance(action, _Loop) and (step.time_s <= 0.0 or index + 1 < len(steps)):
                raise ScriptError(f"{step.time_s:g} s loop: must be the last step, after 0 s")
            actions.append((step.time_s, action))
        self._actions = tuple(actions)
        self._next = 0
        self._offset_s = 0.0
        self._now_s = 0.0
        self._ramp = (0.0, ZERO, _Ramp(ZERO, 0.0))
        self._stick = (0.0, (0.0, 0.0), _Stick(0.0, 0.0, 0.0))
        self._swings: list[tuple[float, _Swing]] = []
        self._pushes: list[tuple[float, _Swing]] = []

    @property
    def next_due_s(self) -> float:
        """When `advance` has something to do next, s; inf after the end."""
        due_s = math.inf
        if self._next < len(self._actions):
            due_s = self._offset_s + self._actions[self._next][0]
        ends_s = [
            begin_s + swing.period_s * swing.times
            for begin_s, swing in (*self._swings, *self._pushes)
        ]
        for start_s, over_s in (
            (self._ramp[0], self._ramp[2].over_s),
            (self._stick[0], self._stick[2].over_s),
        ):
            if self._now_s < start_s + over_s:
                ends_s.append(start_s + over_s)
        if ends_s:
            due_s = min(due_s, self._now_s + HAND_PERIOD_S, *ends_s)
        return due_s

    def advance(self, now_s: float, remote: SimulatedWiimote) -> None:
        """Do every step that is due until `now_s`, then hold the remote as it is at `now_s`."""
        while self._next < len(self._actions):
            time_s, action = self._actions[self._next]
            time_s += self._offset_s
            if time_s > now_s:
                break
            self._next += 1
            self._act(time_s, action, remote)
        self._now_s = now_s
        self._swings = [item for item in self._swings if now_s < _end_s(item)]
        self._pushes = [item for item in self._pushes if now_s < _end_s(item)]
        angles, rates = self._attitude(now_s)
        remote.set_attitude(*angles, rates)
        remote.set_acceleration(_sum_of(self._pushes, now_s))
        remote.set_stick(*self._stick_at(now_s))

    def _act(self, time_s: float, action: _Action, remote: SimulatedWiimote) -> None:
        if isinstance(action, _Ramp):
            start = self._ramp_at(time_s)
            if action.ends_swings:
                start = self._attitude(time_s)[0]
                self._swings = []
            self._ramp = (time_s, start, action)
        elif isinstance(action, _Swing):
            self._swings.append((time_s, action))
        elif isinstance(action, _Push):
            self._pushes.append((time_s, action.swing))
        elif isinstance(action, _Stick):
            self._stick = (time_s, self._stick_at(time_s), action)
        elif isinstance(action, _Button):
            if action.label not in ("c", "z") or remote.port.nunchuk is not None:
                (remote.press if action.pressed else remote.release)(action.label)
        elif isinstance(action, _Dots):
            remote.set_dots(action.dots)
        elif isinstance(action, _Battery):
            remote.battery = action.level
        elif isinstance(action, _Loop):
            self._offset_s, self._next = time_s, 0
        else:
            events = {
                "plug": remote.plug,
                "unplug": remote.unplug,
                "power-off": remote.power_off,
                "power-on": remote.power_on,
                "leave": remote.leave,
                "come-back": remote.come_back,
                "silence": remote.silence,
                "resume": remote.resume,
            }
            events[action.verb](time_s)

    def _ramp_at(self, time_s: float) -> Vector:
        start_s, start, ramp = self._ramp
        share = _share(time_s - start_s, ramp.over_s)
        x, y, z = (a + share * (b - a) for a, b in zip(start, ramp.target, strict=True))
        return (x, y, z)

    def _stick_at(self, time_s: float) -> tuple[float, float]:
        start_s, (x, y), stick = self._stick
        share = _share(time_s - start_s, stick.over_s)
        return (x + share * (stick.x - x), y + share * (stick.y - y))

    def _attitude(self, time_s: float) -> tuple[Vector, Vector]:
        """Angles, rad, and their derivatives."""
        angles = [*self._ramp_at(time_s)]
        rates = [0.0, 0.0, 0.0]
        start_s, start, ramp = self._ramp
        if ramp.over_s and time_s < start_s + ramp.over_s:
            rates = [(b - a) / ramp.over_s for a, b in zip(start, ramp.target, strict=True)]
        for begin_s, swing in self._swings:
            if time_s >= begin_s + swing.period_s * swing.times:
                continue
            turn = 2.0 * math.pi / swing.period_s
            phase = turn * (time_s - begin_s) + swing.phase_rad
            for axis in range(3):
                angles[axis] += swing.amplitude[axis] * math.sin(phase)
                rates[axis] += swing.amplitude[axis] * turn * math.cos(phase)
        return _vector(angles), _vector(rates)


def play(remote: SimulatedWiimote, hand: ScriptedHand, until_s: float) -> list[bytes]:
    """Let `hand` move `remote` until `until_s`; the input reports that reach the host by then."""
    reports: list[bytes] = []
    while (due_s := min(remote.next_due_s, hand.next_due_s)) <= until_s:
        if hand.next_due_s <= due_s:
            hand.advance(due_s, remote)
        reports += remote.reports(due_s)
    return reports + remote.reports(until_s)


def _share(elapsed_s: float, over_s: float) -> float:
    return 1.0 if elapsed_s >= over_s else max(0.0, elapsed_s / over_s)


def _end_s(item: tuple[float, _Swing]) -> float:
    begin_s, swing = item
    return begin_s + swing.period_s * swing.times


def _sum_of(swings: Iterable[tuple[float, _Swing]], time_s: float) -> Vector:
    total = [0.0, 0.0, 0.0]
    for begin_s, swing in swings:
        share = math.sin(2.0 * math.pi * (time_s - begin_s) / swing.period_s)
        for axis in range(3):
            total[axis] += swing.amplitude[axis] * share
    return _vector(total)


def _vector(values: Iterable[float]) -> Vector:
    x, y, z = values
    return (x, y, z)


def _compile(step: ScriptStep) -> _Action:
    """Turn the words of one step into what it does."""
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

    def angles() -> Vector:
        return _vector(
            [math.radians(number(name, -720.0, 720.0)) for name in ("ROLL", "PITCH", "YAW")]
        )

    def seconds() -> float:
        return number("SECONDS", 0.0) if keyword("over") else 0.0

    def period() -> float:
        if not keyword("over"):
            raise ScriptError(f"{where}: 'over' is missing; usage: {usage}")
        return number("SECONDS", HAND_PERIOD_S)

    def times() -> int:
        return int(number("N", 1.0)) if keyword("times") else 1

    action: _Action
    if step.verb == "tilt":
        target = angles()
        action = _Ramp(target, seconds())
    elif step.verb == "level":
        action = _Ramp(ZERO, seconds(), True)
    elif step.verb == "swing":
        amplitude = angles()
        period_s, count = period(), times()
        phase_rad = math.radians(number("DEGREES", -360.0, 360.0)) if keyword("phase") else 0.0
        action = _Swing(amplitude, period_s, count, phase_rad)
    elif step.verb == "push":
        amplitude = _vector([number(name, -4.0, 4.0) for name in ("X", "Y", "Z")])
        period_s = period()
        action = _Push(_Swing(amplitude, period_s, times()))
    elif step.verb == "stick":
        x, y = number("X", -1.0, 1.0), number("Y", -1.0, 1.0)
        action = _Stick(x, y, seconds())
    elif step.verb in ("press", "release"):
        if not words:
            raise ScriptError(f"{where}: LABEL is missing; usage: {usage}")
        label = words.pop(0)
        labels = (*BUTTONS.values(), "c", "z")
        if label not in labels:
            raise ScriptError(
                f"{where}: there is no button {label!r}; there are: {', '.join(labels)}"
            )
        action = _Button(label, step.verb == "press")
    elif step.verb == "dots":
        dots: list[IrDot] = []
        while words and len(dots) < 4:
            x_count, y_count = number("X", 0.0, WIDTH - 1), number("Y", 0.0, HEIGHT - 1)
            dots.append(IrDot(round(x_count), round(y_count), 3))
        action = _Dots(tuple(dots))
    elif step.verb == "battery":
        action = _Battery(round(number("level", 0.0, 255.0)))
    elif step.verb == "plug":
        if words != ["nunchuk"]:
            raise ScriptError(f"{where}: {' '.join(words)!r} cannot be plugged; usage: {usage}")
        words.clear()
        action = _Event("plug")
    elif step.verb == "loop":
        action = _Loop()
    else:
        action = _Event(step.verb)
    if words:
        raise ScriptError(f"{where}: {' '.join(words)!r} is too much; usage: {usage}")
    return action
