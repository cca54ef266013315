"""What motions by verbs and streams may do, beside the parameters that their users set."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from cardan.errors import ConfigurationError
from cardan.gateway.arm.authority import LEASE_S, AuthorityPolicy
from cardan.gateway.arm.checks import Workspace
from cardan.gateway.arm.planner import Margins
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.motion.reference import ReferenceLimits
from cardan.gateway.servo.options import ServoOptions
from cardan.types import CommandKind


@dataclass(frozen=True, kw_only=True)
class ControllerOptions:
    """What a motion may do, beside the parameters that its users set."""

    drive: CommandKind | None = None
    """The command that motions are sent as; None: the best of those that the robot takes."""
    limits: ReferenceLimits | None = None
    """Speed and acceleration of the TCP that no verb exceeds, whatever the parameters ask for;
    None: the parameters alone bound movj, relj, movl and movv."""
    workspace_m: Workspace = (None, None, None)
    """Range of the TCP along each base axis; None: unbounded."""
    stream_speed_m_s: float = 0.25
    """Of streams and movv."""
    stream_acceleration_m_s2: float = 1.0
    stream_rotation_speed_rad_s: float = 1.0
    stream_rotation_acceleration_rad_s2: float = 4.0
    stream_jerk_m_s3: float = 20.0
    stream_rotation_jerk_rad_s3: float = 80.0
    stream_prediction_s: float = 0.0
    """For how long the reference of streamed poses goes on as the last ones went, at most; the
    period of the stream takes its delay away. 0: it only ever goes to the newest pose."""
    stream_step_m: float = 0.2
    """Farthest that a streamed pose may be from where the TCP is commanded to be."""
    stream_step_rad: float = 1.0
    authority: AuthorityPolicy = AuthorityPolicy.HAND
    """Who may take the authority over the arm from whom."""
    authority_named: str = ""
    """The source that may have it where `authority` is NAMED."""
    authority_lease_s: float = LEASE_S
    """For which a source that does not renew keeps its authority."""
    stop_deceleration_m_s2: float = 1.0
    stop_deceleration_rad_s2: float = 4.0
    leash_m: float = 0.05
    """How far the reference of streams and movv may run ahead of the measured position."""
    leash_rad: float = 0.3
    watchdogs: Watchdogs = field(default_factory=lambda: Watchdogs(following_error_joint=0.2))
    tcp_tolerance_m: float | None = None
    """Most that the robot's own TCP may differ from the model's; None: by the kind of command."""
    force_n: float = 100.0
    """Most that a wrench may exert."""
    torque_nm: float = 20.0
    force_slew_n_s: float = 500.0
    torque_slew_nm_s: float = 100.0
    torque_speed_share: float = 0.5
    """Of each joint's speed: faster, a torque motion runs away and is stopped."""
    margins: Margins = field(default_factory=Margins)
    servo: ServoOptions = field(default_factory=ServoOptions)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name == "stream_prediction_s" and value == 0.0:
                continue
            if isinstance(value, float) and not 0.0 < value < math.inf:
                raise ConfigurationError(name, f"must be a number > 0, not {value}")
        for axis, bounds in zip("xyz", self.workspace_m, strict=True):
            if bounds is not None and not bounds[0] < bounds[1]:
                raise ConfigurationError(
                    "workspace_m", f"{axis} goes from low to high, not {bounds}"
                )
