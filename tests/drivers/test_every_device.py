"""Contract of all operator devices."""

import dataclasses
import inspect

import pytest

from cardan.drivers import registry
from cardan.drivers.base import FoundDevice, OperatorDevice
from cardan.errors import CommandError, DriverError
from cardan.types import NEVER_S, ZERO3, DeviceFeedback, DeviceLink, Frame, Wrench
from tests.docs_tables import ours

NEUTRAL = (0.0,) * 6
ALL = DeviceFeedback(led=True, rumble=0.5, wrench=Wrench(ZERO3, ZERO3, Frame.BASE))

DEVICES = [
    pytest.param(driver, id=name)
    for name, driver in ours(registry).items()
    if issubclass(driver, OperatorDevice)
]


@pytest.fixture(autouse=True)
def nobody_comes(monkeypatch):
    """Shorten the wait of bus devices for their nodes."""
    monkeypatch.setattr("cardan.drivers.bus_devices.device.MEET_S", 0.05)


def nowhere(driver, tmp_path, **more):
    """Return options that lead to no device."""
    nothing = str(tmp_path / "none")
    places = {
        "transport": "socket",
        "interface": "socketcand",
        "path": nothing,
        "socket": nothing,
        "library": nothing,
        "host": "127.0.0.1",
        "port": 1,
    }
    fields = {field.name for field in dataclasses.fields(driver.Options)}
    if "transport" in fields:
        del places["port"]  # With USB enabled its path identifies the device.
    place = {name: value for name, value in places.items() if name in fields}
    assert place
    return driver.Options(**place, **more)


@pytest.mark.parametrize("driver", DEVICES)
def test_it_is_neutral_before_it_was_opened(driver, tmp_path):
    device = driver(nowhere(driver, tmp_path))
    state = device.state()
    assert (state.link, state.axes, state.buttons) == (DeviceLink.CLOSED, NEUTRAL, frozenset())
    assert (state.stamp_s, state.pose, state.wrench) == (NEVER_S, None, None)
    assert state.reason
    assert list(device.button_events()) == []
    device.close()


@pytest.mark.parametrize("driver", DEVICES)
def test_what_is_not_there_is_said_in_words(driver, tmp_path):
    device = driver(nowhere(driver, tmp_path))
    with pytest.raises(DriverError, match=r"\w+ \w+ \w+"):
        device.open()
    assert device.state().axes == NEUTRAL
    device.close()


@pytest.mark.matrix("phone", "ros2_spacenav")  # Same code as xr and ros2_joy; each waits a second.
@pytest.mark.parametrize("driver", DEVICES)
def test_it_can_be_waited_for(driver, tmp_path):
    device = driver(nowhere(driver, tmp_path, wait_for_device=True))
    with device:
        state = device.state()
        assert (state.link, state.axes) == (DeviceLink.LOST, NEUTRAL)
        assert state.reason
        assert device.diagnosis()
        assert all(isinstance(value, (int, float)) for value in device.metrics().values())
    assert device.state().link is DeviceLink.CLOSED
    device.close()


@pytest.mark.parametrize("driver", DEVICES)
def test_feedback_that_it_has_not_is_refused(driver, tmp_path):
    device = driver(nowhere(driver, tmp_path))
    for channel in {"led", "rumble", "wrench"} - device.capabilities.feedback:
        one = DeviceFeedback()._replace(**{channel: getattr(ALL, channel)})
        with pytest.raises(CommandError, match=channel):
            device.feedback(one)


@pytest.mark.parametrize("driver", DEVICES)
def test_looking_for_it_never_fails(driver):
    found = driver.find()
    assert all(type(each) is FoundDevice for each in found)


@pytest.mark.parametrize("driver", DEVICES)
def test_every_option_has_a_default_and_says_what_it_is(driver):
    options = driver.Options
    assert dataclasses.is_dataclass(options)
    assert options() == options()
    with pytest.raises(dataclasses.FrozenInstanceError):
        options().wait_for_device = True
    reported = "".join(
        inspect.getsource(each) for each in options.__mro__ if each.__module__.startswith("cardan")
    )
    for field in dataclasses.fields(options):
        after = reported.partition(f"    {field.name}: ")[2]
        assert '"""' in after.split("\n    def ")[0].split(": ", 1)[-1], field.name
