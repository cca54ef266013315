"""I/O of the SpaceMouse driver with a stand-in for hidapi, and with a socket."""

import errno
import os
import re
import socket
import sys
import threading
import types
from collections import deque

import pytest

from cardan.cli.devices import list_devices as print_devices
from cardan.drivers import access, base, packet_socket, reader_thread, registry
from cardan.drivers.hid import HidDevice
from cardan.drivers.spacemouse import (
    SpaceMouse,
    SpaceMouseOptions,
    device as shell,
    list_devices,
    transports,
)
from cardan.drivers.spacemouse.core import STALE_AFTER_S
from cardan.drivers.spacemouse.transports import HidSocketLink, HidTransport, SocketTransport
from cardan.errors import (
    CommandError,
    DeviceAccessError,
    DeviceNotFoundError,
    DriverError,
    NotOpenError,
)
from cardan.protocols.connexion.descriptors import descriptor_for
from cardan.protocols.connexion.devices import model_by_key
from cardan.protocols.connexion.reports import (
    encode_battery,
    encode_buttons,
    encode_led,
    encode_motion,
    encode_rotation,
    encode_translation,
)
from cardan.types import DeviceFeedback, DeviceLink
from tests.waiting import WITHIN_S, until

pytestmark = pytest.mark.matrix

PATIENCE_S = WITHIN_S
REST = encode_motion(0, 0, 0, 0, 0, 0)
UP = encode_motion(0, 0, -175, 0, 0, 0)


@pytest.fixture(autouse=True)
def frozen_clock(monkeypatch):
    """Stop the driver's clock, so that a busy computer makes no state stale."""
    clock = types.SimpleNamespace(monotonic=lambda: 1000.0)
    monkeypatch.setattr(shell, "time", clock)
    monkeypatch.setattr(reader_thread, "time", clock)


class FakePuck:
    """Interface of a plugged device, in hidapi's form."""

    def __init__(
        self, model, path=b"/dev/null", usage=(1, 8), serial="", descriptor=None, interface=0
    ):
        self.model = model_by_key(model)
        self.info = {
            "path": path,
            "vendor_id": self.model.vendor_id,
            "product_id": self.model.product_id,
            "serial_number": serial,
            "product_string": self.model.name,
            "usage_page": usage[0],
            "usage": usage[1],
            "interface_number": interface,
        }
        self.descriptor = descriptor_for(self.model) if descriptor is None else descriptor
        self.reports = deque()
        self.written = []
        self.condition = threading.Condition()
        self.plugged = True
        self.refuses = False
        self.opened = 0
        self.drained = 0

    def send(self, *reports):
        """Send reports and wait until the driver has read them all."""
        with self.condition:
            self.reports.extend(reports)
            self.condition.notify_all()
            before = self.drained
            assert self.condition.wait_for(
                lambda: not self.reports and self.drained > before, PATIENCE_S
            )

    def unplug(self):
        with self.condition:
            self.plugged = False
            self.condition.notify_all()


def fake_hidapi(pucks):
    """Module that behaves like hidapi 0.15, with `pucks` plugged in."""

    class FakeHandle:
        def __init__(self):
            self._puck = None
            self._nonblocking = False

        def open_path(self, path):
            for puck in pucks:
                if puck.info["path"] == path and puck.plugged and not puck.refuses:
                    self._puck = puck
                    puck.opened += 1
                    return
            raise OSError("open failed")

        def set_nonblocking(self, value):
            self._nonblocking = bool(value)
            return 0

        def read(self, max_length, timeout_ms=0):
            puck = self._opened()
            with puck.condition:
                if not puck.reports:
                    puck.drained += 1
                    puck.condition.notify_all()
                if timeout_ms or not self._nonblocking:
                    puck.condition.wait_for(
                        lambda: puck.reports or not puck.plugged,
                        timeout_ms / 1000 if timeout_ms else None,
                    )
                if not puck.plugged:
                    raise OSError("read error")
                return list(puck.reports.popleft()[:max_length]) if puck.reports else []

        def write(self, data):
            puck = self._opened()
            if not puck.plugged or not puck.model.led:
                return -1
            puck.written.append(bytes(data))
            return len(data)

        def error(self):
            return "Success"

        def get_report_descriptor(self):
            puck = self._opened()
            if not puck.descriptor:
                raise OSError("get report descriptor error")
            return list(puck.descriptor)

        def close(self):
            if self._puck is not None:
                self._puck.opened -= 1
            self._puck = None

        def _opened(self):
            if self._puck is None:
                raise ValueError("not open")
            return self._puck

    def enumerate_(vendor_id=0, product_id=0):
        return [
            dict(puck.info)
            for puck in pucks
            if puck.plugged
            and vendor_id in (0, puck.info["vendor_id"])
            and product_id in (0, puck.info["product_id"])
        ]

    module = types.ModuleType("hidraw")
    module.device = FakeHandle
    module.enumerate = enumerate_
    return module


