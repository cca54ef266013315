"""Every code of a MotoROS controller has a plain text."""

from __future__ import annotations

import enum
import itertools
import re

import pytest
from hypothesis import given, strategies as st

from cardan.drivers.motoros.diagnosis import io_result_in_words, reply_in_words, status_in_words
from cardan.protocols.simple_message.codes import (
    InvalidSubcode,
    IoResult,
    MessageType,
    MotionCommand,
    MotionResult,
    NotReadySubcode,
)
from cardan.protocols.simple_message.messages import RobotStatus

READY = RobotStatus(1, 0, 0, 0, 0, 2, 1)
ANSWERED = (
    *MotionCommand,
    MessageType.JOINT_TRAJ_PT_FULL,
    MessageType.MOTO_JOINT_TRAJ_PT_FULL_EX,
    MessageType.MOTO_SELECT_TOOL,
    MessageType.MOTO_GET_DH_PARAMETERS,
    MessageType.MOTO_JOINT_VELOCITY,
    MessageType.MOTO_JOINT_VELOCITY_EX,
    MessageType.MOTO_VELOCITY_INFO,
)
int32 = st.integers(-(2**31), 2**31 - 1)


def assert_own_words(words: list[str]) -> None:
    assert len(set(words)) == len(words)
    for text in words:
        assert len(text.split()) >= 3
        assert text == text.strip()
        assert "  " not in text


def reason(words: str) -> str:
    return words.split(": ", 1)[1]


@pytest.mark.parametrize(
    ("result", "subcodes"),
    [(MotionResult.INVALID, InvalidSubcode), (MotionResult.NOT_READY, NotReadySubcode)],
)
def test_every_subcode_has_its_own_words(
    result: MotionResult, subcodes: type[enum.IntEnum]
) -> None:
    words = [reply_in_words(MessageType.JOINT_TRAJ_PT_FULL, result, code) for code in subcodes]
    assert_own_words(words)
    for code, text in zip(subcodes, words, strict=True):
        assert str(code.value) not in text, "the text has words, not the number"


def test_no_two_subcodes_of_all_share_words() -> None:
    assert_own_words(
        [
            reason(reply_in_words(MotionCommand.START_TRAJ_MODE, MotionResult.NOT_READY, code))
            for code in itertools.chain(InvalidSubcode, NotReadySubcode)
        ]
    )


@pytest.mark.parametrize("command", ANSWERED)
def test_every_result_has_its_own_words(command: int) -> None:
    assert_own_words([reply_in_words(command, result, 0) for result in MotionResult])


def test_every_failure_says_what_to_make_of_it() -> None:
    words = [reply_in_words(command, MotionResult.FAILURE, 0) for command in ANSWERED]
    assert_own_words(words)
    assert_own_words([reason(text) for text in words])


@pytest.mark.parametrize("command", ANSWERED)
@pytest.mark.parametrize("result", MotionResult)
def test_a_known_command_is_named(command: int, result: MotionResult) -> None:
    assert str(int(command)) not in reply_in_words(command, result, 0)


def test_a_robot_that_is_not_ready_says_why_whichever_way_the_answer_is_written() -> None:
    asked, why = MotionCommand.CHECK_MOTION_READY, NotReadySubcode.NOT_PLAY
    words = reply_in_words(asked, MotionResult.FAILURE, why)
    assert words == "the robot is not ready: the pendant's key is on TEACH: turn it to REMOTE"
    assert "key is on TEACH" in reply_in_words(asked, MotionResult.NOT_READY, why)
    old = reply_in_words(asked, MotionResult.FAILURE, 0)
    assert "does not say why" in old


@pytest.mark.parametrize(
    ("subcode", "said"),
    [(3014, "accelerates"), (3015, "lacks"), (3016, "4 hours"), (3017, "tool"), (3012, "position")],
)
def test_the_numbers_public_decoders_have_wrong(subcode: int, said: str) -> None:
    words = reply_in_words(MessageType.JOINT_TRAJ_PT_FULL, MotionResult.INVALID, subcode)
    assert said in words


