"""Shell completion, and its installation by `--install-completion`."""

import os
import subprocess
import sys

import pytest

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.cli import completion
from tests.programs import Program
from tests.serving import free_endpoint
from tests.test_cli import ENVIRONMENT

ROWS = [
    {"name": "gofa", "kind": "session", "state": "running"},
    {"name": "gp8", "kind": "session", "state": "failed"},
    {"name": "web", "kind": "server", "state": "running"},
]


SHELL_IS_NAMED = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
"""Disables the detection of the shell that started this process."""


class Context:
    params = {"socket": ""}  # noqa: RUF012


def names(offered):
    return [name for name, _ in offered]


def test_demos_and_drivers_and_verbs():
    assert names(completion.demos("go")) == ["gofa"]
    assert {"ros2", "ros2-ur5"} <= {*names(completion.demos("ros2"))}
    assert names(completion.drivers("spa")) == ["spacemouse", "spacemouse_serial"]
    assert names(completion.verbs("mov")) == ["movj", "movl", "movv"]


def test_sessions_and_servers(monkeypatch):
    monkeypatch.setattr(completion, "_rows", lambda context: ROWS)
    assert names(completion.units(Context, "")) == ["gofa", "gp8", "web"]
    assert names(completion.units(Context, "w")) == ["web"]
    assert completion.sessions(Context, "g") == [("gofa", "running"), ("gp8", "failed")]
    assert completion.sessions(Context, "w") == []


def test_devices_and_who_shares_them(monkeypatch):
    shared = [
        {"name": "mouse", "sessions": ["gofa", "ur5"], "holder": "ur5"},
        {"name": "pad", "sessions": ["gp8", "gp25"], "holder": "gp8"},
    ]
    monkeypatch.setattr(completion, "_asked", lambda context, do: shared)
    assert completion.devices(Context, "m") == [("mouse", "serves ur5")]
    context = Context()
    context.params = {"device": "pad"}
    assert names(completion.sharers(context, "gp")) == ["gp8", "gp25"]
    context.params = {"device": "nothing"}
    assert completion.sharers(context, "") == []


def test_topics(monkeypatch):
    asked = []

    def found(options):
        asked.append(options.router)
        return {"/ur5/state/pose": "geometry_msgs/msg/PoseStamped", "/tf": "tf2_msgs/msg/TFMessage"}

    monkeypatch.setattr(completion, "_topics", found)
    context = Context()
    context.params = {"router": "tcp/127.0.0.1:9"}
    assert names(completion.topics(context, "/u")) == ["/ur5/state/pose"]
    assert asked == ["tcp/127.0.0.1:9"]
    context.params = {"session": "/nowhere/at/all.toml"}
    assert completion.topics(context, "") == []


def test_without_a_router_nobody_waits_for_topics(monkeypatch):
    monkeypatch.setattr(BusNetwork, "open", lambda network: pytest.fail("it joined"))
    context = Context()
    context.params = {"router": free_endpoint()}
    assert completion.topics(context, "") == []


@pytest.mark.matrix
def test_topics_of_a_bus(monkeypatch):
    monkeypatch.setattr(completion, "TOPICS_S", 20.0)
    options = BusOptions(router="", listen=(free_endpoint(),))
    with BusNetwork(options, "speaker") as network:
        said = network.advertise("/spoken", "std_msgs/msg/String", latched=False)
        context = Context()
        context.params = {"router": options.listen[0]}
        assert ("/spoken", "std_msgs/msg/String") in completion.topics(context, "/s")
        said.close()


def test_without_a_daemon_there_is_nothing(tmp_path):
    Context.params["socket"] = str(tmp_path / "none")
    try:
        assert completion.units(Context, "") == []
    finally:
        Context.params["socket"] = ""


