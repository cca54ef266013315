"""Values of force feedback: commands to a haptic device, and its reports.

SI units. Hand frame: the axes of all poses of hands, x forward (away from the operator), y left, z
up, in m from the device's own origin. World frame: the robot's base, where fixtures stand.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

from cardan.types import NEVER_S, ZERO3, Pose, Vector3

Matrix3 = tuple[float, float, float, float, float, float, float, float, float]
"""Matrix of nine numbers, row by row."""

IDENTITY3: Matrix3 = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

MAX_FIXTURES = 8
"""Largest number of fixtures in a command: the tick reserves room for them."""


# ---------------------------------------------------------------------------------------------
# Fixtures, world frame. Each pushes with stiffness · depth, at most `cap_n`, and damps with
# `damping_n_s_m` against motion into and out of it, never so much that it would pull.


class Sphere(NamedTuple):
    """A solid sphere, or with `inside` a hollow one that encloses the point."""

    center: Vector3
    radius_m: float
    stiffness_n_m: float
    cap_n: float = 3.0
    damping_n_s_m: float = 0.0
    inside: bool = False


class Plane(NamedTuple):
    """A half space, solid below `point` seen along the outward unit `normal`."""

    point: Vector3
    normal: Vector3
    stiffness_n_m: float
    cap_n: float = 3.0
    damping_n_s_m: float = 0.0


class Box(NamedTuple):
    """A solid box with half sides along the columns of `rotation`, or with `inside` a hollow one.

    A solid box pushes out through its nearest side; a hollow one limits each axis separately.
    """

    center: Vector3
    half_sides_m: Vector3
    stiffness_n_m: float
    cap_n: float = 3.0
    damping_n_s_m: float = 0.0
    inside: bool = False
    rotation: Matrix3 = IDENTITY3
    """Box axes to world axes."""


class Cylinder(NamedTuple):
    """A solid cylinder without ends about `axis` (unit) through `point`; `inside`: hollow."""

    point: Vector3
    axis: Vector3
    radius_m: float
    stiffness_n_m: float
    cap_n: float = 3.0
    damping_n_s_m: float = 0.0
    inside: bool = False


class Spring(NamedTuple):
    """A spring and a damper between the point and `target`: a virtual coupling."""

    target: Vector3
    stiffness_n_m: float
    cap_n: float = 3.0
    damping_n_s_m: float = 0.0


class Viscous(NamedTuple):
    """Drag against every motion."""

    damping_n_s_m: float
    cap_n: float = 3.0


Fixture = Sphere | Plane | Box | Cylinder | Spring | Viscous


class WorldMap(NamedTuple):
    """Map of the stylus into the world: world point = `linear` · hand point + `offset`.

    Forces are mapped back by the rotation alone: hand force = `rotation`ᵀ · world force.
    """

    linear: Matrix3 = IDENTITY3
    """Alignment times scale; no unit."""
    offset: Vector3 = ZERO3
    """m."""
    rotation: Matrix3 = IDENTITY3
    """Alignment alone, hand axes to world axes, determinant +1."""


class MeasuredForce(NamedTuple):
    """A force measured elsewhere, to be rendered: already scaled, hand frame.

    Until the next one the tick extrapolates with `rate_n_s`, and with `stiffness_n_m` against the
    stylus's motion away from `position`, both for a bounded time.
    """

    force: Vector3
    """N, as rendered to the hand."""
    stamp_s: float
    """Local monotonic time of the measurement."""
    rate_n_s: Vector3 = ZERO3
    position: Vector3 = ZERO3
    """Position of the stylus at that time, hand frame, m."""
    stiffness_n_m: float = 0.0
    """0: no local contact model."""
    absorbed_j: float = 0.0
    """Net energy that the touched objects have absorbed in this engagement, J: for a remote device,
    whose own loop does not see it."""


class HapticCommand(NamedTuple):
    """Input of the tick until the next command; a command source owns `sequence`. A command whose
    sequence is not above the last one's, or whose stamp is older, is dropped."""

    sequence: int
    stamp_s: float
    """Local monotonic time of its data."""
    engaged: bool = False
    """False: no force at all, by ramp; the next True engages again (small force first, then a
    ramp up)."""
    world: WorldMap = WorldMap()
    fixtures: tuple[Fixture, ...] = ()
    measured: MeasuredForce | None = None
    force: Vector3 = ZERO3
    """A further force, added to the others, hand frame, N."""
    force_scale: float = 1.0
    """Factor on the fixtures' forces."""
    joint_torques_n_m: Vector3 | None = None
    """Joint torque mode: only these torques are rendered, within the limits."""


