"""A simulated joint-controlled arm with rigid-body dynamics, drives, joint stops and contact."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from cardan.sim_peers.arm.faults import FAULTS as FAULTS
from cardan.sim_peers.arm.options import (
    PERIOD_S as PERIOD_S,
    Ball as Ball,
    PlantOptions as PlantOptions,
    SimulatedArmOptions as SimulatedArmOptions,
    TouchPlane as TouchPlane,
)

if TYPE_CHECKING:
    from cardan.sim_peers.arm.controller import (
        CLIENT_SILENT_S as CLIENT_SILENT_S,
        Counters as Counters,
        SimulatedArm as SimulatedArm,
    )
    from cardan.sim_peers.arm.plant import (
        ArmPlant as ArmPlant,
        DriveMode as DriveMode,
        build_model as build_model,
    )
    from cardan.sim_peers.arm.udp import SimulatedArmPeer as SimulatedArmPeer

_HOMES = {
    "controller": ("CLIENT_SILENT_S", "Counters", "SimulatedArm"),
    "plant": ("ArmPlant", "DriveMode", "build_model"),
    "udp": ("SimulatedArmPeer",),
}
# Imported on demand: the driver of a served arm does without Pinocchio.


def __getattr__(name: str) -> object:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
