"""Options of the servo."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Annotated

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import Options

GAIN_1_S = Range(0.0, 1000.0, "1/s", "at 1 kHz a higher gain overshoots in one tick")
SINGULAR_VALUE = Range(0.0, 1.0, "", "a length-weighed singular value of an arm is not larger")
WEIGHT = Range(0.0, 1000.0, "", "against the weight 1 of the task")


class Policy(enum.Enum):
    """Policy if an arm cannot follow: give up line or pace; no controller can keep both."""

    PATH = "path"
    """Hold the line: slow along it, and wait if it cannot be continued."""
    REACH = "reach"
    """Keep the pace: go around obstacles and leave the line."""


@dataclass(frozen=True, kw_only=True)
class ServoOptions(Options):
    """Weights, gains and limits of the servo. Raises OptionError."""

    policy: Policy = Policy.PATH
    length_m: Annotated[float, bounds.LENGTH_M] = 0.3
    """Weight of rad against m, which makes the result independent of the unit of length."""
    gain_1_s: Annotated[float, GAIN_1_S] = 60.0
    """Gain on the pose error; high, because the reference is computed and without noise."""
    linear_speed_m_s: Annotated[float, bounds.LINEAR_SPEED_M_S] = 1.0
    """Largest speed that the feedback may request."""
    angular_speed_rad_s: Annotated[float, bounds.ANGULAR_SPEED_RAD_S] = 3.0
    linear_deceleration_m_s2: Annotated[float, bounds.LINEAR_ACCELERATION_M_S2] = 2.0
    """Deceleration that the feedback plans with to avoid overshoot."""
    angular_deceleration_rad_s2: Annotated[float, bounds.ANGULAR_ACCELERATION_RAD_S2] = 8.0
    joint_gain_1_s: Annotated[float, GAIN_1_S] = 60.0
    """Gain on the error of a joint target."""
    speed_share: Annotated[float, bounds.SHARE] = 1.0
    """Share of the arm's joint speeds that may be used."""
    acceleration_share: Annotated[float, bounds.SHARE] = 1.0
    damping: Annotated[float, SINGULAR_VALUE] = 0.005
    """Largest damping, at a singularity, as an equivalent singular value."""
    singular_below: Annotated[float, SINGULAR_VALUE] = 0.06
    """Smallest singular value (length-weighed) below which damping sets in."""
    damping_floor: Annotated[float, SINGULAR_VALUE] = 1e-7
    path_stiffness: Annotated[float, WEIGHT] = 0.1
    """Cost of slowing along the path under Policy.PATH: the share of the commanded speed that may
    be lost sideways before all of the pace is given up, squared."""
    posture_gain_1_s: Annotated[float, GAIN_1_S] = 3.0
    posture_weight: Annotated[float, WEIGHT] = 1e-3
    """Weight of the preferred posture, against damping and obstacles, where the task is free."""
    safety_distance_m: Annotated[float, bounds.SAFETY_DISTANCE_M] = 0.01
    """Least distance to obstacles."""
    self_distance_m: Annotated[float, bounds.SAFETY_DISTANCE_M] = 0.005
    """Least distance between the arm's own bodies: their capsules contain them with more margin
    than that, and some pass each other closely in every posture."""
    closing_deceleration_m_s2: Annotated[float, bounds.LINEAR_ACCELERATION_M_S2] = 2.0
    """Deceleration expected of bodies that close in, if the joints can brake that hard."""
