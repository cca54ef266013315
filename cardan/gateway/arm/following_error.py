"""The following error: distance between a robot and its command, and its limits."""

from __future__ import annotations

from typing import NamedTuple


class FollowingError(NamedTuple):
    """Distance between a robot and its command."""

    linear_m: float
    angular_rad: float
    joint_error: float = 0.0
    """Error of the worst joint: rad, or m for a prismatic one; 0 without an arm's model."""
    joint: str = ""
    """That joint's name."""

    def exceeds(self, limit: FollowingError, share: float = 1.0) -> bool:
        """Return whether one of the three is larger than `share` of its value in `limit`."""
        return (
            self.linear_m > share * limit.linear_m
            or self.angular_rad > share * limit.angular_rad
            or self.joint_error > share * limit.joint_error
        )

    def in_words(self, relation: str) -> str:
        """Return a message such as "the robot is 12 mm and 0.10 rad behind its reference (joint_2
        by 0.10)"."""
        if not self.linear_m and not self.angular_rad and self.joint:
            away = f"{self.joint_error:.3f} rad {relation}"
            return f"{self.joint} is {away} where it was commanded to be"
        joint = f" ({self.joint} by {self.joint_error:.2f})" if self.joint else ""
        return (
            f"the robot is {self.linear_m * 1e3:.0f} mm and {self.angular_rad:.2f} rad {relation} "
            f"its reference{joint}"
        )
