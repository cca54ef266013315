"""The law of the force feedback, in virtual time."""

from __future__ import annotations

import ctypes
import dataclasses
import math
import threading
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cardan.drivers.omni import tick as tick_module
from cardan.drivers.omni.tick import (
    NativeMissingError,
    StylusSample,
    Tick,
    TickLimits,
    UncheckedLimits,
    available,
    kinematics,
    library_path,
)
from cardan.errors import CommandError, DriverError
from cardan.haptics import (
    IDENTITY3,
    Box,
    Calibration,
    Cylinder,
    Fixture,
    HapticCommand,
    HapticState,
    MeasuredForce,
    OperatingState,
    Plane,
    Sphere,
    Spring,
    Viscous,
    WorldMap,
)
from cardan.types import ZERO3, Vector3

PERIOD_S = 1e-3
ROOM = {"workspace_lower_m": (-1.0, -1.0, -1.0), "workspace_upper_m": (1.0, 1.0, 1.0)}
FLOOR = Plane(ZERO3, Vector3(0.0, 0.0, 1.0), 500.0)
ABOVE = Vector3(0.0, 0.0, 0.01)
BELOW = Vector3(0.0, 0.0, -0.003)
"""1.5 N deep in FLOOR."""
BARE: dict[str, Any] = {"damping_n_s_m": 0.0, **ROOM}
NAN = float("nan")


class Rig:
    """A tick, its clock, and a command source that never falls silent unless told to."""

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
        self.tick.command(self.command)

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
        """Evenly, from where the stylus is."""
        start, force, steps = self.sample.position, ZERO3, round(seconds / PERIOD_S)
        for k in range(1, steps + 1):
            share = k / steps
            force = self.step(
                position=Vector3(*(a + share * (b - a) for a, b in zip(start, to, strict=True)))
            )
        return force

    def engage(self, **command: Any) -> None:
        """In free space, all the way in."""
        self.tick.enable()
        self.send(**command)
        self.run(self.limits.engage_ramp_s + 0.1)
        assert self.state.state is OperatingState.ENABLED

    def press(self, **command: Any) -> Vector3:
        """Engaged and 1.5 N deep in the floor."""
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
        """How long it takes until the force is zero, s, never changing faster than it may."""
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
    """What a fixture asks for at the last of these points, having been at the others before."""
    rig = Rig(**BARE)
    rig.tick.enable()
    rig.send(fixtures=(fixture,), world=world or WorldMap())
    for point in points:
        rig.run(0.5, position=point)  # long enough that nothing moves any more
    return rig.state.force_commanded


def rotation(x: float, y: float, z: float) -> tuple[float, ...]:
    """Rz·Ry·Rx, row by row."""
    cx, sx, cy, sy, cz, sz = (f(a) for a in (x, y, z) for f in (math.cos, math.sin))
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return tuple(float(v) for v in (rz @ ry @ rx).flatten())


# ---------------------------------------------------------------------------------------------
# What is rendered


@pytest.mark.parametrize(
    ("tcp", "force"),
    [
        ((0.3, 0.0, 0.45), (0.0, 0.0, 3.0)),
        ((0.385, 0.0, 0.4), (1.5, 0.0, 0.0)),
        ((0.3, -0.08, 0.4), (0.0, -2.0, 0.0)),
        ((0.3, 0.06, 0.34), (0.0, 1.071068, -1.071068)),
        ((0.41, 0.0, 0.4), (0.0, 0.0, 0.0)),
    ],
)
def test_papers_sphere(tcp: tuple[float, ...], force: tuple[float, ...]) -> None:
    sphere = Sphere(Vector3(0.3, 0.0, 0.4), 0.1, 100.0)
    assert commanded(sphere, Vector3(*tcp)) == pytest.approx(force, abs=1e-6)


