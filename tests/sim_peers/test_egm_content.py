"""Fields that the simulated controller fills, by release."""

from __future__ import annotations

import math

import pytest

from cardan.protocols.egm.messages import (
    EgmMessageType,
    EgmRapidData,
    EgmSensor,
    MCIState,
    RapidState,
)
from cardan.sim_peers.egm_controller import ROBOTWARE
from tests.sim_peers.egm_pc import Pc, echo

RELEASES = ("6.08", "6.10", "7.6", "7.7", "7.16")


def run(robotware, **options):
    pc = Pc(robotware=robotware, mode="joint", **options)
    pc.run(0.2, echo)
    return pc


@pytest.mark.parametrize("robotware", RELEASES)
def test_fields_of_each_release(robotware):
    last = run(robotware, level=0).last
    major, minor = map(int, robotware.split("."))
    release = (major, minor)
    assert last.test_signals is not None
    assert (last.measured_force.fc_active is None) is (major == 6)
    assert (last.utilization_rate is not None) is (release >= (6, 10))
    assert (last.move_index is not None) is (release >= (7, 6))
    assert (last.collision_info is not None) is (release >= (7, 6))
    assert (last.rapid_from_robot is not None) is (release >= (7, 7))
    assert (last.torque_ref is not None) is (release >= (7, 16))


@pytest.mark.parametrize("robotware", RELEASES)
def test_what_abb_libegm_demands_is_always_there(robotware):
    for script in ("stream", "teleop"):
        message = run(robotware, script=script).last
        assert message.header.seqno is not None
        assert message.header.tm_ms is not None
        assert message.header.mtype == EgmMessageType.DATA
        for motion in (message.feed_back, message.planned):
            assert len(motion.joints) == 6
            assert motion.cartesian.pos is not None
            assert math.hypot(*motion.cartesian.orient) == pytest.approx(1.0)
            assert motion.time_us > 1_700_000_000_000_000 - 1
        assert message.motor_state is not None
        assert message.mci_state is not None
        assert message.rapid_exec_state is not None
        assert message.mci_convergence_met is not None


def test_short_names_of_releases():
    assert ROBOTWARE["6"] == "6.10"
    assert ROBOTWARE["7"] == "7.16"


def test_euler_and_quaternion_are_the_same_rotation_or_euler_is_left_out():
    assert run("7", euler=False).last.feed_back.cartesian.euler is None
    x, y, z = run("7").last.feed_back.cartesian.euler
    assert math.degrees(y) == pytest.approx(60.0, abs=0.01)
    assert abs(math.degrees(x)) == pytest.approx(180.0, abs=0.01)
    assert abs(math.degrees(z)) == pytest.approx(180.0, abs=0.01)


def test_ptp_stamps_and_torques_only_where_configured():
    assert run("7").last.feed_back.time_stamp_ns is None
    assert run("7").last.torque_ref is None  # Level 1
    assert run("7.7", ptp=True).last.feed_back.time_stamp_ns is None
    stamped = run("7", ptp=True).last
    assert stamped.feed_back.time_stamp_ns // 1000 == stamped.feed_back.time_us
    assert run("7", level=0, script="stream").last.torque_ref is None


def forces(pc):
    return [m.measured_force.force for m in pc.received]


def mean(values, index):
    return sum(v[index] for v in values) / len(values)


def test_raw_force_is_noisy_and_biased_and_says_so():
    pc = run("7")
    pc.run(1.0, echo)
    assert pc.last.measured_force.fc_active is False
    values = forces(pc)
    assert len({v[2] for v in values}) > 100
    assert abs(mean(values, 2)) > 5.0


@pytest.mark.parametrize("robotware", ["6", "7"])
def test_contact_with_force_control(robotware):
    pc = Pc(robotware=robotware, mode="joint", force_control=True)
    pc.run(0.5, echo)
    assert mean(forces(pc), 2) == pytest.approx(0.0, abs=0.2)
    pc.received.clear()
    pc.core.do("contact", wrench=(1.0, -2.0, 30.0, 0.5, 0.0, -0.5))
    pc.run(0.5, echo)
    values = forces(pc)
    assert [mean(values, n) for n in range(6)] == pytest.approx(
        [1.0, -2.0, 30.0, 0.5, 0.0, -0.5], abs=0.2
    )
    assert pc.last.measured_force.fc_active is (True if robotware == "7" else None)


def test_force_can_be_absent():
    assert run("7", force=False).last.measured_force is None


def test_move_index_counts_starts_of_movements():
    pc = Pc(
        "0 movej\n0 getid\n0 setup\n0 act max-speed=180 stream\n"
        "0.5 run\n1 stop\n1.5 act max-speed=180 stream\n1.5 run\n",
        mode="joint",
    )
    pc.run(2.0, pc.joints(5, 0, 0, 0, 30, 0))
    seen = sorted({m.move_index for m in pc.received})
    assert seen == [0, 1, 2]


def test_rapid_data_comes_back_from_an_echoing_program():
    pc = Pc(mode="joint")
    pc.run(0.1, echo)
    assert pc.last.rapid_from_robot == EgmRapidData(False, ())
    data = EgmRapidData(True, tuple(float(n) for n in range(40)))
    pc.run(0.1, lambda m: EgmSensor(**{**echo(m)._asdict(), "rapid_to_robot": data}))
    assert pc.last.rapid_from_robot == data
    assert len(pc.raw[-1]) > 800
    assert pc.core.rapid.rapid_in == data


def test_rapid_data_of_a_program_that_sets_its_own():
    pc = Pc(mode="joint", rapid_echo=False)
    pc.core.do("do", on=True)
    pc.core.do("dnum", values=(1.0, -2.5))
    data = EgmRapidData(False, (9.0,))
    pc.run(0.1, lambda m: EgmSensor(**{**echo(m)._asdict(), "rapid_to_robot": data}))
    assert pc.last.rapid_from_robot == EgmRapidData(True, (1.0, -2.5))
    pc.core.do("echo", on=True)
    pc.run(0.1, lambda m: EgmSensor(**{**echo(m)._asdict(), "rapid_to_robot": data}))
    assert pc.last.rapid_from_robot == data


def test_utilization_is_the_demand_over_what_joints_can():
    pc = Pc(mode="joint", script="speed", level=0)
    pc.run(1.0, pc.joints(speeds_deg_s=(25, 0, 0, 0, 0, 0)))
    assert pc.last.utilization_rate == pytest.approx(20.0, abs=0.5)


def test_torques_follow_the_motion_at_level_0():
    pc = Pc(mode="joint", script="speed", level=0)
    pc.run(0.5, echo)
    assert max(map(abs, pc.last.torque_ref)) < 1e-6
    pc.run(0.5, pc.joints(speeds_deg_s=(25, 0, 0, 0, 0, 0)))
    assert pc.last.torque_ref[0] > 1.0


def test_states_of_a_known_controller_bug():
    last = run("7", faults={"rapid-undefined": 1.0}).last
    assert last.rapid_exec_state == RapidState.UNDEFINED
    assert last.mci_state == MCIState.RUNNING
