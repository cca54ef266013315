"""The layers of spacenavd's socket: worked records, comparison with the codec, and damaged
records."""

import math
import struct
import sys

import pytest
from hypothesis import example, given, strategies as st

from cardan.protocols.spnav import codes, records as spnav_records, strings
from cardan_spnav_server import dissect as layers, protocol as server
from cardan_spnav_server.dissect import (
    SpnavBroken,
    SpnavDevice,
    SpnavFromClient,
    SpnavFromServer,
    SpnavHandshake,
    SpnavMotion,
    SpnavPress,
    SpnavReply,
    SpnavRequest,
    SpnavSensitivity,
    string_messages,
)

pytestmark = pytest.mark.skipif(
    sys.byteorder != "little", reason="the layers read the records of little-endian machines"
)


def _hex(text):
    return bytes.fromhex(text)


MOTION = _hex("00000000 64000000 38ffffff 2c010000 f6ffffff 14000000 e2ffffff 10000000")
PRESS = _hex("01000000 03000000 01000000" + "00000000" * 5)
DEVICE = _hex("03000000 00000000 00000000 0d020000 6f250000 31c60000 00000000 00000000")
SET_NAME = _hex("0010aa7f 70656572 2d636865 636b0000 00000000 00000000 00000000 0a000000")

WORKED = [
    (SpnavFromServer, _hex("01 55 aa 7f"), SpnavHandshake(version=1)),
    (SpnavFromClient, _hex("01 55 aa 7f"), SpnavHandshake(version=1)),
    (SpnavFromClient, _hex("00 00 00 40"), SpnavSensitivity(sensitivity=2.0)),
    (
        SpnavFromServer,
        MOTION,
        SpnavMotion(x=100, y=-200, z=300, rx=-10, ry=20, rz=-30, period_ms=16),
    ),
    (SpnavFromServer, PRESS, SpnavPress(button=3, pressed=1)),
    (
        SpnavFromServer,
        DEVICE,
        SpnavDevice(device_type=0x20D, vendor=0x256F, product=0xC631),
    ),
    (
        SpnavFromClient,
        SET_NAME,
        string_messages(SpnavRequest, layers.SET_NAME, b"peer-check")[0],
    ),
]


@pytest.mark.parametrize(("entry", "data", "layer"), WORKED, ids=lambda v: type(v).__name__)
def test_worked_records_both_ways(entry, data, layer):
    assert bytes(layer) == data
    dissected = entry(data)
    assert type(dissected) is type(layer)
    dissected.clear_cache()
    assert dissected == layer
    assert bytes(dissected) == data


def test_what_requests_hold():
    request = SpnavFromClient(SET_NAME)
    assert request.title == "SET_NAME"
    assert request.is_text
    assert (request.text, request.remaining, request.continued) == (b"peer-check", 10, False)
    assert request.values == ()
    bits = struct.unpack("<i", struct.pack("<f", 1.5))[0]
    assert SpnavRequest(code=0x1001, words=[bits, *[0] * 5]).values == (1.5,)
    assert SpnavRequest(code=0x3004, words=[2, 7, *[0] * 4]).values == (2, 7)
    unknown = SpnavFromClient(struct.pack("<8i", 0x5FFF, *range(7)))
    assert (unknown.title, unknown.values) == ("0x5fff", (0, 1, 2, 3, 4, 5))
    failed = SpnavFromServer(struct.pack("<8i", 0x7FAA2000, *[0] * 6, -1))
    assert type(failed) is SpnavReply
    assert (failed.last, failed.text) == (layers.FAILED, b"")


def test_records_follow_each_other_and_broken_ones_are_named():
    found = SpnavFromServer(MOTION + PRESS)
    assert type(found) is SpnavMotion
    assert bytes(found.payload) == PRESS
    assert SpnavFromServer(MOTION[:31]).reason == "a record of 31 bytes"
    assert SpnavFromServer(struct.pack("<8i", 9, *[0] * 7)).reason == "event of unknown type 9"
    assert SpnavFromClient(b"123456").reason == "a record of 6 bytes"


@given(st.sampled_from([SpnavFromServer, SpnavFromClient]), st.binary(max_size=70))
@example(SpnavFromServer, b"")
@example(SpnavFromClient, b"")
def test_random_bytes_never_raise(entry, data):
    record = entry(data)
    assert not data or bytes(record) == data


# Against the codec.

i32 = st.integers(-(2**31), 2**31 - 1)
six = st.tuples(*[i32] * 6)
seven = st.tuples(*[i32] * 7)


