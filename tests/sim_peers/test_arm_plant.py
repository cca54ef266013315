"""Physics of the simulated arm, each property compared with an independent computation."""

from __future__ import annotations

import math
import time

import numpy as np
import pinocchio as pin
import pytest

from cardan.errors import ConfigurationError
from cardan.robots import load_arm, parse_urdf
from cardan.sim_peers.arm.options import Ball, PlantOptions, TouchPlane
from cardan.sim_peers.arm.plant import ArmPlant, DriveMode
from cardan.types import Vector3

FRICTIONLESS = {"viscous_friction_1_s": 0.0, "coulomb_friction_rad_s2": 0.0}
STRETCHED = tuple(map(math.radians, (0.0, 60.0, 10.0, 5.0, 30.0, 0.0)))
FLOOR = TouchPlane(Vector3(0.0, 0.0, 0.0), Vector3(0.0, 0.0, 2.0))


def gofa(**options):
    return ArmPlant(load_arm("gofa_crb15000_5"), PlantOptions(**{"start": STRETCHED, **options}))


def lift(**options):
    """Return a mass of 2 kg on a vertical slide, TCP at its joint's height; rotor of 0.5 kg."""
    urdf = """<robot name="lift"><link name="base"/>
    <joint name="z" type="prismatic"><parent link="base"/><child link="mass"/>
      <axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="2" effort="EFFORT"/></joint>
    <link name="mass"><inertial><mass value="2"/>
      <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link></robot>"""
    effort = options.pop("effort", 0)
    return ArmPlant(
        parse_urdf(urdf.replace("EFFORT", str(effort))),
        PlantOptions(**{"rotor_inertia": 0.5, **FRICTIONLESS, **options}),
    )


def gravity_torque(plant):
    return pin.computeGeneralizedGravity(
        plant.model, plant.model.createData(), np.array(plant.positions)
    )


def run(plant, seconds):
    plant.advance(plant.time_s + seconds)
    return np.array(plant.positions)


# -- gravity and drives -------------------------------------------------------------------------


def test_under_velocity_control_the_arm_creeps_down_as_stated():
    plant = gofa()
    before, height_m = run(plant, 0.5), plant.pose.position.z
    plant.command_speeds((0.0,) * 6)
    run(plant, 0.5)
    before = np.array(plant.positions)
    rate = (run(plant, 2.0) - before) / 2.0
    stated = -plant.options.velocity_leak_1_s * gravity_torque(plant) / plant.stiffness
    # Friction carries a part of the load.
    assert rate[[1, 2]] == pytest.approx(stated[[1, 2]], rel=0.1)
    assert abs(stated[1]) > 5e-4
    assert plant.pose.position.z < height_m - 0.001


def test_a_position_reference_keeps_it_up():
    plant = gofa()
    height_m = plant.pose.position.z
    run(plant, 3.0)
    assert plant.pose.position.z == pytest.approx(height_m, abs=1e-6)


def test_a_virtual_reference_cures_the_sag_of_velocity_control():
    plant = gofa()
    wanted = np.array(plant.positions)
    for _ in range(2000):
        plant.command_speeds(tuple(5.0 * (wanted - plant.positions)))
        run(plant, 0.002)
    creep = plant.options.velocity_leak_1_s * np.abs(gravity_torque(plant)) / plant.stiffness
    left = np.abs(wanted - plant.positions)
    assert (left <= creep / 5.0 + 1e-9).all()
    # Velocity control alone would have lost more than ten times as much.
    assert left.max() < 0.1 * creep.max() * 4.0


def test_commanding_the_measured_position_sinks_every_time():
    plant = gofa()
    start = np.array(plant.positions)
    for _ in range(500):
        plant.command_positions(plant.positions)
        run(plant, 0.002)
    assert plant.positions[1] - start[1] > 10.0 * plant.following_error


