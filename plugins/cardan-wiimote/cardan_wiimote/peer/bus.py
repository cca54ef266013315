"""The remote's memory: EEPROM, and the registers of everything on its bus.

Source: WiiBrew, Dolphin, and dumps of real remotes.
"""

from __future__ import annotations

import math
import random

from cardan_wiimote.protocol import (
    ACCELEROMETER_CALIBRATION_ADDRESSES,
    CALIBRATION_OFFSET,
    CAMERA_CALIBRATION_ADDRESSES,
    EEPROM_BYTES,
    EXTENSION_IDS,
    ID_BYTES,
    ID_OFFSET,
    PASS_CLASSIC,
    PASS_NONE,
    PASS_NUNCHUK,
    RAW_MAX,
    AccelerometerCalibration,
    Extension,
    IrDot,
    IrFormat,
    MotionPlusCalibration,
    MotionPlusRange,
    NunchukCalibration,
    NunchukData,
    encode_accelerometer_calibration,
    encode_dots,
    encode_motion_plus,
    encode_motion_plus_calibration,
    encode_nunchuk,
    encode_nunchuk_calibration,
    encode_nunchuk_pass_through,
    from_rad_s,
)
from cardan_wiimote.protocol.accelerometer import checksum

SPEAKER, PORT, MOTION_PLUS, CAMERA = 0x51, 0x52, 0x53, 0x58
"""Addresses on the bus, 7 bits."""
EEPROM_CHIP = 0x50

ACCELEROMETER = AccelerometerCalibration((531, 520, 536), (636, 628, 638))
"""Calibration of a real remote."""
NUNCHUK = NunchukCalibration((510, 514, 518), (714, 716, 720), (35, 128, 228), (27, 128, 220))
GYROSCOPES = MotionPlusCalibration(
    MotionPlusRange((31107, 29524, 29416), (12483, 52298, 13564), 1200),
    MotionPlusRange((30537, 30116, 29594), (13650, 51746, 14118), 270),
    (0x4F, 0xE5),
)
"""Calibration of a real MotionPlus."""

SWITCH_S = 0.030
"""Time for which the port is dead while a MotionPlus changes its address."""
FRAME_BYTES = 6
_NO_DEVICE = b"\xff"

Vector = tuple[float, float, float]


def make_eeprom(*, bad_checksum: bool = False, no_calibration: bool = False) -> bytearray:
    """Return the remote's EEPROM with both copies of both calibrations."""
    memory = bytearray(EEPROM_BYTES)
    corners = [IrDot(*corner) for corner in ((127, 93), (896, 93), (896, 674), (127, 674))]
    camera = encode_dots(corners, IrFormat.BASIC)
    blocks = (
        (CAMERA_CALIBRATION_ADDRESSES, camera + bytes((checksum(camera),))),
        (ACCELEROMETER_CALIBRATION_ADDRESSES, encode_accelerometer_calibration(ACCELEROMETER)),
    )
    for addresses, block in blocks:
        for address in addresses:
            memory[address : address + len(block)] = (
                b"\xff" * len(block) if no_calibration else block
            )
    if bad_checksum:
        memory[ACCELEROMETER_CALIBRATION_ADDRESSES[0] + 9] ^= 0xFF
    return memory


class Registers:
    """256 bytes behind a bus address. An access beyond the end continues at the start."""

    def __init__(self) -> None:
        self.memory = bytearray(256)

    def read(self, offset: int, size: int) -> bytes:
        """Return the registers that the host reads."""
        return bytes(self.memory[(offset + i) & 255] for i in range(size))

    def write(self, offset: int, data: bytes, now_s: float) -> None:
        """Store the registers that the host writes."""
        for i, byte in enumerate(data):
            self.memory[(offset + i) & 255] = byte


