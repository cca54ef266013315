"""Playback of a record to its viewer, without messages on the bus."""

from __future__ import annotations

import io
import json

import pytest

pytest.importorskip("mcap", reason="mcap is not installed: pip install cardan[record]")

from cardan.errors import CaptureError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.type_hash import type_hash
from cardan.recording.mcap_file import (
    PLACE_NS,
    RecordedMessage,
    RecordedTopic,
    RecordReader,
    RecordWriter,
)
from cardan.recording.player import MOST_MESSAGE, Player, Show, run

STRING, WRENCH = "std_msgs/msg/String", "geometry_msgs/msg/WrenchStamped"
NS = 10**9
BEGAN_NS = 1_700_000_000 * NS

DESCRIPTION = RecordedTopic("/robot_description", STRING, type_hash(STRING), True, ("/arm",))
STATE = RecordedTopic("/arm/state", STRING, type_hash(STRING), False, ("/arm",))
OTHER = RecordedTopic("/other", "acme_msgs/msg/Unknown", "", False, ())


def text(topic, at_s, value):
    data = codec_of(STRING).encode({"data": value})
    stamp_ns = BEGAN_NS + round(at_s * NS)
    return RecordedMessage(topic, stamp_ns, stamp_ns, 1, data)


def made(path, seconds=60, per_second=20):
    """Return a record whose state has its own time, in tenths of a second."""
    writer = RecordWriter(path)
    writer.add(text(DESCRIPTION, 0.0, "<robot/>"))
    for number in range(seconds * per_second):
        at_s = number / per_second
        writer.add(text(STATE, at_s, f"{at_s:.2f}"))
        if number % per_second == 0:
            writer.add(RecordedMessage(OTHER, BEGAN_NS + round(at_s * NS), 0, 1, b"\0\1\0\0"))
            writer.flush()
    writer.finish()
    return path


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return made(tmp_path_factory.mktemp("records") / "one.mcap")


@pytest.fixture
def show(path):
    show = Show(path)
    show.wanted = frozenset({STATE.name, DESCRIPTION.name, OTHER.name})
    return show


def values(shown):
    """Return the shown values by topic."""
    return {name: message["data"] for name, message in map(json.loads, shown)}


def test_what_is_in_it_is_known_before_anything_is_shown(show):
    assert show.contents.duration_s == pytest.approx(59.95)
    assert show.contents.topics[STATE.name] == (STRING, 1200)
    assert not show.contents.cut_off


def test_any_time_shows_what_was_newest_then(show):
    assert values(show.seek(40.0)) == {STATE.name: "40.00", DESCRIPTION.name: "<robot/>"}
    assert values(show.seek(3.02)) == {STATE.name: "3.00", DESCRIPTION.name: "<robot/>"}
    assert values(show.forward(3.06)) == {STATE.name: "3.05"}
    assert values(show.forward(3.06)) == {}
    assert values(show.seek(1e9))[STATE.name] == "59.95"
    assert show.over


def test_a_time_is_found_without_reading_all_that_was_before(path):
    reader = RecordReader(path)
    assert sum(1 for _ in reader) == 1261
    assert all(
        later.log_ns - place.log_ns >= PLACE_NS
        for place, later in zip(reader.places, reader.places[1:], strict=False)
    )
    place = reader.places[-2]
    found = list(reader.messages(place))
    assert 0 < len(found) < 100
    assert found[0].log_ns == place.log_ns
    assert found[0].topic in (STATE, OTHER)


def test_it_is_played_in_the_time_that_is_given(show):
    player = Player(show)
    topics = [STATE.name]
    shown = player.order({"topics": topics, "at_s": 10.0, "rate": 2.0, "playing": True}, 100.0)
    assert values(shown) == {STATE.name: "10.00"}
    assert values(player.tick(101.0)) == {STATE.name: "12.00"}
    player.order({"playing": False}, 101.0)
    assert player.tick(200.0) == []
    player.order({"playing": True, "rate": 16.0}, 300.0)
    assert values(player.tick(300.5)) == {STATE.name: "20.00"}
    assert json.loads(player.line([]))["at_s"] == pytest.approx(20.0)
    assert player.line([]) == ""
    player.tick(1000.0)
    assert not player.playing
    assert values(player.order({"playing": True}, 1001.0)) == {STATE.name: "0.00"}


@pytest.mark.parametrize(
    ("order", "why"),
    [
        ({"rate": 0.0}, "rate is 0, must be 0.1 to 16"),
        ({"rate": True}, "rate must be a number"),
        ({"at_s": -1}, "at_s is -1"),
        ({"at_s": float("nan")}, "at_s is nan"),
        ({"topics": "all"}, "topics must be a list of names"),
    ],
)
def test_orders_that_are_none_are_refused(show, order, why):
    with pytest.raises(ValueError, match=why):
        Player(show).order(order, 0.0)


def test_a_record_that_was_cut_off_is_shown_as_far_as_it_goes(path, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 3])
    show = Show(cut)
    assert "cut off" in show.contents.cut_off
    assert 5.0 < show.contents.duration_s < 50.0
    show.wanted = frozenset({STATE.name})
    assert values(show.seek(3.0)) == {STATE.name: "3.00"}
    assert values(show.seek(1e9))[STATE.name] == f"{show.contents.duration_s:.2f}"


@pytest.mark.parametrize("data", [b"", b"no record", b"\x89MCAP0\r\n"])
def test_what_is_no_record_is_refused_in_words(tmp_path, data):
    path = tmp_path / "bad.mcap"
    path.write_bytes(data)
    with pytest.raises(CaptureError, match=r"is not an MCAP file|has no messages"):
        Show(path)
    out = io.StringIO()
    run(path, io.StringIO(), out)
    assert json.loads(out.getvalue())["error"]


def test_what_is_too_large_for_a_page_is_left_out(tmp_path):
    path = tmp_path / "large.mcap"
    writer = RecordWriter(path)
    writer.add(text(STATE, 0.0, "x" * (MOST_MESSAGE + 1)))
    writer.add(text(DESCRIPTION, 0.1, "y" * (MOST_MESSAGE + 1)))
    writer.finish()
    show = Show(path)
    show.wanted = frozenset({STATE.name, DESCRIPTION.name})
    assert show.seek(1.0) == []


def test_the_program_takes_orders_a_line_each(path):
    out = io.StringIO()
    orders = io.StringIO('nonsense\n{"topics": ["/arm/state"], "at_s": 7}\n[]\n{"rate": 99}\n')
    run(path, orders, out)
    about, bad, first, none, refused = map(json.loads, out.getvalue().splitlines())
    assert about["duration_s"] == pytest.approx(59.95)
    assert about["topics"][STATE.name] == [STRING, 1200]
    assert "refused" in bad
    assert first["messages"] == [[STATE.name, {"data": "7.00"}]]
    assert first["at_s"] == 7.0
    assert "refused" in none
    assert "rate" in refused["refused"]
