"""JR3 boards on CAN: layers compared with worked frames and the codec, and captures."""

import io
import struct
import sys

import can
import pytest
from hypothesis import example, given, strategies as st
from scapy.layers.can import CAN
from scapy.utils import RawPcapWriter

from cardan.errors import CaptureError, ConfigurationError, ExtraMissingError
from cardan_dissect import dissect_file
from cardan_dissect.capture import Direction
from cardan_jr3 import dissect as layers, protocol as codec
from cardan_jr3.dissect import BrokenFrame, UnknownFrame, dissect

NODE = 33
FORCE_SCALES, MOMENT_SCALES = (115, 111, 185), (56, 52, 61)

WORKED = [
    (0x080, "", layers.SyncFrame()),
    (0x221, "c8 00 10 27 00 00", layers.StartAsyncFrame(cutoff_centihertz=200, period_us=10_000)),
    (0x1A1, "c8 00", layers.StartSyncFrame(cutoff_centihertz=200)),
    (0x3A1, "00 00", layers.SetFilterFrame()),
    (0x2A1, "", layers.StopFrame()),
    (0x321, "", layers.ZeroOffsetsFrame()),
    (0x421, "", layers.GetStateFrame()),
    (0x4A1, "", layers.GetForceScalesFrame()),
    (0x521, "", layers.GetMomentScalesFrame()),
    (0x5A1, "", layers.ResetFrame()),
    (0x121, "01", layers.AckFrame(state=1)),
    (0x121, "00 73 00 6f 00 b9 00", layers.FullScalesAckFrame(x=115, y=111, z=185)),
    (0x621, "e8 03 38 ff 01 40 4d 00", layers.ForcesFrame(x=1000, y=-200, z=16385, counter=77)),
    (0x6A1, "00 40 00 c0 00 00 ff ff", layers.MomentsFrame(x=16384, y=-16384, counter=65535)),
    (0x721, "", layers.BootupFrame()),
    (0x7A1, "00 00 a0 c1", layers.GripperPwmFrame(pwm_percent=-20.0)),
]


@pytest.mark.parametrize(("identifier", "text", "frame"), WORKED, ids=lambda v: str(v))
def test_worked_frames_both_ways(identifier, text, frame):
    data = bytes.fromhex(text)
    assert bytes(frame) == data
    dissected = dissect(identifier, data)
    assert type(dissected) is type(frame)
    dissected.clear_cache()
    assert dissected == frame
    assert bytes(dissected) == data


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
@example(0x000, b"")
@example(0x0A1, b"")
@example(0x600, b"12345678")
def test_any_frame(identifier, data):
    frame = dissect(identifier, data)
    if data:
        assert bytes(frame) == data
    known = identifier == 0x080 or (identifier >= 0x100 and identifier & 0x7F)
    assert isinstance(frame, UnknownFrame) == (not known)
    reason = layers.malformed(identifier, data)
    assert (reason is not None) == isinstance(frame, BrokenFrame)


# Against the codec.

i16, u16 = st.integers(-(2**15), 2**15 - 1), st.integers(0, 2**16 - 1)
nodes = st.integers(1, 127)
three = st.tuples(u16, u16, u16)
from_board = st.one_of(
    st.builds(codec.Forces, i16, i16, i16, u16),
    st.builds(codec.Moments, i16, i16, i16, u16),
    st.builds(codec.Bootup),
    st.builds(codec.Ack, st.integers(0, 255), st.none() | three),
)
from_host = st.one_of(
    st.builds(codec.StartSync, u16),
    st.builds(codec.StartAsync, u16, st.integers(0, codec.MAX_PERIOD_US)),
    st.builds(codec.SetFilter, u16),
    st.builds(codec.GripperPwm, st.floats(-100, 100, width=32)),
    *map(
        st.builds,
        (
            codec.Sync, codec.Stop, codec.ZeroOffs, codec.GetState, codec.GetFsForces,
            codec.GetFsMoments, codec.Reset,
        ),
    ),
)  # fmt: skip


def value_of(frame):
    """Return a frame's value in the codec's types."""
    match frame:
        case layers.ForcesFrame():
            return codec.Forces(frame.x, frame.y, frame.z, frame.counter)
        case layers.MomentsFrame():
            return codec.Moments(frame.x, frame.y, frame.z, frame.counter)
        case layers.AckFrame():
            return codec.Ack(frame.state)
        case layers.FullScalesAckFrame():
            return codec.Ack(frame.state, (frame.x, frame.y, frame.z))
        case layers.StartSyncFrame():
            return codec.StartSync(frame.cutoff_centihertz)
        case layers.SetFilterFrame():
            return codec.SetFilter(frame.cutoff_centihertz)
        case layers.StartAsyncFrame():
            return codec.StartAsync(frame.cutoff_centihertz, frame.period_us)
        case layers.GripperPwmFrame():
            return codec.GripperPwm(frame.pwm_percent)
    return {
        layers.SyncFrame: codec.Sync,
        layers.StopFrame: codec.Stop,
        layers.ZeroOffsetsFrame: codec.ZeroOffs,
        layers.GetStateFrame: codec.GetState,
        layers.GetForceScalesFrame: codec.GetFsForces,
        layers.GetMomentScalesFrame: codec.GetFsMoments,
        layers.ResetFrame: codec.Reset,
        layers.BootupFrame: codec.Bootup,
    }[type(frame)]()


