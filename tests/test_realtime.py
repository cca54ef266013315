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
