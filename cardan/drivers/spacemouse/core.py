"""Interpreter of a SpaceMouse's reports, without any I/O and in the caller's time.

A device at rest is silent, and a deflected one reports continuously (over HID a pair of halves or
one whole report every 16 ms). Silence counts as rest only after a report of rest:

- After opening, a loss or a silence, the axes are zero (NEEDS_NEUTRAL) until both translation and
  rotation were reported inside the dead zone. An untouched device sends nothing, so the operator
  touches and releases the cap once: every release ends in reports of rest.
- A deflected device that falls silent for `STALE_AFTER_S`, or one of whose halves does, is STALE:
  the axes are zero, and the buttons count as released, since a release may have been lost.
"""

from __future__ import annotations

from collections.abc import Mapping

from cardan.drivers.core import DeviceCore
from cardan.drivers.shaping import Shaper
from cardan.drivers.spacemouse.buttons import Buttons
from cardan.drivers.spacemouse.drift import DRIFT_AFTER_S, DriftDetector
from cardan.drivers.spacemouse.options import MouseOptions
from cardan.errors import CommandError
from cardan.protocols.connexion.devices import DEFAULT_FULL_SCALE, Family, Model
from cardan.protocols.connexion.reports import (
    HALF_BYTES,
    MOTION_BYTES,
    Battery,
    InputReport,
    MotionReport,
    Rotation,
    Translation,
    decode_input,
    from_serial_axes,
    to_robot_axes,
)
from cardan.protocols.hid import MalformedReport
from cardan.types import NEVER_S, Axes, DeviceLink

REPORT_PERIOD_S = 0.016
"""Period at which a deflected HID device repeats each half, or its whole report."""

STALE_AFTER_S = 0.09
"""Silence of a deflected HID device after which the link is STALE. The state must be neutral within
0.1 s; the difference is for one cycle of the reader."""

SLOW_STALE_AFTER_S = 0.1
"""The same for a device that reports less often."""

GAP_AFTER_S = 3 * REPORT_PERIOD_S
"""Shortest silence of a deflected device that is counted."""
GAP_PERIODS = 1.5
"""The same for a slow device, in periods."""

SETTLE_S = REPORT_PERIOD_S
"""Time after a silence in which reports of rest do not count: they may have been queued."""

LOW_BATTERY_PERCENT = 10

PLAUSIBLE_FULL_SCALE = (100, 2048)
"""Plausible full scale, counts; a report descriptor that declares another is ignored."""

OPENED_REASON = "not seen at rest yet: touch the cap and let go once"
RESUMED_REASON = "the device fell silent while deflected: let go of the cap once"


class _Half:
    """Translation or rotation: the newest counts, their time, and whether they are rest."""

    __slots__ = ("active", "at_rest", "counts", "name", "stamp_s", "zero")

    def __init__(self, name: str) -> None:
        self.name = name
        self.stamp_s = NEVER_S
        self.zero: tuple[int, int, int] | None = None
        """Counts at rest, subtracted from `counts`; None: all zero."""
        self.counts = (0, 0, 0)
        self.active = False
        """True outside the dead zone."""
        self.at_rest = False
        """True once reported inside the dead zone since rest was last required."""

    def forget(self) -> None:
        self.counts = (0, 0, 0)
        self.active = self.at_rest = False


