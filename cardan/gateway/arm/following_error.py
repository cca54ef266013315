"""The following error: how far a robot is from where it is commanded to be, and what stops it."""

from __future__ import annotations

from typing import NamedTuple


class FollowingError(NamedTuple):
    """How far a robot is from where it is commanded to be."""

    linear_m: float
    angular_rad: float
    joint_error: float = 0.0
    """Error of the worst joint: rad, or m for a prismatic one; 0 without an arm's model."""
    joint: str = ""
    """That joint's name."""

    def exceeds(self, limit: FollowingError, share: float = 1.0) -> bool:
        """True when one of the three is larger than `share` of that of `limit`."""
        return (
            self.linear_m > share * limit.linear_m
            or self.angular_rad > share * limit.angular_rad
            or self.joint_error > share * limit.joint_error
        )

    def in_words(self, relation: str) -> str:
        """For example "the robot is 12 mm and 0.10 rad behind its reference (joint_2 by 0.10)"."""
        if not self.linear_m and not self.angular_rad and self.joint:
            away = f"{self.joint_error:.3f} rad {relation}"
            return f"{self.joint} is {away} where it was commanded to be"
        joint = f" ({self.joint} by {self.joint_error:.2f})" if self.joint else ""
        return (
            f"the robot is {self.linear_m * 1e3:.0f} mm and {self.angular_rad:.2f} rad {relation} "
            f"its reference{joint}"
        )
