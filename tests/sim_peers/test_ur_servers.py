"""Client interfaces and dashboard of the simulated Universal Robots controller."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import struct
import time
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest

from cardan.errors import OptionError
from cardan.protocols.ur import robot_state
from cardan.protocols.ur.framing import UNFINISHED_S
from cardan.protocols.ur.primary import (
    ROBOT_STATE,
    MessageKind,
    PackageReader,
    read_message,
    read_mode,
)
from cardan.protocols.ur.rtde import PacketType, ask_outputs, ask_version, packet
from cardan.protocols.ur.script import LARGEST
from cardan.protocols.ur.states import RobotMode, RuntimeState, SafetyMode
from cardan.sim_peers.tcp_peer import _Link
from cardan.sim_peers.ur_controller import UrControllerOptions, UrControllerPeer
from cardan.sim_peers.ur_controller.controller import MOST_WAITING
from cardan.sim_peers.ur_controller.servers import CLIENTS, PORT_KINDS
from tests.sim_peers.test_ur_controller import World
from tests.waiting import WITHIN_S

LOOP = "  while True:\n    sync()\n  end"


@pytest.fixture
def world():
    return World()


def packages(world, number):
    reader, found = PackageReader(), []
    reader.feed(world.heard[number])
    while (each := reader.take()) is not None:
        found.append(each)
    assert reader.failure == ""
    return found


def messages(world, number):
    return [m for each in packages(world, number) if (m := read_message(each)) is not None]


# -- messages sent ---------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
@pytest.mark.parametrize("kind", ["primary", "secondary", "primary-read", "secondary-read"])
def test_version_first_then_ten_whole_states_a_second(robot, kind):
    world = World(robot=robot)
    number = world.join(kind)
    world.run(1.05)
    first, *rest = packages(world, number)
    assert read_message(first)[:2] == (MessageKind.VERSION, "URControl")
    assert first.content[20] == (5 if robot == "ur5e" else 3)
    assert [each.kind for each in rest] == [ROBOT_STATE] * 10
    assert read_mode(rest[-1]).robot_mode is RobotMode.RUNNING
    kinds = list(robot_state.sub_packages(rest[-1]))
    assert kinds == [0, 1, 4, 5, 9, 3, 2, 6, 7, 8] + ([11, 12, 13] if robot == "ur5e" else [])


def test_a_state_tells_what_rtde_tells():
    world = World(start=(0.1, -1.5, 1.4, -1.3, -1.2, 0.6))
    number = world.join("secondary")
    world.run(0.15)
    parts = robot_state.sub_packages(packages(world, number)[-1])
    joints = [values[0] for values in struct.iter_unpack(">dddffffB", parts[1])]
    assert joints == list(world.controller.motion.actual_q)
    pose = struct.unpack_from(">6d", parts[4])
    assert pose == pytest.approx(world.servers.telemetry.value("actual_TCP_pose"))
    a, d, alpha = (struct.unpack_from(">6d", parts[5], 24 + 48 * n) for n in (1, 2, 3))
    assert a == (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
    assert d == (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
    assert alpha == pytest.approx((1.570796327, 0, 0, 1.570796327, -1.570796327, 0))
    assert struct.unpack_from(">dd", parts[6]) == pytest.approx((-6.3355, 6.3355), abs=1e-4)


def test_the_dexterity_is_the_one_of_a_controller():
    """Joints, and the dexterity that URSim 5.8 reported for them."""
    world = World(start=(-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031))
    number = world.join("secondary")
    world.run(0.15)
    parts = robot_state.sub_packages(packages(world, number)[-1])
    assert struct.unpack_from(">d", parts[7], 48)[0] == pytest.approx(0.00353511, abs=1e-7)
    assert parts[13] == b"\0\0"


def test_an_arm_that_is_stretched_is_singular():
    world = World(start=(0.0, -1.5708, 0.0, -1.5708, 0.0, 0.0))
    number = world.join("secondary")
    world.run(0.15)
    parts = robot_state.sub_packages(packages(world, number)[-1])
    assert parts[13][0] == 1


def test_messages_come_on_the_primary_interface_only():
    world = World(faults={"protective-stop": 0.3})
    numbers = {kind: world.join(kind) for kind in ("primary", "primary-read", "secondary")}
    world.upload('  textmsg("hello")\n' + LOOP).run(0.5)
    expected = [
        (MessageKind.VERSION, "URControl"),
        (MessageKind.KEY, "test"),
        (MessageKind.TEXT, "hello"),
        (MessageKind.ERROR_CODE, "fault"),
        (MessageKind.KEY, "test"),
        (MessageKind.SAFETY_MODE, ""),
    ]
    for kind in ("primary", "primary-read"):
        assert [m[:2] for m in messages(world, numbers[kind])] == expected
    assert [m.kind for m in messages(world, numbers["secondary"])] == [MessageKind.VERSION]
    assert read_mode(packages(world, numbers["secondary"])[-1]).protective_stopped


@pytest.mark.parametrize(
    ("robot", "size", "count", "period_s"),
    [("ur5e", 1220, 50, 0.002), ("ur5", 1108, 12, 0.008)],
)
def test_the_real_time_interface_has_a_packet_each_cycle(robot, size, count, period_s):
    world = World(robot=robot)
    heard = [world.join(kind) for kind in ("realtime", "realtime-read")]
    world.say(world.join("realtime"), b"def a():\n  speedj([0.2, 0, 0, 0, 0, 0], 5.0, 1.0)\nend\n")
    world.run(0.1005)
    for number in heard:
        data = world.heard[number]
        assert len(data) == size * count
        rows = list(struct.iter_unpack(f">i{size // 8}d", data))
        assert {row[0] for row in rows} == {size}
        steps = [after[1] - before[1] for before, after in itertools.pairwise(rows)]
        assert steps == pytest.approx([period_s] * (count - 1))
        last, motion = rows[-1], world.controller.motion
        assert last[2:8] == tuple(motion.target_q)
        assert last[32:38] == tuple(motion.actual_q)
        assert last[32] > 0.0
        assert last[95] == RobotMode.RUNNING
        assert last[132] == RuntimeState.PLAYING


# -- scripts ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["primary", "secondary", "realtime"])
def test_all_three_take_programs_and_lines(kind, world):
    primary, number = world.join("primary"), world.join(kind)
    world.say(number, b'textmsg("one")\n')
    world.run(0.2)
    world.say(number, f"# a program\ndef two():\n{LOOP}\nend\n".encode())
    world.run(0.2)
    assert world.controller.program_name == "two"
    world.say(number, b"stopj(2.0)\n")
    world.run(0.2)
    assert not world.controller.has_program
    said = [m.text for m in messages(world, primary) if m.kind in (0, 7)]
    assert said == ["line", "one", "line", "two", "two", "line", "line"]


@pytest.mark.parametrize("kind", ["primary-read", "secondary-read", "realtime-read"])
def test_what_only_sends_takes_nothing(kind, world):
    world.say(world.join(kind), b"power off\ndef a():\n  halt\nend\n")
    world.run(0.2)
    assert world.controller.mode is RobotMode.RUNNING
    assert not any("program" in text for text in world.events())


@pytest.mark.parametrize(
    "garbage",
    [
        b"end\n",
        b"\xff\x00\x01(]\n",
        b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n",
        b"no such thing\n",
        b"def broken(\nend\n",
        b"if True:\n  textmsg(1)\nend\nend\n",
        b'textmsg("one\n',
    ],
)
def test_garbage_is_refused_and_the_next_program_runs(garbage, world):
    number = world.join("secondary")
    world.say(number, garbage)
    world.run(0.1)
    world.say(number, f"def good():\n{LOOP}\nend\n".encode())
    world.run(0.1)
    assert world.controller.program_name == "good"
    assert world.controller.has_program
    assert number not in world.closed


def test_a_program_that_is_never_finished_is_refused_after_a_while(world):
    number, primary = world.join("secondary"), world.join("primary")
    world.say(number, b"def broken():\n  while True:\n    sync()\nend\n")
    world.run(UNFINISHED_S - 0.1)
    assert not any("refused" in text for text in world.events())
    world.run(0.2)
    assert any("a program is refused, line 5" in text for text in world.events())
    assert messages(world, primary)[-1].line == 5
    world.say(number, f"def good():\n{LOOP}\nend\n".encode())
    world.run(0.1)
    assert world.controller.program_name == "good"


def test_a_line_is_refused_by_its_own_number(world):
    primary = world.join("primary")
    world.say(primary, b"# first\n\nno_such_function(1)\n")
    world.run(0.1)
    wrong = [m for m in messages(world, primary) if m.kind == MessageKind.RUNTIME_EXCEPTION]
    assert wrong[0].line == 3
    assert "no_such_function" in wrong[0].text


def test_what_has_no_last_newline_counts_when_the_client_goes(world):
    number = world.join("secondary")
    world.say(number, f"def last():\n{LOOP}\nend".encode())
    world.run(0.1)
    assert not world.controller.has_program
    world.servers.eof(number, world.now_s)
    world.run(0.1)
    assert world.controller.program_name == "last"


@pytest.mark.parametrize("kind", ["primary", "secondary", "realtime"])
def test_a_script_that_is_too_long_is_refused_and_its_connection_goes_on(kind, world):
    number, listening = world.join(kind), world.join("primary-read")
    world.say(number, b"def a():\n")
    for _ in range(60):
        world.say(number, b"  x = 1\n" * 500)
    assert number not in world.closed
    world.say(number, b"end\ndef b():\n  sleep(1)\nend\n")
    world.run(0.1)
    assert (MessageKind.TEXT, f"a program has more than {LARGEST} bytes") in [
        m[:2] for m in messages(world, listening)
    ]
    assert world.controller.program_name == "b"


def test_a_line_that_is_too_long_is_answered_and_its_connection_goes_on(world):
    number = world.join("dashboard")
    long = b"x" * 4000
    said = b"".join(world.say(number, each) for each in (long, long, long, b"\nrobotmode\n"))
    assert said.decode().splitlines()[1:] == [
        "could not understand: a line of more than 4096 bytes",
        "Robotmode: RUNNING",
    ]


def test_what_is_no_rtde_is_informed(world):
    number = world.join("rtde")
    assert b"not an RTDE server" in world.say(number, b"\0\0V\0\2")
    assert number in world.closed


@pytest.mark.parametrize(
    "words", [b"GET / HTTP/1.1\r\n", b"POST / HTTP/1.1\r\n", b"SSH-2.0-", b"\x16\x03\x01\x02\0"]
)
def test_a_client_that_speaks_another_protocol_is_let_go_of(words, world):
    for count in (1, 2):
        number = world.join("rtde")
        assert world.say(number, words[:2]) == b""
        assert number not in world.closed
        world.say(number, words[2:])
        assert number in world.closed
        assert f"the client does not speak RTDE ({count} so far)" in world.servers.events[-1][1]


def test_a_long_recipe_before_the_version_is_answered(world):
    number = world.join("rtde")
    long = ask_outputs(125.0, [f"output_double_register_{n}" for n in range(48)])
    assert b"has to be agreed on first" in world.say(number, long)
    assert number not in world.closed


def test_programs_wait_in_their_sockets_while_many_wait_here(world):
    number, other = world.join("primary"), world.join("dashboard")
    body = b"def a():\n" + b"  x = [1, -2 * (3 + 4)]\n" * 1_000 + b"end\n"
    for _ in range(MOST_WAITING + 1):
        world.say(number, body)
    assert not world.servers.takes(number)
    assert world.servers.takes(other)
    world.run(2.0)
    assert world.servers.takes(number)


def test_orders_that_are_no_script():
    world = World(running=False)
    number = world.join("primary")
    world.say(number, b"power on\n")
    world.run(1.1)
    assert world.controller.mode is RobotMode.IDLE
    world.say(number, b"  Set  robotmode run  # please\n")
    world.run(0.7)
    assert world.controller.mode is RobotMode.RUNNING
    world.upload(LOOP).run(0.1)
    world.say(number, b"pause program\n")
    assert world.controller.runtime is RuntimeState.PAUSED
    world.say(number, b"resume program\n")
    assert world.controller.runtime is RuntimeState.PLAYING
    world.say(number, b"stop program\n")
    assert not world.controller.has_program
    world.controller.protective_stop("a test")
    world.run(5.1)
    world.say(number, b"set unlock protective stop\n")
    assert world.controller.safety is SafetyMode.NORMAL
    world.say(number, b"power off\n")
    assert world.controller.mode is RobotMode.POWER_OFF


def test_local_control_takes_no_orders():
    world = World(remote=False)
    heard = world.join("primary")
    world.say(world.join("secondary"), b"power off\n")
    assert world.controller.mode is RobotMode.RUNNING
    assert messages(world, heard)[-1].text == "the robot is in local control"
    world.upload("  sync()").run(0.2)
    assert "a program is not taken: the robot is in local control" in world.events()
    world.say(world.join("secondary"), b"power off\n" * 2_000)
    refused = [m for m in messages(world, heard) if m.kind == MessageKind.ERROR_CODE]
    assert len(refused) == 1_000 + 2


# -- the dashboard ---------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path):
    inside = tmp_path / "programs"
    (inside / "sub").mkdir(parents=True)
    (inside / "wait.urp").write_bytes(b"gzip")
    (inside / "wait.script").write_text(f"def anything():\n{LOOP}\nend\n")
    (inside / "sub" / "end.script").write_text("def end_it():\n  halt\nend\n")
    (inside / "alone.urp").write_bytes(b"gzip")
    (inside / "bad.script").write_text("def\n")
    (inside / "cell.installation").write_bytes(b"")
    (tmp_path / "secret.script").write_text("def a():\n  halt\nend\n")
    (inside / "link.script").symlink_to(tmp_path / "secret.script")
    (inside / "link.urp").write_bytes(b"gzip")
    (inside / "pipe.urp").write_bytes(b"gzip")
    os.mkfifo(inside / "pipe.script")
    (inside / "long.script").write_bytes(b"#" * (LARGEST + 1))
    return inside


def test_load_and_play(folder):
    world = World(programs=str(folder))
    board = world.join("dashboard")
    assert world.ask(board, "get loaded program") == "No program loaded"
    assert world.ask(board, "play") == "Failed to execute: play"
    assert world.ask(board, "load wait.urp") == "Loading program: wait.urp"
    assert world.ask(board, "programState") == "STOPPED wait.urp"
    assert world.ask(board, "get loaded program") == "Loaded program: wait.urp"
    assert world.ask(board, "isProgramSaved") == "true wait.urp"
    assert world.ask(board, "play") == "Starting program"
    world.run(0.1)
    assert world.ask(board, "programState") == "PLAYING wait.urp"
    assert world.ask(board, "play") == "Failed to execute: play"
    assert world.ask(board, "load wait.urp") == "Error while loading program: wait.urp"
    assert world.ask(board, "load installation cell.installation").startswith("Failed to load")
    assert world.ask(board, "pause") == "Pausing program"
    assert world.ask(board, "programState") == "PAUSED wait.urp"
    assert world.ask(board, "pause") == "Failed to execute: pause"
    assert world.ask(board, "play") == "Starting program"
    assert world.ask(board, "running") == "Program running: true"
    assert world.ask(board, "stop") == "Stopped"
    assert world.ask(board, "running") == "Program running: false"
    assert world.ask(board, "programState") == "STOPPED wait.urp"


@pytest.mark.parametrize(
    ("name", "answer"),
    [
        ("/ursim/programs/wait.urp", "Loading program: "),
        ("/programs/sub/end.script", "Loading program: "),
        ("sub/end.script", "Loading program: "),
        ("none.urp", "File not found: "),
        ("sub", "File not found: "),
        ("../secret.script", "File not found: "),
        ("/etc/passwd", "File not found: "),
        ("link.script", "File not found: "),
        ("a\0b", "File not found: "),
        ("a" * 300 + ".script", "File not found: "),
        ("link.urp", "Error while loading program: "),
        ("pipe.urp", "Error while loading program: "),
        ("long.script", "Error while loading program: "),
        ("alone.urp", "Error while loading program: "),
    ],
)
def test_what_can_be_loaded(folder, name, answer):
    world = World(programs=str(folder))
    assert world.ask(world.join("dashboard"), f"load {name}") == answer + name


def test_what_a_program_says_too_much_is_left_out(world):
    inner = "    while i < 300:\n      textmsg(i)\n      i = i + 1\n    end\n"
    world.controller.upload(f"def a():\n  while True:\n    i = 0\n{inner}    sync()\n  end\nend\n")
    world.controller.advance(0.0)
    for frame in range(1, 60):
        world.controller.advance(frame * world.controller.period_s)
    assert 1000 <= len(world.controller.messages) <= 1001
    assert world.controller.has_program


def test_a_client_that_has_gone_is_lost_once(monkeypatch):
    peer, lost = UrControllerPeer(UrControllerOptions()), []
    monkeypatch.setattr(peer.servers, "lost", lambda number, _now_s, _why: lost.append(number))
    with socket.socket() as gone:
        link = peer._links[1] = _Link(1, "primary", gone)
        for _ in range(3):
            peer._send(link, b"more")
        del peer._links[1]
    assert lost == [1]


def test_a_program_that_is_refused_is_not_played(folder):
    world = World(programs=str(folder))
    board, primary = world.join("dashboard"), world.join("primary")
    assert world.ask(board, "load bad.script") == "Loading program: bad.script"
    assert world.ask(board, "play") == "Failed to execute: play"
    world.run(0.05)
    assert messages(world, primary)[-1].kind == MessageKind.RUNTIME_EXCEPTION


def test_what_is_saved(folder):
    world = World(programs=str(folder))
    board = world.join("dashboard")
    world.ask(board, "power off"), world.ask(board, "addToLog Now look")
    assert world.ask(board, "saveLog") == "Log saved to disk"
    log = (folder / "log_history.txt").read_text()
    assert log == "0.000 power off\n0.000 dashboard: connection 1\n0.000 Now look\n"
    assert world.ask(board, "generate support file sub") == (
        "Completed successfully: ur_20000000000.zip"
    )
    with zipfile.ZipFile(folder / "sub" / "ur_20000000000.zip") as file:
        assert file.namelist() == ["log_history.txt"]
    assert world.ask(board, "generate support file ..") == "Error: there is no directory .."
    assert world.ask(board, "load installation cell.installation") == (
        "Loading installation: cell.installation"
    )


COMMON = [
    ("PolyscopeVersion", "URSoftware {version} (simulated)"),
    ("get robot model", "UR5"),
    ("get serial number", "20000000000"),
    ("robotmode", "Robotmode: RUNNING"),
    ("safetymode", "Safetymode: NORMAL"),
    ("safetystatus", "Safetystatus: NORMAL"),
    ("running", "Program running: false"),
    ("isProgramSaved", "true"),
    ("popup watch  out", "showing popup"),
    ("close popup", "closing popup"),
    ("close safety popup", "closing safety popup"),
    ("addToLog something", "Added log message"),
    ("addToLog", "No log message to add"),
    ("load", "could not understand: 'load'"),
    ("load a.urp", "File not found: a.urp"),
    ("load installation default.installation", "Loading installation: default.installation"),
    ("load installation a.installation", "File not found: a.installation"),
    ("saveLog", "Failed to save log"),
    ("generate flight report", "Flight Report generated with id: 1"),
    ("generate flight report software", "Flight Report generated with id: 2"),
    ("generate flight report other", "Error: there is no flight report 'other'"),
    ("generate support file .", "Error: there is no directory ."),
    ("restart safety", "Restarting safety"),
    ("power on", "Powering on"),
    ("brake release", "Brake releasing"),
    ("power off", "Powering off"),
    ("unlock protective stop", "Protective stop releasing"),
    ("stop", "Stopped"),
    ("pause", "Failed to execute: pause"),
    ("", "could not understand: ''"),
    ("Nonsense", "could not understand: 'Nonsense'"),
]
E_SERIES = [
    ("version", "5.12.0.0"),
    ("is in remote control", "true"),
    ("get operational mode", "NONE"),
    ("set operational mode MANUAL", "Operational mode MANUAL is set"),
    ("get operational mode", "MANUAL"),
    ("set operational mode other", "Failed setting operational mode: other"),
    (
        "clear operational mode",
        "No longer controlling the operational mode. Current operational mode: 'NONE'.",
    ),
    ("get operational mode", "NONE"),
    ("getUserRole", "could not understand: 'getUserRole'"),
    ("setUserRole none", "could not understand: 'setUserRole none'"),
]
CB3 = [
    ("version", "could not understand: 'version'"),
    ("is in remote control", "could not understand: 'is in remote control'"),
    ("set operational mode manual", "could not understand: 'set operational mode manual'"),
    ("getUserRole", "PROGRAMMER"),
    ("setUserRole LOCKED", "Setting user role: LOCKED"),
    ("getUserRole", "LOCKED"),
    ("setUserRole other", "Failed setting user role: other"),
]


@pytest.mark.parametrize(
    ("robot", "version", "own"), [("ur5e", "5.12.0.0", E_SERIES), ("ur5", "3.15.0.0", CB3)]
)
def test_every_answer(robot, version, own):
    world = World(robot=robot)
    board = world.join("dashboard")
    for request, answer in [*COMMON, *own]:
        assert world.ask(board, request) == answer.format(version=version), request


@pytest.mark.parametrize(
    ("robot", "software", "knows", "lacks"),
    [
        ("ur5e", "5.0", "version", "is in remote control"),
        ("ur5e", "5.3.1", "restart safety", "safetystatus"),
        ("ur5e", "5.7.0.4", "get operational mode", "saveLog"),
        ("ur5", "3.2", "getUserRole", "restart safety"),
        ("ur5", "3.12", "get serial number", "generate flight report"),
    ],
)
def test_an_older_version_knows_less(robot, software, knows, lacks):
    world = World(robot=robot, software=software)
    board = world.join("dashboard")
    assert "could not understand" not in world.ask(board, knows)
    assert world.ask(board, lacks) == f"could not understand: '{lacks}'"
    assert software in world.ask(board, "PolyscopeVersion")


@pytest.mark.parametrize(("software", "size"), [("3.4", 46), ("3.5", 47)])
def test_the_modes_are_a_byte_longer_from_3_5_on(software, size):
    world = World(robot="ur5", software=software)
    number = world.join("secondary")
    world.run(0.15)
    assert struct.unpack_from(">i", packages(world, number)[-1].content) == (size,)


@pytest.mark.parametrize(
    ("robot", "software"),
    [("ur5e", "3.15"), ("ur5", "5.0"), ("ur5", "3.16"), ("ur5e", "5"), ("ur5e", "5.x")],
)
def test_a_version_that_the_robot_never_had(robot, software):
    with pytest.raises(OptionError, match="software"):
        UrControllerOptions(robot=robot, software=software)


def test_help_of_a_cb3_names_what_it_understands():
    world = World(robot="ur5")
    said = world.ask(world.join("dashboard"), "help")
    assert said.startswith("Available commands: addtolog, brake release")
    assert "operational" not in said


@pytest.mark.parametrize(
    "request_", ["load a.urp", "play", "load installation x", "power off", "shutdown"]
)
def test_local_control_refuses(request_):
    world = World(remote=False)
    said = world.ask(world.join("dashboard"), request_)
    assert said == f"'{request_}' is not allowed in local control"


def test_a_set_mode_is_reported_on_the_client_interfaces(world):
    world.ask(world.join("dashboard"), "set operational mode AUTOMATIC")
    number = world.join("secondary")
    world.run(0.15)
    assert robot_state.sub_packages(packages(world, number)[-1])[3][-3] == 2


def test_shutdown_ends_all_connections_for_good(world):
    numbers = [world.join(kind) for kind in PORT_KINDS]
    board = world.join("dashboard")
    assert world.ask(board, "shutdown") == "Shutting down"
    assert world.closed == {*numbers, board}
    assert world.join("primary") is None
    assert world.controller.mode is RobotMode.POWER_OFF


# -- clients ---------------------------------------------------------------------------------------


def test_all_ports_have_several_clients_at_once(world):
    for kind in PORT_KINDS:
        numbers = [world.join(kind) for _ in range(CLIENTS)]
        assert None not in numbers
        assert world.join(kind) is None
        world.servers.eof(numbers[0], world.now_s)
        assert world.join(kind) is not None


def test_where_the_ports_are():
    usual = UrControllerOptions().ports
    assert usual == {
        "rtde": 30004,
        "dashboard": 29999,
        "primary": 30001,
        "secondary": 30002,
        "realtime": 30003,
        "primary-read": 30011,
        "secondary-read": 30012,
        "realtime-read": 30013,
    }
    other = UrControllerOptions(primary_port=40001).ports
    assert {other[kind] for kind in PORT_KINDS if kind not in ("rtde", "dashboard", "primary")} == {
        0
    }
    given = UrControllerOptions(primary_port=40001, secondary_port=30002).ports
    assert (given["secondary"], given["secondary-read"]) == (30002, 30012)


def stamps_of(kind, data):
    """Return the time stamps of the complete packets in `data`, s, and the rest of it."""
    stamps = []
    head = struct.Struct(">id") if kind.startswith("realtime") else struct.Struct(">IB5xQ")
    while len(data) >= head.size and len(data) >= (size := head.unpack_from(data)[0]):
        if head.size == 12:
            stamps.append(head.unpack_from(data)[1])
        elif data[4] == ROBOT_STATE:
            stamps.append(1e-6 * head.unpack_from(data)[2])
        data = data[size:]
    return stamps, data


@pytest.mark.real
def test_clients_that_never_read_miss_whole_packets_on_every_port_of_states(monkeypatch):
    clock = itertools.count(100.0, 0.004)  # Read twice per frame, so that no real time passes.
    monkeypatch.setattr(
        "cardan.sim_peers.tcp_peer.time", SimpleNamespace(monotonic=lambda: next(clock))
    )
    kinds = [kind for kind in PORT_KINDS if kind.startswith(("primary", "secondary", "realtime"))]
    options = UrControllerOptions(
        robot="ur5", rtde_port=0, primary_port=0, dashboard_port=0, running=True
    )
    peer = UrControllerPeer(options)
    with contextlib.ExitStack() as stack:
        peer.open()
        stack.callback(peer.close)
        clients = {}
        for kind in kinds:
            for reads in (False, True):
                client = stack.enter_context(socket.socket())
                if not reads:
                    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                client.connect(("127.0.0.1", peer.port(kind)))
                client.setblocking(False)
                clients[kind, reads] = client
        stamps = {each: [] for each in clients}
        rest = dict.fromkeys(clients, b"")

        def read(kind, reads):
            with contextlib.suppress(BlockingIOError):
                while True:
                    rest[kind, reads] += clients[kind, reads].recv(65536)
                    found, rest[kind, reads] = stamps_of(kind, rest[kind, reads])
                    stamps[kind, reads] += found

        def serve(seconds):
            end_s = next(clock) + seconds
            while (now_s := next(clock)) < end_s:
                peer.step(now_s + 0.05)
                for kind in kinds:
                    read(kind, True)

        serve(25.0)
        # Its messages are read nevertheless.
        clients["realtime", False].sendall(b"def a():\n  sync()\nend\n")
        serve(0.2)
        assert any("program a" in text for _, text in peer.controller.events)
        for kind in kinds:
            period_s = 0.008 if kind.startswith("realtime") else 0.1
            assert max(np.diff(stamps[kind, True])) < 1.5 * period_s
            assert stamps[kind, True][-1] - stamps[kind, True][0] > 20.0
        stood_s = stamps["realtime", True][-1]
        while any(stamps[kind, False][-1:] < [stood_s] for kind in kinds):
            for kind in kinds:
                read(kind, False)
            serve(0.2)
        for kind in kinds:
            assert max(np.diff(stamps[kind, False])) > 1.0
        assert not any("does not read" in text for _, text in peer.servers.events)


LONG_RECIPE = ask_outputs(500.0, [f"output_double_register_{n}" for n in range(48)])


@pytest.mark.real
@pytest.mark.parametrize(
    ("kind", "first", "again"),
    [
        ("rtde", ask_version() + LONG_RECIPE + packet(PacketType.START), b""),
        ("dashboard", b"", b"help\n" * 100),
    ],
    ids=["rtde", "dashboard"],
)
def test_a_client_that_does_not_read_is_let_go_of_where_answers_must_not_be_lost(
    kind, first, again
):
    options = UrControllerOptions(rtde_port=0, primary_port=0, dashboard_port=0, running=True)
    with UrControllerPeer(options) as peer, socket.socket() as idle:
        idle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        idle.connect(("127.0.0.1", peer.port(kind)))
        idle.sendall(first)
        end_s = time.monotonic() + WITHIN_S
        while not any("does not read" in text for _, text in tuple(peer.servers.events)):
            assert time.monotonic() < end_s
            with contextlib.suppress(OSError):
                idle.sendall(again)
            time.sleep(0.02)


# -- a slow computer -------------------------------------------------------------------------------


def test_sockets_are_served_between_the_frames_that_are_owed(world):
    number = world.join("dashboard")
    world.run(0.1)
    frames = world.controller.frames
    world.now_s += 0.3
    for n in range(1, 150):
        world.servers.advance(world.now_s)
        assert world.ask(number, "robotmode") == "Robotmode: RUNNING"
        assert world.controller.frames == frames + n
        assert world.servers.next_s <= world.now_s
    world.run(0.1)
    assert world.controller.frames == frames + 200


def test_time_that_cannot_be_made_up_is_left_out_and_that_is_said_once(world):
    world.run(0.1)
    for _ in range(3):
        world.now_s += 1.0
        world.run(0.02)
    assert world.controller.frames < 100
    assert [text for text in world.events() if "too slow" in text] == [
        "this computer is too slow: 1.00 s are left out (further ones are not reported)"
    ]