@given(from_board, nodes)
def test_frames_of_the_codecs_board(message, node):
    frame = codec.encode_from_board(message, node)
    found = dissect(*frame)
    assert found.way is Direction.FROM_DEVICE
    assert value_of(found) == message
    assert layers.split(frame.arbitration_id)[1] == node


@given(from_host, nodes)
def test_frames_of_the_codecs_host(message, node):
    frame = codec.encode_from_host(message, node)
    found = dissect(*frame)
    assert found.way is Direction.TO_DEVICE
    assert value_of(found) == message


@given(st.integers(0x100, 0x7FF), st.binary(max_size=8))
def test_both_refuse_the_same_frames_of_a_board(identifier, data):
    value = codec.decode_from_board(identifier, data)
    frame = dissect(identifier, data)
    if value is not None and identifier & 0x7F:
        assert isinstance(value, codec.Malformed) == isinstance(frame, BrokenFrame)


# Captures.


def can_frame(identifier, data=b"", flags=""):
    return bytes(CAN(identifier=identifier, flags=flags, data=data, length=len(data)))


def sample(counter, node=NODE, values=(16384, 0, -16384)):
    return [
        can_frame(opcode + node, struct.pack("<3hH", *values, counter)) for opcode in (0x600, 0x680)
    ]


def asked(opcode, answer=b"\0", data=b"", node=NODE):
    return [can_frame(opcode + node, data), can_frame(0x100 + node, answer)]


HANDSHAKE = [
    *asked(0x400),
    *asked(0x180, data=struct.pack("<H", 200)),
    *asked(0x480, struct.pack("<B3H", 0, *FORCE_SCALES)),
    *asked(0x500, struct.pack("<B3H", 0, *MOMENT_SCALES)),
    *asked(0x300),
]


@pytest.fixture
def dissected(tmp_path):
    def run(packets, **options):
        path = tmp_path / "capture.pcap"
        writer = RawPcapWriter(str(path), linktype=227)
        writer.write_header(b"")
        for number, packet in enumerate(packets):
            writer.write_packet(packet, sec=1_700_000_000, usec=1000 * number)
        writer.close()
        out = io.StringIO()
        counts = dissect_file(path, out, **options)
        lines = out.getvalue().splitlines()
        return counts, [line.split(" ", 2)[2] for line in lines if line.startswith("#")], lines

    return run


def test_a_session(dissected):
    sync = can_frame(0x080)
    packets = [*HANDSHAKE, *sample(10), sync, *sample(18), sync, *sample(26)]
    counts, shown, lines = dissected(packets)
    assert counts.messages["JR3"] == len(packets)
    assert counts.malformed["JR3"] == 0
    assert counts.other_packets == 0
    assert shown[:3] == [
        "JR3 node 33 GetState",
        "JR3 node 33 Ack | state 0",
        "JR3 node 33 StartSync | cutoff_centihz 200",
    ]
    assert shown[5] == "JR3 node 33 Ack | state 0 | full_scales 115 111 185"
    assert shown[10:13] == [
        "JR3 node 33 Forces | x 16384 | y 0 | z -16384 | counter 10",
        "JR3 node 33 Moments | x 16384 | y 0 | z -16384 | counter 10",
        "CAN Sync",
    ]
    assert (
        lines[-13:]
        == [
            "JR3 JR3 node 33",
            "  16 messages",
            "  Ack x5, period mean 2.000 min 2.000 max 2.000 ms",
            "  Forces x3, period mean 3.000 min 3.000 max 3.000 ms",
            "  Moments x3, period mean 3.000 min 3.000 max 3.000 ms",
            "  GetState x1",
            "  StartSync x1",
            "  GetFsForces x1",
            "  GetFsMoments x1",
            "  ZeroOffs x1",
            "JR3 CAN",
            "  2 messages",
            "  Sync x2, period mean 3.000 min 3.000 max 3.000 ms",
            "18 packets: 18 JR3, 0 malformed; 0 others",
        ][1:]
    )


