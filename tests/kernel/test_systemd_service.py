"""The service under systemd as the computer's first process: start, operation and end."""

from __future__ import annotations

import re
import stat
from pathlib import Path

import pytest

from cardan.gateway.daemon.client import SYSTEM_SOCKET
from cardan.gateway.daemon.service import NAME
from tests.kernel.systemd_lab import (
    LAB_ID,
    computer as computer,
    hardware as hardware,
    journal,
    lab as lab,
    run,
    wait,
)

pytestmark = pytest.mark.timeout(600)


def test_it_serves_once_it_says_so_as_the_user_it_was_given(lab):
    assert lab.shows("ActiveState") == "active"  # `systemctl enable --now` waits for READY=1.
    assert Path(SYSTEM_SOCKET).stat().st_uid == LAB_ID
    uid = re.search(r"^Uid:\t(\d+)", Path(f"/proc/{lab.pid}/status").read_text(), re.MULTILINE)
    assert int(uid[1]) == LAB_ID


def test_a_device_comes_through_the_hardening_and_moves_the_arm(lab):
    row = lab.until("moving")
    assert (row["device_link"], row["robot_link"]) == ("live", "live")
    wait(lambda: lab.shows("StatusText") == "1 running")


def test_the_journal_has_its_fields(lab):
    lab.until("moving")
    found = wait(lambda: journal(NAME, "CARDAN_NAME=gofa", "CARDAN_EVENT=arm"))
    assert {"disarmed", "moving"} <= {each["CARDAN_WHAT"] for each in found}
    assert {each["SYSLOG_IDENTIFIER"] for each in found} == {"cardan"}
    stored = Path("/var/lib/cardan/events.jsonl")
    assert '"event":"arm"' in stored.read_text()
    assert stat.S_IMODE(stored.stat().st_mode) == 0o600


def test_how_much_is_exposed(lab, capsys):
    """systemd's own measure, 0 to 10, of the rights that the service has beyond its needs."""
    reported = run("systemd-analyze", "security", "--no-pager", NAME)
    (score,) = re.findall(r"Overall exposure level for \S+: ([0-9.]+)", reported)
    with capsys.disabled():
        print(f"\nsystemd-analyze security {NAME}: {score}")
    assert float(score) < 5.0


def test_it_ends_in_good_order(lab):
    lab.until("moving")
    session = lab.row()["pid"]
    lab.systemctl("stop", NAME)
    assert lab.shows("Result") == "success"
    assert not Path(f"/proc/{session}").exists()
