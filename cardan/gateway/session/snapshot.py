"""The state of a session, published a few times a second.

A snapshot is one JSON object in one packet, so that a user interface in any process can read it.
The session publishes decimated snapshots, the latest wins, and it never waits for a reader.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from typing import Any

from cardan.common.text_sanitizer import printable

BOUNDS_S = (0.25e-3, 0.5e-3, 1e-3, 2e-3, 4e-3, 8e-3, 16e-3, 32e-3, 50e-3)
"""Bounds of the histograms: cycles of robots are 1 to 24 ms, of devices 8 to 16 ms."""

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
    stops: int = 0
    """Stops that were asked for, by whomever; of each, motion has to be enabled again."""
    stopped_by: str = ""
    """Source of the newest one."""
    device_link: str = ""
    device_reason: str = ""
    device_held: bool = True
    """False: another session has the device."""
    device_passes: int = 0
    """How often the operator asked to pass the device on to the next session."""
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
    lead_used: float = 0.0
    at_workspace_limit: bool = False
    filters: list[str] = field(default_factory=list)
    """Effects of shared control on the operator's motion."""
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
    """Limits of the arm now; empty if there are none."""
    limits: list[str] = field(default_factory=list)
    """Of :data:`cardan.gateway.arm.status.LIMITS` those that act now."""
    scheduling: str = ""
    """How the system runs the loop: "real time", "raised priority" or "ordinary"."""
    cycles: int = 0
    """Control instants of the robot that were answered."""
    path_m: float = 0.0
    """How far the reference has traveled."""
    moving_s: float = 0.0
    error_m: float | None = None
    """Distance between reference and robot; None while it does not move."""
    error_rms_m: float = 0.0
    """The same since the session's start, root of the mean square."""
    error_max_m: float = 0.0
    tick_p50_s: float = 0.0
    tick_p99_s: float = 0.0
    tick_max_s: float = 0.0
    tick_sum_s: float = 0.0
    tick_within: list[int] = field(default_factory=list)
    """Answers that took no longer than each of BOUNDS_S."""
    input_age_sum_s: float = 0.0
    inputs: int = 0
    """Cycles in which the operator device was live."""
    input_age_within: list[int] = field(default_factory=list)
    """Those whose newest report was no older than each of BOUNDS_S."""
    part_cost_s: dict[str, float] = field(default_factory=dict)
    """Mean time of each part of the session in a cycle, after its answer."""
    haptic_state: str = ""
    """Operating state of the haptic device's force; empty without such a device."""
    haptic_reason: str = ""
    """Why the force differs from the commanded one; empty if it does not."""
    force_n: float = 0.0
    """Force rendered to the hand now."""
    force_commanded_n: float = 0.0
    """Force requested by fixtures and measured force."""
    force_peak_n: float = 0.0
    """The largest force sent in any tick."""
    felt_depth_m: float = 0.0
    """How far the hand went in against a measured force, at most."""
    felt_stiffness_n_m: float | None = None
    """Force that the hand felt over that depth, least squares; None: nothing was felt in
    contact."""
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
    """StopReason about the target, or about the mean without one."""
    metrics: dict[str, float] = field(default_factory=dict)
    """The robot driver's own figures."""
    device_metrics: dict[str, float] = field(default_factory=dict)
    """Those of the operator device's driver; empty while another session has the device."""
    robot_errors: dict[str, int] = field(default_factory=dict)
    """Messages of the robot that could not be used, by kind."""
    device_errors: dict[str, int] = field(default_factory=dict)
    """Those of the operator device."""
    refusals: dict[str, int] = field(default_factory=dict)
    """Requests that were refused, by kind."""
    diagnosis: list[str] = field(default_factory=list)
    """Problems, worst first: robot, device, then filters."""
    error: str = ""
    """Why the session ended, when it did not end as asked."""

    @property
    def missed_cycles(self) -> int:
        """Control instants that never arrived here, or that had passed before they were
        answered."""
        return int((self.metrics.get("lost") or 0) + (self.metrics.get("superseded") or 0))

    def to_bytes(self) -> bytes:
        """As one packet. Figures that are not numbers travel as null."""
        fields = vars(self)
        try:
            return _encode(fields).encode()
        except ValueError:
            return _encode(_finite(fields)).encode()

    @classmethod
    def from_bytes(cls, data: bytes) -> Snapshot:
        """From one packet. Its texts are made printable: much of them came over a wire."""
        fields = json.loads(data)
        snapshot = cls()
        vars(snapshot).update(fields if _is_printable(data) else _printable(fields))
        return snapshot


_encode = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode
"""Raises ValueError for figures that are not numbers."""


def _is_printable(data: bytes) -> bool:
    """Whether all texts in JSON are printable for certain: it allows no control characters but DEL
    without an escape."""
    return data.isascii() and b"\\" not in data and b"\x7f" not in data


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
