"""A whole session in virtual time: simulated Omni, the compiled tick, engine, simulated arm.

Only the driver's thread is left out, because it runs in real time.
"""

from __future__ import annotations

import numpy as np
import pytest

from cardan.drivers import registry
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.session import make_session
from cardan.types import DeviceLink, DeviceState
from cardan_omni.driver.limits import TickLimits
from cardan_omni.peer.library import available
from studies.haptics.loop import Bench
from tests.gateway.force.fakes import REST, FakeHaptic

pytestmark = [
    pytest.mark.skipif(not available(), reason="the simulated libHD was not compiled"),
    pytest.mark.matrix,
]

SECONDS = 5.4
PRESSED_S, OUT_S = 0.4, 5.2
LIMITS = TickLimits()
BACK_M, STROKE_M = -0.032, 0.064
"""Stroke over most of the Omni's nominal workspace, outside which the edge's force acts."""
SPHERE = {"shape": "sphere", "center_m": [0.3, 0.0, 0.4], "radius_m": 0.1, "stiffness_n_m": 100.0}
SURFACE = {
    "shape": "plane",
    "point_m": [0.4, 0.0, 0.0],
    "normal": [1.0, 0.0, 0.0],
    "stiffness_n_m": 1000.0,
}
TABLE = {
    "device": {"driver": "fake_haptic"},
    "robot": {
        "driver": "sim_arm",
        "robot": "ur5",
        "pacing": "virtual",
        "period_s": 0.004,
        "gravity_feedforward": True,
        "start": [-0.251, -1.712, 1.782, -1.641, -1.571, -0.251],
    },
    "arm": {"model": "ur5", "collisions": False},
    "mapping": {
        "mode": "position",
        "clutch": "button_2",
        "orientation": "fixed",
        "scale": [1.25, 1.25, 1.25, 1.0, 1.0, 1.0],
        "device_rpy_deg": [0.0, 0.0, 180.0],
    },
}


class VirtualOmni(FakeHaptic):
    """The simulated Omni and its tick, in the bench's time."""

    bench: Bench

    def state(self):
        snapshot = self.bench.tick.snapshot()
        return DeviceState(snapshot.stamp_s, DeviceLink.LIVE, REST, frozenset(), snapshot.pose)

    def render(self, command):
        self.bench.tick.command(command)

    def haptics(self):
        return self.bench.tick.snapshot()

    def enable(self):
        self.bench.tick.enable()

    def disable(self):
        self.bench.tick.disable()


def run(monkeypatch, each=lambda now_s, bench: None, until_s=SECONDS, **tables):
    """Clutch in, push the TCP 80 mm towards the robot within 1.2 s, stay, return, clutch out. Calls
    `each` in each cycle."""
    monkeypatch.setitem(registry.BUILT_IN, "fake_haptic", f"{__name__}:VirtualOmni")
    s = make_session(parse_config({**TABLE, **tables}))
    states = s.robot.cycles
    places, presses = [], [PRESSED_S, OUT_S]
    with Bench(LIMITS) as bench:
        device = s.device
        device.bench = bench
        bench.sim.hand((BACK_M, 0.0, 0.0))

        def cycles():
            for state in states():
                now_s = state.stamp_s
                on_way = np.clip(min(now_s - 1.6, 4.8 - now_s) / 1.2, 0.0, 1.0)
                bench.sim.hand((BACK_M + STROKE_M * on_way, 0.0, 0.0))
                if now_s > bench.now_s:
                    bench.run(now_s - bench.now_s, None)
                device.now_s = now_s
                each(now_s, bench)
                if presses and now_s >= presses[0]:
                    presses.pop(0)
                    device.press("button_2")
                if s.controller.reference.pose is not None:
                    places.append(s.controller.reference.pose.position)
                if now_s >= until_s:
                    s.stop("enough")
                yield state

        s.robot.cycles = cycles
        last = s.run()
        return last, bench.trace, places


