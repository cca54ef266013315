"""The controller as ``cardan sim ur`` has it."""

from __future__ import annotations

from cardan.sim_peers.command import PeerCommand
from cardan.sim_peers.ur_controller.faults import FAULTS
from cardan.sim_peers.ur_controller.options import UrControllerOptions
from cardan.sim_peers.ur_controller.tcp import UrControllerPeer


class Ur(PeerCommand[UrControllerOptions]):
    """A Universal Robots UR5e or UR5 (RTDE, client interfaces and dashboard on TCP ports)."""

    Options, Peer = UrControllerOptions, UrControllerPeer
    page = "simulated-peers.md"
    speaks = (
        "[RTDE; primary, secondary and real-time interface with URScript; dashboard]"
        "(protocols/ur.md) on TCP ports"
    )
    epilog = "Prints READY and the address of RTDE once it serves."
    faults = FAULTS
