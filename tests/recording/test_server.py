"""The recorder as a server: locations of its files, and messages about them."""

import threading

import pytest

from cardan.bus.options import BusOptions
from cardan.errors import CaptureError
from cardan.gateway.servers import stats
from cardan.recording.server import (
    RecorderServer,
    RecorderServerOptions,
    RecordsOptions,
    new_file,
)
from tests.waiting import WITHIN_S

NOON_S = 1_800_000_000.0


def test_no_record_takes_the_place_of_another(tmp_path):
    first = new_file(tmp_path / "records", NOON_S)
    first.touch()
    second = new_file(tmp_path / "records", NOON_S)
    second.touch()
    third = new_file(tmp_path / "records", NOON_S)
    assert first.name.startswith("cardan-2027011")
    assert [second.stem, third.stem] == [f"{first.stem}-2", f"{first.stem}-3"]


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(CaptureError, match=r"cannot make the folder .*file/records"):
        new_file(tmp_path / "file" / "records", NOON_S)


@pytest.mark.matrix
def test_it_records_until_it_is_asked_to_end_and_tells_how_much(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(stats.TELLS_VARIABLE, "1")
    stop, reported, ready = threading.Event(), [], []

    def tell(figures):
        reported.append(figures)
        if len(reported) > 1:
            stop.set()

    monkeypatch.setattr(stats, "tell", tell)
    options = RecorderServerOptions(
        bus=BusOptions(router=""), records=RecordsOptions(folder=str(tmp_path))
    )
    timer = threading.Timer(WITHIN_S, stop.set)
    timer.start()
    RecorderServer.serve(options, ready.append, stop)
    timer.cancel()
    (file,) = tmp_path.glob("*.mcap")
    assert ready == [str(file)]
    assert reported[0].keys() == {"bytes", "messages", "dropped", "lost"}
    assert 0 < reported[-1]["bytes"] <= file.stat().st_size
    assert "0 messages of 0 topics" in capsys.readouterr().out
