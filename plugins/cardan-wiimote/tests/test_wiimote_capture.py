"""Wii Remotes in Bluetooth captures: channels, recognition, memory reads, figures."""

import io
import struct

import pytest
from scapy.layers.bluetooth import (
    HCI_Event_Hdr,
    HCI_Hdr,
    L2CAP_CmdHdr,
    L2CAP_ConnReq,
    L2CAP_ConnResp,
    L2CAP_DisconnReq,
    L2CAP_Hdr,
)
from scapy.packet import Raw
from scapy.utils import RawPcapWriter

from cardan.conform import Level, registry
from cardan.conform.run import captured, simulated
from cardan.conform.timeline import Kind
from cardan.errors import CaptureError, ConfigurationError
from cardan_dissect import dissect_file
from cardan_dissect.capture import Capture

HANDLE = 0x0B
ADDRESS = bytes.fromhex("001f32abcdef")
HOST_CONTROL, HOST_INTERRUPT, REMOTE_CONTROL, REMOTE_INTERRUPT = 0x40, 0x41, 0x41, 0x40
"""Channel ids of one side may equal those of the other side's other channel, as here."""


def acl(payload, handle=HANDLE, boundary=2):
    data = bytes(payload)
    # Packed by hand, because scapy's names of these fields differ between versions.
    return struct.pack("<BHH", 2, handle | boundary << 12, len(data)) + data


def on(cid, data, handle=HANDLE):
    return acl(L2CAP_Hdr(cid=cid) / Raw(data), handle)


def signal(command, code, number):
    return acl(L2CAP_Hdr(cid=1) / L2CAP_CmdHdr(code=code, id=number) / command)


def set_up(psm, host_cid, remote_cid, number):
    """Return the packets with which the host opens a channel."""
    return [
        (False, signal(L2CAP_ConnReq(psm=psm, scid=host_cid), 2, number)),
        (True, signal(L2CAP_ConnResp(dcid=remote_cid, scid=host_cid, result=1), 3, number)),
        (True, signal(L2CAP_ConnResp(dcid=remote_cid, scid=host_cid, result=0), 3, number)),
    ]


def both_channels():
    return [
        *set_up(0x11, HOST_CONTROL, REMOTE_CONTROL, 1),
        *set_up(0x13, HOST_INTERRUPT, REMOTE_INTERRUPT, 2),
    ]


def event(code, values):
    return bytes(HCI_Hdr(type=4) / HCI_Event_Hdr(code=code) / Raw(values))


CONNECTED = (
    True,
    event(3, struct.pack("<BH6sBB", 0, HANDLE, ADDRESS[::-1], 1, 0)),
)
NAMED = (True, event(7, b"\0" + ADDRESS[::-1] + b"Nintendo RVL-CNT-01".ljust(248, b"\0")))
DISCONNECTED = (True, event(5, struct.pack("<BHB", 0, HANDLE, 0x13)))


def interrupt_in(text, cid=HOST_INTERRUPT):
    return True, on(cid, b"\xa1" + bytes.fromhex(text))


def interrupt_out(text, cid=REMOTE_INTERRUPT):
    return False, on(cid, b"\xa2" + bytes.fromhex(text))


