"""The core with the simulated device in virtual time: every model, every fault."""

import pytest

from cardan.drivers.spacemouse import SpaceMouseCore, SpaceMouseOptions
from cardan.protocols.connexion.devices import MODELS, model_by_key
from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse
from cardan.sim_peers.spacemouse.faults import FAULTS
from cardan.types import DeviceLink

STEP_S = 0.002
PLAIN = SpaceMouseOptions(dead_zone=0.0)
DEFLECTION = (0.4, -0.2, 0.6, -0.1, 0.3, -0.5)
REST = (0.0,) * 6
# The simulated device does not support the raw frame of serial-order models.
USUAL_MODELS = [model for model in MODELS if not model.serial_axes]
MODELS_NOW = (
    *("spacenavigator", "spacepilot-pro", "spacemouse-enterprise", "spacemouse-wireless-bt"),
    *("spacemouse-module", "cadman"),
)
"""Models tested with every change; the matrix has the others."""


class Bench:
    """A simulated device wired to a core."""

    def __init__(self, model, faults=None, options=PLAIN, jitter_lsb=0):
        self.device = SimulatedSpaceMouse(model, faults=faults, jitter_lsb=jitter_lsb)
        self.core = SpaceMouseCore(options, model)
        self.core.on_opened(0.0, model)
        self.now_s = 0.0
        self.states = []

    def run(self, seconds, axes=None):
        """Hold the puck at `axes`; return the last state."""
        if axes is not None:
            self.device.set_axes(axes)
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            was_plugged = self.device.plugged
            self.now_s += STEP_S
            for report in self.device.reports(self.now_s):
                self.core.on_report(report, self.now_s)
            if was_plugged and not self.device.plugged:
                self.core.on_lost("unplugged", self.now_s)
            elif self.device.plugged and not was_plugged:
                self.core.on_opened(self.now_s, self.device.model)
            self.states.append(self.core.state(self.now_s))
        return self.states[-1]

    def touch(self):
        self.run(0.1, (0.0, 0.0, 0.3, 0.0, 0.0, 0.0))
        return self.run(0.3, REST)


@pytest.mark.matrix(*(model.key for model in USUAL_MODELS if model.key not in MODELS_NOW))
@pytest.mark.judged(device="SpaceMouse", transport="HID reports", by="simulated peer")
@pytest.mark.parametrize("model", USUAL_MODELS, ids=lambda m: m.key)
def test_every_model_is_followed(model):
    bench = Bench(model)
    assert bench.run(5.0).link is DeviceLink.NEEDS_NEUTRAL
    assert bench.touch().link is DeviceLink.LIVE
    state = bench.run(2.0, DEFLECTION)
    assert state.link is DeviceLink.LIVE
    assert state.axes == pytest.approx(DEFLECTION, abs=0.5 / 350 + 1e-9)
    state = bench.run(60.0, REST)
    assert (state.link, state.axes) == (DeviceLink.LIVE, REST)
    words = bench.core.diagnosis(bench.now_s)
    assert words == []


@pytest.mark.parametrize(
    "model", [model for model in USUAL_MODELS if model.buttons], ids=lambda m: m.key
)
def test_every_button_is_heard(model):
    bench = Bench(model)
    labels = list(model.buttons.values())
    for label in labels:
        bench.device.press(label)
        assert label in bench.run(0.05).buttons
        bench.device.release(label)
        assert not bench.run(0.05).buttons
    edges = [(event.button, event.pressed) for event in bench.core.events()]
    assert edges == [(label, pressed) for label in labels for pressed in (True, False)]
    assert set(labels) <= set(bench.core.labels)


def faulty(fault, value=None, model="spacenavigator", **settings):
    default = {switch.name: switch.default for switch in FAULTS}[fault]
    faults = {fault: default if value is None else value}
    return Bench(model_by_key(model), faults=faults, **settings)


@pytest.mark.parametrize("fault", ["short-report", "unknown-id", "padded-report", "duplicate-half",
                                   "late-half", "lost-half"])  # fmt: skip
def test_mangled_reports_are_noted_and_survived(fault):
    bench = faulty(fault)
    bench.touch()
    state = bench.run(3.0, DEFLECTION)
    assert state.link is DeviceLink.LIVE
    assert state.axes == pytest.approx(DEFLECTION, abs=0.002)
    assert bench.core.diagnosis(bench.now_s)
    assert bench.run(1.0, REST).axes == REST


def test_jitter_at_rest_stays_at_rest():
    bench = Bench(model_by_key("spacemouse-wireless"), options=SpaceMouseOptions(), jitter_lsb=3)
    bench.touch()
    axes = (0.0, 0.0, 0.02, 0.0, 0.0, 0.0)
    assert bench.run(10.0, axes).axes == REST
    assert bench.states[-1].link is DeviceLink.LIVE
