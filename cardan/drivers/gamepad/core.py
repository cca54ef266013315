"""Interpreter of a gamepad's events, without any I/O and in the caller's time.

Pads differ in where their right stick and triggers are: RX and RY with the triggers on Z and RZ
(Xbox by cable, PlayStation), Z and RZ with the triggers on GAS and BRAKE (Xbox by Bluetooth), on RX
and RY (PlayStation by the kernel's generic driver), or as buttons (Switch, simple pads). The node's
identity decides. An unknown pad is identified by the resting values of its axes: sticks are in the
middle of their range, triggers at its lower end. Until the pad has been at rest, each new frame is
evaluated: before the first one the kernel reports zeros.
"""

from __future__ import annotations

from collections.abc import Mapping

from cardan.drivers.evdev.core import EvdevCore
from cardan.drivers.gamepad.options import GamepadOptions
from cardan.drivers.shaping import Deflections, Shaper
from cardan.protocols.evdev.codes import (
    ABS_BRAKE,
    ABS_GAS,
    ABS_HAT0X,
    ABS_HAT0Y,
    ABS_RX,
    ABS_RY,
    ABS_RZ,
    ABS_X,
    ABS_Y,
    ABS_Z,
    FF_RUMBLE,
    PAD_BUTTONS,
    PAD_LABELS,
    AxisPair,
    PadLayout,
    pad_layout,
)
from cardan.protocols.evdev.requests import AbsInfo
from cardan.types import Axes, DeviceLink

LEAST_REST = 0.02
"""Deflection that counts as rest whatever the dead zone: a range of 0..255 has no exact center."""

TRIGGER_DOWN, TRIGGER_UP = 0.5, 0.3
"""An analog trigger is pressed as a button above the first and released below the second."""

RESTS_WITHIN = 0.25
"""Largest distance from the middle or the lower end of an axis, as a share of its range, that
counts as there."""

_PAIRS: tuple[AxisPair, ...] = ((ABS_RX, ABS_RY), (ABS_Z, ABS_RZ))
"""Axis pairs of the right stick or the triggers, the usual stick first."""
_PEDALS: AxisPair = (ABS_BRAKE, ABS_GAS)
"""Axis pair that is always the triggers."""

_HATS = ((ABS_HAT0X, "dpad-left", "dpad-right"), (ABS_HAT0Y, "dpad-up", "dpad-down"))
_NAMES = {
    "left_x": "left stick, left and right",
    "left_y": "left stick, up and down",
    "right_x": "right stick, left and right",
    "right_y": "right stick, up and down",
    "left_trigger": "left trigger",
    "right_trigger": "right trigger",
}


class _Stick:
    """An axis of a stick, scaled to -1..1 by the range that it declares."""

    __slots__ = ("center", "code", "flat", "negative", "positive", "sign")

    def __init__(self, code: int, info: AbsInfo, sign: float) -> None:
        low, high = info.minimum, info.maximum
        self.code = code
        self.sign = sign
        self.center = 0.0 if low < 0 < high else 0.5 * (low + high)
        self.positive = max(high - self.center, 1.0)
        self.negative = max(self.center - low, 1.0)
        self.flat = info.flat / self.positive

    def of(self, values: dict[int, int]) -> float:
        away = values[self.code] - self.center
        share = away / (self.positive if away > 0.0 else self.negative)
        return self.sign * min(1.0, max(-1.0, share))


class _Trigger:
    """A trigger: 0 to 1, from an axis or, without one, a button."""

    __slots__ = ("button", "code", "down", "label", "low", "span")

    def __init__(
        self, label: str, code: int | None, info: AbsInfo | None, button: int | None
    ) -> None:
        self.label = label
        self.code = code
        self.button = button
        self.low, self.span = (info.minimum, info.maximum - info.minimum) if info else (0, 1)
        self.down = False

    def of(self, values: dict[int, int], keys: set[int]) -> float:
        if self.code is None:
            return 1.0 if self.button in keys else 0.0
        return min(1.0, max(0.0, (values[self.code] - self.low) / max(self.span, 1)))

    def pressed(self, values: dict[int, int], keys: set[int]) -> bool:
        share = self.of(values, keys)
        self.down = share >= (TRIGGER_UP if self.down else TRIGGER_DOWN)
        return self.down


