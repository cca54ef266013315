"""Notification of plugged-in devices, so that a driver without one need not poll.

The kernel reports it where it lets us listen; elsewhere (some containers, other systems) a driver
polls. Any program may send such an event: it only makes a driver look.
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
"""Actions after which a device may have appeared, or may be opened: udev reports its permissions by
repeating the kernel's action."""

SUBSYSTEMS: Final = frozenset({"hidraw", "input", "tty", "usb", "usb_device", "can", "net"})
"""Subsystems of operator devices."""

LISTEN_S: Final = 0.1
"""Period of checking whether to end."""


class HotplugMonitor:
    """Listener for devices that are plugged in, from its making until `close`."""

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
        """Whether the system reports devices."""
        return self._socket is not None

    def wait(self, timeout_s: float, stop: threading.Event) -> bool:
        """Wait until a device has arrived, for `timeout_s` at most; ends early when `stop` is set.

        Returns whether one has arrived.
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
        """Whether one of the events that wait is of a device that has arrived; all are read."""
        listening = self._socket
        arrived = False
        if listening is None:
            return False
        while True:
            try:
                event = decode_uevent(listening.recv(LARGEST))
            except BlockingIOError:
                return arrived
            except OSError:  # Too many at once (ENOBUFS): there may have been one.
                arrived = True
                continue
            if event is not None and event.action in ARRIVED and event.subsystem in SUBSYSTEMS:
                arrived = True

    def close(self) -> None:
        """Stop listening. Never raises; twice is fine."""
        listening, self._socket = self._socket, None
        if listening is not None:
            listening.close()
