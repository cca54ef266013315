"""The spacenavd-compatible socket: access, service, and its cost."""

import contextlib
import ctypes
import errno
import os
import select
import socket
import stat
import threading
import time

import pytest

from cardan.drivers.base import OperatorDevice
from cardan.drivers.spacemouse import SpaceMouse
from cardan.drivers.spacemouse.transports import HidCandidate, HidLink, Transport
from cardan.errors import AddressError, DeviceNotFoundError
from cardan.protocols.connexion.devices import model_by_key
from cardan.protocols.spnav.codes import Code, EventMask
from cardan.protocols.spnav.records import (
    RECORD_BYTES,
    Button,
    DeviceChange,
    MotionEvent,
    ServerReply,
    encode_handshake,
    encode_request,
)
from cardan.protocols.spnav.streams import Handshake, ServerReader
from cardan.types import ButtonEvent, DeviceCapabilities, DeviceLink, DeviceState
from cardan_spnav_server import (
    DeviceIdentity,
    SpnavServer,
    SpnavServerCore,
    SpnavServerOptions,
    SpnavService,
    serve_device,
)

pytestmark = pytest.mark.matrix

REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
PUSH = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
AWAY = (0, 0, 175, 0, 0, 0)
TIMEOUT_S = 5.0


def device_state(axes=REST, link=DeviceLink.LIVE):
    return DeviceState(time.monotonic(), link, axes, frozenset())


class Program:
    """A client at the socket."""

    def __init__(self, path, version=0):
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(TIMEOUT_S)
        deadline_s = time.monotonic() + TIMEOUT_S
        while self.sock.connect_ex(str(path)):  # not listening yet
            assert time.monotonic() < deadline_s, "no server listens"
            time.sleep(0.005)
        self.reader = ServerReader()
        self.values = []
        if version:
            self.sock.sendall(encode_handshake(version))
            assert self.next() == Handshake(1)

    def next(self):
        while not self.values:
            data = self.sock.recv(4096)
            if not data:
                raise EOFError
            self.values = self.reader.feed(data)
        return self.values.pop(0)

    def until(self, wanted):
        while True:
            if wanted(value := self.next()):
                return value

    def close(self):
        self.sock.close()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "spnav.sock"


@contextlib.contextmanager
def served(path, buttons=("left", "right"), axes=REST, **options):
    """Run a service, with a loop that offers the state every 4 ms."""
    service = SpnavService(buttons, SpnavServerOptions(socket=str(path), **options))
    service.axes = axes
    service.edges = []
    service.link = DeviceLink.LIVE
    service.offer(device_state(axes), ())
    service.start()
    stopping = threading.Event()

    def loop():
        while not stopping.wait(0.004):
            edges, service.edges = service.edges, []
            service.offer(device_state(service.axes, service.link), edges)

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        yield service
    finally:
        stopping.set()
        thread.join()
        service.stop()


# -- the socket ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("access", "mode"), [("owner", 0o600), ("everybody", 0o666)])
def test_who_may_connect(path, access, mode):
    with served(path, access=access):
        assert stat.S_IMODE(path.stat().st_mode) == mode
    assert not path.exists()


def test_a_socket_that_nobody_serves_is_replaced(path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(path))
    with served(path, axes=PUSH):
        program = Program(path)
        assert program.next()[:6] == AWAY
        program.close()


def test_a_socket_that_another_serves_is_left_alone(path):
    with served(path):
        other = SpnavService((), SpnavServerOptions(socket=str(path)))
        with pytest.raises(AddressError, match="another program"):
            other.start()
        other.stop()
        Program(path, version=1).close()


def test_what_is_no_socket_is_left_alone(path):
    path.write_text("precious")
    service = SpnavService((), SpnavServerOptions(socket=str(path)))
    with pytest.raises(AddressError, match="is not a socket"):
        service.start()
    assert path.read_text() == "precious"


