"""Common time of two clocks, in virtual time."""

import random

import pytest

from cardan.drivers.missed_cycles import PAUSE_S, SLACK_S, AgreedTime

PERIOD_S = 0.002


def heard(arrivals, clock=lambda t: 7.0 + t, period_s=PERIOD_S, simulated=False):
    """Feed states with these send and arrival times; return the clock, and the faults that it
    reported."""
    agreed, faults = AgreedTime(period_s, simulated=simulated), []
    for sent_s, came_s in arrivals:
        agreed.passed(clock(sent_s), came_s)
        if agreed.fault and agreed.fault not in faults:
            faults.append(agreed.fault)
    return agreed, faults


def sent(seconds, late=lambda t: 0.0):
    """Yield send and arrival times of states with given delays; no state overtakes another."""
    came_s = 0.0
    for n in range(round(seconds / PERIOD_S)):
        came_s = max(came_s, n * PERIOD_S + late(n * PERIOD_S))
        yield n * PERIOD_S, came_s


def between(low_s, high_s):
    """Delay of states that are not read between two times."""
    return lambda t: high_s - t if low_s < t < high_s else 0.0


def jittering(seed, most_s):
    draw = random.Random(seed)
    return lambda t: draw.expovariate(1.0 / (0.2 * most_s)) % most_s


DELAYS = {
    "none": lambda t: 0.0,
    "jitter of a network": jittering(1, 0.008),
    "jitter of a radio link": jittering(2, 0.04),
    "this computer is stopped for 0.1 s": between(1.0, 1.1),
    "this computer is stopped for 0.3 s": between(1.0, 1.3),
    "this computer is stopped for 1 s": between(1.0, 2.0),
    "the first states were kept back": between(-1.0, 0.3),
    "stopped for 50 ms again and again": lambda t: max(0.05 - t % 0.1, 0.0),
}


@pytest.mark.parametrize("drift", [1.0, 1.0001, 0.9999, 1.01])
@pytest.mark.parametrize("late", DELAYS.values(), ids=DELAYS)
def test_delays_are_no_fault_and_lose_little(late, drift):
    agreed, faults = heard(sent(6.0, late), lambda t: 7.0 + drift * t)
    assert faults == []
    assert 6.0 - 1.0 - 2 * PAUSE_S <= agreed.time_s <= 6.0 + SLACK_S


def test_lost_states_are_no_fault():
    draw = random.Random(3)
    agreed, faults = heard([each for each in sent(6.0) if draw.random() < 0.7])
    assert faults == []
    assert agreed.time_s == pytest.approx(6.0, abs=0.02)


def test_a_simulated_controller_that_is_stopped_and_whose_clock_loses_the_time_is_no_fault():
    arrivals = [
        (t, t + (0.7 if t >= 1.0 else 0.0) + (0.4 if t >= 3.0 else 0.0)) for t, _ in sent(6)
    ]
    agreed, faults = heard(arrivals)
    assert faults == []
    assert agreed.time_s == pytest.approx(6.0, abs=0.01)


LIES = {
    "jumped ahead by 0.14 s": (lambda t: t + 0.14 * (t > 1.2), 0.005),
    "jumped ahead by 1 s": (lambda t: t + 1.0 * (t > 1.2), 0.005),
    "went back by 0.138 s": (lambda t: t - 0.14 * (t > 1.2), 0.005),
    "stands still": (lambda t: min(t, 1.2), PAUSE_S + 0.005),
    "1.6 times": (lambda t: max(t, 1.2 + 1.6 * (t - 1.2)), 0.51),
    "4 times": (lambda t: max(t, 1.2 + 4.0 * (t - 1.2)), 0.51),
    "1.05 times": (lambda t: max(t, 1.2 + 1.05 * (t - 1.2)), 1.5),
    "0.5 times": (lambda t: min(t, 1.2 + 0.5 * (t - 1.2)), 1.5),
    "0.95 times": (lambda t: min(t, 1.2 + 0.95 * (t - 1.2)), 1.5),
}


