"""What the tick of the force feedback keeps to, and how far a device may be driven."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

WORKSPACE_LOWER_M = (-0.12, -0.2, -0.1)
WORKSPACE_UPPER_M = (0.075, 0.2, 0.195)
"""Hand frame: an Omni's largest workspace, less 5 to 10 mm on every side."""


@dataclass(frozen=True, kw_only=True)
class TickLimits:
    """What the tick keeps to, whatever it is told to render. ValueError for what is not allowed."""

    clamp_n: float = 2.0
    """Largest norm of the force, N, 3.3 at most; the direction is kept."""
    slew_rise_n_s: float = 50.0
    """How fast the force may change while it grows, N/s."""
    slew_fall_n_s: float = 400.0
    """How fast while it shrinks, N/s; at least clamp_n / release_s."""
    release_s: float = 0.005
    """Whatever forbids force has it at zero within so long, s."""
    engage_ramp_s: float = 1.0
    """An engagement's force comes in over so long, s."""
    engage_below_n: float = 0.2
    """Before that the commanded force must have been smaller than this, N, ..."""
    engage_ticks: int = 4
    """... for so many ticks in a row."""
    hold_s: float = 0.020
    """A command is rendered for so long, s; then the force is released."""
    pause_s: float = 0.2
    """After a silence of so long, s, the state is PAUSED; after it, or after a stall of the loop
    that lasted longer, the force must be small first and comes in by the whole ramp."""
    measured_hold_s: float = 0.05
    """A measured force is rendered for so long, s."""
    velocity_gate_m_s: float = 1.0
    """A stylus under force that is faster than this flies: FAULT."""
    damping_n_s_m: float = 0.5
    """Damping in the tick, of the filtered velocity."""
    velocity_cutoff_hz: float = 30.0
    """Of the velocity's low-pass filter."""
    continuous_n: float = 0.88
    """The force's root mean square, exponentially weighted over continuous_window_s as a motor
    warms, stays below this, N."""
    continuous_window_s: float = 10.0
    """s."""
    thermal_derating_s: float = 1.0
    """Time constant with which the clamp then goes down to continuous_n, s."""
    temperature_limit: float = 0.9
    """No force at this motor temperature (0 cold, 1 hottest); less and less from 0.2 below it."""
    passivity: bool = True
    """The passivity controller acts; its observer always does."""
    alpha_max_n_s_m: float = 4.0
    """Most damping of the passivity controller."""
    energy_budget_j: float = 0.005
    """Net energy an engagement may give to the hand, J (tick.h has the exact bound)."""
    prediction_error_m: float = 1e-4
    """How far the stylus's next position may be from where its motion would carry it, m: 1e-4 at
    1 kHz is 100 m/s²."""
    leak_s: float = 3.0
    """Time constant with which energy taken in is forgotten in free space, s."""
    workspace_lower_m: tuple[float, float, float] = WORKSPACE_LOWER_M
    workspace_upper_m: tuple[float, float, float] = WORKSPACE_UPPER_M
    """Hand frame, m. Outside a spring leads back, and fixtures fade over 20 mm."""
    edge_stiffness_n_m: float = 200.0
    extrapolate_s: float = 0.008
    """A measured force goes on with its rate and stiffness for so long, s."""
    overrun_gap_s: float = 0.002
    """After a gap of so long between ticks, s, no force is asked for in the next one."""
    pause_gap_s: float = 0.020
    """After a gap of so long, s, the state is PAUSED."""
    oscillation_reversals: int = 8
    """So many changes of the velocity's sign along one axis ..."""
    oscillation_window_s: float = 0.1
    """... within this time, s, ..."""
    oscillation_speed_m_s: float = 0.02
    """... each between speeds above this halve the force; the second time it is PAUSED."""
    force_error_wait_s: float = 0.5
    """No force for so long after a force error of the library, s; three in 10 s are a FAULT."""
    torque_limit_n_m: float = 0.35
    """Of each joint, where the device is driven by joint torques, N·m."""
    lowest_rate_hz: float = 900.0
    """No force while the loop runs slower than this, Hz: a wall would oscillate."""

    def __post_init__(self) -> None:
        self._check_sense()
        self._check_ranges()

    def _check_ranges(self) -> None:
        for name, (low, high, reason) in RANGES.items():
            if not low <= (value := getattr(self, name)) <= high:
                raise ValueError(f"{name} is {value:g}; allowed: {low:g} to {high:g}: {reason}")
        for name in ("workspace_lower_m", "workspace_upper_m"):
            if any(abs(x) > 1.0 for x in getattr(self, name)):
                raise ValueError(f"{name} is {getattr(self, name)!r}; allowed: -1 to 1 m")
        if self.engage_ticks > 10_000:
            raise ValueError(f"engage_ticks is {self.engage_ticks}; allowed: 1 to 10000")

    def _check_sense(self) -> None:
        for name in RANGES:
            value = getattr(self, name)
            if not _is_number(value):
                raise ValueError(f"{name} is {value!r}; allowed: a number")
            if name in _MAY_BE_ZERO and value < 0.0:
                raise ValueError(f"{name} is {value:g}; allowed: 0 or more")
            if name not in _MAY_BE_ZERO and value <= 0.0:
                raise ValueError(f"{name} is {value:g}; allowed: above 0")
        for name in ("engage_ticks", "oscillation_reversals"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int):
                raise ValueError(f"{name} is {value!r}; allowed: a whole number")
        if not isinstance(self.passivity, bool):
            raise ValueError(f"passivity is {self.passivity!r}; allowed: true or false")
        if self.clamp_n > 3.3:
            raise ValueError(f"clamp_n is {self.clamp_n:g}; allowed: at most 3.3 N")
        if self.release_s > 0.05:
            raise ValueError(f"release_s is {self.release_s:g}; allowed: at most 0.05 s")
        if self.slew_fall_n_s * self.release_s < self.clamp_n * (1.0 - 1e-9):
            raise ValueError(
                f"slew_fall_n_s is {self.slew_fall_n_s:g}; allowed: at least clamp_n / release_s, "
                f"{self.clamp_n / self.release_s:g} N/s, so that a release keeps release_s"
            )
        for shorter, longer in (("hold_s", "pause_s"), ("overrun_gap_s", "pause_gap_s")):
            if getattr(self, longer) < getattr(self, shorter):
                raise ValueError(
                    f"{longer} is {getattr(self, longer):g}; allowed: at least {shorter}, "
                    f"{getattr(self, shorter):g} s"
                )
        for name in ("workspace_lower_m", "workspace_upper_m"):
            corner = getattr(self, name)
            if (
                not isinstance(corner, (tuple, list))
                or len(corner) != 3
                or not all(map(_is_number, corner))
            ):
                raise ValueError(f"{name} is {corner!r}; allowed: three lengths in m")
        if not all(
            low < high
            for low, high in zip(self.workspace_lower_m, self.workspace_upper_m, strict=True)
        ):
            raise ValueError(
                f"workspace_upper_m is {self.workspace_upper_m!r}; allowed: above "
                f"workspace_lower_m, {self.workspace_lower_m!r}, along each axis"
            )
        if not 1 <= self.engage_ticks < 2**31:
            raise ValueError(f"engage_ticks is {self.engage_ticks}; allowed: 1 to 10000")
        if not 2 <= self.oscillation_reversals <= 32:
            raise ValueError(
                f"oscillation_reversals is {self.oscillation_reversals}; allowed: 2 to 32"
            )


