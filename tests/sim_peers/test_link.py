"""A bad network between a peer and the other side."""

from __future__ import annotations

from itertools import pairwise

import pytest

from cardan.sim_peers.link import LINK_FAULTS, FaultyLink
from tests.sim_peers.egm_pc import TS


def test_every_switch_of_the_network_and_garbage_want_a_link():
    for name in (*(switch.name for switch in LINK_FAULTS), "garbage"):
        assert FaultyLink.wanted({name: 0.1})


def through(faults, count=2000, seed=5, garbage=False):
    """Send a datagram per cycle through a faulty link; return (time, number) of the delivered
    ones."""
    link = FaultyLink(faults, seed, garbage)
    arrived = []
    for n in range(count + 100):
        now_s = n * TS
        if n < count:
            link.push(now_s, b"%d" % n)
        arrived += [(now_s, data) for data in link.pop(now_s)]
    assert link.next_s() is None
    return arrived


def numbers(arrived):
    return [int(data) for _, data in arrived]


def test_a_link_without_faults_is_transparent():
    assert numbers(through({})) == list(range(2000))
    assert not FaultyLink.wanted({"estop": 3.0, "drop": 0.0})
    assert FaultyLink.wanted({"drop": 0.1})


def test_drop():
    got = numbers(through({"drop": 0.05}))
    assert got == sorted(set(got))
    assert len(got) == pytest.approx(1900, abs=40)


def test_duplicate():
    got = numbers(through({"duplicate": 0.05}))
    assert sorted(set(got)) == list(range(2000))
    assert len(got) == pytest.approx(2100, abs=40)


def test_reorder():
    got = numbers(through({"reorder": 0.05}))
    assert sorted(got) == list(range(2000))
    swaps = [b for a, b in pairwise(got) if b < a]
    assert len(swaps) == pytest.approx(95, abs=30)
    assert max(abs(n - at) for at, n in enumerate(got)) == 1


def test_delay_and_jitter():
    arrived = through({"delay": 20.0})
    for at, data in arrived:
        assert at - int(data) * TS == pytest.approx(0.020, abs=TS)
    late = [at - int(data) * TS for at, data in through({"delay": 10.0, "jitter": 8.0})]
    assert min(late) >= 0.010
    assert max(late) <= 0.018 + TS
    assert max(late) - min(late) > 0.006
    assert numbers(through({"jitter": 8.0})) == list(range(2000))


def test_faults_repeat_with_the_seed():
    faults = {"drop": 0.1, "duplicate": 0.1, "reorder": 0.1, "jitter": 5.0}
    assert through(faults, seed=1) == through(faults, seed=1)
    assert through(faults, seed=1) != through(faults, seed=2)
