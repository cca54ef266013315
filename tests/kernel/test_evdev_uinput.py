"""Gamepad and keyboard made with /dev/uinput, read by the drivers through the kernel's evdev."""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from cardan.drivers.gamepad import Gamepad, GamepadOptions
from cardan.drivers.keyboard import Keyboard, KeyboardOptions
from cardan.protocols.evdev.codes import ABS_RZ, ABS_Y, BTN_SOUTH, KEY_CODES
from cardan.sim_peers.evdev import EvdevPeer, EvdevPeerOptions
from cardan.types import DeviceFeedback, DeviceLink
from tests.kernel.waiting import wait_for
from tests.serving import in_a_thread

TOUCH = {"gamepad": "0.2 hold start for 0.2", "keyboard": "0.2 hold left-shift for 0.2"}


@pytest.fixture(autouse=True)
def kernel(modules: Callable[..., None]) -> None:
    modules("evdev", "uinput")


@pytest.fixture
def made(tmp_path: Path) -> Callable[..., EvdevPeer]:
    """A device whose script starts at ``begin()``, which the test calls once the driver has opened
    it: uinput does not report that, and an emulated machine takes seconds to open a device."""

    def make(kind: str, script: str = "", model: str = "", **faults: float) -> EvdevPeer:
        file = tmp_path / "script"
        file.write_text(f"{TOUCH[kind]}\n{script}")
        peer = EvdevPeer(
            EvdevPeerOptions(kind=kind, uinput=True, model=model, script=str(file), faults=faults)
        )
        peer.backend.awaits_program = True
        return peer

    return make


def edges_of(device: Gamepad | Keyboard, count: int) -> list[tuple[str, bool]]:
    found: list[tuple[str, bool]] = []

    def enough() -> bool:
        found.extend((event.button, event.pressed) for event in device.button_events())
        return len(found) >= count

    wait_for(enough)
    return found


@pytest.mark.judged(device="Gamepad", transport="evdev", by="Linux kernel 6.1: uinput, evdev")
@pytest.mark.parametrize("model", ["xbox-360", "xbox-one", "dualshock-4", "dualsense-generic"])
def test_sticks_and_buttons_arrive_through_the_kernel(made, model):
    script = """
        1.5 press left-shoulder
        1.8 sticks 0.5 1 0 -0.5
        2.5 hold west for 0.3
        3.0 triggers 0 1
    """
    options = GamepadOptions(dead_zone=0.0, wait_for_device=True)
    with in_a_thread(made("gamepad", script, model)) as peer, Gamepad(options) as pad:
        assert peer.endpoint.startswith("/dev/input/event")
        (found,) = Gamepad.find()
        assert (found.path, found.obstacle) == (peer.endpoint, "")
        assert found.name == peer.device.model.name
        peer.begin()
        state = wait_for(lambda: (s := pad.state()).axes[2] < -0.4 and s)
        assert state.axes == pytest.approx((1.0, -0.5, -0.5, 0.0, 0.0, 0.0), abs=0.02)
        assert {"west", "right-trigger", "dpad-up"} <= set(pad.capabilities.buttons)
        edges = edges_of(pad, 4)
        assert edges[:3] == [("left-shoulder", True), ("west", True), ("west", False)]
        assert edges[3] == ("right-trigger", True)
        assert pad.diagnosis() == ()


@pytest.mark.judged(device="Gamepad", transport="evdev", by="Linux kernel 6.1: uinput, evdev")
def test_rumble_goes_through_the_kernel(made):
    with in_a_thread(made("gamepad")) as peer, Gamepad(GamepadOptions()) as pad:
        peer.begin()

        def turns() -> tuple[float, float]:
            return peer.device.rumble(peer.device_s())

        assert pad.capabilities.feedback == {"rumble"}
        pad.feedback(DeviceFeedback(rumble=0.5))
        wait_for(lambda: turns() == pytest.approx((0.5, 0.5), abs=1e-4))
        pad.feedback(DeviceFeedback(rumble=1.0))
        wait_for(lambda: turns() == (1.0, 1.0))
        pad.feedback(DeviceFeedback(rumble=0.0))
        wait_for(lambda: turns() == (0.0, 0.0))
        pad.feedback(DeviceFeedback(rumble=1.0))
        wait_for(lambda: turns() == (1.0, 1.0))
        assert pad.diagnosis()[1:] == ()
        pad.close()
        wait_for(lambda: turns() == (0.0, 0.0))


@pytest.mark.judged(device="Gamepad", transport="evdev", by="Linux kernel 6.1: uinput, evdev")
def test_unplugged_and_back(made):
    script = "1.0 sticks 0 1 0 0\n4.0 neutral\n" + "\n".join(
        f"{at} hold start for 0.2" for at in range(5, 40)
    )
    peer = made("gamepad", script, unplug=2.0, replug=3.0)
    with in_a_thread(peer), Gamepad(GamepadOptions()) as pad:
        peer.begin()
        wait_for(lambda: any(pad.state().axes))
        state = wait_for(lambda: (s := pad.state()).link is DeviceLink.LOST and s)
        assert not any(state.axes)
        assert "unplugged" in state.reason or "plugged in" in state.reason

        def lives_without_a_move() -> bool:
            state = pad.state()
            assert not any(state.axes)
            return state.link is DeviceLink.LIVE

        wait_for(lives_without_a_move)


