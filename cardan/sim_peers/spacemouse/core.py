"""A simulated 3Dconnexion device, without any I/O and in virtual time."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence

from cardan.errors import ScriptError
from cardan.protocols.connexion.devices import LONG_PRESS, Family, Model
from cardan.protocols.connexion.reports import (
    KEY_SLOTS,
    LedOutput,
    decode_output,
    encode_battery,
    encode_buttons,
    encode_keys_down,
    encode_long_press,
    encode_motion,
    encode_rotation,
    encode_translation,
    from_robot_axes,
    from_serial_axes,
)
from cardan.sim_peers.spacemouse.faults import FaultyLine

Axes = tuple[float, float, float, float, float, float]

AXES = ("X", "Y", "Z", "RX", "RY", "RZ")
NEUTRAL: Axes = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

SPLIT_PERIOD_S = 0.008
"""A wired device's 8-byte packets hold half a motion: ids 1 and 2 take turns."""
ONE_PERIOD_S = 0.016
ZERO_REPORTS = 3
"""Number of zero pairs (or whole zero reports) after a release, before the device falls silent."""
LONG_PRESS_S = 1.0
"""Duration of a long press of a key. The vendor does not publish it."""
BATTERY_CHANCE = 0.5
"""Share of the motions' ends, after the first, that a battery report follows."""
BATTERY_PERCENT = 85
LED_PRIMED_MODELS = frozenset({"spacemouse-compact"})
"""Models that switch the LED off only after the host has switched it on once."""


