"""Connection of a session over several TCP connections to simulated servers, in virtual time."""

LATENCY_S = 1.5e-4
"""One-way latency. A request is answered in 0.3 ms, as measured on a real line."""


class TcpBench:
    """TCP connections of a bench, which has `session`, `servers` and `now_s`, and delivers data in
    transit."""

    def __init__(self):
        self.reachable = True
        self.numbers = {}
        self._flight = []
        """(arrival time, whether at the controller, its connection there, bytes) of data in
        transit."""

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

    def arrive(self):
        """Let data of the controller wait at the session's end, as after a stall: the driver reads
        it before it looks at the time."""
        self._carry_from_controller()
        self._flight = [(self.now_s if not to else due_s, to, key, data)
                        for due_s, to, key, data in self._flight]  # fmt: skip

    def unplug(self, channel):
        """Break the connection for both ends."""
        number = self.numbers.pop(channel)
        self.servers.eof(number, self.now_s)
        self.session.disconnected(channel, "Connection reset by peer", self.now_s)
