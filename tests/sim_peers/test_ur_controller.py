"""Simulated Universal Robots controller: programs in its own time, modes, and its servers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cardan.errors import OptionError, ScriptError
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.protocols.ur.primary import PackageReader, read_message
from cardan.protocols.ur.rtde import (
    PacketReader,
    PacketType,
    Recipe,
    ask_inputs,
    ask_outputs,
    ask_version,
    packet,
    read_reply,
)
from cardan.protocols.ur.states import RobotMode, RuntimeState, SafetyMode
from cardan.robots import load_arm
from cardan.sim_peers.kinematics import UR_LINKS, forward
from cardan.sim_peers.ur_controller import UrController, UrControllerOptions, UrServers

pytestmark = pytest.mark.matrix


class World:
    """Controller with its servers, in virtual time."""

    def __init__(self, **options):
        options.setdefault("running", True)
        self.options = UrControllerOptions(**options)
        self.controller = UrController(self.options)
        self.servers = UrServers(self.controller, self.options)
        self.now_s = 0.0
        self.heard = {}
        self.closed = set()
        self.path = []
        self.servers.advance(0.0)

    def run(self, seconds):
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            self.now_s = min(max(self.servers.next_s, self.now_s + 1e-6), end_s)
            self.servers.advance(self.now_s)
            self.path.append(tuple(self.controller.motion.target_q))
            self.carry()
        return self

    def carry(self):
        for number, data in self.servers.outgoing():
            self.heard[number] = self.heard.get(number, b"") + data
        self.closed |= {*self.servers.closing(), *self.servers.aborting()}

    def join(self, kind):
        number = self.servers.accepted(kind, self.now_s)
        self.carry()
        return number

    def say(self, number, data):
        self.servers.data(number, data, self.now_s)
        self.carry()
        said, self.heard[number] = self.heard.get(number, b""), b""
        return said

    def ask(self, number, line):
        return self.say(number, line.encode() + b"\n").decode().splitlines()[-1]

    def upload(self, body):
        self.say(self.join("primary"), f"def test():\n{body}\nend\n".encode())
        return self

    def events(self):
        return [text for _, text in (*self.controller.events, *self.servers.events)]


# -- programs --------------------------------------------------------------------------------------


def test_a_program_really_moves_the_arm_and_takes_its_time():
    world = World().upload(
        """
  q = get_target_joint_positions()
  n = 0
  while n < 100:
    q[0] = q[0] + 0.001
    servoj(q, 0, 0, 0.002, 0.03, 300)
    n = n + 1
  end
  write_output_integer_register(1, n)
  servoj(q, 0, 0, 0.5, 0.03, 300)