def test_static_sag_is_gravity_over_stiffness_and_feed_forward_or_integral_removes_it():
    target = np.array(STRETCHED)
    for options, sag_is_left in (
        ({}, True),
        ({"gravity_feedforward": True}, False),
        ({"integral_1_s": 5.0}, False),
    ):
        plant = gofa(**options)
        plant.command_positions(STRETCHED)
        error = target - run(plant, 4.0)
        stated = gravity_torque(plant) / plant.stiffness if sag_is_left else np.zeros(6)
        assert error == pytest.approx(stated, abs=1e-6)


def test_torque_mode_keeps_energy():
    plant = gofa(**FRICTIONLESS)
    plant.command_torques((0.0,) * 6)
    energy_j = plant.energy_j()
    fastest_j = 0.0
    for _ in range(40):
        run(plant, 0.01)
        data = plant.model.createData()
        potential_j = pin.computePotentialEnergy(plant.model, data, np.array(plant.positions))
        fastest_j = max(fastest_j, plant.energy_j() - potential_j)
        assert plant.energy_j() == pytest.approx(energy_j, abs=1e-4 * max(fastest_j, 1.0))
    assert fastest_j > 20.0


def pr2(side="left", **options):
    """Return an arm with its mechanical end stops, 0.1 to 0.2 rad beyond the soft limits."""
    arm = load_arm(f"pr2_{side}_arm")
    joints = (
        joint._replace(lower=joint.lower - 0.2, upper=joint.upper + 0.15) for joint in arm.joints
    )
    return ArmPlant(arm._replace(joints=tuple(joints)), PlantOptions(**options))


@pytest.mark.parametrize("side", ["left", "right"])
def test_springs_carry_what_their_joints_would(side):
    plant = pr2(side)
    run(plant, 0.5)
    weight = gravity_torque(plant)
    assert abs(weight[1]) > 35.0  # N·m, of which the lift joint can deliver 30
    assert np.abs(plant.torques).max() < 0.5
    assert np.abs(np.array(plant.positions) - plant.arm.home).max() < 1e-6
    # With a straight wrist the springs carry the whole weight.
    straight = [*plant.arm.home[:4], 0.0, 0.0, 0.0]
    plant.set_state(straight)
    run(plant, 0.5)
    assert np.array(plant.torques)[:4] == pytest.approx(np.zeros(4), abs=1e-6)


def test_springs_carry_no_load():
    """The drives carry 1 kg at the TCP."""
    bare, loaded = pr2(), pr2(payload_kg=1.0)
    for plant in (bare, loaded):
        run(plant, 0.5)
    more = np.array(loaded.torques) - bare.torques
    assert more == pytest.approx(gravity_torque(loaded) - gravity_torque(bare), abs=0.05)
    assert abs(more[1]) > 3.0


def test_springs_make_no_energy():
    plant = pr2(**FRICTIONLESS)
    plant.set_state(plant.arm.home, (0.3, -0.4, 0.5, 0.4, 0.5, -0.4, 0.5))
    plant.command_torques((0.0,) * 7)
    energy_j = plant.energy_j()
    for _ in range(80):
        before = np.array(plant.positions)
        run(plant, 0.01)
        assert plant.energy_j() == pytest.approx(energy_j, abs=2e-4)
    assert np.abs(np.array(plant.positions) - before).max() > 1e-3  # still moving


def test_the_feed_forward_knows_the_springs():
    plant = pr2(gravity_feedforward=True)
    plant.command_positions(plant.arm.home)
    run(plant, 1.0)
    assert plant.positions == pytest.approx(plant.arm.home, abs=1e-6)


def test_zero_torque_falls_and_inverse_dynamics_hold():
    falling, held = gofa(**FRICTIONLESS), gofa(**FRICTIONLESS)
    zero = np.zeros(6)
    data = held.model.createData()
    for _ in range(200):
        falling.command_torques((0.0,) * 6)
        held.command_torques(pin.rnea(held.model, data, np.array(held.positions), zero, zero))
        run(falling, 0.001)
        run(held, 0.001)
    assert falling.pose.position.z < held.pose.position.z - 0.05
    assert np.abs(np.array(held.positions) - STRETCHED).max() < 1e-6


