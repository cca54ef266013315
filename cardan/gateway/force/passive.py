"""Passivity of a remote force, for any delay, jitter and loss.

A two-port after Ryu, Artigas and Preusche (A passive bilateral control scheme for a teleoperator
with time-varying communication delay, 2010): each end observes the energy at its own port and
transmits only sums, so the newest received sum is correct despite packets lost, reordered or
duplicated. A delayed sum errs on the safe side. The arm's end (`FarPort`) sends the net energy that
the surroundings have absorbed; the device's end (`DevicePort`) renders no force that would return
more than they have given back by then, or in all more than the hand put in.

Two things differ from the paper. The arm's motion is not limited by the energy that the hand has
put in: its motors supply the rest, and a limited arm would stay offset from the hand until the next
clutch. Wave variables cause such an offset with every lost packet, and also damp free motion. The
device's end acts before it returns energy, not after: it predicts the hand's motion until its next
step.

Hand frame, SI units; time is an argument. Energy observed with a hand at rest is noise, so sums are
of signed work, in which noise cancels.
"""

from __future__ import annotations

import math

from cardan.spatial import dot, norm, scale, subtract
from cardan.types import ZERO3, Vector3

BUDGET_J = 0.005
"""Net energy that one engagement may give to the hand, as an Omni's own loop allows it by default:
noise and prediction need some."""

SURPLUS_J = 0.05
"""Largest energy put in by the hand that it can get back: a spring of 40 N/m at 2 N."""

HARDEST_M_S2 = 60.0
"""Largest acceleration assumed for a hand on a stylus. A hand that exceeds it may get more energy
in one step, and gets that much less in the next."""

LONGEST_STEP_S = 0.02
"""Longest step at the device's end: after a longer one there is no force until the next step."""

HOLD_S, FADE_S = 0.1, 0.1
"""Silence after which a force fades, and the duration of the fade, both ways."""

OLDEST_S = 0.6
"""Round trip above which a force fades: 0.2 s each way, and jitter."""


def share_left(silent_s: float, round_s: float) -> float:
    """Return the share of a force that is left, 0 to 1. `silent_s`: time since the last packet;
    `round_s`: time since the hand was at the position that the force answers."""
    late_s = max(silent_s - HOLD_S, round_s - OLDEST_S)
    return 1.0 if late_s <= 0.0 else max(0.0, 1.0 - late_s / FADE_S)


class FarPort:
    """The arm's end: energy of the hand's motion that the surroundings absorbed, as it arrives."""

    def __init__(self) -> None:
        self.absorbed_j = 0.0
        """Net energy, at least 0: surroundings cannot give more than they absorbed."""
        self._place: Vector3 | None = None
        self._force = ZERO3

    def forget(self) -> None:
        """Reset at a clutch-out: the next engagement has its own energy."""
        self.absorbed_j, self._place = 0.0, None

    def rest(self) -> None:
        """Suspend while there is no force: motion does no work until the next step."""
        self._place = None

    def step(self, place: Vector3, force: Vector3) -> float:
        """Return the hand's position that the arm follows now, the force that is sent, and
        `absorbed_j`."""
        if self._place is not None:
            work_j = dot(self._force, subtract(place, self._place))
            self.absorbed_j = max(0.0, self.absorbed_j - work_j)
        self._place, self._force = place, force
        return self.absorbed_j


class DevicePort:
    """The device's end, from clutch-in to clutch-out."""

    def __init__(self, budget_j: float = BUDGET_J) -> None:
        self._budget_j = budget_j
        self.put_in_j = 0.0
        """Net energy that the hand has put in against the rendered force; SURPLUS_J at most."""
        self._most_in_j = self._most_absorbed_j = 0.0
        """Largest `put_in_j` so far, and largest energy that the surroundings had absorbed."""
        self._place: Vector3 | None = None
        self._force = ZERO3
        self._moved = ZERO3
        self._now_s = math.nan
        self.share = 0.0
        """Share of the force that is rendered now: it fades out, and returns slowly."""

    def rest(self) -> None:
        """Suspend while the device renders no force: the hand's motion since the last step is no
        work."""
        self._force = ZERO3

    def step(
        self, place: Vector3, asked: Vector3, absorbed_j: float, left: float, now_s: float
    ) -> Vector3:
        """Return the force to render until the next step, N. `asked` and `absorbed_j` are the
        newest received from the arm's end; `left` is `share_left()` of them."""
        before, dt_s = self._place, now_s - self._now_s
        self._place, self._now_s = place, now_s
        if before is not None:
            self._moved = subtract(place, before)
            put_in_j = -dot(self._force, self._moved)
            if not 0.0 < dt_s <= LONGEST_STEP_S:
                # The time for which the device has rendered the force is unknown.
                put_in_j = min(put_in_j, 0.0)
            self.put_in_j = min(self.put_in_j + put_in_j, SURPLUS_J)
        if before is None or not 0.0 < dt_s <= LONGEST_STEP_S:
            # The hand's motion until the next step cannot be predicted.
            self._force, self.share = ZERO3, 0.0
            return ZERO3
        # The force returns slowly, without a jolt after a release.
        self.share = min(left, self.share + dt_s / FADE_S)
        force = scale(asked, self.share)
        self._most_in_j = max(self._most_in_j, self.put_in_j)
        self._most_absorbed_j = max(self._most_absorbed_j, absorbed_j)
        returned_j = self._most_absorbed_j - absorbed_j
        taken_j = self._most_in_j - self.put_in_j
        allowed_j = self._budget_j + min(self.put_in_j, returned_j - taken_j)
        size = norm(force)
        if size > 0.0:
            error_m = HARDEST_M_S2 * dt_s * dt_s
            away_m = dot(force, self._moved) / size + error_m
            if away_m > 0.0 and size * away_m > allowed_j:
                force = scale(force, max(0.0, allowed_j) / (size * away_m))
        self._force = force
        return force
