"""The closed loop in virtual time: where the plain loop gives energy to the hand, ours stays
passive.

Energy is taken from the simulation. The bound is the budget of tick.h plus the energy that encoders
and motor converter hide from the tick's account, computed by `studies.haptics.stability` from the
true motion; the sum for hard accelerations is not included.
"""

from __future__ import annotations

import functools
import itertools
import random

import numpy as np
import pytest

from cardan.common.haptics import HapticCommand, Plane
from cardan.types import ZERO3, Vector3
from studies.haptics import theory
from studies.haptics.loop import MISPLACED_M, Bench
from studies.haptics.remote import Channel, Link, RemoteWall, Robot, Wall
from studies.haptics.stability import (
    HANDS,
    HELD,
    LIGHTLY,
    OURS,
    PLAIN,
    PUSHES,
    UNHELD,
    compare,
    hidden_j,
    judge,
    local,
    remote,
    summary,
    table,
)
from studies.haptics.zwidth import FRICTIONLESS

pytestmark = pytest.mark.matrix

UP = Vector3(0.0, 0.0, 1.0)
MOST_J = OURS.energy_budget_j + 0.0005
"""The bound holds however much the sensors hid."""


@functools.cache
def run(limits_are_ours, hand, stiffness_n_m, link):
    limits = OURS if limits_are_ours else PLAIN
    return judge(remote(limits, hand, stiffness_n_m, link), limits)


@pytest.mark.parametrize("push", PUSHES, ids=lambda push: f"{push.name}, {push.hand.name}")
def test_the_plain_loop_goes_unstable_and_ours_does_not(push):
    assert run(False, push.hand, *push.calm).stable
    assert run(True, push.hand, *push.calm).stable
    plain, ours = run(False, push.hand, *push.pushed), run(True, push.hand, *push.pushed)
    assert not plain.passive
    assert not plain.settled
    assert plain.given_j > 10.0 * ours.bound_j
    assert ours.stable
    assert ours.harder_j == 0.0


def test_the_tables():
    calm, pushed = (compare(HELD, 400.0, Link(d)) for d in (0.01, 0.05))
    lines = table([(PUSHES[1], calm, pushed)]).splitlines()
    assert [line.count("|") for line in lines] == [8] * 4
    assert "**" in lines[3]
    assert "**" not in lines[2]
    assert "2 points, plain unstable at 1; ours within its bound at 2" in summary(
        "delay", [calm, pushed]
    )


def test_an_unstable_loop_keeps_feeding_the_hand():
    trace = remote(PLAIN, LIGHTLY, 100.0, Link(0.05))
    thirds = np.interp((1.0, 2.0, 3.0), trace.times_s, trace.given_j)
    assert thirds[1] - thirds[0] > 0.1
    assert thirds[2] - thirds[1] > 0.1


@pytest.mark.parametrize("stiffness", [50.0, 400.0, 2000.0])
@pytest.mark.parametrize("delay_s", [0.0, 0.01, 0.05, 0.1])
@pytest.mark.parametrize("hand", HANDS, ids=lambda hand: hand.name)
def test_ours_keeps_its_bound_everywhere(hand, delay_s, stiffness):
    found = run(True, hand, stiffness, Link(delay_s))
    assert found.passive
    assert found.given_j <= MOST_J
    if hand is not UNHELD:
        assert found.settled


def test_ours_keeps_its_bound_whatever_the_channel_does():
    chance = random.Random(6)
    for _ in range(20):
        link = Link(
            chance.choice((0.0, chance.uniform(0.0, 0.1))),
            chance.uniform(0.0, 0.1),
            chance.uniform(0.0, 0.6),
            chance.choice((0.004, 0.008, 0.012, 0.018)),
        )
        hand, stiffness = chance.choice(HANDS), 10.0 ** chance.uniform(1.0, 4.0)
        found = run(True, hand, stiffness, link)
        assert found.passive, (hand.name, stiffness, link)
        assert found.given_j <= MOST_J


def test_a_wall_in_the_tick_itself():
    plain = judge(local(PLAIN, UNHELD, 5000.0), PLAIN)
    ours = judge(local(OURS, UNHELD, 5000.0), OURS)
    assert not plain.passive
    assert not plain.settled
    assert ours.stable


@pytest.mark.parametrize(
    ("limits", "hand", "link"), [(OURS, LIGHTLY, Link(0.05)), (PLAIN, UNHELD, Link())]
)
def test_the_tick_books_no_less_than_the_truth(limits, hand, link):
    trace = remote(limits, hand, 400.0, link)
    reported = trace.given_j - hidden_j(trace)
    # The tick learns of a motion one tick later.
    assert np.all(reported[:-1] <= trace.believed_j[1:] + 1e-9)


def test_a_position_is_a_tick_old_and_no_further_off_than_its_quantum():
    trace = remote(OURS, LIGHTLY, 400.0, Link(0.05))
    off_m = np.linalg.norm(trace.measured_m[1:] - trace.position_m[:-1], axis=1)
    assert off_m[1:].max() <= MISPLACED_M


def test_what_the_sensors_hide_stays_small_in_half_a_minute_of_swinging():
    """Rounding accumulates force by force, possibly without limit, but has no preferred sign."""
    trace = local(OURS, FRICTIONLESS, 2000.0, seconds=30.0)
    assert np.ptp(hidden_j(trace)) > 1e-4
    assert hidden_j(trace).max() < 5e-4
    assert judge(trace, OURS).passive