class SpaceMouseCore(DeviceCore):
    """State of one device. Times are monotonic, s; `now_s` may step back a little.

    `model` may be unknown (None): the family is found from the reports in any case.
    """

    def __init__(self, options: MouseOptions, model: Model | None = None) -> None:
        super().__init__()
        self._options = options
        self._shaper = Shaper(options)
        self._radial = options.dead_zone_shape == "radial"
        self._translation = _Half("translation")
        self._rotation = _Half("rotation")
        self._drift = DriftDetector()
        self._buttons: Buttons = Buttons(model)
        self._resumed_reason = RESUMED_REASON
        """Reason to report once a STALE device is heard again."""
        self._low_battery = False
        self._split: bool | None = None
        """True if the device reports in halves; None: unknown yet."""
        self._last_half: _Half | None = None
        self._active = False
        self._active_since_s = NEVER_S
        self._motion_s = NEVER_S
        self._set_period(REPORT_PERIOD_S)
        self._set_model(model, None)

    # -- events of the device -------------------------------------------------------------------

    def on_opened(
        self,
        now_s: float,
        model: Model | None = None,
        descriptor_full_scale: int | None = None,
        period_s: float = REPORT_PERIOD_S,
    ) -> None:
        """Start after the device was opened (again): the previous state is void.

        `descriptor_full_scale` is from its report descriptor, in counts; `period_s` is its report
        period while deflected.
        """
        self._set_model(model, descriptor_full_scale)
        self._set_period(period_s)
        for half in (self._translation, self._rotation):
            half.stamp_s = NEVER_S
            half.zero = None
        self._split = None
        self._begin(OPENED_REASON, now_s)
        self._buttons.on_opened()

    def on_report(self, report: bytes, now_s: float) -> None:
        """Process an input report of its true length, received at `now_s`. Never raises."""
        self.on_value(decode_input(report), now_s, len(report))

    def on_value(self, value: InputReport, now_s: float, size: int = 0) -> None:
        """Process the contents of a report received at `now_s`.

        Never raises. `size` is the report's length, which helps to interpret some; 0 if it has
        none.
        """
        if not self._open:
            return
        if isinstance(value, MalformedReport):
            self._on_malformed(value.reason, value.report_id)
            return
        self._cached = None
        self._heard = True
        self._stamp_s = now_s
        if isinstance(value, Translation):
            self._on_half(self._translation, value, size, now_s)
        elif isinstance(value, Rotation):
            self._on_half(self._rotation, value, size, now_s)
        elif isinstance(value, MotionReport):
            self._on_motion(value, size, now_s)
        elif isinstance(value, Battery):
            self._battery = value.percent / 100.0
            self._low_battery = value.percent <= LOW_BATTERY_PERCENT and not value.external_power
        else:
            self._buttons.on_report(value, size, now_s)

    # -- reports --------------------------------------------------------------------------------

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the buttons, lowest first; empty if the model is unknown."""
        return self._buttons.labels

    @property
    def full_scale(self) -> float:
        """Counts at full deflection."""
        return self._full_scale

    def rezero(self, now_s: float) -> None:
        """Set the zero to the cap's resting position, until the device is opened again.

        Raises CommandError unless the cap rests: silent, or constant for `DRIFT_AFTER_S`.
        """
        if self._split is None or not self._open:
            raise CommandError("cannot re-zero: the device has not reported its cap's position")
        silent = not self._active and now_s - self._motion_s > self._stale_after_s
        if not (silent or self._drift.drifting):
            raise CommandError(
                f"cannot re-zero: the cap moves, or is deflected too far, at {self._raw()} "
                f"counts; let go of it and wait {DRIFT_AFTER_S:.0f} s"
            )
        for half in (self._translation, self._rotation):
            (a, b, c), (u, v, w) = half.zero or (0, 0, 0), half.counts
            half.zero = (a + u, b + v, c + w)
            half.forget()
        self._active = False
        self._drift.reset()
        self._cached = None

    @property
    def _counters(self) -> Mapping[str, str]:
        return {
            "silences": f"silences of more than {self._stale_after_s:g} s while deflected",
            "gaps": f"gaps of more than {1000.0 * self._gap_after_s:.0f} ms while deflected",
            "unpaired_halves": "translation or rotation reports without the other half",
            "unusual_lengths": "motion reports of an unusual length",
        }

    def _figures(self, now_s: float) -> dict[str, float]:
        return {
            "translation_age_s": now_s - self._translation.stamp_s,
            "rotation_age_s": now_s - self._rotation.stamp_s,
            "malformed_reports": self._malformed.total(),
        }

    def _notes(self, now_s: float) -> list[str]:
        words = []
        if self._drift.drifting:
            words.append(
                f"the cap rests off zero, at {self._raw()} counts: let go of it and re-zero"
            )
        if self._low_battery and self._battery is not None:
            words.append(f"battery at {100.0 * self._battery:.0f} %: charge it")
        if self._model is not None and self._split is (self._model.family is Family.ONE):
            form = "two halves" if self._split else "one piece"
            words.append(f"reports motion in {form}, unlike the {self._model.name} known here")
        return words

    # -- motion --------------------------------------------------------------------------------

    def _on_motion(self, value: MotionReport, size: int, now_s: float) -> None:
        x, y, z, rx, ry, rz = value
        if rx or ry or rz:
            self._split = False
        elif self._split or (self._split is None and self._may_be_padded_half(size)):
            self._on_half(self._translation, (x, y, z), size, now_s)
            return
        else:
            self._split = False
        if size not in (0, MOTION_BYTES):
            self._counts["unusual_lengths"] += 1
        self._before_motion(now_s)
        self._take(self._translation, x, y, z, now_s)
        self._take(self._rotation, rx, ry, rz, now_s)
        self._after_motion(now_s)

    def _on_half(self, half: _Half, counts: tuple[int, int, int], size: int, now_s: float) -> None:
        self._split = True
        if size not in (0, HALF_BYTES):
            self._counts["unusual_lengths"] += 1
        self._before_motion(now_s)
        if half is self._last_half and self._active:
            self._counts["unpaired_halves"] += 1
        self._last_half = half
        self._take(half, *counts, now_s)
        self._after_motion(now_s)

    def _may_be_padded_half(self, size: int) -> bool:
        """True if a long report 1 without rotation may be the zero-padded half of a SPLIT model."""
        model = self._model
        return size > MOTION_BYTES and model is not None and model.family is Family.SPLIT

    def _before_motion(self, now_s: float) -> None:
        if self._active:
            if now_s - self._motion_s > self._gap_after_s:
                self._counts["gaps"] += 1
            if (
                now_s - self._translation.stamp_s > self._stale_after_s
                or now_s - self._rotation.stamp_s > self._stale_after_s
            ):
                self._watch(now_s)
        if self._link is DeviceLink.STALE:
            self._resume(self._resumed_reason, SETTLE_S, now_s)
        self._motion_s = now_s

    def _take(self, half: _Half, a: int, b: int, c: int, now_s: float) -> None:
        if half.zero:
            u, v, w = half.zero
            a, b, c = a - u, b - v, c - w
        half.counts = (a, b, c)
        half.stamp_s = now_s
        dead = self._dead_counts
        if self._radial:
            half.active = a * a + b * b + c * c > dead * dead
        else:
            half.active = not (-dead <= a <= dead and -dead <= b <= dead and -dead <= c <= dead)
        if half.active:
            self._translation.at_rest = self._rotation.at_rest = False
        elif now_s >= self._ignore_rest_until_s:
            half.at_rest = True

    def _after_motion(self, now_s: float) -> None:
        translation, rotation = self._translation, self._rotation
        active = translation.active or rotation.active
        if active and not self._active:
            self._active_since_s = now_s
        self._active = active
        if self._link is DeviceLink.NEEDS_NEUTRAL and translation.at_rest and rotation.at_rest:
            self._link = DeviceLink.LIVE
        if now_s >= self._drift.due_s:
            self._drift.update(self._raw(), self._full_scale, now_s)

    def _watch(self, now_s: float) -> None:
        if not self._active:
            return
        translation, rotation = self._translation, self._rotation
        older = translation if translation.stamp_s < rotation.stamp_s else rotation
        if now_s - max(older.stamp_s, self._active_since_s) <= self._stale_after_s:
            return
        self._resumed_reason = RESUMED_REASON
        what = older.name if now_s - self._motion_s <= self._gap_after_s else "motion"
        self._fall_silent(
            f"deflected, but no {what} report for {self._stale_after_s:g} s: check radio, cable "
            "and other programs, then let go of the cap",
            now_s,
        )

    # -- inside --------------------------------------------------------------------------------

    def _raw(self) -> tuple[int, int, int, int, int, int]:
        return (*self._translation.counts, *self._rotation.counts)

    def _axes(self, now_s: float) -> Axes:
        raw = self._raw()
        if self._model is not None and self._model.serial_axes:
            raw = from_serial_axes(raw)
        return self._shaper(to_robot_axes(raw, self._full_scale))

    def _set_model(self, model: Model | None, descriptor_full_scale: int | None) -> None:
        self._model = self._buttons.model = model
        low, high = PLAUSIBLE_FULL_SCALE
        full_scale: float = DEFAULT_FULL_SCALE if model is None else model.full_scale
        if descriptor_full_scale is not None and low <= descriptor_full_scale <= high:
            full_scale = descriptor_full_scale
        if self._options.full_scale is not None:
            full_scale = self._options.full_scale
        self._full_scale = full_scale
        self._dead_counts = self._options.dead_zone * full_scale

    def _set_period(self, period_s: float) -> None:
        self._gap_after_s = max(GAP_AFTER_S, GAP_PERIODS * period_s)
        slow = period_s > REPORT_PERIOD_S
        self._stale_after_s = SLOW_STALE_AFTER_S if slow else STALE_AFTER_S

    def _drop_input(self, now_s: float) -> None:
        self._translation.forget()
        self._rotation.forget()
        self._active = False
        self._ignore_rest_until_s = NEVER_S
        self._last_half = None
        self._drift.reset()
