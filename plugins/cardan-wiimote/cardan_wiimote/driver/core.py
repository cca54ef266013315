"""State of a remote from its reports, and the conditions for its input. No I/O, no clock.

A remote streams a hundred reports per second, moved or not; silence is always a fault: after
`STALE_AFTER_S` its input is ignored until the clutch has been released.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import ClassVar, NamedTuple

from cardan.drivers.core import DeviceCore
from cardan.drivers.shaping import Shaper
from cardan.types import NEUTRAL, NEVER_S, Axes, DeviceLink, Inertia, Vector3
from cardan_wiimote.driver.gyro import Gyro
from cardan_wiimote.driver.options import WiimoteOptions
from cardan_wiimote.driver.roles import ROLES, STICK_BUTTON, RemoteMotion
from cardan_wiimote.driver.rumble import PULSE_S, Rumble
from cardan_wiimote.driver.session import Session
from cardan_wiimote.driver.tilt import Tilt, Vector
from cardan_wiimote.protocol import (
    BATTERY_FULL,
    BUTTONS,
    DATA_LAYOUTS,
    HEIGHT,
    WIDTH,
    CalibrationSource,
    Data,
    Interleaved,
    Leds,
    MalformedReport,
    Rumble as RumbleReport,
    Status,
    button_labels,
    decode_dots,
    decode_input,
    decode_motion_plus,
    decode_nunchuk,
    decode_nunchuk_pass_through,
    encode_output,
    is_motion_plus_frame,
    stick_deflection,
    to_g,
    to_operator_axes,
    to_rad_s,
    with_rumble,
)

STALE_AFTER_S = 0.09
"""Silence, nine reports, after which the link is STALE. The state must be neutral within 0.1 s; the
difference is for one cycle of the reader."""

G_M_S2 = 9.80665
"""Standard gravity, the unit of accelerometer calibrations."""

SETTLE_S = 0.02
"""Reports of rest within this time after a silence may be old ones from a queue."""

SUSPECT_S = 0.3
"""Time without usable data of an extension after which it is detected again."""

CENTERED = 0.2
"""Deflection below which a stick counts as released."""

CENTER_SAMPLES, CENTER_COUNTS = 16, 25
"""For a Nunchuk without calibration: its center is the mean of the first samples, if they are this
close to the middle."""

EARLY_LOSS_S = 5.0
"""A remote lost within this time of its opening was dropped by the system or disconnected
itself."""

_NAMES = {"1": "one", "2": "two"}
BUTTON_NAMES = tuple(_NAMES.get(label, label) for label in BUTTONS.values())
NUNCHUK_BUTTONS = ("c", "z")

_STARTING = "starting up: reading calibration and extensions"
_OPENED = "not seen at rest yet: let go of its buttons once"
_SILENT = f"no report for {STALE_AFTER_S:g} s: check range and batteries, then let go of buttons"
_RESUMED = "the remote fell silent: let go of its buttons once"
_CHANGED = "an extension was plugged in or out: let go of its buttons once"

KERNEL_DRIVER = (
    "the kernel's driver hid-wiimote drives it too: it changes data mode, MotionPlus and rumble; "
    "load the module hid with ignore_special_drivers=1, or blacklist hid-wiimote and use transport "
    "l2cap"
)


class Identity(NamedTuple):
    """Identity of the opened remote and its connection."""

    name: str = ""
    """Its Bluetooth name."""
    address: str = ""
    transport: str = ""
    kernel_driver: bool = False
    """True if the kernel's driver hid-wiimote is bound to it too."""
    late_model: bool = False
    """True for the -TR remotes."""


