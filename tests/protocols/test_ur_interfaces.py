"""The client interfaces byte by byte: sub-packages, real-time packets, messages, and the end of a
script. The tables are independent transcripts of UR's guides."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings, strategies as st

from cardan.protocols.ur import primary, robot_state
from cardan.protocols.ur.framing import ScriptReader
from cardan.protocols.ur.realtime import RealtimeForm, RealtimeReader
from cardan.protocols.ur.states import RobotMode, SafetyMode
from tests.examples import examples

MODES = primary.ModeData(True, False, False, True, False, RobotMode.RUNNING, 0.5, 0.25)

VECTORS = {
    name: tuple(10.0 * number + k for k in range(count))
    for number, (name, count) in enumerate(
        [
            ("actual_q", 6),
            ("target_q", 6),
            ("actual_qd", 6),
            ("actual_current", 6),
            ("actual_joint_voltage", 6),
            ("joint_temperatures", 6),
            ("joint_mode", 6),
            ("actual_TCP_pose", 6),
            ("tcp_offset", 6),
            ("kinematics_checksum", 6),
            ("dh_theta", 6),
            ("dh_a", 6),
            ("dh_d", 6),
            ("dh_alpha", 6),
            ("calibration_forces", 6),
            ("joint_limits", 12),
            ("joint_motion_limits", 12),
            ("actual_TCP_force", 6),
        ]
    )
}
WHOLE = {
    "joint_mode": (253,) * 6,
    "kinematics_checksum": (1, 2, 3, 4, 5, 2**32 - 1),
    "calibration_status": 7,
    "actual_digital_input_bits": 0x20105,
    "actual_digital_output_bits": 0x10203,
    "analog_io_types": 0b1010,
    "safety_mode": 3,
    "safety_status_bits": 0b10,
    "operational_mode": 2,
    "three_position_enabling_device": 1,
    "tool_analog_input_types": 0b10,
    "tool_output_voltage": 24,
    "tool_mode": 253,
    "masterboard_version": 6,
    "controller_box_type": 4,
    "robot_type": 1,
    "robot_subtype": 3,
    "robot_status_bits": 0b111,
    "freedrive_button_enabled": 1,
    "tool_communication_enabled": 1,
    "tool_output_mode": 1,
    "tool_digital_output0_mode": 2,
    "tool_digital_output1_mode": 3,
    "singularity_severity": 1,
    "singularity_type": 2,
}


def value(name):
    return WHOLE[name] if name in WHOLE else VECTORS.get(name, 0.5)


def state(e_series):
    data = primary.state_package(1.5, MODES, robot_state.parts(value, e_series))
    reader = primary.PackageReader()
    reader.feed(data)
    found = reader.take()
    assert found is not None
    return found


SIZES = [
    0,
    47,
    1,
    251,
    4,
    101,
    5,
    225,
    9,
    53,
    3,
    75,
    2,
    37,
    6,
    445,
    7,
    61,
    8,
    9,
    11,
    26,
    12,
    8,
    13,
    7,
]
"""Types and sizes of the sub-packages in their order."""


@pytest.mark.parametrize(("e_series", "count"), [(True, 13), (False, 10)])
def test_every_sub_package_has_its_size_and_its_place(e_series, count):
    found = state(e_series)
    pairs = list(zip(SIZES[::2], SIZES[1::2], strict=True))[:count]
    at = 0
    for kind, size in pairs:
        assert struct.unpack_from(">iB", found.content, at) == (size, kind)
        at += size
    assert at == len(found.content)
    assert [
        (kind, len(data) + 5) for kind, data in robot_state.sub_packages(found).items()
    ] == pairs
    assert primary.read_mode(found) == MODES


def test_what_is_in_the_modes():
    values = struct.unpack_from(">iBQ???????BBdddB", state(True).content)
    assert values[2:] == (1_500_000, 1, 1, 1, 0, 0, 1, 0, 7, 0, 0.5, 0.25, 1.0, 0)


def test_what_is_in_the_sub_packages():
    parts = robot_state.sub_packages(state(True))
    for joint, values in enumerate(struct.iter_unpack(">dddffffB", parts[1])):
        of = [VECTORS[name][joint] for name in list(VECTORS)[:6]]
        assert values == (*of, 0.0, 253)
    assert struct.unpack(">12d", parts[4]) == VECTORS["actual_TCP_pose"] + VECTORS["tcp_offset"]
    kinematics = struct.unpack(">6I24dI", parts[5])
    assert kinematics[:6] == (1, 2, 3, 4, 5, 2**32 - 1)
    assert kinematics[6:12] == VECTORS["dh_theta"]
    assert kinematics[12:18] == VECTORS["dh_a"]
    assert kinematics[18:24] == VECTORS["dh_d"]
    assert kinematics[24:] == (*VECTORS["dh_alpha"], 7)
    board = struct.unpack(">IIBBddbbddffffBBBIBBB", parts[3])
    assert board[:4] == (0x20105, 0x10203, 0, 1)
    assert board[6:8] == (0, 1)
    assert board[14:] == (3, 1, 0, 0, 2, 1, 0)
    tool = struct.unpack(">BBddfBffB", parts[2])
    assert (tool[:2], tool[5], tool[8]) == ((0, 1), 24, 253)
    configuration = struct.unpack(">24d5d24d4i", parts[6])
    assert configuration[:24] == VECTORS["joint_limits"] + VECTORS["joint_motion_limits"]
    assert configuration[26:29] == (0.25, 1.2, 0.25)
    assert configuration[29:53] == sum(
        (VECTORS[f"dh_{x}"] for x in ("a", "d", "alpha", "theta")), ()
    )
    assert configuration[53:] == (6, 4, 1, 3)
    assert struct.unpack(">7d", parts[7]) == (*VECTORS["actual_TCP_force"], 0.5)
    assert parts[8] == bytes([1, 1, 0, 0])
    assert struct.unpack(">Biiiff", parts[11]) == (1, 115200, 0, 1, 1.5, 3.5)
    assert (parts[12], parts[13]) == (b"\1\2\3", b"\1\2")


@given(st.binary(max_size=80))
def test_a_state_that_is_cut_is_none(data):
    robot_state.sub_packages(primary.PrimaryPackage(primary.ROBOT_STATE, data))
    assert robot_state.sub_packages(primary.PrimaryPackage(primary.ROBOT_MESSAGE, data)) is None


def test_a_sub_package_that_says_it_is_longer():
    head = struct.pack(">iB", 9, 1)
    assert robot_state.sub_packages(primary.PrimaryPackage(16, head)) is None
    assert robot_state.sub_packages(primary.PrimaryPackage(16, head + b"abc")) is None
    assert robot_state.sub_packages(primary.PrimaryPackage(16, head + b"abcd")) == {1: b"abcd"}


# -- messages --------------------------------------------------------------------------------------

HEAD = bytes.fromhex("14" + "000000000000000a" + "fe")


@pytest.mark.parametrize(
    ("made", "content", "said"),
    [
        (
            primary.version_message(1e-5, (5, 12, 3, 7), "a date"),
            b"\3\x09URControl\x05\x0c\0\0\0\3\0\0\0\7a date",
            (3, "URControl", 0, "", 0),
        ),
        (
            primary.label_message(1e-5, 4, "MoveJ"),
            b"\1\0\0\0\4MoveJ",
            (1, "MoveJ", 0, "", 4),
        ),
        (
            primary.popup_message(1e-5, 3, "Note", "Look", warning=True),
            b"\2\0\0\0\3\0\0\0\0\1\0\0\4NoteLook",
            (2, "Look", 0, "Note", 3),
        ),
        (
            primary.safety_message(1e-5, SafetyMode.PROTECTIVE_STOP),
            b"\5\0\0\0\0\0\0\0\0\3\0\0\0\0\0\0\0\0",
            (5, "", 0, "", 0),
        ),
        (
            primary.error_message(1e-5, 204, 3, primary.ReportLevel.VIOLATION, "why"),
            b"\6\0\0\0\xcc\0\0\0\3\0\0\0\3\0\0\0\0\0\0\0\0why",
            (6, "why", 0, "", 204),
        ),
    ],
)
def test_messages(made, content, said):
    assert made == struct.pack(">i", len(HEAD) + 4 + len(content)) + HEAD + content
    reader = primary.PackageReader()
    reader.feed(made)
    assert primary.read_message(reader.take()) == said


# -- the real-time interface -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("version", "size"),
    [
        ((3, 2), 1060),
        ((3, 4), 1060),
        ((3, 5), 1108),
        ((3, 15), 1108),
        ((5, 0), 1108),
        ((5, 4), 1116),
        ((5, 8), 1116),
        ((5, 9), 1140),
        ((5, 10), 1220),
        ((5, 12), 1220),
    ],
)
def test_the_size_of_a_real_time_packet(version, size):
    assert RealtimeForm(version).size == size


COLUMNS = {
    "timestamp": (1, 1),
    "target_q": (2, 7),
    "target_qd": (8, 13),
    "target_qdd": (14, 19),
    "target_current": (20, 25),
    "target_moment": (26, 31),
    "actual_q": (32, 37),
    "actual_qd": (38, 43),
    "actual_current": (44, 49),
    "joint_control_output": (50, 55),
    "actual_TCP_pose": (56, 61),
    "actual_TCP_speed": (62, 67),
    "actual_TCP_force": (68, 73),
    "target_TCP_pose": (74, 79),
    "target_TCP_speed": (80, 85),
    "actual_digital_input_bits": (86, 86),
    "joint_temperatures": (87, 92),
    "actual_execution_time": (93, 93),
    "robot_mode": (95, 95),
    "joint_mode": (96, 101),
    "safety_mode": (102, 102),
    "actual_tool_accelerometer": (109, 111),
    "speed_scaling": (118, 118),
    "actual_momentum": (119, 119),
    "actual_main_voltage": (122, 122),
    "actual_robot_voltage": (123, 123),
    "actual_robot_current": (124, 124),
    "actual_joint_voltage": (125, 130),
    "actual_digital_output_bits": (131, 131),
    "runtime_state": (132, 132),
    "elbow_position": (133, 135),
    "elbow_velocity": (136, 138),
    "safety_status": (139, 139),
    "payload": (143, 143),
    "payload_cog": (144, 146),
    "payload_inertia": (147, 152),
}
"""Columns in the guide, from 1, both ends included."""
ONE = {name for name, (first, last) in COLUMNS.items() if first == last}


def test_the_columns_of_a_real_time_packet():
    def column(name):
        first, last = COLUMNS[name]
        return float(first) if name in ONE else tuple(float(n) for n in range(first, last + 1))

    data = RealtimeForm((5, 12)).pack(column)
    size, *numbers = struct.unpack(">i152d", data)
    assert size == len(data)
    filled = {n for first, last in COLUMNS.values() for n in range(first, last + 1)}
    assert numbers == [float(n) if n in filled else 0.0 for n in range(1, 153)]
    read = RealtimeForm((5, 12)).read(data)
    assert read == {name: (column(name),) if name in ONE else column(name) for name in COLUMNS}


def test_a_real_time_packet_of_another_version():
    data = RealtimeForm((5, 9)).pack(lambda name: 1.0 if name in ONE else (1.0,) * _width(name))
    assert RealtimeForm((5, 4)).read(data)["safety_status"] == (1.0,)
    assert RealtimeForm((5, 10)).read(data) is None


def _width(name):
    first, last = COLUMNS[name]
    return last - first + 1


def test_real_time_packets_come_in_any_pieces():
    packets = [struct.pack(">id", 12, float(n)) for n in range(3)]
    reader, found = RealtimeReader(), []
    for at in range(0, 36, 5):
        reader.feed(b"".join(packets)[at : at + 5])
        while (each := reader.take()) is not None:
            found.append(each)
    assert found == packets
    assert not reader.failure


@pytest.mark.parametrize("size", [-1, 0, 4, 1 << 20])
def test_a_size_that_no_real_time_packet_has(size):
    reader = RealtimeReader()
    reader.feed(struct.pack(">i", size))
    assert reader.take() is None
    assert reader.failure == f"a packet of {size} bytes: not a real-time interface"


# -- end of a script -------------------------------------------------------------------------------

NESTED = """def a():
  def b(x):
    if x: textmsg("end") end  # end
  end
  thread t():
    while True:
      switch (x):
        case 1:
          b(1)
        default:
          b(2)
      end
      sync()
    end
  end
  if True:
    b(0)
  elif False:
    b(1)
  else:
    s.end = 'def'
  end
end
"""
WHOLES = [
    NESTED,
    'textmsg("one")\n',
    "power on\n",
    "# one\n\n# two\ndef c():\n  halt\nend\n",
    "sec d():\n  set_digital_out(1, True)\nend\n",
    "def e(): sync() end\n",
    "end\n",
    ") x ? def_ end\n",
    "def f():\nend # over\n",
]


def read(pieces):
    reader, found = ScriptReader(1 << 16), []
    for piece in pieces:
        reader.feed(piece)
        while (each := reader.take()) is not None:
            found.append(each)
    assert reader.refused == 0
    return reader, found


@settings(max_examples=examples(50))
@given(st.lists(st.sampled_from(WHOLES), max_size=6), st.lists(st.integers(1, 60)))
def test_scripts_in_pieces(wholes, sizes):
    stream, at, pieces = "\n".join(wholes).encode(), 0, []
    for size in [*sizes, len(stream)]:
        pieces.append(stream[at : at + size])
        at += size
    reader, found = read(pieces)
    reader.end()
    assert found == wholes
    assert reader.take() is None


def test_the_end_of_a_connection_is_the_end_of_a_script():
    reader, found = read([b"movej([0])\r\nstop", b"j(1)"])
    assert found == ["movej([0])\n"]
    assert not reader.open
    reader.end()
    assert reader.take() == "stopj(1)\n"
    reader, found = read([b"def a():\n  while True:\n  end\n"])
    assert (found, reader.open) == ([], True)
    reader.end()
    assert reader.take() == "def a():\n  while True:\n  end\n"
    assert not reader.open


def test_comments_alone_are_nothing():
    reader, found = read([b"# a\n\n# b\n"])
    reader.end()
    assert (found, reader.take()) == ([], None)


@pytest.mark.parametrize("size", [1, 7, 1000])
@pytest.mark.parametrize(
    "data",
    [
        b"x" * 101 + b"\n",
        b"x" * 5_000 + b"\n",
        b"def a():\n" * 20 + b"end\n" * 20,
        b"def a():\n  x = 1 # " + b"y" * 500 + b"\n\nend\n",
        b"# more\n" * 20 + b"\nx\n",
    ],
)
def test_a_script_that_is_too_long_is_not_kept_and_what_follows_is_read(data, size):
    reader, found = ScriptReader(100), []
    whole = b"sync()\n" + data + b"sync()\n"
    for at in range(0, len(whole), size):
        reader.feed(whole[at : at + size])
        assert len(reader._pending) <= 101
        while (each := reader.take()) is not None:
            found.append(each)
    assert found == ["sync()\n"] * 2
    assert reader.refused == 1


@pytest.mark.parametrize("data", [b"x" * 101, b"def a():\n" * 20, b"# more\n" * 20])
def test_a_script_that_is_too_long_and_does_not_end(data):
    reader = ScriptReader(100)
    reader.feed(data)
    reader.end()
    assert reader.take() is None
    assert reader.refused == 1


def test_a_script_that_is_as_long_as_it_may_be():
    reader = ScriptReader(100)
    reader.feed(b"# " + b"x" * 90 + b"\nsync()\n")
    assert len(reader.take() or "") == 100


@settings(max_examples=examples(100))
@given(st.lists(st.text(alphabet="def end(){}\nwhile\"#' _.", max_size=30)))
def test_no_stream_raises(pieces):
    reader = ScriptReader(1 << 16)
    for piece in pieces:
        reader.feed(piece.encode())
    reader.end()
    assert not reader.open
