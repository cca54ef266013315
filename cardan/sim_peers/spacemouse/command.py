"""The puck as ``cardan sim spacemouse`` has it: one command for all carriers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from cardan.errors import ConfigurationError
from cardan.protocols.connexion import MODELS
from cardan.protocols.connexion_serial import SERIAL_MODELS
from cardan.sim_peers.base import FaultSwitch, SimulatedPeer, serve
from cardan.sim_peers.command import PeerCommand, option
from cardan.sim_peers.spacemouse.faults import FAULTS
from cardan.sim_peers.spacemouse.hand import SCRIPT_VERBS, SCRIPTS
from cardan.sim_peers.spacemouse.serial import SerialSpaceMousePeer, SerialSpaceMousePeerOptions
from cardan.sim_peers.spacemouse.serial_line import SERIAL_FAULTS
from cardan.sim_peers.spacemouse.shell import PuckOptions
from cardan.sim_peers.spacemouse.socket import SpaceMousePeer, SpaceMousePeerOptions
from cardan.sim_peers.spacemouse.uhid import UhidSpaceMousePeer, UhidSpaceMousePeerOptions
from cardan.sim_peers.spacemouse.usbip import UsbipSpaceMousePeer, UsbipSpaceMousePeerOptions


@dataclass(frozen=True, kw_only=True)
class CarriedPuckOptions(PuckOptions):
    """What to simulate, and which one of the four carriers opens it."""

    hid: str = option("", "Unix seqpacket socket: each packet one raw HID report.", metavar="PATH")
    serial: str = option("", "A serial port: a link to a pseudo-terminal.", metavar="LINK")
    uhid: bool = option(False, "A HID device of this machine's kernel (/dev/uhid).")
    usbip: int | None = option(
        None, "A USB device by USB/IP at this port of 127.0.0.1; 0: any.", metavar="PORT"
    )
    model: str = option(
        "",
        "Which device; see --list-models. Default: spacenavigator, magellan if serial.",
        metavar="NAME",
        listed=[
            *(
                (model.key, f"{model.vendor_id:04x}:{model.product_id:04x}  {model.name}")
                for model in MODELS
            ),
            *((model.key, f"serial     {model.name}") for model in SERIAL_MODELS),
        ],
    )


class SpaceMouse(PeerCommand[CarriedPuckOptions]):
    """A 3Dconnexion device, USB (HID reports) or serial, moved by a script or by the keyboard."""

    Options = CarriedPuckOptions
    page = "simulated-devices.md"
    speaks = (
        "[HID reports](protocols/3dconnexion-hid.md), one per packet of a Unix socket, by "
        "uhid or USB/IP; [serial packets](protocols/3dconnexion-serial.md) on a "
        "pseudo-terminal"
    )
    epilog = "Prints READY and where it is once it can be opened."
    faults, scripts, verbs = FAULTS, SCRIPTS, SCRIPT_VERBS

    @classmethod
    def faults_with(cls, given: Mapping[str, Any]) -> Sequence[FaultSwitch]:
        return SERIAL_FAULTS if given["serial"] else FAULTS

    @staticmethod
    def run(options: CarriedPuckOptions, seconds: float | None) -> None:
        serve(_peer(options), seconds)


def _peer(options: CarriedPuckOptions) -> SimulatedPeer:
    ways = {
        "--hid": bool(options.hid),
        "--serial": bool(options.serial),
        "--uhid": options.uhid,
        "--usbip": options.usbip is not None,
    }
    given = [way for way, there in ways.items() if there]
    if len(given) != 1:
        found = " and ".join(given) if given else "none"
        raise ConfigurationError(", ".join(ways), f"give one way to open the device, not {found}")
    puck: dict[str, Any] = {each.name: getattr(options, each.name) for each in fields(PuckOptions)}
    if options.serial:
        puck["model"] = options.model or SerialSpaceMousePeerOptions.model
        return SerialSpaceMousePeer(SerialSpaceMousePeerOptions(link=options.serial, **puck))
    puck["model"] = options.model or PuckOptions.model
    if options.hid:
        return SpaceMousePeer(SpaceMousePeerOptions(path=options.hid, **puck))
    if options.uhid:
        return UhidSpaceMousePeer(UhidSpaceMousePeerOptions(**puck))
    return UsbipSpaceMousePeer(UsbipSpaceMousePeerOptions(**{"port": options.usbip, **puck}))
