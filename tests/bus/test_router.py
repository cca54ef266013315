"""Router that sessions on this computer need: exactly one process runs it."""

import socket
import subprocess
import sys
from types import SimpleNamespace

import pytest

from cardan.bus import router as module
from cardan.bus.options import ROUTER, BusOptions
from cardan.bus.router import (
    LOOK_PERIOD_S,
    RESTART_PAUSE_S,
    RouterKeeper,
    announced,
    is_served,
    router_address,
    router_addresses,
    routers_here,
)
from cardan.cli.bus import bus_options
from cardan.errors import ConfigurationError
from cardan.gateway.session.subprocesses import cardan_subprocess
from tests.serving import free_endpoint
from tests.waiting import until


@pytest.mark.parametrize(
    ("router", "address"),
    [
        ("tcp/127.0.0.1:7447", ("127.0.0.1", 7447)),
        ("tcp/localhost:7447", ("localhost", 7447)),
        ("tcp/[::1]:7447", ("::1", 7447)),
        ("tcp/127.0.0.1:7447#so_sndbuf=65000", ("127.0.0.1", 7447)),
        ("tcp/127.0.0.1:7447?prio=6-7", ("127.0.0.1", 7447)),
        ("tcp/192.168.0.1:7447", None),
        ("tcp/robot:7447", None),
        ("tls/127.0.0.1:7447", None),
        ("udp/127.0.0.1:7447", None),
        ("tcp/127.0.0.1:port", None),
        ("", None),
    ],
)
def test_only_a_router_of_this_computer_is_ours_to_serve(router, address):
    assert router_address(BusOptions(router=router)) == address


def test_a_configuration_of_zenohs_says_for_itself_where_the_router_is():
    assert router_address(BusOptions(zenoh_config="zenoh.json5")) is None


def test_a_port_is_served_while_somebody_listens():
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = server.getsockname()
        assert is_served(address)
        with socket.create_connection(address):
            connection, _ = server.accept()
            connection.close()
    assert not is_served(address)  # also while the closed connection lingers


class FakeProcess:
    """Router process that lives until a test ends it."""

    def __init__(self, words, **_pipes):
        self.words, self.pid, self.code, self.ended = words, id(self), None, False
        self.stderr = SimpleNamespace(read=lambda: b"Traceback ...\ncardan: no such interface\n")

    def poll(self):
        return self.code

    def terminate(self):
        self.ended, self.code = True, 0

    def communicate(self, timeout):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        pass


class Bench:
    def __init__(self, monkeypatch, options=None):
        self.started, self.served, self.now_s = [], False, 10.0
        self.promised = frozenset()
        monkeypatch.setattr(module.subprocess, "Popen", self.start)
        self.keeper = RouterKeeper(
            options or BusOptions(),
            served=lambda _address: self.served,
            promised=lambda address: address in self.promised,
            clock=lambda: self.now_s,
        )

    def start(self, words, **pipes):
        self.started.append(FakeProcess(words, **pipes))
        return self.started[-1]

    def poll(self):
        self.now_s += LOOK_PERIOD_S
        self.keeper.poll()
        return len(self.started)


def test_a_router_is_started_where_nobody_serves_one_and_ended_at_the_end(monkeypatch):
    bench = Bench(monkeypatch, BusOptions(router="tcp/127.0.0.1:7999"))
    assert bench.poll() == 1
    words = bench.started[0].words
    assert words[1:] == [
        *(
            "-m",
            "cardan",
            "net",
            "server",
            "router",
            "--endpoint",
            "tcp/127.0.0.1:7999",
            "--attached",
        )
    ]
    bench.served = True
    assert bench.poll() == 1
    bench.keeper.close()
    bench.keeper.close()
    assert bench.started[0].ended


def test_a_router_of_somebody_else_is_left_alone_until_it_has_ended(monkeypatch):
    bench = Bench(monkeypatch)
    bench.served = True
    assert bench.poll() == 0
    bench.served = False
    assert bench.poll() == 1
    assert bench.poll() == 1  # a router needs time to start


def test_who_comes_second_is_content(monkeypatch, caplog):
    bench = Bench(monkeypatch)
    bench.poll()
    bench.started[0].code, bench.served = 3, True
    assert bench.poll() == 1
    assert caplog.messages == []
    bench.keeper.close()
    assert not bench.started[0].ended


def test_none_is_started_where_another_program_is_to_serve_and_a_started_one_leaves(
    monkeypatch, caplog
):
    bench = Bench(monkeypatch)
    bench.promised = router_addresses(["tcp/[::]:7447"])
    assert bench.poll() == 0
    bench.promised = router_addresses(["tcp/[::]:7448"])
    assert bench.poll() == 1
    bench.promised = router_addresses([ROUTER])
    assert bench.poll() == 1
    assert bench.started[0].ended
    bench.poll()
    bench.promised = frozenset()
    assert bench.poll() == 2
    assert caplog.messages == []


