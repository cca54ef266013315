"""Scripted hands: what an operator does above the simulated tracker, as a function of time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from cardan.errors import ScriptError
from cardan.protocols.leap import HANDS
from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.leap.core import SimulatedLeapService
from cardan.sim_peers.leap.faults import RESTART_S

SCRIPT_VERBS: Mapping[str, str] = {
    "enter": "enter left|right [X Y Z]",
    "leave": "leave left|right",
    "move": "move left|right X Y Z [over SECONDS]",
    "tilt": "tilt left|right PITCH YAW ROLL [over SECONDS]",
    "swing": "swing left|right X Y Z [PITCH YAW ROLL] over SECONDS [times N]",
    "grab": "grab left|right STRENGTH [over SECONDS]",
    "pinch": "pinch left|right STRENGTH [over SECONDS]",
    "confidence": "confidence left|right VALUE [over SECONDS]",
    "new-id": "new-id left|right",
    "unplug": "unplug",
    "replug": "replug",
    "pause": "pause",
    "unpause": "unpause",
    "stall": "stall",
    "resume": "resume",
    "steal-focus": "steal-focus",
    "restart": "restart [SECONDS]",
    "malformed": "malformed [FRAMES]",
    "loop": "loop",
}
"""Usage of each verb of a script. Positions are in the tracker's axes, mm: X right, Y up, Z towards
the operator; angles in degrees: PITCH fingers up, YAW fingers to the right, ROLL left edge down.
Strengths and confidence are 0 to 1.

