"""A simulated remote connected to the driver's core, in virtual time."""

from __future__ import annotations

import math

from cardan.types import NEVER_S, DeviceLink
from cardan_wiimote.driver import Identity, WiimoteCore, WiimoteOptions
from cardan_wiimote.peer import FAULTS, SimulatedWiimote
from cardan_wiimote.protocol import Data, Rumble, decode_input, encode_output

STEP_S = 0.002
RETRY_S = 0.25
REST = (0.0,) * 6


def fault_default(name):
    return {switch.name: switch.default for switch in FAULTS}[name]


class Bench:
    """The driver's shell without threads: opens, serves, detects a loss, reopens."""

    def __init__(self, options=None, *, identity=None, **remote):
        self.options = options or WiimoteOptions(dead_zone=0.0)
        self.remote = SimulatedWiimote(**remote)
        self.core = WiimoteCore(self.options)
        self.identity = identity or Identity("Nintendo RVL-CNT-01")
        self.now_s = 0.0
        self.open = False
        self.retry_s = 0.0
        self.opened = 0
        self.sent = []
        self.states = []
        """Time, age of the newest good report, and state, for every step."""
        self.deaf = False
        """True: all reports of the remote are lost."""
        self.good_s = NEVER_S
        """Arrival time of the newest report with an acceleration."""

    def run(self, seconds):
        """Run and return the last state."""
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            self.now_s += STEP_S
            self._step()
            state = self.core.state(self.now_s)
            self.states.append((self.now_s, self.now_s - self.good_s, state))
        return self.states[-1][2]

    def until(self, condition, within_s):
        end_s = self.now_s + within_s
        while not condition(self):
            assert self.now_s < end_s, (self.state, self.core.diagnosis(self.now_s))
            self.run(STEP_S)
        return self.state

    def ready(self, within_s=2.0):
        """Run until it is LIVE."""
        return self.until(lambda bench: bench.state.link is DeviceLink.LIVE, within_s)

    @property
    def state(self):
        return self.core.state(self.now_s)

    def tilt(self, right_deg=0.0, down_deg=0.0):
        self.remote.set_attitude(math.radians(right_deg), -math.radians(down_deg))

    def press(self, *labels):
        for label in labels:
            self.remote.press(label)
        return self.run(0.05)

    def release(self, *labels):
        for label in labels:
            self.remote.release(label)
        return self.run(0.05)

    def edges(self):
        return [(event.button, event.pressed) for event in self.core.events()]

    def diagnosis(self):
        return self.core.diagnosis(self.now_s)

    def metrics(self):
        return self.core.metrics(self.now_s)

    def _step(self):
        now_s = self.now_s
        if not self.open:
            if now_s < self.retry_s or not self.remote.connect(now_s):
                return
            self.open = True
            self.opened += 1
            self.core.on_opened(now_s, self.identity)
        for report in self.core.outgoing(now_s):
            self.sent.append((now_s, report))
            self.remote.output(report, now_s)
        reports = self.remote.reports(now_s)
        for report in () if self.deaf else reports:
            value = decode_input(report)
            if isinstance(value, Data) and value.accelerometer is not None:
                self.good_s = now_s
            self.core.on_report(report, now_s)
        if self.core.failure(now_s):
            self._lose(self.core.failure(now_s))
        elif not (self.remote.control_open and self.remote.interrupt_open):
            self._lose("unplugged")

    def _lose(self, reason):
        self.core.on_lost(reason, self.now_s)
        self.remote.output(encode_output(Rumble()), self.now_s)
        self.remote.disconnect(self.now_s)
        self.open = False
        self.retry_s = self.now_s + RETRY_S
