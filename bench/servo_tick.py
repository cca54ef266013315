"""Cost of one servo tick and of one inverse: Cardan and other libraries in Python and in C++.

    python -m bench servo-tick [--pages]

All are measured call by call, in turns within one run, on the same goals: a TCP that wanders at 0.1
m/s. Cardan's tick is complete: forward kinematics, Jacobian, singular value, limits of speed,
acceleration and range, the distances of 35 pairs, and the quadratic program. The others do less:
the plain step scales and clips, pink has limits but no distances, KDL has neither.

Rows "in C" are timed inside C, as a C++ caller would see them (bench/native): Cardan's kernel with
its 35 pairs and without any, a step with Pinocchio and daqp that has pink's task and limits, and
KDL. The first run builds them and names the parts that cannot be built.

Each is measured twice: in back-to-back calls, and paced at one call every 4 ms as in a session,
when other processes have used the caches. Paced calls use real-time scheduling if the user has the
right to it, so that waiting for the processor is not counted.
"""

from __future__ import annotations

import ctypes
import gc
import math
import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from bench import native, pages
from bench.arms import (
    DampedLeastSquares,
    kdl,
    kdl_step,
    kinematics,
    pink_step,
    shorten,
    surroundings,
)
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import to_pose
from cardan.gateway.kinematics.collision import CollisionModel
from cardan.gateway.servo.choice import AnyServo
from cardan.gateway.servo.compiled import CompiledServo
from cardan.gateway.servo.options import ServoOptions
from cardan.gateway.servo.servo import Servo
from cardan.robots import arm_names, load_arm
from cardan.types import ZERO3, Pose

DT_S = 0.002
PAIRS = 35
ROUNDS, CALLS = 12, 400
FOLLOWS = 1e-4
"""Tolerance for following the goal, m and rad; a peer with a larger error does not do the same
work."""
PACE_S = 0.004
PACED_ROUNDS, PACED_CALLS = 10, 100
POSES = 1000

Step = Callable[[Any, Pose], object]
"""Function that runs one tick towards a goal, given as a placement and as a pose."""

Timed = Callable[[Any, Pose], float]
"""Function that runs one such tick and returns its duration, s."""

ARMS = {"ur5": "UR5", "pr2_right_arm": "PR2 arm"}

Figures = dict[str, tuple[tuple[float, float], tuple[float, float]]]
"""Median and 99th percentile, µs, back to back and paced, by subject."""

PAGE = Path(__file__).parents[1] / "docs/measurements.md"
PART = "servo tick"

PYTHON, COMPILED, IN_C = "cardan in Python", "cardan compiled", "cardan's kernel in C"


def _timed(step: Step) -> Timed:
    clock = time.perf_counter

    def timed(goal: Any, pose: Pose) -> float:
        begin = clock()
        step(goal, pose)
        return clock() - begin

    return timed


def _cardan(kind: type[AnyServo], name: str, rows: int, pairs: int = PAIRS) -> AnyServo:
    """Cardan's servo with at least `rows` closing pairs in every quadratic program."""
    arm = kinematics(name)
    collision = shorten(CollisionModel(arm, surroundings()), pairs)
    home = np.array(arm.arm.home)
    retained_m = sorted(collision.at(home))[rows - 1] + 0.02 if rows else 1e-6
    options = ServoOptions(
        safety_distance_m=retained_m, self_distance_m=retained_m, closing_deceleration_m_s2=50.0
    )
    servo = kind(arm, collision, options)
    servo.place(home)
    return servo


def _tick(servo: AnyServo) -> Timed:
    """Run the tick as Python calls it."""
    return _timed(lambda goal, pose: servo.tick(pose, (ZERO3, ZERO3), DT_S))


def _kernel(servo: AnyServo) -> Timed:
    """Run the kernel's tick as C calls it."""
    assert isinstance(servo, CompiledServo)
    step, kernel = native.kernel_step(), servo._handle
    address = ctypes.cast(servo._library.kernel_tick, ctypes.c_void_p).value
    assert address is not None

    def timed(goal: Any, pose: Pose) -> float:
        servo._state.goal_position[:] = pose.position
        servo._state.goal_orientation[:] = pose.orientation
        return step(address, kernel, DT_S)

    return timed


