"""What a session tells the world about itself, a few times a second.

A snapshot is one JSON object in one packet, so that a user interface in any process can read it.
The session publishes decimated snapshots, the latest wins, and it never waits for a reader.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from typing import Any

MAX_SNAPSHOT_BYTES = 65536
"""Room for a packet: a real snapshot has 2 to 4 kB, diagnosis included."""


@dataclass
class Snapshot:
    """One look at a session. Lengths in m, angles in rad, times in s, shares in 0..1."""

    elapsed_s: float = 0.0
    finished: bool = False
    """True for the last snapshot of a session."""
    ending: str = ""
    """Why the session ends, once it was asked to or its time is over."""
    phase: str = ""
    message: str = ""
    trips: int = 0
    authority: str = ""
    """Who may move the arm: "hand", "verbs", or the owner of a stream; empty: nobody."""
    authority_s: float | None = None
    """For how long."""
    authority_refused: str = ""
    """The source it was refused to last, and why."""
    device_link: str = ""
    device_reason: str = ""
    axes: list[float] = field(default_factory=list)
    buttons: list[str] = field(default_factory=list)
    battery: float | None = None
    robot_link: str = ""
    hold_reason: str = ""
    sequence: int = 0
    joints_rad: list[float] = field(default_factory=list)
    pose: list[float] = field(default_factory=list)
    """Measured: x y z in m, then w x y z."""
    reference: list[float] = field(default_factory=list)
    """Commanded: likewise."""
    twist: list[float] = field(default_factory=list)
    """Commanded: m/s, then rad/s, base axes."""
    leash_used: float = 0.0
    at_workspace_limit: bool = False
    filters: list[str] = field(default_factory=list)
    """What shared control does to the operator's motion, in words."""
    gripper_closed: bool = False
    utilization: float | None = None
    path_speed: float | None = None
    """Share of the asked speed that the arm can do; None without an arm's model."""
    singular_value: float | None = None
    """Smallest one of the arm's Jacobian, rotation weighed by 0.3 m."""
    clearance_m: float | None = None
    """Distance of the nearest pair of bodies."""
    nearest_pair: list[str] = field(default_factory=list)
    arm_limits: list[str] = field(default_factory=list)
    """What limits the arm now, in words; empty while nothing does."""
    scheduling: str = ""
    """How the system runs the loop: "real time", "raised priority" or "ordinary"."""
    cycles: int = 0
    """Control instants of the robot that were answered."""
    path_m: float = 0.0
    """How far the reference has travelled."""
    moving_s: float = 0.0
    error_rms_m: float = 0.0
    """Distance between reference and robot while moving."""
    error_max_m: float = 0.0
    tick_p50_s: float = 0.0
    tick_p99_s: float = 0.0
    tick_max_s: float = 0.0
    haptic_state: str = ""
    """Operating state of the haptic device's force; empty without such a device."""
    haptic_reason: str = ""
    """Why the force is not what was commanded; empty when it is."""
    force_n: float = 0.0
    """Felt by the hand now."""
    force_commanded_n: float = 0.0
    """What fixtures and measured force ask for."""
    force_peak_n: float = 0.0
    """The strongest that was sent, in any tick."""
    force_losses: int = 0
    """How often teleoperation was disengaged because the force was lost, or did not come."""
    force_out_s: float = 0.0
    """How long, in all, the hand was followed without the force that it had had before."""
    force_lost_reason: str = ""
    """Why, the last time."""
    measured_force_n: list[float] | None = None
    """The measured force as the hand would feel it: scaled, filtered, base axes; None: there is
    none. Where it points is the test of `sense` and of the force's frame."""
    force_age_s: float | None = None
    """Age of the measured force that is rendered now; None: none is."""
    fixture_age_p50_s: float | None = None
    """Age of the stylus position at which fixtures were evaluated; None: nothing was rendered."""
    fixture_age_p99_s: float | None = None
    measured_age_p50_s: float | None = None
    """Age of the measured force that was rendered, since its measurement."""
    measured_age_p99_s: float | None = None
    energy_j: float = 0.0
    """The passivity observer's: below 0, what is rendered has given more than it took."""
    energy_given_j: float = 0.0
    """Net, from the device to the hand, at most."""
    energy_given_peak_j: float = 0.0
    """The most of that within one engagement, which passivity bounds."""
    passivity_damping_n_s_m: float = 0.0
    """What the passivity controller damps with now."""
    contact_force_n: float | None = None
    """At the tool, now; None without a source of measured force."""
    contact_s: float = 0.0
    """How long the tool touched something."""
    contact_path_m: float = 0.0
    """How far the measured TCP went meanwhile."""
    contact_force_mean_n: float = 0.0
    contact_target_n: float | None = None
    contact_force_rms_error_n: float = 0.0
    """About the target, or about the mean without one."""
    metrics: dict[str, float] = field(default_factory=dict)
    """The robot driver's own figures."""
    diagnosis: list[str] = field(default_factory=list)
    """What stands in the way, worst first: robot, device, then filters."""
    error: str = ""
    """Why the session ended, when it did not end as asked."""

    def to_bytes(self) -> bytes:
        """As one packet. Figures that are not numbers travel as null."""
        return json.dumps(_finite(asdict(self)), separators=(",", ":")).encode()

    @classmethod
    def from_bytes(cls, data: bytes) -> Snapshot:
        """From one packet."""
        return cls(**json.loads(data))


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return value
