"""Events derived from a session's snapshots, and the file that stores them."""

import errno
import json
import os
import resource

import pytest

from cardan.errors import ConfigurationError
from cardan.gateway.daemon.events import (
    MAX_FILES,
    Event,
    EventLog,
    SessionWatch,
    default_event_log,
)
from cardan.gateway.session.snapshot import Snapshot
from tests.gateway.daemon.event_files import read_events
from tests.snapshots import changed

REST = Snapshot.of(
    {"arm": {"phase": "disarmed"}, "robot": {"link": "live"}, "device": {"link": "live"}}
)


@pytest.fixture
def watch():
    watch = SessionWatch("gofa")
    list(watch.take(REST, 1.0))
    return watch


def reported(watch, **changes):
    found = watch.take(changed(REST, **changes), 2.0)
    return [(each.event, each.what, each.why) for each in found]


def test_the_first_snapshot_says_how_it_begins():
    found = {each.event: each.what for each in SessionWatch("gofa").take(REST, 1.0)}
    assert found == {"robot": "live", "device": "live", "arm": "disarmed"}


def test_nothing_new_is_no_event(watch):
    assert reported(watch) == []


def test_who_took_the_authority_and_what_moved(watch):
    found = reported(watch, arm__authority="device", arm__phase="moving")
    assert found == [("authority", "device", ""), ("arm", "moving", "")]
    found = reported(
        watch, arm__phase="braking", arm__message="the device was unplugged", arm__trips=1
    )
    assert ("authority", "nobody", "the device was unplugged") in found
    assert ("trip", "1", "the device was unplugged") in found
    assert ("arm", "braking", "the device was unplugged") in found


def test_a_link_that_is_lost_has_its_reason(watch):
    found = reported(watch, robot__link="lost", robot__hold_reason="no datagram for 0.1 s")
    assert found == [("robot", "lost", "no datagram for 0.1 s")]


def test_figures_that_change_are_no_news(watch):
    assert reported(watch, arm__message="silent for 0.3 s") == [("message", "silent for 0.3 s", "")]
    assert reported(watch, arm__message="silent for 12.4 s") == []


def test_a_new_process_begins_anew(watch):
    watch.forget()
    assert ("arm", "disarmed", "") in reported(watch)


def test_events_are_there_as_soon_as_they_are_written(tmp_path):
    log = EventLog(tmp_path / "state" / "events.jsonl")
    log.write(Event(1.5, "gofa", "arm", "moving", "because"))
    (line,) = log.path.read_text().splitlines()
    assert json.loads(line) == {
        "time_s": 1.5, "name": "gofa", "event": "arm", "what": "moving", "why": "because"
    }  # fmt: skip
    assert log.path.stat().st_mode & 0o777 == 0o600
    log.close()


def test_the_log_is_turned_over(tmp_path):
    log = EventLog(tmp_path / "events.jsonl", file_bytes=500)
    for number in range(200):
        log.write(Event(float(number), "gofa", "arm", "moving"))
    log.close()
    files = sorted(each.name for each in tmp_path.iterdir())
    assert files == ["events.jsonl", *(f"events.jsonl.{n}" for n in range(1, MAX_FILES + 1))]
    assert all(each.stat().st_size <= 500 for each in tmp_path.iterdir())
    times = [event["time_s"] for event in read_events(log.path)]
    assert times == sorted(times)
    assert times[-1] == 199.0


def test_a_broken_line_is_left_out(tmp_path):
    path = tmp_path / "events.jsonl"
    path.write_bytes(b'{"time_s":1}\n{"time_s"\n\xff\n{"time_s":2}\n')
    assert [event["time_s"] for event in read_events(path)] == [1, 2]


def test_what_cannot_be_written_is_counted(tmp_path):
    log = EventLog(tmp_path / "events.jsonl")
    os.close(log._file)
    log._file = os.open("/dev/full", os.O_WRONLY)
    log.write(Event(1.0, "gofa", "arm", "moving"))
    assert log.lost == 1
    log.close()


def _event(number):
    return Event(float(number), "gofa", "arm", "moving", "because " * 4)


def _times(log):
    return [each["time_s"] for each in read_events(log.path) if each["name"] == "gofa"]


@pytest.fixture
def file_size():
    """Sets the greatest size of any file, which acts like a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_disk_that_is_full_within_a_line_costs_no_later_event(tmp_path, file_size, caplog):
    log = EventLog(tmp_path / "events.jsonl")
    log.write(_event(1))
    file_size(log.path.stat().st_size + 10)
    for number in (2, 3):
        log.write(_event(number))
    assert [each.message for each in caplog.records] == [
        f"{log.path} cannot be written: the disk is full; events are lost"
    ]
    file_size(resource.RLIM_INFINITY)
    for number in (4, 5):
        log.write(_event(number))
    log.close()
    assert _times(log) == [1.0, 4.0, 5.0]
    (said,) = [each for each in read_events(log.path) if each["name"] == "daemon"]
    assert (said["event"], said["what"]) == ("lost", "2 events")
    assert log.lost == 2


def test_what_a_daemon_left_on_a_full_disk_costs_the_next_one_nothing(tmp_path):
    path = tmp_path / "events.jsonl"
    path.write_bytes(b'{"time_s":1,"name":"gofa"}\n{"time_s":2,"na')
    log = EventLog(path)
    log.write(_event(3))
    log.close()
    assert _times(log) == [1, 3.0]


def test_a_log_that_cannot_be_turned_over_is_written_on(tmp_path, monkeypatch):
    log = EventLog(tmp_path / "events.jsonl", file_bytes=300)
    real = os.open

    def none_left(*_words, **_more):
        raise OSError(errno.EMFILE, "too many open files")

    monkeypatch.setattr(os, "open", none_left)
    for number in range(20):
        log.write(_event(number))
    monkeypatch.setattr(os, "open", real)
    assert _times(log) == [float(number) for number in range(20)]
    log.write(_event(20))
    assert log.path.stat().st_size < 300
    assert _times(log) == [float(number) for number in range(21)]
    assert log.lost == 0
    log.close()


def test_a_log_that_somebody_has_removed_begins_anew(tmp_path):
    log = EventLog(tmp_path / "events.jsonl")
    log.write(_event(1))
    log.path.unlink()
    for number in (2, 3):
        log.write(_event(number))
    log.close()
    assert _times(log) == [2.0, 3.0]


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigurationError, match="event_log"):
        EventLog(tmp_path / "file" / "events.jsonl")


def test_where_it_is(monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", "/home/me/state")
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    assert str(default_event_log()) == "/home/me/state/cardan/events.jsonl"
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/cardan:/var/lib/other")
    assert str(default_event_log()) == "/var/lib/cardan/events.jsonl"
