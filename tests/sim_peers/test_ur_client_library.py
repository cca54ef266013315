"""The simulated Universal Robots controller meets what UR's C++ client library expects, seen from
the client's end of the connections. The library itself is not run: see docs/judged.md."""

from __future__ import annotations

import math
import re
import struct

import numpy as np
import pytest

from cardan.protocols.ur import robot_state
from cardan.protocols.ur.primary import (
    ROBOT_MESSAGE,
    MessageKind,
    ReportLevel,
    read_message,
    read_mode,
)
from cardan.protocols.ur.rtde import (
    Accepted,
    ControllerVersion,
    PacketReader,
    PacketType,
    SetupReply,
    ask_outputs,
    ask_version,
    packet,
    read_reply,
)
from cardan.protocols.ur.states import RobotMode, RuntimeState, SafetyMode
from tests.sim_peers.test_ur_controller import World
from tests.sim_peers.test_ur_servers import LOOP, messages, packages

NOMINAL_UR5E = "calib_12788084448423163542"
"""Checksum of the nominal kinematics of a UR5e in the library's tests and examples."""
STATES = re.compile("(STOPPED|PLAYING|PAUSED) .*")
"""Answers to `programState` that the library takes, after it has removed spaces at the end."""
_HEAD = struct.Struct(">QbB")


class Client:
    """Primary client, and what it received so far."""

    def __init__(self, **options):
        self.world = World(**options)
        self.number = self.world.join("primary")

    def send(self, text, seconds=0.5):
        self.world.heard[self.number] = self.world.say(self.number, text.encode() + b"\n")
        self.world.run(seconds)
        return self

    @property
    def messages(self):
        return [m for m in messages(self.world, self.number) if m.kind != MessageKind.VERSION]

    def contents(self, kind):
        """Return the contents of the messages of a kind, after their heads."""
        return [
            each.content[_HEAD.size :]
            for each in packages(self.world, self.number)
            if each.kind == ROBOT_MESSAGE and _HEAD.unpack_from(each.content)[2] == kind
        ]

    def errors(self):
        """Return code, argument and level of each error."""
        return [struct.unpack_from(">iii", each) for each in self.contents(MessageKind.ERROR_CODE)]

    def safety_modes(self):
        return [struct.unpack_from(">iiB", each)[2] for each in self.contents(5)]


def hashed(data):
    """Return std::hash of a text in the GNU C++ library with 64 bits: MurmurHash64A."""
    whole, factor = (1 << 64) - 1, 0xC6A4A7935BD1E995
    found = 0xC70F6907 ^ (len(data) * factor & whole)

    def mixed(value):
        return value ^ value >> 47

    for at in range(0, len(data) - 7, 8):
        block = int.from_bytes(data[at : at + 8], "little") * factor & whole
        found = (found ^ mixed(block) * factor & whole) * factor & whole
    rest = data[len(data) // 8 * 8 :]
    if rest:
        found = (found ^ int.from_bytes(rest, "little")) * factor & whole
    return mixed(mixed(found) * factor & whole)


# -- the primary interface -------------------------------------------------------------------------


def test_the_kinematics_have_the_checksum_of_a_nominal_arm():
    client = Client().send("")
    found = next(filter(None, map(robot_state.sub_packages, packages(client.world, client.number))))
    numbers = struct.unpack(">6I24dI", found[robot_state.KINEMATICS_INFO.kind])[6:30]
    theta, a, d, alpha = (numbers[at : at + 6] for at in range(0, 24, 6))
    said = "".join(f"{each:g}" for joint in zip(theta, d, a, alpha, strict=True) for each in joint)
    assert f"calib_{hashed(said.encode())}" == NOMINAL_UR5E


def test_a_program_that_is_awaited_tells_its_start_and_its_end_by_name():
    client = Client().send('def test_fun():\n  textmsg("still running")\n  sleep(0.1)\nend')
    assert [(m.kind, m.title, m.text) for m in client.messages] == [
        (MessageKind.KEY, "PROGRAM_XXX_STARTED", "test_fun"),
        (MessageKind.TEXT, "", "still running"),
        (MessageKind.KEY, "PROGRAM_XXX_STOPPED", "test_fun"),
    ]


def test_a_program_and_the_order_before_it_are_taken_in_one_packet():
    client = Client().send("def old():\n" + LOOP + "\nend")
    client.send("stop program\ndef externalControl():\n\tsync()\n" + LOOP + "\nend\n")
    assert client.world.controller.program_name == "externalControl"
    assert client.world.controller.runtime is RuntimeState.PLAYING


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("def illegal_fun():\n  missing()\nend", (2, 3)),
        ("missing()", (1, 1)),
        ("sec illegal_fun():\n\n    missing()\nend", (3, 5)),
    ],
)
def test_an_unknown_function_is_told_with_its_place(text, place):
    client = Client().send(text)
    (found,) = client.contents(MessageKind.RUNTIME_EXCEPTION)
    assert struct.unpack_from(">ii", found) == place
    assert found[8:] == b"compile_error_name_not_found:missing:"


def test_a_goal_that_no_joints_reach_is_an_exception_or_an_error():
    client = Client().send("def one():\n  movej(p[0,0,0,0,0,0])\nend")
    assert [m.kind for m in client.messages if m.kind != MessageKind.KEY] == [
        MessageKind.RUNTIME_EXCEPTION
    ]
    assert not client.errors()
    client.send("def two():\n  movel(p[0,0,0,0,0,0])\nend")
    assert [error[2] for error in client.errors()] == [ReportLevel.VIOLATION]
    client.send("set unlock protective stop").send("def three():\n  sync()\nend")
    assert client.messages[-1][:2] == (MessageKind.KEY, "three")
    assert client.world.controller.safety is SafetyMode.NORMAL


