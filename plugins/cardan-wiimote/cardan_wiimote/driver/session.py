"""Requests to the remote: start-up, extensions, camera, data mode. No I/O, no clock."""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

from cardan.types import NEVER_S
from cardan_wiimote.driver.options import WiimoteOptions
from cardan_wiimote.driver.requests import Answer, Requests, WiimoteRequest
from cardan_wiimote.protocol import (
    ACCELEROMETER_CALIBRATION_ADDRESSES,
    ACCELEROMETER_CALIBRATION_BYTES,
    DEFAULT_ACCELEROMETER,
    DEFAULT_MOTION_PLUS,
    DEFAULT_NUNCHUK,
    EEPROM,
    EXTENSION_START,
    MOTION_PLUS_START,
    MOTION_PLUS_STOP,
    PASS_NONE,
    PASS_NUNCHUK,
    READ_EXTENSION_ID,
    READ_MOTION_PLUS_CALIBRATION,
    READ_MOTION_PLUS_ID,
    READ_NUNCHUK_CALIBRATION,
    AccelerometerCalibration,
    Ack,
    CalibrationSource,
    DataMode,
    Extension,
    IrFormat,
    Leds,
    MotionPlusCalibration,
    NunchukCalibration,
    ReadData,
    ReadMemory,
    Rumble,
    Status,
    StatusRequest,
    Switch,
    WriteMemory,
    camera_start,
    decode_motion_plus_calibration,
    decode_nunchuk_calibration,
    encode_output,
    extension_of,
    motion_plus_activate,
    read_accelerometer_calibration,
)

MODE_AGAIN_S = 0.03
"""Time after which a data mode that did not take effect is set again."""

MODE_SILENCE_S, MODE_SILENCE_LATER_S = 0.05, 0.5
"""Silence after which a remote may have another data mode and is set again, and the period of that
while it stays silent: long enough to fill no buffers while it is out of range."""

KERNEL_LAG_S = 0.02
"""After a status report the kernel's driver sets its own data mode; ours is sent after it."""

PORT_SETTLE_S = 0.1
"""Time that a change of the extension port must last to count; a MotionPlus that is switched on
appears and vanishes for some 40 ms."""

MOTION_PLUS_READY_S = 0.5
"""Longest time that a MotionPlus takes to move to the extension port."""

SUSPECT_AGAIN_S = 2.0
"""Time between two detections at a port with unexpected data."""

LOOK_AGAIN_S = 4.0
"""Period of checks for a MotionPlus: a remote does not report that one was plugged in."""

STATUS_PERIOD_S = 60.0
"""Period of requests for the battery's charge while no clutch is held."""

_ACTIVE = (Extension.MOTION_PLUS, Extension.MOTION_PLUS_NUNCHUK, Extension.MOTION_PLUS_CLASSIC)


class Pause(NamedTuple):
    """Step of a script: wait, at most until the extension port is in use."""

    seconds: float
    for_port: bool = False


Script = Generator[WiimoteRequest | Pause, Answer, None]


