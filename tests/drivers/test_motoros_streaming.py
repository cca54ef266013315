"""Both kinds of motion with scripted replies; tests of the session use a simulated controller."""

import math
import struct
from itertools import pairwise

import pytest

from cardan.drivers.motoros.feedback import StateFeed
from cardan.drivers.motoros.motion import MotionCounters, MotionParts, MotionRecord
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.requests import MotionRequests
from cardan.drivers.motoros.streaming import LAST_TIME_MS, RENEW_TIME_MS, PointStream
from cardan.drivers.motoros.trajectory_limiter import JointTrajectoryLimiter
from cardan.drivers.motoros.velocity import VelocityStream
from cardan.protocols.simple_message.codec import wire
from cardan.protocols.simple_message.codes import MotionCommand
from cardan.protocols.simple_message.messages import (
    JointFeedback,
    JointTrajPtFull,
    JointVelocity,
    MotionReply,
    RobotStatus,
    joints10,
    reply,
    topic,
)
from cardan.types import HoldCommand, JointCommand, JointLimits, JointVelocityCommand

IPC_S = 0.004
SUCCESS, BUSY, INVALID, NOT_READY = (0, 0), (1, 0), (3, 3011), (5, 5001)
HOME = (0.1, 0.2, 0.3, 0.0, -0.5, 0.0)
LIMITS = JointLimits((-3.0,) * 6, (3.0,) * 6, (2.0,) * 6, (10.0,) * 6)


class Bench:
    """A kind of motion, with replies like those of stock MotoROS."""

    def __init__(self, kind, **options):
        self.options = MotorosOptions(**options)
        self.feed = StateFeed(self.options)
        self.requests = MotionRequests(0)
        self.counters = MotionCounters()
        self.record = MotionRecord("", 6)
        self.guide = JointTrajectoryLimiter(*LIMITS)
        self.now_s = 50.0
        self.points = []
        self.velocities = []
        self.verdicts = []
        """Results of the next points, in order; afterwards success."""
        self.ready = True
        self.empty_s = 0.0
        """Time at which the queue is empty."""
        self.position = list(HOME)
        self.feed.connected()
        self.publish()
        self.motion = kind(
            MotionParts(
                self.options, self.requests, self.feed, self.guide, self.counters, self.record
            ),
            self.now_s,
        )

    def publish(self, in_motion=0, motion_possible=1, **more):
        status = RobotStatus(1, 0, 0, 0, in_motion, 2, motion_possible)._replace(**more)
        ten = joints10(self.position)
        zeros = joints10(())
        for body in (JointFeedback(0, 2, 0.0, ten, zeros, zeros), status):
            self.feed.received(wire().encode(topic(body)), self.now_s)

    def count(self):
        return max(0, math.ceil((self.empty_s - self.now_s) / IPC_S - 1e-6))

    def serve(self):
        """Answer all requests, including those caused by an answer."""
        for message in self.motion.topics:
            self.velocities.append((self.now_s, message.body))
        self.motion.topics.clear()
        while (message := self.requests.take(self.now_s)) is not None:
            body = message.body
            self.now_s += 1e-4
            if isinstance(body, JointTrajPtFull):
                result = self.verdicts.pop(0) if self.verdicts else SUCCESS
                self.points.append((self.now_s, body, result))
                if result == SUCCESS and body.sequence > 0:
                    before = [p for _, p, r in self.points if r == SUCCESS][-2]
                    way_s = (int(body.time * 1e3) - int(before.time * 1e3)) * 1e-3
                    self.empty_s = max(self.empty_s, self.now_s + IPC_S) + way_s
                answer = MotionReply(0, body.sequence, 14, *result)
            elif isinstance(body, JointVelocity):
                self.velocities.append((self.now_s, body))
                data = joints10((1.0, 0.0, 4.0, 3.0, 2.0))
                result = self.verdicts.pop(0) if self.verdicts else SUCCESS
                answer = MotionReply(0, body.sequence, 2040, *result, data)
            elif body.command == MotionCommand.CHECK_QUEUE_CNT:
                answer = MotionReply(0, body.sequence, body.command, 0, self.count())
            else:
                good = (0, 0) if self.ready else (2, 5006)
                answer = MotionReply(0, body.sequence, body.command, *good)
            assert self.requests.received(reply(answer), self.now_s) == ""

    def run(self, seconds, command, step_s=1e-3):
        """Let time pass; `command` answers each control instant. Return the number of instants."""
        end_s = self.now_s + seconds
        instants = 0
        while self.now_s < end_s and not self.motion.ended:
            self.motion.advance(self.now_s)
            self.serve()
            period_s = self.motion.due(self.now_s)
            if period_s:
                instants += 1
                self.motion.command(command, self.now_s)
                self.serve()
            self.now_s += step_s
        return instants

    def start(self):
        self.now_s += 0.025
        self.publish()
        self.motion.advance(self.now_s)
        self.serve()
        return self

    def accepted(self):
        return [p for _, p, result in self.points if result == SUCCESS]