@pytest.fixture
def usb(monkeypatch):
    """Plug pucks in: ``usb(FakePuck(...), ...)``; the libusb back end finds nothing."""
    monkeypatch.setattr(reader_thread, "RETRY_FIRST_S", 0.005)
    monkeypatch.setattr(reader_thread, "RETRY_LAST_S", 0.01)
    pucks = []
    monkeypatch.setitem(sys.modules, "hidraw", fake_hidapi(pucks))
    monkeypatch.setitem(sys.modules, "hid", fake_hidapi([]))

    def plug(*more):
        pucks.extend(more)
        return more[0] if len(more) == 1 else more

    return plug


@pytest.fixture
def open_mouse():
    """Open a SpaceMouse by its options; closed again after the test."""
    opened = []

    def open_it(**options):
        mouse = SpaceMouse(SpaceMouseOptions(**options))
        opened.append(mouse)
        mouse.open()
        return mouse

    yield open_it
    for mouse in opened:
        mouse.close()
        assert mouse.state().link is DeviceLink.CLOSED
    assert not [t for t in threading.enumerate() if t.name == "cardan-spacemouse"]


# -- hidapi ------------------------------------------------------------------------------------


def test_the_registry_knows_it():
    assert registry.load("spacemouse") is SpaceMouse
    assert SpaceMouse().options == SpaceMouseOptions()


def test_reports_become_states(usb, open_mouse):
    puck = usb(FakePuck("spacemouse-wireless"))
    mouse = open_mouse(dead_zone=0.0)
    assert mouse.state().link is DeviceLink.NEEDS_NEUTRAL
    puck.send(REST, UP, encode_buttons(1, 3), encode_battery(55, False))
    state = mouse.state()
    assert state.link is DeviceLink.LIVE
    assert state.axes == (0.0, 0.0, 0.5, 0.0, 0.0, 0.0)
    assert state.buttons == {"left"}
    assert state.battery == 0.55
    assert [(e.button, e.pressed) for e in mouse.button_events()] == [("left", True)]
    assert mouse.capabilities.buttons == ("left", "right")
    assert mouse.capabilities.battery
    assert mouse.metrics()["rotation_age_s"] >= 0.0


def test_a_queue_is_drained_to_the_newest_and_keeps_every_edge(usb, open_mouse):
    puck = usb(FakePuck("spacemouse-wireless"))
    mouse = open_mouse(dead_zone=0.0)
    puck.send(REST)
    backlog = []
    for count in range(1, 101):
        backlog += [encode_buttons(count % 2, 3), encode_motion(0, 0, -count, 0, 0, 0)]
    puck.send(*backlog)
    assert mouse.state().axes[2] == pytest.approx(100 / 350)
    assert [e.pressed for e in mouse.button_events()] == [True, False] * 50


def test_full_scale_comes_from_the_descriptor(usb, open_mouse):
    model = model_by_key("spacemouse-wireless")
    puck = usb(FakePuck(model.key, descriptor=descriptor_for(model._replace(full_scale=500))))
    mouse = open_mouse(dead_zone=0.0)
    puck.send(REST, UP)
    assert mouse.state().axes[2] == pytest.approx(175 / 500)


def test_an_unreadable_descriptor_is_no_obstacle(usb, open_mouse):
    puck = usb(FakePuck("spacemouse-wireless", descriptor=b""))
    mouse = open_mouse(dead_zone=0.0)
    puck.send(REST, UP)
    assert mouse.state().axes[2] == 0.5


def test_unplug_and_replug(usb, open_mouse):
    puck = usb(FakePuck("spacemouse-wireless"))
    mouse = open_mouse()
    puck.send(REST, UP, encode_buttons(2, 3))
    puck.unplug()
    until(lambda: mouse.state().link is DeviceLink.LOST)
    state = mouse.state()
    assert state.axes == (0.0,) * 6
    assert not state.buttons
    assert [e.pressed for e in mouse.button_events()] == [True, False]
    until(lambda: "plugged in" in mouse.state().reason)
    assert puck.opened == 0
    puck.plugged = True
    until(lambda: mouse.state().link is DeviceLink.NEEDS_NEUTRAL)
    puck.send(UP)
    assert mouse.state().link is DeviceLink.NEEDS_NEUTRAL
    puck.send(REST, UP)
    assert mouse.state().link is DeviceLink.LIVE


