"""Faults that the supervision of a robot reports, tick by tick, in virtual time."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.gateway.arm.commanded_arm import TaskSpaceArm
from cardan.gateway.arm.motions.base import GOING, CommandedMotion
from cardan.gateway.arm.supervision import (
    LONGEST_STEP_PERIODS,
    TRUST_AFTER_S,
    Cause,
    Supervision,
    Watchdogs,
)
from cardan.gateway.motion.speed_limited_reference import Reference, ReferenceLimits
from cardan.types import IDENTITY, Pose, RobotLink, RobotState, Vector3

DT_S = 0.004


class Watched:
    """A robot that is supervised once per period."""

    def __init__(self, robot_period_s=0.0, **watchdogs):
        self.supervision = Supervision(Watchdogs(**watchdogs), robot_period_s)
        self.commanded = TaskSpaceArm(ReferenceLimits())
        self.state = RobotState(
            10.0, RobotLink.LIVE, 1, 0, DT_S, (), (), self.pose(0.0), ""
        )  # fmt: skip

    @staticmethod
    def pose(x):
        return Pose(Vector3(x, 0.0, 0.4), IDENTITY)

    def look(self, after_s=DT_S, **change):
        state = self.state = self.state._replace(stamp_s=self.state.stamp_s + after_s, **change)
        return self.supervision.look(state, self.commanded)

    def compare(self, ahead_m=0.0, motion=None):
        reference = Reference(ReferenceLimits())
        reference.place(self.pose(ahead_m))
        return self.supervision.compare(self.state, self.commanded, reference, motion, True)


def ready(**watchdogs):
    watched = Watched(**watchdogs)
    assert watched.look().cause is Cause.FIRST
    assert watched.look() is None
    return watched


def test_the_first_ready_state_is_said_once():
    ready()


@pytest.mark.parametrize(
    ("change", "cause", "reason"),
    [
        ({"link": RobotLink.LOST, "hold_reason": "silent"}, Cause.LOST, "silent"),
        ({"hold_reason": "motors are off"}, Cause.NOT_READY, "motors are off"),
        ({"pose": None}, Cause.NOT_READY, "the robot reports no pose"),
        ({"pose": Watched.pose(math.nan)}, Cause.NOT_READY, "pose that is not numbers"),
        ({"pose": Watched.pose(1e9)}, Cause.NOT_READY, "farther than any"),
        ({"session": 2, "hold_reason": "motors are off"}, Cause.NEW_SESSION, "motors are off"),
    ],
)
def test_a_robot_that_is_not_ready_says_why_and_is_reported_when_it_returns(change, cause, reason):
    watched = ready()
    before = watched.state
    found = watched.look(**change)
    assert found.cause is cause
    assert reason in found.reason
    back = watched.look(link=RobotLink.LIVE, hold_reason="", pose=before.pose)
    assert back.cause is (Cause.RETURNED if watched.state.session == 1 else Cause.NEW_SESSION)
    assert watched.look() is None


def test_a_session_that_was_never_ready_is_the_first_one():
    watched = Watched()
    assert watched.look(hold_reason="motors are off").cause is Cause.NOT_READY
    assert watched.look(session=2, hold_reason="").cause is Cause.FIRST


def test_a_new_session_is_found_even_in_the_tick_of_a_stall():
    watched = ready()
    assert watched.look(1.0, session=2) == (Cause.NEW_SESSION, "")


def test_a_pause_of_this_computer_is_a_stall_only_when_it_is_long():
    watched = ready(stall_s=0.1)
    assert watched.look(0.1) is None
    assert watched.look(0.101) == (
        Cause.STALLED,
        "this computer or the network stalled for 0.1 s",
    )
    assert watched.look() is None


def test_a_reading_that_jumps_is_not_believed_until_it_is_trusted_again():
    watched = ready()
    found = watched.look(pose=watched.pose(0.3))
    assert found.cause is Cause.JUMPED
    assert "300 mm" in found.reason
    assert watched.supervision.implausible == found.reason
    assert not watched.supervision.trustworthy
    assert watched.look() is None
    assert watched.supervision.implausible  # Plausible from here on, and not yet trusted.
    for _ in range(math.ceil(TRUST_AFTER_S / DT_S)):
        watched.look()
    assert watched.supervision.trustworthy
    watched.supervision.trust()
    assert watched.supervision.implausible == ""


def test_every_jump_starts_the_wait_anew():
    watched = ready()
    watched.look(pose=watched.pose(0.3))
    for x in (0.0, 0.3, 0.0):
        watched.look(0.9 * TRUST_AFTER_S)
        watched.look(pose=watched.pose(x))
        assert not watched.supervision.trustworthy


def test_a_jump_counts_from_the_last_reading_before_a_silence():
    watched = ready()
    watched.look(link=RobotLink.LOST, hold_reason="silent", pose=None)
    found = watched.look(link=RobotLink.LIVE, hold_reason="", pose=watched.pose(0.5))
    assert found.cause is Cause.JUMPED


def test_a_new_session_may_be_anywhere():
    watched = ready()
    assert watched.look(session=2, pose=watched.pose(0.9)) == (Cause.NEW_SESSION, "")
    assert watched.supervision.implausible == ""


def test_readings_that_waited_in_a_queue_are_no_jump():
    """Two readings that arrive at once were measured one period apart."""
    watched = ready()
    assert watched.look(0.0, period_s=0.02, pose=watched.pose(0.1)) is None


def test_a_robot_that_is_held_is_found_at_the_limit_and_not_before():
    watched = ready(following_error_m=0.1)
    assert watched.compare(0.0999) is None
    found = watched.compare(0.101)
    assert found.cause is Cause.HELD
    assert "101 mm" in found.reason
    assert watched.supervision.error.linear_m == pytest.approx(0.101)


def test_an_alarm_is_found_in_the_drivers_words():
    watched = ready()
    watched.look(alarm="the port is flooded")
    assert watched.compare() == (Cause.ALARM, "the port is flooded")
    assert watched.compare(0.2).cause is Cause.HELD


class Streamed(CommandedMotion):
    silence_s = 0.1

    def __init__(self, heard_s, driven):
        self.heard_s, self._driven = heard_s, driven

    @property
    def driven(self):
        return self._driven

    def tick(self, robot, dt_s):
        return GOING

    def brake(self):
        pass


def test_silence_matters_only_where_it_lets_something_go_on():
    watched = ready()
    heard_s = watched.state.stamp_s
    watched.look(0.09)
    assert watched.compare(motion=Streamed(heard_s, True)) is None
    watched.look(0.02)
    found = watched.compare(motion=Streamed(heard_s, True))
    assert found == (Cause.SILENT, "the stream was silent for 0.110 s")
    assert watched.compare(motion=Streamed(heard_s, False)) is None


@given(st.floats(), st.floats(1e-4, 1.0))
def test_no_gap_advances_a_tick_by_more_than_its_share_of_periods(gap_s, period_s):
    watched = Watched(period_s)
    watched.look()
    watched.look(0.0, period_s=gap_s)
    step = watched.supervision.step_s
    assert 0.0 <= step <= LONGEST_STEP_PERIODS * period_s
    if 0.0 <= gap_s <= LONGEST_STEP_PERIODS * period_s:
        assert step == gap_s


def test_a_robot_of_unknown_period_advances_as_it_says():
    watched = Watched(0.0)
    watched.look(0.3, period_s=0.3)
    assert watched.supervision.step_s == 0.3


LINKS = st.sampled_from((RobotLink.LIVE,) * 4 + (RobotLink.LOST, RobotLink.WAITING))
POSES = st.one_of(st.none(), st.floats(-0.02, 0.02).map(Watched.pose), st.just(Watched.pose(3.0)))


@given(
    st.lists(
        st.tuples(
            st.floats(0.0, 0.3),
            LINKS,
            st.sampled_from(("", "", "motors")),
            st.integers(1, 3),
            POSES,
        ),
        max_size=25,
    )
)
def test_after_any_absence_a_robot_is_never_taken_for_granted(ticks):
    """A robot is usable only from the second ready tick on, in the same session, without a jump."""
    watched, before = Watched(), None
    for after_s, link, reason, session, pose in ticks:
        found = watched.look(after_s, link=link, hold_reason=reason, session=session, pose=pose)
        state = watched.state
        usable = state.ready and state.pose is not None
        if not usable:
            assert found is not None
            assert found.reason == reason or (not reason and found.reason)
            before = None
            continue
        if found is None:
            assert before is not None
            assert before.session == session
            assert watched.commanded.jump(before, state, max(after_s, DT_S)) == ""
            assert after_s <= Watchdogs().stall_s
        before = state
