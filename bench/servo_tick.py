"""Cost of one servo tick and of one inverse: Cardan, plain damped least squares, pink, KDL.

    python -m bench servo-tick

All are measured in turns within one run, each call alone, on the same goals: a TCP that wanders at
0.1 m/s. Cardan's tick is whole: forward kinematics, Jacobian, singular value, limits of speed,
acceleration and range, the distances of 35 pairs, and the quadratic programme. The others do less:
the plain step scales and clips, pink has limits but no distances, KDL has neither.
"""

from __future__ import annotations

import gc
import math
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from bench.arms import (
    DampedLeastSquares,
    kdl,
    kdl_step,
    kinematics,
    pink_step,
    shorten,
    surroundings,
)
from cardan.gateway.kinematics.collision import CollisionModel
from cardan.gateway.servo.options import ServoOptions
from cardan.gateway.servo.servo import Servo
from cardan.robots import arm_names

DT_S = 0.002
PAIRS = 35
ROUNDS, CALLS = 12, 400
POSES = 1000

Step = Callable[[Any, float], None]


def _cardan(name: str, rows: int) -> Step:
    """Cardan's tick with at least `rows` closing pairs in every programme."""
    arm = kinematics(name)
    collision = shorten(CollisionModel(arm, surroundings()), PAIRS)
    home = np.array(arm.arm.home)
    influence = 0.0
    if rows:
        influence = sorted(collision.at(home))[rows - 1] + 0.02
    options = ServoOptions(influence_distance_m=influence, closing_deceleration_m_s2=50.0)
    servo = Servo(arm, collision, options)
    servo.place(home)
    last = [home]

    def step(goal: Any, dt_s: float) -> None:
        servo.tick(goal, last[0], dt_s)

    last[0] = np.zeros((2, 3))
    return step


def _measure(steps: dict[str, Step], start: Any) -> dict[str, list[float]]:
    samples: dict[str, list[float]] = {name: [] for name in steps}
    goal, clock = start.copy(), time.perf_counter
    gc.collect()
    gc.disable()
    try:
        for turn in range(ROUNDS):
            for name, step in steps.items():
                for call in range(CALLS):
                    t = (turn * CALLS + call) * DT_S
                    goal.translation = start.translation + 0.05 * np.array(
                        (math.sin(2.0 * t), math.sin(1.3 * t), math.sin(1.7 * t))
                    )
                    begin = clock()
                    step(goal, DT_S)
                    samples[name].append(clock() - begin)
    finally:
        gc.enable()
    return samples


def _ticks(arm: str, joints: int) -> None:
    model = kinematics(arm)
    steps: dict[str, Step] = {
        "cardan, 35 pairs": _cardan(arm, 0),
        "cardan, 10 rows": _cardan(arm, 10),
        "plain DLS": DampedLeastSquares(kinematics(arm)).step,
        "pink (daqp)": pink_step(kinematics(arm)),
    }
    library = kdl()
    if library is not None:
        steps["KDL wdls"] = kdl_step(kinematics(arm), library)
    start = model.forward(np.array(model.arm.home))
    samples = _measure(steps, start)
    print(f"\n{arm}, {joints} joints: one step, µs\n")
    print(f"{'':20}{'median':>9}{'p99':>9}   times plain DLS")
    base = statistics.median(samples["plain DLS"])
    for name, values in samples.items():
        median, p99 = statistics.median(values), float(np.percentile(values, 99))
        print(f"{name:20}{median * 1e6:9.1f}{p99 * 1e6:9.1f}   {median / base:5.2f}")
    if library is None:
        print("KDL: not present (Debian package python3-pykdl, for Debian's own Python)")
    for name, aim in (("cardan, 35 pairs", (50, 100)), ("cardan, 10 rows", (80, 150))):
        median = statistics.median(samples[name]) * 1e6
        p99 = float(np.percentile(samples[name], 99)) * 1e6
        met = "met" if median <= aim[0] and p99 <= aim[1] else "MISSED"
        print(f"aim: {name} <= {aim[0]} / {aim[1]} µs: {met}")


def _inverses() -> None:
    print(f"\ninverse of {POSES} random reachable poses from random configurations\n")
    print(f"{'':20}{'found':>9}{'median µs':>11}{'p99 µs':>9}   aim 99.5 %, 150 µs")
    for name in arm_names():
        arm = kinematics(name)
        generator = np.random.default_rng(1)
        low = np.where(arm.continuous, -math.pi, arm.lower)
        high = np.where(arm.continuous, math.pi, arm.upper)
        found, times = 0, []
        for _ in range(POSES):
            goal = arm.forward(generator.uniform(low, high))
            near = generator.uniform(low, high)
            begin = time.perf_counter()
            q = arm.inverse(goal, near)
            times.append(time.perf_counter() - begin)
            if q is not None and arm.within_limits(q):
                difference = pin.log6(arm.forward(q).actInv(goal)).vector
                found += int(np.abs(difference).max() < 1e-5)
        share, median = found / POSES, statistics.median(times) * 1e6
        met = "met" if share >= 0.995 and median <= 150.0 else "MISSED"
        p99 = float(np.percentile(times, 99)) * 1e6
        print(f"{name:20}{share * 100:8.1f}%{median:11.0f}{p99:9.0f}   {met}")


def main() -> None:
    """Print both tables."""
    for arm, joints in (("ur5", 6), ("pr2_right_arm", 7)):
        _ticks(arm, joints)
    _inverses()


if __name__ == "__main__":
    main()
