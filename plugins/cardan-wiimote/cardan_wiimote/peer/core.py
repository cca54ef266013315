"""A simulated Wii Remote, without any I/O and in virtual time.

Source: WiiBrew, Dolphin's emulated remote, and the observed behavior of real drivers.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Literal, NamedTuple

from cardan.common.bounds import Range
from cardan.common.options import check_value
from cardan.errors import ScriptError
from cardan.sim_peers.base import strikes
from cardan_wiimote.peer import bus
from cardan_wiimote.peer.faults import FaultyLink, check_faults
from cardan_wiimote.protocol import (
    BATTERY_LOW,
    BUTTONS,
    DATA_LAYOUTS,
    DATA_MODE_ID,
    EEPROM,
    EEPROM_BYTES,
    FIRST_HALF_ID,
    HANDSHAKE_OK,
    IR_ENABLE_1_ID,
    IR_ENABLE_2_ID,
    LEDS_ID,
    OUTPUT_HEADER,
    READ_MEMORY_ID,
    READ_PIECE_BYTES,
    SECOND_HALF_ID,
    SET_REPORT_HEADER,
    SPEAKER_ENABLE_ID,
    WIIMOTE,
    WIIMOTE_TR,
    WRITE_MEMORY_ID,
    Ack,
    Data,
    DataMode,
    ErrorCode,
    IrDot,
    IrFormat,
    Leds,
    MalformedReport,
    NunchukData,
    ReadData,
    ReadMemory,
    Status,
    StatusRequest,
    Switch,
    WriteMemory,
    button_labels,
    button_mask,
    decode_output,
    encode_ack,
    encode_data,
    encode_dots,
    encode_interleaved,
    encode_read_data,
    encode_status,
    from_g,
    from_operator_axes,
    rumble_of,
)

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)

ExtensionName = Literal["", "nunchuk"]
"""Plugged extension; empty: none."""
NoiseLsb = Annotated[int, Range(0, 50, "counts", "the gyroscopes have four times as much noise")]
TICK_S = 0.010
"""Period of the data reports and of the pieces of a read."""
TICK_JITTER_S = 0.001
"""Largest deviation of a report from its time."""
LINK_TIMEOUT_S = 2.0
"""Silence after which either end of a radio link drops it."""
BATTERY = 0xC0
BATTERY_EMPTY = 0x1A
LOG_ENTRIES = 4096
_REFUSED_HANDSHAKE = b"\x02"
_DEFAULT_MODE = 0x30
_STOLEN_MODE = bytes((DATA_MODE_ID, 0x00, _DEFAULT_MODE))
"""Report that Linux's hid-wiimote sends after every status report."""


class LogEntry(NamedTuple):
    """An action of the remote on the host's request, or an event."""

    time_s: float
    what: str


class _Read(NamedTuple):
    """Active read of memory."""

    space: int
    address: int
    size: int
    due_s: float