def test_closing_releases_the_device_and_opening_again_works(usb, open_mouse):
    puck = usb(FakePuck("spacenavigator"))
    mouse = open_mouse()
    mouse.open()
    assert puck.opened == 1
    mouse.close()
    mouse.close()
    assert puck.opened == 0
    assert mouse.state().link is DeviceLink.CLOSED
    with mouse:
        puck.send(encode_translation(0, 0, 0), encode_rotation(0, 0, 0))
        assert mouse.state().link is DeviceLink.LIVE


def test_nothing_plugged_in(usb):
    with pytest.raises(DeviceNotFoundError, match="no 3Dconnexion device is plugged in"):
        SpaceMouse().open()
    usb(FakePuck("spacenavigator"))
    for options, words in (
        ({"model": "spacemouse-pro"}, "model 'spacemouse-pro'"),
        ({"path": "/dev/hidraw9", "serial": "7"}, "path '/dev/hidraw9' and serial '7'"),
    ):
        with pytest.raises(DeviceNotFoundError, match=words):
            SpaceMouse(SpaceMouseOptions(**options)).open()


def test_waiting_for_the_device(usb, open_mouse):
    mouse = open_mouse(wait_for_device=True)
    assert mouse.state().link is DeviceLink.LOST
    assert "plugged in" in mouse.diagnosis()[0]
    puck = usb(FakePuck("spacenavigator"))
    until(lambda: mouse.state().link is DeviceLink.NEEDS_NEUTRAL)
    assert puck.opened == 1


def test_a_device_is_chosen_by_model_path_or_serial(usb, open_mouse):
    one, two, three = usb(
        FakePuck("spacenavigator", path=b"/dev/zero"),
        FakePuck("spacenavigator", path=b"/dev/full", serial="7"),
        FakePuck("spacemouse-compact", path=b"/dev/null"),
    )
    for options, puck in (
        ({"path": "/dev/full"}, two),
        ({"serial": "7"}, two),
        ({"model": "spacenavigator"}, one),
        ({"model": "spacemouse-compact"}, three),
        ({}, three),  # the vendor's own ids come first
    ):
        mouse = open_mouse(**options)
        assert [p.opened for p in (one, two, three)] == [int(p is puck) for p in (one, two, three)]
        mouse.close()


def test_a_path_may_be_a_link_of_udev(usb, open_mouse, tmp_path):
    node, other, link = (tmp_path / name for name in ("hidraw3", "hidraw4", "spacemouse"))
    node.touch()
    other.touch()
    link.symlink_to(node)
    one, two = usb(
        FakePuck("spacenavigator", path=str(other).encode()),
        FakePuck("spacenavigator", path=str(node).encode()),
    )
    open_mouse(path=str(link))
    assert (one.opened, two.opened) == (0, 1)


def test_mice_and_silent_collections_are_left_alone(usb):
    usb(FakePuck("universal-receiver", usage=(0xFF00, 1)))
    mouse = usb(FakePuck("spacenavigator"))
    mouse.info.update(vendor_id=0x256F, product_id=0xC650)
    with pytest.raises(DeviceNotFoundError):
        SpaceMouse().open()
    assert list_devices() == []


def test_a_receiver_is_bound_where_it_speaks(usb, open_mouse):
    slots = usb(
        *(FakePuck("universal-receiver", path=f"/dev/hidraw{n}".encode()) for n in range(5))
    )
    mouse = open_mouse(dead_zone=0.0)
    assert [slot.opened for slot in slots] == [1] * 5
    slots[3].send(encode_battery(50, False))  # battery only: no evidence of a puck
    assert slots[3].opened == 1
    slots[1].send(UP, REST, UP, encode_buttons(1, 3))
    assert [slot.opened for slot in slots] == [0, 1, 0, 0, 0]
    assert mouse.state().axes[2] == 0.5
    assert mouse.state().buttons == {"left"}
    assert {"left", "menu", "ctrl"} <= set(mouse.capabilities.buttons)


def test_a_receiver_that_is_unplugged_before_it_speaks(usb, open_mouse):
    slots = usb(*(FakePuck("universal-receiver", path=f"/dev/{n}".encode()) for n in range(3)))
    mouse = open_mouse()
    slots[0].unplug()
    until(lambda: slots[0].opened == 0)
    assert mouse.state().link is DeviceLink.NEEDS_NEUTRAL
    for slot in slots:
        slot.unplug()
    until(lambda: mouse.state().link is DeviceLink.LOST)


