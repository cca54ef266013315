"""A MotoROS session joined to a simulated controller, in virtual time."""

from cardan.drivers.motoros.connections import CHANNELS
from cardan.drivers.motoros.motion_control import MotionPhase
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.session import MotorosSession
from cardan.sim_peers.motoros_controller import (
    MotorosController,
    MotorosControllerOptions,
    MotorosServers,
)
from tests.drivers.tcp_bench import TcpBench

TICK_S = 2.5e-4
"""Longest step of virtual time."""


class SessionBench(TcpBench):
    """`trace`: (time, joint 1 commanded in the controller, joint 1 measured) of every tick."""

    kind_of_session = MotorosSession
    channels = CHANNELS
    idle = MotionPhase.IDLE

    def __init__(self, driver=None, answer=None, start_s=100.0, tick_s=TICK_S, **controller):
        controller.setdefault("servo_on", True)
        self.peer_options = MotorosControllerOptions(**controller)
        self.options = MotorosOptions(**(driver or {}))
        self.tick_s = tick_s
        made = MotorosController(self.peer_options)
        servers = MotorosServers(made, self.peer_options)
        super().__init__(self.kind_of_session(self.options), made, servers, answer, start_s)

    def _times(self):
        return [self.now_s + self.tick_s, *super()._times()]

    def turn(self):
        super().turn()
        commanded = self.controller.command_rad(0)
        self.trace.append((self.now_s, commanded[0], self.controller.measured_rad(0)[0]))