class SimulatedSpaceMouse:
    """Reports of a 3Dconnexion puck for given deflections and buttons.

    Time counts in seconds from plugging in and advances in `reports` only: a new state applies from
    the time of the last `reports` on. `faults` are values by the names of `FAULTS`; `jitter_lsb` is
    the noise on every axis while deflected, in counts.
    """

    def __init__(
        self,
        model: Model,
        *,
        faults: Mapping[str, float] | None = None,
        jitter_lsb: int = 0,
        seed: int = 0,
    ) -> None:
        faults = faults or {}
        self.model = model
        self.plugged = True
        self.led = True
        """LED state, on at power-up."""
        self.led_changed_s = 0.0
        self.refused_outputs = 0
        """Output reports that are invalid for the device."""
        self.axes = NEUTRAL
        self.battery_percent = int(faults.get("low-battery", BATTERY_PERCENT))
        self._line = FaultyLine(faults, model, seed)
        self._split = self._line.family is Family.SPLIT
        self._period_s = SPLIT_PERIOD_S if self._split else ONE_PERIOD_S
        self._jitter_lsb = jitter_lsb
        self._random = random.Random(seed)
        self._range = int(faults.get("overrange", model.full_scale))
        self._drift = round(faults.get("drift", 0.0))
        self._silent_after_s = faults.get("silence", math.inf)
        self._seized = bool(faults.get("seized"))
        self._stuck_bit = int(faults["stuck-button"]) if "stuck-button" in faults else None
        self._plugging = [
            (faults[name], action)
            for name, action in (("unplug", self.unplug), ("replug", self.replug))
            if name in faults
        ]
        self._bits = {label: bit for bit, label in model.buttons.items()}
        self._down: dict[int, float] = {}
        self._long: set[int] = set()
        self._key_reports: list[bytes] = []
        self._now_s = 0.0
        self._slot = 0
        self._silenced = False
        self._led_primed = False
        self._counts = self._counts_of(NEUTRAL)
        self._reset_motion()

    # -- device states ----------------------------------------------------------------------------

    def set_axes(self, axes: Sequence[float]) -> None:
        """Deflect the puck: six values in -1..1, robot frame (x forward, y left, z up)."""
        if len(axes) != 6 or not all(map(math.isfinite, axes)):
            raise ValueError(f"axes must be six finite numbers, not {axes!r}")
        x, y, z, rx, ry, rz = (min(1.0, max(-1.0, value)) for value in axes)
        self.axes = (x, y, z, rx, ry, rz)
        self._counts = self._counts_of(self.axes)

    def press(self, label: str) -> None:
        """Press a button. Raises ScriptError if the model has no such label."""
        bit = self._bit(label)
        if bit not in self._down:
            self._down[bit] = self._now_s
            self._report_keys(bit)

    def release(self, label: str) -> None:
        """Release a button. Raises ScriptError if the model has no such label."""
        bit = self._bit(label)
        if bit in self._down and bit != self._stuck_bit:
            del self._down[bit]
            self._report_keys(bit)
            if bit in self._long:
                self._long.discard(bit)
                self._report_long_press()

    @property
    def held(self) -> tuple[str, ...]:
        """Labels of the buttons that are down, oldest first."""
        return tuple(self.model.buttons[bit] for bit in self._down)

    def unplug(self) -> None:
        """Remove the device; reports under way are lost."""
        self.plugged = False
        self._line.cut()
        self._key_reports.clear()
        self._reset_motion()

    def replug(self) -> None:
        """Power it up again: LED on, and held buttons unknown until one of them changes."""
        if not self.plugged:
            self.plugged = self.led = True
            self._led_primed = False

    def silence(self) -> None:
        """Send nothing, as after a loss of the radio link, until `resume`."""
        self._silenced = True
        self._key_reports.clear()

    def resume(self) -> None:
        """Send again."""
        self._silenced = False

    # -- the host ------------------------------------------------------------------------------

    def output(self, report: bytes, now_s: float) -> None:
        """Handle an output report of the host; only the LED's is used."""
        value = decode_output(report)
        if not self.plugged or not self.model.led or not isinstance(value, LedOutput):
            self.refused_outputs += 1
            return
        if value.on:
            self._led_primed = True
        elif self.model.key in LED_PRIMED_MODELS and not self._led_primed:
            return
        if value.on != self.led:
            self.led = value.on
            self.led_changed_s = now_s

    @property
    def next_due_s(self) -> float:
        """Time of the next work of `reports`; inf while at rest."""
        due_s = min(self._line.next_due_s, self._plugging[0][0] if self._plugging else math.inf)
        if self._mute:
            return due_s
        if self._key_reports:
            return min(due_s, self._now_s)
        if not self._resting:
            due_s = min(due_s, self._slot * self._period_s)
        return min(due_s, self._next_long_press_s())

    def reports(self, now_s: float) -> list[bytes]:
        """Return the input reports that arrive at the host from the last call until `now_s`."""
        while self._plugging and self._plugging[0][0] <= now_s:
            at_s, action = self._plugging.pop(0)
            self._produce(at_s)
            arrived = self._line.arrived(at_s)
            action()
            return arrived + self.reports(now_s)
        self._produce(now_s)
        return self._line.arrived(now_s)

    def skip_to(self, now_s: float) -> None:
        """Make no motion reports for the time before `now_s`, which was not simulated."""
        if self._slot * self._period_s >= now_s:
            return
        self._slot = math.ceil(now_s / self._period_s)
        if self._split:
            self._slot += self._slot % 2
            self._owes_rotation = False

    # -- inside --------------------------------------------------------------------------------

    @property
    def _mute(self) -> bool:
        return self._seized or self._silenced or not self.plugged

    @property
    def _resting(self) -> bool:
        return not (self._zeros_left or self._owes_rotation or self._deflected)

    @property
    def _deflected(self) -> bool:
        return any(self._counts)

    def _bit(self, label: str) -> int:
        try:
            return self._bits[label]
        except KeyError:
            raise ScriptError(
                f"{self.model.name} has no button {label!r}; "
                f"it has: {', '.join(self._bits) or 'none'}"
            ) from None

    def _counts_of(self, axes: Axes) -> tuple[int, ...]:
        """Return raw counts of a deflection."""
        counts = from_robot_axes(axes, self._range)
        if self.model.serial_axes:
            counts = from_serial_axes(counts)  # This permutation is its own inverse.
        return tuple(min(self._range, max(-self._range, c + self._drift)) for c in counts)

    def _reset_motion(self) -> None:
        self._zeros_left = 0
        self._owes_rotation = False
        self._motions_ended = 0

    def _produce(self, until_s: float) -> None:
        """Send the device's reports until `until_s`."""
        until_s = max(until_s, self._now_s)
        if not self._mute:
            for report in self._key_reports:
                self._line.carry(report, self._now_s)
            self._key_reports.clear()
        while not self._mute and (press_s := self._next_long_press_s()) <= until_s:
            self._long.update(
                bit for bit, down_s in self._down.items() if down_s + LONG_PRESS_S <= press_s
            )
            self._report_long_press()
            self._line.carry(self._key_reports.pop(), press_s)
        while (due_s := self._slot * self._period_s) <= until_s:
            if self._mute or self._resting:
                self._slot = math.floor(until_s / self._period_s) + 1
                self._owes_rotation = False
                break
            self._send_motion(due_s)
            self._slot += 1
        self._now_s = until_s

    def _send_motion(self, due_s: float) -> None:
        """Fill the slot at `due_s`."""
        second_half = self._split and self._slot % 2 == 1
        if second_half and not self._owes_rotation:
            return
        if self._deflected:
            self._zeros_left = ZERO_REPORTS
        elif not second_half:
            self._zeros_left -= 1
        x, y, z, rx, ry, rz = self._sample()
        if not self._split:
            report = encode_motion(x, y, z, rx, ry, rz)
        elif second_half:
            report = encode_rotation(rx, ry, rz)
        else:
            report = encode_translation(x, y, z)
        self._owes_rotation = self._split and not second_half
        self._line.carry_motion(report, due_s)
        if self._zeros_left == 0 and not self._owes_rotation:
            self._end_motion(due_s)
        if self._deflected and due_s >= self._silent_after_s:
            self._silenced = True

    def _sample(self) -> Sequence[int]:
        if not self._jitter_lsb or not self._deflected:
            return self._counts
        top, noise = self._range, self._jitter_lsb
        return [
            min(top, max(-top, count + self._random.randint(-noise, noise)))
            for count in self._counts
        ]

    def _end_motion(self, due_s: float) -> None:
        self._motions_ended += 1
        if self.model.battery and (
            self._motions_ended == 1 or self._random.random() < BATTERY_CHANCE
        ):
            self._line.carry(encode_battery(self.battery_percent, False), due_s)

    def _report_keys(self, changed: int) -> None:
        """Report the buttons after the one of the bit `changed` was pressed or released."""
        if self._mute:
            return
        length = self.model.button_report_bytes
        bits = 8 * (length - 1)
        if changed < bits:
            mask = sum(1 << bit for bit in self._down if bit < bits)
            self._key_reports.append(encode_buttons(mask, length))
        if self.model.key_array:
            codes = [bit + 1 for bit in self._down][:KEY_SLOTS]
            self._key_reports.append(encode_keys_down(codes))

    def _report_long_press(self) -> None:
        if not self._mute:
            codes = [LONG_PRESS.get(bit + 1, bit + 1) for bit in self._down if bit in self._long]
            self._key_reports.append(encode_long_press(codes[:KEY_SLOTS]))

    def _next_long_press_s(self) -> float:
        if not self.model.key_array:
            return math.inf
        waiting = (down_s for bit, down_s in self._down.items() if bit not in self._long)
        return min(waiting, default=math.inf) + LONG_PRESS_S
