"""The simulated remote for ``cardan sim wiimote``."""

from __future__ import annotations

from cardan.sim_peers.command import PeerCommand
from cardan_wiimote.peer.faults import FAULTS
from cardan_wiimote.peer.motion_script import SCRIPT_VERBS, SCRIPTS
from cardan_wiimote.peer.peer import WiimotePeer, WiimotePeerOptions


class Wiimote(PeerCommand[WiimotePeerOptions]):
    """A Nintendo Wii Remote (reports over two L2CAP channels, or a HID device of the kernel's)."""

    Options, Peer = WiimotePeerOptions, WiimotePeer
    page = "../plugins/cardan-wiimote/README.md"
    example = "--l2cap wiimote-sockets --script demo"
    speaks = (
        "[its reports](../plugins/cardan-wiimote/README.md#protocol) "
        "over seqpacket sockets, uhid or L2CAP"
    )
    epilog = "Prints READY and where it is once it can be connected to."
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS
