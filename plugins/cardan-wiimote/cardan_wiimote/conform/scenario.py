"""Scenario for a remote: requests its buttons, state, memory, and accelerometer data."""

from __future__ import annotations

from collections.abc import Iterator

from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Scenario, Script, Step, ask, mark, open_, send
from cardan.conform.timeline import Kind, WireEvent
from cardan_wiimote.protocol import (
    ACCELEROMETER_CALIBRATION_ADDRESSES,
    ACCELEROMETER_CALIBRATION_BYTES,
    EEPROM,
    EXTENSION_START,
    READ_EXTENSION_ID,
    Ack,
    Data,
    DataMode,
    Leds,
    OutputReport,
    ReadData,
    ReadMemory,
    Status,
    StatusRequest,
    decode_input,
    encode_output,
)

ANSWER_S = 0.8
HAND_S = 30.0
LONG_READ = 0x60
"""Six pieces of the remote's own memory."""
DATA_MODE = 0x31
EXTENSION_MODE = 0x35


class WiimoteScenario(Scenario):
    """Host that has one request open at a time."""

    def __init__(self, level: Level, seconds: float) -> None:
        self._level = level
        self._seconds = seconds
        self._hand_s = min(HAND_S, 4.0 * seconds)
        self._got: set[type] = set()
        self._read_bytes = 0
        self._read_failed = False
        self._pressed: int | None = None
        self._gone = False

    def answer(self, event: WireEvent) -> Iterator[Step]:
        if event.kind in (Kind.CLOSED, Kind.REFUSED):
            self._gone = True
        elif event.kind is Kind.DATA:
            value = decode_input(event.data)
            self._got.add(type(value))
            if isinstance(value, Data):
                self._pressed = value.buttons
            elif isinstance(value, ReadData):
                self._read_bytes += len(value.data)
                self._read_failed = self._read_failed or bool(value.error)
        return iter(())

    def _asked(self, report: OutputReport, answer: type) -> Script:
        self._got.discard(answer)
        yield send(encode_output(report))
        yield Pause(ANSWER_S, lambda: answer in self._got or self._gone)
        yield Pause(0.02)

    def _read(self, report: ReadMemory) -> Script:
        self._read_bytes, self._read_failed = 0, False
        self._got.discard(Ack)
        yield send(encode_output(report))
        yield Pause(
            ANSWER_S,
            lambda: (
                self._gone
                or self._read_failed
                or self._read_bytes >= report.size
                or Ack in self._got
            ),
        )
        yield Pause(0.02)

    def script(self) -> Script:
        yield open_("")
        yield mark("rest")
        yield ask("flat", "Put the remote flat on a table, its buttons up, with its Nunchuk.")
        yield Pause(0.3)
        yield mark("press")
        yield ask("press", "Press A.")
        yield Pause(self._hand_s, lambda: self._gone or self._is_down() is True)
        yield Pause(0.05)
        yield mark("release")
        yield ask("release", "Let A go.")
        yield Pause(self._hand_s, lambda: self._gone or self._is_down() is False)
        yield Pause(0.05)
        if self._level >= Level.HOLD:
            yield from self._asking()
            yield mark("data")
            yield from self._asked(DataMode(DATA_MODE, continuous=True, ack=True), Ack)
            yield mark("stream")
            yield Pause(self._seconds, lambda: self._gone)
            yield mark("status")
            yield from self._asked(StatusRequest(), Status)
            yield mark("after-status")
            yield Pause(0.4)
            yield mark("extension")
            yield from self._asked(DataMode(EXTENSION_MODE, continuous=True, ack=True), Ack)
            yield mark("extension-stream")
            yield Pause(0.4)
            yield mark("last")
            yield from self._asked(StatusRequest(), Status)
        if self._level >= Level.BY_HAND:
            yield mark("power-off")
            yield ask("power-off", "Hold the remote's power button until it is off.")
            yield Pause(self._hand_s, lambda: self._gone)
            yield Pause(0.2)

    def _is_down(self) -> bool | None:
        return None if self._pressed is None else bool(self._pressed)

    def _asking(self) -> Script:
        yield mark("ask")
        yield from self._asked(StatusRequest(), Status)
        yield from self._asked(Leds(0b0001, ack=True), Ack)
        yield mark("memory")
        for address in ACCELEROMETER_CALIBRATION_ADDRESSES:
            yield from self._read(ReadMemory(address, ACCELEROMETER_CALIBRATION_BYTES, EEPROM))
        yield from self._read(ReadMemory(0, LONG_READ, EEPROM))
        yield mark("extension-id")
        for write in EXTENSION_START:
            yield from self._asked(write, Ack)
        yield from self._read(READ_EXTENSION_ID)
