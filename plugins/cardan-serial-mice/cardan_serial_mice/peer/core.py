"""Simulated serial devices of 3Dconnexion, without any I/O and in virtual time."""

from __future__ import annotations

import math
import random
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

from cardan.errors import ScriptError
from cardan.protocols.connexion.reports import from_robot_axes
from cardan.sim_peers.spacemouse.core import NEUTRAL
from cardan_serial_mice.peer.line import SerialLine
from cardan_serial_mice.protocol import (
    CommandReader,
    SerialModel,
    SpaceballMotion,
    encode_magellan_keys,
    encode_magellan_motion,
    encode_orb_keys,
    encode_orb_motion,
    encode_orb_reset,
    encode_orb_text,
    encode_spaceball_keys,
    encode_spaceball_motion,
    escape,
    from_hid_counts,
    keys_of_mask,
)
from cardan_serial_mice.protocol.magellan import ALPHABET, COMPRESSED_MAX, COMPRESSED_MIN
from cardan_serial_mice.protocol.spaceball import (
    LONGEST_PERIOD,
    PERIOD_UNIT_S,
    XOFF,
    XON,
    SpaceballKeys as Keys,
)
from cardan_serial_mice.protocol.spaceorb import COUNT_MAX, COUNT_MIN, HEARTBEAT_S

BOOT_S: Mapping[str, float] = {"magellan": 0.5, "spaceball": 0.5, "spaceorb": 1.0}
"""Time from power to the first command that a device of each protocol receives."""
SHORTEST_PERIOD_S = 0.058
"""Shortest period of a Magellan."""
SPACEBALL_SHORTEST_PERIOD_S = 0.02

MAGELLAN_VERSION = "   MAGELLAN  Version 5.79  by LOGITECH INC. 10/10/97 "
SPACEBALL_5000_VERSION = "   SPACEBALL  Version 7.01  by LOGITECH INC. 02/20/02 "
ORB_VERSION = " Spaceball (R) V4.34 19-Oct-96 Copyright (C) 1996"
SPACEBALL_FIRMWARE = {
    "spaceball-2003": "2.15 created on 24-Oct-1991",
    "spaceball-3003": "2.63 created on 10-Nov-1994",
    "spaceball-4000": "2.43 created on 08-Apr-1998",
}
"""The numbers distinguish the models; the dates are fictitious."""