@given(six, i32)
def test_motion_of_the_codec(axes, period_ms):
    record = SpnavFromServer(server.encode_motion(axes, period_ms))
    assert type(record) is SpnavMotion
    found = tuple(record.getfieldval(name) for name in ("x", "y", "z", "rx", "ry", "rz"))
    assert (*found, record.period_ms) == (*axes, period_ms)
    assert spnav_records.decode_server_record(bytes(record)) == spnav_records.MotionEvent(
        *axes, period_ms
    )


@given(st.integers(0, spnav_records.MAX_BUTTONS - 1), st.booleans())
def test_buttons_of_the_codec(number, pressed):
    record = SpnavFromServer(server.encode_button(number, pressed))
    assert type(record) is (SpnavPress if pressed else layers.SpnavRelease)
    assert (record.button, record.pressed) == (number, pressed)
    raw = layers.SpnavRawButton(button=number, pressed=pressed)
    assert spnav_records.decode_server_record(bytes(raw)) == spnav_records.RawButton(
        number, pressed
    )


@given(st.booleans(), st.integers(0, 2**31 - 1), i32, i32, i32)
def test_devices_of_the_codec(added, number, device_type, vendor, product):
    change = spnav_records.DeviceChange(added, number, device_type, vendor, product)
    record = SpnavFromServer(server.encode_device(change))
    found = (record.device, record.device_type, record.vendor, record.product)
    assert (not record.operation, *found) == change


@given(i32, six, i32)
def test_other_events_of_the_codec(code, data, axis):
    record = SpnavFromServer(server.encode_config(spnav_records.ConfigChange(code, data)))
    found = tuple(record.getfieldval(f"data_{n}") for n in range(6))
    assert (record.code, found) == (code, data)
    raw = layers.SpnavRawAxis(axis=axis, value=code)
    assert spnav_records.decode_server_record(bytes(raw)) == spnav_records.RawAxis(axis, code)


@given(st.integers(0x1000, 0xFFFF) | st.sampled_from(sorted(layers.REQUESTS)), seven)
def test_requests_and_replies_of_the_codec(code, data):
    request = SpnavFromClient(spnav_records.encode_request(code, data))
    assert (request.code, request.mark) == (code, layers.REQUEST_MARK)
    assert (*request.words, request.last) == data
    word = codes.REQUEST_TAG | code
    reply = SpnavFromServer(spnav_records.encode_reply(word, data[:6], data[6]))
    assert type(reply) is SpnavReply
    assert (reply.code, *reply.words, reply.last) == (code, *data)
    assert spnav_records.decode_server_record(bytes(reply)) == spnav_records.ServerReply(word, data)


def test_both_know_the_same_requests_and_devices():
    assert {code: name for code, (name, _) in layers.REQUESTS.items()} == {
        code.value: code.name for code in codes.Code
    }
    assert set(layers.DEVICE_TYPES) == set(codes.DEVICE_TYPES)
    assert set(layers.EVENT_MASK) == {mask.value for mask in codes.EventMask}


@given(st.text(max_size=90))
def test_strings_of_the_codec(text):
    records = strings.encode_string(codes.REQUEST_TAG | 0x2000, text)
    replies = list(map(SpnavFromServer, records))
    assert all(type(reply) is SpnavReply for reply in replies)
    assert b"".join(reply.text for reply in replies) == text.encode()
    assert [reply.continued for reply in replies] == [False, *[True] * (len(replies) - 1)]
    built = string_messages(SpnavReply, 0x2000, text.encode())
    assert list(map(bytes, built)) == records
    assembler = server.StringAssembler()
    taken = [assembler.take((*reply.words, reply.last)) for reply in built]
    assert taken == [*[None] * (len(built) - 1), text]


@given(st.integers(0, 255), st.floats(width=32))
def test_words_of_the_codec(version, sensitivity):
    for entry in (SpnavFromServer, SpnavFromClient):
        handshake = entry(spnav_records.encode_handshake(version))
        assert type(handshake) is SpnavHandshake
        assert handshake.version == version
    record = SpnavFromClient(spnav_records.encode_sensitivity(sensitivity))
    if type(record) is not SpnavHandshake:  # some NaN
        assert type(record) is SpnavSensitivity
        same_nan = math.isnan(record.sensitivity) and math.isnan(sensitivity)
        assert same_nan or record.sensitivity == sensitivity


words = st.integers(0, 2**32 - 1) | st.integers(0, 0xFFF).map(lambda n: codes.REQUEST_TAG | n)


@given(words, st.binary(min_size=28, max_size=28))
@example(7, bytes(28))
@example(codes.REQUEST_TAG | 7, bytes(28))
def test_both_refuse_the_same_events(word, rest):
    data = struct.pack("<I", word) + rest
    if isinstance(SpnavFromServer(data), SpnavBroken):
        assert isinstance(spnav_records.decode_server_record(data), spnav_records.MalformedRecord)
