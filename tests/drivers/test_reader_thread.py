"""Reader thread common to all polled devices: open, lose, reopen, close."""

import threading

import pytest

from cardan.drivers import reader_thread
from cardan.drivers.reader_thread import ReadDevice
from cardan.errors import DeviceAccessError, DeviceNotFoundError, NotOpenError
from cardan.types import (
    NEVER_S,
    ZERO_TWIST,
    DeviceCapabilities,
    DeviceLink,
    DeviceState,
)

PATIENCE_S = 10.0
RETRY_FIRST_S, RETRY_LAST_S = reader_thread.RETRY_FIRST_S, reader_thread.RETRY_LAST_S
FOUND_WITHIN_S = 1.0
"""Longest time from plugging in to the search for the device."""
NEUTRAL = (*ZERO_TWIST.linear, *ZERO_TWIST.angular)


class Core:
    def __init__(self):
        self.heard = False
        self.link, self.reason = DeviceLink.CLOSED, "not opened"
        self.history = []

    def _go(self, link, reason):
        self.link, self.reason = link, reason
        self.history.append((link, reason))

    def on_opened(self):
        self._go(DeviceLink.NEEDS_NEUTRAL, "opened")

    def on_lost(self, reason, now_s):
        self._go(DeviceLink.LOST, reason)

    def on_closed(self, now_s):
        self._go(DeviceLink.CLOSED, "closed")

    def state(self, now_s):
        return DeviceState(NEVER_S, self.link, NEUTRAL, frozenset(), reason=self.reason)

    def events(self):
        return []

    def diagnosis(self, now_s):
        return [self.reason]

    def metrics(self, now_s):
        return {"heard": float(self.heard)}


class Options:
    wait_for_device = False


class Patient(Options):
    wait_for_device = True


class Device(ReadDevice):
    """Device whose hardware is present while `plugged` is set."""

    _kind = "device"

    Options = Options

    def __init__(self, options=None, plugged=True):
        super().__init__(options)
        self._core = Core()
        self.plugged = threading.Event()
        if plugged:
            self.plugged.set()
        self.connected, self.released = threading.Event(), threading.Event()
        self.error = OSError(19, "No such device")

    capabilities = DeviceCapabilities(False, (), frozenset(), False)

    def _connect(self):
        if not self.plugged.is_set():
            raise DeviceNotFoundError("nothing is plugged in")
        with self._lock:
            self._core.on_opened()
        self.connected.set()

    def _serve(self, stop):
        while not stop.wait(0.001):
            if not self.plugged.is_set():
                self.connected.clear()
                raise self.error

    def _release(self):
        self.released.set()


@pytest.fixture(autouse=True)
def _hasty(monkeypatch):
    monkeypatch.setattr(reader_thread, "RETRY_FIRST_S", 0.001)
    monkeypatch.setattr(reader_thread, "RETRY_LAST_S", 0.002)


def test_it_opens_and_closes():
    device = Device()
    with device:
        assert device.state().link is DeviceLink.NEEDS_NEUTRAL
        device.open()
        (reader,) = (each for each in threading.enumerate() if each.name == "cardan-device")
        assert reader.daemon, "a program that does not close it can end"
    assert device.state().link is DeviceLink.CLOSED
    assert device.released.is_set()
    device.close()


def test_one_whose_library_fails_to_let_go_is_found_again(caplog):
    with Device(options=Patient()) as device:

        def release():
            device.released.set()
            raise RuntimeError("close operation timed out")

        device._release = release
        device.plugged.clear()
        assert device.released.wait(PATIENCE_S)
        device.plugged.set()
        assert device.connected.wait(PATIENCE_S)
    assert "could not be closed properly" in caplog.text


def test_a_missing_device_is_an_error():
    device = Device(plugged=False)
    with pytest.raises(DeviceNotFoundError, match="nothing is plugged in"):
        device.open()
    assert device.state().link is DeviceLink.CLOSED
    for call in (device.read, lambda: next(iter(device)), lambda: device.on_state(print)):
        with pytest.raises(NotOpenError, match="Device is not open: call open"):
            call()
    device.close()
    device.plugged.set()
    with device:
        assert device.connected.is_set()


def test_a_missing_device_may_be_waited_for():
    device = Device(Patient(), plugged=False)
    with device:
        assert device.state() == DeviceState(
            NEVER_S, DeviceLink.LOST, NEUTRAL, frozenset(), reason="nothing is plugged in"
        )
        device.plugged.set()
        assert device.connected.wait(PATIENCE_S)
        assert device.state().link is DeviceLink.NEEDS_NEUTRAL