def test_a_server_without_open_files_left_leaves_no_socket(path, monkeypatch):
    def no_more():
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr("selectors.DefaultSelector", no_more)
    with pytest.raises(OSError, match="Too many"):
        SpnavServer(SpnavServerCore(), SpnavServerOptions(socket=str(path))).open()
    assert not path.exists()


def test_a_folder_that_is_not_there_is_named(tmp_path):
    path = tmp_path / "nowhere" / "spnav.sock"
    with pytest.raises(AddressError, match=str(path)):
        SpnavService((), SpnavServerOptions(socket=str(path))).start()


def test_a_socket_that_was_replaced_meanwhile_is_not_removed(path):
    with served(path):
        path.unlink()
        path.write_text("somebody else's")
    assert path.read_text() == "somebody else's"


# -- serving ------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", [0, 1])
def test_motion_buttons_and_the_end(path, version):
    with served(path) as service:
        program = Program(path, version)
        service.axes = PUSH
        assert program.until(lambda value: isinstance(value, MotionEvent))[:6] == AWAY
        service.edges = [ButtonEvent(0.0, "right", True)]
        assert program.until(lambda value: isinstance(value, Button)) == Button(1, True)
        service.axes = REST
        assert (
            program.until(lambda value: isinstance(value, MotionEvent) and value[:6] != AWAY)[:6]
            == (0,) * 6
        )
    with pytest.raises((EOFError, ConnectionResetError)):
        program.until(lambda _: False)
    program.close()


