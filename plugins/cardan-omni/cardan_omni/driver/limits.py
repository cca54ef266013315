"""Limits of the force feedback's tick, and their ranges for a real device.

checks.c has the same ranges. An annotation's second range is that of experiments (UncheckedLimits).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, get_args, get_origin

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import check_field, check_options, hints, require_each

WORKSPACE_LOWER_M = (-0.12, -0.2, -0.1)
WORKSPACE_UPPER_M = (0.075, 0.2, 0.195)
"""Hand frame: an Omni's largest workspace, less 5 to 10 mm on every side."""

_MOST = 1e300
"""No overflow on the way to a double."""
ABOVE_NONE = Range(0.0, _MOST, "", "without it the tick makes no sense", above=True)
NONE_OR_MORE = replace(ABOVE_NONE, above=False)
ANYWHERE_M = Range(-_MOST, _MOST, "m", "the range of a double")

CLAMP_N = Range(0.01, 3.3, "N", "the device bears no more")
CLAMP_N_OF_EXPERIMENTS = replace(CLAMP_N, lowest=0.0, above=True)
SLEW_RISE_N_S = Range(1.0, 400.0, "N/s", "a faster rise is a blow")
SLEW_FALL_N_S = Range(1.0, 3300.0, "N/s", "the largest force within 1 ms")
RELEASE_S = Range(0.001, 0.05, "s", "a force that is not allowed must end soon")
RELEASE_S_OF_EXPERIMENTS = replace(RELEASE_S, lowest=0.0, above=True)
ENGAGE_RAMP_S = Range(0.01, 10.0, "s", "a force must begin gradually")
ENGAGE_BELOW_N = Range(0.001, 0.5, "N", "the first force must not startle")
HOLD_S = Range(0.001, 0.2, "s", "a dead program must not go on pushing")
PAUSE_S = Range(0.001, 1.0, "s", "after a longer pause the hand is elsewhere")
MEASURED_HOLD_S = Range(0.001, 0.2, "s", "a dead sensor must not go on pushing")
VELOCITY_GATE_M_S = Range(0.2, 2.0, "m/s", "a held stylus is slower, a loose one is faster")
DAMPING_N_S_M = Range(0.0, 3.0, "N·s/m", "more is unstable at 1 kHz with a filtered velocity")
VELOCITY_CUTOFF_HZ = Range(5.0, 100.0, "Hz", "lower lags, higher shows the encoders' resolution")
CONTINUOUS_N = Range(0.01, 1.5, "N", "the motors bear 0.88 N continuously")
CONTINUOUS_WINDOW_S = Range(1.0, 30.0, "s", "a motor warms within some ten seconds")
THERMAL_DERATING_S = Range(0.05, 10.0, "s", "warm motors must be relieved soon")
TEMPERATURE_LIMIT = Range(0.05, 1.0, "", "at 1 the library switches off by itself")
ALPHA_MAX_N_S_M = Range(0.0, 10.0, "N·s/m", "more is unstable by itself")
ENERGY_BUDGET_J = Range(0.0, 0.2, "J", "1 m/s of a hand of 0.4 kg")
PREDICTION_ERROR_M = Range(1e-05, 0.001, "m", "10 to 1000 m/s² at 1 kHz")
LEAK_S = Range(0.01, 60.0, "s", "surplus energy must not last until the next contact")
EDGE_STIFFNESS_N_M = Range(0.0, 500.0, "N/m", "a stiffer one oscillates")
EXTRAPOLATE_S = Range(0.0, 0.05, "s", "a longer extrapolation is a guess")
OVERRUN_GAP_S = Range(0.0012, 0.02, "s", "a tick comes every 1 ms")
PAUSE_GAP_S = Range(0.002, 0.1, "s", "a hand moves on meanwhile")
OSCILLATION_WINDOW_S = Range(0.02, 1.0, "s", "an oscillation is 20 Hz and more")
OSCILLATION_SPEED_M_S = Range(0.001, 0.2, "m/s", "an oscillation is not faster")
FORCE_ERROR_WAIT_S = Range(0.1, 10.0, "s", "the library's own ramp takes its time")
TORQUE_LIMIT_N_M = Range(0.01, 0.5, "N·m", "the motors give no more")
LOWEST_RATE_HZ = Range(800.0, 960.0, "Hz", "the limits are those of a loop of 1 kHz")
ENGAGE_TICKS = Range(1, 10_000, "", "10 000 ticks are ten seconds")
OSCILLATION_REVERSALS = Range(2, 32, "", "the tick remembers no more")

