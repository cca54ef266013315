"""Raw USB: pyusb with a stand-in for libusb that lists the plugged devices."""

import errno
import sys
import threading
from collections import deque
from types import SimpleNamespace

import pytest
import usb.backend
import usb.backend.libusb0
import usb.backend.libusb1
import usb.backend.openusb
import usb.core

from cardan.drivers import reader_thread
from cardan.drivers.spacemouse import SpaceMouse, SpaceMouseOptions
from cardan.drivers.spacemouse.usb import UsbTransport
from cardan.errors import DeviceAccessError, DeviceNotFoundError
from cardan.protocols.connexion.descriptors import descriptor_for
from cardan.protocols.connexion.devices import model_by_key
from cardan.protocols.connexion.reports import (
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


class Interface:
    """Interface of a plugged device."""

    def __init__(self, subclass=0, protocol=0, endpoint=0x81):
        self.subclass = subclass
        self.protocol = protocol
        self.endpoint = endpoint
        self.reports = deque()
        self.kernel_has_it = True
        self.claimed = 0


class Puck:
    """Device at a USB port."""

    def __init__(self, model, interfaces=1, ports=(2,), serial=""):
        self.model = model_by_key(model)
        self.interfaces = [Interface(endpoint=0x81 + number) for number in range(interfaces)]
        self.ports = ports
        self.serial = serial
        self.plugged = True
        self.refuses = None
        self.opened = 0
        self.written = []
        self.condition = threading.Condition()

    def send(self, *reports, interface=0):
        with self.condition:
            self.interfaces[interface].reports.extend(reports)
            self.condition.notify_all()

    def unplug(self):
        with self.condition:
            self.plugged = False
            self.condition.notify_all()

    def check(self):
        if not self.plugged:
            raise usb.core.USBError("No such device", -4, errno.ENODEV)


class FakeLibusb(usb.backend.IBackend):
    """Stand-in for the functions of libusb that pyusb calls."""

    def __init__(self, pucks):
        self.pucks = pucks

    def enumerate_devices(self):
        yield from (puck for puck in self.pucks if puck.plugged)

    def get_device_descriptor(self, dev):
        model = dev.model
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x200, bDeviceClass=0, bDeviceSubClass=0,
            bDeviceProtocol=0, bMaxPacketSize0=8, idVendor=model.vendor_id,
            idProduct=model.product_id, bcdDevice=0x100, iManufacturer=0, iProduct=0,
            iSerialNumber=3 if dev.serial else 0, bNumConfigurations=1, address=5, bus=1,
            port_number=dev.ports[-1], port_numbers=dev.ports, speed=1,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev, config):
        if config:
            raise IndexError
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=34, bNumInterfaces=len(dev.interfaces),
            bConfigurationValue=1, iConfiguration=0, bmAttributes=0x80, bMaxPower=50,
            extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev, intf, alt, config):
        if alt or intf >= len(dev.interfaces):
            raise IndexError
        interface = dev.interfaces[intf]
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=intf, bAlternateSetting=0,
            bNumEndpoints=1, bInterfaceClass=3, bInterfaceSubClass=interface.subclass,
            bInterfaceProtocol=interface.protocol, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev, ep, intf, alt, config):
        if ep:
            raise IndexError
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=dev.interfaces[intf].endpoint,
            bmAttributes=3, wMaxPacketSize=32, bInterval=8, bRefresh=0, bSynchAddress=0,
            extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev):
        dev.check()
        if dev.refuses:
            raise usb.core.USBError("Access denied", -3, dev.refuses)
        dev.opened += 1
        return dev

    def close_device(self, dev):
        dev.opened -= 1

    def get_configuration(self, dev):
        return 1

    def set_configuration(self, dev, value):
        pass

    def claim_interface(self, dev, intf):
        if dev.interfaces[intf].kernel_has_it or dev.interfaces[intf].claimed:
            raise usb.core.USBError("Resource busy", -6, errno.EBUSY)
        dev.interfaces[intf].claimed += 1

    def release_interface(self, dev, intf):
        dev.interfaces[intf].claimed -= 1
        dev.check()

    def is_kernel_driver_active(self, dev, intf):
        dev.check()
        return dev.interfaces[intf].kernel_has_it

    def detach_kernel_driver(self, dev, intf):
        dev.interfaces[intf].kernel_has_it = False

    def attach_kernel_driver(self, dev, intf):
        dev.interfaces[intf].kernel_has_it = True
        dev.check()

    def ctrl_transfer(self, dev, request_type, request, value, index, data, timeout):
        dev.check()
        if (request_type, request, value >> 8) == (0x80, 0x06, 3):  # string descriptor
            text = bytes.fromhex("0409") if not value & 0xFF else dev.serial.encode("utf-16-le")
            answer = bytes((len(text) + 2, 3)) + text
        elif (request_type, request, value) == (0x81, 0x06, 0x2200):
            answer = descriptor_for(dev.model)
        elif (request_type, request, value) == (0x21, 0x09, 0x0204):
            dev.written.append((index, data.tobytes()))
            return len(data)
        else:
            raise usb.core.USBError("Pipe error", -9, errno.EPIPE)
        answer = answer[: len(data)]
        data[: len(answer)] = type(data)("B", answer)
        return len(answer)

    def intr_read(self, dev, ep, intf, buff, timeout):
        assert timeout > 0, "0 would be for ever"
        interface = dev.interfaces[intf]
        with dev.condition:
            dev.condition.wait_for(lambda: interface.reports or not dev.plugged, timeout / 1000)
            dev.check()
            if not interface.reports:
                raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
            report = interface.reports.popleft()
        buff[: len(report)] = type(buff)("B", report)
        return len(report)


