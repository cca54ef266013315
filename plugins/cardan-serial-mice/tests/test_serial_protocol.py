"""The serial protocols: worked bytes, round trips, and streams in any pieces with noise."""

import itertools

import pytest
from hypothesis import given, strategies as st

from cardan.protocols.connexion.reports import to_robot_axes
from cardan_serial_mice.protocol import (
    SERIAL_MODELS,
    CommandReader,
    MagellanEcho,
    MagellanError,
    MagellanKeys,
    MagellanMotion,
    MagellanReader,
    MagellanVersion,
    Malformed,
    OrbError,
    OrbKeys,
    OrbMotion,
    OrbReader,
    OrbReset,
    OrbText,
    SpaceballAdvancedKeys,
    SpaceballEcho,
    SpaceballError,
    SpaceballKeys,
    SpaceballMotion,
    SpaceballReader,
    SpaceballReset,
    button_mask,
    decode_magellan,
    decode_orb,
    decode_spaceball,
    encode_magellan_keys,
    encode_magellan_motion,
    encode_orb_error,
    encode_orb_keys,
    encode_orb_motion,
    encode_orb_reset,
    encode_orb_text,
    encode_spaceball_keys,
    encode_spaceball_motion,
    escape,
    from_hid_counts,
    keys_of_mask,
    model_of_firmware,
    model_of_version,
    serial_model_by_key,
    to_hid_counts,
    unescape,
)
from cardan_serial_mice.protocol.values import (
    BAD_CHECKSUM,
    BAD_CODE,
    BAD_LENGTH,
    TOO_LONG,
    UNKNOWN_LETTER,
)

READERS = [MagellanReader, SpaceballReader, OrbReader]
INT16 = st.integers(-0x8000, 0x7FFF)
SIX = st.tuples(*[INT16] * 6)
REST = (0, 0, 0, 0, 0, 0)


def in_pieces(reader, stream, cuts):
    """Return `reader`'s values for `stream`, cut at `cuts`."""
    values = []
    edges = sorted({0, len(stream), *(cut % (len(stream) + 1) for cut in cuts)})
    for begin, end in itertools.pairwise(edges):
        values += reader.feed(stream[begin:end])
    return values


# -- worked bytes ------------------------------------------------------------------------------


@pytest.mark.judged(
    device="Magellan and Spaceball 5000", transport="serial packets", by="worked bytes"
)
def test_magellan_worked():
    motion = MagellanMotion(250, -31, 7, -400, 0, 93)
    assert decode_magellan(b"dH0?:G?NAH00GGNG0H000H05M") == motion
    assert encode_magellan_motion(motion) == b"dH0?:G?NAH00GGNG0H000H05M\r"
    assert encode_magellan_motion(REST) == b"dH000H000H000H000H000H000\r"
    assert decode_magellan(b"kA0A") == MagellanKeys(0b1_0000_0001)
    assert encode_magellan_keys(0b1_0000_0001, extended=False) == b"kA0A\r"
    compressed = bytes.fromhex("64 a1 a4 9e dc e0 85 80 80 bf bf e0 80 e0 42 0d")
    motion = MagellanMotion(100, -100, 5, -2048, 2047, 0)
    assert MagellanReader().feed(compressed) == [motion]
    assert encode_magellan_motion(motion, compressed=True) == compressed


@pytest.mark.judged(device="Spaceball 5000", transport="serial packets", by="published captures")
def test_the_capture_of_a_resting_spaceball_5000():
    packet = bytes.fromhex("64 e0 80 e0 80 e0 80 e0 80 e0 80 e0 80 a1 80 0d")
    assert MagellanReader().feed(packet) == [MagellanMotion(*REST)]
    assert encode_magellan_motion(REST, compressed=True) == packet


@pytest.mark.judged(
    device="Spaceball 2003, 3003, 4000 FLX", transport="serial packets", by="worked bytes"
)
def test_spaceball_worked():
    packet = bytes.fromhex("44 03 20 03 e8 ff fe 00 5e 4d 5e 51 00 00 5e 5e ff ed 0d")
    motion = SpaceballMotion(800, 1000, -2, 13, 4352, 94, -19)
    assert SpaceballReader().feed(packet) == [motion]
    assert encode_spaceball_motion(motion) == packet