def test_the_addresses_of_a_router_are_those_that_programs_here_reach():
    here = {("127.0.0.1", 7), ("localhost", 7)}
    for endpoint in ("tcp/127.0.0.1:7", "tcp/localhost:7", "tcp/0.0.0.0:7", "tcp/[::]:7"):
        assert router_addresses([endpoint]) == here
    others = ["tcp/192.168.1.10:7", "tls/127.0.0.1:7", "nonsense", ""]
    assert router_addresses([*others, "tcp/127.0.0.2:8"]) == {("127.0.0.2", 8)}


def test_a_router_that_ends_is_started_anew_after_a_pause_and_said_so(monkeypatch, caplog):
    bench = Bench(monkeypatch)
    bench.poll()
    bench.started[0].code = 3
    assert bench.poll() == 1
    bench.now_s += RESTART_PAUSE_S
    assert bench.poll() == 2
    (said,) = caplog.messages
    assert said.endswith("has ended: cardan: no such interface")


@pytest.mark.parametrize("options", [None, BusOptions(router="tcp/192.168.0.1:7447")])
def test_nothing_is_started_for_a_router_elsewhere_or_for_no_network(monkeypatch, options):
    started = []
    monkeypatch.setattr(module.subprocess, "Popen", started.append)
    RouterKeeper(options, served=lambda _address: False).poll()
    assert started == []


def test_it_looks_once_a_second(monkeypatch):
    bench = Bench(monkeypatch)
    bench.poll()
    bench.started[0].code = 3
    bench.now_s += 0.9 * LOOK_PERIOD_S
    bench.keeper.poll()
    assert len(bench.started) == 1


@pytest.mark.real
def test_a_router_ends_with_the_process_that_has_started_it():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = probe.getsockname()
    program = (
        "import sys; from cardan.bus.router import *; "
        f"keeper = RouterKeeper(BusOptions(router='tcp/127.0.0.1:{address[1]}')); keeper.poll(); "
        "print(keeper.pid, flush=True); sys.stdin.read()"
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", program], **pipes) as process:
        assert int(process.stdout.readline()) > 0
        until(lambda: is_served(address))
        process.kill()
    until(lambda: not is_served(address))


def test_running_routers_are_found_and_those_that_were_killed_are_not(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    served = {("127.0.0.1", 7450), ("127.0.0.1", 7451)}.__contains__
    assert routers_here(served) == []
    (tmp_path / "cardan-router-1").write_text("tcp/127.0.0.1:7449")  # left by a dead process
    (tmp_path / "cardan-router-2").write_bytes(b"\xff no endpoint")
    with announced(["tls/127.0.0.1:7452", "tcp/0.0.0.0:7451"]):
        assert routers_here(served) == ["tcp/127.0.0.1:7451"]
        (tmp_path / "cardan-router-3").write_text("tcp/127.0.0.1:7450")
        assert routers_here(served) == ["tcp/127.0.0.1:7450", "tcp/127.0.0.1:7451"]
    assert routers_here(served) == ["tcp/127.0.0.1:7450"]


def test_a_router_that_cannot_be_announced_serves_all_the_same(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "none" / "none"))
    with announced(["tcp/127.0.0.1:7451"]):
        assert routers_here(lambda _: True) == []


def test_without_a_word_the_only_router_of_this_computer_is_joined(monkeypatch, capsys):
    """`cardan net echo`, `hz`, `record` and `list` join it; `replay` publishes, and does not."""
    here = []
    monkeypatch.setattr(module, "is_served", lambda _address: False)
    monkeypatch.setattr(module, "routers_here", lambda: here)
    assert bus_options(None) == BusOptions()
    here.append("tcp/127.0.0.1:7450")
    assert bus_options(None).router == "tcp/127.0.0.1:7450"
    assert "7450" in capsys.readouterr().err
    assert bus_options(None, publishes=True) == BusOptions()
    here.append("tcp/127.0.0.1:7451")
    with pytest.raises(ConfigurationError, match=r"7450, tcp/127\.0\.0\.1:7451"):
        bus_options(None)
    assert bus_options(None, "tcp/127.0.0.1:7451").router == "tcp/127.0.0.1:7451"
    monkeypatch.setattr(module, "is_served", lambda _address: True)
    assert bus_options(None) == BusOptions()


@pytest.mark.matrix
def test_a_router_says_where_it_is_while_it_runs(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    endpoint = free_endpoint()
    with cardan_subprocess("net", "server", "router", "--endpoint", endpoint):
        assert routers_here() == [endpoint]
    assert list(tmp_path.glob("*")) == []