``move``, ``tilt``, ``grab``, ``pinch`` and ``confidence`` start and end gently; ``swing`` adds N
whole sine periods of SECONDS each on top. ``unplug`` and ``replug`` are the tracker's cable,
``pause`` and ``unpause`` its delivery; ``stall`` stops the frames without a word until ``resume``.
``restart`` takes the service away for SECONDS, ``malformed`` cuts the next FRAMES short, ``loop``
starts the script again.
"""

HOME_MM = (0.0, 200.0, 0.0)

SCRIPTS: Mapping[str, str] = {
    "empty": """
        # no hand at all
        0.0  leave right
    """,
    "rest": """
        # a hand comes into view and stays where it is
        1.0  enter right
    """,
    # Every swing integrates to zero; the reach that leaving interrupts at 19.6 s has the same
    # length as the one back after the new entry.
    "demo": """
        # 24 s: a right hand comes, waits, moves about, grabs and pinches, leaves in mid-reach
        1.0   enter right
        2.0   swing right 0 0 -80 over 3             # forward and back
        5.2   swing right -80 0 0 over 3             # left and back
        8.4   swing right 0 60 0 over 2.6            # up and down
        11.2  swing right 0 0 0 0 0 35 over 2.4      # roll
        13.8  swing right 0 0 0 25 25 0 over 2.4     # pitch and yaw
        16.4  grab right 1 over 0.3                  # gripper: close
        17.2  grab right 0 over 0.3
        17.8  pinch right 1 over 0.2                 # gripper: open
        18.3  pinch right 0 over 0.2
        18.9  move right 0 200 -60 over 1
        20.2  leave right                            # stop and hold
        21.0  enter right 30 230 -20                 # elsewhere, with a new id: no jump
        22.0  move right 30 230 40 over 1            # back by as much
        23.6  leave right
    """,
    "short": """
        # 5 s of the same
        0.3   enter right
        1.2   swing right 0 0 -40 over 1.2
        2.4   swing right -40 30 0 over 1.2
        3.6   grab right 1 over 0.2
        4.0   grab right 0 over 0.2
        4.6   leave right
    """,
    "clutching": """
        # for clutch = "grab": the hand closes, carries, opens, goes back, and again
        0.5   enter right 0 200 40
        1.2   grab right 1 over 0.2
        1.6   move right 0 200 -60 over 1.2
        3.0   grab right 0 over 0.2
        3.4   move right 0 200 40 over 0.8
        4.4   grab right 1 over 0.2
        4.8   move right 0 200 140 over 1.2
        6.2   grab right 0 over 0.2
        6.6   leave right
        7.0   loop
    """,
    "two-hands": """
        # the left hand comes later, and stays when the right one has gone
        0.5   enter right 60 200 0
        1.5   swing right 0 0 -60 over 3
        2.0   enter left -80 200 0
        3.0   swing left 0 60 0 over 2 times 3
        5.0   leave right
        10.0  leave left
    """,
    "trouble": """
        # what goes wrong in practice, one after the other, with a hand in motion
        0.5   enter right
        1.5   swing right 0 0 -60 over 2 times 15
        3.0   new-id right
        5.0   confidence right 0.1 over 0.2
        6.0   confidence right 1 over 0.2
        8.0   stall
        8.5   resume
        11.0  malformed 30
        14.0  pause
        15.0  unpause
        17.0  leave right
        17.5  enter right
        19.0  unplug
        20.0  replug
        22.0  leave right
        22.5  enter right
        24.0  restart 1
        27.0  leave right
        27.5  enter right
        30.0  leave right
        31.0  loop
    """,
}
"""The built-in scripts. All begin without a hand, since a driver believes a service only after it
has shown nothing that could hold the clutch."""


class _Ramp(NamedTuple):
    """A gentle way from one value to another."""

    start_s: float
    over_s: float
    origin: tuple[float, ...]
    target: tuple[float, ...]

    def at(self, now_s: float) -> tuple[float, ...]:
        if now_s >= self.start_s + self.over_s:
            return self.target
        share = 0.5 - 0.5 * math.cos(math.pi * (now_s - self.start_s) / self.over_s)
        return tuple(a + (b - a) * share for a, b in zip(self.origin, self.target, strict=True))


class _Swing(NamedTuple):
    amplitude: tuple[float, ...]
    """mm and degrees."""
    period_s: float
    times: int
    start_s: float = 0.0

    def at(self, now_s: float) -> float | None:
        """The factor of the amplitude; None when it is over."""
        turns = (now_s - self.start_s) / self.period_s
        return math.sin(math.tau * turns) if turns < self.times else None


class _Set(NamedTuple):
    channel: str
    target: tuple[float, ...]
    over_s: float


class _Enter(NamedTuple):
    palm_mm: tuple[float, ...]


class _Action(NamedTuple):
    time_s: float
    verb: str
    side: str
    what: _Set | _Swing | _Enter | float | None


_CHANNELS: Mapping[str, tuple[float, ...]] = {
    "move": HOME_MM,
    "tilt": (0.0, 0.0, 0.0),
    "grab": (0.0,),
    "pinch": (0.0,),
    "confidence": (1.0,),
}


@dataclass
class _Motion:
    """How one hand moves."""

    channels: dict[str, _Ramp] = field(
        default_factory=lambda: {
            name: _Ramp(0.0, 0.0, value, value) for name, value in _CHANNELS.items()
        }
    )
    swings: list[_Swing] = field(default_factory=list)


class ScriptedHands:
    """Plays the steps of a script above a simulated tracker; afterwards all stays as it is.

    Raises ScriptError, naming the step, for arguments that its verb does not take.
    """

    def __init__(self, steps: Sequence[ScriptStep]) -> None:
        self._actions = tuple(_compile(step) for step in steps)
        for index, action in enumerate(self._actions):
            if action.verb == "loop" and (action.time_s <= 0.0 or index + 1 < len(steps)):
                raise ScriptError(f"{action.time_s:g} s loop: must be the last step, after 0 s")
        self._next = 0
        self._offset_s = 0.0
        self._motions: dict[str, _Motion] = {}

    @property
    def next_due_s(self) -> float:
        """When the next step is due, s; inf after the last. Between steps hands move with the
        service's frames."""
        if self._next >= len(self._actions):
            return math.inf
        return self._offset_s + self._actions[self._next].time_s

    def advance(self, now_s: float, service: SimulatedLeapService) -> None:
        """Do every step that is due until `now_s`, then hold the hands as they are at `now_s`."""
        while (due_s := self.next_due_s) <= now_s:
            action = self._actions[self._next]
            self._next += 1
            self._act(due_s, action, service)
        for side, motion in self._motions.items():
            if side in service.hands:
                self._hold(side, motion, now_s, service)

    def _hold(
        self, side: str, motion: _Motion, now_s: float, service: SimulatedLeapService
    ) -> None:
        x, y, z, pitch, yaw, roll = (
            *motion.channels["move"].at(now_s),
            *motion.channels["tilt"].at(now_s),
        )
        going = []
        for swing in motion.swings:
            factor = swing.at(now_s)
            if factor is not None:
                going.append(swing)
                dx, dy, dz, dpitch, dyaw, droll = (factor * a for a in swing.amplitude)
                x, y, z = x + dx, y + dy, z + dz
                pitch, yaw, roll = pitch + dpitch, yaw + dyaw, roll + droll
        motion.swings = going
        hand = service.hands[side]
        hand.palm_mm, hand.tilt_deg = (x, y, z), (pitch, yaw, roll)
        (hand.grab,) = motion.channels["grab"].at(now_s)
        (hand.pinch,) = motion.channels["pinch"].at(now_s)
        (hand.confidence,) = motion.channels["confidence"].at(now_s)

    def _act(self, due_s: float, action: _Action, service: SimulatedLeapService) -> None:
        verb, side, what = action.verb, action.side, action.what
        if isinstance(what, _Enter):
            service.enter(side)
            self._motions[side] = motion = _Motion()
            motion.channels["move"] = _Ramp(due_s, 0.0, what.palm_mm, what.palm_mm)
        elif isinstance(what, _Set):
            channels = self._motions.setdefault(side, _Motion()).channels
            origin = channels[what.channel].at(due_s)
            channels[what.channel] = _Ramp(due_s, what.over_s, origin, what.target)
        elif isinstance(what, _Swing):
            motion = self._motions.setdefault(side, _Motion())
            motion.swings.append(what._replace(start_s=due_s))
        elif verb == "leave":
            service.leave(side)
        elif verb == "new-id":
            service.new_id(side)
        elif verb == "pause":
            service.set_device(service.attached, False)
        elif verb == "unpause":
            service.set_device(service.attached, service.attached)
        elif verb in ("stall", "resume"):
            service.stalled = verb == "stall"
        elif verb == "unplug":
            service.unplug()
        elif verb == "replug":
            service.replug()
        elif verb == "steal-focus":
            service.steal_focus()
        elif verb == "restart":
            service.restart(RESTART_S if what is None else what)
        elif verb == "malformed":
            service.break_next(1 if what is None else int(what))
        else:
            self._offset_s = due_s
            self._next = 0


