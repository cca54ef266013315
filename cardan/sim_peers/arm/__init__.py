"""A simulated joint-controlled arm with rigid-body dynamics, drives, joint stops and contact."""

from cardan.sim_peers.arm.controller import (
    CLIENT_SILENT_S as CLIENT_SILENT_S,
    Counters as Counters,
    SimulatedArm as SimulatedArm,
)
from cardan.sim_peers.arm.faults import FAULTS as FAULTS
from cardan.sim_peers.arm.options import (
    PERIOD_S as PERIOD_S,
    Ball as Ball,
    Plane as Plane,
    PlantOptions as PlantOptions,
    SimulatedArmOptions as SimulatedArmOptions,
)
from cardan.sim_peers.arm.plant import (
    ArmPlant as ArmPlant,
    DriveMode as DriveMode,
    build_model as build_model,
)
from cardan.sim_peers.arm.udp import SimulatedArmPeer as SimulatedArmPeer
