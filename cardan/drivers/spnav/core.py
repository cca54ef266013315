"""Interpreter of a spacenavd socket, without any I/O and in the caller's time.

The daemon forwards its device's reports: motion every 8 to 60 ms while deflected, zeros once on
release, then nothing. Silence counts as rest only after a motion of zero:

- After opening, a loss or a silence, the axes are zero (NEEDS_NEUTRAL) until a motion inside the
  dead zone came. An untouched device sends nothing, so the operator touches and releases the cap
  once.
- A deflected device that falls silent for the option `stale_after_s` is STALE: the axes are zero
  and the buttons count as released. The daemon tells clients of version 0 nothing else when its
  device is unplugged, and drops zeros and releases for a client that was slow.
- The daemon reports unplugging to a client of version 1: LOST, until a device is there again.
- A daemon that is set to repeat the last motion (`repeat-interval`) does so for a dead device, too.
  If it reports this setting, the link is LOST until that is changed. Identical motions faster than
  any device sends them are the daemon's own, and count as silence.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from itertools import groupby
from types import MappingProxyType

from cardan.drivers.core import DeviceCore
from cardan.drivers.shaping import Shaper
from cardan.drivers.spnav.options import SpnavOptions
from cardan.drivers.spnav.repeats import RepeatDetector
from cardan.protocols.connexion.devices import Family, find_model
from cardan.protocols.spnav.codes import (
    DEVICE_TYPES,
    MASK_V1,
    NEWEST_VERSION,
    REQUEST_TAG,
    Code,
    EventMask,
    LedMode,
)
from cardan.protocols.spnav.records import (
    RECORD_BYTES,
    Button,
    ConfigChange,
    DeviceChange,
    MalformedRecord,
    MotionEvent,
    ServerRecord,
    ServerReply,
    encode_handshake,
    encode_request,
    encode_sensitivity,
    to_robot_axes,
)
from cardan.protocols.spnav.streams import Handshake, ServerReader
from cardan.protocols.spnav.strings import encode_string
from cardan.types import NEUTRAL, NEVER_S, Axes, DeviceLink

USUAL_STALE_AFTER_S = SpnavOptions().stale_after_s

REPEAT_CHECK_S = 1.0
"""Period of querying whether the daemon repeats motions: not all daemons report changed
settings."""

SETTLE_S = 0.016
"""Time after a silence in which motions of zero do not count: they may have been queued."""

HANDSHAKE_TIMEOUT_S = 0.3
"""Timeout of the handshake; a daemon that has not granted version 1 by then has version 0, as in
libspnav."""

REPLY_TIMEOUT_S = 0.4
"""Time after which an unanswered request counts as refused."""

MOST_MOTIONS = 16
"""Most consecutive motions that are processed per read: more (128 ms of the quickest device's) were
not read in time, and the newest tell the present deflection."""

OUT_OF_STEP = 50
"""Consecutive invalid records after which the stream is out of step, or not a daemon's."""

CLIENT_NAME = "cardan"

DEFAULT_FULL_SCALE = 350.0
ONE_FULL_SCALE = 500.0
"""Counts to which the daemon scales the 350 counts of devices with absolute axes."""
_SERIAL_FULL_SCALES: Mapping[int, tuple[float, float]] = MappingProxyType(
    {
        **dict.fromkeys((0x100, 0x101, 0x102), (8000.0, 1600.0)),
        **dict.fromkeys((0x103, 0x104, 0x105), (400.0, 400.0)),
    }
)
"""Full scales of Spaceballs, and of devices with the Magellan's protocol."""
_ONE_TYPES = frozenset({0x20C, 0x20D, 0x20E})

OPENED_REASON = "not seen at rest yet: touch the cap and let go once"
RESUMED_REASON = "the device fell silent while deflected: let go of the cap once"
NO_DEVICE_REASON = "the daemon has no device: plug it in, or see why the daemon does not open it"
UNPLUGGED_REASON = "the daemon's device was unplugged"
REPEATS_REASON = (
    "the daemon repeats the last deflection by itself (repeat-interval = {} in its spnavrc), and "
    "would do so for a device that is dead: set repeat-interval = -1 there (usually "
    "/etc/spnavrc), and restart it"
)

_FIRST_REQUESTS = (
    Code.SET_EVMASK,
    Code.DEV_NBUTTONS,
    Code.DEV_TYPE,
    Code.DEV_USBID,
    Code.GCFG_LED,
    Code.GCFG_REPEAT,
)
"""Requests to a daemon of version 1, in sequence; repeated when a device was added or removed."""


class SpnavCore(DeviceCore):
    """State of the device behind one socket. Times are monotonic, s.

    Pending messages wait in `outgoing()`.
    """

    def __init__(self, options: SpnavOptions) -> None:
        super().__init__()
        self._options = options
        self._shaper = Shaper(options)
        self._radial = options.dead_zone_shape == "radial"
        self._down: list[int] = []
        self._forget_connection()
        self._set_full_scale()

    def _forget_connection(self) -> None:
        self._reader = ServerReader()
        self._malformed_in_a_row = 0
        self._output: list[bytes] = []
        self._version: int | None = None
        """Version in force; None during the handshake."""
        self._to_ask: deque[tuple[int, tuple[int, ...]]] = deque()
        self._asked: int | None = None
        self._asked_s = NEVER_S
        self._has_device = True
        self._button_count = 0
        self._described = False
        """True once the daemon has described its device."""
        self._device_type = 0
        self._usb_id = (0, 0)
        self._led_found: int | None = None
        """The daemon's initial LED setting; None if it has none."""
        self._led_set: int | None = None
        self._repeat_check_s = math.inf
        """Time of the next query whether the daemon repeats."""
        self._refusal = ""
        """Reason why motion of this daemon does not count; empty if it does."""
        self._motion: MotionEvent | None = None
        self._active = False
        self._motion_s = NEVER_S
        """Time of the device's last motion."""
        self._repeats = RepeatDetector(self._options.stale_after_s)

    # -- events of the connection ---------------------------------------------------------------

    def on_opened(self, now_s: float) -> None:
        """Start after the socket was connected (again): the previous state is void."""
        self._begin(OPENED_REASON, now_s)
        self._forget_connection()
        self._set_full_scale()
        self._handshake_until_s = now_s + HANDSHAKE_TIMEOUT_S
        self._output.append(encode_handshake(NEWEST_VERSION))

    def on_bytes(self, data: bytes, now_s: float) -> None:
        """Process bytes from the daemon. Never raises."""
        if not self._open:
            return
        values = self._reader.feed(data)
        newest = self._newest_motions(values) if len(values) > MOST_MOTIONS else values
        self._counts["superseded"] += len(values) - len(newest)
        for value in newest:
            self._cached = None
            if isinstance(value, MotionEvent):
                self._on_motion(value, now_s)
            elif isinstance(value, Button):
                self._on_button(value, now_s)
            elif isinstance(value, ServerReply):
                self._on_reply(value, now_s)
            elif isinstance(value, DeviceChange):
                self._on_device(value, now_s)
            elif isinstance(value, ConfigChange) and self._version:
                self._ask(Code.GCFG_REPEAT, (), now_s)
            elif isinstance(value, Handshake):
                self._on_version(value.version, now_s)
            elif isinstance(value, MalformedRecord):
                self._counts["malformed_records"] += 1
                self._malformed_in_a_row += 1

    @staticmethod
    def _newest_motions(
        values: Sequence[ServerRecord | Handshake],
    ) -> list[ServerRecord | Handshake]:
        """Drop the oldest motions of each long run of them."""
        retained: list[ServerRecord | Handshake] = []
        for are_motions, values_of in groupby(values, lambda value: isinstance(value, MotionEvent)):
            run = list(values_of)
            retained += run[-MOST_MOTIONS:] if are_motions else run
        return retained

    def on_time(self, now_s: float) -> None:
        """End waits that are overdue at `now_s`; call it at least every 50 ms."""
        if not self._open:
            return
        if self._version is None and now_s >= self._handshake_until_s:
            # The daemon took the handshake for a sensitivity that is not a number.
            self._version = 0
            self._output.append(encode_sensitivity(1.0))
        if self._asked is not None and now_s - self._asked_s >= REPLY_TIMEOUT_S:
            self._counts["unanswered_requests"] += 1
            self._asked = None
            self._ask_next(now_s)
        if now_s >= self._repeat_check_s:
            self._repeat_check_s = now_s + REPEAT_CHECK_S
            self._ask(Code.GCFG_REPEAT, (), now_s)
        if self._active:
            self._watch(now_s)

    def outgoing(self) -> list[bytes]:
        """Return messages for the daemon since the last call; send each in one call."""
        output = self._output
        self._output = []
        return output

    def set_led(self, mode: int, now_s: float) -> None:
        """Switch the LED on or off, or to the daemon's own setting (`LedMode`)."""
        if self._led_found is not None:
            self._led_set = mode
            self._ask(Code.SCFG_LED, (mode,), now_s)

    def restore_led(self, now_s: float) -> None:
        """Restore the daemon's LED setting if it was changed, because all programs share it."""
        if self._led_set is not None and self._led_found is not None:
            self.set_led(self._led_found, now_s)
            self._led_set = None

    # -- reports --------------------------------------------------------------------------------

    @property
    def out_of_step(self) -> bool:
        """True if only a new connection helps, because record boundaries are lost."""
        return self._malformed_in_a_row >= OUT_OF_STEP

    @property
    def settled(self) -> bool:
        """True once the version is agreed and all initial requests were answered."""
        return self._version is not None and self._asked is None

    @property
    def refusal(self) -> str:
        """Reason why motion of this daemon does not count, with advice; empty if it does."""
        return self._refusal

    @property
    def device_name(self) -> str:
        """Name of the daemon's device; empty if unknown or there is none."""
        if not (self._described and self._device_type):
            return ""
        return DEVICE_TYPES.get(self._device_type, "")

    @property
    def is_serial(self) -> bool:
        """True if the daemon reports that its device is at a serial port."""
        return self._described and self._device_type in _SERIAL_FULL_SCALES

    @property
    def version(self) -> int | None:
        """Protocol version in force; None: not agreed yet."""
        return self._version

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the buttons; empty if the daemon does not report their number."""
        return tuple(f"button-{number}" for number in range(self._button_count))

    @property
    def further_labels(self) -> tuple[str, ...]:
        """Names of buttons beyond the daemon's count: up to 1.3.1 it counts too few of some
        devices, and sends them all the same."""
        return tuple(f"button-{number}" for number in range(self._button_count, _MOST_LABELS))

    @property
    def has_led(self) -> bool:
        """True if the daemon accepts requests about an LED."""
        return self._led_found is not None

    @property
    def full_scale(self) -> float:
        """Counts of translation at full deflection."""
        return self._full_scale

    @property
    def _counters(self) -> Mapping[str, str]:
        return {
            "silences": f"silences of more than {self._options.stale_after_s:g} s while deflected",
            "repeats": "motions that the daemon repeated by itself, ignored: set repeat-interval "
            "= -1 in its spnavrc",
            "superseded": "motions that newer ones had already replaced, ignored",
            "malformed_records": "invalid records from the daemon, ignored",
            "unanswered_requests": "requests that the daemon did not answer",
            "unasked_replies": "unrequested answers, ignored",
        }

    def protocol_errors(self) -> dict[str, int]:
        return {"malformed": self._counts["malformed_records"]}

    def _figures(self, now_s: float) -> dict[str, float]:
        return {
            "motion_age_s": now_s - self._motion_s,
            "version": -1 if self._version is None else self._version,
            "full_scale": self._full_scale,
        }

    def _notes(self, now_s: float) -> list[str]:
        words = []
        if self._open and self.is_serial:
            words.append(
                f"the daemon's device is a {self.device_name} at a serial port, of which spacenavd "
                "(but not `cardan devices spnav`) drops motion that does not change: the arm "
                "brakes while the hand is steady. End spacenavd, install the plug-in "
                "cardan-serial-mice, and "
                'set driver = "spacemouse_serial" and path = the port'
            )
        if self._open and self._version == 0:
            words.append(
                "an old daemon (protocol version 0): it reports neither unplugging nor full "
                "scale and buttons"
            )
        if self._options.stale_after_s > USUAL_STALE_AFTER_S:
            words.append(
                f"stale_after_s = {self._options.stale_after_s:g}: when the device dies, the arm "
                "runs on for so long"
            )
        return words

    # -- events --------------------------------------------------------------------------------

    def _on_motion(self, value: MotionEvent, now_s: float) -> None:
        self._malformed_in_a_row = 0
        if self._refusal:
            return
        if self._repeats.take(value[:6], now_s):
            self._counts["repeats"] += 1
            # The device may be dead since the last motion that was not ahead of its pace.
            self._motion_s = min(self._motion_s, self._repeats.in_pace_s)
            return
        self._hear(now_s)
        if self._active:
            self._watch(now_s)
        if self._link is DeviceLink.STALE:
            self._resume(RESUMED_REASON, SETTLE_S, now_s)
        elif self._link is DeviceLink.LOST:
            self._link, self._reason = DeviceLink.NEEDS_NEUTRAL, OPENED_REASON
            self._has_device = True
        self._motion = value
        self._motion_s = now_s
        self._active = not self._at_rest(value)
        self._arm(now_s)

    def _arm(self, now_s: float) -> None:
        """Accept the device from its first rest on, unless other motion follows at once."""
        if (
            self._link is DeviceLink.NEEDS_NEUTRAL
            and self._motion is not None
            and not self._active
            and now_s >= self._ignore_rest_until_s
        ):
            self._link = DeviceLink.LIVE
            self._cached = None

    def _at_rest(self, value: MotionEvent) -> bool:
        x, y, z, rx, ry, rz, _ = value
        dead, rotation_dead = self._dead_counts, self._rotation_dead_counts
        if self._radial:
            return (
                x * x + y * y + z * z <= dead * dead
                and rx * rx + ry * ry + rz * rz <= rotation_dead * rotation_dead
            )
        return (
            -dead <= x <= dead
            and -dead <= y <= dead
            and -dead <= z <= dead
            and -rotation_dead <= rx <= rotation_dead
            and -rotation_dead <= ry <= rotation_dead
            and -rotation_dead <= rz <= rotation_dead
        )

    def _on_button(self, value: Button, now_s: float) -> None:
        self._hear(now_s)
        if value.pressed and value.number not in self._down:
            self._down.append(value.number)
        elif not value.pressed and value.number in self._down:
            self._down.remove(value.number)
        self._buttons.set([f"button-{number}" for number in self._down], now_s)

    def _on_device(self, value: DeviceChange, now_s: float) -> None:
        self._hear(now_s)
        if value.added and self._has_device and self._is_known(value):
            pass  # another device of the same kind, or more buttons than the daemon knew
        elif value.added:
            self._has_device = True
            self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, OPENED_REASON, now_s)
        else:
            self._has_device = False
            self._invalidate_input(DeviceLink.LOST, UNPLUGGED_REASON, now_s)
        # Another device may remain, or this one may have another full scale than the last.
        self._ask_all(now_s)

    def _is_known(self, device: DeviceChange) -> bool:
        """True if it is the device that the daemon's answers describe, with the same full scale."""
        return self._described and (self._device_type, *self._usb_id) == (
            device.device_type,
            device.vendor_id,
            device.product_id,
        )

    def _watch(self, now_s: float) -> None:
        if not self._active:
            self._arm(now_s)
        elif now_s - self._motion_s > self._options.stale_after_s:
            self._fall_silent(f"{self._silence()}; let go of the cap", now_s)

    def _silence(self) -> str:
        """Describe the silence of a deflected device."""
        limit_s = self._options.stale_after_s
        if self._repeats.repeating:
            return (
                f"deflected, and for {limit_s:g} s the daemon only repeated its last event: set "
                "repeat-interval = -1 in its spnavrc"
            )
        steady = "the hand may be too steady, " if self.is_serial else ""
        return (
            f"deflected, but no motion for {limit_s:g} s: {steady}the device may be unplugged, or "
            "the daemon stuck"
        )

    # -- requests ------------------------------------------------------------------------------

    def _on_version(self, version: int, now_s: float) -> None:
        self._hear(now_s)
        if self._version == 0 and version:
            # A late answer: it has taken our sensitivity for the start of a request.
            self._output.append(bytes(RECORD_BYTES - len(encode_sensitivity(1.0))))
        elif self._version is not None:
            self._counts["unasked_replies"] += 1
            return
        self._version = min(version, NEWEST_VERSION)
        if self._version:
            self._output += encode_string(REQUEST_TAG | Code.SET_NAME, CLIENT_NAME)
            self._ask_all(now_s)
        else:
            self._output.append(encode_sensitivity(1.0))

    def _ask_all(self, now_s: float) -> None:
        if self._version:
            self._repeat_check_s = now_s + REPEAT_CHECK_S
            for code in _FIRST_REQUESTS:
                # With configuration events masked, some daemons send an empty motion instead.
                data = (MASK_V1 | EventMask.CONFIG,) if code == Code.SET_EVMASK else ()
                self._ask(code, data, now_s)

    def _ask(self, code: int, data: tuple[int, ...], now_s: float) -> None:
        """Send a request once the previous one is answered; a queued request is not repeated."""
        if (code, data) not in self._to_ask:
            self._to_ask.append((code, data))
        if self._asked is None:
            self._ask_next(now_s)

    def _ask_next(self, now_s: float) -> None:
        if self._to_ask:
            self._asked, data = self._to_ask.popleft()
            self._asked_s = now_s
            self._output.append(encode_request(self._asked, data))

    def _on_reply(self, reply: ServerReply, now_s: float) -> None:
        self._hear(now_s)
        if reply.code != self._asked:
            self._counts["unasked_replies"] += 1
            return
        self._take(reply, now_s)
        self._asked = None
        self._ask_next(now_s)

    def _take(self, reply: ServerReply, now_s: float) -> None:
        code, ok, data = reply.code, reply.ok, reply.data
        if code == Code.DEV_NBUTTONS:
            self._button_count = min(max(0, data[0]), _MOST_LABELS) if ok else 0
            if not ok:
                self._has_device = False
                if self._link is not DeviceLink.LOST:
                    self._invalidate_input(DeviceLink.LOST, NO_DEVICE_REASON, now_s)
            elif not self._has_device:
                self._has_device = True
                self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, OPENED_REASON, now_s)
        elif code == Code.DEV_TYPE:
            self._described = ok
            self._device_type = data[0] if ok else 0
            self._set_full_scale()
        elif code == Code.DEV_USBID:
            self._usb_id = (data[0], data[1]) if ok else (0, 0)
            self._set_full_scale()
        elif code == Code.GCFG_LED and self._led_set is None:
            self._led_found = data[0] if ok and data[0] in tuple(LedMode) else None
        elif code == Code.GCFG_REPEAT:
            self._on_repeat_setting(data[0] if ok else None, now_s)

    def _on_repeat_setting(self, repeat_ms: int | None, now_s: float) -> None:
        """Process the daemon's `repeat-interval`, ms; below 0: off; None: unknown."""
        if repeat_ms is None:
            self._repeat_check_s = math.inf
        elif repeat_ms >= 0:
            self._refusal = REPEATS_REASON.format(repeat_ms)
            if self._link is not DeviceLink.LOST or self._has_device:
                self._invalidate_input(DeviceLink.LOST, self._refusal, now_s)
        elif self._refusal:
            self._refusal = ""
            if self._has_device:
                self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, OPENED_REASON, now_s)

    # -- inside --------------------------------------------------------------------------------

    def _hear(self, now_s: float) -> None:
        self._heard = True
        self._malformed_in_a_row = 0
        self._stamp_s = now_s

    def _axes(self, now_s: float) -> Axes:
        motion = self._motion
        if motion is None:
            return NEUTRAL
        return self._shaper(to_robot_axes(motion[:6], self._full_scale, self._rotation_full_scale))

    def _set_full_scale(self) -> None:
        full_scale = self._options.full_scale
        self._full_scale, self._rotation_full_scale = (
            usual_full_scales(self._device_type, *self._usb_id)
            if full_scale is None
            else (full_scale, full_scale)
        )
        self._dead_counts = self._options.dead_zone * self._full_scale
        self._rotation_dead_counts = self._options.dead_zone * self._rotation_full_scale

    def _drop_input(self, now_s: float) -> None:
        self._motion = None
        self._active = False
        self._ignore_rest_until_s = NEVER_S
        self._down.clear()


_MOST_LABELS = 256


def usual_full_scales(device_type: int, vendor_id: int, product_id: int) -> tuple[float, float]:
    """Return spacenavd's counts at full deflection with sensitivity 1: translation, rotation."""
    model = find_model(vendor_id, product_id)
    if model is None and device_type in _SERIAL_FULL_SCALES:
        return _SERIAL_FULL_SCALES[device_type]
    one = device_type in _ONE_TYPES if model is None else model.family is Family.ONE
    full_scale = ONE_FULL_SCALE if one else DEFAULT_FULL_SCALE
    return full_scale, full_scale
