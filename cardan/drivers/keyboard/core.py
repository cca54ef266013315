"""Interpreter of a keyboard's events, without any I/O and in the caller's time.

A key held down deflects, a released key does not. Keys down together with Ctrl, Alt or Meta are
meant for other programs (Ctrl-C), and do not move the robot until they have been released.
"""

from __future__ import annotations

from collections.abc import Mapping

from cardan.drivers.evdev.core import EvdevCore
from cardan.drivers.keyboard.options import KeyboardOptions
from cardan.drivers.shaping import Shaper
from cardan.protocols.evdev.codes import KEY_CODES, KEYS
from cardan.types import Axes, DeviceLink

_LETTERS = ("a z", "s x", "d c", "f v", "g b", "h n")
_ARROWS = ("up down", "left right", "page-up page-down", "kp-9 kp-7", "kp-8 kp-2", "kp-4 kp-6")


def _motion_keys(pairs: tuple[str, ...]) -> dict[int, tuple[int, float]]:
    """Build the map from key code to axis and sign, from a pair of keys for each axis."""
    return {
        KEY_CODES[label]: (axis, sign)
        for axis, pair in enumerate(pairs)
        for label, sign in zip(pair.split(), (1.0, -1.0), strict=True)
    }


MOTION_KEYS: Mapping[str, Mapping[int, tuple[int, float]]] = {
    "letters": _motion_keys(_LETTERS),
    "arrows": _motion_keys(_ARROWS),
}
"""Axis (x y z rx ry rz) and sign of each key, by layout."""

GIVE_BACK, TAKE_AGAIN = KEY_CODES["esc"], KEY_CODES["f12"]
_OTHERS = frozenset(
    KEY_CODES[f"{side}-{name}"] for side in ("left", "right") for name in ("ctrl", "alt", "meta")
)
_AT_ONCE_S = 1e-9


class KeyboardCore(EvdevCore):
    """The state of one keyboard. Times are monotonic, s."""

    _radio_words = (
        "by Bluetooth: when the radio is lost with a key and the dead-man down, the system reports "
        "it only after seconds (keys have no stale_after_s); take a cable"
    )

    def __init__(self, options: KeyboardOptions) -> None:
        super().__init__("press any key once", "let go of all keys that move the robot")
        self._motion = MOTION_KEYS[options.layout]
        self._shaper = Shaper(options)
        self._ramp_s = max(options.ramp_s, _AT_ONCE_S)
        self._grabs = options.grab
        self._given_back = False
        self._muted: set[int] = set()
        """Motion keys that were pressed together with Ctrl, Alt or Meta."""
        self._goal = [0.0] * 6
        self._since_s = [0.0] * 6
        """Time at which the deflection of each axis towards its goal began."""

    @property
    def buttons(self) -> tuple[str, ...]:
        """Labels of the keys that count as buttons: all named keys that move nothing."""
        keys = self.description.keys
        return tuple(
            label
            for code, label in KEYS.items()
            if code not in self._motion and (not keys or code in keys)
        )

    @property
    def wants_grab(self) -> bool:
        """True if the keys are to be withheld from other programs."""
        return self._grabs and not self._given_back

    @property
    def nothing_down(self) -> bool:
        """True if no key is pressed: grabbed now, no other program is left with a pressed key."""
        return not self._down

    # -- defined by the keyboard ------------------------------------------------------------------

    def _on_description(self) -> None:
        self._given_back = False

    def _on_key(self, code: int, pressed: bool, now_s: float) -> None:
        if code in self._motion:
            muted = pressed and self._down & _OTHERS
            (self._muted.add if muted else self._muted.discard)(code)
            self._aim(now_s)
        elif pressed and code in _OTHERS:
            self._muted |= self._down & self._motion.keys()
            self._aim(now_s)
        elif pressed and self._grabs and code == GIVE_BACK:
            self._given_back = True
            reason = "the keyboard was released with Esc: press F12 to grab it again"
            self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, reason, now_s)
        elif pressed and self._grabs and code == TAKE_AGAIN and self._given_back:
            self._given_back = False
            self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, "the keyboard is grabbed again", now_s)

    def _drop_input(self, now_s: float) -> None:
        super()._drop_input(now_s)
        self._goal = [0.0] * 6

    def _aim(self, now_s: float) -> None:
        """Set the goal of each axis from the keys that are down."""
        goal = [0.0] * 6
        for code in self._down - self._muted:
            if code in self._motion:
                axis, sign = self._motion[code]
                goal[axis] += sign
        for axis, (old, new) in enumerate(zip(self._goal, goal, strict=True)):
            if new != old:
                self._since_s[axis] = now_s
        self._goal = goal

    def _labels(self) -> list[str]:
        return [
            KEYS.get(code) or f"key-{code}"
            for code in sorted(self._down)
            if code not in self._motion
        ]

    def _axes(self, now_s: float) -> Axes:
        x, y, z, rx, ry, rz = (
            goal * min(1.0, max(0.0, (now_s - since_s) / self._ramp_s))
            for goal, since_s in zip(self._goal, self._since_s, strict=True)
        )
        return self._shaper((x, y, z, rx, ry, rz))

    def _watch(self, now_s: float) -> None:
        if any(self._goal):  # The ramp continues without events.
            self._cached = None
        super()._watch(now_s)

    def _away_from_rest(self) -> str:
        if self._given_back:
            return "given back"
        return ", ".join(KEYS[code] for code in sorted(self._down & self._motion.keys()))

    def _why(self) -> str:
        return self._reason if self._given_back else super()._why()
