"""Figures of the rendered force and of the tool's contact, in a session's snapshot."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ForceSnapshot:
    """The force that a haptic device renders to the hand."""

    state: str = ""
    """Operating state of the haptic device's force; empty without such a device."""
    reason: str = ""
    """Why the force differs from the commanded one; empty if it does not."""
    rendered_n: float = 0.0
    """Present rendered force."""
    peak_n: float = 0.0
    """The largest force sent in any tick."""
    age_s: float | None = None
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
    rendered_depth_m: float = 0.0
    """Largest depth of the hand against a measured force."""
    rendered_stiffness_n_m: float | None = None
    """Rendered force over that depth, least squares; None: nothing was rendered in contact."""
    losses: int = 0
    """How often teleoperation was disengaged because the force was lost, or did not come."""
    out_s: float = 0.0
    """Total time in which teleoperation went on after the loss of its force."""
    lost_reason: str = ""
    """Why force was lost the last time."""
    measured_n: tuple[float, ...] = ()
    """The measured force as it would be rendered: scaled, filtered, base axes; empty without one.
    Its direction shows whether `sense` and the force's frame are right."""


@dataclass(frozen=True)
class ContactSnapshot:
    """The tool's contact, by a source of measured force."""

    force_n: float | None = None
    """Contact force at the tool, now; None without such a source."""
    time_s: float = 0.0
    """Total time of contact."""
    path_m: float = 0.0
    """Path of the measured TCP in contact."""
    mean_n: float = 0.0
    target_n: float | None = None
    rms_error_n: float = 0.0
    """RMS error about the target, or about the mean without one."""
