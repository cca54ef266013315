"""The spacenavd driver at real sockets: Cardan's own server, an old daemon, and Debian's."""

import contextlib
import socket
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from cardan.drivers.spacemouse import SpaceMouse
from cardan.drivers.spnav import Spnav, SpnavCore, SpnavOptions
from cardan.errors import CommandError, DeviceAccessError, DeviceNotFoundError, NotOpenError
from cardan.gateway.spnav import (
    DeviceIdentity,
    SpnavServer,
    SpnavServerCore,
    SpnavServerOptions,
    core as server_core,
    identity_of,
)
from cardan.protocols.connexion_serial import serial_model_by_key
from cardan.protocols.spnav import (
    RECORD_BYTES,
    Code,
    encode_button,
    encode_handshake,
    encode_motion,
)
from cardan.sim_peers.base import SimulatedPeer
from cardan.types import ButtonEvent, DeviceFeedback, DeviceLink, DeviceState
from tests.serving import in_a_thread
from tests.spacenavd import TIMEOUT_S, spacenavd

pytestmark = pytest.mark.matrix

REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def until(driver, wanted):
    """The first state of `driver` that is `wanted`."""
    deadline_s = time.monotonic() + TIMEOUT_S
    while not wanted(state := driver.state()):
        assert time.monotonic() < deadline_s, (state, driver.diagnosis())
        time.sleep(0.002)
    return state


def live(state):
    return state.link is DeviceLink.LIVE


def lost(state):
    return state.link is DeviceLink.LOST


@pytest.fixture
def path(tmp_path):
    return tmp_path / "spnav.sock"


class Hand(SimulatedPeer):
    """A served device, as Cardan's own server has it."""

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
        """Deflect, let go, and wait until the driver believes in it."""
        start_s = time.monotonic()
        self.axes = (0.2, 0.0, 0.0, 0.0, 0.0, 0.0)
        deadline_s = time.monotonic() + TIMEOUT_S
        while time.monotonic() - driver.metrics()["motion_age_s"] < start_s:
            assert time.monotonic() < deadline_s
            time.sleep(0.005)
        self.axes = REST
        until(driver, live)


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
        state = until(driver, lambda state: state.axes != REST)
        assert state.axes == pytest.approx(hand.axes, abs=1 / 350)
        hand.edges = [ButtonEvent(0.0, "b", True)]
        until(driver, lambda state: state.buttons == {"button-1"})
        assert [event[1:] for event in driver.button_events()] == [("button-1", True)]
        hand.axes = REST
        until(driver, lambda state: state.axes == REST)
        driver.feedback(DeviceFeedback(led=False))
        deadline_s = time.monotonic() + TIMEOUT_S
        while hand.leds != [True, False]:
            assert time.monotonic() < deadline_s
            time.sleep(0.005)
        with pytest.raises(CommandError, match="no rumble"):
            driver.feedback(DeviceFeedback(rumble=1.0))


def test_unplugging_behind_the_daemon_and_plugging_in_again(path):
    with in_a_thread(Hand(path)) as hand, opened(path) as driver:
        hand.touch(driver)
        hand.axes = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
        until(driver, lambda state: state.axes[0] > 0.4)
        hand.link = DeviceLink.LOST
        state = until(driver, lost)
        assert state.axes == REST
        assert "unplugged" in state.reason
        hand.link, hand.axes = DeviceLink.LIVE, REST
        until(driver, lambda state: state.link is DeviceLink.NEEDS_NEUTRAL)
        hand.touch(driver)


@pytest.mark.real
def test_a_daemon_that_ends_is_found_again(path):
    with in_a_thread(Hand(path)) as hand:
        driver = Spnav(SpnavOptions(socket=str(path), dead_zone=0.0))
        driver.open()
        hand.touch(driver)
    state = until(driver, lost)
    assert "the daemon closed the connection" in state.reason or "no socket" in state.reason
    with in_a_thread(Hand(path)) as hand:
        until(driver, lambda state: state.link is DeviceLink.NEEDS_NEUTRAL)
        hand.touch(driver)
        driver.close()
    assert driver.state().link is DeviceLink.CLOSED
    driver.close()


def test_the_led_is_left_as_it_was(path):
    with in_a_thread(Hand(path)) as hand:
        with opened(path) as driver:
            driver.feedback(DeviceFeedback(led=False))
            deadline_s = time.monotonic() + TIMEOUT_S
            while hand.leds != [True, False]:
                assert time.monotonic() < deadline_s
                time.sleep(0.005)
        deadline_s = time.monotonic() + TIMEOUT_S
        while hand.leds != [True, False, True, False]:  # by itself, and nobody connected
            assert time.monotonic() < deadline_s
            time.sleep(0.005)


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
        until(driver, live)
        peer[0].sendall(encode_motion((0, 0, 175, 0, 0, 0), 16) + encode_button(5, True))
        state = until(driver, lambda state: state.buttons)
        assert state.axes == (0.5, 0, 0, 0, 0, 0)
        state = until(driver, lambda state: state.link is DeviceLink.STALE)
        assert (state.axes, state.buttons) == (REST, frozenset())
    thread.join()
    assert bytes(got) == encode_handshake(1) + b"\0\0\x80\x3f"
    peer[0].close()
    listener.close()


