"""A MotoROS session joined to a simulated controller, in virtual time."""

from cardan.drivers.motoros.connections import CHANNELS
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.session import MotorosSession
from cardan.sim_peers.motoros_controller import (
    MotorosController,
    MotorosControllerOptions,
    MotorosServers,
)
from cardan.types import HoldCommand
from tests.drivers.tcp_bench import TcpBench

TICK_S = 2.5e-4
"""Longest step of virtual time."""


class SessionBench(TcpBench):
    """Session and controller; `answer` returns the command for each state that requests one."""

    kind_of_session = MotorosSession

    def __init__(self, driver=None, answer=None, start_s=100.0, tick_s=TICK_S, **controller):
        super().__init__()
        controller.setdefault("servo_on", True)
        self.peer_options = MotorosControllerOptions(**controller)
        self.options = MotorosOptions(**(driver or {}))
        self.session = self.kind_of_session(self.options)
        self.controller = MotorosController(self.peer_options)
        self.servers = MotorosServers(self.controller, self.peer_options)
        self.now_s = start_s
        self.tick_s = tick_s
        self.answer = answer or (lambda state: HoldCommand())
        self.states = []
        self.trace = []
        """(time, joint 1 commanded in the controller, joint 1 measured) of every tick."""
        self.servers.advance(start_s)

    def run(self, seconds, until=None):
        """Let time pass; ends early when `until()` is true."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            times = [self.now_s + self.tick_s, self.session.next_s, self.servers.next_s]
            times += [item[0] for item in self._flight]
            self.now_s = min(max(min(times), self.now_s + 1e-5), end_s)
            self.turn()
            if until is not None and until():
                break
        return self

    def turn(self):
        now_s, session, servers = self.now_s, self.session, self.servers
        servers.advance(now_s)
        self._carry_from_controller()
        due = [item for item in self._flight if item[0] <= now_s]
        self._flight = [item for item in self._flight if item[0] > now_s]
        for _, to_controller, key, data in due:
            if to_controller and key in self.numbers.values():
                servers.data(key, data, now_s)
            elif not to_controller and key in self.numbers:
                session.received(key, data, now_s)
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
                session.command(command, self.now_s)
            self._carry_from_session()
        commanded = self.controller.command_rad(0)
        self.trace.append((now_s, commanded[0], self.controller.measured_rad(0)[0]))

    def ready(self, seconds=5.0):
        """Connect, enable, and wait until commands act."""
        self.run(1.0, until=lambda: self.session.phase.name == "IDLE")
        self.session.enable(self.now_s)
        self.run(seconds, until=lambda: bool(self.states) and self.states[-1].ready)
        assert self.states[-1].ready, self.states[-1].hold_reason
        return self
