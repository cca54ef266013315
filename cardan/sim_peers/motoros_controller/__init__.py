"""A simulated Yaskawa Motoman controller that runs MotoROS: simple message on three TCP ports."""

from cardan.sim_peers.base import FaultSwitch
from cardan.sim_peers.motoros_controller.controller import MotorosController
from cardan.sim_peers.motoros_controller.faults import ROBOT_FAULTS
from cardan.sim_peers.motoros_controller.io_image import IoImage
from cardan.sim_peers.motoros_controller.options import MotorosControllerOptions
from cardan.sim_peers.motoros_controller.plant import PLANTS
from cardan.sim_peers.motoros_controller.server_faults import SERVER_FAULTS
from cardan.sim_peers.motoros_controller.servers import (
    CONNECTIONS,
    PORT_KINDS,
    MotorosServers,
    ServerCounters,
)
from cardan.sim_peers.motoros_controller.tcp import MotorosControllerPeer

FAULTS: tuple[FaultSwitch, ...] = (*ROBOT_FAULTS, *SERVER_FAULTS)

__all__ = [
    "CONNECTIONS",
    "FAULTS",
    "PLANTS",
    "PORT_KINDS",
    "ROBOT_FAULTS",
    "SERVER_FAULTS",
    "IoImage",
    "MotorosController",
    "MotorosControllerOptions",
    "MotorosControllerPeer",
    "MotorosServers",
    "ServerCounters",
]