def test_one_that_is_away_is_looked_for_within_a_second_however_long_it_was(monkeypatch):
    monkeypatch.setattr(reader_thread, "RETRY_FIRST_S", RETRY_FIRST_S)
    monkeypatch.setattr(reader_thread, "RETRY_LAST_S", RETRY_LAST_S)
    waits_s = []

    class Untold:
        """Stand-in for a monitor without kernel events; waiting takes no time."""

        def wait(self, timeout_s, stop):
            waits_s.append(timeout_s)
            if len(waits_s) == 20:
                device.plugged.set()
            return False

        def close(self):
            pass

    monkeypatch.setattr(reader_thread, "HotplugMonitor", Untold)
    with (device := Device(Patient(), plugged=False)):
        assert device.connected.wait(PATIENCE_S)
    assert waits_s[0] == RETRY_FIRST_S
    assert RETRY_FIRST_S < max(waits_s[:20]) < FOUND_WITHIN_S


def test_a_lost_device_is_opened_again():
    device = Device()
    with device:
        device.plugged.clear()
        assert device.released.wait(PATIENCE_S)
        assert device.diagnosis()[0] != "opened"
        device.plugged.set()
        assert device.connected.wait(PATIENCE_S)
        links = [link for link, _ in device._core.history]
    assert links[:2] == [DeviceLink.NEEDS_NEUTRAL, DeviceLink.LOST]
    reasons = {reason for _, reason in device._core.history}
    assert "unplugged, or it cannot be read (No such device)" in reasons


def test_a_reader_that_fails_says_so_and_tries_again():
    device = Device()
    device.error = ZeroDivisionError("a bug")
    with device:
        device.plugged.clear()
        assert device.released.wait(PATIENCE_S)
        device.plugged.set()
        assert device.connected.wait(PATIENCE_S)
        reasons = [reason for _, reason in device._core.history]
    assert "the reader failed: ZeroDivisionError('a bug')" in reasons


def test_whatever_opening_raises_is_an_error_of_the_driver(monkeypatch):
    def refuse():
        raise ValueError("strange")

    device = Device()
    monkeypatch.setattr(device, "_connect", refuse)
    with pytest.raises(DeviceAccessError, match="strange"):
        device.open()
    assert device.state().link is DeviceLink.CLOSED


def test_opening_that_is_interrupted_leaves_it_closed(monkeypatch):
    def interrupted():
        device._core.on_opened()
        raise KeyboardInterrupt

    device = Device(Patient())
    monkeypatch.setattr(device, "_connect", interrupted)
    with pytest.raises(KeyboardInterrupt):
        device.open()
    assert device.state().link is DeviceLink.CLOSED
    assert device.released.is_set()


def test_a_reader_that_hangs_is_not_joined_by_a_second_one(monkeypatch):
    monkeypatch.setattr(reader_thread, "JOIN_TIMEOUT_S", 0.01)
    device, go_on = Device(), threading.Event()
    monkeypatch.setattr(device, "_serve", lambda stop: go_on.wait(PATIENCE_S))
    device.open()
    device.close()
    with pytest.raises(DeviceAccessError, match="still being closed"):
        device.open()
    go_on.set()
    monkeypatch.setattr(reader_thread, "JOIN_TIMEOUT_S", PATIENCE_S)
    with device:
        assert device.state().link is DeviceLink.NEEDS_NEUTRAL


def test_it_may_be_closed_and_opened_by_many_threads_at_once():
    device = Device()
    failures = []

    def call(function):
        for _ in range(30):
            try:
                function()
            except Exception as error:
                failures.append(error)

    threads = [
        threading.Thread(target=call, args=(each,))
        for each in (device.open, device.close, device.open, device.close)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
        assert not thread.is_alive()
    assert failures == []
    device.close()
    device.close()
    assert device.state().link is DeviceLink.CLOSED
    device.open()
    assert device.connected.wait(PATIENCE_S)
    device.close()


def test_a_reader_that_closes_itself_ends(monkeypatch):
    device, known = Device(), threading.Event()

    def serve(stop):
        known.wait(PATIENCE_S)
        device.close()
        stop.wait(PATIENCE_S)

    monkeypatch.setattr(device, "_serve", serve)
    device.open()
    thread = device._thread
    known.set()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    device.close()


def test_one_that_its_reader_closes_is_closed_and_can_be_opened_again(monkeypatch):
    device, waits = Device(), threading.Event()

    def serve(stop):
        waits.wait(PATIENCE_S)
        device.close()
        stop.wait(PATIENCE_S)

    with monkeypatch.context() as patched:
        patched.setattr(device, "_serve", serve)
        device.open()
        states = iter(device)
        next(states)
        waits.set()
        assert next(states, None) is None
    assert device.state().link is DeviceLink.CLOSED
    device.connected.clear()
    with device:
        assert device.connected.is_set()


@pytest.mark.parametrize("closes", ["another thread", "the same thread"])
def test_closing_ends_every_iteration(closes):
    device, ended = Device(), []
    with device:
        for _ in range(3):
            device.on_state(lambda state: None)
        threads = [threading.Thread(target=lambda: ended.extend([*device])) for _ in range(3)]
        for thread in threads:
            thread.start()
        if closes == "another thread":
            closer = threading.Thread(target=device.close)
            closer.start()
            closer.join(PATIENCE_S)
        else:
            device.close()
        for thread in threads:
            thread.join(PATIENCE_S)
            assert not thread.is_alive()
