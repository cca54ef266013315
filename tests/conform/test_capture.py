"""Offline verdicts on captures from other sources."""

from __future__ import annotations

import struct

import pytest

from cardan.cli import app
from cardan.conform import Level, VerdictOutcome, registry
from cardan.conform.report import DOUBTED, read
from cardan.conform.run import captured, save, simulated
from cardan.conform.timeline import Kind, WireTimeline
from cardan.errors import CaptureError, ConfigurationError, ExtraMissingError
from tests.captures import MOTOMAN, require

UNASKED = "no client requested it in this capture"
OF_OUR_OWN = {"ur-rtde": {"UR-003", "UR-007", "UR-015", "UR-027", "UR-103"}}
"""Requirements that only the scenario's second and third client test."""

SOURCE, DESTINATION = 16 + 20, 16 + 22
"""Offsets of the ports in a packet with its record header."""

FAULTS = [
    ("egm", "", set()),
    ("egm", "clock-step", {"EGM-012"}),
    ("egm", "drop", {"EGM-004", "EGM-008"}),
    ("egm-driver", "", set()),
    ("egm-driver", "step-2", {"EGMPC-104"}),
    ("egm-driver", "truncated", {"EGMPC-102", "EGMPC-104"}),
    ("motoros", "", set()),
    ("motoros", "late", {"MOTO-102"}),
    ("motoros", "split", {"MOTO-010"}),
    ("motoros-driver", "", set()),
    ("motoros-driver", "pieces", {"MOTOPC-103"}),
    ("motoros-driver", "no-stop", {"MOTOPC-109"}),
    ("ur-rtde", "", set()),
    ("ur-rtde", "garbage", {"UR-002"}),
    ("ur-rtde", "cut", {"UR-018"}),
    ("joint-stream", "", set()),
    ("joint-stream", "drop", {"JS-103"}),
    ("joint-stream", "garbage", {"JS-102"}),
    ("joint-stream-driver", "", set()),
    ("joint-stream-driver", "clock", {"JSPC-109"}),
    ("joint-stream-driver", "joints", {"JSPC-103"}),
    ("jr3", "", set()),
    ("jr3", "lost-ack", {"JR3-101", "JR3-103"}),
    ("jr3", "unknown-frame", {"JR3-002"}),
]


def recorded(folder, name, faults=None, level=Level.HOLD, seconds=None):
    """The report on a run, and the capture of it that --save writes."""
    suite = registry.load(name)
    report, timeline = simulated(suite, level, faults, seconds=seconds)
    save(folder, suite, report, timeline)
    return report, folder / "capture.pcap"


def verdicts(path, name, target=""):
    report, _ = captured(registry.load(name), path, target)
    return {each.id: each for each in report.results}


def failures(found):
    return {each.id for each in found.values() if each.outcome is VerdictOutcome.FAILED}


@pytest.mark.matrix
@pytest.mark.parametrize(("name", "fault", "failed"), FAULTS)
def test_a_capture_of_a_run_is_judged_as_the_run_was(name, fault, failed, tmp_path):
    suite = registry.load(name)
    faults = suite.faults([fault]) if fault else {}
    faults.update(
        {each: suite.fault_test_values[each] for each in faults if each in suite.fault_test_values}
    )
    report, path = recorded(tmp_path, name, faults)
    found = verdicts(path, name)
    compared = 0
    for each in report.results:
        of_capture = found[each.id]
        if of_capture.said == UNASKED:
            assert of_capture.outcome is VerdictOutcome.NOT_APPLICABLE
        elif each.id in OF_OUR_OWN.get(name, ()):
            assert of_capture.outcome is VerdictOutcome.NOT_SEEN
        elif each.level <= Level.HOLD:
            assert of_capture.outcome is each.outcome, (each, of_capture)
            compared += 1
    assert failures(found) == failed
    assert compared >= 5


def test_the_capture_of_a_right_controller_passes_what_needs_nobody_to_ask(tmp_path):
    _, path = recorded(tmp_path, "motoros", level=Level.LISTEN, seconds=1.0)
    found = verdicts(path, "motoros")
    passed = {each.id for each in found.values() if each.outcome is VerdictOutcome.PASSED}
    assert {"MOTO-002", "MOTO-005", "MOTO-006", "MOTO-009"} <= passed
    assert not failures(found)
    assert found["MOTO-105"].said == UNASKED