@pytest.mark.parametrize(
    ("fixture", "at", "force"),
    [
        (Sphere(ZERO3, 0.05, 100.0, inside=True), (0.06, 0.0, 0.0), (-1.0, 0.0, 0.0)),
        (Sphere(ZERO3, 0.05, 100.0, inside=True), (0.04, 0.0, 0.0), (0.0, 0.0, 0.0)),
        (FLOOR, (0.0, 0.1, -0.002), (0.0, 0.0, 1.0)),
        (FLOOR, (0.0, 0.1, 0.002), (0.0, 0.0, 0.0)),
        (FLOOR._replace(cap_n=0.4), (0.0, 0.0, -0.01), (0.0, 0.0, 0.4)),
        (Box(ZERO3, Vector3(0.1, 0.1, 0.02), 100.0), (0.0, 0.05, -0.01), (0.0, 0.0, -1.0)),
        (Box(ZERO3, Vector3(0.1, 0.1, 0.02), 100.0), (0.0, 0.05, -0.03), (0.0, 0.0, 0.0)),
        (
            Box(ZERO3, Vector3(0.02, 0.02, 0.02), 100.0, inside=True),
            (0.03, 0.0, -0.025),
            (-1.0, 0.0, 0.5),
        ),
        (
            Box(ZERO3, Vector3(0.02, 0.1, 0.1), 100.0, rotation=rotation(0, 0, math.pi / 2)),
            (0.0, 0.015, 0.0),
            (0.0, 0.5, 0.0),
        ),
        (
            Cylinder(ZERO3, Vector3(0.0, 1.0, 0.0), 0.02, 100.0),
            (0.01, 0.3, 0.0),
            (1.0, 0.0, 0.0),
        ),
        (
            Cylinder(ZERO3, Vector3(0.0, 1.0, 0.0), 0.02, 100.0, inside=True),
            (0.0, 0.3, 0.03),
            (0.0, 0.0, -1.0),
        ),
        (Spring(Vector3(0.01, 0.0, 0.0), 100.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        (Spring(Vector3(0.3, 0.4, 0.0), 100.0, 2.0), (0.0, 0.0, 0.0), (1.2, 1.6, 0.0)),
        (Viscous(3.0), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0)),
    ],
)
def test_fixture(fixture: Fixture, at: tuple[float, ...], force: tuple[float, ...]) -> None:
    assert commanded(fixture, Vector3(*at)) == pytest.approx(force, abs=1e-9)


@pytest.mark.parametrize(
    "fixture",
    [
        Sphere(ZERO3, 0.05, 50.0),
        Cylinder(ZERO3, Vector3(0.0, 0.0, 1.0), 0.05, 50.0),
        Box(ZERO3, Vector3(0.05, 0.2, 0.2), 50.0),
    ],
)
def test_in_the_very_middle_a_fixture_pushes_where_it_pushed_before(fixture: Fixture) -> None:
    force = commanded(fixture, Vector3(-0.01, 0.0, 0.0), ZERO3)
    assert force == pytest.approx((-2.5, 0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    "fixture", [Sphere(ZERO3, 0.05, 50.0), Cylinder(ZERO3, Vector3(0.0, 0.0, 1.0), 0.05, 50.0)]
)
def test_in_the_very_middle_at_once_it_pushes_somewhere(fixture: Fixture) -> None:
    assert size(commanded(fixture, ZERO3)) == pytest.approx(2.5)


@pytest.mark.parametrize(
    ("fixture", "speed_m_s", "force_z"),
    [
        (FLOOR._replace(stiffness_n_m=100.0, damping_n_s_m=2.0), -0.1, 0.5 + 0.2),
        (FLOOR._replace(stiffness_n_m=100.0, damping_n_s_m=20.0), 0.1, 0.0),
        (Viscous(2.0), 0.1, -0.2),
        (Viscous(20.0, 1.0), 0.1, -1.0),
        (Spring(ZERO3, 0.0, 3.0, 2.0), 0.1, -0.2),
    ],
)
def test_damping_never_pulls_into_a_wall(
    fixture: Fixture, speed_m_s: float, force_z: float
) -> None:
    rig = Rig(**BARE)
    rig.send(fixtures=(fixture,))
    start = -0.005 - 0.2 * speed_m_s
    for k in range(201):
        rig.step(position=Vector3(0.0, 0.0, start + k * PERIOD_S * speed_m_s))
    assert rig.state.velocity.z == pytest.approx(speed_m_s)
    assert rig.state.force_commanded.z == pytest.approx(force_z)


def test_the_world_map_moves_the_point_and_turns_the_force_back() -> None:
    turn = rotation(0.3, -0.4, 1.1)
    r = np.array(turn).reshape(3, 3)
    offset, scale = np.array([0.3, -0.2, 0.4]), 2.0
    normal = np.array([0.36, 0.48, 0.8])
    hand = np.array([0.01, 0.02, -0.03])
    point = scale * r @ hand + offset
    wall = Plane(Vector3(*(point + 0.01 * normal)), Vector3(*normal), 100.0)
    world = WorldMap(tuple(scale * r.flatten()), Vector3(*offset), turn)  # type: ignore[arg-type]
    assert commanded(wall, Vector3(*hand), world=world) == pytest.approx(r.T @ normal, abs=1e-9)


def test_forces_of_all_sources_are_added_and_only_fixtures_are_scaled() -> None:
    rig = Rig(**BARE)
    rig.send(
        fixtures=(FLOOR, FLOOR),
        force_scale=0.5,
        force=Vector3(0.1, 0.0, 0.0),
        measured=MeasuredForce(Vector3(0.0, 0.3, 0.0), rig.now_s),
    )
    rig.step(position=Vector3(0.0, 0.0, -0.001))
    assert rig.state.force_commanded == pytest.approx((0.1, 0.3, 0.5))


def test_the_edge_of_the_workspace_is_a_spring_and_fixtures_fade_beyond_it() -> None:
    rig = Rig(**{**BARE, "workspace_upper_m": (0.05, 1.0, 1.0)})
    rig.send(fixtures=(FLOOR,))
    rig.step(position=Vector3(0.055, 0.0, -0.002))
    assert rig.state.force_commanded == pytest.approx((-1.0, 0.0, 0.75))
    rig.step(position=Vector3(0.1, 0.0, -0.002))
    assert rig.state.force_commanded == pytest.approx((-10.0, 0.0, 0.0))


def test_a_measured_force_goes_on_for_a_bounded_time() -> None:
    rig = Rig(**BARE, extrapolate_s=0.0085, measured_hold_s=0.0495)
    rig.step()
    measured = MeasuredForce(
        Vector3(0.5, 0.0, 0.0), rig.now_s, Vector3(0.0, 10.0, 0.0), ZERO3, 100.0
    )
    rig.send(measured=measured)
    for k in range(1, 50):
        rig.step(position=Vector3(0.0, 0.0, 1e-4 * k))
        state = rig.state
        held = min(k, 8)
        assert state.force_age_s == pytest.approx(k * PERIOD_S)
        assert state.force_commanded == pytest.approx(
            (0.5, 10.0 * held * PERIOD_S, -100.0 * 1e-4 * held)
        ), k
    rig.step()
    assert rig.state.force_commanded == ZERO3, "too old to be felt"


def test_a_measured_force_is_never_above_the_clamp() -> None:
    rig = Rig(**BARE)
    rig.step()
    rig.send(measured=MeasuredForce(Vector3(30.0, 40.0, 0.0), rig.now_s, Vector3(1e4, 0, 0)))
    rig.step()
    assert size(rig.state.force_commanded) == pytest.approx(2.0)


def test_raw_joint_torques_and_nothing_else() -> None:
    rig = Rig(**BARE, engage_ramp_s=0.0)
    joints = Vector3(0.2, 0.742, 0.5531)
    rig.step(position=BELOW, joints_rad=joints)
    rig.engage(fixtures=(FLOOR,), joint_torques_n_m=ZERO3)
    rig.send(joint_torques_n_m=Vector3(0.05, -0.02, 0.03))
    force = rig.run(0.1)
    jacobian = np.array(kinematics(joints)[1]).reshape(3, 3)
    assert jacobian.T @ force == pytest.approx([0.05, -0.02, 0.03], abs=1e-9)
    assert rig.state.reason == ""
    assert rig.tick.details().torques_n_m == pytest.approx((0.05, -0.02, 0.03), abs=1e-9)


@pytest.mark.parametrize("raw", [True, False])
def test_torques_are_limited_as_a_whole_vector(raw: bool) -> None:
    rig = Rig(**BARE, engage_ramp_s=0.0, clamp_n=3.3, slew_fall_n_s=660.0)
    rig.step(joints_rad=Vector3(0.0, 0.742, 0.5531), joint_torque=not raw)
    rig.engage(joint_torques_n_m=ZERO3 if raw else None)
    if raw:
        rig.send(joint_torques_n_m=Vector3(0.7, 0.35, 0.0))
    else:
        rig.send(force=Vector3(0.0, 3.0, 0.0))
    rig.run(0.1)
    assert rig.state.reason == "limited to the largest force"
    torques = rig.tick.details().torques_n_m
    assert abs(torques.x) <= 0.35 + 1e-12
    assert abs(torques.x) == pytest.approx(0.35)
    if raw:
        assert torques.y == pytest.approx(0.175)


def test_kinematics() -> None:
    position, _ = kinematics(ZERO3)
    assert position == pytest.approx((0.035, 0.0, -0.11), abs=1e-9)
    position, _ = kinematics(Vector3(0.0, 0.7420, 0.5531))
    assert position == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)
    position, _ = kinematics(Vector3(0.0, 0.2689, -0.3708))
    assert position == pytest.approx((0.0881142, 0.0, -0.0655107), abs=1e-4)


@given(st.tuples(st.floats(-0.9, 0.9), st.floats(0.0, 1.7), st.floats(-0.8, 1.2)))
def test_the_jacobian_is_the_derivative_of_the_position(joints: tuple[float, ...]) -> None:
    _, jacobian = kinematics(Vector3(*joints))
    for column in range(3):
        moved = [list(joints), list(joints)]
        moved[0][column] -= 1e-6
        moved[1][column] += 1e-6
        low, high = (kinematics(Vector3(*m))[0] for m in moved)
        for row in range(3):
            assert jacobian[3 * row + column] == pytest.approx(
                (high[row] - low[row]) / 2e-6, abs=1e-8
            )


# ---------------------------------------------------------------------------------------------
# Limits


def test_the_clamp_keeps_the_direction() -> None:
    rig = Rig(**BARE)
    rig.engage()
    rig.send(force=Vector3(3.0, 0.0, 4.0))
    force = rig.run(0.1)
    assert force == pytest.approx((1.2, 0.0, 1.6))
    assert rig.state.reason == "limited to the largest force"


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


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.lists(FIXTURES, max_size=4), min_size=1, max_size=6),
    st.booleans(),
)
def test_never_above_the_clamp_and_never_a_step(
    seed: int, scenes: list[list[Fixture]], passivity: bool
) -> None:
    """Scenes, plain forces and positions jump about; the device docks, the source pauses."""
    random = np.random.default_rng(seed)
    rig = Rig(engage_ramp_s=0.0, velocity_gate_m_s=1e9, passivity=passivity)
    rig.tick.enable()
    limits, before, now = rig.limits, ZERO3, np.zeros(3)
    for scene in scenes:
        force = Vector3(*random.normal(0, 3, 3)) if random.random() < 0.5 else ZERO3
        rig.send(fixtures=tuple(scene), force=ZERO3, engaged=False)
        rig.run(0.01, inkwell=False)
        rig.send(fixtures=(), engaged=True)
        rig.run(0.008)
        rig.send(fixtures=tuple(scene), force=force)
        jumpy = random.random() < 0.3
        end = int(random.integers(20, 60))
        for k in range(60):
            now += random.normal(0, 5e-3 if jumpy else 2e-4, 3)
            gap_s = float(random.choice([1e-3, 1e-3, 1e-3, 0.2e-3, 1.9e-3, 3e-3]))
            previous = rig.forces[-1]
            sent = rig.step(
                silent=k > end and bool(random.random() < 0.9),
                gap_s=gap_s,
                position=Vector3(*now),
                inkwell=k == 55,
            )
            assert size(sent) <= limits.clamp_n
            rate = limits.slew_rise_n_s if size(sent) > size(previous) else limits.slew_fall_n_s
            assert distance(sent, previous) <= rate * gap_s * (1 + 1e-6) + 1e-12
            before = sent
    assert before is not None


def test_new_geometry_gives_no_step() -> None:
    rig = Rig()
    rig.press()
    for world in (
        WorldMap(offset=Vector3(0.0, 0.0, -0.1)),
        WorldMap(),
        WorldMap(rotation=rotation(math.pi / 2, 0.0, 0.0)),  # type: ignore[arg-type]
    ):
        rig.send(world=world)
        for _ in range(40):
            before = rig.forces[-1]
            after = rig.step()
            rate = 50.0 if size(after) > size(before) else 400.0
            assert distance(after, before) <= rate * PERIOD_S * (1 + 1e-6)


