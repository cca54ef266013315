"""The layers of serial devices: worked packets, comparison with the codec, and damaged packets."""

import pytest
from hypothesis import example, given, strategies as st

from cardan_serial_mice import dissect as layers, protocol as codec
from cardan_serial_mice.dissect import (
    Broken,
    MagellanCompressedMotion,
    MagellanExtendedKeys,
    MagellanKeys,
    MagellanMotion,
    MagellanPacket,
    MagellanText,
    SpaceballExtendedKeys,
    SpaceballKeys,
    SpaceballMotion,
    SpaceballPacket,
    SpaceballText,
    SpaceOrbError,
    SpaceOrbKeys,
    SpaceOrbMotion,
    SpaceOrbPacket,
    SpaceOrbText,
)


def _hex(text):
    return bytes.fromhex(text)


WORKED = [
    (
        MagellanPacket,
        b"dH0?:G?NAH00GGNG0H000H05M\r",
        MagellanMotion(x=250, y=-31, z=7, a=-400, b=0, c=93),
    ),
    (MagellanPacket, b"d" + b"H000" * 6 + b"\r", MagellanMotion()),
    (MagellanPacket, b"kA0A\r", MagellanKeys(keys_1_to_4=1, marked_keys=1)),
    (
        MagellanPacket,
        b"k0800\r".replace(b"8", b"H"),
        MagellanExtendedKeys(keys_5_to_8=8),
    ),
    (
        MagellanPacket,
        _hex("64 a1 a4 9e dc e0 85 80 80 bf bf e0 80 e0 42 0d"),
        MagellanCompressedMotion(x=100, y=-100, z=5, a=-2048, b=2047, c=0),
    ),
    (  # from a real Spaceball 5000
        MagellanPacket,
        _hex("64 e0 80 e0 80 e0 80 e0 80 e0 80 e0 80 a1 80 0d"),
        MagellanCompressedMotion(),
    ),
    (
        SpaceballPacket,
        _hex("44 03 20 03 e8 ff fe 00 5e 4d 5e 51 00 00 5e 5e ff ed 0d"),
        SpaceballMotion(period_sixteenths_ms=800, tx=1000, ty=-2, tz=13, rx=4352, ry=94, rz=-19),
    ),
    (SpaceballPacket, b"KHA\r", SpaceballKeys(key_8=1, key_1=1)),
    (SpaceballPacket, b".A\xc2\r", SpaceballExtendedKeys(key_8=1, key_7=1, key_2=1)),
    (
        SpaceOrbPacket,
        _hex("44 81 df be d9 d1 fc b6 f7 df c5 8b"),
        SpaceOrbMotion(a=1, axes=[100, -100, 200, -200, 300, -300]),
    ),
    (SpaceOrbPacket, _hex("44 80 d3 f0 e1 e3 e5 d7 e1 f2 e5 a1"), SpaceOrbMotion()),
    (SpaceOrbPacket, _hex("4b 85 a1 80 ef"), SpaceOrbKeys(period_10_ms=5, a=1, f=1)),
]


@pytest.mark.parametrize(("entry", "data", "layer"), WORKED, ids=lambda v: type(v).__name__)
def test_worked_packets_both_ways(entry, data, layer):
    assert bytes(layer) == data
    found = entry(data)
    assert type(found) is type(layer)
    for field in layer.fields_desc:
        if field.name != "checksum":
            assert found.getfieldval(field.name) == layer.getfieldval(field.name)
    assert bytes(type(found)(**found.fields)) == data


def test_keys_and_texts():
    assert MagellanPacket(b"kA0A\r").keys == ("1", "*")
    assert MagellanPacket(b"k0H50\r").keys == ("8", "*", "-")
    for entry, data, layer, text in (
        (MagellanPacket, b"v  MAGELLAN  Version 5.79\r", MagellanText, b"  MAGELLAN  Version 5.79"),
        (MagellanPacket, b"z\r", MagellanText, b""),
        (SpaceballPacket, b"@2 Firmware version 2.43\r", SpaceballText, b"2 Firmware version 2.43"),
    ):  # fmt: skip
        found = entry(data)
        assert type(found) is layer
        assert found.text == text
        assert bytes(found) == data


