"""A remote robot at a wall: the path of the force in a bilateral loop, without I/O.

The stylus's position goes to the robot by one channel, the measured force comes back by another.
Both have delay, jitter and loss; the robot follows its command with a lag and a speed limit, and
both ends are sampled once per period.
"""

from __future__ import annotations

import heapq
import math
import random
from typing import Generic, NamedTuple, TypeVar

from cardan.common.haptics import MeasuredForce
from cardan.types import ZERO3, Vector3

T = TypeVar("T")


class Link(NamedTuple):
    """A channel in one direction, and the period at which both its ends are sampled."""

    delay_s: float = 0.0
    jitter_s: float = 0.0
    """Largest additional delay, uniformly distributed; items may overtake each other."""
    loss: float = 0.0
    """Share of lost items."""
    period_s: float = 0.004


class Channel(Generic[T]):
    """Transmission with delay, jitter and loss."""

    def __init__(self, link: Link, seed: int) -> None:
        self._link = link
        self._random = random.Random(seed)
        self._under_way: list[tuple[float, int, T]] = []
        self._sent = 0

    def send(self, item: T, now_s: float) -> None:
        """Send `item`."""
        self._sent += 1
        if self._random.random() < self._link.loss:
            return
        late_s = self._link.delay_s + self._random.uniform(0.0, self._link.jitter_s)
        heapq.heappush(self._under_way, (now_s + late_s, self._sent, item))

    def receive(self, now_s: float) -> list[T]:
        """Return all items that have arrived by now, in the order of arrival."""
        found = []
        while self._under_way and self._under_way[0][0] <= now_s + 1e-9:
            found.append(heapq.heappop(self._under_way)[2])
        return found


class Wall(NamedTuple):
    """A stiff plane as seen by the hand: the stiffness includes the scales."""

    point: Vector3
    normal: Vector3
    """Unit normal, out of the wall."""
    stiffness_n_m: float

    def force(self, position: Vector3) -> Vector3:
        """Return the force at `position`, N."""
        depth = sum((p - q) * n for p, q, n in zip(self.point, position, self.normal, strict=True))
        push = self.stiffness_n_m * max(0.0, depth)
        return Vector3(*(push * n for n in self.normal))


class Robot:
    """A position-controlled robot at a wall: first-order lag, limited speed."""

    def __init__(self, wall: Wall, lag_s: float, fastest_m_s: float, start: Vector3) -> None:
        self._wall = wall
        self._lag_s = lag_s
        self._fastest_m_s = fastest_m_s
        self.position = start

    def step(self, goal: Vector3, dt_s: float) -> Vector3:
        """Move towards `goal` for `dt_s`; return the wall's force on the robot, N."""
        share = 1.0 - math.exp(-dt_s / self._lag_s) if self._lag_s > 0.0 else 1.0
        step = [share * (g - p) for g, p in zip(goal, self.position, strict=True)]
        length, most = math.hypot(*step), self._fastest_m_s * dt_s
        scale = most / length if length > most else 1.0
        self.position = Vector3(*(p + scale * s for p, s in zip(self.position, step, strict=True)))
        return self._wall.force(self.position)


class RemoteWall:
    """The remote wall with both channels. The gateway calls `cycle` once per `there.period_s`."""

    def __init__(
        self,
        wall: Wall,
        there: Link,
        back: Link,
        *,
        start: Vector3,
        lag_s: float = 0.004,
        fastest_m_s: float = 2.0,
        seed: int = 1,
    ) -> None:
        self._there: Channel[tuple[int, Vector3]] = Channel(there, seed)
        self._back: Channel[tuple[int, Vector3]] = Channel(back, seed + 1)
        self._robot = Robot(wall, lag_s, fastest_m_s, start)
        self._goal = start
        self._period_s = there.period_s
        self._sent = 0
        self._newest_there = self._newest = 0
        self._measured: MeasuredForce | None = None

    @property
    def robot_position(self) -> Vector3:
        """Position of the robot."""
        return self._robot.position

    def cycle(self, stylus: Vector3, now_s: float) -> MeasuredForce | None:
        """Send the stylus's position; return the newest force received, stamped on arrival.

        The age of the force on arrival is unknown, because the two ends share no clock. Both ends
        drop items that a newer one has overtaken.
        """
        self._sent += 1
        self._there.send((self._sent, stylus), now_s)
        for number, goal in self._there.receive(now_s):
            if number > self._newest_there:
                self._newest_there, self._goal = number, goal
        force = self._robot.step(self._goal, self._period_s)
        self._back.send((self._sent, force), now_s)
        for number, arrived in self._back.receive(now_s):
            if number <= self._newest:
                continue
            before, elapsed_s = self._measured, self._period_s * (number - self._newest)
            rate = ZERO3
            if before is not None:
                rate = Vector3(
                    *((a - b) / elapsed_s for a, b in zip(arrived, before.force, strict=True))
                )
            self._newest = number
            self._measured = MeasuredForce(arrived, now_s, rate, stylus)
        return self._measured