class SimulatedSerialPuck(ABC):
    """Bytes of a serial six-axis device for given power, commands, deflections and buttons.

    Time counts in seconds from plugging in and advances in `reports` only. `faults` are values by
    the names of `SERIAL_FAULTS`; `jitter_lsb` is the noise on every axis while deflected, counts.
    The device has power while a host has its port open (RTS and DTR), and receives the first
    command `boot_s` later; None: the default of its kind.
    """

    def __init__(
        self,
        model: SerialModel,
        *,
        faults: Mapping[str, float] | None = None,
        jitter_lsb: int = 0,
        seed: int = 0,
        boot_s: float | None = None,
    ) -> None:
        faults = faults or {}
        self.model = model
        self.plugged = True
        self.axes = NEUTRAL
        self.powered = False
        self.refused_commands = 0
        """Commands that are invalid for the device."""
        self.beeps = 0
        self.faults_from_s = 0.0
        """Zero of the faults' times; inf: not yet."""
        self.host_began = False
        """True once a host has requested the keys or motion, or for a started device that needs no
        host, or receives nothing."""
        self._line = SerialLine(faults, model, seed)
        self._commands = CommandReader()
        self._jitter_lsb = jitter_lsb
        self._random = random.Random(seed)
        self._boot_s = BOOT_S[model.protocol] if boot_s is None else boot_s
        self._gain = faults.get("overrange", 1.0)
        self._drift = round(faults.get("drift", 0.0))
        self._silent_after_s = faults.get("silence", math.inf)
        self._mute = bool(faults.get("mute"))
        self._deaf = bool(faults.get("deaf"))
        self._answer_s = faults.get("slow-answer", 0.0) * 1e-3
        self._stuck = bool(faults.get("stuck-button"))
        self._plugging = sorted(
            (faults[name], name) for name in ("unplug", "replug", "power-loss") if name in faults
        )
        self._bits = {label: bit for bit, label in model.buttons.items()}
        self._down: dict[int, None] = {}
        self._silenced = False
        self._now_s = 0.0
        self._ready_s = math.inf
        """Time at which it has started; inf without power."""
        self._started = False
        self._skipped_s = 0.0
        self._zero: Sequence[int] = (0,) * 6
        self._period_s = model.period_s
        self._due_s = 0.0
        self._owes_zero = False
        self._start()

    # -- the motion ----------------------------------------------------------------------------

    def set_axes(self, axes: Sequence[float]) -> None:
        """Deflect the cap: six values in -1..1, robot frame (x forward, y left, z up)."""
        if len(axes) != 6 or not all(map(math.isfinite, axes)):
            raise ValueError(f"axes must be six finite numbers, not {axes!r}")
        x, y, z, rx, ry, rz = (min(1.0, max(-1.0, value)) for value in axes)
        self.axes = (x, y, z, rx, ry, rz)

    def press(self, label: str) -> None:
        """Press a button. Raises ScriptError if the model has no such label."""
        bit = self._bit(label)
        if bit not in self._down:
            self._down[bit] = None
            self._keys_changed(bit)

    def release(self, label: str) -> None:
        """Release a button. Raises ScriptError if the model has no such label."""
        bit = self._bit(label)
        if bit in self._down and not (self._stuck and bit == min(self._bits.values())):
            del self._down[bit]
            self._keys_changed(bit)

    @property
    def held(self) -> tuple[str, ...]:
        """Labels of the buttons that are down, oldest first."""
        return tuple(self.model.buttons[bit] for bit in self._down)

    def unplug(self) -> None:
        """Remove the device and its port; bytes under way are lost."""
        self.plugged = False
        self.power(False)

    def replug(self) -> None:
        """Bring the port back; the device has power once the port is opened."""
        self.plugged = True

    def silence(self) -> None:
        """Neither send nor receive, as with the cable unplugged from the port."""
        self._silenced = True

    def resume(self) -> None:
        """Resume sending and receiving."""
        self._silenced = False

    @property
    def led(self) -> bool | None:
        """No serial device has an LED."""
        return None

    # -- the host ------------------------------------------------------------------------------

    def power(self, on: bool) -> None:
        """Set RTS and DTR, which the host raises by opening the port and drops by closing it."""
        self.powered = on
        self._line.cut_at(self._now_s)
        self._commands.reset()
        self._start()
        self._started = False
        self._ready_s = self._now_s + self._boot_s if on else math.inf

    def receive(self, data: bytes) -> None:
        """Handle bytes of the host, in pieces of any size."""
        if self._now_s < self._ready_s or self._deaf or self._silenced:
            return
        for command in self._commands.feed(self._flow(data)):
            self._obey(command)

    @property
    def next_due_s(self) -> float:
        """Time of the next work of `reports`; inf while at rest."""
        due_s = min(self._line.next_due_s, self._next_fault_s)
        if not self._started:
            return min(due_s, self._ready_s)
        due_s = min(due_s, self._next_spontaneous_s())
        if self._moving:
            due_s = min(due_s, max(self._due_s, self._now_s))
        return due_s

    def reports(self, now_s: float) -> list[bytes]:
        """Return the bytes that arrive at the host from the last call until `now_s`, in pieces."""
        arrived: list[bytes] = []
        while (at_s := self._next_fault_s) <= now_s:
            _, name = self._plugging.pop(0)
            self._produce(at_s)
            arrived += self._line.arrived(at_s)
            if name == "unplug":
                self.unplug()
            elif name == "replug":
                self.replug()
            elif self.powered:
                self.power(True)
        self._produce(now_s)
        return arrived + self._line.arrived(now_s)

    def skip_to(self, now_s: float) -> None:
        """Skip the motion packets before `now_s`, which was not simulated."""
        while self._due_s + self._period_s <= now_s:
            self._due_s += self._period_s

    # -- what the models do --------------------------------------------------------------------

    @abstractmethod
    def _start(self) -> None:
        """Apply the settings of power-up."""

    def _greet(self, at_s: float) -> None:  # noqa: B027
        """Send the model's greeting after the start; most have none."""

    @abstractmethod
    def _obey(self, command: bytes) -> None:
        """Execute a command and answer it."""

    @abstractmethod
    def _motion(self, counts: Sequence[int], at_s: float) -> bytes:
        """Encode a motion packet."""

    @abstractmethod
    def _keys(self) -> bytes:
        """Encode the packets of the buttons."""

    @property
    def _reporting(self) -> bool:
        """False after a command that disables motion."""
        return True

    @property
    def _null_counts(self) -> int:
        return 0

    @property
    def _needs_host(self) -> bool:
        """False if it reports without any command."""
        return True

    def _next_spontaneous_s(self) -> float:
        """Time of the next packet that is neither motion nor an answer."""
        return math.inf

    def _spontaneous(self, at_s: float) -> None:  # noqa: B027
        """Send the spontaneous packet of `_next_spontaneous_s`."""

    def _flow(self, data: bytes) -> bytes:
        """Act upon characters of flow control, and return the other bytes."""
        return data

    # -- inside --------------------------------------------------------------------------------

    @property
    def _next_fault_s(self) -> float:
        return self._plugging[0][0] + self.faults_from_s if self._plugging else math.inf

    @property
    def _quiet(self) -> bool:
        return self._mute or self._silenced or not self._started

    @property
    def _moving(self) -> bool:
        return not self._quiet and self._reporting and (self._owes_zero or any(self._counts()))

    def _bit(self, label: str) -> int:
        try:
            return self._bits[label]
        except KeyError:
            raise ScriptError(
                f"{self.model.name} has no button {label!r}; it has: {', '.join(self._bits)}"
            ) from None

    def _raw(self) -> Sequence[int]:
        model = self.model
        translation = from_robot_axes(self.axes, model.full_scale * self._gain)
        rotation = from_robot_axes(self.axes, model.rotation_full_scale * self._gain)
        counts = from_hid_counts(model, (*translation[:3], *rotation[3:]))
        return [count + self._drift for count in counts]

    def _counts(self) -> Sequence[int]:
        """Return the deflections in the device's counts, without noise."""
        null = self._null_counts
        return [
            count if abs(count) > null else 0
            for count in (a - b for a, b in zip(self._raw(), self._zero, strict=True))
        ]

    def _take_zero(self) -> None:
        self._zero = self._raw()

    def _boot_zero(self) -> None:
        """Take the cap's position at a reset as rest; a drift only follows it."""
        self._zero = [count - self._drift for count in self._raw()]

    def _say(self, packet: bytes, at_s: float) -> None:
        if not self._quiet:
            self._line.carry(packet, at_s)

    def _answer(self, packet: bytes) -> None:
        self._say(packet, self._now_s + self._answer_s)

    def _keys_changed(self, bit: int) -> None:
        if not self._quiet:
            self._line.carry_keys(self._keys(), self._now_s)

    def _answer_keys(self) -> None:
        self.host_began = True
        if not self._quiet:
            self._line.carry_keys(self._keys(), self._now_s + self._answer_s)

    def _produce(self, until_s: float) -> None:
        """Produce the device's output until `until_s`."""
        until_s = max(until_s, self._now_s)
        if not self._started and self._ready_s <= until_s:
            self._started = True
            self._now_s = max(self._now_s, self._ready_s)
            self._due_s = self._now_s
            self._boot_zero()
            if self._deaf or self._mute or not self._needs_host:
                self.host_began = True
            self._greet(self._now_s)
        while self._started and (at_s := self._next_spontaneous_s()) <= until_s:
            self._spontaneous(at_s)
        while self._moving and self._due_s <= until_s:
            self._send_motion(max(self._due_s, self._now_s))
            self._due_s = max(self._due_s + self._period_s, self._line.free_s)
        if self._due_s <= until_s:
            # At rest the device continues to measure at its period.
            self._due_s += (
                math.floor((until_s - self._due_s) / self._period_s) + 1
            ) * self._period_s
        self._now_s = until_s

    def _send_motion(self, at_s: float) -> None:
        counts = self._counts()
        deflected = any(counts)
        if deflected and self._jitter_lsb:
            noise = self._jitter_lsb
            counts = [c and c + self._random.randint(-noise, noise) for c in counts]
        self._owes_zero = deflected
        if not self._commands.pending:  # A command without an end silences it.
            self._line.carry_motion(self._motion(counts, at_s), at_s, rest=not deflected)
        if deflected and at_s >= self._silent_after_s + self.faults_from_s:
            self._silenced = True


