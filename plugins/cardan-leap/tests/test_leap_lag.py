"""Late frames: estimate of their delay, and loss of the link because of it."""

from __future__ import annotations

import collections
import contextlib
import select
import socket
import threading
import time

import pytest
from hypothesis import given, strategies as st

from cardan.types import DeviceLink
from cardan_leap.driver import Leap, LeapOptions, core
from cardan_leap.driver.connection import connect
from cardan_leap.driver.lag import Lag
from cardan_leap.peer import LeapPeer, LeapPeerOptions
from cardan_leap.protocol import TrackingFrame
from leap_frames import PERIOD_S, PLUGGED, engaged, hand
from tests.serving import in_a_thread
from tests.waiting import until

pytestmark = pytest.mark.matrix

EPOCH_S = 56_257.0
HELD = {"still": {}, "open": {}, "grab": {"grab_strength": 1.0}, "pinch": {"pinch_strength": 1.0}}
REST = {"still": None, "open": {"grab_strength": 1.0}, "grab": {}, "pinch": {}}


def stamp_us(stamp_s):
    return round((EPOCH_S + stamp_s) * 1e6)


# -- the estimate ---------------------------------------------------------------------------------


@given(st.lists(st.floats(0.0, 5.0), min_size=1, max_size=60))
def test_the_lag_is_that_beyond_the_smallest(delays_s):
    lag = Lag()
    least_s = None
    for step, delay_s in enumerate(delays_s):
        now_s = 10.0 + step * PERIOD_S + delay_s
        found_s = lag.update(stamp_us(step * PERIOD_S), now_s)
        least_s = delay_s if least_s is None else min(least_s, delay_s)
        # The estimate allows for a drift of 1 ms a second.
        assert found_s == pytest.approx(delay_s - least_s, abs=1e-3 * (5.0 + len(delays_s)))
        assert found_s >= 0.0


@pytest.mark.parametrize("drift", [-600e-6, 600e-6])
def test_clocks_drift_apart(drift):
    lag = Lag()
    for step in range(4000):
        now_s = 1.0 * step
        assert lag.update(stamp_us(now_s * (1.0 + drift)), now_s) < 0.01


def test_a_delay_that_lasts_is_not_forgotten():
    lag = Lag()
    lag.update(stamp_us(0.0), 0.0)
    for step in range(1, 600 * 10):
        assert lag.update(stamp_us(0.1 * step), 0.1 * step + 1.0) > 0.1


def test_another_clock_shows_by_stamps_that_go_back():
    lag = Lag()
    lag.update(stamp_us(5.0), 0.0)
    assert not lag.is_another_clock(stamp_us(5.01))
    assert not lag.is_another_clock(stamp_us(4.95))
    assert not lag.is_another_clock(stamp_us(5000.0))
    assert lag.is_another_clock(stamp_us(4.8))
    lag.reset()
    assert not lag.is_another_clock(stamp_us(0.0))
    assert lag.update(stamp_us(0.0), 7.0) == 0.0


# -- reaction of the core -------------------------------------------------------------------------


def tell(bench, *hands, late_s=0.0):
    """Send a frame one period later, measured `late_s` ago."""
    bench.now_s += PERIOD_S
    bench.frame_id += 1
    bench.tell(TrackingFrame(bench.frame_id, round(1e6 * (bench.now_s - late_s)), 110.0, hands))
    return bench.state


def rest_of(clutch):
    return [] if REST[clutch] is None else [hand(**REST[clutch])]


@pytest.mark.parametrize("clutch", HELD)
@pytest.mark.parametrize("posture", ["held", "rest"])
def test_a_delay_that_grows_ends_in_stale(clutch, posture):
    """Models a network with four fifths of the needed capacity: all frames arrive, in order."""
    bench = engaged(clutch)
    hands = [hand(**HELD[clutch])]
    for step in range(1, 200):
        late_s = 0.2 * step * PERIOD_S
        state = tell(
            bench, *(hands if late_s < 0.1 else hands * (posture == "held")), late_s=late_s
        )
        if state.link is DeviceLink.LIVE:
            assert bench.now_s - state.stamp_s == pytest.approx(late_s, abs=0.002)
        if late_s > 0.1:
            assert state.link is DeviceLink.STALE
            assert "late" in state.reason
            assert (state.pose, state.buttons) == (None, frozenset())
    assert bench.core.metrics(bench.now_s)["frame_lag_s"] == pytest.approx(
        0.2 * 199 * PERIOD_S, 0.02
    )
    assert any(
        "frames that came more than 0.09 s late" in w for w in bench.core.diagnosis(bench.now_s)
    )


@pytest.mark.parametrize("clutch", HELD)
def test_late_frames_are_no_neutral(clutch):
    bench = engaged(clutch)
    bench.wait(2.0)
    # Two seconds of frames were queued, in which the hand came to rest and took the clutch again.
    for step in range(220):
        hands = rest_of(clutch) if 50 < step < 150 else [hand(**HELD[clutch])]
        late_s = 2.0 - step * PERIOD_S
        bench.now_s -= 0.99 * PERIOD_S
        state = tell(bench, *hands, late_s=late_s)
        assert state.link is not DeviceLink.LIVE
        assert state.link is DeviceLink.STALE or late_s <= 0.12
    for _ in range(50):
        assert tell(bench, hand(**HELD[clutch])).link is DeviceLink.NEEDS_NEUTRAL
    assert tell(bench, *rest_of(clutch)).link is DeviceLink.LIVE


def test_delay_and_silence_add_up():
    bench = engaged()
    assert tell(bench, hand(), late_s=0.08).link is DeviceLink.LIVE
    assert bench.wait(0.005).link is DeviceLink.LIVE
    assert bench.wait(0.010).link is DeviceLink.STALE


