"""``cardan sim arm``: the command of the simulated arm."""

from __future__ import annotations

from cardan.sim_peers.arm.faults import FAULTS
from cardan.sim_peers.arm.options import SimulatedArmOptions
from cardan.sim_peers.base import serve
from cardan.sim_peers.command import PeerCommand


class SimulatedArmCommand(PeerCommand[SimulatedArmOptions]):
    """An arm with rigid-body dynamics and joint control (joint stream on UDP, 500 Hz)."""

    Options = SimulatedArmOptions
    page = "simulated-peers.md"
    example = "--robot ur5 --listen 127.0.0.1:6520"
    speaks = "[joint stream](simulated-peers.md#joint-stream-byte-for-byte), UDP, 500 Hz"
    epilog = "Prints READY and the address it listens on once it serves."
    faults = FAULTS

    @staticmethod
    def run(options: SimulatedArmOptions, seconds: float | None) -> None:
        from cardan.sim_peers.arm.udp import SimulatedArmPeer

        serve(SimulatedArmPeer(options), seconds)
