"""The spacenavd driver on real sockets: Cardan's own server, an old daemon, and Debian's."""

import contextlib
import math
import socket
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from cardan.drivers.spnav import Spnav, SpnavCore, SpnavOptions
from cardan.errors import CommandError, DeviceAccessError, DeviceNotFoundError, NotOpenError
from cardan.protocols.spnav.codes import Code
from cardan.protocols.spnav.records import RECORD_BYTES, encode_handshake
from cardan.sim_peers.base import SimulatedPeer
from cardan.types import ButtonEvent, DeviceFeedback, DeviceLink, DeviceState
from cardan_serial_mice.driver import SpaceMouseSerial
from cardan_serial_mice.protocol import serial_model_by_key
from cardan_spnav_server import (
    DeviceIdentity,
    SpnavServer,
    SpnavServerCore,
    SpnavServerOptions,
    core as server_core,
    identity_of,
)
from cardan_spnav_server.protocol import encode_button, encode_motion
from tests.serving import in_a_thread
from tests.spacenavd import TIMEOUT_S, PuckMotion, spacenavd
from tests.waiting import until

pytestmark = pytest.mark.matrix

REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def until_state(driver, wanted):
    """Return the first state of `driver` for which `wanted` is true."""
    return until(lambda: wanted(state := driver.state()) and state)


def live(state):
    return state.link is DeviceLink.LIVE


def lost(state):
    return state.link is DeviceLink.LOST


@pytest.fixture
def path(tmp_path):
    return tmp_path / "spnav.sock"


class Hand(SimulatedPeer):
    """Device served by Cardan's own spacenavd server."""

    endpoint = "the socket"

    def __init__(self, path, **options):
        self.leds = []
        self.axes = REST
        self.link = DeviceLink.LIVE
        self.edges = []
        self.core = SpnavServerCore(("a", "b", "c"), on_led=self.leds.append, **options)
        self.server = SpnavServer(self.core, SpnavServerOptions(socket=str(path)))

    def open(self):
        self.server.open()

    def step(self, until_s):
        while (now_s := time.monotonic()) < until_s:
            edges, self.edges = self.edges, []
            self.core.offer(DeviceState(now_s, self.link, self.axes, frozenset()), edges, now_s)
            self.server.step(min(until_s, now_s + 0.004))

    def close(self):
        self.server.close()

    def touch(self, driver):
        """Deflect, release, and wait until the driver is live."""
        start_s = time.monotonic()
        self.axes = (0.2, 0.0, 0.0, 0.0, 0.0, 0.0)
        until(
            lambda: time.monotonic() - driver.metrics()["motion_age_s"] >= start_s,
            "a report of the deflection",
        )
        self.axes = REST
        until_state(driver, live)


@contextlib.contextmanager
def opened(path, **options):
    driver = Spnav(SpnavOptions(socket=str(path), dead_zone=0.0, **options))
    driver.open()
    try:
        yield driver
    finally:
        driver.close()


@pytest.mark.real
@pytest.mark.judged(device="spacenavd client", transport="socket", by="Cardan's own server")
def test_from_one_cardan_to_another(path):
    with in_a_thread(Hand(path)) as hand, opened(path) as driver:
        assert driver.capabilities.buttons == ("button-0", "button-1", "button-2")
        assert driver.capabilities.feedback == {"led"}
        hand.touch(driver)
        hand.axes = (0.1, 0.2, 0.3, -0.4, -0.5, -0.6)
        state = until_state(driver, lambda state: state.axes != REST)
        assert state.axes == pytest.approx(hand.axes, abs=1 / 350)
        hand.edges = [ButtonEvent(0.0, "b", True)]
        until_state(driver, lambda state: state.buttons == {"button-1"})
        assert [event[1:] for event in driver.button_events()] == [("button-1", True)]
        hand.axes = REST
        until_state(driver, lambda state: state.axes == REST)
        driver.feedback(DeviceFeedback(led=False))
        until(lambda: hand.leds == [True, False], "the LED's change")
        with pytest.raises(CommandError, match="no rumble"):
            driver.feedback(DeviceFeedback(rumble=1.0))


