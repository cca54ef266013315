"""Supervision of a session's process by the daemon; no process is started."""

from __future__ import annotations

import threading
import time

from cardan.gateway.daemon import processes
from cardan.gateway.daemon.processes import RunningSession
from cardan.gateway.daemon.systemd_watchdog import HUNG_S, STARTS_WITHIN_S
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import SessionExit
from tests.waiting import WITHIN_S


class Starting:
    """A session's process that reports and ends when the test allows it."""

    def __init__(self, *_configuration, **_options):
        self.may_tell, self.may_end = threading.Event(), threading.Event()
        self.reported = threading.Event()

    def follow(self, take):
        assert self.may_tell.wait(WITHIN_S)
        last = take(Snapshot.of({"arm": {"phase": "disarmed"}}).to_bytes())
        self.reported.set()
        assert self.may_end.wait(WITHIN_S)
        return SessionExit(0, last)


def test_a_session_has_longer_for_its_first_snapshot(monkeypatch):
    monkeypatch.setattr(processes, "SessionProcess", Starting)
    before_s = time.monotonic()
    session = RunningSession(None, print, lambda *_: None, print)
    assert before_s <= session.due_s - STARTS_WITHIN_S <= time.monotonic()
    session._process.may_tell.set()
    assert session._process.reported.wait(WITHIN_S)
    assert before_s <= session.due_s - HUNG_S <= time.monotonic()
    session._process.may_end.set()
    session.join(WITHIN_S)
