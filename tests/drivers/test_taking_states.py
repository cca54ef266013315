"""Access to a device's states: read(), iteration and callbacks, woken by the reader thread."""

import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass

import pytest

import cardan
from cardan.drivers import base, registry
from cardan.drivers.base import OperatorDevice
from cardan.errors import NotOpenError, OptionError
from cardan.types import NEUTRAL, DeviceCapabilities, DeviceLink, DeviceState
from cardan_omni.peer import OmniSettings, SimulatedOmni, available, library_path
from tests.docs_tables import ours
from tests.serving import demo_of, demonstrated, free_tcp_port, served

PATIENCE_S = 10.0


@dataclass(frozen=True)
class NoOptions:
    pass


class Hand(OperatorDevice):
    """Device whose state the test sets."""

    Options = NoOptions
    capabilities = DeviceCapabilities(False, (), frozenset(), False)

    def __init__(self, options=None):
        super().__init__(options)
        self.now = DeviceState(0.0, DeviceLink.CLOSED, NEUTRAL, frozenset())

    def open(self):
        self.now = self.now._replace(link=DeviceLink.LIVE)

    def close(self):
        self.now = self.now._replace(link=DeviceLink.CLOSED)
        self._close_count += 1
        self._notify()

    def diagnosis(self):
        return ()

    def state(self):
        return self.now

    def button_events(self):
        return ()

    def move(self, x):
        self.now = self.now._replace(stamp_s=self.now.stamp_s + 1.0, axes=NEUTRAL._replace(x=x))
        self._notify()


@pytest.fixture
def hand(monkeypatch):
    # Only _notify() wakes a reader.
    monkeypatch.setattr(base, "RECHECK_S", PATIENCE_S)
    with Hand() as hand:
        yield hand


def meanwhile(function):
    """Run `function` in a thread; return a function that waits for its result."""
    found = []
    thread = threading.Thread(target=lambda: found.append(function()))
    thread.start()

    def result():
        thread.join(PATIENCE_S)
        assert not thread.is_alive(), "the call did not return"
        return found[0]

    return result


def waits(device):
    """Return once a reader waits for the device."""
    end_s = time.monotonic() + PATIENCE_S
    while not device._changed._waiters:
        assert time.monotonic() < end_s
        time.sleep(0)


def test_read_gives_each_state_once(hand):
    assert hand.read(0.0) == hand.state()
    assert hand.read(0.0) is None
    hand.move(0.1)
    hand.move(0.2)
    assert hand.read().axes.x == 0.2
    assert hand.read(0.0) is None


def test_read_is_woken_by_a_new_state(hand):
    hand.read()
    state = meanwhile(hand.read)
    waits(hand)
    hand.move(0.5)
    assert state().axes.x == 0.5


def test_read_waits_no_longer_than_it_is_reported(hand):
    hand.read()
    begin_s = time.monotonic()
    assert hand.read(0.02) is None
    assert 0.02 <= time.monotonic() - begin_s < PATIENCE_S


def test_being_reported_nothing_new_is_no_state(hand):
    hand.read()
    state = meanwhile(hand.read)
    waits(hand)
    hand._notify()
    hand.move(0.5)
    assert state().axes.x == 0.5


def test_a_state_that_nobody_tells_of_is_seen_all_the_same(hand, monkeypatch):
    monkeypatch.setattr(base, "RECHECK_S", 0.005)
    hand.read()
    state = meanwhile(lambda: hand.read(PATIENCE_S))
    waits(hand)
    hand.now = hand.now._replace(link=DeviceLink.STALE, reason="silent")
    assert state().link is DeviceLink.STALE


def test_the_loss_of_a_device_is_a_state(hand):
    hand.read()
    hand.now = hand.now._replace(link=DeviceLink.LOST, reason="unplugged")
    assert hand.read().reason == "unplugged"


def test_closing_ends_a_read_that_waits(hand):
    hand.read()
    state = meanwhile(hand.read)
    waits(hand)
    hand.close()
    assert state() is None
    with pytest.raises(NotOpenError, match="Hand is not open: call open\\(\\)"):
        hand.read()


