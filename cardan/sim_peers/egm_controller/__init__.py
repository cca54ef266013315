"""A simulated ABB GoFa CRB 15000-5 controller that speaks Externally Guided Motion (EGM)."""

from cardan.sim_peers.egm_controller.arguments import EgmMode as EgmMode
from cardan.sim_peers.egm_controller.contact import ContactSurface as ContactSurface
from cardan.sim_peers.egm_controller.controller import EgmController as EgmController
from cardan.sim_peers.egm_controller.external_motion import EgmState as EgmState
from cardan.sim_peers.egm_controller.faults import FAULTS as FAULTS
from cardan.sim_peers.egm_controller.options import (
    ROBOTWARE as ROBOTWARE,
    EgmControllerOptions as EgmControllerOptions,
)
from cardan.sim_peers.egm_controller.scripts import SCRIPTS as SCRIPTS
from cardan.sim_peers.egm_controller.udp import EgmControllerPeer as EgmControllerPeer
from cardan.sim_peers.link import FaultyLink as FaultyLink