def moved(*offsets):
    return JointCommand(tuple(a + b for a, b in zip(HOME, joints10(offsets), strict=False)))


class TestPointStream:
    def test_it_begins_where_the_robot_rests(self):
        bench = Bench(PointStream)
        bench.now_s += 0.025
        bench.publish(in_motion=1)
        bench.motion.advance(bench.now_s)
        bench.serve()
        assert bench.points == []
        assert "rest" in bench.motion.waiting
        bench.start()
        ((_, point, _),) = bench.points
        assert point.sequence == 0
        assert point.valid_fields == 7
        assert point.pos[:6] == pytest.approx(HOME, abs=1e-6)
        assert point.vel == joints10(())
        assert bench.motion.waiting == ""

    def test_a_status_from_before_the_start_says_nothing(self):
        bench = Bench(PointStream)
        bench.motion.advance(bench.now_s + 0.01)
        bench.serve()
        assert bench.points == []
        for ends in (False, True):
            bench.now_s += 0.06
            bench.publish(motion_possible=0)
            bench.motion.advance(bench.now_s)
            assert bench.motion.ended == ("the controller does not allow motion" if ends else "")

    def test_a_robot_that_never_rests_is_given_up(self):
        bench = Bench(PointStream)
        bench.motion.advance(bench.now_s + 5.1)
        assert "rest" in bench.motion.ended

    def test_times_are_exact_and_points_come_one_spacing_apart(self):
        bench = Bench(PointStream).start()
        instants = bench.run(2.0, HoldCommand(), 2.5e-4)
        assert 95 <= instants <= 102
        for n, point in enumerate(bench.accepted()):
            assert point.sequence == n
            as_float32 = struct.unpack("<f", struct.pack("<f", point.time))[0]
            assert int(as_float32 * 1000.0) == 20 * n
        assert bench.counters.underruns == 0
        assert bench.counters.busy_replies == 0

    def test_the_queue_stays_shallow_and_is_hardly_asked(self):
        bench = Bench(PointStream).start()
        bench.run(1.0, HoldCommand(), 2.5e-4)
        deepest = 0
        for _ in range(400):
            bench.run(2.5e-4, HoldCommand(), 2.5e-4)
            deepest = max(deepest, bench.count())
        assert deepest <= 3 + 5 + 1
        assert bench.requests.results.total() <= 3 * len(bench.points)

    def test_points_keep_the_limits_and_meet_in_position_and_speed(self):
        bench = Bench(PointStream).start()
        bench.run(1.5, moved(0.5, -0.3), 5e-4)
        points = bench.accepted()
        assert points[-1].pos[:2] == pytest.approx((0.6, -0.1), abs=1e-6)
        for a, b in pairwise(points):
            for j in range(6):
                assert abs(b.vel[j]) <= 2.0 + 1e-6
                assert abs(b.vel[j] - a.vel[j]) <= 10.0 * 0.02 + 1e-6
                mean = 0.5 * 0.02 * (a.vel[j] + b.vel[j])
                assert b.pos[j] - a.pos[j] == pytest.approx(mean, abs=1e-7)

    def test_a_busy_controller_gets_the_same_point_again(self):
        bench = Bench(PointStream).start()
        bench.verdicts = [SUCCESS, BUSY, BUSY]
        bench.run(0.2, moved(0.2), 5e-4)
        busy = [(t, p) for t, p, result in bench.points if result == BUSY]
        assert len(busy) == 2
        assert bench.counters.busy_replies == bench.counters.resent_points == 2
        again = [(t, p) for t, p, _ in bench.points if p.sequence == busy[0][1].sequence]
        assert len(again) == 3
        assert all(p is busy[0][1] for _, p in again)
        assert again[1][0] - again[0][0] == pytest.approx(0.002, abs=0.001)
        assert [p.sequence for p in bench.accepted()] == list(range(len(bench.accepted())))

    def test_another_start_position_is_asked_from_the_robot_again(self):
        bench = Bench(PointStream)
        bench.verdicts = [INVALID, INVALID]
        bench.start()
        assert bench.motion.waiting
        bench.position[0] = 0.15
        bench.start()
        bench.start()
        assert bench.motion.ended == ""
        assert bench.motion.waiting == ""
        assert bench.accepted()[0].pos[0] == pytest.approx(0.15)
        # After an underrun a new trajectory may be refused as often as the first one.
        turn = JointVelocityCommand((0.5,) + (0.0,) * 5)
        bench.run(0.3, turn, 2.5e-4)
        bench.now_s += 0.5
        bench.run(0.1, turn, 2.5e-4)
        bench.verdicts = [INVALID, INVALID]
        for _ in range(3):
            bench.start()
        assert bench.motion.ended == ""
        assert bench.points[-1][2] == SUCCESS

    def test_a_start_that_is_refused_for_ever_ends(self):
        bench = Bench(PointStream)
        bench.verdicts = [INVALID] * 9
        for _ in range(6):
            bench.start()
        assert len(bench.points) == 4
        assert bench.motion.ended

    def test_drives_that_the_first_point_wakes_are_waited_for(self):
        bench = Bench(PointStream).start()
        for ends in (False, True):
            bench.publish(drives_powered=0)
            assert bench.motion.ends_by_status() is ends
            bench.now_s += 0.07

    def test_a_controller_that_is_not_ready_ends_it_in_words(self):
        bench = Bench(PointStream).start()
        bench.verdicts = [SUCCESS, NOT_READY]
        bench.run(0.2, moved(0.2))
        assert "alarm" in bench.motion.ended.lower()

    def test_a_pause_of_this_computer_is_an_underrun_and_piles_nothing_up(self):
        bench = Bench(PointStream).start()
        bench.run(0.3, JointVelocityCommand((0.5,) + (0.0,) * 5), 2.5e-4)
        before = len(bench.points)
        bench.now_s += 0.5
        bench.run(0.1, JointVelocityCommand((0.5,) + (0.0,) * 5), 2.5e-4)
        assert bench.counters.underruns == 1
        assert len(bench.points) - before <= 7
        assert bench.count() <= 9

    def test_a_rest_is_no_underrun(self):
        bench = Bench(PointStream).start()
        bench.run(0.3, HoldCommand())
        bench.now_s += 0.5
        bench.run(0.1, HoldCommand())
        assert bench.counters.underruns == 0

    def test_it_has_settled_when_all_was_played(self):
        bench = Bench(PointStream).start()
        bench.run(0.3, JointVelocityCommand((0.5,) + (0.0,) * 5))
        assert not bench.motion.settled(bench.now_s)
        while not bench.motion.at_rest:
            bench.run(1e-3, HoldCommand())
        assert not bench.motion.settled(bench.now_s)
        bench.now_s = bench.empty_s + 5 * IPC_S
        assert bench.motion.settled(bench.now_s)

    @pytest.mark.parametrize("rests", [True, pytest.param(False, marks=pytest.mark.matrix)])
    def test_a_new_trajectory_is_begun_before_times_become_coarse(self, rests):
        """At rest if the arm rests in time, else after braking."""
        bench = Bench(PointStream, point_spacing_s=0.2).start()
        limit_ms = RENEW_TIME_MS if rests else LAST_TIME_MS
        motion, swing = bench.motion, 0
        while not bench.counters.restarts:
            assert bench.points[-1][1].time * 1e3 < limit_ms + 20_000
            bench.points = bench.points[-2:]
            motion.advance(bench.now_s)
            bench.serve()
            if motion.due(bench.now_s):
                swing += 1
                speed = 0.0 if rests else 0.1 * (-1.0) ** (swing // 2)
                command = JointVelocityCommand((speed,) + (0.0,) * 5)
                motion.command(command, bench.now_s)
                bench.serve()
            bench.now_s = max(bench.now_s + 1e-3, min(motion.next_s, bench.now_s + 1.0))
        last = bench.accepted()[-1]
        assert last.vel == joints10(())
        assert last.time * 1e3 >= limit_ms
        bench.position = list(last.pos[:6])
        bench.points.clear()
        bench.now_s = bench.empty_s + 0.05
        bench.publish()
        assert motion.waiting
        motion.advance(bench.now_s)
        bench.serve()
        assert motion.waiting == ""
        ((_, first, _),) = bench.points
        assert (first.sequence, int(first.time * 1e3)) == (0, 0)
        assert first.pos == last.pos
        bench.run(0.5, HoldCommand())
        assert [p.sequence for p in bench.accepted()][:3] == [0, 1, 2]


class TestVelocityStream:
    def start(self, **options):
        bench = Bench(VelocityStream, mode="velocity", **options)
        bench.run(0.01, HoldCommand(), 1e-3)
        bench.start()
        return bench

    def test_it_is_armed_with_zero_and_fed_while_the_controller_gets_ready(self):
        bench = Bench(VelocityStream, mode="velocity")
        bench.run(0.02, HoldCommand(), 1e-3)
        assert bench.motion.waiting
        sequences = [body.sequence for _, body in bench.velocities]
        assert sequences == [0, 1, 2, 3, 4]
        assert all(body.vel == joints10(()) for _, body in bench.velocities)
        bench.start()
        assert bench.motion.waiting == ""

    def test_a_refused_first_command_is_followed_by_no_other(self):
        bench = Bench(VelocityStream, mode="velocity")
        bench.verdicts = [NOT_READY]
        bench.run(0.02, HoldCommand(), 1e-3)
        assert [body.sequence for _, body in bench.velocities] == [0]
        assert "alarm" in bench.motion.ended.lower()

    def test_a_controller_that_never_gets_ready_ends_it(self):
        bench = Bench(VelocityStream, mode="velocity")
        bench.publish(motion_possible=0)
        bench.run(1.1, HoldCommand())
        assert "does not allow" in bench.motion.ended

    def test_commands_come_every_period_with_rising_sequence_and_time(self):
        bench = self.start()
        bench.velocities.clear()
        instants = bench.run(0.4, JointVelocityCommand((0.2,) + (0.0,) * 5), 2e-4)
        assert 98 <= instants <= 101
        bodies = [body for _, body in bench.velocities]
        assert all(b.sequence == a.sequence + 1 for a, b in pairwise(bodies))
        assert all(b.time > a.time for a, b in pairwise(bodies))
        assert all(body.valid_fields == 13 for body in bodies)
        assert all(body.acc == joints10(bench.guide.accelerations) for body in bodies)
        assert bodies[-1].vel[0] == pytest.approx(0.2)
        bench.run(0.4, JointVelocityCommand((9e-6,) * 6), 2e-4)
        assert bench.velocities[-1][1].vel == joints10(())
        for a, b in pairwise(bodies):
            assert abs(b.vel[0] - a.vel[0]) <= 10.0 * 0.0041

    def test_some_commands_ask_what_was_limited(self):
        bench = self.start(reply_every=10)
        bench.run(0.4, HoldCommand(), 2e-4)
        counters = bench.counters
        assert counters.speed_limited == pytest.approx(10, abs=2)
        assert counters.acceleration_limited == 0
        assert counters.range_limited == counters.speed_limited
        assert counters.overwritten == 2 * counters.speed_limited
        assert counters.command_age_s == pytest.approx(0.003)

    def test_a_late_computer_leaves_instants_out(self):
        bench = self.start()
        bench.run(0.1, HoldCommand(), 1e-3)
        bench.now_s += 0.0185
        period_s = bench.motion.due(bench.now_s)
        assert period_s == pytest.approx(0.020, abs=0.0041)
        assert bench.motion.due(bench.now_s) == 0.0
        assert bench.counters.skipped_instants >= 3

    def test_a_latched_watchdog_ends_it_in_words(self):
        bench = self.start(reply_every=5)
        bench.verdicts = [(5, 5041)]
        bench.run(0.1, HoldCommand())
        assert bench.motion.ended

    def test_the_guide_is_set_to_where_the_arm_is_and_commands_nothing_by_that(self):
        bench = self.start()
        bench.position[0] += 0.03
        for _ in range(60):
            bench.publish()
            bench.run(0.025, HoldCommand())
        assert bench.counters.replaced > 10
        assert bench.guide.reference == pytest.approx(bench.position, abs=0.0041)
        assert all(body.vel == joints10(()) for _, body in bench.velocities)
        assert not bench.motion.ended

    def test_the_faster_the_guide_moves_the_faster_it_is_set(self):
        bench = self.start()
        turn = JointVelocityCommand((0.2,) + (0.0,) * 5)
        bench.run(0.4, turn)
        for _ in range(40):
            before = bench.guide.reference[0]
            bench.position[0] = before + 0.05
            bench.publish()
            bench.run(0.02, turn)
        set_by = bench.guide.reference[0] - before - 0.2 * 0.02
        assert set_by == pytest.approx((0.05 + 0.2) * 0.02, rel=0.1)

    def test_one_wrong_feedback_changes_next_to_nothing(self):
        bench = self.start()
        before = list(bench.guide.reference)
        bench.position[0] += 0.3
        bench.publish()
        bench.run(0.02, HoldCommand())
        bench.position[0] -= 0.3
        bench.publish()
        bench.run(0.1, HoldCommand())
        assert bench.guide.reference == pytest.approx(before, abs=0.002)
        assert not bench.motion.ended

    def test_an_arm_that_is_lost_for_long_ends_it_in_words(self):
        bench = self.start()
        bench.position[0] += 0.5
        for _ in range(30):
            bench.publish()
            bench.run(0.025, HoldCommand())
        assert "joint 1 is 0.5" in bench.motion.ended

    def test_what_was_lost_is_made_up_for_slowly(self):
        bench = self.start()
        goal = list(bench.position)
        bench.guide.relocate([goal[0] - 0.1, *goal[1:]])
        bench.velocities.clear()
        bench.run(0.2, JointCommand(tuple(goal), (0.0,) * 6))
        fastest = max(abs(body.vel[0]) for _, body in bench.velocities)
        assert 0.1 < fastest <= 0.2 + 1e-6

    def test_missed_periods_count_at_the_speed_there_was(self):
        bench = self.start()
        bench.run(0.4, JointVelocityCommand((0.2,) + (0.0,) * 5))
        before = bench.guide.reference[0]
        bench.now_s += 0.06
        period_s = bench.motion.due(bench.now_s)
        bench.motion.command(HoldCommand(), bench.now_s)
        coasted = bench.guide.reference[0] - before
        assert coasted == pytest.approx(0.2 * (period_s - 0.004) + 0.2 * 0.004, abs=4e-4)
        assert bench.velocities or bench.motion.topics

    def test_positions_are_followed_by_speeds(self):
        bench = self.start()
        bench.publish(in_motion=1)
        bench.run(1.0, moved(0.3), 5e-4)
        way = sum(
            0.5 * 0.004 * (a.vel[0] + b.vel[0]) for (_, a), (_, b) in pairwise(bench.velocities)
        )
        assert way == pytest.approx(0.3, abs=5e-3)  # a dropped period counts twice
        assert bench.velocities[-1][1].vel[0] == pytest.approx(0.0, abs=1e-6)
