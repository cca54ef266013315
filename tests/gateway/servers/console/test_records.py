"""A page makes records on the server's computer and reads them; none is published on the
network."""

from __future__ import annotations

import sys

import pytest

pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")
pytest.importorskip("mcap", reason="mcap is not installed: pip install cardan[record]")

from cardan.gateway.servers.console import records as module
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.type_hash import type_hash
from cardan.recording.mcap_file import RecordedMessage, RecordedTopic, RecordWriter
from tests.gateway.servers.console.bench import OPERATOR, VIEWER, console, page_program, token_file
from tests.waiting import until

pytestmark = pytest.mark.matrix

STRING = "std_msgs/msg/String"
STATE = RecordedTopic("/arm/state", STRING, type_hash(STRING), False, ("/arm",))

RECORDER = """
import json, pathlib, signal, sys
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
folder = pathlib.Path(next(each for each in sys.argv if each.startswith("--folder="))[9:])
folder.mkdir(exist_ok=True)
path = folder / "cardan-20260101-000000.mcap"
path.write_bytes(b"")
print("READY", path, flush=True)
print("FIGURES", json.dumps({"bytes": 5, "messages": 7}), flush=True)
signal.sigwait([signal.SIGTERM])
print("7 messages of 2 topics", flush=True)
"""


@pytest.fixture
def running(network, tmp_path):
    options = {"token_file": token_file(tmp_path), "records": str(tmp_path / "records")}
    with console(network, tmp_path, **options) as running:
        yield running


@pytest.fixture
def page(running):
    with page_program(running, f"/ws?t={OPERATOR}") as page:
        page.begin()
        yield page


@pytest.fixture
def record(tmp_path):
    """A record of ten seconds."""
    folder = tmp_path / "records"
    folder.mkdir()
    writer = RecordWriter(folder / "one.mcap")
    for number in range(101):
        data = codec_of(STRING).encode({"data": str(number)})
        writer.add(RecordedMessage(STATE, 10**9 + number * 10**8, 0, number, data))
    writer.finish()
    return "one.mcap"


@pytest.fixture
def recorder(running):
    """A recorder program that records nothing."""
    running.server._records._command[:4] = [sys.executable, "-c", RECORDER]


def asked(page, do):
    page.ask("cardan.records", id=do, do=do)
    return page.next("cardan.records", id=do)


def test_a_record_is_made_from_one_page_and_seen_by_all(running, page, recorder):
    assert asked(page, "list") == {
        "op": "cardan.records", "id": "list", "ended": "", "records": [],
    }  # fmt: skip
    begun = asked(page, "record")["recording"]
    assert begun["name"] == "cardan-20260101-000000.mcap"
    with page_program(running, f"/ws?t={VIEWER}") as other:
        until(lambda: asked(other, "list")["recording"]["messages"] == 7, "its size is told")
        other.ask("cardan.records", id="x", do="finish")
        assert "viewer" in other.next("cardan.refused")["why"]
    page.ask("cardan.records", id="again", do="record")
    assert "already" in page.next("cardan.refused", id="again")["why"]
    ended = asked(page, "finish")
    assert "recording" not in ended
    assert ended["ended"] == "7 messages of 2 topics"
    assert [each["name"] for each in ended["records"]] == [begun["name"]]
    page.ask("cardan.records", id="more", do="finish")
    assert "no record is being made" in page.next("cardan.refused", id="more")["why"]


def test_a_recorder_that_does_not_begin_says_why(running, page):
    complaint = "import sys; sys.exit('cardan: there is no room')"
    running.server._records._command[:4] = [sys.executable, "-c", complaint]
    page.ask("cardan.records", id=1, do="record")
    assert page.next("cardan.refused", id=1)["why"] == "there is no room"
    assert "recording" not in asked(page, "list")


def test_a_record_leaves_the_gateway_its_disk(running, page, recorder, monkeypatch):
    monkeypatch.setattr(module, "LEAST_FREE", 10**18)
    page.ask("cardan.records", id=1, do="record")
    assert "free on the disk" in page.next("cardan.refused", id=1)["why"]
    monkeypatch.setattr(module, "LEAST_FREE", 0)
    asked(page, "record")
    monkeypatch.setattr(module, "LEAST_FREE", 10**18)
    running.loop.call_soon_threadsafe(running.server._records._heard, 'FIGURES {"bytes": 9}')
    until(lambda: "recording" not in asked(page, "list"), "it ends by itself")
    assert "free on the disk" in asked(page, "list")["ended"]


def test_what_is_being_made_ends_with_the_server(network, tmp_path):
    with console(network, tmp_path, records=str(tmp_path / "records")) as running:
        running.server._records._command[:4] = [sys.executable, "-c", RECORDER]
        with page_program(running) as page:
            page.begin()
            asked(page, "record")
        recorder = running.server._records._recorder
    assert recorder.code == 0


def test_a_record_is_shown_to_the_page_that_asks_and_is_not_on_the_bus(
    running, network, record, page
):
    assert [each["name"] for each in asked(page, "list")["records"]] == [record]
    with page_program(running, f"/ws?t={VIEWER}") as other:
        other.ask("cardan.replay", do="open", name=record)
        assert other.next("cardan.replay")["about"]["duration_s"] == 10.0
        page.ask("cardan.replay", do="open", name=record)
        about = page.next("cardan.replay")["about"]
        assert about["topics"] == {STATE.name: [STRING, 101]}
        page.ask("cardan.replay", do="order", topics=[STATE.name], at_s=5.0)
        reported = page.next("cardan.replay")
        assert reported["messages"] == [[STATE.name, {"data": "50"}]]
        assert not reported["playing"]
        page.ask("cardan.replay", do="order", playing=True, rate=16.0)
        while reported["playing"] or reported["at_s"] < 10.0:
            reported = page.next("cardan.replay")
        assert reported["messages"] == [[STATE.name, {"data": "100"}]]
        assert not any(each["op"] == "cardan.replay" for each in other.heard)
    assert STATE.name not in network.topics()
    page.ask("cardan.replay", do="close")
    until(lambda: running.server._records.shown == 0, "both programs have ended")


@pytest.mark.parametrize(
    "name", ["../one.mcap", "/etc/passwd", "two.mcap", "link.mcap", "", None, "one.mcap\n", 5]
)
def test_no_other_file_can_be_asked_for(tmp_path, record, page, name):
    (tmp_path / "records" / "link.mcap").symlink_to(tmp_path / "tokens")
    page.ask("cardan.replay", id=1, do="open", name=name)
    assert "there is no record" in page.next("cardan.refused", id=1)["why"]


def test_a_file_that_is_no_record_is_reported_in_words(tmp_path, record, page):
    (tmp_path / "records" / "bad.mcap").write_bytes(b"nothing")
    page.ask("cardan.replay", do="open", name="bad.mcap")
    assert "is not an MCAP file" in page.next("cardan.replay")["over"]


def test_records_that_are_shown_are_bounded(running, record, page, monkeypatch):
    monkeypatch.setattr(module, "MOST_SHOWN", 1)
    page.ask("cardan.replay", do="open", name=record)
    page.next("cardan.replay")
    with page_program(running, f"/ws?t={OPERATOR}") as other:
        other.ask("cardan.replay", id=1, do="open", name=record)
        assert "shown to pages already" in other.next("cardan.refused", id=1)["why"]
    page.ask("cardan.replay", id=2, do="order", playing="yes", rate="fast")
    assert "rate must be a number" in page.next("cardan.replay")["refused"]