@pytest.mark.judged(device="SpaceOrb 360", transport="serial packets", by="worked bytes")
def test_spaceorb_worked():
    packet = bytes.fromhex("44 81 df be d9 d1 fc b6 f7 df c5 8b")
    motion = OrbMotion(1, 100, -100, 200, -200, 300, -300)
    assert OrbReader().feed(packet) == [motion]
    assert encode_orb_motion(motion.status, motion[1:]) == packet
    rest = bytes.fromhex("44 80 d3 f0 e1 e3 e5 d7 e1 f2 e5 a1")
    assert encode_orb_motion(0, REST) == rest
    assert bytes(byte & 0x7F for byte in rest[2:11]) == b"SpaceWare"
    keys = bytes.fromhex("4b 85 a1 80 ef")
    assert OrbReader().feed(keys) == [OrbKeys(5, 0b100001)]
    assert encode_orb_keys(5, 0b100001) == keys


# -- round trips -------------------------------------------------------------------------------


@given(SIX)
def test_magellan_motion_round_trip(counts):
    packet = encode_magellan_motion(counts)
    assert decode_magellan(packet[:-1]) == MagellanMotion(*counts)


@given(st.tuples(*[st.integers(-2048, 2047)] * 6))
def test_compressed_motion_round_trip(counts):
    packet = encode_magellan_motion(counts, compressed=True)
    assert len(packet) == 16
    assert b"\r" not in packet[:-1]
    assert decode_magellan(packet[:-1]) == MagellanMotion(*counts)


@given(st.integers(0, 0xFFFF))
def test_magellan_keys_round_trip(mask):
    assert decode_magellan(encode_magellan_keys(mask, extended=True)[:-1]) == MagellanKeys(mask)


@given(st.integers(0, 0xFFFF), SIX)
def test_spaceball_motion_round_trip(period, counts):
    motion = SpaceballMotion(period, *counts)
    packet = encode_spaceball_motion(motion)
    assert packet.count(b"\r") == 1
    assert not {0x11, 0x13} & set(packet)
    assert decode_spaceball(packet[:-1]) == motion


@given(st.binary(max_size=40))
def test_escaping_is_undone(data):
    assert unescape(escape(data)) == data


@given(st.integers(0, 127), st.tuples(*[st.integers(-512, 511)] * 6))
def test_spaceorb_motion_round_trip(status, counts):
    assert decode_orb(encode_orb_motion(status, counts)) == OrbMotion(status, *counts)


@pytest.mark.parametrize(
    "model", [m for m in SERIAL_MODELS if m.protocol == "spaceball"], ids=lambda m: m.key
)
def test_buttons_of_a_spaceball_round_trip(model):
    for bits in range(1 << len(model.buttons)):
        keys = keys_of_mask(model, bits)
        packet = encode_spaceball_keys(keys)
        assert all(byte & 0x40 for byte in unescape(packet[1:-1]))
        assert button_mask(model, decode_spaceball(packet[:-1])) == bits


def test_values_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="not all in -32768"):
        encode_magellan_motion((0x8000, 0, 0, 0, 0, 0))
    with pytest.raises(ValueError, match="not all in -2048"):
        encode_magellan_motion((2048, 0, 0, 0, 0, 0), compressed=True)
    with pytest.raises(ValueError, match="cannot encode"):
        encode_spaceball_motion(SpaceballMotion(-1, *REST))
    with pytest.raises(ValueError, match="not all in -512"):
        encode_orb_motion(0, (512, 0, 0, 0, 0, 0))


# -- other packets -----------------------------------------------------------------------------


def test_what_else_a_magellan_says():
    version = b"v   MAGELLAN  Version 5.79  by LOGITECH INC. 10/10/97 "
    stream = version + b"\rm3\rc33\rz\reAx\r"
    assert MagellanReader().feed(stream) == [
        MagellanVersion("MAGELLAN  Version 5.79  by LOGITECH INC. 10/10/97"),
        MagellanEcho(b"m3"), MagellanEcho(b"c33"), MagellanEcho(b"z"),
        MagellanError(1, b"x"),
    ]  # fmt: skip
    assert model_of_version("MAGELLAN  Version 6.60").key == "magellan"
    assert model_of_version("SPACEBALL  Version 7.01").key == "spaceball-5000"


