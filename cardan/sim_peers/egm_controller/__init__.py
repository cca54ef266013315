"""A simulated ABB GoFa CRB 15000-5 controller that speaks Externally Guided Motion (EGM)."""

from cardan.sim_peers.egm_controller.arguments import Mode
from cardan.sim_peers.egm_controller.contact import Surface
from cardan.sim_peers.egm_controller.controller import Counters, EgmController
from cardan.sim_peers.egm_controller.events import Event
from cardan.sim_peers.egm_controller.external_motion import EgmState
from cardan.sim_peers.egm_controller.faults import FAULTS
from cardan.sim_peers.egm_controller.options import ROBOTWARE, EgmControllerOptions
from cardan.sim_peers.egm_controller.scripts import SCRIPT_VERBS, SCRIPTS
from cardan.sim_peers.egm_controller.udp import EgmControllerPeer
from cardan.sim_peers.link import FaultyLink

__all__ = [
    "FAULTS",
    "ROBOTWARE",
    "SCRIPTS",
    "SCRIPT_VERBS",
    "Counters",
    "EgmController",
    "EgmControllerOptions",
    "EgmControllerPeer",
    "EgmState",
    "Event",
    "FaultyLink",
    "Mode",
    "Surface",
]
