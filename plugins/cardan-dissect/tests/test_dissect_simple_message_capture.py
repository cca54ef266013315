"""Simple message in captures: reassembled streams, figures, and a real controller."""

import io
import re
import struct

import pytest
from hypothesis import given, settings, strategies as st
from scapy.layers.inet import IP, TCP
from scapy.layers.l2 import Ether
from scapy.packet import Raw
from scapy.utils import wrpcap

import dissect_streaming as streaming
from cardan_dissect import dissect_file, simple_message as sm
from cardan_dissect.dissectors.streams import SimpleMessage
from cardan_dissect.network import TCP_FIN, TCP_SYN, Endpoint, Segment
from tests import captures
from tests.examples import examples
from tests.protocols import worked

pytestmark = pytest.mark.matrix

CONTROLLER, CLIENT = Endpoint("10.0.0.1", 50241), Endpoint("10.0.0.2", 40000)
MOTION = Endpoint("10.0.0.1", 50240)


def segments(parts, start=2**32 - 100, source=CONTROLLER, destination=CLIENT):
    return streaming.segments(parts, start, source, destination)


def fed(listed, period_s=0.001):
    """Return the lines without addresses, and the final summary."""
    lines, said = streaming.fed(streaming.opened(SimpleMessage), listed, period_s)
    return lines, "\n".join(said)


def states(count, order="<"):
    made = []
    for n in range(count):
        made.append(bytes(sm.JointFeedback(byte_order=order, valid_fields=2, positions=[n])))
        made.append(bytes(sm.RobotStatus(byte_order=order, error_code=n)))
    return made


@settings(max_examples=examples(60))
@given(st.data(), st.sampled_from("<>"))
def test_splitting_merging_reordering_and_repeating_change_nothing(data, order):
    messages = states(4, order)
    expected, _ = fed(segments(messages))
    stream = b"".join(messages)
    cuts = sorted(data.draw(st.sets(st.integers(1, len(stream) - 1), max_size=12)))
    parts = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    first, *rest = segments(parts)
    mixed = [first, *data.draw(st.permutations(rest))]
    for again in data.draw(st.lists(st.sampled_from(mixed), max_size=4)):
        mixed.insert(data.draw(st.integers(1, len(mixed))), again)
    start = Segment("TCP", CONTROLLER, CLIENT, b"", False, (first.sequence - 1) % 2**32, TCP_SYN)
    lines, said = fed([start, *mixed])
    assert lines == expected
    assert "malformed" not in said
    assert "  8 messages" in said


def test_overlapping_retransmissions():
    messages = states(2)
    stream = b"".join(messages)
    start = 5
    listed = [
        Segment("TCP", CONTROLLER, CLIENT, stream[a:b], False, start + a, 16)
        for a, b in ((0, 100), (60, 250), (0, 384), (250, 384))
    ]
    assert fed(listed)[0] == fed(segments(messages))[0]


@settings(max_examples=examples(100))
@given(st.lists(st.tuples(st.binary(max_size=60), u := st.integers(0, 2**32 - 1), u), max_size=8))
def test_arbitrary_segments_never_raise(parts):
    listed = [Segment("TCP", CONTROLLER, CLIENT, p, False, q, f % 64) for p, q, f in parts]
    fed([*segments(states(1)), *listed])


def test_a_gap_is_named_and_reading_goes_on_at_a_message():
    parts = segments(states(5))
    cut = parts[0]._replace(payload=parts[0].payload[:40])
    lines, said = fed([cut, *parts[3:]], period_s=0.3)
    assert lines[0] == (
        "GAP: 300 bytes are missing in the capture, 40 bytes of an unfinished message dropped"
    )
    assert lines[1].startswith("ROBOT_STATUS TOPIC")
    assert "  7 messages" in said
    assert "gaps 1 (300 B missing)" in said
    # The arrival time counts, not the time when the gap was given up.
    assert "  ROBOT_STATUS TOPIC x4, period mean 600.000 min 600.000 max 600.000 ms" in said


def test_joining_in_the_middle_bad_prefixes_and_an_early_end():
    one, two = states(1)
    lines, _ = fed(segments([one[50:], two, b"\xff" * 20, one, two[:20]]))
    assert lines[0] == "SKIPPED 98 bytes that begin no message"
    assert lines[1].startswith("ROBOT_STATUS")
    assert lines[2].startswith("MALFORMED simple message: prefix outside 12 to 65535 (20 B: ff ff")
    assert lines[3].startswith("JOINT_FEEDBACK")
    last = segments([one, two[:20]])
    lines, said = fed([last[0], last[1]._replace(flags=TCP_FIN)])
    assert "the connection ends inside a message (20 B" in lines[1]
    assert "  malformed: the connection ends inside a message x1" in said


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("first", [1, 2, 3])
def test_a_first_segment_may_be_shorter_than_a_prefix(first, order):
    messages = states(2, order)
    stream = b"".join(messages)
    expected, _ = fed(segments(messages))
    lines, _ = fed(segments([stream[:first], stream[first:200], stream[200:]]))
    assert lines == expected
    # It may also be the end of an earlier message.
    lines, said = fed(segments([b"\xff" * first, stream]))
    assert lines == [f"SKIPPED {first} bytes that begin no message", *expected]
    assert f"gaps 0 skipped {first} B" in said
    dissector = streaming.opened(SimpleMessage)
    streaming.fed(dissector, segments([stream[:first]]), 0.001)
    about = dissector.about(f"{CONTROLLER} > {CLIENT}")
    assert f"the capture ends {first} B into a message" in about