def test_what_else_a_spaceball_says():
    stream = b"\x11\r\n@1 Spaceball alive\r\x13CB@\r?x\rEAB\r.\x60\xc1\rK\x44\x41\r"
    assert SpaceballReader().feed(stream) == [
        SpaceballReset("1 Spaceball alive"), SpaceballEcho(ord("C"), b"B@"),
        SpaceballError(ord("?"), "x"), SpaceballError(ord("E"), "AB"),
        SpaceballAdvancedKeys(0x60, 0xC1), SpaceballKeys(0x44, 0x41),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("2 Firmware version 2.13 created on 24-Oct-1991.", "spaceball-2003"),
        ("2 Firmware version 2.63 created on 24-Oct-1991.", "spaceball-3003"),
        ("2 Firmware version 2.43 created on 24-Oct-1991.", "spaceball-4000"),
        ("2 Firmware version 2.42 created on 24-Oct-1991.", "spaceball-2003"),
        ("2 Firmware version 2.99 created on 24-Oct-1991.", None),
        ("1 Spaceball alive and well after a poweron reset.", None),
    ],
)
def test_a_spaceball_is_reported_by_its_firmware(text, key):
    model = model_of_firmware(text)
    assert (model.key if model else None) == key


def test_what_else_a_spaceorb_says():
    text = " Spaceball (R) V4.34 19-Oct-96 Copyright (C) 1996"
    stream = b"\r" + encode_orb_reset(text) + encode_orb_error(5) + encode_orb_text("N", b"\x08")
    assert OrbReader().feed(stream) == [OrbReset(text.strip()), OrbError(5), OrbText(78, b"\x08")]
    # A packet without a length ends at the next packet, or at a carriage return.
    reader = OrbReader()
    assert reader.feed(encode_orb_reset(text)) == []
    assert reader.feed(b"\r") == [OrbReset(text.strip())]


def test_commands_end_in_cr():
    reader = CommandReader()
    assert reader.feed(b"m3") == []
    assert reader.pending
    assert reader.feed(b"\r\rvQ\rz") == [b"m3", b"", b"vQ"]
    reader.reset()
    assert not reader.pending
    assert len(reader.feed(b"x" * 5000 + b"\r")[0]) < 500


# -- streams -----------------------------------------------------------------------------------

STREAMS = {
    MagellanReader: encode_magellan_motion(range(6)) + encode_magellan_keys(5, extended=True)
    + encode_magellan_motion(range(6), compressed=True) + b"m3\r",
    SpaceballReader: b"\x11\r@1 Spaceball alive\r"
    + encode_spaceball_motion(SpaceballMotion(800, 13, 17, 19, 94, -1, 0))
    + encode_spaceball_keys(SpaceballKeys(1, 30)),
    OrbReader: encode_orb_reset("x") + encode_orb_motion(1, range(6)) + encode_orb_keys(100, 2)
    + encode_orb_motion(0, REST),
}  # fmt: skip


@pytest.mark.parametrize("kind", READERS)
@given(cuts=st.lists(st.integers(0, 200), max_size=8))
def test_pieces_do_not_matter(kind, cuts):
    whole = kind().feed(STREAMS[kind])
    assert not any(isinstance(value, Malformed) for value in whole)
    assert in_pieces(kind(), STREAMS[kind], cuts) == whole


@pytest.mark.parametrize("kind", READERS)
@given(noise=st.binary(max_size=600), cuts=st.lists(st.integers(0, 900), max_size=5))
def test_noise_never_raises_and_never_sticks(kind, noise, cuts):
    reader = kind()
    in_pieces(reader, noise, cuts)
    reader.feed(b"\r")
    assert reader.feed(STREAMS[kind]) == kind().feed(STREAMS[kind])


@pytest.mark.parametrize("decode", [decode_magellan, decode_spaceball, decode_orb])
@given(data=st.binary(max_size=40))
def test_decoding_never_raises(decode, data):
    decode(data)