"""
    )
    world.run(0.05 + 0.19)
    assert world.controller.registers.output_int[1] == 0
    world.run(0.02)
    assert world.controller.registers.output_int[1] == 100
    world.run(0.6)
    assert world.controller.motion.target_q[0] == pytest.approx(0.1, abs=1e-6)
    assert world.controller.runtime is RuntimeState.STOPPED
    steps = np.diff([q[0] for q in world.path]) / 0.002
    assert steps.max() == pytest.approx(0.5, rel=0.01)


def test_speedj_and_stopj():
    world = World().upload("  speedj([0.4, 0, 0, 0, 0, 0.2], 2.0, 0.5)\n  stopj(4.0)")
    world.run(0.05 + 0.49)
    assert world.controller.motion.target_qd == pytest.approx([0.4, 0, 0, 0, 0, 0.2])
    world.run(0.3)
    assert not world.controller.motion.moving
    assert world.controller.motion.target_q[0] == pytest.approx(
        0.5 * 0.2 * 0.4 + 0.3 * 0.4 + 0.4**2 / (2 * 4.0), abs=2e-3
    )


def test_the_slider_makes_a_program_slower():
    body = "  speedj([0.4, 0, 0, 0, 0, 0], 8.0, 0.5)"
    fast, slow = World().upload(body), World(faults={"slider": 0.5}).upload(body)
    assert fast.run(0.2).controller.motion.target_qd[0] == pytest.approx(0.4)
    assert slow.run(0.2).controller.motion.target_qd[0] == pytest.approx(0.2)
    fast.run(0.5), slow.run(0.5)
    assert not fast.controller.has_program
    assert slow.controller.has_program


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("  modbus_add_signal([0])", "line 2: compile_error_name_not_found:modbus_add_signal:"),
        ("  movej([0])", "line 2: movej(): q is [0], which is not 6 joints"),
        ("  while True:\n    n = 1\n  end", "used too much time without instructing the robot"),
        ("  x = y", "y has no value"),
        ("  x = [1]\n  x[3] = 2", "a list of 1 has no element 3"),
        ("  x = 1 / 0", "division by zero"),
        ("  x = 2000000000 + 2000000000", "more than 32 bits"),
        ("  if [1]:\n    sync()\n  end", "'[1]' is neither True nor False"),
        ("  servoj([0, 0])", "servoj(): q is [0, 0], which is not 6 joints"),
        ("  servoj(get_target_joint_positions(), gain=1)", "gain 1 is not 100 to 2000"),
        ("  servoj(get_target_joint_positions(), speed=1)", "has no argument speed"),
        ("  stopj()", "stopj(): a is missing"),
        ("  x = sync()", "sync() returns no value"),
        ("  write_output_integer_register(1, 0.5)", "0.5 is not a whole number"),
        ("  x = read_input_integer_register(48)", "there is no register 48"),
        ("  break", "outside of `while`"),
        ("  run a()", "there is no thread a"),
    ],
)
def test_a_program_that_cannot_go_on_says_why(body, words):
    world = World()
    primary = world.join("primary")
    heard = world.say(primary, f"def test():\n{body}\nend\n".encode())
    world.run(0.1)
    assert not world.controller.has_program
    assert any(words in text for text in world.events()), world.events()
    reader = PackageReader()
    reader.feed(heard + world.heard[primary])
    said = []
    while (found := reader.take()) is not None:
        said.append(read_message(found))
    assert any(message is not None and message.line for message in said)


def test_a_command_that_is_too_fast_is_a_protective_stop():
    world = World().upload("  servoj([3.0, -1.5, 1.5, -1.5, -1.5, 0.0], 0, 0, 0.002, 0.03, 300)")
    world.run(0.2)
    assert world.controller.safety is SafetyMode.PROTECTIVE_STOP
    assert "was asked for" in " ".join(world.events())
    assert world.controller.motion.target_q[0] == 0.0


def test_a_program_in_pieces_and_two_at_once():
    world = World()
    primary = world.join("primary")
    for piece in (b"def a():\n  while True:\n", b"    sync()\n  end\ne", b"nd\ndef b():\n  hal"):
        world.say(primary, piece)
    world.run(0.1)
    assert world.controller.program_name == "a"
    world.say(primary, b"t\nend\n")
    world.run(0.1)
    assert world.controller.program_name == "b"
    assert not world.controller.has_program


# -- modes -----------------------------------------------------------------------------------------


def test_power_brakes_and_what_the_dashboard_says_of_them():
    world = World(running=False)
    board = world.join("dashboard")
    assert world.ask(board, "robotmode").endswith("Robotmode: POWER_OFF")
    assert world.ask(board, "power on") == "Powering on"
    assert world.ask(board, "robotmode") == "Robotmode: POWER_ON"
    world.run(1.1)
    assert world.ask(board, "Robotmode") == "Robotmode: IDLE"
    assert world.ask(board, "brake release") == "Brake releasing"
    world.run(0.7)
    assert world.controller.mode is RobotMode.RUNNING
    assert world.ask(board, "is in remote control") == "true"
    assert world.ask(board, "nonsense") == "could not understand: 'nonsense'"
    assert world.ask(board, "load a.urp") == "File not found: a.urp"
    world.ask(board, "quit")
    assert board in world.closed


def test_a_cb3_has_no_remote_control():
    world = World(robot="ur5", remote=False)
    board = world.join("dashboard")
    assert "could not understand" in world.ask(board, "is in remote control")
    assert world.ask(board, "power off") == "Powering off"


def test_a_protective_stop_can_be_unlocked_after_five_seconds():
    world = World(faults={"protective-stop": 0.5})
    world.upload("  while True:\n    speedj([0.5, 0, 0, 0, 0, 0], 5.0, 0.1)\n  end").run(1.0)
    assert world.controller.safety is SafetyMode.PROTECTIVE_STOP
    assert not world.controller.has_program
    assert not world.controller.motion.moving
    board = world.join("dashboard")
    assert "until 5s after" in world.ask(board, "unlock protective stop")
    world.run(5.0)
    assert world.ask(board, "unlock protective stop") == "Protective stop releasing"
    assert world.ask(board, "safetystatus") == "Safetystatus: NORMAL"
    assert world.ask(board, "programState") == "STOPPED <unnamed>"


def test_a_guard_pauses_the_program_and_somebody_goes_on_with_it():
    world = World(faults={"safeguard-stop": 0.3, "safeguard-reset": 0.6})
    world.upload("  while True:\n    sync()\n  end").run(0.5)
    assert world.controller.safety is SafetyMode.SAFEGUARD_STOP
    board = world.join("dashboard")
    assert world.ask(board, "play") == "Failed to execute: play"
    world.run(0.2)
    assert world.ask(board, "programState") == "PAUSED test"
    assert world.ask(board, "play") == "Starting program"
    assert world.ask(board, "running") == "Program running: true"


def test_options_that_are_refused():
    with pytest.raises(OptionError, match="another one"):
        UrControllerOptions(rtde_port=1, primary_port=1)
    with pytest.raises(OptionError, match="6 joints inside"):
        UrControllerOptions(start=(0.0,))
    with pytest.raises(ScriptError, match="needs the fault pause"):
        UrControllerOptions(faults={"resume": 1.0})


# -- RTDE ------------------------------------------------------------------------------------------


def replies(data):
    reader, found = PacketReader(), []
    reader.feed(data)
    while (each := reader.take()) is not None:
        found.append(read_reply(*each))
    return found


def joined(world):
    number = world.join("rtde")
    world.say(number, ask_version())
    return number


@pytest.mark.parametrize(("robot", "rate_hz", "count"), [("ur5e", 500, 50), ("ur5", 125, 12)])
def test_states_come_at_the_rate_asked_for(robot, rate_hz, count):
    world = World(robot=robot)
    number = joined(world)
    names = ("timestamp", "actual_q", "robot_mode")
    (setup,) = replies(world.say(number, ask_outputs(rate_hz, names)))
    assert setup.types == ("DOUBLE", "VECTOR6D", "INT32")
    world.say(number, packet(PacketType.START))
    world.run(0.1)
    recipe = Recipe(setup.recipe, names, setup.types)
    values = [recipe.unpack(each.values) for each in replies(world.heard[number])]
    assert len(values) == count
    assert np.diff([v["timestamp"] for v in values]) == pytest.approx(1.0 / rate_hz)
    assert values[-1]["robot_mode"] == RobotMode.RUNNING
    world.say(number, packet(PacketType.PAUSE))
    world.heard[number] = b""
    world.run(0.1)
    assert world.heard[number] == b""


def test_what_rtde_refuses():
    world = World()
    number = world.join("rtde")
    said = replies(world.say(number, ask_outputs(125, ["timestamp"])))
    assert "version 2 has to be agreed on first" in said[0].text
    assert said[1].recipe == 0
    (version,) = replies(world.say(number, ask_version(7)))
    assert not version.accepted
    number = joined(world)
    (setup,) = replies(world.say(number, ask_outputs(125, ["timestamp", "nothing"])))
    assert (setup.recipe, setup.types) == (0, ("DOUBLE", "NOT_FOUND"))
    said, setup = replies(world.say(number, ask_outputs(1000, ["timestamp"])))
    assert "1000 Hz is not 1 to 500 Hz" in said.text
    (start,) = replies(world.say(number, packet(PacketType.START)))
    assert not start.accepted
    (said,) = replies(world.say(number, packet(PacketType.DATA, b"\x09")))
    assert "there is no input recipe 9" in said.text
    world.say(number, b"\0\0\0\0")
    assert number in world.closed


def test_one_client_has_a_register_until_it_goes():
    world = World()
    first, second = joined(world), joined(world)
    (mine,) = replies(world.say(first, ask_inputs(["input_int_register_24"])))
    assert mine.recipe == 1
    world.say(first, Recipe(1, ["r"], ["INT32"]).pack([-5]))
    assert world.controller.registers.input_int[24] == -5
    (theirs,) = replies(world.say(second, ask_inputs(["input_int_register_24"])))
    assert (theirs.recipe, theirs.types) == (0, ("IN_USE",))
    world.servers.eof(first, world.now_s)
    (theirs,) = replies(world.say(second, ask_inputs(["input_int_register_24"])))
    assert theirs.recipe == 1
    # A written value is kept.
    assert world.controller.registers.input_int[24] == -5


# -- faults of the network -------------------------------------------------------------------------


def test_a_connection_that_is_cut_and_one_that_is_reset():
    world = World(faults={"cut": 0.2, "reset": 0.4})
    rtde, board = world.join("rtde"), world.join("dashboard")
    world.run(0.3)
    assert world.closed == {rtde}
    world.run(0.2)
    assert world.closed == {rtde, board}


def test_a_controller_that_stood_still_does_not_make_up_for_it():
    world = World().upload("  while True:\n    speedj([0.5, 0, 0, 0, 0, 0], 5.0, 0.1)\n  end")
    world.run(0.5)
    at = world.controller.motion.target_q[0]
    world.now_s += 30.0
    world.servers.advance(world.now_s)
    assert world.controller.motion.target_q[0] - at < 0.5 * 0.6


# -- kinematics ------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["ur5", "ur5e"])
def test_the_models_kinematics_are_those_of_the_tables(robot):
    """The model's base is rotated by pi from the controller's."""
    arm = ArmKinematics(load_arm(robot))
    for joints in np.random.default_rng(3).uniform(-3.0, 3.0, (20, 6)):
        x, y, z = forward(joints, UR_LINKS[robot]).pose.position
        assert arm.forward(joints).translation == pytest.approx((-x, -y, z), abs=1e-6)


def test_a_pose_by_hand():
    """Expected pose of a UR5e stretched upwards: the sum of its link lengths."""
    pose = forward((0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0), UR_LINKS["ur5e"]).pose
    assert pose.position == pytest.approx(
        (0.0, -0.1333 - 0.0996, 0.1625 + 0.425 + 0.3922 + 0.0997), abs=1e-9
    )
