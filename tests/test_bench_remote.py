"""The benchmark of a device at another computer: its network, and its place in the docs."""

import random
from pathlib import Path

import pytest

from bench import pages, remote
from bench.figures import Figures
from bench.slow_network import NETWORKS, SEGMENT_S, Network, _Way

pytestmark = pytest.mark.matrix

LOSSY = Network("lossy", 0.05, 0.02, 0.2, 0.5, 10.0, 0.25, (2.0, 25.0), 0.3)
SENT_S = [100.0 + SEGMENT_S * number for number in range(5000)]


def found(**of):
    """One duration by name, s."""
    figures = Figures("")
    for name, seconds in of.items():
        figures.add({"local": remote.LOCAL, "share": remote.REMOTE}.get(name, name), seconds)
    return figures


def test_a_network_keeps_the_order_and_stands_still_when_it_is_said_to():
    way = _Way(LOSSY, random.Random(1))
    arrived = [way.arrives_s(sent_s) for sent_s in SENT_S]
    assert arrived == sorted(arrived)
    assert not [at_s for at_s in arrived if at_s % 10.0 < 0.5 - 1e-9]
    assert min(at - sent for at, sent in zip(arrived, SENT_S, strict=True)) >= 0.03


def test_what_is_lost_comes_a_round_trip_and_three_segments_later():
    alone = LOSSY._replace(jitter_s=0.0, stall_s=0.0)
    late = [_Way(alone, random.Random(seed)).arrives_s(1.0) - 1.0 for seed in range(2000)]
    assert sum(each > 0.06 for each in late) / len(late) == pytest.approx(0.2, abs=0.04)
    assert min(each for each in late if each > 0.06) == pytest.approx(0.05 + 0.1 + 3 * SEGMENT_S)


def test_both_aims_of_the_speed_are_held():
    for share_s, spacenav_s, verdict in (
        (0.00299, 0.005, "met"),
        (0.00301, 0.005, "missed"),
        (0.0029, 0.0037, "missed"),
    ):
        figures = found(local=0.002, share=share_s, **{remote.SPACENAV: spacenav_s})
        assert f"spacenav_node adds: {verdict}." in remote.speed_table(figures, "")


def test_the_page_has_a_place_for_both_tables():
    page = Path(remote.PAGE).read_text("utf-8")
    local = found(local=0.002, share=0.0025, **{remote.SPACENAV: 0.005})
    rows = [(network, found(share=0.13), found(share=0.2)) for network in NETWORKS]
    for part, body in (
        (remote.SPEED_PART, remote.speed_table(local, "")),
        (remote.NETWORK_PART, remote.network_table(rows, local)),
    ):
        assert body.strip() in pages.replaced(page, part, body)
    internet = remote.network_table(rows, local).splitlines()[-1]
    assert "| 8.0 / 8.0 ms | 2 / 15 ms | 200 / 200 ms | 370 ms |" in internet