@pytest.mark.judged(device="Gamepad", transport="evdev", by="Linux kernel 6.1: uinput, evdev")
def test_events_that_the_kernel_drops_end_in_neutral(made):
    """The reader thread is delayed until the kernel's queue of about 64 events overflows."""
    script = "0.6 sticks 0 1 0 0\n2.0 swing 0 0 1 1 over 0.3 times 20\n9 neutral\n" + "\n".join(
        f"{at} hold start for 0.2" for at in range(10, 60)
    )
    with in_a_thread(made("gamepad", script)) as peer, Gamepad(GamepadOptions()) as pad:
        peer.begin()
        wait_for(lambda: any(pad.state().axes))
        with pad._lock:  # as a reader without processor time
            time.sleep(6.0)
        wait_for(lambda: pad.metrics()["dropped"] >= 1)
        assert not any(pad.state().axes)
        wait_for(lambda: pad.state().link is DeviceLink.LIVE)


@pytest.mark.judged(device="Keyboard", transport="evdev", by="Linux kernel 6.1: uinput, evdev")
def test_keys_arrive_through_the_kernel_and_are_grabbed(made):
    script = """
        1.5 press space
        2.0 press h
        4.0 press esc
        4.3 release esc
        4.6 release h
    """
    with (
        in_a_thread(made("keyboard", script)) as peer,
        # The machine has a keyboard itself.
        Keyboard(KeyboardOptions(grab=True, path=peer.endpoint)) as keyboard,
    ):
        assert peer.endpoint in [found.path for found in Keyboard.find()]
        other = os.open(peer.endpoint, os.O_RDONLY | os.O_NONBLOCK)
        peer.begin()
        state = wait_for(lambda: (s := keyboard.state()).axes[5] == 1.0 and s)
        assert state.buttons == {"space"}
        while True:  # events from before the keyboard was grabbed
            try:
                seen = os.read(other, 24 * 64)
            except BlockingIOError:
                break
            assert KEY_CODES["h"].to_bytes(2, "little") not in [
                seen[at + 18 : at + 20] for at in range(0, len(seen), 24)
            ]
        wait_for(lambda: "F12" in keyboard.state().reason)
        assert not any(keyboard.state().axes)

        def heard_by_others() -> bool:
            try:
                return bool(os.read(other, 24 * 64))
            except BlockingIOError:
                return False

        wait_for(heard_by_others)
        os.close(other)


class _Event(ctypes.Structure):
    _fields_ = (
        ("sec", ctypes.c_long),
        ("usec", ctypes.c_long),
        ("type", ctypes.c_uint16),
        ("code", ctypes.c_uint16),
        ("value", ctypes.c_int32),
    )


@pytest.mark.judged(device="Gamepad", transport="evdev", by="Debian libevdev2")
def test_libevdev_sees_the_pad_that_was_meant(made):
    try:
        library = ctypes.CDLL("libevdev.so.2")
    except OSError:
        pytest.skip("libevdev.so.2 is not there: install the Debian package libevdev2")
    library.libevdev_get_name.restype = ctypes.c_char_p
    library.libevdev_event_code_get_name.restype = ctypes.c_char_p
    with in_a_thread(made("gamepad", "1.5 press south\n1.8 sticks 0 1 0 0")) as peer:
        fd = os.open(peer.endpoint, os.O_RDONLY | os.O_NONBLOCK)
        device = ctypes.c_void_p()
        assert library.libevdev_new_from_fd(fd, ctypes.byref(device)) == 0
        assert library.libevdev_get_name(device) == b"Microsoft X-Box 360 pad"
        assert library.libevdev_get_id_vendor(device) == 0x045E
        assert library.libevdev_has_event_code(device, 3, ABS_RZ)
        assert library.libevdev_get_abs_maximum(device, ABS_RZ) == 255
        assert library.libevdev_get_abs_minimum(device, ABS_Y) == -32768
        assert library.libevdev_has_event_code(device, 0x15, 0x50)
        names = set()
        peer.begin()

        def seen_both() -> bool:
            event = _Event()
            if library.libevdev_next_event(device, 2, ctypes.byref(event)) == 0:
                name = library.libevdev_event_code_get_name(event.type, event.code)
                names.add((name.decode(), event.value))
            return {("BTN_SOUTH", 1), ("ABS_Y", -32768)} <= names

        wait_for(seen_both)
        assert library.libevdev_get_event_value(device, 1, BTN_SOUTH) == 1
        library.libevdev_free(device)
        os.close(fd)