@pytest.mark.parametrize(
    ("late", "lost_s"),
    [(DELAYS["none"], 0.0), (DELAYS["jitter of a network"], 0.0), (DELAYS["none"], 0.06)],
)
@pytest.mark.parametrize(("words", "lie"), LIES.items(), ids=LIES)
def test_a_wrong_clock_is_said_and_adds_no_time(words, lie, late, lost_s):
    """Also where states are lost for `lost_s`, again and again."""
    clock, within_s = lie
    agreed, found_s, before_s = AgreedTime(PERIOD_S), None, None
    for sent_s, came_s in sent(6.0, late):
        if (sent_s + 0.1) % 0.3 < lost_s:
            continue
        agreed.passed(clock(sent_s), came_s)
        if agreed.fault and found_s is None:
            found_s, text = came_s, agreed.fault
        if sent_s <= 1.2:
            assert agreed.fault == ""
            before_s = came_s - agreed.time_s
        assert agreed.time_s <= came_s + SLACK_S + 1e-9
    assert before_s < 0.01
    assert found_s - 1.2 <= within_s + 0.01 + lost_s
    if "times" not in words and late is DELAYS["none"]:
        assert words in text
    assert "clock" in text


def test_a_clock_that_is_right_again_is_no_fault():
    agreed, faults = heard(sent(6.0), lambda t: t + 1.0 * (t > 1.2))
    assert len(faults) == 1
    assert agreed.fault == ""


@pytest.mark.parametrize("period_s", [0.1, 0.15, 0.3])
@pytest.mark.parametrize(
    ("words", "clock"),
    [
        ("jumped ahead by", lambda t: t + 0.14 * (t > 5.0)),
        ("went back by", lambda t: t - 0.5 * (t > 5.0)),
        ("stands still", lambda t: min(t, 5.0)),
        ("1.05 times", lambda t: max(t, 5.0 + 1.05 * (t - 5.0))),
        ("0.5 times", lambda t: min(t, 5.0 + 0.5 * (t - 5.0))),
        ("0.01 times", lambda t: min(t, 5.0 + 0.01 * (t - 5.0))),
        ("4 times", lambda t: max(t, 5.0 + 4.0 * (t - 5.0))),
        ("", lambda t: t),
        ("", lambda t: 1.01 * t),
    ],
)
def test_clocks_of_slow_streams_are_compared_too(words, clock, period_s):
    draw = random.Random(5)
    arrivals = [(n * period_s, n * period_s + draw.uniform(0.0, 0.004)) for n in range(150)]
    agreed, faults = heard([each for each in arrivals if each[0] <= 5.0], clock, period_s)
    assert faults == []
    agreed, faults = heard(arrivals, clock, period_s)
    assert agreed.time_s <= arrivals[-1][1] + SLACK_S
    assert bool(faults) == bool(words)
    assert words in "".join(faults[:1]) or words.endswith("times")


@pytest.mark.parametrize("factor", [0.3, 0.9, 1.5, 4.0])
def test_simulated_time_may_pass_at_its_own_speed_and_makes_nothing_faster(factor):
    agreed, faults = heard(sent(6.0), lambda t: factor * t)
    assert "clock runs" in faults[0]
    agreed, faults = heard(sent(6.0), lambda t: factor * t, simulated=True)
    assert faults == []
    assert agreed.time_s == pytest.approx(6.0 * min(factor, 1.0), abs=0.01)
    slow = [(0.1 * n, 0.1 * n) for n in range(60)]
    assert heard(slow, lambda t: factor * t, 0.1, simulated=True)[1] == []
    for clock in (lambda t: factor * t + (t > 3.0), lambda t: factor * min(t, 3.0)):
        assert heard(sent(6.0), clock, simulated=True)[1] != []


def test_a_clock_that_is_no_simulations_is_reported_the_option_for_those():
    agreed = AgreedTime(PERIOD_S, option="simulated_time")
    for sent_s, came_s in sent(3.0):
        agreed.passed(0.5 * sent_s, came_s)
    assert "simulated_time = true" in agreed.fault


def test_steps_never_exceed_this_computers_time_by_more_than_the_slack():
    draw = random.Random(4)
    agreed = AgreedTime(PERIOD_S)
    agreed_s = 0.0
    for n in range(20000):
        came_s = n * PERIOD_S
        step_s = agreed.passed(n * PERIOD_S + draw.uniform(-0.02, 0.02), came_s)
        agreed_s += step_s
        assert step_s <= PERIOD_S + SLACK_S + 1e-12
        assert agreed_s <= came_s + SLACK_S + 1e-12
