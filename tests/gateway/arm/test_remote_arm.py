"""An arm behind packets; the test acts as the session and sends packets in any order."""

import pytest

from cardan.errors import MotionLoopError, OptionError
from cardan.gateway.arm.remote_arm import EARLY_NOTES, RemoteArm
from cardan.gateway.arm.requests import (
    MotionNote,
    PacketError,
    Reply,
    decode_answer,
    decode_request,
    encode_reply,
)
from cardan.gateway.arm.verb_results import Outcome


def reported(answers, source="program"):
    """Return an arm that answers each request at once with the result of `answers`."""

    def connect(arm):
        def send(request, packet):
            assert decode_request(packet).id == request.id
            for answer in answers(request):
                arm._take_answer(answer)

        arm.begin(send)
        return lambda: None

    return RemoteArm(connect, source)


def note(number, outcome=Outcome.RUNNING, reason=""):
    return MotionNote(number, "movl", "program", True, outcome, reason, "", 1.0)


def begun(number):
    return note(number)._asdict() | {"outcome": "running"}


def test_an_end_that_is_reported_before_the_beginning_is_not_lost():
    ended = note(5, Outcome.ABORTED, "a limit")
    with reported(lambda asked: [ended, Reply(asked.id, begun(5), None)]) as arm:
        motion = arm.movl([0.0] * 6)
    assert (motion.outcome, motion.reason) == (Outcome.ABORTED, "a limit")


def test_ends_of_other_programs_motions_are_not_kept():
    others = [note(number, Outcome.DONE) for number in range(10, 10 + 2 * EARLY_NOTES)]
    with reported(lambda asked: [*others, Reply(asked.id, begun(5), None)]) as arm:
        for each in others:
            arm._take_answer(each)
        assert not arm._early
        motion = arm.movl([0.0] * 6)
        assert len(arm._early) <= EARLY_NOTES
        assert not motion.over
        arm._take_answer(note(5, Outcome.DONE))
    assert motion.outcome is Outcome.DONE


def test_stop_after_the_end_is_done_only_where_the_arm_is_known_to_rest():
    with reported(lambda _asked: []) as arm:
        arm.end("the session has ended")
        arm.stop()
        with pytest.raises(MotionLoopError, match="the session has ended"):
            arm.stat()
    with reported(lambda _asked: []) as arm:
        arm.end("the session has ended", rests=False)
        with pytest.raises(MotionLoopError, match="the session has ended"):
            arm.stop()
    arm.stop()  # already closed


@pytest.mark.parametrize("source", ["", "device", "x" * 65])
def test_a_source_has_a_name_of_its_own(source):
    with pytest.raises(OptionError, match=r"source: .* other than 'device'"):
        reported(lambda _asked: [], source)


def test_a_reply_tells_of_the_ends_before_it():
    ended = note(5, Outcome.DONE)

    def answers(asked):
        if asked.verb == "movl":
            return [Reply(asked.id, begun(5), None)]
        packet = encode_reply(asked.id, True, [ended])
        assert decode_answer(packet).ended == (ended,)
        return [decode_answer(packet)]

    with reported(answers) as arm:
        motion = arm.movl([0.0] * 6)
        assert arm.wait() is True
        assert motion.outcome is Outcome.DONE


def test_a_reply_that_is_none_is_an_error():
    with (
        reported(lambda asked: [Reply(asked.id, {"id": 5}, None)]) as arm,
        pytest.raises(PacketError, match="no answer of movl"),
    ):
        arm.movl([0.0] * 6)


def test_opened_twice_it_is_connected_once():
    calls = []

    def connect(arm):
        calls.append("connected")
        arm.begin(lambda _request, _packet: None)
        return lambda: calls.append("disconnected")

    arm = RemoteArm(connect)
    arm.close()
    assert calls == []
    for _ in range(2):
        arm.open()
        arm.open()
        arm.close()
        arm.close()
        with pytest.raises(MotionLoopError, match="not open"):
            arm.stat()
    assert calls == ["connected", "disconnected"] * 2


def test_an_arm_that_cannot_be_connected_is_not_open():
    def connect(arm):
        arm.begin(lambda _request, _packet: None)
        arm.end("its other side is gone", rests=False)
        arm.stat()

    arm = RemoteArm(connect)
    for _ in range(2):
        with pytest.raises(MotionLoopError, match="its other side is gone"):
            arm.open()
        with pytest.raises(MotionLoopError, match="not open"):
            arm.stat()
        arm.stop()  # does not move the arm
        arm.close()


def test_a_request_that_cannot_be_answered_says_why():
    def connect(arm):
        arm.begin(lambda request, _packet: arm.fail(request.id, "no room"))
        return lambda: None

    with RemoteArm(connect) as arm, pytest.raises(MotionLoopError, match="no room"):
        arm.movl([0.0] * 6)
    assert not arm._pending


def test_packets_that_are_no_answers_are_somebody_elses():
    with reported(lambda _asked: []) as arm:
        assert arm.take(encode_reply(7, None)) is True
        assert arm.take(b'{"elapsed_s": 1.0}') is False
        with pytest.raises(PacketError, match="not JSON"):
            arm.take(b'{"reply": ')
