"""Every server has a command, generated from its options; it serves until it is told to end."""

import signal
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import ClassVar, Literal

import pytest
from typer.testing import CliRunner

from cardan.bus import discovery
from cardan.bus.options import BusOptions
from cardan.cli import app, bus
from cardan.cli.daemon import checked
from cardan.cli.server import check_words, server
from cardan.common.options import CODE_ONLY, Options
from cardan.common.plugins import IN_SOURCE_TREE
from cardan.errors import ConfigurationError
from cardan.gateway.daemon.config import read_daemon_config
from cardan.gateway.servers import registry
from cardan.gateway.servers.base import Server
from tests.serving import free_endpoint

WIDE = {"COLUMNS": "400", "NO_COLOR": "1", "TERM": "dumb"}


@dataclass(frozen=True, kw_only=True)
class EchoServerOptions(Options):
    port: int = 9090
    """Where it listens, as [server] would have it."""
    shout: bool = True
    """In capitals."""
    form: Literal["short", "long"] = "short"
    patience_s: float = 2.0
    names: tuple[str, ...] = ("echo",)
    """Names that it answers to."""
    secret: str = field(default="", metadata=CODE_ONLY)


@dataclass(frozen=True, kw_only=True)
class EchoOptions:
    bus: BusOptions = field(default_factory=BusOptions)
    server: EchoServerOptions = field(default_factory=EchoServerOptions)


class Echo(Server[EchoOptions]):
    """Say again what was said."""

    Options = EchoOptions
    served: ClassVar[list[EchoOptions]] = []

    @classmethod
    def serve(cls, options, ready, stop):
        cls.served.append(options)
        ready(f"port {options.server.port}")
        assert stop.wait(20.0)


@pytest.fixture
def echo(monkeypatch):
    point = EntryPoint("echo", f"{__name__}:Echo", registry.ENTRY_POINT_GROUP)
    monkeypatch.setattr(registry.FINDER, "_installed", lambda: [point])
    monkeypatch.setattr(Echo, "served", [])
    return Echo


def said(*words, code=0, program=server):
    outcome = CliRunner().invoke(
        program, words, env=WIDE, catch_exceptions=False, terminal_width=400
    )
    assert outcome.exit_code == code, outcome.output
    return outcome.output


@pytest.mark.parametrize("name", registry.BUILT_IN)
def test_every_server_tells_what_it_does_and_what_its_options_mean(name):
    declared = registry.load(name)
    assert " ".join(declared.__doc__.split()) in " ".join(said("--list").split())
    reported = said(name, "--help")
    assert "--seconds" in reported
    assert declared.epilog in reported


@pytest.mark.parametrize("name", IN_SOURCE_TREE["server"])
def test_a_server_of_a_plug_in_that_is_missing_says_what_to_install(monkeypatch, name):
    monkeypatch.setattr(registry.FINDER, "_installed", list)
    folder = IN_SOURCE_TREE["server"][name]
    with pytest.raises(ConfigurationError, match=f"run `pip install ./{folder}` there"):
        said(name, "--domain", "1")
    with pytest.raises(ConfigurationError, match=f"{name!r} is in the folder {folder} "):
        registry.load(name)
    assert f" {name} " not in said("--list")


def test_the_fields_of_all_options_inside_are_options_with_their_texts(echo):
    reported = said("echo", "--help")
    for words in (
        "ROS_DOMAIN_ID.",
        "--zenoh-config",
        "Where it listens, as [server] would have it.",
        "--no-shout",
        "short|long",
        "--patience",
        "Names that it answers to. [default: echo] (repeatable)",
    ):
        assert words in reported
    assert "--secret" not in reported


def test_a_server_serves_with_what_was_given(echo):
    reported = said("echo", "--seconds", "0")
    assert reported == "READY port 9090\n"
    words = ["--no-shout", "--form", "long", "--names", "a", "--names", "b", "--domain", "7"]
    said("echo", "--seconds", "0", "--patience", "3", *words)
    assert echo.served == [
        EchoOptions(),
        EchoOptions(
            bus=BusOptions(domain=7),
            server=EchoServerOptions(shout=False, form="long", patience_s=3.0, names=("a", "b")),
        ),
    ]


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--domain", "999"], "--domain: 999 is not allowed"),
        (["--form", "broad"], "--form: 'broad' is unknown; allowed: short, long"),
        (["--mode", "client", "--router", ""], "--router: '' is not allowed"),
    ],
)
def test_a_wrong_value_is_refused_by_the_name_of_its_option(echo, words, error):
    with pytest.raises(ConfigurationError, match=error):
        said("echo", *words)
    assert echo.served == []


def test_a_server_that_cannot_be_loaded_says_why(monkeypatch):
    point = EntryPoint("broken", "nowhere:Server", registry.ENTRY_POINT_GROUP)
    monkeypatch.setattr(registry.FINDER, "_installed", lambda: [point])
    assert "broken  cannot be loaded: ModuleNotFoundError" in said("--list")
    with pytest.raises(ConfigurationError, match="No module named 'nowhere'"):
        said("broken")


@pytest.mark.parametrize("name", IN_SOURCE_TREE["server"])
def test_a_server_of_the_source_tree_says_how_it_is_installed(monkeypatch, name):
    folder = IN_SOURCE_TREE["server"][name]
    assert (Path(__file__).parents[1] / folder / "pyproject.toml").is_file()
    monkeypatch.setattr(registry.FINDER, "_installed", list)
    for ask in (lambda: said(name, "--port", "0"), lambda: check_words(name, [])):
        with pytest.raises(ConfigurationError, match=f"server: {name!r} is .*install ./{folder}`"):
            ask()