def test_two_pucks_on_one_receiver_are_distinguished_by_slot(usb, open_mouse):
    slots = usb(
        *(
            FakePuck("universal-receiver", path=f"/dev/hidraw{n}".encode(), interface=n)
            for n in range(5)
        )
    )
    left, right = open_mouse(slot="0", dead_zone=0.0), open_mouse(slot="2", dead_zone=0.0)
    assert [slot.opened for slot in slots] == [1, 0, 1, 0, 0]
    slots[2].send(REST, UP)  # the first to send, and still assigned to the right one
    slots[0].send(REST)
    assert (left.state().axes[2], right.state().axes[2]) == (0.0, 0.5)
    for slot in slots:
        slot.unplug()
    for mouse in (left, right):
        until(lambda mouse=mouse: mouse.state().link is DeviceLink.LOST)
    for slot in reversed(slots):
        slot.plugged = True
    until(lambda: [slot.opened for slot in slots] == [1, 0, 1, 0, 0])
    with pytest.raises(DeviceNotFoundError, match="slot '4'"):
        SpaceMouse(SpaceMouseOptions(slot="4", path="/dev/hidraw1")).open()


def test_two_of_a_kind_are_distinguished_by_port(usb, open_mouse, monkeypatch):
    one, two = usb(
        FakePuck("spacenavigator", path=b"/dev/hidraw0"),
        FakePuck("spacenavigator", path=b"/dev/hidraw1"),
    )
    ports = {"/dev/hidraw0": "1-2", "/dev/hidraw1": "1-3.4"}
    monkeypatch.setattr(transports, "usb_port_of", ports.__getitem__)
    open_mouse(port="1-3.4")
    assert (one.opened, two.opened) == (0, 1)
    # After replugging, the nodes have swapped, the ports have not.
    two.unplug()
    until(lambda: two.opened == 0)
    ports.update({"/dev/hidraw0": "1-3.4", "/dev/hidraw1": "1-2"})
    two.plugged = True
    until(lambda: (one.opened, two.opened) == (1, 0))


def test_the_port_of_a_node(tmp_path):
    device = tmp_path / "sys/devices/pci0000:00/usb1/1-3/1-3.4/1-3.4:1.2/0003:046D:C626.0004"
    device.mkdir(parents=True)
    node = tmp_path / "sys/class/hidraw/hidraw7"
    node.mkdir(parents=True)
    (node / "device").symlink_to(device)
    port = transports.usb_port_of
    assert port("/dev/hidraw7", root=str(tmp_path)) == "1-3.4"
    assert port("/dev/hidraw8", root=str(tmp_path)) == ""
    assert port("1-2:1.0") == "1-2"
    assert port("DevSrvsID:4294969") == ""


def test_unknown_usages_are_tried_together(usb, open_mouse):
    usb(
        FakePuck("spacemouse-wireless-receiver", path=b"1-2:1.0", usage=(0, 0)),
        spoken := FakePuck("spacemouse-wireless-receiver", path=b"1-2:1.1", usage=(0, 0)),
    )
    mouse = open_mouse()
    spoken.send(REST)
    assert mouse.state().link is DeviceLink.LIVE


def test_open_refused(usb, open_mouse):
    puck = usb(FakePuck("spacenavigator"))
    puck.refuses = True
    with pytest.raises(DeviceAccessError, match="open failed; another program may hold it"):
        SpaceMouse().open()
    mouse = open_mouse(wait_for_device=True)
    assert "another program" in mouse.state().reason
    puck.refuses = False
    until(lambda: mouse.state().link is DeviceLink.NEEDS_NEUTRAL)


def test_a_seized_device_is_named(usb, open_mouse, monkeypatch):
    usb(FakePuck("spacenavigator"))
    mouse = open_mouse()
    assert not any("seized" in words for words in mouse.diagnosis())
    monkeypatch.setattr(shell, "MUTE_AFTER_S", -1.0)
    assert any("another program has seized it" in words for words in mouse.diagnosis())


def test_the_led_follows_feedback_and_survives_a_replug(usb, open_mouse):
    puck = usb(FakePuck("spacemouse-compact"))
    mouse = open_mouse()
    mouse.feedback(DeviceFeedback(led=False))
    until(lambda: len(puck.written) == 2)
    assert puck.written == [encode_led(True), encode_led(False)]  # a Compact needs both messages
    mouse.feedback(DeviceFeedback(led=True))
    mouse.feedback(DeviceFeedback())
    until(lambda: len(puck.written) == 3)
    assert puck.written[2] == encode_led(True)
    puck.unplug()
    until(lambda: mouse.state().link is DeviceLink.LOST)
    puck.plugged = True
    until(lambda: len(puck.written) == 4)
    assert puck.written[3] == encode_led(True)


