"""Simulated input device and the kernel's part, without I/O and in virtual time.

Time is given in seconds from plugging in and advances only in `reports`. The hardware is polled
every `InputDeviceModel.period_s`; only changes are reported, as by the kernel.
"""

from __future__ import annotations

import errno
import math
import random
from collections.abc import Hashable, Mapping, Sequence
from typing import NamedTuple

from cardan.errors import ScriptError
from cardan.protocols.evdev.codes import ABS_HAT0X, ABS_HAT0Y, KEY_CODES, KEY_COUNT
from cardan.protocols.evdev.events import (
    EV_ABS,
    EV_FF,
    EV_KEY,
    EV_MSC,
    EV_REP,
    EV_SYN,
    KEY_DOWN,
    KEY_REPEAT,
    KEY_UP,
    MSC_SCAN,
    SYN_REPORT,
    InputEvent,
    MalformedPacket,
    decode_events,
)
from cardan.protocols.evdev.requests import (
    BITS_BYTES,
    EVIOCGEFFECTS,
    EVIOCGID,
    EVIOCGKEY,
    EVIOCGNAME,
    EVIOCGRAB,
    EVIOCRMFF,
    EVIOCSFF,
    NAME_BYTES,
    AbsInfo,
    IoctlCall,
    Rumble,
    argument_bytes,
    decode_int,
    decode_rumble,
    encode_absinfo,
    encode_bits,
    encode_id,
    encode_int,
    encode_rumble,
    eviocgabs,
    eviocgbit,
)
from cardan.sim_peers.evdev.faults import check_faults
from cardan.sim_peers.evdev.models import InputDeviceModel

Controls = tuple[float, float, float, float, float, float]
"""Left stick to the right and up, right stick likewise, -1..1; left and right trigger, 0..1."""
NEUTRAL: Controls = (0.0,) * 6

REPEAT_DELAY_S, REPEAT_PERIOD_S = 0.25, 0.033
"""Autorepeat of a held key by the kernel."""
EFFECTS = 16
"""Effects that the kernel keeps for two motors."""

_STICK_SIGNS = (1.0, -1.0, 1.0, -1.0)
_TRIGGERS = ("left-trigger", "right-trigger")
_HATS = {
    "dpad-left": (ABS_HAT0X, -1),
    "dpad-right": (ABS_HAT0X, 1),
    "dpad-up": (ABS_HAT0Y, -1),
    "dpad-down": (ABS_HAT0Y, 1),
}
_SCAN_CODES = {
    KEY_CODES[label]: code
    for label, code in (
        ("kp-enter", 0x9C), ("right-ctrl", 0x9D), ("kp-slash", 0xB5), ("right-alt", 0xB8),
        ("home", 0xC7), ("up", 0xC8), ("page-up", 0xC9), ("left", 0xCB), ("right", 0xCD),
        ("end", 0xCF), ("down", 0xD0), ("page-down", 0xD1), ("insert", 0xD2), ("delete", 0xD3),
        ("left-meta", 0xDB), ("right-meta", 0xDC), ("compose", 0xDD),
    )
}  # fmt: skip
"""Scan codes of a keyboard's controller that differ from the key's own number."""


class InputEvents(NamedTuple):
    """Changes at one poll: type, code and value of each event, SYN_REPORT last."""

    time_s: float
    events: tuple[tuple[int, int, int], ...]

    def stamped(self, offset_s: float) -> list[InputEvent]:
        """The events, with their time counted from `offset_s` before the script's start."""
        sec, usec = divmod(round(1e6 * (self.time_s + offset_s)), 1_000_000)
        return [InputEvent(sec, usec, *event) for event in self.events]


class _Effect:
    """An uploaded effect."""

    def __init__(self, effect: Rumble, owner: Hashable) -> None:
        self.effect = effect
        self.owner = owner
        self.started_s: float | None = None


