"""Mapping from tilt, angular rates, stick and buttons to six deflections.

All deflections are zero unless a clutch button is held. The roles "paper" follow Łukawski, Victores
and Balaguer 2023 in the tool's axes, as in their published controller: a tilt of 1 g is a
deflection of 1, which `mapping` scales to its 0.1 rad/s, and A and B to 0.01 m/s.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from cardan.drivers.shaping import Deflections

STICK_BUTTON = "z"
"""Nunchuk's trigger: a clutch for its stick alone."""


class RemoteMotion(NamedTuple):
    """Buttons, tilt, rates and stick of the operator's remote."""

    buttons: frozenset[str]
    rolled: float
    """Tilt to the right, -1..1."""
    dipped: float
    """Tilt nose down, -1..1."""
    rates: tuple[float, float, float]
    """Angular rates about x forward, y left, z up; 1 is full deflection."""
    stick: tuple[float, float]
    """The Nunchuk's stick: forward and left, -1..1."""


class Roles(ABC):
    """Mapping from the operator's motion to deflections."""

    clutch: frozenset[str]
    """Buttons that enable the remote's own motion while held."""
    needs_rates = False
    """True if they use a MotionPlus."""

    def on_press(self, buttons: frozenset[str]) -> None:  # noqa: B027 - most roles have no modes
        """Handle `buttons` pressed at the same time."""

    def reset(self) -> None:  # noqa: B027
        """Reset the modes for a new link."""

    @property
    def yaw(self) -> bool:
        """True if tilt to the side rotates about z instead of x."""
        return False

    def axes(self, motion: RemoteMotion) -> Deflections:
        """Return the deflections, before shaping."""
        held = not self.clutch.isdisjoint(motion.buttons)
        x, y, z, rx, ry, rz = self._moved(motion) if held else (0.0,) * 6
        if held or STICK_BUTTON in motion.buttons:
            x, y = _clamped(x + motion.stick[0]), _clamped(y + motion.stick[1])
        return (x, y, z, _clamped(rx), _clamped(ry), _clamped(rz))

    @abstractmethod
    def _moved(self, motion: RemoteMotion) -> Deflections:
        """Return the deflections by the remote itself while its clutch is held."""


class PaperRoles(Roles):
    """A: forward along z; B: back; both: rotation only. Tilt rotates: to the side about x (about z
    after button 2, until button 1), nose down about y."""

    clutch = frozenset({"a", "b"})

    def __init__(self) -> None:
        self._yaw = False

    @property
    def yaw(self) -> bool:
        return self._yaw

    def reset(self) -> None:
        self._yaw = False

    def on_press(self, buttons: frozenset[str]) -> None:
        if "one" in buttons:
            self._yaw = False
        elif "two" in buttons:
            self._yaw = True

    def _moved(self, motion: RemoteMotion) -> Deflections:
        z = float("a" in motion.buttons) - float("b" in motion.buttons)
        if self._yaw:
            return (0.0, 0.0, z, 0.0, motion.dipped, motion.rolled)
        return (0.0, 0.0, z, motion.rolled, motion.dipped, 0.0)


class TiltRoles(Roles):
    """B held: nose down moves forward, tilt to the right moves right, the cross moves up and down
    and rotates about z. With A as well, tilt rotates about x and y instead."""

    clutch = frozenset({"b"})

    def _moved(self, motion: RemoteMotion) -> Deflections:
        z = _cross(motion.buttons, "up", "down")
        rz = _cross(motion.buttons, "left", "right")
        if "a" in motion.buttons:
            return (0.0, 0.0, z, motion.rolled, motion.dipped, rz)
        return (motion.dipped, -motion.rolled, z, 0.0, 0.0, rz)


class GyroRoles(Roles):
    """B held: the robot rotates with the remote; the cross moves forward, back, left and right,
    plus and minus up and down."""

    clutch = frozenset({"b"})
    needs_rates = True

    def _moved(self, motion: RemoteMotion) -> Deflections:
        buttons = motion.buttons
        return (
            _cross(buttons, "up", "down"),
            _cross(buttons, "left", "right"),
            _cross(buttons, "plus", "minus"),
            *motion.rates,
        )


ROLES: Mapping[str, type[Roles]] = MappingProxyType(
    {"paper": PaperRoles, "tilt": TiltRoles, "gyro": GyroRoles}
)


def _cross(buttons: frozenset[str], positive: str, negative: str) -> float:
    return float(positive in buttons) - float(negative in buttons)


def _clamped(value: float) -> float:
    return min(1.0, max(-1.0, value))