def test_it_can_be_read_again_after_it_was_opened_again(hand):
    hand.read()
    hand.close()
    hand.open()
    assert hand.read(0.0).link is DeviceLink.LIVE


def test_a_device_that_was_never_opened_has_nothing_to_read():
    hand = Hand()
    at_once = lambda: hand.on_state(print, own_thread=False)  # noqa: E731
    for call in (hand.read, lambda: next(iter(hand)), lambda: hand.on_state(print), at_once):
        with pytest.raises(NotOpenError):
            call()


def test_iteration_gives_each_new_state_until_the_device_is_closed(hand):
    seen = []
    for state in hand:
        seen.append(state.axes.x)
        if len(seen) == 3:
            hand.close()
        else:
            hand.move(float(len(seen)))
    assert seen == [0.0, 1.0, 2.0]


def test_an_iteration_does_not_go_on_in_the_next_opening(hand):
    states = iter(hand)
    next(states)
    hand.close()
    hand.open()
    assert list(states) == []


def test_every_consumer_gets_every_state(hand):
    one, other = iter(hand), iter(hand)
    next(one), next(other), hand.read()
    hand.move(1.0)
    assert next(one) == next(other) == hand.read(0.0)


def test_a_callback_is_called_in_a_thread_of_its_own(hand):
    calls = []
    called = threading.Semaphore(0)

    def callback(state):
        calls.append((state.axes.x, threading.current_thread()))
        called.release()

    stop = hand.on_state(callback)
    assert called.acquire(timeout=PATIENCE_S)
    hand.move(1.0)
    assert called.acquire(timeout=PATIENCE_S)
    stop()
    hand.move(2.0)
    assert [x for x, _ in calls] == [0.0, 1.0]
    (thread,) = {thread for _, thread in calls}
    assert thread is not threading.current_thread()
    assert not thread.is_alive()
    stop()


def test_a_callback_is_called_in_the_drivers_thread_on_request(hand):
    calls = []
    stop = hand.on_state(
        lambda state: calls.append((state.axes.x, threading.current_thread())), own_thread=False
    )
    driver = threading.Thread(target=hand.move, args=(1.0,))
    driver.start()
    driver.join()
    assert calls == [(0.0, threading.current_thread()), (1.0, driver)]
    stop()
    hand.move(2.0)
    assert len(calls) == 2
    stop()


def test_calls_in_the_drivers_thread_end_when_the_device_is_closed(hand):
    calls = []
    hand.on_state(calls.append, own_thread=False)
    hand.close()
    hand.open()
    hand.move(1.0)
    assert len(calls) == 1


def test_a_slow_callback_holds_up_nobody_and_gets_the_newest_state(hand):
    entered, go_on, last = threading.Event(), threading.Event(), threading.Event()
    seen = []

    def callback(state):
        seen.append(state.axes.x)
        entered.set()
        assert go_on.wait(PATIENCE_S)
        if state.axes.x == 9.0:
            last.set()

    stop = hand.on_state(callback)
    assert entered.wait(PATIENCE_S)
    for x in range(10):
        hand.move(float(x))
    assert hand.read(0.0).axes.x == 9.0
    go_on.set()
    assert last.wait(PATIENCE_S)
    stop()
    assert seen == [0.0, 9.0]


def test_a_callback_may_end_its_own_calls(hand):
    ended = threading.Event()
    stops = []
    made = threading.Event()

    def callback(state):
        assert made.wait(PATIENCE_S)
        stops[0]()
        ended.set()

    stops.append(hand.on_state(callback))
    made.set()
    assert ended.wait(PATIENCE_S)
    hand.move(1.0)
    assert hand.read(0.0).axes.x == 1.0


def test_an_exception_ends_the_calls_and_is_reported_and_the_device_goes_on(hand, monkeypatch):
    reported = threading.Event()
    errors = []

    def hook(args):
        errors.append((str(args.exc_value), args.thread.name))
        reported.set()

    monkeypatch.setattr(threading, "excepthook", hook)
    hand.on_state(lambda state: 1 / 0)
    assert reported.wait(PATIENCE_S)
    assert errors == [("division by zero", "cardan-hand-callback")]
    hand.move(1.0)
    assert hand.read(0.0).axes.x == 1.0
    assert len(errors) == 1


