"""Command ``cardan sim jr3``."""

from __future__ import annotations

from cardan.sim_peers.command import PeerCommand
from cardan_jr3.peer.faults import FAULTS
from cardan_jr3.peer.motion_script import SCRIPT_VERBS, SCRIPTS
from cardan_jr3.peer.peer import Jr3Peer, Jr3PeerOptions


class Jr3(PeerCommand[Jr3PeerOptions]):
    """JR3 force-torque sensor with uc3m's mbed board on a CAN bus, and the loads on it."""

    Options, Peer = Jr3PeerOptions, Jr3Peer
    page = "../plugins/cardan-jr3/README.md"
    example = "--script demo --fault lost=0.05"
    speaks = (
        "[JR3 over CAN](../plugins/cardan-jr3/README.md#protocol), on any bus of python-can, "
        "or on one it serves"
    )
    epilog = "Prints READY and the bus once it is on it."
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS
