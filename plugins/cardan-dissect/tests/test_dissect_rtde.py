"""Two descriptions of RTDE, and its lines and figures in a capture."""

import math
import struct

import pytest
from hypothesis import given, settings, strategies as st
from scapy.layers.inet import TCP

import dissect_streaming as streaming
from cardan.protocols.ur import rtde as codec
from cardan_dissect import framing, rtde as layers
from cardan_dissect.dissectors.streams import Rtde
from cardan_dissect.network import TCP_FIN, TCP_SYN, Endpoint, Segment
from cardan_dissect.rtde import RtdeReply, RtdeRequest, listed, malformed, values_of
from tests.examples import examples

CONTROLLER, CLIENT = Endpoint("10.0.0.1", 30004), Endpoint("10.0.0.2", 40000)

names = st.lists(st.from_regex(r"[a-z_0-9]{1,20}", fullmatch=True), max_size=6)
words = st.text(max_size=60).filter(lambda text: len(text.encode()) < 256)
TYPES = sorted(codec.TYPES)
LIMITS = {
    "BOOL": st.booleans(),
    "UINT8": st.integers(0, 255),
    "UINT32": st.integers(0, 2**32 - 1),
    "UINT64": st.integers(0, 2**64 - 1),
    "INT32": st.integers(-(2**31), 2**31 - 1),
    "DOUBLE": st.floats(allow_nan=False),
}
VECTORS = {
    "VECTOR3D": ("DOUBLE", 3),
    "VECTOR6D": ("DOUBLE", 6),
    "VECTOR6INT32": ("INT32", 6),
    "VECTOR6UINT32": ("UINT32", 6),
}


def value_of(kind):
    if kind in VECTORS:
        each, count = VECTORS[kind]
        return st.tuples(*[LIMITS[each]] * count)
    return LIMITS[kind]


recipes = st.lists(st.sampled_from(TYPES), min_size=1, max_size=8)


@given(st.data(), recipes, st.integers(1, 255))
def test_values_are_read_alike(data, types, number):
    values = [data.draw(value_of(kind)) for kind in types]
    recipe = codec.Recipe(number, [f"v{n}" for n in range(len(types))], types)
    packed = recipe.pack(values)
    for layer in (RtdeReply(packed), RtdeRequest(packed)):
        assert malformed(layer) is None
        assert layer.recipe == number
        assert values_of(types, layer.values) == [*recipe.unpack(layer.values).values()] == values
        assert bytes(layer) == packed
        assert values_of(types, layer.values + b"\0") is None
        assert values_of(types, layer.values[:-1]) is None


def test_types_that_there_are_not_have_no_values():
    assert values_of(["NOT_FOUND"], bytes(8)) is None
    assert {*layers._ONE, *layers._SEVERAL} == codec.TYPES


@given(st.floats(allow_nan=False, allow_infinity=False), names, st.integers(0, 2**16 - 1))
def test_requests_of_the_codec_are_those_of_the_layers(rate_hz, asked, version):
    joined = ",".join(asked).encode()
    for data, layer in (
        (codec.ask_version(version), layers.RtdeAskVersion(version=version)),
        (codec.packet(codec.PacketType.CONTROLLER_VERSION), layers.RtdeAskController()),
        (
            codec.ask_outputs(rate_hz, asked),
            layers.RtdeAskOutputs(frequency_hz=rate_hz, variables=joined),
        ),
        (codec.ask_inputs(asked), layers.RtdeAskInputs(variables=joined)),
        (codec.packet(codec.PacketType.START), layers.RtdeStart()),
        (codec.packet(codec.PacketType.PAUSE), layers.RtdePause()),
    ):
        assert bytes(layer) == data
        read = RtdeRequest(data)
        assert type(read) is type(layer)
        assert malformed(read) is None
        assert bytes(read) == data
    assert RtdeRequest(codec.ask_outputs(rate_hz, asked)).frequency_hz == rate_hz
    assert listed(RtdeRequest(codec.ask_inputs(asked)).variables) == tuple(asked)