class Session:
    """Connection to a remote. Times are monotonic, s."""

    def __init__(self, options: WiimoteOptions) -> None:
        self._options = options
        self.requests = Requests()
        self._script: Script | None = None
        self._begun = False
        self.begin(NEVER_S)

    def begin(self, now_s: float) -> None:
        """Start with an unknown remote after it was opened."""
        self.requests.reset()
        self.requests.foreign = 0
        self.started = False
        """True after the start-up: data reports are wanted."""
        self.failure = ""
        """Reason why the remote cannot be used."""
        self.calibration: AccelerometerCalibration = DEFAULT_ACCELEROMETER
        self.calibration_source: CalibrationSource | None = None
        self.nunchuk: NunchukCalibration | None = None
        """Calibration of the plugged Nunchuk."""
        self.nunchuk_calibrated = False
        self.other_extension = ""
        """Name of any other plugged extension."""
        self._unanswered = False
        self.motion_plus: MotionPlusCalibration | None = None
        """Calibration of the active MotionPlus."""
        self.motion_plus_calibrated = False
        self._camera_format: IrFormat | None = None
        self.status: Status | None = None
        self.changes = 0
        """Number of changes of the extension port."""
        self.mode_restores = 0
        self._now_s = now_s
        self._answer: Answer | None = None
        self._waiting = False
        """The script waits for an answer."""
        self._resume_s = NEVER_S
        self._for_port = False
        self._port = False
        """True if the port was in use at the last check."""
        self._port_changed_s: float | None = None
        self._port_suspected = False
        self._detected_s = NEVER_S
        self._look_s = now_s + LOOK_AGAIN_S
        self._status_s = now_s + STATUS_PERIOD_S
        self._mode = 0x31
        self._mode_sent_s = NEVER_S
        self._mode_again_s: float | None = None
        self._data_s = NEVER_S
        self._leds = 0
        self._leds_shown: int | None = None
        self._out: list[bytes] = []
        self._run(self._start())

    @property
    def camera(self) -> bool:
        """True if the camera is on."""
        return self._camera_format is not None

    # -- what comes in -------------------------------------------------------------------------

    def on_input(self, value: Status | ReadData | Ack, now_s: float) -> None:
        """Handle a report that is not a data report."""
        if isinstance(value, Status):
            self._on_status(value, now_s)
        answer = self.requests.on_input(value, now_s)
        if answer is not None and self._waiting:
            self._answer = answer

    def on_data(self, mode: int, now_s: float) -> None:
        """Handle a data report of `mode`."""
        self._data_s = now_s
        if mode != self._mode and self.started and now_s - self._mode_sent_s > MODE_AGAIN_S:
            self.mode_restores += 1
            self._send_mode(now_s)

    def suspect_port(self, now_s: float) -> None:
        """Detect the extension again, because its data are not as expected."""
        if self.started and self._script is None and now_s - self._detected_s > SUSPECT_AGAIN_S:
            self._port_suspected = True

    def show_leds(self, leds: int) -> None:
        """Switch on these LEDs; bit 0 is LED 1."""
        self._leds = leds

    # -- what goes out -------------------------------------------------------------------------

    def poll(self, now_s: float, at_rest: bool) -> list[bytes]:
        """Return reports to send now, without the motor's bit. `at_rest`: no clutch is held."""
        self._now_s = now_s
        self._advance(now_s)
        if self._script is None and self.started:
            self._choose(now_s, at_rest)
            self._advance(now_s)
        if self.started:
            if self._leds != self._leds_shown:
                self._send(Leds(self._leds))
                self._leds_shown = self._leds
            self._keep_mode(now_s)
        out, self._out = self._out, []
        return out

    def _advance(self, now_s: float) -> None:
        """Run the script until it has to wait."""
        while self._script is not None:
            if self._waiting:
                sent = self.requests.poll(now_s)
                if isinstance(sent, bytes):
                    self._out.append(sent)
                elif sent is not None:
                    self._answer = sent
                if self._answer is None:
                    return
            elif now_s < self._resume_s and not (self._for_port and self._port_in_use):
                return
            answer, self._answer = self._answer, None
            self._waiting = False
            try:
                if self._begun:
                    step = self._script.send(answer or Answer())
                else:
                    self._begun = True
                    step = next(self._script)
            except StopIteration:
                self._script = None
                self._look_s = now_s + LOOK_AGAIN_S
                return
            if isinstance(step, Pause):
                self._resume_s = now_s + step.seconds
                self._for_port = step.for_port
            else:
                self._waiting = True
                self.requests.ask(step)

    def _run(self, script: Script) -> None:
        self._script = script
        self._begun = False

    def _choose(self, now_s: float, at_rest: bool) -> None:
        """Start the script that is due."""
        if self._port_in_use is self._port:
            self._port_changed_s = None
        elif self._port_changed_s is None:
            self._port_changed_s = now_s
            self.changes += 1  # At once: the extension was unplugged, or something was moved.
        changed_s = self._port_changed_s
        if self._port_suspected or (changed_s is not None and now_s - changed_s >= PORT_SETTLE_S):
            self._run(self._detect())
        elif not at_rest:
            return
        elif now_s >= self._look_s and (self._misses_motion_plus or self._unanswered):
            self._look_s = now_s + LOOK_AGAIN_S
            self._run(self._look())
        elif now_s >= self._status_s:
            self._status_s = now_s + STATUS_PERIOD_S
            self._run(self._ask_status())

    # -- scripts -------------------------------------------------------------------------------

    def _start(self) -> Script:
        self._send(Rumble())
        self._send(Leds(self._leds))
        self._leds_shown = self._leds
        answer = yield StatusRequest()
        if not answer.ok:
            self.failure = "it does not answer: press a button of the remote"
            return
        answer = yield ReadMemory(
            ACCELEROMETER_CALIBRATION_ADDRESSES[0], 2 * ACCELEROMETER_CALIBRATION_BYTES, EEPROM
        )
        self.calibration, self.calibration_source = read_accelerometer_calibration(answer.data)
        yield from self._detect()
        self._data_s = self._now_s  # From now on data are missing.
        self.started = True

    def _ask_status(self) -> Script:
        yield StatusRequest()

    def _detect(self) -> Script:
        """Identify the extension at the port, and start it."""
        self.changes += 1
        self.nunchuk = self.motion_plus = None
        self.nunchuk_calibrated = self.motion_plus_calibrated = self._unanswered = False
        self.other_extension = ""
        if self._port_in_use:
            yield from self._start_extension()
        if self._options.wants_motion_plus:
            yield from self._start_motion_plus()
        if self._options.ir and self._camera_format is not self._format_wanted:
            yield from self._start_camera()
        self._port = self._port_in_use
        self._port_changed_s = None
        self._port_suspected = False
        self._detected_s = self._now_s
        self._mode = self._mode_wanted
        self._mode_again_s = NEVER_S

    def _start_extension(self) -> Script:
        answer = yield READ_EXTENSION_ID
        if extension_of(answer.data) in _ACTIVE:
            # Left on by the previous program. When off, it shows the extension plugged into it.
            yield MOTION_PLUS_STOP
            yield Pause(PORT_SETTLE_S)
            yield StatusRequest()
            if not self._port_in_use:
                return
        for write in EXTENSION_START:
            answer = yield write
            if not answer.ok:
                break
        answer = yield READ_EXTENSION_ID
        if not answer.ok:
            self._unanswered = True
            self.other_extension = "something that does not answer"
            return
        kind = extension_of(answer.data)
        if kind is not Extension.NUNCHUK:
            self.other_extension = f"{kind.value} (id {answer.data.hex()})"
            return
        answer = yield READ_NUNCHUK_CALIBRATION
        calibration = decode_nunchuk_calibration(answer.data)
        self.nunchuk_calibrated = calibration is not None
        self.nunchuk = calibration or DEFAULT_NUNCHUK

    def _start_motion_plus(self) -> Script:
        answer = yield READ_MOTION_PLUS_ID
        if not answer.ok:
            return
        answer = yield READ_MOTION_PLUS_CALIBRATION
        calibration = decode_motion_plus_calibration(answer.data)
        answer = yield MOTION_PLUS_START
        if not answer.ok:
            return
        answer = yield motion_plus_activate(PASS_NUNCHUK if self.nunchuk else PASS_NONE)
        if not answer.ok:
            return
        yield Pause(PORT_SETTLE_S)
        yield Pause(MOTION_PLUS_READY_S, for_port=True)
        answer = yield READ_EXTENSION_ID
        if extension_of(answer.data) in _ACTIVE:
            self.motion_plus_calibrated = calibration is not None
            self.motion_plus = calibration or DEFAULT_MOTION_PLUS

    def _look(self) -> Script:
        """Look for an extension or MotionPlus that was absent."""
        found = self._unanswered
        if not found:
            answer = yield READ_MOTION_PLUS_ID
            found = answer.ok
        if found:
            yield from self._detect()

    def _start_camera(self) -> Script:
        wanted = self._format_wanted
        self._camera_format = None
        for step in camera_start(wanted):
            assert isinstance(step, Switch | WriteMemory)
            answer = yield step
            if not answer.ok:
                return
        self._camera_format = wanted

    # -- inside --------------------------------------------------------------------------------

    def _on_status(self, status: Status, now_s: float) -> None:
        self.status = status
        if status.leds != self._leds_shown:
            self._leds_shown = None
        if self.started:
            self._send_mode(now_s)
            self._mode_again_s = now_s + KERNEL_LAG_S

    @property
    def _port_in_use(self) -> bool:
        return self.status is not None and self.status.extension

    @property
    def _extended(self) -> bool:
        """True if data reports carry the extension's bytes."""
        return self.nunchuk is not None or self.motion_plus is not None

    @property
    def _misses_motion_plus(self) -> bool:
        return self._options.wants_motion_plus and self.motion_plus is None

    @property
    def _format_wanted(self) -> IrFormat:
        return IrFormat.BASIC if self._extended else IrFormat.EXTENDED

    @property
    def _mode_wanted(self) -> int:
        if self.camera:
            return 0x37 if self._extended else 0x33
        return 0x35 if self._extended else 0x31

    def _keep_mode(self, now_s: float) -> None:
        silent_long = now_s - self._data_s > MODE_SILENCE_LATER_S
        pause_s = MODE_SILENCE_LATER_S if silent_long else MODE_SILENCE_S
        lost = now_s - max(self._mode_sent_s, self._data_s) > pause_s
        again = self._mode_again_s is not None and now_s >= self._mode_again_s
        if lost or again:
            self._send_mode(now_s)

    def _send_mode(self, now_s: float) -> None:
        self._send(DataMode(self._mode))
        self._mode_sent_s = now_s
        self._mode_again_s = None

    def _send(self, report: Rumble | Leds | DataMode) -> None:
        self._out.append(encode_output(report))
