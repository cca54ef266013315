"""Passivity of a remote force against a stiff wall, in virtual time."""

import math

import pytest

from cardan.gateway.force.passive import (
    BUDGET_J,
    FADE_S,
    HOLD_S,
    LONGEST_STEP_S,
    OLDEST_S,
    DevicePort,
    FarPort,
    share_left,
)
from cardan.types import ZERO3, Vector3
from tests.gateway.force.far_wall import STEP_S, Hand, into_the_wall, press

DELAYS_S = (0.0, 0.01, 0.05, 0.1, 0.2)
HANDS = {"held": Hand(0.2, 5.0, 200.0), "lightly": Hand()}
STALL = (5.0, 5.5)
ROUNDING_J = 1e-9


def network(delay_s, **more):
    """Network faults: jitter of half the delay, packets out of order, 5 % lost, and a silence of
    half a second."""
    return {
        "delay_s": delay_s,
        "jitter_s": 0.002 + 0.5 * delay_s,
        "loss": 0.05,
        "stalls": (STALL,),
        **more,
    }


def restless_m_s(rows, from_s):
    speeds = [row.speed_m_s for row in rows if row.now_s >= from_s]
    return math.sqrt(sum(each * each for each in speeds) / len(speeds))


@pytest.mark.parametrize("hand", HANDS.values(), ids=HANDS)
@pytest.mark.parametrize("delay_s", DELAYS_S)
def test_no_delay_jitter_loss_or_stall_gives_the_hand_energy(delay_s, hand):
    rows = press(into_the_wall, 8.0, hand=hand, **network(delay_s))
    assert max(row.given_j for row in rows) <= BUDGET_J + ROUNDING_J
    assert restless_m_s(rows, 7.0) < 0.005
    assert max(abs(row.place_m) for row in rows) < 0.03


@pytest.mark.parametrize("delay_s", DELAYS_S[1:])
def test_the_newest_force_as_it_arrives_throws_the_hand(delay_s):
    rows = press(into_the_wall, 8.0, passive=False, **network(delay_s))
    assert max(row.given_j for row in rows) > 50.0 * BUDGET_J
    assert restless_m_s(rows, 7.0) > 0.2


@pytest.mark.parametrize("seed", range(4))
def test_a_hand_that_goes_in_and_out_gets_back_no_more_than_it_put_in(seed):
    def in_and_out(now_s):
        return 0.008 * math.cos(2.0 * math.pi * (0.3 + 0.4 * seed) * now_s)

    rows = press(in_and_out, 10.0, hand=HANDS["held"], seed=seed, **network(0.1))
    assert max(row.given_j for row in rows) <= BUDGET_J + ROUNDING_J
    assert max(row.force_n for row in rows) > 0.3, "the contact is rendered"


def test_a_wall_is_felt_where_the_network_allows_it():
    rows = press(into_the_wall, 4.0, hand=HANDS["held"])
    force_n, place_m = rows[-1].force_n, rows[-1].place_m
    assert force_n / -place_m == pytest.approx(400.0, rel=0.05)


@pytest.mark.parametrize("delay_s", [0.0, 0.2])
def test_a_link_that_is_cut_lets_the_force_fade_in_bounded_time(delay_s):
    cut_s = 3.0
    rows = press(into_the_wall, 4.0, hand=HANDS["held"], delay_s=delay_s, cut_s=cut_s)
    assert any(row.force_n > 0.2 for row in rows if cut_s - 0.1 < row.now_s < cut_s)
    zero_s = cut_s + HOLD_S + FADE_S + 0.004 + STEP_S
    assert not any(row.force_n for row in rows if row.now_s > zero_s)


def test_a_hand_that_is_torn_out_is_not_thrown_after():
    """The stylus is pulled away, after which nothing resists the force."""

    def away(now_s):
        return into_the_wall(now_s) if now_s < 3.0 else 0.03

    rows = press(away, 5.0, **network(0.05))
    assert max(row.given_j for row in rows) <= BUDGET_J + ROUNDING_J


