"""The controller as ``cardan sim motoman-gp8`` has it."""

from __future__ import annotations

from cardan.sim_peers.base import serve
from cardan.sim_peers.command import PeerCommand
from cardan.sim_peers.motoros_controller.faults import FAULTS
from cardan.sim_peers.motoros_controller.options import MotorosControllerOptions
from cardan.sim_peers.motoros_controller.tcp import MotorosControllerPeer


class MotomanGp8(PeerCommand[MotorosControllerOptions]):
    """A Yaskawa Motoman GP8 that runs MotoROS (simple message on three TCP ports)."""

    Options = MotorosControllerOptions
    page = "simulated-peers.md"
    speaks = (
        "[simple message](protocols/simple-message.md) on three TCP ports, with [velocity "
        "mode](protocols/motoros-velocity-mode.md)"
    )
    epilog = "Prints READY and the address of motion once it serves."
    faults = FAULTS

    @staticmethod
    def run(options: MotorosControllerOptions, seconds: float | None) -> None:
        serve(MotorosControllerPeer(options), seconds)