def test_free_fall_is_that_of_its_mass_and_rotor():
    plant = lift()
    plant.command_torques((0.0,))
    z = run(plant, 0.3)[0]
    assert z == pytest.approx(-0.5 * 9.81 * (2.0 / 2.5) * 0.3**2, abs=1e-9)


def test_an_arm_without_masses_gets_stated_ones():
    joint = """<joint name="NAME" type="continuous"><parent link="FROM"/><child link="TO"/>
      <origin xyz="0 0 0.4"/><axis xyz="0 1 0"/><limit velocity="2" effort="0"/></joint>"""
    joints = (("p", "base", "a"), ("q", "a", "b"))
    urdf = "".join(
        joint.replace("NAME", name).replace("FROM", start).replace("TO", end)
        for name, start, end in joints
    )
    links = "".join(f'<link name="{name}"/>' for name in ("base", "a", "b"))
    plant = ArmPlant(parse_urdf(f'<robot name="two">{links}{urdf}</robot>'))
    assert [body.mass for body in plant.model.inertias.tolist()[1:]] == [4.0, 4.0]
    assert plant.model.inertias[1].lever == pytest.approx((0.0, 0.0, 0.2))
    plant.set_state((math.pi / 2, 0.0))
    # Both centers of mass are level, 0.2 m and 0.4 m from the first joint (the second body has no
    # length).
    assert gravity_torque(plant)[0] == pytest.approx(-4.0 * 9.81 * (0.2 + 0.4))


def test_payload_weighs():
    light, heavy = lift(), lift(payload_kg=3.0)
    assert light.torques[0] == pytest.approx(2.0 * 9.81)
    assert heavy.torques[0] == pytest.approx(5.0 * 9.81)


def test_friction_brakes():
    plant = lift(viscous_friction_1_s=2.0, gravity_m_s2=Vector3(0.0, 0.0, 0.0))
    plant.set_state((0.0,), (0.5,))
    plant.command_torques((0.0,))
    run(plant, 0.5)
    assert plant.velocities[0] == pytest.approx(0.5 * math.exp(-1.0), rel=2e-3)
    plant = lift(coulomb_friction_rad_s2=1.0, gravity_m_s2=Vector3(0.0, 0.0, 0.0))
    plant.set_state((0.0,), (0.5,))
    plant.command_torques((0.0,))
    run(plant, 0.3)
    assert plant.velocities[0] == pytest.approx(0.2, rel=5e-3)


def test_effort_is_limited():
    plant = lift(effort=30.0)
    plant.command_torques((1000.0,))
    run(plant, 0.1)
    assert plant.velocities[0] == pytest.approx((30.0 - 2.0 * 9.81) / 2.5 * 0.1)
    weak = lift(effort=15.0)  # less than its weight needs
    weak.command_positions((0.5,))
    for _ in range(100):
        run(weak, 0.002)
        assert abs(weak.torques[0]) <= 15.0 * (1.0 + 1e-9)
    assert weak.positions[0] < -0.01


def test_speeds_are_followed():
    plant = gofa(velocity_leak_1_s=0.0)
    plant.command_speeds((0.3, -0.2, 0.1, 0.4, -0.3, 0.5))
    run(plant, 1.0)
    assert plant.velocities == pytest.approx((0.3, -0.2, 0.1, 0.4, -0.3, 0.5), abs=2e-3)


def test_mode_changes_make_no_step_of_torque():
    plant = gofa()
    command = {
        "positions": lambda: plant.command_positions(np.array(STRETCHED) + 0.02, (0.1,) * 6),
        "speeds": lambda: plant.command_speeds((0.2,) * 6),
        "hold": plant.hold,
        "torques": lambda: plant.command_torques(plant.torques),
    }
    plant.command_speeds((0.2,) * 6)
    run(plant, 0.5)
    for mode in ("hold", "speeds", "torques", "speeds", "torques", "hold"):
        before, speed = np.array(plant.torques), np.array(plant.velocities)
        command[mode]()
        plant.step()
        change = np.abs(np.array(plant.torques) - before)
        # In one step at most the change by the joints' acceleration limits.
        assert (change < 0.05 * plant.damping + 0.05).all(), (mode, change)
        assert np.abs(np.array(plant.velocities) - speed).max() < 0.05
        run(plant, 0.1)


