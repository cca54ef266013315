"""Two descriptions of the joint stream, and its lines in a capture."""

import io
import math
import re
from pathlib import Path

import pytest
from hypothesis import example, given, strategies as st
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.packet import Raw
from scapy.utils import wrpcap

from cardan.protocols.joint_stream import codec
from cardan.protocols.joint_stream.codec import ArmCommand, ArmState, ControlMode, MalformedDatagram
from cardan_dissect import dissect_file, joint_stream as layers
from cardan_dissect.joint_stream import (
    JointStream,
    JointStreamBroken,
    JointStreamCommand,
    JointStreamState,
    malformed,
)
from cardan_dissect.ports import JOINT_STREAM_PORT

PAGE = Path(__file__).parents[3] / "docs" / "simulated-peers.md"

finite = st.floats(allow_nan=False, allow_infinity=False)
u32 = st.integers(0, 2**32 - 1)
mode = st.sampled_from([layers.HOLD, layers.POSITION, layers.VELOCITY, layers.TORQUE])


def worked():
    """Datagrams under "Worked bytes": a command, then a state."""
    page = PAGE.read_text(encoding="utf-8")
    section = page.partition("### Worked bytes")[2].partition("\n#")[0]
    blocks = re.findall(r"```\n(.*?)```", section, re.DOTALL)
    lines = [[line.partition("     ")[0] for line in block.splitlines()] for block in blocks]
    return [bytes.fromhex("".join(block)) for block in lines]


COMMAND, STATE = worked()


def vector(size, values=finite):
    return st.lists(values, min_size=size, max_size=size)


@st.composite
def states(draw):
    joints = draw(st.integers(1, 16))
    a, b = draw(st.floats(-4, 4)), draw(st.floats(-4, 4))
    turn = [math.cos(a), math.sin(a) * math.cos(b), 0.0, math.sin(a) * math.sin(b)]
    return JointStreamState(
        mode=draw(mode),
        session=draw(u32),
        sequence=draw(u32),
        stamp_s=draw(finite),
        taken=draw(u32),
        cycle_s=draw(st.floats(1e-4, 10.0)),
        positions=draw(vector(joints)),
        speeds=draw(vector(joints)),
        torques=draw(vector(joints)),
        tcp_pose=draw(vector(3)) + turn,
        wrench=draw(vector(6)),
        reason=draw(st.text(max_size=60)).encode(),
    )


@st.composite
def commands(draw):
    joints, chosen = draw(st.integers(1, 16)), draw(mode)
    values = {name: draw(vector(joints)) for name in layers.COMMAND_LISTS[chosen]}
    given_count = {} if values else {"joints": joints}
    return JointStreamCommand(
        mode=chosen,
        session=draw(u32),
        sequence=draw(u32),
        stamp_s=draw(finite),
        **given_count,
        **values,
    )


def state_value(layer):
    return ArmState(
        session=layer.session,
        sequence=layer.sequence,
        stamp_s=layer.stamp_s,
        mode=ControlMode(layer.mode),
        acknowledged=layer.taken,
        period_s=layer.cycle_s,
        positions=tuple(layer.positions),
        velocities=tuple(layer.speeds),
        torques=tuple(layer.torques),
        pose=tuple(layer.tcp_pose),
        wrench=tuple(layer.wrench),
        reason=layer.reason.decode(),
    )


def command_value(layer):
    values, feed_forward = (), ()
    if layer.mode == layers.POSITION:
        values, feed_forward = layer.positions, layer.speeds
    elif layer.mode == layers.VELOCITY:
        values = layer.speeds
    elif layer.mode == layers.TORQUE:
        values = layer.torques
    return ArmCommand(
        layer.session,
        layer.sequence,
        layer.stamp_s,
        ControlMode(layer.mode),
        tuple(values),
        tuple(feed_forward),
    )


def assert_agreed(data):
    """Check that both descriptions read the same values from `data`, or both refuse it."""
    layer = JointStream(data)
    reason = malformed(layer)
    state = None if reason or not isinstance(layer, JointStreamState) else state_value(layer)
    command = None if reason or not isinstance(layer, JointStreamCommand) else command_value(layer)
    for expected, decode in ((state, codec.decode_state), (command, codec.decode_command)):
        found = decode(data)
        if expected is None:
            assert isinstance(found, MalformedDatagram), (reason, found)
        else:
            assert found == expected
    if not isinstance(layer, JointStreamBroken):
        assert bytes(layer) == data


@given(states())
def test_states_of_the_layers_are_those_of_the_codec(layer):
    data = bytes(layer)
    value = state_value(layer)
    assert codec.encode_state(value) == data
    assert codec.decode_state(data) == value
    assert malformed(JointStream(data)) is None
    assert_agreed(data)


@given(commands())
def test_commands_of_the_layers_are_those_of_the_codec(layer):
    data = bytes(layer)
    value = command_value(layer)
    assert codec.encode_command(value, JointStream(data).joints) == data
    assert codec.decode_command(data) == value
    assert malformed(JointStream(data)) is None
    assert_agreed(data)


def test_worked_bytes():
    command = JointStream(COMMAND)
    assert command_value(command) == ArmCommand(7, 9, 1.5, ControlMode.VELOCITY, (0.25, -0.5))
    built = JointStreamCommand(
        mode=layers.VELOCITY, session=7, sequence=9, stamp_s=1.5, speeds=(0.25, -0.5)
    )
    assert bytes(built) == COMMAND
    state = JointStream(STATE)
    assert (state.taken, state.cycle_s, state.wrench[2]) == (9, 1 / 128, -10.0)
    assert state.reason == "é".encode()
    built = JointStreamState(
        mode=layers.VELOCITY,
        session=7,
        sequence=3,
        stamp_s=0.5,
        taken=9,
        cycle_s=0.0078125,
        positions=[0.25],
        speeds=[-0.5],
        torques=[2.0],
        tcp_pose=[0.5, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0],
        wrench=[0.0, 0.0, -10.0, 0.0, 0.0, 0.0],
        reason="é".encode(),
    )
    assert bytes(built) == STATE
    assert_agreed(COMMAND)
    assert_agreed(STATE)


@pytest.mark.parametrize("data", [COMMAND, STATE], ids=["command", "state"])
def test_every_length_but_the_right_one_is_refused_by_both(data):
    for size in range(len(data)):
        assert malformed(JointStream(data[:size])) is not None
        assert_agreed(data[:size])
    assert malformed(JointStream(data + b"\0")) is not None
    assert_agreed(data + b"\0")


@pytest.mark.parametrize("data", [COMMAND, STATE], ids=["command", "state"])
def test_every_byte_changed_is_read_alike(data):
    for position in range(len(data)):
        for value in (0, 1, 2, 3, 4, 16, 17, 0x7F, 0xF0, 0xFF):
            assert_agreed(data[:position] + bytes([value]) + data[position + 1 :])


@given(st.binary(max_size=400), st.sampled_from([0, 4, 5, 8, 24]))
@example(b"", 0)
def test_random_bytes_are_read_alike(data, retained):
    for start in (COMMAND, STATE):
        assert_agreed(start[:retained] + data)