@pytest.mark.parametrize(
    ("policy", "written"),
    [("keep", []), ("on", [encode_led(True)]), ("off", [encode_led(True), encode_led(False)])],
)
def test_led_policy(usb, open_mouse, policy, written):
    puck = usb(FakePuck("spacenavigator"))
    mouse = open_mouse(led=policy)
    mouse.close()
    assert puck.written == written


def test_the_led_of_the_last_moment_is_set_before_closing(usb, open_mouse):
    puck = usb(FakePuck("spacenavigator"))
    mouse = open_mouse(led="on")
    until(lambda: puck.written)
    mouse.feedback(DeviceFeedback(led=False))
    mouse.close()
    assert puck.written[-1] == encode_led(False)


def test_an_led_that_cannot_be_set_is_said(usb, open_mouse):
    puck = usb(FakePuck("spacenavigator"))
    puck.model = puck.model._replace(led=False)
    mouse = open_mouse(led="on")
    until(lambda: any("LED could not" in words for words in mouse.diagnosis()))
    assert mouse.state().link is DeviceLink.NEEDS_NEUTRAL


def test_feedback_that_it_has_not(usb, open_mouse):
    usb(FakePuck("spacemouse-usb"))
    mouse = open_mouse()
    with pytest.raises(CommandError, match="no led feedback"):
        mouse.feedback(DeviceFeedback(led=True))
    with pytest.raises(NotOpenError):
        SpaceMouse().feedback(DeviceFeedback(led=True))


def test_rezero_reaches_the_core(usb, open_mouse):
    puck = usb(FakePuck("spacemouse-wireless"))
    mouse = open_mouse()
    with pytest.raises(CommandError, match="has not reported"):
        mouse.rezero()
    puck.send(REST, UP)
    with pytest.raises(CommandError, match="let go"):
        mouse.rezero()


def test_libusb_is_the_second_choice(usb, open_mouse, monkeypatch):
    puck = FakePuck("spacenavigator", path=b"1-2:1.0")
    monkeypatch.setitem(sys.modules, "hid", fake_hidapi([puck]))
    open_mouse().close()
    with pytest.raises(DeviceNotFoundError):
        SpaceMouse(SpaceMouseOptions(transport="hidraw")).open()
    open_mouse(transport="libusb")
    assert puck.opened == 1


def test_the_wrong_hid_package_is_named(monkeypatch):
    wrong = types.ModuleType("hid")
    wrong.Device = wrong.enumerate = object
    monkeypatch.setitem(sys.modules, "hid", wrong)
    with pytest.raises(DeviceAccessError, match=r"package `hid`, a different one.*uninstall"):
        SpaceMouse(SpaceMouseOptions(transport="libusb")).open()


def test_a_missing_hid_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "hid", None)
    monkeypatch.setitem(sys.modules, "hidraw", None)
    with pytest.raises(DeviceAccessError, match="pip install hidapi"):
        SpaceMouse().open()
    with pytest.raises(DriverError, match="pip install hidapi"):
        list_devices()


def test_half_a_hid_package_is_enough(usb, monkeypatch):
    monkeypatch.setitem(sys.modules, "hid", None)
    with pytest.raises(DeviceNotFoundError):
        SpaceMouse().open()
    assert list_devices() == []


def test_a_device_newer_than_the_table(usb, open_mouse):
    puck = usb(FakePuck("spacemouse-wireless"))
    puck.info.update(product_id=0xC6FE, product_string="SpaceMouse 9000")
    assert list_devices()[0].name == "SpaceMouse 9000"
    mouse = open_mouse()
    assert mouse.capabilities.buttons == ()
    puck.send(REST, encode_buttons(1 << 23, 7))
    assert mouse.state().link is DeviceLink.LIVE
    assert mouse.state().buttons == {"alt"}


def test_a_flood_of_reports_does_not_keep_the_led_waiting(usb):
    puck = usb(FakePuck("spacenavigator"))
    with SpaceMouse() as mouse:
        puck.reports = Endless(REST)
        until(lambda: mouse.state().link is DeviceLink.LIVE)
        mouse.feedback(DeviceFeedback(led=True))
        until(lambda: puck.written)


class Endless:
    def __init__(self, report):
        self.report = report

    def popleft(self):
        return self.report


