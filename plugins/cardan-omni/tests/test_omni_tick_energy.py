"""Limit of the energy that an engagement may give to the hand, in virtual time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from cardan.common.haptics import (
    Fixture,
    MeasuredForce,
    WorldMap,
)
from cardan.types import ZERO3, Vector3
from cardan_omni.driver.limits import TickLimits
from omni_tick_bench import (
    ABOVE,
    BELOW,
    FIXTURES,
    FLOOR,
    PERIOD_S,
    VECTORS,
    Bench,
    size,
)
from tests.examples import examples

pytestmark = pytest.mark.matrix


class Ledger:
    """Energy given to a hand, from sent forces and stylus positions, and its bound. `given_j`:
    positions measured at once; `given_late_j`: positions a tick old."""

    def __init__(self, limits: TickLimits) -> None:
        fall = limits.slew_fall_n_s * PERIOD_S
        self.factor = limits.clamp_n * (math.ceil(limits.clamp_n / fall - 1e-9) + 3) / 2
        self.limits = limits
        self.given_j = self.given_late_j = self.worst_j = self.excess_m = 0.0
        self.force = self.force_before = self.moved = np.zeros(3)
        self.at: Any = None

    def step(self, position: Any, force: Any) -> None:
        if self.at is not None:
            moved = position - self.at
            now_j, late_j = float(self.force @ moved), float(self.force_before @ moved)
            self.given_j += now_j
            self.given_late_j += late_j
            self.worst_j += max(now_j, late_j)
            self.excess_m += max(
                0.0, float(np.linalg.norm(moved - self.moved)) - self.limits.prediction_error_m
            )
            self.moved = moved
        self.at, self.force_before, self.force = position, self.force, force

    @property
    def bound_j(self) -> float:
        return self.limits.energy_budget_j + self.factor * self.excess_m

    @property
    def balanced(self) -> bool:
        return max(self.given_j, self.given_late_j) <= self.bound_j + 1e-9


class Hand:
    """A mass with a damper and optionally a spring, moved by the force."""

    def __init__(self, mass_kg: float, damping: float, stiffness: float, at: Any) -> None:
        self.mass_kg, self.damping, self.stiffness = mass_kg, damping, stiffness
        self.target = np.array(at, dtype=float)
        self.position, self.velocity = self.target.copy(), np.zeros(3)

    def move(self, force: Any) -> Any:
        for _ in range(4):
            total = (
                force
                - self.damping * self.velocity
                + self.stiffness * (self.target - self.position)
            )
            self.velocity = self.velocity + total * (PERIOD_S / 4 / self.mass_kg)
            self.position = self.position + self.velocity * (PERIOD_S / 4)
        return self.position


HANDS = st.tuples(st.floats(0.045, 0.5), st.floats(0.05, 8.0), st.floats(0.0, 500.0))


def live(
    hand: Hand,
    scene: Callable[[int], dict[str, Any]],
    ticks: int,
    *,
    quantum_m: float = 0.0,
    **limits: Any,
) -> tuple[Bench, Ledger]:
    """Engage in free space, then let the hand move under a sequence of commands; return the energy
    account."""
    bench = Bench(engage_ramp_s=0.0, velocity_gate_m_s=1e9, oscillation_reversals=32, **limits)
    bench.tick.enable()
    ledger = Ledger(bench.limits)

    def read() -> Any:
        at = hand.position
        return np.round(at / quantum_m) * quantum_m if quantum_m else at.copy()

    bench.send()
    for _ in range(8):
        at = read()
        ledger.step(at, np.array(bench.step(position=Vector3(*at))))
    for k in range(ticks):
        change = scene(k)
        if change:
            bench.send(**change)
        hand.move(ledger.force)
        at = read()
        force = np.array(bench.step(position=Vector3(*at)))
        ledger.step(at, force)
        assert ledger.balanced, k
        assert np.linalg.norm(force) <= bench.limits.clamp_n
    return bench, ledger


@settings(max_examples=examples(25))
@given(st.lists(FIXTURES, min_size=1, max_size=4), HANDS, VECTORS)
def test_energy_is_bounded_in_any_scene(
    fixtures: list[Fixture], hand: tuple[float, ...], at: Vector3
) -> None:
    live(Hand(*hand, at), lambda k: {"fixtures": tuple(fixtures)} if k == 0 else {}, 400)


@settings(max_examples=examples(25))
@given(
    FIXTURES,
    HANDS,
    st.floats(0.5, 30.0),
    st.floats(0.0, 0.04),
    st.integers(1, 50),
    st.floats(0.0, 0.005),
)
def test_energy_is_bounded_when_fixtures_move(
    fixture: Fixture,
    hand: tuple[float, ...],
    frequency_hz: float,
    amplitude_m: float,
    every: int,
    budget_j: float,
) -> None:
    """The world frame oscillates, sampled every few ticks."""

    def scene(k: int) -> dict[str, Any]:
        if k % every:
            return {}
        shift = amplitude_m * math.sin(2 * math.pi * frequency_hz * k * PERIOD_S)
        return {"fixtures": (fixture,), "world": WorldMap(offset=Vector3(shift, 0.0, shift))}

    live(Hand(*hand, ZERO3), scene, 400, energy_budget_j=budget_j)


@settings(max_examples=examples(25))
@given(
    HANDS,
    st.floats(10.0, 3000.0),
    st.integers(0, 100),
    st.integers(1, 40),
    st.booleans(),
    st.floats(0.3, 3.0),
)
def test_energy_is_bounded_behind_a_delay(
    hand: tuple[float, ...],
    stiffness: float,
    delay: int,
    every: int,
    quantized: bool,
    push_n: float,
) -> None:
    """A remote wall, rendered as a delayed and held force: unstable without the control law."""
    body = Hand(*hand, ZERO3)
    past: list[float] = []

    def scene(k: int) -> dict[str, Any]:
        past.append(float(body.position[2]))
        body.velocity[2] -= push_n * PERIOD_S / body.mass_kg * (k < 200)
        late = past[max(0, k - delay)]
        if k % every:
            return {}
        force = Vector3(0.0, 0.0, max(0.0, -stiffness * late))
        return {"measured": MeasuredForce(force, 100.0 + (9 + k) * PERIOD_S)}

    live(body, scene, 500, quantum_m=6e-5 if quantized else 0.0)


@settings(max_examples=examples(25))
@given(
    st.integers(0, 2**32 - 1),
    HANDS,
    st.lists(FIXTURES, min_size=1, max_size=3),
)
def test_energy_is_bounded_through_interruptions(
    seed: int, hand: tuple[float, ...], fixtures: list[Fixture]
) -> None:
    """Silence, late ticks, the inkwell and intermittent force: one engagement, one bound."""
    random = np.random.default_rng(seed)
    bench = Bench(engage_ramp_s=0.0, velocity_gate_m_s=1e9, oscillation_reversals=32)
    bench.tick.enable()
    bench.send()
    body, ledger = Hand(*hand, ZERO3), Ledger(bench.limits)
    silent = docked = 0
    for _ in range(600):
        if random.random() < 0.01:
            force = Vector3(*random.normal(0.0, 1.0, 3))
            bench.send(fixtures=tuple(fixtures) if random.random() < 0.5 else (), force=force)
        if random.random() < 0.01:
            bench.send(fixtures=(), force=ZERO3)
        silent = int(random.integers(1, 60)) if random.random() < 0.01 else max(0, silent - 1)
        docked = int(random.integers(1, 20)) if random.random() < 0.01 else max(0, docked - 1)
        at = body.move(ledger.force).copy()
        force = bench.step(silent=silent > 0, position=Vector3(*at), inkwell=docked > 0)
        ledger.step(at, np.array(force))
        assert ledger.balanced


def test_every_engagement_has_a_budget_of_its_own() -> None:
    bench = Bench(engage_ramp_s=0.0)
    bench.tick.enable()
    for _ in range(3):
        bench.send(force=ZERO3, engaged=True)
        bench.run(0.02)
        before = bench.state
        assert before.energy_j == pytest.approx(0.0, abs=1e-6)
        bench.send(force=Vector3(0.5, 0.0, 0.0))
        start = bench.sample.position
        bench.glide(start._replace(x=start.x + 0.02), 0.5)
        after = bench.state
        assert 0.003 < after.delivered_j - before.delivered_j <= 0.005
        bench.send(engaged=False)
        bench.run(0.02)


def test_a_plain_loop_would_have_given_energy() -> None:
    """With the same delayed wall and the controller off, the energy exceeds the bound."""

    def given(passivity: bool) -> float:
        body, past = Hand(0.1, 0.1, 0.0, ZERO3), []
        bench = Bench(
            engage_ramp_s=0.0, velocity_gate_m_s=1e9, oscillation_reversals=32, passivity=passivity
        )
        bench.tick.enable()
        bench.send()
        bench.run(0.01)
        ledger = Ledger(bench.limits)
        for k in range(1000):
            past.append(float(body.position[2]))
            bench.send(force=Vector3(0.0, 0.0, -500.0 * past[max(0, k - 20)]))
            body.velocity[2] += 0.01 * (k == 0)
            at = body.move(ledger.force).copy()
            ledger.step(at, np.array(bench.step(position=Vector3(*at))))
        state = bench.state
        assert state.delivered_j == pytest.approx(ledger.worst_j, abs=1e-9)
        return ledger.given_j

    assert given(False) > 0.05
    assert given(True) <= 0.005


def test_a_still_hand_feels_all_of_a_wall() -> None:
    """The passivity controller takes nothing from a wall that is pressed and released by a normal
    hand."""
    bench = Bench(engage_ramp_s=0.1)
    bench.press()
    for _ in range(5):
        bench.glide(ABOVE, 0.15)
        force = bench.glide(BELOW, 0.15)
        assert force.z == pytest.approx(1.5, abs=0.1)
        state = bench.state
        assert state.passivity_damping_n_s_m == 0.0
        assert state.energy_j >= 0.0


def test_an_empty_tank_damps_first() -> None:
    """A force pushes the hand away: the observer sees it, damping is added, then the force ends."""
    bench = Bench(engage_ramp_s=0.0)
    bench.engage()
    bench.send(force=Vector3(1.0, 0.0, 0.0))
    alphas, position = [], 0.0
    for k in range(200):
        position += min(k, 100) * 1e-6
        bench.step(position=Vector3(position, 0.0, 0.0))
        alphas.append(bench.state.passivity_damping_n_s_m)
    state = bench.state
    assert max(alphas) == pytest.approx(4.0)
    assert state.reason == "limited to stay passive"
    assert size(state.force) < 0.6
    assert state.delivered_j <= 0.005
    assert state.energy_j >= -0.005


def test_the_observer_counts_what_is_sent() -> None:
    bench = Bench(passivity=False, engage_ramp_s=0.0)
    bench.engage(fixtures=(FLOOR,))
    ledger = Ledger(bench.limits)
    for k in range(1000):
        at = np.array([0.0, 0.0, 0.004 * math.sin(0.01 * k)])
        ledger.step(at, np.array(bench.step(position=Vector3(*at))))
    assert bench.state.delivered_j == pytest.approx(ledger.worst_j, abs=1e-12)