@pytest.mark.parametrize(
    "text", ["protective_stop()", "sec setup():\n protective_stop()\nend\n", "def a():\n  b()\nend"]
)
def test_a_protective_stop_that_a_program_calls_for_is_one_error(text):
    client = Client().send("def main():\n" + LOOP + "\nend")
    client.send(text.replace("b()", "protective_stop()"))
    assert client.errors() == [(209, 0, ReportLevel.VIOLATION)]
    assert client.safety_modes() == [SafetyMode.PROTECTIVE_STOP]
    assert client.world.controller.runtime is RuntimeState.STOPPED
    # The end of a program that caused an error is success unless the error is known by then.
    *_, error, stopped, safety = client.messages
    assert (error.kind, safety.kind) == (MessageKind.ERROR_CODE, MessageKind.SAFETY_MODE)
    assert stopped.title == "PROGRAM_XXX_STOPPED"


def test_a_protective_stop_is_unlocked_at_once_by_an_order():
    client = Client().send("protective_stop()")
    board = client.world.join("dashboard")
    assert "until 5s after" in client.world.ask(board, "unlock protective stop")
    client.send("set unlock protective stop")
    # The mode is known before a state tells that the stop is over.
    assert client.safety_modes() == [SafetyMode.PROTECTIVE_STOP, SafetyMode.NORMAL]
    reported = []
    for each in packages(client.world, client.number):
        mode, message = read_mode(each), read_message(each)
        if mode is not None:
            reported.append(mode.protective_stopped)
        elif message is not None and message.kind == MessageKind.SAFETY_MODE:
            reported.append("message")
    second = len(reported) - reported[::-1].index("message")
    assert True in reported[:second]
    assert set(reported[second:]) == {False}


def test_local_control_is_an_interface_that_only_reads():
    client = Client(remote=False)
    for text in ("def a():\n  sync()\nend", "textmsg(1)", "power off"):
        client.send(text)
    assert client.errors() == [(210, 0, ReportLevel.VIOLATION)] * 3
    assert client.world.controller.mode is RobotMode.RUNNING
    assert [m.kind for m in client.messages] == [MessageKind.ERROR_CODE] * 3


@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
@pytest.mark.parametrize(
    "move",
    [
        "movej([1.57, -1.6, 1.6, -0.7, 0.7, 0.2], a=1.4, v=1.4, t=0.1)",
        "movel(p[-0.203, 0.263, 0.559, 0.68, -1.083, -2.076], a=1.4, v=1.04, t=0.1)",
    ],
)
def test_a_move_whose_time_is_too_short_takes_longer(robot, move):
    client = Client(robot=robot, start=(-1.57, -1.6, 1.6, -0.7, 0.7, 0.2))
    client.send(f"def short():\n  {move}\n  textmsg(1)\nend", 3.0)
    assert not client.errors()
    assert [m.text for m in client.messages if m.kind == MessageKind.TEXT] == ["1"]
    dt_s = client.world.controller.period_s
    path = np.unique(np.array(client.world.path), axis=0)
    assert len(path) * dt_s > 0.1
    fastest = np.abs(np.diff(np.array(client.world.path), axis=0)).max() / dt_s
    assert 0.5 * math.pi < fastest <= 1.05 * max(client.world.options.arm.velocity)


# -- the dashboard ---------------------------------------------------------------------------------


def test_a_program_always_has_a_state_and_a_name(tmp_path):
    (tmp_path / "wait.urp").write_bytes(b"gzip")
    (tmp_path / "wait.script").write_text("def wait():\n" + LOOP + "\nend\n")
    world = World(programs=str(tmp_path))
    board = world.join("dashboard")
    assert world.ask(board, "stop") == "Stopped"
    assert world.ask(board, "programState") == "STOPPED <unnamed>"
    world.upload(LOOP).run(0.2)
    assert STATES.fullmatch(world.ask(board, "programState"))
    world.ask(board, "stop")
    assert world.ask(board, "load wait.urp") == "Loading program: wait.urp"
    assert world.ask(board, "programState") == "STOPPED wait.urp"
    for order, answer, state in (
        ("play", "Starting program", "PLAYING"),
        ("pause", "Pausing program", "PAUSED"),
        ("play", "Starting program", "PLAYING"),
        ("stop", "Stopped", "STOPPED"),
    ):
        assert world.ask(board, order) == answer
        world.run(0.1)
        assert world.ask(board, "programState") == f"{state} wait.urp"


# -- RTDE ------------------------------------------------------------------------------------------


def test_a_client_of_a_newer_protocol_agrees_on_version_2():
    world = World(software="5.26")
    number, reader = world.join("rtde"), PacketReader()

    def asked(data):
        reader.feed(world.say(number, data))
        return read_reply(*reader.take())

    assert asked(ask_version(3)) == Accepted(PacketType.PROTOCOL_VERSION, accepted=False)
    assert asked(ask_version(2)) == Accepted(PacketType.PROTOCOL_VERSION, accepted=True)
    version = asked(packet(PacketType.CONTROLLER_VERSION))
    assert version == ControllerVersion(5, 26, 0, 0)
    # A name that this version lacks is reported by NOT_FOUND; the recipe without it is taken.
    refused = asked(ask_outputs(500.0, ["timestamp", "unknown_rtde_variable"]))
    assert refused == SetupReply(PacketType.OUTPUTS, 0, ("DOUBLE", "NOT_FOUND"))
    taken = asked(ask_outputs(500.0, ["timestamp"]))
    assert taken == SetupReply(PacketType.OUTPUTS, 1, ("DOUBLE",))
