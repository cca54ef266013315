"""The udev rules that `cardan devices udev` prints, read and applied by Debian's udevd."""

from __future__ import annotations

import shutil
import stat
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cardan.drivers.gamepad import Gamepad
from cardan.drivers.spacemouse import list_devices
from cardan.drivers.udev import udev_rules
from cardan.sim_peers.evdev import EvdevPeer, EvdevPeerOptions
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions
from tests.kernel.usbip import attach, is_unplugged
from tests.kernel.waiting import wait_for
from tests.serving import in_a_thread

RULES = Path("/run/udev/rules.d/70-cardan.rules")
DEBIANS = ("50-udev-default.rules", "60-input-id.rules")
"""Rules of Debian that ours depend on: mode of USB devices, kind of an input device."""


def udevadm(*words: str) -> str:
    done = subprocess.run(["udevadm", *words], capture_output=True, text=True, timeout=30)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(autouse=True)
def rules(modules: Callable[..., None]) -> Iterator[None]:
    modules("uhid", "hid-generic", "evdev", "uinput")
    modules("vhci-hcd", "usbhid", "hid-logitech")
    RULES.write_text(udev_rules())
    package = Path(shutil.which("udevadm") or "").parents[1] / "lib/udev/rules.d"
    for name in DEBIANS:
        shutil.copy(package / name, RULES.parent)
    udevadm("control", "--reload")
    yield
    for name in (RULES.name, *DEBIANS):
        (RULES.parent / name).unlink()
    udevadm("control", "--reload")


def properties(path: str) -> str:
    """Return udevd's properties of a node."""
    return udevadm("info", "--query=property", path)


def given_to_the_user(path: str) -> bool:
    """True if udevd has set the node's mode, and the tag by which logind grants access to the
    user."""
    return stat.S_IMODE(Path(path).stat().st_mode) == 0o660 and "uaccess" in properties(path)


@pytest.mark.judged(device="SpaceMouse", transport="hidraw, udev rules", by="Debian udevd")
@pytest.mark.parametrize("model", ["spacemouse-wireless-bt"])
def test_the_rules_give_a_spacemouse_to_the_user(model):
    options = SpaceMousePeerOptions(uhid=True, model=model, script="rest")
    with in_a_thread(SpaceMousePeer(options)):
        (found,) = wait_for(list_devices)
        wait_for(lambda: given_to_the_user(found.path))


@pytest.mark.judged(device="SpaceNavigator", transport="USB, udev rules", by="Debian udevd")
def test_the_rules_give_both_nodes_of_a_spacenavigator_to_the_user():
    options = SpaceMousePeerOptions(model="spacenavigator", script="rest", usbip=0)
    with in_a_thread(SpaceMousePeer(options)) as peer:
        device = attach(peer.endpoint)
        numbers = [int((device / name).read_text()) for name in ("busnum", "devnum")]
        (hidraw,) = wait_for(lambda: list(device.glob("*/*/hidraw/hidraw*")))
        wait_for(lambda: given_to_the_user("/dev/bus/usb/{:03}/{:03}".format(*numbers)))
        wait_for(lambda: given_to_the_user(f"/dev/{hidraw.name}"))
    wait_for(is_unplugged)


@pytest.mark.judged(device="Gamepad", transport="evdev, udev rules", by="Debian udevd")
def test_the_rules_give_a_gamepad_to_the_user_and_no_keyboard():
    with in_a_thread(EvdevPeer(EvdevPeerOptions(kind="gamepad", uinput=True, script="rest"))):
        (found,) = wait_for(Gamepad.find)
        wait_for(lambda: given_to_the_user(found.path))
    options = EvdevPeerOptions(kind="keyboard", uinput=True, script="rest")
    with in_a_thread(EvdevPeer(options)) as keyboard:
        wait_for(lambda: "ID_INPUT_KEYBOARD=1" in properties(keyboard.endpoint))
        assert not given_to_the_user(keyboard.endpoint)
