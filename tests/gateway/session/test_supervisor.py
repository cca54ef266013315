"""A session in a separate process: start, reports, stop, and detection of its death."""

import dataclasses
import errno
import logging
import os
import signal
import threading

import pytest

from cardan.common.logs import LogFormat
from cardan.common.tables import as_table
from cardan.errors import ConfigurationError
from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.session import supervisor
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import SessionProcess, supervise

pytestmark = pytest.mark.matrix


@pytest.fixture
def waiting(tmp_path):
    """A session that waits for its device and its robot."""
    return parse_config(
        {
            "device": {
                "driver": "spacemouse",
                "transport": "socket",
                "path": str(tmp_path / "hid"),
                "wait_for_device": True,
            },
            "robot": {"driver": "abb_egm", "listen_port": 0},
        }
    )


def test_runs_for_the_time_it_is_given(waiting):
    seen = []
    outcome = supervise(waiting, 0.5, seen.append)
    assert outcome.exit_code == 0
    assert outcome.last.finished
    assert outcome.last.robot.link == "waiting"
    assert len(seen) >= 3
    assert seen[-1] == outcome.last


def test_a_command_around_it_has_its_signals_and_its_code(waiting):
    outcome = supervise(waiting, 0.5, through=("env", "CARDAN_PROOF=1"))
    assert (outcome.exit_code, outcome.last.robot.link) == (0, "waiting")
    # A command that exits like a shell, with 128 plus the signal's number.
    shell = ("sh", "-c", "trap 'kill $!; exit 143' TERM; sleep 20 & wait", "sh")
    outcome = supervise(waiting, 30.0, poll=lambda: False, through=shell)
    assert (outcome.exit_code, outcome.last.arm.message) == (0, "stopped before it began")


def test_what_only_code_sets_reaches_the_session(waiting, monkeypatch):
    sent = []
    monkeypatch.setattr(supervisor.json, "dumps", lambda table: sent.append(table) or "{}")
    watchdogs = Watchdogs(heartbeat_s=0.2, stall_s=0.05, following_error_joint=0.1)
    changed = dataclasses.replace(waiting, watchdogs=watchdogs)
    supervise(changed, 0.5)
    assert parse_config(sent[0], from_file=False) == changed
    with pytest.raises(ConfigurationError, match=r"watchdogs.*there is no such key"):
        parse_config(sent[0])


def test_poll_stops_it_even_before_it_has_begun(waiting):
    outcome = supervise(waiting, 30.0, poll=lambda: False)
    assert outcome.exit_code == 0
    assert outcome.last.arm.message == "stopped before it began"


@pytest.mark.real
def test_an_interrupt_stops_it(waiting):
    outcome = supervise(waiting, 30.0, lambda _snapshot: os.kill(os.getpid(), signal.SIGINT))
    assert outcome.exit_code == 0
    assert outcome.last.arm.message == "stopped on request"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def signal_session(number):
    """Send a signal to the session's process, a child of this one."""
    pid = os.getpid()
    with open(f"/proc/{pid}/task/{pid}/children", encoding="ascii") as file:
        children = file.read().split()
    for child in children:
        with open(f"/proc/{child}/cmdline", encoding="utf-8") as file:
            if "cardan.gateway.session.session" in file.read():
                os.kill(int(child), number)


@pytest.mark.real
def test_a_session_that_dies_is_an_error(waiting):
    outcome = supervise(waiting, 30.0, lambda _snapshot: signal_session(signal.SIGKILL))
    assert outcome.exit_code == 1
    assert "ended with status -9" in outcome.last.error


@pytest.mark.real
def test_a_session_that_does_not_react_is_ended_by_force(waiting, monkeypatch):
    monkeypatch.setattr(supervisor, "KILL_AFTER_S", 0.3)
    seen = []

    def hang(snapshot):
        seen.append(snapshot)
        signal_session(signal.SIGSTOP)

    outcome = supervise(waiting, 30.0, hang, lambda: not seen)
    assert outcome.exit_code == 1
    assert "ended with status -9" in outcome.last.error


def test_a_session_that_cannot_open_says_why(waiting):
    table = as_table(waiting)
    table["robot"]["listen_host"] = "192.0.2.1"
    seen = []
    outcome = supervise(parse_config(table), 30.0, seen.append)
    assert outcome.exit_code == 3
    assert "192.0.2.1" in outcome.last.error


def test_a_configuration_that_only_the_open_device_can_judge(waiting):
    table = as_table(waiting)
    table["device"]["model"] = "spacenavigator"
    table["mapping"]["deadman"] = "menu"
    outcome = supervise(parse_config(table), 30.0)
    assert outcome.exit_code == 2
    assert "mapping.deadman" in outcome.last.error
    assert "left" in outcome.last.error


def test_a_view_that_fails_does_not_cost_the_braking_ramp(waiting):
    def fail(_snapshot):
        raise BrokenPipeError("nobody reads")

    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(BrokenPipeError):
        supervise(waiting, 30.0, fail)
    assert signal.getsignal(signal.SIGTERM) is before
    pid = os.getpid()
    with open(f"/proc/{pid}/task/{pid}/children", encoding="ascii") as file:
        assert file.read().split() == []


WORDY = ("sh", "-c", 'echo a word; echo another >&2; exec "$@"', "sh")
"""A command around a session that writes lines of its own."""


def test_what_a_session_s_process_says_is_passed_on(waiting):
    said = []
    process = SessionProcess(waiting, 0.2, WORDY, said.append)
    assert process.follow(Snapshot.from_bytes).exit_code == 0
    assert b"".join(said) == b"a word\nanother\n"


def test_a_session_logs_in_the_form_that_it_is_reported(waiting):
    said = []
    through = ("sh", "-c", 'echo "$@"; exec "$@"', "sh")
    process = SessionProcess(waiting, 0.2, through, said.append, log_format=LogFormat.PRIORITY)
    assert process.follow(Snapshot.from_bytes).exit_code == 0
    assert b"--log-format=priority" in b"".join(said)


def test_nobody_waits_for_whom_a_session_s_words_hold_up(waiting):
    held, go_on = threading.Event(), threading.Event()

    def say(_data):
        held.set()
        go_on.wait()

    process = SessionProcess(waiting, 0.2, WORDY, say)
    outcome = process.follow(Snapshot.from_bytes)
    assert held.is_set()
    go_on.set()
    assert (outcome.exit_code, outcome.last.finished) == (0, True)


def test_a_session_that_cannot_be_started_leaves_nothing_open(waiting, monkeypatch):
    def none_left(*_words, **_options):
        raise OSError(errno.EMFILE, "too many open files")

    monkeypatch.setattr(supervisor.subprocess, "Popen", none_left)
    before = sorted(os.listdir("/proc/self/fd"))
    for _ in range(3):
        with pytest.raises(OSError, match="too many"):
            SessionProcess(waiting)
    assert sorted(os.listdir("/proc/self/fd")) == before


def test_what_changes_is_logged(waiting, caplog):
    with caplog.at_level(logging.INFO, "cardan.gateway.session.supervisor"):
        supervise(waiting, 0.3, lambda _snapshot: os.kill(os.getpid(), signal.SIGHUP))
    said = [record.getMessage() for record in caplog.records]
    assert "robot: waiting" in said
    assert "ending on SIGHUP" in said
    assert said.count("robot: waiting") == 1
