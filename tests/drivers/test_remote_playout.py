"""Playout of a remote device's motion with its original spacing, after network jitter."""

import itertools
import math
import random
from types import SimpleNamespace
from typing import NamedTuple

import pytest

from cardan.drivers.remote import Remote, RemoteOptions
from cardan.drivers.remote.playout import MotionSample, Playout
from cardan.drivers.remote.shared import CLAIM_PERIOD_S
from cardan.errors import OptionError
from cardan.types import IDENTITY, NEUTRAL, Axes, DeviceLink, Pose, Vector3
from tests.drivers.remote_bench import STEP_S, Bench, Link, Way

PERIOD_S = 0.008
"""Time between reports of a SpaceMouse."""
FINE_S = 0.0005
"""Step of the virtual time in which a network's states are played."""
OFFSET_S = 1000.0
MAX_AGE_S = 0.3


class Network(NamedTuple):
    """Network, and the playout options to be tested on it."""

    link: Link
    playout_s: float
    stall_s: float = 0.0
    """Length of a stall, after which everything queued arrives."""
    stalls_every_s: float = math.inf
    """Period of the stalls."""
    drift: float = 1e-4


WIFI = Network(Link(0.0, 0.013, loss=0.01), 0.03)  # 5 ± 8 ms, but at least 0
LTE = Network(Link(0.025, 0.04, loss=0.01), 0.06)
NETWORKS = {
    "wifi": WIFI,
    "lte": LTE,
    "bursts": WIFI._replace(playout_s=0.1, stall_s=0.08, stalls_every_s=1.0),
    "stalls": LTE._replace(stall_s=0.5, stalls_every_s=5.0),
    "twice": WIFI._replace(link=WIFI.link._replace(twice=0.2)),
    "reordered": WIFI._replace(link=WIFI.link._replace(in_order=False)),
}


class Played(NamedTuple):
    """Timing results without the first second, s."""

    arrived_error: list
    """Absolute errors of the spacing of states on arrival, compared with their stamps."""
    played_error: list
    """The same errors of the played states."""
    added: list
    """Times from arrival to playout."""
    ages: list
    """Ages of the shown states in each step."""


def played(network, seconds=20.0, seed=1, period_s=PERIOD_S, x=lambda t: 0.5):
    """Play the states of a device that is never at rest."""
    way = Way(network.link, random.Random(seed))
    playout = Playout(network.playout_s, MAX_AGE_S)
    arrived, shown = {}, {}
    ages = []
    newest = sent = -1
    next_stall_s = network.stalls_every_s
    for step in range(round(seconds / FINE_S)):
        now_s = step * FINE_S
        if now_s >= next_stall_s:
            next_stall_s += network.stalls_every_s
            way.stall(now_s + network.stall_s)
        if now_s >= (sent + 1) * period_s - 1e-9:
            sent += 1
            way.send(sent, now_s)
        for number in way.arrived(now_s):
            if number <= newest:
                continue  # The core also drops duplicates and late states.
            newest = number
            made_s = number * period_s
            there_s = OFFSET_S + made_s * (1.0 + network.drift)
            axes = NEUTRAL._replace(x=x(made_s))
            arrived[number] = now_s
            playout.heard(there_s, now_s)
            playout.take(MotionSample(there_s, made_s, made_s, axes), now_s, at_once=False)
        playout.advance(now_s)
        if playout.shown is not None:
            made_s = playout.shown.made_s
            shown.setdefault(round(made_s / period_s), now_s)
            if now_s > 1.0:
                ages.append(now_s - made_s)

    def errors(at_s):
        numbers = [each for each in sorted(at_s) if each * period_s > 1.0]
        return [abs(at_s[b] - at_s[a] - (b - a) * period_s) for a, b in itertools.pairwise(numbers)]

    added = [shown[n] - arrived[n] for n in shown if n * period_s > 1.0]
    return Played(errors(arrived), errors(shown), added, ages)


def quantile(values, share):
    return sorted(values)[math.ceil(share * len(values)) - 1]


@pytest.mark.parametrize("name", NETWORKS)
def test_motion_has_its_own_spacing_and_waits_no_longer_than_allowed(name):
    network = NETWORKS[name]
    found = played(network)
    ratio = quantile(found.played_error, 0.95) / quantile(found.arrived_error, 0.95)
    assert ratio <= 0.25, f"{ratio:.2f}"
    assert max(found.added) <= network.playout_s + FINE_S


def test_without_a_playout_each_state_is_played_on_arrival():
    found = played(LTE._replace(playout_s=0.0))
    assert max(found.added) == 0.0
    assert quantile(found.arrived_error, 0.95) > 0.015


def test_the_delay_follows_the_jitter_and_no_further():
    calm = played(Network(Link(0.045, 0.002), 0.06))
    assert quantile(calm.added, 0.99) <= 0.003
    rough = played(LTE._replace(link=Link(0.025, 0.3), playout_s=0.06))
    assert max(rough.added) <= 0.06 + FINE_S


