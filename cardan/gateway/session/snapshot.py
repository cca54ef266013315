"""The state of a session, published a few times a second.

A snapshot is one JSON object in one packet, so that a user interface in any process can read it.
The session publishes decimated snapshots, the latest wins, and it never waits for a reader.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from typing import Any, TypeVar

from cardan.common.text_sanitizer import printable
from cardan.gateway.force.snapshot import ContactSnapshot, ForceSnapshot

FIGURES = re.compile(r"[0-9.,]+")
"""Parts of a message that change all the time without being news."""

_T = TypeVar("_T")

BOUNDS_S = (0.25e-3, 0.5e-3, 1e-3, 2e-3, 4e-3, 8e-3, 16e-3, 32e-3, 50e-3)
"""Bounds of the histograms: cycles of robots are 1 to 24 ms, of devices 8 to 16 ms."""

MAX_SNAPSHOT_BYTES = 65536
"""Room for a packet: a real snapshot has 2 to 4 kB, diagnosis included."""


@dataclass(frozen=True)
class ArmSnapshot:
    """State of the arm's controller."""

    phase: str = ""
    message: str = ""
    trips: int = 0
    authority: str = ""
    """Source with authority over the arm: "device", "verbs", or a stream's owner; empty: none."""
    authority_s: float | None = None
    """Time for which it has had it, s."""
    authority_refused: str = ""
    """The source that was last refused the authority, and why."""
    stops: int = 0
    """Count of stops requested by any source; after each, motion must be enabled again."""
    stopped_by: str = ""
    """Source of the newest stop."""
    reference: tuple[float, ...] = ()
    """Commanded TCP: x y z in m, then w x y z."""
    twist: tuple[float, ...] = ()
    """Commanded twist: m/s, then rad/s, base axes."""
    lead_used: float = 0.0
    at_workspace_limit: bool = False
    filters: tuple[str, ...] = ()
    """Effects of shared control on the operator's motion."""
    path_speed: float | None = None
    """Share of the requested speed that the arm can do; None without an arm's model."""
    clearance_m: float | None = None
    """Distance between the nearest pair of bodies."""
    nearest_pair: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    """Those of :data:`cardan.gateway.arm.status.LIMITS` that act now."""
    limits_in_words: tuple[str, ...] = ()
    """The limits by the arm's model, as text."""


@dataclass(frozen=True)
class TrackingSnapshot:
    """The robot's following of the reference, since the session's start."""

    path_m: float = 0.0
    """Path length of the reference so far."""
    moving_s: float = 0.0
    error_m: float | None = None
    """Distance between reference and robot; None while it does not move."""
    error_rms_m: float = 0.0
    """Root mean square of the distance."""
    error_max_m: float = 0.0


@dataclass(frozen=True)
class LoopSnapshot:
    """Latency of the answers, and age of the device's reports in them."""

    cycles: int = 0
    """Control instants of the robot that were answered."""
    tick_p50_s: float = 0.0
    tick_p99_s: float = 0.0
    tick_max_s: float = 0.0
    tick_sum_s: float = 0.0
    tick_within: tuple[int, ...] = ()
    """Count of answers within each of BOUNDS_S."""
    inputs: int = 0
    """Cycles in which the operator device was live."""
    input_age_sum_s: float = 0.0
    input_age_within: tuple[int, ...] = ()
    """Count of cycles whose newest report was no older than each of BOUNDS_S."""


@dataclass(frozen=True)
class RobotSnapshot:
    """State of the robot and its driver."""

    link: str = ""
    hold_reason: str = ""
    joints_rad: tuple[float, ...] = ()
    pose: tuple[float, ...] = ()
    """Measured TCP: x y z in m, then w x y z."""
    utilization: float | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)
    """Figures reported by the driver."""
    errors: Mapping[str, int] = field(default_factory=dict)
    """Unusable messages of the robot, by kind."""

    @property
    def missed_cycles(self) -> int:
        """Control instants that never arrived here, or were answered too late."""
        return int((self.metrics.get("lost") or 0) + (self.metrics.get("superseded") or 0))


