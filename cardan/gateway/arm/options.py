"""Limits and options of motions by verbs and streams, beside the parameters that users set."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Annotated

from cardan.common import bounds
from cardan.common.bounds import Bounds
from cardan.common.options import Options, require
from cardan.gateway.arm.arrival import ArrivalOptions
from cardan.gateway.arm.motions.torque import TorqueLimits
from cardan.gateway.arm.states import AuthorityOptions
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.motion.planner import Margins
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.servo.options import ServoOptions
from cardan.types import CommandKind

STREAM_LIMITS = ReferenceLimits(linear_jerk_m_s3=20.0, angular_jerk_rad_s3=80.0)
"""For people beside the arm; it takes 50 ms to reach full acceleration."""

STEP_RAD = bounds.Range(0.0, math.pi, "rad", "no two orientations are farther apart", above=True)


@dataclass(frozen=True, kw_only=True)
class ControllerOptions(Options):
    """Limits and options of motions, beside the parameters that users set. Raises OptionError."""

    drive: CommandKind | None = None
    """Kind of command for motions; None: the best of those that the robot takes."""
    limits: ReferenceLimits | None = None
    """Speed and acceleration of the TCP that no verb exceeds, whatever the parameters ask for;
    None: the parameters alone bound movj, relj, movl and movv. Its maximum lead is not used."""
    streams: ReferenceLimits = STREAM_LIMITS
    """Limits of streams and movv. Their workspace, and that of `limits`, apply to all verbs."""
    stream_prediction_s: Annotated[float, bounds.SHARE_OR_NONE] = 0.0
    """Longest extrapolation of streamed poses: one period of the stream removes its delay. 0: the
    reference only goes to the newest pose."""
    stream_step_m: Annotated[float, bounds.LENGTH_M] = 0.2
    """Largest distance of a streamed pose from the commanded one of the TCP."""
    stream_step_rad: Annotated[float, STEP_RAD] = 1.0
    authority: AuthorityOptions = field(default_factory=AuthorityOptions)
    stop_deceleration_m_s2: Annotated[float, bounds.LINEAR_ACCELERATION_M_S2] = 1.0
    stop_deceleration_rad_s2: Annotated[float, bounds.ANGULAR_ACCELERATION_RAD_S2] = 4.0
    watchdogs: Watchdogs = field(default_factory=lambda: Watchdogs(following_error_joint=0.2))
    tcp_tolerance_m: Annotated[float, bounds.TCP_TOLERANCE_M] | None = None
    """Largest difference between the robot's own TCP and the model's; None: by the kind of command.
    """
    arrival: ArrivalOptions = field(default_factory=ArrivalOptions)
    """Conditions for the arrival of movj, relj, movl and trajectories."""
    torque: TorqueLimits = field(default_factory=TorqueLimits)
    margins: Margins = field(default_factory=Margins)
    servo: ServoOptions = field(default_factory=ServoOptions)
    i_accept_links_without_bodies: bool = False
    """Accept obstacles that some links cannot be kept away from, having no bodies."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in ("linear_jerk_m_s3", "angular_jerk_rad_s3"):
            jerk = getattr(self.streams, key)
            require(jerk is not None, f"streams.{key}", jerk, "a number: it shapes streamed poses")
        if self.limits is not None:
            x, y, z = map(_common, self.streams.workspace_m, self.limits.workspace_m)
            streams = replace(self.streams, workspace_x_m=x, workspace_y_m=y, workspace_z_m=z)
            object.__setattr__(self, "streams", streams)


def _common(one: Bounds | None, other: Bounds | None) -> Bounds | None:
    """Return the intersection of two ranges."""
    if one is None or other is None:
        return one or other
    return max(one[0], other[0]), min(one[1], other[1])
