"""Identity of the device behind the server, and the counts that programs then get."""

import pytest

from cardan.drivers.base import OperatorDevice
from cardan.drivers.gamepad import Gamepad
from cardan.drivers.spacemouse import SpaceMouse, SpaceMouseOptions
from cardan.drivers.spnav.core import usual_full_scales
from cardan.protocols.connexion.devices import MODELS, model_by_key
from cardan.protocols.spnav.codes import DEVICE_TYPES, Code
from cardan.protocols.spnav.records import Button, MotionEvent, encode_handshake, encode_request
from cardan.protocols.spnav.streams import ServerReader
from cardan.types import ButtonEvent, DeviceLink, DeviceState
from cardan_serial_mice.driver import SpaceMouseSerial
from cardan_serial_mice.protocol import SERIAL_MODELS
from cardan_spnav_server import (
    DeviceIdentity,
    SpnavServerCore,
    identity_of,
)

UNTOLD = {
    "lipari",
    "spacemouse-usb",
    "universal-receiver",
    "universal-receiver-2",
    "universal-receiver-2-c65c",
}
"""Models without a separate device type: the puck behind a receiver is unknown."""


def usb_mouse(model):
    return SpaceMouse(SpaceMouseOptions(model=model.key))


def serial_mouse(model):
    return SpaceMouseSerial(model=model.key)


def counts_of(axes, identity, full_scale=None):
    """Return a program's counts for a deflection."""
    core = SpnavServerCore(full_scale=full_scale)
    core.identify(identity)
    number = core.connect(0.0)
    core.receive(number, encode_handshake(1), 0.0)
    core.offer(DeviceState(1.0, DeviceLink.LIVE, axes, frozenset()), (), 1.0)
    reader, values = ServerReader(), []
    while record := core.outgoing(number, 2.0):
        values += reader.feed(record)
        core.sent(number, len(record))
    (motion,) = [value for value in values if isinstance(value, MotionEvent)]
    return motion


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.key)
def test_every_usb_model_is_reported_by_name_type_and_id(model):
    identity = identity_of(usb_mouse(model))
    assert identity.name == model.name
    assert (identity.vendor_id, identity.product_id) == (model.vendor_id, model.product_id)
    if model.key in UNTOLD:
        assert identity.device_type == 0
    else:
        kind = DEVICE_TYPES[identity.device_type]
        assert identity.device_type & 0x200
        assert model.name.casefold().startswith(kind.casefold())


@pytest.mark.parametrize("model", SERIAL_MODELS, ids=lambda m: m.key)
def test_a_serial_model_has_a_type_and_no_usb_id(model):
    identity = identity_of(serial_mouse(model))
    assert (identity.vendor_id, identity.product_id) == (0, 0)
    known = model.key != "spaceorb"
    assert DEVICE_TYPES[identity.device_type] == (model.name if known else "unknown")


@pytest.mark.parametrize(
    "mouse",
    [
        *(pytest.param(usb_mouse(model), id=model.key) for model in MODELS),
        *(pytest.param(serial_mouse(model), id=f"serial {model.key}") for model in SERIAL_MODELS),
    ],
)
def test_full_deflection_is_what_programs_take_for_it(mouse):
    identity = identity_of(mouse)
    linear, angular = usual_full_scales(
        identity.device_type, identity.vendor_id, identity.product_id
    )
    assert counts_of((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), identity).z == linear
    assert counts_of((0.0, 0.0, 0.0, 0.0, 0.0, 1.0), identity).ry == angular


PRO = "1 2 3 4 menu fit top right front roll-cw rotate-lock esc alt shift ctrl"
ENTERPRISE = (
    "1 2 3 4 5 6 7 8 9 10 11 12 menu fit top right front roll-cw esc alt shift ctrl rotate-lock "
    "enter delete tab space v1 v2 v3 iso1"
)
SPACENAVD = {
    "spacemouse-pro": PRO,
    "spacemouse-pro-wireless": PRO,
    "spacemouse-pro-wireless-receiver": PRO,
    "spacemouse-pro-wireless-bt": PRO,
    "spacemouse-enterprise": ENTERPRISE,
}
"""Keys ordered by the numbers in spacenavd's table of devices."""