def test_motion_is_stretched_and_shortened_by_a_tenth_at_most():
    """The network becomes worse, then better, while the hand moves."""
    playout = Playout(0.1, MAX_AGE_S)
    spans, last = [], None
    for number in range(2000):
        sent_s = number * PERIOD_S
        transit_s = 0.02 + (0.05 * (number % 2) if 500 <= number < 1000 else 0.0)
        playout.heard(sent_s, sent_s + transit_s)
        playout.take(
            MotionSample(sent_s, sent_s, sent_s, NEUTRAL._replace(x=0.5)), sent_s, at_once=False
        )
        while playout.due_s < math.inf:
            due_s = playout.due_s
            playout.advance(due_s)
            if last is not None:
                spans.append((due_s - last[0]) / (playout.shown.sent_s - last[1]))
            last = due_s, playout.shown.sent_s
    assert max(spans) > 1.05
    assert 0.985 <= min(spans) < 0.995
    assert max(spans) <= 1.1 + 1e-9


# -- states without playout -----------------------------------------------------------------------


def moved(bench, seconds, each=lambda: None, amplitude=0.5):
    """Run with a deflection that encodes its own time; return (time, device state, time of its
    deflection) of each step."""
    seen = []

    def step():
        each()
        bench.move(0.1 + amplitude * (bench.now_s - began_s))
        state = bench.state
        made_s = began_s + (state.axes.x - 0.1) / amplitude if state.axes.x else None
        seen.append((bench.now_s, state, made_s))

    began_s = bench.now_s
    bench.run(seconds, step)
    return seen


def waiting(down=LTE.link, **options):
    """Return a bench whose motion waits for tens of ms."""
    bench = Bench(down, max_age_s=MAX_AGE_S, playout_ms=80.0, **options).live()
    bench.press()
    bench.run(0.3)
    seen = moved(bench, 1.0)
    assert bench.core.due_s < math.inf
    assert seen[-1][0] - seen[-1][2] > 0.055
    return bench


@pytest.mark.matrix("0-0.03", "0-0.2", "1-0.01", "1-0.2", "2-0.01", "2-0.03")
@pytest.mark.parametrize("again_s", [0.01, 0.03, 0.2])
@pytest.mark.parametrize("seed", range(3))
def test_what_was_let_go_of_never_moves_again_from_the_buffer(seed, again_s):
    """The dead-man may be pressed again while old motion would still wait."""
    bench = waiting(seed=seed)
    bench.heard.clear()
    let_go_s = bench.now_s
    bench.press(pressed=False)
    pressed = []

    def again():
        if not pressed and bench.now_s >= let_go_s + again_s:
            pressed.append(bench.press())

    seen = moved(bench, 0.5, again)
    assert [event.pressed for event in bench.heard] == [False, True]
    assert bench.heard[0].stamp_s - let_go_s <= 0.07 + CLAIM_PERIOD_S
    after = [made_s for at_s, _, made_s in seen if at_s > bench.heard[0].stamp_s + 1.5 * STEP_S]
    assert len(after) > 150
    assert min(after) >= let_go_s - STEP_S


def test_rest_does_not_wait():
    playout = Playout(0.1, MAX_AGE_S)
    for number in range(5):
        now_s = 0.01 * number
        playout.heard(now_s, now_s + 0.1 * (number == 0))
        axes = NEUTRAL if number == 4 else NEUTRAL._replace(x=0.5)
        playout.take(MotionSample(now_s, now_s, now_s, axes), now_s, at_once=number == 0)
        assert (playout.due_s == math.inf) is (number in (0, 4))
    assert playout.shown.axes == NEUTRAL
    assert playout.shown.made_s == now_s


def test_what_was_let_go_of_stays_at_rest():
    bench = waiting()
    rested_s = bench.now_s
    seen = []
    bench.move(0.0)
    bench.run(0.3, lambda: seen.append((bench.now_s, bench.state.axes.x)))
    still_s = next(at_s for at_s, x in seen if x == 0.0)
    assert still_s - rested_s <= 0.065 + 0.008 + STEP_S
    assert not any(x for at_s, x in seen if at_s > still_s)


def test_rest_of_the_axes_does_not_wait_for_a_pose():
    playout = Playout(0.1, MAX_AGE_S)
    poses = [Pose(Vector3(float(n), 0.0, 0.0), IDENTITY) for n in range(5)]
    for number, pose in enumerate(poses):
        now_s = 0.01 * number
        playout.heard(now_s, now_s + 0.1 * (number == 0))
        axes = NEUTRAL if number == 4 else NEUTRAL._replace(x=0.5)
        motion = MotionSample(now_s, now_s, now_s, axes, pose)
        playout.take(motion, now_s, at_once=number == 0)
    found = []
    for step in range(200):
        playout.advance(0.04 + 0.001 * step)
        found.append(playout.shown)
    assert not any(any(each.axes) for each in found)
    assert list(dict.fromkeys(each.pose for each in found)) == poses