def _peers(name: str) -> tuple[dict[str, Timed], list[str]]:
    """Return the peers in C and C++ that could be built, and the reasons why the others could
    not."""
    made: dict[str, Timed] = {}
    missing = []
    try:
        for what, pairs in ((f"{PAIRS} pairs", PAIRS), ("no pairs", 0)):
            made[f"{IN_C}, {what}"] = _kernel(_cardan(CompiledServo, name, 0, pairs))
    except native.NotBuiltError as error:
        missing.append(f"{IN_C}: {error}")
    for what, part in (
        ("Pinocchio, daqp in C++", native.PINOCCHIO_DAQP),
        ("KDL in C++", native.KDL),
    ):
        try:
            arm = kinematics(name)
            _require_that_it_follows(native.Peer(part, arm), arm, what)
            made[what] = _peer(native.Peer(part, arm))
        except native.NotBuiltError as error:
            missing.append(f"{what}: {error}")
    return made, missing


def _require_that_it_follows(peer: native.Peer, arm: ArmKinematics, what: str) -> None:
    """Check that all timed steps do the same work: each arm follows the goal within its limits."""
    start = arm.forward(np.array(arm.arm.home))
    goal = start
    for tick in range(200):
        goal = _goal(start, tick * DT_S)
        peer.step(goal, DT_S)
    off = float(np.abs(pin.log6(arm.forward(peer.q).actInv(goal)).vector).max())
    if not (off < FOLLOWS and (peer.q <= arm.upper + 1e-9).all()):
        raise RuntimeError(f"{what} does not follow the goal of {arm.arm.name}: {off:.2g} away")


def _peer(peer: native.Peer) -> Timed:
    return lambda goal, pose: peer.step(goal, DT_S)


def _goal(start: Any, t: float) -> Any:
    goal = start.copy()
    goal.translation = start.translation + 0.05 * np.array(
        (math.sin(2.0 * t), math.sin(1.3 * t), math.sin(1.7 * t))
    )
    return goal


def _measure(steps: dict[str, Timed], start: Any) -> dict[str, list[float]]:
    """Durations of back-to-back calls, the steps in turns, s."""
    samples: dict[str, list[float]] = {name: [] for name in steps}
    gc.collect()
    gc.disable()
    try:
        for turn in range(ROUNDS):
            goals = [_goal(start, (turn * CALLS + call) * DT_S) for call in range(CALLS)]
            poses = [to_pose(goal) for goal in goals]
            for name, step in steps.items():
                samples[name] += [step(goal, pose) for goal, pose in zip(goals, poses, strict=True)]
    finally:
        gc.enable()
    return samples


def _measure_paced(steps: dict[str, Timed], start: Any) -> dict[str, list[float]]:
    """Durations of calls made every PACE_S, the steps in turns, s."""
    samples: dict[str, list[float]] = {name: [] for name in steps}
    gc.collect()
    gc.disable()
    try:
        for turn in range(PACED_ROUNDS):
            for name, step in steps.items():
                for call in range(PACED_CALLS):
                    goal = _goal(start, (turn * PACED_CALLS + call) * DT_S)
                    pose = to_pose(goal)
                    time.sleep(PACE_S)
                    samples[name].append(step(goal, pose))
    finally:
        gc.enable()
    return samples


def _have_realtime() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    except PermissionError:
        return False
    return True


def _figures(values: list[float]) -> tuple[float, float]:
    """Return the median and 99th percentile, µs."""
    return statistics.median(values) * 1e6, float(np.percentile(values, 99)) * 1e6