class SimulatedInput:
    """A gamepad or keyboard: move its controls, it gives the kernel's events and answers.

    `faults` are values by the names of `FAULTS`; `jitter_lsb` is the noise of the sticks in the
    hand, in counts; `uinput`: the kernel itself filters and repeats.
    """

    def __init__(
        self,
        model: InputDeviceModel,
        *,
        faults: Mapping[str, float] | None = None,
        jitter_lsb: int = 0,
        seed: int = 0,
        uinput: bool = False,
    ) -> None:
        faults = faults or {}
        check_faults(faults, model, uinput=uinput)
        self.model = model
        self.plugged = True
        self.controls = NEUTRAL
        self.refused = 0
        """Invalid writes and requests of clients."""
        self.grabbed_by: Hashable | None = None
        self._uinput = uinput
        self._faults = faults
        self._jitter_lsb = jitter_lsb
        self._random = random.Random(seed)
        self._values = {code: info.value for code, info in model.axes.items()}
        self._keys: dict[int, float] = {}
        """Keys that the kernel knows to be down, and their times; newest last."""
        self._changes: list[tuple[int, bool]] = []
        self._hats: list[str] = []
        self._held: list[str] = []
        self._stuck_left: tuple[float, float] | None = None
        self._effects: dict[int, _Effect] = {}
        self._poll = 0
        self._now_s = 0.0
        self._moved = True
        self._repeat_s = math.inf
        self._silenced = False
        self._plugging = [
            (faults[name], action)
            for name, action in (("unplug", self.unplug), ("replug", self.replug))
            if name in faults
        ]

    # -- device states ----------------------------------------------------------------------------

    def set_controls(self, controls: Sequence[float]) -> None:
        """Move the sticks (-1..1) and triggers (0..1); six finite numbers, clamped."""
        if len(controls) != 6 or not all(map(math.isfinite, controls)):
            raise ValueError(f"controls must be six finite numbers, not {controls!r}")
        if not self.model.is_gamepad:
            return
        lx, ly, rx, ry = (min(1.0, max(-1.0, value)) for value in controls[:4])
        lt, rt = (min(1.0, max(0.0, value)) for value in controls[4:])
        if (lx, ly, rx, ry, lt, rt) != self.controls:
            if self._stuck_left is None and self._now_s >= self._faults.get("stuck-axis", math.inf):
                self._stuck_left = self.controls[:2]
            self.controls = (lx, ly, rx, ry, lt, rt)
            self._moved = True

    def press(self, label: str) -> None:
        """Press a button or key. Raises ScriptError if the device has no such label."""
        self._change(label, pressed=True)

    def release(self, label: str) -> None:
        """Release a button or key. Raises ScriptError if the device has no such label."""
        if label in self._held and self._now_s >= self._faults.get("stuck-button", math.inf):
            return
        self._change(label, pressed=False)

    @property
    def held(self) -> tuple[str, ...]:
        """Labels of held keys and buttons, oldest first."""
        return tuple(self._held)

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of all that can be pressed."""
        return (*self.model.codes, *(_HATS if self.model.is_gamepad else ()))

    def unplug(self) -> None:
        """Unplug the device."""
        self.plugged = False
        self._effects.clear()
        self.grabbed_by = None

    def replug(self) -> None:
        """Plug it in again: initially the kernel knows of no held key."""
        if not self.plugged:
            self.plugged = True
            self._values = {code: info.value for code, info in self.model.axes.items()}
            self._keys.clear()
            self._changes = [(self.model.codes[k], True) for k in self._held if k not in _HATS]
            self._moved = True
            self._repeat_s = math.inf

    def silence(self) -> None:
        """Send no reports, as after a loss of the radio link, until `resume`."""
        self._silenced = True

    def resume(self) -> None:
        """Report again."""
        self._silenced = False
        self._moved = True

    # -- time ----------------------------------------------------------------------------------

    @property
    def next_due_s(self) -> float:
        """Time of the next work of `reports`; inf while at rest."""
        due_s = self._plugging[0][0] if self._plugging else math.inf
        if not self._mute_at(self._now_s):
            if self._moved or self._changes or self._noisy:
                due_s = min(due_s, self._poll * self.model.period_s)
            due_s = min(due_s, self._repeat_s)
        return due_s

    def reports(self, now_s: float) -> list[InputEvents]:
        """Return the frames that the kernel reports from the last call until `now_s`."""
        frames: list[InputEvents] = []
        while True:
            plug_s = self._plugging[0][0] if self._plugging else math.inf
            self._run(min(now_s, plug_s), frames)
            if plug_s > now_s:
                self._now_s = max(self._now_s, now_s)
                return frames
            self._now_s = plug_s
            self._plugging.pop(0)[1]()

    def skip_to(self, now_s: float) -> None:
        """Skip to `now_s` without polls of the time before."""
        self._poll = max(self._poll, math.ceil(now_s / self.model.period_s - 1e-9))

    # -- the host ------------------------------------------------------------------------------

    def call(self, client: Hashable, request: int, argument: bytes, now_s: float) -> IoctlCall:
        """Answer an ioctl request of `client`."""
        result = self._answer(client, request, argument, now_s)
        if isinstance(result, int):
            self.refused += 1
            return IoctlCall(request, -result, b"\0" * argument_bytes(request))
        size = argument_bytes(request)
        return IoctlCall(request, 0, result[:size].ljust(size, b"\0"))

    def write(self, client: Hashable, data: bytes, now_s: float) -> None:
        """Handle events that `client` writes; only those that play effects are used."""
        events = decode_events(data)
        if isinstance(events, MalformedPacket):
            self.refused += 1
            return
        for event in events:
            effect = self._effects.get(event.code) if event.type == EV_FF else None
            if effect is None or effect.owner != client:
                self.refused += 1
            else:
                effect.started_s = now_s if event.value > 0 else None

    def take_effect(self, effect: Rumble, now_s: float) -> None:
        """Store an effect that the kernel passes to a uinput device."""
        slot = self._effects.setdefault(effect.id, _Effect(effect, None))
        slot.effect = effect
        if slot.started_s is not None:
            slot.started_s = now_s

    def play(self, effect_id: int, now_s: float, *, on: bool) -> None:
        """Start or stop an effect of a uinput device."""
        if effect_id in self._effects:
            self._effects[effect_id].started_s = now_s if on else None

    def gone(self, client: Hashable) -> None:
        """Handle the end of `client`: its grab ends, its effects are erased."""
        if self.grabbed_by == client:
            self.grabbed_by = None
        self._effects = {k: e for k, e in self._effects.items() if e.owner != client}

    def erase(self, effect_id: int) -> None:
        """Erase an effect."""
        self._effects.pop(effect_id, None)

    def rumble(self, now_s: float) -> tuple[float, float]:
        """Strength of the heavy and the light motor at `now_s`, 0..1."""
        strong = weak = 0
        for slot in self._effects.values():
            length_s = slot.effect.length_ms / 1000.0 or math.inf
            if slot.started_s is not None and now_s < slot.started_s + length_s:
                strong, weak = max(strong, slot.effect.strong), max(weak, slot.effect.weak)
        return strong / 0xFFFF, weak / 0xFFFF

    # -- inside: reports of the hardware -------------------------------------------------------

    @property
    def _noisy(self) -> bool:
        return bool(self._jitter_lsb) and any(self.controls[:4])

    def _mute_at(self, at_s: float) -> bool:
        return not self.plugged or self._silenced or at_s >= self._faults.get("silence", math.inf)

    def _change(self, label: str, *, pressed: bool) -> None:
        if label not in self.labels:
            raise ScriptError(
                f"{self.model.name} has no button {label!r}; it has: {', '.join(self.labels)}"
            )
        if pressed == (label in self._held):
            return
        (self._held.append if pressed else self._held.remove)(label)
        if label in _HATS:
            (self._hats.append if pressed else self._hats.remove)(label)
            self._moved = True
        elif self.plugged:
            self._changes.append((self.model.codes[label], pressed))

    def _run(self, until_s: float, frames: list[InputEvents]) -> None:
        period_s = self.model.period_s
        while True:
            poll_s = self._poll * period_s
            wanted = self._moved or self._changes or self._noisy
            at_s = min(poll_s if wanted else math.inf, self._repeat_s)
            if at_s > until_s or self._mute_at(at_s):
                break
            self._now_s = max(self._now_s, at_s)
            if at_s == self._repeat_s:
                self._repeat(frames)
                continue
            self._poll += 1
            events = self._sample(at_s)
            if events:
                frames.append(InputEvents(at_s, (*events, (EV_SYN, SYN_REPORT, 0))))
        self.skip_to(until_s)

    def _sample(self, at_s: float) -> list[tuple[int, int, int]]:
        self._moved = False
        events: list[tuple[int, int, int]] = []
        done: set[int] = set()
        while self._changes and self._changes[0][0] not in done:
            code, pressed = self._changes.pop(0)
            done.add(code)
            events += self._key_events(code, pressed, at_s)
        for code, value in self._readings():
            self._report(code, value, events)
        return events

    def _key_events(self, code: int, pressed: bool, at_s: float) -> list[tuple[int, int, int]]:
        if pressed == (code in self._keys):
            return []
        if pressed:
            self._keys[code] = at_s
        else:
            del self._keys[code]
        repeats = self.model.repeats and not self._uinput
        if repeats:
            newest = [*self._keys][-1:] == [code]
            self._repeat_s = at_s + REPEAT_DELAY_S if pressed and newest else math.inf
        scan = [(EV_MSC, MSC_SCAN, _SCAN_CODES.get(code, code))] if self.model.repeats else []
        return [*scan, (EV_KEY, code, KEY_DOWN if pressed else KEY_UP)]

    def _repeat(self, frames: list[InputEvents]) -> None:
        code = [*self._keys][-1]
        frames.append(
            InputEvents(self._repeat_s, ((EV_KEY, code, KEY_REPEAT), (EV_SYN, SYN_REPORT, 1)))
        )
        self._repeat_s += REPEAT_PERIOD_S

    def _readings(self) -> list[tuple[int, int]]:
        """Axis values that the hardware measures."""
        if not self.model.is_gamepad:
            return []
        left = self._stuck_left or self.controls[:2]
        drift = self._faults.get("drift", 0.0)
        readings = []
        for code, sign, share in zip(
            self.model.sticks, _STICK_SIGNS, (*left, *self.controls[2:4]), strict=True
        ):
            info = self.model.axes[code]
            away = sign * (share + drift)
            reach = info.maximum - info.value if away > 0.0 else info.value - info.minimum
            noise = self._random.randint(-self._jitter_lsb, self._jitter_lsb) if share else 0
            counts = info.value + round(away * reach) + noise
            readings.append((code, min(info.maximum, max(info.minimum, counts))))
        for code, share in zip(self.model.triggers, self.controls[4:], strict=False):
            readings.append((code, round(share * self.model.axes[code].maximum)))
        hats = [_HATS[label] for label in self._hats]
        readings += [
            (code, sum(way for hat, way in hats if hat == code)) for code in (ABS_HAT0X, ABS_HAT0Y)
        ]
        return readings

    def _report(self, code: int, value: int, events: list[tuple[int, int, int]]) -> None:
        old = self._values[code]
        if not self._uinput:
            value = _without_fuzz(value, old, self.model.axes[code].fuzz)
        if value == old:
            return
        self._values[code] = value
        events.append((EV_ABS, code, value))
        if code in self.model.triggers:
            button = self.model.codes.get(_TRIGGERS[self.model.triggers.index(code)])
            if button is not None and (value > 0) != (button in self._keys):
                events += self._key_events(button, value > 0, self._now_s)

    # -- inside: the requests ------------------------------------------------------------------

    def _answer(self, client: Hashable, request: int, argument: bytes, now_s: float) -> bytes | int:
        """Return the argument after `request`, or the errno."""
        model = self.model
        if not self.plugged:
            return errno.ENODEV
        if request == EVIOCGID:
            return encode_id(model.id)
        if request == EVIOCGNAME:
            return model.name.encode()[: NAME_BYTES - 1]
        if request == EVIOCGKEY:
            return encode_bits(self._keys, KEY_COUNT // 8)
        if request == EVIOCGEFFECTS:
            return encode_int(EFFECTS if model.effects else 0)
        if request == EVIOCGRAB:
            return self._grab(client, decode_int(argument) != 0)
        if request == EVIOCSFF:
            return self._upload(client, argument, now_s)
        if request == EVIOCRMFF:
            effect = self._effects.get(decode_int(argument))
            if effect is None or effect.owner != client:
                return errno.EINVAL if effect is None else errno.EACCES
            self.erase(effect.effect.id)
            return argument
        for kind in BITS_BYTES:
            if request == eviocgbit(kind):
                return encode_bits(self._codes(kind), BITS_BYTES[kind])
        for code, info in model.axes.items():
            if request == eviocgabs(code):
                return encode_absinfo(AbsInfo(self._values[code], *info[1:]))
        return errno.EINVAL

    def _codes(self, kind: int) -> frozenset[int]:
        model = self.model
        kinds = {EV_SYN, EV_KEY, *({EV_MSC, EV_REP} if model.repeats else {EV_ABS, EV_FF})}
        return {
            EV_SYN: frozenset(kinds),
            EV_KEY: frozenset(model.codes.values()),
            EV_ABS: frozenset(model.axes),
            EV_FF: model.effects,
        }[kind]

    def _grab(self, client: Hashable, on: bool) -> bytes | int:
        if on:
            if self.grabbed_by is not None:
                return errno.EBUSY
            self.grabbed_by = client
        else:
            if self.grabbed_by != client:
                return errno.EINVAL
            self.grabbed_by = None
        return encode_int(int(on))

    def _upload(self, client: Hashable, argument: bytes, now_s: float) -> bytes | int:
        effect = decode_rumble(argument)
        if isinstance(effect, MalformedPacket) or not self.model.effects:
            return errno.EINVAL
        if "refuse-rumble" in self._faults:
            return errno.ENOSPC
        if effect.id == -1:
            free = [number for number in range(EFFECTS) if number not in self._effects]
            if not free:
                return errno.ENOSPC
            effect = effect._replace(id=free[0])
            self._effects[effect.id] = _Effect(effect, client)
            return encode_rumble(effect)
        slot = self._effects.get(effect.id)
        if slot is None or slot.owner != client:
            return errno.EINVAL if slot is None else errno.EACCES
        slot.effect = effect
        if slot.started_s is not None:  # A playing effect restarts.
            slot.started_s = now_s
        return encode_rumble(effect)


def _without_fuzz(value: int, old: int, fuzz: int) -> int:
    """Apply the kernel's filter of small noise on an axis."""
    if fuzz:
        away = abs(value - old)
        if away < fuzz // 2:
            return old
        if away < fuzz:
            return (3 * old + value) // 4
        if away < 2 * fuzz:
            return (old + value) // 2
    return value