@pytest.mark.parametrize("how", ["lost", "gone", "stall", "anew"])
def test_a_link_that_is_lost_drops_what_waits(how):
    bench = waiting()
    broke_s = bench.now_s
    if how == "lost":
        bench.move(0.5, DeviceLink.LOST, reason="unplugged")
        bench.run(0.1)
    elif how == "stall":
        bench.down.stall(bench.now_s + 0.5)
        bench.run(0.4)
    elif how == "gone":
        bench.core.on_lost("no computer shares it", bench.now_s)
    else:
        bench.share._run += 1
        bench.run(0.1)
    assert bench.state.axes == NEUTRAL
    assert bench.core.due_s == math.inf
    if how == "gone":
        bench.core.on_opened(bench.now_s)
    bench.move(0.0)
    seen = []
    bench.run(1.0, lambda: seen.append(bench.state.axes.x))
    assert not any(seen)
    found = moved(bench, 0.3)
    assert bench.state.link is DeviceLink.LIVE
    assert all(made_s is None or made_s > broke_s for _, _, made_s in found)


def test_what_waits_gives_way_before_it_is_too_old():
    playout = Playout(0.1, 0.105)
    for number in range(50):
        sent_s = 0.02 * number
        arrives_s = sent_s + 0.1 * (number == 0)
        playout.heard(sent_s, sent_s)
        playout.heard(sent_s, sent_s + 0.1)
        motion = MotionSample(sent_s, sent_s, sent_s, NEUTRAL._replace(x=0.5))
        playout.take(motion, arrives_s, at_once=number == 0)
        for step in range(20):
            now_s = sent_s + 0.001 * step
            playout.advance(now_s)
            assert now_s - playout.shown.made_s <= 0.105
    assert now_s - playout.shown.made_s > 0.08


def test_a_press_shows_the_newest_motion_and_the_next_ones_wait():
    bench = waiting()
    before_s = bench.state.stamp_s
    bench.press("grip")
    at_s = bench.now_s
    seen = moved(bench, 0.5)
    heard_s = next(event.stamp_s for event in bench.heard if event.button == "grip")
    ages = {now_s: now_s - made_s for now_s, _, made_s in seen}
    first = min(now_s for now_s in ages if now_s > heard_s + 0.5 * STEP_S)
    assert before_s < at_s
    assert ages[first] <= 0.065 + 2 * STEP_S + 0.004
    assert seen[-1][0] - seen[-1][2] > 0.055


def test_its_figures():
    calm = Bench(Link(0.045, 0.004), drift=1e-4).live()
    figures = calm.core.metrics(calm.now_s)
    assert figures["delay_s"] == pytest.approx(0.047, abs=0.004)
    assert figures["jitter_s"] <= 0.004 + STEP_S
    assert (figures["playout_s"], figures["loss"]) == (0.0, 0.0)
    bench = waiting(drift=1e-4)
    figures = bench.core.metrics(bench.now_s)
    assert 0.02 < figures["jitter_s"] <= 0.041
    assert 0.0 < figures["playout_s"] < 0.04
    assert figures["age_s"] == pytest.approx(figures["delay_s"] + figures["playout_s"], abs=0.015)
    assert 0.0 <= figures["loss"] < 0.04
    bench.down.link = bench.down.link._replace(loss=0.2)
    moved(bench, 20.0, amplitude=0.04)
    assert bench.core.metrics(bench.now_s)["loss"] == pytest.approx(0.2, abs=0.04)


def test_motion_that_would_wait_for_longer_than_it_counts_is_refused():
    with pytest.raises(OptionError, match="less than max_age_s, 100 ms"):
        RemoteOptions(max_age_s=0.1, playout_ms=100.0)
    with pytest.raises(OptionError, match="playout_ms"):
        RemoteOptions(playout_ms=-1.0)


def test_the_session_gets_the_played_motion_with_the_stamp_of_its_making():
    bench = waiting()
    state = bench.state
    assert 0.055 < bench.now_s - state.stamp_s < 0.13
    assert isinstance(state.axes, Axes)


def test_transit_times_of_before_a_clock_was_set_are_forgotten():
    bench = waiting()
    bench.lie_s = 0.2
    moved(bench, 1.0)
    assert bench.count("clock_resets") > 0
    assert bench.core.metrics(bench.now_s)["jitter_s"] <= 0.041


def test_the_reader_wakes_when_motion_is_due_and_tells_of_it(monkeypatch):
    bench = waiting()
    clock = SimpleNamespace(monotonic=lambda: bench.now_s)
    monkeypatch.setattr("cardan.drivers.remote.device.time", clock)
    device = Remote(device="x")
    device._core = bench.core
    due_s = bench.core.due_s
    assert device._wait_s() == pytest.approx(due_s - bench.now_s)
    reported = device._notified
    device._attend()
    assert device._notified == reported
    bench.now_s = due_s
    assert device._wait_s() == 0.0
    device._attend()
    assert device._notified == reported + 1
    assert device._wait_s() > 0.0
