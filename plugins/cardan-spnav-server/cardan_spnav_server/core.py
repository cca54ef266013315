"""Sans-I/O core of the spacenavd-compatible server, in the caller's time.

Programs that support spacenavd (Blender, FreeCAD, ROS and others) get the deflection of any
operator device from it. It speaks versions 0 and 1 of the protocol; see
:mod:`cardan.protocols.spnav`. Settings of spacenavd that Cardan does not have are answered with
fixed values; changes of them are refused (status -1).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated

from cardan.common.bounds import COUNTS
from cardan.common.options import check_value
from cardan.protocols.spnav.codes import Code, EventMask, LedMode
from cardan.protocols.spnav.records import (
    FAILED,
    MAX_BUTTONS,
    OK,
    ConfigChange,
    DeviceChange,
    MalformedRecord,
    encode_handshake,
    encode_reply,
)
from cardan.protocols.spnav.streams import Handshake
from cardan.protocols.spnav.strings import encode_string
from cardan.types import NEVER_S, ButtonEvent, DeviceLink, DeviceState
from cardan_spnav_server.client import SpnavClient
from cardan_spnav_server.identity import DeviceIdentity
from cardan_spnav_server.protocol import (
    ClientRequest,
    Sensitivity,
    bits_of,
    encode_config,
    encode_device,
    float_of,
    from_robot_axes,
)

MOTION_PERIOD_S = 0.008
"""Shortest period of sending a changing deflection."""

REPEAT_PERIOD_S = 0.016
"""Period of sending a constant deflection: programs may take silence for a loss."""

STALE_AFTER_S = 0.1
"""Longest time without a new state after which deflection and buttons count as released."""

MAX_CLIENTS = 32

SENSITIVITIES = (0.001, 1000.0)
"""Accepted factors on a program's motion, either sign."""

TWO_BUTTONS = ("left", "right")
"""Numbers of a device without a list of buttons: 0 and 1, for whichever is pressed first."""

AXES = 6
_REST = (0,) * AXES
_ONE = bits_of(1.0)