def packets_of(path):
    """Return the header of a capture that --save wrote, and its packets with their record
    headers."""
    data = path.read_bytes()
    at, packets = 24, []
    while at < len(data):
        size = struct.unpack_from("<I", data, at + 8)[0]
        packets.append(data[at : at + 16 + size])
        at += 16 + size
    return data[:24], packets


@pytest.fixture
def driver_without_a_stop(tmp_path):
    """Capture of a driver that starts motion without stopping the previous one."""
    return recorded(tmp_path, "motoros-driver", {"no-stop": 1.0})[1]


@pytest.mark.matrix
def test_of_a_connection_without_its_beginning_no_failure_is_judged(driver_without_a_stop):
    path = driver_without_a_stop
    assert failures(verdicts(path, "motoros-driver")) == {"MOTOPC-109"}
    head, packets = packets_of(path)
    path.write_bytes(head + b"".join(each for each in packets if not each[16 + 33] & 0x02))
    found = verdicts(path, "motoros-driver")
    assert not failures(found)
    said = found["MOTOPC-109"].said
    assert said.startswith(f"{DOUBTED}the capture lacks the beginning of a connection; ")
    assert found["MOTOPC-102"].outcome is VerdictOutcome.PASSED
    assert found["MOTOPC-102"].said.endswith(", in what the capture has")


@pytest.mark.matrix
@pytest.mark.parametrize("last", [False, True])
def test_of_a_connection_that_lacks_bytes_no_failure_is_judged(last, driver_without_a_stop):
    path = driver_without_a_stop
    head, packets = packets_of(path)
    if last:
        # The last packet before the close of a connection; nothing follows it.
        end = next(n for n, each in enumerate(packets) if each[16 + 33] & 0x01)
    else:
        end = len(packets) // 2
    del packets[max(n for n, each in enumerate(packets[:end]) if len(each) > 16 + 40)]
    path.write_bytes(head + b"".join(packets))
    found = verdicts(path, "motoros-driver")
    assert not failures(found)
    assert f"{DOUBTED}the capture lacks bytes of a connection" in found["MOTOPC-109"].said


def test_of_datagrams_that_were_cut_no_failure_is_judged(tmp_path):
    _, path = recorded(tmp_path, "joint-stream", {"drop": 0.2}, seconds=0.5)
    assert failures(verdicts(path, "joint-stream")) == {"JS-103"}
    head, packets = packets_of(path)
    time, size, whole = packets[9][:8], *struct.unpack_from("<II", packets[9], 8)
    packets[9] = time + struct.pack("<II", size - 4, whole) + packets[9][16:-4]
    path.write_bytes(head + b"".join(packets))
    found = verdicts(path, "joint-stream")
    assert not failures(found)
    assert f"{DOUBTED}the capture cut some of its datagrams" in found["JS-103"].said


def test_what_a_capture_of_datagrams_begins_with_fails_nothing(tmp_path):
    """The first answer in it may belong to a session that began long before."""
    path = recorded(tmp_path, "joint-stream-driver", seconds=0.5)[1]
    head, packets = packets_of(path)
    path.write_bytes(head + b"".join(packets[40:]))
    found = verdicts(path, "joint-stream-driver")
    assert not failures(found)
    words = "not judged: the capture may begin in the middle of it; "
    assert found["JSPC-101"].said.startswith(words)
    assert found["JSPC-102"].outcome is VerdictOutcome.PASSED


def test_packets_that_the_capturing_program_lost_are_no_failure(tmp_path):
    _, path = recorded(tmp_path, "joint-stream", {"drop": 0.2}, seconds=0.5)
    _, packets = packets_of(path)

    def block(kind, body):
        body += bytes(-len(body) % 4)
        size = struct.pack("<I", 12 + len(body))
        return struct.pack("<I", kind) + size + body + size

    def written(lost):
        nanoseconds = struct.pack("<HHB3xI", 9, 1, 9, 0)
        blocks = [
            block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)),
            block(1, struct.pack("<HHI", 101, 0, 0) + nanoseconds),
        ]
        for each in packets:
            seconds, ns, size, whole = struct.unpack_from("<4I", each)
            time_ns = seconds * 10**9 + ns
            head = struct.pack("<5I", 0, time_ns >> 32, time_ns & 0xFFFFFFFF, size, whole)
            blocks.append(block(6, head + each[16:]))
        blocks.append(block(5, struct.pack("<IIIHHQI", 0, 0, 0, 5, 8, lost, 0)))
        path.write_bytes(b"".join(blocks))
        return verdicts(path, "joint-stream")

    assert failures(written(0)) == {"JS-103"}
    found = written(7)
    assert not failures(found)
    assert f"{DOUBTED}the capturing program lost 7 packets" in found["JS-103"].said


