"""Hot-plug events of the kernel."""

import contextlib
import socket
import threading

import pytest

from cardan.drivers.hotplug import HotplugMonitor
from tests.protocols.test_uevent import KERNEL, udev

NEVER = threading.Event()


@pytest.fixture
def reports_devices():
    """Function that returns a monitor whose socket holds these datagrams."""
    with contextlib.ExitStack() as stack:

        def make(*datagrams):
            reading, writing = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            reading.setblocking(False)
            for data in datagrams:
                writing.send(data)
            stack.callback(writing.close)
            arrivals = HotplugMonitor()
            arrivals.close()
            arrivals._socket = reading
            stack.callback(arrivals.close)
            return arrivals

        yield make


@pytest.mark.parametrize("data", [KERNEL, udev(), KERNEL.replace(b"=add", b"=bind")])
def test_a_device_that_arrives_ends_the_wait(reports_devices, data):
    assert reports_devices(b"junk", data, b"").wait(60.0, NEVER)


@pytest.mark.parametrize(
    "data",
    [KERNEL.replace(b"=add", b"=remove"), KERNEL.replace(b"=hidraw\0", b"=block\0"), b"", b"@"],
)
def test_other_events_do_not(reports_devices, data):
    assert not reports_devices(data).wait(0.01, NEVER)


def test_it_ends_when_it_is_asked_to():
    stop = threading.Event()
    stop.set()
    arrivals = HotplugMonitor()
    assert not arrivals.wait(60.0, stop)
    arrivals.close()


def test_without_the_kernels_word_it_waits_as_long(monkeypatch):
    def refuse(*_arguments):
        raise PermissionError

    monkeypatch.setattr("cardan.drivers.hotplug.socket.socket", refuse)
    arrivals = HotplugMonitor()
    assert not arrivals.reports_devices
    assert not arrivals.wait(0.01, NEVER)
    arrivals.close()
    arrivals.close()
