"""`cardan net record`, `cardan net replay` and `cardan net plot` as programs."""

import re
import signal
import subprocess
import sys

import pytest

from cardan.bus.node import BusNode
from cardan.bus.options import BusOptions
from tests.recording.sessions import (
    STRING,
    Recorded,
    session_file,
)
from tests.recording.test_plot import rows
from tests.recording.test_recorder import names_in, put_all
from tests.recording.test_replay import write
from tests.serving import free_endpoint
from tests.waiting import until

CARDAN = (sys.executable, "-m", "cardan")


def cardan(*words):
    return subprocess.run([*CARDAN, *words], capture_output=True, text=True, timeout=50)


@pytest.mark.matrix
def test_a_record_is_ended_by_ctrl_c(tmp_path):
    endpoint, path = free_endpoint(), tmp_path / "r.mcap"
    with BusNode(BusOptions(router="", listen=(endpoint,)), "talker") as node:
        words = ("net", "record", "-o", str(path), "--session", session_file(tmp_path, endpoint))
        process = subprocess.Popen([*CARDAN, *words], stdout=subprocess.PIPE, text=True)
        assert process.stdout.readline() == f"READY {path}\n"
        put_all(node.publisher("/count", STRING), 50)
        until(lambda: path.stat().st_size > 2000)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=20)
    assert process.returncode == 0
    assert out == "50 messages of 1 topics\n"
    assert names_in(path) == {"/count": 50}


@pytest.mark.matrix
def test_a_session_is_recorded_while_it_runs_from_its_first_cycle_on(tmp_path):
    file = session_file(tmp_path, free_endpoint())
    path = tmp_path / "r.mcap"
    done = cardan("run", file, "--seconds", "1.5", "--record", str(path))
    assert done.returncode == 0, done.stderr
    assert re.search(rf"{path}: \d+ messages of \d+ topics\n", done.stdout)
    answered = re.search(r"cycles answered\D*([\d,]+)", done.stdout)[1].replace(",", "")
    replayed = cardan("net", "replay", "--verify", str(path))
    assert f" {answered} cycles, each command bit for bit" in replayed.stdout, replayed.stderr

    done = cardan("run", file, "--seconds", "1.5", "--record", str(path))
    assert done.returncode == 3
    assert f"{path} exists: choose another name" in done.stderr
    assert "TCP" not in done.stdout


def test_a_session_that_is_on_no_network_is_not_recorded(tmp_path):
    file = tmp_path / "session.toml"
    file.write_text('[robot]\ndriver = "sim_arm"\n[arm]\nmodel = "ur5"\n')
    done = cardan("run", str(file), "--record", str(tmp_path / "r.mcap"))
    assert done.returncode == 2
    assert f"--record: {file} has no table [network]: add one" in done.stderr


@pytest.mark.matrix
def test_a_router_is_an_other_way_to_join(tmp_path):
    endpoint, path = free_endpoint(), tmp_path / "r.mcap"
    done = cardan("net", "record", "-o", str(path), "--router", endpoint, "--seconds", "0.2")
    assert done.returncode == 4
    done = cardan("net", "record", "-o", str(path), "--router", endpoint, "--session", "x.toml")
    assert (done.returncode, "give one of them" in done.stderr) == (2, True)


@pytest.mark.matrix
def test_a_record_of_nothing_says_so(tmp_path):
    file = session_file(tmp_path, free_endpoint())
    path = tmp_path / "r.mcap"
    done = cardan("net", "record", "-o", str(path), "--session", file, "--seconds", "0.2")
    assert done.returncode == 4
    assert "no message was received: `cardan net list` shows" in done.stdout


@pytest.mark.matrix
def test_a_record_that_was_cut_off_is_repaired(tmp_path):
    path = write(tmp_path / "r.mcap", rows())
    path.write_bytes(path.read_bytes()[:-8])
    done = cardan("net", "record", "--repair", str(path))
    assert done.returncode == 4, done.stderr
    assert "the file ends early: it was cut off" in done.stdout
    whole = tmp_path / "r-repaired.mcap"
    assert f"{whole}: {len(list(rows()))} messages, with an index" in done.stdout
    assert cardan("net", "plot", str(whole)).returncode == 0
    done = cardan("net", "record", "--repair", str(path), "--seconds", "1")
    assert (done.returncode, "--repair" in done.stderr) == (2, True)


@pytest.mark.matrix
def test_a_record_is_verified_in_another_process(tmp_path):
    """Its hash seed differs from the session's."""
    path = Recorded(seconds=1.2).write(tmp_path / "r.mcap")
    done = cardan("net", "replay", "--verify", str(path))
    assert done.returncode == 0, done.stderr
    assert "300 cycles, each command bit for bit the recorded one" in done.stdout


@pytest.mark.matrix
def test_the_former_name_of_the_option_is_refused_by_the_new_one(tmp_path):
    done = cardan(
        "net", "replay", "--engine", str(Recorded(seconds=0.3).write(tmp_path / "r.mcap"))
    )
    assert (done.returncode, "--engine: is now --verify" in done.stderr) == (2, True)


@pytest.mark.matrix
def test_a_command_that_differs_is_a_failure(tmp_path):
    session = Recorded(seconds=1.2)
    session.tables = session.tables | {"limits": {"linear_speed_m_s": 0.02}}
    done = cardan("net", "replay", "--verify", str(session.write(tmp_path / "r.mcap")))
    assert done.returncode == 4
    assert "differs, after" in done.stdout


@pytest.mark.matrix
@pytest.mark.parametrize(
    "words",
    [("net", "replay"), ("net", "replay", "--verify"), ("net", "plot")],
    ids=lambda words: " ".join(words),
)
def test_a_file_that_is_none_is_refused_in_one_line(tmp_path, words):
    done = cardan(*words, str(tmp_path / "none.mcap"))
    assert done.returncode == 2
    assert done.stderr.startswith("cardan: ")
    assert "none.mcap cannot be read: No such file or directory" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.matrix
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda data: data[:30] + bytes([data[30] ^ 1]) + data[31:], "the file is damaged at byte"),
        (lambda data: data[:-8], "the file ends early: it was cut off"),
    ],
    ids=["damaged", "cut off"],
)
def test_what_is_wrong_with_a_file_is_the_exit_code_of_every_command(tmp_path, spoil, words):
    drawn, replayed = write(tmp_path / "p.mcap", rows()), tmp_path / "e.mcap"
    Recorded(seconds=0.3).write(replayed)
    for command, path in ((("net", "plot"), drawn), (("net", "replay", "--verify"), replayed)):
        assert cardan(*command, str(path)).returncode == 0
        path.write_bytes(spoil(path.read_bytes()))
        done = cardan(*command, str(path))
        assert (done.returncode, words in done.stdout) == (4, True)
