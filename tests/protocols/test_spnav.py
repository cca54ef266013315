"""spacenavd's protocol: worked bytes, round trips, split streams, and malformed data."""

import math
import re
import struct
import sys
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from cardan.protocols.spnav import codes, records, strings
from cardan.protocols.spnav.codes import REQUEST_TAG, Code
from cardan.protocols.spnav.records import (
    FAILED,
    MAX_BUTTONS,
    OK,
    RECORD_BYTES,
    Button,
    ConfigChange,
    DeviceChange,
    MalformedRecord,
    MotionEvent,
    RawAxis,
    RawButton,
    ServerReply,
    decode_handshake,
    decode_server_record,
    encode_handshake,
    encode_reply,
    encode_request,
    encode_sensitivity,
    to_robot_axes,
)
from cardan.protocols.spnav.streams import Handshake, ServerReader
from cardan.protocols.spnav.strings import encode_string
from cardan_spnav_server.protocol import (
    ClientReader,
    ClientRequest,
    Sensitivity,
    StringAssembler,
    bits_of,
    decode_request,
    decode_sensitivity,
    encode_button,
    encode_config,
    encode_device,
    encode_motion,
    float_of,
    from_robot_axes,
)

little = pytest.mark.skipif(sys.byteorder != "little", reason="the worked bytes are little-endian")
worked = pytest.mark.judged(device="spacenavd clients", transport="socket", by="worked bytes")
int32 = st.integers(-(2**31), 2**31 - 1)
words7 = st.tuples(*[int32] * 7)


@little
@worked
def test_worked_handshake_and_sensitivity():
    assert encode_handshake(1) == bytes.fromhex("0155aa7f")
    assert decode_handshake(bytes.fromhex("0155aa7f")) == 1
    assert encode_sensitivity(2.0) == bytes.fromhex("00000040")
    assert decode_sensitivity(bytes.fromhex("00000040")) == 2.0


@little
@worked
def test_worked_motion():
    record = bytes.fromhex(
        "00000000 64000000 38ffffff 2c010000 f6ffffff 14000000 e2ffffff 10000000"
    )
    assert encode_motion((100, -200, 300, -10, 20, -30), 16) == record
    assert decode_server_record(record) == MotionEvent(100, -200, 300, -10, 20, -30, 16)


@little
@worked
def test_worked_press():
    record = bytes.fromhex("01000000 03000000 01000000") + bytes(20)
    assert encode_button(3, True) == record
    assert decode_server_record(record) == Button(3, True)
    assert decode_server_record(encode_button(3, False)) == Button(3, False)


@little
@worked
def test_worked_device_add():
    record = bytes.fromhex(
        "03000000 00000000 00000000 0d020000 6f250000 31c60000 00000000 00000000"
    )
    change = DeviceChange(True, 0, 0x20D, 0x256F, 0xC631)
    assert encode_device(change) == record
    assert decode_server_record(record) == change


@little
@worked
def test_worked_name():
    record = bytes.fromhex(
        "0010aa7f 70656572 2d636865 636b0000 00000000 00000000 00000000 0a000000"
    )
    assert encode_string(REQUEST_TAG | Code.SET_NAME, "peer-check") == [record]
    request = decode_request(record)
    assert request.code == Code.SET_NAME
    assert StringAssembler().take(request.data) == "peer-check"


def test_settings_are_numbered_in_pairs():
    settings = [code for code in Code if Code.SCFG_SENS <= code < Code.CFG_SAVE]
    assert settings == list(range(0x3000, 0x301A))


def test_other_events():
    change = ConfigChange(Code.GCFG_LED, (2, 0, 0, 0, 0, 0))
    assert decode_server_record(encode_config(change)) == change
    assert decode_server_record(struct.pack("=8i", 5, 3, -7, *(0,) * 5)) == RawAxis(3, -7)
    assert decode_server_record(struct.pack("=8i", 6, 3, 1, *(0,) * 5)) == RawButton(3, True)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ((1, MAX_BUTTONS), "with an impossible value"),
        ((2, -1), "with an impossible value"),
        ((3, 2, 0), "with an impossible value"),
        ((3, 0, -1), "with an impossible value"),
        ((7,), "of an unknown type"),
        ((-1,), "of an unknown type"),
    ],
)
def test_nonsense_from_a_server_is_named(words, reason):
    record = struct.pack("=8i", *words, *(0,) * (8 - len(words)))
    assert decode_server_record(record) == MalformedRecord(reason, words[0])