def test_force_comes_in_by_a_ramp_after_it_was_small() -> None:
    rig = Rig(**BARE, engage_ramp_s=0.5)
    rig.tick.enable()
    rig.send(fixtures=(FLOOR,))
    assert rig.run(1.0, position=BELOW) == ZERO3, "engaged inside the wall"
    assert "too large to engage" in rig.state.reason
    rig.glide(ABOVE, 0.1)
    rig.run(0.01)
    assert rig.state.reason == "engaging"
    force = rig.glide(BELOW, 0.1)
    assert 0.0 < force.z < 0.8, "a part of it"
    force = rig.run(0.5)
    assert force.z == pytest.approx(1.5)
    assert rig.state.reason == ""


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ({"inkwell": True}, "inkwell"),
        ({"calibrated": False}, "not calibrated"),
        ({"position": Vector3(NAN, 0.0, 0.0)}, "not finite"),
        ({"velocity": Vector3(0.0, 1.5, 0.0)}, "flew"),
        ({"silent": True}, "stopped coming"),
    ],
)
def test_what_forbids_force_has_it_at_zero_within_5_ms(what: dict[str, Any], reason: str) -> None:
    rig = Rig(clamp_n=2.0)
    rig.press()
    rig.send(force=Vector3(0.0, 0.0, 5.0))
    assert size(rig.run(0.02)) == pytest.approx(2.0)
    if what == {"silent": True}:
        for _ in range(19):
            force = rig.step(**what)
        assert size(force) == pytest.approx(2.0), "held for 20 ms"
    assert rig.zero_after(**what) <= 0.005 + 1e-9
    assert reason in rig.state.reason
    assert rig.run(0.05, **what) == ZERO3


@pytest.mark.parametrize(
    "request_it", [Tick.disable, Tick.pause, lambda tick: None], ids=["disable", "pause", "clutch"]
)
def test_requests_release_within_5_ms(request_it: Callable[[Tick], None]) -> None:
    rig = Rig()
    rig.press()
    request_it(rig.tick)
    if rig.state.state is OperatingState.ENABLED:
        rig.send(engaged=False)
    assert rig.zero_after() <= 0.005 + 1e-9
    assert rig.run(1.0) == ZERO3


def test_a_dead_source_pauses_and_the_next_command_must_be_small_first() -> None:
    rig = Rig()
    rig.press()
    rig.run(0.19, silent=True)
    state = rig.state
    assert state.state is OperatingState.ENABLED
    assert state.stale_commands == 1
    assert rig.run(0.01) != ZERO3, "a short silence: it comes back by itself"
    rig.run(0.205, silent=True)
    assert rig.state.state is OperatingState.PAUSED
    assert rig.run(0.5) == ZERO3, "still deep in the wall"
    assert rig.state.state is OperatingState.ENABLED
    rig.glide(ABOVE, 0.1)
    rig.run(1.1)
    assert rig.glide(BELOW, 0.2).z > 1.0


def test_a_command_with_an_old_stamp_is_as_dead_as_none() -> None:
    rig = Rig()
    rig.press()
    for k in range(40):
        rig.now_s += PERIOD_S
        if k == 0:
            stamp = rig.now_s
        rig.sequence += 1
        rig.tick.command(rig.command._replace(sequence=rig.sequence, stamp_s=stamp))
        force = rig.tick.step(rig.sample._replace(now_s=rig.now_s))
    assert force == ZERO3
    assert rig.state.command_age_s == pytest.approx(39e-3)


def test_a_stamp_of_a_time_to_come_is_not_believed() -> None:
    rig = Rig()
    rig.press()
    rig.tick.command(rig.command._replace(sequence=rig.sequence + 1, stamp_s=rig.now_s + 0.9))
    assert rig.zero_after(silent=True) <= 0.005 + 1e-9
    rig.step()
    assert rig.state.dropped_commands == 0, "nor does it stand in the way of others"
    assert rig.state.command_age_s == 0.0


@pytest.mark.parametrize("ahead_s", [1.1, 3600.0, 1.7e9, 1e300])
def test_a_stamp_of_another_clock_is_refused_and_changes_nothing(ahead_s: float) -> None:
    rig = Rig()
    rig.press()
    bad = rig.command._replace(sequence=2**60, stamp_s=rig.now_s + ahead_s)
    with pytest.raises(CommandError, match=r"time to come.*monotonic"):
        rig.tick.command(bad)
    for _ in range(100):
        assert rig.step().z == pytest.approx(1.5, abs=0.02)
    assert rig.state.dropped_commands == 0


def test_a_stamp_is_judged_by_the_callers_clock_where_it_has_one() -> None:
    tick = Tick()
    with pytest.raises(CommandError, match="time to come"):
        tick.command(HapticCommand(1, 10.1), now_s=10.0)
    assert tick.command(HapticCommand(1, 10.01), now_s=10.0)


def test_a_stamp_of_another_clock_before_the_first_tick_does_not_block_later_ones() -> None:
    rig = Rig()
    rig.tick.command(rig.command._replace(sequence=2**60, stamp_s=1.7e9))
    rig.press()
    assert rig.state.dropped_commands <= 1


def test_a_stamp_ahead_of_the_clock_makes_no_command_live_longer() -> None:
    rig = Rig()
    rig.press()
    rig.tick.command(rig.command._replace(sequence=rig.sequence + 1, stamp_s=rig.now_s + 0.015))
    for _ in range(28):
        force = rig.step(silent=True)
    assert force == ZERO3


def test_stale_commands_are_dropped() -> None:
    tick = Tick()
    assert tick.command(HapticCommand(5, 1.0))
    assert not tick.command(HapticCommand(5, 1.001))
    assert not tick.command(HapticCommand(4, 1.001))
    assert not tick.command(HapticCommand(6, 0.999))
    assert tick.snapshot().dropped_commands == 3
    assert tick.command(HapticCommand(6, 1.0))
    assert tick.command(HapticCommand(1, 1.2)), "another source, after a silence"


def test_a_flying_stylus_is_a_fault_until_enabled() -> None:
    rig = Rig()
    rig.press()
    height = BELOW.z
    for _ in range(30):
        height += 1.2e-3
        rig.step(position=Vector3(0.0, 0.0, height))
    state = rig.state
    assert state.state is OperatingState.FAULT
    assert "flew" in state.reason
    assert state.faults == 1
    assert state.force == ZERO3
    rig.run(1.0)
    assert rig.state.state is OperatingState.FAULT
    rig.tick.enable()
    rig.run(1.1)
    assert rig.state.state is OperatingState.ENABLED
    assert rig.glide(BELOW, 0.3).z > 1.0


def test_a_fast_hand_without_force_is_none() -> None:
    rig = Rig()
    rig.tick.enable()
    rig.send(engaged=False)
    rig.run(0.1, velocity=Vector3(3.0, 0.0, 0.0))
    assert rig.state.state is OperatingState.ENABLED


def test_continuous_force_is_squeezed_to_what_the_motors_bear() -> None:
    rig = Rig(passivity=False, engage_ramp_s=0.0)
    rig.engage()
    rig.send(force=Vector3(2.0, 0.0, 0.0))
    rig.run(30.0)
    assert size(rig.forces[-1]) == pytest.approx(0.88, abs=0.01)
    state = rig.state
    assert state.squeeze == pytest.approx(0.44, abs=0.01)
    assert state.reason == "limited to spare the motors"
    mean = 0.0
    for f in rig.forces:
        mean += (size(f) ** 2 - mean) * PERIOD_S / 10.0
        assert mean <= 0.88**2 * (1 + 1e-3)
    rig.send(force=ZERO3)
    rig.run(15.0)
    assert rig.state.squeeze == 1.0


@pytest.mark.parametrize(("temperature", "share"), [(0.6, 1.0), (0.8, 0.5), (0.9, 0.0), (1.0, 0.0)])
def test_warm_motors_get_less(temperature: float, share: float) -> None:
    rig = Rig()
    rig.engage()
    rig.send(force=Vector3(2.0, 0.0, 0.0))
    force = rig.run(0.1, temperature=temperature)
    assert size(force) == pytest.approx(2.0 * share, abs=1e-9)