def test_a_bug_in_the_reader_is_no_silent_death(usb, monkeypatch):
    puck = usb(FakePuck("spacenavigator"))
    mouse = SpaceMouse()
    monkeypatch.setattr(mouse._core, "on_report", lambda report, now_s: 1 / 0)
    mouse.open()

    def lost():
        # It is lost only for a moment, and the test repeats the fault if it missed that.
        with puck.condition:
            if not puck.reports:
                puck.reports.append(REST)
                puck.condition.notify_all()
        state = mouse.state()
        return state if "ZeroDivisionError" in state.reason else None

    assert until(lost).link is DeviceLink.LOST
    until(lambda: mouse.state().link is DeviceLink.NEEDS_NEUTRAL)  # and recovers
    mouse.close()


# -- obstacles to opening ----------------------------------------------------------------------


def test_what_is_plugged_in_for_everybody(usb, monkeypatch):
    usb(FakePuck("spacemouse-pro", path=b"/dev/null"))
    (found,) = SpaceMouse.find()
    assert (found.name, found.identity) == ("SpaceMouse Pro", "046d:c62b")
    assert (found.transport, found.path, found.obstacle) == ("hidraw", "/dev/null", "")
    usb(FakePuck("universal-receiver", path=b"/dev/zero", interface=3))
    monkeypatch.setattr(transports, "usb_port_of", lambda path: "1-2.3")
    names = [device.name for device in SpaceMouse.find()]
    assert names == ["Universal Receiver (port 1-2.3, slot 3)", "SpaceMouse Pro (port 1-2.3)"]


@pytest.fixture
def only_usb(usb, monkeypatch):
    """Let hidapi find nothing; raw USB finds the given devices, or raises the given error."""

    def plug(*found):
        def find(self):
            for each in found:
                if isinstance(each, Exception):
                    raise each
            return list(found)

        monkeypatch.setattr(shell.UsbTransport, "find", find)

    return plug


def test_hidapi_that_is_missing_or_hidden_is_the_obstacle(only_usb, monkeypatch):
    only_usb()
    assert SpaceMouse.find() == []
    for module, words in (
        (types.ModuleType("hidraw"), "module 'hidraw' is not that of the package hidapi"),
        (None, "module 'hidraw' of the package hidapi cannot be imported"),
    ):
        monkeypatch.setitem(sys.modules, "hidraw", module)
        monkeypatch.setitem(sys.modules, "hid", module)
        (row,) = SpaceMouse.find()
        assert row.obstacle.startswith(words)
        assert (row.identity, row.path) == ("", "")


COMPACT = model_by_key("spacemouse-compact")
ON_USB = transports.HidCandidate(
    COMPACT.name, COMPACT.vendor_id, COMPACT.product_id, "usb", "1-2:1.0", model=COMPACT, port="1-2"
)


def test_what_raw_usb_alone_shows_is_listed_with_the_option(usb, only_usb, monkeypatch):
    only_usb(ON_USB)
    (row,) = SpaceMouse.find()
    assert (row.name, row.identity) == ("SpaceMouse Compact (port 1-2)", "256f:c635")
    assert (row.transport, row.path) == ("usb", "1-2:1.0")
    assert 'transport = "usb"' in row.obstacle
    monkeypatch.setattr(shell, "obstacle", lambda path: f"no permission for {path}")
    (row,) = SpaceMouse.find()
    assert re.fullmatch('no permission for 1-2:1.0; .*transport = "usb".*', row.obstacle)
    monkeypatch.setitem(sys.modules, "hidraw", None)
    monkeypatch.setitem(sys.modules, "hid", None)
    hidden, row = SpaceMouse.find()
    assert "pip install hidapi" in hidden.obstacle
    assert row.path == "1-2:1.0"


def test_raw_usb_is_not_asked_where_hidapi_shows_something(usb, only_usb):
    usb(FakePuck("spacemouse-pro"))
    only_usb(ON_USB)
    assert [row.transport for row in SpaceMouse.find()] == ["hidraw"]


def test_no_libusb_is_no_obstacle_but_a_loose_plug_is(only_usb):
    only_usb(DriverError("pyusb finds no libusb"))
    assert SpaceMouse.find() == []
    only_usb(DeviceAccessError("the Compact at 1-2 cannot be identified: plug it in again"))
    (row,) = SpaceMouse.find()
    assert (row.transport, row.path) == ("usb", "")
    assert "plug it in again" in row.obstacle


class OtherMouse(SpaceMouse):
    """Second driver whose devices hidapi hides."""

    @classmethod
    def find(cls):
        return [each if each.path else each._replace(name="other mice") for each in super().find()]


