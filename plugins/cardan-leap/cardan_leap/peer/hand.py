"""Scripted hands: an operator's motions above the simulated tracker, as a function of time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.motion_profile import SinePeriods, VectorMotion, VectorRamp
from cardan.sim_peers.scripted import Action, MotionScript, StepWords, calling, setting
from cardan_leap.peer.core import SimulatedLeapService
from cardan_leap.peer.faults import RESTART_S
from cardan_leap.protocol import HANDS

SHORTEST_SWING_S = 0.01
"""Shortest period of a swing."""

SCRIPT_VERBS: Mapping[str, str] = {
    "enter": (
        "enter left|right [X Y Z] (a hand comes into view, with a new id, open and flat; at 0"
        " 200 0 unless said otherwise)"
    ),
    "leave": "leave left|right (it leaves)",
    "move": "move left|right X Y Z [over SECONDS] (it goes there, starting and ending gently)",
    "tilt": "tilt left|right PITCH YAW ROLL [over SECONDS] (it turns to there, likewise)",
    "swing": (
        "swing left|right X Y Z [PITCH YAW ROLL] over SECONDS [times N] (add N sine periods "
        "of SECONDS each)"
    ),
    "grab": "grab left|right STRENGTH [over SECONDS] (it closes (1) or opens (0))",
    "pinch": (
        "pinch left|right STRENGTH [over SECONDS] (thumb and index finger meet (1) or part (0))"
    ),
    "confidence": "confidence left|right VALUE [over SECONDS] (the service's confidence in it)",
    "new-id": "new-id left|right (it is lost and found between two frames)",
    "unplug": "unplug (the tracker's cable is pulled; clients are informed)",
    "replug": "replug (the tracker's cable is back; clients are informed)",
    "pause": "pause (its delivery stops; clients are informed)",
    "unpause": "unpause (delivery continues; clients are informed)",
    "stall": "stall (frames stop without notice)",
    "resume": "resume (frames go on)",
    "steal-focus": "steal-focus (another program takes the focus)",
    "restart": (
        "restart [SECONDS] (the service is gone for this time (1), then all counters restart)"
    ),
    "malformed": "malformed [FRAMES] (this number of frames (1) is cut short)",
    "loop": "loop",
}
"""Usage of each verb of a script. Positions are in the tracker's axes, mm: X right, Y up, Z towards
the operator; angles in degrees: PITCH fingers up, YAW fingers to the right, ROLL left edge down.
Strengths and confidence are 0 to 1.

``move``, ``tilt``, ``grab``, ``pinch`` and ``confidence`` start and end gently; ``swing`` adds N
whole sine periods of SECONDS each on top. ``unplug`` and ``replug`` are the tracker's cable,
``pause`` and ``unpause`` its delivery; ``stall`` stops the frames without notice until ``resume``.
``restart`` stops the service for SECONDS, ``malformed`` truncates the next FRAMES, ``loop`` starts
the script again.
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
"""Built-in scripts. All begin without a hand, since a driver uses a service only after a frame
without a hand that could hold the clutch."""


_CHANNELS: Mapping[str, tuple[float, ...]] = {
    "move": HOME_MM,
    "tilt": (0.0, 0.0, 0.0),
    "grab": (0.0,),
    "pinch": (0.0,),
    "confidence": (1.0,),
}


_Channels = Mapping[str, VectorMotion[tuple[float, ...]]]
"""Motion channels of a hand."""


def _channels(palm_mm: tuple[float, ...] = HOME_MM) -> _Channels:
    values = {**_CHANNELS, "move": palm_mm}
    return {name: VectorMotion(value, gentle=True) for name, value in values.items()}