def complete(*words, **environment):
    """Return bash's completions after these words, the last of which is incomplete."""
    done = subprocess.run(
        [sys.executable, "-m", "cardan"],
        env={
            **ENVIRONMENT,
            "_CARDAN_COMPLETE": "complete_bash",
            "COMP_WORDS": " ".join(("cardan", *words)),
            "COMP_CWORD": str(len(words)),
            **environment,
        },
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.matrix
@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("doc",), ["doctor"]),
        (("demo", "ros2-"), ["ros2-joy", "ros2-pr2", "ros2-spacenav", "ros2-ur5"]),
        (("net", "server", "ro"), ["rosbridge", "router"]),
        (("sim", "sp"), ["spacemouse", "spacemouse-serial"]),
        (("devices", "drivers", "ga"), ["gamepad"]),
        (("net", "rep"), ["replay"]),
        (("serve", "la"), []),
        (("daemon", "arm", "gofa", "rel"), ["relj", "release"]),
        (("doctor", "--re"), ["--report"]),
    ],
)
def test_the_shell_is_reported(words, found):
    assert complete(*words) == found


@pytest.mark.matrix
@pytest.mark.parametrize(
    ("shell", "words", "found"),
    [
        (
            "fish",
            "net server ",
            "router\tRun a Zenoh router, like rmw_zenohd, by which sessions, servers",
        ),
        ("fish", "run --", "--record\tRecord the network into this file (MCAP) while the session"),
        ("fish", "run --", "the session needs a [network]."),
        ("zsh", "run --", "the session needs a [network]."),
    ],
)
def test_other_shells_get_each_help_whole_and_on_a_line(shell, words, found):
    """The shell would take a second line for another choice."""
    variables = {
        "_CARDAN_COMPLETE": f"complete_{shell}",
        "_TYPER_COMPLETE_ARGS": f"cardan {words}",
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }
    done = subprocess.run(
        [sys.executable, "-m", "cardan"],
        env={**ENVIRONMENT, **variables},
        capture_output=True, text=True, timeout=50, check=False,
    )  # fmt: skip
    assert found in done.stdout, done.stderr
    assert all("\t" in line or '":"' in line for line in done.stdout.splitlines())


@pytest.mark.matrix
def test_sessions_of_a_daemon_that_runs(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text(
        f'[daemon]\nsocket = "{tmp_path}/cardan.sock"\nevent_log = "none"\n'
        '[[sessions]]\nname = "one"\nstart = false\nrobot = { driver = "abb_egm" }\n'
        '[servers.other]\nserver = "router"\nstart = false\n'
    )
    with Program("daemon", "run", file) as program:
        program.wait_for("READY ")
        own = ("--socket", f"{tmp_path}/cardan.sock")
        assert complete("daemon", "stop", *own, "o") == ["one", "other"]
        assert complete("daemon", "arm", *own, "o") == ["one"]


@pytest.mark.matrix
@pytest.mark.parametrize(
    ("shell", "path", "script"),
    [
        ("bash", ".bashrc", ".bash_completions/cardan.sh"),
        ("zsh", ".zshrc", ".zfunc/_cardan"),
        ("fish", "", ".config/fish/completions/cardan.fish"),
    ],
)
def test_completion_is_installed(tmp_path, shell, path, script):
    environment = {**ENVIRONMENT, "HOME": str(tmp_path), **SHELL_IS_NAMED}
    words = [sys.executable, "-m", "cardan", "--install-completion", shell]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "_CARDAN_COMPLETE" in (tmp_path / script).read_text()
    if path:
        assert (tmp_path / path).exists()


@pytest.mark.real
def test_bash_completes_by_what_was_installed(tmp_path):
    environment = {**ENVIRONMENT, "HOME": str(tmp_path), **SHELL_IS_NAMED}
    shown = subprocess.run(
        [sys.executable, "-m", "cardan", "--show-completion", "bash"],
        env=environment, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "cardan").write_text(f'#!/bin/sh\nexec {sys.executable} -m cardan "$@"\n')
    (folder / "cardan").chmod(0o755)
    environment["PATH"] = f"{folder}:{os.environ['PATH']}"
    typed = "COMP_WORDS=(cardan demo ros2-); COMP_CWORD=2; _cardan_completion cardan\n"
    done = subprocess.run(
        ["bash", "--norc", "-c", f"{shown}\n{typed}echo ${{COMPREPLY[@]}}"],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout == "ros2-joy ros2-pr2 ros2-spacenav ros2-ur5\n", done.stderr
