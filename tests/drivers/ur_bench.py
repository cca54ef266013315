"""A session of the UR driver joined to a simulated controller, in virtual time."""

from itertools import count

from cardan.drivers.ur_rtde.options import UrRtdeOptions
from cardan.drivers.ur_rtde.session import CHANNELS, UrSession
from cardan.sim_peers.ur_controller import UrController, UrControllerOptions, UrServers
from tests.drivers.tcp_bench import TcpBench


class SessionBench(TcpBench):
    """`trace`: (time, commanded joints, measured joints) in each frame of the controller."""

    channels = CHANNELS
    idle = "idle"

    def __init__(self, driver=None, answer=None, start_s=100.0, **controller):
        controller.setdefault("running", True)
        self.peer_options = UrControllerOptions(**controller)
        rate_hz = self.peer_options.rate_hz
        given = {"robot": self.peer_options.robot, "rate_hz": rate_hz, **(driver or {})}
        self.options = UrRtdeOptions(**given)
        self._frames = 0
        made = UrController(self.peer_options)
        session = UrSession(self.options, count(1000).__next__)
        super().__init__(session, made, UrServers(made, self.peer_options), answer, start_s)

    def _watch(self):
        if self.controller.frames != self._frames:
            self._frames = self.controller.frames
            motion = self.controller.motion
            self.trace.append((self.now_s, tuple(motion.target_q), tuple(motion.actual_q)))

    def _command(self, command):
        if self.session.reply_pending and self.session.late(self.now_s):
            self._deliver()  # also done by the driver's send
        super()._command(command)
