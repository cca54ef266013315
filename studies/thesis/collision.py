"""Commands into an obstacle, into the arm itself, and across an obstacle, on the UR5."""

from __future__ import annotations

from typing import NamedTuple

from cardan.common.arm_libraries import np
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import CollisionModel, Obstacle, box_obstacle
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.robots import load_arm
from cardan.spatial import scale
from cardan.types import ZERO_TWIST, Frame, Twist, Vector3
from studies.thesis.bench import (
    STIFF,
    Array,
    Bench,
    Drive,
    Metronome,
    Row,
    Session,
    Streams,
    Trace,
    both,
)

SPEED_M_S = 0.1
RATE_HZ = 20.0
GAP_M = 0.1
"""Distance from the arm to the wall at the start."""
INTO_M = 0.1
"""Distance of the last command beyond the contact."""
SAFETY_M = 0.01
OWN_M = 0.005
"""Distances kept by the servo: to obstacles, and between the arm's own bodies."""
JUMP_M = 0.18
JUMP_GAP_M = 0.03
THIN_M = 0.005
WRIST_RADIUS_M = 0.04
"""Radius of the UR5's last body about the TCP's axis, for placing walls."""
STAY_S = 1.0
FORWARD = Vector3(1.0, 0.0, 0.0)
INWARD = Vector3(-0.8, 0.0, -0.6)
"""Direction towards the arm's own base."""


def _limits() -> ReferenceLimits:
    return ReferenceLimits(linear_acceleration_m_s2=STIFF.streams.linear_acceleration_m_s2)


def wall(gap_m: float, low: bool = False) -> Obstacle:
    """Return a wall 5 mm thick, across x, `gap_m` before the arm at home; `low`: as high as the
    TCP."""
    arm = ArmKinematics(load_arm("ur5"))
    x, _, z = arm.forward(np.array(arm.arm.home)).translation.tolist()
    x += WRIST_RADIUS_M + gap_m
    return box_obstacle("wall", Vector3(x, -0.6, 0.0), Vector3(x + THIN_M, 0.8, z if low else 1.2))


class Stop(NamedTuple):
    """Result of a motion into an obstacle, a stay, and the way back."""

    trace: Trace
    back_s: float
    """Start time of the way back."""
    final_m: float
    """Clearance at the end of the stay."""
    smallest_m: float
    crept_m: float
    """Largest motion during the last half of the stay."""
    retreat_s: float
    """Time from the first command away until 90 % of the commanded speed is reached."""
    refusals: int


def _stop(trace: Trace, clearance: Array, back_s: float, free_s: float, refusals: int) -> Stop:
    stay = (trace.times_s > back_s - 0.5 * STAY_S) & (trace.times_s < back_s)
    held = trace.measured_m[stay]
    away = (trace.times_s > free_s) & (trace.speed_m_s > 0.9 * SPEED_M_S)
    return Stop(
        trace,
        back_s,
        float(clearance[stay][-1]),
        float(clearance.min()),
        float(np.linalg.norm(held - held[0], axis=1).max()),
        float(trace.times_s[away][0] - free_s) if away.any() else float("inf"),
        refusals,
    )


def into_by_poses(drive: Drive) -> Stop:
    """Stream poses that pass through the wall and return."""
    bench = Bench("ur5", drive, obstacles=(wall(GAP_M),))
    driving = bench.streams("pose")
    start = bench.placement(driving)
    deepest_s = (GAP_M + INTO_M) / SPEED_M_S
    back_s = deepest_s + STAY_S
    clock = Metronome(RATE_HZ)
    stood: list[float] = []

    def target(at_s: float) -> float:
        return min(SPEED_M_S * at_s, GAP_M + INTO_M) - SPEED_M_S * max(0.0, at_s - back_s)

    def operator(now_s: float) -> None:
        due_s = clock.due(now_s)
        if due_s is None:
            return
        if due_s >= back_s and not stood:
            stood.append(float((bench.placement(driving).translation - start.translation)[0]))
        driving.pose(start.translation + np.array((target(due_s), 0.0, 0.0)), start.rotation)

    trace = bench.run(driving, back_s + 2.5, operator)
    free_s = back_s + (GAP_M + INTO_M - stood[0]) / SPEED_M_S
    return _stop(trace, trace.obstacle_m, back_s, free_s, len(driving.refusals))


def into_by_twists(drive: Drive) -> Stop:
    """Drive a session's twist into the wall, and then straight back."""
    bench = Bench("ur5", drive, obstacles=(wall(GAP_M),))
    return _twists(bench, FORWARD, (GAP_M + 0.05) / SPEED_M_S, own=False)


def into_itself(drive: Drive) -> Stop:
    """Drive a session's twist towards the arm's own base, and then straight back."""
    return _twists(Bench("ur5", drive), INWARD, 0.55 / SPEED_M_S, own=True)


def _twists(bench: Bench, direction: Vector3, seconds: float, own: bool) -> Stop:
    driving = bench.session(_limits())
    back_s = seconds + STAY_S

    def operator(now_s: float) -> None:
        speed = SPEED_M_S if now_s < back_s else -SPEED_M_S
        driving.target = Twist(scale(direction, speed), ZERO_TWIST.angular, Frame.BASE)

    trace = bench.run(driving, back_s + 1.0, operator)
    clearance = trace.own_m if own else trace.obstacle_m
    return _stop(trace, clearance, back_s, back_s, 0)


class Slide(NamedTuple):
    """Result of a twist at 45 degrees into the wall."""

    share: float
    """Share of the tangential speed that is kept along the wall."""
    smallest_m: float


