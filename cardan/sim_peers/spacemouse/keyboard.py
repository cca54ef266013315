"""Keyboard control of the simulated puck from a terminal."""

from __future__ import annotations

import math
import os
import re
import termios
import tty
from collections.abc import Mapping

from cardan.errors import ScriptError
from cardan.sim_peers.spacemouse.core import NEUTRAL
from cardan.sim_peers.spacemouse.motion_script import MOTION_PERIOD_S, Puck

KEY_AXES: Mapping[str, tuple[int, float]] = {
    "w": (0, 1.0),
    "s": (0, -1.0),
    "a": (1, 1.0),
    "d": (1, -1.0),
    "r": (2, 1.0),
    "f": (2, -1.0),
    "l": (3, 1.0),
    "j": (3, -1.0),
    "i": (4, 1.0),
    "k": (4, -1.0),
    "u": (5, 1.0),
    "o": (5, -1.0),
}
"""Axis and direction of each key, as seen by the operator: w forward, a left, r up; i tilts away,
j to the left, u turns counter-clockwise."""
KEY_BUTTONS: Mapping[str, int] = {" ": 0, "\n": 1, "\r": 1}
"""Button, counted from the lowest, that each key presses and releases in turn."""
KEYBOARD_HELP = (
    "w/s a/d r/f: move   i/k j/l u/o: turn   capitals: full deflection   "
    "space, enter: buttons down/up   Ctrl-C: end"
)

KEY_HOLD_S = 0.15
"""Time without a repetition after which a key is up: terminals repeat at 25 to 30 Hz."""
KEY_DEFLECTION = 0.5
"""Deflection by a lowercase letter; capitals deflect fully."""
KEY_SPEED = 4.0
"""Rate at which a deflection builds up and decays, per second: a hand does not jump."""

_ESCAPE_SEQUENCE = re.compile(r"\x1b(\[[0-9;]*[@-~]|O.|.)?")


class KeyboardMotion:
    """Turns key strokes and their times into deflections and buttons. Reads nothing itself."""

    def __init__(self) -> None:
        self._axes = list(NEUTRAL)
        self._pulls = [(0.0, 0.0)] * 6
        self._toggles: list[int] = []
        self._now_s = 0.0

    def feed(self, text: str, now_s: float) -> None:
        """Process the characters that the terminal gave at `now_s`; unknown ones have no effect."""
        self._move(now_s)
        for key in _ESCAPE_SEQUENCE.sub("", text):
            if key in KEY_BUTTONS:
                self._toggles.append(KEY_BUTTONS[key])
            elif key.lower() in KEY_AXES:
                axis, sign = KEY_AXES[key.lower()]
                size = 1.0 if key.isupper() else KEY_DEFLECTION
                self._pulls[axis] = (sign * size, now_s + KEY_HOLD_S)

    @property
    def next_due_s(self) -> float:
        """Time of the next work of `advance`, s; inf at rest."""
        if self._toggles:
            return self._now_s
        pulled = any(end_s > self._now_s for _, end_s in self._pulls)
        return self._now_s + MOTION_PERIOD_S if pulled or any(self._axes) else math.inf

    def advance(self, now_s: float, device: Puck) -> None:
        """Apply the keys to `device` until `now_s`."""
        self._move(now_s)
        labels = [device.model.buttons[bit] for bit in sorted(device.model.buttons)]
        for index in self._toggles:
            if index < len(labels):
                if labels[index] in device.held:
                    device.release(labels[index])
                else:
                    device.press(labels[index])
        self._toggles.clear()
        device.set_axes(self._axes)

    def _move(self, now_s: float) -> None:
        for axis, (pull, end_s) in enumerate(self._pulls):
            let_go_s = min(now_s, max(self._now_s, end_s))
            value = _towards(self._axes[axis], pull, KEY_SPEED * (let_go_s - self._now_s))
            self._axes[axis] = _towards(value, 0.0, KEY_SPEED * (now_s - let_go_s))
        self._now_s = now_s


def _towards(value: float, target: float, step: float) -> float:
    return min(target, value + step) if value < target else max(target, value - step)


def status_line(device: Puck) -> str:
    """Return the device's state in one line for the user: LED, deflections, buttons."""
    led = {True: "LED on   ", False: "LED off  ", None: ""}[device.led]
    names = ("x", "y", "z", "rx", "ry", "rz")
    axes = " ".join(f"{n} {value:+.2f}" for n, value in zip(names, device.axes, strict=True))
    return f"{led}{axes}  {' '.join(device.held) or '-'}"


class Terminal:
    """Terminal on file descriptor `fd`, in unbuffered mode without echo while open."""

    def __init__(self, fd: int = 0) -> None:
        self.fd = fd
        self._settings: list[object] | None = None

    def open(self) -> None:
        """Set the terminal's mode. Raises ScriptError if `fd` is not a terminal."""
        if not os.isatty(self.fd):
            raise ScriptError("keyboard: standard input is not a terminal; give a script instead")
        self._settings = termios.tcgetattr(self.fd)
        tty.setcbreak(self.fd, termios.TCSANOW)

    def read(self) -> str:
        """Return the typed keys; call it when `fd` is readable. Empty if the terminal is closed."""
        try:
            return os.read(self.fd, 256).decode(errors="ignore")
        except OSError:
            return ""

    def close(self) -> None:
        """Restore the terminal's mode."""
        if self._settings is not None:
            termios.tcsetattr(self.fd, termios.TCSANOW, self._settings)  # type: ignore[arg-type]
            self._settings = None
