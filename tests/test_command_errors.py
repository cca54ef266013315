"""Errors of commands: one line with exit code 2; broken parts leave the rest usable."""

import dataclasses
from importlib.metadata import EntryPoint
from typing import ClassVar

import pytest

from cardan import api
from cardan.drivers import registry
from cardan.drivers.base import FoundDevice, OperatorDevice
from cardan.drivers.udev import udev_rules
from cardan.errors import ConfigurationError
from cardan.gateway.operator.filters import registry as filter_registry
from cardan.gateway.operator.filters.base import TwistFilter
from cardan.sim_peers import registry as peer_registry
from cardan.sim_peers.command import PeerCommand
from tests.gateway.fakes import FakeDevice


class Searching(FakeDevice):
    """Driver whose search fails."""

    @classmethod
    def find(cls):
        raise RuntimeError("no\nbus")


class Failing(FakeDevice):
    """Driver whose constructor fails."""

    def __init__(self, options=None, **keywords):
        raise KeyError("boom")


class Abstract(OperatorDevice):
    """Driver without its abstract methods."""

    Options = FakeDevice.Options


class Mute(FakeDevice):
    """Driver without capabilities."""

    capabilities: ClassVar = None


class Stateless(FakeDevice):
    """Driver whose state fails."""

    def state(self):
        return self.nothing


class Silent(FakeDevice):
    """Driver without a diagnosis."""

    def diagnosis(self):
        return None


class NoTable(FakeDevice):
    """Driver without options."""

    Options = None


class FailingFilter(TwistFilter):
    """Filter without its abstract methods."""

    @dataclasses.dataclass(frozen=True)
    class Options:
        """Options without fields."""


class NoPeerOptions(PeerCommand):
    """Peer without options."""


PLUGINS = {
    "searching": f"{__name__}:Searching",
    "failing": f"{__name__}:Failing",
    "abstract": f"{__name__}:Abstract",
    "mute": f"{__name__}:Mute",
    "stateless": f"{__name__}:Stateless",
    "silent": f"{__name__}:Silent",
    "notable": f"{__name__}:NoTable",
    "gone": "no_such_module_at_all:Driver",
}


@pytest.fixture
def plugins(monkeypatch):
    """Register drivers, a peer and a filter of other packages, each broken in its own way."""
    points = [EntryPoint(name, target, "group") for name, target in PLUGINS.items()]
    shadow = EntryPoint("spacemouse", f"{__name__}:Mute", "group")
    peers = [
        EntryPoint("gone", "no_such_module_at_all:Peer", "group"),
        EntryPoint("odd", f"{__name__}:NoPeerOptions", "group"),
    ]
    filters = [EntryPoint("failing", f"{__name__}:FailingFilter", "group")]
    for module, found in (
        (registry, [*points, shadow]),
        (peer_registry, peers),
        (filter_registry, filters),
    ):
        monkeypatch.setattr(module.FINDER, "_installed", lambda found=found: found)


@pytest.mark.usefixtures("plugins")
def test_lists_say_what_cannot_be_loaded_and_go_on(cardan):
    drivers = cardan("devices", "drivers")
    assert "gone  cannot be loaded: ModuleNotFoundError: No module named" in drivers
    assert "Options is None; it must be a dataclass" in drivers
    assert "Mute, which has the same name, is not used" in drivers
    assert "abb_egm" in drivers
    peers = cardan("sim", "--list")
    assert "gone  cannot be loaded: ModuleNotFoundError" in peers
    assert "abb-gofa" in peers
    help_ = cardan("sim", "--help")
    assert "cannot be loaded: " in help_
    assert "abb-gofa" in help_
    for peer in ("gone", "odd"):
        assert cardan("sim", peer, "--port", "1", code=2).count("\n") == 1
    rules = udev_rules()
    assert "# driver gone cannot be loaded: ModuleNotFoundError" in rules
    assert 'TAG+="uaccess"' in rules


