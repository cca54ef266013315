"""A stylus in virtual time, ticked by the compiled control law."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from cardan.common.haptics import (
    Box,
    Cylinder,
    Fixture,
    HapticCommand,
    HapticState,
    OperatingState,
    Plane,
    Sphere,
    Spring,
    Viscous,
    WorldMap,
)
from cardan.types import ZERO3, Vector3
from cardan_omni.driver.limits import UncheckedLimits
from cardan_omni.driver.tick import Tick
from cardan_omni.driver.values import StylusSample

PERIOD_S = 1e-3
ROOM = {"workspace_lower_m": (-1.0, -1.0, -1.0), "workspace_upper_m": (1.0, 1.0, 1.0)}
FLOOR = Plane(ZERO3, Vector3(0.0, 0.0, 1.0), 500.0)
ABOVE = Vector3(0.0, 0.0, 0.01)
BELOW = Vector3(0.0, 0.0, -0.003)
"""Position with a force of 1.5 N in FLOOR."""
BARE: dict[str, Any] = {"damping_n_s_m": 0.0, **ROOM}
NAN = float("nan")


class Bench:
    """A tick, its clock, and a command source that is silent only on request."""

    def __init__(self, **limits: Any) -> None:
        self.tick = Tick(UncheckedLimits(**{**ROOM, **limits}))
        self.limits = self.tick.limits
        self.now_s = 100.0
        self.sequence = 0
        self.command = HapticCommand(0, 0.0, engaged=True)
        self.sample = StylusSample(self.now_s)
        self.forces: list[Vector3] = []
        self.positions: list[Vector3] = []

    def send(self, **changes: Any) -> None:
        self.sequence += 1
        self.command = self.command._replace(sequence=self.sequence, stamp_s=self.now_s, **changes)
        self.tick.command(self.command, self.now_s)

    def step(self, *, silent: bool = False, gap_s: float = PERIOD_S, **sample: Any) -> Vector3:
        self.now_s += gap_s
        if not silent:
            self.send()
        self.sample = self.sample._replace(now_s=self.now_s, **sample)
        force = self.tick.step(self.sample)
        self.forces.append(force)
        self.positions.append(self.sample.position)
        return force

    def run(self, seconds: float, **sample: Any) -> Vector3:
        force = ZERO3
        for _ in range(round(seconds / PERIOD_S)):
            force = self.step(**sample)
        return force

    def glide(self, to: Vector3, seconds: float) -> Vector3:
        """Move the stylus at constant speed."""
        start, force, steps = self.sample.position, ZERO3, round(seconds / PERIOD_S)
        for k in range(1, steps + 1):
            share = k / steps
            force = self.step(
                position=Vector3(*(a + share * (b - a) for a, b in zip(start, to, strict=True)))
            )
        return force

    def engage(self, **command: Any) -> None:
        """Engage in free space until the ramp is over."""
        self.tick.enable()
        self.send(**command)
        self.run(self.limits.engage_ramp_s + 0.1)
        assert self.state.state is OperatingState.ENABLED

    def press(self, **command: Any) -> Vector3:
        """Engage and press 1.5 N deep into the floor."""
        self.step(position=ABOVE)
        self.engage(fixtures=(FLOOR,), **command)
        force = self.glide(BELOW, 0.2)
        force = self.run(0.05)
        assert force.z == pytest.approx(1.5, abs=0.01)
        return force

    @property
    def state(self) -> HapticState:
        return self.tick.snapshot()

    def zero_after(self, limit_s: float = 0.05, **step: Any) -> float:
        """Return the time until the force is zero, s; check that it changes within its limits."""
        for k in range(round(limit_s / PERIOD_S)):
            before = self.forces[-1]
            force = self.step(**step)
            assert distance(force, before) <= self.limits.slew_fall_n_s * PERIOD_S * (1 + 1e-6)
            if force == ZERO3:
                return (k + 1) * PERIOD_S
        raise AssertionError(f"still {force} after {limit_s} s")


def size(v: Iterable[float]) -> float:
    return math.sqrt(sum(x * x for x in v))


def distance(a: Vector3, b: Vector3) -> float:
    return size(x - y for x, y in zip(a, b, strict=True))


def commanded(fixture: Fixture, *points: Vector3, world: WorldMap | None = None) -> Vector3:
    """Return a fixture's force at the last of these points, reached through the others."""
    bench = Bench(**BARE)
    bench.tick.enable()
    bench.send(fixtures=(fixture,), world=world or WorldMap())
    for point in points:
        bench.run(0.5, position=point)  # long enough for everything to settle
    return bench.state.force_commanded


def rotation(x: float, y: float, z: float) -> tuple[float, ...]:
    """Return Rz·Ry·Rx, row by row."""
    cx, sx, cy, sy, cz, sz = (f(a) for a in (x, y, z) for f in (math.cos, math.sin))
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return tuple(float(v) for v in (rz @ ry @ rx).flatten())


VECTORS = st.tuples(*[st.floats(-0.05, 0.05)] * 3).map(lambda v: Vector3(*v))
PUSHES = st.tuples(st.floats(0.0, 3000.0), st.floats(0.0, 5.0), st.floats(0.0, 20.0))
FIXTURES = st.one_of(
    st.builds(
        lambda c, r, p, i: Sphere(c, r, *p, inside=i),
        VECTORS,
        st.floats(0.0, 0.05),
        PUSHES,
        st.booleans(),
    ),
    st.builds(lambda c, p: Plane(c, Vector3(0.6, 0.0, 0.8), *p), VECTORS, PUSHES),
    st.builds(
        lambda c, p, i: Box(c, Vector3(0.02, 0.01, 0.03), *p, inside=i),
        VECTORS,
        PUSHES,
        st.booleans(),
    ),
    st.builds(
        lambda c, p, i: Cylinder(c, Vector3(0.0, 0.6, 0.8), 0.02, *p, inside=i),
        VECTORS,
        PUSHES,
        st.booleans(),
    ),
    st.builds(lambda c, p: Spring(c, *p), VECTORS, PUSHES),
    st.builds(lambda d: Viscous(d), st.floats(0.0, 20.0)),
)
