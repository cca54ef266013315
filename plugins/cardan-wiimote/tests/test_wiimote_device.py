"""The driver with its thread and transports, mostly with the simulated remote on its two
sockets."""

import threading
import time
import types

import pytest

from cardan.drivers import reader_thread
from cardan.errors import CommandError, DeviceAccessError, DeviceNotFoundError, NotOpenError
from cardan.types import ZERO3, DeviceFeedback, DeviceLink, Wrench
from cardan_wiimote.driver import Wiimote, WiimoteOptions, device as device_module
from cardan_wiimote.driver.transports import Found, Link, Transport
from cardan_wiimote.peer import FAULTS, WiimotePeer, WiimotePeerOptions
from cardan_wiimote.peer.core import BATTERY_EMPTY
from tests.serving import in_a_thread
from tests.waiting import until
from wiimote_bench import REST, fault_default

pytestmark = pytest.mark.matrix

PATIENCE_S = 30.0
NOT_YET_S = 1e6
EARLY = {"stolen-mode": 0.1, "burst": 0.15}
BEFORE = {"in-range": "out-of-range", "power-on": "power-off"}
TIMED = {
    "silence", "out-of-range", "power-off", "close-control", "close-interrupt", "battery-low",
}  # fmt: skip
"""Faults that occur once, at a given time."""
GAPS = {"silence", "close-control", "close-interrupt", "burst", *BEFORE}
"""Faults after which the driver has no remote for a while."""


@pytest.fixture(autouse=True)
def _hasty(monkeypatch):
    monkeypatch.setattr(reader_thread, "RETRY_FIRST_S", 0.01)
    monkeypatch.setattr(reader_thread, "RETRY_LAST_S", 0.05)


@pytest.fixture
def idle(tmp_path):
    """A script in which the remote rests."""
    script = tmp_path / "idle.script"
    script.write_text("0.0 level\n")
    return str(script)


def peer_of(tmp_path, script, **more):
    return WiimotePeer(WiimotePeerOptions(l2cap=str(tmp_path / "wii"), script=script, **more))


def driver_of(tmp_path, **more):
    more.setdefault("dead_zone", 0.0)
    return Wiimote(WiimoteOptions(transport="socket", path=str(tmp_path / "wii"), **more))


def live(wiimote):
    until(lambda: wiimote.state().link is DeviceLink.LIVE)


def gripped(peer, wiimote, condition):
    """Hold A until the state meets `condition`; a machine that stalls releases the clutch, so grip
    again."""
    end_s = time.monotonic() + PATIENCE_S
    while not condition(state := wiimote.state()):
        assert time.monotonic() < end_s, (state, wiimote.diagnosis())
        if "a" not in peer.device.held:
            peer.device.press("a")
        elif state.link is not DeviceLink.LIVE:
            peer.device.release("a")
            live(wiimote)
        time.sleep(0.002)


def lasting(words):
    """Return the diagnosis messages that are not caused by a busy machine."""
    return [w for w in words if not any(s in w for s in ("silences", "data mode", "in time"))]


