"""Requests in transit through the daemon, also when a client or session ends; without processes."""

import contextlib
import itertools
import json
import socket
import time
from collections import deque

import pytest

from cardan.gateway.arm.backlog import BACKLOGGED, BACKLOGGED_S, STALE_S
from cardan.gateway.arm.requests import LATE_S
from cardan.gateway.daemon import server as serving
from cardan.gateway.daemon.client import ControlClient
from cardan.gateway.daemon.config import read_daemon_config
from cardan.gateway.daemon.control import CLIENT_SILENCE_S, Ask, LineReader, decode_response
from cardan.gateway.daemon.daemon import Daemon
from cardan.gateway.daemon.processes import RunningSession
from cardan.gateway.daemon.restart_policy import Ended
from cardan.gateway.daemon.server import ControlConnection, ControlServer
from cardan.gateway.daemon.services import _ended
from cardan.gateway.session.snapshot import Snapshot

SESSION = """
[daemon]
event_log = "none"
[[sessions]]
name = "one"
robot = { driver = "sim_arm", robot = "ur5", period_s = 0.008 }
[sessions.arm]
model = "ur5"
"""


class Session(RunningSession):
    """A session's process that the test controls."""

    def __init__(self):
        self.snapshot = Snapshot.of({"arm": {"phase": "disarmed"}})
        self.sent = []
        self.reads = True

    def send(self, packet):
        if not self.reads:
            raise BlockingIOError(11, "Resource temporarily unavailable")
        self.sent.append(json.loads(packet))


class Bench:
    """A daemon with a session, and a connected client."""

    def __init__(self, folder):
        file = folder / "lab.toml"
        file.write_text(SESSION)
        self.daemon = Daemon(read_daemon_config([file]), lambda: None)
        self.service = self.daemon._services["one"]
        self.session = self.service.process = Session()
        self.service.unit.begun(0.0)
        self.theirs, ours = socket.socketpair()
        self.theirs.settimeout(5.0)
        ours.setblocking(False)
        self.connection = ControlConnection(ours)
        self._reader, self._lines = LineReader(), []

    def ask(self, verb, number=7, **more):
        request = {"id": number, "source": "a", "verb": verb, **more}
        if verb in ("movl", "movv"):
            request["value"] = [0.0, 0.0, 0.01, 0.0, 0.0, 0.0]
        self.daemon._handle(Ask(number, "ask", "one", request), self.connection)

    def answers(self, **result):
        """Let the session reply to the newest request."""
        table = {"reply": self.session.sent[-1]["id"], "result": result}
        self.service.answered(json.dumps(table).encode())

    def begins(self, verb):
        """Let the session begin the requested motion."""
        note = {"id": 3, "verb": verb, "source": "a", "ends": verb != "movv", "reason": ""}
        self.answers(**note, note="", duration_s=0.0, outcome="running")
        self.daemon._end_of_left()

    def leaves(self):
        """Disconnect the client, as the server detects it."""
        self.connection.open = False
        for call in self.connection.gone:
            call()
        self.daemon._end_of_left()

    def heard(self):
        while not self._lines:
            self._lines = self._reader.take(self.theirs.recv(65536))
        return decode_response(self._lines.pop(0))

    @property
    def asked(self):
        return [each["verb"] for each in self.session.sent]


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path)
    yield bench
    bench.theirs.close()
    bench.connection.sock.close()


def test_a_request_and_its_answer_keep_their_numbers(bench):
    bench.ask("stat")
    bench.answers(pose=[0.0] * 6)
    reported = bench.heard()
    assert (reported.id, reported.kind, reported.value["reply"]) == (7, "result", 7)


@pytest.mark.parametrize(("verb", "stops"), [("movv", True), ("movl", False)])
def test_who_leaves_takes_a_motion_without_an_end_along(bench, verb, stops):
    bench.ask(verb)
    bench.begins(verb)
    bench.leaves()
    assert bench.asked == [verb, *(["stop"] if stops else [])]


@pytest.mark.parametrize(("verb", "stops"), [("movv", True), ("movl", False)])
def test_also_who_has_left_before_it_began(bench, verb, stops):
    bench.ask(verb)
    bench.leaves()
    bench.begins(verb)
    assert bench.asked == [verb, *(["stop"] if stops else [])]