def test_buzzing_halves_the_force_then_pauses() -> None:
    rig = Rig(passivity=False, damping_n_s_m=0.0)
    rig.press()
    halved = False
    for k in range(1000):  # noqa: B007
        rig.step(
            position=Vector3(0.0, 0.0, BELOW.z + 2e-4 * math.sin(2 * math.pi * 60 * rig.now_s))
        )
        state = rig.state
        halved = halved or state.reason == "it buzzed: force reduced"
        if state.state is OperatingState.PAUSED:
            break
    assert halved
    assert 0.05 < k * PERIOD_S < 0.4
    assert rig.tick.details().buzzes == 2
    rig.glide(ABOVE, 0.5)
    assert rig.state.state is OperatingState.PAUSED, "not by itself"
    rig.send(engaged=False)
    rig.run(0.01)
    rig.send(engaged=True)
    rig.run(1.1)
    assert rig.glide(BELOW, 0.2).z > 1.0


def test_a_late_tick_asks_for_no_force_and_a_long_gap_pauses() -> None:
    rig = Rig()
    rig.press()
    assert rig.step(gap_s=0.0021).z == pytest.approx(1.5 - 0.4, abs=0.02)
    assert rig.state.reason == "the tick was late"
    assert rig.run(0.009).z == pytest.approx(1.5, abs=0.02), "no hole of 40 ms"
    assert rig.run(0.1).z == pytest.approx(1.5, abs=0.02)
    assert rig.step(gap_s=0.006) == ZERO3
    assert rig.state.late_ticks == 2
    rig.run(0.1)
    assert rig.step(gap_s=0.025) == ZERO3
    assert rig.state.state is OperatingState.PAUSED
    assert not rig.state.rendering


@pytest.mark.parametrize("what", ["silence", "late tick", "unsound"])
def test_after_an_interruption_the_force_comes_back_by_the_ramp(what: str) -> None:
    rig = Rig()
    rig.press()
    if what == "silence":
        for _ in range(40):
            rig.step(silent=True)
    elif what == "late tick":
        rig.step(gap_s=0.006)
    else:
        for _ in range(6):
            rig.step(unsound=True)
        rig.sample = rig.sample._replace(unsound=False)
    assert rig.forces[-1] == ZERO3
    assert rig.state.state is OperatingState.ENABLED
    start = len(rig.forces)
    rig.run(0.12)
    back = [round(force.z, 9) for force in rig.forces[start:]]
    assert back[29] < 0.3 * 1.5 + 0.1, "at the slew limit it would be all there"
    assert back[-1] == pytest.approx(1.5, abs=0.02)
    assert back == sorted(back)


def test_a_source_that_stutters_is_paused_and_begins_small_once_it_is_steady() -> None:
    """One command each 71 ms would be a sawtooth of 14 Hz for ever."""
    rig = Rig()
    rig.press()
    before = rig.state.energy_j
    for _ in range(6):
        rig.step()
        for _ in range(70):
            rig.step(silent=True)
    state = rig.state
    assert state.state is OperatingState.PAUSED
    assert "too irregular" in state.reason
    assert all(force == ZERO3 for force in rig.forces[-2 * 71 :])
    rig.run(0.4)
    assert rig.state.state is OperatingState.PAUSED, "not calm for long enough"
    rig.run(0.2)
    assert rig.state.state is OperatingState.ENABLED
    assert rig.run(0.5) == ZERO3
    assert "too large to engage" in rig.state.reason
    rig.glide(ABOVE, 0.1)
    rig.run(1.1)
    assert rig.glide(BELOW, 0.2).z > 1.0
    assert before > 0.0


def test_late_ticks_again_and_again_are_paused_too() -> None:
    rig = Rig()
    rig.press()
    for k in range(400):
        rig.step(gap_s=0.006 if k % 100 == 99 else PERIOD_S)
    assert "too irregular" in rig.state.reason


def test_a_few_interruptions_far_from_each_other_are_none() -> None:
    rig = Rig()
    rig.press()
    for _ in range(8):
        rig.run(0.4)
        rig.step(gap_s=0.006)
    assert rig.state.state is OperatingState.ENABLED


def test_interruptions_are_of_the_same_engagement() -> None:
    rig = Rig(passivity=False)
    rig.press()
    before = rig.state.given_peak_j, rig.state.energy_j
    for _ in range(6):
        rig.step()
        for _ in range(70):
            rig.step(silent=True)
    rig.run(0.6)
    assert rig.state.energy_j == pytest.approx(before[1], abs=1e-4)
    assert rig.state.given_peak_j == before[0]