@pytest.mark.usefixtures("plugins")
def test_devices_go_on_past_a_search_that_fails(monkeypatch, cardan):
    there = FoundDevice("a puck", "256f:c635", "hidraw", "/dev/hidraw9")
    spacemouse = registry.load("spacemouse")
    monkeypatch.setattr(spacemouse, "find", classmethod(lambda _: [there]))
    found = {device.driver: device for device in api.devices()}
    assert "RuntimeError: no bus" in found["searching"].obstacle
    assert "cannot be loaded: ModuleNotFoundError" in found["gone"].obstacle
    assert found["spacemouse"] == there._replace(driver="spacemouse")
    listed = cardan("devices")
    assert "a puck" in listed
    assert "searching" in listed


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize(
    ("driver", "words"),
    [
        ("failing", "device.driver: driver 'failing' cannot be used: KeyError: 'boom'"),
        ("abstract", "device.driver: driver 'abstract' cannot be used: TypeError: Can't inst"),
        ("mute", "device.driver: driver 'mute' cannot be used: its capabilities are None"),
        (
            "stateless",
            "driver 'stateless' cannot be used: state() of a driver that is not open fails: "
            "AttributeError: 'Stateless' object has no attribute 'nothing'",
        ),
        (
            "silent",
            "driver 'silent' cannot be used: diagnosis() of a driver that is not open returns "
            "None, "
            "not a sequence",
        ),
        ("notable", "Options is None; it must be a dataclass"),
        ("gone", "cannot be loaded: ModuleNotFoundError"),
    ],
)
def test_a_configuration_with_a_broken_driver_is_refused_in_one_line(
    cardan, tmp_path, driver, words
):
    file = tmp_path / "it.toml"
    file.write_text(
        f'[device]\ndriver = "{driver}"\n[robot]\ndriver = "sim_arm"\n[arm]\nmodel="ur5"'
    )
    said = cardan("check", file, code=2)
    assert words in said
    assert said.startswith("cardan: ")
    assert said.count("\n") == 1


@pytest.mark.usefixtures("plugins")
def test_a_configuration_with_a_broken_filter_is_refused_in_one_line(cardan, tmp_path):
    file = tmp_path / "it.toml"
    file.write_text(
        '[device]\ndriver = "spacemouse"\n[robot]\ndriver = "sim_arm"\n[arm]\nmodel="ur5"\n'
        '[[filters]]\nfilter = "failing"\n'
    )
    said = cardan("check", file, code=2)
    words = "filters.0.filter: filter 'failing' cannot be used: TypeError: Can't instantiate"
    assert said.startswith(f"cardan: {file}:8:1: {words}")
    assert said.count("\n") == 1


def test_a_bug_of_our_own_is_no_wrong_configuration():
    with pytest.raises(KeyError), registry.using("spacemouse", "device.driver"):
        raise KeyError("boom")
    with pytest.raises(ConfigurationError), registry.using("theirs", "device.driver"):
        raise KeyError("boom")


@pytest.mark.parametrize("seconds", ["nan", "inf", "-1", "soon"])
@pytest.mark.parametrize(
    "command",
    [("demo",), ("run", "x.toml"), ("sim", "arm"), ("devices", "spnav")],
    ids=lambda it: it[0],
)
def test_a_duration_is_a_finite_number(cardan, command, seconds):
    said = cardan(*command, "--seconds", seconds, code=2)
    assert said.startswith("cardan: ")
    assert "--seconds" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("abb-gofa", "--period", "nan"), "cardan: --period: nan is not allowed"),
        (("motoman-gp8", "--base-port", "99999"), "cardan: --base-port: 99999 is not allowed"),
        (("motoman-gp8", "--fault", "no"), "cardan: there is no fault 'no'"),
        (("arm", "--sphere", "0,0,0,-1"), "cardan: --sphere: "),
        (("gamepad",), "cardan: --events, --uinput: give either"),
        (("jr3", "--channel", ""), "cardan: --channel: '' is not allowed"),
        (("abb-gofa", "--log", "/nonexistent/x"), "cardan: No such option: --log"),
        (("no-such-peer",), "cardan: No such command 'no-such-peer'; `cardan sim --help` lists"),
        (("abb",), "cardan: No such command 'abb'. Did you mean 'abb-gofa'? `cardan sim --help`"),
    ],
)
def test_a_peer_names_the_flag_in_one_line(cardan, words, said):
    reported = cardan("sim", *words, code=2)
    assert reported.startswith(said)
    assert reported.count("\n") == 1
