"""Motion scripts of the operator of a simulated remote, as a function of time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.motion_profile import VectorMotion, VectorRamp
from cardan.sim_peers.scripted import Action, MotionScript, StepWords, calling, moving, setting
from cardan_wiimote.peer.core import ZERO, SimulatedWiimote
from cardan_wiimote.protocol import BUTTONS, IrDot
from cardan_wiimote.protocol.camera import HEIGHT, WIDTH

MOTION_PERIOD_S = 0.005
"""Sample period of a motion."""

SCRIPT_VERBS: Mapping[str, str] = {
    "tilt": "tilt ROLL PITCH YAW [over SECONDS] (ramp the angles there)",
    "swing": (
        "swing ROLL PITCH YAW over SECONDS [times N] [phase DEGREES] (add N sine periods of "
        "SECONDS each)"
    ),
    "level": "level [over SECONDS] (back to level: ends ramps and swings)",
    "push": (
        "push X Y Z over SECONDS [times N] (accelerate to and fro, g, along the remote's "
        "forward, left and up)"
    ),
    "stick": "stick X Y [over SECONDS] (the Nunchuk's stick, each in -1..1: right, forward)",
    "press": (
        "press LABEL (a, b, 1, 2, plus, minus, home, up, down, left, right; c, z of a Nunchuk)"
    ),
    "release": "release LABEL (let go of it)",
    "dots": (
        "dots [X Y ...] (what the camera sees, up to four points in 1024 x 768; none: nothing)"
    ),
    "battery": "battery 0..255 (0 to 255; new cells show about 200)",
    "plug": "plug nunchuk (a Nunchuk is plugged in)",
    "unplug": "unplug (the Nunchuk is pulled out)",
    "power-off": "power-off (the remote is switched off)",
    "power-on": "power-on (the remote is switched on)",
    "leave": "leave (out of radio range; after 2 s the link is given up)",
    "come-back": "come-back (in radio range again)",
    "silence": "silence (it neither sends nor obeys, with the link up)",
    "resume": "resume (it sends and obeys again)",
    "loop": "loop",
}
"""Usage of each verb of a script. Angles are in degrees: roll right side down, pitch nose up, yaw
to the left.