def numbers_of(mouse):
    """Return a program's number for each button of `mouse`, and the number of buttons."""
    core = SpnavServerCore()
    core.identify(identity_of(mouse))
    core.name_buttons(mouse.capabilities.buttons)
    number = core.connect(0.0)
    core.receive(number, encode_handshake(1), 0.0)
    core.offer(DeviceState(1.0, DeviceLink.LIVE, (0.0,) * 6, frozenset()), (), 1.0)
    reader, reported = ServerReader(), {}
    while record := core.outgoing(number, 2.0):
        reader.feed(record)
        core.sent(number, len(record))
    for label in mouse.capabilities.buttons:
        edges = [ButtonEvent(1.0, label, pressed) for pressed in (True, False)]
        core.offer(DeviceState(1.0, DeviceLink.LIVE, (0.0,) * 6, frozenset()), edges, 1.0)
        values = []
        while record := core.outgoing(number, 2.0):
            values += reader.feed(record)
            core.sent(number, len(record))
        reported[label] = [value.number for value in values if isinstance(value, Button)]
    core.receive(number, encode_request(Code.DEV_NBUTTONS), 2.0)
    (count,) = reader.feed(core.outgoing(number, 2.0))
    assert all(down == up for down, up in reported.values())
    return {label: down for label, (down, _) in reported.items()}, count.data[0]


@pytest.mark.parametrize("model", [m for m in MODELS if not m.receiver], ids=lambda m: m.key)
def test_every_button_has_spacenavds_number(model):
    """The keys of most models are numbered by their bit in the report."""
    keys = (
        dict(enumerate(SPACENAVD[model.key].split())) if model.key in SPACENAVD else model.buttons
    )
    numbers, count = numbers_of(usb_mouse(model))
    assert numbers == {label: number for number, label in keys.items()}
    assert count == max(keys, default=-1) + 1


@pytest.mark.parametrize("model", SERIAL_MODELS, ids=lambda m: m.key)
def test_the_buttons_of_a_serial_device_have_spacenavds_numbers(model):
    """Numbers follow the order of our table; there is no button for zero."""
    numbers, _ = numbers_of(serial_mouse(model))
    assert numbers == {label: number for number, label in enumerate(model.buttons.values())}


@pytest.mark.parametrize("model", [m for m in MODELS if m.receiver], ids=lambda m: m.key)
def test_the_puck_of_a_universal_receiver_keeps_the_numbers_of_its_reports(model):
    numbers, _ = numbers_of(usb_mouse(model))
    assert numbers["left"] == numbers["menu"] == 0
    assert numbers["right"] == numbers["fit"] == 1
    assert (numbers["1"], numbers["esc"], numbers["rotate-lock"]) == (12, 22, 26)


def test_another_device_has_its_own_numbers():
    core = SpnavServerCore()
    mice = [usb_mouse(model_by_key(f"spacemouse-{key}")) for key in ("pro", "enterprise")]
    number = core.connect(0.0)
    core.receive(number, encode_handshake(1), 0.0)
    reader, reported = ServerReader(), []
    for mouse in (*mice, mice[0]):
        core.offer(DeviceState(1.0, DeviceLink.LOST, (0.0,) * 6, frozenset()), (), 1.0)
        core.identify(identity_of(mouse))
        core.name_buttons(mouse.capabilities.buttons)
        edges = [ButtonEvent(1.0, "menu", True)]
        core.offer(DeviceState(1.0, DeviceLink.LIVE, (0.0,) * 6, frozenset()), edges, 1.0)
        while record := core.outgoing(number, 2.0):
            reported += [each for each in reader.feed(record) if isinstance(each, Button)]
            core.sent(number, len(record))
    assert [button.number for button in reported if button.pressed] == [4, 12, 4]


def test_a_full_scale_that_is_given_counts_for_every_device():
    identity = identity_of(serial_mouse(SERIAL_MODELS[1]))
    assert counts_of((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), identity, 600.0).z == 600
    assert counts_of((0.0, 0.0, 0.0, 0.0, 0.0, 1.0), identity, 600.0).ry == 600


def test_a_name_that_is_given_wins():
    mouse = usb_mouse(model_by_key("spacenavigator"))
    assert identity_of(mouse, "Hand")[:3] == ("Hand", "", 0x206)


def test_other_devices_have_only_a_name():
    assert identity_of(Gamepad()) == DeviceIdentity("Cardan")
    assert identity_of(Gamepad(), "Pad") == DeviceIdentity("Pad")
    assert identity_of(SpaceMouse()) == DeviceIdentity("Cardan")  # unknown until the device is open


def test_an_attribute_of_the_same_name_that_is_something_else():
    class Stranger(OperatorDevice):
        class Options:
            pass

        model = "S-1000"
        open = close = diagnosis = state = button_events = capabilities = None

    assert identity_of(Stranger()) == DeviceIdentity("Cardan")
