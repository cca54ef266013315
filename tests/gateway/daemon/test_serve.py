"""``cardan daemon run`` with real sessions and servers, and the client commands."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import urllib.request
from pathlib import Path

import pytest

from cardan.errors import AddressError, MotionLoopError, MotionRefusedError
from cardan.gateway.arm.requests import LATE_S
from cardan.gateway.daemon.client import ControlClient, daemon_arm
from cardan.gateway.daemon.control import Ask
from tests.gateway.daemon.event_files import read_events
from tests.programs import Program
from tests.serving import free_endpoint
from tests.test_cli import ENVIRONMENT
from tests.waiting import STOOD_STILL, WITHIN_S, done_again, until

pytestmark = pytest.mark.matrix  # Whole programs: all time limits are generous.

ARM = """
[[sessions]]
name = "{name}"
robot = {{ driver = "sim_arm", robot = "ur5", period_s = 0.008 }}
{more}
[sessions.arm]
model = "ur5"
"""
HERE = [0.4, 0.1, 0.4, 3.14, 0.0, 0.0]


class Lab:
    """A daemon in a temporary folder."""

    def __init__(self, folder):
        self.folder = folder
        self.file = folder / "lab.toml"
        self.socket = str(folder / "cardan.sock")
        self.program = None

    def write(self, *parts):
        self.file.write_text(
            f'[daemon]\nsocket = "{self.socket}"\nevent_log = "{self.folder}/events"\n'
            + "".join(parts)
        )
        return self

    def start(self):
        self.program = Program("daemon", "run", self.file)
        self.program.wait_for("READY ")
        return self

    def ask(self, *words, **options):
        with ControlClient(self.socket) as client:
            return client.ask(*words, **options)

    def row(self, name):
        return self.ask("units", name)[0]

    def until(self, name, **values):
        """Wait until the row of `name` has these values; return the row."""

        def found():
            row = self.row(name)
            return row if all(row[key] == value for key, value in values.items()) else None

        return until(found, f"{name}: {values}")

    def cardan(self, *words, code=0):
        done = subprocess.run(
            [sys.executable, "-m", "cardan", *words, "--socket", self.socket],
            env=ENVIRONMENT, capture_output=True, text=True, timeout=WITHIN_S, check=False,
        )  # fmt: skip
        assert done.returncode == code, done.stderr
        return done.stdout + done.stderr


def gone(lab, arm, pose):
    """Move to a pose; return the reason if the motion failed, or ""."""
    until(lambda: lab.row("one")["phase"] in ("disarmed", "holding"), "the arm's rest")
    motion = arm.movj(pose)
    arm.wait()
    return motion.reason


@pytest.fixture
def lab():
    # tmp_path may be too long for a socket's path.
    with tempfile.TemporaryDirectory(prefix="cardan-test-") as folder:
        lab = Lab(Path(folder))
        yield lab
        if lab.program is not None:
            lab.program.__exit__()


@pytest.fixture
def one(lab):
    """A lab with one session, disarmed."""
    lab.write(ARM.format(name="one", more="")).start()
    lab.until("one", phase="disarmed")
    return lab


@pytest.mark.real
def test_sessions_run_and_are_listed(lab):
    lab.write(ARM.format(name="one", more=""), ARM.format(name="two", more="start = false")).start()
    row = lab.until("one", phase="disarmed", robot_link="live")
    assert row["state"] == "running"
    assert row["robot"] == "sim_arm"
    assert lab.row("two")["state"] == "stopped"
    text = lab.cardan("daemon", "ps")
    assert "one" in text
    assert "stopped" in text
    assert json.loads(lab.cardan("daemon", "ps", "--json"))[0]["name"] == "one"
    assert "there is no 'three'; there are: one, two" in lab.cardan("daemon", "ps", "three", code=2)


@pytest.mark.real
def test_a_session_that_is_killed_comes_back_disarmed(one):

    def happened():
        return [(each["event"], each["what"]) for each in read_events(one.folder / "events")]

    with daemon_arm("one", path=one.socket) as arm:

        def moves():
            if one.row("one")["phase"] == "moving":
                return True
            # After a pause of the computer a session ends the motion, or refuses one.
            with contextlib.suppress(MotionLoopError, MotionRefusedError):
                arm.movv([0.0, 0.0, 0.001, 0.0, 0.0, 0.0])
            return False

        until(moves, "the motion")
        until(lambda: ("authority", "verbs") in happened(), "the event")
        pid = one.row("one")["pid"]
        os.kill(pid, signal.SIGKILL)
        row = until(lambda: (r := one.row("one"))["pid"] not in (pid, None) and r, "a new process")
        assert row["restarts"] == 1
    one.until("one", phase="disarmed", robot_link="live", authority="")

    def afterwards():
        return happened()[happened().index(("waiting", "session")) :]

    # The event log may lag behind the row.
    until(lambda: {("arm", "disarmed"), ("robot", "live")} <= {*afterwards()}, "the events")
    assert ("authority", "verbs") in happened()[: -len(afterwards())]
    assert [what for event, what in afterwards() if event == "arm"] == ["disarmed"]
    assert "waiting  session: the session's process ended" in one.cardan("daemon", "events", "one")
    until(lambda: "status -9" in one.program.err, "its words in the log")


def test_orders(one):
    assert "one is ending" in one.cardan("daemon", "stop", "one")
    one.until("one", state="stopped", reason="stopped by hand")
    one.cardan("daemon", "start", "one")
    one.until("one", state="running", phase="disarmed")
    before = one.row("one")["pid"]
    one.cardan("daemon", "restart", "one")
    until(lambda: one.row("one")["pid"] not in (before, None), "a new process")


def test_verbs_of_an_arm(one):
    assert "pose" in one.cardan("daemon", "arm", "one", "stat")
    assert "movj: done" in one.cardan("daemon", "arm", "one", "movj", *map(str, HERE), "--wait")
    there = ("0.4", "-0.1", "0.4", "3.14", "-0", "-1e-3")
    assert "movj: done" in one.cardan("daemon", "arm", "one", "movj", *there, "--wait")
    stat = json.loads(one.cardan("daemon", "arm", "one", "stat", "--json"))
    assert -0.11 < stat["pose"][1] < -0.09
    assert "out of reach" in one.cardan("daemon", "arm", "one", "movj", "9", *["0"] * 5, code=4)
    assert "there is no 'fly'" in one.cardan("daemon", "arm", "one", "fly", code=2)
    assert "takes x y z" in one.cardan("daemon", "arm", "one", "movl", "1", code=2)
    one.cardan("daemon", "arm", "one", "set_parameter", "controllerGain", "0.2")
    assert one.cardan("daemon", "arm", "one", "get_parameter", "controllerGain") == "0.2\n"


def test_who_waits_for_a_session_that_is_killed_is_reported_at_once(one):
    with daemon_arm("one", path=one.socket) as arm:
        motion = arm.movv([0.0, 0.0, 0.01, 0.0, 0.0, 0.0])
        os.kill(one.row("one")["pid"], signal.SIGSTOP)
        failed = []

        def wait():
            try:
                arm.movv([0.0, 0.0, -0.01, 0.0, 0.0, 0.0])
            except MotionLoopError as error:
                failed.append(str(error))

        waiting = threading.Thread(target=wait)
        waiting.start()
        until(lambda: arm._pending, "a request that is not answered")
        os.kill(one.row("one")["pid"], signal.SIGKILL)
        waiting.join(WITHIN_S / 2)
        assert not waiting.is_alive()
        assert "one has ended" in failed[0] or "takes no requests" in failed[0]
        until(lambda: motion.over, "its motion's end")
        assert "one has ended" in motion.reason


@pytest.mark.real
def test_a_command_that_is_suspended_moves_nothing(one):
    """As Ctrl-Z does; while it runs, its heartbeat lets the arm go on for longer than a silence."""

    def height_m():
        return json.loads(one.cardan("daemon", "arm", "one", "stat", "--json"))["pose"][2]

    with daemon_arm("one", path=one.socket) as arm:
        done_again(lambda: gone(one, arm, HERE))
    up = ("0", "0", "0.02", "0", "0", "0")

    def suspended():
        before_m = height_m()
        with Program("daemon", "arm", "one", "movv", *up, "--socket", one.socket) as program:
            ended = program.process.poll
            until(lambda: ended() is not None or height_m() > before_m + 0.02, "a second's motion")
            program.process.send_signal(signal.SIGSTOP)
            until(lambda: one.row("one")["phase"] not in ("moving", "braking"), "the arm's rest")
            program.process.send_signal(signal.SIGCONT)
            until(lambda: ended() is not None, "the command's end")
            return "it is suspended" in one.cardan("daemon", "events", "one")

    # A pause of this computer may end the motion earlier.
    until(suspended, "a motion that ended with the suspension")


@pytest.mark.real
def test_a_motion_that_waited_while_its_session_stood_still_is_not_begun(one):
    with daemon_arm("one", path=one.socket) as arm:
        done_again(lambda: gone(one, arm, HERE))
    one.until("one", authority="")
    pid = one.row("one")["pid"]
    with ControlClient(one.socket) as client:
        os.kill(pid, signal.SIGSTOP)
        request = {"id": 1, "source": "verbs", "verb": "movv", "value": [0, 0, 0.01, 0, 0, 0]}
        client.send(Ask(1, "ask", "one", request))
        threading.Event().wait(1.5 * LATE_S)
        os.kill(pid, signal.SIGCONT)
        table = client.receive().value
    assert STOOD_STILL in table["error"]["message"]
    assert one.row("one")["phase"] != "moving"


def test_no_request_ends_the_daemon(one):
    for line in (
        '{"do":"ask","name":"one","value":{"verb":[]}}',
        '{"do":"ask","name":"one","value":{"verb":{"stat":1}}}',
        *(f'{{"do":"ask","name":"one","value":{{"verb":"stat","value":{"[" * n + "]" * n}}}}}'
          for n in (450, 900, 940, 960, 980, 1000, 2000, 30_000)),
        '{"do":"ask","name":"one","value":{"verb":"stat","source":"\\ud800","value":1e999}}',
        '{"do":"stop","name":"\\ud800"}',
        '{"do":"watch","value":1e999}',
        '{"do":"watch","value":NaN}',
        '{"do":"watch","value":%s}' % ("9" * 400),
        '{"do":"switch","name":"one","value":[{}]}',
        '{"do":"events","name":"one","value":{}}',
    ):  # fmt: skip
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(one.socket)
            client.settimeout(WITHIN_S)
            client.sendall(line.replace("{", '{"id":1,', 1).encode() + b"\n")
            assert client.recv(1 << 16).startswith(b'{"id":'), line
    assert one.row("one")["state"] == "running"


@pytest.mark.real
def test_the_end_of_the_daemon_is_the_end_of_its_sessions(one):
    pid = one.row("one")["pid"]
    assert one.program.end(signal.SIGTERM) == 0
    assert not Path(f"/proc/{pid}").exists()
    assert not Path(one.socket).exists()


def test_sessions_leave_when_the_daemon_is_killed_and_the_next_one_starts(one):
    pid = one.row("one")["pid"]
    one.program.end(signal.SIGKILL)
    until(lambda: not Path(f"/proc/{pid}/fd").exists(), "the session's end")
    one.program.__exit__()
    one.start()
    one.until("one", phase="disarmed")


def test_there_is_one_daemon_at_a_socket(one):
    with Program("daemon", "run", one.file) as second:
        assert second.end() == 3
        assert "is a daemon running already?" in second.err
    assert one.row("one")["state"] == "running"


def test_what_cannot_be_started_is_tried_again_and_says_why(lab):
    listening = lab.folder / "busy.toml"
    listening.write_text(
        '[robot]\ndriver = "sim_arm"\nrobot = "ur5"\n[arm]\nmodel = "ur5"\n'
        '[device]\ndriver = "spacemouse"\ntransport = "socket"\npath = "/nowhere/hid"\n'
    )
    lab.write('[[sessions]]\nname = "s"\nfile = "busy.toml"\n').start()
    row = lab.until("s", state="waiting")
    assert "/nowhere/hid" in row["reason"]


LIMITS = "[sessions.limits]\nlinear_speed_m_s = {speed}\nmax_lead_m = {lead}\n"


def test_a_reload_says_each_key_and_restarts_the_session_once_nobody_has_its_arm(one):
    text = one.file.read_text()
    pid = one.row("one")["pid"]
    with daemon_arm("one", path=one.socket) as arm:
        arm.movj(HERE)
        arm.wait()
        arm.movv([0.0, 0.0, 0.001, 0.0, 0.0, 0.0])
        one.until("one", phase="moving")
        one.file.write_text(
            text + LIMITS.format(speed=0.1, lead=0.08) + ARM.format(name="two", more="")
        )
        said = {
            "two: added",
            "one limits.linear_speed_m_s: 0.25 -> 0.1",
            "one limits.max_lead_m: 0.05 -> 0.08",
        }

        def without_waits(lines):
            # On a busy computer the arm may have been stopped by now.
            return {line.removesuffix(" (waits until no source has authority)") for line in lines}

        assert without_waits(one.cardan("daemon", "reload", "--check").splitlines()) == said
        assert [each["name"] for each in one.ask("units")] == ["one"]
        assert without_waits(one.cardan("daemon", "reload").splitlines()) == said
        assert one.row("one")["pid"] == pid
        arm.stop()
        # after the lease of the arm's last source
        until(lambda: one.row("one")["pid"] not in (pid, None), "the new process")
        one.until("one", authority="", phase="disarmed", changes_wait=[])
        assert one.cardan("daemon", "reload") == "nothing has changed\n"
    one.file.write_text(text)
    one.program.process.send_signal(signal.SIGHUP)
    one.until("two", state="stopped", reason="it is not in the files any more")


def test_a_reload_that_is_refused_changes_nothing(one):
    text = one.file.read_text()
    one.file.write_text(
        text.replace('model = "ur5"', 'model = "ur7"') + ARM.format(name="two", more="")
    )
    assert "ur7" in one.cardan("daemon", "reload", code=2)
    assert [each["name"] for each in one.ask("units")] == ["one"]
    refused = one.ask("events", "daemon")[-1]
    assert (refused["event"], refused["what"]) == ("reload refused", "nothing was changed")
    assert "ur7" in refused["why"]


def test_a_change_begins_a_disarmed_session_anew_at_once(one):
    pid = one.row("one")["pid"]
    one.file.write_text(one.file.read_text() + "collisions = false\n")
    (change,) = json.loads(one.cardan("daemon", "reload", "--json"))
    assert (change["key"], change["old"], change["new"]) == ("arm.collisions", True, False)
    assert (change["what"], change["waits"]) == ("changed", "")
    until(lambda: one.row("one")["pid"] not in (pid, None), "the new process")
    one.until("one", phase="disarmed", changes_wait=[])


def test_a_server_runs_and_its_death_harms_no_session(lab):
    port = int(free_endpoint().rpartition(":")[2])
    lab.write(
        ARM.format(name="one", more=""),
        f'[servers.web]\nserver = "rosbridge"\nport = {port}\nrouter = ""\n',
    ).start()
    before = lab.until("one", phase="disarmed")["pid"]
    row = until(lambda: (r := lab.row("web"))["endpoint"] and r, "the server")
    assert row["endpoint"] == f"ws://127.0.0.1:{port}"
    os.kill(row["pid"], signal.SIGKILL)
    until(lambda: lab.row("web")["restarts"] == 1, "its new start")
    assert lab.row("one")["pid"] == before
    assert any("READY" in text for _, name, text, _ in lab.ask("log") if name == "web")


def test_who_asks_where_no_daemon_is():
    with pytest.raises(AddressError, match="cardan daemon run"):
        ControlClient("/nowhere/cardan.sock")


@pytest.mark.real
def test_metrics_and_the_log_of_a_lab(lab):
    parser = pytest.importorskip("prometheus_client.parser", reason="cardan[metrics]")
    lab.write(
        ARM.format(name="one", more=""),
        '[servers.metrics]\nport = 0\n[servers.rosbridge]\nport = 0\nrouter = ""\n',
    ).start()
    lab.until("one", phase="disarmed", robot_link="live")
    endpoint = until(lambda: lab.row("metrics")["endpoint"], "the server of the metrics")

    def figures():
        with urllib.request.urlopen(endpoint, timeout=WITHIN_S) as response:
            text = response.read().decode()
        return {
            (sample.name, *sample.labels.values()): sample.value
            for family in parser.text_string_to_metric_families(text)
            for sample in family.samples
        }

    found = until(
        lambda: ("cardan_server_clients", "rosbridge") in (f := figures()) and f,
        "a server's figures",
    )
    assert found["cardan_server_clients", "rosbridge"] == 0
    assert found["cardan_session_cycles_total", "one"] > 0
    assert found["cardan_cycle_seconds_count", "one"] == found["cardan_session_cycles_total", "one"]
    assert not [line for _, _, line, _ in lab.ask("log") if "FIGURES" in line]
    assert lab.program.end(signal.SIGTERM) == 0
    log = [json.loads(line) for line in lab.program.err.splitlines()]
    assert ("one", "running") in [(each.get("name"), each.get("event")) for each in log]
    assert {"time", "level", "logger", "message"} <= set(log[0])