# -- each end -------------------------------------------------------------------------------------


def up(z):
    return Vector3(0.0, 0.0, z)


def test_surroundings_that_give_more_than_they_got_are_not_believed():
    far = FarPort()
    assert far.step(up(0.0), up(2.0)) == 0.0
    assert far.step(up(-0.002), up(2.0)) == pytest.approx(0.004)
    assert far.step(up(0.01), up(2.0)) == 0.0
    far.step(up(0.008), up(2.0))
    far.rest()
    assert far.step(up(-0.5), up(2.0)) == pytest.approx(0.004), "no force, no work"
    far.forget()
    assert far.step(up(-0.6), up(2.0)) == 0.0


def pushed(port, places):
    return [port.step(up(z), up(1.0), 0.0, 1.0, 0.004 * n) for n, z in enumerate(places)]


def test_what_the_wall_still_holds_is_not_given_back():
    into = [-0.0002 * number for number in range(100)]
    back = [into[-1] + 0.0004 * number for number in range(1, 40)]
    held, free = DevicePort(), DevicePort()
    for port in (held, free):
        pushed(port, into)
        assert port.put_in_j == pytest.approx(0.02, rel=0.2)
        port.step(up(into[-1]), up(1.0), 0.02, 1.0, 0.4)
    given = []
    for port, absorbed_j in ((held, 0.02), (free, 0.0)):
        before_j = port.put_in_j
        for number, z in enumerate(back):
            port.step(up(z), up(1.0), absorbed_j, 1.0, 0.404 + 0.004 * number)
        given.append(before_j - port.put_in_j)
    assert given[0] <= BUDGET_J
    assert given[1] > 0.01


def test_a_stall_of_the_hands_end_ends_the_force():
    port = DevicePort()
    assert pushed(port, [0.0] * 60)[-1].z > 0.5
    assert port.step(ZERO3, up(1.0), 0.0, 1.0, 60 * 0.004 + LONGEST_STEP_S) == ZERO3
    assert port.step(ZERO3, up(1.0), 0.0, 1.0, 61 * 0.004 + LONGEST_STEP_S).z < 0.1


@pytest.mark.parametrize(
    ("silent_s", "round_s", "left"),
    [
        (0.0, 0.0, 1.0),
        (HOLD_S, OLDEST_S, 1.0),
        (HOLD_S + 0.5 * FADE_S, 0.0, 0.5),
        (0.0, OLDEST_S + 0.5 * FADE_S, 0.5),
        (HOLD_S + FADE_S, 0.0, 0.0),
        (0.0, math.inf, 0.0),
    ],
)
def test_how_much_is_left_of_a_force(silent_s, round_s, left):
    assert share_left(silent_s, round_s) == pytest.approx(left)


@pytest.mark.parametrize(("toward_m", "gained"), [(-0.01, 0.0), (0.01, -1.0)])
def test_of_a_stall_the_hand_is_owed_nothing_and_has_what_it_was_given(toward_m, gained):
    """Motion during a gap may only reduce the energy budget, because the device may have stopped
    its force long before it moved."""
    port, now_s = DevicePort(), 0.0
    asked = Vector3(0.0, 0.0, 1.0)
    for _ in range(200):
        now_s += STEP_S
        force = port.step(ZERO3, asked, 0.0, 1.0, now_s)
    assert force.z > 0.9
    now_s += LONGEST_STEP_S + STEP_S
    assert port.step(Vector3(0.0, 0.0, toward_m), asked, 0.0, 1.0, now_s) == ZERO3
    assert port.put_in_j == pytest.approx(gained * force.z * abs(toward_m))


def test_what_the_hand_does_while_its_device_lets_no_force_out_is_no_work():
    port = DevicePort()
    for n, z in enumerate((0.0, 0.0, -0.001)):
        port.step(up(z), up(1.0), 0.0, 1.0, 0.004 * n)
    put_in_j = port.put_in_j
    port.rest()
    port.step(up(-0.05), up(1.0), 0.0, 1.0, 0.012)
    assert port.put_in_j == put_in_j
