"""Requests are carried out beside the loop, and answered, whatever they are."""

import json
import select
import socket
import threading
import time

import pytest

from cardan.errors import MotionLoopError, MotionRefusedError
from cardan.gateway.arm.link import LoopLink
from cardan.gateway.arm.motion import Motion, Outcome
from cardan.gateway.session.requests import (
    MotionNote,
    PacketError,
    Request,
    decode_answer,
    encode_request,
    result_of,
)
from cardan.gateway.session.worker import MAX_PENDING, MAX_WAITS, STALE_S, RequestWorker

POSE = [0.4, 0.1, 0.3, 0.0, 0.0, 0.0]
TIMEOUT_S = 5.0


class FakeVerbs:
    """Plans until it is let go on; streams are taken down."""

    def __init__(self):
        self.planning, self.go_on = threading.Event(), threading.Event()
        self.began, self.streamed = [], []
        self.stopped = 0
        self.waited_for = None
        self.stamp_s = 0.0

    def movl(self, xd, source):
        self.planning.set()
        assert self.go_on.wait(TIMEOUT_S)
        motion = Motion("movl", True, source)
        motion.outcome = Outcome.RUNNING
        self.waited_for = motion
        self.began.append(motion)
        return motion

    movj = movl

    def stream(self, verb, x, owner, sequence):
        self.streamed.append((verb, x, owner, sequence))
        return ""

    def stat(self):
        raise MotionRefusedError("stat: nothing was heard of the robot yet")

    def get_parameters(self):
        raise ZeroDivisionError

    def get_parameter(self, _key):
        return 1.0

    def stop(self):
        self.stopped += 1
        if self.waited_for is not None:
            self.waited_for.outcome = Outcome.ABORTED


class Bench:
    """A worker, its loop's side, and a client's end of the channel."""

    def __init__(self):
        self.ours, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.ours.settimeout(TIMEOUT_S)
        self.theirs.setblocking(False)
        self.verbs, self.link, self.made = FakeVerbs(), LoopLink(), 0
        self.now_s = 100.0
        self.worker = RequestWorker(
            self.theirs, self.link, self.make, self.verbs.stop, lambda: self.now_s
        )
        self.link.begin()

    def make(self):
        self.made += 1
        return self.verbs

    def ask(self, number, verb, value=None, sequence=None, source="a"):
        self.worker.offer(
            encode_request(Request(number, source, verb, value, sequence)), self.now_s
        )

    def heard(self, verb=""):
        """The next answer; a reply as its result or error."""
        answer = decode_answer(self.ours.recv(65536))
        if isinstance(answer, MotionNote):
            return answer
        return answer.id, answer.error or result_of(verb, answer.result)


@pytest.fixture
def bench():
    bench = Bench()
    yield bench
    bench.verbs.go_on.set()
    bench.link.end("the loop has ended")
    bench.worker.close()
    bench.ours.close()
    bench.theirs.close()


def test_nothing_is_made_before_anybody_asks(bench):
    assert not bench.worker.busy
    assert bench.made == 0
    bench.ask(1, "twist", POSE, 4)
    assert bench.heard() == (1, "")
    assert bench.verbs.streamed == [("twist", POSE, "a", 4)]
    assert bench.made == 1
    bench.ask(2, "twist", POSE, source="verbs")
    assert bench.heard() == (2, "")
    assert bench.verbs.streamed[1] == ("twist", POSE, "", None)
    assert bench.made == 1


def test_a_stop_acts_at_once_while_another_request_is_planned(bench):
    bench.ask(1, "movl", POSE)
    assert bench.verbs.planning.wait(TIMEOUT_S)
    bench.ask(2, "movj", POSE)
    bench.ask(3, "stop")
    assert bench.heard() == (3, None)
    assert bench.verbs.stopped == 1
    bench.verbs.go_on.set()
    number, motion = bench.heard("movl")
    assert number == 1
    assert motion.outcome is Outcome.ABORTED
    assert bench.verbs.stopped == 2
    number, error = bench.heard()
    assert number == 2
    assert "stopped before it began" in str(error)
    assert len(bench.verbs.began) == 1


def test_a_motion_tells_of_its_end_before_what_is_answered_after(bench):
    bench.verbs.go_on.set()
    bench.ask(1, "movl", POSE)
    number, begun = bench.heard("movl")
    assert (number, begun.outcome, begun.source) == (1, Outcome.RUNNING, "a")
    bench.worker.attend()
    bench.verbs.waited_for.outcome = Outcome.DONE
    bench.ask(2, "wait", 0.0)
    note = bench.heard()
    assert (note.id, note.outcome) == (begun.id, Outcome.DONE)
    assert bench.heard() == (2, True)


def test_a_motions_end_is_told_without_being_asked(bench):
    bench.verbs.go_on.set()
    bench.ask(1, "movl", POSE)
    _, begun = bench.heard("movl")
    bench.verbs.waited_for.outcome = Outcome.DONE
    while not select.select([bench.ours], [], [], 0.001)[0]:
        bench.worker.attend()
    assert bench.heard() == begun._replace(outcome=Outcome.DONE)


def test_a_streamed_command_that_waited_behind_a_plan_is_not_acted_on(bench):
    bench.ask(1, "movl", POSE)
    assert bench.verbs.planning.wait(TIMEOUT_S)
    bench.ask(2, "pose", POSE)
    bench.now_s += 2.0 * STALE_S
    bench.verbs.go_on.set()
    bench.heard()
    number, why = bench.heard()
    assert number == 2
    assert "it waited" in why
    assert bench.verbs.streamed == []


def test_refusals_and_what_is_no_request_are_answered(bench):
    bench.ask(1, "stat")
    number, error = bench.heard()
    assert (number, type(error)) == (1, MotionRefusedError)
    bench.worker.offer(b'{"id":2,"source":"a","verb":"movj","value":3}', 100.0)
    number, error = bench.heard()
    assert (number, type(error)) == (2, MotionRefusedError)
    bench.worker.offer(b"\xff{", 100.0)
    number, error = bench.heard()
    assert (number, type(error)) == (None, PacketError)
    assert bench.worker.malformed == 2


def test_a_mistake_of_ours_is_an_answer_too(bench):
    bench.ask(1, "get_parameters")
    assert "ZeroDivisionError" in str(bench.heard()[1])
    bench.ask(2, "get_parameter", "cpts")
    assert bench.heard() == (2, 1.0)


def test_too_many_requests_are_refused(bench):
    bench.ask(0, "movl", POSE)
    assert bench.verbs.planning.wait(TIMEOUT_S)
    for number in range(1, MAX_PENDING + 2):
        bench.ask(number, "movl", POSE)
    number, error = bench.heard()
    assert number == MAX_PENDING + 1
    assert "are waiting already" in str(error)
    bench.ask(99, "stop")
    assert bench.heard() == (99, None)


def test_waits_do_not_hold_each_other_up_and_end_with_the_loop(bench):
    bench.verbs.go_on.set()
    bench.ask(0, "movl", POSE)
    bench.heard()
    for number in range(1, MAX_WAITS + 2):
        bench.ask(number, "wait", 0.0)
    number, error = bench.heard()
    assert number == MAX_WAITS + 1
    assert "are waiting already" in str(error)
    bench.link.end("the robot is closed")
    answers = [bench.heard() for _ in range(MAX_WAITS)]
    assert {number for number, _ in answers} == set(range(1, MAX_WAITS + 1))
    assert {(type(error), str(error)) for _, error in answers} == {
        (MotionLoopError, "the robot is closed")
    }


def test_a_client_that_is_gone_is_no_error(bench):
    bench.ours.close()
    bench.ask(1, "twist", POSE)
    deadline_s = time.monotonic() + TIMEOUT_S
    while not bench.verbs.streamed and time.monotonic() < deadline_s:
        threading.Event().wait(0.001)
    assert bench.verbs.streamed


def test_a_session_without_verbs_says_why(bench):
    def refuse():
        raise MotionRefusedError("this session has no [arm]")

    bench.worker._make_verbs = refuse
    bench.worker.offer(json.dumps({"id": 1, "source": "a", "verb": "stat"}).encode(), 100.0)
    assert "no [arm]" in str(bench.heard()[1])
    bench.ask(2, "stop")
    assert bench.heard() == (2, None)
