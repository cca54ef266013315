"""An arm by packets, with a test in the session's place: packets in any order."""

import pytest

from cardan.errors import MotionLoopError, OptionError
from cardan.gateway.arm.motion import Outcome
from cardan.gateway.arm.remote_arm import EARLY_NOTES, RemotePacketArm
from cardan.gateway.arm.requests import (
    MotionNote,
    Reply,
    decode_answer,
    decode_request,
    encode_reply,
)


class Told(RemotePacketArm):
    """Answers each request at once with the result of `answers`."""

    def __init__(self, answers, source="program"):
        super().__init__(source)
        self.answers = answers
        self.asked = []

    def open(self):
        self._begin()

    def close(self):
        self._close()

    def _send(self, request, packet):
        assert decode_request(packet).id == request.id
        self.asked.append(request)
        for answer in self.answers(request):
            self._take_answer(answer)

    def end(self, **how):
        self._end("the session has ended", **how)


def note(number, outcome=Outcome.RUNNING, reason=""):
    return MotionNote(number, "movl", "program", True, outcome, reason, "", 1.0)


def begun(number):
    return note(number)._asdict() | {"outcome": "running"}


def test_an_end_that_is_told_before_the_beginning_is_not_lost():
    ended = note(5, Outcome.ABORTED, "a limit")
    with Told(lambda asked: [ended, Reply(asked.id, begun(5), None)]) as arm:
        motion = arm.movl([0.0] * 6)
    assert (motion.outcome, motion.reason) == (Outcome.ABORTED, "a limit")


def test_ends_of_other_programs_motions_are_not_kept():
    others = [note(number, Outcome.DONE) for number in range(10, 10 + 2 * EARLY_NOTES)]
    with Told(lambda asked: [*others, Reply(asked.id, begun(5), None)]) as arm:
        for each in others:
            arm._take_answer(each)
        assert not arm._early
        motion = arm.movl([0.0] * 6)
        assert len(arm._early) <= EARLY_NOTES
        assert not motion.over
        arm._take_answer(note(5, Outcome.DONE))
    assert motion.outcome is Outcome.DONE


def test_stop_after_the_end_is_done_only_where_the_arm_is_known_to_rest():
    with Told(lambda _asked: []) as arm:
        arm.end()
        arm.stop()
        with pytest.raises(MotionLoopError, match="the session has ended"):
            arm.stat()
    with Told(lambda _asked: []) as arm:
        arm.end(rests=False)
        with pytest.raises(MotionLoopError, match="the session has ended"):
            arm.stop()
    arm.stop()  # It is closed.


@pytest.mark.parametrize("source", ["", "hand", "x" * 65])
def test_a_source_has_a_name_of_its_own(source):
    with pytest.raises(OptionError, match=r"source: .* other than 'hand'"):
        Told(lambda _asked: [], source)


def test_a_reply_tells_of_the_ends_before_it():
    ended = note(5, Outcome.DONE)

    def answers(asked):
        if asked.verb == "movl":
            return [Reply(asked.id, begun(5), None)]
        packet = encode_reply(asked.id, True, [ended])
        assert decode_answer(packet).ended == (ended,)
        return [decode_answer(packet)]

    with Told(answers) as arm:
        motion = arm.movl([0.0] * 6)
        assert arm.wait() is True
        assert motion.outcome is Outcome.DONE
