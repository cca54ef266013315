"""Arguments of the EGM RAPID instructions, with the manual's defaults.

Source: ABB Application manual, Externally Guided Motion (3HAC073318-001), RAPID reference.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from cardan.sim_peers.kinematics import AXES

ALL_AXES = tuple(range(AXES))


class EgmMode(enum.Enum):
    """Mode chosen by EGMSetupUC: \\Joint, \\Pose or \\PathCorr."""

    JOINT = "joint"
    POSE = "pose"
    PATH = "path"


class StopMode(enum.Enum):
    """Action at the end of guidance."""

    HOLD = "hold"
    """EGM_STOP_HOLD: stay."""
    RAMP_DOWN = "ramp-down"
    """EGM_STOP_RAMP_DOWN: return to the start position."""


@dataclass(frozen=True, kw_only=True)
class EgmSetup:
    """EGMSetupUC."""

    mode: EgmMode
    comm_timeout_s: float = 1.0
    """The manual gives no default; users report 1 s."""


@dataclass(frozen=True, kw_only=True)
class EgmAct:
    """EGMActJoint, EGMActPose or EGMActMove."""

    mode: EgmMode
    window_deg: float = 0.5
    """Half width of the convergence window: joints, or rx ry rz."""
    window_mm: float = 1.0
    """Half width of the convergence window: x y z."""
    lp_filter_hz: float = 0.0
    """<= 0 takes the system parameter."""
    sample_rate_ms: int | None = None
    """Nominal; None is 4, for path correction 48."""
    max_pos_deviation_deg: float = 1000.0
    max_speed_deviation_deg_s: float = 1.0
    stream_start: bool = False


@dataclass(frozen=True, kw_only=True)
class EgmRun:
    """EGMRunJoint or EGMRunPose."""

    mode: EgmMode
    stop_mode: StopMode = StopMode.HOLD
    axes: tuple[int, ...] = ALL_AXES
    """Indices of the switches given: J1..J6, or x y z rx ry rz. None given moves nothing."""
    cond_time_s: float = 1.0
    ramp_in_s: float = 0.0
    ramp_out_s: float | None = None
    """None takes the system parameter."""
    pos_corr_gain: float = 1.0
    no_wait: bool = False
    """\\NoWaitCond: errors are fatal instead of recoverable."""


@dataclass(frozen=True, kw_only=True)
class PathMove:
    """EGMMoveL: straight from here by `displacement_mm`, with a constant orientation."""

    displacement_mm: tuple[float, float, float]
    """Base frame."""
    speed_mm_s: float
    repeats: int = 1
    """How often: there, back, there again ..."""
