"""Template package cardan-lever: its lines, its core in virtual time, and its driver on a port."""

import importlib
import time
from pathlib import Path

import pytest

from cardan.errors import DeviceNotFoundError
from cardan.types import DeviceLink
from tests.serving import in_a_thread
from tests.waiting import WITHIN_S

REST = (0.0,) * 6
PACKAGE = Path(__file__).parents[2] / "examples" / "packages" / "cardan-lever"


@pytest.fixture
def module(monkeypatch):
    """Return a function that imports a module of the package."""
    monkeypatch.syspath_prepend(PACKAGE)
    return lambda name: importlib.import_module(f"cardan_lever.{name}")


@pytest.fixture
def core(module):
    return module("driver").LeverCore(module("driver").LeverOptions())


def line(forward, trigger=False, left=0.0, twist=0.0):
    return f"L {forward:.3f} {left:.3f} {twist:.3f} {trigger:d}\n".encode()


def test_lines_are_read_however_they_are_cut(module):
    protocol = module("protocol")
    first = protocol.Report(0.12, -0.03, 0.0, True)
    second = protocol.Report(-1.0, 1.0, 0.5, False)
    assert protocol.encode(first) == b"L 0.120 -0.030 0.000 1\n"
    stream = b"0.000 1\n" + protocol.encode(first) + protocol.encode(second)
    for size in (1, 5, len(stream)):
        reader = protocol.LineReader()
        portions = (stream[at : at + size] for at in range(0, len(stream), size))
        assert [each for data in portions for each in reader.feed(data)] == [first, second]


@pytest.mark.parametrize(
    "words",
    [b"", b"L", b"L 0.120 -0.030 0.000", b"L 1.001 0.000 0.000 0", b"L 0 0 0 0", b"\xff" * 9],
)
def test_a_line_that_is_none_is_reported(module, words):
    reader = module("protocol").LineReader()
    assert list(reader.feed(b"\n" + words + b"\n")) == [None]


def test_a_stream_without_lines_is_not_kept(module):
    reader = module("protocol").LineReader()
    assert list(reader.feed(b"\n" + b"x" * 65)) == [None]
    assert list(reader.feed(b"x\n" + line(0.0))) == [(0.0, 0.0, 0.0, False)]


def test_its_core(core):
    core.on_opened(1.0)
    core.on_bytes(b"\n" + line(0.0), 1.0)
    core.on_bytes(line(0.5, trigger=True, left=-1.0, twist=1.0), 1.01)
    state = core.state(1.01)
    assert (state.link, state.buttons) == (DeviceLink.LIVE, {"trigger"})
    assert state.axes == pytest.approx((0.45 / 0.95, -1.0, 0.0, 0.0, 0.0, 1.0))
    state = core.state(1.2)
    assert (state.link, state.axes, state.buttons) == (DeviceLink.STALE, REST, frozenset())
    assert state.reason == "no line for 0.15 s: check its cable"
    core.on_bytes(line(0.5, trigger=True), 1.3)
    assert core.state(1.3).reason == "the lever fell silent: let go of it once"
    core.on_bytes(line(0.0), 1.33)
    assert core.state(1.33).link is DeviceLink.NEEDS_NEUTRAL
    core.on_bytes(line(0.0), 1.35)
    assert core.state(1.35).link is DeviceLink.LIVE
    assert core.metrics(1.35) == {"silences": 1, "malformed_lines": 0, "lost_edges": 0}


def test_a_silence_that_nobody_looked_at_counts_too(core):
    core.on_opened(1.0)
    core.on_bytes(b"\n" + line(0.0), 1.0)
    core.on_bytes(line(0.5), 2.0)
    assert core.state(2.0).link is DeviceLink.NEEDS_NEUTRAL


def test_a_port_at_which_nothing_speaks_is_reported(core):
    core.on_opened(1.0)
    core.on_bytes(b"\nnonsense\n", 1.1)
    assert core.state(1.2).link is DeviceLink.STALE
    assert core.diagnosis(1.2) == [
        "no line for 0.15 s: check its cable",
        "1 lines that are none of a lever's, ignored",
    ]


def test_a_port_that_is_not_there(module, tmp_path):
    lever = module("driver").Lever(path=str(tmp_path / "none"))
    with pytest.raises(DeviceNotFoundError, match=r"cannot open .*none: no device is at that"):
        lever.open()


@pytest.mark.matrix
def test_unplugged_and_back_it_has_to_be_seen_at_rest_again(module, tmp_path):
    peer = module("peer")
    faults = {"unplug": 0.3, "replug": 0.6, "cut": 3.0}
    options = peer.LeverPeerOptions(path=str(tmp_path / "port"), script="rest", faults=faults)
    links = []
    end_s = time.monotonic() + WITHIN_S
    with (
        in_a_thread(peer.LeverPeer(options)),
        module("driver").Lever(path=options.path) as lever,
    ):
        for state in lever:
            if links[-1:] != [state.link]:
                links.append(state.link)
            if links.count(DeviceLink.LIVE) == 2:
                break
            assert time.monotonic() < end_s, links
        assert lever.metrics()["malformed_lines"] > 0
    lost = links.index(DeviceLink.LOST)
    assert DeviceLink.LIVE in links[:lost]
    assert links[-2:] == [DeviceLink.NEEDS_NEUTRAL, DeviceLink.LIVE]