class SimulatedWiimote:
    """Reports of a remote for given attitude, buttons and reports of the host.

    Time is in seconds from when it was switched on and never goes back. `extension` is "nunchuk"
    or "". `tr`: the late model with the MotionPlus inside, which obeys on the interrupt channel
    only. `faults` are values by the names of `FAULTS`; `noise_lsb` is the noise of the
    accelerometers and, four times as much, of the gyroscopes, in counts.
    """

    def __init__(
        self,
        *,
        extension: ExtensionName = "",
        motion_plus: bool = False,
        tr: bool = False,
        faults: Mapping[str, float] | None = None,
        noise_lsb: int = 0,
        seed: int = 0,
    ) -> None:
        faults = faults or {}
        check_faults(faults, tr=tr)
        check_value("extension", extension, ExtensionName)
        check_value("noise_lsb", noise_lsb, NoiseLsb)
        self.model = WIIMOTE_TR if tr else WIIMOTE
        blank = bool(faults.get("no-calibration"))
        self.eeprom = bus.make_eeprom(
            bad_checksum=bool(faults.get("bad-checksum")), no_calibration=blank
        )
        self.port = bus.ExtensionPort(
            nunchuk=extension == "nunchuk", motion_plus=motion_plus, built_in=tr, blank=blank,
            noise_lsb=4 * noise_lsb, seed=seed,
        )  # fmt: skip
        self.camera = bus.Camera()
        self._speaker = bus.Registers()
        self._faults = faults
        self._random = random.Random(seed)
        self._noise_lsb = noise_lsb
        self._link = FaultyLink(faults, seed)

        self.powered = True
        self.in_range = True
        self.connected = False
        """True if a host has both channels open, as far as the remote knows."""
        self.control_open = False
        self.interrupt_open = False
        self.battery = BATTERY
        self.rumble = False
        self.leds = 0
        """Bit 0 is LED 1."""
        self.mode: int | None = _DEFAULT_MODE
        """Id of the data report; None: no data until the host sets one."""
        self.continuous = False
        self.ir_enabled = [False, False]
        self.speaker = False
        self.ignored_outputs = 0
        """Output reports that are invalid for the remote."""
        self.outputs = 0
        self.log: deque[LogEntry] = deque(maxlen=LOG_ENTRIES)
        """The newest entries."""
        self.logged = 0
        """Number of entries since the start, dropped ones included."""

        self._buttons = 0
        self._angles: Vector = ZERO
        self._angle_rates: Vector = ZERO
        self._acceleration_g: Vector = ZERO
        self._stick = (0.0, 0.0)
        self._c = self._z = False
        self._now_s = 0.0
        self._connected_s = 0.0
        self._tick = 0
        self._tick_due_s = math.inf
        self._given_up_s = math.inf
        self._silent = False
        self._read: _Read | None = None
        self._reported_extension = self.port.connected
        self._last_data = b""
        self._send_first = False
        self._half: tuple[tuple[int, int, int], bytes] | None = None
        self._late: list[tuple[float, bytes]] = []
        self._acks = self._reads = 0
        self._happenings = self._plan(faults)
        self._measure()

    # -- the motion ----------------------------------------------------------------------------

    def set_attitude(
        self, roll_rad: float, pitch_rad: float, yaw_rad: float = 0.0, rates_rad_s: Vector = ZERO
    ) -> None:
        """Set the attitude: roll right side down, pitch nose up, yaw to the left; all 0: flat.

        Turned by yaw first, then pitch, then roll. `rates_rad_s` are the angles' derivatives.
        """
        values = (roll_rad, pitch_rad, yaw_rad, *rates_rad_s)
        if not all(map(math.isfinite, values)):
            raise ValueError(f"attitude must be finite, not {values}")
        self._angles = (roll_rad, pitch_rad, yaw_rad)
        self._angle_rates = rates_rad_s
        self._measure()

    def set_acceleration(self, acceleration_g: Vector) -> None:
        """Set the acceleration besides gravity, along the remote's own forward, left and up, g."""
        if not all(map(math.isfinite, acceleration_g)):
            raise ValueError(f"acceleration must be finite, not {acceleration_g}")
        self._acceleration_g = acceleration_g
        self._measure()

    def set_stick(self, x: float, y: float) -> None:
        """Set the Nunchuk's stick, -1..1: x to the right, y forward."""
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError(f"stick must be finite, not {(x, y)}")
        self._stick = (min(1.0, max(-1.0, x)), min(1.0, max(-1.0, y)))
        self._measure()

    def set_dots(self, dots: Sequence[IrDot]) -> None:
        """Set the dots that the camera sees, at most four."""
        self.camera.dots = tuple(dots[:4])

    def press(self, label: str) -> None:
        """Press a button of the remote, or c or z of a Nunchuk. Raises ScriptError for other
        labels."""
        self._push(label, True)

    def release(self, label: str) -> None:
        """Release a button."""
        self._push(label, False)

    @property
    def held(self) -> tuple[str, ...]:
        """Labels of the buttons that are down."""
        extra = ("c",) * self._c + ("z",) * self._z
        return button_labels(self._buttons) + extra

    @property
    def attitude_rad(self) -> Vector:
        """Roll, pitch and yaw."""
        return self._angles

    def plug(self, now_s: float) -> None:
        """Plug a Nunchuk in."""
        self._produce(now_s)
        self.port.plug()
        self._measure()

    def unplug(self, now_s: float) -> None:
        """Pull the Nunchuk out."""
        self._produce(now_s)
        self.port.unplug()

    def power_off(self, now_s: float) -> None:
        """Hold the power button: both channels close, the extension loses power."""
        self._produce(now_s)
        self._power_off()

    def power_on(self, now_s: float) -> None:
        """Press a button of a remote that is off."""
        self._produce(now_s)
        self.powered = True

    def leave(self, now_s: float) -> None:
        """Leave the radio range: silence, and after `LINK_TIMEOUT_S` no link."""
        self._produce(now_s)
        self._leave()

    def come_back(self, now_s: float) -> None:
        """Return into range: a link that was not dropped continues."""
        self._produce(now_s)
        self._come_back()

    def silence(self, now_s: float) -> None:
        """Neither send nor receive, with the link up, until `resume`."""
        self._produce(now_s)
        self._silent = True

    def resume(self, now_s: float) -> None:
        """End the silence."""
        self._produce(now_s)
        self._silent = False

    # -- the host ------------------------------------------------------------------------------

    @property
    def plugged(self) -> bool:
        """True if a host can find it: switched on, and in range."""
        return self.powered and self.in_range

    @property
    def reachable(self) -> bool:
        """True if a host can connect now."""
        return self.plugged and not self.connected

    def connect(self, now_s: float) -> bool:
        """Connect a host, which has opened both channels; return False if the remote does not
        answer."""
        self._produce(now_s)
        if not self.reachable:
            return False
        self.connected = self.control_open = self.interrupt_open = True
        self.rumble, self.leds, self.speaker = False, 0, False
        self.mode, self.continuous = _DEFAULT_MODE, False
        self.ir_enabled = [False, False]
        self._read, self._late, self._last_data, self._half = None, [], b"", None
        self._send_first = False
        self._silent = False
        self._reported_extension = self.port.connected
        self._connected_s = now_s
        self._tick = 0
        self._plan_tick()
        self._note("connected")
        return True

    def disconnect(self, now_s: float) -> None:
        """Handle a channel closed by the host, which ends both."""
        self._produce(now_s)
        self._end("the host closed the link")

    def interrupt(self, packet: bytes, now_s: float) -> None:
        """Handle a packet of the interrupt channel, header first."""
        if packet[:1] == bytes((OUTPUT_HEADER,)):
            self.output(packet[1:], now_s)
        else:
            self.ignored_outputs += 1

    def control(self, packet: bytes, now_s: float) -> bytes:
        """Handle a packet of the control channel, header first; return the reply there, if any."""
        self._produce(now_s)
        if not self._can_receive:
            return b""
        if packet[:1] != bytes((SET_REPORT_HEADER,)):
            self.ignored_outputs += 1
            return b""
        if not self.model.set_report:
            return _REFUSED_HANDSHAKE
        self.output(packet[1:], now_s)
        return bytes((HANDSHAKE_OK,))

    def output(self, report: bytes, now_s: float) -> None:
        """Handle an output report, id first."""
        self._produce(now_s)
        if not self._can_receive:
            return
        self.outputs += 1
        if self._faults.get("woken-by-1-2"):
            self._end("the remote was woken with 1 and 2 and drops the link at the first report")
            return
        rumble = rumble_of(report)
        if rumble is not None and rumble != self.rumble:
            self.rumble = rumble
            self._note(f"rumble {'on' if rumble else 'off'}")
        value = decode_output(report)
        if isinstance(value, MalformedReport):
            self.ignored_outputs += 1
        elif isinstance(value, Leds):
            if value.leds != self.leds:
                self.leds = value.leds
                self._note(
                    "LEDs " + "".join("1234"[i] if value.leds >> i & 1 else "-" for i in range(4))
                )
            self._ack_if(value.ack, LEDS_ID)
        elif isinstance(value, DataMode):
            self.mode, self.continuous = value.mode, value.continuous
            self._half = None
            self._note(f"mode {value.mode:#04x}{' continuous' if value.continuous else ''}")
            self._ack_if(value.ack, DATA_MODE_ID)
            self._send_first = True
            if self._read is None:
                self._send_data()
        elif isinstance(value, Switch):
            self._switch(value)
        elif isinstance(value, StatusRequest):
            self._send_status()
        elif isinstance(value, WriteMemory):
            self._write(value)
        elif isinstance(value, ReadMemory):
            self._begin_read(value)

    @property
    def next_due_s(self) -> float:
        """Time at which `reports` has work next."""
        return min(self._next_happening_s, self._link.next_due_s)

    def reports(self, now_s: float) -> list[bytes]:
        """Return the input reports that reach the host from the last call until `now_s`, id
        first."""
        self._produce(now_s)
        return self._link.arrived(now_s)

    def skip_to(self, now_s: float) -> None:
        """Skip the data before `now_s`, which was not simulated."""
        if self._tick_due_s < now_s:
            self._tick = math.ceil((now_s - self._connected_s) / TICK_S)
            self._plan_tick()

    # -- time ----------------------------------------------------------------------------------

    def _plan(self, faults: Mapping[str, float]) -> list[tuple[float, Callable[[], None]]]:
        """Return the timed actions of faults, in order: time, action."""
        acts: dict[str, Callable[[], None]] = {
            "silence": self._fall_silent,
            "out-of-range": self._leave,
            "in-range": self._come_back,
            "power-off": self._power_off,
            "power-on": self._power_on,
            "close-control": self._close_control,
            "close-interrupt": self._close_interrupt,
            "battery-low": self._run_low,
        }
        planned = [(faults[name], act) for name, act in acts.items() if name in faults]
        if "stolen-mode" in faults:
            planned.append((faults["stolen-mode"], self._steal_mode))
        return sorted(planned, key=lambda item: item[0])

    @property
    def _next_happening_s(self) -> float:
        planned_s = self._happenings[0][0] if self._happenings else math.inf
        late_s = self._late[0][0] if self._late else math.inf
        return min(planned_s, late_s, self._tick_due_s, self._given_up_s, self.port.next_due_s)

    def _produce(self, until_s: float) -> None:
        while (due_s := self._next_happening_s) <= until_s:
            self._now_s = max(self._now_s, due_s)
            if self.port.next_due_s <= due_s:
                self.port.advance(due_s)
                self._measure()
                self._check_extension()
            elif self._happenings and self._happenings[0][0] <= due_s:
                self._happenings.pop(0)[1]()
            elif self._given_up_s <= due_s:
                self._end("out of range for too long")
            elif self._late and self._late[0][0] <= due_s:
                self._carry(self._late.pop(0)[1])
            else:
                self._tick += 1
                self._plan_tick()
                self._on_tick()
        self._now_s = max(self._now_s, until_s)

    def _plan_tick(self) -> None:
        if not self.interrupt_open:
            self._tick_due_s = math.inf
            return
        jitter_s = self._random.uniform(-TICK_JITTER_S, TICK_JITTER_S) if self._tick else 0.0
        self._tick_due_s = self._connected_s + self._tick * TICK_S + jitter_s

    def _on_tick(self) -> None:
        if not self._can_send:
            return
        self._check_extension()
        if self._read is not None:
            if self._read.due_s <= self._now_s:
                self._send_piece()
        else:
            self._send_data()

    # -- what is sent --------------------------------------------------------------------------

    @property
    def _can_send(self) -> bool:
        return self.interrupt_open and self.in_range and not self._silent

    @property
    def _can_receive(self) -> bool:
        return self.connected and self.in_range and not self._silent

    def _carry(self, report: bytes) -> None:
        if self._can_send:
            self._link.carry(report, self._now_s)

    def _send_status(self) -> None:
        self._reported_extension = self.port.connected
        status = Status(
            self._buttons, self.battery < BATTERY_LOW, self.port.connected, self.speaker,
            self.ir_enabled[0], self.leds, self.battery,
        )  # fmt: skip
        self._carry(encode_status(status))
        if self._faults.get("stale-mode"):
            self.mode = None

    def _check_extension(self) -> None:
        """Report a change at the port, which ends the data until a mode is set."""
        if self._can_send and self.port.connected != self._reported_extension:
            self._send_status()
            self.mode = None

    def _ack_if(self, wanted: bool, report_id: int) -> None:
        if wanted:
            self._ack(report_id, ErrorCode.SUCCESS)

    def _ack(self, report_id: int, error: int) -> None:
        self._acks += 1
        if self._strikes("lost-ack", self._acks):
            return
        report = encode_ack(Ack(self._buttons, report_id, error))
        late_s = self._faults.get("slow-memory", 0.0) * (report_id == WRITE_MEMORY_ID)
        if late_s:
            self._late.append((self._now_s + late_s, report))
        else:
            self._carry(report)

    def _send_data(self) -> None:
        if self.mode is None:
            return
        if self.mode in (FIRST_HALF_ID, SECOND_HALF_ID):
            report = self._half_report()
        else:
            report = self._data_report(self.mode)
        # The MotionPlus alternates and the halves alternate: both always differ.
        if self.continuous or self._send_first or report != self._last_data:
            self._send_first = False
            self._last_data = report
            if self._can_send:
                self._link.carry_data(report, self._now_s)

    def _data_report(self, mode: int) -> bytes:
        layout = DATA_LAYOUTS[mode]
        ir = b""
        if layout.ir_format is not None:
            ir = self._dots(layout.ir_format)
        extension = b""
        if layout.extension_bytes:
            extension = self.port.data(layout.extension_bytes)
        return encode_data(
            Data(
                mode,
                self._buttons if layout.buttons else None,
                self._counts() if layout.accelerometer else None,
                ir,
                extension,
            )
        )

    def _half_report(self) -> bytes:
        """Return a 0x3E, or the 0x3F after it with the rest of the same measurement."""
        if self._half is None:
            dots = self._dots(IrFormat.FULL)
            counts = self._counts()
            self._half = (counts, dots)
            return encode_interleaved(FIRST_HALF_ID, self._buttons, counts, dots[:18])
        counts, dots = self._half
        self._half = None
        return encode_interleaved(SECOND_HALF_ID, self._buttons, counts, dots[18:])

    def _dots(self, ir_format: IrFormat) -> bytes:
        if all(self.ir_enabled):
            return self.camera.data(ir_format)
        return encode_dots((), ir_format)

    # -- memory --------------------------------------------------------------------------------

    def _registers(self, address: int) -> bus.Registers | int:
        """Return the registers at an address, or the error of accessing it."""
        chip = address >> 17
        if chip == bus.EEPROM_CHIP:
            return ErrorCode.INVALID_ADDRESS
        device: bus.Registers | None = None
        if chip == bus.SPEAKER:
            device = self._speaker
        elif chip in (bus.PORT, bus.MOTION_PLUS):
            device = self.port.device(chip)
        elif chip == bus.CAMERA and self.ir_enabled[0]:
            device = self.camera
        return ErrorCode.NO_DEVICE if device is None else device

    def _write(self, value: WriteMemory) -> None:
        self._ack(WRITE_MEMORY_ID, self._try_write(value))

    def _try_write(self, value: WriteMemory) -> int:
        if self._read is not None:
            return ErrorCode.BUSY
        if value.space == EEPROM:
            if value.address + len(value.data) > EEPROM_BYTES:
                return ErrorCode.INVALID_ADDRESS
            self.eeprom[value.address : value.address + len(value.data)] = value.data
            return ErrorCode.SUCCESS
        if value.space == 3:
            return ErrorCode.INVALID_SPACE
        device = self._registers(value.address)
        if isinstance(device, int):
            return device
        device.write(value.address & 0xFF, value.data, self._now_s)
        return ErrorCode.SUCCESS

    def _begin_read(self, value: ReadMemory) -> None:
        if self._read is not None:
            self._ack(READ_MEMORY_ID, ErrorCode.BUSY)
            return
        self._reads += 1
        if self._strikes("busy", self._reads):
            self._ack(READ_MEMORY_ID, ErrorCode.BUSY)
            return
        error: int = ErrorCode.SUCCESS
        if value.space == EEPROM:
            if value.address + value.size > EEPROM_BYTES:
                error = ErrorCode.INVALID_ADDRESS
        elif value.space == 3:
            error = ErrorCode.INVALID_SPACE
        else:
            device = self._registers(value.address)
            error = device if isinstance(device, int) else ErrorCode.SUCCESS
        if error:
            self._carry(
                encode_read_data(ReadData(self._buttons, error, value.address & 0xFFFF, b""))
            )
            return
        late_s = self._faults.get("slow-memory", 0.0)
        self._read = _Read(value.space, value.address, value.size, self._now_s + late_s)
        if not late_s:
            self._send_piece()
        if self._read is not None and self._now_s >= self._faults.get("hot-plug", math.inf):
            self._faults = {name: v for name, v in self._faults.items() if name != "hot-plug"}
            if self.port.nunchuk is None:
                self.port.plug()
            else:
                self.port.unplug()

    def _send_piece(self) -> None:
        read = self._read
        assert read is not None
        size = min(READ_PIECE_BYTES, read.size)
        address = read.address & 0xFFFF
        data, error = b"", int(ErrorCode.SUCCESS)
        if read.space == EEPROM:
            data = bytes(self.eeprom[read.address : read.address + size])
        else:
            device = self._registers(read.address)
            if isinstance(device, int):
                error = device  # Unplugged meanwhile.
            else:
                data = device.read(address & 0xFF, size)
        self._carry(encode_read_data(ReadData(self._buttons, error, address, data)))
        left = read.size - size
        if error or not left:
            self._read = None
        else:
            # Only the low 16 bits count up: the bus address stays.
            next_address = read.address & 0xFF0000 | (address + size) & 0xFFFF
            self._read = read._replace(address=next_address, size=left)

    def _switch(self, value: Switch) -> None:
        if value.report_id == SPEAKER_ENABLE_ID:
            self.speaker = value.on
        elif value.report_id in (IR_ENABLE_1_ID, IR_ENABLE_2_ID):
            self.ir_enabled[value.report_id == IR_ENABLE_2_ID] = value.on
            if not value.on:
                self.camera.power_down()
        self._ack_if(value.ack, value.report_id)

    # -- what is measured ----------------------------------------------------------------------

    def _measure(self) -> None:
        """Compute gravity, acceleration and angular rates in the sensors' axes."""
        roll, pitch, _ = self._angles
        roll_rate, pitch_rate, yaw_rate = self._angle_rates
        # The remote's forward, left and up; pitching up rotates it backwards about its left.
        forward, left, up = self._acceleration_g
        level = math.cos(pitch)
        force = (
            math.sin(pitch) + forward,
            level * math.sin(roll) + left,
            level * math.cos(roll) + up,
        )
        rates = (
            roll_rate + yaw_rate * math.sin(pitch),
            -pitch_rate * math.cos(roll) + yaw_rate * level * math.sin(roll),
            pitch_rate * math.sin(roll) + yaw_rate * level * math.cos(roll),
        )
        self._force_g = from_operator_axes(force)
        if self.port.motion_plus is not None:
            self.port.motion_plus.rates_rad_s = from_operator_axes(rates)
        nunchuk = self.port.nunchuk
        if nunchuk is not None:
            calibration = bus.NUNCHUK
            nunchuk.set(
                NunchukData(
                    _stick_reading(self._stick[0], calibration.stick_x),
                    _stick_reading(self._stick[1], calibration.stick_y),
                    # It hangs level at the end of its cable, independent of the remote.
                    from_g((0.0, 0.0, 1.0), calibration.zero, calibration.one_g),
                    self._c,
                    self._z,
                )
            )

    def _counts(self) -> tuple[int, int, int]:
        calibration = bus.ACCELEROMETER
        x, y, z = from_g(self._force_g, calibration.zero, calibration.one_g)
        return self._noisy(x), self._noisy(y), self._noisy(z)

    def _noisy(self, count: int) -> int:
        if not self._noise_lsb:
            return count
        noise = self._random.randint(-self._noise_lsb, self._noise_lsb)
        return min(1023, max(0, count + noise))

    def _push(self, label: str, down: bool) -> None:
        if label in ("c", "z"):
            if self.port.nunchuk is None:
                raise ScriptError(f"button {label!r}: there is no Nunchuk")
            if label == "c":
                self._c = down
            else:
                self._z = down
            self._measure()
            return
        try:
            bit = button_mask([label])
        except ValueError:
            raise ScriptError(
                f"there is no button {label!r}; there are: {', '.join(BUTTONS.values())}, "
                f"and of a Nunchuk c, z"
            ) from None
        self._buttons = self._buttons | bit if down else self._buttons & ~bit

    # -- what happens --------------------------------------------------------------------------

    def _strikes(self, fault: str, count: int) -> bool:
        return strikes(self._faults, fault, count)

    def _note(self, what: str) -> None:
        self.log.append(LogEntry(self._now_s, what))
        self.logged += 1

    def _end(self, why: str) -> None:
        """Close both channels; the motor stops."""
        self._given_up_s = math.inf
        if not self.connected:
            return
        self.connected = self.control_open = self.interrupt_open = False
        self.rumble, self.leds, self.mode = False, 0, _DEFAULT_MODE
        self._read, self._late = None, []
        self._tick_due_s = math.inf
        self._link.cut()
        self._note(f"link ended: {why}")

    def _power_off(self) -> None:
        self._end("the remote was switched off")
        self.powered = False
        self.port.power_down()
        self.camera.power_down()

    def _power_on(self) -> None:
        self.powered = True

    def _leave(self) -> None:
        self.in_range = False
        self._link.cut()
        if self.connected:
            self._given_up_s = self._now_s + LINK_TIMEOUT_S

    def _come_back(self) -> None:
        self.in_range = True
        self._given_up_s = math.inf

    def _fall_silent(self) -> None:
        self._silent = True
        self._link.cut()

    def _close_control(self) -> None:
        if self.connected:
            self.control_open = False
            self._note("control channel closed")

    def _close_interrupt(self) -> None:
        if self.connected:
            self.interrupt_open = False
            self._tick_due_s = math.inf
            self._link.cut()
            self._note("interrupt channel closed")

    def _run_low(self) -> None:
        self.battery = BATTERY_EMPTY

    def _steal_mode(self) -> None:
        self._happenings.append((self._now_s + self._faults["stolen-mode"], self._steal_mode))
        self._happenings.sort(key=lambda item: item[0])
        self.output(_STOLEN_MODE, self._now_s)


def _stick_reading(value: float, calibration: tuple[int, int, int]) -> int:
    low, center, high = calibration
    return round(center + value * (high - center if value > 0.0 else center - low))
