"""Replies of the daemon; no process is started."""

import pytest

from cardan.gateway.daemon.config import read_daemon_config
from cardan.gateway.daemon.control import Ask, ControlError
from cardan.gateway.daemon.daemon import (
    GOING_ON,
    LINES_WAITING,
    MAX_CHARACTERS,
    MAX_LINES,
    Daemon,
)
from cardan.gateway.daemon.services import LogLine

LAB = """
[devices.mouse]
driver = "keyboard"
[robots.ur5]
driver = "sim_arm"
robot = "ur5"
"""
SESSION = """
[[sessions]]
name = "{}"
device = "mouse"
robot = "ur5"
start = {}
[sessions.arm]
model = "ur5"
"""


class Asker:
    """A connection that collects its messages."""

    def __init__(self):
        self.reported, self.gone = [], []

    def tell(self, *reported):
        self.reported += reported


def daemon_of(tmp_path, *parts):
    file = tmp_path / "lab.toml"
    file.write_text(LAB + "".join(parts))
    config = read_daemon_config([file])
    return Daemon(config, lambda: config)


def test_a_device_goes_to_nobody_who_does_not_run(tmp_path):
    sessions = SESSION.format("one", "true"), SESSION.format("two", "false")
    daemon = daemon_of(tmp_path, *sessions)
    with pytest.raises(ControlError, match="two is stopped: `cardan daemon start two` first"):
        daemon._do_switch(Ask(1, "switch", "mouse", "two"), Asker())
    with pytest.raises(ControlError, match="no other session that shares mouse runs"):
        daemon._do_switch(Ask(1, "switch", "mouse"), Asker())
    with pytest.raises(ControlError, match="mouse goes to one, two, not to 'three'"):
        daemon._do_switch(Ask(1, "switch", "mouse", "three"), Asker())
    daemon._order(Ask(1, "start", "two"), lambda unit, now_s: unit.start(now_s + 1e6))
    found = daemon._do_switch(Ask(1, "switch", "mouse", "two"), Asker())
    assert found == {"name": "mouse", "from": "one", "to": "two"}


def test_a_connection_has_only_so_many_requests_that_go_on(tmp_path):
    daemon, asker = daemon_of(tmp_path, SESSION.format("one", "false")), Asker()
    for number in range(GOING_ON):
        do = ("watch", "log", "events")[number % 3]
        value = None if do == "watch" else True
        assert getattr(daemon, f"_do_{do}")(Ask(number, do, "", value), asker) is None
    for do, number in (("watch", 99), ("log", 98), ("events", 97)):
        with pytest.raises(ControlError, match="this connection has 16 requests already"):
            getattr(daemon, f"_do_{do}")(Ask(number, do, "", do != "watch" or None), asker)
    other = Asker()
    daemon._do_watch(Ask(0, "watch"), other)
    with pytest.raises(ControlError, match="has a request of id 0"):
        daemon._do_watch(Ask(0, "watch"), other)
    for call in asker.gone:
        call()
    assert len(daemon._watchers) == 1
    assert not daemon._followers


def test_what_is_kept_of_lines_is_bounded(tmp_path):
    daemon = daemon_of(tmp_path, SESSION.format("one", "false"))
    for number in range(MAX_LINES + 10):
        daemon._keep_line(LogLine(0.0, "one", str(number), "info"))
    assert len(daemon._do_log(Ask(1, "log"), Asker())) == MAX_LINES
    for _ in range(MAX_CHARACTERS // 4000 + 10):
        daemon._keep_line(LogLine(0.0, "one", "x" * 4000, "info"))
    stored = daemon._do_log(Ask(1, "log"), Asker())
    assert sum(len(text) for _, _, text, _ in stored) <= MAX_CHARACTERS
    assert stored[-1][2] == "x" * 4000


def test_lines_that_come_too_fast_wait_in_no_endless_queue(tmp_path, caplog):
    daemon = daemon_of(tmp_path, SESSION.format("one", "false"))
    for number in range(LINES_WAITING + 7):
        daemon._say(LogLine(0.0, "one", str(number), "info"))
    assert len(daemon._events) == LINES_WAITING
    daemon._keep_line(LogLine(0.0, "one", "next", "info"))
    assert "7 lines of processes were left out" in caplog.text
