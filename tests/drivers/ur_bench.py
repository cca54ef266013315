"""A session of the UR driver joined to a simulated controller, in virtual time."""

from itertools import count

from cardan.drivers.ur_rtde.options import UrRtdeOptions
from cardan.drivers.ur_rtde.session import CHANNELS, UrSession
from cardan.sim_peers.ur_controller import UrController, UrControllerOptions, UrServers
from cardan.types import HoldCommand
from tests.drivers.tcp_bench import TcpBench


class SessionBench(TcpBench):
    """Session and controller; `answer` returns the command for each state that requests one."""

    def __init__(self, driver=None, answer=None, start_s=100.0, **controller):
        super().__init__()
        controller.setdefault("running", True)
        self.peer_options = UrControllerOptions(**controller)
        rate_hz = self.peer_options.rate_hz
        given = {"robot": self.peer_options.robot, "rate_hz": rate_hz, **(driver or {})}
        self.options = UrRtdeOptions(**given)
        self.session = UrSession(self.options, count(1000).__next__)
        self.controller = UrController(self.peer_options)
        self.servers = UrServers(self.controller, self.peer_options)
        self.now_s = start_s
        self.answer = answer or (lambda state: HoldCommand())
        self.states = []
        self.trace = []
        """(time, commanded joints, measured joints) in each frame of the controller."""
        self.alive = True
        """False while the driver's process is stopped or dead."""
        self._frames = 0
        self.servers.advance(start_s)

    def run(self, seconds, until=None):
        """Let time pass; return early when `until()` is true."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            arrivals = (item[0] for item in self._flight if self.alive or item[1])
            times = [self.servers.next_s, *arrivals]
            if self.alive:
                times.append(self.session.next_s)
            self.now_s = min(max(min(times), self.now_s + 1e-5), end_s)
            self.turn()
            if until is not None and until():
                break
        return self

    def turn(self):
        now_s, session, servers = self.now_s, self.session, self.servers
        servers.advance(now_s)
        if self.controller.frames != self._frames:
            self._frames = self.controller.frames
            motion = self.controller.motion
            self.trace.append((now_s, tuple(motion.target_q), tuple(motion.actual_q)))
        self._carry_from_controller()
        self._deliver()
        if not self.alive:
            return
        for channel in CHANNELS:
            if channel not in self.numbers and session.wants(channel, now_s):
                self._connect(channel)
        session.advance(now_s)
        self._carry_from_session()
        state = session.due_state(now_s)
        if state is not None:
            self.states.append(state)
            command = self.answer(state)
            if command is not None:
                if session.reply_pending and session.late(self.now_s):
                    self._deliver()  # also done by the driver's send
                session.command(command, self.now_s)
            self._carry_from_session()

    def _deliver(self):
        """Deliver data that has arrived; a stopped process leaves it queued."""
        now_s = self.now_s
        flight, self._flight, due = self._flight, [], []
        for item in flight:
            arrived = item[0] <= now_s and (self.alive or item[1])
            (due if arrived else self._flight).append(item)
        for _, to_controller, key, data in due:
            if to_controller and key in self.numbers.values():
                self.servers.data(key, data, now_s)
            elif not to_controller and key in self.numbers:
                self.session.received(key, data, now_s)

    def stall(self, seconds):
        """Stop the driver's process; robot and network continue."""
        self.alive = False
        self.run(seconds)
        self.alive = True

    def ready(self, seconds=5.0):
        """Connect, enable, and wait until commands act."""
        self.run(1.0, until=lambda: self.session.phase == "idle")
        self.session.ask("enable", self.now_s)
        self.run(seconds, until=lambda: bool(self.states) and self.states[-1].ready)
        assert self.states[-1].ready, self.states[-1].hold_reason
        return self
