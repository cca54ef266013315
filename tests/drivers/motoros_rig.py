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

LATENCY_S = 1.5e-4
"""One way. With it a request is answered in the 0.3 ms that were seen on a real line."""
TICK_S = 2.5e-4
"""At most so much time passes at once."""


class Rig:
    """Session and controller; `answer` makes the command for each state that asks for one."""

    def __init__(self, driver=None, answer=None, start_s=100.0, tick_s=TICK_S, **controller):
        controller.setdefault("servo_on", True)
        self.peer_options = MotorosControllerOptions(**controller)
        self.options = MotorosOptions(**(driver or {}))
        self.session = MotorosSession(self.options)
        self.controller = MotorosController(self.peer_options)
        self.servers = MotorosServers(self.controller, self.peer_options)
        self.now_s = start_s
        self.tick_s = tick_s
        self.answer = answer or (lambda state: HoldCommand())
        self.states = []
        self.trace = []
        """(time, joint 1 commanded in the controller, joint 1 measured) of every tick."""
        self.reachable = True
        self.numbers = {}
        self._flight = []
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
                session.command(command, now_s)
            self._carry_from_session()
        commanded = self.controller.command_rad(0)
        self.trace.append((now_s, commanded[0], self.controller.measured_rad(0)[0]))

    def _connect(self, channel):
        if not self.reachable:
            self.session.connect_failed(channel, "Connection refused", self.now_s)
            return
        number = self.servers.accepted(channel, self.now_s)
        self.session.connected(channel, self.now_s)
        if number is None:
            self.session.disconnected(channel, "the controller closed it", self.now_s)
        else:
            self.numbers[channel] = number

    def _carry_from_session(self):
        for channel in self.session.closing():
            number = self.numbers.pop(channel, None)
            if number is not None:
                self.servers.eof(number, self.now_s)
        for channel, data in self.session.outgoing():
            if channel in self.numbers:
                self._flight.append((self.now_s + LATENCY_S, True, self.numbers[channel], data))

    def _carry_from_controller(self):
        names = {number: channel for channel, number in self.numbers.items()}
        for number, data in self.servers.outgoing():
            if number in names:
                self._flight.append((self.now_s + LATENCY_S, False, names[number], data))
        for number in (*self.servers.closing(), *self.servers.aborting()):
            channel = names.get(number)
            if channel in self.numbers:
                del self.numbers[channel]
                self.session.disconnected(channel, "the controller closed it", self.now_s)

    def unplug(self, channel):
        """The connection breaks for both."""
        number = self.numbers.pop(channel)
        self.servers.eof(number, self.now_s)
        self.session.disconnected(channel, "Connection reset by peer", self.now_s)

    def ready(self, seconds=5.0):
        """Connect, enable, and wait until commands act."""
        self.run(1.0, until=lambda: self.session.phase.name == "IDLE")
        self.session.enable(self.now_s)
        self.run(seconds, until=lambda: bool(self.states) and self.states[-1].ready)
        assert self.states[-1].ready, self.states[-1].hold_reason
        return self