def play(
    service: SimulatedLeapService, hands: ScriptedHands, until_s: float
) -> list[tuple[float, int, str]]:
    """Run `service` with `hands` until `until_s`; time, client and text of what it sent."""
    sent: list[tuple[float, int, str]] = []
    while (due_s := min(service.next_due_s, hands.next_due_s)) <= until_s:
        hands.advance(due_s, service)
        service.advance(due_s)
        sent += [(due_s, number, text) for number, text in service.outgoing()]
    return sent


def _compile(step: ScriptStep) -> _Action:
    """Turn the words of one step into what it does."""
    verb = step.verb
    where = f"{step.time_s:g} s {verb}"
    usage = SCRIPT_VERBS[verb]
    words = list(step.args)

    def number(name: str, lowest: float = -math.inf, highest: float = math.inf) -> float:
        if not words:
            raise ScriptError(f"{where}: {name} is missing; usage: {usage}")
        text = words.pop(0)
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not lowest <= value <= highest or math.isinf(value):
            limits = "" if math.isinf(lowest) else f" from {lowest:g}"
            limits += "" if math.isinf(highest) else f" to {highest:g}"
            raise ScriptError(f"{where}: {name} is {text!r}, must be a number{limits}")
        return value

    def keyword(name: str) -> bool:
        found = words[:1] == [name]
        del words[: int(found)]
        return found

    def position() -> tuple[float, ...]:
        return tuple(number(axis, -2000.0, 2000.0) for axis in ("X", "Y", "Z"))

    def angles() -> tuple[float, ...]:
        return tuple(number(angle, -180.0, 180.0) for angle in ("PITCH", "YAW", "ROLL"))

    def over() -> float:
        return number("SECONDS", 0.0) if keyword("over") else 0.0

    side = ""
    if usage.startswith(f"{verb} left|right"):
        side = words.pop(0) if words else ""
        if side not in HANDS:
            raise ScriptError(f"{where}: {side!r} must be left or right; usage: {usage}")
    what: _Set | _Swing | _Enter | float | None = None
    if verb == "enter":
        what = _Enter(position() if words else HOME_MM)
    elif verb == "move":
        what = _Set(verb, position(), over())
    elif verb == "tilt":
        what = _Set(verb, angles(), over())
    elif verb in ("grab", "pinch", "confidence"):
        what = _Set(verb, (number("STRENGTH", 0.0, 1.0),), over())
    elif verb == "swing":
        amplitude = position()
        amplitude += (0.0, 0.0, 0.0) if words[:1] in ([], ["over"]) else angles()
        if not keyword("over"):
            raise ScriptError(f"{where}: 'over' is missing; usage: {usage}")
        period_s = number("SECONDS", 0.01)
        what = _Swing(amplitude, period_s, int(number("N", 1.0)) if keyword("times") else 1)
    elif verb == "restart" and words:
        what = number("SECONDS", 0.0)
    elif verb == "malformed" and words:
        what = number("FRAMES", 1.0)
    if words:
        raise ScriptError(f"{where}: {' '.join(words)!r} is too much; usage: {usage}")
    return _Action(step.time_s, verb, side, what)
