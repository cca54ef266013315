"""The map that forces are rendered by, without its leaps.

When both references are taken anew (`recapture`), a place of the hand means another place of the
TCP from one cycle to the next, and a wall stands elsewhere under a hand that did not move. So the
map that is rendered glides to the one that is true. Time is an argument.
"""

from __future__ import annotations

from cardan.gateway.force.fixtures import turned, world_point
from cardan.haptics import WorldMap
from cardan.spatial import add, limit_norm, norm, scale, subtract
from cardan.types import NEVER_S, ZERO3, Vector3

GLIDE_M_S = 0.01
"""A wall of 300 N/m that comes upon a hand at rest so fast grows by 3 N/s: about as fast as force
comes in when the hand clutches in, and slow enough to yield to."""

LONGEST_STEP_S = 0.05
"""More time than this does not count at once: a session that stood still makes no leap of it."""

NOTHING_M = 1e-9
"""Less is rounding."""


class MapGlide:
    """Follows the map of one engagement after the other."""

    def __init__(self) -> None:
        self.left = ZERO3
        """m in the world: how far what is rendered is from where it is true."""
        self._map: WorldMap | None = None
        self._hand = ZERO3
        self._seen_s = NEVER_S

    def release(self) -> None:
        """The hand is let go: the next engagement begins with its own map at once."""
        self._map, self.left = None, ZERO3

    def follow(self, world: WorldMap, hand: Vector3, now_s: float) -> WorldMap:
        """What to render where `world` is true and the hand is at `hand` (m, device axes).

        Beyond GLIDE_M_S the rendered place moves by what the hand moves alone: as far as that goes,
        the map may slip and be held at an edge.
        """
        before = self._map
        if before is not None:
            if self.left != ZERO3:
                step_m = GLIDE_M_S * min(max(now_s - self._seen_s, 0.0), LONGEST_STEP_S)
                self.left = subtract(self.left, limit_norm(self.left, step_m))
            if world.linear == before.linear:
                leap = subtract(before.offset, world.offset)
            else:
                leap = subtract(world_point(before, hand), world_point(world, hand))
            leap_m = norm(leap)
            if leap_m > NOTHING_M:
                way = subtract(hand, self._hand)
                way_m = max(norm(turned(world.linear, way)), norm(turned(before.linear, way)))
                if leap_m > way_m + NOTHING_M:
                    self.left = add(self.left, scale(leap, 1.0 - way_m / leap_m))
        self._map, self._hand, self._seen_s = world, hand, now_s
        if self.left == ZERO3:
            return world
        return world._replace(offset=add(world.offset, self.left))