def test_a_request_that_the_end_left_open_is_not_unanswered(tmp_path):
    path = recorded(tmp_path, "motoros", seconds=1.0)[1]
    head, packets = packets_of(path)
    asked = [n for n, each in enumerate(packets) if each[16 + 22 : 16 + 24] == b"\xc4\x40"]
    last = next(n for n in reversed(asked) if len(packets[n]) > 16 + 40)
    path.write_bytes(head + b"".join(packets[: last + 1]))
    assert verdicts(path, "motoros")["MOTO-101"].outcome is VerdictOutcome.PASSED


def test_a_candump_log_is_judged(tmp_path):
    path = recorded(tmp_path, "jr3", {"unknown-frame": 20.0})[1]
    lines = []
    for each in packets_of(path)[1]:
        seconds, ns = struct.unpack_from("<2I", each)
        word, size = struct.unpack_from(">IB", each, 16)
        lines.append(
            f"({seconds + 10**9}.{ns:09}) can0 {word:03X}#{each[24 : 24 + size].hex().upper()}\n"
        )
    log = tmp_path / "board.log"
    log.write_text("".join(lines))
    assert failures(verdicts(log, "jr3")) == failures(verdicts(path, "jr3")) == {"JR3-002"}
    with pytest.raises(ConfigurationError, match=r"board\.log has no frames of it"):
        verdicts(log, "jr3", "can0:99")


def test_a_capture_of_a_real_controller_is_judged():
    """Connections to the state port and the motion port were open before the capture began."""
    path = require(MOTOMAN)
    found = verdicts(path, "motoros")
    assert not failures(found)
    assert found["MOTO-101"].said == "60 requests, in what the capture has"
    found = verdicts(path, "motoros-driver")
    assert not failures(found)
    assert found["MOTOPC-126"].said == "48 busy answers, in what the capture has"
    assert found["MOTOPC-109"].said.startswith(DOUBTED)


def test_a_client_that_asks_for_no_version_of_rtde_has_the_oldest(tmp_path):
    suite = registry.load("ur-rtde")
    report, timeline = simulated(suite, Level.LISTEN, seconds=1.0)
    of_old = [each for each in timeline if each.channel == "rtde-1"]
    version = [n for n, each in enumerate(of_old) if each.data[2:3] == b"V"]
    assert len(version) == 2
    silent = WireTimeline()
    for number, each in enumerate(of_old):
        if number not in version:
            silent.add(each._replace(channel="rtde"))
    save(tmp_path, suite, report, silent)
    found = verdicts(tmp_path / "capture.pcap", "ur-rtde")
    assert not failures(found)
    assert found["UR-002"].outcome is VerdictOutcome.PASSED
    assert found["UR-001"].said == found["UR-004"].said == "it was not asked"
    assert suite.decode(silent).states


def test_of_a_connection_of_rtde_without_its_beginning_the_newest_version_is_read(tmp_path):
    _, path = recorded(tmp_path, "ur-rtde", level=Level.LISTEN, seconds=1.0)
    head, packets = packets_of(path)
    first = packets[0][SOURCE : SOURCE + 4]
    ends = first, first[2:] + first[:2]
    of_it = [n for n, each in enumerate(packets) if each[SOURCE : SOURCE + 4] in ends]
    with_bytes = [n for n in of_it if len(packets[n]) > 16 + 40]
    assert packets[with_bytes[0]][16 + 42 : 16 + 43] == b"V"
    begun = {n for n in of_it if n <= with_bytes[1]}
    path.write_bytes(head + b"".join(p for n, p in enumerate(packets) if n not in begun))
    found = verdicts(path, "ur-rtde")
    assert found["UR-002"].outcome is VerdictOutcome.PASSED
    assert found["UR-005"].said.endswith(", in what the capture has")


