"""Whole commands that get an ending signal, or whose output is not read or fails: the arm brakes,
and the process exits soon, with at most one line."""

import contextlib
import json
import os
import pty
import selectors
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pytest

from bench.killed import REST_M_S, ROBOTS, WINDOW_S, Watch, driven
from cardan.common.signals import signal_name
from tests.programs import Program
from tests.test_cli import ENVIRONMENT, EXAMPLES
from tests.waiting import STOOD_STILL, WITHIN_S, until

pytestmark = pytest.mark.matrix  # Whole programs; all bounds are generous.

ROBOT = "GP8, MotoROS velocity"
"""This robot stops as soon as it is commanded to."""
SPEED_M_S = 0.1

SIGNALS = [signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM]


def toml(tables):
    lines = []
    for name, table in tables.items():
        lines.append(f"[{name}]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    return "\n".join(lines) + "\n"


class Moving:
    """Served robot, and the configuration of a session that moves it."""

    def __init__(self, robot, file):
        self.file = file
        self._joints = robot.joints
        self._watch = Watch(ROBOTS[ROBOT].arm, robot.joints)

    def wait_until_moving(self, said=lambda: b""):
        try:
            self._watch.until(lambda found: found > 0.8 * SPEED_M_S, 0.2)
        except TimeoutError as error:
            raise AssertionError(said()[-4000:].decode(errors="replace")) from error

    def wait_until_at_rest(self):
        # Longer than the script's own pauses.
        self._watch.until(lambda found: found < REST_M_S, 1.2)

    @property
    def rests(self):
        """Return whether the TCP is at rest."""
        watch = Watch(ROBOTS[ROBOT].arm, self._joints)
        began_s = time.monotonic()
        while time.monotonic() < began_s + WINDOW_S:
            speed = watch.sample()
        return speed < REST_M_S


@pytest.fixture
def moving(tmp_path):
    with driven(ROBOT, SPEED_M_S, tmp_path) as (robot, tables):
        file = tmp_path / "session.toml"
        file.write_text(toml(tables))
        yield Moving(robot, file)


def session_of(program):
    """Return the process id of a session whose supervisor is verbose."""
    return int(program.wait_for(r"the session is process (\d+)", "stderr")[1])


def assert_it_braked(program, code):
    # After a pause of the computer at the end, the device is too old, which sets the exit code.
    paused = STOOD_STILL in program.out + program.err
    assert code in ((0, 4) if paused else (0,)), program.out + program.err
    assert "stopped on request" in program.out
    assert "Traceback" not in program.err
    assert "ended with status 0" in program.err


# -- signals --------------------------------------------------------------------------------------


@pytest.mark.real("SIGHUP")
@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGQUIT], ids=signal_name)
def test_a_signal_to_the_command_brakes_the_arm(moving, number):
    with Program("run", "-v", moving.file) as program:
        moving.wait_until_moving(lambda: program.said["stderr"])
        assert_it_braked(program, program.end(number))
        assert f"ending on {signal_name(number)}" in program.err
        assert moving.rests


@pytest.mark.real("SIGHUP")
@pytest.mark.parametrize(
    "number", [signal.SIGHUP, signal.SIGUSR1, signal.SIGALRM, signal.SIGINT], ids=signal_name
)
def test_a_signal_to_the_session_itself_brakes_the_arm(moving, number):
    with Program("run", "-v", moving.file) as program:
        moving.wait_until_moving(lambda: program.said["stderr"])
        os.kill(session_of(program), number)
        assert_it_braked(program, program.end())
        assert moving.rests


def test_a_login_session_that_ends_tells_all_its_processes_twice(moving):
    with Program("run", "-v", moving.file) as program:
        moving.wait_until_moving(lambda: program.said["stderr"])
        session = session_of(program)
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGTERM):
            program.process.send_signal(number)
            os.kill(session, number)
        assert_it_braked(program, program.end())


def test_signals_do_not_break_the_stop_that_is_under_way(moving):
    with Program("run", "-v", moving.file) as program:
        moving.wait_until_moving(lambda: program.said["stderr"])
        session = session_of(program)
        while program.process.poll() is None:
            for number in SIGNALS:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(session, number)
            program.process.send_signal(signal.SIGINT)
            program.process.send_signal(signal.SIGTERM)
            if "stopped on request" in program.out:
                break
            threading.Event().wait(0.005)
        program.end()
        assert "ended with status 0" in program.err
        assert moving.rests


def test_a_signal_before_the_session_has_begun_is_no_fault(moving):
    with Program("run", "-v", moving.file) as program:
        os.kill(session_of(program), signal.SIGHUP)
        code = program.end()
        assert "only its controller stops" not in program.err
        assert code == 0, program.err


