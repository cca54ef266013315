"""Figures of the rendered force and of the tool's contact, for a session's summary."""

from __future__ import annotations

import math

from cardan.common.haptics import HapticState
from cardan.common.histogram import LatencyHistogram
from cardan.gateway.force.conditioning import LowPass
from cardan.gateway.force.snapshot import ContactSnapshot, ForceSnapshot
from cardan.spatial import dot, norm, subtract
from cardan.types import Vector3

CONTACT_CUTOFF_HZ = 10.0
"""Cut-off of the filter on the contact force before its evaluation: 0.3 N of noise leave 0.1 N."""

CONTACT_FROM_N, CONTACT_UNTIL_N = 1.0, 0.5
"""Contact begins above the first, and ends below the second."""

LONGEST_PERIOD_S = 0.1
"""Longest time counted for one reading."""

FELT_FROM_N = 0.05
"""Smallest force on the hand with a direction along which a depth is measured."""

PATH_STEP_M = 0.0005
"""Step length for the path in contact: noise at rest adds nothing."""


class ContactFigures:
    """The contact force, and the path of the TCP in contact."""

    def __init__(self) -> None:
        self.force_n = 0.0
        """Present contact force, N."""
        self.time_s = 0.0
        self.path_m = 0.0
        self.touching = False
        self._force = LowPass(CONTACT_CUTOFF_HZ)
        self._sum = self._square_sum = 0.0
        self._corner: Vector3 | None = None

    def add(self, force: Vector3, stamp_s: float, place: Vector3 | None) -> None:
        """Take the contact force (N, at the tool) of one reading, and the TCP's position."""
        period_s = min(max(stamp_s - self._force.stamp_s, 0.0), LONGEST_PERIOD_S)
        self._force.add(force, stamp_s)
        now_n = self.force_n = norm(self._force.value)
        self.touching = now_n >= (CONTACT_UNTIL_N if self.touching else CONTACT_FROM_N)
        if not self.touching:
            self._corner = None
            return
        self.time_s += period_s
        self._sum += now_n * period_s
        self._square_sum += now_n * now_n * period_s
        if place is None:
            return
        corner = self._corner
        if corner is None:
            self._corner = place
        elif (step_m := norm(subtract(place, corner))) >= PATH_STEP_M:
            self.path_m += step_m
            self._corner = place

    def lift(self) -> None:
        """Mark the contact as unknown: no force is measured."""
        self.touching, self.force_n, self._corner = False, 0.0, None

    @property
    def mean_n(self) -> float:
        """The mean contact force."""
        return self._sum / self.time_s if self.time_s else 0.0

    def rms_error_n(self, target_n: float | None) -> float:
        """RMS error of the contact force about `target_n`, or about its own mean without one."""
        if not self.time_s:
            return 0.0
        mean = self.mean_n
        target = mean if target_n is None else target_n
        square = self._square_sum / self.time_s - 2.0 * target * mean + target * target
        return math.sqrt(max(0.0, square))

    def report(self, target_n: float | None) -> ContactSnapshot:
        """The figures of a snapshot."""
        return ContactSnapshot(
            self.force_n,
            self.time_s,
            self.path_m,
            self.mean_n,
            target_n,
            self.rms_error_n(target_n),
        )


class StiffnessFigures:
    """Depth of the hand in contact, and the stiffness rendered to it."""

    def __init__(self) -> None:
        self.depth_m = 0.0
        """Largest depth so far, from the hand's position at the first touch."""
        self._origin: Vector3 | None = None
        self._work = self._square_m2 = 0.0

    def add(self, place: Vector3 | None, force: Vector3) -> None:
        """Add the hand's position and the force on it (N), both in the hand frame; the position is
        None while the tool touches nothing, or the hand is clutched out."""
        if place is None:
            self._origin = None
            return
        if self._origin is None:
            self._origin = place
        force_n = norm(force)
        if force_n < FELT_FROM_N:
            return
        depth_m = dot(force, subtract(self._origin, place)) / force_n
        if depth_m <= 0.0:
            return
        self.depth_m = max(self.depth_m, depth_m)
        self._work += force_n * depth_m
        self._square_m2 += depth_m * depth_m

    @property
    def stiffness_n_m(self) -> float | None:
        """Least squares of force over depth, through zero; None: none in contact."""
        return self._work / self._square_m2 if self._square_m2 else None


class HapticFigures:
    """Figures of the rendered force: largest force and energy, and the ages of forces."""

    def __init__(self) -> None:
        self.peak_n = 0.0
        """Largest force in any tick, N."""
        self.given_peak_j = 0.0
        """Largest net energy given to the hand within one engagement, an upper bound."""
        self.fixture_age = LatencyHistogram()
        """Age of the position that fixtures are evaluated at: longest tick of each snapshot."""
        self.measured_age = LatencyHistogram()
        self.newest = HapticState()

    def add(self, state: HapticState, fixtures: bool, measured: bool) -> None:
        """Add the device's newest snapshot, with or without fixtures and a measured force."""
        self.newest = state
        self.peak_n = max(self.peak_n, state.peak_n)
        self.given_peak_j = max(self.given_peak_j, state.given_peak_j)
        if fixtures and state.gap_s > 0.0:
            self.fixture_age.add(state.gap_s + state.tick_cost_s)
        if measured and math.isfinite(state.force_age_s):
            self.measured_age.add(state.force_age_s)

    def report(self) -> ForceSnapshot:
        """Return its figures of a snapshot."""
        state = self.newest
        return ForceSnapshot(
            state=state.state.value,
            reason=state.reason,
            rendered_n=norm(state.force),
            peak_n=self.peak_n,
            age_s=state.force_age_s,
            fixture_age_p50_s=_percentile(self.fixture_age, 50),
            fixture_age_p99_s=_percentile(self.fixture_age, 99),
            measured_age_p50_s=_percentile(self.measured_age, 50),
            measured_age_p99_s=_percentile(self.measured_age, 99),
            energy_j=state.energy_j,
            energy_given_j=state.delivered_j,
            energy_given_peak_j=self.given_peak_j,
            passivity_damping_n_s_m=state.passivity_damping_n_s_m,
        )


def _percentile(ages: LatencyHistogram, percent: float) -> float | None:
    return ages.percentile(percent) if ages.count else None