def test_a_delay_that_lasts_takes_a_new_connection():
    bench = engaged()
    bench.wait(0.5)
    for _ in range(round(2.9 / PERIOD_S)):
        tell(bench, late_s=0.5)
        assert bench.core.failure(bench.now_s) == ""
    for _ in range(30):
        tell(bench, late_s=0.5)
    assert "have come late for 3 s, now by 0.5 s" in bench.core.failure(bench.now_s)
    bench.core.on_lost("late", bench.now_s)
    bench.core.on_opened(bench.now_s)
    bench.tell(PLUGGED)
    assert bench.core.failure(bench.now_s) == ""
    # Reconnecting did not help: frames are still late.
    assert tell(bench, late_s=0.5).link is DeviceLink.STALE
    # It helped.
    assert tell(bench).link is DeviceLink.NEEDS_NEUTRAL
    bench.now_s += 0.02
    assert tell(bench).link is DeviceLink.LIVE


def test_a_service_that_restarts_has_another_clock():
    bench = engaged()
    bench.core.on_lost("gone", bench.now_s)
    bench.core.on_opened(bench.now_s)
    bench.tell(PLUGGED)
    assert tell(bench, late_s=50.0).link is DeviceLink.LIVE
    assert tell(bench, late_s=50.0).link is DeviceLink.LIVE


def test_a_clock_that_is_set_back_needs_neutral():
    bench = engaged("grab")
    grabbing = hand(**HELD["grab"])
    state = tell(bench, grabbing, late_s=50.0)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    for _ in range(20):
        assert tell(bench, grabbing, late_s=50.0).link is DeviceLink.NEEDS_NEUTRAL
    assert tell(bench, hand(), late_s=50.0).link is DeviceLink.LIVE
    assert any("clock was set back" in words for words in bench.core.diagnosis(bench.now_s))


def test_a_stamp_of_nonsense_is_no_lasting_harm():
    bench = engaged()
    tell(bench, hand(), late_s=-1e20)
    assert tell(bench, hand()).link is DeviceLink.NEEDS_NEUTRAL
    bench.now_s += 0.02
    assert tell(bench).link is DeviceLink.LIVE


def test_frames_without_a_stamp_are_no_sign_of_life():
    bench = engaged()
    for _ in range(12):
        bench.now_s += PERIOD_S
        bench.frame_id += 1
        bench.tell(TrackingFrame(bench.frame_id, None, 110.0, (hand(),)))
    assert bench.state.link is DeviceLink.STALE
    assert bench.core.metrics(bench.now_s)["undated"] == 12


# -- reading everything available -----------------------------------------------------------------


def test_a_reader_that_was_held_up_reads_all_that_has_come(tmp_path):
    script = tmp_path / "hand.script"
    script.write_text("0 enter right\n")
    with in_a_thread(LeapPeer(LeapPeerOptions(port=0, script=str(script)))) as peer:
        connection, _, _ = connect("127.0.0.1", peer.backend.port, 6, 2.0)
        connection.send('{"background":true}')
        connection.receive(2.0)
        sent = peer.device.frames_sent
        end_s = time.monotonic() + 10.0
        while peer.device.frames_sent < sent + 60:  # some 300 kB
            assert time.monotonic() < end_s
            time.sleep(0.005)
        received = connection.receive(1.0)
        connection.close()
        assert sum(map(len, received)) > 1 << 16  # more than one read


class DelayLine:
    """TCP relay that delays the service's data by `delay_s`, from scratch for each connection."""

    def __init__(self, port):
        self._port = port
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self.delay_s = 0.0
        self.connections = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self):
        self._ended.set()
        self._thread.join()
        self._server.close()

    def _run(self):
        self._server.settimeout(0.01)
        while not self._ended.is_set():
            try:
                client, _ = self._server.accept()
            except TimeoutError:
                continue
            self.connections += 1
            self.delay_s = 0.0
            service = socket.create_connection(("127.0.0.1", self._port))
            with client, service, contextlib.suppress(OSError):
                self._relay(client, service)

    def _relay(self, client, service):
        waiting = collections.deque()
        while not self._ended.is_set():
            ready, _, _ = select.select([client, service], [], [], 0.002)
            if client in ready:
                data = client.recv(1 << 16)
                if not data:
                    return
                service.sendall(data)
            if service in ready:
                waiting.append((time.monotonic(), service.recv(1 << 16)))
            while waiting and time.monotonic() - waiting[0][0] >= self.delay_s:
                client.sendall(waiting.popleft()[1])


@pytest.mark.judged(device="Leap Motion", transport="WebSocket", by="simulated peer")
def test_a_slow_network_ends_in_stale_and_is_left_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(core, "CONNECT_ANEW_S", 0.2)
    script = tmp_path / "hand.script"
    script.write_text("0.1 enter right\n1.5 leave right\n1.7 loop\n")

    def until_state(condition):
        return until(lambda: condition(leap.state()), "the state")

    with (
        in_a_thread(LeapPeer(LeapPeerOptions(port=0, script=str(script)))) as peer,
        contextlib.closing(DelayLine(peer.backend.port)) as line,
        Leap(LeapOptions(port=line.port)) as leap,
    ):
        until_state(lambda state: "clutch" in state.buttons)
        before = line.connections
        line.delay_s = 0.5
        until_state(lambda state: state.link is DeviceLink.STALE and "late" in state.reason)
        assert leap.state().pose is None
        until_state(lambda state: "have come late for" in state.reason)
        until_state(lambda state: "clutch" in state.buttons)
        assert line.connections > before