def test_a_capture_without_the_flow_says_what_is_there(tmp_path):
    path = recorded(tmp_path, "motoros", seconds=1.0)[1]
    with pytest.raises(ConfigurationError) as raised:
        verdicts(path, "egm")
    assert "capture.pcap has no flow at UDP 6510: there are TCP 192.0.2.2" in str(raised.value)
    with pytest.raises(ConfigurationError, match="no flow at TCP 7000 7001 7002: there are"):
        verdicts(path, "motoros", ":7000")


def test_a_flow_at_another_port_is_found_by_what_it_says_and_judged_by_target(tmp_path):
    _, path = recorded(tmp_path, "egm", level=Level.LISTEN, seconds=1.0)
    head, packets = packets_of(path)
    at = 16 + 22
    moved = [each[:at] + (7777).to_bytes(2, "big") + each[at + 2 :] for each in packets]
    path.write_bytes(head + b"".join(moved))
    with pytest.raises(
        ConfigurationError, match=r"looks like EGM, .*read it with .*--target :7777"
    ):
        verdicts(path, "egm")
    assert verdicts(path, "egm", ":7777")["EGM-002"].outcome is VerdictOutcome.PASSED
    assert verdicts(path, "egm", "192.0.2.1:7777")["EGM-002"].outcome is VerdictOutcome.PASSED
    with pytest.raises(ConfigurationError, match=r"UDP 7777 of 192\.0\.2\.9"):
        verdicts(path, "egm", "192.0.2.9:7777")


def test_of_two_controllers_one_must_be_chosen(tmp_path):
    _, path = recorded(tmp_path, "egm", level=Level.LISTEN, seconds=1.0)
    head, packets = packets_of(path)
    at = 16 + 15
    others = [each[:at] + b"\x07" + each[at + 1 :] for each in packets]
    path.write_bytes(head + b"".join(packets + others))
    with pytest.raises(ConfigurationError, match=r"192\.0\.2\.1, 192\.0\.2\.7: give one as HOST"):
        verdicts(path, "egm")
    assert verdicts(path, "egm", "192.0.2.7")["EGM-010"].outcome is VerdictOutcome.PASSED


def moved(packet, at, value):
    """Return a packet with another port, or with another last byte of an address if given one
    byte."""
    return packet[:at] + value + packet[at + len(value) :]


def at_a_time(packets, others):
    """Interleave the packets of two clients."""
    return b"".join(packet for both in zip(packets, others, strict=True) for packet in both)


def of_two_controllers(folder, port=b"\x12\x34"):
    """Return a capture of one EGM controller, and one with a second controller added behind its
    host."""
    _, path = recorded(folder, "egm", seconds=1.0)
    head, packets = packets_of(path)
    known = registry.load("egm").transport.ports[""].to_bytes(2, "big")
    to_us = [each[DESTINATION : DESTINATION + 2] == known for each in packets]
    others = [
        moved(each, SOURCE if ours else DESTINATION, port)
        for each, ours in zip(packets, to_us, strict=True)
    ]
    return path, head, packets, others


def test_two_controllers_behind_one_host_are_judged_each_by_itself(tmp_path):
    path, head, packets, others = of_two_controllers(tmp_path)
    alone = verdicts(path, "egm")
    path.write_bytes(head + at_a_time(packets, others))
    report, timeline = captured(registry.load("egm"), path)
    found = {each.id: each for each in report.results}
    assert {n: each.outcome for n, each in found.items()} == {
        n: each.outcome for n, each in alone.items()
    }
    assert found["EGM-010"].said.startswith("of 2 clients at a time, host-1:")
    assert len(timeline) == 2 * len(packets)
    again = tmp_path / "again"
    save(again, registry.load("egm"), report, timeline)
    of_saved = verdicts(again / "capture.pcap", "egm")
    assert {n: each.said for n, each in of_saved.items()} == {
        n: each.said for n, each in found.items()
    }


