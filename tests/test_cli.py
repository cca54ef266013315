"""Command line for its users: help, errors, exit codes, and the contract of simulated peers."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cardan import __version__
from tests.serving import free_udp_port
from tests.waiting import WITHIN_S

pytestmark = pytest.mark.matrix

EXAMPLES = Path(__file__).parents[1] / "examples"
ENVIRONMENT = {**os.environ, "NO_COLOR": "1", "COLUMNS": "120"}


def cardan(*arguments, code=0, **options):
    """Run the command until it exits; return its output."""
    done = subprocess.run(
        [sys.executable, "-m", "cardan", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=WITHIN_S,
        env=ENVIRONMENT,
        **options,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


class Peer:
    """Peer that runs until the block ends; `endpoint` is from its READY line."""

    def __init__(self, *arguments):
        self._process = subprocess.Popen(
            [sys.executable, "-m", "cardan", "sim", *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def __enter__(self):
        line = self._process.stdout.readline()
        assert line.startswith("READY "), line + self._process.stderr.read()
        self.endpoint = line.removeprefix("READY ").strip()
        return self

    def __exit__(self, *_exception):
        self._process.send_signal(signal.SIGTERM)
        self.said, self.logged = self._process.communicate(timeout=WITHIN_S)
        self.code = self._process.returncode


def test_help_leads_a_newcomer_to_the_demo():
    text = cardan("--help")
    assert "cardan demo" in text
    for command in ("demo", "run", "sim", "devices", "check", "dissect"):
        assert command in text


def test_version():
    assert cardan("--version") == f"cardan {__version__}\n"


@pytest.mark.real
def test_check_says_what_a_configuration_would_do():
    text = cardan("check", EXAMPLES / "spacemouse-gofa.toml")
    assert "100 mm/s" in text
    assert "'left' must be held" in text


def test_check_and_run_warn_of_a_robot_that_anybody_may_take(tmp_path):
    file = tmp_path / "anybody.toml"
    robot = '[robot]\ndriver = "abb_egm"\nlisten_host = "0.0.0.0"\nlisten_port = 0\n'
    file.write_text(robot)
    words = "robot: listen_host 0.0.0.0 without controller_host: the first sender to UDP port"
    text = cardan("check", file)
    assert f"{file}: fine, with WARNINGS\n  WARNING  {words} 0 is taken" in text
    assert f"cardan: WARNING: {words} 0 is taken" in cardan("run", file, "--seconds", "0.2", code=4)
    file.write_text(robot + 'controller_host = "192.168.125.1"\n')
    assert "WARNING" not in cardan("check", file)


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        ('mode = "position"', "the TCP moves as the device does, base axes"),
        (
            'mode = "absolute"\norigin_m = [0.5, 0.0, 0.3]\napproach_speed_m_s = 0.04',
            "the TCP goes where the device is, base axes, at 40 mm/s and 17 deg/s",
        ),
    ],
)
def test_check_says_what_a_hand_whose_pose_is_followed_does(tmp_path, mapping, words):
    file = tmp_path / "pose.toml"
    file.write_text(
        '[device]\ndriver = "leap"\n[robot]\ndriver = "abb_egm"\n'
        f'[mapping]\n{mapping}\ndeadman = "grab"\n'
    )
    text = cardan("check", file)
    assert words in text
    assert "full deflection" not in text


def test_check_says_what_moves_an_arm_without_a_device(tmp_path):
    text = cardan("check", EXAMPLES / "verbs-ur5-simulated.toml")
    assert "device   none" in text
    assert "moved by verbs and streams of a program" in text
    assert "servo    compiled" in text
    assert "dead-man" not in text
    bare = tmp_path / "bare.toml"
    bare.write_text('[robot]\ndriver = "abb_egm"\n')
    assert "moved by NOTHING: verbs and streams need an [arm]" in cardan("check", bare)


def test_run_without_a_device_shows_an_arm_that_holds():
    text = cardan("run", EXAMPLES / "verbs-ur5-simulated.toml", "--seconds", "1")
    assert "disarmed  device –, robot live" in text
    assert "moving 0.0 s" in text


def test_check_names_the_key(tmp_path):
    file = tmp_path / "bad.toml"
    file.write_text(
        '[device]\ndriver = "spacemouse"\n[robot]\ndriver = "abb_egm"\nlisten_prt = 1\n'
    )
    text = cardan("check", file, code=2)
    assert "robot.listen_prt" in text
    assert "did you mean 'listen_port'" in text
    assert "Traceback" not in text


def test_run_without_its_device_says_what_to_do():
    text = cardan("run", EXAMPLES / "spacemouse-gofa-simulated.toml", code=3, cwd="/")
    assert "start the simulated device first" in text


@pytest.mark.real
def test_the_drivers_are_listed_with_what_they_declare():
    lines = cardan("devices", "drivers").splitlines()
    (mouse,) = (line for line in lines if line.split()[:1] == ["spacemouse"])
    for words in ("[device]", "3Dconnexion", "cardan sim spacemouse", "docs/spacemouse.md"):
        assert words in mouse
    assert any(line.split()[:2] == ["abb_egm", "[robot]"] for line in lines)


def test_the_simulated_peers_are_listed():
    lines = cardan("sim", "--list").splitlines()
    assert any(line.split()[0] == "motoman-gp8" and "simple message" in line for line in lines)


def test_dissect_of_nothing():
    assert "no such file" in cardan("dissect", "nothing.pcap", code=2)


@pytest.mark.parametrize(
    ("peer", "fault"),
    [("abb-gofa", "garbage"), ("spacemouse", "short-report")],
)
def test_peers_list_what_they_can(peer, fault):
    assert fault in cardan("sim", peer, "--list-faults")
    assert "a file has one step a line" in cardan("sim", peer, "--list-scripts")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("abb-gofa", "--fault", "nonsense"), "there is no fault 'nonsense'"),
        (("abb-gofa", "--to", "nowhere"), "HOST:PORT"),
        (("abb-gofa", "--mode", "fly"), "allowed: joint, pose, path"),
        (("abb-gofa", "--robotware", "5"), "robotware"),
        (("abb-gofa", "--script", "nope"), "teleop"),
        (("abb-gofa", "--period", "1"), "0.001 to 0.1 s"),
        (("abb-gofa", "--period", "0.008", "--virtual"), "one of them"),
        (("spacemouse",), "--hid"),
        (("spacemouse", "--hid", "x", "--model", "mouse"), "spacenavigator"),
        (("spacemouse", "--hid", "x", "--fault", "unplug=soon"), "not a number"),
    ],
)
def test_wrong_words_to_a_peer(arguments, words, tmp_path):
    assert words in cardan("sim", *arguments, "--seconds", "0", code=2, cwd=tmp_path)


def test_a_peer_serves_until_its_seconds_are_over(tmp_path):
    text = cardan("sim", "spacemouse", "--hid", tmp_path / "hid", "--seconds", "0.1")
    assert text.startswith(f"READY {tmp_path / 'hid'}\n")
    assert not (tmp_path / "hid").exists()


def test_a_peer_that_is_interrupted_cleans_up(tmp_path):
    with Peer("spacemouse", "--hid", tmp_path / "hid") as peer:
        assert peer.endpoint == str(tmp_path / "hid")
        assert (tmp_path / "hid").is_socket()
    assert peer.code == 0
    assert peer.said == ""
    assert not (tmp_path / "hid").exists()


def test_a_session_through_start_stop_and_restart_of_the_controller(tmp_path):
    """``cardan run`` serves a controller that starts, stops and restarts."""
    port = free_udp_port()
    program = tmp_path / "program.txt"
    program.write_text(
        # Enough time for the session to listen, even on a busy computer.
        "4.0 movej\n4.0 getid\n4.0 setup\n4.0 act window=1e-9 max-speed=180\n"
        "4.0 run cond-time=1e6 nowait\n5.0 stop\n6.0 restart\n7.5 controller-restart\n"
    )
    config = tmp_path / "session.toml"
    config.write_text(
        f'[device]\ndriver = "spacemouse"\ntransport = "socket"\npath = "{tmp_path}/hid"\n'
        f'[robot]\ndriver = "abb_egm"\nlisten_port = {port}\n'
    )
    to = f"127.0.0.1:{port}"
    with (
        Peer("spacemouse", "--hid", tmp_path / "hid", "--script", "rest"),
        Peer("abb-gofa", "--to", to, "--script", program) as robot,
    ):
        text = cardan("run", config, "--seconds", "12")
    assert robot.endpoint == to
    sessions = next(line for line in text.splitlines() if "robot sessions" in line)
    assert int("".join(filter(str.isdigit, sessions))) >= 3
    assert "no datagram for" in text


def test_check_takes_a_file_of_the_daemon(tmp_path):
    file = tmp_path / "lab.toml"
    session = '[[sessions]]\nname = "one"\nrobot = {driver = "sim_arm", robot = "ur5"}\n'
    arm = '[sessions.arm]\nmodel = "ur5"\n'
    file.write_text(f"{session}{arm}[servers.rosbridge]\nport = 9191\n", encoding="utf-8")
    text = cardan("check", file)
    assert "fine" in text
    assert re.search(r"session +one\n +server +rosbridge", text)
    file.write_text(f"{session}{arm}speed_share = 2\n", encoding="utf-8")
    assert "lab.toml:6:1:" in cardan("check", file, code=2)
