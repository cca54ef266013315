"""Detection of a shifted zero, as opposed to a cap that is held still."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cardan.types import NEVER_S

DRIFT_AFTER_S = 5.0
"""Duration of a constant small deflection that proves a shifted zero: no hand is so still."""

DRIFT_BAND = 2
"""Jitter of a resting axis, counts."""

DRIFT_LIMIT = 0.2
"""Largest constant deflection that counts as a shifted zero, as a share of the full scale."""

CHECK_PERIOD_S = 0.25


class DriftDetector:
    """Detector of a shifted zero; `update` is due from `due_s` on."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Restart the estimate."""
        self.due_s = NEVER_S
        self.drifting = False
        self._reference: Sequence[int] | None = None
        self._since_s = math.inf

    def update(self, counts: Sequence[int], full_scale: float, now_s: float) -> None:
        """Process the counts of the six axes."""
        self.due_s = now_s + CHECK_PERIOD_S
        if not DRIFT_BAND < max(map(abs, counts)) <= DRIFT_LIMIT * full_scale:
            self.drifting = False
            self._reference = None
        elif self._reference is None or any(
            abs(a - b) > DRIFT_BAND for a, b in zip(counts, self._reference, strict=True)
        ):
            self.drifting = False
            self._reference = counts
            self._since_s = now_s
        else:
            self.drifting = now_s - self._since_s >= DRIFT_AFTER_S
