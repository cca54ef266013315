"""Variables that the simulated UR controller reports: each follows its motion and its state."""

from __future__ import annotations

import itertools
import math
import struct

import numpy as np
import pinocchio as pin
import pytest

from cardan.protocols.ur.rtde import (
    PacketReader,
    PacketType,
    Recipe,
    RecipeSetup,
    TextLevel,
    TextMessage,
    ask_inputs,
    ask_outputs,
    ask_version,
    packet,
    read_reply,
    read_request,
    text,
)
from cardan.protocols.ur.states import RobotMode, RuntimeState
from cardan.protocols.ur.variables import INPUT_VARIABLES, OUTPUT_VARIABLES, OUTPUTS, of_series
from cardan.robots import load_arm
from cardan.robots.arm_bodies import pinocchio_model
from cardan.sim_peers.ur_controller import UrController, UrControllerOptions, UrServers
from cardan.sim_peers.ur_controller.dynamics import Dynamics, RigidBody
from cardan.sim_peers.ur_controller.kinematics import frame_of
from cardan.sim_peers.ur_controller.motion import Payload
from cardan.sim_peers.ur_controller.telemetry import Telemetry
from cardan.sim_peers.ur_controller.values import UrPose
from cardan.spatial import rotate, rotation_between

UP = 9.82
LOAD = RigidBody(2.0, (0.01, 0.02, 0.05), (0.01, 0.02, 0.03, 0.001, 0.002, 0.003))
MOVING = """def moving():
  speedj([0.4, 0.2, -0.3, 0.5, 0.1, 0.2], 2.0, 0.6)
  stopj(2.0)
end
"""


class World:
    """Controller with a program, and its reports."""

    def __init__(self, program="", **options):
        self.controller = UrController(
            UrControllerOptions(running=True, program_start_s=0.0, **options)
        )
        self.telemetry = Telemetry(self.controller)
        self.value = self.telemetry.value
        self.now_s = 0.0
        self.controller.advance(0.0)
        if program:
            self.controller.upload(program)

    def run(self, seconds):
        for _ in range(round(seconds / self.controller.period_s)):
            self.now_s += self.controller.period_s
            self.controller.advance(self.now_s)
        return self

    def record(self, seconds, *names):
        """Record the variables' values in each frame."""
        found = []
        for _ in range(round(seconds / self.controller.period_s)):
            self.run(self.controller.period_s)
            found.append([np.array(self.value(name), dtype=float) for name in names])
        return (np.array(each) for each in zip(*found, strict=True))


# -- the table -------------------------------------------------------------------------------------


def test_the_table_has_all_that_is_published_once():
    registers = [name for name in OUTPUTS if "_register" in name]
    assert len(registers) == 2 * (2 + 64 + 48 + 48)
    assert len(OUTPUTS) - len(registers) == 82
    assert OUTPUT_VARIABLES["payload_inertia"].since(3) == (3, 15)
    assert OUTPUT_VARIABLES["output_int_register_24"].since(5) == (5, 3)
    assert OUTPUT_VARIABLES["tool_output_mode"].since(3) is None
    assert "input_bit_register_63" not in INPUT_VARIABLES


@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
def test_every_variable_of_its_series_can_be_sent_in_every_state(robot):
    world = World(MOVING, robot=robot)
    names = list(world.telemetry.outputs)
    assert names == list(of_series(OUTPUT_VARIABLES, 5 if robot == "ur5e" else 3))
    recipe = Recipe(1, names, list(world.telemetry.outputs.values()))
    for act in (lambda: None, world.controller.emergency_stop, world.controller.restart):
        act()
        world.run(0.4)
        recipe.pack([world.value(name) for name in names])


def test_a_cb3_has_no_variables_of_an_e_series():
    assert "ft_raw_wrench" not in World(robot="ur5").telemetry.outputs


# -- the dynamics ----------------------------------------------------------------------------------


def pinocchio_inertia(load):
    xx, yy, zz, xy, xz, yz = load.inertia
    return pin.Inertia(
        load.mass, np.array(load.center), np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
    )


