"""A simulated joint-controlled arm with rigid-body dynamics, drives, joint stops and contact."""

from cardan.sim_peers.arm.controller import CLIENT_SILENT_S, Counters, SimulatedArm
from cardan.sim_peers.arm.faults import FAULTS
from cardan.sim_peers.arm.options import (
    PERIOD_S,
    Ball,
    Plane,
    PlantOptions,
    SimulatedArmOptions,
)
from cardan.sim_peers.arm.plant import ArmPlant, DriveMode, build_model
from cardan.sim_peers.arm.udp import SimulatedArmPeer

__all__ = [
    "CLIENT_SILENT_S",
    "FAULTS",
    "PERIOD_S",
    "ArmPlant",
    "Ball",
    "Counters",
    "DriveMode",
    "Plane",
    "PlantOptions",
    "SimulatedArm",
    "SimulatedArmOptions",
    "SimulatedArmPeer",
    "build_model",
]
