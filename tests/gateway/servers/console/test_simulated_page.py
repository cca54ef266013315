"""A simulated page at protocol level, the console server, and the driver behind it."""

from __future__ import annotations

import pytest

pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")
pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.drivers.bus_devices import Phone, Xr
from cardan.errors import AddressError, DriverError
from cardan.protocols.handheld.frames import decode_frame
from cardan.sim_peers.handheld import PagePeer, PagePeerOptions, XrPeerOptions
from cardan.types import DeviceFeedback, DeviceLink
from tests.gateway.servers.console.bench import console
from tests.gateway.servers.memory_network import MemoryNetwork
from tests.serving import free_endpoint, in_a_thread
from tests.waiting import until

pytestmark = pytest.mark.matrix

TOKEN = "operators-0123456789"


def url(running):
    return f"ws://127.0.0.1:{running.port}"


def test_its_frames_are_those_of_a_page(tmp_path):
    network, frames = MemoryNetwork(), []

    def held():
        frames[:] = [decode_frame(bytes(each["frame"])) for _, each in network.published]
        return any(frame.hold for frame in frames)

    with console(network, tmp_path) as running:
        peer = PagePeer(PagePeerOptions(console=url(running), script="short"))
        with in_a_thread(peer):
            until(held, "the hand holds")
    assert {topic for topic, _ in network.published} == {"/phone"}
    assert frames[0].held_buttons == ("align",)
    assert not frames[0].hold


def test_frames_that_take_too_long_hold_nothing(tmp_path):
    network = MemoryNetwork()
    with console(network, tmp_path) as running:
        late = PagePeerOptions(console=url(running), script="short", faults={"late": 0.3})
        with in_a_thread(PagePeer(late)):
            until(lambda: running.server.counts["frames dropped"] > 10, "they are dropped")
    frames = [decode_frame(bytes(each["frame"])) for _, each in network.published]
    assert frames
    assert not any(frame.hold for frame in frames)


def test_a_console_that_is_not_there_or_asks_for_a_token(tmp_path, monkeypatch):
    with pytest.raises(DriverError, match="cannot be a page"):
        PagePeer(PagePeerOptions(console="ws://127.0.0.1:9")).open()
    with pytest.raises(AddressError, match="such as"):
        PagePeer(PagePeerOptions(console="http://127.0.0.1:9")).open()
    with console(MemoryNetwork(), tmp_path, token=TOKEN) as running:
        with pytest.raises(DriverError, match="401"):
            PagePeer(PagePeerOptions(console=url(running))).open()
        monkeypatch.setenv("CARDAN_SERVER_TOKEN", TOKEN)
        with PagePeer(PagePeerOptions(console=url(running))):
            pass


@pytest.mark.real
@pytest.mark.parametrize(("driver", "options"), [(Phone, PagePeerOptions), (Xr, XrPeerOptions)])
def test_from_the_page_to_the_driver_and_back(tmp_path, driver, options):
    endpoint = free_endpoint()
    bus = BusOptions(router="", listen=(endpoint,))
    with BusNetwork(bus, "console") as network, console(network, tmp_path) as running:
        peer = PagePeer(options(console=url(running), script="strokes"))
        with in_a_thread(peer), driver(router=endpoint, wait_for_device=True) as device:
            until(lambda: device.state().link is DeviceLink.LIVE, "it is live")
            until(lambda: any(device.state().axes), "it is deflected")
            device.feedback(DeviceFeedback(rumble=0.5))
            until(lambda: peer.device.rumble == 0.5, "the peer vibrates")
        until(lambda: running.server.clients == 0, "the page is closed")
