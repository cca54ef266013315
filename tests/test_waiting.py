"""Actions interrupted by a pause of the computer are repeated; other results are final."""

import pytest

from cardan.errors import MotionRefusedError
from tests.waiting import TRIES, done_again

PAUSED = "this computer or the network stalled for 0.1 s"


def acts(*outcomes):
    """Return an action with these outcomes in sequence, including errors, and the list of its
    calls."""
    done, left = [], list(outcomes)

    def act():
        done.append(outcome := left.pop(0))
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    return act, done


def test_it_is_done_again_while_the_session_says_so():
    act, done = acts(PAUSED, MotionRefusedError(f"movl: {PAUSED}"), "arrived", "not asked for")
    assert done_again(act) == "arrived"
    assert len(done) == 3


def test_a_robot_that_moves_still_after_that_is_waited_for():
    moves = MotionRefusedError("movj: wrist_3_joint moves already, at -0.105 rad/s")
    act, done = acts(PAUSED, moves, moves, "arrived")
    assert done_again(act) == "arrived"
    assert len(done) == 4
    with pytest.raises(MotionRefusedError, match="moves already"):
        done_again(acts(moves, "arrived")[0])


def test_another_outcome_is_the_tests():
    assert done_again(acts("out of reach", "")[0]) == "out of reach"
    with pytest.raises(MotionRefusedError, match="out of reach"):
        done_again(acts(MotionRefusedError("movl: out of reach"), "")[0])


def test_a_computer_that_always_stands_still_is_a_failure():
    act, done = acts(*[(1, PAUSED)] * (TRIES + 1))
    with pytest.raises(AssertionError, match=f"{TRIES} times: {PAUSED}"):
        done_again(act, reason=lambda reported: reported[1])
    assert len(done) == TRIES