class SimulatedMagellan(SimulatedSerialPuck):
    """A Magellan, or a Spaceball 5000, which speaks the same."""

    def _start(self) -> None:
        self.mode = 3
        self.extended = 0
        self._null = 8
        self._sensitivity = b"00"
        self._periods = b"BB"
        self._set_period(2)
        self._zero = (0,) * 6
        self._owes_zero = False

    @property
    def _reporting(self) -> bool:
        return not self.mode & 8

    @property
    def _null_counts(self) -> int:
        return self._null

    @property
    def _has_twelve(self) -> bool:
        return self.model.key == "spaceball-5000"

    def _set_period(self, nibble: int) -> None:
        self._period_s = max(SHORTEST_PERIOD_S, 0.02 * (nibble + 1))

    def _obey(self, command: bytes) -> None:
        if not command or command.startswith(b"@"):  # It ignores a Spaceball's reset.
            return
        letter, argument = command[:1], command[1:]
        values = [ALPHABET.find(byte) for byte in argument]
        query = argument == b"Q"
        if letter == b"v" and query:
            text = SPACEBALL_5000_VERSION if self._has_twelve else MAGELLAN_VERSION
            self._answer(b"v" + text.encode() + b"\r")
        elif letter == b"d" and query:
            self._answer(self._motion(self._counts(), self._now_s))
        elif letter == b"k" and query:
            self._answer_keys()
        elif letter == b"z" and not argument:
            self._take_zero()
            self._answer(b"z\r")
        elif letter == b"b" and len(values) <= 1:
            self.beeps += 1
            self._answer(b"b\r")
        elif letter in (b"f", b"l"):
            self._answer(letter + b"\r")
        elif query and letter in b"mcnqp":
            self._answer(letter + self._setting(letter) + b"\r")
        elif -1 not in values and self._set(letter, argument, values):
            self._answer(command + b"\r")
        else:
            self.refused_commands += 1
            self._answer(b"eA" + command[:1] + b"\r")

    def _setting(self, letter: bytes) -> bytes:
        return {
            b"m": ALPHABET[self.mode : self.mode + 1],
            b"c": bytes((ALPHABET[self.mode & 7], ALPHABET[self.extended])),
            b"n": ALPHABET[self._null : self._null + 1],
            b"q": self._sensitivity,
            b"p": self._periods,
        }[letter]

    def _set(self, letter: bytes, argument: bytes, values: Sequence[int]) -> bool:
        if letter == b"m" and len(values) == 1:
            self.mode = values[0]
            self.host_began = True
        elif letter == b"c" and len(values) == 2:
            self.mode = self.mode & 8 | values[0] & 7
            self.extended = values[1]
        elif letter == b"n" and len(values) == 1:
            self._null = values[0]
        elif letter == b"q" and len(values) == 2:
            self._sensitivity = argument
        elif letter == b"p" and len(values) == 2:
            self._periods = argument
            self._set_period(values[0])
        else:
            return False
        return True

    def _counts(self) -> Sequence[int]:
        counts = list(super()._counts())
        if not self.mode & 2:
            counts[:3] = (0, 0, 0)
        if not self.mode & 1:
            counts[3:] = (0, 0, 0)
        if self.mode & 4:
            sizes = [abs(count) for count in counts]
            leader = sizes.index(max(sizes))
            counts = [count if i == leader else 0 for i, count in enumerate(counts)]
        return counts

    def _motion(self, counts: Sequence[int], at_s: float) -> bytes:
        compressed = bool(self.extended & 1)
        if compressed:
            counts = [min(COMPRESSED_MAX, max(COMPRESSED_MIN, count)) for count in counts]
        return encode_magellan_motion(counts, compressed=compressed)

    def _keys(self) -> bytes:
        mask = sum(1 << bit for bit in self._down)
        return encode_magellan_keys(mask, extended=self._has_twelve or bool(self.extended & 2))

    def _keys_changed(self, bit: int) -> None:
        super()._keys_changed(bit)
        pair = {"star", "8"}  # Back to the defaults.
        if self.model.buttons[bit] in pair <= set(self.held) and not self._quiet:
            self._null, self._sensitivity = 8, b"00"
            self._line.carry(b"nH\r", self._now_s)
            self._line.carry(b"q00\r", self._now_s)