def changed(**fields):
    layer = JointStream(STATE)
    for name, value in fields.items():
        setattr(layer, name, value)
    return bytes(layer)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "empty datagram"),
        (b"GET / HTTP/1.1\r\n\r\n", "does not begin with CJST"),
        (COMMAND[:20], "shorter than its header"),
        (COMMAND[:4] + b"\2" + COMMAND[5:], "version 2"),
        (COMMAND[:5] + b"\3" + COMMAND[6:], "kind 3"),
        (COMMAND[:6] + b"\4" + COMMAND[7:], "mode 4"),
        (COMMAND[:7] + b"\0" + COMMAND[8:], "number of joints 0"),
        (COMMAND[:7] + b"\x11" + COMMAND[8:], "number of joints 17"),
        (COMMAND[:-1], "a command too short"),
        (STATE + b"a", "a state too long"),
        (changed(stamp_s=math.inf), "stamp_s not finite"),
        (changed(speeds=[math.nan]), "speeds not finite"),
        (changed(cycle_s=0.0), "cycle_s not above 0"),
        (changed(tcp_pose=[0.0, 0.0, 0.0, 1.01, 0.0, 0.0, 0.0]), "orientation no unit quaternion"),
        (changed(reason=b"\xff\xff"), "reason not UTF-8"),
    ],
)
def test_what_is_wrong_is_named(data, reason):
    assert malformed(JointStream(data)) == reason
    assert_agreed(data)


@pytest.mark.parametrize("off", [-0.0011, -0.0009, 0.0009, 0.0011])
def test_the_norm_of_the_orientation_may_be_off_by_a_thousandth(off):
    data = changed(tcp_pose=[0.0, 0.0, 0.0, 1.0 + off, 0.0, 0.0, 0.0])
    assert (malformed(JointStream(data)) is None) == (abs(off) < 0.001)
    assert_agreed(data)


def test_layers_are_bound_to_the_port():
    for layer, ports in (
        (JointStreamCommand(session=1, joints=6), {"dport": JOINT_STREAM_PORT, "sport": 40000}),
        (JointStream(STATE), {"sport": JOINT_STREAM_PORT, "dport": 40000}),
    ):
        packet = UDP(bytes(UDP(**ports) / layer))
        assert type(packet.payload) is type(layer)
    assert (UDP() / JointStreamCommand(joints=6)).dport == JOINT_STREAM_PORT
    assert (UDP() / JointStreamState()).sport == JOINT_STREAM_PORT


ARM, CLIENT = ("10.0.0.1", JOINT_STREAM_PORT), ("10.0.0.2", 40000)


def packet(time_s, source, destination, payload):
    made = (
        Ether(src="02:00:00:00:00:01", dst="02:00:00:00:00:02")
        / IP(src=source[0], dst=destination[0])
        / UDP(sport=source[1], dport=destination[1])
        / Raw(bytes(payload))
    )
    made.time = 1_700_000_000 + time_s
    return made


def state(sequence, taken=0, session=7, **more):
    joints = {"positions": [0.5], "speeds": [0.0], "torques": [1.0]}
    return JointStreamState(session=session, sequence=sequence, taken=taken, **joints, **more)


def command(sequence, session=7):
    return JointStreamCommand(
        mode=layers.VELOCITY, session=session, sequence=sequence, speeds=[0.25]
    )


def hold(sequence, session=0):
    return JointStreamCommand(session=session, sequence=sequence, joints=1)


@pytest.fixture
def shown(tmp_path):
    def read(packets, **options):
        path, out = tmp_path / "capture.pcap", io.StringIO()
        wrpcap(str(path), packets)
        counts = dissect_file(path, out, **options)
        return counts, out.getvalue()

    return read


def session(arm=ARM):
    packets = [packet(0.0, CLIENT, arm, hold(1))]
    for n in range(1, 6):
        packets.append(packet(n * 0.008, arm, CLIENT, state(n, taken=n)))
        packets.append(packet(n * 0.008 + 0.002, CLIENT, arm, command(n + 1)))
    return packets


def test_a_clean_session(shown):
    counts, text = shown(session())
    assert counts.messages["joint stream"] == 11
    assert counts.malformed["joint stream"] == 0
    assert counts.other_packets == 0
    lines = text.splitlines()
    assert lines[1:4] == [
        "#1 0.000000 10.0.0.2:40000 > 10.0.0.1:6520 ArmCommand | session 0 | sequence 1 | "
        "stamp_s 0 | mode HOLD | values (none) | feed_forward (none)",
        "#2 0.008000 10.0.0.1:6520 > 10.0.0.2:40000 ArmState | session 7 | sequence 1 | "
        "stamp_s 0 | mode HOLD | acknowledged 1 | period_s 0.004 | positions 0.5 | velocities 0 | "
        "torques 1 | pose 0 0 0 1 0 0 0 | wrench 0 0 0 0 0 0 | reason ''",
        "#3 0.010000 10.0.0.2:40000 > 10.0.0.1:6520 ArmCommand | session 7 | sequence 2 | "
        "stamp_s 0 | mode VELOCITY | values 0.25 | feed_forward (none)",
    ]
    assert lines[12:] == [
        "joint stream 10.0.0.2:40000 > 10.0.0.1:6520",
        "  6 messages",
        "  ArmCommand x6, period mean 8.400 min 8.000 max 10.000 ms, "
        "lost 0 duplicate 0 out of order 0 restarts 0",
        "  answers x5, after: median 2.000 p99 2.000 ms",
        "joint stream 10.0.0.1:6520 > 10.0.0.2:40000",
        "  5 messages",
        "  ArmState x5, period mean 8.000 min 8.000 max 8.000 ms, "
        "lost 0 duplicate 0 out of order 0 restarts 0",
        "  answers x5, after: median 6.000 p99 7.964 ms",
        "11 packets: 11 joint stream, 0 malformed; 0 others",
    ]


def test_another_port_is_known_by_the_mark(shown):
    counts, text = shown(session(arm=("10.0.0.1", 7001)), summary=True)
    assert counts.messages["joint stream"] == 11
    assert "joint stream 10.0.0.1:7001 > 10.0.0.2:40000\n  5 messages" in text


def test_a_port_given_to_egm_is_egm_s(shown):
    counts, _ = shown(session(), egm_ports=[JOINT_STREAM_PORT], summary=True)
    assert counts.messages["joint stream"] == 0
    assert counts.messages["EGM"] == 11
    assert counts.other_packets == 0


def test_loss_restart_other_sessions_reasons_and_damage(shown):
    packets = [
        packet(0.000, ARM, CLIENT, state(1)),
        packet(0.004, ARM, CLIENT, state(2)),
        packet(0.012, ARM, CLIENT, state(4, reason=b"emergency stop")),  # 3 is lost
        packet(0.013, ARM, CLIENT, state(4, reason=b"emergency stop")),  # sent twice
        packet(0.016, ARM, CLIENT, bytes(state(5))[:-3]),
        packet(0.017, CLIENT, ARM, b"hello"),
        packet(0.018, CLIENT, ARM, command(1, session=6)),
        packet(0.500, ARM, CLIENT, state(1, session=8)),
    ]
    counts, text = shown(packets)
    assert counts.malformed["joint stream"] == 2
    for line in (
        "reason 'emergency stop' | SEQUENCE GAP",
        "reason 'emergency stop' | SEQUENCE DUPLICATE",
        "MALFORMED joint stream: a state of 1 joints in ",
        "MALFORMED joint stream: 5 bytes are too short (5 B: 68 65 6c 6c 6f)",
        "session 6 | sequence 1 | stamp_s 0 | mode VELOCITY | values 0.25",
        "reason '' | SEQUENCE RESTART",
        "  6 messages",
        "lost 1 duplicate 1 out of order 0 restarts 1",
        "  malformed: a state of 1 joints in ",
        "  malformed: 5 bytes are too short x1",
    ):
        assert line in text


def test_what_the_codec_sends_is_shown(shown):
    value = ArmCommand(7, 9, 1.5, ControlMode.POSITION, (0.5, 0.0))
    data = codec.encode_command(value, 2)
    _, text = shown([packet(0, CLIENT, ARM, data), packet(1, ARM, CLIENT, STATE)])
    assert "mode POSITION | values 0.5 0 | feed_forward 0 0" in text
    assert "reason 'é'" in text
