"""Attachments of a conformance report: a capture for dissectors, and a record with every byte."""

from __future__ import annotations

import io
import json

import pytest

from cardan.conform import Kind, Level, WireEvent, WireTimeline, registry
from cardan.conform.attachments import pcap
from cardan.conform.report import check_timeline
from cardan.conform.run import captured, save, simulated
from cardan.errors import CaptureError, ConfigurationError
from cardan.recording.mcap_file import RecordWriter
from cardan_dissect import dissect_file


@pytest.mark.parametrize(("suite", "said"), [("motoros", "ROBOT_STATUS"), ("egm", "EgmRobot")])
def test_the_capture_is_dissected_without_a_remark_of_damage(suite, said, tmp_path):
    found = registry.load(suite)
    report, timeline = simulated(found, Level.LISTEN, seconds=1.0)
    save(tmp_path, found, report, timeline)
    out = io.StringIO()
    dissect_file(tmp_path / "capture.pcap", out, summary=False)
    text = out.getvalue()
    assert said in text
    assert ", 0 malformed; 0 others" in text
    assert "192.0.2.1" in text


def test_tcp_of_the_capture_is_whole(tmp_path):
    from scapy.layers.inet import IP, TCP
    from scapy.utils import rdpcap

    found = registry.load("motoros")
    report, timeline = simulated(found, Level.HOLD, seconds=1.0)
    save(tmp_path, found, report, timeline)
    packets = rdpcap(str(tmp_path / "capture.pcap"))
    sent = b"".join(bytes(p[TCP].payload) for p in packets if p[TCP].dport == 50240)
    asked = b"".join(e.data for e in timeline if e.sent and e.channel == "motion")
    assert sent == asked != b""
    for packet in packets[:50]:
        checked = IP(bytes(packet))
        sums = checked.chksum, checked[TCP].chksum
        del checked.chksum, checked[TCP].chksum
        again = IP(bytes(checked))
        assert (again.chksum, again[TCP].chksum) == sums


@pytest.mark.matrix
def test_a_client_of_ours_begins_its_connections_in_the_capture(tmp_path):
    from scapy.layers.inet import TCP
    from scapy.utils import rdpcap

    found = registry.load("motoros-driver")
    report, timeline = simulated(found, Level.HOLD)
    save(tmp_path, found, report, timeline)
    packets = rdpcap(str(tmp_path / "capture.pcap"))
    first = {}
    for packet in packets:
        port = min(packet[TCP].sport, packet[TCP].dport), max(packet[TCP].sport, packet[TCP].dport)
        first.setdefault(port, packet)
    clients = [e for e in timeline if e.kind is Kind.OPENED and " " in e.channel]
    # No two connections share their ports, and each begins with the client's SYN.
    assert len(first) == len(clients)
    assert {(p["IP"].src, str(p[TCP].flags)) for p in first.values()} == {("192.0.2.1", "S")}
    assert {p[TCP].dport for p in first.values()} == {50240, 50241}


def test_the_record_has_every_event(tmp_path):
    from mcap.reader import make_reader

    found = registry.load("3dconnexion")
    report, timeline = simulated(found, Level.HOLD)
    report, missing = save(tmp_path, found, report, timeline)
    assert missing == ["capture.pcap: the protocol has no packets of a network"]
    with (tmp_path / "record.mcap").open("rb") as file:
        messages = [
            (channel.topic, message.data)
            for _, channel, message in make_reader(file).iter_messages()
        ]
    assert len(messages) == len(timeline)
    came = [data for topic, data in messages if topic == "/3dconnexion/from"]
    assert came == [e.data for e in timeline if e.kind is Kind.DATA and not e.sent]
    assert ("/3dconnexion/events", b"mark push") in messages
    stored = json.loads((tmp_path / "report.json").read_text())
    assert [*stored["attached"]] == ["record.mcap"]
    assert {each.name for each in tmp_path.iterdir()} == {
        "record.mcap",
        "report.json",
        "report.md",
        "report.txt",
        "report.xml",
    }


def test_a_simulated_run_saved_twice_gives_the_same_bytes(tmp_path):
    found = registry.load("motoros")
    for name in "ab":
        save(tmp_path / name, found, *simulated(found, Level.LISTEN, seconds=1.0))
    for each in ("capture.pcap", "report.json", "report.md"):
        assert (tmp_path / "a" / each).read_bytes() == (tmp_path / "b" / each).read_bytes()


def test_real_addresses_do_not_get_into_a_capture():
    timeline = WireTimeline()
    timeline.add(WireEvent(0.5, Kind.DATA, False, "", b"\x01", "10.9.8.7:49000"))
    data = pcap(registry.load("egm"), timeline, 0)
    assert bytes((10, 9, 8, 7)) not in data
    assert (49000).to_bytes(2, "big") in data


def results(report):
    return [(each.id, each.outcome, each.said) for each in report.results]


@pytest.mark.parametrize(
    ("suite", "level", "fault"),
    [
        ("egm", Level.MOVE, {}),
        ("motoros", Level.HOLD, {"stale-reply": 1.0}),
        ("3dconnexion", Level.HOLD, {}),
        ("egm-driver", Level.HOLD, {}),
    ],
)
def test_a_kept_record_is_judged_as_its_run_was(suite, level, fault, tmp_path):
    found = registry.load(suite)
    report, timeline = simulated(found, level, fault, seconds=1.0)
    timeline.record_lateness(0.25)
    save(tmp_path, found, report, timeline)
    again, read = captured(found, tmp_path / "record.mcap")
    assert [e._replace(time_s=0.0) for e in read] == [
        found.redacted(e)._replace(time_s=0.0) for e in timeline
    ]
    assert [e.time_s for e in read] == pytest.approx([e.time_s for e in timeline], abs=1e-9)
    assert (read.late_s, again.level, read.strays) == (0.25, int(level), ())
    assert results(again) == results(check_timeline(found, timeline, level))
    assert len(report.failed) >= len(fault)


def test_a_record_that_is_of_something_else_is_not_judged(tmp_path):
    found = registry.load("3dconnexion")
    save(tmp_path, found, *simulated(found, Level.LISTEN, seconds=1.0))
    path = tmp_path / "record.mcap"
    with pytest.raises(CaptureError, match="is of 3dconnexion: check it by `cardan conform` of"):
        captured(registry.load("egm"), path)
    with pytest.raises(ConfigurationError, match="one target: leave it out"):
        captured(found, path, "192.0.2.1")
    of_a_session = RecordWriter(tmp_path / "session.mcap")
    of_a_session.finish()
    with pytest.raises(CaptureError, match=r"no recorded traffic: only a record\.mcap of --save"):
        captured(found, tmp_path / "session.mcap")


def test_of_a_damaged_record_it_is_said_what_is_missing(tmp_path):
    found = registry.load("3dconnexion")
    save(tmp_path, found, *simulated(found, Level.LISTEN, seconds=1.0))
    path = tmp_path / "record.mcap"
    path.write_bytes(path.read_bytes()[:-40])
    _, timeline = captured(found, path)
    assert "the file ends early" in timeline.strays[0]
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(CaptureError):
        captured(found, path)