@given(words, words, st.integers(0, 3), names, st.integers(0, 255))
def test_replies_of_the_codec_are_those_of_the_layers(said, source, level, types, number):
    version = codec.ControllerVersion(5, 12, 3, 2**32 - 1)
    joined = ",".join(types).encode()
    kinds = codec.PacketType
    for data, layer in (
        (
            codec.reply_version(version),
            layers.RtdeController(major=5, minor=12, bugfix=3, build_number=2**32 - 1),
        ),
        (
            codec.reply_setup(codec.SetupReply(kinds.OUTPUTS, number, tuple(types))),
            layers.RtdeOutputs(recipe=number, types=joined),
        ),
        (
            codec.reply_setup(codec.SetupReply(kinds.INPUTS, number, tuple(types))),
            layers.RtdeInputs(recipe=number, types=joined),
        ),
        (codec.reply_accepted(kinds.PROTOCOL_VERSION, True), layers.RtdeVersionReply()),
        (codec.reply_accepted(kinds.START, False), layers.RtdeStarted(accepted=0)),
        (codec.reply_accepted(kinds.PAUSE, True), layers.RtdePaused()),
        (
            codec.text(said, source, codec.TextLevel(level)),
            layers.RtdeText(message=said.encode(), source=source.encode(), level=level),
        ),
    ):
        assert bytes(layer) == data
        read = RtdeReply(data)
        assert type(read) is type(layer)
        assert malformed(read) is None
        assert bytes(read) == data


@settings(max_examples=examples(200))
@given(st.binary(max_size=60))
def test_what_the_layers_take_the_codec_takes(payload):
    for kind in (*layers.NAMES, 0, 88):
        data = struct.pack(">HB", 3 + len(payload), kind) + payload
        for dissect, read in ((RtdeReply, codec.read_reply), (RtdeRequest, codec.read_request)):
            layer = dissect(data)
            if malformed(layer) is None:
                assert not isinstance(read(kind, payload), codec.MalformedPayload)
            assert bytes(layer) == data


@given(st.binary(max_size=80))
def test_arbitrary_bytes_never_raise(data):
    for dissect in (RtdeReply, RtdeRequest):
        layer = dissect(data)
        malformed(layer)
        assert bytes(layer) == data


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "empty"),
        (b"\0\4", "shorter than its header"),
        (b"\0\2V", "a size below 3"),
        (b"\0\5V\1", "shorter than its size says"),
        (b"\0\4X\1", "unknown type 88"),
        (b"\0\5V\1\2", "PROTOCOL_VERSION of 2 bytes"),
        (b"\0\3U", "DATA of 0 bytes"),
        (b"\0\5v\1\2", "CONTROLLER_VERSION of 2 bytes"),
        (b"\0\6M\2ab", "TEXT of 3 bytes"),
        (b"\0\6O\1a\xff", "types not UTF-8"),
    ],
)
def test_what_is_wrong_with_a_reply_is_named(data, reason):
    assert malformed(RtdeReply(data)) == reason


def test_what_is_wrong_with_a_request_is_named():
    assert malformed(RtdeRequest(b"\0\4V\1")) == "PROTOCOL_VERSION of 1 bytes"
    assert malformed(RtdeRequest(b"\0\x06O\0\0\0")) == "OUTPUTS of 3 bytes"
    asked = bytes(layers.RtdeAskOutputs(frequency_hz=math.nan))
    assert malformed(RtdeRequest(asked)) == "frequency_hz not finite"


def test_several_packets_of_a_segment_are_read_one_after_the_other():
    data = codec.ask_version() + codec.ask_inputs(("a", "b")) + b"\0\4Z\1"
    read = RtdeRequest(data)
    assert type(read) is layers.RtdeAskVersion
    assert type(read.payload) is layers.RtdeAskInputs
    assert malformed(read.payload.payload) == "unknown type 90"
    assert bytes(read) == data


def test_layers_are_bound_to_the_port():
    for layer, port in ((layers.RtdeAskVersion(), "dport"), (layers.RtdeVersionReply(), "sport")):
        packet = TCP(bytes(TCP(**{port: 30004}) / layer))
        assert type(packet.payload) is type(layer)
        assert getattr(TCP() / layer, port) == 30004


# -- captures -------------------------------------------------------------------------------------


def segments(parts, source, destination, start=1000):
    return streaming.segments(parts, start, source, destination)


def fed(listed, period_s=0.002):
    """Return the lines without addresses, and the final summary."""
    return streaming.fed(streaming.opened(Rtde), listed, period_s)


NAMES = ("timestamp", "actual_q", "robot_mode")
KINDS = ("DOUBLE", "VECTOR6D", "INT32")


def asked():
    return [
        codec.ask_version(),
        codec.packet(codec.PacketType.CONTROLLER_VERSION),
        codec.ask_outputs(500.0, NAMES),
        codec.ask_inputs(("input_int_register_24", "nothing")),
        codec.packet(codec.PacketType.START),
    ]


