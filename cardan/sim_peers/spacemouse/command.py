"""The puck as ``cardan sim spacemouse`` has it: one command for all carriers."""

from __future__ import annotations

from cardan.sim_peers.command import PeerCommand
from cardan.sim_peers.spacemouse.faults import FAULTS
from cardan.sim_peers.spacemouse.hand import SCRIPT_VERBS, SCRIPTS
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions


class SpaceMouse(PeerCommand[SpaceMousePeerOptions]):
    """A 3Dconnexion device (HID reports), moved by a script or by the keyboard."""

    Options, Peer = SpaceMousePeerOptions, SpaceMousePeer
    page = "simulated-devices.md"
    speaks = (
        "[HID reports](protocols/3dconnexion-hid.md), one per packet of a Unix socket, by "
        "uhid or USB/IP"
    )
    epilog = "Prints READY and where it is once it can be opened."
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS
