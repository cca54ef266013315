"""All requests are carried out outside of the loop, and answered."""

import json
import queue
import select
import socket
import threading
import time
from types import SimpleNamespace

import pytest

from cardan.errors import MotionLoopError, MotionRefusedError
from cardan.gateway.arm.backlog import STALE_S, STREAMED_S
from cardan.gateway.arm.loop_link import LoopLink
from cardan.gateway.arm.requests import (
    LATE_S,
    MotionNote,
    PacketError,
    Request,
    decode_answer,
    encode_request,
    result_of,
)
from cardan.gateway.arm.verb_results import Motion, Outcome
from cardan.gateway.arm.vocab import Begins, Stream
from cardan.gateway.session.stop_and_requests import (
    MAX_PENDING,
    MAX_WAITS,
    ChannelClient,
    RequestWorker,
)

POSE = [0.4, 0.1, 0.3, 0.0, 0.0, 0.0]
TIMEOUT_S = 5.0


class FakeVerbs:
    """Plans until the test lets it continue; stores streamed commands."""

    controller = SimpleNamespace(record_request=lambda *_: None)

    def __init__(self):
        self.planning, self.go_on = threading.Event(), threading.Event()
        self.began, self.streamed, self.given = [], [], []
        self.streams = SimpleNamespace(kind=Stream.NONE)
        self.stopped, self.reasons, self.sources = 0, [], []
        self.released = []
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

    def movv(self, xdot, source):
        motion = Motion("movv", False, source)
        motion.outcome = Outcome.RUNNING
        self.waited_for = motion
        self.began.append(motion)
        return motion

    def stream(self, verb, x, owner, sequence, stamp_s, begins):
        self.streamed.append((verb, x, owner, sequence))
        self.given.append((stamp_s, begins))
        return ""

    def goes_on(self, _begins, _source):
        return False

    def may_choose(self, _verb, _begins, _source):
        return self.streams.kind is Stream.NONE

    def stat(self):
        raise MotionRefusedError("stat: no state of the robot was received yet")

    def release(self, source):
        self.released.append(source)
        if self.waited_for is not None and self.waited_for.source == source:
            self.waited_for.outcome = Outcome.ABORTED

    def get_parameters(self):
        raise ZeroDivisionError

    def get_parameter(self, _key):
        return 1.0

    def brake(self, reason, source):
        self.reasons.append(reason)
        self.sources.append(source)
        self.stop()

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
        self.worker = RequestWorker(self.link, self.make, self.verbs.brake, lambda: self.now_s)
        self.client = ChannelClient(self.theirs)
        self.link.begin()

    def make(self):
        self.made += 1
        return self.verbs

    def ask(self, number, verb, value=None, sequence=None, source="a"):
        packet = encode_request(Request(number, source, verb, value, sequence))
        self.offer(packet)

    def plan(self, number, **more):
        """Request a motion; return while it is being planned."""
        self.ask(number, "movl", POSE, **more)
        assert self.verbs.planning.wait(TIMEOUT_S)

    def offer(self, packet):
        self.worker.offer(self.client, packet, self.now_s)

    def heard(self, verb=""):
        """Next reply as its result or error."""
        answer = decode_answer(self.ours.recv(65536))
        if isinstance(answer, MotionNote):
            return answer
        result = result_of(verb, answer.result) if verb and not answer.error else answer.result
        return answer.id, answer.error or result


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
    bench.plan(1)
    bench.ask(2, "movj", POSE)
    bench.ask(3, "stop")
    assert bench.heard() == (3, None)
    assert bench.verbs.stopped == 1
    assert bench.verbs.sources == ["a"]
    bench.verbs.go_on.set()
    number, motion = bench.heard("movl")
    assert number == 1
    assert motion.outcome is Outcome.ABORTED
    assert bench.verbs.stopped == 2
    assert bench.verbs.sources == ["a", ""], "one stop, counted once"
    number, error = bench.heard()
    assert number == 2
    assert "stopped before it began" in str(error)
    assert len(bench.verbs.began) == 1


def test_what_a_source_asked_for_before_it_gave_up_its_authority_does_not_begin(bench):
    bench.plan(1, source="a")
    for number, source in enumerate("ab", 2):
        bench.ask(number, "movj", POSE, source=source)
    bench.ask(4, "release", source="a")
    assert bench.heard() == (4, None)
    bench.verbs.go_on.set()
    number, motion = bench.heard("movl")
    assert (number, motion.outcome) == (1, Outcome.ABORTED)
    assert bench.verbs.released == ["a", "a"]
    number, error = bench.heard()
    assert number == 2
    assert "gave up its authority before it began" in str(error)
    number, motion = bench.heard("movj")
    assert (number, motion.outcome) == (3, Outcome.RUNNING)
    assert bench.verbs.stopped == 0
    bench.ask(5, "movj", POSE, source="a")
    assert bench.heard("movj")[1].outcome is Outcome.RUNNING


@pytest.mark.parametrize("meanwhile", ["release", "stop"])
def test_a_stream_does_not_begin_when_its_source_released_or_stopped_the_arm(bench, meanwhile):
    bench.plan(1, source="b")
    client = Watched()
    bench.worker.offer(client, Request(1, "a", "twist", POSE, begins=Begins.NEW), bench.now_s)
    bench.ask(2, meanwhile, source="a")
    assert bench.heard() == (2, None)
    bench.verbs.go_on.set()
    assert client.heard.get(timeout=TIMEOUT_S) == ("done", "twist")
    assert bench.verbs.streamed == []


def test_a_motion_tells_of_its_end_before_what_is_answered_after(bench):
    bench.verbs.go_on.set()
    bench.ask(1, "movl", POSE)
    number, begun = bench.heard("movl")
    assert (number, begun.outcome, begun.source) == (1, Outcome.RUNNING, "a")
    bench.worker.run_due()
    bench.verbs.waited_for.outcome = Outcome.DONE
    bench.ask(2, "wait", 0.0)
    note = bench.heard()
    assert (note.id, note.outcome) == (begun.id, Outcome.DONE)
    assert bench.heard() == (2, True)


def test_a_motions_end_is_reported_without_being_asked(bench):
    bench.verbs.go_on.set()
    bench.ask(1, "movl", POSE)
    _, begun = bench.heard("movl")
    bench.verbs.waited_for.outcome = Outcome.DONE
    while not select.select([bench.ours], [], [], 0.001)[0]:
        bench.worker.run_due()
    assert bench.heard() == begun._replace(outcome=Outcome.DONE)


def test_a_streamed_command_that_waited_behind_a_plan_is_not_acted_on(bench):
    bench.plan(1)
    bench.ask(2, "pose", POSE)
    bench.now_s += 2.0 * STALE_S
    bench.verbs.go_on.set()
    bench.heard()
    number, why = bench.heard()
    assert number == 2
    assert "it waited" in why
    assert bench.verbs.streamed == []


@pytest.mark.parametrize("verb", ["movl", "movv"])
def test_a_motion_that_was_asked_for_while_the_session_stood_still_is_not_begun(bench, verb):
    bench.verbs.go_on.set()
    bench.worker.turn(bench.now_s)
    bench.now_s += 1.5 * LATE_S
    bench.worker.turn(bench.now_s)
    bench.ask(1, verb, POSE)
    number, error = bench.heard(verb)
    assert (number, type(error)) == (1, MotionRefusedError)
    assert f"stalled for {1.5 * LATE_S:.1f} s" in str(error)
    assert bench.verbs.began == []
    bench.now_s += 0.5 * LATE_S
    bench.worker.turn(bench.now_s)
    bench.ask(2, verb, POSE)
    assert bench.heard(verb)[1].outcome is Outcome.RUNNING
    assert len(bench.verbs.began) == 1


def test_what_came_before_the_session_had_begun_begins_no_motion(bench):
    bench.verbs.go_on.set()
    bench.worker.turn(bench.now_s)
    bench.ask(1, "movl", POSE)
    assert "before the session had begun" in str(bench.heard("movl")[1])
    bench.ask(2, "twist", POSE, 4)
    assert "it waited" in bench.heard()[1]
    bench.ask(3, "stop")
    assert bench.heard() == (3, None)
    assert bench.verbs.began == bench.verbs.streamed == []
    assert bench.verbs.stopped == 1


def test_a_streamed_command_of_a_time_without_a_turn_is_not_acted_on(bench):
    bench.worker.turn(bench.now_s)
    bench.now_s += 2.0 * STALE_S
    bench.worker.turn(bench.now_s)
    bench.ask(1, "twist", POSE, 4)
    assert "it waited" in bench.heard()[1]
    assert bench.verbs.streamed == []


@pytest.mark.parametrize("verb", ["twist", "movl"])
def test_what_waited_before_it_came_to_the_session_counts(bench, verb):
    """The wait may be at the daemon's socket, and in the channel behind it while the session was
    busy."""
    bench.verbs.go_on.set()
    bench.worker.turn(bench.now_s)
    longest_s = STREAMED_S if verb == "twist" else LATE_S
    for number, waited_s in enumerate((1.1 * longest_s, 0.9 * longest_s), 1):
        bench.worker.turn(bench.now_s)
        request = Request(number, "a", verb, POSE, since_s=bench.now_s - waited_s)
        bench.offer(encode_request(request))
        answer = str(bench.heard(verb))
        assert ("it waited" in answer or "stalled" in answer) is (number == 1)
    assert len(bench.verbs.streamed) + len(bench.verbs.began) == 1


def test_refusals_and_what_is_no_request_are_answered(bench):
    bench.ask(1, "stat")
    number, error = bench.heard()
    assert (number, type(error)) == (1, MotionRefusedError)
    bench.offer(b'{"id":2,"source":"a","verb":"movj","value":3}')
    number, error = bench.heard()
    assert (number, type(error)) == (2, MotionRefusedError)
    bench.offer(b"\xff{")
    number, error = bench.heard()
    assert (number, type(error)) == (None, PacketError)
    assert bench.worker.refusals() == {"malformed": 2, "verb": 1, "busy": 0}


def test_a_mistake_of_ours_is_an_answer_too(bench):
    bench.ask(1, "get_parameters")
    assert "ZeroDivisionError" in str(bench.heard()[1])
    bench.ask(2, "get_parameter", "cpts")
    assert bench.heard() == (2, 1.0)


def test_a_client_with_a_mistake_does_not_end_the_worker(bench):
    class Broken:
        refusals = queue.Queue()

        def decode(self, packet):
            raise ZeroDivisionError

        def refused(self, number, error):
            self.refusals.put((number, str(error)))

    broken = Broken()
    bench.worker.offer(broken, b"", bench.now_s)
    assert broken.refusals.get(timeout=TIMEOUT_S) == (None, "ZeroDivisionError()")
    bench.ask(1, "stop")
    assert bench.heard("stop") == (1, None)
    assert bench.worker.refusals()["malformed"] == 1


def test_too_many_requests_are_refused(bench):
    bench.plan(0)
    for number in range(1, MAX_PENDING + 2):
        bench.ask(number, "movl", POSE)
    number, error = bench.heard()
    assert number == MAX_PENDING + 1
    assert "are waiting already" in str(error)
    assert bench.worker.refusals()["busy"] == 1
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
    bench.offer(json.dumps({"id": 1, "source": "a", "verb": "stat"}).encode())
    assert "no [arm]" in str(bench.heard()[1])
    bench.ask(2, "stop")
    assert bench.heard() == (2, None)


class Watched:
    """A client on the network, whose requests know if it is still there."""

    def __init__(self):
        self.there = True
        self.heard = queue.Queue()

    def decode(self, packet):
        return packet._replace(there=lambda: self.there)

    def done(self, request, result):
        self.heard.put(("done", request.verb))

    def refused(self, number, error):
        self.heard.put(("refused", str(error)))

    def ended(self, note):
        self.heard.put(("ended", note.outcome, note.reason))


def begin(bench, client, verb, value):
    bench.worker.offer(client, Request(1, "ros2", verb, value), bench.now_s)
    return client.heard.get(timeout=TIMEOUT_S)