SERVING = {
    "sim": ("sim", "spacemouse", "--hid", "{folder}/hid"),
    "spnav": ("devices", "spnav", "--socket", "{folder}/spnav.sock"),
    "arm": ("sim", "arm", "--listen", "127.0.0.1:0"),
}


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("sim", signal.SIGHUP),
        ("sim", signal.SIGQUIT),
        ("arm", signal.SIGALRM),
        ("arm", signal.SIGUSR1),
        ("spnav", signal.SIGHUP),
        ("spnav", signal.SIGUSR2),
    ],
)
def test_what_serves_ends_in_good_order(tmp_path, name, number):
    words = [word.format(folder=tmp_path) for word in SERVING[name]]
    with Program(*words) as program:
        program.wait_for("READY ")
        assert program.end(number) == 0, program.err
        assert "Traceback" not in program.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.real("SIGHUP")
@pytest.mark.parametrize("number", [signal.SIGQUIT, signal.SIGHUP], ids=signal_name)
def test_a_demo_that_is_asked_to_end_leaves_nothing_behind(number):
    # tmp_path may be too long for a socket.
    with tempfile.TemporaryDirectory(prefix="cardan-test-") as folder:
        program = subprocess.Popen(
            [sys.executable, "-m", "cardan", "demo", "gofa", "-v"],
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
            env={**ENVIRONMENT, "TMPDIR": folder},
        )
        with program:
            said = []
            for line in program.stderr:
                said.append(line)
                if "the session is process" in line:
                    break
            program.send_signal(number)
            rest = program.stderr.read()
            assert program.wait(WITHIN_S) == 0, "".join(said) + rest
        assert os.listdir(folder) == []


# -- output that is not read ----------------------------------------------------------------------


@contextlib.contextmanager
def unread(kind):
    """Yield a file descriptor to read from, which is not read, and one to write to."""
    reading, writing = pty.openpty() if kind == "terminal" else os.pipe()
    try:
        yield reading, writing
    finally:
        os.close(writing)
        os.close(reading)


def fill(fd):
    """Fill a pipe while other processes may write to it."""
    own = os.open(f"/proc/self/fd/{fd}", os.O_WRONLY | os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(own, b"x" * 4096)
    os.close(own)


class Reader:
    """Reader in a thread that can be paused."""

    def __init__(self, fd):
        self.found = b""
        self._fd = fd
        self._reads, self._ended = threading.Event(), threading.Event()
        self._rests = threading.Event()
        self._reads.set()
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self):
        with selectors.DefaultSelector() as selector:
            selector.register(self._fd, selectors.EVENT_READ)
            while not self._ended.is_set():
                if not self._reads.is_set():
                    self._rests.set()
                    self._reads.wait()
                elif selector.select(0.05):
                    self.found += os.read(self._fd, 1 << 16)

    def stop(self):
        self._rests.clear()
        self._reads.clear()
        assert self._rests.wait(WITHIN_S)

    def go_on(self):
        self._reads.set()

    def __enter__(self):
        return self

    def __exit__(self, *_exception):
        self._ended.set()
        self._reads.set()
        self._thread.join()


@pytest.mark.real("terminal-SIGINT")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=signal_name)
@pytest.mark.parametrize("kind", ["terminal", "pipe"])
def test_a_session_that_nobody_sees_holds_and_ends_when_reported(moving, kind, number):
    with (
        unread(kind) as (reading, writing),
        Reader(reading) as reader,
        Program("run", moving.file, stdout=writing, stderr=writing) as program,
    ):
        moving.wait_until_moving(lambda: reader.found)
        reader.stop()
        if kind == "pipe":
            fill(writing)  # a terminal fills soon
        moving.wait_until_at_rest()
        assert program.process.poll() is None
        assert program.end(number, number) == 0


def test_a_session_that_is_seen_again_says_why_it_held(moving):
    with (
        unread("terminal") as (reading, writing),
        Reader(reading) as reader,
        Program("run", moving.file, stdout=writing, stderr=writing) as program,
    ):
        moving.wait_until_moving(lambda: reader.found)
        reader.stop()
        moving.wait_until_at_rest()
        reader.go_on()
        # A narrow terminal may break the line anywhere.
        until(lambda: b"output" in reader.found, "the reason")
        assert program.end(signal.SIGINT) == 0


def waits_to_write(pid: int) -> bool:
    """Return whether a thread is blocked on writing to a pipe; libraries have their own threads."""
    tasks = list(Path(f"/proc/{pid}/task").iterdir())
    waits = [(task / "wchan").read_text() for task in tasks]
    if not any(wait.strip("0") for wait in waits):  # the kernel hides it
        return len(tasks) > 1
    return any("pipe_write" in wait for wait in waits)