@pytest.mark.parametrize("rate_hz", [500, 700, 880])
def test_a_slow_loop_gives_no_force_and_engages_anew(rate_hz: int) -> None:
    rig = Rig()
    rig.press()
    for _ in range(rate_hz // 2):
        rig.step(gap_s=1.0 / rate_hz)
        assert distance(rig.forces[-1], rig.forces[-2]) <= 0.4 / rate_hz * 1000 + 1e-9
    state = rig.state
    assert state.force == ZERO3
    assert not state.rendering
    assert state.reason in ("the force loop is too slow for force", "the tick was late")
    assert rig.run(0.5) == ZERO3
    assert "too large to engage" in rig.state.reason
    rig.glide(ABOVE, 0.1)
    rig.run(1.1)
    assert rig.glide(BELOW, 0.2).z > 1.0


def test_around_the_lowest_rate_the_force_does_not_flutter() -> None:
    rig = Rig()
    rig.press()
    changes, before = 0, True
    for k in range(3000):
        rig.step(gap_s=1.0 / (895.0 if k // 100 % 2 else 910.0))
        rendering = rig.state.rendering
        changes += rendering is not before
        before = rendering
    assert changes <= 1


def test_one_stall_is_no_slow_loop() -> None:
    rig = Rig()
    rig.press()
    rig.step(gap_s=0.019)
    rig.run(0.02)
    rig.step(gap_s=0.015)
    reasons = set()
    for _ in range(200):
        rig.step()
        reasons.add(rig.state.reason)
    assert "the force loop is too slow for force" not in reasons
    assert rig.forces[-1].z == pytest.approx(1.5, abs=0.02)


def test_while_the_motors_are_off_nothing_is_asked_of_them() -> None:
    rig = Rig()
    rig.press()
    rig.tick.allow(False)
    assert rig.zero_after() <= 0.005 + 1e-9
    assert rig.state.reason == "the motors are not on"
    assert not rig.state.rendering
    rig.tick.allow(True)
    assert rig.run(0.3) == ZERO3, "it engages anew"


def test_what_was_lost_is_a_fault_until_enabled() -> None:
    rig = Rig()
    rig.press()
    rig.tick.lose()
    state = rig.state
    assert (state.state, state.faults) == (OperatingState.FAULT, 1)
    assert "lost" in state.reason
    rig.tick.lose()
    assert rig.state.faults == 1
    assert rig.zero_after() <= 0.005 + 1e-9
    rig.glide(ABOVE, 0.1)
    rig.run(1.2)
    assert rig.glide(BELOW, 0.2) == ZERO3
    # What nothing steps has no clock: commands go on, by their own order.
    rig.tick.lose()
    assert rig.tick.command(rig.command._replace(sequence=10**6, stamp_s=rig.now_s + 3600.0))


def test_readings_that_fail_are_no_readings() -> None:
    rig = Rig()
    rig.press()
    good = rig.state
    before = rig.now_s
    for k in range(120):
        rig.step(unsound=True, position=Vector3(0.3, 0.3, 0.3), buttons=3, calibrated=False)
        state = rig.state
        assert state.stamp_s == pytest.approx(before)
        assert (state.pose, state.presses) == (good.pose, good.presses)
        assert state.calibration is Calibration.OK
        assert (state.state is OperatingState.FAULT) is (k >= 100)
        if k >= 6:
            assert state.force == ZERO3
    assert "readings fail" in rig.state.reason
    assert rig.tick.details().bad_readings == 120


def test_before_the_first_sound_reading_there_is_none() -> None:
    rig = Rig()
    rig.step(unsound=True, position=Vector3(0.3, 0.3, 0.3))
    assert (rig.state.pose, rig.state.stamp_s) == (None, -math.inf)


def test_after_a_long_gap_the_force_is_back_within_a_tenth_of_a_second() -> None:
    """A hand that leant on it has begun to fall: it would never find a small force again."""
    rig = Rig()
    rig.press()
    rig.step(gap_s=0.025)
    norms = [round(rig.run(0.01).z, 9) for _ in range(13)]
    assert norms == sorted(norms)
    assert norms[3] < 0.8
    assert norms[-1] == pytest.approx(1.5, abs=0.02)
    assert rig.state.state is OperatingState.ENABLED
    assert rig.state.rendering
    assert rig.state.given_peak_j <= rig.limits.energy_budget_j


def test_a_long_gap_while_nothing_was_let_out_changes_nothing_of_that() -> None:
    rig = Rig()
    rig.press()
    rig.tick.pause()
    rig.run(0.02)
    rig.step(gap_s=0.025)
    rig.tick.resume()
    assert rig.run(0.5) == ZERO3
    assert "too large to engage" in rig.state.reason


def test_the_largest_force_is_remembered() -> None:
    rig = Rig()
    rig.press()
    rig.tick.disable()
    rig.run(0.1)
    assert rig.state.force == ZERO3
    assert rig.state.peak_n == pytest.approx(1.5, abs=0.05)


def test_a_clock_that_stands_still_or_goes_back_gives_no_step() -> None:
    rig = Rig()
    before = rig.press()
    rig.send(force=Vector3(0.0, 5.0, 0.0))
    assert rig.step(gap_s=0.0) == before
    assert rig.step(gap_s=-0.5, silent=True) == before


def test_after_a_late_tick_the_librarys_velocity_is_no_flight() -> None:
    rig = Rig()
    rig.press()
    rig.step(gap_s=0.03, velocity=Vector3(0.0, 0.0, 1.6))
    rig.run(0.02, velocity=Vector3(0.0, 0.0, 1.2))
    assert rig.state.state is not OperatingState.FAULT
    rig.run(0.2)
    rig.step(velocity=Vector3(0.0, 0.0, 1.2))
    assert rig.state.state is OperatingState.FAULT


def test_under_a_clock_that_stands_the_force_goes() -> None:
    rig = Rig()
    assert rig.press().z > 1.4
    for _ in range(19):
        rig.step(gap_s=0.0)
    assert [rig.step(gap_s=0.0).z for _ in range(6)][-1] == 0.0
    assert rig.state.stale_commands == 1


def test_a_new_engagement_does_not_resume_the_old_one() -> None:
    rig = Rig()
    rig.press()
    rig.step(gap_s=0.025)
    rig.tick.disable()
    rig.tick.enable()
    assert rig.run(0.5) == ZERO3
    assert "too large to engage" in rig.state.reason


def test_a_measured_force_of_a_time_to_come_is_not_felt() -> None:
    rig = Rig()
    rig.engage()
    rig.send(measured=MeasuredForce(Vector3(0.0, 0.0, 1.0), rig.now_s + 100.0))
    assert rig.run(0.1) == ZERO3
    assert rig.state.force_age_s == math.inf


def test_maxima_are_since_the_snapshot_before() -> None:
    rig = Rig()
    rig.run(0.01)
    rig.step(gap_s=0.004)
    rig.run(0.01)
    assert rig.state.gap_s == pytest.approx(0.004)
    rig.run(0.01)
    assert rig.state.gap_s == pytest.approx(0.001)


# ---------------------------------------------------------------------------------------------
# What is no number


@pytest.mark.parametrize("bad", [NAN, math.inf, -math.inf])
@pytest.mark.parametrize(
    "field",
    ["now_s", "position", "velocity", "rotation", "joints_rad", "gimbal_rad", "temperature"],
)
def test_a_sample_that_is_no_number_is_a_fault_and_no_force(field: str, bad: float) -> None:
    rig = Rig()
    rig.press()
    good = rig.sample
    value = getattr(good, field)
    if isinstance(value, tuple):
        value = (*value[:-1], bad)
    else:
        value = bad
    before = rig.forces[-1]
    for k in range(6):
        rig.now_s += PERIOD_S
        sample = good._replace(now_s=rig.now_s)
        if k == 0:
            sample = sample._replace(**{field: value})
        force = rig.tick.step(sample)
        assert size(force) <= size(before)
        before = force
    assert force == ZERO3
    state = rig.state
    assert state.state is OperatingState.FAULT
    assert "not finite" in state.reason
    assert all(math.isfinite(x) for x in (*state.force, *state.velocity, state.energy_j))
    rig.tick.enable()
    rig.step()
    assert rig.state.state is OperatingState.ENABLED


def test_forces_that_overflow_are_a_fault() -> None:
    rig = Rig()
    rig.press()
    rig.send(
        force=Vector3(1.7e308, 0.0, 0.0),
        measured=MeasuredForce(ZERO3, rig.now_s),
        world=WorldMap(linear=(1.7e308,) * 9),
        fixtures=(Spring(ZERO3, 1e300, 1e300),),
    )
    assert rig.zero_after() <= 0.005 + 1e-9
    assert rig.state.state is OperatingState.FAULT


MEASURED = MeasuredForce(ZERO3, 1.0)
BAD_COMMANDS: list[tuple[dict[str, Any], str]] = [
    ({"stamp_s": NAN}, "not finite"),
    ({"force": Vector3(0.0, math.inf, 0.0)}, "not finite"),
    ({"force_scale": NAN}, "not finite"),
    ({"force_scale": -1.0}, "negative"),
    ({"joint_torques_n_m": Vector3(NAN, 0.0, 0.0)}, "not finite"),
    ({"world": WorldMap(offset=Vector3(NAN, 0.0, 0.0))}, "not finite"),
    ({"world": WorldMap(linear=(NAN,) * 9)}, "not finite"),
    ({"world": WorldMap(rotation=(1.0, 0, 0, 0, 1.0, 0, 0, 0, -1.0))}, "no rotation"),
    ({"world": WorldMap(rotation=(2.0, 0, 0, 0, 1.0, 0, 0, 0, 0.5))}, "no rotation"),
    ({"measured": MEASURED._replace(force=Vector3(NAN, 0.0, 0.0))}, "not finite"),
    ({"measured": MEASURED._replace(stamp_s=NAN)}, "not finite"),
    ({"measured": MEASURED._replace(rate_n_s=Vector3(NAN, 0.0, 0.0))}, "not finite"),
    ({"measured": MEASURED._replace(position=Vector3(NAN, 0.0, 0.0))}, "not finite"),
    ({"measured": MEASURED._replace(stiffness_n_m=-1.0)}, "negative"),
    ({"fixtures": (FLOOR,) * 9}, "more than 8"),
    ({"fixtures": (FLOOR._replace(stiffness_n_m=NAN),)}, "not finite"),
    ({"fixtures": (FLOOR, FLOOR._replace(cap_n=-1.0))}, "negative"),
    ({"fixtures": (FLOOR._replace(normal=Vector3(0.0, 0.0, 2.0)),)}, "not of length 1"),
    ({"fixtures": (Cylinder(ZERO3, ZERO3, 1.0, 1.0),)}, "not of length 1"),
    ({"fixtures": (Box(ZERO3, Vector3(1, 1, -1), 1.0),)}, "negative"),
    ({"fixtures": (Box(ZERO3, ZERO3, 1.0, rotation=(0.0,) * 9),)}, "no rotation"),
    ({"fixtures": (Sphere(ZERO3, -0.1, 1.0),)}, "negative"),
    ({"fixtures": ("wall",)}, "no fixture"),
    ({"sequence": -1}, "cannot be taken"),
    ({"force": ("a", "b", "c")}, "cannot be taken"),
]


@pytest.mark.parametrize(("change", "words"), BAD_COMMANDS, ids=[str(c) for c, _ in BAD_COMMANDS])
def test_bad_commands_are_refused_and_change_nothing(change: dict[str, Any], words: str) -> None:
    rig = Rig(**BARE)
    rig.send(force=Vector3(0.0, 0.0, 1.0))
    good = rig.command
    rig.step(silent=True)
    with pytest.raises(CommandError, match=words):
        rig.tick.command(good._replace(**{"sequence": 99, "stamp_s": 200.0, **change}))
    rig.step(silent=True)
    assert rig.state.force_commanded == (0.0, 0.0, 1.0)
    assert rig.state.command_sequence == 1
    assert rig.tick.command(good._replace(sequence=2, stamp_s=rig.now_s)), "nor what is stale"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"clamp_n": 4.0}, "3.3"),
        ({"clamp_n": 0.0}, "above 0"),
        ({"clamp_n": NAN}, "a number"),
        ({"slew_fall_n_s": 300.0}, "clamp_n / release_s"),
        ({"pause_s": 0.01}, "at least hold_s"),
        ({"pause_gap_s": 0.001}, "at least overrun_gap_s"),
        ({"damping_n_s_m": -0.1}, "0 or more"),
        ({"energy_budget_j": "much"}, "a number"),
        ({"workspace_lower_m": (0.0, 0.0)}, "three lengths"),
        ({"workspace_lower_m": (0.0, 0.0, 0.3)}, "workspace_upper_m"),
        ({"engage_ticks": 0}, "1 to 10000"),
        ({"clamp_n": True}, "a number"),
        ({"clamp_n": 10**400}, "a number"),
        ({"passivity": "no"}, "true or false"),
        ({"passivity": 1}, "true or false"),
        ({"engage_ticks": 2.5}, "a whole number"),
        ({"engage_ticks": True}, "a whole number"),
        ({"workspace_upper_m": ("a", 0, 0)}, "three lengths"),
        ({"workspace_upper_m": None}, "three lengths"),
        ({"workspace_upper_m": (50.0, 50.0, 50.0)}, "-1 to 1 m"),
        ({"hold_s": 0.5, "pause_s": 0.9}, "dead program"),
        ({"velocity_gate_m_s": 1e9}, "0.2 to 2"),
        ({"energy_budget_j": 1e9}, "0 to 0.2"),
        ({"buzz_changes": 50}, "2 to 32"),
    ],
)
def test_limits_that_make_no_sense_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        TickLimits(**change)


