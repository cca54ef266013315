"""Gamepad driver: reads an input device, and controls its rumble."""

from __future__ import annotations

import contextlib
import time
from typing import Any, ClassVar

from cardan.drivers.base import FoundDevice
from cardan.drivers.evdev.device import EvdevDevice
from cardan.drivers.evdev.links import EvdevLink
from cardan.drivers.evdev.nodes import CONSOLE_HINT, is_gamepad, joystick, pad_in_mode_d
from cardan.drivers.gamepad.core import GamepadCore
from cardan.drivers.gamepad.options import GamepadOptions
from cardan.drivers.packet_socket import FEEDBACK_TIMEOUT_S
from cardan.drivers.simulated import OWN
from cardan.protocols.evdev.events import EV_FF, InputEvent, MalformedPacket, encode_events
from cardan.protocols.evdev.requests import (
    EVIOCRMFF,
    EVIOCSFF,
    Rumble,
    decode_rumble,
    encode_int,
    encode_rumble,
)
from cardan.types import DeviceCapabilities, DeviceFeedback

RUMBLE_MS = 400
"""Time after which a rumble ends unless it is repeated."""
RUMBLE_AGAIN_S = 0.2

_FULL = 0xFFFF
_NEW = -1


class Gamepad(EvdevDevice[GamepadCore]):
    """A gamepad as an operator device.

    Its axes are LIVE only after its sticks were seen at rest; see :mod:`cardan.drivers.evdev.core`
    for the rules. An unplugged pad is reopened automatically.
    """

    Options: ClassVar[type[GamepadOptions]] = GamepadOptions
    summary = "gamepads"
    page = "gamepad.md"
    peer = "gamepad"
    simulated = ({"transport": ("socket",), "path": OWN},)
    gives = "sticks, triggers, buttons"
    takes_back = "rumble"
    suits = "rate, base frame"
    udev_matches = ('SUBSYSTEM=="input", KERNEL=="event*", ENV{ID_INPUT_JOYSTICK}=="1"',)
    options: GamepadOptions
    _kind = "gamepad"
    _permission_hint = CONSOLE_HINT
    _fits = staticmethod(is_gamepad)
    _misfit = staticmethod(joystick)

    def __init__(self, options: GamepadOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = GamepadCore(self.options)
        self._level = 0.0
        """Requested strength of the rumble, 0 to 1."""
        self._shown = 0.0
        self._effect = _NEW
        self._again_s = 0.0
        self._rumble_failures = 0

    @classmethod
    def find(cls) -> list[FoundDevice]:
        """Return the gamepads, and Logitech pads that are switched to another mode. Never
        raises."""
        return super().find() + [
            FoundDevice(node.name, node.identity, "evdev", node.path, words)
            for node in cls._nodes(fit=False)
            if (words := pad_in_mode_d(node.identity))
        ]

    @property
    def capabilities(self) -> DeviceCapabilities:
        """Capabilities of the open pad; before, the buttons of every pad, and no rumble."""
        with self._lock:
            return DeviceCapabilities(
                gives_pose=False,
                buttons=self._core.buttons,
                feedback=frozenset({"rumble"} if self._core.rumbles else ()),
                battery=False,
            )

    def diagnosis(self) -> tuple[str, ...]:
        words = super().diagnosis()
        if self._rumble_failures:
            words += (f"{self._rumble_failures} rumble commands that the gamepad refused",)
        return words

    def _feedback(self, feedback: DeviceFeedback) -> None:
        self._check_open("feedback()")
        if feedback.rumble is not None:
            self._level = min(1.0, max(0.0, feedback.rumble))

    # -- rumble, by the reader -----------------------------------------------------------------

    def _attend(self, link: EvdevLink) -> None:
        level, now_s = self._level, time.monotonic()
        if level == self._shown and (level == 0.0 or now_s < self._again_s):
            return
        try:
            self._rumble(link, level)
        except OSError:
            # Reading tells the state of the link; a pad may refuse effects and work otherwise.
            self._rumble_failures += 1
            self._effect = _NEW
        self._shown, self._again_s = level, now_s + RUMBLE_AGAIN_S

    def _rumble(self, link: EvdevLink, level: float) -> None:
        if level > 0.0 and (level != self._shown or self._effect == _NEW):
            strength = round(_FULL * level)
            effect = decode_rumble(
                link.call(
                    EVIOCSFF,
                    encode_rumble(Rumble(self._effect, strength, strength, RUMBLE_MS)),
                    FEEDBACK_TIMEOUT_S,
                )
            )
            if isinstance(effect, MalformedPacket):
                self._rumble_failures += 1
                return
            self._effect = effect.id
        if self._effect != _NEW:
            link.write(encode_events([InputEvent(0, 0, EV_FF, self._effect, int(level > 0.0))]))

    def _before_release(self, link: EvdevLink) -> None:
        effect, self._effect, self._shown = self._effect, _NEW, 0.0
        if effect != _NEW:
            with contextlib.suppress(OSError):
                link.write(encode_events([InputEvent(0, 0, EV_FF, effect, 0)]))
            link.call(EVIOCRMFF, encode_int(effect), FEEDBACK_TIMEOUT_S)

    def close(self) -> None:
        super().close()
        self._level = 0.0