@pytest.mark.real
def test_a_daemon_that_ends_is_found_again(path):
    with in_a_thread(Hand(path)) as hand:
        driver = Spnav(SpnavOptions(socket=str(path), dead_zone=0.0))
        driver.open()
        hand.touch(driver)
    state = until_state(driver, lost)
    assert "the daemon closed the connection" in state.reason or "no socket" in state.reason
    with in_a_thread(Hand(path)) as hand:
        until_state(driver, lambda state: state.link is DeviceLink.NEEDS_NEUTRAL)
        hand.touch(driver)
        driver.close()
    assert driver.state().link is DeviceLink.CLOSED
    driver.close()


def test_the_led_is_left_as_it_was(path):
    with in_a_thread(Hand(path)) as hand:
        with opened(path) as driver:
            driver.feedback(DeviceFeedback(led=False))
            until(lambda: hand.leds == [True, False], "the LED's change")
        # Set by the driver, without a client.
        until(lambda: hand.leds == [True, False, True, False], "the LED's change")


def test_an_old_daemon(path):
    """Version 0: no answer to the handshake, motion and buttons only."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(str(path))
    listener.listen()
    got = bytearray()
    connected = threading.Event()
    peer = []

    def accept():
        peer.append(listener.accept()[0])
        connected.set()
        with contextlib.suppress(OSError):
            while data := peer[0].recv(64):
                got.extend(data)

    thread = threading.Thread(target=accept)
    thread.start()
    with opened(path) as driver:
        assert connected.wait(TIMEOUT_S)
        assert driver.metrics()["version"] == 0
        assert driver.capabilities.buttons == ()
        assert driver.capabilities.feedback == frozenset()
        peer[0].sendall(encode_motion((0,) * 6, 0))
        until_state(driver, live)
        peer[0].sendall(encode_motion((0, 0, 175, 0, 0, 0), 16) + encode_button(5, True))
        state = until_state(driver, lambda state: state.buttons)
        assert state.axes == (0.5, 0, 0, 0, 0, 0)
        state = until_state(driver, lambda state: state.link is DeviceLink.STALE)
        assert (state.axes, state.buttons) == (REST, frozenset())
    thread.join()
    assert bytes(got) == encode_handshake(1) + b"\0\0\x80\x3f"
    peer[0].close()
    listener.close()


def test_nonsense_is_not_listened_to(path):
    """The driver becomes neutral and reconnects."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(str(path))
    listener.listen()

    def babble():
        peer, _ = listener.accept()
        listener.close()
        peer.sendall(encode_handshake(1) + encode_motion((0,) * 6, 0))
        peer.sendall(encode_motion((0, 0, 175, 0, 0, 0), 16))
        time.sleep(0.05)
        with contextlib.suppress(OSError):
            peer.sendall(b"\xff" * 32 * 60)
            while peer.recv(256):
                pass
        peer.close()

    thread = threading.Thread(target=babble)
    thread.start()
    driver = Spnav(SpnavOptions(socket=str(path), wait_for_device=True))
    driver.open()
    state = until_state(driver, lost)
    assert state.axes == REST
    thread.join(TIMEOUT_S)
    assert not thread.is_alive()
    assert driver.metrics()["malformed_records"] >= 50
    assert driver.protocol_errors()["malformed"] >= 50
    driver.close()


