"""`cardan sim omni`: run a program with the simulated device."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cardan.errors import ConfigurationError, DeviceNotFoundError
from cardan_omni import peer as omni
from cardan_omni.peer import OmniSettings, environment, library_path
from tests.waiting import until

pytestmark = pytest.mark.matrix

compiled = pytest.mark.skipif(not omni.available(), reason="the C parts were not compiled")
COMMAND = [sys.executable, "-m", "cardan", "sim", "omni"]
ENVIRONMENT = {**os.environ, "NO_COLOR": "1", "COLUMNS": "120"}


def cardan(*arguments, code=0):
    """Run the command to its end; return its output."""
    done = subprocess.run(
        [*COMMAND, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=50,
        env=ENVIRONMENT,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_what_it_can_be_asked_without_the_library():
    assert "comm-error" in cardan("--list-faults")
    scripts = cardan("--list-scripts")
    assert "a file has one step a line" in scripts
    assert "drawing" in scripts
    assert "stiffness KX KY KZ [over SECONDS]" in scripts


def test_it_says_how_much_it_logs():
    said = cardan("--help")
    assert "--verbose" in said
    assert "--log-level" in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "cardan sim omni -- ./program"),
        (("--model", "falcon", "true"), "it must be one of omni, touch"),
        (("--fault", "fire", "true"), "there is no fault 'fire'"),
        (("--script", "nope", "true"), "drawing"),
    ],
)
def test_wrong_words(arguments, words):
    assert words in cardan(*arguments, code=2)


@compiled
def test_a_program_that_is_not_there():
    assert "'./nothing-here' cannot be run: No such file" in cardan("--", "./nothing-here", code=2)
    with pytest.raises(ConfigurationError):
        omni.run_program(["./nothing-here"], OmniSettings())


def test_without_the_library_it_says_what_to_do(monkeypatch, tmp_path):
    monkeypatch.setattr(omni.library, "__file__", str(tmp_path / "library.py"))
    assert not omni.available()
    with pytest.raises(DeviceNotFoundError, match="apt-get install gcc libc6-dev"):
        library_path()
    with pytest.raises(DeviceNotFoundError), environment(OmniSettings()):
        pass


@compiled
def test_where_the_library_is():
    path = Path(cardan("--library").strip())
    assert path == library_path()
    assert path.is_absolute()


@compiled
def test_the_environment_of_a_program(monkeypatch):
    monkeypatch.setenv("LD_LIBRARY_PATH", "/opt/theirs")
    settings = OmniSettings(seed=3)
    with environment(settings) as variables:
        file = Path(variables["CARDAN_OMNI"])
        assert file.read_text(encoding="utf-8") == settings.text
        assert variables["CARDAN_LIBHD"] == str(library_path())
        folder, theirs = variables["LD_LIBRARY_PATH"].split(":")
        assert theirs == "/opt/theirs"
        for name in ("libHD.so", "libHD.so.3.0", "libHD.so.3.4"):
            assert Path(folder, name).samefile(library_path())
    assert not file.exists()
    assert not Path(folder).exists()
    monkeypatch.delenv("LD_LIBRARY_PATH")
    with environment(settings) as variables:
        assert ":" not in variables["LD_LIBRARY_PATH"]


@compiled
def test_the_program_gets_its_words_and_its_exit_code_is_passed_on():
    program = "import os, sys; print(sys.argv[1:], os.path.exists(os.environ['CARDAN_OMNI']))"
    reported = cardan("--seed", 3, "--", sys.executable, "-c", program, "--seed", "4", "--", "x")
    assert reported == "['--seed', '4', '--', 'x'] True\n"
    reported = cardan(sys.executable, "-c", program, "--library")
    assert reported == "['--library'] True\n"
    cardan("--", sys.executable, "-c", "raise SystemExit(7)", code=7)
    killed = "import os; os.kill(os.getpid(), 9)"
    cardan("--", sys.executable, "-c", killed, code=128 + signal.SIGKILL)


@compiled
def test_the_settings_that_the_program_gets(tmp_path):
    program = "import os; print(open(os.environ['CARDAN_OMNI']).read())"
    arguments = ("--cold", "--model", "touch", "--fault", "jitter=50@2", "--script", "inkwell")
    reported = cardan(
        *arguments, "--log", tmp_path / "truth", "--", sys.executable, "-c", program
    ).splitlines()
    for line in ("powered cold", 'model "Touch"', "fault jitter 50 2", f"log {tmp_path}/truth"):
        assert line in reported
    first = next(line for line in reported if line.startswith("waypoint"))
    assert first.split()[10] == "1"  # docked


WAITS = """
import os, signal, sys
# A handler could come in the middle of the print before it, or just before a pause.
waited = signal.SIGTERM, signal.SIGINT, signal.SIGALRM
signal.pthread_sigmask(signal.SIG_BLOCK, waited)
signal.alarm(40)
print(os.environ["CARDAN_OMNI"], flush=True)
print("told", int(signal.sigwait(waited)), flush=True)
sys.exit(5)
"""


@compiled
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_go_on_to_the_program(number):
    # In a new session no terminal sends the signal to the program itself.
    with subprocess.Popen(
        [*COMMAND, "--", sys.executable, "-c", WAITS],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        file = Path(process.stdout.readline().strip())
        assert file.exists()
        process.send_signal(number)
        said, complaints = process.communicate(timeout=30)
    assert said == f"told {int(number)}\n"
    assert complaints == ""
    assert process.returncode == 5
    assert not file.exists()


@pytest.mark.real
@compiled
def test_a_killed_command_leaves_neither_the_program_nor_a_folder():
    with subprocess.Popen(
        [*COMMAND, "--", sys.executable, "-c", WAITS],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        folder = Path(process.stdout.readline().strip()).parent
        assert folder.is_dir()
        process.kill()
        # The end of the output is the end of the program, which has received the signal.
        assert process.stdout.read() == "told 15\n"
    until(lambda: not folder.exists(), "the folder's removal")


@compiled
def test_an_ended_guard_does_no_harm(monkeypatch):
    monkeypatch.setattr(omni.program, "_GUARD", "exit 0")
    assert omni.run_program(["sh", "-c", "sleep 0.2; exit 4"], OmniSettings()) == 4


@compiled
def test_a_log_that_cannot_be_written_is_reported_before_the_program_runs(tmp_path):
    log = tmp_path / "nowhere" / "truth.csv"
    reported = cardan("--log", log, "--", "sh", "-c", "echo it ran", code=2)
    assert "truth.csv' cannot be written: No such file" in " ".join(reported.split())
    assert "it ran" not in reported


USES = """
import ctypes, os, sys
hd = ctypes.CDLL(os.environ["CARDAN_LIBHD"])
if sys.argv[1] > "0":
    hd.hdInitDevice(None)