class WiimoteCore(DeviceCore):
    """State of one remote. Times are monotonic, s; `now_s` may step back a little."""

    _counters: ClassVar[Mapping[str, str]] = {
        "silences": f"silences of more than {STALE_AFTER_S:g} s",
        "mode_restores": "times another program had changed its data mode",
        "foreign_answers": "answers to another program's requests",
        "timeouts": "requests that it did not answer in time",
    }

    def __init__(self, options: WiimoteOptions) -> None:
        super().__init__()
        self._options = options
        self._session = Session(options)
        self._rumble = Rumble()
        self._shaper = Shaper(options)
        self._roles = ROLES[options.roles]()
        self._clutch = self._roles.clutch | {STICK_BUTTON}
        self._tilt = Tilt(options.low_pass_hz, options.full_tilt_used_deg)
        self._gyro = Gyro(options.dead_zone * options.gyro_full_scale_rad_s)
        self._identity = Identity()
        self._usual_reason = self._reason
        """Default reason, without a more urgent one."""
        self._early_losses = 0
        self._reports = 0
        self._led: int | None = None
        self._forget(NEVER_S)

    def _forget(self, now_s: float) -> None:
        """Discard the state of the remote."""
        self._opened_s = now_s
        self._battery_counts: int | None = None
        self._heard_s = now_s
        self._stamp_s = NEVER_S
        self._fresh_until_s = NEVER_S
        """Time until which no part is stale."""
        self._complete_s = now_s
        """Time at which all needed parts were last fresh."""
        self._force_g: Vector = (0.0, 0.0, 0.0)
        self._pointer: tuple[float, float] | None = None
        self._dots = 0
        self._core_buttons = 0
        self._deflected: Axes = NEUTRAL
        self._held = False
        self._changes = 0
        self._led_s = NEVER_S
        self._tilt.reset()
        self._forget_port()

    def _forget_port(self) -> None:
        """Discard the state of Nunchuk and MotionPlus."""
        self._stick_s = self._rate_s = NEVER_S
        self._stick = (0.0, 0.0)
        self._rates_rad_s: Vector = (0.0, 0.0, 0.0)
        self._extension_buttons: tuple[str, ...] = ()
        self._center_samples: list[tuple[int, int]] = []
        self._center: tuple[int, int] | None = None
        self._skip_frame = True
        self._gyro.reset()

    # -- what happens to the device ------------------------------------------------------------

    def on_opened(self, now_s: float, identity: Identity | None = None) -> None:
        """Handle the opening of the remote."""
        self._identity = identity or Identity()
        self._session.begin(now_s)
        led = self._options.led
        self._session.show_leds((1 << led >> 1) if self._led is None else self._led)
        self._rumble.reset()
        self._roles.reset()
        self._forget(now_s)
        self._begin(_OPENED, now_s)
        self._reason = _STARTING

    def on_lost(self, reason: str, now_s: float) -> None:
        """Handle a remote that was unplugged, cannot be read, or is missing."""
        if self._open and not self.failure(now_s):
            early = now_s - self._opened_s < EARLY_LOSS_S
            self._early_losses = self._early_losses + 1 if early else 0
        super().on_lost(reason, now_s)

    def on_closed(self, now_s: float) -> None:
        """Handle the closing of the remote on request."""
        super().on_closed(now_s)
        self._led = None

    def on_report(self, report: bytes, now_s: float) -> None:
        """Handle an input report, id first, received at `now_s`. Never raises."""
        if not self._open:
            return
        value = decode_input(report)
        if isinstance(value, MalformedReport):
            self._on_malformed(value.reason, value.report_id)
            return
        self._watch(now_s)
        self._heard = True
        self._heard_s = now_s
        self._reports += 1
        if isinstance(value, Data):
            self._on_data(value, now_s)
        elif isinstance(value, Interleaved):
            self._core_buttons = value.buttons
            self._session.on_data(value.mode, now_s)
        else:
            self._core_buttons = value.buttons
            if isinstance(value, Status):
                self._battery_counts = value.battery
                self._battery = min(1.0, value.battery / BATTERY_FULL)
            self._session.on_input(value, now_s)
        self._update(now_s)

    # -- commands to it ------------------------------------------------------------------------

    def set_rumble(self, level: float, now_s: float) -> None:
        """Rumble at `level`, 0..1, until the next call, but at most for `CUT_OFF_S`."""
        self._rumble.set(level, now_s)

    def set_led(self, on: bool) -> None:
        """Switch on the LED of the options (default: the first), or switch all off."""
        self._led = 1 << max(self._options.led, 1) >> 1 if on else 0

    def final_reports(self) -> list[bytes]:
        """Return the output reports to send before closing: the LEDs as requested last."""
        return [] if self._led is None else [encode_output(Leds(self._led))]

    def outgoing(self, now_s: float) -> list[bytes]:
        """Return the output reports to send now."""
        if not self._open:
            return []
        if self._led is not None and now_s - self._led_s >= PULSE_S:
            self._session.show_leds(self._led)
            self._led_s = now_s
        session = self._session
        if self._stamp_s > now_s - STALE_AFTER_S and now_s - self._complete_s > SUSPECT_S:
            session.suspect_port(now_s)
        reports = session.poll(now_s, not self._held)
        if session.changes != self._changes:
            self._on_port_change(now_s)
        if self._rumble.update(now_s) and not reports:
            reports.append(encode_output(RumbleReport()))
        return [with_rumble(report, self._rumble.on) for report in reports]

    def failure(self, now_s: float) -> str:
        """Return why the remote must be reopened; empty if there is no reason."""
        if self._session.failure:
            return self._session.failure
        silent_s = now_s - self._heard_s
        if self._session.started and silent_s > self._options.reconnect_after_s:
            return f"silent for {silent_s:.1f} s: out of range, or switched off"
        return ""

    # -- what it says --------------------------------------------------------------------------

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the buttons; those of the Nunchuk always, because it may be plugged in later."""
        return (*BUTTON_NAMES, *NUNCHUK_BUTTONS)

    def _tally(self) -> Mapping[str, int]:
        session = self._session
        return {
            "silences": self._counts["silences"],
            "mode_restores": session.mode_restores,
            "timeouts": session.requests.timeouts,
            "foreign_answers": session.requests.foreign,
        }

    def _figures(self, now_s: float) -> dict[str, float]:
        """Ages in s, forces in g, rates in rad/s, counts."""
        session = self._session
        figures: dict[str, float] = {
            "data_age_s": now_s - self._stamp_s,
            "reports": self._reports,
            "malformed_reports": self._malformed.total(),
            "force_x_g": self._force_g[0],
            "force_y_g": self._force_g[1],
            "force_z_g": self._force_g[2],
            "tilt_known": float(self._tilt.trusted(now_s)),
            "yaw_mode": float(self._roles.yaw),
            "rumble": self._rumble.level,
        }
        if self._battery_counts is not None:
            figures["battery_raw"] = self._battery_counts
        if session.nunchuk is not None:
            figures["stick_x"], figures["stick_y"] = self._stick
        if session.motion_plus is not None:
            figures |= zip(
                ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s"), self._rates_rad_s, strict=True
            )
            figures["rest_point_updates"] = self._gyro.updates
        if session.camera:
            figures["pointer_dots"] = self._dots
            if self._pointer is not None:
                figures["pointer_x"], figures["pointer_y"] = self._pointer
        return figures

    def _notes(self, now_s: float) -> list[str]:
        session, identity = self._session, self._identity
        words = []
        if self._early_losses:
            words.append(self._why_lost_early())
        if identity.kernel_driver:
            words.append(KERNEL_DRIVER)
        if session.status is not None and session.status.battery_low:
            words.append("its batteries are nearly empty")
        if session.started:
            if self._link is DeviceLink.LIVE and not self._tilt.trusted(now_s):
                words.append(
                    "it is shaken: its tilt cannot be measured meanwhile, and counts as zero"
                )
            if self._roles.yaw:
                words.append("tilt to the side turns about z (button 2): press 1 for about x")
            words += self._part_notes()
        return words

    def _part_notes(self) -> list[str]:
        session = self._session
        words = []
        if session.calibration_source is CalibrationSource.DEFAULT:
            words.append("its accelerometer's calibration is unreadable: level may be off")
        elif session.calibration_source is CalibrationSource.SECOND:
            words.append("the first copy of its accelerometer's calibration is damaged")
        if self._options.wants_motion_plus and session.motion_plus is None:
            words.append("it has no MotionPlus, or none that answers")
        if session.motion_plus is not None and not session.motion_plus_calibrated:
            words.append("its MotionPlus has no readable calibration: rates may be off by a third")
        if session.nunchuk is not None and not session.nunchuk_calibrated:
            words.append("its Nunchuk has no readable calibration: the stick's center is measured")
        if session.other_extension:
            words.append(f"its extension is of no use here: {session.other_extension}")
        if self._options.ir and not session.camera:
            words.append("its camera could not be switched on")
        return words

    def _why_lost_early(self) -> str:
        words = f"{self._early_losses} times it was lost within {EARLY_LOSS_S:.0f} s of opening: "
        if self._identity.transport == "socket":
            return words + "another program holds it"
        words += (
            "it is not paired (use the red sync button; BlueZ drops unpaired remotes, see "
            "ClassicBondedOnly)"
        )
        if self._identity.late_model:
            words += ", or woken with 1 and 2, which a -TR remote does not tolerate"
        return words

    # -- data ----------------------------------------------------------------------------------

    def _on_data(self, value: Data, now_s: float) -> None:
        session = self._session
        if value.buttons is not None:
            self._core_buttons = value.buttons
        session.on_data(value.mode, now_s)
        if value.accelerometer is not None:
            zero, one_g, _ = session.calibration
            self._force_g = to_operator_axes(to_g(value.accelerometer, zero, one_g))
            calibrated = session.calibration_source is not CalibrationSource.DEFAULT
            self._tilt.update(self._force_g, now_s, calibrated)
            self._stamp_s = now_s
        if value.extension:
            self._on_extension(value.extension, now_s)
        if value.ir and session.camera:
            self._on_dots(value)

    def _on_extension(self, data: bytes, now_s: float) -> None:
        session = self._session
        if session.motion_plus is None:
            if session.nunchuk is not None:
                self._on_nunchuk(data, False, now_s)
            return
        if not is_motion_plus_frame(data):
            if session.nunchuk is not None:
                self._on_nunchuk(data, True, now_s)
            return
        if self._skip_frame:  # The first report after the start may be garbage.
            self._skip_frame = False
            return
        frame = decode_motion_plus(data)
        if frame is None:
            return
        rates = to_operator_axes(to_rad_s(frame, session.motion_plus))
        self._rates_rad_s = self._gyro.update(rates, now_s, not self._held)
        self._rate_s = now_s
        if frame.extension is (session.nunchuk is None) and not session.other_extension:
            session.suspect_port(now_s)

    def _on_nunchuk(self, data: bytes, passed: bool, now_s: float) -> None:
        calibration = self._session.nunchuk
        value = decode_nunchuk_pass_through(data) if passed else decode_nunchuk(data)
        if value is None or calibration is None:
            return
        middle_x, middle_y = calibration.stick_x, calibration.stick_y
        if not self._session.nunchuk_calibrated:
            x, y = self._measured_center(value.stick_x, value.stick_y)
            middle_x = (middle_x[0], x, middle_x[2])
            middle_y = (middle_y[0], y, middle_y[2])
        self._stick = (
            stick_deflection(value.stick_y, middle_y),
            -stick_deflection(value.stick_x, middle_x),
        )
        self._extension_buttons = tuple(
            name for name, down in zip(NUNCHUK_BUTTONS, (value.c, value.z), strict=True) if down
        )
        self._stick_s = now_s

    def _measured_center(self, x: int, y: int) -> tuple[int, int]:
        """Return the center of a stick without calibration: the mean of first samples near the
        middle."""
        if self._center is None:
            low, high = 128 - CENTER_COUNTS, 128 + CENTER_COUNTS
            if low <= x <= high and low <= y <= high:
                self._center_samples.append((x, y))
            if len(self._center_samples) < CENTER_SAMPLES:
                return 128, 128
            xs, ys = zip(*self._center_samples, strict=True)
            self._center = round(sum(xs) / CENTER_SAMPLES), round(sum(ys) / CENTER_SAMPLES)
        return self._center

    def _on_dots(self, value: Data) -> None:
        ir_format = DATA_LAYOUTS[value.mode].ir_format
        if ir_format is None:
            return
        dots = [dot for dot in decode_dots(value.ir, ir_format) if dot is not None]
        self._dots = len(dots)
        self._pointer = None
        if dots:
            x = sum(dot.x for dot in dots) / len(dots)
            y = sum(dot.y for dot in dots) / len(dots)
            self._pointer = (2.0 * x / (WIDTH - 1) - 1.0, 2.0 * y / (HEIGHT - 1) - 1.0)

    def _on_port_change(self, now_s: float) -> None:
        """Handle a plugged or unplugged extension."""
        self._changes = self._session.changes
        self._forget_port()
        if self._link is DeviceLink.LIVE:
            self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, _CHANGED, now_s)

    # -- when input counts ---------------------------------------------------------------------

    def _watch(self, now_s: float) -> None:
        """Check for silence of the whole remote or of a needed part."""
        if now_s <= self._fresh_until_s or self._link not in _TALKING:
            return
        if now_s - self._heard_s > STALE_AFTER_S and self._buttons.held:
            self._release(now_s)
        if self._stamp_s == NEVER_S or not self._session.started:
            return
        missing = self._missing(now_s)
        if missing and self._link is DeviceLink.LIVE:
            self._fall_silent(missing, now_s)
        elif now_s - self._stamp_s > STALE_AFTER_S:
            self._invalidate_input(DeviceLink.STALE, _SILENT, now_s)

    def _missing(self, now_s: float) -> str:
        """Return the needed part that is silent; empty if none is."""
        session = self._session
        oldest_s = now_s - STALE_AFTER_S
        if not session.started:
            return _STARTING
        if self._stamp_s < oldest_s:
            return _SILENT
        if session.nunchuk is not None and self._stick_s < oldest_s:
            return "its Nunchuk sends nothing usable: plug it in again"
        if self._roles.needs_rates:
            if session.motion_plus is None:
                return "it has no MotionPlus, which roles 'gyro' need"
            if self._rate_s < oldest_s:
                return "its MotionPlus sends nothing usable: plug it in again"
        return ""

    def _update(self, now_s: float) -> None:
        """Update buttons, link and axes after a report."""
        missing = self._missing(now_s)
        if not missing:
            self._complete_s = now_s
        if self._link is DeviceLink.STALE:
            if missing:
                return
            self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, _RESUMED, now_s)
            self._ignore_rest_until_s = now_s + SETTLE_S
        before = self._buttons.held
        labels = (*_labels(self._core_buttons), *self._extension_buttons)
        self._buttons.set(labels, now_s)
        held = self._buttons.held
        if held != before:
            self._on_buttons(held - before, held)
        if self._link is DeviceLink.NEEDS_NEUTRAL:
            self._seek_neutral(missing, not self._clutch.isdisjoint(labels), now_s)
        live = self._link is DeviceLink.LIVE
        self._deflected = self._deflections(now_s) if live and self._held else NEUTRAL
        self._fresh_until_s = STALE_AFTER_S + self._oldest_s()
        self._cached = None

    def _on_buttons(self, pressed: frozenset[str], held: frozenset[str]) -> None:
        if self._link is DeviceLink.LIVE:  # A press that wakes the remote up sets no mode.
            self._roles.on_press(pressed)
        was_held, self._held = self._held, not self._clutch.isdisjoint(held)
        if self._held and not was_held and self._options.neutral == "press":
            self._tilt.capture()

    def _seek_neutral(self, missing: str, held: bool, now_s: float) -> None:
        """Accept the remote once all its parts report and none of its buttons is held.

        `held`: a clutch button is down, even if it is ignored until its release.
        """
        let_go = not held and max(map(abs, self._stick)) < CENTERED
        if not missing and let_go and now_s >= self._ignore_rest_until_s:
            self._link = DeviceLink.LIVE
        else:
            stick = "" if held or let_go else "let go of the Nunchuk's stick once"
            self._reason = missing or stick or self._usual_reason

    def _inertia(self, now_s: float) -> Inertia | None:
        oldest_s = now_s - STALE_AFTER_S
        if self._link not in _TALKING or self._stamp_s < oldest_s:
            return None
        x, y, z = self._force_g
        acceleration = Vector3(x * G_M_S2, y * G_M_S2, z * G_M_S2)
        turning = self._rate_s >= oldest_s
        return Inertia(acceleration, Vector3(*self._rates_rad_s) if turning else None)

    def _axes(self, now_s: float) -> Axes:
        return self._deflected

    def _deflections(self, now_s: float) -> Axes:
        rolled, dipped = self._tilt.rolled_and_dipped(now_s)
        scale = 1.0 / self._options.gyro_full_scale_rad_s
        wx, wy, wz = self._rates_rad_s
        motion = RemoteMotion(
            self._buttons.held, rolled, dipped, (scale * wx, scale * wy, scale * wz), self._stick
        )
        return self._shaper(self._roles.axes(motion))

    def _oldest_s(self) -> float:
        """Return the oldest of the last report times of the remote's parts."""
        stamps = [self._stamp_s]
        if self._session.nunchuk is not None:
            stamps.append(self._stick_s)
        if self._roles.needs_rates:
            stamps.append(self._rate_s)
        return min(stamps)

    def _release(self, now_s: float) -> None:
        """Count all buttons as released, because their state is unknown."""
        self._forget_buttons()
        self._buttons.release_all(now_s)
        self._cached = None

    def _forget_buttons(self) -> None:
        self._core_buttons = 0
        self._extension_buttons = ()
        self._held = False

    def _drop_input(self, now_s: float) -> None:
        self._usual_reason = self._reason
        self._deflected = NEUTRAL
        self._fresh_until_s = NEVER_S
        self._ignore_rest_until_s = NEVER_S
        self._forget_buttons()


_TALKING = (DeviceLink.LIVE, DeviceLink.NEEDS_NEUTRAL)


@lru_cache(maxsize=4096)
def _labels(mask: int) -> tuple[str, ...]:
    return tuple(_NAMES.get(label, label) for label in button_labels(mask))