def test_a_daemon_that_hangs_up_at_once(path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(str(path))
        listener.listen()

        def refuse():
            listener.accept()[0].close()

        thread = threading.Thread(target=refuse)
        thread.start()
        driver = Spnav(SpnavOptions(socket=str(path)))
        with pytest.raises(DeviceAccessError, match="cannot use the daemon at"):
            driver.open()
        thread.join()
    assert driver.state().link is DeviceLink.CLOSED


def test_a_daemon_that_repeats_is_refused_until_that_is_changed(path, monkeypatch):
    settings = dict(server_core._SETTINGS)
    monkeypatch.setattr(server_core, "_SETTINGS", settings)
    monkeypatch.setenv("SPNAV_SOCKET", str(path))
    settings[Code.GCFG_REPEAT] = (250,)
    with in_a_thread(Hand(path)) as hand:
        with pytest.raises(DeviceAccessError, match="set repeat-interval = -1 there"):
            Spnav().open()
        (found,) = Spnav.find()
        assert "repeat-interval = 250" in found.obstacle
        with opened(path, wait_for_device=True) as driver:
            # Until the daemon has answered, the driver needs neutral, so that nothing moves.
            assert "repeat-interval = 250" in until_state(driver, lost).reason
            settings[Code.GCFG_REPEAT] = (-1,)
            until_state(driver, lambda state: state.link is DeviceLink.NEEDS_NEUTRAL)
            hand.touch(driver)
            hand.axes = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
            until_state(driver, lambda state: state.axes[0] > 0.4)
            settings[Code.GCFG_REPEAT] = (16,)
            assert until_state(driver, lost).axes == REST


# -- finding it ---------------------------------------------------------------------------------


def test_no_socket_is_named_with_the_way_out(path):
    with pytest.raises(DeviceNotFoundError, match=f"no socket at {path}: start spacenavd"):
        Spnav(SpnavOptions(socket=str(path))).open()


def test_it_can_be_waited_for(path):
    with opened(path, wait_for_device=True) as driver:
        assert "no socket" in driver.state().reason
        with in_a_thread(Hand(path)) as hand:
            until_state(driver, lambda state: state.link is DeviceLink.NEEDS_NEUTRAL)
            hand.touch(driver)


def test_find(path, monkeypatch):
    monkeypatch.setenv("SPNAV_SOCKET", str(path))
    assert Spnav.find() == []
    with in_a_thread(Hand(path)):
        (found,) = Spnav.find()
        assert (found.transport, found.path, found.obstacle) == ("spnav", str(path), "")
        assert found.name == "spacenavd"
    for device_type, reported in (
        (0x20F, "spacenavd (SpaceMouse Compact)"),
        (0x103, "spacenavd (Magellan SpaceMouse: better read without it, as spacemouse)"),
    ):
        with in_a_thread(Hand(path, identity=DeviceIdentity(device_type=device_type))):
            (found,) = Spnav.find()
            assert (found.name, found.obstacle) == (reported, "")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(path))
    (found,) = Spnav.find()
    assert "no program serves" in found.obstacle


def test_the_environment_names_the_socket(path, monkeypatch):
    monkeypatch.setenv("SPNAV_SOCKET", str(path))
    with in_a_thread(Hand(path)), Spnav() as driver:
        assert driver.capabilities.buttons


def test_feedback_before_open(path):
    with in_a_thread(Hand(path)):
        driver = Spnav(SpnavOptions(socket=str(path)))
        driver.open()
        driver.close()
        with pytest.raises(NotOpenError):
            driver.feedback(DeviceFeedback(led=True))


# -- judged by spacenavd ------------------------------------------------------------------------


