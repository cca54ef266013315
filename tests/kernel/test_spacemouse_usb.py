"""A SpaceNavigator served over USB/IP: a USB device to the kernel and to libusb."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import usb.core
import usb.util

from cardan.drivers.spacemouse import SpaceMouse, SpaceMouseOptions
from cardan.drivers.spacemouse.transports import hid_transport
from cardan.drivers.spacemouse.usb import UsbTransport
from cardan.protocols.connexion.reports import decode_input
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions
from cardan.types import DeviceFeedback, DeviceLink
from tests.kernel.usbip import attach, is_unplugged, usbip
from tests.kernel.waiting import in_a_process, wait_for
from tests.serving import in_a_thread

MOVE = """
    0.1  axes 0 0 0.2 0 0 0 over 0.1   # touch, let go, and move after a while, again and again
    0.2  neutral over 0.1
    1.0  axes 0.5 -0.25 1 0 0.125 -1
    1.0  press first
    2.0  release first
    2.0  neutral
    2.5  loop
"""
EXPECTED = (0.5, -0.25, 1.0, 0.0, 0.125, -1.0)


@pytest.fixture(autouse=True)
def kernel(modules: Callable[..., None]) -> None:
    modules("vhci-hcd", "usbhid", "hid-generic", "hid-logitech")


@pytest.fixture
def puck(tmp_path: Path) -> Iterator[Callable[..., SpaceMousePeer]]:
    def make(script: str, model: str = "spacenavigator") -> SpaceMousePeer:
        file = tmp_path / "script.txt"
        file.write_text(script)
        return SpaceMousePeer(
            SpaceMousePeerOptions(model=model, script=str(file), usbip=0, jitter_lsb=0)
        )

    yield make
    wait_for(is_unplugged)


@pytest.mark.judged(
    device="SpaceNavigator", transport="USB", by="Linux kernel 6.1: vhci-hcd; Debian usbip; libusb"
)
def test_libusb_reads_reports_and_sets_the_led(puck):
    with in_a_thread(puck(MOVE)) as peer:
        attach(peer.endpoint)
        device = wait_for(lambda: usb.core.find(idVendor=0x046D, idProduct=0xC626))
        assert (device.manufacturer, device.product) == ("3Dconnexion", "SpaceNavigator")
        device.detach_kernel_driver(0)
        reports = [bytes(device.read(0x81, 64, 5000)) for _ in range(40)]
        kinds = {type(decode_input(report)).__name__ for report in reports}
        assert kinds >= {"Translation", "Rotation"}
        assert peer.device.led
        assert device.ctrl_transfer(0x21, 0x09, 0x0204, 0, b"\x04\x00") == 2
        wait_for(lambda: not peer.device.led)
        with pytest.raises(usb.core.USBError):
            device.ctrl_transfer(0xA1, 0x01, 0x0305, 0, 8)
        usb.util.dispose_resources(device)


@pytest.mark.judged(
    device="SpaceNavigator",
    transport="hidraw over USB",
    by="Linux kernel 6.1: usbhid, hid-logitech",
)
def test_the_kernels_logitech_driver_takes_it_and_gives_a_hidraw_node(puck):
    with in_a_process(puck(MOVE)) as endpoint:
        attach(endpoint)
        follow("hidraw")


@pytest.mark.judged(
    device="SpaceNavigator", transport="hidapi's libusb", by="Linux kernel 6.1: vhci-hcd, usbfs"
)
def test_the_driver_follows_it_through_hidapis_libusb(puck):
    with in_a_process(puck(MOVE)) as endpoint:
        attach(endpoint)
        follow("libusb")


@pytest.mark.judged(
    device="SpaceNavigator", transport="pyusb", by="Linux kernel 6.1: vhci-hcd, usbfs"
)
def test_the_driver_follows_it_through_pyusb(puck):
    with in_a_process(puck(MOVE)) as endpoint:
        attach(endpoint)
        follow("usb")


@pytest.mark.judged(
    device="Universal Receiver", transport="hidraw over USB", by="Linux kernel 6.1: usbhid"
)
def test_of_a_receivers_five_interfaces_the_one_that_speaks_is_bound(puck):
    with in_a_process(puck(MOVE.replace("first", "menu"), "universal-receiver")) as endpoint:
        attach(endpoint)
        assert wait_for(lambda: len(hid_transport("hidraw").find()) == 5)
        follow("hidraw", "menu")


@pytest.mark.judged(
    device="SpaceNavigator", transport="USB, unplugged", by="Linux kernel 6.1: vhci-hcd, usbhid"
)
def test_unplugged_on_the_bus_it_is_lost_and_picked_up_again(puck):
    script = """
        0.1  axes 0 0 0.2 0 0 0 over 0.1
        0.2  neutral over 0.1
        0.9  axes 0 0 0.2 0 0 0 over 0.1   # again, for a driver that was still opening it
        1.0  neutral over 0.1
        2.0  axes 0.5 0 0 0 0 0
        5.0  unplug
        5.2  replug
        5.3  axes 0 0.5 0 0 0 0
    """ + "\n".join(  # Repeated, because the kernel may still be attaching the device.
        f"""
        {at} neutral
        {at + 0.5} axes 0 0 0.2 0 0 0 over 0.1
        {at + 0.6} neutral over 0.1
        {at + 1.5} axes 0 0 0.5 0 0 0
        """
        for at in range(15, 60, 3)
    )
    with (
        in_a_process(puck(script)) as endpoint,
        SpaceMouse(SpaceMouseOptions(transport="hidraw", wait_for_device=True)) as mouse,
    ):
        attach(endpoint)
        wait_for(lambda: mouse.state().axes[0] > 0.4)
        lost = wait_for(lambda: (s := mouse.state()).link is DeviceLink.LOST and s)
        assert not any(lost.axes)
        wait_for(is_unplugged)
        attach(endpoint)
        again = wait_for(lambda: (s := mouse.state()).link is DeviceLink.NEEDS_NEUTRAL and s)
        assert not any(again.axes)
        wait_for(lambda: mouse.state().axes[2] > 0.4)


def follow(transport: str, button: str = "left") -> None:
    """Open the device and check motion, a button and the LED."""
    way = UsbTransport() if transport == "usb" else hid_transport(transport)
    wait_for(lambda: way.find())
    # The device may be listed while the kernel is still attaching it.
    options = SpaceMouseOptions(transport=transport, dead_zone=0.0, wait_for_device=True)
    with SpaceMouse(options) as mouse:
        # The puck is deflected at opening: only one of the two motion reports has arrived at first.
        expected = pytest.approx(EXPECTED, abs=0.5 / 350 + 1e-9)
        state = wait_for(lambda: (s := mouse.state()).axes == expected and s)
        assert state.link is DeviceLink.LIVE
        mouse.feedback(DeviceFeedback(led=False))
        edges = []
        wait_for(lambda: edges.extend(mouse.button_events()) or len(edges) >= 4)
        pressed = [edge.pressed for edge in edges]
        assert {edge.button for edge in edges} == {button}
        assert pressed in ([True, False] * 2, [True, False] * 3, [False, True] * 2)
        wait_for(lambda: not any(mouse.state().axes))
        assert not any("LED" in words for words in mouse.diagnosis())


def test_the_tool_lists_what_is_exported(tmp_path):
    with in_a_thread(SpaceMousePeer(SpaceMousePeerOptions(script="rest", usbip=0))) as peer:
        said = usbip(peer.endpoint, "list").stdout
    assert re.search(r"1-1:.*046d:c626", said)
