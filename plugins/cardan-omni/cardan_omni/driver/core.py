"""Core of the Omni driver: tick snapshots to device state; no I/O, time is an argument.

- The link is LIVE while the newest tick is young, the device calibrated, its stylus out of the
  inkwell, and its position plausible. Otherwise there is no pose and the buttons are released.
- It is LIVE again only after the buttons were seen up: a button held through a fault must not
  act. The axes (rate mode) stay zero until the stylus was seen near its center.
- Button edges come from the tick's counters, so that a click between two snapshots is an edge too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from cardan import spatial
from cardan.common.haptics import Calibration, HapticState, OperatingState
from cardan.drivers.core import DeviceCore
from cardan.drivers.shaping import Shaper
from cardan.types import NEUTRAL, NEVER_S, ZERO3, Axes, DeviceLink, Pose, Vector3
from cardan_omni.driver.calibration import CalibrationWatch
from cardan_omni.driver.options import OmniOptions

BUTTONS = ("button_1", "button_2")
"""Names of the buttons: button_1 is the front one (dark), button_2 the rear one (white)."""

RATE_KNOWN_AFTER = 80
"""Number of ticks after opening before the smoothed rate is valid."""

FORCE_KNOWN_S = 0.02
"""Age of a snapshot beyond which its force is unknown."""

POSE_AFTER_S = 0.1
"""Largest age of the pose that `measured` gives."""

SETTLING_S = 0.5
"""Time after opening in which the calibration may settle and the rate be unknown."""

SETTLES = (Calibration.OK, Calibration.UNKNOWN)

SLOW_S = 0.3
"""Duration of a low rate beyond which it is not a passing stall."""

GAP_REPORT_HOLD_S = 0.05
"""Time for which a gap between ticks is still reported after it ended, so that every reader sees
it."""

SLOW_TICK_S = 0.8e-3
"""Duration of a tick, of the 1 ms available, above which the diagnosis reports it."""

WARM = 0.8
"""Motor temperature (0 cold, 1 hottest) above which the diagnosis reports it."""

UNSEEN_REASON = "opened, no tick yet"
SILENT_REASON = f"no tick of the force loop for {FORCE_KNOWN_S * 1e3:g} ms: its force is not known"
INKWELL_REASON = "the stylus is in the inkwell: take it out"
BUTTONS_REASON = "let go of the buttons once"
NO_POSITION_REASON = "the device gives no position"


class Identity(NamedTuple):
    """Identity and nominal values that the device reports. SI units, hand frame."""

    model: str = ""
    serial: str = ""
    vendor: str = ""
    api_version: str = ""
    driver_version: str = ""
    firmware: str = ""
    max_force_n: float = 0.0
    continuous_force_n: float = 0.0
    max_stiffness_n_m: float = 0.0
    max_damping_n_s_m: float = 0.0
    usable_lower_m: Vector3 = ZERO3
    usable_upper_m: Vector3 = ZERO3
    reach_lower_m: Vector3 = ZERO3
    reach_upper_m: Vector3 = ZERO3
    input_dof: int = 0
    output_dof: int = 0
    calibration_styles: int = 0


class OmniCore(DeviceCore):
    """State of one device. Times are monotonic, s."""

    def __init__(self, options: OmniOptions) -> None:
        super().__init__()
        self._options = options
        self.calibration = CalibrationWatch()
        self.identity = Identity()
        self.snapshot = HapticState()
        """Newest snapshot; its maxima are since the last snapshot that was `taken`."""
        self.hint = ""
        """Further warning, about the force loop's priority and permissions."""
        self.numbers_hint = ""
        """Fault of the process's locale for numbers."""
        self._shaper = Shaper(options)
        self._center = Vector3(*options.center_m)
        angles = (math.radians(angle) for angle in options.center_rpy_deg)
        self._upright = spatial.conjugate(spatial.from_euler_zyx(*angles))
        self._presses = (0, 0)
        self._levels = 0
        self._deflected: Axes = NEUTRAL
        self._axes_count = False
        self._first_tick = 0
        self._fast = False
        """True if the loop is fast enough for force."""
        self._slow_since_s: float | None = None
        self._update_due = False
        self._gap_seen_s = NEVER_S
        self.errors = 0
        """Number of errors of the library, counted by the tick."""
        self.bad_readings = 0
        """Number of ticks in which the device could not be read."""
        self._longest_gap_s = 0.0
        self._longest_cost_s = 0.0
        self._opened_s = 0.0

    # -- what happens --------------------------------------------------------------------------

    def on_opened(self, identity: Identity, now_s: float) -> None:
        """Discard what was known of the stylus when the device was opened (again)."""
        self.identity = identity
        self.calibration.on_opened(identity.calibration_styles)
        self._fast, self._slow_since_s = False, None
        self._update_due = False
        self._gap_seen_s = NEVER_S
        self._stamp_s = NEVER_S
        self._opened_s = now_s
        self._begin(UNSEEN_REASON, now_s)

    def on_snapshot(self, snapshot: HapticState, now_s: float) -> None:
        """Process the newest snapshot of the tick at `now_s`. Never raises."""
        last = self.snapshot
        if self._heard:  # Otherwise the gap began before the device was opened.
            self._longest_gap_s = max(self._longest_gap_s, snapshot.gap_s)
        self._longest_cost_s = max(self._longest_cost_s, snapshot.tick_cost_s)
        self.snapshot = snapshot._replace(
            gap_s=max(last.gap_s, snapshot.gap_s),
            tick_cost_s=max(last.tick_cost_s, snapshot.tick_cost_s),
        )
        if not self._open or snapshot.stamp_s < self._opened_s:
            return
        if not self._heard:
            self._first_tick = snapshot.ticks
        elif snapshot.gap_s > self._options.stale_after_s and snapshot.ticks != last.ticks:
            # No reader saw the loss, but it counts as one.
            self._gap_seen_s = now_s
        self._heard = True
        self._cached = None
        self._stamp_s = snapshot.stamp_s
        self._check_rate(snapshot, now_s)
        if self.calibration.on_answer(snapshot.calibration, now_s):
            self._update_due = True
        before, self._levels = self._levels, snapshot.buttons
        counts, self._presses = self._presses, snapshot.presses
        was_live = self._link is DeviceLink.LIVE
        self._watch(now_s)
        if self._link is DeviceLink.LIVE:
            if was_live and (before != self._levels or counts != self._presses):
                self._show_buttons(before, counts, now_s)
            self._deflect()

    def take_update(self) -> bool:
        """Return True, once for each time, if the library must calibrate now."""
        due, self._update_due = self._update_due, False
        return due

    def taken(self, now_s: float) -> HapticState:
        """Return the newest snapshot at `now_s`; longest gap and cost are reset."""
        snapshot = self.checked_snapshot(now_s)
        self.snapshot = self.snapshot._replace(gap_s=0.0, tick_cost_s=0.0)
        return snapshot

    def checked_snapshot(self, now_s: float) -> HapticState:
        """Return the newest snapshot at `now_s`; without force, and with the reason in words, if it
        is too old or the device must not give force."""
        snapshot = self.snapshot
        reason = ""
        if not self._ticks(now_s):
            reason = self.state(now_s).reason or SILENT_REASON
        elif snapshot.state is OperatingState.ENABLED:
            reason = self.force_obstacle(now_s)
        if not reason:
            return snapshot
        if snapshot.state is OperatingState.FAULT:
            reason = snapshot.reason or reason
        return snapshot._replace(force=ZERO3, force_commanded=ZERO3, rendering=False, reason=reason)

    def _ticks(self, now_s: float) -> bool:
        """Return True if the newest snapshot is recent."""
        return now_s - self.snapshot.stamp_s <= FORCE_KNOWN_S

    def forget_tick(self) -> None:
        """Discard the tick and its counters after it was closed."""
        self.snapshot = HapticState(reason=self._reason)
        self._presses = (0, 0)

    # -- what it says --------------------------------------------------------------------------

    def open_for_s(self, now_s: float) -> float:
        """Return the time since the device was opened."""
        return now_s - self._opened_s

    def force_obstacle(self, now_s: float) -> str:
        """Return why the device must not give force now; empty when it may."""
        if not self._open:
            return self._reason
        if not self._heard:
            return "no tick of the force loop since the device was opened"
        if not self._fast and not self._ticks(now_s):
            return SILENT_REASON
        if not self._fast and self.snapshot.ticks - self._first_tick >= RATE_KNOWN_AFTER:
            return (
                f"the library's loop runs at {self.snapshot.rate_hz:.0f} Hz, and force needs 1000: "
                "is the machine busy, or another rate set in the vendor's setup tool?"
            )
        if self.identity.output_dof < 3:
            return f"the device gives {self.identity.output_dof} forces, and 3 are needed"
        if reason := self.calibration.reason(now_s):
            return reason
        return "" if self._fast else "waiting until the rate of the force loop is known"

    def settling(self, now_s: float) -> bool:
        """True if the obstacle to force is expected to end by itself soon."""
        if not self._open or self.calibration.state not in SETTLES:
            return False
        return not self.calibration.usable(now_s) or now_s - self._opened_s < SETTLING_S

    def measured(self, now_s: float) -> tuple[Pose | None, str]:
        """Return the newest pose, or None and the reason; valid also while buttons or the inkwell
        keep the link from being LIVE."""
        if not self._open:
            return None, self._reason
        if not now_s - self._stamp_s <= POSE_AFTER_S:
            return None, "no tick of the force loop"
        if reason := self.calibration.reason(now_s):
            return None, reason
        return self.snapshot.pose, NO_POSITION_REASON

    def _axes(self, now_s: float) -> Axes:
        return self._deflected

    def _pose(self) -> Pose | None:
        return self.snapshot.pose

    @property
    def _counters(self) -> Mapping[str, str]:
        stale_ms = 1e3 * self._options.stale_after_s
        return {
            "calibrations_lost": "times the calibration was lost",
            "silences": f"times no tick came for more than {stale_ms:g} ms",
            "bad_readings": "times the device could not be read",
            "library_errors": "errors of the library",
            "late_ticks": "ticks came late: real-time priority and an idle machine help",
            "stale_commands": "times the source of the force fell silent",
            "dropped_commands": "commands came too late or out of order, and were dropped",
            "faults": "faults that switched the force off",
        }

    def _tally(self) -> Mapping[str, int]:
        snapshot = self.snapshot
        return {
            "calibrations_lost": self.calibration.changes,
            "silences": self._counts["silences"],
            "bad_readings": self.bad_readings,
            "library_errors": self.errors,
            "late_ticks": snapshot.late_ticks,
            "stale_commands": snapshot.stale_commands,
            "dropped_commands": snapshot.dropped_commands,
            "faults": snapshot.faults,
        }

    def _figures(self, now_s: float) -> dict[str, float]:
        """Describe the force loop's rate, gaps and cost, the force, its age, and the energy."""
        snapshot = self.checked_snapshot(now_s)
        return {
            "tick_age_s": now_s - self._stamp_s,
            "rate_hz": snapshot.rate_hz,
            "longest_gap_s": self._longest_gap_s,
            "longest_tick_s": self._longest_cost_s,
            "ticks": snapshot.ticks,
            "force_n": spatial.norm(snapshot.force),
            "force_commanded_n": spatial.norm(snapshot.force_commanded),
            "command_age_s": snapshot.command_age_s,
            "force_age_s": snapshot.force_age_s,
            "temperature": snapshot.temperature,
            "thermal_derating": snapshot.thermal_derating,
            "energy_j": snapshot.energy_j,
            "delivered_j": snapshot.delivered_j,
            "passivity_damping_n_s_m": snapshot.passivity_damping_n_s_m,
        }

    def _notes(self, now_s: float) -> list[str]:
        snapshot = self.snapshot
        reason = self.state(now_s).reason
        words = []
        if self.numbers_hint and self.numbers_hint not in reason:
            words.append(self.numbers_hint)
        if not self._open:
            return words
        obstacle = self.force_obstacle(now_s)
        if obstacle and obstacle != reason:
            words.append(f"no force: {obstacle}")
        if snapshot.state is OperatingState.FAULT:
            words.append(f"no force until it is enabled again; {snapshot.reason or 'fault'}")
        elif snapshot.state is OperatingState.DISABLED:
            words.append("the force is disabled: no program has enabled it")
        elif snapshot.state is OperatingState.PAUSED:
            words.append(f"no force: {snapshot.reason or 'paused'}")
        if snapshot.temperature >= WARM:
            words.append(
                f"the motors are warm ({snapshot.temperature:.0%} of their limit): let them rest"
            )
        if snapshot.thermal_derating < 0.99:
            words.append(
                f"the force is limited to {snapshot.thermal_derating:.0%}: it was strong for "
                "long, and the motors would get too warm"
            )
        if self.hint:
            words.append(self.hint)
        if self._longest_cost_s > SLOW_TICK_S:
            words.append(
                f"a tick of the force loop took {self._longest_cost_s * 1e3:.3g} ms, of 1 ms there "
                "is: is the machine busy, or the library slow?"
            )
        return words

    # -- inside --------------------------------------------------------------------------------

    def _watch(self, now_s: float) -> None:
        """Update the link's state at `now_s`."""
        if not self._open:
            return
        link, reason = self._verdict(now_s)
        if link is DeviceLink.LIVE:
            if self._link is not DeviceLink.LIVE:
                self._link, self._reason = link, ""
                self._deflected, self._axes_count = NEUTRAL, False
                self._buttons.set((), now_s)
                self._cached = None
        elif self._link is not link or self._reason != reason:
            if link is DeviceLink.STALE and self._link is not DeviceLink.STALE:
                self._fall_silent(reason, now_s)
            else:
                self._invalidate_input(link, reason, now_s)

    def _check_rate(self, snapshot: HapticState, now_s: float) -> None:
        if snapshot.rate_hz >= self._options.lowest_rate_hz:
            self._slow_since_s = None
            self._fast = self._fast or snapshot.ticks - self._first_tick >= RATE_KNOWN_AFTER
        elif self._slow_since_s is None:
            self._slow_since_s = now_s
        elif now_s - self._slow_since_s >= SLOW_S:
            self._fast = False

    def _verdict(self, now_s: float) -> tuple[DeviceLink, str]:
        options, snapshot = self._options, self.snapshot
        if not self._heard:
            if now_s - self._opened_s <= options.stale_after_s:
                return DeviceLink.NEEDS_NEUTRAL, UNSEEN_REASON
            return DeviceLink.STALE, "no tick of the force loop since the device was opened"
        if not now_s - self._stamp_s <= options.stale_after_s:
            return (
                DeviceLink.STALE,
                f"no tick of the force loop for {options.stale_after_s * 1e3:g} ms: is the machine "
                "busy, or the device gone?",
            )
        if now_s - self._gap_seen_s < GAP_REPORT_HOLD_S:
            return (
                DeviceLink.STALE,
                f"no tick of the force loop for more than {options.stale_after_s * 1e3:g} ms a "
                "moment ago",
            )
        if reason := self.calibration.reason(now_s):
            return DeviceLink.NEEDS_NEUTRAL, reason
        if options.inkwell_switch and snapshot.inkwell:
            return DeviceLink.NEEDS_NEUTRAL, INKWELL_REASON
        pose = snapshot.pose
        if pose is None or not spatial.is_finite((*pose.position, *pose.orientation)):
            return DeviceLink.STALE, NO_POSITION_REASON
        if self._link is not DeviceLink.LIVE and snapshot.buttons & 0b11:
            return DeviceLink.NEEDS_NEUTRAL, BUTTONS_REASON
        return DeviceLink.LIVE, ""

    def _show_buttons(self, levels: int, counts: tuple[int, int], now_s: float) -> None:
        """Turn the counters' changes since the last snapshot into edges."""
        down = [bool(levels >> bit & 1) for bit in range(2)]
        for bit in range(2):
            for _ in range(min(self._presses[bit] - counts[bit], MOST_CLICKS)):
                if down[bit]:
                    down[bit] = False
                    self._buttons.set(_labels(down), now_s)
                down[bit] = True
                self._buttons.set(_labels(down), now_s)
        down = [bool(self._levels >> bit & 1) for bit in range(2)]
        self._buttons.set(_labels(down), now_s)

    def _deflect(self) -> None:
        options, pose = self._options, self.snapshot.pose
        assert pose is not None
        x, y, z = (
            value / options.range_m for value in spatial.subtract(pose.position, self._center)
        )
        turn = (
            spatial.to_rotation_vector(spatial.multiply(pose.orientation, self._upright))
            if options.rotation
            else ZERO3
        )
        rx, ry, rz = (math.degrees(value) / options.range_deg for value in turn)
        raw = tuple(max(-1.0, min(1.0, value)) for value in (x, y, z, rx, ry, rz))
        axes = self._shaper(raw)  # type: ignore[arg-type]
        self._axes_count = self._axes_count or not any(axes)
        self._deflected = axes if self._axes_count else NEUTRAL

    def _drop_input(self, now_s: float) -> None:
        self._deflected, self._axes_count = NEUTRAL, False


MOST_CLICKS = 50
"""Most clicks of a button reported between two snapshots."""


def _labels(down: list[bool]) -> list[str]:
    return [label for label, held in zip(BUTTONS, down, strict=True) if held]