@pytest.mark.judged(device="spacenavd client", transport="socket", by="Debian spacenavd")
def test_behind_spacenavd_and_a_serial_spacemouse(tmp_path):
    """Touch and release, then one axis after the other; the device vanishes during a push."""
    hand = PuckMotion()
    with spacenavd(tmp_path, "", motion=hand) as (path, old_client), answered(path) as driver:
        assert driver.metrics()["version"] == 1
        assert driver.metrics()["full_scale"] == 400.0
        assert driver.capabilities.feedback == {"led"}
        assert len(driver.capabilities.buttons) >= 9
        reported = OldClient(old_client)
        hand.do("set_axes", push(2, 0.2))
        reported.until(
            lambda state: reported.core.metrics(reported.now_s)["motion_age_s"] < math.inf
        )
        hand.do("set_axes", REST)
        reported.until(live)
        until_state(driver, live)
        first_live = len(reported.states)
        hand.do("press", FIRST_KEY)
        until_state(driver, lambda state: state.buttons)
        for axis in range(6):
            hand.do("set_axes", push(axis, 0.9))
            reported.until(lambda state, axis=axis: state.axes[axis] > 0.6)
        hand.do("set_axes", REST)
        reported.until(lambda state: state.axes == REST)
        hand.do("release", FIRST_KEY)
        reported.until(lambda state: not state.buttons)
        hand.do("set_axes", push(0, 0.9))
        reported.until(lambda state: state.axes[0] > 0.6)
        hand.do("unplug")
        # This daemon does not report an unplugged serial device.
        state = until_state(driver, lambda state: state.link is DeviceLink.STALE)
        assert state.axes == REST
        edges = []

        def released(_):
            edges.extend(driver.button_events())
            return len(edges) == 2

        until_state(driver, released)
        assert [event[1:] for event in edges] == [("button-0", True), ("button-0", False)]
        assert driver.metrics()["malformed_records"] == 0
        assert driver.metrics()["unasked_replies"] == 0
    assert all(map(live, reported.states[first_live:]))
    for axis in range(6):
        peak = max(reported.states, key=lambda state, axis=axis: state.axes[axis])
        assert peak.axes[axis] > 0.6
        assert max(abs(value) for i, value in enumerate(peak.axes) if i != axis) < 0.4
        assert min(state.axes[axis] for state in reported.states) > -0.1
    assert reported.core.metrics(reported.now_s)["malformed_records"] == 0
    assert reported.core.state(reported.now_s + 0.101).axes == REST


@pytest.mark.judged(device="spacenavd client", transport="socket", by="Debian spacenavd")
@pytest.mark.parametrize("interval", [40, 250, 999])
def test_what_spacenavd_repeats_by_itself_is_no_sign_of_life(tmp_path, monkeypatch, interval):
    settings = f"repeat-interval = {interval}\n"
    hand = PuckMotion()
    daemon = spacenavd(tmp_path, "", motion=hand, settings=settings, jitter_lsb=0)
    with daemon as (path, old_client), opened(path) as driver:
        reported = OldClient(old_client)
        hand.do("set_axes", push(2, 0.2))
        reported.until(
            lambda state: reported.core.metrics(reported.now_s)["motion_age_s"] < math.inf
        )
        hand.do("set_axes", REST)
        until_state(driver, live)
        hand.do("press", FIRST_KEY)
        until_state(driver, lambda state: state.buttons and live(state))
        core, on_bytes, seen = driver._core, driver._core.on_bytes, []

        def noting(data, now_s):
            on_bytes(data, now_s)
            seen.append(core.state(now_s).axes[2])

        monkeypatch.setattr(core, "on_bytes", noting)
        hand.do("set_axes", push(2, 0.6))

        def only_repeats(state):
            return not live(state) and "repeat-interval" in state.reason

        # Tests of the core check the time limit in virtual time. A stopped daemon is reported until
        # it repeats again.
        state = until_state(driver, only_repeats)
        assert (state.link, state.axes) == (DeviceLink.STALE, REST)
        assert state.buttons == frozenset()
        assert max(seen) > 0.5
        before = driver.metrics()
        until_state(driver, lambda _: driver.metrics()["repeats"] > before["repeats"] + 300)
        assert driver.state().link is DeviceLink.STALE
        assert driver.metrics()["silences"] == before["silences"]


@pytest.mark.judged(device="spacenavd client", transport="socket", by="Debian spacenavd")
def test_a_steady_hand_on_a_serial_device_needs_the_longer_silence(tmp_path):
    """With tremor of one count, some packets equal the previous ones and are not forwarded."""
    hand = PuckMotion()
    daemon = spacenavd(tmp_path, "", motion=hand, jitter_lsb=1)
    with daemon as (path, _), opened(path) as usual, opened(path, stale_after_s=1.0) as patient:
        assert '"spacemouse_serial"' in " ".join(usual.diagnosis())
        hand.do("set_axes", push(2, 0.2))
        for each in (usual, patient):
            until_state(each, lambda _, heard=each: heard.metrics()["motion_age_s"] < math.inf)
        hand.do("set_axes", REST)
        for each in (usual, patient):
            until_state(each, live)
        hand.do("set_axes", push(2, 0.6))
        until_state(patient, lambda state: state.axes[2] > 0.5)
        end_s = time.monotonic() + 3.0
        until_state(patient, lambda state: not live(state) or time.monotonic() > end_s)
        assert live(patient.state()), patient.diagnosis()
        assert usual.metrics()["silences"] > 0
        assert "stale_after_s = 1" in " ".join(patient.diagnosis())


