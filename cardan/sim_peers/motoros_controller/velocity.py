"""The law of the velocity mode for one group, one IPC at a time, in double precision.

It converts the newest speeds to pulses within speed, acceleration and position limits by
construction, in the commanded direction unless a position limit is near, and carries fractions of
pulses over (no dead band, no drift). Source: docs/protocols/simple-message.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from cardan.common.braking import stopping_speed

SEQUENCES = 2**31
"""Sequence numbers count modulo this; 0 arms, so that after the largest comes 1."""


def is_newer(sequence: int, newest: int) -> bool:
    """Return True if `sequence` follows `newest` by less than half the numbers."""
    return 0 < (sequence - newest) % SEQUENCES < SEQUENCES // 2


class GroupVelocityStream:
    """Velocity commands of one group: a single slot for the newest. Each group has its own
    sequence, watchdog and latch."""

    def __init__(self, accelerations: Sequence[float]) -> None:
        self.armed = False
        self.latched = False
        """The watchdog or STOP_MOTION has ended an armed stream; sequence 0 resets it."""
        self.sequence = 0
        self.target: list[float] | None = None
        """Target speeds, rad/s; None: no command."""
        self.accelerations = list(accelerations)
        self.heard_s = -math.inf
        self.unused = False
        self.age_ms = 0.0
        """Age of the last used command at its first use."""
        self.overwritten = 0
        self.offset_s = math.inf
        """Smallest difference between local time and the sender's."""
        self.worst_lateness_s = 0.0

    def disarm(self, latched: bool = False) -> None:
        self.latched = latched and (self.armed or self.latched)
        self.armed = False
        self.target = None
        self.unused = False


