"""Defaults for an arm whose files leave them open: its home, and the pairs of bodies that are not
checked for collisions because they touch in every posture."""

from __future__ import annotations

import itertools
import math
from typing import Any

from cardan.common.arm_libraries import np, pin
from cardan.robots.arm_bodies import (
    FloatArray,
    coal_shape,
    pinocchio_model,
    smallest_singular_values,
)
from cardan.robots.arm_model import ArmModel, JointKind

HOMES = 1_000
"""Number of postures to choose the home from."""

MIDDLE_SHARE = 0.5
"""Share of each range, about its middle, in which a home is chosen."""

FARTHEST_RAD = math.pi / 2.0
"""Largest distance from the middle, for joints with a long range or none."""

HOME_ROOMS_M = (0.02, 0.01, 0.005, 0.0)
"""Distances between bodies at home, tried in order: bodies of a wrist may always be a few mm
apart."""

AS_GOOD = 0.9
"""Share of the largest smallest singular value from which on postures count as equally
conditioned."""

POSTURES = 10_000
"""Random postures in all of which unchecked bodies touch, as in MoveIt's setup assistant."""


def pairs_to_watch(arm: ArmModel) -> list[tuple[int, int]]:
    """Return the pairs of the arm's shapes, by number, that are checked for collisions."""
    return [
        (first, second)
        for first, second in itertools.combinations(range(len(arm.shapes)), 2)
        if arm.keeps_apart((arm.shapes[first].body, arm.shapes[second].body), (first, second))
    ]


def touching_shapes(arm: ArmModel) -> frozenset[tuple[int, int]]:
    """Return the checked pairs of link names that touch in each of 10,000 random postures: a link
    covered with several shapes touches if any of them does."""
    bodies = _Bodies(arm)
    # Continuous joints cover one turn, the others their whole range.
    lower = np.maximum(arm.lower, [_ends(joint.kind)[0] for joint in arm.joints])
    upper = np.minimum(arm.upper, [_ends(joint.kind)[1] for joint in arm.joints])
    of_links: dict[Any, set[int]] = {}
    for number, pair in enumerate(bodies.pairs):
        links = tuple((arm.shapes[each].body, arm.shapes[each].name) for each in pair)
        of_links.setdefault(frozenset(links), set()).add(number)
    for q in np.random.default_rng(0).uniform(lower, upper, (POSTURES, len(arm.joints))):
        if not of_links:
            break
        # Bodies that were apart once are not checked again, which leaves a thousandth of the work.
        touching = bodies.touching(q)
        of_links = {links: pairs for links, pairs in of_links.items() if pairs & touching}
        bodies.watch_only(set().union(*of_links.values()))
    return frozenset(bodies.pairs[number] for pairs in of_links.values() for number in pairs)


def _ends(kind: JointKind) -> tuple[float, float]:
    return (-math.pi, math.pi) if kind is JointKind.CONTINUOUS else (-math.inf, math.inf)


def bent_home(arm: ArmModel) -> tuple[float, ...]:
    """Choose the best-conditioned of 1,000 postures near the middle of each range without near
    bodies; if they touch in all, the best-conditioned of all.

    Among nearly equally conditioned postures, the one with the least load on its joints is chosen
    (norm of the torques and forces by gravity; a difference of a tenth of the largest counts), and
    among these the one nearest to the middle. Values are rounded to degrees and millimeters for
    readability, except the middle itself.
    """
    postures = _postures(arm)
    model = pinocchio_model(arm)
    data, tcp = model.createData(), model.getFrameId("tcp")
    local = pin.ReferenceFrame.LOCAL
    jacobians = [pin.computeFrameJacobian(model, data, q, tcp, local) for q in postures]
    bent = smallest_singular_values(np.array(jacobians), arm.task.weights)
    order = sorted(range(len(postures)), key=lambda number: -bent[number])
    bodies = _Bodies(arm)
    found: list[int] = []
    for room_m in HOME_ROOMS_M:
        bodies.set_room(room_m)
        for number in order:
            if found and bent[number] < AS_GOOD * bent[found[0]]:
                break
            if not bodies.touch(postures[number]):
                found.append(number)
        if found:
            break
    found = found or [number for number in order if bent[number] >= AS_GOOD * bent[order[0]]]
    loads = {
        number: float(np.linalg.norm(pin.computeGeneralizedGravity(model, data, postures[number])))
        for number in found
    }
    heaviest = max(loads.values()) or 1.0

    def preference(number: int) -> tuple[float, float]:
        away = float(np.linalg.norm(postures[number] - postures[0]))
        return round(loads[number] / heaviest, 1), away

    return tuple(postures[min(found, key=preference)].tolist())


def _postures(arm: ArmModel) -> FloatArray:
    """Yield the middle of each range, and other postures around it."""
    middle, room, unit = [], [], []
    for joint in arm.joints:
        endless = joint.kind is JointKind.CONTINUOUS
        slides = joint.kind is JointKind.PRISMATIC
        middle.append(0.0 if endless else 0.5 * (joint.lower + joint.upper))
        half = 0.5 * MIDDLE_SHARE * (joint.upper - joint.lower)
        room.append(half if slides else min(half, FARTHEST_RAD))
        unit.append(1e-3 if slides else math.pi / 180.0)
    spread = np.random.default_rng(0).uniform(-1.0, 1.0, (HOMES - 1, len(middle)))
    around = np.rint((middle + spread * room) / unit) * unit
    return np.vstack((middle, np.clip(around, arm.lower, arm.upper)))


class _Bodies:
    """Checked shapes: which touch, or come nearer than `set_room` allows."""

    def __init__(self, arm: ArmModel) -> None:
        self.pairs = pairs_to_watch(arm)
        self._model, self._geometry = pinocchio_model(arm), pin.GeometryModel()
        for number, each in enumerate(arm.shapes):
            shape, placement = coal_shape(each.shape)
            self._geometry.addGeometryObject(
                pin.GeometryObject(f"{each.name}#{number}", each.body, placement, shape)
            )
        for pair in self.pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(*pair))
        self._data, self._found = self._model.createData(), self._geometry.createData()
        self._watched = set(range(len(self.pairs)))

    def set_room(self, room_m: float) -> None:
        """Set the distance below which bodies count as touching."""
        for number in range(len(self.pairs)):
            self._found.collisionRequests[number].security_margin = room_m

    def touch(self, q: FloatArray) -> bool:
        """True if any of `pairs` touch at `q`."""
        any_do: bool = pin.computeCollisions(
            self._model, self._data, self._geometry, self._found, q, True
        )
        return any_do

    def watch_only(self, numbers: set[int]) -> None:
        """Check only these of `pairs`; the others count as apart."""
        for number in self._watched - numbers:
            self._found.deactivateCollisionPair(number)
        self._watched = set(numbers)

    def touching(self, q: FloatArray) -> set[int]:
        """Return the numbers of `pairs` that touch at `q`."""
        pin.computeCollisions(self._model, self._data, self._geometry, self._found, q, False)
        results: Any = self._found.collisionResults
        return {number for number in self._watched if results[number].isCollision()}