def test_a_busy_answer_says_what_is_waited_for() -> None:
    busy = MotionResult.BUSY
    assert "same point" in reply_in_words(MessageType.JOINT_TRAJ_PT_FULL, busy, 0)
    assert "trajectory" in reply_in_words(MotionCommand.START_VEL_MODE, busy, 0)


def test_unknown_numbers_are_given() -> None:
    assert "4711" in reply_in_words(4711, MotionResult.SUCCESS, 0)
    assert "unknown result 99" in reply_in_words(MotionCommand.STOP_MOTION, 99, 0)
    assert "5099" in reply_in_words(MotionCommand.START_TRAJ_MODE, MotionResult.NOT_READY, 5099)
    for subcode, said in ((77, True), (1, True), (0, False), (-1, False)):
        words = reply_in_words(MotionCommand.START_SERVOS, MotionResult.FAILURE, subcode)
        assert (f"(subcode {subcode})" in words) is said
    assert "1099" in io_result_in_words(1099)


@given(command=int32, result=int32 | st.integers(0, 6), subcode=int32 | st.integers(2999, 5050))
def test_any_reply_has_words(command: int, result: int, subcode: int) -> None:
    assert len(reply_in_words(command, result, subcode).split()) >= 4


def test_every_io_result_has_its_own_words() -> None:
    assert_own_words([f"it says: {io_result_in_words(result)}" for result in IoResult])
    assert not any(re.search(r"\b100[1-5]\b", io_result_in_words(r)) for r in IoResult)


class TestStatus:
    def test_nothing_to_say_when_motion_is_possible(self) -> None:
        assert status_in_words(READY) == ""
        assert status_in_words(READY._replace(in_motion=1)) == ""
        assert status_in_words(READY._replace(in_motion=-1, mode=-1, e_stopped=-1)) == ""

    def test_the_worst_comes_first(self) -> None:
        words = status_in_words(RobotStatus(0, 1, 4107, 1, 0, 1, 0))
        order = [words.index(part) for part in ("emergency", "alarm 4107", "TEACH", "servos are")]
        assert order == sorted(order)

    @pytest.mark.parametrize(
        ("change", "said"),
        [
            ({"e_stopped": 1}, "emergency stop"),
            ({"in_error": 1, "error_code": 4107}, "alarm 4107"),
            ({"in_error": 1, "error_code": -1}, "number the controller does not give"),
            ({"in_error": 1, "error_code": 0}, "number the controller does not give"),
            ({"mode": 1}, "turn it to REMOTE"),
            ({"drives_powered": 0}, "servos are off"),
            ({}, "enable the robot"),
            ({"e_stopped": -1}, "does not know whether an emergency stop"),
            ({"in_error": -1}, "does not know whether there is an alarm"),
            ({"mode": -1}, "does not know whether the pendant's key"),
            ({"mode": 7}, "does not know whether the pendant's key"),
            ({"drives_powered": -1}, "does not know whether the servos"),
        ],
    )
    def test_each_reason(self, change: dict[str, int], said: str) -> None:
        words = status_in_words(READY._replace(motion_possible=0, **change))
        assert said in words
        assert ";" not in words

    def test_motion_possible_may_be_unknown(self) -> None:
        words = status_in_words(READY._replace(motion_possible=-1))
        assert words == "the controller does not know whether motion is possible"

    def test_what_is_wrong_is_said_even_where_motion_is_called_possible(self) -> None:
        assert "emergency stop" in status_in_words(READY._replace(e_stopped=1))
        assert "alarm 12" in status_in_words(READY._replace(in_error=1, error_code=12))

    @given(status=st.tuples(*[st.integers(-2, 3)] * 7).map(RobotStatus._make))
    def test_silent_only_if_motion_is_possible(self, status: RobotStatus) -> None:
        if status.motion_possible <= 0:
            assert status_in_words(status)