def test_serving_without_a_terminal_ends_by_its_time_in_any_thread(echo, capsys):
    thread = threading.Thread(target=echo.run, args=(EchoOptions(), 0.01))
    thread.start()
    thread.join(20.0)
    assert capsys.readouterr().out == "READY port 9090\n"


# -- the router -----------------------------------------------------------------------------------


def cardan(*words):
    return subprocess.Popen(
        [sys.executable, "-m", "cardan", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.PIPE,
        text=True,
    )


@pytest.mark.matrix
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_router_serves_until_a_signal(number):
    endpoint = free_endpoint()
    with cardan("net", "server", "router", "--endpoint", endpoint) as process:
        assert process.stdout.readline() == f"READY {endpoint}\n"
        with cardan("net", "server", "router", "--endpoint", endpoint) as second:
            _, error = second.communicate(timeout=20.0)
            assert second.returncode == 3
            assert error.startswith(
                f"cardan: the router cannot serve at {endpoint}; another router"
            )
        process.send_signal(number)
        _, error = process.communicate(timeout=20.0)
    assert (process.returncode, error) == (0, "")


@pytest.mark.matrix
def test_an_attached_router_ends_with_its_standard_input():
    endpoint = free_endpoint()
    with cardan("net", "server", "router", "--endpoint", endpoint, "--attached") as process:
        assert process.stdout.readline() == f"READY {endpoint}\n"
        process.stdin.write("what comes has no meaning")
        process.stdin.close()
        assert process.wait(20.0) == 0


# -- the self-test --------------------------------------------------------------------------------

SOMEBODY = discovery.Discovery(
    ["/arm/server"],
    {"/joint_states": discovery.Topic("sensor_msgs/msg/JointState", ("/arm/server",))},
    {"/arm/server/stop": discovery.ServiceInfo("std_srvs/srv/Trigger", ("/arm/server",))},
    1,
    1,
)


def test_the_network_is_printed_to_be_copied(monkeypatch):
    monkeypatch.setattr(bus, "met_here", lambda options: options)
    monkeypatch.setattr(discovery, "discover", lambda _options: SOMEBODY)
    assert said("net", "list", program=app).splitlines() == [
        "node     /arm/server",
        "topic    /joint_states  sensor_msgs/msg/JointState  by /arm/server",
        "service  /arm/server/stop  std_srvs/srv/Trigger  by /arm/server",
    ]


def test_the_network_is_joined_as_a_session_joins_it(monkeypatch, tmp_path):
    seen = []
    monkeypatch.setattr(discovery, "discover", lambda options: seen.append(options) or SOMEBODY)
    file = tmp_path / "session.toml"
    robot = '[robot]\ndriver = "sim_arm"\nrobot = "ur5"\n[arm]\nmodel = "ur5"\n'
    file.write_text(f'{robot}[network]\nrouter = "tcp/10.0.0.1:7447"\nmode = "client"\n')
    said("net", "list", str(file), program=app)
    assert seen == [BusOptions(router="tcp/10.0.0.1:7447", mode="client")]
    with pytest.raises(ConfigurationError, match="give one of them"):
        said("net", "list", str(file), "--router", "tcp/10.0.0.2:7447", program=app)
    file.write_text(robot)
    with pytest.raises(ConfigurationError, match=r"has no table \[network\]"):
        said("net", "list", str(file), program=app)
    said("net", "list", "--router", "tcp/10.0.0.2:7447", program=app)
    assert seen[1:] == [BusOptions(router="tcp/10.0.0.2:7447")]


def test_where_nobody_is_met_the_remedies_are_said(monkeypatch):
    nobody = discovery.Discovery((), {}, {}, 1, 0)
    monkeypatch.setattr(discovery, "discover", lambda _options: nobody)
    reported = said("net", "list", program=app, code=4)
    assert "A router answers, but no node was found." in reported
    assert 'mode = "client"' in reported


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (("--port", "70000"), "--port: 70000 is not allowed"),
        (("--prot", "9090"), "No such option: --prot"),
        (("--port", "many"), r"--port.*valid int(eger)?\b"),
        (("--token", "s3cret"), "No such option: --token"),
        (("--host", "0.0.0.0"), "--host: .*127.0.0.1, unless"),
        (("more",), "unexpected extra argument"),
    ],
)
def test_what_a_server_would_refuse_is_known_before_it_runs(words, error):
    with pytest.raises(ConfigurationError, match=f"(?i){error}") as refused:
        check_words("rosbridge", words)
    assert "s3cret" not in str(refused.value)


def test_what_a_server_takes():
    check_words(
        "rosbridge", ("--port", "0", "--topics", "/a", "--topics", "/b", "--log-level", "debug")
    )


def test_a_daemon_with_servers_refuses_the_former_name_of_the_token_before_it_runs(
    monkeypatch, tmp_path
):
    (tmp_path / "lab.toml").write_text('[servers.web]\nserver = "rosbridge"\n')
    config = read_daemon_config([tmp_path / "lab.toml"])
    assert checked(config) is config
    monkeypatch.setenv("CARDAN_FACE_TOKEN", "x" * 16)
    with pytest.raises(ConfigurationError, match="CARDAN_FACE_TOKEN: is now"):
        checked(config)
