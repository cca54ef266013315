"""Gravity compensation (gcmp), force (forc) and streamed wrenches, in simulated time."""

import math

import numpy as np
import pinocchio as pin
import pytest

from cardan.errors import (
    MotionRefusedError,
)
from cardan.gateway.arm.motions.torque import TorqueLimits
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.arm.vocab import State
from cardan.robots import load_arm
from cardan.types import (
    JointCommand,
    TorqueCommand,
)
from tests.gateway.arm.arms import DT_S, World


def test_gcmp_holds_the_weight_and_can_be_led():
    world = World("ur5")
    motion = world.verbs.gcmp()
    assert world.verbs.state is State.GRAVITY
    world.tick()
    first = np.array(world.command.torques)
    assert abs(first[1]) > 5.0
    for _ in range(25):
        world.q = world.q + 0.004
        world.tick()
    assert not np.allclose(first, world.command.torques)
    world.verbs.stop()
    world.tick()
    assert isinstance(world.command, JointCommand)
    np.testing.assert_allclose(world.command.positions, world.q, atol=1e-6)
    world.rest()
    assert motion.outcome is Outcome.ABORTED


def test_forc_adds_the_wrench_on_the_world():
    world = World("ur5")
    world.verbs.gcmp()
    world.tick()
    weight = np.array(world.command.torques)
    world.verbs.stop()
    world.rest()
    force = np.array([5.0, -3.0, 8.0, 0.1, 0.2, -0.3])
    motion = world.verbs.forc(force)
    assert world.verbs.state is State.FORCE
    world.tick(20)
    kinematics = world.verbs.servo.kinematics
    kinematics.update(world.q)
    rotation = kinematics.placement.rotation
    base = np.vstack((rotation @ kinematics.jacobian[:3], rotation @ kinematics.jacobian[3:]))
    np.testing.assert_allclose(world.command.torques, weight + base.T @ force, atol=1e-9)
    assert world.verbs.forc([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) is motion
    with pytest.raises(MotionRefusedError, match="more than the 100"):
        world.verbs.forc([500.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_forc_is_refused_in_the_tcp_frame():
    world = World("ur5")
    world.verbs.set_parameter("cpf", "cpft")
    with pytest.raises(MotionRefusedError, match="base frame only"):
        world.verbs.forc([0.0, 0.0, 5.0, 0.0, 0.0, 0.0])


def test_torques_stay_inside_the_joints_limits():
    world = World(
        "ur5", options=ControllerOptions(torque=TorqueLimits(force_n=5000.0, force_slew_n_s=1e6))
    )
    world.verbs.gcmp()
    world.tick()
    weight = np.array(world.command.torques)
    world.verbs.stop()
    world.rest()
    for force in (4000.0, -4000.0):
        world.verbs.forc([0.0, 0.0, force, 0.0, 0.0, 0.0])
        world.tick(5)
        torques = np.array(world.command.torques)
        used = np.abs(torques) / [joint.effort for joint in world.model.joints]
        # The wrench keeps its direction; its magnitude is limited by the weakest joint.
        assert used.max() == pytest.approx(1.0)
        kinematics = world.verbs.servo.kinematics
        kinematics.update(world.q)
        asked = force * (kinematics.placement.rotation @ kinematics.jacobian[:3])[2]
        share = (torques - weight) @ asked / (asked @ asked)
        np.testing.assert_allclose(torques - weight, share * asked, atol=1e-6)


def test_an_arm_that_runs_away_is_caught():
    world = World("ur5")
    motion = world.verbs.gcmp()
    world.tick()
    world.v[:] = 0.0
    world.v[2] = 2.5
    world.tick()
    assert isinstance(world.command, JointCommand)
    assert "ran away" in motion.reason
    assert world.command.velocities[2] > 2.0  # a ramp, not an immediate stop
    world.rest()
    assert world.verbs.status().trips == 1


def test_an_arm_that_runs_away_without_telling_its_speed_is_caught_all_the_same():
    """Joint speeds that are NaN are computed from positions instead, and never commanded."""
    world = World("ur5")
    motion = world.verbs.gcmp()
    world.tick()
    world.v[:] = math.nan
    world.q[2] += 2.5 * DT_S
    world.tick()
    assert "ran away" in motion.reason
    assert isinstance(world.command, JointCommand)
    assert np.isfinite(world.command.positions).all()
    assert np.isfinite(world.command.velocities).all()
    assert world.command.velocities[2] > 2.0
    world.v[:] = math.nan
    world.verbs.stop()
    world.tick()
    assert np.isfinite(world.command.positions).all()


def test_a_silent_wrench_stream_leaves_the_weight():
    world = World("ur5")
    world.verbs.set_parameter("cpsc", "wrnc")
    world.tick()
    weight = world.command.torques
    for _ in range(20):
        assert world.verbs.stream("wrench", [0.0, 0.0, 10.0, 0.0, 0.0, 0.0]) == ""
        world.tick()
    assert not np.allclose(world.command.torques, weight, atol=0.1)
    world.tick(int(0.1 / DT_S) + 2)
    assert isinstance(world.command, TorqueCommand)
    np.testing.assert_allclose(world.command.torques, weight)
    assert "silent" in world.verbs.stream("wrench", [0.0] * 6)


def test_springs_of_the_arm_are_left_out_of_the_torques():
    world = World("pr2_left_arm")
    world.verbs.gcmp()
    world.tick()
    model = world.verbs.servo.kinematics.model
    weight = pin.computeGeneralizedGravity(model, model.createData(), world.q)
    assert abs(weight[1]) > 35.0
    assert np.abs(world.command.torques).max() < 0.5
    assert world.command.torques[4:] == pytest.approx(weight[4:])  # joints without springs


def test_arms_that_cannot_carry_themselves_are_refused(tmp_path):
    """A PR2's arm without its springs."""
    (tmp_path / "arm.urdf").write_text(load_arm("pr2_left_arm").urdf, encoding="utf-8")
    (tmp_path / "arm.toml").write_text(
        'urdf = "arm.urdf"\nhome_deg = [20, 20, 40, -90, 0, -60, 0]', encoding="utf-8"
    )
    world = World(str(tmp_path / "arm.toml"))
    with pytest.raises(MotionRefusedError, match=r"to hold the arm's weight; it has 30.0 N·m"):
        world.verbs.gcmp()
