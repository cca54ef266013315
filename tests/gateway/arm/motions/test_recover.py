"""Recovery of a command that lost its robot: slow, and limited in time."""

import pytest
from hypothesis import given, settings, strategies as st

from cardan.gateway.arm.commanded_arm import (
    APPROACH_SPEED_M_S,
    APPROACH_SPEED_RAD_S,
    FollowingError,
    TaskSpaceArm,
)
from cardan.gateway.arm.motions.recover import MARGIN_M, MARGIN_SHARE, Recover
from cardan.gateway.motion.speed_limited_reference import Reference, ReferenceLimits
from cardan.spatial import add, from_rotation_vector, norm, rotation_between, subtract
from cardan.types import IDENTITY_POSE, ZERO3, Pose, RobotLink, RobotState, Vector3

DT_S = 0.004
LIMITS = ReferenceLimits()
NEAR = FollowingError(0.005, 0.03, 0.01)
LONGEST_S = 60.0


def robot(x=0.0, turn=ZERO3):
    pose = Pose(Vector3(x, 0.0, 0.0), from_rotation_vector(turn))
    return RobotState(1.0, RobotLink.LIVE, 1, 0, DT_S, (), (), pose, "")


class Recovery:
    """An arm in task space at rest, whose robot is now at `away`."""

    def __init__(self, away, limits=LIMITS):
        self.away = away
        self.commanded, self.reference = TaskSpaceArm(limits), Reference(limits)
        self.commanded.place(robot())
        self.reference.place(self.commanded.pose)
        self.reference.observe(away.pose)
        error = self.commanded.following_error(away, self.reference)
        self.motion = Recover(self.commanded, self.reference, NEAR, error)

    def tick(self):
        self.reference.observe(self.away.pose)
        over = self.motion.tick(self.away, DT_S).over
        assert norm(self.commanded.twist.linear) <= APPROACH_SPEED_M_S * (1.0 + 1e-9)
        assert norm(self.commanded.twist.angular) <= APPROACH_SPEED_RAD_S * (1.0 + 1e-9)
        assert self.reference.pose == self.commanded.pose
        return over

    def run(self, along=ZERO3):
        """Tick until the recovery ends; the robot moves by `along` in every tick."""
        for _ in range(round(LONGEST_S / DT_S)):
            if self.tick():
                assert not self.commanded.moving
                return self
            pose = self.away.pose
            self.away = robot()._replace(pose=pose._replace(position=add(pose.position, along)))
        raise AssertionError("the recovery does not end")

    @property
    def way_m(self):
        return norm(self.commanded.pose.position)

    @property
    def way_rad(self):
        return norm(rotation_between(IDENTITY_POSE.orientation, self.commanded.pose.orientation))

    @property
    def apart_m(self):
        return norm(subtract(self.away.pose.position, self.commanded.pose.position))


def test_it_ends_near_its_robot_and_at_rest():
    recovery = Recovery(robot(0.03, Vector3(0.0, 0.15, 0.0))).run()
    assert recovery.motion.near
    assert recovery.apart_m <= NEAR.linear_m


def test_a_robot_that_is_farther_than_the_maximum_lead_is_not_reached():
    recovery = Recovery(robot(0.3)).run()
    assert not recovery.motion.near
    assert 0.8 * LIMITS.max_lead_m <= recovery.way_m <= LIMITS.max_lead_m


def test_a_robot_that_goes_along_is_not_chased():
    runs_away = Vector3(APPROACH_SPEED_M_S * DT_S, 0.0, 0.0)
    recovery = Recovery(robot(0.02)).run(runs_away)
    assert not recovery.motion.near
    assert recovery.way_m <= MARGIN_SHARE * 0.02 + MARGIN_M + 1e-3


def test_it_ends_in_a_ramp_when_it_is_asked_to():
    recovery = Recovery(robot(0.04))
    for _ in range(50):
        assert not recovery.tick()
    speed = norm(recovery.commanded.twist.linear)
    recovery.motion.brake()
    for _ in range(round(speed / LIMITS.linear_acceleration_m_s2 / DT_S) + 2):
        if recovery.tick():
            break
    assert not recovery.commanded.moving
    assert not recovery.motion.near
    assert recovery.way_m < 0.03


def test_one_that_is_near_already_moves_nothing():
    recovery = Recovery(robot(0.004)).run()
    assert recovery.motion.near
    assert recovery.commanded.pose == IDENTITY_POSE


@pytest.mark.parametrize("limits", [LIMITS, ReferenceLimits(max_lead_m=0.01, max_lead_rad=0.05)])
def test_one_that_creeps_ends_in_time(limits):
    """A robot that oscillates at the edge of the tolerance must not prolong the recovery."""
    recovery = Recovery(robot(0.009), limits)
    ticks = 0
    while not recovery.tick():
        recovery.away = robot(recovery.commanded.pose.position.x + 0.009)
        ticks += 1
        assert ticks * DT_S < 10.0
    assert recovery.way_m <= limits.max_lead_m


@settings(max_examples=20)
@given(
    st.floats(-0.4, 0.4),
    st.floats(-2.0, 2.0),
    st.floats(-2.0, 2.0),
)
def test_wherever_the_robot_is_and_goes_the_maximum_lead_is_its_end(x, turn, share):
    along = Vector3(share * APPROACH_SPEED_M_S * DT_S, 0.0, 0.0)
    recovery = Recovery(robot(x, Vector3(0.0, 0.0, turn))).run(along)
    assert recovery.way_m <= LIMITS.max_lead_m + 1e-3
    assert recovery.way_rad <= LIMITS.max_lead_rad + 5e-3
