"""Removes jumps from the map that forces are rendered by.

After a new capture of both references (`recapture`) the same position of the hand maps to another
position of the TCP from one cycle to the next, and a wall would jump onto a hand that did not move.
The rendered map therefore approaches the true one slowly. Time is an argument.
"""

from __future__ import annotations

from cardan.common.haptics import WorldMap
from cardan.gateway.force.fixtures import turned, world_point
from cardan.spatial import add, limit_norm, norm, scale, subtract
from cardan.types import NEVER_S, ZERO3, Vector3

CROSSFADE_M_S = 0.01
"""Speed of that approach. A wall of 300 N/m grows by 3 N/s then under a hand at rest: about as fast
as force begins at a clutch-in, and slow enough to yield to."""

LONGEST_STEP_S = 0.05
"""Longest time step: a session that stalled must not cause a jump."""

NOTHING_M = 1e-9
"""Offsets below this are rounding."""


class MapCrossfade:
    """Rendered map across successive engagements."""

    def __init__(self) -> None:
        self.left = ZERO3
        """Offset of the rendered map from the true one, m, world axes."""
        self._map: WorldMap | None = None
        self._hand = ZERO3
        self._seen_s = NEVER_S

    def release(self) -> None:
        """Clutch-out: the next engagement begins with its own map at once."""
        self._map, self.left = None, ZERO3

    def follow(self, world: WorldMap, hand: Vector3, now_s: float) -> WorldMap:
        """Return the map to render while `world` is the true one, for a hand at `hand` (m, device
        axes). Beyond CROSSFADE_M_S the rendered position moves only as far as the hand does: the
        map may slip by as much, or stop at the workspace's edge."""
        before = self._map
        if before is not None:
            if self.left != ZERO3:
                step_m = CROSSFADE_M_S * min(max(now_s - self._seen_s, 0.0), LONGEST_STEP_S)
                self.left = subtract(self.left, limit_norm(self.left, step_m))
            if world.linear == before.linear:
                jump = subtract(before.offset, world.offset)
            else:
                jump = subtract(world_point(before, hand), world_point(world, hand))
            jump_m = norm(jump)
            if jump_m > NOTHING_M:
                way = subtract(hand, self._hand)
                way_m = max(norm(turned(world.linear, way)), norm(turned(before.linear, way)))
                if jump_m > way_m + NOTHING_M:
                    self.left = add(self.left, scale(jump, 1.0 - way_m / jump_m))
        self._map, self._hand, self._seen_s = world, hand, now_s
        if self.left == ZERO3:
            return world
        return world._replace(offset=add(world.offset, self.left))