@contextlib.contextmanager
def answered(path):
    """Yield a driver whose opening requests the daemon answered in time. A later answer would count
    as unexpected."""
    for _ in range(30):
        with opened(path) as driver:
            until_state(driver, lambda _: driver._core.settled)
            if driver.metrics()["version"] == 1 and not driver.metrics()["unanswered_requests"]:
                yield driver
                return
    raise AssertionError("the daemon is never in time")


FIRST_KEY = min(serial_model_by_key("magellan").buttons.items())[1]


def push(axis, deflection):
    """Return six axes of which one is deflected."""
    return tuple(deflection if i == axis else 0.0 for i in range(6))


class OldClient:
    """Client of version 0 that decodes the daemon's data, a record each 16 ms of virtual time."""

    def __init__(self, client):
        client.settimeout(TIMEOUT_S)
        self._client, self._left = client, b""
        self.core = SpnavCore(SpnavOptions(dead_zone=0.02, full_scale=400.0))
        self.now_s = 0.0
        self.core.on_opened(self.now_s)
        self.states = []
        """States after each record."""

    def until(self, wanted):
        """Read until `wanted` is true of the state after a record."""
        end_s = time.monotonic() + TIMEOUT_S
        while time.monotonic() < end_s:
            while len(self._left) < RECORD_BYTES:
                self._left += self._client.recv(65536)
            record, self._left = self._left[:RECORD_BYTES], self._left[RECORD_BYTES:]
            self.now_s += 0.016
            self.core.on_bytes(record, self.now_s)
            self.states.append(self.core.state(self.now_s))
            if wanted(self.states[-1]):
                return
        raise AssertionError(f"never told: {self.states[-1]}")


UNTOLD = {"rezero", "plus", "minus"}
"""Keys that spacenavd 1.1 does not report; it reports those of a Magellan from 1.2 on."""


def keys_of(model):
    """Return the keys of a serial device that spacenavd reports."""
    return [key for key in serial_model_by_key(model).buttons.values() if key not in UNTOLD]


def reported_presses(folder, model):
    """Press all keys of a serial device; return the buttons that the driver reports."""
    folder.mkdir()
    hand, edges = PuckMotion(), []
    with spacenavd(folder, "", motion=hand, model=model) as (path, _), answered(path) as driver:
        for key in keys_of(model):
            for act in ("press", "release"):
                hand.do(act, key)
                count = len(edges) + 1
                until_state(driver, lambda _, wanted=count: reported(driver, edges) == wanted)
    return [event.button for event in edges if event.pressed]


def reported(driver, edges):
    """Collect new edges of the driver; return the number of all of them."""
    edges.extend(driver.button_events())
    return len(edges)


@pytest.mark.judged(device="spacenavd client", transport="socket", by="Debian spacenavd")
def test_spacenavd_numbers_the_keys_of_serial_devices_as_our_server_does():
    models = ("magellan", "spaceball-2003", "spaceball-3003", "spaceball-4000")
    # A socket's path is limited to 107 bytes.
    with tempfile.TemporaryDirectory(prefix="cardan-") as name, ThreadPoolExecutor(4) as pool:
        reported = pool.map(lambda model: reported_presses(Path(name) / model, model), models)
        reported = dict(zip(models, reported, strict=True))
    for model in models:
        mouse = SpaceMouseSerial(model=model)
        served = identity_of(mouse).button_numbers
        assert reported[model] == [f"button-{served[key]}" for key in keys_of(model)]
