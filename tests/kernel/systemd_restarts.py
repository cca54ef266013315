"""The service under systemd as the computer's first process: reloads, and all ways in which a
process dies.

These tests take minutes in the emulator: `make test-systemd`.
"""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from cardan.gateway.daemon.service import NAME, WATCHDOG_S
from tests.kernel.systemd_lab import (
    Lab,
    computer as computer,
    hardware as hardware,
    journal,
    lab as lab,
    systemds_words,
    wait,
    write_layout,
)

pytestmark = pytest.mark.timeout(600)


def test_reload(lab, hardware):
    write_layout(hardware, 0.05)
    lab.systemctl("reload", NAME)
    reported = wait(lambda: journal(NAME, "CARDAN_EVENT=reload"))
    assert "gofa mapping" in reported[-1]["CARDAN_WHAT"]
    wait(lambda: lab.shows("SubState") == "running")
    pid = lab.pid
    Path(hardware).write_text("[[sessions]]\nname = 1\n")
    lab.systemctl("reload", NAME)
    (refused,) = wait(lambda: journal(NAME, "CARDAN_EVENT=reload refused"))
    assert "nothing was changed" in refused["CARDAN_WHAT"]
    assert refused["PRIORITY"] == "4"  # a warning: the old configuration stays in effect
    wait(lambda: (lab.shows("SubState"), lab.pid) == ("running", pid))
    write_layout(hardware, 0.05)
    lab.until("moving")


def comes_back(lab: Lab, before: int, restarts: int) -> None:
    """Check that the daemon is a new process, and that its session's arm is disarmed until the
    dead-man's switch is pressed again."""
    wait(lambda: lab.pid not in (0, before))
    assert int(lab.shows("NRestarts")) == restarts
    lab.until("moving")
    phases = [each["what"] for each in lab.ask("events", "gofa") if each["event"] == "arm"]
    assert phases[:1] == ["disarmed"] or phases[:2] == ["no robot", "disarmed"]


def test_a_daemon_that_is_killed_is_started_anew_and_its_sessions_had_time_to_brake(lab):
    session, before = lab.until("moving")["pid"], lab.pid
    os.kill(before, signal.SIGKILL)
    comes_back(lab, before, 1)
    assert not Path(f"/proc/{session}").exists()
    # systemd would log here that it had to kill the session
    words = systemds_words()
    assert "Main process exited, code=killed, status=9/KILL" in words
    assert "with signal SIGKILL" not in words


def test_a_daemon_that_hangs_is_started_anew(lab):
    lab.until("moving")
    before = lab.pid
    os.kill(before, signal.SIGSTOP)
    comes_back(lab, before, 2)
    assert f"Watchdog timeout (limit {WATCHDOG_S}s)!" in systemds_words()


def test_a_session_that_hangs_starves_the_watchdog(lab):
    row, before = lab.until("moving"), lab.pid
    os.kill(row["pid"], signal.SIGSTOP)
    comes_back(lab, before, 3)
    assert not Path(f"/proc/{row['pid']}").exists()