def test_records_of_another_length_are_named():
    assert decode_server_record(bytes(31)) == MalformedRecord("of the wrong length", 0)
    assert decode_request(bytes(33)) == MalformedRecord("of the wrong length", 0)


@given(st.binary(max_size=40))
def test_decoding_never_raises(data):
    decode_server_record(data)
    decode_request(data)


@given(st.tuples(*[int32] * 6), st.integers(0, 2**31 - 1))
def test_motion_round_trip(counts, period_ms):
    assert decode_server_record(encode_motion(counts, period_ms)) == MotionEvent(*counts, period_ms)


def test_motion_beyond_32_bits_is_clamped():
    motion = decode_server_record(encode_motion((2**40, -(2**40), 0, 0, 0, 0), 2**40))
    assert (motion.x, motion.y, motion.period_ms) == (2**31 - 1, -(2**31), 2**31 - 1)


@given(st.sampled_from(list(Code)), words7)
def test_request_and_reply_round_trip(code, data):
    request = decode_request(encode_request(code, data))
    assert (request.code, request.data) == (code, data)
    reply = decode_server_record(encode_reply(request.word, data[:6], OK))
    assert (reply.word, reply.code, reply.ok) == (request.word, code, True)
    assert not decode_server_record(encode_reply(request.word, data[:6], FAILED)).ok


def test_a_request_without_libspnavs_tag_is_the_same_request():
    assert decode_request(struct.pack("=8i", 0x2003, *(0,) * 7)).code == Code.DEV_NBUTTONS
    assert isinstance(decode_server_record(encode_reply(0x2003, (15,))), ServerReply)


@pytest.mark.parametrize(
    "make",
    [
        lambda: encode_button(MAX_BUTTONS, True),
        lambda: encode_button(-1, True),
        lambda: encode_device(DeviceChange(True, 2**31, 0, 0, 0)),
        lambda: encode_config(ConfigChange(0, (2**31, 0, 0, 0, 0, 0))),
        lambda: encode_request(0x10000),
        lambda: encode_request(0x1000, (0,) * 8),
        lambda: encode_reply(0x1000, (0,) * 7),
        lambda: encode_handshake(256),
        lambda: encode_sensitivity(1e300),
    ],
)
def test_what_does_not_fit_is_refused(make):
    with pytest.raises(ValueError, match=r"allowed|fit"):
        make()


@given(st.floats(width=32))
def test_floats_travel_as_words(value):
    back = float_of(bits_of(value))
    assert back == value or (math.isnan(back) and math.isnan(value))


# -- strings ------------------------------------------------------------------------------------


@given(st.text(max_size=200))
def test_strings_round_trip(text):
    assembler = StringAssembler()
    *first, last = encode_string(REQUEST_TAG | Code.DEV_NAME, text)
    for record in first:
        assert assembler.take(decode_request(record).data) is None
    assert assembler.take(decode_request(last).data) == text


def test_a_long_string_says_how_much_is_left():
    records = [decode_request(record) for record in encode_string(0x1000, "x" * 60)]
    assert [request.data[6] for request in records] == [60, 36 | 0x10000, 12 | 0x10000]


def test_a_continuation_out_of_order_is_malformed_and_the_next_string_is_not():
    first, second, third = (
        decode_request(record).data for record in encode_string(0x1000, "x" * 60)
    )
    assembler = StringAssembler()
    assert assembler.take(first) is None
    assert isinstance(assembler.take(third), MalformedRecord)
    assert isinstance(assembler.take(second), MalformedRecord)
    assert assembler.take(decode_request(encode_string(0x1000, "y")[0]).data) == "y"