@pytest.mark.parametrize(
    ("entry", "data", "reason"),
    [
        (MagellanPacket, b"", "does not end with CR"),
        (MagellanPacket, b"\r", "unknown letter"),
        (MagellanPacket, b"x\r", "unknown letter"),
        (MagellanPacket, b"dH0\r", "d of 4 bytes"),
        (MagellanPacket, b"d" + b"H001" * 6 + b"\r", "d with a character of no nibble"),
        (MagellanPacket, b"d" + b"\x81" * 14 + b"\r", "d with a byte of no six bits"),
        (MagellanPacket, b"d" + b"\x80" * 14 + b"\r", "d with a wrong checksum"),
        (MagellanPacket, b"k1\r", "k of 3 bytes"),
        (MagellanPacket, b"k111\r", "k with a character of no nibble"),
        (SpaceballPacket, b"D12", "does not end with CR"),
        (SpaceballPacket, b"D12\r", "D of 3 bytes"),
        (SpaceballPacket, b"D^12\r", "D with a broken escape"),
        (SpaceballPacket, b"D^\r", "D with a broken escape"),
        (SpaceballPacket, b"\r", "unknown letter"),
        (SpaceOrbPacket, b"", "unknown letter"),
        (SpaceOrbPacket, b"K\x80", "K of 2 bytes"),
        (SpaceOrbPacket, b"K\x80\x80\x00\xcb", "K with a byte without bit 7"),
        (SpaceOrbPacket, b"K\x80\x80\x80\xca", "K with a wrong checksum"),
    ],
)
def test_what_is_wrong_is_named(entry, data, reason):
    found = entry(data)
    assert isinstance(found, Broken)
    assert found.reason == reason


@given(
    st.sampled_from([MagellanPacket, SpaceballPacket, SpaceOrbPacket]),
    st.sampled_from([row[1] for row in WORKED]),
    st.integers(0, 12),
    st.binary(max_size=30),
    st.booleans(),
)
@example(SpaceOrbPacket, b"!", 1, b"", False)
def test_random_bytes_never_raise(entry, start, retained, rest, ended):
    data = start[:retained] + rest + b"\r" * ended
    found = entry(data)
    if data:
        assert bytes(found) == data
    if isinstance(found, Broken):
        assert found.reason


# Against the codec.

i16 = st.integers(-(2**15), 2**15 - 1)
bits = st.integers(0, 255)
AXES = ("x", "y", "z", "a", "b", "c")


@given(st.tuples(*[i16] * 6), st.tuples(*[st.integers(-2048, 2047)] * 6))
def test_magellan_motion_of_the_codec(plain, compressed):
    for counts, layer in ((plain, MagellanMotion), (compressed, MagellanCompressedMotion)):
        short = layer is MagellanCompressedMotion
        data = codec.encode_magellan_motion(counts, compressed=short)
        found = MagellanPacket(data)
        assert type(found) is layer
        assert tuple(found.getfieldval(axis) for axis in AXES) == counts
        assert bytes(layer(**dict(zip(AXES, counts, strict=True)))) == data
        assert codec.decode_magellan(data[:-1]) == codec.MagellanMotion(*counts)


@given(st.integers(0, 0xFFFF))
def test_magellan_keys_of_the_codec(mask):
    found = MagellanPacket(codec.encode_magellan_keys(mask, extended=True))
    assert isinstance(found, MagellanExtendedKeys if mask >> 12 else MagellanKeys)
    low = found.keys_1_to_4 | found.keys_5_to_8 << 4 | found.marked_keys << 8
    assert low | getattr(found, "more_keys", 0) << 12 == mask
    found = MagellanPacket(codec.encode_magellan_keys(mask, extended=False))
    numbered = {str(n + 1) for n in range(8) if mask >> n & 1}
    assert set(found.keys) == numbered | ({"*"} if mask >> 8 & 1 else set())