def test_the_table_says_once_what_hides_the_devices_of_several_drivers(
    only_usb, monkeypatch, capsys
):
    only_usb(ON_USB)
    monkeypatch.setitem(sys.modules, "hidraw", None)
    monkeypatch.setitem(sys.modules, "hid", None)
    monkeypatch.setitem(registry.BUILT_IN, "other_mouse", f"{__name__}:OtherMouse")
    monkeypatch.setattr(registry.FINDER, "_installed", lambda: ())
    monkeypatch.setenv("COLUMNS", "400")
    print_devices()
    said = capsys.readouterr().out
    assert said.count("pip install hidapi") == 1
    assert re.search("other mice, 3Dconnexion devices +other_mouse, spacemouse ", said)
    assert "SpaceMouse Compact (port 1-2)" in said


def test_brackets_in_an_obstacle_are_shown(monkeypatch, capsys):
    def find():
        return [base.FoundDevice("can0", "", "can", "can0", 'pip install "cardan[can]"')]

    monkeypatch.setattr(registry, "names", lambda: ("spacemouse",))
    monkeypatch.setattr(SpaceMouse, "find", find)
    monkeypatch.setenv("COLUMNS", "200")
    print_devices()
    assert 'pip install "cardan[can]"' in capsys.readouterr().out


def test_list_devices(usb):
    usb(
        FakePuck("spacemouse-pro", path=b"/dev/null", serial="7"),
        FakePuck("spacemouse-wireless", path=b"/dev/hidraw-not-there"),
    )
    wireless, pro = list_devices()
    assert (pro.name, pro.vendor_id, pro.product_id) == ("SpaceMouse Pro", 0x046D, 0xC62B)
    assert (pro.transport, pro.path, pro.serial) == ("hidraw", "/dev/null", "7")
    assert pro.obstacle == ""
    assert pro.model is model_by_key("spacemouse-pro")
    assert "gone" in wireless.obstacle


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.EACCES, "no permission for .*udev rules"),
        (errno.EPERM, "no permission"),
        (errno.EBUSY, "another program holds"),
        (errno.ENODEV, "is gone"),
        (errno.EIO, "Input/output error"),
    ],
)
@pytest.mark.parametrize("path", ["/dev/hidraw3", "3-1.4:1.0", "0003:0011:00"])
def test_obstacles_by_errno(tmp_path, monkeypatch, code, words, path):
    port = tmp_path / "sys/bus/usb/devices/3-1.4"
    port.mkdir(parents=True)
    (port / "busnum").write_text("3\n")
    (port / "devnum").write_text("17\n")
    tried = []

    def refuse(node, flags):
        tried.append(str(node))
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(access.os, "open", refuse)
    assert re.search(words, access.obstacle(path, root=tmp_path))
    expected = "dev/hidraw3" if path.startswith("/dev") else "dev/bus/usb/003/017"
    assert tried == [str(tmp_path / expected)]


def test_no_obstacle(tmp_path):
    node = tmp_path / "dev/hidraw0"
    node.parent.mkdir()
    node.touch()
    assert access.obstacle("/dev/hidraw0", root=tmp_path) == ""
    assert "gone" in access.obstacle("/dev/hidraw1", root=tmp_path)
    assert access.obstacle("7-7:1.0", root=tmp_path) == ""
    assert access.obstacle("DevSrvsID:4294969", root=tmp_path) == ""


def test_permission_is_distinguished_from_a_busy_device(usb, monkeypatch):
    puck = usb(FakePuck("spacenavigator", path=b"/dev/hidraw3"))
    puck.refuses = True

    def refuse(node, flags):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(access.os, "open", refuse)
    with pytest.raises(DeviceAccessError, match=r"no permission for /dev/hidraw3.*udev"):
        SpaceMouse().open()


def test_refusal_on_macos(monkeypatch):
    monkeypatch.setattr(access.sys, "platform", "darwin")
    assert "3DconnexionHelper" in access.refusal("DevSrvsID:1", OSError("open failed"))


# -- socket ------------------------------------------------------------------------------------


class Puck:
    """The device's end of the socket."""

    def __init__(self, path):
        self.path = str(path)
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.listener.settimeout(PATIENCE_S)
        self.listener.bind(self.path)
        self.listener.listen(1)
        self.peer = None

    def accept(self):
        self.peer, _ = self.listener.accept()
        self.peer.settimeout(PATIENCE_S)

    def send(self, *reports):
        for report in reports:
            self.peer.send(report)

    def close(self):
        for sock in (self.peer, self.listener):
            if sock is not None:
                sock.close()