@pytest.mark.parametrize(
    "tables",
    [
        {"fixtures": [SPHERE]},
        {"force": {"source": "contact", "contact": [SURFACE], "scale": 0.1}},
    ],
    ids=["sphere", "contact"],
)
def test_the_hand_feels_what_the_tcp_meets_and_gets_no_energy_of_it(monkeypatch, tables):
    last, trace, places = run(monkeypatch, **tables)
    assert last.arm.trips == 0
    assert last.tracking.path_m > 0.06
    sent = np.linalg.norm(trace.sent_n, axis=1)
    early, late = trace.times_s < PRESSED_S, trace.times_s > OUT_S + 0.02
    assert sent[early].max() == 0.0  # No force before the operator clutches in.
    assert sent[late].max() == 0.0  # No force 20 ms after clutching out.
    assert sent.max() > 1.0
    assert sent.max() <= LIMITS.clamp_n + 1e-9
    # The force pushes the hand back, away from the robot.
    assert trace.sent_n[np.argmax(sent), 0] < -0.95 * sent.max()
    assert np.abs(np.diff(trace.sent_n, axis=0)).max() < 0.5
    # The force holds the TCP back: in free space it would move 80 mm.
    nearest = min(place.x for place in places)
    assert 0.36 < nearest < 0.395
    # Energy of the whole push and return, from the simulation.
    assert trace.given_j[-1] < 0.005
    assert last.force.peak_n == pytest.approx(sent.max(), abs=0.1)
    assert last.force.energy_given_j == pytest.approx(trace.believed_j[-1], abs=1e-6)


def test_free_space_is_free(monkeypatch):
    far = {**SPHERE, "center_m": [-0.3, 0.0, 0.4]}
    _, trace, places = run(monkeypatch, fixtures=[far])
    assert np.linalg.norm(trace.sent_n, axis=1).max() < 0.15  # from the damping only
    assert min(place.x for place in places) == pytest.approx(0.36, abs=0.005)


CONTACT = {"force": {"source": "contact", "contact": [SURFACE], "scale": 0.1}}


def test_clutching_in_while_the_tool_presses_brings_the_force_in_by_a_ramp(monkeypatch):
    pressed = {**SURFACE, "point_m": [0.455, 0.0, 0.0]}  # 15 mm deep from the start: 1.5 N
    last, trace, _ = run(
        monkeypatch,
        until_s=1.5,
        force={"source": "contact", "contact": [pressed], "scale": 0.1},
    )
    sent = np.linalg.norm(trace.sent_n, axis=1)
    begun = trace.times_s[np.argmax(sent > 0.0)]
    assert PRESSED_S < begun < PRESSED_S + 0.1
    assert np.abs(np.diff(trace.sent_n, axis=0)).max() < 0.1
    assert sent[trace.times_s > 1.45].min() > 0.8
    assert (last.arm.trips, last.force.losses) == (0, 0)


def test_clutching_in_deep_in_a_fixture_ends_with_words(monkeypatch):
    deep = {**SPHERE, "center_m": [0.39, 0.0, 0.4]}
    last, trace, places = run(monkeypatch, until_s=1.55, fixtures=[deep])
    assert np.linalg.norm(trace.sent_n, axis=1).max() == 0.0
    assert "move out of the fixture, then clutch in" in last.force.lost_reason
    assert (last.arm.trips, last.force.losses) == (1, 1)
    assert places[-1] == places[-2]


@pytest.mark.parametrize(
    ("fault", "value", "words"),
    [
        ("warm-motors", 0.86, "spare the motors"),
        ("warm-motors", 0.95, "spare the motors"),
        ("warm-motors", 1.0, ""),
        ("slow-ticks", 200.0, "slow"),
        ("slow-ticks", 20.0, ""),
        ("overrun", 3.0, "slow"),
    ],
)
def test_the_arm_does_not_follow_a_hand_that_falls_in(monkeypatch, fault, value, words):
    """The hand pushes towards 80 mm beyond the TCP, and is held back by the contact."""
    at = {}

    def each(now_s, bench):
        if now_s >= 3.0 and "n" not in at:
            at["n"] = len(bench.trace.times_s)
            bench.sim.fault(fault, value)

    last, trace, places = run(monkeypatch, each, until_s=3.7, **CONTACT)
    sent = np.linalg.norm(trace.sent_n, axis=1)
    assert sent[at["n"] - 1] > 0.8
    assert last.arm.trips == 1
    assert words in last.force.lost_reason
    before, after = places[round(2.9 / 0.004)].x, min(place.x for place in places)
    assert before - after < 0.003  # It would be 15 mm at the end of the hand's motion.
    assert places[-1] == places[-40]
