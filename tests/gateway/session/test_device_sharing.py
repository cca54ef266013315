"""The lease of a shared device, which opens and closes it in a thread outside of the session's
loop."""

import threading

import pytest

from cardan.errors import DeviceNotFoundError
from cardan.gateway.session.device_sharing import DeviceLease

WITHIN_S = 10.0


class Device:
    """Records its calls."""

    def __init__(self, failures=0):
        self.is_open = False
        self.failures = failures
        self.done = threading.Semaphore(0)

    def open(self):
        if self.failures:
            self.failures -= 1
            raise DeviceNotFoundError("it is not there")
        self.is_open = True
        self.done.release()

    def close(self):
        self.is_open = False
        self.done.release()


@pytest.fixture
def make():
    leases = []

    def made(device):
        leases.append(DeviceLease(device))
        return leases[-1]

    yield made
    for lease in leases:
        lease.close()


def test_it_is_given_and_taken_back(make):
    device = Device()
    lease = make(device)
    lease.begin()
    assert lease.held
    assert device.done.acquire(timeout=WITHIN_S)
    for held in (False, True, False):
        lease.want(held)
        assert device.done.acquire(timeout=WITHIN_S)
        assert device.is_open is held


def test_wanted_again_before_it_was_given_it_is_open_in_the_end(make):
    device = Device()
    lease = make(device)
    lease.begin()
    for held in (False, True) * 50:
        lease.want(held)
    lease.want(False)
    lease.close()
    assert not device.is_open


def test_one_that_is_not_there_yet_is_tried_again(make, monkeypatch):
    monkeypatch.setattr("cardan.gateway.session.device_sharing.AGAIN_S", 0.001)
    device = Device(failures=3)
    lease = make(device)
    lease.want(True)
    assert device.done.acquire(timeout=WITHIN_S)
    assert device.is_open


def test_one_that_is_not_there_is_said(make):
    device = Device(failures=10**9)
    lease = make(device)
    with pytest.raises(DeviceNotFoundError):
        lease.begin()
    assert not lease.held


def test_closing_ends_it_all(make):
    device = Device(failures=10**9)
    lease = make(device)
    lease.want(True)
    lease.close()
    lease.close()
    assert not lease.held
