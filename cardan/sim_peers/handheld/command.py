"""The simulated pages as ``cardan sim phone`` and ``cardan sim xr`` have them."""

from __future__ import annotations

from cardan.sim_peers.command import PeerCommand
from cardan.sim_peers.handheld.core import FAULTS
from cardan.sim_peers.handheld.peer import PagePeer, PagePeerOptions, XrPeerOptions
from cardan.sim_peers.spacemouse.hand import SCRIPT_VERBS, SCRIPTS

_SPEAKS = "[operator frames](protocols/handheld.md), Zenoh"
_EPILOG = "Prints READY and the Zenoh endpoint that others connect to once it serves."


class PhonePage(PeerCommand[PagePeerOptions]):
    """A page of the console with a phone's orientation and touch."""

    Options, Peer = PagePeerOptions, PagePeer
    page = "simulated-devices.md"
    speaks = _SPEAKS
    epilog = _EPILOG
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS


class XrPage(PeerCommand[XrPeerOptions]):
    """A page of the console with a headset's controllers, or a phone with AR."""

    Options, Peer = XrPeerOptions, PagePeer
    page = "simulated-devices.md"
    speaks = _SPEAKS
    epilog = _EPILOG
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS
