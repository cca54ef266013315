"""A JR3 between flange and pen as the force source of an Omni's session.

In virtual time: the simulated board, the driver's core, the session, the compiled tick. One test
runs in real time: the driver itself, on a bus.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

import jr3_bench
from cardan.drivers import registry
from cardan.drivers.base import OperatorDevice
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.session import make_session
from cardan.spatial import from_euler_zyx
from cardan.types import DeviceCapabilities
from cardan_jr3.driver import Jr3Options
from cardan_jr3.peer import Jr3Peer, Jr3PeerOptions
from cardan_omni.driver.limits import TickLimits
from cardan_omni.peer.library import available
from studies.haptics.loop import Bench
from tests.gateway.force.fakes import PERIOD_S, robot_state
from tests.gateway.force.test_session import (  # noqa: F401
    ScriptedRobot,
    drivers,
    forces,
    session as fake_session,
)
from tests.plugin_benches import PLUGINS as PLUGINS  # Makes the Omni's tests importable.
from tests.serving import in_a_thread

pytestmark = pytest.mark.matrix

PEN_DOWN = from_euler_zyx(3.141592653589793, 0.0, 0.0)
"""Orientation of the tool with its pen pointing down: its z axis is the base's -z."""
BOARD_N = 10.0
"""Force of the board on the pen: upwards, which is -z of the tool."""
SCALE = 0.1
LOST_S = 8.0


class VirtualJr3(OperatorDevice):
    """The JR3's driver without its thread and its bus."""

    Options = Jr3Options
    capabilities = DeviceCapabilities(False, (), frozenset(), False)

    def __init__(self, options=None):
        super().__init__(options)
        self.bench = jr3_bench.Bench(options)

    def open(self):
        self.bench.open()

    def close(self):
        pass

    def diagnosis(self):
        return tuple(self.bench.core.diagnosis(self.bench.now_s))

    def button_events(self):
        return ()

    def state(self):
        return self.bench.core.state(self.bench.now_s)


class PenDown(ScriptedRobot):
    """Its time starts with the sensor's, and its pen points down."""

    def cycles(self):
        for k in range(self.options.cycles):
            now_s = k * PERIOD_S
            fields = self.script(k, now_s, self.place)
            yield robot_state(now_s, self.place, turn=PEN_DOWN, **fields)


@pytest.mark.skipif(not available(), reason="the simulated libHD was not compiled")
def test_a_pen_that_is_pressed_down_pushes_the_hand_up(monkeypatch):
    for name, target in (
        ("fake_haptic", "test_omni_session:VirtualOmni"),
        ("virtual_jr3", f"{__name__}:VirtualJr3"),
        ("scripted", f"{__name__}:PenDown"),
    ):
        monkeypatch.setitem(registry.BUILT_IN, name, target)
    config = parse_config(
        {
            "device": {"driver": "fake_haptic"},
            "robot": {"driver": "scripted", "cycles": round(9.0 / PERIOD_S)},
            "mapping": {"mode": "position", "clutch": "button_2", "orientation": "fixed"},
            "force": {
                "source": "sensor",
                "scale": SCALE,
                "sensor": {"driver": "virtual_jr3", "cutoff_hz": 50.0, "period_s": 0.002},
            },
        }
    )
    s = make_session(config)
    hand, jr3 = s.device, forces(s).measured.source.device.bench
    presses = [3.0]
    with Bench(TickLimits()) as omni:
        hand.bench = omni
        omni.sim.hand((0.0, 0.0, 0.0))

        def script(k, now_s, place):
            while jr3.now_s < now_s - 1e-9:
                jr3.step()
            if now_s > omni.now_s:
                omni.run(now_s - omni.now_s, None)
            hand.now_s = now_s
            if presses and now_s >= presses[0]:
                presses.pop()
                hand.press("button_2")
            if 4.5 < now_s < LOST_S:
                pressed_n = BOARD_N * min(1.0, (now_s - 4.5) / 0.5)
                jr3.board.set_wrench((0.0, 0.0, -pressed_n, 0.0, 0.0, 0.0))
            elif now_s >= LOST_S:
                jr3.mangle = lambda frame: None
            return {}

        s.robot.script = script
        last = s.run()
        trace = omni.trace
    sent = trace.sent_n
    free = (trace.times_s > 3.0) & (trace.times_s < 4.4)
    pressed = (trace.times_s > 6.5) & (trace.times_s < LOST_S)
    assert np.abs(sent[free]).max() < 0.1
    assert sent[pressed, 2].mean() == pytest.approx(SCALE * BOARD_N, abs=0.1)
    assert np.abs(sent[pressed, :2]).max() < 0.1
    assert (last.arm.trips, last.force.losses) == (1, 1)
    assert "the measured force is lost" in last.force.lost_reason
    out = trace.times_s > LOST_S + 0.1 + 0.1 + 0.05  # max_age_s, SOURCE_LOST_S, release
    assert np.linalg.norm(sent[out], axis=1).max() == 0.0


def test_the_driver_on_a_bus_is_felt_and_missed():
    """Real time: the driver and the simulated sensor on a python-can bus."""
    pytest.importorskip("can", reason='python-can is not installed: pip install "cardan[can]"')
    peer = Jr3Peer(
        Jr3PeerOptions(interface="virtual", channel="jr3-force", script="rest", boot_s=0.0)
    )
    sensor = {"driver": "jr3_can", "interface": "virtual", "channel": "jr3-force"}
    sensor |= {"cutoff_hz": 50.0, "period_s": 0.005}
    s = fake_session(force={"source": "sensor", "scale": SCALE, "sensor": sensor})
    hand, felt = s.device, []

    def load(what):
        peer.motion.advance = lambda now_s, board: what(board)

    def cycles():
        stage = 0
        while True:
            time.sleep(PERIOD_S)
            hand.now_s = time.monotonic()
            engaged = bool(hand.commands) and hand.commands[-1].engaged
            if engaged and (measured := hand.commands[-1].measured) is not None:
                felt.append(measured.force.z)
            if stage == 0 and forces(s).measured.conditioner.tare.taken:
                hand.press("button_2")
                load(lambda board: board.set_wrench((0.0, 0.0, -BOARD_N, 0.0, 0.0, 0.0)))
                stage = 1
            elif stage == 1 and felt and felt[-1] > 0.8 * SCALE * BOARD_N:
                load(lambda board: board.hang())
                stage = 2
            elif stage == 2 and not engaged:
                s.stop("seen")
            yield robot_state(hand.now_s, s.robot.place, turn=PEN_DOWN)

    s.robot.cycles = cycles
    with in_a_thread(peer):
        last = s.run(seconds=15.0)
    assert last.ending == "seen", (last.arm.message, last.diagnosis)
    assert max(felt) == pytest.approx(SCALE * BOARD_N, abs=0.2)
    assert min(felt) > -0.1
    assert (last.arm.trips, last.force.losses) == (1, 1)
    assert "the measured force is lost" in last.force.lost_reason
