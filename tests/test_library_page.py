"""Every program of docs/library.md runs with the simulated peers that the page starts."""

import os
import re
import shlex
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.serving import free_udp_port, served

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "library.md").read_text(encoding="utf-8")
PROGRAMS = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
PEERS = re.findall(r"^cardan sim (.*)$", PAGE, re.MULTILINE)
PORT, SOCKET = "6510", "spacemouse.sock"


def needed(program):
    """Return the page's commands that a program needs."""
    serves_itself = "sim_peers" in program
    return [
        peer
        for peer in PEERS
        if not serves_itself and any(word in peer and word in program for word in (PORT, SOCKET))
    ]


@pytest.mark.matrix
@pytest.mark.parametrize("program", PROGRAMS, ids=range(len(PROGRAMS)))
def test_the_programs_run(program, tmp_path):
    port = free_udp_port()

    def at_home(text):
        return text.replace(PORT, str(port)).replace(SOCKET, str(tmp_path / SOCKET))

    with ExitStack() as stack:
        for peer in needed(program):
            stack.enter_context(served("sim", *shlex.split(at_home(peer))))
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", at_home(program)],
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            timeout=50,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert done.stdout or "print" not in program or "cardan.devices()" in program


def test_the_page_has_programs_and_they_are_short():
    assert len(PROGRAMS) > 10
    assert max(len(program.splitlines()) for program in PROGRAMS) <= 9
    assert all(needed(program) for program in PROGRAMS if SOCKET in program)