def test_what_is_skipped_after_a_gap_is_in_the_summary():
    parts = segments([*states(2), *[b"\xff" * n for n in (3, 30, 2)], *states(1)])
    lines, said = fed([parts[0], *parts[2:]], period_s=0.6)
    shown = [int(line.split()[1]) for line in lines if line.startswith("SKIPPED")]
    assert sum(shown) > 0
    assert f"gaps 1 (44 B missing) skipped {sum(shown)} B" in said


def test_replies_name_what_they_answer_and_its_result():
    point = sm.JointTrajPtFull(sequence=3)
    asked = [bytes(point), worked.PING_REQUEST, bytes(sm.ReadIoBit(address=10010))]
    answers = [
        sm.MotionReply(sequence=3, command_code=14, result=1),
        sm.Ping(comm_type=3, reply_code=1),
        sm.ReadIoBitReply(result=1001, reply_code=2),
        sm.MotionReply(command_code=200111),
    ]
    to, back = (
        segments(asked, 1, CLIENT, MOTION),
        segments(map(bytes, answers), 1, MOTION, CLIENT),
    )
    lines, said = fed([to[0], back[0], to[1], back[1], to[2], *back[2:]])
    assert lines[1].startswith(
        "MOTO_MOTION_REPLY SERVICE_REPLY SUCCESS JOINT_TRAJ_PT_FULL BUSY 0 | group 0 | sequence 3"
    )
    assert lines[-1].startswith("MOTO_MOTION_REPLY SERVICE_REPLY SUCCESS STOP_MOTION SUCCESS 0 |")
    for line in (
        "  PING SERVICE_REPLY SUCCESS x1",
        "  MOTO_READ_IO_BIT_REPLY SERVICE_REPLY FAILURE x1",
        "  answers x3, after: median 1.000 p99 1.000 ms",
    ):
        assert line in said


def test_other_ports_and_64_bit_reals(tmp_path):
    path, out = tmp_path / "capture.pcap", io.StringIO()
    ether = Ether(src="02:00:00:00:00:01", dst="02:00:00:00:00:02")
    payload = bytes(sm.JointFeedback(real_bytes=8, positions=[0.1]))
    tcp = TCP(sport=11002, dport=40000, seq=1, flags="PA")
    wrpcap(str(path), [ether / IP(src="10.0.0.1", dst="10.0.0.2") / tcp / Raw(payload)])
    assert dissect_file(path, out).messages["simple message"] == 0
    counts = dissect_file(path, out, simple_message_ports=[11002])
    assert counts.messages["simple message"] == 1
    assert "| pos 0.1 0 0" in out.getvalue()


def test_the_cycle_of_the_real_time_mode():
    state = bytes(sm.RtJointState(message_id=7, groups=[()] * 4, group_count=1))
    pc, rt = Endpoint("10.0.0.2", 50244), Endpoint("10.0.0.1", 50999)
    listed = [
        Segment("UDP", rt, pc, state.ljust(552, b"\0"), False),
        Segment("UDP", pc, rt, worked.RT_COMMAND, False),
        Segment("UDP", pc, rt, struct.pack("<8f", *range(8)), False),
    ]
    dissector = streaming.opened(SimpleMessage)
    lines, said = streaming.fed(dissector, listed, 0.001)
    names = ["MOTO_RT_JOINT_STATE_EX", "MOTO_RT_JOINT_COMMAND_EX"]
    assert [line.split(" ")[0] for line in lines] == names
    assert dissector.packets == 2
    assert said[-1] == "  answers x1, after: median 1.000 p99 1.000 ms"


def test_a_real_controller():
    out = io.StringIO()
    counts = dissect_file(captures.require(captures.MOTOMAN), out)
    assert counts.messages["simple message"] == 164
    assert counts.malformed["simple message"] == 0
    assert counts.other_packets == 0
    text = out.getvalue()
    reply = "  MOTO_MOTION_REPLY SERVICE_REPLY SUCCESS"
    for line in (
        f"{reply} JOINT_TRAJ_PT_FULL BUSY 0 x48",
        f"{reply} JOINT_TRAJ_PT_FULL SUCCESS 0 x10",
        f"{reply} CHECK_MOTION_READY FAILURE 0 x1",
        f"{reply} START_TRAJ_MODE SUCCESS 0 x1",
        "  ROBOT_STATUS TOPIC x22, period mean 25.0",
        "simple message 192.168.245.156:50240 > 10.116.249.229:40872: 60 segments",
    ):
        assert line in text
    found = re.search(r"x60, after: median (\S+) p99 (\S+) ms", text)
    assert float(found[1]) == pytest.approx(0.337, abs=0.01)
    assert float(found[2]) == pytest.approx(109.895, rel=0.03)
    assert "remarks" not in text
