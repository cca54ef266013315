"""Run-on distance of a robot whose session is killed: its controller's own time limit ends
motion."""

import pytest

from bench.killed import SPEEDS_M_S, kill_while_moving

pytestmark = pytest.mark.matrix

SPEED_M_S = SPEEDS_M_S[0]


@pytest.mark.parametrize(
    ("name", "distance_m", "time_s"),
    [
        # CommTimeout of EGM, 0.2 s, with its ramp of 0.5 s; a watchdog of 0.1 s.
        ("GoFa, EGM pose", 0.2 * SPEED_M_S + 0.5 * SPEED_M_S / 2.0, 0.8),
        ("GP8, MotoROS velocity", 0.1 * SPEED_M_S + 0.005, 0.3),
    ],
)
def test_a_robot_whose_session_is_killed_comes_to_rest(name, distance_m, time_s):
    found = kill_while_moving(name, SPEED_M_S)
    assert found.speed_m_s > 0.8 * SPEED_M_S
    assert 0.0 < found.distance_m <= distance_m
    assert found.time_s <= time_s
