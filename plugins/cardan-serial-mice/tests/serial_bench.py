"""A simulated serial device, a driver session and a core in virtual time."""

import random

from cardan.types import DeviceLink
from cardan_serial_mice.driver import SerialMouseCore, SpaceMouseSerialOptions
from cardan_serial_mice.driver.session import SerialSession, device_model
from cardan_serial_mice.peer import simulated_serial_puck
from cardan_serial_mice.protocol import serial_model_by_key

STEP_S = 0.004
PLAIN = SpaceMouseSerialOptions(dead_zone=0.0)
REST = (0.0,) * 6


class Bench:
    """A simulated device, a driver session and a core, connected to each other."""

    def __init__(self, key, faults=None, known_model=True, jitter_lsb=0, boot_s=None):
        self.puck = simulated_serial_puck(
            serial_model_by_key(key), faults=faults, jitter_lsb=jitter_lsb, boot_s=boot_s
        )
        self.known_model = serial_model_by_key(key) if known_model else None
        self.core = SerialMouseCore(PLAIN)
        self.now_s = 0.0
        self.states = []
        self.failures = []
        self.notices = []
        self.session = None
        self.opened = False
        self.rng = random.Random(5)

    def connect(self):
        self.puck.power(True)
        self.session = SerialSession(self.known_model, self.now_s)
        self.opened = False

    def run(self, seconds, axes=None):
        """Hold the cap at `axes`; return the last state."""
        if axes is not None:
            self.puck.set_axes(axes)
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s += STEP_S
            self.step()
            self.states.append((self.now_s, self.core.state(self.now_s)))
        return self.states[-1][1]

    def step(self):
        arrived = self.puck.reports(self.now_s)
        session = self.session
        if session is None or not self.puck.plugged:
            if self.opened:
                self.core.on_lost("unplugged", self.now_s)
                self.opened = False
            self.session = None
            if self.puck.plugged:
                self.connect()
            return
        words = session.send(self.now_s)
        # A slow line delivers bytes one by one, a stalled one in bursts.
        if words:
            self.puck.receive(words)
        for notice in session.notices(self.now_s):
            self.notices.append((self.now_s, notice))
            if self.opened:
                self.core.on_notice(notice, self.now_s)
        for portion in arrived:
            cut = self.rng.randrange(len(portion) + 1)
            for part in (portion[:cut], portion[cut:]):
                values = session.receive(part, self.now_s) if part else []
                for notice in session.notices(self.now_s):
                    self.notices.append((self.now_s, notice))
                    self.core.on_notice(notice, self.now_s)
                if session.running and not self.opened:
                    self.opened = True
                    model = device_model(session.model)
                    self.core.on_opened(self.now_s, model, None, session.model.period_s)
                for value in values:
                    self.core.on_value(value, self.now_s)
        if session.running and not self.opened:
            self.opened = True
            self.core.on_opened(
                self.now_s, device_model(session.model), None, session.model.period_s
            )
        if reason := session.failure(self.now_s):
            self.failures.append((self.now_s, reason))
            if self.opened:
                self.core.on_lost(reason, self.now_s)
            self.puck.power(False)
            self.session = None

    def touch(self):
        self.run(0.2, (0.0, 0.0, 0.3, 0.0, 0.0, 0.0))
        return self.run(0.4, REST)

    def live(self):
        self.run(3.0)
        state = self.touch()
        assert state.link is DeviceLink.LIVE, (state, self.failures)
        return self

    def last_motion_s(self):
        return max((at_s for at_s, state in self.states if any(state.axes)), default=0.0)