class ScriptedHands(MotionScript[SimulatedLeapService]):
    """Player of a script's steps above a simulated tracker. Between steps hands move with the
    service's frames."""

    def __init__(self, steps: Sequence[ScriptStep]) -> None:
        self._hands: dict[str, _Channels] = {}
        super().__init__(steps, SCRIPT_VERBS)

    def _hold(self, device: SimulatedLeapService, now_s: float) -> None:
        for side, channels in self._hands.items():
            if side in device.hands:
                hand = device.hands[side]
                x, y, z = channels["move"].advance(now_s)
                pitch, yaw, roll = channels["tilt"].advance(now_s)
                hand.palm_mm, hand.tilt_deg = (x, y, z), (pitch, yaw, roll)
                (hand.grab,) = channels["grab"].advance(now_s)
                (hand.pinch,) = channels["pinch"].advance(now_s)
                (hand.confidence,) = channels["confidence"].advance(now_s)

    def _read(self, words: StepWords) -> Action[SimulatedLeapService]:
        if words.usage.startswith(f"{words.verb} left|right"):
            side = words.left.pop(0) if words.left else ""
            if side not in HANDS:
                raise words.error(f"{side!r} must be left or right; usage: {words.usage}")
            return self._read_hand(words, side)
        if words.verb == "restart":
            return calling("restart", words.number("SECONDS", 0.0) if words.left else RESTART_S)
        if words.verb == "malformed":
            return calling("break_next", int(words.number("FRAMES", 1.0)) if words.left else 1)
        return _ACTIONS[words.verb]

    def _read_hand(self, words: StepWords, side: str) -> Action[SimulatedLeapService]:
        """Return the action of a step on a hand."""
        if words.verb == "enter":
            return self._entering(side, _position(words) if words.left else HOME_MM)
        if words.verb == "swing":
            amplitude = _position(words)
            angles = (0.0, 0.0, 0.0) if words.left[:1] in ([], ["over"]) else _angles(words)
            swing = words.swing(amplitude, SHORTEST_SWING_S, phased=False)
            return self._moving(side, move=swing, tilt=swing._replace(amplitude=angles))
        if words.verb in _GOALS:
            ramp = VectorRamp(_GOALS[words.verb](words), words.over())
            return self._moving(side, **{words.verb: ramp})
        return calling(words.verb.replace("-", "_"), side)

    def _entering(self, side: str, palm_mm: tuple[float, ...]) -> Action[SimulatedLeapService]:
        def enter(service: SimulatedLeapService, _: float) -> None:
            service.enter(side)
            self._hands[side] = _channels(palm_mm)

        return enter

    def _moving(
        self, side: str, **strokes: VectorRamp | SinePeriods
    ) -> Action[SimulatedLeapService]:
        """Motion profiles by their channels, of a hand that a script may move before it appears."""

        def move(_: SimulatedLeapService, at_s: float) -> None:
            channels = self._hands.setdefault(side, _channels())
            for channel, stroke in strokes.items():
                channels[channel].start(at_s, stroke)

        return move


def _position(words: StepWords) -> tuple[float, ...]:
    return words.numbers(("X", "Y", "Z"), -2000.0, 2000.0)


def _angles(words: StepWords) -> tuple[float, ...]:
    return words.numbers(("PITCH", "YAW", "ROLL"), -180.0, 180.0)


def _strength(words: StepWords) -> tuple[float, ...]:
    return words.numbers(("STRENGTH",), 0.0, 1.0)


_GOALS: Mapping[str, Callable[[StepWords], tuple[float, ...]]] = {
    "move": _position,
    "tilt": _angles,
    "grab": _strength,
    "pinch": _strength,
    "confidence": _strength,
}
"""Parsers of a channel's target, by verb."""

_ACTIONS: Mapping[str, Action[SimulatedLeapService]] = {
    "unplug": calling("unplug"),
    "replug": calling("replug"),
    "pause": lambda service, _: service.set_device(service.attached, False),
    "unpause": lambda service, _: service.set_device(service.attached, service.attached),
    "stall": setting("stalled", True),
    "resume": setting("stalled", False),
    "steal-focus": calling("steal_focus"),
}
"""Actions of steps without arguments."""
