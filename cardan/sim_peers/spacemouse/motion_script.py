"""Motion scripts of an operator at the simulated puck, as a function of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.motion_profile import VectorMotion, VectorRamp
from cardan.sim_peers.scripted import Action, HeldDevice, MotionScript, StepWords, calling, moving
from cardan.sim_peers.spacemouse.core import AXES, NEUTRAL, Axes

MOTION_PERIOD_S = 0.008
"""Sample period of a motion: the shortest report period of a device."""

SCRIPT_VERBS: Mapping[str, str] = {
    "axes": "axes X Y Z RX RY RZ [over SECONDS] (ramp the deflection there, each in -1..1)",
    "swing": (
        "swing X Y Z RX RY RZ over SECONDS [times N] [phase DEGREES] (add N sine periods of "
        "SECONDS each)"
    ),
    "neutral": "neutral [over SECONDS] (let go: ends ramps and swings)",
    "press": "press LABEL (a button by its name, or first or second)",
    "release": "release LABEL (let go of a button)",
    "unplug": "unplug (the device is gone)",
    "replug": "replug (the device is back)",
    "silence": "silence (its reports stop)",
    "resume": "resume (it sends reports again)",
    "loop": "loop (the last step: start again)",
}
"""Usage of each verb of a script. Deflections are -1..1 in the robot frame.

