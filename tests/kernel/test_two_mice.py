"""Two SpaceMice of one model, plugged in while their drivers wait for them, and distinguished by
serial number."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from cardan.common.tables import read_toml
from cardan.drivers.spacemouse import SpaceMouse, SpaceMouseOptions, list_devices
from cardan.protocols.connexion.descriptors import descriptor_for
from cardan.protocols.connexion.devices import model_by_key
from cardan.protocols.connexion.reports import encode_buttons, encode_rotation, encode_translation
from cardan.sim_peers.backends.uhid import BUS_USB, HidIdentity, Open, UhidDevice
from cardan.types import DeviceLink, DeviceState
from tests.kernel.waiting import wait_for

EXAMPLE = Path(__file__).parents[2] / "examples/two-arms/mice.toml"

FOUND_WITHIN_S = 1.0
"""Longest time from plugging in until the device is open."""

NAMES = ("left", "right")


class Mouse:
    """A SpaceMouse Compact made with /dev/uhid."""

    model = model_by_key("spacemouse-compact")

    def __init__(self) -> None:
        self._uhid = UhidDevice()
        self._uhid.open()

    def plug(self, serial: str) -> None:
        model = self.model
        self._uhid.plug(
            HidIdentity(
                model.name, BUS_USB, model.vendor_id, model.product_id, descriptor_for(model),
                serial=serial,
            )
        )  # fmt: skip

    def unplug(self) -> None:
        self._uhid.unplug()
        while self._uhid.read() is not None:
            pass

    def until_opened(self) -> float:
        """Wait until a program opens the mouse; return the time that took, s."""
        begin_s = time.monotonic()
        wait_for(lambda: isinstance(self._uhid.read(), Open), poll_s=0.001)
        return time.monotonic() - begin_s

    def say(self, z: int, down: bool) -> None:
        for report in (
            encode_translation(0, 0, -z),
            encode_rotation(0, 0, 0),
            encode_buttons(int(down), self.model.button_report_bytes),
        ):
            self._uhid.send(report)

    def close(self) -> None:
        self._uhid.close()


@pytest.fixture
def mice(modules) -> Iterator[dict[str, Mouse]]:
    modules("uhid", "hid-generic")
    with contextlib.ExitStack() as stack:
        made = {name: Mouse() for name in NAMES}
        for mouse in made.values():
            stack.callback(mouse.close)
        yield made


@contextlib.contextmanager
def opened(options: dict[str, dict[str, object]]) -> Iterator[dict[str, SpaceMouse]]:
    """Drivers by name, opened with these options."""
    with contextlib.ExitStack() as stack:
        drivers = {}
        for name, each in options.items():
            drivers[name] = SpaceMouse(SpaceMouseOptions(transport="hidraw", **each))
            stack.callback(drivers[name].close)
            drivers[name].open()
        yield drivers


def at_rest(state: DeviceState) -> bool:
    return state.link is DeviceLink.LIVE and not state.buttons and not any(state.axes)


def each_has_its_own(drivers: dict[str, SpaceMouse], mice: dict[str, Mouse]) -> None:
    for name, other in (NAMES, NAMES[::-1]):
        for mouse in mice.values():
            mouse.say(0, down=False)
        for driver in drivers.values():
            # With both at rest, a deflection of the other mouse would be a new one.
            wait_for(lambda at=driver: at_rest(at.state()))
        mice[name].say(200, down=True)
        state = wait_for(lambda name=name: (s := drivers[name].state()).axes[2] and s)
        assert state.axes[2] > 0.0
        wait_for(lambda name=name: drivers[name].state().buttons == {"left"})
        assert drivers[other].state().buttons == frozenset()
        assert not any(drivers[other].state().axes)


@pytest.mark.judged(
    device="SpaceMouse", transport="hidraw, two by serial", by="Linux kernel 6.1: uhid, uevents"
)
def test_two_of_a_model_are_distinguished_by_serial_and_found_within_a_second(mice):
    devices = read_toml(EXAMPLE)["devices"]
    serials = {name: devices[name]["serial"] for name in NAMES}
    waiting = {name: {"serial": serials[name], "wait_for_device": True} for name in NAMES}
    with opened(waiting) as drivers:
        # In reverse order: the first mouse found is the wrong one.
        for name in ("right", "left", "right"):
            mice[name].unplug()
            wait_for(lambda name=name: drivers[name].state().link is DeviceLink.LOST)
            mice[name].plug(serials[name])
            assert mice[name].until_opened() < FOUND_WITHIN_S
            # A mouse that is deflected when it appears was not seen at rest and must not arm.
            mice[name].say(200, down=True)
            driver = drivers[name]
            held = wait_for(
                lambda at=driver: (s := at.state()).link is DeviceLink.NEEDS_NEUTRAL and s
            )
            assert not any(held.axes)
        each_has_its_own(drivers, mice)


@pytest.mark.judged(
    device="SpaceMouse", transport="hidraw, two by path", by="Linux kernel 6.1: uhid, hidraw"
)
def test_two_of_a_model_without_a_serial_are_distinguished_by_path(mice):
    paths: dict[str, str] = {}
    for count, (name, mouse) in enumerate(mice.items(), 1):
        mouse.plug("")
        wait_for(lambda count=count: len(list_devices()) == count)
        (paths[name],) = {found.path for found in list_devices()} - set(paths.values())
    with opened({name: {"path": paths[name]} for name in reversed(NAMES)}) as drivers:
        each_has_its_own(drivers, mice)
