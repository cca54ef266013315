"""Sources of force readings: the robot itself, a sensor at its flange, virtual contact surfaces.

A source is read once in every cycle and gives its newest reading, or the reason for having none.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

from cardan.common import bounds
from cardan.common.context import enter, leave
from cardan.common.haptics import WorldMap
from cardan.common.options import Options
from cardan.drivers.base import OperatorDevice
from cardan.errors import DriverError
from cardan.spatial import add, dot, is_finite, norm, scale, subtract
from cardan.types import ZERO3, Frame, Pose, RobotLink, RobotState, Vector3, Wrench

STICK_SPEED_M_S = 0.005
"""Friction of a computed contact grows with speed below this, and is Coulomb's above it."""

VELOCITY_CUTOFF_HZ = 20.0
"""Cut-off of the filter on the velocity that is computed from two positions of the TCP."""

LONGEST_STEP_S = 0.1
"""Longest time between two positions of the TCP from which a velocity is computed."""

FASTEST_M_S = 10.0
"""Speed above which a TCP counts as relocated: its velocity is not computed."""

LARGEST_READING_N = 1000.0
"""Largest plausible force: no tool in teleoperation presses harder. A larger reading is a fault and
is rejected, not limited, because the filter would render it long after."""

FUTURE_S = 0.1
"""Largest time that a stamp may be in the future: beyond, it is from another clock, and every
reading after it would seem to be older."""


class Reading(NamedTuple):
    """A reading of a source."""

    stamp_s: float
    """Local monotonic time of the measurement."""
    force: Vector3
    """Force of the world on the tool, N."""
    frame: Frame
    """Axes of `force`."""


class ForceSource(ABC):
    """An origin of forces. `reason` says why there is no reading, in words."""

    needs_tcp = False
    """True if `read` needs the measured TCP."""

    rests_at_zero = False
    """True: without contact the readings are zero, so no tare is taken."""

    shaped = False
    """True: forces are scaled for the hand already; only their axes are turned."""

    reason = ""

    def open(self) -> None:
        """Open the channel of the force. Raises DriverError."""
        return

    def close(self) -> None:
        """Release all resources. Never raises."""
        return

    __enter__ = enter
    __exit__ = leave

    @abstractmethod
    def read(self, state: RobotState, tcp: Pose | None) -> Reading | None:
        """Return the newest reading in the cycle of `state`; None if there is none."""

    def publish(
        self, state: RobotState, tcp: Pose | None, world: WorldMap | None, now_s: float
    ) -> None:
        """Send the robot's state to a process that computes the force, before each `read`."""
        return

    def diagnosis(self) -> tuple[str, ...]:
        """Reasons why there is no reading."""
        return (f"no measured force: {self.reason}",) if self.reason else ()


class Sieve:
    """Rejects implausible readings of an instrument.

    After a rejected one the last plausible reading stands until it is too old.
    """

    def __init__(self, instrument: str) -> None:
        self.refused = 0
        self.reason = ""
        """Reason for rejecting the newest reading; empty if it was accepted."""
        self._instrument = instrument
        self._last: Reading | None = None
        self._refused_s = math.nan

    def forget(self) -> None:
        """Forget the last reading."""
        self._last, self.reason = None, ""

    def take(self, reading: Reading, now_s: float) -> Reading | None:
        """Return `reading`, or the last plausible one if it is rejected; None if there is none.
        `now_s`: present time."""
        force_n = math.hypot(*reading.force)
        if force_n <= LARGEST_READING_N and reading.stamp_s <= now_s + FUTURE_S:
            self.reason, self._last = "", reading
            return reading
        if reading.stamp_s != self._refused_s:
            self._refused_s = reading.stamp_s
            self.refused += 1
        if not is_finite(reading.force):
            self.reason = f"{self._instrument} gives a force that is not a number"
        elif not force_n <= LARGEST_READING_N:
            self.reason = (
                f"{self._instrument} gives {force_n:.3g} N; more than {LARGEST_READING_N:g} N "
                "is rejected"
            )
        else:
            self.reason = (
                f"{self._instrument} gives a time {reading.stamp_s - now_s:.3g} s in the future"
            )
        return self._last

    def diagnosis(self) -> tuple[str, ...]:
        """Counts of rejected readings."""
        return (f"readings of a force refused: {self.refused}",) if self.refused else ()


class _Instrument(ForceSource):
    """Base of sources that measure a wrench."""

    def __init__(self, name: str, reaction: bool) -> None:
        self._sign = 1.0 if reaction else -1.0
        self._sieve = Sieve(name)

    def _reading(
        self, wrench: Wrench | None, stamp_s: float, now_s: float, why_none: str
    ) -> Reading | None:
        """Return the reading of a wrench of `stamp_s`; `why_none` says why there is no wrench."""
        if wrench is None:
            self._sieve.forget()
            self.reason = why_none
            return None
        new = Reading(stamp_s, scale(wrench.force, self._sign), wrench.frame)
        reading = self._sieve.take(new, now_s)
        self.reason = self._sieve.reason
        return reading

    def diagnosis(self) -> tuple[str, ...]:
        """Why there is no force; rejections."""
        return (*super().diagnosis(), *self._sieve.diagnosis())