class VelocityLaw:
    """Speeds of one group.

    The bound of a position limit is the speed v with v·T + v²/2a = distance left. Within it an axis
    can always stop in time with its own highest acceleration, independent of the acceleration of
    the command and of the other axes.
    """

    def __init__(
        self,
        speeds_rad_s: Sequence[float],
        accelerations_rad_s2: Sequence[float],
        lower_rad: Sequence[float],
        upper_rad: Sequence[float],
        pulses_per_rad: Sequence[float],
        ipc_s: float,
    ) -> None:
        self.axes = len(speeds_rad_s)
        self.speeds_rad_s = tuple(speeds_rad_s)
        self.accelerations_rad_s2 = tuple(accelerations_rad_s2)
        self._lower = tuple(lower_rad)
        self._upper = tuple(upper_rad)
        self._per_rad = tuple(pulses_per_rad)
        self._ipc_s = ipc_s
        self.velocity = [0.0] * self.axes
        """Present command, rad/s."""
        self.still = True
        """True if all of `velocity` is zero."""
        self._exact = [0.0] * self.axes
        """Commanded position in pulses, with its fraction."""
        self._sent = [0] * self.axes
        self._zeros = [0] * self.axes
        self.speed_mask = self.acceleration_mask = self.position_mask = 0
        """Bits of the axes that a limit has held back since `clear_masks`."""

    def place(self, command_pulses: Sequence[int]) -> None:
        """Start at rest at `command_pulses`."""
        self.halt()
        self.discard(command_pulses)

    def halt(self) -> None:
        """Zero speed at once."""
        for axis in range(self.axes):
            self.velocity[axis] = 0.0
        self.still = True

    def discard(self, command_pulses: Sequence[int]) -> None:
        """Continue from `command_pulses`: pulses that were not executed are never caught up."""
        for axis, pulses in enumerate(command_pulses):
            self._exact[axis] = float(pulses)
            self._sent[axis] = pulses

    def clear_masks(self) -> None:
        """Count limited axes from here."""
        self.speed_mask = self.acceleration_mask = self.position_mask = 0

    @property
    def stopping_time_s(self) -> float:
        """Return the duration of a ramp to zero from now."""
        return max(
            abs(v) / a for v, a in zip(self.velocity, self.accelerations_rad_s2, strict=True)
        )

    def step(
        self,
        target_rad_s: Sequence[float] | None,
        accelerations_rad_s2: Sequence[float],
        speed_share: float = 1.0,
    ) -> list[int]:
        """Run one IPC toward `target_rad_s`; None stops each axis at its limit.

        `accelerations_rad_s2` hold for this command, each at most the axis's own. The functional
        safety unit allows `speed_share` of the highest speeds (0 to 1): all axes are slowed alike,
        and `velocity` is the slowed one. Returns the increments in pulses.
        """
        velocity, ipc_s = self.velocity, self._ipc_s
        if target_rad_s is None:
            if self.still:
                return self._zeros
            new = [
                math.copysign(max(0.0, abs(v) - a * ipc_s), v)
                for v, a in zip(velocity, self.accelerations_rad_s2, strict=True)
            ]
        else:
            new = self._toward(target_rad_s, accelerations_rad_s2, speed_share)
        way = 1.0 if speed_share == 1.0 else self._cut(new, speed_share)
        increments = []
        exact, sent, half_s = self._exact, self._sent, 0.5 * ipc_s * way
        moving = False
        for axis, v in enumerate(new):
            if v or velocity[axis]:
                exact[axis] += half_s * (velocity[axis] + v) * self._per_rad[axis]
                moving = moving or v != 0.0
                velocity[axis] = v
            pulses = int(exact[axis])
            increments.append(pulses - sent[axis])
            sent[axis] = pulses
        self.still = not moving
        return increments

    def _cut(self, new: list[float], speed_share: float) -> float:
        """Scale the next speeds to `speed_share` at once; return the share of this period's motion,
        which the previous speeds contribute to, that is executed."""
        cut = way = 1.0
        for v, highest in zip(new, self.speeds_rad_s, strict=True):
            most = speed_share * highest
            if abs(v) * cut > most:
                cut = most / abs(v)
        if cut < 1.0:
            new[:] = [v * cut for v in new]
        for old, v, highest in zip(self.velocity, new, self.speeds_rad_s, strict=True):
            most = speed_share * highest
            mean = 0.5 * abs(old + v)
            if mean * way > most:
                way = most / mean
        return way

    def _toward(
        self, target: Sequence[float], accelerations: Sequence[float], speed_share: float
    ) -> list[float]:
        """Return the next speeds."""
        ipc_s, velocity = self._ipc_s, self.velocity
        scale = 1.0
        for axis, full in enumerate(self.speeds_rad_s):
            highest = speed_share * full
            speed = abs(target[axis])
            if speed > highest:
                self.speed_mask |= 1 << axis
                if speed * scale > highest:
                    scale = highest / speed
        wanted, least, most = [], [], []
        share = 1.0
        for axis, own in enumerate(self.accelerations_rad_s2):
            now = velocity[axis]
            aim = target[axis] * scale
            joint = self._exact[axis] / self._per_rad[axis]
            ahead = 0.5 * ipc_s * now
            high = stopping_speed(self._upper[axis] - joint - ahead, own, ipc_s)
            low = -stopping_speed(joint - self._lower[axis] + ahead, own, ipc_s)
            if aim > high:
                aim = high
                self.position_mask |= 1 << axis
            elif aim < low:
                aim = low
                self.position_mask |= 1 << axis
            change = abs(aim - now)
            allowed = accelerations[axis] * ipc_s
            if change > allowed:
                self.acceleration_mask |= 1 << axis
                if change * share > allowed:
                    share = allowed / change
            wanted.append(aim)
            least.append(low)
            most.append(high)
        if share == 1.0:
            new = wanted
        else:
            new = [now + share * (aim - now) for now, aim in zip(velocity, wanted, strict=True)]
        # An axis that must brake before its limit does so independent of the others.
        for axis, v in enumerate(new):
            hardest = self.accelerations_rad_s2[axis] * ipc_s
            if v > most[axis]:
                new[axis] = max(most[axis], velocity[axis] - hardest)
            elif v < least[axis]:
                new[axis] = min(least[axis], velocity[axis] + hardest)
        return new
