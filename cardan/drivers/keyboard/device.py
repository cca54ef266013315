"""Keyboard driver: reads an input device, and grabs it if configured."""

from __future__ import annotations

from typing import Any, ClassVar

from cardan.drivers.evdev.device import EvdevDevice
from cardan.drivers.evdev.links import EvdevLink
from cardan.drivers.evdev.nodes import GROUP_HINT, is_keyboard
from cardan.drivers.keyboard.core import KeyboardCore
from cardan.drivers.keyboard.options import KeyboardOptions
from cardan.drivers.packet_socket import FEEDBACK_TIMEOUT_S
from cardan.drivers.simulated import OWN
from cardan.protocols.evdev.requests import EVIOCGRAB, encode_int
from cardan.types import DeviceCapabilities


class Keyboard(EvdevDevice[KeyboardCore]):
    """A keyboard as an operator device.

    It is LIVE only after all keys that move the robot were seen released; see
    :mod:`cardan.drivers.evdev.core` for the rules. An unplugged keyboard is reopened automatically.
    """

    Options: ClassVar[type[KeyboardOptions]] = KeyboardOptions
    summary = "keyboards"
    page = "gamepad.md"
    peer = "keyboard"
    simulated = ({"transport": ("socket",), "path": OWN},)
    gives = "keys"
    suits = "rate, base frame"
    udev_matches = (
        "# To read a keyboard is to read every password typed on it, so this rule is off.",
        "# Take the comment sign away for the one keyboard you mean, by its ids.",
        '#SUBSYSTEM=="input", KERNEL=="event*", ATTRS{idVendor}=="1234", '
        'ATTRS{idProduct}=="5678", MODE="0660", TAG+="uaccess"',
    )
    options: KeyboardOptions
    _kind = "keyboard"
    _permission_hint = GROUP_HINT
    _fits = staticmethod(is_keyboard)

    def __init__(self, options: KeyboardOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = KeyboardCore(self.options)
        self._grabbed = False
        self._grab_refused = False

    @property
    def capabilities(self) -> DeviceCapabilities:
        with self._lock:
            buttons = self._core.buttons
        return DeviceCapabilities(
            gives_pose=False, buttons=buttons, feedback=frozenset(), battery=False
        )

    def diagnosis(self) -> tuple[str, ...]:
        words = super().diagnosis()
        if self._grab_refused:
            words += ("another program has grabbed the keyboard: end it, or set grab = false",)
        return words

    def _attend(self, link: EvdevLink) -> None:
        with self._lock:
            wanted, nothing_down = self._core.wants_grab, self._core.nothing_down
        # If grabbed with a key pressed, programs that saw the press would never see the release.
        if wanted == self._grabbed or (wanted and (self._grab_refused or not nothing_down)):
            return
        try:
            link.call(EVIOCGRAB, encode_int(int(wanted)), FEEDBACK_TIMEOUT_S)
        except OSError:
            self._grab_refused = wanted
            return
        self._grabbed = wanted

    def _before_release(self, link: EvdevLink) -> None:
        grabbed, self._grabbed, self._grab_refused = self._grabbed, False, False
        if grabbed:
            link.call(EVIOCGRAB, encode_int(0), FEEDBACK_TIMEOUT_S)
