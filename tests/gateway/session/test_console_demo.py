"""The console's demo: what it finds fault with, and what it does with a browser and without."""

import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from cardan.errors import ConfigurationError, DriverError
from cardan.gateway.faces.console.site import FOLDER
from cardan.gateway.session.browser import chromium, find_chromium
from cardan.gateway.session.console_demo import Person
from cardan.gateway.session.demo import EXIT_INCOMPLETE, run_demo
from cardan.gateway.session.session import EXIT_OK
from tests.waiting import until

PICTURES = {"goal", "hand", "move", "phone", "plots", "setup"}
SHOWN = "At rest. Enable motion to move it."

STAYS = """
import sys
from pathlib import Path
from cardan.gateway.session.browser import chromium
with chromium(sys.argv[1], Path(sys.argv[2])):
    pass
"""
"""A program that waits for a browser."""


def person(tmp_path, done=()):
    """One who has not begun, and who did all that is `done`."""
    made = Person("http://127.0.0.1:9/", tmp_path, lambda _line: None, threading.Event())
    made.done += done
    made._shown = SHOWN
    return made


@pytest.fixture
def program(tmp_path):
    """Writes a program, and gives its path: `program(lines)`."""

    def write(lines):
        path = tmp_path / "browser"
        path.write_text(f"#!/bin/sh\n{lines}\n")
        path.chmod(0o755)
        return str(path)

    return write


def demo(seconds, tmp_path, path, *packages):
    """What ``cardan demo console`` says, and its exit code, where programs are found by `path`, and
    Python's packages in the folders `packages` before all others."""
    words = ["demo", "console", "--seconds", str(seconds), "--pictures", str(tmp_path / "pictures")]
    done = subprocess.run(
        [sys.executable, "-m", "cardan", *words],
        capture_output=True,
        text=True,
        check=False,
        env={
            **os.environ,
            "PATH": path,
            "PYTHONPATH": os.pathsep.join((*packages, os.environ.get("PYTHONPATH", ""))),
            "STATE_DIRECTORY": str(tmp_path),
            "COLUMNS": "200",
            "NO_COLOR": "1",
        },
    )
    return done.returncode, done.stdout + done.stderr


def test_what_was_not_done_at_the_page_is_said_with_what_the_page_said(tmp_path):
    assert person(tmp_path, ["jogged", "at rest", "at the goal"]).problems() == []
    problems = person(tmp_path, ["jogged", "at rest"]).problems()
    assert problems == [f"at the page the arm was never at the goal; it says: {SHOWN}"]
    assert len(person(tmp_path).problems()) == 3


def test_a_browser_that_does_not_start_is_a_problem_of_the_demo(tmp_path, program):
    path = program("exit 3")
    with pytest.raises(DriverError, match=r"browser ended with 3$"), chromium(path, tmp_path):
        pass
    somebody = person(tmp_path)
    somebody.work(path)
    assert somebody.problems() == [f"at the page: {path} ended with 3"]


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL], ids=lambda how: how.name)
def test_a_browser_ends_with_the_program_that_started_it_however_that_ends(tmp_path, program, how):
    """Debian's are started by a script, which waits for them."""
    own = tmp_path / "own"
    path = program(f"sleep 1000 &\necho $! >{own}.new\nmv {own}.new {own}\nwait")
    with subprocess.Popen([sys.executable, "-c", STAYS, path, str(tmp_path)]) as starter:
        until(own.exists)
        starter.send_signal(how)
    pid = int(own.read_text())
    until(lambda: not is_running(pid))


def is_running(pid):
    """Whether a process runs; one that nobody has waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_pictures_are_of_the_demo_that_has_a_page():
    with pytest.raises(ConfigurationError, match=r"--pictures: gofa shows no page"):
        run_demo(5.0, "gofa", Path("pictures"))


@pytest.fixture
def page():
    """All that a demo of the page needs."""
    pytest.importorskip(
        "zenoh", reason="eclipse-zenoh is not installed: pip install cardan[console]"
    )
    if not (FOLDER / "manifest.json").exists():
        pytest.skip("the page is not built: run tools/console")


@pytest.mark.matrix
@pytest.mark.timeout(200)
def test_a_browser_moves_the_arm_by_the_page_and_pictures_of_it_are_left(page, tmp_path):
    if find_chromium() is None:
        pytest.skip("no Chromium is installed: tools/debian-packages judges")
    code, said = demo(30, tmp_path, os.environ["PATH"])
    # A machine that is busy with other work misses cycles, which is another matter.
    assert code == EXIT_OK or "cycles were missed" in said, said
    assert "X+ was held: the TCP went" in said
    assert "mm above: Reachable" in said
    assert "at the page" not in said
    assert f"pictures of the page: {tmp_path / 'pictures'}" in said
    made = {path.name: path.read_bytes() for path in (tmp_path / "pictures").iterdir()}
    assert set(made) == {f"console-{name}.png" for name in PICTURES}
    assert all(data.startswith(b"\x89PNG") for data in made.values())
    assert len(set(made.values())) == len(made)


@pytest.mark.matrix
@pytest.mark.parametrize("encrypted", [True, False], ids=["openssl", "no openssl"])
def test_without_a_browser_the_page_waits_for_a_person_and_says_where(page, tmp_path, encrypted):
    programs, packages = tmp_path / "bin", tmp_path / "packages"
    programs.mkdir()
    packages.mkdir()
    if encrypted:
        openssl = shutil.which("openssl")
        if openssl is None:
            pytest.skip("openssl is not installed (Debian package openssl)")
        (programs / "openssl").symlink_to(openssl)
    # Where this package is there it makes certificates, too.
    (packages / "cryptography.py").write_text("raise ImportError\n")
    code, said = demo(15, tmp_path, str(programs), str(packages))
    assert code == EXIT_INCOMPLETE, said
    assert "no path was commanded" in said
    assert "there is no Chromium here that could show it. Open the page: http" in said
    assert said.count("█") > 50
    assert ("certificate SHA-256" in said) is encrypted
    assert ("the page is for this computer alone" in said) is not encrypted
    assert ("#t=" in said) is encrypted
    assert not (tmp_path / "pictures").exists()
