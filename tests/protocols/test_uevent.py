"""Linux uevents."""

import struct

import pytest
from hypothesis import given, strategies as st

from cardan.protocols.uevent import decode_uevent

KERNEL = (
    b"add@/devices/pci0000:00/usb1/1-1/1-1:1.0/0003:256F:C635.0001/hidraw/hidraw0\0"
    b"ACTION=add\0DEVPATH=/devices/pci0000:00/usb1/1-1/hidraw/hidraw0\0SUBSYSTEM=hidraw\0"
    b"MAJOR=247\0MINOR=0\0DEVNAME=hidraw0\0SEQNUM=2211\0"
)
PROPERTIES = b"UDEV_DATABASE_VERSION=1\0ACTION=add\0SUBSYSTEM=input\0DEVNAME=/dev/input/event7\0"


def udev(properties=PROPERTIES, magic=0xFEEDCAFE):
    """Return an event in the format of systemd's device-monitor.c."""
    header = struct.pack("=8s", b"libudev") + struct.pack(">I", magic)
    header += struct.pack("=III", 40, 40, len(properties)) + struct.pack(">IIII", 1, 2, 3, 4)
    return header + properties


def test_the_kernels():
    event = decode_uevent(KERNEL)
    assert event.action == "add"
    assert event.subsystem == "hidraw"
    assert event.properties["DEVNAME"] == "hidraw0"


def test_udevs():
    event = decode_uevent(udev())
    assert event.action == "add"
    assert event.subsystem == "input"
    assert event.properties["DEVNAME"] == "/dev/input/event7"


@pytest.mark.parametrize(
    "data",
    [b"", b"libudev\0", udev(magic=1), udev(b""), b"add\0ACTION=add\0", b"add@/x\0SUBSYSTEM=usb\0"],
)
def test_what_is_none(data):
    assert decode_uevent(data) is None


@given(st.one_of(st.binary(max_size=300), st.binary(max_size=200).map(lambda b: udev() + b)))
def test_no_bytes_raise(data):
    decode_uevent(data)