def test_hold_brakes_then_stays():
    plant = gofa()
    plant.command_speeds((0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
    run(plant, 0.5)
    plant.hold()
    rest = run(plant, 1.0)
    assert plant.mode is DriveMode.HOLD
    assert run(plant, 1.0) == pytest.approx(rest, abs=1e-6)


@pytest.mark.matrix("0.0001-5.0", "0.0001-60.0")
@pytest.mark.parametrize("bandwidth", [5.0, 60.0, 300.0])
@pytest.mark.parametrize("step_s", [0.0001, 0.0005, 0.002])
def test_no_gain_makes_it_unstable(bandwidth, step_s):
    plant = gofa(position_bandwidth_rad_s=bandwidth, step_s=step_s, coulomb_friction_rad_s2=20.0)
    plant.command_positions(np.array(STRETCHED) + 0.1)
    for _ in range(10):
        run(plant, 0.1)
        assert np.abs(plant.velocities).max() < 3.0
    assert np.abs(plant.velocities).max() < 0.05


# -- stops and contact --------------------------------------------------------------------------


def test_joint_stops_are_hard_and_let_go():
    plant = lift(effort=1000.0)
    plant.command_torques((40.0,))
    run(plant, 3.0)
    assert plant.positions == (1.0,)
    assert plant.velocities == (0.0,)
    plant.command_torques((0.0,))
    assert run(plant, 0.2)[0] == pytest.approx(1.0 - 0.5 * 9.81 * 0.8 * 0.04, abs=1e-3)


def test_a_joint_at_its_stop_loads_the_others_as_a_rigid_one():
    plant = gofa(**FRICTIONLESS)
    upper = plant.arm.upper
    plant.set_state((STRETCHED[0], STRETCHED[1], upper[2], *STRETCHED[3:]))
    plant.command_torques((0.0, 0.0, 500.0, 0.0, 0.0, 0.0))
    run(plant, 0.1)
    assert plant.positions[2] == upper[2]
    assert np.isfinite(plant.velocities).all()
    assert np.abs(plant.velocities).max() < 10.0


def test_at_rest_on_a_plane_the_force_is_the_weight_and_the_depth_weight_over_stiffness():
    plant = lift(planes=(FLOOR,), contact_damping_n_s_m=300.0)
    plant.command_torques((0.0,))
    z = run(plant, 3.0)[0]
    assert z == pytest.approx(0.02 - 2.0 * 9.81 / 1e4, abs=1e-7)
    # The TCP's force on its environment points down.
    assert plant.wrench.force == pytest.approx((0.0, 0.0, -2.0 * 9.81), abs=1e-3)
    assert plant.wrench.torque == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_at_rest_on_a_sphere():
    ball = Ball(Vector3(0.0, 0.0, -0.3), 0.25)
    plant = lift(balls=(ball,), contact_damping_n_s_m=300.0)
    plant.command_torques((0.0,))
    assert run(plant, 3.0)[0] == pytest.approx(-0.05 + 0.02 - 2.0 * 9.81 / 1e4, abs=1e-6)


def test_contact_never_pulls():
    plant = lift(planes=(FLOOR,), contact_damping_n_s_m=1000.0, gravity_m_s2=Vector3(0, 0, 0))
    plant.set_state((0.019,), (1.0,))
    plant.command_torques((0.0,))
    for _ in range(20):
        plant.step()
        assert plant.wrench.force.z <= 0.0
        assert plant.velocities[0] >= 1.0 - 1e-9


def test_an_arm_that_is_driven_into_a_plane_pushes_and_rubs():
    plant = gofa(gravity_feedforward=True)
    tcp = plant.pose.position
    floor = TouchPlane(Vector3(0.0, 0.0, tcp.z - 0.03), Vector3(0.0, 0.0, 1.0))
    plant, free = gofa(gravity_feedforward=True, planes=(floor,)), plant
    for _ in range(150):
        for each in (plant, free):
            each.command_speeds((0.2, 0.2, 0.0, 0.0, 0.0, 0.0))
            run(each, 0.002)
        force = plant.wrench.force
        assert math.hypot(force.x, force.y) <= 0.5 * -force.z + 1e-9
    # The TCP moves towards positive y, and drags the surface along.
    assert force.z < -20.0
    assert force.y > 1.0
    assert plant.pose.position.z > free.pose.position.z + 0.005


def test_capsules_touch_when_asked():
    plane = TouchPlane(Vector3(0.0, 0.0, 0.0), Vector3(0.0, 0.0, -1.0))  # everything above z = 0
    alone = gofa(planes=(plane,), contact_radius_m=0.0)
    whole = gofa(planes=(plane,), contact_radius_m=0.0, body_contact=True)
    for plant in (alone, whole):
        plant.command_torques((0.0,) * 6)
        plant.step()
    assert np.abs(np.array(whole.velocities) - alone.velocities).max() > 0.1


# -- ideal drives, faults, and the rest ---------------------------------------------------------


def test_ideal_drives_are_exactly_where_they_are_asked_to_be():
    plant = gofa(drive="ideal")
    target = tuple(q + 0.1 for q in STRETCHED)
    plant.command_positions(target, (0.1,) * 6)
    plant.step()
    assert plant.positions == target
    assert plant.velocities == (0.1,) * 6
    plant.command_speeds((0.2, 0.0, 0.0, 0.0, 0.0, 0.0))
    run(plant, 1.0)
    assert plant.positions[0] == pytest.approx(target[0] + 0.2)
    with pytest.raises(ValueError, match="no torque mode"):
        plant.command_torques((0.0,) * 6)


@pytest.mark.parametrize("drive", ["ideal", "dynamic"])
def test_a_jammed_joint_and_a_slow_drive(drive):
    plant = gofa(drive=drive)
    plant.jammed = 0
    plant.slow = 0.1
    before = np.array(plant.positions)
    plant.command_speeds((0.5, 0.0, 0.0, 0.5, 0.0, 0.0))
    moved = run(plant, 1.0) - before
    assert moved[0] == 0.0
    assert moved[3] == pytest.approx(0.05, abs=3e-3)


def test_the_same_calls_give_the_same_motion():
    def play():
        plant = gofa(planes=(FLOOR,), payload_kg=1.0)
        plant.command_speeds((0.1, 0.3, 0.0, 0.0, 0.2, 0.0))
        run(plant, 0.7)
        return plant.positions, plant.velocities, plant.torques

    assert play() == play()


def test_bad_options_name_the_key():
    for options, key in (
        ({"drive": "no"}, "drive"),
        ({"step_s": 0.1}, "step_s"),
        ({"payload_kg": math.nan}, "payload_kg"),
        ({"planes": (TouchPlane(Vector3(0, 0, 0), Vector3(0, 0, 0)),)}, "planes"),
        ({"balls": (Ball(Vector3(0, 0, 0), 0.0),)}, "balls"),
    ):
        with pytest.raises(ConfigurationError) as raised:
            PlantOptions(**options)
        assert raised.value.key == key


def quickest_s(act):
    """Return the shortest processor time of a call, without other load."""

    def once_s():
        began_s = time.thread_time()
        act()
        return time.thread_time() - began_s

    return min(once_s() for _ in range(5))


def test_a_step_costs_little_beside_its_dynamics():
    plant = gofa()
    plant.command_speeds((0.1,) * 6)
    data, nothing = plant.model.createData(), np.zeros(6)

    def dynamics():
        for _ in range(100):
            pin.aba(plant.model, data, nothing, nothing, nothing)

    # 10 to 13 times as long, where real time, 0.5 ms per step, would be 160 times as long.
    assert quickest_s(lambda: run(plant, 100 * plant.step_s)) < 80 * quickest_s(dynamics)
