"""Template packages of examples/packages: after installation each is found, its simulated peer
serves, its driver reads it, its demo runs, and it keeps Cardan's own rules."""

from __future__ import annotations

import dataclasses
import inspect
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import cardan
from cardan.demos.examples import find_demos
from cardan.drivers import base, registry as drivers
from cardan.drivers.base import OperatorDevice
from cardan.errors import OptionError
from cardan.gateway.session.assembly import load_config
from cardan.sim_peers import registry as peers
from cardan.types import DeviceLink, RobotLink
from tests import installed
from tests.drivers import test_every_device as every_device
from tests.drivers.test_taking_states import PATIENCE_S, check_it_wakes_its_reader
from tests.serving import demo_of, demonstrated
from tests.test_options import bad_values, with_inside

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PACKAGES = Path(__file__).parents[1] / "examples" / "packages"
FOLDERS = sorted(file.parent for file in PACKAGES.glob("*/pyproject.toml"))


@pytest.fixture(params=FOLDERS, ids=lambda folder: folder.name)
def package(request, tmp_path, monkeypatch):
    """Install a package for this process and its children."""
    project = tomllib.loads((request.param / "pyproject.toml").read_text(encoding="utf-8"))
    points = project["project"]["entry-points"]
    sites = (tmp_path / "site", request.param)
    installed.add_metadata(sites[0], project["project"]["name"], points)
    for name, value in installed.environment(*sites).items():
        monkeypatch.setenv(name, value)
    for site in sites:
        monkeypatch.syspath_prepend(site)
    targets = points["cardan.drivers"]
    home = next(iter(targets.values())).partition(".")[0]
    return SimpleNamespace(
        sites=sites,
        drivers={name: drivers.load(name) for name in targets},
        peers={name: peers.load(name) for name in points["cardan.sim_peers"]},
        demos={name: demo for name, demo in find_demos().items() if home in demo.file.parts},
        examples=sorted((request.param / home / "examples").glob("*.toml")),
    )


def test_there_are_packages():
    assert FOLDERS


@pytest.mark.matrix
def test_it_is_in_every_list(package):
    def listed(*words):
        code, said = installed.cardan(*words, sites=())  # the fixture has set the environment
        assert code == 0, said
        return said

    rows = [line.split() for line in listed("devices", "drivers").splitlines()]
    for name, driver in package.drivers.items():
        (row,) = (row for row in rows if row[:1] == [name])
        assert driver.summary.split()[0] in row
    said = listed("sim", "--list")
    for name, peer in package.peers.items():
        assert f" {name} " in said
        assert peer.__doc__ in said
    said = listed("demo", "--list")
    for name, demo in package.demos.items():
        assert f" {name} " in said
        assert demo.description in said


def test_it_declares_what_the_lists_say(package):
    for driver in package.drivers.values():
        assert driver.summary
        assert driver.page
        assert driver.peer in package.peers
        if issubclass(driver, OperatorDevice):
            assert driver.gives
            assert driver.suits
    for peer in package.peers.values():
        assert (peer.__doc__ or "").endswith(".")
        assert peer.speaks
        assert peer.page
    demonstrated_ = frozenset().union(*(demo.drivers for demo in package.demos.values()))
    assert package.drivers.keys() <= demonstrated_


def test_its_examples_are_fine(package):
    assert package.examples
    for example in package.examples:
        load_config(example)


def test_every_bad_option_names_its_key(package):
    declared = (*package.drivers.values(), *package.peers.values())
    for kind in (kind for each in declared for kind in with_inside(each.Options)):
        for field in dataclasses.fields(kind):
            for bad in bad_values(kind, field.name):
                with pytest.raises(OptionError, match="is not allowed; it must be") as caught:
                    kind(**{field.name: bad})
                assert caught.value.key == field.name
                assert caught.value.value is bad
                assert caught.value.allowed


def test_its_devices_keep_to_what_every_device_keeps_to(package, tmp_path):
    rules = [rule for name, rule in vars(every_device).items() if name.startswith("test_")]
    assert len(rules) > 5
    for driver in package.drivers.values():
        if issubclass(driver, OperatorDevice):
            given = {"driver": driver, "tmp_path": tmp_path}
            for rule in rules:
                rule(**{name: given[name] for name in inspect.signature(rule).parameters})


@pytest.mark.matrix
def test_its_driver_meets_its_simulated_peer(package, tmp_path, monkeypatch):
    for name, driver in package.drivers.items():
        with demonstrated(demo_of(name), tmp_path) as tables:
            options = dict(tables["device" if issubclass(driver, OperatorDevice) else "robot"])
            assert options.pop("driver") == name
            if issubclass(driver, OperatorDevice):
                with cardan.open_device(name, **options) as device:
                    moved = (state for state in device if any(state.axes) or state.pose)
                    assert next(moved).link is DeviceLink.LIVE
                    monkeypatch.setattr(base, "RECHECK_S", PATIENCE_S)
                    check_it_wakes_its_reader(device)
            else:
                with cardan.open_robot(name, **options) as robot:
                    heard = (state for state in robot.cycles() if state.link is RobotLink.LIVE)
                    assert next(heard).joints or next(heard).pose


@pytest.mark.matrix
def test_its_demos_run(package):
    for name, demo in package.demos.items():
        seconds = max(4.0, demo.shortest_s)
        code, said = installed.cardan("demo", name, "--seconds", f"{seconds}", sites=())
        assert said.startswith(f"{demo.description}\n")
        # A busy computer may miss cycles; the robot has moved in any case.
        assert (code == 0 and demo.success_message in said) or "cycles were missed" in said, said
        for never in ("never commanded", "no path", "disengaged 1"):
            assert never not in said
