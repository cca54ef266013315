"""Frames of the JR3's CAN protocol: worked bytes, round trips, bad input, scaling."""

import math
import re
import struct
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from cardan_jr3 import protocol as jr3

NODES = st.integers(1, 127)
U16 = st.integers(0, 0xFFFF)
I16 = st.integers(-32768, 32767)
THREE = st.tuples(U16, U16, U16)

HOST = st.one_of(
    st.builds(jr3.Sync),
    st.builds(jr3.StartSync, U16),
    st.builds(jr3.StartAsync, U16, st.integers(0, 0xFFFFFFFF)),
    st.builds(jr3.SetFilter, U16),
    st.builds(jr3.GripperPwm, st.floats(-100, 100, width=32)),
    *(
        st.builds(kind)
        for kind in (
            jr3.Stop,
            jr3.ZeroOffs,
            jr3.GetState,
            jr3.GetFsForces,
            jr3.GetFsMoments,
            jr3.Reset,
        )
    ),
)
BOARD = st.one_of(
    st.builds(jr3.Ack, st.integers(0, 255), st.none() | THREE),
    st.builds(jr3.Forces, I16, I16, I16, U16),
    st.builds(jr3.Moments, I16, I16, I16, U16),
    st.builds(jr3.Bootup),
)

WORKED_HOST = [
    # The first one is the example in the firmware's description: node 33, 2 Hz, 10 ms.
    (jr3.StartAsync(200, 10_000), 33, 0x221, "c8 00 10 27 00 00"),
    (jr3.StartSync(200), 33, 0x1A1, "c8 00"),
    (jr3.Sync(), 33, 0x080, ""),
    (jr3.GetState(), 34, 0x422, ""),
    (jr3.GetFsForces(), 33, 0x4A1, ""),
    (jr3.GetFsMoments(), 33, 0x521, ""),
    (jr3.ZeroOffs(), 31, 0x31F, ""),
    (jr3.SetFilter(65535), 32, 0x3A0, "ff ff"),
    (jr3.Stop(), 127, 0x2FF, ""),
    (jr3.Reset(), 1, 0x581, ""),
    (jr3.GripperPwm(-50.0), 33, 0x7A1, "00 00 48 c2"),
]
WORKED_BOARD = [
    (jr3.Ack(0), 33, 0x121, "00"),
    (jr3.Ack(1), 33, 0x121, "01"),
    (jr3.Ack(0, (115, 111, 185)), 33, 0x121, "00 73 00 6f 00 b9 00"),
    (jr3.Forces(855, -1, 16384, 0x1234), 33, 0x621, "57 03 ff ff 00 40 34 12"),
    (jr3.Moments(0, -32768, 2, 0x1234), 33, 0x6A1, "00 00 00 80 02 00 34 12"),
    (jr3.Bootup(), 33, 0x721, ""),
]


@pytest.mark.judged(device="JR3", transport="CAN frames", by="worked bytes")
@pytest.mark.parametrize(("message", "node_id", "arbitration_id", "data"), WORKED_HOST)
def test_worked_bytes_of_the_host(message, node_id, arbitration_id, data):
    frame = jr3.encode_from_host(message, node_id)
    assert frame == (arbitration_id, bytes.fromhex(data))
    assert jr3.decode_from_host(*frame) == message


@pytest.mark.judged(device="JR3", transport="CAN frames", by="worked bytes")
@pytest.mark.parametrize(("message", "node_id", "arbitration_id", "data"), WORKED_BOARD)
def test_worked_bytes_of_the_board(message, node_id, arbitration_id, data):
    frame = jr3.encode_from_board(message, node_id)
    assert frame == (arbitration_id, bytes.fromhex(data))
    assert jr3.decode_from_board(*frame) == message


@given(HOST, NODES)
def test_what_a_host_asks_comes_back(message, node_id):
    frame = jr3.encode_from_host(message, node_id)
    assert frame.arbitration_id & jr3.NODE_MASK == (0 if isinstance(message, jr3.Sync) else node_id)
    decoded = jr3.decode_from_host(*frame)
    assert type(decoded) is type(message)
    assert decoded == message


@given(BOARD, NODES)
def test_what_a_board_says_comes_back(message, node_id):
    frame = jr3.encode_from_board(message, node_id)
    assert frame.arbitration_id & jr3.NODE_MASK == node_id
    assert len(frame.data) <= 8
    decoded = jr3.decode_from_board(*frame)
    assert type(decoded) is type(message)
    assert decoded == message


@given(st.integers(0, 0x1FFFFFFF), st.binary(max_size=64))
def test_no_frame_raises(arbitration_id, data):
    jr3.decode_from_board(arbitration_id, data)
    jr3.decode_from_host(arbitration_id, data)


