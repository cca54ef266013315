"""The tests' data about LeRobot's interface compared with an installed LeRobot.

Only `make test-lerobot` runs these tests.
"""

import abc
import dataclasses
import importlib
import importlib.metadata

import pytest

from tests.lerobot import interface
from tests.lerobot.conftest import FOLDERS


@pytest.mark.parametrize("module", interface.CLASSES)
def test_abstract_members(module):
    for name, members in interface.CLASSES[module].items():
        kind = getattr(importlib.import_module(module), name)
        assert kind.__abstractmethods__ == {*members["properties"], *members["methods"]}
        for each in members["properties"]:
            assert isinstance(getattr(kind, each), property)
        assert isinstance(kind, abc.ABCMeta)


@pytest.mark.parametrize(("module", "name"), interface.CONFIGS.items())
def test_configurations(module, name):
    config = getattr(importlib.import_module(module), name)
    assert {field.name for field in dataclasses.fields(config)} == {"id", "calibration_dir"}
    assert callable(config.register_subclass)


def test_events():
    events = importlib.import_module("lerobot.teleoperators.utils").TeleopEvents
    assert {each.name: each.value for each in events} == interface.EVENTS


def test_errors():
    errors = importlib.import_module("lerobot.utils.errors")
    for name in interface.ERRORS:
        assert issubclass(getattr(errors, name), ConnectionError)


def test_it_finds_the_installed_distributions_and_makes_devices_of_them(tmp_path):
    """LeRobot's own discovery finds them: no module of ours is imported before."""
    utils = importlib.import_module("lerobot.utils.import_utils")
    names = {each.metadata["Name"] for each in importlib.metadata.distributions()}
    assert names >= {folder.name for folder in FOLDERS}
    utils.register_third_party_plugins()
    for base, make, given in (
        ("teleoperators", "make_teleoperator_from_config", {"driver": "spacemouse"}),
        ("robots", "make_robot_from_config", {"driver": "sim_arm", "model": "ur5"}),
    ):
        module = importlib.import_module(f"lerobot.{base}")
        kind = "TeleoperatorConfig" if base == "teleoperators" else "RobotConfig"
        config = getattr(module, kind).get_choice_class("cardan")
        made = getattr(module, make)(config(calibration_dir=tmp_path, **given))
        assert type(made).__name__ == config.__name__.removesuffix("Config")


def test_options_come_through_its_command_line():
    """Parsed like `lerobot-teleoperate --teleop.type=cardan ...`."""
    draccus = importlib.import_module("draccus")
    for name in ("lerobot_teleoperator_cardan", "lerobot_robot_cardan"):
        importlib.import_module(name)
    teleop = importlib.import_module("lerobot.teleoperators").TeleoperatorConfig
    robot = importlib.import_module("lerobot.robots").RobotConfig
    program = dataclasses.make_dataclass("Program", [("teleop", teleop), ("robot", robot)])
    parsed = draccus.parse(
        program,
        args=[
            "--teleop.type=cardan",
            "--teleop.driver=spacemouse",
            '--teleop.options={"transport": "socket", "path": "a.sock", "curve": 0.5}',
            '--teleop.mapping={"deadman": "left", "scale": [1, 1, 1, 0.5, 0.5, 0.5]}',
            "--robot.type=cardan",
            "--robot.session=session.toml",
            "--robot.action=pose",
        ],
    )
    assert parsed.teleop.options == {"transport": "socket", "path": "a.sock", "curve": 0.5}
    assert parsed.teleop.mapping == {"deadman": "left", "scale": [1, 1, 1, 0.5, 0.5, 0.5]}
    assert (parsed.robot.session, parsed.robot.action) == ("session.toml", "pose")
    assert parsed.robot.cameras == {}