class Nunchuk(Registers):
    """A Nunchuk: all FF until it is initialized, the old way with its fixed encryption."""

    def __init__(self, *, no_calibration: bool = False) -> None:
        super().__init__()
        block = b"\xff" * 16 if no_calibration else encode_nunchuk_calibration(NUNCHUK)
        self.memory[0x20:0x40] = block * 2
        self.memory[ID_OFFSET:] = EXTENSION_IDS[Extension.NUNCHUK]
        self.initialized = False
        self.encrypted = False
        self.set(NunchukData(128, 128, (510, 514, 720), False, False))

    def set(self, measured: NunchukData) -> None:
        """Set the measurement from now on."""
        self.measured = measured
        self.memory[:FRAME_BYTES] = encode_nunchuk(measured)

    def forget(self) -> None:
        """Lose the power."""
        self.initialized = self.encrypted = False

    def read(self, offset: int, size: int) -> bytes:
        if not self.initialized:
            return _NO_DEVICE * size
        data = super().read(offset, size)
        if self.encrypted:
            # With a key of zeros, which the old initialization sets.
            data = bytes(((byte - 0x17) & 255) ^ 0x17 for byte in data)
        return data

    def write(self, offset: int, data: bytes, now_s: float) -> None:
        if offset == 0xF0 and data[0] == 0x55:
            self.initialized, self.encrypted = True, False
        elif offset == 0x40:
            self.initialized = self.encrypted = True
        elif offset < 0x20 or offset >= 0x40:
            pass  # neither measurements nor identity can be written
        else:
            super().write(offset, data, now_s)


class MotionPlus(Registers):
    """Three gyroscopes that receive at one address and send at another."""

    def __init__(
        self, *, built_in: bool, no_calibration: bool = False, noise_lsb: int = 0, seed: int = 0
    ) -> None:
        super().__init__()
        self._noise_lsb = noise_lsb
        self._random = random.Random(seed)
        block = b"\xff" * 32 if no_calibration else encode_motion_plus_calibration(GYROSCOPES)
        self.memory[CALIBRATION_OFFSET : CALIBRATION_OFFSET + 32] = block
        self._built_in = built_in
        self.rates_rad_s: Vector = (0.0, 0.0, 0.0)
        self.mode = 0
        """PASS_NONE, PASS_NUNCHUK or PASS_CLASSIC while active, else 0."""
        self.becomes: int | None = None
        """Mode that it is changing to; the port is dead meanwhile."""
        self.ready_s = math.inf
        self._was = 0
        self._own_turn = True
        self._garbage = False
        self._identify()

    @property
    def active(self) -> bool:
        return self.mode != 0 and self.becomes is None

    @property
    def inactive(self) -> bool:
        return self.mode == 0 and self.becomes is None

    def write(self, offset: int, data: bytes, now_s: float) -> None:
        target: int | None = None
        if offset == 0xFE and data[0] in (PASS_NONE, PASS_NUNCHUK, PASS_CLASSIC):
            target = data[0]
        elif self.active and (
            (offset == 0xF0 and data[0] == 0x55) or (offset, data[0]) == (0xFE, 0)
        ):
            target = 0
        if target is not None and target != self.mode:
            self.becomes = target
            self.ready_s = now_s + SWITCH_S

    def arrive(self) -> None:
        """Complete the change of address."""
        assert self.becomes is not None
        self._was, self.mode, self.becomes = self.mode or self._was, self.becomes, None
        self.ready_s = math.inf
        self._own_turn = self._garbage = True
        self._identify()

    def forget(self) -> None:
        """Lose the power."""
        self.mode, self.becomes, self.ready_s, self._was = 0, None, math.inf, 0
        self._identify()

    def frame(self, passed: Nunchuk | None) -> bytes:
        """Return its next frame, or every second time that of the extension behind it."""
        if self._garbage:
            self._garbage = False
            return self._random.randbytes(5) + b"\x03"
        passing = passed is not None and self.mode == PASS_NUNCHUK
        own, self._own_turn = self._own_turn or not passing, not self._own_turn
        if own:
            frame = from_rad_s(self.rates_rad_s, GYROSCOPES, extension=passed is not None)
            return encode_motion_plus(
                frame._replace(
                    yaw=self._noisy(frame.yaw),
                    roll=self._noisy(frame.roll),
                    pitch=self._noisy(frame.pitch),
                )
            )
        assert passed is not None
        return encode_nunchuk_pass_through(passed.measured)

    def _noisy(self, reading: int) -> int:
        if not self._noise_lsb:
            return reading
        noise = self._random.randint(-self._noise_lsb, self._noise_lsb)
        return min(RAW_MAX, max(0, reading + noise))

    def _identify(self) -> None:
        page = 0xA4 if self.mode else 0xA6
        identity = bytes((self._built_in, 0, page, 0x20, self.mode or self._was, 0x05))
        self.memory[ID_OFFSET : ID_OFFSET + ID_BYTES] = identity