``tilt`` ramps the angles from where they are; ``swing`` adds N whole sine periods of SECONDS each
on top; ``level`` ends both. ``push`` accelerates by N sine periods of X forward, Y left, Z up, in
g. ``stick`` is the Nunchuk's, -1..1, right and forward. ``dots`` are those in the camera's view, up
to four of X 0..1023 and Y 0..767. ``leave`` and ``come-back`` are about radio range; ``silence``
stops everything but the link until ``resume``; ``loop`` starts the script again.
"""

SCRIPTS: Mapping[str, str] = {
    "rest": """
        # level and still, no buttons
    """,
    # Swings take the remote back to level, A and B alone are held equally long, and the tilt that
    # the release interrupts has the same area as the one back: all integrates to zero.
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


class ScriptedWiimote(MotionScript[SimulatedWiimote]):
    """Plays the steps of a script on a remote.

    Raises ScriptError also for steps that need a Nunchuk if `extension` is none and the script
    plugs none.
    """

    def __init__(self, steps: Sequence[ScriptStep], extension: str = "") -> None:
        self._has_nunchuk = extension == "nunchuk"
        self._angles_rad = VectorMotion(ZERO, MOTION_PERIOD_S)
        self._acceleration_g = VectorMotion(ZERO, MOTION_PERIOD_S)
        self._stick = VectorMotion((0.0, 0.0), MOTION_PERIOD_S)
        motions = (self._angles_rad, self._acceleration_g, self._stick)
        super().__init__(steps, SCRIPT_VERBS, motions)

    def _hold(self, device: SimulatedWiimote, now_s: float) -> None:
        angles_rad = self._angles_rad.advance(now_s)
        device.set_attitude(*angles_rad, self._angles_rad.rates_at(now_s))
        device.set_acceleration(self._acceleration_g.advance(now_s))
        device.set_stick(*self._stick.advance(now_s))

    def _read(self, words: StepWords) -> Action[SimulatedWiimote]:
        if words.verb in _READERS:
            return _READERS[words.verb](self, words)
        if words.verb == "plug":
            if words.left != ["nunchuk"]:
                what = " ".join(words.left)
                raise words.error(f"{what!r} cannot be plugged; usage: {words.usage}")
            words.left.clear()
            self._has_nunchuk = True
        method = words.verb.replace("-", "_")
        return lambda remote, at_s: getattr(remote, method)(at_s)

    def _tilt(self, words: StepWords) -> Action[SimulatedWiimote]:
        return moving(self._angles_rad, VectorRamp(_angles_rad(words), words.over()))

    def _level(self, words: StepWords) -> Action[SimulatedWiimote]:
        return moving(self._angles_rad, VectorRamp(ZERO, words.over(), ends_swings=True))

    def _swing(self, words: StepWords) -> Action[SimulatedWiimote]:
        return moving(self._angles_rad, words.swing(_angles_rad(words), MOTION_PERIOD_S))

    def _push(self, words: StepWords) -> Action[SimulatedWiimote]:
        amplitude_g = words.numbers(("X", "Y", "Z"), -4.0, 4.0)
        return moving(self._acceleration_g, words.swing(amplitude_g, MOTION_PERIOD_S, phased=False))

    def _move_stick(self, words: StepWords) -> Action[SimulatedWiimote]:
        act = moving(self._stick, VectorRamp(words.numbers(("X", "Y"), -1.0, 1.0), words.over()))
        self._need_nunchuk(words)
        return act

    def _button(self, words: StepWords) -> Action[SimulatedWiimote]:
        label, labels = words.word("LABEL"), (*BUTTONS.values(), *_NUNCHUK_BUTTONS)
        if label not in labels:
            raise words.error(f"there is no button {label!r}; there are: {', '.join(labels)}")
        act = calling(words.verb, label)
        if label not in _NUNCHUK_BUTTONS:
            return act
        self._need_nunchuk(words)
        return lambda remote, at_s: None if remote.port.nunchuk is None else act(remote, at_s)

    def _dots(self, words: StepWords) -> Action[SimulatedWiimote]:
        dots: list[IrDot] = []
        while words.left and len(dots) < 4:
            x_count = words.number("X", 0.0, WIDTH - 1)
            y_count = words.number("Y", 0.0, HEIGHT - 1)
            dots.append(IrDot(round(x_count), round(y_count), 3))
        return calling("set_dots", tuple(dots))

    def _battery(self, words: StepWords) -> Action[SimulatedWiimote]:
        return setting("battery", round(words.number("level", 0.0, 255.0)))

    def _need_nunchuk(self, words: StepWords) -> None:
        if not self._has_nunchuk:
            raise words.error("there is no Nunchuk; choose the extension 'nunchuk'")


_READERS: Mapping[str, Callable[[ScriptedWiimote, StepWords], Action[SimulatedWiimote]]] = {
    "tilt": ScriptedWiimote._tilt,
    "level": ScriptedWiimote._level,
    "swing": ScriptedWiimote._swing,
    "push": ScriptedWiimote._push,
    "stick": ScriptedWiimote._move_stick,
    "press": ScriptedWiimote._button,
    "release": ScriptedWiimote._button,
    "dots": ScriptedWiimote._dots,
    "battery": ScriptedWiimote._battery,
}
"""Readers of the words of verbs that are not methods of the remote."""
_NUNCHUK_BUTTONS = ("c", "z")


def _angles_rad(words: StepWords) -> tuple[float, ...]:
    return tuple(map(math.radians, words.numbers(("ROLL", "PITCH", "YAW"), -720.0, 720.0)))
