"""Notification of plugged-in devices, as an alternative to polling.

If the kernel's events are not accessible (some containers, other systems), drivers poll. Any
program may send such an event, which only makes a driver search.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from typing import Final

from cardan.protocols.uevent import (
    KERNEL_GROUP,
    LARGEST,
    PROTOCOL,
    UDEV_GROUP,
    decode_uevent,
)

ARRIVED: Final = frozenset({"add", "bind", "change"})
"""Actions after which a device may have appeared or become accessible: udev repeats the kernel's
action once it has set permissions."""

SUBSYSTEMS: Final = frozenset({"hidraw", "input", "tty", "usb", "usb_device", "can", "net"})
"""Subsystems of operator devices."""

LISTEN_S: Final = 0.1
"""Period of checking whether to end, s."""


class HotplugMonitor:
    """Listener for plugged-in devices, from its creation until `close`."""

    def __init__(self) -> None:
        self._socket: socket.socket | None = None
        if not hasattr(socket, "AF_NETLINK"):
            return
        kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
        with contextlib.suppress(OSError):
            listening = socket.socket(socket.AF_NETLINK, kind, PROTOCOL)
            try:
                listening.bind((0, KERNEL_GROUP | UDEV_GROUP))
            except OSError:
                listening.close()
                raise
            self._socket = listening

    @property
    def reports_devices(self) -> bool:
        """True if the system reports devices."""
        return self._socket is not None

    def wait(self, timeout_s: float, stop: threading.Event) -> bool:
        """Wait for a device, at most `timeout_s` or until `stop` is set.

        Returns True if one was plugged in.
        """
        listening = self._socket
        if listening is None:
            stop.wait(timeout_s)
            return False
        end_s = time.monotonic() + timeout_s
        while not stop.is_set() and (left_s := end_s - time.monotonic()) > 0.0:
            if select.select((listening,), (), (), min(left_s, LISTEN_S))[0] and self._arrived():
                return True
        return False

    def _arrived(self) -> bool:
        """Read all waiting events; return True if one is of a device that was plugged in."""
        listening = self._socket
        arrived = False
        if listening is None:
            return False
        while True:
            try:
                event = decode_uevent(listening.recv(LARGEST))
            except BlockingIOError:
                return arrived
            except OSError:  # Lost events (ENOBUFS): a device may have been among them.
                arrived = True
                continue
            if event is not None and event.action in ARRIVED and event.subsystem in SUBSYSTEMS:
                arrived = True

    def close(self) -> None:
        """Stop listening. Never raises; idempotent."""
        listening, self._socket = self._socket, None
        if listening is not None:
            listening.close()
