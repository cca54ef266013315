"""A simulated pad or keyboard wired to a driver's core, in virtual time."""

from cardan.drivers.evdev.nodes import EvdevDeviceInfo, EvdevState
from cardan.drivers.gamepad import GamepadCore, GamepadOptions
from cardan.drivers.keyboard import KeyboardCore, KeyboardOptions
from cardan.protocols.evdev.events import encode_events
from cardan.protocols.evdev.requests import EVIOCGKEY, decode_absinfo, decode_bits, eviocgabs
from cardan.sim_peers.evdev import MODELS, SimulatedInput

STEP_S = 0.004
REST = (0.0,) * 6
BY_KEY = {model.key: model for model in MODELS}


def describe(model):
    return EvdevDeviceInfo(
        model.name,
        model.id.vendor,
        model.id.product,
        frozenset(model.codes.values()),
        dict(model.axes),
        model.effects,
        bustype=model.id.bustype,
    )


class Bench:
    """Simulated device wired to a core; `mangle` maps a packet to those that arrive."""

    def __init__(
        self, model="xbox-360", options=None, faults=None, mangle=None, touched=True, **settings
    ):
        self.model = BY_KEY[model]
        self.device = SimulatedInput(self.model, faults=faults, **settings)
        if self.model.is_gamepad:
            self.core = GamepadCore(options or GamepadOptions(dead_zone=0.0))
        else:
            self.core = KeyboardCore(options or KeyboardOptions(ramp_s=0.0))
        self.mangle = mangle or (lambda packet: [packet])
        self.answers = True
        """True if the device answers queries of its state."""
        self.read = True
        """True if the reader runs."""
        self.now_s = 0.0
        self.states = []
        self._arrived = []
        self._plugged = True
        self.open()
        if touched:
            self.touch()

    def snapshot(self):
        keys = decode_bits(self.device.call(None, EVIOCGKEY, b"", self.now_s).argument)
        values = {
            code: decode_absinfo(
                self.device.call(None, eviocgabs(code), b"", self.now_s).argument
            ).value
            for code in self.model.axes
        }
        return EvdevState(keys, values)

    def open(self):
        self.core.on_opened(describe(self.model), self.snapshot(), self.now_s)

    def run(self, seconds, controls=None):
        """Hold the sticks and triggers at `controls`; return the last state."""
        if controls is not None:
            self.device.set_controls(controls)
        end_s = self.now_s + seconds - 1e-9
        while self.now_s < end_s:
            self.now_s += STEP_S
            was_plugged = self._plugged
            for frame in self.device.reports(self.now_s):
                self._arrived += self.mangle(encode_events(frame.stamped(0.0)))
            self._plugged = self.device.plugged
            if was_plugged and not self.device.plugged:
                self.core.on_lost("unplugged", self.now_s)
            elif self.device.plugged and not was_plugged:
                self.open()
            if self.read and self.device.plugged:
                for packet in self._arrived:
                    self.core.on_packet(packet, self.now_s)
                self._arrived.clear()
                self.core.on_checked(self.now_s)
                if self.core.needs_snapshot and self.answers:
                    self.core.on_snapshot(self.snapshot(), self.now_s)
            self.states.append(self.core.state(self.now_s))
        return self.states[-1]

    def touch(self):
        """Press and release a key: the first frame that the driver receives."""
        label = "start" if self.model.is_gamepad else "left-shift"
        self.press(label)
        state = self.release(label)
        self.core.events()
        return state

    def press(self, *labels):
        for label in labels:
            self.device.press(label)
        return self.run(0.02)

    def release(self, *labels):
        for label in labels:
            self.device.release(label)
        return self.run(0.02)
