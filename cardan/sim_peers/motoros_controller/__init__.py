"""A simulated Yaskawa Motoman controller that runs MotoROS: simple message on three TCP ports."""

from cardan.sim_peers.motoros_controller.controller import MotorosController as MotorosController
from cardan.sim_peers.motoros_controller.faults import FAULTS as FAULTS
from cardan.sim_peers.motoros_controller.options import (
    MotorosControllerOptions as MotorosControllerOptions,
)
from cardan.sim_peers.motoros_controller.servers import (
    CONNECTIONS as CONNECTIONS,
    PORT_KINDS as PORT_KINDS,
    MotorosServers as MotorosServers,
)
from cardan.sim_peers.motoros_controller.tcp import MotorosControllerPeer as MotorosControllerPeer
