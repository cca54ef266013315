"""Serial port, with explanations of a failed open."""

from __future__ import annotations

import contextlib
import errno
import os
from typing import Any

try:
    from termios import error as TerminalError  # noqa: N812
except ImportError:  # on systems without terminals

    class TerminalError(Exception):  # type: ignore[no-redef]
        """Never raised."""


from cardan.errors import DeviceAccessError, DeviceNotFoundError, DriverError

WAIT_S = 0.02
"""Longest wait of a read: the reader has other work, and checks whether to stop."""


class SerialPort:
    """Exclusively opened serial port: 8 data bits, no parity; RTS and DTR are up, which power some
    devices.

    Raises DeviceNotFoundError if nothing is at `path`, DeviceAccessError if it cannot be opened.
    """

    def __init__(self, path: str, baud: int, *, stop_bits: int = 1) -> None:
        try:
            import serial
        except ImportError as error:
            raise DriverError(
                f"the package pyserial cannot be imported ({error}): pip install pyserial"
            ) from None
        try:
            # No flow control: not every cable wires CTS, and waiting for it would never end.
            self._port: Any = serial.Serial(
                path,
                baud,
                stopbits=stop_bits,
                timeout=WAIT_S,  # set once: pyserial configures the port at each change
                write_timeout=0.5,
                exclusive=True if os.name == "posix" else None,
            )
        except (OSError, ValueError, TerminalError) as error:
            number = _number_of(error) or _number_of(error.__context__)
            kind = DeviceNotFoundError if number == errno.ENOENT else DeviceAccessError
            raise kind(f"cannot open {path}: {_words(error, number)}") from None

    def read(self, *, wait: bool = True) -> bytes:
        """Return the bytes received; if there are none and `wait`, the first within `WAIT_S`.

        Raises OSError once the port is gone.
        """
        try:
            waiting = self._port.in_waiting
            data: bytes = self._port.read(waiting or 1) if waiting or wait else b""
        except (OSError, TerminalError) as error:
            raise _gone(error) from None
        return data

    def write(self, data: bytes) -> None:
        """Send `data`. Raises OSError once the port is gone, or if it accepts nothing."""
        try:
            self._port.write(data)
        except (OSError, TerminalError) as error:
            raise _gone(error) from None

    def fileno(self) -> int:
        """File descriptor for `select`, if the system has serial ports as files."""
        return int(self._port.fileno())

    def close(self) -> None:
        """Close the port, which cuts a device's power. Never raises; closing twice is fine."""
        with contextlib.suppress(OSError, TerminalError):
            self._port.close()


def _gone(error: Exception) -> OSError:
    # pyserial's message would mention file descriptors.
    return OSError(_number_of(error) or errno.ENODEV, "the port is gone")


def _number_of(error: BaseException | None) -> int | None:
    """Return the error number of an exception; a terminal's has it only as its first argument."""
    if isinstance(error, TerminalError) and error.args:
        return int(error.args[0])
    return getattr(error, "errno", None)


def _words(error: Exception, number: int | None) -> str:
    if number in (errno.EACCES, errno.EPERM):
        return (
            "no permission: add yourself to the group that owns it (dialout, as a rule), and log "
            "in again"
        )
    if number in (errno.EAGAIN, errno.EBUSY):
        return "another program has it open: spacenavd, a modem manager or another session"
    if number in (errno.ENOTTY, errno.EINVAL):
        return "it is not a serial port"
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.EIO):
        return "no device is at that port"
    return str(getattr(error, "strerror", None) or error)