class MeasuredSource(_Instrument):
    """The robot's own measurement (EGM's measuredForce)."""

    def __init__(self, *, reaction: bool = False) -> None:
        """`reaction`: the wrench is the world's on the tool; else the tool's on the world."""
        super().__init__("the robot", reaction)

    def read(self, state: RobotState, tcp: Pose | None) -> Reading | None:
        """The wrench of this cycle's state."""
        why_none = "the robot reports none" if state.link is RobotLink.LIVE else ""
        return self._reading(state.wrench, state.stamp_s, state.stamp_s, why_none)


class SensorSource(_Instrument):
    """A force-torque sensor with its own driver (JR3), along the tool's axes."""

    def __init__(
        self, device: OperatorDevice, *, reaction: bool = True, zero: bool = False
    ) -> None:
        """`reaction`: the wrench is that of the world on the tool; `zero`: zero it when opened."""
        super().__init__("the sensor", reaction)
        self.device = device
        self._zero = zero

    def open(self) -> None:
        """Open the sensor. Raises DriverError."""
        self.device.open()
        if self._zero:
            try:
                self.device.zero()  # type: ignore[attr-defined]  # make_source() saw it
            except DriverError:
                self.device.close()
                raise

    def close(self) -> None:
        """Close the sensor."""
        self.device.close()

    def read(self, state: RobotState, tcp: Pose | None) -> Reading | None:
        """Return the sensor's newest wrench; its stamps must be of the same clock as the
        robot's."""
        sensed = self.device.state()
        why_none = sensed.reason or "the sensor gives no wrench"
        return self._reading(sensed.wrench, sensed.stamp_s, state.stamp_s, why_none)

    def diagnosis(self) -> tuple[str, ...]:
        """Why there is no force, and the sensor's own diagnosis."""
        lines = (line for line in self.device.diagnosis() if line != self.reason)
        return (*super().diagnosis(), *(f"force sensor: {line}" for line in lines))


class PointVelocity:
    """The velocity of a point, from its positions."""

    def __init__(self) -> None:
        self._place: Vector3 | None = None
        self._place_s = 0.0
        self._velocity = ZERO3

    def update(self, place: Vector3, now_s: float) -> Vector3:
        """Return the filtered velocity, m/s, with the newest position."""
        before, dt_s = self._place, now_s - self._place_s
        if dt_s <= 0.0 and before is not None:
            return self._velocity
        self._place, self._place_s = place, now_s
        if before is None or dt_s > LONGEST_STEP_S:
            self._velocity = ZERO3
            return ZERO3
        raw = scale(subtract(place, before), 1.0 / dt_s)
        if norm(raw) > FASTEST_M_S:
            self._velocity = ZERO3
            return ZERO3
        share = 1.0 - math.exp(-2.0 * math.pi * VELOCITY_CUTOFF_HZ * dt_s)
        self._velocity = add(self._velocity, scale(subtract(raw, self._velocity), share))
        return self._velocity


@dataclass(frozen=True, kw_only=True)
class ContactTable(Options, ABC):
    """One of ``[[force.contact]]``: a virtual contact surface."""

    stiffness_n_m: Annotated[float, bounds.ENVIRONMENT_STIFFNESS_N_M]
    damping_n_s_m: Annotated[float, bounds.DAMPING_N_S_M] = 0.0
    friction: Annotated[float, bounds.FRICTION] = 0.0

    @abstractmethod
    def depth_at(self, place: Vector3) -> tuple[Vector3, float]:
        """Return the unit normal out of the body, and the depth of `place`, m; <= 0: outside."""


def contact_force(contact: ContactTable, place: Vector3, velocity: Vector3) -> Vector3:
    """Return the force of `contact` on a TCP at `place` that moves at `velocity`: N, world axes.
    Stiffness · depth, damped and never pulling, and friction against the sliding."""
    outward, depth = contact.depth_at(place)
    if depth <= 0.0:
        return ZERO3
    towards = dot(velocity, outward)
    pressed = contact.stiffness_n_m * depth - contact.damping_n_s_m * towards
    if pressed <= 0.0:
        return ZERO3
    force = scale(outward, pressed)
    if contact.friction:
        sliding = subtract(velocity, scale(outward, towards))
        drag = contact.friction * pressed / max(norm(sliding), STICK_SPEED_M_S)
        force = subtract(force, scale(sliding, drag))
    return force


class ContactSource(ForceSource):
    """Contacts computed from the measured TCP, for arms and simulators without a sensor."""

    needs_tcp = True
    rests_at_zero = True

    def __init__(self, contacts: Sequence[ContactTable]) -> None:
        self._contacts = tuple(contacts)
        self._velocity = PointVelocity()

    def read(self, state: RobotState, tcp: Pose | None) -> Reading | None:
        """Return the sum of all contacts, base axes."""
        if tcp is None:
            self.reason = "the robot reports no pose" if state.link is RobotLink.LIVE else ""
            return None
        self.reason = ""
        velocity = self._velocity.update(tcp.position, state.stamp_s)
        force = ZERO3
        for contact in self._contacts:
            force = add(force, contact_force(contact, tcp.position, velocity))
        return Reading(state.stamp_s, force, Frame.BASE)
