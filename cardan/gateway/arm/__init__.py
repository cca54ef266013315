"""The controller of an arm, the same for every source of motion, and the verbs of the Cartesian
interface."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cardan.gateway.arm.device import CartesianDevice, digital_output_gripper
    from cardan.gateway.arm.interface import CartesianArm
    from cardan.gateway.arm.options import ControllerOptions
    from cardan.gateway.arm.verb_methods import ArmVerbs
    from cardan.gateway.arm.verb_results import ControllerStatus, Motion, Outcome, Stat
    from cardan.gateway.arm.vocab import Action, FrameCode, Parameter, State, Stream

_HOMES = {
    "vocab": ("Action", "FrameCode", "Parameter", "State", "Stream"),
    "device": ("CartesianDevice", "digital_output_gripper"),
    "interface": ("CartesianArm",),
    "options": ("ControllerOptions",),
    "verb_methods": ("ArmVerbs",),
    "verb_results": ("ControllerStatus", "Motion", "Outcome", "Stat"),
}
# Imported on demand: sessions without an arm's model do without Pinocchio.

__all__ = [
    "Action",
    "ArmVerbs",
    "CartesianArm",
    "CartesianDevice",
    "ControllerOptions",
    "ControllerStatus",
    "FrameCode",
    "Motion",
    "Outcome",
    "Parameter",
    "Stat",
    "State",
    "Stream",
    "digital_output_gripper",
]


def __getattr__(name: str) -> object:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