def slide(drive: Drive) -> Slide:
    """Drive a session's twist at 45 degrees into the wall."""
    bench = Bench("ur5", drive, obstacles=(wall(0.03),))
    driving: Session = bench.session(_limits())

    def operator(now_s: float) -> None:
        linear = Vector3(SPEED_M_S, -SPEED_M_S, 0.0)
        driving.target = Twist(linear, ZERO_TWIST.angular, Frame.BASE)

    trace = bench.run(driving, 2.0, operator)
    last = trace.times_s >= 1.0 - 1e-9
    way = -np.ptp(trace.measured_m[last][:, 1])
    seconds = trace.times_s[last][-1] - trace.times_s[last][0]
    return Slide(float(-way / (SPEED_M_S * seconds)), float(trace.obstacle_m.min()))


class Jump(NamedTuple):
    """Result of commanding a pose on the other side of a thin wall."""

    trace: Trace
    answer: str
    smallest_m: float
    final_m: float
    off_m: float
    """Distance from the commanded pose to the final TCP."""
    published_m: float
    """Smallest distance to the wall on the straight joint path that the published interface
    commands; negative: through it."""


def jump(drive: Drive) -> Jump:
    """Command a pose 0.18 m away, with the wall in between."""
    obstacle = wall(JUMP_GAP_M, low=True)
    bench = Bench("ur5", drive, obstacles=(obstacle,))
    driving: Streams = bench.streams("pose")
    start = bench.placement(driving)
    goal = start.copy()
    goal.translation = start.translation + np.array((JUMP_M, 0.0, 0.0))
    answers: list[str] = []
    clock = Metronome(RATE_HZ)

    def operator(now_s: float) -> None:
        if clock.due(now_s) is not None:
            answers.append(driving.pose(goal.translation, goal.rotation))

    trace = bench.run(driving, 2.0, operator)
    arm = ArmKinematics(load_arm("ur5"))
    model = CollisionModel(arm, (obstacle,))
    there = arm.inverse(goal, trace.joints[0])
    assert there is not None
    way = np.linspace(trace.joints[0], there, 400)
    distances = np.array([model.at(q) for q in way])[:, model.with_obstacle].min(axis=1)
    if distances[-1] < SAFETY_M:
        raise AssertionError("the pose beyond the wall is not free: the jump would be none")
    return Jump(
        trace,
        answers[0],
        float(trace.obstacle_m.min()),
        float(trace.obstacle_m[-1]),
        float(np.linalg.norm(trace.commanded_m[-1] - goal.translation)),
        float(distances.min()),
    )


class Result(NamedTuple):
    """Results for one drive."""

    poses: Stop
    twists: Stop
    itself: Stop
    sliding: Slide
    jump: Jump


def measure(drive: Drive) -> Result:
    """Run all collisions on one drive."""
    return Result(
        into_by_poses(drive), into_by_twists(drive), into_itself(drive), slide(drive), jump(drive)
    )


def rows(ideal: Result, dynamic: Result) -> list[Row]:
    """Return the table."""
    stops = (
        ("poses into a wall", "poses", SAFETY_M, "stops where it is, before"),
        ("twist into a wall", "twists", SAFETY_M, "stops where it is, before"),
        ("twist into itself", "itself", OWN_M, "stops where it is, before"),
    )
    found = []
    for what, key, wanted_m, published in stops:
        one, two = getattr(ideal, key), getattr(dynamic, key)
        found += [
            Row(
                f"{what}: smallest / final clearance",
                published,
                *both(lambda s: f"{s.smallest_m * 1e3:.2f} / {s.final_m * 1e3:.2f} mm", one, two),
                f"comes to {wanted_m * 1e3:g} mm, >= 90 %",
                one.smallest_m >= 0.9 * wanted_m and one.final_m <= 1.1 * wanted_m,
            ),
            Row(
                "  motion while held (twists slide)",
                "none",
                *both(lambda s: f"{s.crept_m * 1e3:.2f} mm", one, two),
                "<= 0.1 mm" if key == "poses" else "",
                one.crept_m <= 1e-4 if key == "poses" else None,
            ),
            Row(
                "  asked away: 90 % of the speed after",
                "",
                *both(lambda s: f"{s.retreat_s * 1e3:.0f} ms", one, two),
                "<= 100 ms",
                one.retreat_s <= 0.1,
            ),
        ]
    found += [
        Row(
            "twist at 45° into the wall: kept along it",
            "does not slide",
            *both(lambda r: f"{r.sliding.share * 100:.1f} %", ideal, dynamic),
            ">= 95 %",
            ideal.sliding.share >= 0.95,
        ),
        Row(
            "  smallest clearance",
            "",
            *both(lambda r: f"{r.sliding.smallest_m * 1e3:.2f} mm", ideal, dynamic),
            ">= 9 mm",
            ideal.sliding.smallest_m >= 0.9 * SAFETY_M,
        ),
        Row(
            "one pose behind a wall: smallest / final",
            f"collides (simulated: {ideal.jump.published_m * 1e3:.1f} mm)",
            *both(
                lambda r: f"{r.jump.smallest_m * 1e3:.2f} / {r.jump.final_m * 1e3:.2f} mm",
                ideal,
                dynamic,
            ),
            ">= 9 mm",
            ideal.jump.smallest_m >= 0.9 * SAFETY_M,
        ),
        Row(
            "  command from the pose after 2 s",
            "",
            *both(lambda r: f"{r.jump.off_m * 1e3:.1f} mm", ideal, dynamic),
        ),
    ]
    return found