@pytest.mark.parametrize("opcode", [jr3.Opcode.FORCES, jr3.Opcode.MOMENTS, jr3.Opcode.ACK])
@pytest.mark.parametrize("size", [0, 2, 5, 6])
def test_a_wrong_length_is_malformed(opcode, size):
    value = jr3.decode_from_board(opcode + 33, bytes(size))
    assert value == jr3.Malformed("of a wrong length", opcode)


def test_a_boot_with_data_is_malformed():
    assert isinstance(jr3.decode_from_board(0x721, b"\0"), jr3.Malformed)


def test_boards_do_not_send_what_hosts_do():
    for message, node_id, *_ in WORKED_HOST:
        assert jr3.decode_from_board(*jr3.encode_from_host(message, node_id)) is None
    for message, node_id, *_ in WORKED_BOARD:
        assert jr3.decode_from_host(*jr3.encode_from_board(message, node_id)) is None


@pytest.mark.parametrize(
    ("arbitration_id", "data", "message"),
    [
        (0x1A1, "", jr3.StartSync(0)),
        (0x1A1, "c8", jr3.StartSync(0)),
        (0x221, "c8 00 10 27", jr3.StartAsync(200, 0)),
        (0x221, "c8", jr3.StartAsync(0, 0)),
        (0x3A1, "c8 00 77", jr3.SetFilter(200)),
        (0x7A1, "00 00", jr3.GripperPwm(0.0)),
    ],
)
def test_a_board_reads_what_is_missing_as_zero(arbitration_id, data, message):
    assert jr3.decode_from_host(arbitration_id, bytes.fromhex(data)) == message


def test_sync_has_no_node():
    assert jr3.decode_from_host(0x0A1, b"") is None


@pytest.mark.parametrize("message", [jr3.StartSync(65536), jr3.StartAsync(0, -1)])
def test_a_value_that_does_not_fit_is_refused(message):
    with pytest.raises(ValueError, match="Start"):
        jr3.encode_from_host(message, 33)


def test_cutoffs_travel_in_hundredths_of_a_hertz():
    assert jr3.centihertz(2.0) == 200
    assert jr3.centihertz(655.35) == 65535
    for bad in (-0.1, 655.36, math.nan, math.inf):
        with pytest.raises(ValueError, match=r"655\.35"):
            jr3.centihertz(bad)


def test_full_scale_of_teos_right_hand():
    per_count = jr3.TEO_SENSORS["right-hand"].per_count
    assert [16384 * unit for unit in per_count] == pytest.approx([115, 111, 185, 5.6, 5.2, 6.1])
    assert per_count[0] == pytest.approx(7e-3, rel=0.01)  # resolution: 7 mN, 0.34 mN·m
    assert per_count[3] == pytest.approx(0.34e-3, rel=0.01)


@given(st.tuples(*[I16] * 6), st.sampled_from(sorted(jr3.TEO_SENSORS)))
def test_counts_survive_the_way_to_newtons_and_back(counts, sensor):
    scales = jr3.TEO_SENSORS[sensor]
    values = tuple(count * unit for count, unit in zip(counts, scales.per_count, strict=True))
    assert jr3.to_counts(values, scales) == counts


def test_counts_stop_where_sixteen_bits_do():
    scales = jr3.TEO_SENSORS["left-foot"]
    counts = jr3.to_counts((1e9, -1e9, 0, 1e9, -1e9, 0), scales)
    assert counts == (32767, -32768, 0, 32767, -32768, 0)
    struct.pack("<6h", *counts)


@given(U16, st.integers(0, 65535))
def test_the_counter_wraps(older, steps):
    assert jr3.samples_between((older + steps) % 65536, older) == steps


@pytest.mark.judged(device="JR3", transport="CAN frames", by="worked bytes")
def test_the_session_of_the_page():
    page = Path(__file__).parents[1] / "README.md"
    lines = page.read_text(encoding="utf-8").partition("# Worked bytes")[2].splitlines()
    heard = []
    for line in lines:
        found = re.match(r"(host|board) +([0-9a-f]{3})((?: [0-9a-f]{2}|  [0-9a-f]{2})*)", line)
        if found:
            decode = jr3.decode_from_host if found[1] == "host" else jr3.decode_from_board
            heard.append(decode(int(found[2], 16), bytes.fromhex(found[3])))
    assert [(type(message), *message) for message in heard] == [
        (type(message), *message)
        for message in (
            jr3.GetState(),
            jr3.Ack(0),
            jr3.StartAsync(200, 10_000),
            jr3.Ack(0),
            jr3.GetFsForces(),
            jr3.Ack(0, (115, 111, 185)),
            jr3.GetFsMoments(),
            jr3.Ack(0, (56, 52, 61)),
            jr3.ZeroOffs(),
            jr3.Ack(0),
            jr3.Forces(855, -1, 16384, 0x1234),
            jr3.Moments(0, -256, 2, 0x1234),
        )
    ]