@pytest.mark.parametrize("fault", ["", "short-report"])
def test_a_capture_of_a_remote_is_judged_as_the_run_was(fault, tmp_path):
    suite = registry.load("wiimote")
    report, timeline = simulated(suite, Level.HOLD, suite.faults([fault] if fault else []))
    path = tmp_path / "radio.pcap"
    writer = RawPcapWriter(str(path), linktype=201)
    writer.write_header(b"")
    begun = [(0.0, *each) for each in (CONNECTED, NAMED, *both_channels())]
    reports = [
        (each.time_s, *(interrupt_out if each.sent else interrupt_in)(each.data.hex()))
        for each in timeline
        if each.kind is Kind.DATA
    ]
    for time_s, to_host, packet in begun + reports:
        seconds, us = divmod(round(time_s * 1e6), 10**6)
        packet = struct.pack("!I", to_host) + packet
        writer.write_packet(packet, sec=1_700_000_000 + seconds, usec=us)
    writer.close()
    found, _ = captured(suite, path)
    compared = 0
    for of_run, each in zip(report.results, found.results, strict=True):
        unasked = each.said == "no client requested it in this capture"
        if of_run.level <= Level.HOLD and not unasked:
            assert each.outcome is of_run.outcome, (of_run, each)
            compared += 1
    assert compared >= 5
    assert bool(found.failed) == bool(fault)
    with pytest.raises(ConfigurationError, match="there are those of Wiimote 00:1f:32:ab:cd:ef"):
        captured(suite, path, "Wiimote 00:00:00:00:00:00")


H1, H4, MONITOR = 1001, 1002, 2001
SECOND_ADAPTER = 1 << 16


def in_btsnoop(datalink, to_host, packet):
    """Return a packet's flags and bytes in such a log."""
    kind = packet[0]
    if datalink == MONITOR:
        return SECOND_ADAPTER | (3 if kind == 4 else 5 if to_host else 4), packet[1:]
    return to_host | (kind == 4) << 1, packet[datalink == H1 :]


def btsnoop(datalink, records):
    """Return a log of (flags, bytes), 10 ms apart, with 3 packets lost before the last one."""
    log = b"btsnoop\0" + struct.pack(">II", 1, datalink)
    for number, (flags, data) in enumerate(records):
        lost = 3 * (number == len(records) - 1)
        since_2000_us = (1_700_000_000 - 946_684_800) * 10**6 + 10_000 * number
        time_us = 0x00E03AB44A676000 + since_2000_us
        log += struct.pack(">IIIIq", len(data), len(data), flags, lost, time_us) + data
    return log


@pytest.mark.parametrize("datalink", [H1, H4, MONITOR])
def test_a_btsnoop_log_is_read_as_the_capture_of_the_same_packets(dissected, tmp_path, datalink):
    packets = [
        CONNECTED,
        NAMED,
        *both_channels(),
        interrupt_out("11 10"),
        interrupt_in("31 60 48 91 82 9c"),
        interrupt_in("31 60 4c 84 82 9f"),
    ]
    _, shown, lines = dissected(packets)
    path = tmp_path / "btsnoop_hci.log"
    log = btsnoop(datalink, [in_btsnoop(datalink, *each) for each in packets])
    path.write_bytes(log)
    out = io.StringIO()
    dissect_file(path, out)
    found = out.getvalue().splitlines()
    assert [each for each in found if "lost" not in each] == lines
    assert len(shown) == 3
    assert any("3 packets" in each for each in found if "lost" in each)
    (first, *_) = Capture(path)
    assert first.time_ns == 1_700_000_000 * 10**9
    path.write_bytes(log[:-3])
    with pytest.raises(CaptureError, match=f"ends inside a packet after packet {len(packets) - 1}"):
        dissect_file(path, io.StringIO())


def test_what_a_monitor_says_of_its_adapters_is_no_packet_of_the_radio(tmp_path):
    path = tmp_path / "btmon.log"
    opened = SECOND_ADAPTER | 8, b""
    path.write_bytes(btsnoop(MONITOR, [opened, in_btsnoop(MONITOR, *interrupt_in("30 00 08"))]))
    out = io.StringIO()
    counts = dissect_file(path, out)
    assert counts.messages["Wiimote"] == 1
    assert "other packets: Bluetooth monitor x1" in out.getvalue()


@pytest.mark.parametrize(("version", "datalink"), [(2, H4), (1, 1003)])
def test_another_log_of_that_name_is_refused(tmp_path, version, datalink):
    path = tmp_path / "other.log"
    path.write_bytes(b"btsnoop\0" + struct.pack(">II", version, datalink))
    with pytest.raises(CaptureError, match=f"of version {version} and datalink type {datalink} is"):
        dissect_file(path, io.StringIO())