@pytest.mark.parametrize(("verb", "stops"), [("movv", True), ("movl", False)])
def test_a_suspended_client_loses_a_motion_without_an_end(bench, verb, stops):
    bench.ask(verb)
    bench.begins(verb)
    bench.heard()
    began_s = bench.connection.heard_s = bench.daemon._motions["one", 3].since_s
    for silent_s, stopped in ((CLIENT_SILENCE_S, False), (CLIENT_SILENCE_S + 0.01, stops)):
        bench.connection.empty_s = began_s + silent_s
        bench.daemon._end_of_left()
        assert bench.asked == [verb, *(["stop"] if stopped else [])]
    bench.daemon._end_of_left()
    assert bench.asked.count("stop") == int(stops)
    # It is still connected, and learns how its motion ended.
    note = {"id": 3, "verb": verb, "outcome": "stopped", "reason": "stopped by daemon"}
    bench.service.answered(json.dumps({"motion": note}).encode())
    assert bench.heard().value["motion"] == note
    said = [each.why for each in bench.daemon._recent if each.event == "message"]
    assert [each.startswith("nothing came from its program for 0.5 s") for each in said] == [
        True
    ] * stops


@pytest.mark.parametrize("suspended", [True, False])
def test_a_stop_that_the_session_does_not_take_is_tried_again(bench, suspended):
    bench.ask("movv")
    bench.begins("movv")
    bench.session.reads = False
    if suspended:
        bench.connection.heard_s = bench.daemon._motions["one", 3].since_s
        bench.connection.empty_s = bench.connection.heard_s + 2 * CLIENT_SILENCE_S
    else:
        bench.leaves()
    for _ in range(3):
        bench.daemon._end_of_left()
    bench.session.reads = True
    for _ in range(3):
        bench.daemon._end_of_left()
    assert bench.asked == ["movv", "stop"]


def test_a_client_that_leaves_ends_no_motion_of_the_same_number_after_a_restart(bench):
    """A session that is restarted counts its motions anew."""
    theirs, ours = socket.socketpair()
    with theirs:
        bench.ask("movv")
        bench.begins("movv")
        bench.service.process = None
        bench.service.unit.ended(Ended.DIED, "it was killed", 1.0)
        bench.service.gone("it was killed")
        bench.session = bench.service.process = Session()
        before, bench.connection = bench.connection, ControlConnection(ours)
        bench.ask("movv", 8)
        bench.begins("movv")
        before.open = False
        bench.daemon._end_of_left()
        assert bench.asked == ["movv"]
        before.sock.close()


def test_the_silence_of_a_client_begins_with_the_answer_about_its_motion(bench):
    """A motion may wait for another one to brake; and what a paused daemon has not read yet
    is no silence."""
    bench.ask("movv")
    bench.connection.heard_s -= 60.0
    bench.begins("movv")
    bench.daemon._end_of_left()
    bench.connection.heard_s -= 60.0
    bench.connection.empty_s = bench.connection.heard_s
    bench.daemon._end_of_left()
    assert bench.asked == ["movv"]


def test_what_a_session_owes_when_it_ends_is_reported(bench):
    bench.ask("movl", 7)
    bench.begins("movl")
    bench.heard()
    bench.ask("stat", 8)
    bench.service.process = None
    bench.service.unit.ended(Ended.DIED, "it was killed", 1.0)
    bench.service.gone("it was killed")
    refused, ended = bench.heard(), bench.heard()
    assert (refused.id, refused.kind) == (8, "error")
    assert "one has ended: it was killed" in refused.value
    assert (ended.id, ended.kind) == (7, "event")
    note = ended.value["motion"]
    assert (note["id"], note["outcome"]) == (3, "aborted")
    assert "it was killed" in note["reason"]
    assert not bench.daemon._routes
    assert not bench.daemon._motions


def test_a_session_that_starts_or_does_not_read_takes_no_requests(bench):
    bench.session.snapshot = Snapshot()
    bench.ask("stat")
    assert bench.heard().value == "one is starting"
    bench.session.snapshot = Snapshot.of({"arm": {"phase": "disarmed"}})
    bench.session.reads = False
    bench.ask("stat")
    assert "it hangs" in bench.heard().value
    assert bench.asked == []


def test_a_daemon_that_stood_still_passes_no_motion_on(bench):
    bench.connection.since_s = time.monotonic() - 2 * LATE_S
    for verb in ("movl", "twist", "trajectory"):
        bench.ask(verb)
        assert "the daemon stalled for" in bench.heard().value
    bench.ask("stop")
    assert bench.asked == ["stop"]


def test_a_streamed_command_that_may_have_waited_is_not_passed_on(bench):
    bench.connection.since_s = time.monotonic() - 2 * STALE_S
    bench.ask("twist")
    assert "send less often" in bench.heard().value
    bench.ask("movl")
    bench.ask("stop")
    assert bench.asked == ["movl", "stop"]


