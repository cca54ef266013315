"""Robot in the simulated Motoman controller: messages and operator actions, in virtual time."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from cardan.errors import ConfigurationError, ScriptError
from cardan.protocols.simple_message.codes import (
    ActiveMode,
    CommType,
    InvalidSubcode,
    MessageType,
    MotionCommand,
)
from cardan.protocols.simple_message.messages import (
    ZEROS,
    Empty,
    JointFeedback,
    JointTrajPtFull,
    JointTrajPtFullEx,
    JointVelocity,
    JointVelocityEx,
    Message,
    MotionCtrl,
    Raw,
    RobotStatus,
    SelectTool,
    VelocityInfoRequest,
    joints10,
    request,
    topic,
)
from cardan.robots import load_arm
from cardan.sim_peers.motoros_controller.controller import MotorosController
from cardan.sim_peers.motoros_controller.dh import dh_table
from cardan.sim_peers.motoros_controller.options import MotorosControllerOptions
from cardan.sim_peers.motoros_controller.plant import PlantModel
from cardan.spatial import compose, from_rotation_vector
from cardan.types import IDENTITY_POSE, Pose, Vector3

IPC_S = 0.004
HOME = load_arm("gp8").home
SUCCESS, BUSY, FAILURE, INVALID, NOT_READY = 0, 1, 2, 3, 5


def point_message(sequence, time_s, joints, speeds=(), group=0, fields=7):
    body = JointTrajPtFull(
        group, sequence, fields, time_s, joints10(joints), joints10(speeds), ZEROS
    )
    return request(body)


class Cell:
    """Controller with a client on its motion port, in virtual time."""

    def __init__(self, **options):
        options.setdefault("servo_on", True)
        self.it = MotorosController(MotorosControllerOptions(**options))
        self.now_s = 100.0
        self.it.advance(self.now_s)
        self.it.connected(self.now_s)
        self.sequence = 0
        self.velocity_sequence = 0

    def run(self, seconds):
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            self.now_s = min(end_s, self.now_s + IPC_S / 2)
            self.it.advance(self.now_s)

    def ask(self, message):
        """Return the reply after its delay; None if there is none."""
        self.it.motion(message, self.now_s)
        while self.it.blocked:
            self.run(0.001)
        answers, self.it.replies[:] = list(self.it.replies), []
        assert len(answers) <= 1
        return answers[0] if answers else None

    def control(self, command, group=0, data=ZEROS):
        self.sequence += 1
        answer = self.ask(request(MotionCtrl(group, self.sequence, command, joints10(data)))).body
        assert answer[:3] == (group, self.sequence, command)
        return answer

    def start(self):
        assert self.control(MotionCommand.START_TRAJ_MODE)[3:5] == (SUCCESS, 0)
        return self

    def start_velocity(self, *data):
        answer = self.control(MotionCommand.START_VEL_MODE, data=data)
        assert answer[3:5] == (SUCCESS, 0)
        self.velocity_sequence = 0
        return answer

    def point(self, sequence, time_s, joints=HOME, speeds=(), group=0, fields=7):
        return self.ask(point_message(sequence, time_s, joints, speeds, group, fields)).body

    def velocity(
        self, *speeds, sequence=None, group=0, fields=4, time_s=0.0, acc=ZEROS, wants=True
    ):
        if sequence is None:
            sequence = self.velocity_sequence
            self.velocity_sequence += 1
        body = JointVelocity(
            group, sequence, fields, time_s, ZEROS, joints10(speeds), joints10(acc)
        )
        answer = self.ask(request(body) if wants else topic(body))
        return answer.body if wants else answer

    def drive(self, seconds, *speeds):
        for _ in range(round(seconds / 0.02)):
            assert self.velocity(*speeds)[3] == SUCCESS
            self.run(0.02)

    def move(self, seconds=0.4, way=0.05):
        """Move the first axis by a trajectory; assert that every point is accepted."""
        assert self.point(0, 0.0, self.it.command_rad(0)).result == SUCCESS
        goal = np.array(self.it.command_rad(0))
        goal[0] += way
        assert self.point(1, seconds + 0.0005, goal).result == SUCCESS
        return goal

    def moving(self):
        before = self.it.command_pulses(0)
        self.run(0.012)
        return self.it.command_pulses(0) != before

    def reason(self):
        return self.control(MotionCommand.CHECK_MOTION_READY)[3:5]


@pytest.fixture
def cell():
    return Cell()


# -- commands --------------------------------------------------------------------------------------


def test_ping_and_readiness(cell):
    ping = cell.ask(request(Empty(), msg_type=MessageType.PING))
    assert ping == Message(MessageType.PING, CommType.SERVICE_REPLY, 1, Empty())
    assert cell.reason() == (FAILURE, 5008)
    cell.start()
    assert cell.reason() == (SUCCESS, 0)
    assert cell.it.status() == RobotStatus(1, 0, 0, 0, 0, 2, 1)
    assert cell.it.active_mode == ActiveMode.TRAJECTORY


def test_starting_takes_its_time_and_blocks(cell):
    cell.it.motion(request(MotionCtrl(0, 1, MotionCommand.START_TRAJ_MODE)), cell.now_s)
    cell.run(0.1)
    assert cell.it.blocked
    assert not cell.it.replies
    cell.run(0.015)
    assert not cell.it.blocked
    assert cell.it.replies[0].body.result == SUCCESS
    # If already ready: at once.
    before_s = cell.now_s
    cell.it.replies.clear()
    cell.start()
    assert cell.now_s == before_s


def test_motion_is_possible_a_good_while_before_starting_is_answered(cell):
    """In the capture: not after 60 ms, but after 85 ms; the reply came after 110 ms."""
    cell.it.motion(request(MotionCtrl(0, 1, MotionCommand.START_TRAJ_MODE)), cell.now_s)
    cell.run(0.07)
    assert cell.it.status().motion_possible == 0
    cell.run(0.016)
    assert cell.it.status().motion_possible == 1
    assert cell.it.blocked


def test_starting_from_servo_off_takes_a_second():
    cell = Cell(servo_on=False)
    assert cell.it.status().drives_powered == 0
    assert cell.reason() == (FAILURE, 5006)
    before_s = cell.now_s
    cell.start()
    assert 1.0 <= cell.now_s - before_s < 1.5
    assert cell.it.status().drives_powered == 1


@pytest.mark.parametrize(
    ("act", "reason"),
    [
        (lambda it, t: it.emergency_stop(t), 5003),
        (lambda it, t: it.hold(True, t), 5007),
        (lambda it, t: it.remote(False, t), 5005),
        (lambda it, t: it.mode("teach", t), 5004),
        (lambda it, t: it.alarm(1234, t), 5001),
    ],
)
def test_starting_fails_for_what_an_operator_must_change(act, reason, cell):
    act(cell.it, cell.now_s)
    cell.run(0.02)
    assert cell.control(MotionCommand.START_TRAJ_MODE)[3:5] == (NOT_READY, reason)


def test_starting_resets_a_minor_alarm_and_an_error(cell):
    cell.it.alarm(4107, cell.now_s)
    cell.it.error(3040, cell.now_s)
    cell.run(0.02)
    status = cell.it.status()
    assert (status.in_error, status.error_code) == (1, 4107)
    cell.start()
    assert cell.it.status().in_error == 0


def test_servos_over_the_network():
    cell = Cell(servo_on=False)
    before_s = cell.now_s
    assert cell.control(MotionCommand.START_SERVOS).result == SUCCESS
    assert cell.now_s - before_s >= 1.0
    cell.start()
    cell.move()
    cell.run(0.05)
    assert cell.control(MotionCommand.STOP_SERVOS).result == SUCCESS
    assert cell.reason() == (FAILURE, 5006)
    cell.it.emergency_stop(cell.now_s)
    before_s = cell.now_s
    assert cell.control(MotionCommand.START_SERVOS).result == FAILURE
    assert cell.now_s - before_s == pytest.approx(5.0, abs=0.1)


def test_reset_alarm_over_the_network(cell):
    cell.it.alarm(4107, cell.now_s)
    cell.run(0.02)
    assert cell.reason() == (FAILURE, 5001)
    assert cell.control(MotionCommand.RESET_ALARM).result == SUCCESS
    assert cell.it.status().error_code == 0


def test_the_reasons_come_in_their_order():
    cell = Cell(servo_on=False, play=False, remote=False)
    it = cell.it
    it.hold(True, cell.now_s)
    it.emergency_stop(cell.now_s)
    it.error(3040, cell.now_s)
    it.alarm(4107, cell.now_s)
    cell.run(0.02)
    assert cell.reason()[1] == 5001
    it.reset_alarm(cell.now_s)
    it.error(3040, cell.now_s)
    steps = (
        (5002, lambda: it.reset_alarm(cell.now_s)),
        (5003, lambda: it.release_emergency_stop(cell.now_s)),
        (5004, lambda: it.mode("play", cell.now_s)),
        (5005, lambda: it.remote(True, cell.now_s)),
        (5006, lambda: it.servo(True, cell.now_s)),
        (5007, lambda: it.hold(False, cell.now_s)),
        (5008, lambda: None),
    )
    for reason, undo in steps:
        cell.run(0.02)
        assert cell.reason() == (FAILURE, reason)
        undo()


def test_unknown_types_and_types_that_are_not_served(cell):
    answer = cell.ask(Message(4711, CommType.SERVICE_REQUEST, 0, Raw(b"")))
    assert answer.body[:5] == (-1, -1, 4711, INVALID, 3003)
    for msg_type in (13, 15, 2002, 2017):
        assert cell.ask(Message(msg_type, CommType.TOPIC, 0, Raw(b""))) is None
        assert cell.it.close_requested
        cell.it.close_requested = False


def test_replies_are_processed_but_not_answered():
    cell = Cell().start()
    cell.move()
    cell.run(0.05)
    stop = request(MotionCtrl(0, 1, MotionCommand.STOP_MOTION))
    assert cell.ask(stop._replace(comm_type=CommType.SERVICE_REPLY)) is None
    assert cell.it.queue_count(0) == 0
    body = MotionCtrl(0, 9, MotionCommand.CHECK_QUEUE_CNT)
    assert cell.ask(topic(body)).body.sequence == 9


def test_queue_count_and_stopping_trajectory_mode():
    cell = Cell().start()
    cell.move()
    cell.run(0.02)
    count = cell.control(MotionCommand.CHECK_QUEUE_CNT)
    assert count[3:5] == (SUCCESS, cell.it.queue_count(0))
    assert count.subcode > 50
    assert cell.control(MotionCommand.CHECK_QUEUE_CNT, group=1)[3:5] == (FAILURE, -1)
    assert cell.control(MotionCommand.STOP_TRAJ_MODE).result == FAILURE
    assert cell.control(MotionCommand.DISCONNECT).result == FAILURE
    cell.run(0.6)
    assert cell.control(MotionCommand.STOP_TRAJ_MODE).result == SUCCESS
    cell.run(0.02)
    assert cell.reason() == (FAILURE, 5008)
    cell.start()


def test_disconnect_is_not_answered_and_ends_the_job():
    cell = Cell().start()
    assert cell.ask(request(MotionCtrl(0, 1, MotionCommand.DISCONNECT))) is None
    assert cell.it.close_requested
    cell.run(0.02)
    assert not cell.it.ready


def test_tools():
    cell = Cell(groups=2)
    assert cell.ask(request(SelectTool(1, 63, 5))).body[:5] == (1, 5, 2018, SUCCESS, 0)
    assert cell.it.tool(1) == 63
    assert cell.ask(request(SelectTool(1, 64, 6))).body[3:5] == (INVALID, 3017)
    assert cell.ask(request(SelectTool(2, 1, 7))).body[3:5] == (INVALID, 3004)
    assert (cell.it.tool(0), cell.it.tool(1)) == (0, 63)


# -- kinematics ------------------------------------------------------------------------------------


def transform(link, q):
    ct, stheta = math.cos(link.theta + q), math.sin(link.theta + q)
    ca, sa = math.cos(link.alpha), math.sin(link.alpha)
    return np.array(
        [
            [ct, -stheta * ca, stheta * sa, link.a * ct],
            [stheta, ct * ca, -ct * sa, link.a * stheta],
            [0.0, sa, ca, link.d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


@pytest.mark.parametrize("robot", ["gp8", "ur5", "gofa_crb15000_5"])
def test_dh_parameters_are_the_models_kinematics(robot):
    arm = load_arm(robot)
    table = dh_table(arm)
    base = np.eye(4)
    base[:3, :3] = np.column_stack([table.x, np.cross(table.z, table.x), table.z])
    base[:3, 3] = table.origin

    def by_dh(joints):
        found = base
        for link, q in zip(table.links, joints, strict=True):
            found = found @ transform(link, q)
        return found

    def by_model(joints):
        pose = IDENTITY_POSE
        for joint, q in zip(arm.joints, joints, strict=True):
            turn = from_rotation_vector(Vector3(*[q * part for part in joint.axis]))
            pose = compose(compose(pose, joint.placement), Pose(Vector3(0, 0, 0), turn))
        columns = [
            compose(pose, Pose(Vector3(*axis), IDENTITY_POSE.orientation)).position
            for axis in np.eye(3)
        ]
        found = np.eye(4)
        found[:3, 3] = pose.position
        found[:3, :3] = np.column_stack([np.subtract(c, pose.position) for c in columns])
        return found

    rng = np.random.default_rng(1)
    zero = np.linalg.inv(by_model([0.0] * 6)) @ by_dh([0.0] * 6)
    for _ in range(20):
        joints = rng.uniform(-2.0, 2.0, 6)
        assert by_model(joints) @ zero == pytest.approx(by_dh(joints), abs=1e-9)


def test_dh_parameters_are_answered_for_each_group():
    cell = Cell(groups=2)
    groups = cell.ask(request(Empty(), msg_type=MessageType.MOTO_GET_DH_PARAMETERS)).body.groups
    assert [len(links) for links in groups] == [8] * 4
    assert groups[0] == groups[1]
    assert not any(any(link) for links in groups[2:] for link in links)
    lengths = [(round(link.d, 6), round(link.a, 6)) for link in groups[0]]
    assert [a for _, a in lengths][:3] == [0.04, 0.345, 0.04]
    assert sorted(abs(d) for d, _ in lengths)[-2:] == [0.08, 0.34]


# -- points ----------------------------------------------------------------------------------------


def test_points_are_refused_in_this_order(cell):
    assert cell.point(0, 0.0)[3:5] == (NOT_READY, 5008)
    cell.start()
    far = [q + 0.1 for q in HOME]
    assert cell.point(0, 99999.0, far, (99.0,), group=1, fields=0)[3:5] == (INVALID, 3004)
    assert cell.point(-1, 99999.0, far, (99.0,), fields=6)[3:5] == (INVALID, 3015)
    assert cell.point(-1, 14400.0, far, (99.0,))[3:5] == (INVALID, 3016)
    assert cell.point(-1, 0.0, far, (99.0,))[3:5] == (INVALID, 3005)
    assert cell.point(0, 0.0, far, (99.0,))[3:5] == (INVALID, 3011)
    assert cell.point(0, 0.0, HOME, (99.0,))[3:5] == (INVALID, 3013)
    second_far = [HOME[0], HOME[1] + 0.1, *HOME[2:]]
    assert cell.point(0, 0.0, second_far, (99.0,))[3:5] == (INVALID, 3013)
    assert cell.point(0, 0.0, second_far, (0.0, 99.0))[3:5] == (INVALID, 3011)
    assert cell.point(0, math.nan, HOME)[3:5] == (INVALID, 3010)
    assert cell.point(-1, math.nan, HOME)[3:5] == (INVALID, 3005)
    assert cell.point(0, 0.0, HOME)[:5] == (0, 0, 14, SUCCESS, 0)
    assert cell.point(1, 0.1, far, (99.0,))[3:5] == (INVALID, 3013)
    assert cell.point(1, math.nan, far)[3:5] == (INVALID, 3010)
    assert cell.point(1, math.inf, far)[3:5] == (INVALID, 3016)
    assert cell.point(1, 0.0505, HOME).result == SUCCESS
    assert cell.point(2, math.nan, far).result == BUSY


@pytest.mark.parametrize("groups", [1, 2])
def test_a_client_that_ignores_a_refused_point_0_makes_the_arm_jump(groups):
    """3011 is not harmless: by then MotionServer.c has stored the point."""
    cell = Cell(groups=groups).start()
    away = [q + 0.005 for q in HOME]  # an axis may move this far in one IPC
    if groups == 1:
        assert cell.point(0, 0.0, away)[3:5] == (INVALID, 3011)
        assert cell.point(1, 0.4005, away).result == SUCCESS
    else:
        assert cell.ask(ex(0, (0, 0.0, away), (1, 0.0, HOME))).body[3:5] == (INVALID, 3011)
        assert cell.ask(ex(1, (0, 0.4005, away))).body.result == SUCCESS
    commands = [cell.it.command_pulses(0)]
    for _ in range(100):
        cell.run(IPC_S)
        commands.append(cell.it.command_pulses(0))
    moved = [after for before, after in pairwise(commands) if after != before]
    assert len(moved) == 1  # all of it in one IPC
    assert cell.it.command_rad(0) == pytest.approx(away, abs=1e-4)


def test_a_client_that_ignores_a_point_0_far_away_is_stopped_with_5012():
    cell = Cell().start()
    away = [HOME[0] + 1.0, *HOME[1:]]
    assert cell.point(0, 0.0, away)[3:5] == (INVALID, 3011)
    assert cell.point(1, 2.0005, away).result == SUCCESS  # at 0.5 rad/s it would be slow enough
    cell.run(0.05)
    assert cell.reason() == (FAILURE, 5012)
    assert cell.it.command_rad(0) == pytest.approx(HOME, abs=1e-4)


def test_point_0_in_energy_saving_is_kept_even_when_the_drives_do_not_wake():
    cell = Cell().start()
    cell.it.energy_saving(True, cell.now_s)
    cell.it.motion(point_message(0, 0.0, HOME), cell.now_s)
    cell.it.hold(True, cell.now_s)
    while cell.it.blocked:
        cell.run(0.001)
    assert cell.it.replies.pop().body.result == SUCCESS
    assert cell.point(1, 0.1)[3] == NOT_READY


def test_a_point_is_busy_while_the_one_before_is_converted():
    cell = Cell().start()
    cell.point(0, 0.0)
    assert cell.point(1, 0.0205).result == SUCCESS
    assert cell.point(2, 0.0405).result == BUSY
    cell.run(IPC_S)
    assert cell.point(2, 0.0405).result == SUCCESS


def test_a_trajectory_is_followed_and_its_status_reported():
    cell = Cell().start()
    goal = cell.move(0.4, 0.05)
    cell.run(0.1)
    assert cell.it.status().in_motion == 1
    feedback = cell.it.feedback(0)
    assert (feedback.valid_fields, feedback.time, feedback.acc) == (6, 0.0, ZEROS)
    assert feedback.vel[0] > 0.0
    assert cell.it.velocity_rad_s(0)[0] == pytest.approx(feedback.vel[0], rel=0.2)
    cell.run(0.35)
    assert cell.it.command_rad(0) == pytest.approx(goal, abs=1e-4)
    assert cell.it.measured_rad(0) == cell.it.command_rad(0)
    assert cell.it.status().in_motion == 0
    assert cell.it.newest_command_age_s == pytest.approx(0.45)


def test_in_motion_lasts_until_the_arm_has_followed():
    cell = Cell(plant="paper").start()
    cell.move(0.4, 0.1)
    cell.run(0.45)
    assert cell.it.queue_count(0) == 0
    assert cell.it.status().in_motion == 1
    cell.run(0.6)
    assert cell.it.status().in_motion == 0


def test_an_underrun_stops_dead_and_goes_on_later():
    cell = Cell().start()
    start = cell.it.command_rad(0)[0]
    cell.point(0, 0.0)
    moved = [HOME[0] + 0.02, *HOME[1:]]
    cell.point(1, 0.1005, moved, (0.2,))
    cell.run(0.5)
    assert cell.it.command_rad(0)[0] - start == pytest.approx(0.02, abs=1e-4)
    assert cell.it.velocity_rad_s(0)[0] == 0.0
    further = [HOME[0] + 0.04, *HOME[1:]]
    assert cell.point(2, 0.2005, further, (0.2,)).result == SUCCESS
    cell.run(0.5)
    assert cell.it.command_rad(0)[0] - start == pytest.approx(0.04, abs=1e-4)


def ex(sequence, *points):
    return request(
        JointTrajPtFullEx(
            sequence,
            tuple(
                JointFeedback(group, 7, time_s, joints10(joints), ZEROS, ZEROS)
                for group, time_s, joints in points
            ),
        )
    )


def test_points_for_several_groups_are_all_or_nothing():
    cell = Cell(groups=2).start()
    moved = [HOME[0] + 0.01, *HOME[1:]]
    assert cell.ask(ex(0, (0, 0.0, HOME), (1, 0.0, HOME))).body[:5] == (1, 0, 2016, 0, 0)
    assert cell.point(1, 0.1005, HOME, group=1).result == SUCCESS
    assert cell.ask(ex(1, (0, 0.1005, moved), (1, 0.1, moved))).body[:5] == (1, 1, 2016, BUSY, 0)
    cell.run(0.2)
    assert cell.it.command_rad(0) == pytest.approx(HOME, abs=1e-4)
    assert cell.ask(ex(1, (0, 0.1005, moved), (1, 0.2005, moved))).body.result == SUCCESS
    cell.run(0.3)
    for group in (0, 1):
        assert cell.it.command_rad(group)[0] - HOME[0] == pytest.approx(0.01, abs=1e-4)
    # The check concerns the group, not the 4 h.
    assert cell.ask(ex(0, (0, 20000.0, moved))).body.result == SUCCESS
    assert cell.ask(ex(0, (0, 0.0, moved), (2, 0.0, moved))).body[3:5] == (INVALID, 3004)


def test_a_group_without_increments_stands_still():
    cell = Cell(groups=2).start()
    cell.move()
    cell.run(0.2)
    assert cell.it.command_pulses(0) != cell.it.command_pulses(1)
    assert cell.it.command_rad(1) == pytest.approx(HOME, abs=1e-4)


def test_refused_increments_latch_until_the_mode_is_started_again():
    cell = Cell().start()
    cell.point(0, 0.0)
    jump = [HOME[0] + 1.0, *HOME[1:]]
    assert cell.point(1, 0.0205, jump).result == SUCCESS
    cell.run(0.05)
    assert cell.it.queue_count(0) == 0
    assert cell.reason() == (FAILURE, 5012)
    assert cell.it.command_rad(0) == pytest.approx(HOME, abs=1e-4)
    cell.start()


def test_point_0_wakes_the_drives():
    cell = Cell().start()
    cell.it.energy_saving(True, cell.now_s)
    cell.run(0.02)
    assert cell.it.status().drives_powered == 0
    before_s = cell.now_s
    assert cell.point(0, 0.0).result == SUCCESS
    assert cell.now_s - before_s >= 0.2
    assert cell.it.status().drives_powered == 1


def test_point_0_for_several_groups_wakes_the_drives():
    cell = Cell(groups=2).start()
    cell.it.energy_saving(True, cell.now_s)
    before_s = cell.now_s
    assert cell.ask(ex(0, (0, 0.0, HOME), (1, 0.0, HOME))).body.result == SUCCESS
    assert cell.now_s - before_s >= 0.2


def test_times_beyond_all_measure_do_no_harm():
    cell = Cell().start()
    assert cell.ask(ex(0, (0, 3e38, HOME))).body.result == SUCCESS
    assert cell.ask(ex(1, (0, 3.2e38, HOME))).body.result == SUCCESS
    cell.run(0.05)
    assert not cell.moving()


# -- causes of the end of motion (4.4) -------------------------------------------------------------

STOPS = {
    "emergency stop": (lambda it, t: it.emergency_stop(t), 5003),
    "alarm": (lambda it, t: it.alarm(4107, t), 5001),
    "error": (lambda it, t: it.error(3040, t), 5002),
    "teach": (lambda it, t: it.mode("teach", t), 5004),
    "remote": (lambda it, t: it.remote(False, t), 5005),
    "servo off": (lambda it, t: it.servo(False, t), 5006),
    "hold": (lambda it, t: it.hold(True, t), 5007),
    "job stop": (lambda it, t: it.job_stop(t), 5008),
    "collaborative stop": (lambda it, t: it.collaborative_stop(t), 5011),
}


def restored(cell):
    """Do all operator actions that motion needs, except its start."""
    it, t = cell.it, cell.now_s
    it.release_emergency_stop(t)
    it.reset_alarm(t)
    it.mode("play", t)
    it.remote(True, t)
    it.hold(False, t)
    it.servo(True, t)
    cell.run(0.05)


@pytest.mark.parametrize("name", STOPS)
@pytest.mark.parametrize("phase_s", [0.0, 0.005])
def test_what_ends_a_trajectory(name, phase_s):
    act, reason = STOPS[name]
    cell = Cell().start()
    cell.move()
    cell.run(0.1 + phase_s)
    assert cell.moving()
    act(cell.it, cell.now_s)
    stopped_at = cell.it.command_pulses(0)
    cell.run(0.0101)
    assert cell.it.queue_count(0) == 0
    assert cell.it.command_pulses(0) == stopped_at
    assert cell.reason() == (FAILURE, reason)
    assert cell.it.status().motion_possible == 0
    restored(cell)
    assert not cell.moving()
    assert cell.reason()[0] == FAILURE
    cell.start()
    assert not cell.moving()


@pytest.mark.parametrize("name", STOPS)
def test_what_ends_the_velocity_mode_at_once(name):
    act, reason = STOPS[name]
    cell = Cell()
    cell.start_velocity()
    cell.drive(0.2, 0.3)
    act(cell.it, cell.now_s)
    stopped_at = cell.it.command_pulses(0)
    cell.run(0.0101)
    assert cell.it.command_pulses(0) == stopped_at
    assert cell.it.active_mode == ActiveMode.NONE
    assert cell.it.velocity_rad_s(0) == (0.0,) * 6
    assert cell.velocity(0.3)[3:5] == (NOT_READY, reason)
    restored(cell)
    assert not cell.moving()


def test_stop_motion_keeps_the_mode():
    cell = Cell().start()
    cell.move(2.0)
    cell.run(0.1)
    before_s = cell.now_s
    assert cell.control(MotionCommand.STOP_MOTION).result == SUCCESS
    assert 0.0 < cell.now_s - before_s <= 0.02
    assert cell.it.queue_count(0) == 0
    assert not cell.moving()
    assert cell.reason() == (SUCCESS, 0)
    cell.move()
    cell.run(0.02)
    assert cell.moving()


def test_a_closed_motion_connection_leaves_the_queue():
    cell = Cell().start()
    goal = cell.move(0.4)
    cell.run(0.1)
    cell.it.disconnected(cell.now_s)
    cell.run(0.04)
    assert cell.moving()
    cell.run(0.02)
    assert not cell.moving()
    left = cell.it.queue_count(0)
    assert left > 0
    assert cell.it.moving_data
    cell.run(3.0)
    assert cell.it.queue_count(0) == left
    cell.it.connected(cell.now_s)
    assert cell.moving()
    cell.run(0.5)
    assert cell.it.command_rad(0) == pytest.approx(goal, abs=1e-4)


def test_stop_motion_first_thing_after_connecting_empties_the_queue():
    cell = Cell().start()
    cell.move(0.4)
    cell.run(0.1)
    cell.it.disconnected(cell.now_s)
    cell.run(0.2)
    cell.it.connected(cell.now_s)
    assert cell.control(MotionCommand.STOP_MOTION).result == SUCCESS
    assert cell.it.queue_count(0) == 0
    assert not cell.moving()


def test_a_client_that_is_replaced_takes_its_waiting_request_along():
    cell = Cell(servo_on=False)
    cell.it.motion(request(MotionCtrl(0, 1, MotionCommand.START_TRAJ_MODE)), cell.now_s)
    cell.run(0.2)
    cell.it.disconnected(cell.now_s)
    cell.it.connected(cell.now_s)
    assert not cell.it.blocked
    cell.run(2.0)
    assert not cell.it.replies
    assert cell.reason()[0] == FAILURE


@pytest.mark.parametrize("after_s", [0.1, 1.05])
def test_a_request_dies_with_its_connection(after_s):
    """Also while the servos switch on, and while the job starts."""
    cell = Cell(servo_on=False)
    cell.it.motion(request(MotionCtrl(0, 1, MotionCommand.START_VEL_MODE)), cell.now_s)
    cell.run(after_s)
    assert cell.it.blocked
    cell.it.disconnected(cell.now_s)
    assert not cell.it.blocked
    cell.run(5.0)
    assert not cell.it.replies
    assert cell.it.active_mode != ActiveMode.VELOCITY
    cell.it.connected(cell.now_s)
    cell.start()
    assert cell.it.active_mode == ActiveMode.TRAJECTORY


def test_a_client_that_comes_finds_the_velocity_mode_off(cell):
    cell.start_velocity()
    cell.it.disconnected(cell.now_s)
    assert cell.it.active_mode == ActiveMode.TRAJECTORY
    cell.it.connected(cell.now_s)
    cell.start_velocity()
    # No event has reported the end of the previous client.
    cell.it.connected(cell.now_s)
    assert cell.it.active_mode == ActiveMode.TRAJECTORY
    assert cell.velocity(0.1)[3:5] == (NOT_READY, 5040)


def test_old_firmware_plays_a_left_queue_on():
    cell = Cell(faults={"old-firmware": 1.0}).start()
    cell.move(0.4)
    cell.run(0.1)
    cell.it.mode("teach", cell.now_s)
    cell.run(1.0)
    assert not cell.moving()
    assert cell.it.queue_count(0) > 0
    assert cell.reason() == (FAILURE, 0)
    cell.it.mode("play", cell.now_s)
    cell.run(0.02)
    assert cell.moving()
    assert cell.it.feedback(0).valid_fields == 2
    assert cell.it.feedback(0).vel == ZEROS


@pytest.mark.parametrize("old", [False, True])
def test_a_speed_limit_stretches_a_trajectory_or_shortens_it(old):
    cell = Cell(faults={"old-firmware": 1.0} if old else {}).start()
    cell.it.speed_limit(0.01, cell.now_s)
    goal = cell.move(0.4, 0.06)
    cell.run(0.45)
    assert cell.it.moving_data is not old
    cell.run(1.0)
    way = cell.it.command_rad(0)[0] - goal[0] + 0.06
    assert way == pytest.approx(0.06, abs=1e-4) if not old else way < 0.04


# -- velocity mode ---------------------------------------------------------------------------------


def test_without_the_velocity_mode_nobody_knows_it():
    cell = Cell(velocity_mode=False)
    answer = cell.ask(request(VelocityInfoRequest(0))).body
    assert answer[:5] == (-1, -1, 2042, INVALID, 3003)
    body = JointVelocity(0, 0, 4, 0.0, ZEROS, ZEROS, ZEROS)
    assert cell.ask(request(body)).body[2:5] == (2040, INVALID, 3003)
    cell.control(MotionCommand.CHECK_QUEUE_CNT)
    again = cell.ask(request(MotionCtrl(0, 50, MotionCommand.START_VEL_MODE))).body
    assert again.command == MotionCommand.CHECK_QUEUE_CNT


def test_the_probe_tells_limits(cell):
    info = cell.ask(request(VelocityInfoRequest(0))).body
    arm = load_arm("gp8")
    assert info[:6] == (1, 4000, 100, ActiveMode.NONE, 1, 6)
    assert info.v_max[:6] == arm.velocity
    assert info.a_max[:6] == tuple(joint.acceleration for joint in arm.joints)
    assert info.pos_min[:6] == arm.lower
    assert info.pos_max[:6] == arm.upper
    assert cell.ask(request(VelocityInfoRequest(1))).body[3:5] == (INVALID, 3004)


@pytest.mark.parametrize(
    ("asked", "given"),
    [((), (100, 1)), ((5, 2), (20, 1)), ((900, 0.5), (500, 0.5)), ((250,), (250, 1))],
)
def test_starting_clamps_and_tells_what_is_in_force(asked, given):
    answer = Cell().start_velocity(*asked)
    assert answer.data[:4] == (1.0, 4.0, *given)


def test_starting_is_refused_with_data_in_the_queue():
    cell = Cell().start()
    cell.move()
    assert cell.control(MotionCommand.START_VEL_MODE).result == BUSY
    cell.run(0.1)
    assert cell.control(MotionCommand.START_VEL_MODE).result == BUSY
    cell.run(0.5)
    before_s = cell.now_s
    cell.start_velocity()
    assert cell.now_s == before_s
    bad = cell.control(MotionCommand.START_VEL_MODE, data=(math.nan,))
    assert bad[3:5] == (INVALID, 3041)


def test_the_modes_exclude_each_other():
    cell = Cell().start()
    assert cell.velocity(0.1)[3:5] == (NOT_READY, 5040)
    assert cell.control(MotionCommand.STOP_VEL_MODE)[3:5] == (NOT_READY, 5040)
    cell.start_velocity()
    assert cell.it.active_mode == ActiveMode.VELOCITY
    assert cell.point(0, 0.0)[3:5] == (NOT_READY, 5042)
    assert cell.ask(ex(0, (0, 0.0, HOME))).body[3:5] == (NOT_READY, 5042)
    cell.drive(0.1, 0.1)
    assert cell.control(MotionCommand.START_TRAJ_MODE)[3:5] == (NOT_READY, 5042)
    assert cell.control(MotionCommand.STOP_TRAJ_MODE).result == FAILURE
    cell.drive(0.1, 0.0)
    cell.start()
    assert cell.it.active_mode == ActiveMode.TRAJECTORY
    cell.move()
    cell.run(0.1)
    assert cell.moving()


def test_speeds_are_followed_and_the_way_is_exact(cell):
    cell.start_velocity()
    cell.drive(0.4, 0.1, -0.05)
    assert cell.it.velocity_rad_s(0)[:2] == pytest.approx((0.1, -0.05))
    assert cell.it.status().in_motion == 1
    assert cell.it.moving_data
    before = cell.it.command_rad(0)
    cell.drive(1.0, 0.1, -0.05)
    after = cell.it.command_rad(0)
    assert after[0] - before[0] == pytest.approx(0.1, abs=3e-5)
    assert after[1] - before[1] == pytest.approx(-0.05, abs=3e-5)


def test_stopping_ramps_tells_how_long_and_ends_the_mode(cell):
    cell.start_velocity()
    cell.drive(0.4, 2.0)
    answer = cell.control(MotionCommand.STOP_VEL_MODE)
    a_max = load_arm("gp8").joints[0].acceleration
    assert answer[3:5] == (SUCCESS, 0)
    assert answer.data[0] == pytest.approx(2.0 / a_max)
    assert cell.velocity(1.0)[3:5] == (NOT_READY, 5040)
    assert cell.velocity(1.0, sequence=0)[3:5] == (NOT_READY, 5040)
    assert cell.it.status().motion_possible == 0
    assert cell.reason() == (FAILURE, 5040)
    assert cell.control(MotionCommand.START_VEL_MODE).result == BUSY
    cell.run(answer.data[0] - 2 * IPC_S)
    assert cell.it.active_mode == ActiveMode.VELOCITY
    assert cell.control(MotionCommand.STOP_VEL_MODE).data[0] < answer.data[0]
    cell.run(5 * IPC_S)
    assert cell.it.active_mode == ActiveMode.TRAJECTORY
    assert cell.it.status().motion_possible == 1
    assert not cell.moving()


def test_the_watchdog_ramps_and_latches_until_sequence_0(cell):
    cell.start_velocity(60)
    cell.drive(0.2, 0.5)
    cell.run(0.03)
    assert cell.it.velocity_rad_s(0)[0] == pytest.approx(0.5)
    cell.run(0.1)
    assert cell.it.velocity_rad_s(0)[0] == 0.0
    assert cell.it.active_mode == ActiveMode.VELOCITY
    assert cell.it.status().motion_possible == 0
    assert cell.reason() == (FAILURE, 5041)
    assert cell.velocity(0.5)[3:5] == (NOT_READY, 5041)
    assert not cell.moving()
    assert cell.velocity(0.5, sequence=0).result == SUCCESS
    assert cell.it.status().motion_possible == 1
    assert cell.moving()


def test_nobody_is_late_before_the_stream_is_armed(cell):
    cell.start_velocity()
    cell.run(1.0)
    assert cell.it.status().motion_possible == 1
    assert cell.velocity(0.1, sequence=5)[3:5] == (INVALID, 3040)
    assert cell.velocity(0.1, sequence=0).result == SUCCESS


def test_starting_again_at_rest_disarms_the_stream(cell):
    cell.start_velocity()
    cell.drive(0.1, 0.2)
    assert cell.control(MotionCommand.START_VEL_MODE).result == BUSY
    assert cell.velocity(0.0).result == SUCCESS
    cell.run(0.05)
    assert cell.velocity(0.0, wants=False) is None
    assert cell.velocity(0.0, wants=False) is None
    cell.start_velocity()
    cell.run(1.0)
    assert cell.it.status().motion_possible == 1
    assert cell.velocity(0.1, sequence=9)[3:5] == (INVALID, 3040)
    assert cell.velocity(0.0).data == ZEROS


def test_checks_come_in_their_order():
    """Each command also fails all later checks."""
    nan = joints10((math.nan,))

    def verdict(cell, sequence, *commands):
        commands = [JointFeedback(g, fields, 0.0, ZEROS, v, ZEROS) for g, fields, v in commands]
        return cell.ask(request(JointVelocityEx(sequence, tuple(commands)))).body[3:5]

    cell = Cell(groups=2)
    assert verdict(cell, -1) == (NOT_READY, 5008)
    cell.start()
    assert verdict(cell, -1) == (NOT_READY, 5040)
    cell.start_velocity()
    assert verdict(cell, -1) == (INVALID, 3010)
    assert verdict(cell, -1, (2, 2, nan)) == (INVALID, 3005)
    assert verdict(cell, 3, (2, 2, nan)) == (INVALID, 3004)
    good = (0, 4, ZEROS)
    assert verdict(cell, 3, good, (0, 2, nan)) == (INVALID, 3010)
    assert verdict(cell, 3, good, (1, 2, nan)) == (INVALID, 3015)
    assert verdict(cell, 3, good, (1, 6, nan)) == (INVALID, 3010)
    assert verdict(cell, 3, good, (1, 4, nan)) == (INVALID, 3041)
    assert verdict(cell, 3, good, (1, 4, ZEROS)) == (INVALID, 3040)
    assert verdict(cell, 0, (1, 4, ZEROS)) == (SUCCESS, 0)
    cell.run(0.2)
    assert verdict(cell, 0, good) == (SUCCESS, 0)
    assert verdict(cell, 0, good, (1, 6, ZEROS)) == (INVALID, 3010)
    assert verdict(cell, 1, good, (1, 4, ZEROS)) == (NOT_READY, 5041)
    assert verdict(cell, 1, good) == (SUCCESS, 0)


def test_stop_motion_ramps_and_latches(cell):
    cell.start_velocity()
    cell.drive(0.4, 2.0)
    assert cell.control(MotionCommand.STOP_MOTION).result == SUCCESS
    assert cell.it.velocity_rad_s(0)[0] > 1.0
    cell.run(0.1)
    assert cell.it.velocity_rad_s(0)[0] == 0.0
    assert cell.velocity(2.0)[3:5] == (NOT_READY, 5041)


def test_a_closed_motion_connection_ramps_and_leaves(cell):
    cell.start_velocity()
    cell.drive(0.4, 3.0)
    before = cell.it.command_rad(0)[0]
    cell.it.disconnected(cell.now_s)
    cell.run(2 * IPC_S)
    assert 0.0 < cell.it.velocity_rad_s(0)[0] < 3.0
    assert cell.it.moving_data
    cell.run(0.5)
    a_max = load_arm("gp8").joints[0].acceleration
    assert cell.it.command_rad(0)[0] - before == pytest.approx(9.0 / (2 * a_max), abs=0.01)
    assert cell.it.active_mode == ActiveMode.TRAJECTORY
    assert not cell.it.moving_data
    cell.it.connected(cell.now_s)
    assert not cell.moving()


def test_sequences_must_rise(cell):
    cell.start_velocity()
    for sequence in (0, 1, 5, 2**30, 2**31 - 1, 1):
        assert cell.velocity(0.1, sequence=sequence).result == SUCCESS
    assert cell.velocity(0.2, sequence=1 + 2**30)[3:5] == (INVALID, 3040)
    for sequence in (1, 2**31 - 1):
        assert cell.velocity(0.2, sequence=sequence)[3:5] == (INVALID, 3040)
    assert cell.velocity(0.2, sequence=-1)[3:5] == (INVALID, 3005)
    cell.run(0.08)
    assert cell.it.velocity_rad_s(0)[0] == pytest.approx(0.1)


def test_bad_commands_change_nothing(cell):
    cell.start_velocity()
    cell.drive(0.1, 0.1)
    assert cell.velocity(math.nan)[3:5] == (INVALID, 3041)
    assert cell.velocity(0.0, -math.inf)[3:5] == (INVALID, 3041)
    assert cell.velocity(0.5, fields=5, time_s=math.nan)[3:5] == (INVALID, 3041)
    assert cell.velocity(0.5, fields=12, acc=(math.nan,))[3:5] == (INVALID, 3041)
    assert cell.velocity(*[0.0] * 9, math.nan)[3:5] == (INVALID, 3041)
    assert cell.velocity(0.1, time_s=math.nan, acc=(math.nan,)).result == SUCCESS
    assert cell.velocity(0.5, fields=1)[3:5] == (INVALID, 3015)
    assert cell.velocity(0.5, fields=6)[3:5] == (INVALID, 3010)
    assert cell.velocity(0.5, group=1)[3:5] == (INVALID, 3004)
    cell.run(0.02)
    assert cell.it.velocity_rad_s(0)[0] == pytest.approx(0.1)


def test_topics_are_obeyed_and_not_answered(cell):
    cell.start_velocity()
    assert cell.velocity(0.2, wants=False) is None
    cell.run(0.05)
    assert cell.it.velocity_rad_s(0)[0] == pytest.approx(0.2)


def test_a_reply_tells_what_became_of_the_commands_before(cell):
    cell.start_velocity()
    cell.run(IPC_S)
    for speed in (1.0, 50.0, 50.0):
        cell.velocity(speed, wants=False)
    cell.run(0.02)
    answer = cell.velocity(50.0)
    speed, acceleration, position, age_ms, overwritten = answer.data[:5]
    assert (speed, acceleration, position, overwritten) == (1.0, 1.0, 0.0, 2.0)
    assert 0.0 < age_ms <= 4.0
    assert cell.velocity(0.0).data[4] == 1.0
    assert cell.velocity(0.0).data[:3] == (0.0, 0.0, 0.0)


def test_commands_may_ask_for_less_acceleration(cell):
    cell.start_velocity(0, 0.5)
    a_max = load_arm("gp8").joints[0].acceleration
    cell.velocity(1.0, fields=12, acc=(2.0,))
    cell.run(10 * IPC_S)
    assert cell.it.velocity_rad_s(0)[0] == pytest.approx(10 * IPC_S * 2.0)
    cell.velocity(5.0, fields=12, acc=(-1.0,))
    before = cell.it.velocity_rad_s(0)[0]
    cell.run(5 * IPC_S)
    assert cell.it.velocity_rad_s(0)[0] - before == pytest.approx(5 * IPC_S * 0.5 * a_max)


def test_a_position_limit_is_never_passed(cell):
    cell.start_velocity()
    cell.drive(3.0, 5.0)
    upper = load_arm("gp8").upper[0]
    assert upper - 0.01 < cell.it.command_rad(0)[0] <= upper
    assert cell.velocity(5.0).data[2] == 1.0


def test_a_speed_limit_discards_in_velocity_mode(cell):
    cell.start_velocity()
    cell.drive(0.2, 0.5)
    cell.it.speed_limit(0.02, cell.now_s)
    before = cell.it.command_rad(0)[0]
    cell.drive(0.5, 0.5)
    limited = cell.it.command_rad(0)[0] - before
    assert limited == pytest.approx(0.5 * 0.02 * load_arm("gp8").velocity[0], rel=0.02)
    cell.it.speed_limit(None, cell.now_s)
    before = cell.it.command_rad(0)[0]
    cell.drive(0.5, 0.5)
    assert cell.it.command_rad(0)[0] - before == pytest.approx(0.25, abs=0.003)


def test_a_speed_limit_keeps_the_direction_and_fractions_of_pulses(cell):
    cell.it.speed_limit(0.1, cell.now_s)
    cell.start_velocity()
    before = np.array(cell.it.command_rad(0))
    cell.drive(0.4, 5.0, 0.02, 0.0, 0.5)
    assert cell.velocity(5.0, 0.02, 0.0, 0.5).data[0] == 1.0
    way = np.array(cell.it.command_rad(0)) - before
    assert way[0] == pytest.approx(0.4 * 0.1 * load_arm("gp8").velocity[0], rel=0.05)
    assert way[[1, 3]] == pytest.approx(way[0] * np.array([0.004, 0.1]), abs=4e-5)


def test_a_speed_limit_that_comes_and_goes_acts_at_once_and_lets_go_in_a_ramp(cell):
    cell.start_velocity()
    cell.drive(0.3, 2.0)
    highest, a_max = load_arm("gp8").velocity[0], load_arm("gp8").joints[0].acceleration
    cell.it.speed_limit(0.1, cell.now_s)
    for _ in range(5):
        before = cell.it.command_rad(0)[0]
        cell.run(IPC_S)
        assert cell.it.command_rad(0)[0] - before <= 0.1 * highest * IPC_S + 4e-5
    assert cell.it.velocity_rad_s(0)[0] == pytest.approx(0.1 * highest)
    cell.velocity(2.0)
    cell.it.speed_limit(None, cell.now_s)
    cell.run(4 * IPC_S)
    assert cell.it.velocity_rad_s(0)[0] == pytest.approx(0.1 * highest + 4 * a_max * IPC_S)


def test_a_speed_limit_does_not_move_the_position_limits(cell):
    cell.start_velocity()
    cell.it.speed_limit(0.02, cell.now_s)
    before = cell.it.command_rad(0)[0]
    cell.drive(6.0, 5.0)
    way = cell.it.command_rad(0)[0] - before
    assert way == pytest.approx(6.0 * 0.02 * load_arm("gp8").velocity[0], rel=0.02)


def test_energy_saving_ends_the_velocity_mode_and_starting_it_wakes_the_drives(cell):
    cell.start_velocity()
    cell.it.energy_saving(True, cell.now_s)
    cell.run(0.02)
    assert cell.velocity(0.1, sequence=0)[3:5] == (NOT_READY, 5040)
    before_s = cell.now_s
    cell.start_velocity()
    assert cell.now_s - before_s >= 0.2
    cell.drive(0.1, 0.1)
    assert cell.moving()


def test_refused_increments_end_the_velocity_mode(cell):
    cell.start_velocity()
    cell.drive(0.1, 0.1)
    cell.it.increment_error(cell.now_s)
    cell.run(0.02)
    assert cell.velocity(0.1)[3:5] == (NOT_READY, 5012)
    assert not cell.moving()
    cell.start_velocity()


def test_two_groups_start_in_the_same_period():
    cell = Cell(groups=2)
    cell.start_velocity()
    commands = tuple(
        JointFeedback(group, 4, 0.0, ZEROS, joints10((0.1 + group,)), ZEROS) for group in (0, 1)
    )
    assert cell.ask(request(JointVelocityEx(0, commands))).body[:5] == (1, 0, 2041, SUCCESS, 0)
    assert cell.ask(request(JointVelocityEx(0, ()))).body.result == INVALID
    cell.run(IPC_S + 0.001)
    assert all(cell.it.velocity_rad_s(group)[0] > 0.0 for group in (0, 1))
    # Group 1 gets no more commands: both stop.
    for sequence in range(1, 8):
        cell.velocity(0.1, sequence=sequence)
        cell.run(0.02)
    assert cell.velocity(0.1, sequence=20)[3:5] == (NOT_READY, 5041)
    cell.run(0.1)
    assert all(cell.it.velocity_rad_s(group)[0] == 0.0 for group in (0, 1))


def test_the_latch_is_each_groups_own():
    cell = Cell(groups=2)
    cell.start_velocity()
    for group in (0, 1):
        assert cell.velocity(0.1, sequence=0, group=group).result == SUCCESS
    cell.run(0.2)
    assert cell.velocity(0.1, sequence=0, group=0).result == SUCCESS
    assert cell.velocity(0.1, sequence=1, group=0).result == SUCCESS
    assert cell.velocity(0.1, sequence=1, group=1)[3:5] == (NOT_READY, 5041)
    assert cell.it.status().motion_possible == 0
    assert cell.reason() == (FAILURE, 5041)
    assert cell.velocity(0.1, sequence=0, group=1).result == SUCCESS
    assert cell.it.status().motion_possible == 1
    assert cell.reason() == (SUCCESS, 0)


def test_a_group_that_was_never_armed_is_not_latched():
    cell = Cell(groups=2)
    cell.start_velocity()
    cell.velocity(0.1, sequence=0)
    cell.run(0.2)
    assert cell.velocity(0.1, sequence=1, group=1)[3:5] == (INVALID, 3040)
    assert cell.velocity(0.1, sequence=0).result == SUCCESS
    assert cell.it.status().motion_possible == 1


def test_a_reply_for_several_groups_tells_of_all_of_them():
    cell = Cell(groups=2)
    cell.start_velocity()

    def both(sequence, *speeds):
        commands = [
            JointFeedback(group, 4, 0.0, ZEROS, joints10(v), ZEROS)
            for group, v in enumerate(speeds)
        ]
        return JointVelocityEx(sequence, tuple(commands))

    assert cell.ask(topic(both(0, (99.0,), (0.0, 0.1)))) is None
    assert cell.ask(topic(both(1, (99.0,), (0.0, 99.0)))) is None
    cell.run(0.001)
    assert cell.velocity(99.0, sequence=2, wants=False) is None
    cell.run(0.02)
    answer = cell.ask(request(both(3, (0.0,), (0.0,)))).body
    assert answer[:5] == (1, 3, 2041, SUCCESS, 0)
    speed, acceleration, position, age_ms, overwritten = answer.data[:5]
    assert (speed, acceleration, position, overwritten) == (3.0, 3.0, 0.0, 3.0)
    assert age_ms == pytest.approx(2.0)  # that of group 0 is 1 ms
    assert cell.ask(request(both(4, (0.0,), (0.0,)))).body.data[0] == 0.0


def test_the_senders_time_tells_how_late_commands_come(cell):
    cell.start_velocity()
    sent_s = 5.0
    for late_s in (0.0, 0.002, 0.013, 0.001):
        cell.run(late_s)
        cell.velocity(0.1, fields=5, time_s=sent_s)
        cell.run(0.02 - late_s)
        sent_s += 0.02
    assert cell.it.worst_lateness_s == pytest.approx(0.013, abs=1e-6)


# -- time, faults, log, options --------------------------------------------------------------------


def test_a_stall_is_no_burst_and_no_drift():
    cell = Cell(log="kept").start()
    cell.it.log.clear()
    cell.now_s += 10.0
    cell.it.advance(cell.now_s)
    assert len(cell.it.log) <= 26
    cell.it.log.clear()
    cell.run(2.0)
    assert len(cell.it.log) == pytest.approx(500, abs=1)
    assert cell.it.next_s > cell.now_s


def test_periods_keep_an_absolute_schedule():
    cell = Cell(log="kept")
    for _ in range(777):
        cell.run(0.0013)
    times = [row[0] for row in cell.it.log]
    assert times == pytest.approx([100.0 + IPC_S * (k + 1) for k in range(len(times))], abs=1e-9)


def test_a_row_of_the_log():
    cell = Cell(log="kept").start()
    cell.move()
    cell.run(0.1)
    row = dict(zip(cell.it.log_columns, cell.it.log[-1], strict=True))
    assert (row["mode"], row["queue"]) == ("trajectory", cell.it.queue_count(0))
    assert row["command_joint_1_s"] == cell.it.command_rad(0)[0]
    assert row["measured_joint_6_t"] == cell.it.measured_rad(0)[5]
    assert row["command_age_s"] == pytest.approx(0.1, abs=IPC_S)


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("remote-off", 5005),
        ("job-stop", 5008),
        ("increment-error", 5012),
        ("energy-saving", None),
    ],
)
def test_faults_come_at_their_time(fault, reason):
    cell = Cell(faults={fault: 0.3}).start()
    cell.move(0.6)
    cell.run(0.15)
    assert cell.moving()
    cell.run(0.1)
    assert not cell.moving()
    if reason is not None:
        assert cell.reason() == (FAILURE, reason)
    else:
        assert cell.it.status().drives_powered == 0


def test_signals(cell):
    assert cell.it.signals()[11120] is False
    cell.it.connections.update({"motion", "io"})
    cell.start()
    signals = cell.it.signals()
    assert sorted(signals) == list(range(11120, 11128))
    on = [address for address, value in signals.items() if value]
    assert on == [11120, 11122, 11123, 11124, 11126]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("groups", 5),
        ("plant", "heavy"),
        ("plant", PlantModel(lag_s=-1.0)),
        ("ipc_s", 0.0035),
        ("queue_increments", 1),
        ("base_port", 65534),
        ("feedback_fields", 4),
        ("start", (0.0,)),
        ("start", (9.0,) * 6),
        ("pulses_per_rad", (1.0, 2.0)),
        ("speed_limits", (0.0,) * 6),
        ("job_start_s", -1.0),
    ],
)
def test_wrong_options_are_named(key, value):
    with pytest.raises(ConfigurationError, match=key):
        MotorosControllerOptions(**{key: value})


def test_unknown_faults_are_named():
    with pytest.raises(ScriptError, match="old-firmware"):
        MotorosControllerOptions(faults={"gremlin": 1.0})


def test_default_pulses_are_some_tens_of_thousands():
    assert all(30_000 < each < 80_000 for each in MotorosControllerOptions().axis_pulses)


@pytest.mark.parametrize("bad", [-0.1, 1.5, math.nan])
def test_hands_refuse_nonsense(bad, cell):
    with pytest.raises(ValueError, match="speed limit"):
        cell.it.speed_limit(bad, cell.now_s)
    with pytest.raises(ValueError, match="mode"):
        cell.it.mode("auto", cell.now_s)


def test_points_are_answered_busy_and_first_ones_refused_as_often_as_that_is_asked_for():
    cell = Cell().start()
    cell.it.refused_starts = cell.it.busy_answers = 1
    assert cell.point(0, 0.0)[3:5] == (INVALID, InvalidSubcode.DATA_START_POS)
    assert cell.point(0, 0.0).result == SUCCESS
    assert cell.point(1, 0.1005).result == BUSY
    assert cell.point(1, 0.1005).result == SUCCESS