if sys.argv[1] > "1":
    hd.hdStartScheduler()
    import time
    time.sleep(0.2)
if sys.argv[1] > "2":
    os.kill(os.getpid(), 9)
"""


@compiled
@pytest.mark.parametrize(
    ("does", "code", "words"),
    [
        (0, 0, "is empty: the program has not initialized"),
        (1, 0, "has no rows: the program has not started"),
        (2, 0, ""),
        (3, 137, ""),
    ],
)
def test_no_rows_in_the_log_are_worth_a_word(tmp_path, does, code, words):
    log = tmp_path / "truth.csv"
    log.write_text("of another run\n1\n2\n")
    reported = cardan("--log", log, "--", sys.executable, "-c", USES, does, code=code)
    assert ("warning: --log" in reported) is bool(words)
    assert words in reported
    assert "another run" not in log.read_text()
    assert bool(words) is (len(log.read_text().splitlines()) < 20)


@compiled
def test_after_its_seconds_the_program_is_asked_to_end():
    waits = "import time; print('up', flush=True); time.sleep(40)"
    assert cardan("--seconds", 1, "--", sys.executable, "-c", waits) == "up\n"
    assert "told" in cardan("--seconds", 1, "--", sys.executable, "-c", WAITS, code=5)


@compiled
def test_a_program_that_does_not_end_is_ended(monkeypatch):
    monkeypatch.setattr(omni.program, "GRACE_S", 0.2)
    before = signal.getitimer(signal.ITIMER_REAL)
    stubborn = "trap '' TERM; for i in 1 2 3 4 5 6 7 8 9; do sleep 1; done"
    began_s = time.monotonic()
    assert omni.run_program(["sh", "-c", stubborn], OmniSettings(), 0.3) == 0
    assert time.monotonic() - began_s < 8.0
    assert signal.getitimer(signal.ITIMER_REAL)[0] == pytest.approx(before[0], abs=9.0)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
