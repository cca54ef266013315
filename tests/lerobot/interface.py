"""Public interface of LeRobot's teleoperators and robots, as data, and stand-ins made of it.

Read from lerobot 0.4.4 and 0.6.1. test_interface.py compares it with an installed LeRobot (`make
test-lerobot`).
"""

from __future__ import annotations

import abc
import enum
import sys
import types
from dataclasses import dataclass
from pathlib import Path

CLASSES = {
    "lerobot.teleoperators": {
        "Teleoperator": {
            "properties": ("action_features", "feedback_features", "is_connected", "is_calibrated"),
            "methods": (
                *("connect", "calibrate", "configure"),
                *("get_action", "send_feedback", "disconnect"),
            ),
        },
    },
    "lerobot.robots": {
        "Robot": {
            "properties": (
                "observation_features", "action_features", "is_connected", "is_calibrated",
            ),
            "methods": (
                *("connect", "calibrate", "configure"),
                *("get_observation", "send_action", "disconnect"),
            ),
        },
    },
}  # fmt: skip
"""Abstract members by module and class."""

CONFIGS = {"lerobot.teleoperators": "TeleoperatorConfig", "lerobot.robots": "RobotConfig"}
"""Dataclasses with the keywords `id` and `calibration_dir`, and `register_subclass(name)`."""

EVENTS = {
    "SUCCESS": "success",
    "FAILURE": "failure",
    "RERECORD_EPISODE": "rerecord_episode",
    "IS_INTERVENTION": "is_intervention",
    "TERMINATE_EPISODE": "terminate_episode",
}
"""Members of lerobot.teleoperators.utils.TeleopEvents."""

REPORTED_EVENTS = ("IS_INTERVENTION", "TERMINATE_EPISODE", "SUCCESS", "RERECORD_EPISODE")
"""Events that get_teleop_events() reports."""

ERRORS = ("DeviceNotConnectedError", "DeviceAlreadyConnectedError")
"""Errors of lerobot.utils.errors; both are ConnectionErrors."""

PREFIXES = ("lerobot_robot_", "lerobot_teleoperator_")
"""Prefixes of distributions that LeRobot imports by name."""


class _Registry:
    """Stand-in for draccus's ChoiceRegistry, with the functions that the distributions use."""

    def __init_subclass__(cls, **keywords):
        super().__init_subclass__(**keywords)
        if _Registry in cls.__bases__:
            cls._choices = {}

    @classmethod
    def register_subclass(cls, name):
        def register(kind):
            cls._choices[name] = kind
            return kind

        return register

    @classmethod
    def get_choice_class(cls, name):
        return cls._choices[name]

    @property
    def type(self):
        return next(name for name, kind in self._choices.items() if kind is type(self))


def _config(name):
    @dataclass(kw_only=True)
    class Config(_Registry):
        id: str | None = None
        calibration_dir: Path | None = None

    Config.__name__ = name
    return Config


def _device(name, members):
    def init(self, config):
        self.id = config.id
        self.robot_type = self.name

    def absent(self):
        raise NotImplementedError

    space = {"__init__": init, "__str__": lambda self: f"{self.id} {type(self).__name__}"}
    for each in members["properties"]:
        space[each] = property(abc.abstractmethod(absent))
    for each in members["methods"]:
        space[each] = abc.abstractmethod(lambda self, *_: None)
    return abc.ABC.__class__(name, (abc.ABC,), space)


def stand_ins():
    """Return stand-ins of all modules, by name."""
    modules = {name: types.ModuleType(name) for name in ("lerobot", "lerobot.utils")}
    for name, classes in CLASSES.items():
        module = modules[name] = types.ModuleType(name)
        for each, members in classes.items():
            setattr(module, each, _device(each, members))
        setattr(module, CONFIGS[name], _config(CONFIGS[name]))
    utils = modules["lerobot.teleoperators.utils"] = types.ModuleType("lerobot.teleoperators.utils")
    utils.TeleopEvents = enum.Enum("TeleopEvents", EVENTS)
    errors = modules["lerobot.utils.errors"] = types.ModuleType("lerobot.utils.errors")
    for name in ERRORS:
        setattr(errors, name, type(name, (ConnectionError,), {}))
    cameras = modules["lerobot.cameras"] = types.ModuleType("lerobot.cameras")
    cameras.CameraConfig = _config("CameraConfig")
    cameras.make_cameras_from_configs = lambda configs: {
        name: config.made() for name, config in configs.items()
    }
    return modules


def is_installed():
    """Return whether LeRobot is installed, with all modules that the distributions import.

    The import takes seconds, so that LeRobot belongs in a separate environment.
    """
    if "lerobot" in sys.modules:
        return not isinstance(getattr(sys.modules["lerobot"], "__file__", None), type(None))
    try:
        import lerobot.robots
        import lerobot.teleoperators  # noqa: F401
    except ImportError:
        return False
    return True
