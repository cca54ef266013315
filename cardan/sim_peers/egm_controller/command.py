"""The controller as ``cardan sim abb-gofa`` has it."""

from __future__ import annotations

from cardan.sim_peers.base import serve
from cardan.sim_peers.command import PeerCommand
from cardan.sim_peers.egm_controller.faults import FAULTS
from cardan.sim_peers.egm_controller.options import EgmControllerOptions
from cardan.sim_peers.egm_controller.scripts import SCRIPT_VERBS, SCRIPTS
from cardan.sim_peers.egm_controller.udp import EgmControllerPeer


class AbbGofa(PeerCommand[EgmControllerOptions]):
    """An ABB GoFa CRB 15000-5 in Externally Guided Motion (protobuf on UDP, 250 Hz)."""

    Options = EgmControllerOptions
    page = "simulated-peers.md"
    speaks = "[EGM](protocols/egm.md), protobuf on UDP, 250 Hz"
    epilog = "Prints READY and the PC's address once it sends."
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS

    @staticmethod
    def run(options: EgmControllerOptions, seconds: float | None) -> None:
        serve(EgmControllerPeer(options), seconds)