@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
def test_the_dynamics_are_pinocchios(robot):
    arm = load_arm(robot)
    model = pinocchio_model(arm)
    model.gravity.linear = np.array((0.0, 0.0, -UP))
    inertia = pinocchio_inertia(LOAD)
    loaded = model.copy()
    loaded.appendBodyToJoint(6, inertia, pin.SE3.Identity())
    data, dynamics = loaded.createData(), Dynamics(arm)
    for q, v, a in np.random.default_rng(5).uniform(-2.0, 2.0, (20, 3, 6)):
        found = dynamics.effort(q.tolist(), v.tolist(), a.tolist(), LOAD, (0.0, 0.0, UP))
        torques = pin.rnea(loaded, data, q, v, a)
        assert found.torques == pytest.approx(torques, abs=1e-9)
        base = data.liMi[1].act(data.f[1])
        assert found.base_wrench == pytest.approx((*base.linear, *base.angular), abs=1e-9)
        pin.computeCentroidalMomentum(loaded, data, q, v)
        assert found.momentum == pytest.approx(np.linalg.norm(data.hg.linear), abs=1e-9)
        pin.forwardKinematics(loaded, data, q, v, a)
        moved = pin.getClassicalAcceleration(loaded, data, 6, pin.ReferenceFrame.LOCAL)
        weight = data.oMi[6].rotation.T @ np.array((0.0, 0.0, UP))
        assert found.acceleration == pytest.approx(moved.linear + weight, abs=1e-9)
        assert found.turning == pytest.approx(moved.angular, abs=1e-9)
        felt = inertia * (data.a[6] + pin.Motion(weight, np.zeros(3))) + inertia.vxiv(data.v[6])
        assert found.load_wrench == pytest.approx((*felt.linear, *felt.angular), abs=1e-9)