def test_closing_ends_the_calls(hand):
    before = threading.active_count()
    stop = hand.on_state(lambda state: None)
    waits(hand)
    assert threading.active_count() == before + 1
    hand.close()
    stop()
    assert threading.active_count() == before


# -- all devices -------------------------------------------------------------------------------

DEVICES = [name for name, kind in ours(registry).items() if issubclass(kind, OperatorDevice)]


def check_it_wakes_its_reader(device):
    """Check that a reader and a callback get each new state at once, not only after RECHECK_S,
    which has to be PATIENCE_S here."""
    assert base.RECHECK_S == PATIENCE_S
    states = [device.read(PATIENCE_S / 2) for _ in range(10)]
    called = threading.Semaphore(0)
    device.on_state(lambda state: called.release())
    for _ in range(3):
        assert called.acquire(timeout=PATIENCE_S)
    assert None not in states
    assert len(set(states)) == len(states)
    assert states[-1].stamp_s > states[0].stamp_s


@contextmanager
def simulated(name, folder):
    """Yield options that lead to a simulated device, with its demo's settings if these work
    here."""
    if name == "omni":
        if not available():
            pytest.skip("the simulated libHD was not compiled")
        SimulatedOmni(OmniSettings()).hand((0.0, 0.0, 0.0))
        yield {"library": str(library_path())}
    elif name == "jr3_can":  # The multicast of its demo is not available everywhere.
        port = free_tcp_port()
        with served("sim", "jr3", "--serve-socketcand", "--port", str(port), "--script", "wiggle"):
            yield {"interface": "socketcand", "host": "127.0.0.1", "port": port}
    else:
        with demonstrated(demo_of(name), folder) as tables:
            yield {key: value for key, value in tables["device"].items() if key != "driver"}


@pytest.mark.matrix
@pytest.mark.parametrize("name", DEVICES)
def test_who_reads_a_device_is_woken_by_its_reader(name, tmp_path, monkeypatch):
    monkeypatch.setattr(base, "RECHECK_S", PATIENCE_S)
    with simulated(name, tmp_path) as options, cardan.open_device(name, **options) as device:
        check_it_wakes_its_reader(device)


@pytest.mark.parametrize("timeout_s", [float("nan"), float("inf"), -1.0, "x", True, 10**400])
def test_a_time_to_wait_that_is_none_is_refused(hand, timeout_s):
    with pytest.raises(OptionError, match=r"^timeout_s: .* a finite number of seconds, 0 or more"):
        hand.read(timeout_s)


@pytest.mark.parametrize("callback", [3, None, "print"])
def test_a_callback_that_cannot_be_called_is_refused_at_once(hand, callback):
    before = threading.active_count()
    with pytest.raises(OptionError, match=r"^callback: .* a function that takes a state"):
        hand.on_state(callback)
    assert threading.active_count() == before


class OldHand(Hand):
    """Driver with its own __init__, which does not call that of its base."""

    def __init__(self, options=None):
        self.options = options
        self.now = DeviceState(0.0, DeviceLink.CLOSED, NEUTRAL, frozenset())


def test_a_driver_with_an_init_of_its_own_is_read_like_any():
    seen = threading.Event()
    with OldHand() as hand:
        assert hand.read(PATIENCE_S).link is DeviceLink.LIVE
        assert hand.read(0.0) is None
        assert next(iter(hand)).link is DeviceLink.LIVE
        stop = hand.on_state(lambda state: state.axes.x == 0.5 and seen.set())
        hand.move(0.5)
        assert seen.wait(PATIENCE_S)
        stop()
    with hand:
        assert hand.read(PATIENCE_S).axes.x == 0.5


def test_all_wait_for_the_same_change():
    hand, all_there = OldHand(), threading.Barrier(8)

    def ask():
        all_there.wait()
        return hand._changed

    results = [meanwhile(ask) for _ in range(8)]
    assert len({id(result()) for result in results}) == 1