``axes`` ramps linearly from the present axes; ``swing`` adds N whole sine periods of SECONDS each
on top; ``neutral`` ends both. LABEL is a button's label, or ``first`` or ``second`` for the two
lowest buttons of whatever model it is. ``silence`` stops the device's reports until ``resume``;
``loop`` starts the script again.
"""

SCRIPTS: Mapping[str, str] = {
    "rest": """
        # touch the cap, let go, and leave it alone
        0.2  axes 0 0 0.2 0 0 0 over 0.1
        0.3  neutral over 0.1
    """,
    # Every axis returns to where it began: swings integrate to zero, and the stroke that the
    # dead-man interrupts at 21.4 s has the same area as the one back after the new grip.
    "demo": """
        # 28 s of everything: translation, gripper, rotation, letting go in mid-motion
        0.2   axes 0 0 0.2 0 0 0 over 0.1              # touch and let go: shows a neutral puck
        0.3   neutral over 0.1
        1.0   press first                              # the dead-man
        1.2   swing 0.6 0 0 0 0 0 over 3               # forward and back
        4.2   swing 0 0.6 0 0 0 0 over 3               # left and back
        7.2   swing 0 0 0.6 0 0 0 over 2.6             # up and down
        9.8   swing 0 0.6 0 0 0 0 over 4               # a figure of eight in y and z
        9.8   swing 0 0 0.6 0 0 0 over 2 times 2
        14.0  press second                             # gripper
        14.3  release second
        14.5  swing 0 0 0 0 0 0.7 over 3               # yaw
        17.5  swing 0 0 0 0.6 0 0 over 2.4             # roll with twice as fast a pitch
        17.5  swing 0 0 0 0 0.5 0 over 1.2 times 2
        20.2  axes 0.6 0 0 0 0 0 over 0.5              # forward ...
        21.4  release first                            # ... and the dead-man goes: brake
        21.8  neutral over 0.3
        22.8  press first                              # a new grip, from neutral
        23.1  axes -0.6 0 0 0 0 0 over 0.5             # back by as much
        24.05 neutral over 0.5
        24.8  press second
        25.1  release second
        25.4  swing 0.4 0.4 0.4 0 0 0.4 over 2.1       # all together
        27.8  release first
    """,
    "short": """
        # 6 s of the same
        0.05  axes 0 0 0.2 0 0 0 over 0.05
        0.1   neutral over 0.05
        0.4   press first
        0.6   swing 0.5 0 0 0 0 0 over 1.2
        1.8   swing 0 0.5 0.3 0 0 0 over 1.2
        3.0   swing 0 0 0 0.3 0 0.5 over 1.2
        4.3   press second
        4.5   release second
        4.6   axes 0 0 -0.4 0 0 0 over 0.2
        4.9   release first
        5.1   neutral over 0.2
        5.5   press first
        5.8   release first
    """,
    # A circle in x and y to the left, then the same to the right. The ramp to the start of a cosine
    # is dropped as the cosine begins; the two turns cancel its area.
    "circle": """
        # a circle to the left, then one to the right
        0.2   axes 0 0 0.2 0 0 0 over 0.1
        0.3   neutral over 0.1
        1.0   press first
        1.2   axes 0 0.5 0 0 0 0 over 0.4
        1.6   axes 0 0 0 0 0 0
        1.6   swing 0.5 0 0 0 0 0 over 5
        1.6   swing 0 0.5 0 0 0 0 over 5 phase 90
        6.6   axes 0 0.5 0 0 0 0
        6.6   axes 0 -0.5 0 0 0 0 over 0.8
        7.4   axes 0 0 0 0 0 0
        7.4   swing 0.5 0 0 0 0 0 over 5
        7.4   swing 0 -0.5 0 0 0 0 over 5 phase 90
        12.4  axes 0 -0.5 0 0 0 0
        12.4  neutral over 0.4
        13.0  release first
    """,
    "strokes": """
        # the second button, the dead-man, a stroke to the left and back, one up and down; for ever
        0.2   axes 0 0 0.2 0 0 0 over 0.1
        0.3   neutral over 0.1
        0.8   press second                             # enables a robot that wants it
        1.0   release second
        1.5   press first
        1.7   swing 0 0.6 0 0 0 0 over 2
        3.7   swing 0 0 0.6 0 0 0 over 2
        6.0   release first
        6.5   loop
    """,
    "taps": """
        # buttons only, for ever
        0.2   axes 0 0 0.2 0 0 0 over 0.1
        0.3   neutral over 0.1
        1.0   press first
        1.1   release first
        1.4   press second
        1.5   release second
        1.8   press first
        1.9   press second
        2.0   release first
        2.1   release second
        2.4   loop
    """,
    "wiggle": """
        # small motions on all axes without any button, for ever
        0.2   axes 0 0 0.2 0 0 0 over 0.1
        0.3   neutral over 0.1
        1.0   swing 0.3 0 0 0 0 0.3 over 2
        2.0   swing 0 0.3 0 0 0.3 0 over 2
        3.0   swing 0 0 0.3 0.3 0 0 over 2
        5.5   loop
    """,
}
"""The built-in scripts. All begin with a touch and a release, since a driver accepts a device
only after it has seen it at rest."""


class PuckModel(Protocol):
    """Data of a model that a motion script needs."""

    @property
    def name(self) -> str:
        """Name for people."""

    @property
    def buttons(self) -> Mapping[int, str]:
        """Label by bit."""


class Puck(HeldDevice, Protocol):
    """A simulated device as its script sees it; times are s from plugging in."""

    axes: Axes

    @property
    def model(self) -> PuckModel:
        """Model of the device."""

    @property
    def led(self) -> bool | None:
        """State of its LED; None: it has none."""

    @property
    def held(self) -> tuple[str, ...]:
        """Labels of the buttons that are down, oldest first."""

    def set_axes(self, axes: Sequence[float]) -> None:
        """Deflect it: six values in -1..1, robot frame."""

    def press(self, label: str) -> None:
        """Press a button."""

    def release(self, label: str) -> None:
        """Release a button."""

    def unplug(self) -> None:
        """Unplug the device."""

    def replug(self) -> None:
        """Plug the device in again."""

    def silence(self) -> None:
        """Stop sending until `resume`."""

    def resume(self) -> None:
        """Resume sending."""


class ScriptedPuck(MotionScript[Puck]):
    """Plays the steps of a script on a device of `model`."""

    def __init__(self, steps: Sequence[ScriptStep], model: PuckModel, start_s: float = 0.0) -> None:
        self._model = model
        self._axes = VectorMotion(NEUTRAL, MOTION_PERIOD_S)
        super().__init__(steps, SCRIPT_VERBS, [self._axes], start_s)

    def _hold(self, device: Puck, now_s: float) -> None:
        device.set_axes(self._axes.advance(now_s))

    def _read(self, words: StepWords) -> Action[Puck]:
        if words.verb == "axes":
            return moving(self._axes, VectorRamp(words.numbers(AXES, -1.0, 1.0), words.over()))
        if words.verb == "neutral":
            return moving(self._axes, VectorRamp(NEUTRAL, words.over(), ends_swings=True))
        if words.verb == "swing":
            amplitude = words.numbers(AXES, -1.0, 1.0)
            return moving(self._axes, words.swing(amplitude, MOTION_PERIOD_S))
        labels = [self._label(words)] if words.verb in ("press", "release") else []
        return calling(words.verb, *labels)

    def _label(self, words: StepWords) -> str:
        word = words.word("LABEL")
        buttons = self._model.buttons
        labels = [buttons[bit] for bit in sorted(buttons)]
        by_word = {"first": labels[:1], "second": labels[1:2]}.get(word, [word])
        if not by_word or by_word[0] not in labels:
            raise words.error(
                f"{self._model.name} has no button {word!r}; "
                f"it has: {', '.join(labels) or 'no buttons'}"
            )
        return by_word[0]
