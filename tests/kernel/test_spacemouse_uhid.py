"""A SpaceMouse made with /dev/uhid, read by the driver through the kernel's own hidraw."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cardan.drivers.spacemouse import SpaceMouse, SpaceMouseOptions, list_devices
from cardan.protocols.connexion.descriptors import descriptor_for
from cardan.protocols.connexion.devices import model_by_key
from cardan.protocols.connexion.reports import encode_rotation, encode_translation
from cardan.sim_peers.backends.uhid import BUS_USB, HidIdentity, UhidDevice
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions
from cardan.types import DeviceFeedback, DeviceLink
from tests.kernel.waiting import wait_for
from tests.serving import in_a_thread

COMPACT = "256f:c635"
TOUCH = """
    0.1  axes 0 0 0.2 0 0 0 over 0.1
    0.2  neutral over 0.1
"""


@pytest.fixture(autouse=True)
def kernel(modules: Callable[..., None]) -> None:
    modules("uhid", "hid-generic")


@pytest.fixture
def puck(tmp_path: Path) -> Callable[..., SpaceMousePeer]:
    def make(script: str = "", model: str = "spacemouse-compact", **options: object):
        file = tmp_path / "script.txt"
        file.write_text(TOUCH + script)
        return SpaceMousePeer(
            SpaceMousePeerOptions(uhid=True, model=model, script=str(file), jitter_lsb=0, **options)
        )

    return make


@pytest.fixture
def mouse() -> Iterator[SpaceMouse]:
    mouse = SpaceMouse(SpaceMouseOptions(transport="hidraw", dead_zone=0.0, wait_for_device=True))
    yield mouse
    mouse.close()


@pytest.mark.judged(
    device="SpaceMouse", transport="hidraw", by="Linux kernel 6.1: uhid, hid-generic, hidraw"
)
@pytest.mark.parametrize("model", ["spacemouse-compact", "spacenavigator", "spacemouse-wireless"])
def test_motion_and_buttons_arrive_through_the_kernel(puck, mouse, model):
    script = """
        0.6  axes 0.5 -0.25 1 0 0.125 -1
        0.6  press first
        2.6  release first
        2.6  neutral
        4.0  loop
    """
    with in_a_thread(puck(script, model)):
        wait_for(list_devices)
        mouse.open()
        # If an emulated machine pauses, the driver misses reports of a deflected puck and requires
        # rest again, which the next round of the script has.
        expected = pytest.approx((0.5, -0.25, 1.0, 0.0, 0.125, -1.0), abs=0.5 / 350 + 1e-9)
        state = wait_for(lambda: (s := mouse.state()).axes == expected and s)
        assert state.link is DeviceLink.LIVE

        def rests() -> bool:
            state = mouse.state()
            return state.link is DeviceLink.LIVE and not any(state.axes)

        wait_for(rests)
        edges = []
        wait_for(lambda: edges.extend(mouse.button_events()) or len(edges) >= 2)
        first = [(edge.button, edge.pressed) for edge in edges[:2]]
        assert first == [("left", True), ("left", False)]


@pytest.mark.judged(
    device="SpaceMouse", transport="hidraw", by="Linux kernel 6.1: uhid, hid-generic, hidraw"
)
def test_the_led_is_reached_through_the_kernel(puck, mouse):
    with in_a_thread(puck()) as peer:
        wait_for(list_devices)
        mouse.open()
        mouse.feedback(DeviceFeedback(led=False))
        wait_for(lambda: not peer.device.led)
        mouse.feedback(DeviceFeedback(led=True))
        wait_for(lambda: peer.device.led)
        assert peer.device.refused_outputs == 0


@pytest.mark.judged(
    device="SpaceMouse", transport="hidraw, unplugged", by="Linux kernel 6.1: uhid, hidraw"
)
def test_unplugged_while_deflected_is_lost_and_picked_up_again_only_after_rest(puck, mouse):
    script = """
        0.6  axes 0.5 0 0 0 0 0
        1.2  unplug
        1.7  replug
        1.8  axes 0.6 0 0 0 0 0
        4.6  neutral
        5.0  axes 0 0.7 0 0 0 0
    """
    with in_a_thread(puck(script)):
        wait_for(list_devices)
        mouse.open()
        wait_for(lambda: mouse.state().axes[0] > 0.4)
        lost = wait_for(lambda: (s := mouse.state()).link is DeviceLink.LOST and s)
        assert not any(lost.axes)
        assert lost.reason
        held = wait_for(lambda: (s := mouse.state()).link is DeviceLink.NEEDS_NEUTRAL and s)
        assert not any(held.axes)
        live = wait_for(lambda: (s := mouse.state()).link is DeviceLink.LIVE and s)
        assert live.axes[0] == 0.0
        wait_for(lambda: mouse.state().axes[1] > 0.6)


@pytest.mark.judged(device="SpaceMouse", transport="hidraw", by="Linux kernel 6.1: sysfs, devtmpfs")
def test_cardan_devices_lists_it_and_says_what_stands_in_the_way(puck):
    with in_a_thread(puck()):
        (found,) = wait_for(list_devices)
        assert (found.vendor_id, found.product_id) == (0x256F, 0xC635)
        assert found.path.startswith("/dev/hidraw")
        assert found.obstacle == ""
        said = subprocess.run(
            [sys.executable, "-m", "cardan", "devices"],
            capture_output=True, text=True, timeout=60, check=True,
        ).stdout  # fmt: skip
        assert COMPACT in said
        assert found.path in said


@pytest.mark.judged(
    device="SpaceMouse", transport="hidraw, no permission", by="Linux kernel 6.1: devtmpfs"
)
def test_a_node_one_may_not_open_is_named_with_the_remedy(puck):
    with in_a_thread(puck()):
        (found,) = wait_for(list_devices)
        os.chmod(found.path, 0)
        words = as_nobody(lambda: list_devices()[0].obstacle)
        assert re.search(rf"permission.*{found.path}", words)
        assert "udev" in words
        refusal = as_nobody(open_and_say)
        assert found.path in refusal
        assert "udev" in refusal


def open_and_say() -> str:
    mouse = SpaceMouse(SpaceMouseOptions(transport="hidraw"))
    try:
        mouse.open()
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "it opened"


def as_nobody(ask: Callable[[], str]) -> str:
    """Return the result of `ask` in a process without any privileges."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.setgroups([])
            os.setgid(65534)
            os.setuid(65534)
            words = ask()
        except BaseException as error:
            words = f"the child failed: {error!r}"
        os.write(writer, words.encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as answer:
        words = answer.read().decode()
    os.waitpid(child, 0)
    return words


@pytest.mark.judged(device="SpaceMouse", transport="hidraw", by="Linux kernel 6.1: uhid, hidraw")
def test_a_report_reaches_the_driver_within_milliseconds(mouse):
    """Time from the write to /dev/uhid to state(), on the slow emulated processor."""
    model = model_by_key("spacemouse-compact")
    uhid = UhidDevice()
    uhid.open()
    try:
        uhid.plug(HidIdentity(model.name, BUS_USB, 0x256F, 0xC635, descriptor_for(model)))
        wait_for(list_devices)
        mouse.open()
        uhid.send(encode_rotation(0, 0, 0))
        delays_s = []
        for count in range(1, 41):
            start_s = time.monotonic()
            uhid.send(encode_translation(0, 0, count % 2))
            wait_for(lambda start_s=start_s: mouse.state().stamp_s > start_s, poll_s=0.0001)
            delays_s.append(time.monotonic() - start_s)
    finally:
        uhid.close()
    assert sorted(delays_s)[len(delays_s) // 2] < 0.02