def test_a_canopen_node_is_none(dissected):
    packets = [
        can_frame(0x080),
        can_frame(0x601, bytes.fromhex("40 00 10 00 00 00 00 00")),
        can_frame(0x581, bytes.fromhex("43 00 10 00 92 01 02 00")),
        can_frame(0x181, b"\x37\x02"),
        can_frame(0x081, bytes(8)),
        can_frame(0x701, b"\x05"),
        *sample(1, node=NODE),
    ]
    counts, shown, lines = dissected(packets)
    assert counts.messages["JR3"] == 2
    assert counts.other_packets == 6
    assert [line.split()[3] for line in shown] == ["Forces", "Moments"]
    assert "other packets: CAN x6" in lines
    counts, _, lines = dissected(packets[:6])
    assert counts.messages["JR3"] == 0
    assert "or JR3 traffic found in 6 packets" in lines[1]


def test_counters_must_agree_and_nodes_can_be_named(dissected):
    forces, _ = sample(1)
    _, moments = sample(2)
    counts, _, _ = dissected([forces, moments, forces])
    assert counts.messages["JR3"] == 0
    counts, shown, _ = dissected([forces, moments, forces], jr3_nodes=[NODE])
    assert counts.messages["JR3"] == 3
    assert shown[1].endswith("NO FORCES OF THIS COUNTER")
    with pytest.raises(ConfigurationError, match="node id 128: allowed are 1 to 127"):
        dissected([forces], jr3_nodes=[1, 128])


def test_lost_halves_repeats_and_damage(dissected):
    packets = [
        *sample(65530),
        *sample(2),  # the counter wraps
        sample(10)[0],
        *sample(18),
        *sample(18),
        sample(26)[1],
        can_frame(0x621, b"123"),
        can_frame(0x1A1, b"\1"),
        can_frame(0x121, b"\1"),
        can_frame(0x721),
        *sample(0, values=(20000, 0, 0)),
        sample(5)[0][:12],
        can_frame(0x621, b"12345678", "remote_transmission_request"),
        can_frame(0x621, b"12345678", "extended"),
        b"\0\0",
    ]
    counts, shown, lines = dissected(packets)
    assert counts.malformed["JR3"] == 2
    assert counts.other_packets == 3
    texts = "\n".join(shown)
    for text in (
        "counter 18 | NO MOMENTS BEFORE",
        "Moments | x 16384 | y 0 | z -16384 | counter 18 | SAME SAMPLE AGAIN",
        "counter 26 | NO FORCES OF THIS COUNTER",
        "MALFORMED CAN frame: FORCES of a wrong length (3 B: 31 32 33)",
        "JR3 node 33 StartSync | cutoff_centihz 0",
        "Ack | state 1",
        "Forces | x 20000 | y 0 | z 0 | counter 0",
        "MALFORMED CAN frame: cut by the capture (4 B: 00 40 00 00)",
    ):
        assert text in texts
    for line in (
        "  17 messages",
        "  malformed: FORCES of a wrong length x1, cut by the capture x1",
        "  remarks: NO MOMENTS BEFORE x1, SAME SAMPLE AGAIN x1, NO FORCES OF THIS COUNTER x1",
    ):
        assert line in lines


# Logs.

SAMPLES = [(0x621, "e80338ff01404d00"), (0x6A1, "004000c000004d00"), (0x080, "")]
BUS_OFF = "(1700000000.003000) can0 20000040#0000000000000000"


def candump(frames):
    return [
        f"(1700000000.{1000 * n:06d}) can0 {identifier:03X}#{data.upper()}"
        for n, (identifier, data) in enumerate(frames)
    ]


def read_log(path):
    out = io.StringIO()
    counts = dissect_file(path, out)
    lines = out.getvalue().splitlines()
    return counts, [line.split(" ", 2)[2] for line in lines if line.startswith("#")], lines


SHOWN = [
    "JR3 node 33 Forces | x 1000 | y -200 | z 16385 | counter 77",
    "JR3 node 33 Moments | x 16384 | y -16384 | z 0 | counter 77",
    "CAN Sync",
]


@pytest.mark.parametrize("way", ["", " R", " T"])
def test_a_log_of_candump(tmp_path, way):
    path = tmp_path / "candump.log"
    path.write_text("".join(f"{line}{way}\n" for line in candump(SAMPLES)))
    counts, shown, lines = read_log(path)
    assert shown == SHOWN
    assert (counts.packets, counts.other_packets) == (3, 0)
    assert lines[0] == "capture starts 2023-11-14 22:13:20.000000 UTC"
    assert lines[2].startswith("#2 0.001000 ")


