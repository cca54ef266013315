"""Cost of a servo tick on published arms, compared with Pinocchio, Coal and daqp.

    python -m bench published-tick [--pages]

The arms are eleven from the wheel example-robot-data, with shapes fitted to their meshes and the
pairs of these that are kept apart. Both are timed in C or C++, in back-to-back calls and in turns
within one run, on the same goals: a TCP that wanders at 0.1 m/s. Both respect the limits of speed,
acceleration and range, and their quadratic program has a row for each pair that could come too
near. The peer (bench/native/pinocchio_daqp.cpp) uses Coal's distances of the same shapes; before
timing, these are compared and the peer's arm has to follow the goal. Cardan's kernel also computes
the smallest singular value and the speed along the path. "From Python" is its tick as a session
calls it.
"""

from __future__ import annotations

import gc
import importlib.metadata
import os
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from bench import native, pages
from bench.servo_tick import DT_S, FOLLOWS, PAGE, Timed, _goal, _have_realtime, _kernel, _tick
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import to_pose
from cardan.gateway.kinematics.collision import CollisionModel
from cardan.gateway.servo.compiled import CompiledServo
from cardan.robots import load_arm
from tests.published_arms import ARMS, INSTALL, Published

PART = "published tick"
ROUNDS, CALLS = 20, 400
FOLLOWED_TICKS, SLOWLY = 200, 0.2
"""Number of ticks in which a peer has to follow the goal before it is timed, and the share of the
speed in them: the joints of some arms are too slow for the full speed."""

SAME_M = 1e-6
"""Tolerance of Coal's distances between Python and C++: Coal iterates."""

AT_END = 1e-9
"""Tolerance at the end of a joint's range, rad or m."""

MOST_US, MOST_TIMES = 8.0, 2.0

COLUMNS = (
    "Arm", "Joints", "Pairs", "Rows", "From Python, µs", "In C, µs", "Peer in C++, µs", "Times",
)  # fmt: skip


class Found(NamedTuple):
    """Measurement of one arm; each time is a median and a 90th percentile, µs."""

    name: str
    joints: int
    pairs: int
    rows: int
    """Largest number of rows in a program of the peer."""
    python: tuple[float, float]
    kernel: tuple[float, float]
    peer: tuple[float, float]

    @property
    def times(self) -> float:
        """Ratio of the kernel's median to the peer's."""
        return self.kernel[0] / self.peer[0]

    def row(self) -> list[str]:
        """Row of the table."""
        each = [f"{a:.1f} / {b:.1f}" for a, b in (self.python, self.kernel, self.peer)]
        counts = map(str, (self.joints, self.pairs, self.rows))
        return [self.name, *counts, *each, f"{self.times:.2f}"]


