"""Public EGM clients, unmodified, drive the simulated controller over loopback UDP."""

from __future__ import annotations

import contextlib
import json
import math
import select
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from cardan.sim_peers import datagrams
from cardan.sim_peers.egm_controller import EgmControllerOptions, EgmControllerPeer
from tests.sim_peers.egm_public_client import (
    CYCLES,
    SHIFT_MM,
    SPEED_MM_S,
    START_DEG,
    TARGET_DEG,
)

pytestmark = pytest.mark.matrix

PROGRAM = Path(__file__).with_name("egm_public_client.py")
AT_MOST_S = 30.0
SILENT_S = 2.0
"""Virtual time of a controller after its client's last message."""

both = pytest.mark.parametrize("library", ["ABBRobotEGM", "abb-robot-client"])


class InStep:
    """Clock and select() of a controller whose time stands still until its client has answered,
    unlike a real one's: a late client changes nothing.

    After the client's last answer, when only `answers` are expected, time advances by itself for
    `SILENT_S`; then the client's input ends.
    """

    def __init__(self, process: subprocess.Popen[str], answers: float) -> None:
        self.now_s = 100.0
        self.sent = False
        self._process, self._answers = process, answers
        self._end_s = math.inf

    def monotonic(self) -> float:
        return self.now_s

    def select(self, reads: list[Any], _w: list[Any], _x: list[Any], timeout_s: float) -> None:
        end = self._process.stdout
        if self.sent and self._answers > 0:
            ready, _, _ = select.select([*reads, end], [], [], AT_MOST_S)
            assert ready, "the client does not answer"
            if reads[0] not in ready:
                raise EOFError
            self.sent = False
            self._answers -= 1
            if not self._answers:
                self._end_s = self.now_s + SILENT_S
        self.now_s += timeout_s
        if self.now_s >= self._end_s:
            raise EOFError


def drive(
    monkeypatch: pytest.MonkeyPatch,
    library: str,
    scenario: str,
    answers: float = math.inf,
    **options: Any,
) -> tuple[dict[str, Any], EgmControllerPeer]:
    """Serve a controller while the client's program runs; return the client's output and the
    controller."""
    with subprocess.Popen(
        [sys.executable, str(PROGRAM), library, scenario],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdin is not None
            port = int(process.stdout.readline())
            clock = InStep(process, answers)
            monkeypatch.setattr(datagrams, "time", clock)
            monkeypatch.setattr(datagrams, "select", clock)
            peer = EgmControllerPeer(EgmControllerOptions(pc_port=port, **options))
            transmit = peer._transmit

            def note(data: bytes) -> None:
                clock.sent = True
                transmit(data)

            monkeypatch.setattr(peer, "_transmit", note)
            peer.open()
            with contextlib.suppress(EOFError):
                peer.step(math.inf)
            peer.close()
            said, _ = process.communicate(timeout=AT_MOST_S)
            assert process.returncode == 0
            return json.loads(said), peer
        finally:
            process.kill()


def joints_deg(peer: EgmControllerPeer) -> list[float]:
    return [math.degrees(q) for q in peer.core.joints_rad]


@pytest.mark.real
@pytest.mark.parametrize(
    ("library", "robotware"), [("ABBRobotEGM", "6"), ("abb-robot-client", "7")]
)
def test_joints(monkeypatch, library, robotware):
    saw, peer = drive(monkeypatch, library, "joints", mode="joint", robotware=robotware, k=15.0)
    first, last = saw["first"], saw["last"]
    assert first["motors_on"]
    assert first["rapid_running"]
    assert first["joints"] == pytest.approx(START_DEG, abs=0.01)
    assert first["joints_planned"] == pytest.approx(START_DEG, abs=0.01)
    assert last["joints"] == pytest.approx(TARGET_DEG, abs=0.03)
    assert joints_deg(peer) == pytest.approx(TARGET_DEG, abs=0.03)
    assert peer.core.counters.accepted > 0.9 * CYCLES
    assert peer.core.counters.ignored == {}
    assert all(event.code == 41830 for event in peer.core.events)


@pytest.mark.parametrize(
    ("library", "robotware"), [("ABBRobotEGM", "7.6"), ("abb-robot-client", "6.08")]
)
def test_poses(monkeypatch, library, robotware):
    saw, peer = drive(monkeypatch, library, "poses", mode="pose", robotware=robotware, k=15.0)
    target = [a + b for a, b in zip(saw["first"]["xyz"], SHIFT_MM, strict=True)]
    last = saw["last"]
    assert last["xyz"] == pytest.approx(target, abs=0.1)
    assert last["xyz_planned"] == pytest.approx(target, abs=0.1)
    dot = sum(a * b for a, b in zip(saw["first"]["orientation"], last["orientation"], strict=True))
    assert abs(dot) == pytest.approx(1.0, abs=1e-6)
    assert [1e3 * c for c in peer.core.tcp.position] == pytest.approx(target, abs=0.1)
    assert peer.core.counters.ignored == {}


@both
def test_speeds(monkeypatch, library):
    saw, peer = drive(monkeypatch, library, "speeds", mode="pose", script="speed")
    moved_mm = saw["last"]["xyz"][1] - saw["first"]["xyz"][1]
    assert moved_mm == pytest.approx(SPEED_MM_S * CYCLES / 2 * 0.004032, abs=3.0)
    assert peer.core.servo.at_rest or max(map(abs, peer.core.joint_speeds_rad_s)) < 1e-3


@both
def test_rapid_data_and_force(monkeypatch, library):
    saw, _ = drive(
        monkeypatch, library, "rapid_data", mode="joint", robotware="7.7", force_control=True
    )
    assert saw["last"]["rapid"] == [1.0, 2.5, -3.0]
    assert len(saw["last"]["force"]) == 6
    assert saw["last"]["move_index"] == 1


@both
def test_path_correction(monkeypatch, library):
    saw, peer = drive(
        monkeypatch, library, "path_correction", script="path", path_correction_absolute=True
    )
    aside = [b - a for a, b in zip(saw["first"]["xyz"], saw["last"]["xyz"], strict=True)]
    assert aside[1] > 20.0
    assert math.hypot(aside[0], aside[2]) == pytest.approx(10.0, abs=0.5)
    assert peer.core.counters.ignored == {}


def test_a_client_that_goes_silent_meets_its_comm_timeout(monkeypatch):
    saw, peer = drive(
        monkeypatch, "ABBRobotEGM", "silence", answers=20, mode="joint", script="teleop-once",
        comm_timeout_s=0.1,
    )  # fmt: skip
    assert not saw["last"]["rapid_running"]
    # CommTimeout plus the ramp time, at 4.032 ms per cycle.
    assert 21 + 0.5 / 0.004032 < saw["count"] < 21 + 0.75 / 0.004032
    assert [event.code for event in peer.core.events] == [41822, 10125]
