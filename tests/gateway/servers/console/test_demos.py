"""A page starts and ends demos on the server's computer."""

from __future__ import annotations

import os
import sys

import pytest

pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")

from cardan.common.realtime import SCHEDULING_VARIABLE, ask_for_real_time
from tests.gateway.servers.console.bench import OPERATOR, VIEWER, page_program
from tests.waiting import until

pytestmark = pytest.mark.matrix


LISTING = """
print('[{"demo": "gofa", "what_is_joined": "a mouse -> an arm"}]')
"""
DEMO = """
import os, signal, sys
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
print("begun", *sys.argv[1:], os.environ["CARDAN_SCHEDULING"], flush=True)
print("x" * 100_000, flush=True)
signal.sigwait([signal.SIGTERM])
print("ended", flush=True)
"""


@pytest.fixture
def running(with_tokens):
    demos = with_tokens.server._demos
    demos._listing = [sys.executable, "-c", LISTING]
    demos._command = [sys.executable, "-c", DEMO]
    return with_tokens


def asked(page, do, **more):
    page.ask("cardan.demo", id=do, do=do, **more)
    return page.next("cardan.demo", id=do)


def refused(page, **fields):
    page.ask("cardan.demo", id="no", **fields)
    return page.next("cardan.refused", id="no")["why"]


def test_a_demo_is_started_watched_and_ended(running):
    with page_program(running, f"/ws?t={OPERATOR}") as page:
        page.begin()
        table = asked(page, "list")
        assert table["demos"] == [{"name": "gofa", "what": "a mouse -> an arm"}]
        assert not table["running"]
        assert "no demo" in refused(page, do="stop")
        assert "no demo" in refused(page, do="start", name="--help")
        assert asked(page, "start", name="gofa")["running"]
        until(lambda: asked(page, "list")["said"], "it says something")
        assert asked(page, "list")["said"][0] == "begun demo gofa --seconds 60 ordinary"
        assert "runs; end it first" in refused(page, do="start", name="gofa")
        table = asked(page, "stop")
        assert not table["running"]
        assert table["said"][-1] == "ended"
        asked(page, "start", name="gofa")
        process = running.server._demos._running
    running.loop.call_soon_threadsafe(running.ended.set)
    until(lambda: process.code is not None, "it ends with the server")


def test_a_viewer_starts_nothing(running):
    with page_program(running, f"/ws?t={VIEWER}") as page:
        assert "viewer" in refused(page, do="start", name="gofa")
        assert "allowed: list, start, stop" in refused(page, do="run")


def test_a_demo_does_not_run_before_sessions(monkeypatch):
    monkeypatch.setenv(SCHEDULING_VARIABLE, "ordinary")
    before = os.getpriority(os.PRIO_PROCESS, 0)
    assert ask_for_real_time() == "ordinary"
    assert os.getpriority(os.PRIO_PROCESS, 0) == before
