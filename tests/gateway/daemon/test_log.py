"""The daemon's log keeps the levels of its processes' lines, and contains no secrets."""

import http.client
import json
import signal
import tempfile
from pathlib import Path

import pytest

from cardan.gateway.daemon.client import ControlClient
from tests.gateway.daemon.event_files import read_events
from tests.programs import Program
from tests.waiting import WITHIN_S, until

pytestmark = pytest.mark.matrix

RIGHT, WRONG = "right-token-0123456789abcdef", "wrong-token-0123456789abcdef"


@pytest.fixture
def folder():
    with tempfile.TemporaryDirectory(prefix="cardan-test-") as folder:
        yield Path(folder)


def get(port, path, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=WITHIN_S)
    connection.request("GET", path, headers=headers)
    status = connection.getresponse().status
    connection.close()
    return status


@pytest.mark.parametrize("level", ["debug", "warning"])
def test_levels_are_kept_and_tokens_are_nowhere(folder, level):
    pytest.importorskip("prometheus_client", reason="cardan[metrics]")
    token = folder / "token"
    token.write_text(f"viewer {RIGHT}\n")
    token.chmod(0o600)
    file, socket = folder / "lab.toml", str(folder / "sock")
    file.write_text(
        f'[daemon]\nsocket = "{socket}"\nevent_log = "{folder}/events"\n'
        f'[servers.metrics]\nport = 0\ntoken_file = "{token}"\n'
    )
    with Program("daemon", "run", file, "--log-level", level, "--log-format", "json") as program:
        program.wait_for("READY ")

        def row():
            with ControlClient(socket) as client:
                return client.ask("units", "metrics")[0]

        port = int(until(lambda: row()["endpoint"], "the server").rpartition(":")[2].split("/")[0])
        assert get(port, f"/metrics?t={RIGHT}") == 200
        assert get(port, "/metrics", Authorization=f"Bearer {RIGHT}") == 200
        assert get(port, f"/metrics?t={WRONG}") == 401
        assert get(port, f"/{RIGHT}?t={WRONG}") == 401
        program.wait_for("was refused", "stderr")
        with ControlClient(socket) as client:
            stored = client.ask("log")
        words = Path(f"/proc/{row()['pid']}/cmdline").read_bytes().decode()
        assert program.end(signal.SIGTERM) == 0
    log = [json.loads(line) for line in program.err.splitlines()]
    denied = [each for each in log if "was refused" in each["message"]]
    assert [(each["name"], each["level"]) for each in denied] == [("metrics", "warning")] * 2
    assert {of for _, _, said, of in stored if "was refused" in said} == {"warning"}
    levels = {each["level"] for each in log if each.get("event") == "said"}
    assert levels == ({"debug", "info", "warning"} if level == "debug" else {"warning"})
    everything = program.err + program.out + json.dumps(stored) + words
    everything += json.dumps(list(read_events(folder / "events")))
    assert RIGHT not in everything
    assert WRONG not in everything