def _ticks(arm: str, joints: int) -> Figures:
    """Measure on an arm; print and return the four figures of each subject."""
    model = kinematics(arm)
    plain, pink = DampedLeastSquares(kinematics(arm)).step, pink_step(kinematics(arm))
    compiled = {
        "35 pairs": _cardan(CompiledServo, arm, 0),
        "10 closing pairs": _cardan(CompiledServo, arm, 10),
    }
    steps: dict[str, Timed] = {
        **{f"{COMPILED}, {what}": _tick(servo) for what, servo in compiled.items()},
        f"{PYTHON}, 35 pairs": _tick(_cardan(Servo, arm, 0)),
        f"{PYTHON}, 10 closing pairs": _tick(_cardan(Servo, arm, 10)),
        "plain DLS": _timed(lambda goal, pose: plain(goal, DT_S)),
        "pink (daqp)": _timed(lambda goal, pose: pink(goal, DT_S)),
    }
    peers, missing = _peers(arm)
    steps |= peers
    library = kdl()
    if library is None:
        missing.append("KDL in Python: Debian package python3-pykdl, for Debian's own Python")
    else:
        other = kdl_step(kinematics(arm), library)
        steps["KDL in Python"] = _timed(lambda goal, pose: other(goal, DT_S))
    start = model.forward(np.array(model.arm.home))
    tight, paced = _measure(steps, start), _measure_paced(steps, start)
    print(f"\n{arm}, {joints} joints: one step, µs\n")
    print(f"{'':36}{'median':>9}{'p99':>9}{'paced':>9}{'p99':>9}   times plain DLS, tight")
    base = _figures(tight["plain DLS"])[0]
    for name, values in tight.items():
        median, p99 = _figures(values)
        slow, slowest = _figures(paced[name])
        print(f"{name:36}{median:9.1f}{p99:9.1f}{slow:9.1f}{slowest:9.1f}   {median / base:5.2f}")
    for why in missing:
        print(f"not measured: {why}")
    most = max(servo.status().iterations for servo in compiled.values())
    print(f"most iterations of the programs of one tick: {most}")
    return {name: (_figures(tight[name]), _figures(paced[name])) for name in steps}


def _verdicts(joints: int, found: Figures) -> list[str]:
    """Compare the results with the aims for an arm with this number of joints."""
    many, closing = found[f"{COMPILED}, 35 pairs"], found[f"{COMPILED}, 10 closing pairs"]
    return [
        f"{what} at most {most:g} µs: {'met' if value <= most else f'missed, {value:.0f}'}"
        for what, value, most in (
            ("35 pairs, tight, median", many[0][0], 8.0 if joints == 6 else 10.0),
            ("10 closing pairs, tight, median", closing[0][0], 15.0),
            ("35 pairs, paced, median", many[1][0], 25.0),
            ("35 pairs, paced, p99", many[1][1], 80.0),
        )
    ]


def _table(found: list[Figures], conditions: str) -> str:
    """Return the table of docs/measurements.md: a column for each arm, back to back and paced."""
    heads = [f"{title}, {how}" for title in ARMS.values() for how in ("tight", "paced")]
    lines = ["| | " + " | ".join(heads) + " |", "|---" * (1 + len(heads)) + "|"]
    for name in found[0]:
        cells = [f"{a:.1f} / {b:.1f}" for each in found for a, b in each[name]]
        label = f"**{name}**" if name.startswith(COMPILED) else name
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    lines.append("")
    for arm, each in zip(ARMS, found, strict=True):
        aims = "; ".join(_verdicts(len(load_arm(arm).joints), each))
        lines += [f"Aims, {ARMS[arm]}: {aims}."]
    return "\n".join(lines) + "\n\n" + conditions


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
    """Print both tables; with `--pages`, write the first one."""
    realtime = _have_realtime()
    load = os.getloadavg()[0]
    print(f"load {load:.1f} on {os.cpu_count()} processors, real-time scheduling: {realtime}")
    found = [_ticks(arm, len(load_arm(arm).joints)) for arm in ARMS]
    _inverses()
    body = _table(
        found,
        f"Median / p99, µs. {os.cpu_count()} processors, real-time scheduling: "
        f"{'yes' if realtime else 'no'}. Load in the minute before: {load:.1f}.",
    )
    print("\n" + pages.marked(PART, body), flush=True)
    if "--pages" in sys.argv:
        pages.rewrite(PAGE, {PART: body})
        print(f"docs/{PAGE.name} has these numbers")


if __name__ == "__main__":
    main()
