"""``cardan net server console`` and ``cardan run --console`` as whole programs."""

from __future__ import annotations

import json
import os
import re
import signal
import ssl
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")

from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from cardan.gateway.daemon.client import ControlClient
from cardan.gateway.servers.console.site import FOLDER
from tests.gateway.servers.bench import WAIT_S
from tests.gateway.servers.console.bench import PageProgram
from tests.serving import ARM_SESSION, free_endpoint
from tests.waiting import until

pytestmark = pytest.mark.matrix

CARDAN = [sys.executable, "-m", "cardan"]


@pytest.fixture(autouse=True)
def built():
    if not (FOLDER / "manifest.json").exists():
        pytest.skip("the page is not built: run tools/console")


@contextmanager
def program(*words, **environment):
    """A running cardan command; its lines up to the first with `READY` or `console`."""
    with subprocess.Popen(
        [*CARDAN, *words], stdout=subprocess.PIPE, text=True, env={**os.environ, **environment}
    ) as process:
        try:
            lines = []
            while not lines or not lines[-1].startswith(("READY ", "console ")):
                line = process.stdout.readline()
                assert line, lines
                lines.append(line.rstrip())
            yield lines
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(WAIT_S)


def server(tmp_path, *words, **environment):
    return program(
        "net", "server", "console", "--port", "0", "--router=", *words,
        STATE_DIRECTORY=str(tmp_path), **environment,
    )  # fmt: skip


def test_others_come_by_the_address_that_it_prints_and_by_no_other(tmp_path):
    with server(tmp_path, "--host", "0.0.0.0") as lines:
        fingerprint, ready = lines
        assert fingerprint.startswith("certificate SHA-256 ")
        assert len(fingerprint.split()[-1]) == 32 * 3 - 1
        address, _, token = ready.removeprefix("READY ").partition("#t=")
        assert address.startswith("https://")
        assert len(token) == 32
        context = ssl.create_default_context(cafile=str(tmp_path / "console-certificate.pem"))
        url = f"wss://{address.removeprefix('https://')}ws"
        with connect(f"{url}?t={token}", ssl=context, compression=None) as connection:
            assert PageProgram(connection).begin()["role"] == "operator"
        with pytest.raises(InvalidStatus), connect(url, ssl=context, compression=None):
            pass


def test_a_daemons_console_lists_and_stops_what_it_runs_and_tells_no_token(monkeypatch):
    # tmp_path may be too long for a socket's path.
    with tempfile.TemporaryDirectory(prefix="cardan-test-") as name:
        folder = Path(name)
        monkeypatch.setenv("STATE_DIRECTORY", name)
        path, endpoint = str(folder / "cardan.sock"), free_endpoint()
        (folder / "lab.toml").write_text(
            f'[daemon]\nsocket = "{path}"\nevent_log = "none"\n'
            f'[servers.page]\nserver = "console"\nhost = "0.0.0.0"\nport = 0\nrouter = ""\n'
            f'[servers.other]\nserver = "router"\nendpoint = "{endpoint}"\n'
        )
        command = [*CARDAN, "daemon", "run", str(folder / "lab.toml")]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as daemon:
            try:
                assert daemon.stdout.readline().startswith("READY ")
                with ControlClient(path) as client:
                    until(lambda: client.ask("units", "page")[0]["endpoint"], "the page is served")
                    address = client.ask("units", "page")[0]["endpoint"]
                    token = own_tokens(folder)[1]
                    context = ssl.create_default_context(
                        cafile=str(folder / "console-certificate.pem")
                    )
                    url = f"wss://{address.removeprefix('https://')}ws?t={token}"
                    with connect(url, ssl=context, compression=None) as connection:
                        page = PageProgram(connection)
                        page.begin()
                        page.ask("cardan.daemon", id=1, do="list")
                        rows = page.next("cardan.daemon", id=1)["result"]
                        assert {each["name"] for each in rows} == {"page", "other"}
                        page.ask("cardan.daemon", id=2, do="stop", name="other")
                        assert "other is" in page.next("cardan.daemon", id=2)["result"]
                    stored = json.dumps(client.ask("units")) + json.dumps(rows)
            finally:
                daemon.send_signal(signal.SIGINT)
                stored += daemon.stdout.read()
                daemon.wait(WAIT_S)
        assert "#t=" not in stored
        assert not any(each in stored for each in own_tokens(folder))


def own_tokens(folder):
    """Tokens generated by a server: a viewer's, an operator's and an admin's."""
    lines = (folder / "server-tokens").read_text().splitlines()
    return [line.split()[1] for line in lines if line and not line.startswith("#")]


def test_this_computer_needs_neither(tmp_path):
    with server(tmp_path) as (ready,):
        assert ready.startswith("READY http://127.0.0.1:")
        assert "#" not in ready
    assert list(tmp_path.iterdir()) == []


@pytest.mark.real
def test_a_session_runs_with_its_console(tmp_path):
    pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")
    path = tmp_path / "session.toml"
    path.write_text(ARM_SESSION.format(endpoint=free_endpoint()))
    with program("run", str(path), "--console", STATE_DIRECTORY=str(tmp_path)) as lines:
        url = lines[-1].removeprefix("console http://").rstrip("/")
        with connect(f"ws://{url}/ws", compression=None) as connection:
            page = PageProgram(connection)
            page.begin()
            page.ask(
                "subscribe",
                topic="/left/arm/state/status",
                queue_length=1,
                type="cardan_msgs/msg/ArmStatus",
            )
            assert page.next("publish")["msg"]["phase"]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--console"], "--console: .* has no table .network."),
        (["--console-host", "0.0.0.0"], "--console-host: is the address of --console: give both"),
    ],
)
def test_what_a_session_cannot_show_is_refused(tmp_path, words, why):
    path = tmp_path / "session.toml"
    path.write_text(ARM_SESSION.partition("[network]")[0])
    command = [*CARDAN, "run", str(path), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert re.search(why, done.stderr)