def test_a_position_that_comes_a_tick_late_is_no_loophole():
    """Without friction a stiff wall under a weight oscillates for ever if the work is computed with
    the wrong tick's force."""
    trace = local(OURS, FRICTIONLESS, 400.0, seconds=5.0)
    assert trace.given_j.max() <= MOST_J
    assert judge(trace, OURS).passive


@pytest.mark.parametrize(
    ("fault", "value"), [("jitter", 500.0), ("late-tick", 1.5), ("slow-ticks", 900.0)]
)
@pytest.mark.parametrize("hand", [LIGHTLY._replace(friction_n=0.0), FRICTIONLESS])
def test_uneven_ticks_are_no_loophole(hand, fault, value):
    """Exceeds the promise of tick.h, which assumes a steady period."""
    wall = Plane(ZERO3, UP, 1500.0)
    with Bench(OURS, hand.settings) as bench:
        bench.tick.enable()
        bench.sim.fault(fault, value)
        numbers = itertools.count(1)

        def each(now_s):
            bench.tick.command(HapticCommand(next(numbers), now_s, True, fixtures=(wall,)))

        bench.run(0.3, each)
        bench.sim.push(Vector3(0.0, 0.0, hand.push_n))
        bench.run(3.0, each)
        trace = bench.trace
    assert np.linalg.norm(trace.sent_n, axis=1).max() > 0.5
    assert trace.given_j.max() <= MOST_J


def test_a_soft_wall_is_rendered_and_not_spared_away():
    trace = remote(OURS, HELD, 100.0, Link(0.005))
    depth_m = -trace.position_m[-1, 2]
    assert depth_m > 0.002
    assert trace.sent_n[-1, 2] == pytest.approx(100.0 * depth_m, rel=0.05)


# -- theory ----------------------------------------------------------------------------------------


def test_the_rules_of_thumb():
    assert theory.passive_stiffness(0.1, 0.0, 1e-3) == pytest.approx(200.0)
    assert theory.passive_stiffness(0.1, 0.2, 1e-3) == 0.0
    assert theory.stable_stiffness_rule(5.0, 1e-3, 1e-3) == pytest.approx(3333.3, rel=1e-3)
    assert theory.stable_stiffness_rule(5.0, 4e-3, 50e-3) == pytest.approx(96.2, rel=1e-3)
    assert theory.passive_by_friction(0.26, 5e-5) == pytest.approx(10400.0)


@pytest.mark.parametrize("samples", [0, 1, 5, 12])
def test_the_exact_limit_is_that_of_a_simulated_loop(samples):
    held, period_s = theory.Held(0.25, 5.0, 200.0), 0.004
    limit = theory.stable_stiffness(held, period_s, samples)

    def amplitude_after_4_s(stiffness):
        x, v, old = 1e-3, 0.0, [1e-3] * (samples + 1)
        steps, peak = 40, 0.0
        for tick in range(1000):
            old = [x, *old[:-1]]
            for _ in range(steps):
                dt_s = period_s / steps
                v += dt_s * (-5.0 * v - 200.0 * x - stiffness * old[samples]) / held.mass_kg
                x += dt_s * v
            if tick >= 900:
                peak = max(peak, abs(x))
        return peak

    assert amplitude_after_4_s(0.9 * limit) < 1e-3
    assert amplitude_after_4_s(1.1 * limit) > 1e-3


def test_encoders_misplace_the_tip_by_about_their_quantum():
    assert 5.0e-5 < MISPLACED_M < 6.0e-5


# -- the channel and the robot ---------------------------------------------------------------------


def test_a_channel_is_late_and_keeps_the_order_of_arrival():
    channel = Channel(Link(0.01), 1)
    channel.send("a", 0.0)
    channel.send("b", 0.004)
    assert channel.receive(0.009) == []
    assert channel.receive(0.010) == ["a"]
    assert channel.receive(1.0) == ["b"]


def test_jitter_reorders_and_loss_loses():
    channel = Channel(Link(0.0, jitter_s=0.05, loss=0.25), 3)
    for number in range(1000):
        channel.send(number, 0.004 * number)
    arrived = channel.receive(100.0)
    assert 700 < len(arrived) < 800
    assert arrived != sorted(arrived)


def test_the_robot_follows_behind_its_lag_and_its_limit():
    robot = Robot(Wall(ZERO3, UP, 1000.0), 0.01, 0.5, Vector3(0.0, 0.0, 0.1))
    robot.step(ZERO3, 0.01)
    assert robot.position.z == pytest.approx(0.095)
    for _ in range(100):
        force = robot.step(Vector3(0.0, 0.0, -0.002), 0.01)
    assert robot.position.z == pytest.approx(-0.002)
    assert force == pytest.approx((0.0, 0.0, 2.0))


def test_an_overtaken_force_is_dropped_and_the_stamp_is_that_of_arrival():
    link = Link(0.02, jitter_s=0.03)
    far = RemoteWall(Wall(ZERO3, UP, 100.0), link, link, start=Vector3(0.0, 0.0, 0.01))
    stamps, forces = [], []
    for count in range(200):
        now_s = 0.004 * count
        measured = far.cycle(Vector3(0.0, 0.0, -1e-4 * count), now_s)
        if measured is not None:
            assert measured.stamp_s <= now_s
            stamps.append(measured.stamp_s)
            forces.append(measured.force.z)
    assert stamps == sorted(stamps)
    assert forces == sorted(forces)