@pytest.fixture
def dissected(tmp_path):
    def run(packets, link_type=201, **options):
        path = tmp_path / "capture.pcap"
        writer = RawPcapWriter(str(path), linktype=link_type)
        writer.write_header(b"")
        for number, (to_host, packet) in enumerate(packets):
            if link_type == 201:
                packet = struct.pack("!I", to_host) + packet
            writer.write_packet(packet, sec=1_700_000_000, usec=10_000 * number)
        writer.close()
        out = io.StringIO()
        counts = dissect_file(path, out, **options)
        lines = out.getvalue().splitlines()
        return counts, [line.split(" ", 2)[2] for line in lines if line.startswith("#")], lines

    return run


def test_a_session_with_its_set_up(dissected):
    packets = [
        CONNECTED,
        NAMED,
        *both_channels(),
        interrupt_out("11 10"),
        (False, on(REMOTE_CONTROL, bytes.fromhex("52 12 04 31"))),
        (True, on(HOST_CONTROL, b"\0")),
        interrupt_in("31 60 48 91 82 9c"),
        interrupt_in("31 60 4c 84 82 9f"),
        interrupt_in("20 00 08 12 00 00 c0"),
        interrupt_out("15 00"),
    ]
    counts, shown, lines = dissected(packets)
    where = "Wiimote 00:1f:32:ab:cd:ef"
    assert shown == [
        f"{where} interrupt OUT Leds | leds 1 | ack False | rumble False",
        f"{where} control OUT DataMode | mode 49 | continuous True | ack False | rumble False",
        f"{where} control IN HID transaction 00",
        f"{where} interrupt IN Data | mode 49 | buttons 2048 | accelerometer 583 520 626 | "
        "ir (none) | extension (none)",
        f"{where} interrupt IN Data | mode 49 | buttons 3072 | accelerometer 531 520 638 | "
        "ir (none) | extension (none)",
        f"{where} interrupt IN Status | buttons 2048 | battery_low False | extension True | "
        "speaker False | ir False | leds 1 | battery 192",
        f"{where} interrupt OUT StatusRequest | rumble False",
    ]
    assert (
        lines[-12:]
        == [
            f"Wiimote {where} interrupt OUT: Nintendo RVL-CNT-01",
            "  2 messages",
            "  Leds x1",
            "  StatusRequest x1",
            f"Wiimote {where} control OUT: Nintendo RVL-CNT-01",
            "  1 messages",
            "  DataMode x1",
            f"Wiimote {where} interrupt IN: Nintendo RVL-CNT-01",
            "  3 messages",
            "  Data x2, period mean 10.000 min 10.000 max 10.000 ms",
            "  Status x1",
            "15 packets: 6 Wiimote, 0 malformed; 8 others",
            "other packets: Bluetooth x8",
        ][1:]
    )
    assert counts.messages["Wiimote"] == 6
    assert counts.malformed["Wiimote"] == 0


@pytest.mark.parametrize("link_type", [187, 201])
def test_without_the_set_up_the_header_byte_tells(dissected, link_type):
    packets = [
        (True, on(0x70, bytes.fromhex("06 00 01 00 02 35 03"))),  # of a different channel
        interrupt_in("30 00 08", cid=0x77),
        (False, on(0x78, bytes.fromhex("52 11 21"))),
        interrupt_out("10 00", cid=0x79),
        (True, on(0x70, bytes.fromhex("a1"))),
    ]
    counts, shown, _ = dissected(packets, link_type)
    assert shown == [
        "Wiimote handle 0x000b interrupt IN Data | mode 48 | buttons 2048 | "
        "ir (none) | extension (none)",
        "Wiimote handle 0x000b control OUT Leds | leds 2 | ack False | rumble True",
        "Wiimote handle 0x000b interrupt OUT Rumble | rumble False",
        "Wiimote handle 0x000b interrupt IN MALFORMED report: empty (0 B: )",
    ]
    assert counts.malformed["Wiimote"] == 1
    assert counts.other_packets == 1


