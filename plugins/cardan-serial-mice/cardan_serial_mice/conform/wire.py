"""The wire to a real device: its serial port."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from cardan.conform.transports import TargetWire, Wires
from cardan.drivers.serial_port import SerialPort


class _Serial(TargetWire):
    """A serial line."""

    def __init__(self, port: SerialPort) -> None:
        self._port = port

    def fileno(self) -> int:
        return self._port.fileno()

    def read(self) -> Iterator[tuple[bytes, str]]:
        try:
            data = self._port.read(wait=False)
        except OSError:
            self.ended = True
            return
        if data:
            yield data, ""

    def write(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            self._port.write(data)

    def close(self) -> None:
        self._port.close()


class SerialLine(Wires):
    """A serial port; opening it powers the device."""

    def __init__(self, path: str, baud: int, stop_bits: int = 1) -> None:
        self._path, self._baud, self._stop_bits = path, baud, stop_bits

    def open(self, channel: str) -> TargetWire:
        return _Serial(SerialPort(self._path, self._baud, stop_bits=self._stop_bits))
