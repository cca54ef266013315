"""JR3 boards on CAN: layers against worked frames and the codec, and captures."""

import io
import struct

import pytest
from hypothesis import example, given, strategies as st
from scapy.layers.can import CAN
from scapy.utils import RawPcapWriter

from cardan.dissect import dissect_file, jr3_can as layers
from cardan.dissect.capture import Direction
from cardan.dissect.jr3_can import BrokenFrame, UnknownFrame, dissect
from cardan.dissect.jr3_can_text import describe
from cardan.errors import ConfigurationError
from cardan.protocols import jr3_can as codec

NODE = 33
FORCE_SCALES, MOMENT_SCALES = (115, 111, 185), (56, 52, 61)

WORKED = [
    (0x080, "", layers.SyncFrame(), "SYNC"),
    (
        0x221,
        "c8 00 10 27 00 00",
        layers.StartAsyncFrame(cutoff_centihertz=200, period_us=10_000),
        "START_ASYNC cut-off 2 Hz period 10 ms",
    ),
    (0x1A1, "c8 00", layers.StartSyncFrame(cutoff_centihertz=200), "START_SYNC cut-off 2 Hz"),
    (0x3A1, "00 00", layers.SetFilterFrame(), "SET_FILTER unfiltered"),
    (0x2A1, "", layers.StopFrame(), "STOP"),
    (0x321, "", layers.ZeroOffsetsFrame(), "ZERO_OFFS"),
    (0x421, "", layers.GetStateFrame(), "GET_STATE"),
    (0x4A1, "", layers.GetForceScalesFrame(), "GET_FS_FORCES"),
    (0x521, "", layers.GetMomentScalesFrame(), "GET_FS_MOMENTS"),
    (0x5A1, "", layers.ResetFrame(), "RESET"),
    (0x121, "01", layers.AckFrame(state=1), "ACK not initialised"),
    (
        0x121,
        "00 73 00 6f 00 b9 00",
        layers.FullScalesAckFrame(x=115, y=111, z=185),
        "ACK ready full scales 115 111 185",
    ),
    (
        0x621,
        "e8 03 38 ff 01 40 4d 00",
        layers.ForcesFrame(x=1000, y=-200, z=16385, counter=77),
        "FORCES 1000 -200 16385 counter 77 | OVERRANGE",
    ),
    (
        0x6A1,
        "00 40 00 c0 00 00 ff ff",
        layers.MomentsFrame(x=16384, y=-16384, counter=65535),
        "MOMENTS 16384 -16384 0 counter 65535",
    ),
    (0x721, "", layers.BootupFrame(), "BOOTUP"),
    (0x7A1, "00 00 a0 c1", layers.GripperPwmFrame(pwm_percent=-20.0), "GRIPPER_PWM -20 %"),
]


@pytest.mark.parametrize(("identifier", "text", "frame", "shown"), WORKED, ids=lambda v: str(v))
def test_worked_frames_both_ways(identifier, text, frame, shown):
    data = bytes.fromhex(text)
    assert bytes(frame) == data
    dissected = dissect(identifier, data)
    assert type(dissected) is type(frame)
    dissected.clear_cache()
    assert dissected == frame
    assert bytes(dissected) == data
    assert describe(dissected) == shown


def test_si_values():
    forces = dissect(0x621, struct.pack("<3hH", 16384, -8192, 1, 5))
    assert describe(forces, FORCE_SCALES).endswith("| 115 -55.5 0.0112915 N")
    moments = dissect(0x6A1, struct.pack("<3hH", 16384, -8192, 1, 5))
    assert describe(moments, MOMENT_SCALES).endswith("| 5.6 -2.6 0.000372314 N·m")


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
@example(0x000, b"")
@example(0x0A1, b"")
@example(0x600, b"12345678")
def test_any_frame(identifier, data):
    frame = dissect(identifier, data)
    assert describe(frame)
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
    """What a frame stands for, as the codec has it."""
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
        "CAN 0x421 JR3 node 33 GET_STATE",
        "CAN 0x121 JR3 node 33 ACK ready | of GET_STATE",
        "CAN 0x1a1 JR3 node 33 START_SYNC cut-off 2 Hz",
    ]
    assert shown[5] == (
        "CAN 0x121 JR3 node 33 ACK ready full scales 115 111 185 | of GET_FS_FORCES"
    )
    assert shown[10:13] == [
        "CAN 0x621 JR3 node 33 FORCES 16384 0 -16384 counter 10 | 115 0 -185 N",
        "CAN 0x6a1 JR3 node 33 MOMENTS 16384 0 -16384 counter 10 | 5.6 0 -6.1 N·m",
        "CAN 0x080 SYNC to every node",
    ]
    assert lines[-8:] == [
        "JR3 board, node 33: ACK x5, FORCES x3, MOMENTS x3, GET_STATE x1, START_SYNC x1, "
        "GET_FS_FORCES x1, GET_FS_MOMENTS x1, ZERO_OFFS x1",
        "  samples 3, period mean 3.000 min 3.000 max 3.000 ms",
        "  counter steps 8.00 a sample, 1.028 ms of the sensor's time",
        "  commands answered 5 of 5, latency median 1.000 p99 1.000 ms",
        "  full scales of forces 115 111 185 N",
        "  full scales of moments 56 52 61 0.1 N·m",
        "SYNC of the CAN bus: 2, period mean 3.000 min 3.000 max 3.000 ms",
        "18 packets: 18 JR3, 0 malformed; 0 others",
    ]


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
    assert [line.split()[1] for line in shown] == ["0x621", "0x6a1"]
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
    assert counts.malformed["JR3"] == 3
    assert counts.other_packets == 3
    texts = "\n".join(shown)
    for text in (
        "FORCES 16384 0 -16384 counter 18 | NO MOMENTS BEFORE",
        "MOMENTS 16384 0 -16384 counter 18 | SAME SAMPLE AGAIN",
        "MOMENTS 16384 0 -16384 counter 26 | NO FORCES OF THIS COUNTER",
        "MALFORMED FORCES of 3 bytes: 31 32 33",
        "MALFORMED START_SYNC of 1 bytes: 01",
        "ACK not initialised | NOT ASKED FOR",
        "FORCES 20000 0 0 counter 0 | OVERRANGE",
        "MALFORMED cut by the capture: 00 40 00 00",
    ):
        assert text in texts
    for line in (
        "  samples 5, period mean 2.333 min 2.000 max 3.000 ms",
        "  counter steps 12.00 a sample, 1.542 ms of the sensor's time",
        "  halves without the other: 2",
        "  samples sent again: 1",
        "  halves beyond full scale: 2",
        "  ACKs that nothing asked for: 1",
        "  ACKs that say not initialised: 1",
    ):
        assert line in lines