_Meter = Annotated[float, bounds.DESK_M, ANYWHERE_M]


@dataclass(frozen=True, kw_only=True)
class TickLimits:
    """Limits that the tick enforces on every command. Raises OptionError."""

    clamp_n: Annotated[float, CLAMP_N, CLAMP_N_OF_EXPERIMENTS] = 2.0
    """Largest norm of the force, N, 3.3 at most; the direction is kept."""
    slew_rise_n_s: Annotated[float, SLEW_RISE_N_S] = 50.0
    """Fastest rise of the force, N/s."""
    slew_fall_n_s: Annotated[float, SLEW_FALL_N_S] = 400.0
    """Fastest fall of the force, N/s; at least clamp_n / release_s."""
    release_s: Annotated[float, RELEASE_S, RELEASE_S_OF_EXPERIMENTS] = 0.005
    """Longest time to zero force once force is not allowed, s."""
    engage_ramp_s: Annotated[float, ENGAGE_RAMP_S, NONE_OR_MORE] = 1.0
    """Duration of the ramp of force when it engages, s."""
    engage_below_n: Annotated[float, ENGAGE_BELOW_N] = 0.2
    """Force below which the commanded force must have been before it engages, N, ..."""
    engage_ticks: Annotated[int, ENGAGE_TICKS] = 4
    """... for this number of ticks in a row."""
    hold_s: Annotated[float, HOLD_S] = 0.020
    """Time for which a command is rendered, s; then the force is released."""
    pause_s: Annotated[float, PAUSE_S] = 0.2
    """Silence of the commands, s, after which the state is PAUSED; after that, or a longer stall
    of the loop, the force must be small first and rises by the whole ramp."""
    measured_hold_s: Annotated[float, MEASURED_HOLD_S] = 0.05
    """Time for which a measured force is rendered, s."""
    velocity_gate_m_s: Annotated[float, VELOCITY_GATE_M_S] = 1.0
    """Speed above which a stylus under force counts as released: FAULT."""
    damping_n_s_m: Annotated[float, DAMPING_N_S_M] = 0.5
    """Damping added by the tick, on the filtered velocity."""
    velocity_cutoff_hz: Annotated[float, VELOCITY_CUTOFF_HZ] = 30.0
    """Cut-off of the velocity's low-pass filter."""
    continuous_n: Annotated[float, CONTINUOUS_N] = 0.88
    """The force's root mean square, exponentially weighted over continuous_window_s as a motor
    warms, is limited to this, N."""
    continuous_window_s: Annotated[float, CONTINUOUS_WINDOW_S] = 10.0
    """Time constant of that mean square, s."""
    thermal_derating_s: Annotated[float, THERMAL_DERATING_S] = 1.0
    """Time constant with which the clamp then goes down to continuous_n, s."""
    temperature_limit: Annotated[float, TEMPERATURE_LIMIT] = 0.9
    """Motor temperature (0 cold, 1 hottest) at which force ends; it is reduced gradually from 0.2
    below."""
    passivity: bool = True
    """Enable the passivity controller; its observer always runs."""
    alpha_max_n_s_m: Annotated[float, ALPHA_MAX_N_S_M] = 4.0
    """Largest damping of the passivity controller."""
    energy_budget_j: Annotated[float, ENERGY_BUDGET_J] = 0.005
    """Net energy an engagement may give to the hand, J (tick.h has the exact bound)."""
    prediction_error_m: Annotated[float, PREDICTION_ERROR_M, NONE_OR_MORE] = 1e-4
    """Largest distance of the next position from the one predicted by the stylus's motion, m: 1e-4
    at 1 kHz is 100 m/s²."""
    leak_s: Annotated[float, LEAK_S] = 3.0
    """Time constant with which energy taken in is forgotten in free space, s."""
    workspace_lower_m: tuple[_Meter, _Meter, _Meter] = WORKSPACE_LOWER_M
    """First corner of the workspace, hand frame, m. If both corners are left at their defaults, the
    device's own largest workspace counts, less 10 mm."""
    workspace_upper_m: tuple[_Meter, _Meter, _Meter] = WORKSPACE_UPPER_M
    """Opposite corner. Outside, a spring pulls back, and fixtures fade over 20 mm."""
    edge_stiffness_n_m: Annotated[float, EDGE_STIFFNESS_N_M] = 200.0
    """Stiffness of the spring that pulls back from outside, N/m."""
    extrapolate_s: Annotated[float, EXTRAPOLATE_S] = 0.008
    """Time for which a measured force is extrapolated from its rate and stiffness, s."""
    overrun_gap_s: Annotated[float, OVERRUN_GAP_S] = 0.002
    """Gap between ticks, s, after which the next tick sends no force."""
    pause_gap_s: Annotated[float, PAUSE_GAP_S] = 0.020
    """Gap between ticks, s, after which the state is PAUSED."""
    oscillation_reversals: Annotated[int, OSCILLATION_REVERSALS] = 8
    """Number of sign changes of the velocity along one axis ..."""
    oscillation_window_s: Annotated[float, OSCILLATION_WINDOW_S] = 0.1
    """... within this time, s, ..."""
    oscillation_speed_m_s: Annotated[float, OSCILLATION_SPEED_M_S] = 0.02
    """... each between speeds above this, that halve the force; the second time it is PAUSED."""
    force_error_wait_s: Annotated[float, FORCE_ERROR_WAIT_S, NONE_OR_MORE] = 0.5
    """Time without force after a force error of the library, s; three errors in 10 s are a
    FAULT."""
    torque_limit_n_m: Annotated[float, TORQUE_LIMIT_N_M] = 0.35
    """Largest torque of each joint, if the device is driven by joint torques, N·m."""
    lowest_rate_hz: Annotated[float, LOWEST_RATE_HZ] = 900.0
    """Rate of the loop below which there is no force, Hz: a virtual wall would oscillate."""

    def __post_init__(self) -> None:
        self._check_ranges()
        lower, upper = self.workspace_lower_m, self.workspace_upper_m
        slowest_n_s = self.clamp_n / self.release_s
        require_each(
            self,
            (
                "slew_fall_n_s",
                self.slew_fall_n_s * self.release_s >= self.clamp_n * (1.0 - 1e-9),
                f"at least clamp_n / release_s, {slowest_n_s:g} N/s, so that a release keeps "
                "release_s",
            ),
            ("pause_s", self.pause_s >= self.hold_s, f"at least hold_s, {self.hold_s:g} s"),
            (
                "pause_gap_s",
                self.pause_gap_s >= self.overrun_gap_s,
                f"at least overrun_gap_s, {self.overrun_gap_s:g} s",
            ),
            (
                "workspace_upper_m",
                all(low < high for low, high in zip(lower, upper, strict=True)),
                f"above workspace_lower_m, {lower!r}, along each axis",
            ),
        )

    def _check_ranges(self) -> None:
        check_options(self)


@dataclass(frozen=True, kw_only=True)
class UncheckedLimits(TickLimits):
    """Limits outside the ranges of a real device, for experiments on a simulated one. Raises
    OptionError for impossible values."""

    def _check_ranges(self) -> None:
        for name, hint in hints(TickLimits).items():
            check_field(self, name, _of_experiments(hint))


def _of_experiments(hint: Any) -> Any:
    """Return the annotation of a limit without the range of a device."""
    kind, *ranges = get_args(hint) or (hint,)
    if get_origin(hint) is tuple:
        return tuple[(_of_experiments(kind),) * 3]  # type: ignore[misc]
    if kind is not float:
        return hint
    device, *own = ranges
    least = NONE_OR_MORE if device.lowest == 0.0 else ABOVE_NONE
    return Annotated[float, own[0] if own else least]