class SimulatedSpaceball(SimulatedSerialPuck):
    """A Spaceball 2003, 3003 or 4000 FLX."""

    def _start(self) -> None:
        self.sends_ball = False
        """True after an `M` command that enabled motion."""
        self._paused = False
        self._period_s = self.model.period_s
        self._zero = (0,) * 6
        self._owes_zero = False
        self._last_s = -math.inf

    def _greet(self, at_s: float) -> None:
        self._say(b"\x11\r" + self._banner("poweron"), at_s)

    def _banner(self, cause: str) -> bytes:
        firmware = SPACEBALL_FIRMWARE[self.model.key]
        return (
            f"@1 Spaceball alive and well after a {cause} reset.\r@2 Firmware version {firmware}.\r"
        ).encode()

    @property
    def _reporting(self) -> bool:
        return self.sends_ball and not self._paused

    @property
    def _null_counts(self) -> int:
        return self.model.rotation_full_scale // 200

    def _flow(self, data: bytes) -> bytes:
        flow = [byte for byte in data if byte in (XON, XOFF)]
        if flow:
            self._paused = flow[-1] == XOFF
            data = bytes(byte for byte in data if byte not in (XON, XOFF))
        return data

    def _obey(self, command: bytes) -> None:
        letter = command[:1]
        if not command:
            return
        if letter == b"@":
            self._start()
            self._boot_zero()
            self._answer(b"\r" + self._banner("software"))
        elif letter == b"M":
            self.sends_ball = True
            self.host_began = True
            self._answer(command + b"\r")
        elif letter == b"P" and len(command) == 5:
            period_s = ((command[1] & 0x3F) << 6 | command[2] & 0x3F) * 1e-3
            self._period_s = max(SPACEBALL_SHORTEST_PERIOD_S, period_s)
            self._answer(command + b"\r")
        elif letter == b"C" and command[1:2] == b"B":
            # Hosts expect a third character, which no source describes.
            self._answer(b"CB@\r")
        elif letter in (b"N", b"F", b"Y"):
            self._answer(command + b"\r")
        elif letter == b"Z":
            self._take_zero()
            self._answer(escape(b"Z" + bytes(12)) + b"\r")
        elif letter == b"B":
            self.beeps += 1
        elif command == b"k":
            self._answer_keys()
        elif command in (b"hm", b"hv", b'"'):
            self._identify(command)
        else:
            self.refused_commands += 1
            self._answer(b"?" + command + b"\r")

    def _identify(self, command: bytes) -> None:
        key = self.model.key
        if command == b'"' and key == "spaceball-4000":
            self._answer(b'"1 Spaceball 4000 FLX\r')
            self._answer(b'"2 B:12 R \r')
            self._answer(b'"3 \r')
        elif command == b"hm" and key != "spaceball-4000":
            self._answer(b"Hm%sC\r" % key[-4:].encode())
        elif command != b'"':
            self._answer(f"HvFirmware version {SPACEBALL_FIRMWARE[key]}.\r".encode())
        else:
            self.refused_commands += 1
            self._answer(b'?"\r')

    def _motion(self, counts: Sequence[int], at_s: float) -> bytes:
        since_s = at_s - self._last_s
        self._last_s = at_s
        share = self._period_s / self.model.period_s
        x, y, z, a, b, c = (
            min(0x7FFF, max(-0x8000, round(count * share))) for count in counts
        )  # Displacement, thus larger in a longer period.
        period = round(min(since_s / PERIOD_UNIT_S, LONGEST_PERIOD))
        return encode_spaceball_motion(SpaceballMotion(period, x, y, z, a, b, c))

    def _keys(self) -> bytes:
        mask = sum(1 << bit for bit in self._down)
        keys = keys_of_mask(self.model, mask)
        if isinstance(keys, Keys):
            return encode_spaceball_keys(keys)
        # A 4000 FLX reports the first nine keys in the old format too.
        old = Keys(mask >> 4 & 0x1F, mask & 0x0F)
        return encode_spaceball_keys(keys) + encode_spaceball_keys(old)


