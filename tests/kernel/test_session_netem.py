"""A whole session over a loopback interface on which the kernel emulates a bad network."""

from __future__ import annotations

import copy
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cardan.demos.examples import free_ports
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.subprocesses import cardan_subprocess
from cardan.gateway.session.supervisor import supervise

HAND = """
    0.2  axes 0 0 0.2 0 0 0 over 0.1
    0.3  neutral over 0.1
    1.0  press first
    1.2  swing 0.6 0 0 0 0 0 over 2
    1.2  swing 0 0 0 0 0 0.4 over 2
    3.4  release first
    3.6  loop
"""
ENOUGH_M = 0.04
PROGRAM = """
    0 movej
    0 on-error restart 2
    0 getid
    0 setup timeout=1
    0 act window=1e-9 max-speed=180
    0 run cond-time=1e6
"""
PERIOD_S = 0.032
"""An eighth of the usual rate: two emulated processors run the simulated device, the robot and the
session, and are 20 to 45 times as slow as real ones."""

SPEED_M_S = 0.1
SECONDS = 75.0
READY_WITHIN_S = 80.0
"""Imports take long in the emulator."""


@pytest.fixture
def loopback(modules: Callable[..., None]) -> Iterator[Callable[..., None]]:
    """Set the netem options for all packets from now on."""
    modules("sch_netem")

    def shape(*words: str) -> None:
        tc("replace", "dev", "lo", "root", "netem", "limit", "10000", *words)

    yield shape
    subprocess.run(["tc", "qdisc", "del", "dev", "lo", "root"], timeout=30, capture_output=True)


def tc(*words: str) -> None:
    subprocess.run(["tc", "qdisc", *words], check=True, timeout=30)


@pytest.mark.timeout(280)
@pytest.mark.judged(
    device="GoFa", transport="EGM with delay and loss", by="Linux kernel 6.1: netem"
)
def test_a_session_moves_through_delay_and_loss_and_brakes_when_all_is_lost(
    loopback, tmp_path: Path
):
    hand, program = tmp_path / "hand.txt", tmp_path / "program.txt"
    hand.write_text(HAND)
    program.write_text(PROGRAM)
    hid = str(tmp_path / "puck")
    port = free_ports()
    config = parse_config(
        {
            "device": {"driver": "spacemouse", "transport": "socket", "path": hid},
            "robot": {"driver": "abb_egm", "listen_port": port, "silence_s": 0.5},
            "mapping": {"deadman": "left", "linear_speed_m_s": SPEED_M_S},
        }
    )
    bad: list[Snapshot] = []
    dead: list[Snapshot] = []
    again: list[Snapshot] = []
    shown = [bad]

    def show(snapshot: Snapshot) -> None:
        shown[-1].append(copy.deepcopy(snapshot))
        if (
            len(shown) == 1
            and snapshot.tracking.path_m > ENOUGH_M
            and snapshot.arm.phase == "moving"
        ):
            loopback("loss", "100%")
            shown.append(dead)
            dead_since.append(time.monotonic())
        elif len(shown) == 2 and time.monotonic() > dead_since[0] + 4.0:
            loopback("delay", "20ms", "5ms", "loss", "2%")
            shown.append(again)

    dead_since: list[float] = []

    def go_on() -> bool:
        return not any(snapshot.arm.phase == "moving" for snapshot in again)

    loopback("delay", "20ms", "5ms", "loss", "2%")
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
        outcome = supervise(config, SECONDS, show, go_on)

    assert dead, f"it never moved enough: {outcome.last.diagnosis}\n{story(bad)}"
    # Delayed by 40 to 50 ms in each direction, out of order, with one datagram in 25 lost: the arm
    # moves.
    assert fastest(bad) < 1.1 * SPEED_M_S, story(bad)
    # No packet arrives any more: the session reports it, and the command is at rest.
    lost = [snapshot for snapshot in dead if snapshot.robot.link == "lost"]
    assert lost, dead[-1]
    assert lost[-1].robot.hold_reason
    assert lost[-1].arm.phase == "no robot"
    assert not any(lost[-1].arm.twist)
    assert len({tuple(snapshot.arm.reference) for snapshot in lost[-5:]}) == 1
    # The link is restored: no step in the commands, and motion only after a new grip.
    assert again
    assert fastest(again) < 1.1 * SPEED_M_S, story(again)
    assert any("silent" in snapshot.arm.message for snapshot in (*dead, *again)), story(
        dead + again
    )


def fastest(snapshots: list[Snapshot]) -> float:
    """Highest commanded speed along one axis, m/s."""
    return max(abs(speed) for snapshot in snapshots for speed in snapshot.arm.twist[:3])


def story(snapshots: list[Snapshot]) -> str:
    """Return the changes between consecutive snapshots."""
    lines = []
    for s in snapshots:
        words = (
            f"{s.arm.phase} ({s.arm.message}), robot {s.robot.link} ({s.robot.hold_reason}), hand "
        )
        words += f"{s.device.link} ({s.device.reason}), trips {s.arm.trips}"
        words = re.sub(r"[\d.]+ s", "... s", words)
        if not lines or not lines[-1].endswith(words):
            lines.append(f"{s.elapsed_s:5.1f} s {words}")
    return "\n".join(lines)
