"""The state of a session, published a few times a second.

A snapshot is one JSON object in one packet, so that a user interface in any process can read it.
The session publishes decimated snapshots, the latest wins, and it never waits for a reader.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from typing import Any

from cardan.printable import printable

MAX_SNAPSHOT_BYTES = 65536
"""Room for a packet: a real snapshot has 2 to 4 kB, diagnosis included."""


@dataclass
class Snapshot:
    """State of a session. Lengths in m, angles in rad, times in s, shares in 0..1."""

    elapsed_s: float = 0.0
    finished: bool = False
    """True for the last snapshot of a session."""
    ending: str = ""
    """Why the session ends, once it was asked to or its time is over."""
    phase: str = ""
    message: str = ""
    trips: int = 0
    authority: str = ""
    """Source with authority over the arm: "hand", "verbs", or a stream's owner; empty: none."""
    authority_s: float | None = None
    """How long it has had it."""
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
    """Measured TCP: x y z in m, then w x y z."""
    reference: list[float] = field(default_factory=list)
    """Commanded: likewise."""
    twist: list[float] = field(default_factory=list)
    """Commanded twist: m/s, then rad/s, base axes."""
    leash_used: float = 0.0
    at_workspace_limit: bool = False
    filters: list[str] = field(default_factory=list)
    """What shared control does to the operator's motion."""
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
    """What limits the arm now; empty while nothing does."""
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
    """Force rendered to the hand now."""
    force_commanded_n: float = 0.0
    """What fixtures and measured force ask for."""
    force_peak_n: float = 0.0
    """The largest force sent in any tick."""
    force_losses: int = 0
    """How often teleoperation was disengaged because the force was lost, or did not come."""
    force_out_s: float = 0.0
    """Total time in which teleoperation went on without the force that it had had before."""
    force_lost_reason: str = ""
    """Why force was lost the last time."""
    measured_force_n: list[float] | None = None
    """The measured force as it would be rendered: scaled, filtered, base axes; None: there is none.
    Its direction shows whether `sense` and the force's frame are right."""
    force_age_s: float | None = None
    """Age of the measured force that is rendered now; None: none is."""
    fixture_age_p50_s: float | None = None
    """Age of the stylus position at which fixtures were evaluated; None: nothing was rendered."""
    fixture_age_p99_s: float | None = None
    measured_age_p50_s: float | None = None
    """Age of the measured force that was rendered, since its measurement."""
    measured_age_p99_s: float | None = None
    energy_j: float = 0.0
    """By the passivity observer: below 0, the rendered environment has given more than it took."""
    energy_given_j: float = 0.0
    """Net energy from the device to the hand, an upper bound."""
    energy_given_peak_j: float = 0.0
    """Largest such energy within one engagement, which passivity bounds."""
    passivity_damping_n_s_m: float = 0.0
    """Present damping by the passivity controller."""
    contact_force_n: float | None = None
    """Contact force at the tool, now; None without a source of measured force."""
    contact_s: float = 0.0
    """Total time of contact."""
    contact_path_m: float = 0.0
    """Way of the measured TCP in contact."""
    contact_force_mean_n: float = 0.0
    contact_target_n: float | None = None
    contact_force_rms_error_n: float = 0.0
    """Deviation about the target, or about the mean without one."""
    metrics: dict[str, float] = field(default_factory=dict)
    """The robot driver's own figures."""
    diagnosis: list[str] = field(default_factory=list)
    """Problems, worst first: robot, device, then filters."""
    error: str = ""
    """Why the session ended, when it did not end as asked."""

    def to_bytes(self) -> bytes:
        """As one packet. Figures that are not numbers travel as null."""
        return json.dumps(_finite(asdict(self)), separators=(",", ":")).encode()

    @classmethod
    def from_bytes(cls, data: bytes) -> Snapshot:
        """From one packet. What it tells is printable: much of it came over a wire."""
        return cls(**_printable(json.loads(data)))


def _printable(value: Any) -> Any:
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, dict):
        return {printable(key): _printable(item) for key, item in value.items()}
    return [_printable(item) for item in value] if isinstance(value, list) else value


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return value