class SpnavServerCore:
    """Clients and their send queues. Times are monotonic, s.

    Buttons have the numbers of `identity`. All others of `buttons` are numbered from 0 in their
    order; a button that is not listed gets the next number when it is first seen. If the device
    lists none, "left" and "right" are 0 and 1, "button-7" is 7 and "7" is 6, in any order of
    presses; all others follow. `on_led` switches the device's LED; None: it has none, or programs
    may not switch it. `full_scale` is in counts; None: the counts that programs expect for a full
    deflection of such a device. Raises OptionError for a value that is not in `COUNTS` of
    :mod:`cardan.common.bounds`.
    """

    def __init__(
        self,
        buttons: Sequence[str] = (),
        *,
        full_scale: float | None = None,
        identity: DeviceIdentity | None = None,
        on_led: Callable[[bool], None] | None = None,
    ) -> None:
        check_value("full_scale", full_scale, Annotated[float, COUNTS] | None)
        self._numbers: dict[str, int] = {}
        self._taken: set[int] = set()
        """Numbers that are assigned to buttons."""
        self._button_count = 0
        """Highest of them plus one."""
        self._listed = False
        self._full_scale = full_scale
        self._on_led = on_led
        self._led_mode = LedMode.AUTO
        self._led_shown: bool | None = None
        self._clients: dict[int, SpnavClient] = {}
        self._next_client = 0
        self._given_up: list[tuple[int, str]] = []
        self._counts: Counter[str] = Counter(dict.fromkeys(_COUNTERS, 0))
        self._last_failure = ""
        self._present = False
        self._device_id = -1
        self._held: set[int] = set()
        self._target: tuple[int, ...] = _REST
        self._shown: tuple[int, ...] = _REST
        self._offered_s = NEVER_S
        self._motion_s = NEVER_S
        self._due_s = NEVER_S
        self._identity = DeviceIdentity()
        self.identify(identity or self._identity)
        self.name_buttons(buttons)

    # -- clients -------------------------------------------------------------------------------

    def connect(self, now_s: float) -> int | None:
        """Add a program; return its number, or None if there are too many."""
        if len(self._clients) >= MAX_CLIENTS:
            self._counts["refused_clients"] += 1
            return None
        number = self._next_client
        self._next_client += 1
        self._clients[number] = SpnavClient(now_s)
        self._counts["served_clients"] += 1
        self._show_led()
        return number

    def disconnect(self, number: int) -> None:
        """Remove a program; unknown numbers are ignored."""
        if self._clients.pop(number, None) is not None:
            self._show_led()

    def receive(self, number: int, data: bytes, now_s: float) -> None:
        """Handle bytes from a program. Never raises."""
        client = self._clients.get(number)
        if client is None:
            return
        for value in client.reader.feed(data):
            if isinstance(value, ClientRequest):
                client.on_request(now_s)
                self._answer(client, value)
            elif isinstance(value, Handshake):
                client.on_request(now_s)
                client.shake_hands(value.version)
                client.reply(encode_handshake(value.version))
            elif isinstance(value, Sensitivity):
                client.on_request(now_s)
                self._set_sensitivity(client, value.value)
            else:
                self._counts["malformed"] += 1
        self._drop_if_unread(number, client)

    def outgoing(self, number: int, now_s: float) -> bytes:
        """Return the bytes to send to a program next, in one call; empty: nothing yet."""
        client = self._clients.get(number)
        return b"" if client is None else client.outgoing(now_s)

    def sent(self, number: int, size: int) -> None:
        """Record that `size` bytes from `outgoing` were sent."""
        client = self._clients.get(number)
        if client is not None:
            client.sent(size)

    def give_up(self, number: int, reason: str) -> None:
        """Disconnect a program that cannot be served, and report it in `given_up`."""
        client = self._clients.get(number)
        if client is not None:
            client.failure = reason
            self._drop_if_unread(number, client)

    def given_up(self) -> list[tuple[int, str]]:
        """Return the programs to disconnect since the last call, each with the reason."""
        given_up = self._given_up
        self._given_up = []
        return given_up

    @property
    def clients(self) -> int:
        """Number of connected programs."""
        return len(self._clients)

    # -- the device ----------------------------------------------------------------------------

    @property
    def present(self) -> bool:
        """True if the device was present at the last offer."""
        return self._present

    def identify(self, identity: DeviceIdentity) -> None:
        """Set the identity for programs, preferably while the device is absent.

        Its buttons are renumbered if it is another device.
        """
        before, self._identity = self._identity, identity
        if identity.button_numbers != before.button_numbers:
            self._renumber()
        linear, angular = (
            identity.full_scales if self._full_scale is None else (self._full_scale,) * 2
        )
        self._linear_full_scale = linear
        self._angular_share = angular / linear

    def name_buttons(self, buttons: Sequence[str]) -> None:
        """Number those of the device's `buttons` that have no number yet, in their order."""
        self._listed |= bool(buttons)
        before = self._button_count
        for button in buttons:
            self._number(button)
        if self._present and self._button_count > before:
            self._announce_device()

    def offer(self, state: DeviceState, events: Sequence[ButtonEvent], now_s: float) -> None:
        """Handle the device's newest state, and its button events since the last offer."""
        self._offered_s = now_s
        present = state.link not in (DeviceLink.CLOSED, DeviceLink.LOST)
        if present is not self._present:
            self._plug(present, now_s)
        for event in events:
            self._on_button(event)
        if not present:
            self._release_all()
        if state.link is DeviceLink.LIVE:
            self._target = self._counts_of(state)
        else:
            self._target = _REST
        self._move(now_s)

    def advance(self, now_s: float) -> None:
        """Advance the time: repeat a deflection, or end a stale one."""
        held = self._target is not _REST or self._held
        if held and now_s - self._offered_s > STALE_AFTER_S:
            self._counts["stale_offers"] += 1
            self._target = _REST
            self._release_all()
        self._move(now_s)

    def next_due_s(self) -> float:
        """Time of the next work of `advance` or `outgoing`, without new input."""
        due_s = min((client.due_s for client in self._clients.values()), default=math.inf)
        if self._shown != _REST and self._clients:
            due_s = min(due_s, self._motion_s + REPEAT_PERIOD_S)
        return due_s

    # -- what it says --------------------------------------------------------------------------

    def metrics(self) -> dict[str, float]:
        """Programs connected now, and counts."""
        return {"clients": len(self._clients), **self._counts}

    def diagnosis(self) -> list[str]:
        """Return the warnings in words."""
        words = [f"{self._counts[key]} {_COUNTERS[key]}" for key in _TELLING if self._counts[key]]
        if self._last_failure:
            words.append(f"the last program disconnected: {self._last_failure}")
        return words

    # -- motion and buttons --------------------------------------------------------------------

    def _counts_of(self, state: DeviceState) -> tuple[int, ...]:
        try:
            x, y, z, rx, ry, rz = state.axes
            share = self._angular_share
            axes = (x, y, z, share * rx, share * ry, share * rz)
            counts = from_robot_axes(axes, self._linear_full_scale)
        except (ValueError, OverflowError):  # NaN, infinity.
            self._counts["bad_axes"] += 1
            return _REST
        return counts if any(counts) else _REST

    def _move(self, now_s: float) -> None:
        """Send the deflection when due: its end at once, changes with a period."""
        target, shown = self._target, self._shown
        if target is _REST:
            if shown is _REST:
                return
            self._due_s = now_s + MOTION_PERIOD_S
        elif target != shown:
            if now_s < self._due_s:
                return
            late = now_s >= self._due_s + MOTION_PERIOD_S
            self._due_s = (now_s if late else self._due_s) + MOTION_PERIOD_S
        else:
            if now_s < self._motion_s + REPEAT_PERIOD_S:
                return
            self._due_s = now_s + MOTION_PERIOD_S
        period_ms = round(1000.0 * (now_s - self._motion_s)) if self._motion_s > NEVER_S else 0
        self._shown = target
        self._motion_s = now_s
        for client in self._clients.values():
            if client.mask & EventMask.MOTION:
                client.motion(target, period_ms)

    def _number(self, button: str) -> int | None:
        """Return the number of `button`, assigned if it had none; None: no number is left."""
        number = self._numbers.get(button)
        if number is None:
            own = number = self._identity.button_numbers.get(button)
            if number is None and not self._listed:
                number = _usual_number(button)
            if number is None or (own is None and number in self._taken):
                number = max(self._button_count, 0 if self._listed else len(TWO_BUTTONS))
            if number >= MAX_BUTTONS:
                number = next((n for n in range(MAX_BUTTONS) if n not in self._taken), None)
            if number is not None:
                self._numbers[button] = number
                self._taken.add(number)
                self._button_count = max(self._button_count, number + 1)
        return number

    def _renumber(self) -> None:
        """Renumber the buttons in the order of their earlier numbers."""
        buttons = tuple(self._numbers)
        self._numbers.clear()
        self._taken.clear()
        self._button_count = 0
        for button in buttons:
            self._number(button)

    def _on_button(self, event: ButtonEvent) -> None:
        before = self._button_count
        number = self._number(event.button)
        if number is None:
            self._counts["unnumbered_buttons"] += 1
            return
        if self._present and self._button_count > before:
            self._announce_device()
        if event.pressed is (number in self._held):
            return
        if event.pressed:
            self._held.add(number)
        else:
            self._held.discard(number)
        self._tell_edge(number, event.pressed)

    def _release_all(self) -> None:
        for number in sorted(self._held):
            self._tell_edge(number, False)
        self._held.clear()

    def _plug(self, present: bool, now_s: float) -> None:
        self._present = present
        if present:
            self._device_id += 1
        else:
            self._target = _REST
            self._release_all()
            self._move(now_s)
        self._announce_device()

    def _announce_device(self) -> None:
        """Report that the device appeared or vanished, or has more buttons than were known."""
        identity = self._identity
        change = DeviceChange(
            self._present,
            self._device_id,
            identity.device_type,
            identity.vendor_id,
            identity.product_id,
        )
        self._queue_for_all(EventMask.DEVICE, encode_device(change))

    def _tell_edge(self, number: int, pressed: bool) -> None:
        for client_number, client in tuple(self._clients.items()):
            if client.mask & EventMask.BUTTON:
                client.button(number, pressed)
                self._drop_if_unread(client_number, client)

    def _queue_for_all(self, kind: EventMask, record: bytes) -> None:
        """Queue an event that must not be lost for every program that subscribed to its kind."""
        for number, client in tuple(self._clients.items()):
            if client.mask & kind:
                client.event(record)
                self._drop_if_unread(number, client)

    def _drop_if_unread(self, number: int, client: SpnavClient) -> None:
        """Disconnect a program that does not read."""
        if client.failure and self._clients.pop(number, None) is not None:
            self._counts["given_up_clients"] += 1
            name = client.name or f"client {number}"
            self._last_failure = f"{name}, {client.failure}"
            self._given_up.append((number, self._last_failure))
            self._show_led()

    # -- requests ------------------------------------------------------------------------------

    def _answer(self, client: SpnavClient, request: ClientRequest) -> None:
        word, data, code = request.word, request.data, request.code
        if code == Code.SET_NAME:
            self._set_name(client, request)
        elif code in (Code.DEV_NAME, Code.DEV_PATH) and self._present:
            identity = self._identity
            text = identity.name if code == Code.DEV_NAME else identity.path
            for record in encode_string(word, text):
                client.reply(record)
        elif code == Code.GCFG_SERDEV:
            client.reply(encode_string(word, "")[0])
        elif code != Code.SCFG_SERDEV:  # It has no reply.
            answer = self._reply_data(client, code, data)
            if answer is None:
                client.reply(encode_reply(word, data[:AXES], FAILED))
            else:
                client.reply(encode_reply(word, answer, OK))

    def _reply_data(
        self, client: SpnavClient, code: int, data: Sequence[int]
    ) -> Sequence[int] | None:
        """Return the data of a reply; None: refused."""
        if code in _SETTINGS:
            return _SETTINGS[code]
        if code == Code.SET_SENS:
            return data[:AXES] if self._set_sensitivity(client, float_of(data[0])) else None
        if code == Code.GET_SENS:
            return (bits_of(client.sensitivity),)
        if code == Code.SET_EVMASK:
            self._set_mask(client, data[0])
            return data[:AXES]
        if code == Code.GET_EVMASK:
            return (client.mask,)
        if code in (Code.SCFG_LED, Code.GCFG_LED):
            return self._led(code, data)
        if code in (Code.GCFG_DEADZONE, Code.GCFG_AXISMAP):
            mapped = 0 if code == Code.GCFG_DEADZONE else data[0]
            return (data[0], mapped) if 0 <= data[0] < AXES else None
        if code in (Code.GCFG_BNMAP, Code.GCFG_BNACTION, Code.GCFG_KBMAP):
            mapped = data[0] if code == Code.GCFG_BNMAP else 0
            return (data[0], mapped) if 0 <= data[0] < MAX_BUTTONS else None
        return self._device_data(code) if self._present else None

    def _device_data(self, code: int) -> Sequence[int] | None:
        identity = self._identity
        if code == Code.DEV_NAXES:
            return (AXES,)
        if code == Code.DEV_NBUTTONS:
            return (self._button_count,)
        if code == Code.DEV_TYPE:
            return (identity.device_type,)
        if code == Code.DEV_USBID and identity.vendor_id:
            return (identity.vendor_id, identity.product_id)
        return None

    def _set_name(self, client: SpnavClient, request: ClientRequest) -> None:
        name = client.strings.take(request.data)
        if isinstance(name, MalformedRecord):
            self._counts["malformed"] += 1
        elif name is not None:
            client.name = name

    def _set_mask(self, client: SpnavClient, mask: int) -> None:
        """Set the event mask, and send the program the changes that it has missed."""
        wanted = mask & ~client.mask
        client.mask = mask
        if wanted & EventMask.MOTION:
            client.motion(self._shown, 0)
        if wanted & EventMask.BUTTON:
            client.hold(self._held)

    def _set_sensitivity(self, client: SpnavClient, sensitivity: float) -> bool:
        """Set the sensitivity; return True if it was accepted.

        libspnav's `spnav_sensitivity` sends half of a double in version 1, which is zero or far
        from the intended value: it would leave the program without motion.
        """
        low, high = SENSITIVITIES
        if not low <= abs(sensitivity) <= high:
            return False
        client.sensitivity = sensitivity
        return True

    def _led(self, code: int, data: Sequence[int]) -> Sequence[int] | None:
        if self._on_led is None:
            return None
        if code == Code.SCFG_LED:
            if data[0] not in tuple(LedMode):
                return None
            self._led_mode = LedMode(data[0])
            self._show_led()
            change = ConfigChange(Code.GCFG_LED, (self._led_mode, 0, 0, 0, 0, 0))
            self._queue_for_all(EventMask.CONFIG, encode_config(change))
        return (self._led_mode,)

    def _show_led(self) -> None:
        if self._on_led is None:
            return
        auto = self._led_mode is LedMode.AUTO
        on = bool(self._clients) if auto else self._led_mode is LedMode.ON
        if on is not self._led_shown:
            self._led_shown = on
            self._on_led(on)