def test_the_session_is_reported_since_when_a_request_can_have_waited(bench):
    """A time given by the client is ignored."""
    for number, verb in enumerate(("twist", "movl")):
        bench.connection.since_s = time.monotonic() - 0.1 * STALE_S
        bench.ask(verb, number, since=0.0)
        assert bench.session.sent[-1]["since"] == bench.connection.since_s


class Flood:
    """A socket with more data at every read; also the server's clock."""

    def __init__(self):
        self.now_s = 100.0
        self.reported = bytearray()
        line = b'{"id":1,"do":"units"}\n'
        self._bytes = itertools.cycle(line)

    def recv(self, count):
        return bytes(itertools.islice(self._bytes, count))

    def send(self, data):
        self.reported += data
        return len(data)

    def monotonic(self):
        return self.now_s


@pytest.fixture
def flooded(tmp_path, monkeypatch):
    """A server, the connection of a client that floods it, and its socket."""
    flood = Flood()
    monkeypatch.setattr(serving, "time", flood)
    with contextlib.closing(ControlServer(str(tmp_path / "sock"), "", lambda *_: None)) as server:
        yield server, ControlConnection(flood), flood


def floods(flooded, seconds):
    """Read repeatedly while connected; return the time for which that was."""
    server, connection, flood = flooded
    began_s = flood.now_s
    while connection.open and flood.now_s < began_s + seconds:
        server._read(connection)
        connection.asked.clear()
        flood.now_s += 0.01
    return flood.now_s - began_s


def test_who_sends_more_than_can_be_handled_is_let_go_with_the_reason(flooded):
    _, connection, flood = flooded
    most_s = STALE_S + BACKLOGGED_S
    assert floods(flooded, 2 * most_s) == pytest.approx(most_s, abs=0.05)
    assert not connection.open
    assert decode_response(bytes(flood.reported).splitlines()[-1]).value == BACKLOGGED


def test_a_backlog_that_was_worked_off_is_forgotten(flooded):
    _, connection, flood = flooded
    for _ in range(2):
        floods(flooded, STALE_S + 0.9 * BACKLOGGED_S)
        assert connection.open
        # a read that did not fill its buffer
        connection.empty_s = flood.now_s
        floods(flooded, 0.02)
    assert not flood.reported


def test_it_is_known_since_when_a_request_can_have_waited(tmp_path):
    asked = []
    server = ControlServer(
        str(tmp_path / "sock"), "", lambda _ask, asker: asked.append(asker.since_s)
    )
    with contextlib.closing(server), ControlClient(server.path) as client:
        server.poll(0.0)
        server.poll(0.0)
        empty_s = time.monotonic()
        client.send(Ask(1, "units"))
        stopped_s = time.monotonic()
        client.send(Ask(2, "units"))
        server.poll(0.0)
        assert len(asked) == 2
        assert all(each <= empty_s for each in asked)
        server.poll(0.0)
        client.send(Ask(3, "units"))
        server.poll(0.0)
        assert asked[2] >= stopped_s


def test_what_a_session_did_last_is_reported_though_its_process_has_ended(bench, monkeypatch):
    """The end of the process is reported too, although the daemon looks again only when the next
    process is due."""
    bench.daemon._find_events()
    bench.session.snapshot = Snapshot.of({"arm": {"phase": "moving", "authority": "a"}})
    _ended(bench.service, Ended.DIED, "killed")
    monkeypatch.setattr(
        bench.service, "begin", lambda *_: setattr(bench.service, "process", Session())
    )
    bench.daemon._look_after(time.monotonic() + 10.0)
    bench.daemon._find_events()
    assert [(each.event, each.what) for each in bench.daemon._recent] == [
        ("running", "session"),
        ("arm", "disarmed"),
        ("authority", "a"),
        ("arm", "moving"),
        ("waiting", "session"),
        ("running", "session"),
        ("arm", "disarmed"),
    ]


def test_nothing_counts_as_empty_that_was_looked_at_before_the_daemon_stood_still(
    flooded, monkeypatch
):
    """epoll then reports a timeout, without any readable socket."""
    server, connection, flood = flooded
    connection.asked, connection.sock = deque(), flood
    monkeypatch.setattr(server, "_connections", {7: connection})
    monkeypatch.setattr(server, "_answer_some", lambda _: None)
    monkeypatch.setattr(server, "_look_at", lambda _: None)
    for stood_still_s in (0.0, 1.0):
        looked_s = flood.now_s

        def select(timeout_s, stood_still_s=stood_still_s):
            flood.now_s += timeout_s + stood_still_s
            return []

        monkeypatch.setattr(server._selector, "select", select)
        server.poll(0.1)
        assert connection.empty_s == (looked_s if stood_still_s else flood.now_s)
    server._connections.clear()