def answered():
    kinds = codec.PacketType
    return [
        codec.reply_accepted(kinds.PROTOCOL_VERSION, True),
        codec.reply_version(codec.ControllerVersion(5, 12, 0, 1)),
        codec.reply_setup(codec.SetupReply(kinds.OUTPUTS, 1, KINDS)),
        codec.reply_setup(codec.SetupReply(kinds.INPUTS, 0, ("IN_USE", "NOT_FOUND"))),
        codec.reply_accepted(kinds.START, True),
    ]


def states(*times_s):
    recipe = codec.Recipe(1, NAMES, KINDS)
    return [recipe.pack([time_s, (0.5,) * 6, 7]) for time_s in times_s]


def conversation(*more):
    asks = segments(asked(), CLIENT, CONTROLLER)
    says = segments([*answered(), *more], CONTROLLER, CLIENT, 5000)
    paired = [each for pair in zip(asks, says, strict=False) for each in pair]
    return [*paired, *says[len(asks) :]]


def test_a_connection_has_its_lines_and_figures():
    lines, said = fed(conversation(*states(1.0, 1.002, 1.006, 1.008)))
    assert lines[:4] == [
        "RTDE PROTOCOL_VERSION | kind PROTOCOL_VERSION | version 2",
        "RTDE PROTOCOL_VERSION | kind PROTOCOL_VERSION | accepted True",
        "RTDE CONTROLLER_VERSION | kind CONTROLLER_VERSION | version 0",
        "RTDE CONTROLLER_VERSION | major 5 | minor 12 | bugfix 0 | build 1",
    ]
    assert lines[4:8] == [
        "RTDE OUTPUTS | kind OUTPUTS | names 'timestamp' 'actual_q' 'robot_mode' | "
        "frequency_hz 500",
        "RTDE OUTPUTS | kind OUTPUTS | recipe 1 | types 'DOUBLE' 'VECTOR6D' 'INT32'",
        "RTDE INPUTS | kind INPUTS | names 'input_int_register_24' 'nothing' | frequency_hz 0",
        "RTDE INPUTS | kind INPUTS | recipe 0 | types 'IN_USE' 'NOT_FOUND' | "
        "REFUSED input_int_register_24 IN_USE | REFUSED nothing NOT_FOUND",
    ]
    assert lines[10] == (
        "RTDE DATA recipe 1 | timestamp 1 | actual_q 0.5 0.5 0.5 0.5 0.5 0.5 | robot_mode 7"
    )
    assert said == [
        "10.0.0.2:40000 > 10.0.0.1:30004: 5 segments, retransmitted 0 out of order 0 gaps 0",
        "  5 messages",
        "  RTDE PROTOCOL_VERSION x1",
        "  RTDE CONTROLLER_VERSION x1",
        "  RTDE OUTPUTS x1",
        "  RTDE INPUTS x1",
        "  RTDE START x1",
        "  answers x4, after: median 2.000 p99 2.000 ms",
        "10.0.0.1:30004 > 10.0.0.2:40000: 9 segments, retransmitted 0 out of order 0 gaps 0",
        "  9 messages",
        "  RTDE DATA recipe 1 x4, period mean 2.000 min 2.000 max 2.000 ms, "
        "lost 1 duplicate 0 out of order 0 restarts 0 (steps by 2)",
        "  RTDE PROTOCOL_VERSION x1",
        "  RTDE CONTROLLER_VERSION x1",
        "  RTDE OUTPUTS x1",
        "  RTDE INPUTS x1",
        "  RTDE START x1",
        "  remarks: REFUSED input_int_register_24 IN_USE x1, REFUSED nothing NOT_FOUND x1",
        "  answers x5, after: median 2.000 p99 2.000 ms",
    ]


def test_damage_texts_and_what_nobody_asked_for():
    wrong = codec.packet(codec.PacketType.DATA, b"\1" + bytes(4))
    text = codec.text("too fast", "Controller", codec.TextLevel.WARNING)
    lines, said = fed(
        conversation(
            wrong,
            text,
            codec.reply_setup(codec.SetupReply(codec.PacketType.OUTPUTS, 3, KINDS)),
            codec.packet(codec.PacketType.DATA, b"\2" + bytes(4)),
            b"\0\4X\1",
        )
    )
    assert lines[10:] == [
        "MALFORMED RTDE: values that are not of their recipe's types "
        "(8 B: 00 08 55 01 00 00 00 00)",
        "RTDE TEXT | text 'too fast' | source 'Controller' | level 2",
        "RTDE OUTPUTS | kind OUTPUTS | recipe 3 | types 'DOUBLE' 'VECTOR6D' 'INT32' | "
        "ANSWERS NO REQUEST",
        "RTDE DATA recipe 2 | recipe 2 | values 00 00 00 00 | RECIPE NOT IN THE CAPTURE",
        "MALFORMED RTDE: type 88 is unknown (4 B: 00 04 58 01)",
    ]
    counted = "values that are not of their recipe's types x1, type 88 is unknown x1"
    assert f"  malformed: {counted}" in said