@pytest.fixture
def plug(monkeypatch):
    monkeypatch.setattr(reader_thread, "RETRY_FIRST_S", 0.005)
    pucks = []
    backend = FakeLibusb(pucks)
    monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda *_, **__: backend)

    def add(*more):
        pucks.extend(more)
        return more[0]

    return add


def mouse(**options):
    return SpaceMouse(SpaceMouseOptions(transport="usb", dead_zone=0.0, **options))


@pytest.mark.real
def test_it_takes_the_interface_and_gives_it_back(plug):
    puck = plug(Puck("spacemouse-wireless"))
    interface = puck.interfaces[0]
    with mouse(led="on") as device:
        assert (interface.kernel_has_it, interface.claimed) == (False, 1)
        puck.send(REST, UP, encode_buttons(2, 3))
        until(lambda: device.state().buttons == {"right"})
        assert device.state().link is DeviceLink.LIVE
        assert device.state().axes[2] == 0.5
        until(lambda: puck.written == [(0, encode_led(True))])
        device.feedback(DeviceFeedback(led=False))
        until(lambda: len(puck.written) == 2)
        assert device.capabilities.battery
    assert (interface.kernel_has_it, interface.claimed, puck.opened) == (True, 0, 0)


def test_halves_and_the_full_scale_of_the_descriptor(plug):
    puck = plug(Puck("spacenavigator"))
    puck.model = puck.model._replace(full_scale=500)
    with mouse() as device:
        puck.send(encode_translation(0, 0, 0), encode_rotation(0, 0, 0))
        puck.send(encode_translation(0, 0, -250), encode_rotation(0, 0, 0))
        until(lambda: device.state().axes[2] == 0.5)


def test_unplug_and_replug(plug):
    puck = plug(Puck("spacemouse-wireless"))
    with mouse() as device:
        puck.send(REST, UP)
        until(lambda: device.state().axes[2] == 0.5)
        puck.unplug()
        until(lambda: device.state().link is DeviceLink.LOST)
        assert not any(device.state().axes)
        assert puck.opened == 0
        puck.plugged = True
        until(lambda: device.state().link is DeviceLink.NEEDS_NEUTRAL)


def test_a_device_that_is_being_plugged_in_is_not_there_yet(plug, monkeypatch):
    coming = plug(Puck("spacenavigator"))
    ask = FakeLibusb.get_configuration_descriptor

    def answer(self, dev, config):
        if answer.refused:
            answer.refused -= 1
            raise usb.core.USBError("No such device", -4, errno.ENODEV)
        return ask(self, dev, config)

    monkeypatch.setattr(FakeLibusb, "get_configuration_descriptor", answer)
    answer.refused = 1
    with pytest.raises(DeviceNotFoundError):
        mouse().open()
    assert UsbTransport().find()
    coming.refuses = errno.ENODEV
    with pytest.raises(DeviceAccessError, match=r"cannot open SpaceNavigator: 1-2:1\.0 is gone"):
        mouse().open()
    answer.refused, coming.refuses = 1, None
    with mouse(wait_for_device=True) as device:
        until(lambda: device.state().link is DeviceLink.NEEDS_NEUTRAL)