@dataclass(frozen=True, kw_only=True)
class UncheckedLimits(TickLimits):
    """Limits outside the ranges a device may be driven with: for experiments on a simulated one,
    such as what a plain loop would do. ValueError for what makes no sense at all."""

    def _check_ranges(self) -> None:
        pass


RANGES: Mapping[str, tuple[float, float, str]] = MappingProxyType(
    {
        "clamp_n": (0.01, 3.3, "the device bears no more, N"),
        "slew_rise_n_s": (1.0, 400.0, "a faster rise is a blow, N/s"),
        "slew_fall_n_s": (1.0, 3300.0, "the largest force within 1 ms, N/s"),
        "release_s": (0.001, 0.05, "what forbids force takes it soon, s"),
        "engage_ramp_s": (0.01, 10.0, "a force comes in, it does not strike, s"),
        "engage_below_n": (0.001, 0.5, "what it begins with must be no surprise, N"),
        "hold_s": (0.001, 0.2, "a dead program must not go on pushing, s"),
        "pause_s": (0.001, 1.0, "after so long the hand is elsewhere, s"),
        "measured_hold_s": (0.001, 0.2, "a dead sensor must not go on pushing, s"),
        "velocity_gate_m_s": (0.2, 2.0, "a hand is slower, a flying stylus is not, m/s"),
        "damping_n_s_m": (0.0, 3.0, "more is unstable at 1 kHz with a filtered velocity, N·s/m"),
        "velocity_cutoff_hz": (5.0, 100.0, "lower is late, higher is the encoders' quantum, Hz"),
        "continuous_n": (0.01, 1.5, "the motors bear 0.88 for long, N"),
        "continuous_window_s": (1.0, 30.0, "a motor warms within some ten seconds, s"),
        "thermal_derating_s": (0.05, 10.0, "warm motors are spared soon, s"),
        "temperature_limit": (0.05, 1.0, "at 1 the library switches off by itself"),
        "alpha_max_n_s_m": (0.0, 10.0, "more is unstable by itself, N·s/m"),
        "energy_budget_j": (0.0, 0.2, "1 m/s of a hand of 0.4 kg, J"),
        "prediction_error_m": (1e-5, 1e-3, "10 to 1000 m/s² at 1 kHz, m"),
        "leak_s": (0.01, 60.0, "a surplus is not kept for the next contact, s"),
        "edge_stiffness_n_m": (0.0, 500.0, "a stiffer one oscillates, N/m"),
        "extrapolate_s": (0.0, 0.05, "a force of later is a guess, s"),
        "overrun_gap_s": (0.0012, 0.02, "a tick comes every 1 ms, s"),
        "pause_gap_s": (0.002, 0.1, "a hand moves on meanwhile, s"),
        "oscillation_window_s": (0.02, 1.0, "an oscillation is 20 Hz and more, s"),
        "oscillation_speed_m_s": (0.001, 0.2, "an oscillation is not faster, m/s"),
        "force_error_wait_s": (0.1, 10.0, "the library's own ramp takes its time, s"),
        "torque_limit_n_m": (0.01, 0.5, "the motors give no more, N·m"),
        "lowest_rate_hz": (800.0, 960.0, "the limits are those of a loop of 1 kHz, Hz"),
    }
)
"""Lowest and highest value of a limit that a device may be driven with, and why no more."""
_MAY_BE_ZERO = frozenset(
    {
        "engage_ramp_s",
        "damping_n_s_m",
        "alpha_max_n_s_m",
        "energy_budget_j",
        "prediction_error_m",
        "edge_stiffness_n_m",
        "extrapolate_s",
        "force_error_wait_s",
    }
)


def _is_number(value: object) -> bool:
    return (
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and abs(value) < 1e300  # No overflow on the way to a double either.
    )
