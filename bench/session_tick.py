"""Cost of one tick of the arm controller as a session makes it: `python -m bench session-tick`.

The robot is at its commanded position, the operator holds the dead-man button. All situations are
measured in turns within one run.
"""

from __future__ import annotations

import gc
import math
import statistics
import sys
import time
from types import FrameType
from typing import Any

import cardan
from cardan.gateway.session.assembly import make_controller, make_robot
from cardan.gateway.session.config import parse_config
from cardan.robots import load_arm
from cardan.types import (
    CommandKind,
    DeviceLink,
    DeviceState,
    Pose,
    Quaternion,
    RobotLink,
    RobotState,
    Vector3,
)

ARM = "gofa_crb15000_5"
DT_S = 0.004
ROUNDS, TICKS = 12, 400
PACKAGE = cardan.__path__[0]
DEVICE = {"device": {"driver": "spacemouse"}, "mapping": {"deadman": "left"}}
TABLES: dict[str, dict[str, Any]] = {
    "poses": {**DEVICE, "robot": {"driver": "abb_egm"}},
    "joints": {
        **DEVICE,
        "robot": {"driver": "sim_arm", "robot": ARM, "drive": "ideal"},
        "arm": {"model": ARM},
    },
}


class _Session:
    """A controller, an ideal robot and an operator who moves back and forth, or holds still."""

    def __init__(self, table: dict[str, Any], moves: bool) -> None:
        config = parse_config(table)
        self.controller = make_controller(config, make_robot(config))
        self._moves = moves
        self._now_s = 10.0
        self._ticks = 0
        self._joints = tuple(load_arm(ARM).home)
        self._pose: Pose | None = Pose(Vector3(0.6, 0.0, 0.6), Quaternion(0.0, 1.0, 0.0, 0.0))
        if config.arm is not None:
            self._pose = None  # The model's pose is used.

    def tick(self) -> float:
        """Run one control cycle; return the duration of the tick, s."""
        self._ticks += 1
        self._now_s += DT_S
        state = RobotState(
            self._now_s, RobotLink.LIVE, 1, self._ticks, DT_S, self._joints, (), self._pose, ""
        )
        x = 0.5 * math.sin(2.0 * self._ticks * DT_S) if self._moves and self._ticks > 40 else 0.0
        buttons = frozenset({"left"} if self._ticks > 20 else ())
        device = DeviceState(
            self._now_s, DeviceLink.LIVE, (x, 0.3 * x, 0.0, 0.0, 0.0, 0.1 * x), buttons
        )
        began_s = time.perf_counter()
        command = self.controller.tick(state, device)
        took_s = time.perf_counter() - began_s
        if command.kind is CommandKind.JOINT:
            self._joints = command.positions
        elif command.kind is CommandKind.POSE:
            self._pose = command.pose
        return took_s


def _calls(session: _Session) -> int:
    """Count the package's Python functions called in one tick."""
    found = 0

    def note(frame: FrameType, event: str, _: object) -> None:
        nonlocal found
        found += event == "call" and frame.f_code.co_filename.startswith(PACKAGE)

    sys.setprofile(note)
    session.tick()
    sys.setprofile(None)
    return found


def main() -> None:
    """Measure and print."""
    sessions = {
        f"{name}, {'moving' if moves else 'holding'}": _Session(table, moves)
        for name, table in TABLES.items()
        for moves in (True, False)
    }
    for session in sessions.values():
        for _ in range(200):
            session.tick()
    calls = {name: _calls(session) for name, session in sessions.items()}
    costs: dict[str, list[float]] = {name: [] for name in sessions}
    gc.collect()
    gc.disable()
    try:
        for _ in range(ROUNDS):
            for name, session in sessions.items():
                costs[name] += [session.tick() for _ in range(TICKS)]
    finally:
        gc.enable()
    print(f"\none tick of a session's controller, µs ({ARM})\n")
    print(f"{'robot is sent':20} {'median':>8} {'p99':>8} {'calls':>8}")
    for name, values in costs.items():
        values.sort()
        p99 = values[int(0.99 * len(values))]
        print(f"{name:20} {statistics.median(values) * 1e6:8.1f} {p99 * 1e6:8.1f} {calls[name]:8}")