def test_of_two_clients_the_one_that_is_wrong_is_named(tmp_path):
    path, head, packets, others = of_two_controllers(tmp_path)
    known = registry.load("egm").transport.ports[""].to_bytes(2, "big")
    bad = next(n for n in range(len(packets) // 2, len(packets)) if packets[n][38:40] == known)
    others[bad] = others[bad][: 16 + 28] + b"\xff" * (len(others[bad]) - 16 - 28)
    path.write_bytes(head + at_a_time(packets, others))
    found = verdicts(path, "egm")
    assert "EGM-002" in failures(found)
    assert found["EGM-002"].said.startswith("of 2 clients at a time, host-1:4660: ")
    assert f"#{2 * bad + 1} at " in found["EGM-002"].evidence[0]


def test_two_ports_one_after_another_are_one_client(tmp_path):
    path, head, packets, others = of_two_controllers(tmp_path)
    half = len(packets) // 2
    path.write_bytes(head + b"".join(packets[:half] + others[half:]))
    assert failures(verdicts(path, "egm")) == {"EGM-010"}


def test_a_controller_that_sends_from_the_port_that_it_sends_to_is_judged(tmp_path):
    known = registry.load("egm").transport.ports[""].to_bytes(2, "big")
    path, head, _, others = of_two_controllers(tmp_path, known)
    alone = verdicts(path, "egm")
    path.write_bytes(head + b"".join(others))
    assert {n: each.said for n, each in verdicts(path, "egm").items()} == {
        n: each.said for n, each in alone.items()
    }


@pytest.mark.parametrize("name", ["egm", "egm-driver", "joint-stream", "joint-stream-driver"])
def test_a_stray_of_another_host_changes_no_verdict(name, tmp_path, capsys):
    _, path = recorded(tmp_path, name, seconds=0.5)
    alone = verdicts(path, name)
    head, packets = packets_of(path)
    known = next(iter(registry.load(name).transport.ports.values())).to_bytes(2, "big")
    at = next(n for n in range(len(packets) // 2, len(packets)) if packets[n][38:40] == known)
    stray = moved(moved(packets[at], 16 + 15, b"\x09"), SOURCE, b"\x12\x34")
    junk = stray[: 16 + 28] + b"\xff" * (len(stray) - 16 - 28)
    path.write_bytes(head + b"".join([*packets[:at], stray, junk, *packets[at:]]))
    report, timeline = captured(registry.load(name), path)
    assert {each.id: each for each in report.results} == alone
    (words,) = timeline.strays
    assert words.startswith("2 packets between 192.0.2.9 and 192.0.2.")
    assert run(name, "--capture", str(path)) == 0
    assert f"cardan: {words}" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["motoros", "motoros-driver"])
def test_a_port_scan_changes_no_verdict(name, tmp_path):
    _, path = recorded(tmp_path, name, seconds=0.5)
    alone = verdicts(path, name)
    head, packets = packets_of(path)
    opened = [each for each in packets[:3] if each[16 + 33] & 0x02]
    assert len(opened) == 2
    # A complete connection that stays open, before the client's own.
    scan = [
        moved(opened[0], 16 + 15, b"\x09"),
        moved(opened[1], 16 + 19, b"\x09"),
    ]
    path.write_bytes(head + b"".join(scan + packets))
    report, timeline = captured(registry.load(name), path)
    assert {each.id: each for each in report.results} == alone
    assert len(timeline.strays) == 1
    assert "2 packets between 192.0.2.9 and " in timeline.strays[0]


@pytest.mark.parametrize("name", ["motoros", "joint-stream", "jr3"])
def test_of_a_truncated_capture_the_whole_packets_are_judged(name, tmp_path, capsys):
    path = recorded(tmp_path, name, seconds=1.0)[1]
    head, packets = packets_of(path)
    path.write_bytes(head + b"".join(packets[:-1]))
    whole = verdicts(path, name)
    path.write_bytes(head + b"".join(packets)[:-3])
    where = f"truncated: the file ends inside a packet after packet {len(packets) - 1}"
    report, timeline = captured(registry.load(name), path)
    assert timeline.strays == (f"{where}; the rest is not read",)
    for each in report.results:
        before = whole[each.id]
        if before.outcome is VerdictOutcome.FAILED:
            assert each.outcome is VerdictOutcome.NOT_SEEN
            assert each.said.startswith(f"{DOUBTED}{where}; ")
        elif before.outcome is VerdictOutcome.PASSED:
            assert each.said == f"{before.said}, in what the capture has"
    assert any(each.outcome is VerdictOutcome.PASSED for each in report.results)


def test_a_failure_in_a_truncated_capture_is_doubted(tmp_path, capsys):
    path = recorded(tmp_path, "joint-stream", {"drop": 0.2}, seconds=0.5)[1]
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(SystemExit) as ended:
        app(["conform", "joint-stream", "--capture", str(path)])
    assert ended.value.code == 4
    said = capsys.readouterr()
    assert f"{DOUBTED}truncated: the file ends inside a packet after packet " in said.out
    assert "; the rest is not read" in said.err


def test_damaged_files_are_named(tmp_path):
    path = recorded(tmp_path, "motoros", seconds=1.0)[1]
    data = path.read_bytes()
    for content, why in ((data[:30], "truncated"), (b"", "empty"), (b"nothing!", "not a pcap")):
        path.write_bytes(content)
        with pytest.raises(CaptureError, match=rf"capture\.pcap: .*{why}"):
            verdicts(path, "motoros")
    path.write_bytes(data[:24])
    with pytest.raises(CaptureError, match=r"capture\.pcap: it has no packets"):
        verdicts(path, "motoros")
    with pytest.raises(CaptureError, match=r"gone\.pcap: there is no such file"):
        verdicts(tmp_path / "gone.pcap", "motoros")


def of_usb(path, timeline, devices=(5,)):
    """Write the reports of a timeline in usbmon's format, for each of these devices."""

    def urb(data, device, *, event=b"C", transfer=1, endpoint=0x81, setup=b"", number=1):
        head = struct.pack("<QcBBBHBB", number, event, transfer, endpoint, device, 1, not setup, 0)
        sizes = struct.pack("<qiiII8s", 0, 0, 0, len(data), len(data), setup)
        return (head + sizes).ljust(64, b"\0") + data

    model = next(each.note for each in timeline if each.kind is Kind.OPENED)
    ids = struct.pack("<HH", *(int(each, 16) for each in model.split(":")))
    asks, control = b"\x80\x06\x00\x01\x00\x00\x12\x00", {"transfer": 2, "endpoint": 0x80}
    records = []
    for device in devices:
        description = b"\x12\x01\x00\x02\0\0\0\x08" + ids + bytes(6)
        records.append((0.0, urb(b"", device, event=b"S", setup=asks, number=device, **control)))
        records.append((0.0, urb(description, device, number=device, **control)))
    for each in timeline:
        if each.kind is Kind.DATA and not each.sent:
            records += [(each.time_s, urb(each.data, device)) for device in devices]
    parts = [struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 262_144, 220)]
    for time_s, record in records:
        seconds, ns = divmod(10**18 + round(time_s * 1e9), 10**9)
        parts.append(struct.pack("<IIII", seconds, ns, len(record), len(record)) + record)
    path.write_bytes(b"".join(parts))


@pytest.mark.parametrize(("fault", "failed"), [("", set()), ("short-report", {"HID3D-004"})])
def test_a_capture_of_a_device_on_usb_is_judged_as_the_run_was(fault, failed, tmp_path):
    suite = registry.load("3dconnexion")
    report, timeline = simulated(suite, Level.LISTEN, suite.faults([fault] if fault else []))
    path = tmp_path / "usb.pcap"
    of_usb(path, timeline)
    found = verdicts(path, "3dconnexion")
    compared = 0
    for each in report.results:
        if each.level == Level.LISTEN and found[each.id].said != UNASKED:
            assert found[each.id].outcome is each.outcome, (each, found[each.id])
            compared += 1
    assert compared >= 5
    assert failures(found) == failed


def test_of_two_devices_on_usb_one_must_be_chosen(tmp_path):
    _, timeline = simulated(registry.load("3dconnexion"), Level.LISTEN)
    path = tmp_path / "usb.pcap"
    of_usb(path, timeline, (5, 7))
    with pytest.raises(ConfigurationError, match=r"give one of USB 1\.5, USB 1\.7"):
        verdicts(path, "3dconnexion")
    assert not failures(verdicts(path, "3dconnexion", "USB 1.7"))
    with pytest.raises(ConfigurationError, match=r"no reports of USB 1\.9 from the device in "):
        verdicts(path, "3dconnexion", "USB 1.9")
    of_network = recorded(tmp_path, "egm", level=Level.LISTEN, seconds=0.5)[1]
    with pytest.raises(ConfigurationError, match="no reports from the device in "):
        verdicts(of_network, "3dconnexion")


def test_a_protocol_without_packets_has_no_capture(tmp_path):
    with pytest.raises(
        ConfigurationError, match=r"magellan has no packets of a network: .*; pcap and"
    ):
        verdicts(tmp_path / "any.pcap", "magellan")


def test_without_the_plug_in_it_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr("cardan.conform.run.entry_points", lambda group: [])
    with pytest.raises(ExtraMissingError, match=r"cardan\[dissect\]"):
        verdicts(tmp_path / "any.pcap", "egm")


def run(*words):
    """Run the command in this process; return its exit code."""
    try:
        return app(["conform", *words], standalone_mode=False) or 0
    except SystemExit as raised:
        return raised.code


def test_the_command_reports_in_every_form_and_keeps_it(tmp_path, capsys):
    path = str(recorded(tmp_path, "joint-stream", {"drop": 0.2}, seconds=0.5)[1])
    words = ["joint-stream", "--capture", path]
    assert run(*words) == 4
    assert "FAIL JS-103" in capsys.readouterr().out
    for form, said in (("markdown", "| JS-103 | failed |"), ("junit", "<failure message=")):
        assert run(*words, "--format", form) == 4
        assert said in capsys.readouterr().out
    folder = tmp_path / "kept"
    assert run(*words, "--format", "json", "--save", str(folder)) == 4
    report = read(capsys.readouterr().out, "the report")
    assert (report.target, report.simulated, report.failed) == ("capture.pcap", False, ("JS-103",))
    # The saved capture has the times of the judged one.
    assert (
        packets_of(folder / "capture.pcap")[1][0][:8]
        == packets_of(tmp_path / "capture.pcap")[1][0][:8]
    )


def test_what_a_capture_only_makes_likely_is_no_success(tmp_path, capsys):
    _, path = recorded(tmp_path, "joint-stream", {"drop": 0.2}, seconds=0.5)
    head, packets = packets_of(path)
    time, size, whole = packets[9][:8], *struct.unpack_from("<II", packets[9], 8)
    packets[9] = time + struct.pack("<II", size - 4, whole) + packets[9][16:-4]
    path.write_bytes(head + b"".join(packets))
    assert run("joint-stream", "--capture", str(path)) == 4
    raised = capsys.readouterr()
    assert "0 failed" in raised.out
    assert "cardan: JS-103: perhaps not met, but the capture does not show it" in raised.err


def test_a_capture_without_the_side_that_is_judged_is_refused(tmp_path):
    _, path = recorded(tmp_path, "joint-stream", {}, seconds=0.5)
    head, packets = packets_of(path)
    port = registry.load("joint-stream").transport.ports[""].to_bytes(2, "big")
    path.write_bytes(head + b"".join(each for each in packets if each[16 + 22 : 16 + 24] == port))
    with pytest.raises(ConfigurationError, match=r"has nothing of .*, only what it was sent"):
        run("joint-stream", "--capture", str(path))


@pytest.mark.parametrize(
    "more",
    [
        ["--fault", "drop"],
        ["--level", "0"],
        ["--seconds", "1"],
        ["--seed", "0"],
        ["--yes"],
        ["--i-am-at-the-enable-switch"],
    ],
)
def test_a_capture_is_judged_as_it_is(more, tmp_path):
    words = f"checked as it is, and nothing is run: leave {more[0]} out"
    with pytest.raises(ConfigurationError, match=words):
        run("egm", "--capture", str(tmp_path / "a.pcap"), *more)


@pytest.mark.parametrize("more", [["--list"], ["--requirements"], ["--compare", "a", "b"]])
def test_what_prints_and_ends_is_refused_beside_a_capture(more, tmp_path, capsys):
    words = f"nothing is checked with {more[0]}, which prints and ends: give one alone"
    with pytest.raises(ConfigurationError, match=words):
        run("egm", "--capture", str(tmp_path / "a.pcap"), *more)
    assert not capsys.readouterr().out


def test_a_capture_that_is_refused_leaves_no_folder(tmp_path):
    folder = tmp_path / "new" / "report"
    with pytest.raises(CaptureError, match="there is no such file"):
        run("egm", "--capture", str(tmp_path / "gone.pcap"), "--save", str(folder))
    with pytest.raises(ConfigurationError, match="leave --seed out"):
        run("egm", "--capture", "any.pcap", "--seed", "3", "--save", str(folder))
    assert not folder.parent.exists()
