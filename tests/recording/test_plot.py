"""Plots of records: contents, and messages about missing data."""

import json
import math
import sys

import pytest

from cardan.errors import CaptureError, DriverError, OptionError
from cardan.gateway.session.snapshot import Snapshot
from cardan.recording.plot import plot, read_series
from tests.recording.sessions import NODE, STRING
from tests.recording.test_replay import topic, write

POSE, WRENCH = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped"
RAW = "cardan_msgs/msg/RawPacket"
PNG, SVG, PDF = b"\x89PNG", b"<?xml", b"%PDF"


def header(stamp_s):
    return {"stamp": {"sec": int(stamp_s), "nanosec": round(stamp_s % 1.0 * 1e9)}}


def rows(node=NODE):
    state, target = topic(f"{node}/state/pose", POSE), topic(f"{node}/state/target", POSE)
    force, raw = topic(f"{node}/state/wrench", WRENCH), topic(f"{node}/raw/robot", RAW)
    for n in range(100):
        t = 1.0 + 0.02 * n
        x, y = 0.5 + 0.1 * math.cos(t), 0.1 * math.sin(t)
        place = {"x": x, "y": y, "z": 0.4}
        yield t, state, {"header": header(t), "pose": {"position": place}}
        ahead = {"position": {**place, "z": 0.403}}
        yield t, target, {"header": header(t), "pose": ahead}
        yield t, force, {"header": header(t), "wrench": {"force": {"z": float(n)}}}
        yield t, raw, {"header": header(t), "direction": 0}
        yield t, raw, {"header": header(t + 0.0004), "direction": 1}
        if n % 5 == 0:
            s = Snapshot.of(
                {
                    "loop": {"cycles": n + 1, "tick_p50_s": 1e-4, "tick_p99_s": 2e-4},
                    "arm": {"trips": int(n >= 50)},
                }
            )
            text = s.to_bytes().decode()
            yield t, topic(f"{node}/state/snapshot", STRING), {"data": text}


def damaged(path, where):
    """Return the file with a flipped bit: in the program's name, or in its only chunk."""
    data = bytearray(path.read_bytes())
    data[where] ^= 1
    path.write_bytes(data)
    return path


def test_the_figures_are_those_of_the_record(tmp_path):
    node, series, problems = read_series(write(tmp_path / "r.mcap", rows()))
    assert problems == []
    assert node == NODE
    assert len(series.poses) == len(series.targets) == len(series.forces) == 100
    error = series.following_error()
    assert len(error) == 100
    assert all(each[1] == pytest.approx(0.003) for each in error)
    assert len(series.answers) == 100
    assert all(each[1] == pytest.approx(0.0004) for each in series.answers)
    assert len(series.ticks) == 20
    assert len(series.trips) == 1
    assert series.begin_ns == 1_000_000_000


@pytest.mark.matrix("svg", "pdf")
@pytest.mark.parametrize(
    ("ending", "magic"), [("png", PNG), ("svg", SVG), ("pdf", PDF)], ids=["png", "svg", "pdf"]
)
def test_a_picture(tmp_path, ending, magic):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    path = write(tmp_path / "r.mcap", rows())
    picture = tmp_path / f"r.{ending}"
    assert plot(path, picture) == []
    assert picture.read_bytes().startswith(magic)
    assert picture.stat().st_size > 10_000


def test_a_picture_of_next_to_nothing(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    path = write(tmp_path / "r.mcap", list(rows())[:1])
    plot(path, tmp_path / "r.svg")
    text = (tmp_path / "r.svg").read_text()
    for words in ("nothing was commanded", "no force was measured", "no latency was recorded"):
        assert f"<!-- {words} -->" in text


def test_a_damaged_record_is_drawn_and_said_to_be(tmp_path):
    path = damaged(write(tmp_path / "r.mcap", rows()), 30)
    (words,) = read_series(path)[2]
    assert words.startswith("the file is damaged at byte ")
    damaged(path, 1000)
    with pytest.raises(
        CaptureError, match=r"has no state of an arm.*; the file is damaged at byte"
    ):
        read_series(path)


def test_one_of_several_arms_is_named(tmp_path):
    path = write(tmp_path / "r.mcap", [*rows("/left/server"), *rows("/right/server")])
    assert read_series(path, "left/server")[0] == "/left/server"
    with pytest.raises(OptionError, match=r"--arm.*one of /left/server, /right/server"):
        read_series(path)
    with pytest.raises(OptionError, match="--arm"):
        read_series(path, "/middle/server")


def test_of_a_record_of_an_earlier_version_the_latencies_are_read(tmp_path):
    flat = json.dumps({"cycles": 9, "tick_p50_s": 1e-3, "tick_p99_s": 2e-3, "trips": 1})
    earlier = (1.0, topic(f"{NODE}/state/snapshot", STRING), {"data": flat})
    series = read_series(write(tmp_path / "r.mcap", [earlier, *rows()]))[1]
    assert [each[1:] for each in series.ticks][:2] == [(1e-3, 2e-3), (1e-4, 2e-4)]
    assert len(series.trips) == 2


def test_other_nodes_topics_of_these_names_do_no_harm(tmp_path):
    others = [
        (1.0, topic("/other/state/pose", STRING), {"data": "x"}),
        (1.0, topic("/other/state/snapshot", STRING), {"data": json.dumps([1])}),
    ]
    assert read_series(write(tmp_path / "r.mcap", [*others, *rows()]))[0] == NODE


def test_what_cannot_be_drawn_is_refused(tmp_path):
    path = write(tmp_path / "r.mcap", [(1.0, topic("/other"), {"data": "x"})])
    with pytest.raises(OptionError, match=r"--output.*\.png, \.svg, \.pdf"):
        plot(path, tmp_path / "r.gif")
    with pytest.raises(CaptureError, match="no state of an arm"):
        read_series(path)


def test_without_matplotlib_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(DriverError, match=r'pip install "cardan\[evaluate\]"'):
        plot(write(tmp_path / "r.mcap", rows()), tmp_path / "r.png")
