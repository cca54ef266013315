"""Benchmark of a device at another computer: its goals, and its place in the docs."""

from pathlib import Path

import pytest

from bench import pages, remote
from bench.figures import Figures
from bench.link import Carried
from bench.remote import NETWORKS

pytestmark = pytest.mark.matrix


def found(**of):
    """Return figures with a duration by name, s."""
    figures = Figures("")
    for name, seconds in of.items():
        names = {"local": remote.LOCAL, "share": remote.REMOTE, "beyond": remote.BEYOND}
        figures.add(names.get(name, name), seconds)
    return figures


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
    rows = [
        (network, way, found(share=0.13, beyond=0.003), found(share=0.2))
        for network in NETWORKS
        for way in remote.WAYS
    ]
    for part, body in (
        (remote.SPEED_PART, remote.speed_table(local, "")),
        (remote.NETWORK_PART, remote.network_table(rows, local)),
    ):
        assert body.strip() in pages.replaced(page, part, body)
    *_, internet = remote.network_table(rows, local).splitlines()
    assert internet.startswith("| Internet | QUIC |")
    assert "| 1.0 / 1.0 ms | 2 / 15 ms | 8.0 / 8.0 ms | 0 | 200 / 200 ms | 370 ms |" in internet


class Network:
    """Frames by the time since the act when they were sent, and when they arrived."""

    def __init__(self, *frames):
        self.frames = [Carried(sent_s, 66, came_s) for sent_s, came_s in frames]

    def carried(self, to, since_s, until_s):
        assert to == remote.ROBOT
        return [each for each in self.frames if since_s <= each.sent_s <= until_s]


@pytest.mark.parametrize(
    ("frames", "took_s"),
    [
        ([(0.9, 1.0), (1.001, 1.031), (1.002, 1.132)], 0.03),
        # Time for retransmission is the protocol's cost.
        ([(1.001, None), (1.2, 1.3)], 0.1),
        ([], 0.1),
    ],
)
def test_the_first_frame_since_the_act_tells_what_the_network_took(frames, took_s):
    stroke = remote.Stroke(1.0, 1.5, 2.0, 2.1)
    assert remote.transit_s(Network(*frames), stroke, 0.1) == pytest.approx(took_s)