class Camera(Registers):
    """Infrared camera, which sees dots once it runs."""

    def __init__(self) -> None:
        super().__init__()
        self.dots: tuple[IrDot, ...] = ()

    def data(self, ir_format: IrFormat) -> bytes:
        """Return the camera's bytes in a report of that format: all FF unless it runs in this
        format."""
        running = self.memory[0x30] == 0x08 and self.memory[0x33] == ir_format
        return encode_dots(self.dots if running else (), ir_format)

    def power_down(self) -> None:
        """Switch off, and lose all settings."""
        self.memory[:] = bytes(256)


class ExtensionPort:
    """Extension port: empty, or with a Nunchuk, a MotionPlus, or the one behind the other."""

    def __init__(
        self,
        *,
        nunchuk: bool,
        motion_plus: bool,
        built_in: bool = False,
        blank: bool = False,
        noise_lsb: int = 0,
        seed: int = 0,
    ) -> None:
        self._blank = blank
        self.nunchuk = Nunchuk(no_calibration=blank) if nunchuk else None
        self.motion_plus: MotionPlus | None = None
        if motion_plus:
            self.motion_plus = MotionPlus(
                built_in=built_in, no_calibration=blank, noise_lsb=noise_lsb, seed=seed
            )

    @property
    def next_due_s(self) -> float:
        """Time at which a MotionPlus has moved; inf when none is on its way."""
        return math.inf if self.motion_plus is None else self.motion_plus.ready_s

    @property
    def connected(self) -> bool:
        """Flag of the status report: a device answers at the port."""
        return self.device(PORT) is not None

    def advance(self, now_s: float) -> None:
        """Advance the extensions until `now_s`."""
        if self.motion_plus is not None and self.motion_plus.ready_s <= now_s:
            self.motion_plus.arrive()
            if self.nunchuk is not None:
                self.nunchuk.forget()

    def device(self, address: int) -> Registers | None:
        """Return the registers that answer at PORT or MOTION_PLUS; None: none do."""
        plus = self.motion_plus
        if address == MOTION_PLUS:
            return plus if plus is not None and plus.inactive else None
        if plus is None or plus.inactive:
            return self.nunchuk
        return plus if plus.active else None

    def data(self, size: int) -> bytes:
        """Return the extension's bytes of a data report: FF if there is none."""
        plus = self.motion_plus
        if plus is not None and plus.active:
            return plus.frame(self.nunchuk).ljust(size, b"\0")
        if not self.connected or self.nunchuk is None:
            return _NO_DEVICE * size
        return self.nunchuk.read(0, FRAME_BYTES).ljust(
            size, b"\0" if self.nunchuk.initialized else _NO_DEVICE
        )

    def plug(self) -> None:
        """Plug a Nunchuk in."""
        if self.nunchuk is None:
            self.nunchuk = Nunchuk(no_calibration=self._blank)

    def unplug(self) -> None:
        """Pull the Nunchuk out."""
        self.nunchuk = None

    def power_down(self) -> None:
        """Switch the remote off."""
        for device in (self.nunchuk, self.motion_plus):
            if device is not None:
                device.forget()