def test_nonsense_is_not_listened_to(path):
    """Neutral, and connected anew."""
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
    state = until(driver, lost)
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
    assert driver.state().link is DeviceLink.LOST


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
            # Until the daemon has answered it needs neutral, which moves nothing either.
            assert "repeat-interval = 250" in until(driver, lost).reason
            settings[Code.GCFG_REPEAT] = (-1,)
            until(driver, lambda state: state.link is DeviceLink.NEEDS_NEUTRAL)
            hand.touch(driver)
            hand.axes = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
            until(driver, lambda state: state.axes[0] > 0.4)
            settings[Code.GCFG_REPEAT] = (16,)
            assert until(driver, lost).axes == REST


# -- finding it ---------------------------------------------------------------------------------


def test_no_socket_is_named_with_the_way_out(path):
    with pytest.raises(DeviceNotFoundError, match=f"no socket at {path}: start spacenavd"):
        Spnav(SpnavOptions(socket=str(path))).open()


def test_it_can_be_waited_for(path):
    with opened(path, wait_for_device=True) as driver:
        assert "no socket" in driver.state().reason
        with in_a_thread(Hand(path)) as hand:
            until(driver, lambda state: state.link is DeviceLink.NEEDS_NEUTRAL)
            hand.touch(driver)


def test_find(path, monkeypatch):
    monkeypatch.setenv("SPNAV_SOCKET", str(path))
    assert Spnav.find() == []
    with in_a_thread(Hand(path)):
        (found,) = Spnav.find()
        assert (found.transport, found.path, found.obstacle) == ("spnav", str(path), "")
        assert found.name == "spacenavd"
    for device_type, told in (
        (0x20F, "spacenavd (SpaceMouse Compact)"),
        (0x103, "spacenavd (Magellan SpaceMouse: better read without it, as spacemouse)"),
    ):
        with in_a_thread(Hand(path, identity=DeviceIdentity(device_type=device_type))):
            (found,) = Spnav.find()
            assert (found.name, found.obstacle) == (told, "")
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

SCRIPT = """
    0.30 axes 0 0 0.2 0 0 0 over 0.1
    0.50 neutral over 0.1
    0.80 press first
    0.90 axes 0.9 0 0 0 0 0 over 0.35
    1.25 axes 0 0.9 0 0 0 0 over 0.35
    1.60 axes 0 0 0.9 0 0 0 over 0.35
    1.95 axes 0 0 0 0.9 0 0 over 0.35
    2.30 axes 0 0 0 0 0.9 0 over 0.35
    2.65 axes 0 0 0 0 0 0.9 over 0.35
    3.00 neutral over 0.3
    3.50 release first
    3.60 axes 0.9 0 0 0 0 0 over 0.6
    4.10 unplug
"""
"""Touch and let go once the daemon has found the device; then one axis after the other, and gone in
the middle of a push."""


@pytest.mark.judged(device="spacenavd client", transport="socket", by="Debian spacenavd")
def test_behind_spacenavd_and_a_serial_spacemouse(tmp_path):
    with spacenavd(tmp_path, SCRIPT) as (path, old_client):
        with opened(path) as driver:
            watch(driver)
        old_client.setblocking(False)
        records = old_client.recv(65536)
    replay(records)


HELD = """
    0.30 axes 0 0 0.2 0 0 0 over 0.1
    0.50 neutral over 0.1
    0.80 press first
    0.90 axes 0 0 0.6 0 0 0
    9.00 neutral
"""
"""Touch and let go; then hold quite still, of which the daemon passes on nothing."""


@pytest.mark.judged(device="spacenavd client", transport="socket", by="Debian spacenavd")
@pytest.mark.parametrize("interval", [40, 250, 999])
def test_what_spacenavd_repeats_by_itself_is_no_sign_of_life(tmp_path, interval):
    settings = f"repeat-interval = {interval}\n"
    daemon = spacenavd(tmp_path, HELD, settings=settings, jitter_lsb=0)
    with daemon as (path, _), opened(path) as driver:
        until(driver, lambda state: state.axes[2] > 0.5)
        pushed_s = time.monotonic()
        state = until(driver, lambda state: not live(state))
        assert time.monotonic() - pushed_s < 1.0  # 0.1 s, were this machine not busy
        assert (state.link, state.axes) == (DeviceLink.STALE, REST)
        assert state.buttons == frozenset()
        assert "repeat-interval" in state.reason
        before = driver.metrics()
        until(driver, lambda _: driver.metrics()["repeats"] > before["repeats"] + 300)
        assert driver.state().link is DeviceLink.STALE
        assert driver.metrics()["silences"] == before["silences"]