def test_without_directions_a_number_of_both_sides_tells_nothing(dissected):
    packets = [
        *both_channels(),
        interrupt_out("10 00"),
        (False, on(REMOTE_CONTROL, bytes.fromhex("52 11 21"))),
        interrupt_in("30 00 08"),
        *set_up(0x01, 0x50, 0x51, 3),
        interrupt_in("30 00 08", cid=0x51),  # service discovery, by its PSM
    ]
    _, shown, _ = dissected(packets, 187)
    assert [line.split()[3:5] for line in shown] == [
        ["interrupt", "OUT"],
        ["control", "OUT"],
        ["interrupt", "IN"],
    ]


def test_set_up_by_the_remote_and_other_protocols_on_its_link(dissected):
    packets = [
        (True, signal(L2CAP_ConnReq(psm=0x13, scid=0x51), 2, 1)),
        (False, signal(L2CAP_ConnResp(dcid=0x61, scid=0x51, result=0), 3, 1)),
        (True, signal(L2CAP_ConnReq(psm=0x01, scid=0x52), 2, 2)),
        (False, signal(L2CAP_ConnResp(dcid=0x62, scid=0x52, result=0), 3, 2)),
        interrupt_in("30 00 08", cid=0x61),
        interrupt_in("30 00 08", cid=0x62),  # service discovery, by its PSM
        interrupt_out("10 01", cid=0x51),
        (False, signal(L2CAP_DisconnReq(dcid=0x51, scid=0x61), 6, 3)),
        interrupt_in("30 00 00", cid=0x61),  # by its header byte
    ]
    _, shown, _ = dissected(packets)
    assert shown == [
        "Wiimote handle 0x000b interrupt IN Data | mode 48 | buttons 2048 | "
        "ir (none) | extension (none)",
        "Wiimote handle 0x000b interrupt OUT Rumble | rumble True",
        "Wiimote handle 0x000b interrupt IN Data | mode 48 | buttons 0 | "
        "ir (none) | extension (none)",
    ]


def test_other_devices_are_left_alone(dissected):
    packets = [
        *both_channels(),
        interrupt_in("01 00 00 04 00 00 00 00 00"),  # a keyboard
        interrupt_in("11 " + "00" * 78),  # a game pad
        interrupt_in("30 " + "00" * 48),  # another of the same maker
    ]
    counts, shown, lines = dissected(packets)
    assert shown == []
    assert counts.messages["Wiimote"] == 0
    assert "Wiimote traffic found in 9 packets" in lines[1]
    other_name = (True, event(7, b"\0" + ADDRESS[::-1] + b"Keyboard".ljust(248, b"\0")))
    _, shown, _ = dissected([CONNECTED, other_name, interrupt_in("30 00 08")])
    assert shown == []


