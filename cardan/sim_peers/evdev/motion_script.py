"""Motion scripts of an operator at the simulated pad or keyboard, as a function of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.evdev.core import NEUTRAL, SimulatedInput
from cardan.sim_peers.motion_profile import VectorMotion, VectorRamp
from cardan.sim_peers.scripted import Action, MotionScript, StepWords, calling, moving

MOTION_PERIOD_S = 0.004
"""Sample period of a motion: a pad's poll period."""

SCRIPT_VERBS: Mapping[str, str] = {
    "sticks": (
        "sticks LX LY RX RY [over SECONDS] (ramp the sticks there, each -1..1, to the right and up)"
    ),
    "triggers": "triggers LEFT RIGHT [over SECONDS] (ramp the triggers there, 0..1)",
    "swing": (
        "swing LX LY RX RY over SECONDS [times N] [phase DEGREES] (add N sine periods of "
        "SECONDS each)"
    ),
    "neutral": "neutral [over SECONDS] (let go of sticks and triggers: ends ramps and swings)",
    "press": "press LABEL (a button or a key by its name)",
    "release": "release LABEL (let go of it)",
    "hold": "hold LABEL for SECONDS (press it, and release it later)",
    "unplug": "unplug (the device is gone)",
    "replug": "replug (the device is back)",
    "silence": "silence (its events stop)",
    "resume": "resume (it sends events again)",
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
    "strokes": """
        # the dead-man, a stroke to the left and back, one up and down, let go; for ever
        0.3   hold start for 0.1
        1.5   press left-shoulder
        1.7   swing -0.6 0 0 0 over 2
        3.7   swing 0 0 0 0.6 over 2
        6.0   release left-shoulder
        6.5   loop
    """,
    "circle": """
        # a circle to the left; the ramp that takes the device there is dropped as the sine begins
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
"""The built-in scripts of each kind of device. All begin with a touch, since a driver accepts
a device only after its first event."""


_STICKS = ("LX", "LY", "RX", "RY")


class ScriptedInput(MotionScript[SimulatedInput]):
    """Plays the steps of a script on `device`."""

    def __init__(self, steps: Sequence[ScriptStep], device: SimulatedInput) -> None:
        self._device = device
        self._controls = VectorMotion(NEUTRAL, MOTION_PERIOD_S)
        super().__init__(steps, SCRIPT_VERBS, [self._controls])

    def _hold(self, device: SimulatedInput, now_s: float) -> None:
        device.set_controls(self._controls.advance(now_s))

    def _timed(self, words: StepWords) -> list[tuple[float, Action[SimulatedInput]]]:
        if words.verb != "hold":
            return super()._timed(words)
        label = self._label(words)
        words.needs("for")
        end_s = words.time_s + words.number("SECONDS", 0.0)
        words.end()
        return [(words.time_s, calling("press", label)), (end_s, calling("release", label))]

    def _read(self, words: StepWords) -> Action[SimulatedInput]:
        model = self._device.model
        if words.verb in ("sticks", "triggers", "swing") and not model.is_gamepad:
            raise words.error(f"{model.name} has no sticks and no triggers")
        if words.verb == "sticks":
            sticks = words.numbers(_STICKS, -1.0, 1.0)
            return moving(self._controls, VectorRamp((*sticks, None, None), words.over()))
        if words.verb == "triggers":
            triggers = words.numbers(("LEFT", "RIGHT"), 0.0, 1.0)
            return moving(self._controls, VectorRamp((None,) * 4 + triggers, words.over()))
        if words.verb == "neutral":
            return moving(self._controls, VectorRamp(NEUTRAL, words.over(), ends_swings=True))
        if words.verb == "swing":
            sticks = words.numbers(_STICKS, -1.0, 1.0)
            return moving(self._controls, words.swing((*sticks, 0.0, 0.0), MOTION_PERIOD_S))
        labels = [self._label(words)] if words.verb in ("press", "release") else []
        return calling(words.verb, *labels)

    def _label(self, words: StepWords) -> str:
        word, labels = words.word("LABEL"), self._device.labels
        if word not in labels:
            raise words.error(
                f"{self._device.model.name} has no button {word!r}; it has: {', '.join(labels)}"
            )
        return word