@pytest.fixture
def puck(tmp_path):
    puck = Puck(tmp_path / "puck")
    yield puck
    puck.close()


@pytest.mark.real
def test_socket_both_ways(puck, open_mouse):
    mouse = open_mouse(transport="socket", path=puck.path, dead_zone=0.0, led="on")
    puck.accept()
    assert puck.peer.recv(64) == encode_led(True)
    puck.send(
        encode_translation(0, 0, 0), encode_rotation(0, 0, 0), encode_buttons(1, 3),
        encode_translation(0, 0, -175), encode_rotation(0, 0, 0), encode_buttons(3, 3),
    )  # fmt: skip
    until(lambda: mouse.state().buttons == {"left", "right"})
    assert [e.button for e in mouse.button_events()] == ["left", "right"]
    mouse.feedback(DeviceFeedback(led=False))
    assert puck.peer.recv(64) == encode_led(False)
    assert mouse.capabilities.buttons == ()
    assert mouse.capabilities.feedback == {"led"}
    mouse.close()
    assert puck.peer.recv(64) == b""


def test_an_led_message_that_nobody_reads_does_not_delay_motion(puck):
    link = HidSocketLink(puck.path)
    puck.accept()
    with pytest.raises(TimeoutError):
        write_all(link, [encode_led(True)] * 100_000)
    report = encode_translation(0, 0, -175)
    puck.send(report)
    assert link.read(0.0) == report
    assert 2 * packet_socket.FEEDBACK_TIMEOUT_S < STALE_AFTER_S  # switched on and off
    link.close()
    puck.peer.setblocking(False)


def write_all(link, reports):
    for report in reports:
        link.write(report)


def test_socket_model_names_the_buttons(puck, open_mouse):
    mouse = open_mouse(transport="socket", path=puck.path, model="spacemouse-pro")
    puck.accept()
    assert mouse.capabilities.buttons[:3] == ("menu", "fit", "top")
    puck.send(encode_buttons(1 << 26, 7))
    until(lambda: mouse.state().buttons == {"rotate-lock"})


@pytest.mark.real
def test_socket_unplug_and_replug(puck, tmp_path, open_mouse, monkeypatch):
    monkeypatch.setattr(reader_thread, "RETRY_FIRST_S", 0.005)
    mouse = open_mouse(transport="socket", path=puck.path)
    puck.accept()
    puck.send(REST, encode_buttons(1, 3))
    until(lambda: mouse.state().buttons)
    puck.close()
    os.unlink(puck.path)
    until(lambda: mouse.state().link is DeviceLink.LOST)
    assert [e.pressed for e in mouse.button_events()] == [True, False]
    again = Puck(puck.path)
    again.accept()
    until(lambda: mouse.state().link is DeviceLink.NEEDS_NEUTRAL)
    again.close()


def test_socket_that_is_not_there(tmp_path):
    path = str(tmp_path / "nothing")
    with pytest.raises(DeviceNotFoundError, match=r"no socket at .*nothing"):
        SpaceMouse(SpaceMouseOptions(transport="socket", path=path)).open()
    (tmp_path / "nothing").touch()
    with pytest.raises(DeviceAccessError, match="Connection refused; is its simulated device"):
        SpaceMouse(SpaceMouseOptions(transport="socket", path=path)).open()


def test_a_read_of_hidapi_waits_as_long_as_it_may_and_never_for_ever():
    asked = []

    class Handle:
        open_path = set_nonblocking = lambda self, value: 0

        def read(self, room, timeout_ms=None):
            asked.append(timeout_ms)
            return []

    device = HidDevice(types.SimpleNamespace(device=Handle), "puck")
    assert [device.read(timeout_s) for timeout_s in (0.25, 1e-5, 0.0)] == [None] * 3
    assert asked == [250, 1, None]


def test_socket_keeps_packets_apart(puck):
    transport = SocketTransport(puck.path)
    link = transport.open(transport.find()[0])
    puck.accept()
    assert link.read(0.0) is None
    assert link.read(0.001) is None
    puck.send(b"\x03\x01\x00", b"\x2a" * 40)
    assert link.read(1.0) == b"\x03\x01\x00"
    assert link.read(0.0) == b"\x2a" * 40
    assert link.descriptor() is None
    puck.peer.close()
    with pytest.raises(OSError, match="unplugged"):
        link.read(1.0)
    link.close()


def test_transports_can_be_replaced(usb):
    puck = usb(FakePuck("spacenavigator"))
    mouse = SpaceMouse(transports=[HidTransport("mine", "hidraw")])
    with mouse:
        assert puck.opened == 1
    assert puck.opened == 0