class GamepadCore(EvdevCore):
    """The state of one gamepad. Times are monotonic, s."""

    _radio_words = (
        "by Bluetooth: when the radio is lost with a stick deflected and the dead-man held, the "
        "system reports it only after seconds; set stale_after_s if the sticks flutter, or "
        "take a cable"
    )

    _guess_words = (
        "the system has counted this pad's buttons without knowing where they are: their names may "
        "be those of others; try the dead-man before you rely on it"
    )

    def __init__(self, options: GamepadOptions) -> None:
        super().__init__("press any button once", "let go of the sticks", options.stale_after_s)
        self._options = options
        self._shaper = Shaper(options)
        self._on_triggers = options.layout == "triggers"
        if self._on_triggers:
            self._release_words = "let go of the sticks and triggers"
        self._sticks: dict[str, _Stick] = {}
        self._triggers: tuple[_Trigger, ...] = ()
        self._layout = PadLayout(PAD_BUTTONS)

    @property
    def buttons(self) -> tuple[str, ...]:
        """Labels of the open pad's buttons; before, of every pad's."""
        keys = self.description.keys
        if not keys:
            return PAD_LABELS
        labels = [label for code, label in self._layout.buttons.items() if code in keys]
        for code, low, high in _HATS:
            if code in self.description.axes:
                labels += [low, high]
        labels += [trigger.label for trigger in self._trigger_buttons]
        return tuple(dict.fromkeys(labels))

    @property
    def rumbles(self) -> bool:
        """True if the open pad can rumble."""
        return FF_RUMBLE in self.description.effects

    # -- defined by the gamepad -------------------------------------------------------------------

    def _on_description(self) -> None:
        about = self.description
        self._layout = pad_layout(about.vendor, about.product, about.kernel_driver, about.keys)
        there = about.axes.keys()
        right, triggers = (
            pair if pair and there >= {*pair} else None
            for pair in (self._layout.right_stick, self._layout.triggers)
        )
        if self._layout.right_stick is None:
            right, *others = (*self._pairs, None)
            triggers = others[0] if others and others[0] else self._pedals
        self._assign(right, triggers)
        self._look_at_rest({code: info.value for code, info in about.axes.items()})

    @property
    def _pairs(self) -> list[AxisPair]:
        return [pair for pair in _PAIRS if self.description.axes.keys() >= {*pair}]

    @property
    def _pedals(self) -> AxisPair | None:
        return _PEDALS if self.description.axes.keys() >= {*_PEDALS} else None

    def _assign(self, right: AxisPair | None, triggers: AxisPair | None) -> None:
        """Assign the axes of the right stick and the triggers."""
        axes, keys = self.description.axes, self.description.keys
        right_x, right_y = right or (None, None)
        # Sticks count right and down as positive; here right and up (away from the operator) are.
        self._sticks = {
            name: _Stick(code, axes[code], sign)
            for name, code, sign in (
                ("left_x", ABS_X, 1.0),
                ("left_y", ABS_Y, -1.0),
                ("right_x", right_x, 1.0),
                ("right_y", right_y, -1.0),
            )
            if code is not None and code in axes
        }
        codes = {label: code for code, label in self._layout.buttons.items() if code in keys}
        self._triggers = tuple(
            _Trigger(label, code, None if code is None else axes[code], codes.get(label))
            for label, code in zip(
                ("left-trigger", "right-trigger"), triggers or (None, None), strict=True
            )
            if code is not None or label in codes
        )

    def _look_at_rest(self, values: Mapping[int, int]) -> None:
        """Identify the right stick and the triggers of an unknown pad by where its axes rest."""
        pairs = self._pairs
        if self._layout.right_stick is not None or len(pairs) < len(_PAIRS):
            return
        shares = {pair: [self._share(code, values) for code in pair] for pair in pairs}
        middle = [p for p in pairs if all(abs(s - 0.5) < RESTS_WITHIN for s in shares[p])]
        low = [p for p in pairs if all(s < RESTS_WITHIN for s in shares[p])]
        if middle:
            right = middle[0]
        elif len(low) == 1:
            # The other pair is the deflected stick.
            right = next(pair for pair in pairs if pair not in low)
        else:
            return
        triggers = next((pair for pair in pairs if pair != right and pair not in middle), None)
        self._assign(right, triggers or self._pedals)

    def _share(self, code: int, values: Mapping[int, int]) -> float:
        """Return the position of an axis in its range, 0..1."""
        info = self.description.axes[code]
        return (values[code] - info.minimum) / max(info.maximum - info.minimum, 1)

    def _settle(self) -> None:
        if self._link is not DeviceLink.LIVE and self._values:
            self._look_at_rest(self._values)
        super()._settle()

    def _notes(self, now_s: float) -> list[str]:
        unknown = self._open and not self._layout.known
        return super()._notes(now_s) + ([self._guess_words] if unknown else [])

    @property
    def _trigger_buttons(self) -> list[_Trigger]:
        """Analog triggers that act as buttons: those not mapped to an axis."""
        if self._on_triggers:
            return []
        return [trigger for trigger in self._triggers if trigger.code is not None]

    def _labels(self) -> list[str]:
        values, names = self._values, self._layout.buttons
        labels = [names.get(code) or f"button-{code}" for code in sorted(self._down)]
        for code, low, high in _HATS:
            value = values.get(code, 0)
            if value:
                labels.append(low if value < 0 else high)
        if values:
            labels += [
                trigger.label
                for trigger in self._trigger_buttons
                if trigger.pressed(values, self._down)
            ]
        return labels

    def _axes(self, now_s: float) -> Axes:
        left_x, left_y, right_x, right_y = (
            self._stick("left_x"),
            self._stick("left_y"),
            self._stick("right_x"),
            self._stick("right_y"),
        )
        shift = self._options.shift in self._buttons.held
        axes: Deflections
        if self._on_triggers:
            x, y, z = (
                left_y,
                0.0 - left_x,
                self._trigger("right-trigger") - self._trigger("left-trigger"),
            )
            axes = (
                (x, y, z, right_x, right_y, 0.0)
                if shift
                else (x, y, z, 0.0, right_y, 0.0 - right_x)
            )
        else:
            if self._options.layout == "swapped":
                left_x, left_y, right_x, right_y = right_x, right_y, left_x, left_y
            z, yaw = right_y, 0.0 - right_x
            axes = (
                (0.0, 0.0, z, left_x, left_y, yaw)
                if shift
                else (left_y, 0.0 - left_x, z, 0.0, 0.0, yaw)
            )
        return self._shaper(axes)

    def _away_from_rest(self) -> str:
        values = self._values
        if not values:
            return ""
        dead = max(self._options.dead_zone, LEAST_REST)
        away = []
        for name, stick in self._sticks.items():
            share = stick.of(values)
            if abs(share) > max(dead, stick.flat):
                away.append(f"{_NAMES[name]}: {share:+.2f}")
        if self._on_triggers:
            for trigger in self._triggers:
                share = trigger.of(values, self._down)
                if share > dead:
                    away.append(f"{trigger.label.replace('-', ' ')}: {share:.2f}")
        return ", ".join(away)

    def _stick(self, name: str) -> float:
        stick = self._sticks.get(name)
        return stick.of(self._values) if stick else 0.0

    def _trigger(self, label: str) -> float:
        for trigger in self._triggers:
            if trigger.label == label:
                return trigger.of(self._values, self._down)
        return 0.0