@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
def test_the_functions_of_dynamics_are_pinocchios(robot):
    world = World(robot=robot)
    functions, motion = world.controller.functions, world.controller.motion
    motion.payload = Payload(LOAD.mass, LOAD.center, LOAD.inertia)
    model = pinocchio_model(load_arm(robot))
    model.gravity.linear = np.zeros(3)
    model.appendBodyToJoint(6, pinocchio_inertia(LOAD), pin.SE3.Identity())
    data = model.createData()
    for q, v in np.random.default_rng(6).uniform(-2.0, 2.0, (20, 2, 6)):
        place, speed = q.tolist(), v.tolist()
        mass = pin.crba(model, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        assert np.array(functions["get_mass_matrix"].do(place, False)) == pytest.approx(mass)
        torques = functions["get_coriolis_and_centrifugal_torques"].do(place, speed)
        assert torques == pytest.approx(pin.rnea(model, data, q, v, np.zeros(6)), abs=1e-9)
        # With zero joint acceleration, the result is the acceleration of the flange.
        rate = np.array(functions["get_jacobian_time_derivative"].do(place, speed, None))
        effort = world.controller.dynamics.effort(place, speed, [0.0] * 6, LOAD, (0.0,) * 3)
        turn = motion.kinematics.forward(place).orientation
        moved = (*rotate(turn, effort.acceleration), *rotate(turn, effort.turning))
        assert rate @ v == pytest.approx(moved, abs=1e-6)


def test_what_a_function_of_dynamics_is_not_given_is_measured():
    world = World()
    functions, q = world.controller.functions, list(world.controller.motion.actual_q)
    for name, more in (
        ("get_mass_matrix", [False]),
        ("get_coriolis_and_centrifugal_torques", [[0.0] * 6]),
        ("get_jacobian_time_derivative", [[0.0] * 6, None]),
    ):
        function = functions[name]
        assert function.do(*function.defaults.values()) == function.do(q, *more)
    with pytest.raises(ValueError, match="the model has no rotors"):
        functions["get_mass_matrix"].do(q, True)


def test_an_arm_that_is_none_of_urs_has_no_such_dynamics():
    with pytest.raises(ValueError, match="does not turn about its z axis"):
        Dynamics(load_arm("gofa_crb15000_5"))


# -- values that follow the motion -----------------------------------------------------------------


@pytest.mark.parametrize("kind", ["actual", "target"])
def test_speeds_and_accelerations_are_those_of_the_poses(kind):
    world = World(MOVING).run(0.02)
    world.controller.functions["set_tcp"].do(UrPose((0.0, 0.05, 0.1, 0.2, 0.0, 0.0)), "")
    poses, speeds, accelerations = world.record(
        0.8, f"{kind}_TCP_pose", f"{kind}_TCP_speed", f"{kind}_TCP_acceleration"
    )
    dt = world.controller.period_s
    assert speeds[1:, :3] == pytest.approx(np.diff(poses[:, :3], axis=0) / dt, abs=6e-3)
    turns = [
        rotation_between(frame_of(a).orientation, frame_of(b).orientation)
        for a, b in itertools.pairwise(poses)
    ]
    assert speeds[1:, 3:] == pytest.approx(np.array(turns) / dt, abs=6e-3)
    moving = slice(1, 250)
    rates = np.diff(speeds, axis=0)[moving] / dt
    assert accelerations[1:][moving] == pytest.approx(rates, abs=2e-2)
    assert abs(accelerations).max() > 0.3


def test_joint_accelerations_are_those_of_the_speeds():
    speeds, changes = World(MOVING).record(0.3, "target_qd", "target_qdd")
    assert changes[1:] == pytest.approx(np.diff(speeds, axis=0) / 0.002, abs=1e-6)
    assert abs(changes).max() > 1.0


def test_currents_are_the_torques_of_the_motion():
    world = World(MOVING)
    still = world.value("target_moment")
    assert abs(still[1]) > 5.0
    world.run(0.1)
    assert world.value("target_moment")[0] != pytest.approx(still[0], abs=0.1)
    assert np.array(world.value("target_moment")) / world.value("target_current") == pytest.approx(
        (10.5,) * 3 + (8.4,) * 3
    )
    assert world.value("actual_current") == world.value("joint_control_output")
    assert world.value("actual_momentum") > 0.1
    assert world.value("actual_robot_current") > 0.4
    world.run(1.0)
    assert world.value("actual_momentum") == pytest.approx(0.0, abs=1e-3)
    torque = world.value("actual_current_as_torque")
    assert torque == pytest.approx(world.value("target_moment"), abs=1e-2)


def test_brakes_hold_without_current_and_nothing_flows_without_power():
    world = World()
    world.controller.mode = RobotMode.IDLE
    assert world.value("actual_current") == world.value("target_moment") == (0.0,) * 6
    assert world.value("actual_robot_current") == 0.4
    assert set(world.value("joint_mode")) == {255}
    world.controller.power_off()
    assert world.value("actual_robot_current") == world.value("actual_robot_voltage") == 0.0
    assert set(world.value("joint_mode")) == {239}


def test_gravity_in_the_tools_axes_and_a_payload_at_the_sensor():
    world = World()
    # At home the tool points down.
    assert world.value("actual_tool_accelerometer") == pytest.approx((0.0, 0.0, -UP), abs=1e-6)
    before = world.value("actual_current_as_torque")
    functions = world.controller.functions
    functions["set_target_payload"].do(2.0, [0.0, 0.0, 0.1], [0.0] * 6, 0.0)
    world.run(0.01)
    assert world.value("ft_raw_wrench") == pytest.approx((0.0, 0.0, 2.0 * UP, 0, 0, 0), abs=1e-6)
    more = np.array(world.value("actual_current_as_torque")) - before
    x, *_ = world.value("actual_TCP_pose")
    assert abs(more[1]) == pytest.approx(2.0 * UP * abs(x), rel=1e-6)
    assert world.value("actual_TCP_force") == pytest.approx((0.0,) * 6)


def test_a_contact_is_felt_and_carries_a_part_of_the_arm():
    world = World(contact_z_m=0.49)
    pushed = world.controller.motion.pushed()
    assert pushed > 10.0
    x = world.value("actual_TCP_pose")[0]
    assert world.value("actual_TCP_force")[2] == pytest.approx(pushed)
    assert world.value("tcp_force_scalar") == pytest.approx(pushed)
    assert world.value("ft_raw_wrench")[2] == pytest.approx(-pushed)
    assert world.value("collision_detection_ratio") == pytest.approx(pushed / 150.0)
    less = world.value("actual_current_as_torque")[1] - world.value("target_moment")[1]
    assert abs(less) == pytest.approx(pushed * abs(x), rel=1e-6)


def test_the_elbow_moves_with_the_first_two_joints():
    world = World(MOVING).run(0.1)
    (places, speeds) = world.record(0.2, "elbow_position", "elbow_velocity")
    assert speeds[1:] == pytest.approx(np.diff(places, axis=0) / 0.002, abs=2e-3)
    assert np.linalg.norm(places[0] - (0.0, 0.0, 0.1625)) == pytest.approx(0.425)


def test_how_far_the_arm_is_from_its_target():
    world = World(MOVING).run(0.3)
    lag = max(np.abs(np.subtract(world.value("target_q"), world.value("actual_q"))))
    assert lag > 1e-3
    assert world.value("joint_position_deviation_ratio") == pytest.approx(lag / 0.2)


# -- the program, inputs and outputs ---------------------------------------------------------------


def test_the_line_that_moves_the_arm_and_a_program_that_comes_to_its_end():
    world = World("def a():\n  sleep(0.1)\n  speedj([0.5, 0, 0, 0, 0, 0], 2.0, 0.4)\nend\n")
    world.run(0.05)
    assert (world.value("script_control_line"), world.value("time_scale_source")) == (0, 1)
    world.run(0.2)
    assert world.value("script_control_line") == 3
    assert world.value("runtime_state") is RuntimeState.PLAYING
    world.controller.stop_program()
    world.run(0.004)
    assert world.value("runtime_state") is RuntimeState.STOPPING
    world.run(0.5)
    assert world.value("runtime_state") is RuntimeState.STOPPED
    assert (world.value("script_control_line"), world.value("time_scale_source")) == (0, 0)


def test_a_pause_and_what_comes_after_it_take_their_time():
    world = World("def a():\n  movej([1, -1.5, 1.5, -1.5, -1.5, 0], 1.0, 0.5)\nend\n").run(0.5)
    seen = []
    for act, seconds in ((world.controller.pause, 0.6), (world.controller.resume, 0.6)):
        act()
        for _ in range(round(seconds / 0.002)):
            world.run(0.002)
            now = world.value("runtime_state")
            if now not in seen[-1:]:
                seen.append(now)
    assert seen == [
        RuntimeState.PAUSING,
        RuntimeState.PAUSED,
        RuntimeState.RESUMING,
        RuntimeState.PLAYING,
    ]


def test_what_clients_write_is_reported():
    world = World()
    write, value = world.telemetry.write, world.value
    write({"speed_slider_mask": 1, "speed_slider_fraction": 0.5})
    assert value("target_speed_fraction") == 0.5
    write({"speed_slider_mask": 0, "speed_slider_fraction": 0.7})
    assert value("target_speed_fraction") == 0.5
    write({"speed_slider_mask": 1, "speed_slider_fraction": math.nan})
    assert value("target_speed_fraction") == 0.5
    write({"standard_digital_output_mask": 0b11, "standard_digital_output": 0b10})
    write({"configurable_digital_output_mask": 0xFF, "configurable_digital_output": 0x81})
    write({"tool_digital_output_mask": 1, "tool_digital_output": 3})
    assert value("actual_digital_output_bits") == 0x18102
    assert value("actual_configurable_digital_output_bits") == 0x81
    write({"standard_digital_output": 1})  # the mask is kept
    assert value("actual_digital_output_bits") == 0x18101
    write(
        {
            "standard_analog_output_mask": 3,
            "standard_analog_output_type": 2,
            "standard_analog_output_0": 0.5,
            "standard_analog_output_1": 0.5,
        }
    )
    assert (value("standard_analog_output0"), value("standard_analog_output1")) == (12.0, 5.0)
    assert value("analog_io_types") == 0b1000
    write({"input_bit_registers32_to_63": 0x80000001, "input_bit_register_64": True})
    assert value("input_bit_registers32_to_63") == 0x80000001
    assert value("input_bit_registers0_to_31") == 0
    assert value("input_bit_register_64")
    write({"input_int_register_3": -4, "input_double_register_47": 0.25})
    assert (value("input_int_register_3"), value("input_double_register_47")) == (-4, 0.25)
    world.controller.registers.output_bit[31] = True
    assert value("output_bit_registers0_to_31") == 1 << 31


# -- the protocol ----------------------------------------------------------------------------------


class Client:
    """RTDE client in virtual time."""

    def __init__(self):
        options = UrControllerOptions(running=True)
        self.servers = UrServers(UrController(options), options)
        self.servers.advance(0.0)
        self.number = self.servers.accepted("rtde", 0.0)
        self.reader = PacketReader()

    def say(self, data):
        self.servers.data(self.number, data, 0.0)
        return self.heard()

    def run(self, seconds):
        end_s = round(seconds / 0.002) * 0.002
        for frame in range(1, round(end_s / 0.002) + 1):
            self.servers.advance(frame * 0.002 + 1e-9)
        return self.heard()

    def heard(self):
        for _, data in self.servers.outgoing():
            self.reader.feed(data)
        found = []
        while (each := self.reader.take()) is not None:
            found.append(each)
        return found


def test_version_1_has_neither_a_frequency_nor_a_number_of_outputs():
    client = Client()
    assert client.say(ask_version(1)) == [(ord("V"), b"\1")]
    names = ("timestamp", "robot_mode")
    assert client.say(packet(PacketType.OUTPUTS, ",".join(names).encode())) == [
        (ord("O"), b"DOUBLE,INT32")
    ]
    (found,) = client.say(ask_inputs(["input_int_register_1"]))
    assert found == (ord("I"), b"\1INT32")
    ((kind, said),) = client.say(packet(PacketType.DATA, b"\7"))
    assert (kind, said[0], said[1:]) == (ord("M"), TextLevel.ERROR, b"there is no input recipe 7")
    assert client.say(packet(PacketType.START)) == [(ord("S"), b"\1")]
    packages = client.run(0.1)
    assert len(packages) == 50
    kind, values = packages[-1]
    assert kind == PacketType.DATA
    assert struct.unpack(">di", values) == pytest.approx((0.1, 7))
    assert Recipe(None, names, ("DOUBLE", "INT32")).unpack(values)["robot_mode"] == 7
    said = packet(PacketType.TEXT, b"\2hello")
    assert said == text("hello", "nobody", TextLevel.WARNING, 1)
    assert read_request(ord("M"), b"\2hello", 1) == TextMessage("hello", "", 2)
    assert read_request(ord("O"), b"a,b", 1) == RecipeSetup(PacketType.OUTPUTS, ("a", "b"))


@pytest.mark.parametrize(
    ("asked_hz", "count"), [(500.0, 500), (125.0, 125), (30.0, 31), (12.5, 12), (1.0, 1)]
)
def test_packages_come_at_the_frequency_that_the_recipe_asks(asked_hz, count):
    """The period is a whole number of frames."""
    client = Client()
    client.say(ask_version())
    ((_, answer),) = client.say(ask_outputs(asked_hz, ["timestamp"]))
    assert answer == b"\1DOUBLE"
    client.say(packet(PacketType.START))
    assert len(client.run(1.0)) == count


@pytest.mark.parametrize("asked_hz", [0.5, math.nan, -1.0, 500.5])
def test_frequencies_that_no_controller_has(asked_hz):
    client = Client()
    client.say(ask_version())
    said, refused = client.say(ask_outputs(asked_hz, ["timestamp"]))
    assert "is not 1 to 500 Hz" in read_reply(*said).text
    assert read_reply(*refused).recipe == 0