@pytest.mark.parametrize("name", tick_module.RANGES)
@pytest.mark.parametrize("end", [0, 1])
def test_both_languages_refuse_what_a_device_may_not_be_driven_with(name: str, end: int) -> None:
    edge, reason = tick_module.RANGES[name][end], tick_module.RANGES[name][2]
    beyond = edge * (1.001 if end else 0.999) - (1e-9 if edge == 0.0 else 0.0)
    with pytest.raises(ValueError, match=name):
        TickLimits(**{name: beyond})
    assert reason
    wide: dict[str, Any] = {"slew_fall_n_s": 3300.0, "release_s": 0.05, "pause_s": 0.9}
    wide |= {"pause_gap_s": 0.09, "overrun_gap_s": 0.0012, "hold_s": 0.001}
    for value, taken in ((edge, True), (beyond, False)):
        limits = tick_module._c_limits(TickLimits(**wide))
        setattr(limits, name, value)
        if name == "pause_s":
            limits.hold_s = min(limits.hold_s, value)
        elif name == "slew_fall_n_s" and not end:
            continue  # Too slow for any release, whatever the range.
        elif name == "release_s" and not end:
            limits.clamp_n = 2.0
        pointer = tick_module._library().tick_create(ctypes.byref(limits))
        assert bool(pointer) is taken, (name, value)
        if pointer:
            tick_module._library().tick_destroy(pointer)


def test_experiments_may_go_beyond_and_say_so() -> None:
    limits = UncheckedLimits(engage_ramp_s=0.0, velocity_gate_m_s=100.0)
    Tick(limits).close()
    assert isinstance(dataclasses.replace(limits, passivity=False), UncheckedLimits)
    with pytest.raises(ValueError, match="a number"):
        UncheckedLimits(clamp_n=NAN)


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(TickLimits)])
def test_every_limit_arrives(name: str) -> None:
    """Of the limits as C has them, this one and no other differs."""
    value = getattr(TickLimits(), name)
    change: Any
    if name == "passivity":
        change = False
    elif isinstance(value, tuple):
        change = tuple(0.9 * x for x in value)
    elif isinstance(value, int) or name in ("slew_fall_n_s", "pause_s", "pause_gap_s", "release_s"):
        change = 2 * value
        if name == "release_s":
            change = value  # its only effect is what slew_fall_n_s must be
    else:
        change = 0.9 * value
    if name == "temperature_limit":
        change = 0.8
    a, b = (
        tick_module._c_limits(limits) for limits in (TickLimits(), TickLimits(**{name: change}))
    )
    for field, *_ in a._fields_:
        first, second = (getattr(x, field) for x in (a, b))
        if isinstance(value, tuple) and field == name:
            assert tuple(second) == pytest.approx(change)
        elif field == name:
            assert second == pytest.approx(float(change))
        elif hasattr(first, "_length_"):
            assert tuple(first) == tuple(second)
        else:
            assert first == second


def test_limits_can_change_while_it_runs() -> None:
    rig = Rig()
    rig.press()
    rig.tick.set_limits(dataclasses.replace(rig.limits, clamp_n=1.0))
    force = rig.run(0.01)
    assert size(force) == pytest.approx(1.0)


# ---------------------------------------------------------------------------------------------
# States, buttons


@pytest.mark.parametrize(
    ("start", "verb", "end"),
    [
        ("disabled", "enable", "enabled"),
        ("disabled", "disable", "disabled"),
        ("disabled", "pause", None),
        ("disabled", "resume", None),
        ("enabled", "enable", "enabled"),
        ("enabled", "disable", "disabled"),
        ("enabled", "pause", "paused"),
        ("enabled", "resume", None),
        ("paused", "enable", None),
        ("paused", "disable", "disabled"),
        ("paused", "pause", "paused"),
        ("paused", "resume", "enabled"),
        ("fault", "enable", "enabled"),
        ("fault", "disable", "disabled"),
        ("fault", "pause", None),
        ("fault", "resume", None),
    ],
)
def test_state_commands(start: str, verb: str, end: str | None) -> None:
    rig = Rig()
    if start != "disabled":
        rig.tick.enable()
    if start == "paused":
        rig.tick.pause()
    if start == "fault":
        rig.step(position=Vector3(NAN, 0.0, 0.0))
    assert rig.state.state is OperatingState(start)
    if end is None:
        with pytest.raises(CommandError, match=f"{verb} is not possible in state {start}"):
            getattr(rig.tick, verb)()
    else:
        getattr(rig.tick, verb)()
    assert rig.tick.state is rig.state.state is OperatingState(end or start)
    rig.step(position=ZERO3)
    assert rig.state.state is OperatingState(end or start)


def test_disabled_and_enabled_between_two_ticks_engages_anew() -> None:
    rig = Rig()
    rig.press()
    rig.tick.disable()
    rig.tick.enable()
    assert rig.zero_after() <= 0.005 + 1e-9
    assert "too large to engage" in rig.state.reason


def test_a_clutch_released_and_pressed_between_two_ticks_engages_anew() -> None:
    rig = Rig()
    rig.press()
    rig.send(engaged=False)
    rig.send(engaged=True)
    assert rig.zero_after() <= 0.005 + 1e-9


def test_the_account_is_closed_only_once_the_force_is_gone() -> None:
    rig = Rig()
    rig.press()
    rig.send(engaged=False)
    rig.send(engaged=True, fixtures=())
    while rig.state.energy_j != 0.0:
        assert len(rig.forces) < 10_000
        before = rig.forces[-1]
        rig.step()
    assert before == ZERO3


@pytest.mark.parametrize("bounce_ms", [0, 1, 3, 5, 10, 20])
def test_a_bouncing_button_is_pressed_once_and_at_once(bounce_ms: int) -> None:
    rig = Rig()
    rig.run(0.05)
    for press in range(1, 5):
        rig.step(buttons=2)
        assert rig.state.presses == (0, press), "the first edge counts"
        for k in range(bounce_ms):
            rig.step(buttons=2 * (k % 2))
        rig.run(0.06, buttons=2)
        assert rig.state.buttons == 2
        rig.step(buttons=0)
        assert rig.state.buttons == 0
        for k in range(bounce_ms):
            rig.step(buttons=2 * ((k + 1) % 2))
        rig.run(0.06, buttons=0)
        assert (rig.state.presses, rig.state.buttons) == ((0, press), 0)


def test_buttons_do_not_hold_each_other_up_and_time_counts_not_ticks() -> None:
    rig = Rig()
    rig.run(0.05)
    rig.step(buttons=1)
    rig.step(buttons=3)
    assert rig.state.presses == (1, 1)
    rig.step(buttons=0, gap_s=0.024)
    assert rig.state.buttons == 2, "25 ms from its own edge"
    rig.step(buttons=0, gap_s=0.002)
    assert rig.state.buttons == 0