class SimulatedSpaceOrb(SimulatedSerialPuck):
    """A SpaceOrb 360. It sends a packet each second, by which a host can detect it."""

    def _start(self) -> None:
        self._period_s = self.model.period_s
        self._zero = (0,) * 6
        self._owes_zero = False
        self._null = 8
        self._keys_s = math.inf

    def _greet(self, at_s: float) -> None:
        self._say(b"\r" + encode_orb_reset(ORB_VERSION), at_s)
        self._keys_s = at_s

    @property
    def _needs_host(self) -> bool:
        return False

    @property
    def _reporting(self) -> bool:
        return self._period_s < math.inf

    @property
    def _null_counts(self) -> int:
        return self._null

    @property
    def _status(self) -> int:
        return sum(1 << bit for bit in self._down)

    def _obey(self, command: bytes) -> None:
        letter = command[:1]
        if not command:
            return
        if command == b"?":
            self._answer(encode_orb_text("!", b"1" + ORB_VERSION.encode()))
            self._answer(encode_orb_text("!", b"2 11.52N 0.2557Nm 10bit") + b"\r")
        elif letter == b"P" and len(command) == 3:
            period_ms = (command[1] & 0x0F) << 7 | command[2] & 0x7F
            self._period_s = period_ms * 1e-3 if period_ms else math.inf
            self._due_s = self._now_s
        elif letter == b"N" and len(command) == 2:
            self._null = command[1] & 0x7F
            self._answer(encode_orb_text("N", bytes((self._null,))))
        elif command == b"n":
            self._answer(encode_orb_text("N", bytes((self._null,))))
        elif command == b"d":
            if not self._reporting or not any(self._counts()):
                self._answer(self._motion(self._counts(), self._now_s))
        else:
            self.refused_commands += 1

    def _motion(self, counts: Sequence[int], at_s: float) -> bytes:
        return encode_orb_motion(
            self._status, [min(COUNT_MAX, max(COUNT_MIN, count)) for count in counts]
        )

    def _keys(self) -> bytes:
        period = round((self._now_s - self._keys_s + HEARTBEAT_S) * 100.0) & 0x7F
        self._keys_s = self._now_s + HEARTBEAT_S
        # A carriage return ends a packet without a successor.
        return encode_orb_keys(period, self._status) + b"\r"

    def _keys_changed(self, bit: int) -> None:
        super()._keys_changed(bit)
        if self.model.buttons[bit] == "rezero" and bit in self._down and not self._quiet:
            self._take_zero()

    def _next_spontaneous_s(self) -> float:
        return math.inf if self._quiet else self._keys_s

    def _spontaneous(self, at_s: float) -> None:
        self._now_s = max(self._now_s, at_s)
        self._line.carry_keys(self._keys(), at_s)


_KINDS: Mapping[str, type[SimulatedSerialPuck]] = {
    "magellan": SimulatedMagellan,
    "spaceball": SimulatedSpaceball,
    "spaceorb": SimulatedSpaceOrb,
}


def simulated_serial_puck(
    model: SerialModel,
    *,
    faults: Mapping[str, float] | None = None,
    jitter_lsb: int = 0,
    seed: int = 0,
    boot_s: float | None = None,
) -> SimulatedSerialPuck:
    """Return a simulated device of `model`; see :class:`SimulatedSerialPuck`."""
    kind = _KINDS[model.protocol]
    return kind(model, faults=faults, jitter_lsb=jitter_lsb, seed=seed, boot_s=boot_s)
