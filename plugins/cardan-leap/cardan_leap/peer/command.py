"""Command ``cardan sim leap``."""

from __future__ import annotations

from cardan.sim_peers.command import PeerCommand
from cardan_leap.peer.faults import FAULTS
from cardan_leap.peer.hand import SCRIPT_VERBS, SCRIPTS
from cardan_leap.peer.service import LeapPeer, LeapPeerOptions


class Leap(PeerCommand[LeapPeerOptions]):
    """A Leap Motion tracking service and the hands it sees (JSON over WebSocket)."""

    Options, Peer = LeapPeerOptions, LeapPeer
    page = "../plugins/cardan-leap/README.md"
    example = "--port 6437 --script demo"
    speaks = "[JSON over WebSocket](../plugins/cardan-leap/README.md#protocol), 110 frames a second"
    epilog = "Prints READY and its address once it listens."
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS
