"""A session over several TCP connections, joined to simulated servers in virtual time."""

from cardan.types import HoldCommand

LATENCY_S = 1.5e-4
"""One-way latency. A request is answered in 0.3 ms, as measured on a real line."""


class TcpBench:
    """Session and controller; `answer` returns the command for each state that requests one."""

    channels = ()
    idle = None
    """Phase of a session that can be enabled."""

    def __init__(self, session, controller, servers, answer, start_s):
        self.session = session
        self.controller = controller
        self.servers = servers
        self.answer = answer or (lambda state: HoldCommand())
        self.now_s = start_s
        self.states = []
        self.trace = []
        self.alive = True
        """False while the driver's process is stopped or dead; its kernel keeps the sockets."""
        self.reachable = True
        self.numbers = {}
        self._flight = []
        """(arrival time, whether at the controller, its connection there, bytes) of data in
        transit."""
        self.servers.advance(start_s)

    def run(self, seconds, until=None):
        """Let time pass; ends early when `until()` is true."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s = min(max(min(self._times()), self.now_s + 1e-5), end_s)
            self.turn()
            if until is not None and until():
                break
        return self

    def _times(self):
        """Return the times at which something is due."""
        arrivals = [item[0] for item in self._flight if self.alive or item[1]]
        return [self.servers.next_s, *arrivals, *([self.session.next_s] if self.alive else [])]

    def turn(self):
        self.servers.advance(self.now_s)
        self._watch()
        self._carry_from_controller()
        self._deliver()
        if self.alive:
            self._act()

    def _watch(self):
        """Look at the controller before data arrive."""

    def _act(self):
        now_s, session = self.now_s, self.session
        for channel in self.channels:
            if channel not in self.numbers and session.wants(channel, now_s):
                self._connect(channel)
        session.advance(now_s)
        self._carry_from_session()
        state = session.due_state(now_s)
        if state is not None:
            self.states.append(state)
            command = self.answer(state)
            if command is not None:
                self._command(command)
            self._carry_from_session()

    def _command(self, command):
        self.session.command(command, self.now_s)

    def stall(self, seconds):
        """Stop the driver's process; robot and network continue."""
        self.alive = False
        self.run(seconds)
        self.alive = True

    def ready(self, seconds=5.0):
        """Connect, enable, and wait until commands act."""
        self.run(1.0, until=lambda: self.session.phase == self.idle)
        self.session.ask("enable", self.now_s)
        self.run(seconds, until=lambda: bool(self.states) and self.states[-1].ready)
        assert self.states[-1].ready, self.states[-1].hold_reason
        return self

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
        """Break the connection for both ends."""
        number = self.numbers.pop(channel)
        self.servers.eof(number, self.now_s)
        self.session.disconnected(channel, "Connection reset by peer", self.now_s)