@given(st.integers(0, 0xFFFF), st.tuples(*[i16] * 6))
def test_spaceball_motion_of_the_codec(period, axes):
    data = codec.encode_spaceball_motion(codec.SpaceballMotion(period, *axes))
    found = SpaceballPacket(data)
    assert type(found) is SpaceballMotion
    names = ("tx", "ty", "tz", "rx", "ry", "rz")
    assert found.period_sixteenths_ms == period
    assert tuple(found.getfieldval(name) for name in names) == axes
    built = SpaceballMotion(period_sixteenths_ms=period, **dict(zip(names, axes, strict=True)))
    assert bytes(built) == data


@given(bits, bits)
def test_spaceball_keys_of_the_codec(high, low):
    keys = codec.SpaceballKeys(high & 0x3F, low & 0x3F)
    found = SpaceballPacket(codec.encode_spaceball_keys(keys))
    assert type(found) is SpaceballKeys
    names = ("key_5", "key_6", "key_7", "key_8", "pick", "rezero_3003")
    assert [found.getfieldval(n) for n in names] == [keys.high >> n & 1 for n in range(6)]
    names = ("key_1", "key_2", "key_3", "key_4", "left_3003", "right_3003")
    assert [found.getfieldval(n) for n in names] == [keys.low >> n & 1 for n in range(6)]

    advanced = codec.SpaceballAdvancedKeys(high & 0x3F, low & 0xBF)
    found = SpaceballPacket(codec.encode_spaceball_keys(advanced))
    assert type(found) is SpaceballExtendedKeys
    names = ("key_8", "key_9", "key_10", "key_11", "key_12", "handed")
    assert [found.getfieldval(n) for n in names] == [advanced.high >> n & 1 for n in range(6)]
    shown = [found.getfieldval(f"key_{n}") for n in range(1, 8)]
    assert shown == [*(low >> n & 1 for n in range(6)), low >> 7 & 1]


@given(st.binary(max_size=40))
def test_escapes_of_the_codec(data):
    assert layers.escape(data) == codec.escape(data)
    assert layers.unescape(layers.escape(data)) == data
    assert layers.unescape(data) == codec.unescape(data)


status = st.integers(0, 127)
ten_bits = st.integers(-512, 511)


def buttons(packet):
    return sum(packet.getfieldval(name) << n for n, name in enumerate(layers.ORB_BUTTONS))


@given(status, st.tuples(*[ten_bits] * 6), status)
def test_spaceorb_packets_of_the_codec(mask, counts, period):
    data = codec.encode_orb_motion(mask, counts)
    found = SpaceOrbPacket(data)
    assert type(found) is SpaceOrbMotion
    assert (buttons(found), tuple(found.axes)) == (mask, counts)
    assert codec.decode_orb(data) == codec.OrbMotion(mask, *counts)
    found = SpaceOrbPacket(codec.encode_orb_keys(period, mask))
    assert type(found) is SpaceOrbKeys
    assert (buttons(found), found.period_10_ms) == (mask, period)
    found = SpaceOrbPacket(codec.encode_orb_error(period & 7))
    assert type(found) is SpaceOrbError
    assert found.hardware | found.eeprom << 1 | found.brown_out << 2 == period & 7


@given(st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=60))
def test_spaceorb_texts_of_the_codec(text):
    for data in (codec.encode_orb_reset(text), codec.encode_orb_text("!", text.encode())):
        found = SpaceOrbPacket(data)
        assert type(found) is SpaceOrbText
        assert found.text == text.encode()


@given(st.binary(max_size=30), st.sampled_from([b"D", b"K", b".", b"d", b"k", b"E", b"N"]))
def test_both_refuse_the_same_packets(rest, letter):
    line = letter + rest.replace(b"\r", b"")
    magellan, spaceball = MagellanPacket(line + b"\r"), SpaceballPacket(line + b"\r")
    if letter in b"dk":
        refused = isinstance(codec.decode_magellan(line), codec.Malformed)
        assert refused == isinstance(magellan, Broken)
    if letter in b"DK.":
        refused = isinstance(codec.decode_spaceball(line), codec.Malformed)
        assert refused == isinstance(spaceball, Broken)
    orb = letter + bytes(byte | 0x80 for byte in rest)
    if letter in b"DKEN":
        refused = isinstance(codec.decode_orb(orb), codec.Malformed)
        assert refused == isinstance(SpaceOrbPacket(orb), Broken)
