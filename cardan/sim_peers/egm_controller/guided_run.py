"""A run of EGM, from its start until it ends as planned or with an error.

Source: ABB Application manual, Externally Guided Motion (3HAC073318-001), RAPID reference of
EGMRunJoint, EGMRunPose and EGMMoveL.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

from cardan.protocols.egm.messages import EgmSensor, EgmSensorPathCorr
from cardan.sim_peers.egm_controller.arguments import EgmAct, EgmMode, EgmRun, PathMove, StopMode
from cardan.sim_peers.egm_controller.events import JOINT_OUT_OF_RANGE, NO_DATA, UNNUMBERED
from cardan.sim_peers.egm_controller.guidance import (
    GuidedJointMotion,
    GuidedMotion,
    GuidedPoseMotion,
    MotionError,
    PathCorrectedMotion,
    Tuning,
)
from cardan.sim_peers.egm_controller.motion import ServoAxes
from cardan.sim_peers.egm_controller.settings import EgmSettings

_LEVEL_1_DELAY_CYCLES = 2
"""Level 1 filters and thus acts later than Level 0; the manual gives no number."""


class RunRequest(NamedTuple):
    """An EGMRun or EGMMoveL that the program reached; it may be run more than once."""

    arguments: EgmRun | PathMove
    start_joints: list[float]
    """Joints when the program reached it, rad."""


class Ending(NamedTuple):
    """How the arm comes to rest after a run that ended as planned."""

    stop_mode: StopMode
    brake_s: float = 0.0
    """Ramp to zero speed; 0 is as fast as the axes can."""
    return_s: float = 0.0
    """Shortest time for the return to the start position of StopMode.RAMP_DOWN."""


class GuidedRun:
    """EGMRunJoint, EGMRunPose or EGMMoveL while the PC guides the arm.

    Call `tick` once per control cycle with increasing times, s since the start of the controller.
    """

    def __init__(
        self,
        settings: EgmSettings,
        act: EgmAct,
        order: RunRequest,
        servo: ServoAxes,
        flaws: Counter[str],
        now_s: float,
    ) -> None:
        """Start the run. Raises MotionError for a path that cannot be run."""
        self.order = order
        self.guidance = _guidance(settings, act, order.arguments, servo, flaws)
        self.converged = False
        """True while every selected axis is inside its convergence window."""
        self._settings = settings
        self._servo = servo
        self._started_s = now_s
        self._last_accepted_s = now_s
        self._heard = False
        self._converged_since_s: float | None = None

    def accept(self, message: EgmSensor | EgmSensorPathCorr, now_s: float) -> str:
        """Handle one message; return the reason if it is ignored, else empty.

        Raises MotionError for a reference that the controller stops at.
        """
        reason = self.guidance.accept(message)
        if not reason:
            self._last_accepted_s = now_s
            self._heard = True
        return reason

    def tick(self, now_s: float) -> Ending | None:
        """Move for one control cycle; return the kind of ending if it was the last, else None.

        Raises MotionError, before anything has moved, if the controller stops: for silence of the
        PC, a joint at its limit, a deviation or a load beyond its limit, a singularity.
        """
        servo = self._servo
        if now_s - self._last_accepted_s > self._settings.comm_timeout_s:
            raise MotionError(NO_DATA, "No data from the UdpUc device")
        if (axis := servo.out_of_range()) is not None:
            raise MotionError(
                JOINT_OUT_OF_RANGE,
                f"Joint out of range: joint {axis + 1} = {math.degrees(servo.planned[axis]):.3f}",
            )
        cap = self._speed_limit()
        speeds = self.guidance.speeds(now_s - self._started_s)
        factor = self._settings.options.dynamic_load_factor
        if factor > 0.0 and servo.demanded_acceleration(speeds, cap) > factor:
            raise MotionError(UNNUMBERED, "Dynamic load too high")
        servo.drive(speeds, cap)
        if self.guidance.done:
            return Ending(StopMode.HOLD)
        if isinstance(self.order.arguments, EgmRun):
            return self._watch_convergence(self.order.arguments, now_s)
        return None

    def _speed_limit(self) -> float:
        """Return MaxSpeedDeviation, rad/s. Raises MotionError if a joint is beyond
        MaxPosDeviation."""
        act = self._settings.act
        if act is None or isinstance(self.order.arguments, PathMove):
            return math.inf
        furthest = math.radians(act.max_pos_deviation_deg)
        for axis, (q, q0) in enumerate(
            zip(self._servo.planned, self.order.start_joints, strict=True)
        ):
            if abs(q - q0) > furthest:
                raise MotionError(
                    UNNUMBERED, f"joint {axis + 1} is beyond MaxPosDeviation of its start"
                )
        return math.radians(act.max_speed_deviation_deg_s)

    def _watch_convergence(self, run: EgmRun, now_s: float) -> Ending | None:
        # Before the first message there is nothing to converge to.
        self.converged = self._heard and self.guidance.converged()
        if not self.converged:
            self._converged_since_s = None
        elif self._converged_since_s is None:
            self._converged_since_s = now_s
        elif now_s - self._converged_since_s >= run.cond_time_s:
            ramp_s = run.ramp_out_s
            if ramp_s is None:
                ramp_s = self._settings.options.ramp_time_s
            return Ending(run.stop_mode, return_s=ramp_s)
        return None


def _guidance(
    settings: EgmSettings,
    act: EgmAct,
    arguments: EgmRun | PathMove,
    servo: ServoAxes,
    flaws: Counter[str],
) -> GuidedMotion:
    options = settings.options
    filter_hz = act.lp_filter_hz if act.lp_filter_hz > 0.0 else options.default_lp_filter_hz
    tuning = Tuning(
        options.k,
        filter_hz if filter_hz > 0.0 else None,
        _LEVEL_1_DELAY_CYCLES if settings.level == 1 else 0,
        options.singularity_threshold,
        options.path_correction_absolute,
    )
    if isinstance(arguments, PathMove):
        return PathCorrectedMotion(servo, tuning, arguments, flaws)
    if arguments.mode is EgmMode.JOINT:
        return GuidedJointMotion(servo, tuning, act, arguments, flaws)
    return GuidedPoseMotion(servo, tuning, act, arguments, flaws)
