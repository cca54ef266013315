"""Two virtual Bluetooth controllers in radio range of each other, by BlueZ's btvirt.

Only the kernel's part of Bluetooth runs, without bluetoothd: ioctls of the HCI socket power on the
controllers and make them connectable.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import signal
import socket
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from tests.kernel.waiting import wait_for

AF_BLUETOOTH, BTPROTO_L2CAP, BTPROTO_HCI = 31, 0, 1
HCIDEVUP, HCIGETDEVINFO, HCISETSCAN = 0x400448C9, 0x800448D3, 0x400448DD
SCAN_PAGE = 2
DEVICE_INFO_BYTES = 92


def ready(index: int) -> str | None:
    """Power on controller `index` and make it connectable; return its address, None while it is
    new."""
    with socket.socket(AF_BLUETOOTH, socket.SOCK_RAW, BTPROTO_HCI) as control:
        try:
            fcntl.ioctl(control, HCIDEVUP, index)
        except OSError as error:
            if error.errno != 114:  # EALREADY: already powered on
                return None
        fcntl.ioctl(control, HCISETSCAN, struct.pack("=HxxI", index, SCAN_PAGE))
        info = fcntl.ioctl(
            control, HCIGETDEVINFO, struct.pack("=H", index).ljust(DEVICE_INFO_BYTES)
        )
        return ":".join(f"{byte:02X}" for byte in reversed(info[10:16]))


@contextmanager
def controllers() -> Iterator[tuple[str, str]]:
    """Return the addresses of two controllers."""
    emulator = subprocess.Popen(
        ["btvirt", "-l2"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        wait_for(lambda: {"hci0", "hci1"} <= set(os.listdir("/sys/class/bluetooth")))
        first, second = (wait_for(lambda index=index: ready(index)) for index in (0, 1))
        yield first, second
    finally:
        emulator.send_signal(signal.SIGTERM)
        emulator.wait(10.0)


def connect(address: str, psm: int) -> socket.socket:
    """Connect a plain L2CAP channel, by libc, because not every Python supports these addresses."""
    channel = socket.socket(AF_BLUETOOTH, socket.SOCK_SEQPACKET, BTPROTO_L2CAP)
    bdaddr = bytes.fromhex(address.replace(":", ""))[::-1]
    name = struct.pack("<HH6sHBx", AF_BLUETOOTH, psm, bdaddr, 0, 0)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.connect(channel.fileno(), name, len(name)):
        channel.close()
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return channel
