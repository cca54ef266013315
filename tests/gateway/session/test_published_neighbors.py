"""Published robots of two arms, one session for each arm, driven at each other in virtual time."""

import importlib.metadata

import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from cardan.gateway.arm.status import Phase
from cardan.gateway.session.cautions import cautions
from tests.gateway.session.test_neighbors import REST, SAFETY_M, Between, Session
from tests.published_arms import INSTALL, TWO_ARMS, folder_of

pytestmark = pytest.mark.matrix

try:
    folder_of("example-robot-data")
except importlib.metadata.PackageNotFoundError:
    pytest.skip(INSTALL.format("example-robot-data"), allow_module_level=True)

STEPS = 350
INWARD = (0.0, -1.0, 0.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
"""The devices of the left arm and of the right one, pushed along y towards the other arm."""


@pytest.mark.timeout(600)
@pytest.mark.parametrize("robot", TWO_ARMS)
def test_the_arms_of_a_robot_that_are_driven_at_each_other_both_stop(robot, tmp_path):
    files = [str(each.write(tmp_path)) for each in TWO_ARMS[robot]]
    sessions = []
    for own, other, name in ((*files, "right"), (*files[::-1], "left")):
        arm = {
            "model": own,
            "safety_distance_m": SAFETY_M,
            "i_accept_links_without_bodies": True,
        }
        one = Session(own=own, other=other, name=name, neighbor={}, arm=arm)
        assert not [line for line in cautions(one.config) if "overlap" in line]
        sessions.append(one)
    left, right = sessions
    between, gap, way = Between(left), [], np.zeros(2)
    for step in range(STEPS):
        for number, (one, other) in enumerate(((left, right), (right, left))):
            before = one.core.commanded.pose.position.y
            one.cycle(INWARD[number] if step >= 10 else REST, held=step >= 5)
            way[number] += one.core.commanded.pose.position.y - before
            # As a session publishes, every second cycle, over a network.
            if step % 2 == 0:
                now_s = one.state.stamp_s
                other.topic.say(one.q, one.state.velocities, stamp_s=now_s, at_s=now_s + 0.005)
        gap.append(between(left.q, right.q))
    for one in sessions:
        assert one.core.phase is not Phase.DISARMED, one.message
    # Both arms moved toward each other.
    assert way[0] < -0.1
    assert way[1] > 0.1
    assert min(gap) >= SAFETY_M
    assert max(gap[-50:]) < 0.05
    assert max(gap[-50:]) - min(gap[-50:]) < 0.005