@pytest.mark.parametrize("time_s", [math.nan, math.inf, 1e300, -1e300])
def test_a_clock_that_tells_nonsense_is_shown(time_s):
    lines, said = fed(conversation(*states(time_s, 1.0, time_s)))
    assert lines[-1].startswith(f"RTDE DATA recipe 1 | timestamp {time_s:.8g} | ")
    assert not any("malformed" in line for line in said)
    assert any("RTDE DATA recipe 1 x3" in line and "lost 0" in line for line in said)


def test_a_timestamp_of_another_type_is_no_time():
    kinds = ("VECTOR3D", "BOOL", "UINT64")
    reported = codec.reply_setup(codec.SetupReply(codec.PacketType.OUTPUTS, 2, kinds))
    data = codec.Recipe(2, NAMES, kinds).pack([(1.0, 2.0, 3.0), True, 2**40])
    asks = segments([codec.ask_outputs(125.0, NAMES)], CLIENT, CONTROLLER)
    lines, _ = fed([*asks, *segments([reported, data, data], CONTROLLER, CLIENT)])
    assert lines[-1] == (
        "RTDE DATA recipe 2 | timestamp 1 2 3 | actual_q True | robot_mode 1099511627776"
    )


def test_a_new_connection_has_no_recipes():
    again = [
        Segment("TCP", CLIENT, CONTROLLER, b"", False, 90_000, TCP_SYN),
        Segment("TCP", CONTROLLER, CLIENT, b"", False, 80_000, TCP_SYN),
        *segments(states(2.0), CONTROLLER, CLIENT, 80_001),
    ]
    lines, _ = fed([*conversation(*states(1.0)), *again])
    assert lines[-1].endswith("RECIPE NOT IN THE CAPTURE")


def test_joining_in_the_middle_and_an_early_end():
    one, two, three = states(1.0, 1.002, 1.004)
    parts = segments([one[20:], two, three[:30]], CONTROLLER, CLIENT)
    parts[-1] = parts[-1]._replace(flags=TCP_FIN)
    lines, said = fed(parts)
    assert lines[0] == f"SKIPPED {len(one) - 20} bytes that begin no message"
    assert lines[1].startswith("RTDE DATA recipe 1")
    assert "MALFORMED RTDE: the connection ends inside a message (30 B" in lines[2]
    assert "  malformed: the connection ends inside a message x1" in said


@settings(max_examples=examples(60))
@given(st.data())
def test_splitting_and_reordering_change_nothing(data):
    messages = states(*(1.0 + 0.002 * n for n in range(5)))
    said = [*answered(), *messages]
    expected, _ = fed(segments(said, CONTROLLER, CLIENT))
    stream = b"".join(said)
    cuts = sorted(data.draw(st.sets(st.integers(1, len(stream) - 1), max_size=12)))
    parts = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    start = Segment("TCP", CONTROLLER, CLIENT, b"", False, 999, TCP_SYN)
    mixed = data.draw(st.permutations(segments(parts, CONTROLLER, CLIENT)))
    lines, said = fed([start, *mixed])
    assert lines == expected
    assert not any("malformed" in line for line in said)


@given(st.lists(st.tuples(st.binary(max_size=60), st.integers(0, 2**32 - 1), st.booleans())))
def test_arbitrary_segments_never_raise(parts):
    made = []
    for payload, sequence, back in parts:
        ends = (CONTROLLER, CLIENT) if back else (CLIENT, CONTROLLER)
        made.append(Segment("TCP", *ends, payload, False, sequence, sequence % 64))
    fed([*conversation(*states(1.0)), *made])


def test_flows_without_end_are_bounded(monkeypatch):
    monkeypatch.setattr(framing, "MOST_FLOWS", 3)
    monkeypatch.setattr(framing, "MOST_ABOUT", 5)
    dissector = streaming.opened(Rtde)
    listed = [
        each
        for port in range(40000, 40010)
        for each in segments(states(1.0), CONTROLLER, Endpoint("10.0.0.2", port))
    ]
    lines, _ = streaming.fed(dissector, listed, 0.002)
    assert len(lines) == 10
    assert len(dissector._flows) == 3
    assert len(dissector._about) == 5