@dataclass(frozen=True)
class DeviceSnapshot:
    """State of the operator device and its driver."""

    link: str = ""
    reason: str = ""
    held: bool = True
    """False while another session has the device."""
    passes: int = 0
    """Count of the operator's requests to pass the device on to the next session."""
    axes: tuple[float, ...] = ()
    buttons: tuple[str, ...] = ()
    battery: float | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)
    """Figures reported by the driver; empty while another session has the device."""
    errors: Mapping[str, int] = field(default_factory=dict)
    """Unusable messages of the device, by kind."""


@dataclass
class Snapshot:
    """State of a session. Lengths in m, angles in rad, times in s, shares in 0..1."""

    elapsed_s: float = 0.0
    finished: bool = False
    """True for the last snapshot of a session."""
    ending: str = ""
    """Reason for the end of the session, once it was requested or the time is over."""
    error: str = ""
    """Reason for an end of the session that was not requested."""
    scheduling: str = ""
    """Scheduling of the loop by the system: "real time", "raised priority" or "ordinary"."""
    diagnosis: list[str] = field(default_factory=list)
    """Problems, worst first: robot, device, then filters."""
    part_cost_s: Mapping[str, float] = field(default_factory=dict)
    """Mean time of each part of the session in a cycle, after its answer."""
    refusals: Mapping[str, int] = field(default_factory=dict)
    """Count of refused requests, by kind."""
    gripper_closed: bool = False
    arm: ArmSnapshot = field(default_factory=ArmSnapshot)
    tracking: TrackingSnapshot = field(default_factory=TrackingSnapshot)
    loop: LoopSnapshot = field(default_factory=LoopSnapshot)
    robot: RobotSnapshot = field(default_factory=RobotSnapshot)
    device: DeviceSnapshot = field(default_factory=DeviceSnapshot)
    force: ForceSnapshot = field(default_factory=ForceSnapshot)
    contact: ContactSnapshot = field(default_factory=ContactSnapshot)

    def to_bytes(self) -> bytes:
        """Encode as one packet. Values that are not numbers are sent as null."""
        try:
            return _encode(self).encode()
        except ValueError:
            text = json.dumps(self, default=vars)
            return _encode(json.loads(text, parse_constant=lambda _name: None)).encode()

    @classmethod
    def from_bytes(cls, data: bytes) -> Snapshot:
        """Decode from one packet. Its texts are made printable: many of them came from a
        network."""
        fields = json.loads(data)
        return cls.of(fields if _is_printable(data) else _printable(fields))

    @classmethod
    def of(cls, fields: Mapping[str, Any]) -> Snapshot:
        """Decode from its JSON. Fields unknown to either version are ignored; a value that is null
        is unknown."""
        return _updated(cls(), fields)


def _updated(status: _T, fields: Mapping[str, Any]) -> _T:
    known: dict[str, Any] = vars(status)
    new: dict[str, Any] = {}
    for name in known.keys() & fields.keys():
        before, value = known[name], fields[name]
        if is_dataclass(before):
            new[name] = _updated(before, value) if isinstance(value, dict) else before
        elif value is not None:
            new[name] = tuple(value) if isinstance(before, tuple) else value
    return replace(status, **new)  # type: ignore[type-var]


_encode = json.JSONEncoder(separators=(",", ":"), allow_nan=False, default=vars).encode
"""Raises ValueError for figures that are not numbers."""


def _is_printable(data: bytes) -> bool:
    """Return whether all texts in JSON are certainly printable: it allows no control characters but
    DEL without an escape."""
    return data.isascii() and b"\\" not in data and b"\x7f" not in data


def _printable(value: Any) -> Any:
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, dict):
        return {printable(key): _printable(item) for key, item in value.items()}
    return [_printable(item) for item in value] if isinstance(value, list) else value
