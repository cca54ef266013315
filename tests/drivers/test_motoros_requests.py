"""Sequential requests, whose replies are accepted only if they match the request."""

import math

import pytest

from cardan.drivers.motoros.requests import MotionRequests
from cardan.protocols.simple_message.codes import MotionCommand
from cardan.protocols.simple_message.messages import (
    ZEROS,
    JointFeedback,
    JointTrajPtFull,
    JointVelocity,
    MalformedMessage,
    MotionReply,
    VelocityInfo,
    VelocityInfoRequest,
    reply,
    topic,
)

STOP, COUNT = MotionCommand.STOP_MOTION, MotionCommand.CHECK_QUEUE_CNT
POINT = JointTrajPtFull(0, 7, 7, 0.5, ZEROS, ZEROS, ZEROS)
INFO = VelocityInfo(1, 4000, 100, 0, 1, 6, ZEROS, ZEROS, ZEROS, ZEROS)


class Asked:
    """Requests whose answers are recorded."""

    def __init__(self, **options):
        self.requests = MotionRequests(0, **options)
        self.answers = []

    def control(self, command=STOP):
        self.requests.control(command, self.keep)
        return self

    def ask(self, body):
        self.requests.ask(body, self.keep)
        return self

    def keep(self, answer, now_s):
        self.answers.append((answer, now_s))

    def sent(self, now_s=0.0):
        message = self.requests.take(now_s)
        return None if message is None else message.body


def test_requests_leave_one_by_one_and_in_order():
    asked = Asked().control(STOP).control(COUNT)
    first = asked.sent()
    assert first.command == STOP
    assert asked.sent() is None
    assert not asked.requests.idle
    assert asked.requests.received(reply(MotionReply(0, first.sequence, STOP, 0, 0)), 0.01) == ""
    second = asked.sent(0.01)
    assert second.command == COUNT
    assert second.sequence != first.sequence
    assert asked.answers == [(MotionReply(0, first.sequence, STOP, 0, 0), 0.01)]
    assert not asked.requests.idle
    asked.requests.received(reply(MotionReply(0, second.sequence, COUNT, 0, 5)), 0.02)
    assert asked.requests.idle
    assert asked.requests.latency.count == 2
    assert asked.requests.latency.max == pytest.approx(0.01)


def test_a_reply_nobody_asked_for_is_not_trusted():
    assert "not asked for" in Asked().requests.received(reply(MotionReply(0, 0, STOP, 0, 0)), 0.0)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (MalformedMessage("prefix 3"), "prefix 3"),
        (reply(MotionReply(0, 1, COUNT, 0, 0)), "CHECK_QUEUE_CNT"),
        (reply(MotionReply(0, 2, STOP, 0, 0)), "sequence"),
        (topic(MotionReply(0, 1, STOP, 0, 0)), "comm_type"),
        (reply(JointFeedback(0, 2, 0.0, ZEROS, ZEROS, ZEROS)), "JOINT_FEEDBACK"),
        (reply(INFO), "VELOCITY_INFO"),
        (reply(MotionReply(-1, -1, 14, 3, 3003)), "JOINT_TRAJ_PT_FULL"),
    ],
)
def test_a_reply_to_something_else_is_named_and_not_delivered(answer, words):
    asked = Asked().control(STOP)
    asked.sent()
    assert words in asked.requests.received(answer, 0.0)
    assert asked.answers == []


def test_the_reply_before_sent_again_is_seen():
    """MotoROS repeats its last reply when it does not know a command."""
    asked = Asked().control(STOP)
    first = asked.sent()
    stale = reply(MotionReply(0, first.sequence, STOP, 0, 0))
    asked.requests.received(stale, 0.0)
    asked.control(STOP).sent()
    assert "sequence" in asked.requests.received(stale, 0.0)


def test_a_point_is_answered_by_its_type_and_sequence():
    asked = Asked().ask(POINT)
    assert asked.sent() is POINT
    assert asked.requests.received(reply(MotionReply(0, 7, 14, 1, 0)), 0.0) == ""
    assert asked.answers[0][0].result == 1


@pytest.mark.parametrize(
    "answer", [INFO, MotionReply(-1, -1, 2042, 3, 3003)], ids=["known", "unknown"]
)
def test_the_probe_takes_both_answers(answer):
    asked = Asked().ask(VelocityInfoRequest(0))
    asked.sent()
    assert asked.requests.received(reply(answer), 0.0) == ""
    assert asked.answers == [(answer, 0.0)]


def test_a_message_that_was_not_understood_is_a_reply_too():
    asked = Asked().control(STOP)
    asked.sent()
    assert asked.requests.received(reply(MotionReply(-1, -1, 2001, 3, 3001)), 0.0) == ""
    assert asked.answers[0][0].subcode == 3001


def test_time_outs_are_short_for_questions_and_long_for_starts():
    asked = Asked(timeout_s=0.5, slow_timeout_s=12.0).control(COUNT)
    assert asked.requests.deadline_s == math.inf
    asked.sent(10.0)
    assert asked.requests.deadline_s == 10.5
    assert asked.requests.overdue(10.49) == ""
    assert "CHECK_QUEUE_CNT for 0.5 s" in asked.requests.overdue(10.5)
    asked.requests.reset()
    assert asked.requests.overdue(99.0) == ""
    asked.control(MotionCommand.START_TRAJ_MODE).sent(20.0)
    assert asked.requests.deadline_s == 32.0
    asked.requests.received(reply(MotionReply(0, 2, 200121, 0, 0)), 21.0)
    assert asked.requests.latency.count == 0  # time of the robot, not of the line


def test_dropping_keeps_the_place_of_the_reply_that_is_awaited():
    velocity = JointVelocity(0, 3, 5, 0.0, ZEROS, ZEROS, ZEROS)
    asked = Asked().ask(velocity).control(STOP)
    asked.sent()
    asked.requests.drop()
    asked.control(COUNT)
    assert asked.sent() is None
    assert asked.requests.received(reply(MotionReply(0, 3, 2040, 5, 5041)), 0.0) == ""
    assert asked.answers == []
    assert asked.sent().command == COUNT
