"""Status of the servo's ticks."""

from __future__ import annotations

from typing import NamedTuple

from cardan.gateway.kinematics.singularity import SINGULAR

SLOWED = 0.9
"""Share of the requested speed below which the status names the limit."""

UNREACHABLE_M_S, UNREACHABLE_RAD_S = 1e-3, 1e-2
"""Smallest part of the commanded motion that counts as unreachable."""

NEARER_M = 5e-3
"""Least reported approach of a body that moves by itself. A body at rest may move as far within a
cycle."""


class ServoStatus(NamedTuple):
    """Numbers of the last tick. Lengths in m, angles in rad."""

    path_speed: float
    """Share of the commanded speed along the path that was possible, 0..1."""
    smallest_singular_value: float
    damping: float
    limiting_joints: tuple[str, ...]
    """Joints at a bound of speed, acceleration or range."""
    distance_m: float
    """Distance of the nearest pair of bodies; infinite without any. A body that others move counts
    at its nearest possible place."""
    nearest_pair: tuple[str, str]
    active_pairs: int
    error_m: float
    """Distance of the commanded TCP from the reference."""
    error_rad: float
    unreachable_m_s: float
    """Part of the commanded motion that this arm cannot do anywhere, for lack of joints."""
    unreachable_rad_s: float
    failures: int
    """Ticks so far without a solution, or with a step into a collision; each braked."""
    iterations: int = 0
    """Most iterations of the program in a tick so far."""
    compiled: bool = False
    """True if the compiled servo runs."""
    refused: str = ""
    """Fault in the input of the last tick, which therefore braked; empty if none."""
    nearer_m: float = 0.0
    """Largest approach by itself of the first of `nearest_pair` until this arm moves next and it
    stops."""

    @property
    def slowed(self) -> bool:
        """True if a limit slows the arm."""
        return self.path_speed < SLOWED

    @property
    def singular(self) -> bool:
        """True if the arm is so close to a singularity that this may slow it."""
        return self.smallest_singular_value < SINGULAR

    @property
    def overlaps(self) -> bool:
        """True if two bodies overlap."""
        return self.distance_m < 0.0

    @property
    def nearest_in_words(self) -> str:
        """Distance of the nearest pair of bodies, as text."""
        first, second = self.nearest_pair
        if self.nearer_m >= NEARER_M:
            first += f", which may come {self.nearer_m * 1e3:.0f} mm nearer by itself,"
        if self.overlaps:
            return f"{first} and {second} overlap by {self.distance_m * -1e3:.1f} mm"
        return f"{first} and {second} are {self.distance_m * 1e3:.1f} mm apart"

    @property
    def unreachable(self) -> bool:
        """True if the command has a part for which the arm has no joints."""
        return self.unreachable_m_s > UNREACHABLE_M_S or self.unreachable_rad_s > UNREACHABLE_RAD_S

    def limits(self) -> list[str]:
        """Present limits of the arm, in one word each; empty if there are none."""
        slowed = self.slowed
        found = {
            "collision": self.overlaps or (slowed and self.active_pairs > 0),
            "singularity": slowed and self.singular,
            "joint": slowed and bool(self.limiting_joints),
            "unreachable": self.unreachable,
        }
        return [name for name, limits in found.items() if limits]

    def in_words(self) -> list[str]:
        """Present limits of the arm, as text; empty if there are none."""
        found = []
        if self.slowed:
            if self.active_pairs:
                first, second = self.nearest_pair
                found.append(f"{second} is {self.distance_m * 1e3:.0f} mm from {first}")
            if self.singular:
                found.append(f"singular ({self.smallest_singular_value:.3f})")
            if self.limiting_joints:
                found.append(f"limit of {', '.join(self.limiting_joints)}")
            found.insert(0, f"{self.path_speed * 100:.0f} % of the speed asked")
        if self.overlaps:
            first, second = self.nearest_pair
            found.append(
                f"{first} and {second} overlap by {self.distance_m * -1e3:.0f} mm: move apart"
            )
        if self.unreachable:
            found.append(
                f"this arm cannot do {self.unreachable_m_s * 1e3:.0f} mm/s and "
                f"{self.unreachable_rad_s:.2f} rad/s of what is asked"
            )
        if self.refused:
            found.insert(0, self.refused)
        return found