class Bench:
    """An arm and its timed steps."""

    def __init__(self, published: Published, folder: Path) -> None:
        """Raises NotBuiltError."""
        self.name = published.name
        self.arm = ArmKinematics(load_arm(str(published.write(folder))))
        self.collision = CollisionModel(self.arm)
        self.home = np.array(self.arm.arm.home)
        self.start = self.arm.forward(self.home)
        self.rows = 0
        self._require_the_same()
        self.peer = self._surrounded()

    def _surrounded(self) -> native.Peer:
        peer = native.Peer(native.PINOCCHIO_DAQP, self.arm)
        peer.surround(self.arm, self.collision)
        return peer

    def _servo(self) -> CompiledServo:
        return CompiledServo(self.arm, self.collision, weights=self.arm.arm.task.weights)

    def _off(self, q: Any, goal: Any) -> float:
        """Return the largest weighted distance of an arm from its goal, m and rad."""
        away = pin.log6(self.arm.forward(q).actInv(goal)).vector
        return float(np.abs(away * np.array(self.arm.arm.task.weights)).max())

    def _require_the_same(self) -> None:
        """Check that the timed peer has Coal's distances as seen from Python, and follows its
        goal."""
        peer, goal = self._surrounded(), self.start
        for tick in range(FOLLOWED_TICKS):
            q = peer.q
            goal = _goal(self.start, SLOWLY * tick * DT_S)
            peer.step(goal, DT_S)
            difference = np.abs(peer.distances - self.collision.at(q)).max(initial=0.0)
            if not difference < SAME_M:
                raise RuntimeError(f"{self.name}: distances differ by {difference:.2g} m")
        q, off = peer.q, self._off(peer.q, goal)
        room = np.minimum(q - self.arm.lower, self.arm.upper - q)
        # A pair or the end of a joint's range may keep the arm from its goal.
        follows = off < FOLLOWS or peer.rows > 0 or room.min() < AT_END
        if not (follows and room.min() > -AT_END):
            raise RuntimeError(f"the peer does not follow the goal of {self.name}: {off:.2g} away")

    def measure(self) -> Found:
        """Measure all steps in turns, each on a separate arm."""
        steps: dict[str, Timed] = {
            "python": _tick(self._servo()),
            "kernel": _kernel(self._servo()),
            "peer": self._step_of_peer,
        }
        samples: dict[str, list[float]] = {name: [] for name in steps}
        gc.collect()
        gc.disable()
        try:
            for turn in range(ROUNDS):
                goals = [_goal(self.start, (turn * CALLS + call) * DT_S) for call in range(CALLS)]
                poses = [to_pose(goal) for goal in goals]
                for name, step in steps.items():
                    samples[name] += [step(*each) for each in zip(goals, poses, strict=True)]
        finally:
            gc.enable()
        times = {
            name: (float(np.median(values)) * 1e6, float(np.percentile(values, 90)) * 1e6)
            for name, values in samples.items()
        }
        return Found(self.name, self.arm.joints, len(self.collision.pairs), self.rows, **times)

    def _step_of_peer(self, goal: Any, _: Any) -> float:
        took_s = self.peer.step(goal, DT_S)
        self.rows = max(self.rows, self.peer.rows)
        return took_s


def _verdict(found: list[Found]) -> str:
    slow = [f"{each.name} {each.python[0]:.1f}" for each in found if each.python[0] > MOST_US]
    long = [f"{each.name} {each.times:.2f}" for each in found if each.times > MOST_TIMES]
    judged = ["missed, " + ", ".join(which) if which else "met" for which in (slow, long)]
    return (
        f"Aims: from Python at most {MOST_US:g} µs: {judged[0]}; "
        f"in C at most {MOST_TIMES:g} times the peer: {judged[1]}."
    )


def main() -> None:
    """Print the table; with `--pages`, write it into the page."""
    try:
        importlib.metadata.distribution("example-robot-data")
        native.built(native.PINOCCHIO_DAQP)
    except importlib.metadata.PackageNotFoundError:
        print("not measured: " + INSTALL.format("example-robot-data"))
        return
    except native.NotBuiltError as error:
        print(f"not measured: {error}")
        return
    realtime, load = _have_realtime(), os.getloadavg()[0]
    found = []
    with tempfile.TemporaryDirectory(prefix="cardan-arms-") as folder:
        for published in ARMS:
            if published.package == "example-robot-data":
                found.append(Bench(published, Path(folder)).measure())
                print("  ".join(found[-1].row()), flush=True)
    lines = ["| " + " | ".join(COLUMNS) + " |", "|---" * len(COLUMNS) + "|"]
    lines += ["| " + " | ".join(each.row()) + " |" for each in found]
    conditions = (
        f"Median / 90th percentile. {os.cpu_count()} processors, real-time scheduling: "
        f"{'yes' if realtime else 'no'}. Load in the minute before: {load:.1f}."
    )
    body = "\n".join([*lines, "", _verdict(found), "", conditions])
    print("\n" + pages.marked(PART, body), flush=True)
    if "--pages" in sys.argv:
        pages.rewrite(PAGE, {PART: body})
        print(f"docs/{PAGE.name} has these numbers")


if __name__ == "__main__":
    main()
