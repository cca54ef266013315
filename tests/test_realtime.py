"""System settings that a session requests to keep its loop on time."""

import os
import subprocess
import sys

import pytest

from cardan.common import realtime

A_SESSION = """
import io, socket, sys
from cardan.gateway.session import session

def run(self, seconds):
    print(sys.getswitchinterval())

session.Session.run = run
sys.stdin = io.StringIO('{"robot": {"driver": "abb_egm"}, "device": {"driver": "keyboard"}}')
mine, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
code = session.main([f"--channel-fd={theirs.detach()}"])
sys.stdout.flush()
sys.exit(code)
"""


def test_a_session_has_threads_that_compute_let_its_loop_go_on():
    done = subprocess.run(
        [sys.executable, "-c", A_SESSION],
        check=True, capture_output=True, text=True,
        env={**os.environ, realtime.SCHEDULING_VARIABLE: "ordinary"},
    )  # fmt: skip
    assert float(done.stdout) == pytest.approx(realtime.SWITCH_INTERVAL_S)


def open_files(path):
    return [
        each
        for each in os.listdir("/proc/self/fd")
        if os.path.realpath(f"/proc/self/fd/{each}") == str(path)
    ]


def test_processors_stay_awake_as_long_as_it_is_wanted(tmp_path, monkeypatch):
    file = tmp_path / "latency"
    file.touch()
    monkeypatch.setattr(realtime, "LATENCY_FILE", str(file))
    monkeypatch.delenv(realtime.SCHEDULING_VARIABLE, raising=False)
    for _ in range(2):
        realtime.keep_processors_awake(awake=True)
    assert len(open_files(file)) == 1
    assert file.read_bytes() == bytes(4)
    for _ in range(2):
        realtime.keep_processors_awake(awake=False)
    assert open_files(file) == []
    monkeypatch.setenv(realtime.SCHEDULING_VARIABLE, "ordinary")
    realtime.keep_processors_awake(awake=True)
    assert open_files(file) == []


def test_a_user_who_may_not_keep_processors_awake_is_not_disturbed(tmp_path, monkeypatch):
    monkeypatch.setattr(realtime, "LATENCY_FILE", str(tmp_path / "missing"))
    monkeypatch.delenv(realtime.SCHEDULING_VARIABLE, raising=False)
    realtime.keep_processors_awake(awake=True)
    realtime.keep_processors_awake(awake=False)
