"""A session whose network becomes bad, or whose computer's clock is set, while its arm moves: rows
of the fault table."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cardan.demos.examples import free_ports
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.subprocesses import cardan_subprocess
from cardan.gateway.session.supervisor import supervise
from tests.kernel.test_session_netem import (
    PERIOD_S,
    PROGRAM,
    READY_WITHIN_S,
    loopback as loopback,
    story,
)

SPEED_M_S = 0.04
HAND = """
    0.2  axes 0 0 0.2 0 0 0 over 0.1
    0.3  neutral over 0.1
    0.8  press first
    1.0  axes -1 0 0 0 0 0
    5.0  axes 1 0 0 0 0 0
    9.0  neutral
    9.2  release first
    9.4  loop
"""
SECONDS = 300.0
"""Longest time of the session; it ends once all faults were applied."""
SILENCE_S = 0.5
"""Silence limit of the link: one and a half times as many of the slow periods here as a real
session has in 0.1 s."""
STEADY = 3
"""Number of snapshots, at ten a second, that must show the arm at its speed before a fault."""
WATCH_S = 1.5

Act = Callable[[Callable[..., None]], None]


def shaped(*words: str) -> Act:
    return lambda loopback: loopback(*words)


def stepped(seconds: float) -> Act:
    """Set the computer's clock."""
    return lambda _: time.clock_settime(time.CLOCK_REALTIME, time.time() + seconds)


FAULTS: dict[str, Act] = {
    **{f"{share} % of all datagrams lost": shaped("loss", f"{share}%") for share in (1, 5, 10, 30)},
    **{f"{ms} ms of delay, each way": shaped("delay", f"{ms}ms") for ms in (20, 50, 100, 200)},
    "the clock is set forward by 1 h": stepped(3600.0),
    "the clock is set back by 2 h": stepped(-7200.0),
}

GAPS = {f"{ms} ms of delay, each way" for ms in (100, 200)}
"""Faults that begin with a gap so long that the arm stops."""


def held_up(snapshot: Snapshot, name: str) -> bool:
    """True if the emulator was too slow for the session or its supervisor, which is a different
    fault."""
    said = f"{snapshot.arm.message} {snapshot.robot.hold_reason}"
    return "supervises" in said or ("stalled" in said and name not in GAPS)


class Course:
    """Applies faults in sequence, each while the arm moves steadily."""

    def __init__(self, loopback: Callable[..., None]) -> None:
        self._loopback = loopback
        self._left = list(FAULTS)
        self._steady = 0
        self._seen: list[Snapshot] = []
        self._at_s = 0.0
        self._name = ""
        self.all: list[Snapshot] = []
        self.rows: list[dict[str, Any]] = []

    @property
    def over(self) -> bool:
        return not self._left and not self._name

    def show(self, snapshot: Snapshot) -> None:
        now_s = time.monotonic()
        self.all.append(copy.deepcopy(snapshot))
        if not self._name:
            speed = max((abs(each) for each in snapshot.arm.twist[:3]), default=0.0)
            going = snapshot.arm.phase == "moving" and speed > 0.9 * SPEED_M_S
            self._steady = self._steady + 1 if going else 0
            if self._left and self._steady >= STEADY:
                self._name, self._at_s, self._seen = self._left.pop(0), now_s, [self.all[-1]]
                FAULTS[self._name](self._loopback)
            return
        self._seen.append(self.all[-1])
        if now_s >= self._at_s + WATCH_S:
            self._loopback("delay", "0ms")
            let_go = any("left" not in each.device.buttons for each in self._seen)
            if let_go or any(held_up(each, self._name) for each in self._seen):
                self._left.append(self._name)  # retried after the others
            else:
                self.rows.append(self._row())
            self._name, self._steady = "", 0

    def _row(self) -> dict[str, Any]:
        first, last = self._seen[0], self._seen[-1]
        moves = [each.arm.phase == "moving" for each in self._seen]
        stopped = moves.index(False) if False in moves else None
        said = [each.arm.message or each.robot.hold_reason for each in self._seen]
        return {
            "name": self._name,
            "stop_s": None if stopped is None else self._seen[stopped].elapsed_s - first.elapsed_s,
            "distance_m": math.dist(first.robot.pose[:3], last.robot.pose[:3]),
            "peak_m_s": fastest(self._seen),
            "again": stopped is not None and any(moves[stopped:]),
            "said": next(filter(None, said), ""),
        }


def fastest(snapshots: list[Snapshot]) -> float:
    """Highest commanded speed, m/s."""
    return max(math.hypot(*snapshot.arm.twist[:3]) for snapshot in snapshots)


@pytest.mark.timeout(440)
@pytest.mark.judged(
    device="GoFa", transport="EGM with loss, delay, clock steps", by="Linux kernel 6.1: netem"
)
def test_a_bad_network_and_a_wrong_clock_make_no_arm_faster_and_move_none_again(
    loopback: Callable[..., None],
    tmp_path: Path,
    fault_rows: list[dict[str, Any]],
):
    hand, program = tmp_path / "hand.txt", tmp_path / "program.txt"
    hand.write_text(HAND)
    program.write_text(PROGRAM)
    hid, port = str(tmp_path / "puck"), free_ports()
    config = parse_config(
        {
            "device": {"driver": "spacemouse", "transport": "socket", "path": hid},
            "robot": {"driver": "abb_egm", "listen_port": port, "silence_s": SILENCE_S},
            "mapping": {"deadman": "left", "linear_speed_m_s": SPEED_M_S},
        }
    )
    course = Course(loopback)
    with (
        cardan_subprocess(
            *("sim", "spacemouse", "--hid", hid, "--script", str(hand)),
            ready_within_s=READY_WITHIN_S,
        ),
        cardan_subprocess(
            *("sim", "abb-gofa"),
            *("--to", f"127.0.0.1:{port}", "--script", str(program), "--period", str(PERIOD_S)),
            ready_within_s=READY_WITHIN_S,
        ),
    ):
        supervise(config, SECONDS, course.show, lambda: not course.over)
    fault_rows += course.rows
    assert {row["name"] for row in course.rows} == {*FAULTS}, story(course.all)
    assert not [row for row in course.rows if row["again"]]
    assert fastest(course.all) < 1.1 * SPEED_M_S
    for row in course.rows:
        if "clock" in row["name"] or row["name"].startswith(("1 ", "5 ", "20 ")):
            assert row["stop_s"] is None, (row, story(course.all))