def test_a_motion_without_end_ends_with_who_asked_for_it(bench):
    client = Watched()
    assert begin(bench, client, "movv", POSE) == ("done", "movv")
    bench.worker.run_due()
    assert bench.verbs.reasons == []
    client.there = False
    bench.worker.run_due()
    assert bench.verbs.reasons == ["the node that sent the request is gone"]
    bench.worker.run_due()
    assert client.heard.get(timeout=TIMEOUT_S)[:2] == ("ended", Outcome.ABORTED)
    assert len(bench.verbs.reasons) == 1


def test_a_stream_that_begins_waits_for_what_is_planned_and_one_that_goes_on_does_not(bench):
    bench.plan(1)
    client = Watched()
    first = Request(1, "ros2", "twist", POSE, begins=Begins.NEW)
    bench.worker.offer(client, first, bench.now_s)
    bench.ask(2, "get_parameter", "cpf")
    assert bench.heard() == (2, 1.0)  # the earlier request has been processed
    bench.verbs.streams.kind = Stream.TWIST
    second = first._replace(source="another", stamp_s=5.0)
    bench.worker.offer(client, second, bench.now_s)
    assert client.heard.get(timeout=TIMEOUT_S) == ("done", "twist")
    bench.verbs.go_on.set()
    assert client.heard.get(timeout=TIMEOUT_S) == ("done", "twist")
    assert bench.verbs.given == [(5.0, Begins.NEW), (None, Begins.NEW)]


def test_the_commands_of_a_stream_that_begins_keep_their_order(bench):
    """The stream has begun, but some of its commands are still queued: newer ones of the same
    sender must not overtake them."""
    bench.plan(0)
    client = Watched()
    first = Request(1, "ros2", "twist", POSE, stamp_s=1.0, begins=Begins.NEW)
    bench.worker.offer(client, first, bench.now_s)
    bench.ask(2, "get_parameter", "cpf")
    assert bench.heard() == (2, 1.0)  # the earlier request has been processed
    bench.verbs.streams.kind = Stream.TWIST
    bench.worker.offer(client, first._replace(stamp_s=2.0), bench.now_s)
    bench.ask(3, "get_parameter", "cpf")
    assert bench.heard() == (3, 1.0)
    assert bench.verbs.given == []
    bench.verbs.go_on.set()
    for _ in range(2):
        assert client.heard.get(timeout=TIMEOUT_S) == ("done", "twist")
    assert [stamp_s for stamp_s, _ in bench.verbs.given] == [1.0, 2.0]
    bench.worker.offer(client, first._replace(stamp_s=3.0), bench.now_s)
    assert client.heard.get(timeout=TIMEOUT_S) == ("done", "twist")


def test_a_motion_that_ends_by_itself_outlives_who_asked_for_it(bench):
    bench.verbs.go_on.set()
    client = Watched()
    assert begin(bench, client, "movl", POSE) == ("done", "movl")
    client.there = False
    bench.worker.run_due()
    assert bench.verbs.reasons == []


def test_a_motion_without_end_does_not_begin_for_who_is_gone(bench):
    client = Watched()
    client.there = False
    reported = begin(bench, client, "movv", POSE)
    assert reported == ("refused", "movv: the node that sent the request is gone")
    assert bench.verbs.began == []


def test_a_motion_that_was_canceled_before_its_turn_does_not_begin(bench):
    bench.plan(1)
    client, wanted = Watched(), [True]
    request = Request(2, "ros2", "movj", POSE, wanted=lambda: wanted[0])
    bench.worker.offer(client, request, bench.now_s)
    wanted[0] = False
    bench.verbs.go_on.set()
    reported = client.heard.get(timeout=TIMEOUT_S)
    assert reported == ("refused", "movj: it was canceled before it began")
    assert [each.verb for each in bench.verbs.began] == ["movl"]
    assert bench.verbs.stopped == 0


def test_the_end_of_a_later_motion_does_not_wait_for_who_asked_before(bench):
    client, other = Watched(), Watched()
    begin(bench, client, "movv", POSE)
    bench.verbs.began[0].outcome = Outcome.ABORTED  # the next motion took over
    begin(bench, other, "movv", POSE)
    client.there = False
    bench.worker.run_due()
    assert bench.verbs.reasons == []
