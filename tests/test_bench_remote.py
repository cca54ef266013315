"""The benchmark of a device at another computer: its aims, and its place in the docs."""

from pathlib import Path

import pytest

from bench import pages, remote
from bench.figures import Figures
from bench.remote import NETWORKS

pytestmark = pytest.mark.matrix


def found(**of):
    """Return figures with a duration by name, s."""
    figures = Figures("")
    for name, seconds in of.items():
        figures.add({"local": remote.LOCAL, "share": remote.REMOTE}.get(name, name), seconds)
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
        (network, way, found(share=0.13), found(share=0.2))
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
    assert "| 8.0 / 8.0 ms | 2 / 15 ms | 200 / 200 ms | 370 ms |" in internet