def test_a_snapshot_tells_what_the_device_told() -> None:
    rig = Rig()
    assert rig.state.pose is None
    turn = rotation(0.4, -1.2, 2.9)
    rig.run(
        0.01,
        position=Vector3(0.01, 0.02, 0.03),
        rotation=turn,
        joints_rad=Vector3(0.1, 0.2, 0.3),
        gimbal_rad=Vector3(1.1, 1.2, 1.3),
        temperature=0.4,
        encoders=(1, 2, 3, -4, 5, 6),
        buttons=2,
    )
    state = rig.state
    assert state.pose is not None
    w, x, y, z = state.pose.orientation
    again = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    assert again == pytest.approx(turn)
    assert state.pose.position == (0.01, 0.02, 0.03)
    assert state.joints_rad == (0.1, 0.2, 0.3)
    assert state.gimbal_rad == (1.1, 1.2, 1.3)
    assert state.temperature == 0.4
    assert state.buttons == 2
    assert state.calibration is Calibration.OK
    assert state.ticks == 10
    assert state.stamp_s == pytest.approx(rig.now_s)
    assert state.rate_hz == pytest.approx(1000.0)
    assert rig.tick.details().encoders == (1, 2, 3, -4, 5, 6)


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).filter(
        lambda q: sum(x * x for x in q) > 0.01
    )
)
def test_every_orientation_survives(q: list[float]) -> None:
    w, x, y, z = (v / size(q) for v in q)
    matrix = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    again = tick_module._quaternion(matrix)
    assert abs(sum(a * b for a, b in zip(again, (w, x, y, z), strict=True))) == pytest.approx(1.0)


# ---------------------------------------------------------------------------------------------
# Energy


class Ledger:
    """The energy given to a hand, from what was sent and where the stylus went; and the bound.

    `given_j` if places are measured at once, `given_late_j` if they are a tick old when measured.
    """

    def __init__(self, limits: TickLimits) -> None:
        fall = limits.slew_fall_n_s * PERIOD_S
        self.factor = limits.clamp_n * (math.ceil(limits.clamp_n / fall - 1e-9) + 3) / 2
        self.limits = limits
        self.given_j = self.given_late_j = self.worst_j = self.excess_m = 0.0
        self.force = self.force_before = self.moved = np.zeros(3)
        self.at: Any = None

    def step(self, position: Any, force: Any) -> None:
        if self.at is not None:
            moved = position - self.at
            now_j, late_j = float(self.force @ moved), float(self.force_before @ moved)
            self.given_j += now_j
            self.given_late_j += late_j
            self.worst_j += max(now_j, late_j)
            self.excess_m += max(
                0.0, float(np.linalg.norm(moved - self.moved)) - self.limits.prediction_error_m
            )
            self.moved = moved
        self.at, self.force_before, self.force = position, self.force, force

    @property
    def bound_j(self) -> float:
        return self.limits.energy_budget_j + self.factor * self.excess_m

    @property
    def kept(self) -> bool:
        return max(self.given_j, self.given_late_j) <= self.bound_j + 1e-9


class Hand:
    """A mass with a damper and perhaps a spring, which the force moves."""

    def __init__(self, mass_kg: float, damping: float, stiffness: float, at: Any) -> None:
        self.mass_kg, self.damping, self.stiffness = mass_kg, damping, stiffness
        self.target = np.array(at, dtype=float)
        self.position, self.velocity = self.target.copy(), np.zeros(3)

    def move(self, force: Any) -> Any:
        for _ in range(4):
            total = (
                force
                - self.damping * self.velocity
                + self.stiffness * (self.target - self.position)
            )
            self.velocity = self.velocity + total * (PERIOD_S / 4 / self.mass_kg)
            self.position = self.position + self.velocity * (PERIOD_S / 4)
        return self.position


HANDS = st.tuples(st.floats(0.045, 0.5), st.floats(0.05, 8.0), st.floats(0.0, 500.0))


def live(
    hand: Hand,
    scene: Callable[[int], dict[str, Any]],
    ticks: int,
    *,
    quantum_m: float = 0.0,
    **limits: Any,
) -> tuple[Rig, Ledger]:
    """Engage in free space, then let the hand live in a scene of commands; returns the account."""
    rig = Rig(engage_ramp_s=0.0, velocity_gate_m_s=1e9, buzz_changes=32, **limits)
    rig.tick.enable()
    ledger = Ledger(rig.limits)

    def read() -> Any:
        at = hand.position
        return np.round(at / quantum_m) * quantum_m if quantum_m else at.copy()

    rig.send()
    for _ in range(8):
        at = read()
        ledger.step(at, np.array(rig.step(position=Vector3(*at))))
    for k in range(ticks):
        change = scene(k)
        if change:
            rig.send(**change)
        hand.move(ledger.force)
        at = read()
        force = np.array(rig.step(position=Vector3(*at)))
        ledger.step(at, force)
        assert ledger.kept, k
        assert np.linalg.norm(force) <= rig.limits.clamp_n
    return rig, ledger


@settings(max_examples=25, deadline=None)
@given(st.lists(FIXTURES, min_size=1, max_size=4), HANDS, VECTORS)
def test_energy_is_bounded_in_any_scene(
    fixtures: list[Fixture], hand: tuple[float, ...], at: Vector3
) -> None:
    live(Hand(*hand, at), lambda k: {"fixtures": tuple(fixtures)} if k == 0 else {}, 400)


@settings(max_examples=25, deadline=None)
@given(
    FIXTURES,
    HANDS,
    st.floats(0.5, 30.0),
    st.floats(0.0, 0.04),
    st.integers(1, 50),
    st.floats(0.0, 0.005),
)
def test_energy_is_bounded_when_fixtures_move(
    fixture: Fixture,
    hand: tuple[float, ...],
    frequency_hz: float,
    amplitude_m: float,
    every: int,
    budget_j: float,
) -> None:
    """The world is shaken, seen every so many ticks."""

    def scene(k: int) -> dict[str, Any]:
        if k % every:
            return {}
        shift = amplitude_m * math.sin(2 * math.pi * frequency_hz * k * PERIOD_S)
        return {"fixtures": (fixture,), "world": WorldMap(offset=Vector3(shift, 0.0, shift))}

    live(Hand(*hand, ZERO3), scene, 400, energy_budget_j=budget_j)


@settings(max_examples=25, deadline=None)
@given(
    HANDS,
    st.floats(10.0, 3000.0),
    st.integers(0, 100),
    st.integers(1, 40),
    st.booleans(),
    st.floats(0.3, 3.0),
)
def test_energy_is_bounded_behind_a_delay(
    hand: tuple[float, ...],
    stiffness: float,
    delay: int,
    every: int,
    quantised: bool,
    push_n: float,
) -> None:
    """A remote wall, felt as a force that is late and held: what goes unstable without the law."""
    body = Hand(*hand, ZERO3)
    past: list[float] = []

    def scene(k: int) -> dict[str, Any]:
        past.append(float(body.position[2]))
        body.velocity[2] -= push_n * PERIOD_S / body.mass_kg * (k < 200)
        late = past[max(0, k - delay)]
        if k % every:
            return {}
        force = Vector3(0.0, 0.0, max(0.0, -stiffness * late))
        return {"measured": MeasuredForce(force, 100.0 + (9 + k) * PERIOD_S)}

    live(body, scene, 500, quantum_m=6e-5 if quantised else 0.0)


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    HANDS,
    st.lists(FIXTURES, min_size=1, max_size=3),
)
def test_energy_is_bounded_through_interruptions(
    seed: int, hand: tuple[float, ...], fixtures: list[Fixture]
) -> None:
    """Silence, late ticks, the inkwell and force that comes and goes: one engagement, one bound."""
    random = np.random.default_rng(seed)
    rig = Rig(engage_ramp_s=0.0, velocity_gate_m_s=1e9, buzz_changes=32)
    rig.tick.enable()
    rig.send()
    body, ledger = Hand(*hand, ZERO3), Ledger(rig.limits)
    silent = docked = 0
    for _ in range(600):
        if random.random() < 0.01:
            force = Vector3(*random.normal(0.0, 1.0, 3))
            rig.send(fixtures=tuple(fixtures) if random.random() < 0.5 else (), force=force)
        if random.random() < 0.01:
            rig.send(fixtures=(), force=ZERO3)
        silent = int(random.integers(1, 60)) if random.random() < 0.01 else max(0, silent - 1)
        docked = int(random.integers(1, 20)) if random.random() < 0.01 else max(0, docked - 1)
        at = body.move(ledger.force).copy()
        force = rig.step(silent=silent > 0, position=Vector3(*at), inkwell=docked > 0)
        ledger.step(at, np.array(force))
        assert ledger.kept


