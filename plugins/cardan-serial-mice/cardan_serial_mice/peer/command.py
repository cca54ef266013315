"""The simulated device for ``cardan sim spacemouse-serial``."""

from __future__ import annotations

from cardan.sim_peers.command import PeerCommand
from cardan.sim_peers.spacemouse.motion_script import SCRIPT_VERBS, SCRIPTS
from cardan_serial_mice.peer.line import SERIAL_FAULTS
from cardan_serial_mice.peer.peer import SerialPuckPeer, SerialPuckPeerOptions


class SpaceMouseSerial(PeerCommand[SerialPuckPeerOptions]):
    """A Magellan, Spaceball or SpaceOrb at a serial port, moved by a script or by the keyboard."""

    Options, Peer = SerialPuckPeerOptions, SerialPuckPeer
    page = "simulated-peers.md"
    example = "--port magellan0 --model magellan"
    speaks = (
        "[serial packets](../plugins/cardan-serial-mice/README.md#protocol) on a pseudo-terminal"
    )
    epilog = "Prints READY and the port's path once it can be opened."
    faults, scripts, verbs = SERIAL_FAULTS, SCRIPTS, SCRIPT_VERBS
