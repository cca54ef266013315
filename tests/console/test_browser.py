"""Control of the browser: error for a browser that does not start, and end of all of its
processes."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cardan.errors import DriverError
from tests.console.browser import chromium
from tests.waiting import until

STAYS = """
import sys
from pathlib import Path
from tests.console.browser import chromium
with chromium(sys.argv[1], Path(sys.argv[2])):
    pass
"""
"""A program that runs until it is ended, in place of a browser."""


@pytest.fixture
def program(tmp_path):
    """Write an executable script: `program(lines)` returns its path."""

    def write(lines):
        path = tmp_path / "browser"
        path.write_text(f"#!/bin/sh\n{lines}\n")
        path.chmod(0o755)
        return str(path)

    return write


def test_a_browser_that_does_not_start_is_named(tmp_path, program):
    path = program("exit 3")
    with pytest.raises(DriverError, match=r"browser ended with 3$"), chromium(path, tmp_path):
        pass


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL], ids=lambda how: how.name)
def test_a_browser_ends_with_the_program_that_started_it_however_that_ends(tmp_path, program, how):
    """Debian's browsers are started by a script, which waits for them."""
    own = tmp_path / "own"
    path = program(f"sleep 1000 &\necho $! >{own}.new\nmv {own}.new {own}\nwait")
    with subprocess.Popen(
        [sys.executable, "-c", STAYS, path, str(tmp_path)], cwd=Path(__file__).parents[2]
    ) as starter:
        until(own.exists)
        starter.send_signal(how)
    pid = int(own.read_text())
    until(lambda: not is_running(pid))


def is_running(pid):
    """True if the process runs; a zombie does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
