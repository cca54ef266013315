"""The udev rules that `cardan udev` prints, read and applied by Debian's udevd."""

from __future__ import annotations

import stat
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cardan.drivers.spacemouse import list_devices
from cardan.drivers.udev import udev_rules
from cardan.drivers.wiimote import Wiimote
from cardan.sim_peers.spacemouse import UhidSpaceMousePeer, UhidSpaceMousePeerOptions
from cardan.sim_peers.wiimote import WiimotePeer, WiimotePeerOptions
from tests.kernel.waiting import wait_for
from tests.serving import in_a_thread

RULES = Path("/run/udev/rules.d/70-cardan.rules")


def udevadm(*words: str) -> str:
    done = subprocess.run(["udevadm", *words], capture_output=True, text=True, timeout=30)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(autouse=True)
def rules(modules: Callable[..., None]) -> Iterator[None]:
    modules("uhid", "hid-generic", "hid-wiimote", "evdev")
    RULES.write_text(udev_rules())
    udevadm("control", "--reload")
    yield
    RULES.unlink()
    udevadm("control", "--reload")


def given_to_the_user(path: str) -> bool:
    """Whether udevd has set the node's mode, and the tag by which logind gives it away."""
    return stat.S_IMODE(Path(path).stat().st_mode) == 0o660 and "uaccess" in udevadm(
        "info", "--query=property", path
    )


@pytest.mark.judged(device="SpaceMouse", transport="hidraw, udev rules", by="Debian udevd")
@pytest.mark.parametrize("model", ["spacemouse-wireless-bt"])
def test_the_rules_give_a_spacemouse_to_the_user(model):
    options = UhidSpaceMousePeerOptions(model=model, script="rest")
    with in_a_thread(UhidSpaceMousePeer(options)):
        (found,) = wait_for(list_devices)
        wait_for(lambda: given_to_the_user(found.path))


@pytest.mark.judged(device="Wiimote", transport="hidraw, udev rules", by="Debian udevd")
def test_the_rules_give_a_wiimote_to_the_user():
    with in_a_thread(WiimotePeer(WiimotePeerOptions(uhid=True, script="rest"))):
        (found,) = wait_for(Wiimote.find)
        wait_for(lambda: given_to_the_user(found.path))