@pytest.mark.judged(device="spacenavd client", transport="socket", by="Debian spacenavd")
def test_a_steady_hand_on_a_serial_device_needs_the_longer_silence(tmp_path):
    """A hand that trembles by one count: some packets are like those before, and not passed on."""
    daemon = spacenavd(tmp_path, HELD, jitter_lsb=1)
    with daemon as (path, _), opened(path) as usual, opened(path, stale_after_s=1.0) as patient:
        assert 'transport = "serial"' in " ".join(usual.diagnosis())
        until(patient, lambda state: state.axes[2] > 0.5)
        end_s = time.monotonic() + 3.0
        until(patient, lambda state: not live(state) or time.monotonic() > end_s)
        assert live(patient.state()), patient.diagnosis()
        assert usual.metrics()["silences"] > 0
        assert "stale_after_s = 1" in " ".join(patient.diagnosis())


UNTOLD = {"rezero", "plus", "minus"}
"""Keys that spacenavd 1.1 does not tell of; those of a Magellan it tells of from 1.2 on."""


def keys_of(model):
    """The keys of a serial device that spacenavd tells of."""
    return [key for key in serial_model_by_key(model).buttons.values() if key not in UNTOLD]


def presses(model):
    """A script that presses all keys of a device, one after the other."""
    keys = keys_of(model)
    return "".join(
        f"{0.5 + 0.2 * at:.1f} press {key}\n{0.6 + 0.2 * at:.1f} release {key}\n"
        for at, key in enumerate(keys)
    )


def told_presses(folder, model):
    """The buttons that the driver has of a hand that presses all keys of a serial device."""
    folder.mkdir()
    edges = []

    def all_were_told(_):
        edges.extend(driver.button_events())
        return len(edges) == 2 * len(keys_of(model))

    with spacenavd(folder, presses(model), model=model) as (path, _), opened(path) as driver:
        until(driver, all_were_told)
    return [event.button for event in edges if event.pressed]


@pytest.mark.judged(device="spacenavd client", transport="socket", by="Debian spacenavd")
def test_spacenavd_numbers_the_keys_of_serial_devices_as_our_server_does():
    models = ("magellan", "spaceball-2003", "spaceball-3003", "spaceball-4000")
    # A socket's path has room for 107 bytes.
    with tempfile.TemporaryDirectory(prefix="cardan-") as name, ThreadPoolExecutor(4) as pool:
        told = pool.map(lambda model: told_presses(Path(name) / model, model), models)
        told = dict(zip(models, told, strict=True))
    for model in models:
        mouse = SpaceMouse(transport="serial", path="PORT", model=model)
        served = identity_of(mouse).button_numbers
        assert told[model] == [f"button-{served[key]}" for key in keys_of(model)]


def watch(driver):
    """What does not hang on this machine's being quick, in real time."""
    assert driver.metrics()["version"] == 1
    assert driver.metrics()["full_scale"] == 400.0
    assert driver.capabilities.feedback == {"led"}
    assert len(driver.capabilities.buttons) >= 9
    edges = []
    deadline_s = time.monotonic() + 2.0 * TIMEOUT_S
    # This daemon says nothing when a serial device is unplugged.
    while len(edges) < 2 or driver.metrics()["motion_age_s"] < 0.8:
        assert time.monotonic() < deadline_s, (driver.state(), driver.diagnosis())
        edges += driver.button_events()
        time.sleep(0.01)
    assert driver.state().link is DeviceLink.STALE
    assert driver.state().axes == REST
    assert [event[1:] for event in edges] == [("button-0", True), ("button-0", False)]
    assert driver.metrics()["malformed_records"] == 0
    assert driver.metrics()["unasked_replies"] == 0


def replay(records):
    """What the daemon sent to a client of version 0, one record each 16 ms of virtual time."""
    core = SpnavCore(SpnavOptions(dead_zone=0.02, full_scale=400.0))
    now_s = 0.0
    core.on_opened(now_s)
    states = []
    for at in range(0, len(records), RECORD_BYTES):
        now_s += 0.016
        core.on_bytes(records[at : at + RECORD_BYTES], now_s)
        states.append(core.state(now_s))
    first_live = next(index for index, state in enumerate(states) if live(state))
    assert all(map(live, states[first_live:]))
    for axis in range(6):
        peak = max(states, key=lambda state, axis=axis: state.axes[axis])
        assert peak.axes[axis] > 0.6
        assert max(abs(value) for i, value in enumerate(peak.axes) if i != axis) < 0.4
        assert min(state.axes[axis] for state in states) > -0.1
    assert core.metrics(now_s)["malformed_records"] == 0
    state = core.state(now_s + 0.101)
    assert state.axes == REST