@pytest.mark.parametrize("compressed", [False, True])
@given(at=st.integers(1, 13), bit=st.integers(0, 7))
def test_a_flipped_bit_of_magellan_motion_is_noticed(compressed, at, bit):
    packet = bytearray(encode_magellan_motion((250, -31, 7, -400, 0, 93), compressed=compressed))
    packet[at] ^= 1 << bit
    assert not any(isinstance(v, MagellanMotion) for v in MagellanReader().feed(bytes(packet)))


@given(at=st.integers(1, 11), bit=st.integers(0, 6))
def test_a_flipped_bit_of_spaceorb_motion_is_noticed(at, bit):
    packet = bytearray(encode_orb_motion(1, (250, -31, 7, -400, 0, 93)))
    packet[at] ^= 1 << bit
    assert OrbReader().feed(bytes(packet)) == [Malformed(BAD_CHECKSUM, ord("D"))]


@pytest.mark.parametrize("compressed", [False, True])
@given(size=st.integers(1, 14))
def test_half_a_magellan_packet_does_not_take_the_next_with_it(compressed, size):
    packet = encode_magellan_motion((250, -31, 7, -400, 0, 93), compressed=compressed)
    first, second = MagellanReader().feed(packet[:size] + packet)
    assert isinstance(first, Malformed)
    assert second == MagellanMotion(250, -31, 7, -400, 0, 93)


def test_reasons():
    assert decode_magellan(b"dH000") == Malformed(BAD_LENGTH, ord("d"))
    assert decode_magellan(b"d" + b"1" * 24) == Malformed(BAD_CODE, ord("d"))
    assert decode_magellan(b"k12") == Malformed(BAD_LENGTH, ord("k"))
    assert decode_magellan(b"k111") == Malformed(BAD_CODE, ord("k"))
    assert decode_magellan(b"#") == Malformed(UNKNOWN_LETTER, ord("#"))
    assert decode_spaceball(b"D12^x") == Malformed(BAD_CODE, ord("D"))
    assert decode_spaceball(b"K1") == Malformed(BAD_LENGTH, ord("K"))
    assert decode_spaceball(b"~") == Malformed(UNKNOWN_LETTER, ord("~"))
    assert decode_orb(b"x\x80") == Malformed(UNKNOWN_LETTER, ord("x"))
    assert decode_orb(b"K\x80") == Malformed(BAD_LENGTH, ord("K"))
    for kind, packet in ((MagellanReader, b"v"), (SpaceballReader, b"@"), (OrbReader, b"R")):
        filler = b"\x81" if kind is OrbReader else b"x"
        long = packet + filler * 400
        assert kind().feed(long)[0] == Malformed(TOO_LONG, packet[0])
        assert kind().feed(long + b"\r")[0] == Malformed(TOO_LONG, packet[0])


# -- frames ------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", SERIAL_MODELS, ids=lambda m: m.key)
@given(SIX)
def test_frames_are_inverse(model, counts):
    assert from_hid_counts(model, to_hid_counts(model, counts)) == counts


@pytest.mark.parametrize("key", ["magellan", "spaceball-2003", "spaceorb"])
@pytest.mark.parametrize(
    ("native", "robot"),
    [
        ((0, 0, -100, 0, 0, 0), (1, 0, 0, 0, 0, 0)),
        ((-100, 0, 0, 0, 0, 0), (0, 1, 0, 0, 0, 0)),
        ((0, 100, 0, 0, 0, 0), (0, 0, 1, 0, 0, 0)),
        ((0, 0, 0, 0, 0, -100), (0, 0, 0, 1, 0, 0)),
        ((0, 0, 0, -100, 0, 0), (0, 0, 0, 0, 1, 0)),
        ((0, 0, 0, 0, 100, 0), (0, 0, 0, 0, 0, 1)),
    ],
)
def test_native_axes_in_the_frame_of_robots(key, native, robot):
    model = serial_model_by_key(key)
    if model.protocol == "spaceball":  # its Z points away from the operator
        x, y, z, a, b, c = native
        native = (x, y, -z, a, b, -c)
    assert to_robot_axes(to_hid_counts(model, native), 100) == robot