def test_every_engagement_has_a_budget_of_its_own() -> None:
    rig = Rig(engage_ramp_s=0.0)
    rig.tick.enable()
    for _ in range(3):
        rig.send(force=ZERO3, engaged=True)
        rig.run(0.02)
        before = rig.state
        assert before.energy_j == pytest.approx(0.0, abs=1e-6)
        rig.send(force=Vector3(0.5, 0.0, 0.0))
        start = rig.sample.position
        rig.glide(start._replace(x=start.x + 0.02), 0.5)
        after = rig.state
        assert 0.003 < after.delivered_j - before.delivered_j <= 0.005
        rig.send(engaged=False)
        rig.run(0.02)


def test_a_plain_loop_would_have_given_energy() -> None:
    """The same late wall with the controller off: the bound is one that is needed."""

    def given(passivity: bool) -> float:
        body, past = Hand(0.1, 0.1, 0.0, ZERO3), []
        rig = Rig(engage_ramp_s=0.0, velocity_gate_m_s=1e9, buzz_changes=32, passivity=passivity)
        rig.tick.enable()
        rig.send()
        rig.run(0.01)
        ledger = Ledger(rig.limits)
        for k in range(1000):
            past.append(float(body.position[2]))
            rig.send(force=Vector3(0.0, 0.0, -500.0 * past[max(0, k - 20)]))
            body.velocity[2] += 0.01 * (k == 0)
            at = body.move(ledger.force).copy()
            ledger.step(at, np.array(rig.step(position=Vector3(*at))))
        state = rig.state
        assert state.delivered_j == pytest.approx(ledger.worst_j, abs=1e-9)
        return ledger.given_j

    assert given(False) > 0.05
    assert given(True) <= 0.005


def test_a_still_hand_feels_all_of_a_wall() -> None:
    """Passivity takes nothing from a wall that is pressed and left again as people do."""
    rig = Rig(engage_ramp_s=0.1)
    rig.press()
    for _ in range(5):
        rig.glide(ABOVE, 0.15)
        force = rig.glide(BELOW, 0.15)
        assert force.z == pytest.approx(1.5, abs=0.1)
        state = rig.state
        assert state.passivity_damping_n_s_m == 0.0
        assert state.energy_j >= 0.0


def test_an_empty_tank_damps_first() -> None:
    """A force pushes the hand away: the observer sees it, alpha is tried, then it is let go."""
    rig = Rig(engage_ramp_s=0.0)
    rig.engage()
    rig.send(force=Vector3(1.0, 0.0, 0.0))
    alphas, position = [], 0.0
    for k in range(200):
        position += min(k, 100) * 1e-6
        rig.step(position=Vector3(position, 0.0, 0.0))
        alphas.append(rig.state.passivity_damping_n_s_m)
    state = rig.state
    assert max(alphas) == pytest.approx(4.0)
    assert state.reason == "limited to stay passive"
    assert size(state.force) < 0.6
    assert state.delivered_j <= 0.005
    assert state.energy_j >= -0.005


def test_the_observer_counts_what_is_sent() -> None:
    rig = Rig(passivity=False, engage_ramp_s=0.0)
    rig.engage(fixtures=(FLOOR,))
    ledger = Ledger(rig.limits)
    for k in range(1000):
        at = np.array([0.0, 0.0, 0.004 * math.sin(0.01 * k)])
        ledger.step(at, np.array(rig.step(position=Vector3(*at))))
    assert rig.state.delivered_j == pytest.approx(ledger.worst_j, abs=1e-12)


# ---------------------------------------------------------------------------------------------
# Threads and the library itself


def test_nothing_is_ever_read_half_written() -> None:
    """Three threads without the interpreter's lock: one commands, one steps, one reads."""
    free: Any = ctypes.CDLL(str(library_path()))
    limits = tick_module._c_limits(TickLimits(**ROOM))
    free.tick_create.restype = ctypes.c_void_p
    tick = ctypes.c_void_p(free.tick_create(ctypes.byref(limits)))
    stop = threading.Event()
    torn: list[Any] = []
    seen: set[int] = set()

    def command() -> None:
        c = tick_module._Command()
        c.linear[:] = c.rotation[:] = IDENTITY3
        c.fixture_count, c.force_scale = 8, 1.0
        sequence = 0
        for fixture in c.fixtures:
            fixture.kind = 4
            fixture.rotation[:] = IDENTITY3
            fixture.stiffness_n_m, fixture.cap_n = 1.0, 1e9
        while not stop.is_set():
            sequence += 1
            c.sequence, c.stamp_s = sequence, float(sequence)
            c.force[:] = c.offset[:] = (sequence, sequence, sequence)
            for fixture in c.fixtures:
                fixture.point[:] = (2.0 * sequence, 2.0 * sequence, 2.0 * sequence)
            free.tick_command(tick, ctypes.byref(c))

    def step() -> None:
        s = tick_module._Sample()
        s.rotation[:] = s.jacobian[:] = IDENTITY3
        s.calibrated = 1
        output = tick_module._Output()
        k = 0
        while not stop.is_set():
            k += 1
            s.now_s = 1e-3 * k
            s.joints_rad[:] = s.gimbal_rad[:] = (k, k, k)
            free.tick_step(tick, ctypes.byref(s), ctypes.byref(output))

    def read() -> None:
        snapshot = tick_module._Snapshot()
        while len(seen) < 1000 and not torn:
            free.tick_snapshot(tick, ctypes.byref(snapshot))
            if not snapshot.ticks:
                continue
            sequence = snapshot.command_sequence
            # 8 springs of 1 N/m pull by 2n - n each, and n beside: 9 n along each axis.
            if set(snapshot.commanded[:]) != {9.0 * sequence}:
                torn.append((sequence, snapshot.commanded[:]))
            if {*snapshot.joints_rad[:], *snapshot.gimbal_rad[:]} != {float(snapshot.ticks)}:
                torn.append((snapshot.ticks, snapshot.joints_rad[:], snapshot.gimbal_rad[:]))
            seen.add(snapshot.ticks)

    others = [threading.Thread(target=t) for t in (command, step)]
    for thread in others:
        thread.start()
    reader = threading.Thread(target=read)
    reader.start()
    reader.join(60.0)
    stop.set()
    for thread in others:
        thread.join()
    assert not torn
    assert len(seen) >= 1000
    free.tick_destroy(tick)


def test_both_languages_agree_on_every_field(monkeypatch: pytest.MonkeyPatch) -> None:
    assert available()
    right = tick_module._expected_layout()
    monkeypatch.setattr(tick_module, "_expected_layout", lambda: [*right[:-1], right[-1] + 4])
    tick_module._library.cache_clear()
    try:
        with pytest.raises(NativeMissingError, match="tools/native"):
            Tick()
        assert not available()
    finally:
        tick_module._library.cache_clear()


def test_without_the_compiled_part_it_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    monkeypatch.setattr(tick_module, "library_path", lambda: tmp_path / "libcardan_omni.so")
    tick_module._library.cache_clear()
    try:
        assert not available()
        with pytest.raises(NativeMissingError, match="gcc"):
            Tick()
    finally:
        tick_module._library.cache_clear()


def test_packed_and_declared_structures_are_the_same() -> None:
    assert tick_module._COMMAND.size == tick_module._Command.fixtures.offset
    assert tick_module._FIXTURE.size == ctypes.sizeof(tick_module._Fixture)
    assert tick_module._SAMPLE.size + tick_module._SAMPLE_REST.size == ctypes.sizeof(
        tick_module._Sample
    )
    assert tick_module._SNAPSHOT.size == ctypes.sizeof(tick_module._Snapshot)


def test_after_close_it_says_so() -> None:
    tick = Tick()
    tick.close()
    tick.close()
    with pytest.raises(DriverError, match="closed"):
        tick.snapshot()