def test_errors_and_others_in_a_log_of_candump_are_no_data(tmp_path):
    path = tmp_path / "candump.log"
    one, two, sync = candump(SAMPLES)
    others = [
        BUS_OFF,
        "(1700000000.003000) can0 20000004#000C000000000000",
        "(1700000000.003000) can0 20000088#0000000000000000",
        "(1700000000.003000) can0 621#R8",
        "(1700000000.003000) can0 621#R",
        "(1700000000.003000) can0 00000621#e80338ff01404d00",
        "(1700000000.003000) can0 12345678##1" + "00" * 64,
        "",
    ]
    path.write_text("\n".join([one, two, *others, sync, ""]))
    counts, shown, lines = read_log(path)
    assert shown == SHOWN
    assert (counts.packets, counts.other_packets) == (10, 7)
    assert lines[-1] == "other packets: CAN x7"


def test_a_log_of_candump_that_is_cut(tmp_path):
    path = tmp_path / "candump.log"
    path.write_text("\n".join([*candump(SAMPLES), "(1700000000.00"]))
    out = io.StringIO()
    with pytest.raises(CaptureError, match=r"damaged: line 4 is not of candump -L: '.*after pack"):
        dissect_file(path, out)
    assert SHOWN[0] in out.getvalue()


def test_a_time_of_candump_that_is_too_long_is_reported_by_its_line(tmp_path):
    path = tmp_path / "candump.log"
    path.write_text(f"({'9' * 5000}.000000) can0 181#00\n")
    with pytest.raises(CaptureError, match=r"damaged: line 1 is not of candump -L: '\(9999"):
        dissect_file(path, io.StringIO())


ASC = """date Tue Nov 14 10:13:20.000 pm 2023
base hex  timestamps absolute
internal events logged
// version 9.0.0
Begin Triggerblock Tue Nov 14 10:13:20.000 pm 2023
   0.000000 Start of measurement
   0.000500 CAN 1 Status:chip status error active
   0.001000 1  621             Rx   d 8 e8 03 38 ff 01 40 4d 00
   0.002000 1  6a1             Rx   d 8 00 40 00 c0 00 00 4d 00  Length = 244000 BitCount = 126
   0.002500 1  ErrorFrame
   0.002600 CAN 1 Status:chip status bus off
   0.002700 1  621x            Rx   d 8 e8 03 38 ff 01 40 4d 00
   0.002800 1  621             Rx   r
   0.002900 1  80              TxRq d 0
   0.003000 1  80              Tx   d 0
   0.004000 1  Statistic: D 4 R 0 XD 0 XR 0 E 1 O 0 B 0.50%
End TriggerBlock
"""


@pytest.mark.parametrize("date", ["Tue Nov 14", "mar. nov. 14"])
def test_a_log_of_vector_as_text(tmp_path, date):
    path = tmp_path / "log.asc"
    path.write_text(ASC.replace("Tue Nov 14", date))
    counts, shown, lines = read_log(path)
    assert shown == SHOWN
    assert (counts.packets, counts.other_packets) == (6, 3)
    assert lines[2].startswith("#2 0.001000 ")


def test_a_line_that_is_none_in_a_log_of_vector(tmp_path):
    path = tmp_path / "log.asc"
    path.write_text(ASC + "   0.004000 1  621             Rx   d 8 e8 xx\n")
    with pytest.raises(CaptureError, match=r"damaged: line 18 cannot be read: '0\.004000 1  621"):
        read_log(path)


def test_a_binary_log_of_vector(tmp_path):
    path = tmp_path / "log.blf"
    with can.BLFWriter(path) as writer:
        for n, (identifier, data) in enumerate(SAMPLES):
            said = {"arbitration_id": identifier, "data": bytes.fromhex(data)}
            time_s = 1_700_000_000 + 0.001 * n
            writer(can.Message(time_s, is_extended_id=False, **said))
            if n == 1:
                writer(can.Message(time_s, is_error_frame=True, **said))
                writer(can.Message(time_s, is_extended_id=True, **said))
    counts, shown, lines = read_log(path)
    assert shown == SHOWN
    assert (counts.packets, counts.other_packets) == (5, 2)
    assert lines[2].startswith("#2 0.001000 ")
    whole = path.read_bytes()
    path.write_bytes(whole[:-10])
    with pytest.raises(CaptureError, match=f"it has {len(whole) - 10} of {len(whole)} bytes after"):
        read_log(path)
    path.write_bytes(whole[:150] + bytes(50))
    with pytest.raises(CaptureError, match="damaged: a part of it is not where it should be"):
        read_log(path)


@pytest.mark.parametrize("name", ["log.asc", "log.blf"])
def test_what_reads_logs_of_vector_is_named(tmp_path, monkeypatch, name):
    path = tmp_path / name
    path.write_bytes(ASC.encode() if name == "log.asc" else b"LOGG" + bytes(200))
    for module in ("can", "can.io.blf"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ExtraMissingError, match=r"cardan\[can\]"):
        read_log(path)
    path.write_text(candump(SAMPLES)[0])
    assert read_log(path)[0].packets == 1
