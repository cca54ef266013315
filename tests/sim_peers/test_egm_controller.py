"""The simulated controller in virtual time: states, timeouts, convergence, limits, queue."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from cardan.errors import ConfigurationError, ScriptError
from cardan.protocols.egm.encode import encode_sensor
from cardan.protocols.egm.messages import (
    EgmHeader,
    EgmMessageType,
    EgmMotion,
    EgmPose,
    EgmSensor,
    EgmSensorPathCorr,
    EgmSpeedRef,
    MCIState,
    MotorState,
    RapidState,
)
from cardan.sim_peers.egm_controller import (
    SCRIPTS,
    ContactSurface,
    EgmControllerOptions,
    EgmState,
)
from cardan.sim_peers.egm_controller.guidance import beyond_any_robot
from cardan.sim_peers.kinematics import GOFA
from cardan.spatial import from_rotation_vector, multiply, norm, rotation_between, subtract
from cardan.types import Quaternion, Vector3
from tests.sim_peers.egm_pc import START_DEG, TS, Pc, echo

QUIET = {"encoder_noise_deg": 0.0}


TELEOP = """
0 movej
0 getid
0 setup
0 act window=1e-9 max-speed=180
0 run cond-time=1e6
"""


# ---------------------------------------------------------------------------------------------
# Session


def test_first_datagrams_of_a_session():
    pc = Pc(mode="joint")
    first, second = pc.run(3 * TS, echo)[:2]
    assert (first.header.seqno, second.header.seqno) == (0, 1)
    assert first.header.mtype == EgmMessageType.DATA
    assert second.header.tm_ms - first.header.tm_ms == 4
    assert first.mci_state == MCIState.RUNNING
    assert first.motor_state == MotorState.ON
    assert first.rapid_exec_state == RapidState.RUNNING
    assert pc.core.state is EgmState.RUNNING
    assert first.feed_back.joints == pytest.approx(list(map(math.radians, START_DEG)), abs=1e-4)


def test_same_options_same_datagrams():
    def datagrams(seed):
        pc = Pc(mode="pose", seed=seed)
        pc.run(0.5, echo)
        return pc.raw

    assert datagrams(3) == datagrams(3)
    assert datagrams(3) != datagrams(4)


def test_seqno_and_tm_wrap():
    pc = Pc(seqno_start=2**32 - 2, tm_start_ms=2**32 - 6)
    pc.run(5 * TS, echo)
    assert [m.header.seqno for m in pc.received[:4]] == [2**32 - 2, 2**32 - 1, 0, 1]
    assert pc.received[2].header.tm_ms == 2


def test_states_through_the_instructions():
    pc = Pc(
        mode="joint",
        steps="1 movej\n1 getid\n2 setup\n2 act\n3 stream-start\n4 run\n4.9 stop\n6 reset\n",
    )
    seen = {}
    for second in range(7):
        pc.run(1.0, echo)
        seen[second] = (pc.core.state, pc.last.mci_state if pc.received else None)
    assert seen[0] == (EgmState.DISCONNECTED, None)
    assert seen[1] == (EgmState.CONNECTED, None)
    assert seen[3] == (EgmState.RUNNING, MCIState.STOPPED)
    assert seen[5][0] is EgmState.CONNECTED
    assert seen[6][0] is EgmState.DISCONNECTED
    running = [m for m in pc.received if m.mci_state == MCIState.RUNNING]
    assert len(running) == pytest.approx(0.9 / TS, abs=3)
    # Streaming and the following run belong to one session.
    assert [m.header.seqno for m in pc.received] == list(range(len(pc.received)))


def test_streaming_without_guidance_moves_nothing():
    pc = Pc(script="stream", mode="joint")
    pc.run(1.0, pc.joints(10, 0, 0, 0, 30, 0))
    assert pc.core.state is EgmState.RUNNING
    assert {m.mci_state for m in pc.received} == {MCIState.STOPPED}
    assert pc.joints_deg == pytest.approx(START_DEG)
    assert pc.core.counters.ignored["not in EGMRun"] > 200
    pc.run(3.0)
    assert pc.core.events == []


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"steps": "0 movej\n0 getid\n0 act\n"}, "EGMAct before EGMSetupUC"),
        ({"steps": "0 movej\n0 setup\n"}, "EGMSetupUC before EGMGetId"),
        ({"steps": "0 movej\n0 getid\n0 setup\n0 run\n"}, "EGMRun before EGMAct"),
        ({"steps": "0 getid\n0 setup\n0 act\n0 run\n"}, "first movement"),
        (
            {"steps": "0 movej\n0 getid\n0 setup path\n0 act path sample-rate=16\n"},
            "multiple of 24",
        ),
        ({"steps": TELEOP, "mode": "path"}, "no EGMRun for path correction"),
        ({"level": 2}, "Level 2 is not for mode pose"),
    ],
)
def test_instructions_that_cannot_be_stop_the_program(options, complaint):
    pc = Pc(**options)
    pc.run(0.1)
    assert complaint in pc.core.events[0].text
    assert pc.core.events[1].code == 10125
    assert not pc.received


def test_path_correction_has_a_program_of_its_own():
    assert Pc(mode="path").core.options.program == "path"


def test_mode_mismatch_is_fatal():
    pc = Pc(steps="0 movej\n0 getid\n0 setup pose\n0 act pose\n0 run joint\n")
    pc.run(0.1)
    assert pc.codes == [41826, 10125]
    assert pc.core.state is EgmState.CONNECTED


def test_a_run_without_axes_returns_at_once():
    pc = Pc(steps=TELEOP.replace("run ", "run axes=none "))
    pc.run(0.1)
    assert not pc.received
    assert pc.core.state is EgmState.CONNECTED


def test_no_move_during_a_run():
    pc = Pc(steps=TELEOP + "0.5 movej 0 0 0 0 40 0\n", mode="joint")
    pc.run(0.6, echo)
    assert pc.codes == [50453, 10125]
    assert pc.last.mci_state == MCIState.ERROR


def test_instructions_wait_for_a_programmed_move():
    pc = Pc(steps=TELEOP.replace("movej", "movej 20 0 0 0 40 0"), mode="joint")
    pc.run(2.0, echo)
    assert pc.times[0] > 0.3
    assert pc.core.events == []
    assert math.degrees(pc.received[0].planned.joints[0]) == pytest.approx(20.0, abs=1e-6)


# ---------------------------------------------------------------------------------------------
# Motion


def test_joint_guidance_reaches_its_target_at_the_gain_of_the_law():
    pc = Pc(mode="joint", default_lp_filter_hz=0.0, level=0, servo_delay_s=0.0, **QUIET)
    target = pc.joints(1, 0, 0, 0, 30, 0)
    pc.step(target)  # the reply is used one cycle later
    for _ in range(50):
        pc.step(target)
    assert math.degrees(pc.core.planned_joints_rad[0]) == pytest.approx(0.638791, abs=1e-6)
    pc.run(3.0, target)
    assert pc.joints_deg == pytest.approx((1, 0, 0, 0, 30, 0), abs=1e-3)


def test_rapid_default_speed_deviation_makes_the_robot_hardly_move():
    pc = Pc(mode="joint", max_speed_deviation_deg_s=1.0)
    pc.run(2.0, pc.joints(30, 0, 0, 0, 30, 0))
    assert 1.8 < pc.joints_deg[0] < 2.0


def test_level_1_acts_later_than_level_0():
    def first_motion(level):
        pc = Pc(mode="joint", level=level, **QUIET)
        pc.run(20 * TS, pc.joints(5, 0, 0, 0, 30, 0))
        return next(n for n, m in enumerate(pc.received) if m.planned.joints[0] > 0.0)

    assert first_motion(0) == 2
    assert first_motion(1) == 4


def test_planned_leads_feedback_and_says_so_in_its_time():
    pc = Pc(mode="joint", servo_delay_s=0.016128, **QUIET)
    pc.run(0.6, pc.joints(30, 0, 0, 0, 30, 0))
    later, now = pc.received[-1], pc.received[-5]
    assert now.planned.joints[0] == pytest.approx(later.feed_back.joints[0])
    assert now.planned.joints[0] > now.feed_back.joints[0]
    assert now.planned.time_us - now.feed_back.time_us == 16128
    assert now.planned.time_us == pytest.approx(later.feed_back.time_us, abs=1)


def test_pose_guidance_goes_straight_to_the_pose():
    pc = Pc(mode="pose")
    start = pc.core.tcp
    goal = Vector3(start.position.x - 0.05, start.position.y + 0.08, start.position.z + 0.03)
    turned = multiply(from_rotation_vector(Vector3(0.0, 0.1, 0.2)), start.orientation)
    way = subtract(goal, start.position)
    reply = pc.pose(goal, turned)
    for _ in range(600):
        pc.step(reply)
        gone = subtract(pc.core.tcp.position, start.position)
        along = sum(a * b for a, b in zip(gone, way, strict=True)) / norm(way) ** 2
        aside = norm(Vector3(*(g - along * w for g, w in zip(gone, way, strict=True))))
        # Not a planned line: the law results in one, but joint limits may bend it a little.
        assert aside < 2e-3
    assert norm(subtract(pc.core.tcp.position, goal)) < 1e-5
    assert norm(rotation_between(pc.core.tcp.orientation, turned)) < 1e-4
    assert pc.core.events == []


def test_pose_guidance_follows_a_ramp_without_lag_given_its_speed():
    pc = Pc(mode="pose", level=0, **QUIET)
    start = pc.core.tcp.position
    speed = 0.1

    def ramp(lead_s, feed):
        def reply(_message):
            y = speed * (pc.now_s + lead_s)
            return pc.pose(
                start._replace(y=y),
                orientation,
                speeds=(0.0, feed, 0.0, 0.0, 0.0, 0.0),
            )(_message)

        return reply

    orientation = pc.core.tcp.orientation
    pc.run(2.0, ramp(0.0, 0.0))
    assert speed * pc.now_s - pc.core.planned_tcp.position.y == pytest.approx(0.020, abs=2e-3)
    pc.run(2.0, ramp(0.0, speed))
    assert speed * pc.now_s - pc.core.planned_tcp.position.y == pytest.approx(0.0, abs=1e-3)


def test_only_selected_axes_move():
    pose = Pc(steps=TELEOP.replace("run ", "run axes=y,z "))
    start = pose.core.tcp
    goal = Vector3(start.position.x + 0.05, 0.05, start.position.z - 0.05)
    pose.run(3.0, pose.pose(goal, Quaternion(1.0, 0.0, 0.0, 0.0)))
    assert tuple(pose.core.tcp.position) == pytest.approx(
        (start.position.x, goal.y, goal.z), abs=1e-5
    )
    assert norm(rotation_between(pose.core.tcp.orientation, start.orientation)) < 1e-5
    joint = Pc(steps=TELEOP.replace("run ", "run axes=2 "), mode="joint")
    joint.run(3.0, joint.joints(5, 5, 5, 5, 35, 5))
    assert joint.joints_deg == pytest.approx((0, 5, 0, 0, 30, 0), abs=1e-3)


def test_euler_wins_over_the_quaternion():
    pc = Pc(mode="pose")
    start = pc.core.tcp
    euler = Vector3(math.pi, math.radians(60.0), math.pi - 0.1)
    pc.run(3.0, pc.pose(start.position, Quaternion(1.0, 0.0, 0.0, 0.0), euler))
    turned = rotation_between(start.orientation, pc.core.tcp.orientation)
    assert turned == pytest.approx((0.0, 0.0, -0.1), abs=1e-4)
    assert pc.core.counters.flaws["Euler over quaternion"] > 700


def test_a_quaternion_that_is_not_normalized_is_and_is_noted():
    pc = Pc(mode="pose")
    start = pc.core.tcp
    turned = multiply(from_rotation_vector(Vector3(0.0, 0.0, 0.1)), start.orientation)
    pc.run(3.0, pc.pose(start.position, Quaternion(*(3.0 * c for c in turned))))
    assert norm(rotation_between(pc.core.tcp.orientation, turned)) < 1e-4
    assert pc.core.counters.flaws["quaternion not normalized"] > 700
    ignored = pc.core.counters.accepted
    pc.run(3 * TS, pc.pose(start.position, Quaternion(0.0, 0.0, 0.0, 0.0)))
    assert pc.core.counters.ignored["quaternion without direction"] >= 2
    assert pc.core.counters.accepted - ignored <= 1


def test_pure_speed_control_has_no_position_to_hold():
    pc = Pc(mode="joint", script="speed", default_lp_filter_hz=0.0, level=0, **QUIET)
    pc.run(1.0, pc.joints(speeds_deg_s=(10, 0, 0, 0, 0, 0)))
    assert math.degrees(pc.core.planned_joints_rad[0]) == pytest.approx(10.0, abs=0.2)


def test_ramp_in_holds_back_position_and_speed():
    def after(seconds, **options):
        pc = Pc(mode="joint", **QUIET, **options)
        pc.run(seconds, pc.joints(10, 0, 0, 0, 30, 0, speeds_deg_s=(5, 0, 0, 0, 0, 0)))
        return math.degrees(pc.core.planned_joints_rad[0])

    assert after(0.5, ramp_in_s=2.0) < 0.4 * after(0.5)
    assert after(4.0, ramp_in_s=2.0) == pytest.approx(after(4.0), abs=0.05)


# ---------------------------------------------------------------------------------------------
# Causes of stops


def test_comm_timeout_with_a_speed_keeps_moving_until_then():
    pc = Pc(mode="joint", script="teleop-once", comm_timeout_s=0.5, pos_corr_gain=0.0)
    reply = pc.joints(speeds_deg_s=(10, 0, 0, 0, 0, 0))
    pc.run(1.0, reply)
    silent_from = math.degrees(pc.core.planned_joints_rad[0])
    pc.run(0.45)
    assert math.degrees(pc.core.planned_joints_rad[0]) - silent_from == pytest.approx(4.5, abs=0.2)
    assert pc.core.events == []
    pc.run(0.06)
    assert pc.codes == [41822, 10125]
    assert pc.core.events[0].time_s == pytest.approx(1.5, abs=2 * TS)
    before = math.degrees(pc.core.planned_joints_rad[0])
    pc.run(0.6)
    # Speed falls linearly over the ramp time of 0.5 s: half of 10 deg/s on the way.
    assert math.degrees(pc.core.planned_joints_rad[0]) - before == pytest.approx(2.5, abs=0.2)
    assert pc.last.mci_state == MCIState.ERROR
    assert pc.last.rapid_exec_state == RapidState.STOPPED
    count = len(pc.received)
    pc.run(5.0)
    assert len(pc.received) == count
    assert pc.core.state is EgmState.CONNECTED


def test_comm_timeout_counts_accepted_messages_only():
    pc = Pc(mode="pose", script="teleop-once", comm_timeout_s=0.2)
    pc.run(0.5, pc.joints(*START_DEG))
    assert pc.core.counters.ignored["joints in pose mode"] > 40
    assert pc.codes[0] == 41822


def test_nobody_answers_from_the_start():
    pc = Pc(script="teleop-once")
    pc.run(2.0)
    assert pc.codes == [41822, 10125]
    assert pc.core.events[0].time_s == pytest.approx(1.0, abs=2 * TS)


def test_teleop_is_restarted_by_an_operator():
    pc = Pc(mode="joint")
    pc.run(1.2)
    assert pc.codes == [41822, 10125]
    before = len(pc.received)
    pc.run(4.0, echo)
    assert pc.codes == [41822, 10125, 10151]
    assert pc.core.events[2].time_s == pytest.approx(3.0, abs=0.05)
    again = pc.received[before:]
    restart = next(n for n, m in enumerate(again) if m.header.seqno == 0)
    assert all(m.mci_state == MCIState.RUNNING for m in again[restart:])


def test_an_operator_also_switches_motors_on_and_jogs_back_into_range():
    outside = Pc(mode="joint")
    outside.run(0.1, outside.joints(0, 0, 86, 0, 30, 0))
    outside.run(3.0, echo)
    assert outside.codes == [0, 10010, 10125, 10011, 10151]
    assert outside.core.state is EgmState.RUNNING
    limit = Pc(mode="joint", joints_deg=(0, 0, 84, 0, 30, 0), pos_corr_gain=0.0)
    limit.run(1.0, limit.joints(speeds_deg_s=(0, 0, 20, 0, 0, 0)))
    limit.run(3.0, limit.joints(speeds_deg_s=(0, 0, 0, 0, 0, 0)))
    assert limit.codes == [50027, 10125, 10151]
    assert limit.joints_deg[2] == pytest.approx(85.0)
    assert limit.core.state is EgmState.RUNNING


def test_error_handler_retries_a_blocking_run_only():
    for words, recovered in (("", True), ("nowait ", False)):
        pc = Pc(
            mode="joint",
            steps="0 on-error retry 1\n" + TELEOP.replace("run ", f"run {words}"),
        )
        pc.run(2.5)
        assert (10125 not in pc.codes) is recovered
        assert (pc.core.state is EgmState.RUNNING) is recovered


def test_joint_reference_out_of_range_switches_motors_off():
    pc = Pc(mode="joint", script="teleop-once")
    pc.run(0.1, echo)
    pc.run(0.1, pc.joints(0, 0, 86, 0, 30, 0))
    assert "input out of bounds: joint 3 = 86.000 deg" in pc.core.events[0].text
    assert 10010 in pc.codes
    assert pc.last.motor_state == MotorState.OFF
    assert pc.last.mci_state == MCIState.ERROR
    assert pc.joints_deg == pytest.approx(START_DEG, abs=1e-3)


def test_a_joint_driven_to_its_limit_stops_with_an_error():
    pc = Pc(
        mode="joint",
        script="speed",
        joints_deg=(0, 0, 80, 0, 30, 0),
    )
    pc.run(1.0, pc.joints(speeds_deg_s=(0, 0, 20, 0, 0, 0)))
    assert pc.codes[0] == 50027
    assert pc.joints_deg[2] < 85.5
    assert pc.core.servo.at_rest


def test_max_pos_deviation():
    pc = Pc(mode="joint", script="teleop-once", max_pos_deviation_deg=5.0)
    pc.run(2.0, pc.joints(20, 0, 0, 0, 30, 0))
    assert "MaxPosDeviation" in pc.core.events[0].text
    assert 5.0 < pc.joints_deg[0] < 8.0  # plus the braking distance


def test_a_jump_of_the_reference_is_a_dynamic_load():
    pc = Pc(mode="joint", script="teleop-once", k=20.0, default_lp_filter_hz=100.0, level=0)
    pc.run(0.1, echo)
    pc.run(0.5, pc.joints(60, 0, 0, 0, 30, 0))
    assert pc.core.events[0].text == "Dynamic load too high"
    assert pc.joints_deg[0] < 0.1
    tolerant = Pc(
        mode="joint", k=20.0, default_lp_filter_hz=100.0, level=0, dynamic_load_factor=0.0
    )
    tolerant.run(3.0, tolerant.joints(60, 0, 0, 0, 30, 0))
    assert tolerant.joints_deg[0] == pytest.approx(60.0, abs=0.1)


def test_joint_speeds_and_accelerations_stay_within_the_arms():
    pc = Pc(mode="joint", k=20.0, dynamic_load_factor=0.0, max_speed_deviation_deg_s=1000.0)
    target = {"deg": 0.0}
    worst = 0.0
    for n in range(1500):
        target["deg"] = 60.0 if (n // 200) % 2 else -60.0
        pc.step(pc.joints(target["deg"], 0, 0, target["deg"], 30, 0))
        for v, a, vmax, amax in zip(
            pc.core.joint_speeds_rad_s,
            pc.core.joint_accelerations_rad_s2,
            GOFA.velocity,
            GOFA.acceleration,
            strict=True,
        ):
            assert abs(v) <= vmax * (1 + 1e-9)
            assert abs(a) <= amax * (1 + 1e-9)
        worst = max(worst, pc.last.utilization_rate)
    assert worst > 100.0


def test_singularity_stops_and_only_a_jog_recovers():
    pc = Pc(mode="pose", joints_deg=(0, 0, 0, 0, 10, 0))
    start = pc.core.tcp
    for _ in range(400):
        # Turning the wrist back folds it through its singular configuration near -10 deg.
        turn = from_rotation_vector(Vector3(0.0, -0.5, 0.0))
        pc.step(pc.pose(start.position, multiply(turn, start.orientation)))
    assert pc.codes[:2] == [50026, 10125]
    pc.run(6.0, echo)
    assert 10151 not in pc.codes  # the operator retries only after jogging away
    pc.core.do("restart")
    pc.run(0.5, echo)
    assert pc.core.state is EgmState.CONNECTED
    assert "jog the robot away first" in pc.core.events[-2].text
    assert pc.core.jog_to(START_DEG)
    assert pc.joints_deg == pytest.approx(START_DEG)
    pc.core.do("restart")
    pc.run(0.5, echo)
    assert pc.core.state is EgmState.RUNNING
    assert pc.last.mci_state == MCIState.RUNNING


def test_jogging_is_refused_while_guided_and_a_movement_while_streaming():
    guided = Pc(mode="joint")
    guided.run(0.1, echo)
    assert not guided.core.jog_to((0, 0, 0, 0, 40, 0))
    streaming = Pc(script="stream")
    streaming.run(0.1)
    assert streaming.core.jog_to((0, 0, 0, 0, 40, 0))
    streaming.run(0.1)
    assert 30.0 < streaming.joints_deg[4] < 40.0
    streaming.run(1.0)
    assert streaming.joints_deg[4] == pytest.approx(40.0)
    assert streaming.core.events == guided.core.events[:0]


def test_program_stop_and_start():
    pc = Pc(mode="joint", steps=TELEOP + "1 program-stop\n2 program-start\n")
    pc.run(1.0 + 3 * TS, pc.joints(5, 0, 0, 0, 30, 0))
    assert pc.codes == [10125]
    assert pc.last.rapid_exec_state == RapidState.STOPPED
    assert pc.last.mci_state == MCIState.STOPPED
    assert pc.core.state is EgmState.CONNECTED
    pc.run(0.9)
    stopped = len(pc.received)
    assert pc.times[-1] < 1.6
    pc.run(1.0, echo)
    assert pc.received[stopped].header.seqno == 0
    assert pc.last.mci_state == MCIState.RUNNING
    assert pc.core.state is EgmState.RUNNING


def test_motors_off_and_on():
    text = TELEOP + "1 motors-off\n2 program-start\n3 motors-on\n4 program-start\n"
    pc = Pc(mode="joint", steps=text)
    pc.run(1.1, pc.joints(speeds_deg_s=(20, 0, 0, 0, 0, 0)))
    assert pc.codes == [10010, 10125]
    assert pc.last.motor_state == MotorState.OFF
    assert pc.last.mci_state == MCIState.STOPPED
    pc.run(0.5)
    assert pc.core.servo.at_rest
    count = len(pc.received)
    pc.run(2.2)
    assert len(pc.received) == count
    pc.run(1.0, echo)
    assert pc.codes == [10010, 10125, 0, 10011, 10151]
    assert pc.last.mci_state == MCIState.RUNNING
    strict = Pc(mode="joint", steps=text, do_not_restart_after_motors_off=True)
    strict.run(5.0, echo)
    assert strict.core.state is EgmState.CONNECTED


def test_emergency_stop():
    text = TELEOP + "1 estop\n2 program-start\n3 motors-on\n4 program-start\n"
    pc = Pc(mode="joint", steps=text)
    pc.run(1.02, pc.joints(speeds_deg_s=(60, 0, 0, 0, 0, 0)))
    assert pc.codes == [10013, 10010, 10125]
    pc.run(0.1)
    assert pc.core.servo.at_rest
    pc.run(4.0, echo)
    assert pc.codes[3:] == [0, 10011, 10151]
    assert pc.core.state is EgmState.RUNNING


def test_streaming_goes_on_while_the_program_is_stopped():
    pc = Pc(mode="joint", script="teleop-stream")
    pc.run(1.0, echo)
    pc.core.do("program-stop")
    pc.run(2.0, echo)
    assert pc.core.state is EgmState.RUNNING
    assert pc.last.rapid_exec_state == RapidState.STOPPED
    assert pc.last.mci_state == MCIState.STOPPED
    pc.core.do("program-start")
    pc.run(0.5, echo)
    assert pc.last.mci_state == MCIState.RUNNING
    assert [m.header.seqno for m in pc.received] == list(range(len(pc.received)))


def test_collision_stops():
    pc = Pc(mode="joint", steps=TELEOP + "0.5 collision\n")
    pc.run(0.52, echo)
    assert pc.codes == [50204, 10125]
    assert pc.last.collision_info.collision_triggered
    assert min(pc.last.collision_info.coll_det_quota) > 100.0


# ---------------------------------------------------------------------------------------------
# Convergence


def test_manual_defaults_end_when_the_operator_holds_still():
    pc = Pc(mode="joint", script="manual-defaults")
    pc.run(3.0, pc.joints(*START_DEG))
    assert pc.times[-1] == pytest.approx(1.0, abs=0.03)
    assert pc.last.mci_convergence_met
    assert pc.core.state is EgmState.CONNECTED
    assert pc.core.events == []


@pytest.mark.parametrize("mode", ["joint", "pose"])
def test_teleop_programs_never_converge(mode):
    pc = Pc(mode=mode)
    pc.run(4.0, echo if mode == "joint" else pc.pose(pc.core.tcp.position, pc.core.tcp.orientation))
    assert pc.core.state is EgmState.RUNNING
    assert not any(m.mci_convergence_met for m in pc.received)


def test_pose_windows():
    pc = Pc(steps="0 movej\n0 getid\n0 setup\n0 act max-speed=180\n0 run\n", **QUIET)
    start = pc.core.tcp
    goal = start.position._replace(y=0.05)
    reply = pc.pose(goal, start.orientation)
    pc.run(3.0, reply)
    first = next(n for n, m in enumerate(pc.received) if m.mci_convergence_met)
    assert abs(pc.received[first - 2].feed_back.cartesian.pos.y - 0.05) >= 1.0e-3
    assert abs(pc.received[first].feed_back.cartesian.pos.y - 0.05) < 1.0e-3
    assert pc.times[-1] - pc.times[first] == pytest.approx(1.0, abs=3 * TS)


def test_ramp_down_returns_to_the_start():
    text = "0 movej\n0 getid\n0 setup\n0 act max-speed=180\n0 run ramp-down cond-time=0.2\n"
    pc = Pc(mode="joint", steps=text)
    pc.run(6.0, pc.joints(10, 0, 0, 0, 30, 0))
    assert max(m.feed_back.joints[0] for m in pc.received) > math.radians(9.0)
    assert pc.joints_deg == pytest.approx(START_DEG, abs=1e-3)
    assert pc.core.state is EgmState.CONNECTED
    assert pc.core.servo.at_rest


def test_stop_with_hold_ramps_the_speed_down():
    pc = Pc(mode="joint", steps=TELEOP + "1 stop hold ramp-out=0.3\n")
    pc.run(2.0, pc.joints(speeds_deg_s=(20, 0, 0, 0, 0, 0)))
    assert pc.core.servo.at_rest
    assert pc.times[-1] == pytest.approx(1.3, abs=0.05)


def test_while_true_programs_begin_again_with_seqno_0():
    pc = Pc(mode="joint", script="while-true", cond_time_s=0.5)
    pc.run(2.5, pc.joints(*START_DEG))
    starts = [n for n, m in enumerate(pc.received) if m.header.seqno == 0]
    assert len(starts) >= 4
    retained = Pc(mode="joint", script="while-true", cond_time_s=0.5, seqno_restarts=False)
    retained.run(2.5, retained.joints(*START_DEG))
    assert [m.header.seqno for m in retained.received] == list(range(len(retained.received)))


# ---------------------------------------------------------------------------------------------
# The PC's messages


def marked(pc, n):
    return EgmSensor(EgmHeader(n, 0, 3), EgmMotion(joints=(n * 1e-4, 0, 0, 0, math.pi / 6, 0)))


def test_one_message_a_cycle_oldest_first():
    pc = Pc(mode="joint", queue_length=8)
    pc.step()
    for n in range(1, 11):
        pc.send(marked(pc, n))
    assert pc.core.counters.ignored == {"queue overflow": 2}
    for n in range(1, 9):
        pc.step()
        assert pc.core.counters.accepted == n
        reference = pc.core.rapid.guidance._reference
        assert reference[0] == pytest.approx(n * 1e-4)
    pc.step()
    assert pc.core.counters.accepted == 8


def test_newest_wins_for_comparison():
    pc = Pc(mode="joint", newest_wins=True)
    pc.step()
    for n in range(1, 11):
        pc.send(marked(pc, n))
    pc.step()
    assert pc.core.counters.accepted == 1
    assert pc.core.counters.ignored == {"superseded": 9}
    assert pc.core.rapid.guidance._reference[0] == pytest.approx(10e-4)


def test_a_pc_that_sends_faster_than_the_cycle_gains_latency():
    pc = Pc(mode="joint", level=0, **QUIET)
    y = {"n": 0}
    for _ in range(40):
        pc.step()
        for _ in range(2):
            y["n"] += 1
            pc.send(marked(pc, y["n"]))
    assert pc.core.counters.accepted == 39
    assert y["n"] - pc.core.rapid.guidance._reference[0] / 1e-4 == pytest.approx(41)


ENORMOUS = (0.0, 0.0, 0.0, 1e200, 1e200, 1e200)


@pytest.mark.parametrize("mode", ["joint", "pose"])
@pytest.mark.parametrize(
    "content",
    [
        (EgmMotion(joints=ENORMOUS), None),
        (EgmMotion(cartesian=EgmPose(Vector3(1e200, 0.0, 0.0), None)), None),
        (EgmMotion(cartesian=EgmPose(None, Quaternion(1e200, 1e200, 0.0, 0.0))), None),
        (EgmMotion(cartesian=EgmPose(None, None, Vector3(1e200, 0.0, 0.0))), None),
        (None, EgmSpeedRef(joints=ENORMOUS)),
        (None, EgmSpeedRef(cartesians=ENORMOUS)),
    ],
)
def test_numbers_beyond_any_robot_are_counted_and_change_nothing(mode, content):
    pc = Pc(mode=mode, **QUIET)
    before = pc.run(0.1)[-1].planned.joints
    for number in range(50):
        pc.send(EgmSensor(EgmHeader(number, 0, 3), *content))
        assert pc.step().planned.joints == before
    assert pc.core.counters.ignored["a number beyond any robot"] == 50


def test_a_correction_beyond_any_robot_is_ignored():
    message = EgmSensorPathCorr(EgmHeader(1, 0, 4), Vector3(0.0, 1e200, 0.0), 1)
    assert beyond_any_robot(message)
    assert not beyond_any_robot(message._replace(pos=Vector3(0.0, 0.001, 0.0)))


def test_bad_messages_are_counted_and_change_nothing():
    pc = Pc(mode="joint", **QUIET)
    pc.run(0.1, pc.joints(*START_DEG))
    accepted = pc.core.counters.accepted
    good = encode_sensor(marked(pc, 1))
    nan = encode_sensor(EgmSensor(EgmHeader(1, 0, 3), EgmMotion(joints=(math.nan, 0, 0, 0, 0, 0))))
    short = EgmSensor(EgmHeader(1, 0, 3), EgmMotion(joints=(0.1, 0.2, 0.3)))
    for bad in (b"", good[:-3], b"\xff" * 3000, b"GET /", nan):
        pc.send(bad)
        pc.step()
    pc.send(short)
    pc.step()
    pc.send(EgmSensor(EgmHeader(1, 0, 3)))
    pc.step()
    pc.send(EgmSensorPathCorr(EgmHeader(1, 0, 4), Vector3(0.0, 0.001, 0.0), 1))
    pc.run(3 * TS)
    ignored = pc.core.counters.ignored
    assert sum(ignored.values()) == 8
    assert ignored["NaN or infinity"] == 1
    assert ignored["wrong number of joints"] == 1
    assert ignored["no reference"] == 1
    assert ignored["path correction in guidance mode"] == 1
    assert pc.core.counters.accepted - accepted == 1  # the last good one, still in the queue
    assert pc.joints_deg == pytest.approx(START_DEG, abs=1e-9)
    assert pc.core.events == []


def test_nan_can_be_fatal_as_on_some_controllers():
    pc = Pc(mode="joint", nan_is_fatal=True)
    pc.run(0.1, echo)
    pc.run(1.0, pc.joints(math.nan, 0, 0, 0, 30, 0))
    assert pc.codes == [10014]
    assert pc.times[-1] < 0.12


def test_wrong_mode_keeps_the_last_reference():
    pc = Pc(mode="joint", **QUIET)
    pc.run(0.2, pc.joints(*START_DEG))
    pc.run(0.2, pc.pose(Vector3(0.5, 0.1, 0.8), Quaternion(0.5, 0.0, math.sqrt(0.75), 0.0)))
    assert pc.core.counters.ignored["pose in joint mode"] > 40
    assert pc.joints_deg == pytest.approx(START_DEG, abs=1e-9)


def test_speed_alone_is_legal_and_joints_alone_mean_speed_0():
    pc = Pc(mode="joint", level=0, **QUIET)
    pc.run(0.3, pc.joints(speeds_deg_s=(5, 0, 0, 0, 0, 0)))
    assert pc.joints_deg[0] > 0.3
    pc.run(3.0, pc.joints(*START_DEG))
    assert pc.joints_deg == pytest.approx(START_DEG, abs=1e-3)


@pytest.mark.parametrize(("strict", "moved"), [(False, True), (True, False)])
def test_mtype_and_seqno_are_noted_or_enforced(strict, moved):
    pc = Pc(mode="joint", strict_mtype=strict)
    reply = pc.joints(5, 0, 0, 0, 30, 0)
    pc.run(0.5, lambda m: reply(m)._replace(header=EgmHeader(pc.cycles, 0, 0)))
    where = pc.core.counters.ignored if strict else pc.core.counters.flaws
    assert where["unexpected mtype"] > 100
    assert (pc.joints_deg[0] > 0.5) is moved
    pc = Pc(mode="joint", strict_seqno=strict)
    reply = pc.joints(5, 0, 0, 0, 30, 0)
    pc.run(0.5, lambda m: reply(m)._replace(header=EgmHeader(7, 0, 3)))
    where = pc.core.counters.ignored if strict else pc.core.counters.flaws
    assert where["seqno did not advance"] > 100


def test_datagrams_left_in_the_queue_act_in_the_next_run():
    text = TELEOP + "0.5 stop hold ramp-out=0\n1 run cond-time=1e6\n"
    pc = Pc(mode="joint", steps=text, **QUIET)
    pc.run(0.6, pc.joints(*START_DEG))
    before = pc.core.counters.accepted
    pc.send(marked(pc, 300))
    pc.run(0.5)
    # The answer to the last datagram of the first run is queued as well.
    assert pc.core.counters.accepted == before + 2
    # A new connection of the device starts with an empty queue.
    pc = Pc(mode="joint", steps=text.replace("1 run cond-time=1e6", "1 restart"))
    pc.run(0.6, pc.joints(*START_DEG))
    before = pc.core.counters.accepted
    pc.send(marked(pc, 300))
    pc.run(0.8)
    assert pc.core.state is EgmState.RUNNING
    assert pc.core.counters.accepted == before


# ---------------------------------------------------------------------------------------------
# Time


def test_missed_cycles_are_made_up_for_without_datagrams():
    steady, stalled = (Pc(mode="joint", script="speed", **QUIET) for _ in range(2))
    reply = {pc: pc.joints(speeds_deg_s=(10, 0, 0, 0, 0, 0)) for pc in (steady, stalled)}
    for pc in (steady, stalled):
        pc.run(0.5, reply[pc])
    steady.run(20 * TS)
    stalled.cycles += 19
    stalled.step()
    assert stalled.core.planned_joints_rad == pytest.approx(steady.core.planned_joints_rad)
    assert stalled.last.header.seqno == steady.last.header.seqno - 19
    assert stalled.last.feed_back.time_us == steady.last.feed_back.time_us


def test_sample_rate():
    pc = Pc(mode="joint", sample_rate_ms=16)
    pc.run(1.0, echo)
    gaps = [b - a for a, b in pairwise(pc.times)]
    assert gaps == pytest.approx([4 * TS] * len(gaps))
    assert pc.core.state is EgmState.RUNNING


def test_virtual_controller_period():
    pc = Pc(mode="joint", period_s=0.004)
    pc.run(0.1, echo)
    assert pc.received[10].header.tm_ms - pc.received[0].header.tm_ms == 40


# ---------------------------------------------------------------------------------------------
# Path correction


def path_corr(pc, y, z, age_ms=0):
    return lambda _m: EgmSensorPathCorr(pc.header(4), Vector3(0.5, y, z), age_ms)


def test_path_correction_runs_the_path_and_refuses_guidance():
    pc = Pc(script="path")
    start = pc.core.tcp
    pc.run(3.0, echo)
    gaps = [b - a for a, b in pairwise(pc.times)]
    assert gaps == pytest.approx([12 * TS] * len(gaps))
    assert pc.core.counters.ignored["guidance in path correction mode"] == len(pc.received) - 1
    assert pc.core.tcp.position.y == pytest.approx(0.12, abs=0.01)
    pc.run(3.0)
    assert pc.core.tcp.position.y == pytest.approx(0.16, abs=0.02)  # on the return
    assert norm(rotation_between(start.orientation, pc.core.tcp.orientation)) < 1e-6
    assert pc.core.events == []


def test_path_correction_shifts_sideways_only():
    plain, shifted = Pc(script="path"), Pc(script="path", path_correction_absolute=True)
    plain.run(2.0)
    shifted.run(2.0, path_corr(shifted, 0.010, 0.004))
    difference = subtract(shifted.core.tcp.position, plain.core.tcp.position)
    assert difference.y == pytest.approx(0.0, abs=1e-6)
    assert norm(difference) == pytest.approx(math.hypot(0.010, 0.004), abs=1e-4)


def test_path_correction_of_a_sensor_on_the_tool_closes_the_loop():
    pc = Pc(script="path")
    offset = 0.010

    def sensor(_message):
        y, z = pc.core.rapid.guidance.offset_m
        return path_corr(pc, offset - y, -z)(_message)

    pc.run(3.0, sensor)
    assert pc.core.rapid.guidance.offset_m == pytest.approx((offset, 0.0), abs=5e-4)


def test_a_path_ends_at_its_fine_point():
    text = "0 movej\n0 getid\n0 setup path\n0 act path\n0 egmmovel 0 20 0 50\n"
    pc = Pc(steps=text)
    pc.run(2.0)
    assert pc.core.tcp.position.y == pytest.approx(0.020, abs=1e-5)
    assert pc.core.state is EgmState.CONNECTED
    assert pc.core.servo.at_rest


# ---------------------------------------------------------------------------------------------
# Settings


@pytest.mark.parametrize(
    "options",
    [
        {"robotware": "5"},
        {"mode": "sideways"},
        {"k": 21.0},
        {"pc_port": 0},
        {"level": 3},
        {"sample_rate_ms": 6},
        {"comm_timeout_s": 0.0},
        {"joints_deg": (0.0, 0.0)},
        {"pos_corr_gain": 2.0},
        {"joints_deg": (0.0, 0.0, 90.0, 0.0, 0.0, 0.0)},
        {"joints_deg": (math.nan, 0.0, 0.0, 0.0, 0.0, 0.0)},
        {"surface": ContactSurface(math.nan)},
        {"surface": ContactSurface(0.2, stiffness_n_m=-1.0)},
        {"surface": ContactSurface(0.2, friction=math.inf)},
        {"force_frame": "world"},
        {"force_sense": "pulled"},
        {"collision_force_n": -1.0},
    ],
)
def test_bad_options_name_their_key(options):
    (key,) = options
    with pytest.raises(ConfigurationError) as error:
        EgmControllerOptions(**options)
    assert error.value.key == key


@pytest.mark.parametrize("faults", [{"gremlins": 1.0}, {"drop": -3.0}, {"garbage": 1.5}])
def test_bad_faults_are_named(faults):
    (name,) = faults
    with pytest.raises(ScriptError, match=name):
        EgmControllerOptions(faults=faults)


@pytest.mark.parametrize(
    "line",
    [
        "0 setup sideways",
        "0 run axes=9",
        "0 run path",
        "0 run pos-gain=3",
        "0 act window=wide",
        "0 act sample-rate=7",
        "0 jog 1 2 3",
        "0 egmmovel 1 2 3",
        "0 reset now",
        "0 on-error panic",
        "0 loop maybe",
        "0 dance",
    ],
)
def test_bad_script_lines_quote_the_usage(line):
    with pytest.raises(ScriptError) as error:
        Pc(steps=line + "\n")
    assert "run " in str(error.value) or line.split()[1] in str(error.value)


def test_every_built_in_script_runs():
    for name in SCRIPTS:
        for mode in ("joint", "pose"):
            pc = Pc(script=name, mode=mode)
            pc.run(0.4, echo)
            assert pc.received, name
            assert pc.core.events == [], name