def test_a_device_that_vanishes_while_it_is_looked_at(plug, monkeypatch):
    broken = plug(Puck("spacenavigator"))
    ask = FakeLibusb.get_configuration_descriptor
    looks = []

    def vanish(self, dev, config):
        looks.append(dev)
        if dev is broken and len(looks) > vanish.after:
            raise usb.core.USBError("Input/Output Error", -1, errno.EIO)
        return ask(self, dev, config)

    monkeypatch.setattr(FakeLibusb, "get_configuration_descriptor", vanish)
    for vanish.after, words in (
        (0, r"SpaceNavigator at 1-2 cannot be identified .*: plug it in again"),
        (1, r"cannot open SpaceNavigator: 1-2:1\.0: .*Input/Output Error"),
    ):
        looks.clear()
        with pytest.raises(DeviceAccessError, match=words):
            mouse().open()
    vanish.after = 0
    plug(Puck("spacemouse-compact", ports=(3,)))
    with mouse() as device:  # the other device is not affected
        assert device.state().link is DeviceLink.NEEDS_NEUTRAL


def test_a_receiver_has_slots(plug):
    receiver = Puck("universal-receiver", interfaces=4)
    receiver.interfaces[3].subclass = receiver.interfaces[3].protocol = 1  # a keyboard
    plug(receiver)
    with mouse() as device:
        assert [i.claimed for i in receiver.interfaces] == [1, 1, 1, 0]
        receiver.send(UP, interface=1)
        until(lambda: [i.claimed for i in receiver.interfaces] == [0, 1, 0, 0])
        assert device.state().link is DeviceLink.NEEDS_NEUTRAL
    with mouse(slot="2") as left, mouse(slot="0") as right:
        assert [i.claimed for i in receiver.interfaces] == [1, 0, 1, 0]
        receiver.send(REST, UP, interface=2)
        until(lambda: left.state().axes[2] == 0.5)
        assert not right.state().stamp_s > 0
    with mouse(slot="1"), pytest.raises(DeviceAccessError, match=r"1-2:1\.1"):
        mouse(slot="1").open()  # a second session is refused
    with pytest.raises(DeviceNotFoundError, match="slot '3'"):
        mouse(slot="3").open()


def test_two_of_a_kind_are_distinguished_by_port_or_serial(plug):
    plug(one := Puck("spacenavigator"), two := Puck("spacenavigator", ports=(3, 1), serial="7"))
    found = UsbTransport().find()
    assert [(d.path, d.port, d.serial) for d in found] == [
        ("1-2:1.0", "1-2", ""), ("1-3.1:1.0", "1-3.1", "7"),
    ]  # fmt: skip
    for options in ({"port": "1-3.1"}, {"serial": "7"}, {"path": "1-3.1:1.0"}):
        with mouse(**options):
            assert (one.opened, two.opened) == (0, 1)
    with pytest.raises(DeviceNotFoundError, match="port '1-4'"):
        mouse(port="1-4").open()


def test_what_stands_in_the_way(plug, monkeypatch):
    puck = plug(Puck("spacenavigator"))
    puck.refuses = errno.EACCES
    with pytest.raises(DeviceAccessError, match=r"cannot open SpaceNavigator: .*Access denied"):
        mouse().open()
    puck.refuses = None
    puck.interfaces[0].kernel_has_it = False
    puck.interfaces[0].claimed = 1
    with pytest.raises(DeviceAccessError, match="Resource busy"):
        mouse().open()
    for module in (usb.backend.libusb1, usb.backend.openusb, usb.backend.libusb0):
        monkeypatch.setattr(module, "get_backend", lambda *_, **__: None)
    with pytest.raises(DeviceAccessError, match="pyusb finds no libusb: install it"):
        mouse().open()
    monkeypatch.setitem(sys.modules, "usb.core", None)
    with pytest.raises(DeviceAccessError, match="pyusb cannot be imported"):
        mouse().open()


def test_mice_and_strangers_are_left_alone(plug):
    puck = plug(Puck("universal-receiver"))
    puck.model = puck.model._replace(product_id=0xC650)
    assert UsbTransport().find() == []