def test_programs_come_and_go_and_a_stuck_one_blocks_nobody(path):
    with served(path, axes=PUSH) as service:
        stuck = Program(path, version=1)
        for _ in range(5):
            program = Program(path)
            assert program.next()[:6] == AWAY
            program.close()
        deadline_s = time.monotonic() + TIMEOUT_S
        while service.metrics()["clients"] > 1:
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        assert service.metrics()["served_clients"] == 6
        # The stalled client reads again: old motion kept by the kernel, then the newest.
        service.axes = (-1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        assert stuck.until(lambda value: value[2] == -350)
        stuck.close()


def test_a_flood_of_requests_leaves_the_others_their_motion(path):
    with served(path, axes=PUSH):
        flooding = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        flooding.connect(str(path))
        flooding.setblocking(False)
        flooding.send(encode_handshake(1))
        request = encode_request(Code.GET_SENS) * 64
        program = Program(path)
        program.next()
        stamps = []
        while len(stamps) < 40:
            with contextlib.suppress(OSError):
                flooding.send(request)
            program.next()
            stamps.append(time.monotonic())
        flooding.close()
        program.close()
        assert (stamps[-1] - stamps[0]) / len(stamps) < 0.1


def test_a_request_is_answered_at_once(path):
    with served(path) as service:
        program = Program(path, version=1)
        for _ in range(3):
            program.sock.sendall(encode_request(Code.DEV_NBUTTONS))
            reply = program.until(lambda value: isinstance(value, ServerReply))
            assert reply.data[0] == 2
        program.close()
        assert service.diagnosis() == ()


@pytest.mark.parametrize("where", ["receive", "outgoing"])
def test_a_program_that_cannot_be_served_costs_the_others_nothing(path, where, monkeypatch):
    whole = getattr(SpnavServerCore, where)
    victims = []

    def failing(core, number, *args):
        if number in victims:
            raise OverflowError("nobody thought of this")
        return whole(core, number, *args)

    monkeypatch.setattr(SpnavServerCore, where, failing)
    with served(path, axes=PUSH) as service:
        first = Program(path)
        assert first.next()[:6] == AWAY
        second = Program(path)
        victims.append(0)
        first.sock.sendall(encode_handshake(1))
        with pytest.raises((EOFError, ConnectionResetError)):
            first.until(lambda value: False)
        assert second.next()[:6] == AWAY
        assert any("nobody thought of this" in words for words in service.diagnosis())
        first.close()
        second.close()


def test_buttons_may_be_known_only_once_the_device_is_plugged_in(path):
    service = SpnavService(lambda: ("a", "b", "c"), SpnavServerOptions(socket=str(path)))
    service.offer(device_state(link=DeviceLink.LOST), ())
    service.start()
    program = Program(path, version=1)
    service.offer(device_state(), [ButtonEvent(0.0, "c", True)])
    assert program.until(lambda value: isinstance(value, Button)) == Button(2, True)
    program.close()
    service.stop()


def test_what_the_device_is_may_be_known_only_once_it_is_plugged_in(path):
    reported = [DeviceIdentity()]
    options = SpnavServerOptions(socket=str(path))
    service = SpnavService((), options, lambda: reported[0])
    service.offer(device_state(link=DeviceLink.LOST), ())
    service.start()
    program = Program(path, version=1)
    reported[0] = DeviceIdentity("Pro", "", 0x20D, 0x256F, 0xC631)
    service.offer(device_state(PUSH), ())
    change = program.until(lambda value: isinstance(value, DeviceChange))
    assert change == DeviceChange(True, 0, 0x20D, 0x256F, 0xC631)
    assert (
        program.until(lambda value: isinstance(value, MotionEvent)).z == 250
    )  # of 500, like spacenavd
    program.close()
    service.stop()


def test_raw_events_may_be_asked_for_and_do_not_come(path):
    everything = EventMask.RAW_BUTTON * 2 - 1
    with served(path, axes=PUSH) as service:
        program = Program(path, version=1)
        program.sock.sendall(encode_request(Code.SET_EVMASK, (everything,)))
        assert program.until(lambda value: isinstance(value, ServerReply)).ok
        program.sock.sendall(encode_request(Code.GET_EVMASK))
        reply = program.until(lambda value: isinstance(value, ServerReply))
        assert reply.data[0] == everything
        service.edges = [ButtonEvent(0.0, "left", True)]
        kinds = set()
        program.until(lambda value: kinds.add(type(value)) or len(kinds) > 1)
        service.edges = [ButtonEvent(0.0, "left", False)]
        program.until(lambda value: kinds.add(type(value)) or value == Button(0, False))
        assert kinds == {MotionEvent, Button}
        program.close()


def test_offering_without_a_thread_costs_nothing_and_stopping_twice_is_fine(path):
    service = SpnavService(("left",), SpnavServerOptions(socket=str(path)))
    for _ in range(10_000):
        service.offer(device_state(), [ButtonEvent(0.0, "left", True)])
    service.start()
    service.start()
    service.stop()
    service.stop()
    assert not path.exists()


# -- a device -----------------------------------------------------------------------------------


class Hand(OperatorDevice):
    """A device that is always deflected."""

    class Options:
        pass

    def __init__(self, *, there=True):
        super().__init__()
        self.there = there
        self.opened = False
        self.leds = []

    def open(self):
        if not self.there:
            raise DeviceNotFoundError("nothing is plugged in")
        self.opened = True

    def close(self):
        self.opened = False

    def diagnosis(self):
        return ()

    @property
    def capabilities(self):
        return DeviceCapabilities(False, ("a", "b", "c"), frozenset({"led"}), False)

    def state(self):
        return device_state(PUSH)

    def button_events(self):
        return ()

    def _feedback(self, feedback):
        self.leds.append(feedback.led)


def test_a_device_is_served_and_closed(path, capsys):
    hand = Hand()
    options = SpnavServerOptions(socket=str(path), name="Hand", full_scale=500.0)
    thread = threading.Thread(target=serve_device, args=(hand, options, 1.0))
    thread.start()
    deadline_s = time.monotonic() + TIMEOUT_S
    while not path.exists() and time.monotonic() < deadline_s:
        time.sleep(0.01)
    program = Program(path, version=1)
    assert program.until(lambda value: isinstance(value, MotionEvent)).z == 250
    program.sock.sendall(encode_request(Code.DEV_NBUTTONS))
    assert program.until(lambda value: isinstance(value, ServerReply)).data[0] == 3
    program.close()
    thread.join()
    assert not hand.opened
    assert hand.leds[0] is True
    assert hand.leds[-1] is False
    assert capsys.readouterr().out == f"READY {path}\n"


def test_a_device_that_is_not_there_leaves_no_socket(path):
    with pytest.raises(DeviceNotFoundError):
        serve_device(Hand(there=False), SpnavServerOptions(socket=str(path)), 1.0)
    assert not path.exists()


def test_a_path_that_is_taken_leaves_no_device_open(path):
    path.write_text("precious")
    hand = Hand()
    with pytest.raises(AddressError):
        serve_device(hand, SpnavServerOptions(socket=str(path)), 1.0)
    assert not hand.opened


# -- judged by libspnav -------------------------------------------------------------------------


class MotionStructure(ctypes.Structure):
    _fields_ = (
        ("type", ctypes.c_int),
        ("counts", ctypes.c_int * 6),
        ("period_ms", ctypes.c_uint),
        ("data", ctypes.c_void_p),
    )


class ButtonEventOfLibrary(ctypes.Structure):
    _fields_ = (("type", ctypes.c_int), ("pressed", ctypes.c_int), ("number", ctypes.c_int))


class LibraryEvent(ctypes.Union):
    _fields_ = (
        ("type", ctypes.c_int),
        ("motion", MotionStructure),
        ("button", ButtonEventOfLibrary),
    )


MOTION, BUTTON = 1, 2


@pytest.fixture
def library(path, monkeypatch):
    """Debian's libspnav, to be opened at `path`, and closed in the end."""
    try:
        library = ctypes.CDLL("libspnav.so.0")
    except OSError:
        pytest.skip("libspnav.so.0 is not installed (Debian package libspnav0)")
    # The library asks the process's own environment, which os.environ keeps up to date.
    monkeypatch.setenv("SPNAV_SOCKET", str(path))
    library.spnav_cfg_get_sens.restype = ctypes.c_float
    library.spnav_sensitivity.argtypes = [ctypes.c_double]
    yield library
    library.spnav_close()


def next_event(library, kind, wanted=lambda event: True):
    event = LibraryEvent()
    deadline_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline_s:
        select.select([library.spnav_fd()], [], [], 0.05)
        if library.spnav_poll_event(ctypes.byref(event)) == kind and wanted(event):
            return event
    raise AssertionError("no such event")


@pytest.mark.real
@pytest.mark.judged(device="spacenavd clients", transport="socket", by="Debian libspnav")
def test_libspnav_opens_asks_and_gets_motion_and_buttons(path, library):
    core_options = {"axes": PUSH, "name": "A hand of a rather long and descriptive name"}
    with served(path, ("a", "b", "c"), **core_options) as service:
        assert library.spnav_open() == 0
        assert library.spnav_protocol() == 1
        assert library.spnav_client_name(b"a judge of a rather long name") == 0
        name = ctypes.create_string_buffer(128)
        for _ in range(3):  # While deflected: no event is mistaken for an answer.
            assert library.spnav_dev_name(name, len(name)) > 0
            assert name.value.decode() == core_options["name"]
            assert library.spnav_dev_buttons() == 3
            assert library.spnav_dev_axes() == 6
            assert library.spnav_dev_type() == 0
            assert library.spnav_dev_usbid(None, None) == -1
            assert library.spnav_cfg_get_sens() == 1.0
            assert library.spnav_cfg_set_sens(ctypes.c_float(2.0)) == -1
            assert library.spnav_cfg_get_led() == -1
        event = next_event(library, MOTION)
        assert tuple(event.motion.counts) == AWAY
        assert 4 <= next_event(library, MOTION).motion.period_ms <= 100
        service.edges = [ButtonEvent(0.0, "b", True)]
        event = next_event(library, BUTTON)
        assert (event.button.number, event.button.pressed) == (1, 1)
        service.edges = [ButtonEvent(0.0, "b", False)]
        event = next_event(library, BUTTON)
        assert (event.button.number, event.button.pressed) == (1, 0)
        service.axes = REST
        next_event(library, MOTION, lambda event: not any(event.motion.counts))


class OneDevice(Transport):
    """Transport to a connected device at rest."""

    name = "stand-in"

    def __init__(self, model):
        self.found = HidCandidate(
            model.name, model.vendor_id, model.product_id, self.name, "here", model=model
        )

    def find(self):
        return [self.found]

    def open(self, device):
        return Resting()


class Resting(HidLink):
    """An open device at rest."""

    def read(self, timeout_s):
        threading.Event().wait(timeout_s)

    def write(self, report):
        pass

    def close(self):
        pass


@pytest.mark.judged(device="spacenavd clients", transport="socket", by="Debian libspnav")
@pytest.mark.parametrize(
    ("key", "device_type"), [("spacenavigator", 0x206), ("spacemouse-pro-wireless", 0x20D)]
)
def test_libspnav_is_reported_which_spacemouse_it_is(path, library, key, device_type):
    model = model_by_key(key)
    mouse = SpaceMouse(transports=[OneDevice(model)])
    options = SpnavServerOptions(socket=str(path))
    thread = threading.Thread(target=serve_device, args=(mouse, options, 1.5))
    thread.start()
    try:
        deadline_s = time.monotonic() + TIMEOUT_S
        while library.spnav_open() or library.spnav_dev_type() < 0:
            assert time.monotonic() < deadline_s, "there is no device"
            library.spnav_close()
            time.sleep(0.01)
        assert library.spnav_dev_type() == device_type
        vendor, product = ctypes.c_int(), ctypes.c_int()
        assert library.spnav_dev_usbid(ctypes.byref(vendor), ctypes.byref(product)) == 0
        assert (vendor.value, product.value) == (model.vendor_id, model.product_id)
        name = ctypes.create_string_buffer(128)
        assert library.spnav_dev_name(name, len(name)) > 0
        assert name.value.decode() == model.name
    finally:
        thread.join()


@pytest.mark.judged(device="spacenavd clients", transport="socket", by="Debian libspnav")
def test_libspnav_does_not_lose_its_motion_to_its_own_sensitivity(path, library):
    with served(path, axes=PUSH):
        assert library.spnav_open() == 0
        for sensitivity in (1.0, 2.0, 1.1, 0.3):
            library.spnav_sensitivity(sensitivity)
        event = next_event(library, MOTION, lambda event: event.motion.counts[2])
        assert tuple(event.motion.counts) == AWAY


@pytest.mark.judged(device="spacenavd clients", transport="socket", by="Debian libspnav")
def test_libspnav_switches_the_led(path, library):
    shown = []
    core = SpnavServerCore(on_led=shown.append, identity=DeviceIdentity())
    server = SpnavServer(core, SpnavServerOptions(socket=str(path)))
    server.open()
    stopping = threading.Event()

    def serve():
        while not stopping.is_set():
            core.offer(device_state(), (), time.monotonic())
            server.step(time.monotonic() + 0.01)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        assert library.spnav_open() == 0
        assert library.spnav_cfg_get_led() == 2
        assert library.spnav_cfg_set_led(0) == 0
        assert library.spnav_cfg_get_led() == 0
    finally:
        stopping.set()
        thread.join()
        server.close()
    assert shown == [True, False]


def test_a_record_is_one_packet_for_the_reader(path):
    """libspnav reads 32 bytes once, and does not put pieces together."""
    with served(path, axes=PUSH):
        program = Program(path)
        for _ in range(10):
            assert len(program.sock.recv(RECORD_BYTES)) == RECORD_BYTES
        program.close()
    assert not os.path.exists(path)