class OperatingState(enum.Enum):
    """State of a haptic device's force (CRTK operating_state)."""

    DISABLED = "disabled"
    """No force until enabled."""
    ENABLED = "enabled"
    PAUSED = "paused"
    """No force, on request, or because commands stopped, ticks were late or the force oscillated,
    until that is over and the commanded force is small; after a short stall of the loop alone,
    force returns by a ramp."""
    FAULT = "fault"
    """Latched, with a reason; enabling retries."""


class Calibration(enum.Enum):
    """Calibration of the device's position."""

    OK = "ok"
    NEEDS_UPDATE = "needs update"
    NEEDS_MANUAL_INPUT = "needs manual input"
    """The stylus must be put into the inkwell."""
    UNKNOWN = "unknown"


class FeedbackLimits(NamedTuple):
    """The largest feedback that a haptic device renders."""

    force_n: float
    """Norm of the force."""
    joint_torque_n_m: float | None = None
    """Limit of each joint; None: it does not accept joint torques."""
    energy_j: float | None = None
    """Net energy that one engagement may give to the hand; None: the device has no such limit."""


class HapticState(NamedTuple):
    """A snapshot of the force tick."""

    stamp_s: float = NEVER_S
    """Local monotonic time of the newest tick."""
    ticks: int = 0
    state: OperatingState = OperatingState.DISABLED
    reason: str = ""
    """Why the force differs from the command; empty if it does not."""
    pose: Pose | None = None
    """Pose of the gimbal's center, hand frame; orientation orthonormal."""
    velocity: Vector3 = ZERO3
    """m/s, filtered."""
    joints_rad: Vector3 = ZERO3
    gimbal_rad: Vector3 = ZERO3
    buttons: int = 0
    """Levels, bit 0 is button 1."""
    presses: tuple[int, int] = (0, 0)
    """Count of presses of each button, in the tick."""
    inkwell: bool = False
    calibration: Calibration = Calibration.UNKNOWN
    force_commanded: Vector3 = ZERO3
    """Force of the fixtures and of the measured force, N, hand frame."""
    force: Vector3 = ZERO3
    """Rendered force, after every limit, N, hand frame."""
    rendering: bool = False
    """Whether force is rendered, in full or ramping up; `reason` says why not."""
    peak_n: float = 0.0
    """Largest force since the tick began."""
    energy_j: float = 0.0
    """Net energy that the rendered environment absorbed, by the passivity observer; below 0 it has
    released more than it absorbed."""
    delivered_j: float = 0.0
    """Net energy given to the hand since the tick began, an upper bound: the age of a measured
    position leaves a range, whose larger end counts."""
    given_peak_j: float = 0.0
    """Largest net energy given to the hand within one engagement, an upper bound likewise."""
    passivity_damping_n_s_m: float = 0.0
    """Present damping by the passivity controller."""
    thermal_derating: float = 1.0
    """Share of the clamp that the thermal limiter leaves."""
    temperature: float = 0.0
    """Predicted temperature of the hottest motor: 0 cold, 1 hottest."""
    command_sequence: int = 0
    command_age_s: float = float("inf")
    force_age_s: float = float("inf")
    """Age of the measured force that is rendered."""
    gap_s: float = 0.0
    """Longest time between two ticks since the previous snapshot."""
    tick_cost_s: float = 0.0
    """Longest duration of a tick since the previous snapshot."""
    late_ticks: int = 0
    """Gaps above the limit since the tick began."""
    dropped_commands: int = 0
    stale_commands: int = 0
    """Count of silences of the command source."""
    faults: int = 0
    rate_hz: float = 0.0