@pytest.mark.judged(device="Wiimote", transport="seqpacket sockets", by="simulated peer")
@pytest.mark.parametrize("ir", [False, True])
@pytest.mark.parametrize(
    "remote",
    [
        {},
        {"extension": "nunchuk"},
        {"motion_plus": True},
        {"extension": "nunchuk", "motion_plus": True},
        {"tr": True, "motion_plus": True},
    ],
    ids=["alone", "nunchuk", "motion-plus", "both", "tr"],
)
def test_every_kind_of_remote(tmp_path, idle, remote, ir):
    options = {"ir": ir, "motion_plus": "on" if "motion_plus" in remote else "off"}
    with (
        in_a_thread(peer_of(tmp_path, idle, **remote)) as peer,
        driver_of(tmp_path, **options) as wiimote,
    ):
        live(wiimote)
        gripped(peer, wiimote, lambda state: state.axes[2] == 1.0)
        assert wiimote.state().battery == pytest.approx(0.96)
        peer.device.release("a")
        live(wiimote)
        until(lambda: wiimote.state().axes == REST and not wiimote.state().buttons)
        assert lasting(wiimote.diagnosis()) == []
        edges = [(e.button, e.pressed) for e in wiimote.button_events()]
        assert edges == [("a", True), ("a", False)] * (len(edges) // 2)
    assert wiimote.state().link is DeviceLink.CLOSED


class Noted(Wiimote):
    """Records the state after every report and every loss."""

    def __init__(self, *arguments, **keywords):
        super().__init__(*arguments, **keywords)
        self.noted = []

    def _notify(self):
        self.noted.append(self.state())
        super()._notify()

    def has_been(self, *links):
        return any(state.link in links for state in tuple(self.noted))


def next_fault(peer):
    """Trigger the next scheduled fault now."""
    (_, act), *later = peer.device._happenings
    peer.device._happenings = [(0.0, act), *later]


@pytest.mark.judged(device="Wiimote", transport="seqpacket sockets", by="simulated peer")
@pytest.mark.parametrize("name", [switch.name for switch in FAULTS])
def test_faults_end_to_end(tmp_path, idle, name):
    """Timed faults are triggered when the driver is ready for them."""
    faults = {name: EARLY.get(name, fault_default(name))}
    if name in BEFORE:
        faults[BEFORE[name]], faults[name] = NOT_YET_S, 2.0 * NOT_YET_S
    elif name in TIMED or name == "refuse":
        faults[name] = NOT_YET_S
    more = {"hot-plug": {"extension": "nunchuk"}, "woken-by-1-2": {"tr": True}}.get(name, {})
    peer = peer_of(tmp_path, idle, faults=faults, start_on_connect=False, **more)
    options = WiimoteOptions(
        transport="socket", path=str(tmp_path / "wii"), dead_zone=0.0, wait_for_device=True
    )
    with in_a_thread(peer), Noted(options) as wiimote:
        if name in ("refuse", "woken-by-1-2"):
            until(lambda: wiimote.has_been(DeviceLink.LOST))
            peer._opened_s -= NOT_YET_S
        if name == "woken-by-1-2":
            assert not wiimote.has_been(DeviceLink.LIVE)
            return
        live(wiimote)
        if name in TIMED or name in BEFORE:
            wiimote.noted.clear()
            next_fault(peer)
        if name in ("out-of-range", "power-off"):
            until(lambda: wiimote.state().link is DeviceLink.LOST)
        elif name in GAPS:
            until(lambda: wiimote.has_been(DeviceLink.LOST, DeviceLink.STALE))
        elif name == "battery-low":
            until(lambda: peer.device.battery == BATTERY_EMPTY)
        elif name == "stolen-mode":
            until(lambda: any(each.what == "mode 0x30" for each in tuple(peer.device.log)))
        assert all(state.axes == REST for state in tuple(wiimote.noted))
        if name in ("out-of-range", "power-off"):
            return
        if name in BEFORE:
            next_fault(peer)
        live(wiimote)
        assert all(state.axes == REST for state in tuple(wiimote.noted))
        if name != "burst":
            gripped(peer, wiimote, lambda state: state.axes[2] == 1.0)


@pytest.mark.judged(device="Wiimote", transport="seqpacket sockets", by="simulated peer")
def test_a_script_is_followed(tmp_path):
    script = tmp_path / "roll.script"
    script.write_text("0.0 tilt 30 0 0\n")
    with in_a_thread(peer_of(tmp_path, str(script))) as peer, driver_of(tmp_path) as wiimote:
        live(wiimote)
        gripped(peer, wiimote, lambda state: state.axes[3] > 0.48)
        assert wiimote.state().axes in (REST, pytest.approx((0, 0, 1, 0.5, 0, 0), abs=0.04))


@pytest.mark.real
def test_feedback_reaches_the_remote(tmp_path, idle):
    with in_a_thread(peer_of(tmp_path, idle)) as peer, driver_of(tmp_path, led=4) as wiimote:
        live(wiimote)
        assert peer.device.leds == 0b1000
        assert wiimote.capabilities.feedback == {"led", "rumble"}
        wiimote.feedback(DeviceFeedback(led=False, rumble=1.0))
        until(lambda: peer.device.leds == 0 and peer.device.rumble)
        wiimote.feedback(DeviceFeedback(led=True, rumble=0.0))
        until(lambda: peer.device.leds == 0b1000 and not peer.device.rumble)
        with pytest.raises(CommandError, match="wrench"):
            wiimote.feedback(DeviceFeedback(wrench=Wrench(ZERO3, ZERO3)))
        wiimote.feedback(DeviceFeedback(rumble=1.0))
        until(lambda: peer.device.rumble)
        wiimote.close()
        until(lambda: not peer.device.connected)
        reported = [entry.what for entry in peer.device.log]
        motor = [index for index, what in enumerate(reported) if "rumble" in what]
        assert "rumble off" in reported[motor[-1]]


@pytest.mark.real
def test_the_remote_comes_and_goes(tmp_path, idle):
    with driver_of(tmp_path, wait_for_device=True) as wiimote:
        assert wiimote.state().link is DeviceLink.LOST
        assert "cardan sim wiimote" in wiimote.state().reason
        with in_a_thread(peer_of(tmp_path, idle)) as peer:
            live(wiimote)
            gripped(peer, wiimote, lambda state: any(state.axes))
        until(lambda: wiimote.state().link is DeviceLink.LOST)
        assert wiimote.state().axes == REST
        with in_a_thread(peer_of(tmp_path, idle)):
            live(wiimote)


def test_no_remote_is_an_error(tmp_path):
    with pytest.raises(DeviceNotFoundError, match="start `cardan sim wiimote"):
        driver_of(tmp_path).open()


def test_feedback_before_open(tmp_path):
    with pytest.raises(NotOpenError, match="call open"):
        driver_of(tmp_path).feedback(DeviceFeedback(led=True))


# -- choosing a remote ----------------------------------------------------------------------------


class Silent(Link):
    """A remote that sends nothing."""

    def __init__(self):
        self.written, self.closed = [], False

    def read(self, timeout_s):
        time.sleep(timeout_s)

    def write(self, report):
        self.written.append(report)

    def close(self):
        self.closed = True


class Absent(Silent):
    """An absent remote, as seen through an adapter."""

    def write(self, report):
        raise OSError(32, "Broken pipe")


class Shelf(Transport):
    name = "shelf"

    def __init__(self, *remotes, refuses=(), absent=()):
        self.remotes, self.refuses, self.absent = remotes, refuses, absent
        self.opened, self.links = [], []

    def find(self):
        return list(self.remotes)

    def open(self, remote, given_up):
        if remote.path in self.refuses:
            raise DeviceAccessError(f"cannot open {remote.path}")
        self.opened.append(remote.path)
        self.links.append(Absent() if remote.path in self.absent else Silent())
        return self.links[-1]


FIRST = Found("Nintendo RVL-CNT-01", "shelf", "/dev/hidraw1", "00:00:00:00:00:01")
SECOND = Found("Nintendo RVL-CNT-01", "shelf", "/dev/hidraw2", "00:00:00:00:00:0A")


@pytest.mark.parametrize(
    ("options", "opened"),
    [
        ({}, "/dev/hidraw1"),
        ({"path": "/dev/hidraw2"}, "/dev/hidraw2"),
        ({"address": "00:00:00:00:00:0a"}, "/dev/hidraw2"),
    ],
)
def test_the_remote_that_is_meant(options, opened):
    shelf = Shelf(FIRST, SECOND)
    with Wiimote(WiimoteOptions(**options), backend=shelf):
        assert shelf.opened == [opened]


def test_the_next_one_if_the_first_is_refused():
    shelf = Shelf(FIRST, SECOND, refuses={FIRST.path})
    with Wiimote(backend=shelf):
        assert shelf.opened == [SECOND.path]


def test_a_remote_that_is_not_really_there_is_passed_over():
    shelf = Shelf(FIRST, SECOND, absent={FIRST.path})
    with Wiimote(backend=shelf):
        assert shelf.opened == [FIRST.path, SECOND.path]
        assert shelf.links[0].closed
    with pytest.raises(DeviceAccessError, match=r"hidraw1 takes no report: .*Broken pipe"):
        Wiimote(backend=Shelf(FIRST, absent={FIRST.path})).open()
    held = FIRST._replace(transport="socket")
    with pytest.raises(DeviceAccessError, match="Broken pipe; another program holds it"):
        Wiimote(backend=Shelf(held, absent={held.path})).open()


def test_all_refused():
    with pytest.raises(DeviceAccessError, match="hidraw1; cannot open /dev/hidraw2"):
        Wiimote(backend=Shelf(FIRST, SECOND, refuses={FIRST.path, SECOND.path})).open()


def test_none_is_meant():
    options = WiimoteOptions(address="00:00:00:00:00:02")
    with pytest.raises(DeviceNotFoundError, match="with address '00:00:00:00:00:02'"):
        Wiimote(options, backend=Shelf(FIRST)).open()


class Lossy(Silent):
    """A remote that is lost on request."""

    lost = False

    def read(self, timeout_s):
        if self.lost:
            raise OSError(19, "No such device")
        super().read(timeout_s)


class Returning(Shelf):
    """A set of remotes that can be lost."""

    def open(self, remote, given_up):
        self.opened.append(remote.path)
        self.links.append(Lossy())
        return self.links[-1]


def test_another_remote_is_no_successor():
    shelf = Returning(FIRST, SECOND)
    wiimote = Wiimote(backend=shelf)
    with wiimote:
        shelf.remotes = (SECOND,)
        shelf.links[0].lost = True
        until(lambda: "another one" in wiimote.state().reason)
        assert f"the remote {FIRST.address} is gone" in wiimote.state().reason
        assert any(SECOND.address in words for words in wiimote.diagnosis())
        assert shelf.opened == [FIRST.path]
        # The remote is back, with another device path.
        shelf.remotes = (SECOND, FIRST._replace(path="/dev/hidraw7"))
        until(lambda: len(shelf.opened) == 2)
        assert shelf.opened[1] == "/dev/hidraw7"
    shelf.remotes = (SECOND,)
    with wiimote:
        assert shelf.opened[2] == SECOND.path


def test_a_remote_without_an_address_is_known_by_its_path():
    first, second = FIRST._replace(address=""), SECOND._replace(address="")
    shelf = Returning(first, second)
    with Wiimote(backend=shelf) as wiimote:
        shelf.remotes = (second,)
        shelf.links[0].lost = True
        until(lambda: f"the remote {first.path} is gone" in wiimote.state().reason)
        shelf.remotes = ()
        until(lambda: wiimote.state().reason.endswith("is gone: press one of its buttons"))
        shelf.remotes = (second, first)
        until(lambda: shelf.opened == [first.path] * 2)


def test_a_path_finds_the_remote_only_the_first_time():
    shelf = Returning(FIRST, SECOND)
    with Wiimote(WiimoteOptions(path=SECOND.path), backend=shelf):
        shelf.remotes = (FIRST, SECOND._replace(path="/dev/hidraw8"))
        shelf.links[0].lost = True
        until(lambda: shelf.opened == [SECOND.path, "/dev/hidraw8"])


def test_the_motor_is_stopped_at_the_end():
    shelf = Shelf(FIRST)
    with Wiimote(backend=shelf):
        pass
    (link,) = shelf.links
    assert link.written[-1] == b"\x10\x00"
    assert link.closed


def test_found_remotes(monkeypatch):
    remotes = [
        FIRST._replace(kernel_driver=True),
        SECOND._replace(obstacle="no permission for /dev/hidraw2"),
    ]
    monkeypatch.setattr(
        device_module, "HidrawTransport", lambda: types.SimpleNamespace(find=lambda: remotes)
    )
    first, second = Wiimote.find()
    assert (first.name, first.path) == (FIRST.name, FIRST.path)
    assert first.obstacle.startswith("ready, but the kernel's driver hid-wiimote")
    assert (second.identity, second.obstacle) == (SECOND.address, remotes[1].obstacle)


def test_the_list_has_the_remedy_that_the_diagnosis_has(monkeypatch):
    remote = FIRST._replace(kernel_driver=True)
    listed = what_is_listed(monkeypatch, remote)
    with Wiimote(backend=Shelf(remote)) as wiimote:
        (reported,) = [words for words in wiimote.diagnosis() if "hid-wiimote" in words]
    assert listed.endswith(reported[reported.index("load the module") :])


def test_a_late_remote_is_listed_with_how_to_pair_it(monkeypatch):
    assert what_is_listed(monkeypatch, FIRST) == ""
    listed = what_is_listed(monkeypatch, FIRST._replace(late_model=True))
    assert listed.startswith("ready, but pair it with the red sync button")
    listed = what_is_listed(monkeypatch, FIRST._replace(late_model=True, kernel_driver=True))
    assert "hid-wiimote" in listed
    assert "red sync button" in listed


def what_is_listed(monkeypatch, remote):
    monkeypatch.setattr(
        device_module, "HidrawTransport", lambda: types.SimpleNamespace(find=lambda: [remote])
    )
    (found,) = Wiimote.find()
    return found.obstacle


def test_finding_never_raises(monkeypatch):
    def broken():
        raise OSError("no HID here")

    monkeypatch.setattr(
        device_module, "HidrawTransport", lambda: types.SimpleNamespace(find=broken)
    )
    (row,) = Wiimote.find()
    assert (row.path, row.obstacle) == ("", "no HID here")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"transport": "usb"}, "transport: 'usb' is not allowed"),
        ({"roles": "dance"}, "roles: 'dance' is not allowed; it must be one of paper, tilt, gyro"),
        ({"neutral": "x"}, "neutral: 'x' is not allowed"),
        ({"motion_plus": "maybe"}, "motion_plus: 'maybe' is not allowed"),
        ({"transport": "l2cap"}, "it must be the remote's address"),
        ({"transport": "socket"}, "it must be the folder"),
        ({"address": "00:11"}, "address: '00:11' is not allowed"),
        ({"led": 5}, "led: 5 is not allowed; it must be 0 \\(none\\) to 4"),
        ({"led": 1.5}, "led: 1.5 is not allowed"),
        ({"full_tilt_deg": 0.0}, "full_tilt_deg: 0.0 is not allowed; it must be 5 to 90"),
        ({"low_pass_hz": float("nan")}, "low_pass_hz: nan is not allowed"),
        ({"gyro_full_scale_rad_s": 0.0}, "gyro_full_scale_rad_s: 0.0 is not allowed"),
        ({"reconnect_after_s": 0.1}, "reconnect_after_s: 0.1 is not allowed; it must be 0.3 to 60"),
        ({"roles": "gyro", "motion_plus": "off"}, "roles 'gyro' need it"),
        ({"dead_zone": 1.0}, "dead_zone: 1.0 is not allowed"),
    ],
)
def test_options_that_are_refused(options, words):
    with pytest.raises(ValueError, match=words):
        WiimoteOptions(**options)


class OneReport:
    """Returns one report, then stops the reader."""

    def __init__(self, report):
        self.stop = threading.Event()
        self.given, self.written = [report], []

    def read(self, _timeout_s):
        if self.given:
            return self.given.pop()
        self.stop.set()
        return None

    def write(self, data):
        self.written.append(data)


def test_its_tap_is_given_reports_both_ways_as_they_are():
    tapped = []
    remote, link = Wiimote(), OneReport(b"\x20\0\0\0\0\0\0")
    remote.raw_packet_callback, remote._remote = (lambda *packet: tapped.append(packet)), link
    remote._core.on_opened(0.0)
    remote._serve(link.stop)
    assert [data for data, sent, _ in tapped if not sent] == [b"\x20\0\0\0\0\0\0"]
    assert [data for data, sent, _ in tapped if sent] == link.written[: len(tapped) - 1]
    assert {type(data) for data, _, _ in tapped} == {bytes}