def _usual_number(button: str) -> int | None:
    """Return the usual number of a button for a device without a list of its own; None: any."""
    if button in TWO_BUTTONS:
        return TWO_BUTTONS.index(button)
    digits = button.removeprefix("button-")
    if not (digits.isascii() and digits.isdecimal() and len(digits) <= 3):
        return None
    number = int(digits) - (digits == button)
    return number if 0 <= number < MAX_BUTTONS else None


_COUNTERS: Mapping[str, str] = MappingProxyType(
    {
        "served_clients": "programs have connected",
        "refused_clients": f"programs refused: {MAX_CLIENTS} were connected",
        "given_up_clients": "programs disconnected because they did not read",
        "malformed": "requests that were malformed",
        "bad_axes": "states of the device with values that are not numbers",
        "unnumbered_buttons": f"edges of buttons beyond the {MAX_BUTTONS} that have a number",
        "stale_offers": f"times the axes were ignored: no state was offered for {STALE_AFTER_S} s",
    }
)
"""Description of each counter."""

_TELLING = tuple(key for key in _COUNTERS if key != "served_clients")

_SETTINGS: Mapping[int, tuple[int, ...]] = MappingProxyType(
    {
        Code.GCFG_SENS: (_ONE,),
        Code.GCFG_SENS_AXIS: (_ONE,) * AXES,
        Code.GCFG_INVERT: (0,) * AXES,
        Code.GCFG_SWAPYZ: (0,),
        Code.GCFG_GRAB: (0,),
        Code.GCFG_REPEAT: (-1,),  # Off: only continued reports of the device are sent again.
    }
)
"""Fixed answers for these settings of spacenavd."""
