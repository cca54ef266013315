"""RTDE packets: worked bytes of the vendor's guide, split streams, malformed packets, recipes."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings, strategies as st

from cardan.protocols.ur import rtde
from cardan.protocols.ur.rtde import (
    Accepted,
    ControllerVersion,
    ControlRequest,
    Data,
    MalformedPayload,
    PacketReader,
    PacketType,
    Recipe,
    RecipeSetup,
    SetupReply,
    TextLevel,
    TextMessage,
)
from cardan.protocols.ur.states import SafetyBit, StatusBit
from cardan.protocols.ur.variables import INPUTS, OUTPUTS
from tests.examples import examples

WORKED = [
    (rtde.ask_version(), "0005560002", ControlRequest(PacketType.PROTOCOL_VERSION, 2)),
    (
        rtde.packet(PacketType.CONTROLLER_VERSION),
        "000376",
        ControlRequest(PacketType.CONTROLLER_VERSION),
    ),
    (rtde.packet(PacketType.START), "000353", ControlRequest(PacketType.START)),
    (rtde.packet(PacketType.PAUSE), "000350", ControlRequest(PacketType.PAUSE)),
    (
        rtde.ask_outputs(125.0, ["actual_q", "timestamp"]),
        "001d4f405f400000000000" + b"actual_q,timestamp".hex(),
        RecipeSetup(PacketType.OUTPUTS, ("actual_q", "timestamp"), 125.0),
    ),
    (
        rtde.ask_inputs(["speed_slider_mask"]),
        "001449" + b"speed_slider_mask".hex(),
        RecipeSetup(PacketType.INPUTS, ("speed_slider_mask",)),
    ),
    (
        rtde.text("hi", "me", TextLevel.WARNING),
        "000a4d" + "026869" + "026d65" + "02",
        TextMessage("hi", "me", 2),
    ),
]
REPLIES = [
    (
        rtde.reply_accepted(PacketType.PROTOCOL_VERSION, True),
        "00045601",
        Accepted(PacketType.PROTOCOL_VERSION, True),
    ),
    (
        rtde.reply_version(ControllerVersion(5, 12, 0, 77)),
        "001376" + "00000005" + "0000000c" + "00000000" + "0000004d",
        ControllerVersion(5, 12, 0, 77),
    ),
    (
        rtde.reply_setup(SetupReply(PacketType.OUTPUTS, 1, ("VECTOR6D", "DOUBLE"))),
        "00134f01" + b"VECTOR6D,DOUBLE".hex(),
        SetupReply(PacketType.OUTPUTS, 1, ("VECTOR6D", "DOUBLE")),
    ),
    (
        Recipe(3, ["timestamp", "robot_mode"], ["DOUBLE", "INT32"]).pack([1.0, 7]),
        "00105503" + "3ff0000000000000" + "00000007",
        Data(3, bytes.fromhex("3ff000000000000000000007")),
    ),
]


def taken(data):
    reader = PacketReader()
    reader.feed(data)
    found = reader.take()
    assert found is not None
    return found


@pytest.mark.parametrize(("made", "worked", "read"), WORKED)
def test_a_clients_packets(made, worked, read):
    assert made == bytes.fromhex(worked)
    assert rtde.read_request(*taken(made)) == read


@pytest.mark.parametrize(("made", "worked", "read"), REPLIES)
def test_a_controllers_packets(made, worked, read):
    assert made == bytes.fromhex(worked)
    assert rtde.read_reply(*taken(made)) == read


@pytest.mark.parametrize(
    ("kind", "payload", "read"),
    [
        (ord("O"), b"DOUBLE,VECTOR6D", SetupReply(PacketType.OUTPUTS, 1, ("DOUBLE", "VECTOR6D"))),
        (ord("O"), b"DOUBLE,NOT_FOUND", SetupReply(PacketType.OUTPUTS, 0, ("DOUBLE", "NOT_FOUND"))),
        (ord("O"), b"", SetupReply(PacketType.OUTPUTS, 0, ())),
        (ord("I"), b"\2INT32", SetupReply(PacketType.INPUTS, 2, ("INT32",))),
        (ord("U"), b"\2\1", Data(0, b"\2\1")),
        (ord("M"), b"\1no", rtde.TextMessage("no", "", 1)),
        (ord("V"), b"\1", Accepted(PacketType.PROTOCOL_VERSION, True)),
    ],
)
def test_a_controllers_packets_in_version_1(kind, payload, read):
    assert rtde.read_reply(kind, payload, 1) == read


def test_a_list_that_ends_with_a_comma():
    found = rtde.read_request(PacketType.INPUTS, b"speed_slider_mask,")
    assert found == RecipeSetup(PacketType.INPUTS, ("speed_slider_mask",))


@given(st.lists(st.integers(1, 40)))
def test_any_pieces_give_the_same_packets(sizes):
    stream = b"".join(made for made, _, _ in WORKED + REPLIES)
    reader, found, at = PacketReader(), [], 0
    for size in [*sizes, len(stream)]:
        reader.feed(stream[at : at + size])
        at += size
        while (each := reader.take()) is not None:
            found.append(each)
    assert found == [taken(made) for made, _, _ in WORKED + REPLIES]
    assert not reader.failure


def test_a_size_that_no_packet_has():
    reader = PacketReader()
    reader.feed(b"\0\1U")
    assert reader.take() is None
    assert reader.failure == "a packet of 1 bytes: not an RTDE server"


@pytest.mark.parametrize(
    ("kind", "payload", "reason"),
    [
        (ord("V"), b"", "a version of 0 bytes"),
        (ord("S"), b"1", "1 bytes too many"),
        (ord("O"), b"1234", "has no frequency"),
        (ord("U"), b"", "a data package of 0 bytes"),
        (ord("M"), b"\x05ab", "cut"),
        (0x58, b"", "type 88 is unknown"),
    ],
)
def test_what_no_client_means(kind, payload, reason):
    found = rtde.read_request(kind, payload)
    assert isinstance(found, MalformedPayload)
    assert reason in found.reason


@pytest.mark.parametrize(
    ("kind", "payload", "reason"),
    [
        (ord("V"), b"", "an answer of 0 bytes"),
        (ord("v"), b"\0" * 15, "a version of 15 bytes"),
        (ord("O"), b"", "a recipe of 0 bytes"),
        (ord("U"), b"", "a data package of 0 bytes"),
        (ord("M"), b"", "cut"),
        (0x58, b"", "type 88 is unknown"),
    ],
)
def test_what_no_controller_means(kind, payload, reason):
    found = rtde.read_reply(kind, payload)
    assert isinstance(found, MalformedPayload)
    assert reason in found.reason


@settings(max_examples=examples(50))
@given(st.integers(0, 255), st.binary(max_size=60))
def test_nothing_that_comes_raises(kind, payload):
    for version in rtde.VERSIONS:
        rtde.read_reply(kind, payload, version)
        rtde.read_request(kind, payload, version)


@settings(max_examples=examples(30))
@given(st.lists(st.sampled_from(sorted(OUTPUTS)), min_size=1, max_size=12, unique=True), st.data())
def test_a_recipe_gives_back_what_it_packed(names, data):
    recipe = Recipe(1, names, [OUTPUTS[name] for name in names])
    values = [data.draw(_VALUES[OUTPUTS[name]]) for name in names]
    kind, payload = taken(recipe.pack(values))
    assert (kind, payload[0]) == (PacketType.DATA, 1)
    assert recipe.unpack(payload[1:]) == dict(zip(names, values, strict=True))
    assert recipe.unpack(payload) is None


_FLOATS = st.floats(allow_nan=False)
_VALUES = {
    "BOOL": st.booleans(),
    "UINT8": st.integers(0, 255),
    "UINT32": st.integers(0, 2**32 - 1),
    "UINT64": st.integers(0, 2**64 - 1),
    "INT32": st.integers(-(2**31), 2**31 - 1),
    "DOUBLE": _FLOATS,
    "VECTOR3D": st.tuples(*[_FLOATS] * 3),
    "VECTOR6D": st.tuples(*[_FLOATS] * 6),
    "VECTOR6INT32": st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 6),
    "VECTOR6UINT32": st.tuples(*[st.integers(0, 2**32 - 1)] * 6),
}


def test_every_variable_has_a_type_that_can_be_packed():
    assert set(OUTPUTS.values()) | set(INPUTS.values()) <= rtde.TYPES == set(_VALUES)


def test_recipes_that_cannot_be():
    with pytest.raises(ValueError, match="a: NOT_FOUND"):
        Recipe(1, ["a"], ["NOT_FOUND"])
    with pytest.raises(ValueError, match="1 types for 2 variables"):
        Recipe(1, ["a", "b"], ["DOUBLE"])
    with pytest.raises(struct.error):
        Recipe(1, ["a"], ["UINT8"]).pack([256])
    with pytest.raises(ValueError, match="65536 bytes"):
        rtde.packet(PacketType.TEXT, bytes(65533))


def test_bits_of_status_and_safety_are_numbered_without_gaps():
    assert list(StatusBit) == [1 << bit for bit in range(4)]
    assert list(SafetyBit) == [1 << bit for bit in range(11)]