@pytest.mark.parametrize(
    "words",
    [
        ("devices", "drivers"),
        ("devices",),
        ("check", EXAMPLES / "spacemouse-gofa.toml"),
        ("sim", "--list"),
        ("devices", "udev"),
    ],
    ids=lambda words: words[0],
)
def test_a_command_waits_for_its_reader_and_can_be_reported_not_to(words):
    with unread("pipe") as (_, writing):
        fill(writing)
        with Program(*words, stdout=writing) as program:
            until(lambda: waits_to_write(program.process.pid), "the thread that writes")
            assert program.end(signal.SIGINT) == 128 + signal.SIGINT
            assert program.err == ""


@pytest.mark.parametrize("kind", ["terminal", "pipe"])
@pytest.mark.parametrize("name", ["sim", "spnav"])
def test_what_serves_does_so_with_each_reader(tmp_path, name, kind):
    words = [word.format(folder=tmp_path) for word in SERVING[name]]
    with (
        unread(kind) as (_, writing),
        Program(*words, stdout=writing, stderr=writing) as program,
    ):
        until(lambda: list(tmp_path.iterdir()), "the socket")
        assert program.end(signal.SIGINT) == 0


def test_a_hand_at_a_terminal_that_is_not_read(tmp_path):
    hid = tmp_path / "hid"
    with (
        unread("terminal") as (reading, writing),
        Program(
            *("sim", "spacemouse", "--hid", hid, "--keyboard"),
            stdin=writing,
            stdout=writing,
            stderr=writing,
        ) as program,
    ):
        with selectors.DefaultSelector() as selector:
            selector.register(reading, selectors.EVENT_READ)
            assert selector.select(WITHIN_S)
        for _ in range(40):  # each key changes the display
            os.write(reading, b"wsad")
            threading.Event().wait(0.02)
        assert program.end(signal.SIGINT) == 0


# -- output that fails ----------------------------------------------------------------------------

FULL = "cardan: standard output cannot be written: No space left on device\n"


@pytest.mark.real("full-run")
@pytest.mark.parametrize(
    "words",
    [
        ("devices", "drivers"),
        ("devices",),
        ("check", EXAMPLES / "spacemouse-gofa.toml"),
        ("sim", "--list"),
        ("--help",),
        ("--version",),
        ("run", EXAMPLES / "verbs-ur5-simulated.toml", "--seconds", "3"),
        ("sim", "spacemouse", "--hid", "hid", "--seconds", "0.2"),
    ],
    ids=lambda words: words[0],
)
@pytest.mark.parametrize("stderr", ["read", "full"])
def test_a_full_disk_is_said_in_one_line(tmp_path, words, stderr):
    with open("/dev/full", "wb") as full:
        options = {"stdout": full, "cwd": tmp_path}
        if stderr == "full":
            options["stderr"] = full
        with Program(*words, **options) as program:
            assert program.end() == 1
            assert program.err == (FULL if stderr == "read" else "")


def test_a_session_whose_output_fails_brakes_the_arm(moving):
    with open("/dev/full", "wb") as full, Program("run", "-v", moving.file, stdout=full) as program:
        assert program.end() == 1
        assert "ended with status 0" in program.err
        assert program.err.endswith(FULL)


@pytest.mark.parametrize(
    "words",
    [
        ("devices", "drivers"),
        ("check", EXAMPLES / "spacemouse-gofa.toml"),
        ("--help",),
        ("run", EXAMPLES / "verbs-ur5-simulated.toml"),
    ],
    ids=lambda words: words[0],
)
def test_a_reader_that_has_gone_is_no_news(words):
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "wb", buffering=0) as gone, Program(*words, stdout=gone) as program:
        assert program.end() == 1
        assert program.err == ""


def test_closed_streams_are_no_robot_s_sockets():
    closed = ("sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", sys.executable, "-m", "cardan")
    example = EXAMPLES / "verbs-ur5-simulated.toml"
    done = subprocess.run([*closed, "run", str(example), "--seconds", "1"], timeout=WITHIN_S)
    assert done.returncode == 0


# -- logs -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words", [("run",), ("demo",), ("devices", "spnav"), ("devices", "force"), ("sim", "arm")]
)
def test_every_command_that_runs_on_says_how_much_it_logs(words):
    with Program(*words, "--help") as program:
        assert program.end() == 0
        assert "--verbose" in program.out
        assert "--log-level" in program.out


def test_a_session_is_silent_unless_reported():
    words = ("run", EXAMPLES / "verbs-ur5-simulated.toml", "--seconds", "1")
    with Program(*words) as program:
        assert program.end() == 0
        assert program.err == ""
    with Program(*words, "--log-level", "info") as program:
        assert program.end() == 0
        assert "supervisor: robot: live" in program.err
    with Program(*words, "-v", "--log-level", "info") as program:
        assert program.end() == 2
        assert program.err == "cardan: --verbose, --log-level: give one of them\n"
