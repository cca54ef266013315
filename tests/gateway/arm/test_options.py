"""Valid options of motions, and the workspace shared by limits and streams."""

import math
from dataclasses import replace

import pytest

from cardan.errors import ConfigurationError, MotionRefusedError, OptionError
from cardan.gateway.arm.options import STREAM_LIMITS, ControllerOptions
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.motion.planner import Margins
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.servo.options import ServoOptions
from tests.gateway.arm.arms import quick

WALLS = ReferenceLimits(workspace_x_m=(0.1, 0.6), workspace_z_m=(0.6, 1.0))


def test_the_workspace_of_the_limits_holds_for_verbs_and_streams():
    both = replace(STREAM_LIMITS, workspace_x_m=(0.2, 0.7))
    options = ControllerOptions(limits=WALLS, streams=both)
    assert options.streams.workspace_m == ((0.2, 0.6), None, (0.6, 1.0))
    world = quick(options=ControllerOptions(limits=WALLS))
    for verb in ("inv", "movj", "movl"):
        with pytest.raises(MotionRefusedError, match=r"0\.6000 to 1\.0000 m"):
            getattr(world.verbs, verb)(world.moved(0.0, 0.0, -0.3))
    world.verbs.set_parameter("cpsc", "twst")
    for _ in range(800):
        assert world.verbs.stream("twist", [0.0, 0.0, -0.2, 0.0, 0.0, 0.0]) == ""
        world.tick()
    assert world.six()[2] == pytest.approx(0.6, abs=2e-3)


def test_walls_that_have_nothing_in_common_are_refused():
    with pytest.raises(ConfigurationError, match="lower bound first"):
        ControllerOptions(limits=WALLS, streams=replace(STREAM_LIMITS, workspace_z_m=(1.1, 1.2)))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0, 1e300, "x", True])
@pytest.mark.parametrize(
    ("options", "name"),
    [
        (ServoOptions, "speed_share"),
        (ServoOptions, "gain_1_s"),
        (ServoOptions, "safety_distance_m"),
        (Margins, "obstacle_m"),
        (Watchdogs, "following_error_joint"),
        (Watchdogs, "stall_s"),
        (ReferenceLimits, "linear_speed_m_s"),
        (ControllerOptions, "stop_deceleration_m_s2"),
    ],
)
def test_no_limit_is_anything_but_a_number_in_its_range(options, name, bad):
    with pytest.raises(OptionError, match=name):
        options(**{name: bad})