def test_memory_is_shown_as_it_is_read_and_written(dissected):
    block = "84 82 86 30 9f 9d 9f 02 40 2e"
    packets = [
        *both_channels(),
        interrupt_out("17 00 00 00 16 00 14"),
        interrupt_in(f"21 00 00 f0 00 16 {block} 84 82 86 30 9f 9d"),
        interrupt_in("21 00 00 30 00 26 9f 02 40 2e" + " 00" * 12),
        interrupt_in("32 00 00 80 c0 80 7f b5 e5 00 00"),
        interrupt_out("16 04 a4 00 f0 01 55" + " 00" * 15),
        interrupt_in("22 00 00 16 00"),
        interrupt_out("17 04 a4 00 fa 00 06"),
        interrupt_in("21 00 00 50 00 fa 00 00 a4 20 00 00" + " 00" * 10),
        interrupt_in("32 00 00 80 c0 80 7f b5 e5 00 00"),
        interrupt_in("20 00 00 00 00 00 c0"),
        interrupt_in("32 00 00 80 c0 80 7f b5 e5 00 00"),
        interrupt_out("17 04 a6 00 fa 00 06"),
        interrupt_in("21 00 00 f7 00 fa" + " 00" * 16),
        interrupt_in("21 00 00 50 00 fa" + " 00" * 16),
        interrupt_out("17 04 a6 00 20 00 20"),
        interrupt_in("21 00 00 f0 00 40" + " 00" * 16),
    ]
    _, shown, lines = dissected(packets)
    texts = [line.split(" IN ", 1)[1] for line in shown if " IN " in line]
    head = "ReadData | buttons 0 | error 0 | address"
    assert texts[0] == f"{head} 22 | data {block} 84 82 86 30 9f 9d"
    assert texts[1] == f"{head} 38 | data 9f 02 40 2e"
    assert texts[2].endswith("ir (none) | extension 80 c0 80 7f b5 e5 00 00")
    assert texts[3] == "Ack | buttons 0 | report_id 22 | error 0"
    assert texts[4] == f"{head} 250 | data 00 00 a4 20 00 00"
    assert texts[8] == "ReadData | buttons 0 | error 7 | address 250 | data (none)"
    asked = [line.split(" OUT ", 1)[1] for line in shown if " OUT " in line]
    assert asked[0] == "ReadMemory | address 22 | size 20 | space 0 | rumble False"
    assert asked[1] == "WriteMemory | address 10748144 | data 55 | space 1 | rumble False"
    assert any(line.startswith("  ReadData x6, period mean") for line in lines)


def test_connections_end_and_handles_are_used_again(dissected):
    packets = [
        CONNECTED,
        *both_channels(),
        interrupt_in("30 00 08"),
        DISCONNECTED,
        interrupt_in("01 00 00"),  # of another device
        interrupt_in("30 00 00", cid=0x50),
    ]
    _, shown, lines = dissected(packets)
    assert [line.split(" ")[1] for line in shown] == ["00:1f:32:ab:cd:ef", "handle"]
    assert "Wiimote Wiimote 00:1f:32:ab:cd:ef interrupt IN" in lines
    assert "Wiimote Wiimote handle 0x000b interrupt IN" in lines


def test_fragments_damage_and_unknown_reports(dissected):
    whole = on(HOST_INTERRUPT, bytes.fromhex("a1 31 60 48 91 82 9c"))[5:]
    rest = struct.pack("<BHH", 2, HANDLE | 1 << 12, len(whole) - 6) + whole[6:]
    packets = [
        *both_channels(),
        (True, rest),  # without its start
        (True, struct.pack("<BHH", 2, HANDLE | 2 << 12, 6) + whole[:6]),
        (True, rest),
        interrupt_in("31 60 48"),
        interrupt_in("2a 01"),
        (True, on(HOST_CONTROL, b"\x15")),
        (True, b""),
        (True, b"\x02\x0b"),
        (True, b"\x04\x03\x0b\x00"),
    ]
    counts, shown, lines = dissected(packets)
    where = "Wiimote handle 0x000b"
    assert shown == [
        f"{where} interrupt IN Data | mode 49 | buttons 2048 | accelerometer 583 520 626 | "
        "ir (none) | extension (none)",
        f"{where} interrupt IN MALFORMED report: 0x31 too short: 3 bytes (3 B: 31 60 48)",
        f"{where} interrupt IN report 0x2a of an unknown id | data 01",
        f"{where} control IN HID transaction 15",
    ]
    assert counts.malformed["Wiimote"] == 1
    assert "  report 0x2a of an unknown id x1" in lines


def test_summary_and_limit(dissected):
    packets = [interrupt_in("30 00 08")] * 5
    _, shown, lines = dissected(packets, summary=True)
    assert shown == []
    assert "5 packets: 5 Wiimote, 0 malformed; 0 others" in lines
    _, shown, lines = dissected(packets, limit=2)
    assert len(shown) == 2
    assert "stopped at the limit of 2" in lines[-1]
