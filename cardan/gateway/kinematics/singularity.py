"""Singular postures of an arm."""

SINGULAR = 0.03
"""Smallest singular value below which a slow arm is called singular."""

UNBENT = "the arm is singular there ({:.3f}): move its joints to a bent posture first"
"""Advice for a motion that cannot continue, by the smallest singular value."""