@given(st.lists(words7, max_size=20))
def test_assembling_never_raises(packets):
    assembler = StringAssembler()
    for data in packets:
        assembler.take(data)


# -- streams ------------------------------------------------------------------------------------


def in_pieces(reader, data, sizes):
    values = []
    while data:
        size = sizes.pop() if sizes else len(data)
        values += reader.feed(data[:size])
        data = data[size:]
    return values


@given(st.lists(st.integers(1, 40), max_size=30))
def test_a_server_is_read_in_any_pieces(sizes):
    data = (
        encode_motion((1, 2, 3, 4, 5, 6), 8)
        + encode_handshake(1)
        + encode_button(1, True)
        + encode_reply(REQUEST_TAG | Code.DEV_NAXES, (6,))
    )
    assert in_pieces(ServerReader(), data, sizes) == [
        MotionEvent(1, 2, 3, 4, 5, 6, 8),
        Handshake(1),
        Button(1, True),
        ServerReply(REQUEST_TAG | Code.DEV_NAXES, (6, 0, 0, 0, 0, 0, 0)),
    ]


@given(st.lists(st.integers(1, 40), max_size=30))
def test_a_client_is_read_in_any_pieces(sizes):
    data = encode_sensitivity(0.5) + encode_handshake(9) + encode_request(Code.DEV_TYPE)
    assert in_pieces(ClientReader(), data, sizes) == [
        Sensitivity(0.5),
        Handshake(1),
        ClientRequest(REQUEST_TAG | Code.DEV_TYPE, (0,) * 7),
    ]


def test_an_old_server_takes_the_handshake_for_a_number_that_is_none():
    (value,) = ClientReader(newest=0).feed(encode_handshake(1))
    assert isinstance(value, Sensitivity)
    assert math.isnan(value.value)


@given(st.lists(st.binary(max_size=100), max_size=20))
def test_reading_never_raises_and_keeps_less_than_a_record(chunks):
    server, client = ServerReader(), ClientReader()
    for chunk in chunks:
        server.feed(chunk)
        client.feed(chunk)
        assert len(server._buffer) < RECORD_BYTES
        assert len(client._buffer) < RECORD_BYTES


# -- axes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("counts", "axes"),
    [
        ((0, 0, 350, 0, 0, 0), (1, 0, 0, 0, 0, 0)),  # away from the operator
        ((-350, 0, 0, 0, 0, 0), (0, 1, 0, 0, 0, 0)),  # left
        ((0, 350, 0, 0, 0, 0), (0, 0, 1, 0, 0, 0)),  # up
        ((0, 0, 0, 0, 0, 350), (0, 0, 0, 1, 0, 0)),
        ((0, 0, 0, -350, 0, 0), (0, 0, 0, 0, 1, 0)),
        ((0, 0, 0, 0, 350, 0), (0, 0, 0, 0, 0, 1)),
    ],
)
def test_frames(counts, axes):
    assert to_robot_axes(counts, 350) == axes
    assert from_robot_axes(axes, 350) == counts


@given(st.tuples(*[st.integers(-500, 500)] * 6))
def test_frames_round_trip(counts):
    assert from_robot_axes(to_robot_axes(counts, 500), 500) == counts


def test_deflection_is_clamped():
    assert to_robot_axes((700, 0, -900, 0, 0, 0), 350) == (-1, -1, 0, 0, 0, 0)


# -- the page -----------------------------------------------------------------------------------


def test_the_page_has_every_function_and_its_worked_bytes_are_right():
    page = (Path(__file__).parents[2] / "plugins/cardan-spnav-server/README.md").read_text(
        encoding="utf-8"
    )
    names = {**vars(codes), **vars(records), **vars(strings)}
    functions = [name for name in names if re.match(r"(de|en)code_", name)]
    assert [name for name in functions if f"\n{name}(" not in page] == []
    rows = re.findall(r"^\| `((?:[0-9a-f]{8} ?){8})` \| `(.*?)`", page, re.MULTILINE)
    assert len(rows) == 3
    if sys.byteorder == "little":
        for record, value in rows:
            assert decode_server_record(bytes.fromhex(record)) == eval(value, names)
