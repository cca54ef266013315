"""A reload by the daemon, with simulated sessions."""

import errno
import time
from types import SimpleNamespace

import pytest

from cardan.common.inbox import InboxEmptyError
from cardan.errors import CardanError, ConfigurationError
from cardan.gateway.daemon import services
from cardan.gateway.daemon.changes import Change, of_session
from cardan.gateway.daemon.config import read_daemon_config, read_daemon_config_in_subprocess
from cardan.gateway.daemon.control import ControlError
from cardan.gateway.daemon.daemon import Daemon
from cardan.gateway.daemon.processes import RunningSession
from cardan.gateway.daemon.restart_policy import Ended
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.snapshot import Snapshot

SESSION = """
[[sessions]]
name = "{name}"
robot = {{ driver = "sim_arm", robot = "ur5" }}
[sessions.arm]
model = "ur5"
[sessions.limits]
linear_speed_m_s = {speed}
"""


class Response(RunningSession):
    """A running session without a process."""

    def __init__(self, config, say, over, answered, has_device=True, router_promised=None):
        self.config, self.over, self.has_device = config, over, has_device
        self.router_promised = router_promised
        self.snapshot = Snapshot.of(
            {"arm": {"phase": "moving", "authority": "verbs"}, "device": {"held": has_device}}
        )
        self.due_s = time.monotonic()
        self.reported = []
        self.ended = False

    pid = 4711

    def send(self, packet):
        self.reported.append(packet)

    def stop(self):
        self.ended = True


class Lab:
    def __init__(self, folder, monkeypatch):
        monkeypatch.setattr(services, "RunningSession", Response)
        self.file = folder / "lab.toml"
        self.write(one=0.25, two=0.25)
        self.daemon = Daemon(
            read_daemon_config([self.file]), lambda: read_daemon_config([self.file])
        )
        self.daemon._look_after(time.monotonic())
        self.reported = []

    def write(self, **speeds):
        self.file.write_text(
            "".join(SESSION.format(name=name, speed=speed) for name, speed in speeds.items())
        )

    def service(self, name):
        return self.daemon._services[name]

    def session(self, name):
        return self.service(name).process

    def changes(self, **speeds):
        """Write the file and reload it; return the outcome."""
        self.write(**speeds)
        return self.reload()

    def reload(self, check_only=False):
        """Reload; return the outcome, or None if the reload is still in progress."""
        self.reported = []
        self.daemon.reload(self.reported.append, check_only)
        self.turn(wait_s=30.0)
        return self.reported[0] if self.reported else None

    def turn(self, wait_s=0.0):
        try:
            while True:
                self.daemon._events.get(wait_s)()
                wait_s = 0.0
        except InboxEmptyError:
            pass

    def rest(self, name, phase="disarmed"):
        """Show the daemon that no source has authority over a session's arm."""
        self.session(name).snapshot = Snapshot.of({"arm": {"phase": phase}})
        self.look()

    def look(self):
        self.daemon._look_after(time.monotonic())

    def end(self, name, how=Ended.AS_ASKED, reason=""):
        """End the process of a session, which the daemon restarts if necessary."""
        self.session(name).over(how, reason)
        self.turn()
        self.look()

    def speed(self, name):
        """Return the speed limit of the running process, m/s."""
        return self.session(name).config.limits.linear_speed_m_s

    def row(self, name):
        return self.service(name).shown(time.monotonic())


@pytest.fixture
def lab(tmp_path, monkeypatch):
    return Lab(tmp_path, monkeypatch)


def words(outcome):
    assert not isinstance(outcome, CardanError), outcome
    return [each.in_words for each in outcome]


def test_the_watchdog_is_fed_while_no_session_is_overdue(lab):
    lab.session("one").due_s, lab.session("two").due_s = 100.0, 99.0
    assert lab.daemon._all_answer(99.0)
    assert not lab.daemon._all_answer(99.1)


WAITS = " (waits until no source has authority)"


def test_a_session_is_restarted_once_nobody_has_its_arm(lab):
    lab.write(one=0.1, two=0.25)
    before, other = lab.session("one"), lab.session("two")
    assert words(lab.reload()) == [f"one limits.linear_speed_m_s: 0.25 -> 0.1{WAITS}"]
    assert lab.row("one")["changes_wait"] == ["limits.linear_speed_m_s"]
    assert lab.row("two")["changes_wait"] == []
    lab.look()
    assert not before.ended
    lab.rest("one")
    assert before.ended
    assert lab.service("one").unit.reason == "its configuration has changed"
    lab.end("one")
    assert lab.session("one") is not before
    assert lab.speed("one") == 0.1
    assert lab.row("one")["changes_wait"] == []
    lab.session("one").snapshot = Snapshot.of({"arm": {"phase": "disarmed"}})
    lab.rest("two")
    assert lab.session("two") is other
    assert not other.ended


@pytest.mark.parametrize(
    ("phase", "authority", "waits"),
    [
        ("", "", False),
        ("no robot", "", False),
        ("disarmed", "", False),
        ("disarmed", "verbs", True),
        ("holding", "", False),
        ("holding", "device", True),
        ("moving", "device", True),
        ("moving", "", True),
        ("braking", "", True),
        ("recovering", "", True),
    ],
)
def test_a_restart_waits_while_somebody_has_the_arm_or_it_moves(lab, phase, authority, waits):
    lab.session("one").snapshot = Snapshot.of({"arm": {"phase": phase, "authority": authority}})
    lab.write(one=0.1, two=0.25)
    reported = words(lab.reload())
    assert reported == ["one limits.linear_speed_m_s: 0.25 -> 0.1" + (WAITS if waits else "")]
    lab.look()
    assert lab.session("one").ended is not waits


def test_a_check_changes_nothing(lab):
    lab.write(one=0.1, two=0.25, three=0.1)
    assert words(lab.reload(check_only=True)) == [
        f"one limits.linear_speed_m_s: 0.25 -> 0.1{WAITS}",
        "three: added",
    ]
    lab.rest("one")
    assert not lab.session("one").ended
    assert "three" not in lab.daemon._services
    assert lab.row("one")["changes_wait"] == []


def test_an_error_in_one_file_is_the_refusal_of_all(lab):
    lab.write(one=0.1, two=0.4, three=0.1)
    lab.file.write_text(lab.file.read_text().replace('model = "ur5"', 'model = "ur7"', 1))
    outcome = lab.reload()
    assert isinstance(outcome, ConfigurationError)
    assert "ur7" in str(outcome)
    for name in ("one", "two"):
        lab.rest(name)
        assert not lab.session(name).ended
        assert lab.daemon.config.sessions[name].config.limits.linear_speed_m_s == 0.25
    assert "three" not in lab.daemon._services


def test_one_reload_at_a_time(lab):
    lab.daemon.reload(lab.reported.append)
    with pytest.raises(ControlError, match="a reload is under way"):
        lab.daemon.reload(lab.reported.append)
    lab.turn(wait_s=30.0)
    assert lab.reported == [[]]


def test_of_two_reloads_the_newest_counts(lab):
    lab.changes(one=0.1, two=0.25)
    assert words(lab.changes(one=0.2, two=0.1)) == [
        f"one limits.linear_speed_m_s: 0.25 -> 0.2{WAITS}",
        f"two limits.linear_speed_m_s: 0.25 -> 0.1{WAITS}",
    ]
    assert words(lab.reload()) == [
        f"one limits.linear_speed_m_s: 0.25 -> 0.2{WAITS}",
        f"two limits.linear_speed_m_s: 0.25 -> 0.1{WAITS}",
    ]
    lab.rest("one")
    lab.end("one")
    assert lab.speed("one") == 0.2
    assert not lab.session("two").ended


def test_a_reload_while_a_session_ends_for_one_before(lab):
    lab.changes(one=0.1, two=0.25)
    lab.rest("one")
    assert lab.session("one").ended
    lab.changes(one=0.2, two=0.25)
    lab.look()
    lab.end("one")
    assert lab.speed("one") == 0.2
    assert lab.row("one")["changes_wait"] == []
    lab.rest("one")
    assert not lab.session("one").ended


def test_what_changes_back_while_it_waits_is_nothing_to_do(lab):
    before = lab.file.read_text()
    lab.changes(one=0.1, two=0.25)
    lab.file.write_text(before)
    assert words(lab.reload()) == ["one limits.linear_speed_m_s: taken back"]
    assert lab.row("one")["changes_wait"] == []
    lab.rest("one")
    assert not lab.session("one").ended
    assert words(lab.reload()) == []


def test_a_removal_that_is_taken_back_while_it_waits_is_nothing_to_do(lab):
    before = lab.file.read_text()
    assert words(lab.changes(one=0.25)) == [f"two: removed{WAITS}"]
    assert lab.row("two")["changes_wait"] == ["removed"]
    assert words(lab.reload()) == []
    lab.look()
    assert not lab.session("two").ended
    lab.file.write_text(before)
    assert words(lab.reload()) == ["two removed: taken back"]
    lab.rest("two")
    assert not lab.session("two").ended
    assert lab.row("two")["state"] == "running"


def test_a_session_that_dies_while_it_waits_begins_with_the_new_file(lab):
    lab.changes(one=0.1)
    for name in ("one", "two"):
        lab.end(name, Ended.DIED, "killed")
    assert lab.row("two")["state"] == "stopped"
    assert lab.row("one")["state"] == "waiting"
    lab.daemon._look_after(time.monotonic() + 60.0)
    assert lab.speed("one") == 0.1
    assert lab.row("one")["changes_wait"] == []


def test_a_session_that_cannot_begin_with_its_new_file_says_so_and_harms_no_other(lab):
    lab.changes(one=0.1, two=0.1)
    lab.rest("one")
    lab.end("one")
    why = "mapping.deadman: the device has no button 'z'"
    lab.end("one", Ended.MISCONFIGURED, why)
    assert (lab.row("one")["state"], lab.row("one")["reason"]) == ("failed", why)
    assert lab.row("two")["state"] == "running"
    assert not lab.session("two").ended
    lab.rest("two")
    lab.end("two")
    assert lab.speed("two") == 0.1


def test_a_session_that_does_not_run_takes_it_with_its_start(lab):
    lab.service("one").unit.stop(time.monotonic())
    lab.end("one")
    assert words(lab.changes(one=0.4, two=0.25)) == [
        "one limits.linear_speed_m_s: 0.25 -> 0.4 (waits until it starts)"
    ]
    lab.look()
    assert lab.session("one") is None
    assert lab.row("one")["changes_wait"] == []
    lab.service("one").unit.start(time.monotonic())
    lab.look()
    assert lab.speed("one") == 0.4


def test_what_leaves_the_files_stops_and_starts_when_it_is_back(lab):
    lab.rest("two")
    assert words(lab.changes(one=0.25)) == ["two: removed"]
    lab.look()
    assert lab.session("two").ended
    lab.end("two")
    assert lab.row("two")["reason"] == "it is not in the files any more"
    assert words(lab.changes(one=0.25, two=0.1)) == ["two: added"]
    lab.look()
    assert lab.speed("two") == 0.1


def test_a_session_that_had_failed_is_tried_again_with_what_has_changed(lab):
    lab.end("one", Ended.MISCONFIGURED, "mapping.deadman: ...")
    lab.changes(one=0.25, two=0.1)
    assert lab.row("one")["state"] == "failed"
    lab.changes(one=0.1, two=0.1)
    lab.look()
    assert lab.row("one")["state"] == "running"
    assert lab.speed("one") == 0.1


def test_what_is_written_otherwise_and_means_the_same_is_no_change(lab):
    lab.file.write_text(lab.file.read_text().replace('"ur5" }', '"ur5", seed = 0 }', 1))
    assert words(lab.reload()) == []
    lab.rest("one")
    assert not lab.session("one").ended


SHARED = """
[devices.mouse]
driver = "spacemouse"
"""


def test_who_has_a_shared_device_keeps_it_until_it_is_restarted_without_it(lab):
    both = lab.file.read_text().replace("[sessions.arm]", 'device = "mouse"\n[sessions.arm]')
    for name in ("one", "two"):
        lab.rest(name)
    lab.file.write_text(SHARED + both)
    assert [each[:3] for each in lab.reload()] == [
        ("one", "device", "changed"),
        ("two", "device", "changed"),
    ]
    lab.look()
    for name in ("one", "two"):
        lab.end(name)
    assert [lab.session(name).has_device for name in ("one", "two")] == [True, False]
    lab.file.write_text(SHARED + both.replace("0.25", "0.1", 1))
    lab.rest("one")
    lab.reload()
    lab.look()
    assert lab.session("one").ended
    lab.daemon._pass_devices()
    lab.end("one")
    lab.daemon._pass_devices()
    assert [lab.session(name).has_device for name in ("one", "two")] == [True, False]
    assert not lab.session("two").reported
    one = lab.session("one")
    one.snapshot = Snapshot.of(
        {"arm": {"phase": "moving", "authority": "device"}, "device": {"held": True}}
    )
    lab.file.write_text(SHARED + both.replace('device = "mouse"\n', "", 1))
    lab.reload()
    lab.daemon._pass_devices()
    assert lab.daemon._shared["mouse"].sessions == ("one", "two")
    assert not lab.session("two").reported
    one.snapshot = Snapshot.of({"arm": {"phase": "disarmed"}, "device": {"held": True}})
    lab.look()
    lab.end("one")
    assert "mouse" not in lab.daemon._shared


def test_who_had_a_device_alone_keeps_it_when_another_one_comes_to_share_it(lab):
    alone = lab.file.read_text().replace("[sessions.arm]", 'device = "mouse"\n[sessions.arm]', 1)
    lab.rest("one")
    lab.file.write_text(SHARED + alone)
    lab.reload()
    lab.look()
    lab.end("one")
    first = SESSION.format(name="zero", speed=0.25).replace(
        "[sessions.arm]", 'device = "mouse"\n[sessions.arm]'
    )
    lab.file.write_text(SHARED + first + alone)
    assert words(lab.reload()) == ["zero: added"]
    lab.look()
    assert not lab.session("zero").has_device
    lab.daemon._pass_devices()
    assert not lab.session("one").reported


def test_sessions_run_no_router_where_a_server_of_the_daemon_is_to(lab, monkeypatch):
    monkeypatch.setattr(services, "RunningServer", lambda *_given: SimpleNamespace(stop=int))
    promised, address = lab.session("one").router_promised, ("127.0.0.1", 7999)
    assert not promised(address)
    with lab.file.open("a") as file:
        file.write('[servers.router]\nendpoint = "tcp/0.0.0.0:7999"\n')
    lab.reload()
    lab.look()
    assert promised(address)
    assert not promised(("127.0.0.1", 7447))
    lab.service("router").unit.stop(time.monotonic())
    lab.look()
    assert not promised(address)


def test_what_keeps_the_files_from_being_read_is_said(lab, monkeypatch):
    def read():
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(lab.daemon, "_read", read)
    assert "too many files are open" in str(lab.reload())
    monkeypatch.undo()
    assert words(lab.reload()) == []


def test_what_the_files_say_wrong_is_refused(lab):
    lab.file.write_text("[demon]\n")
    assert "demon: there is no such key" in str(lab.reload())
    lab.write(one=0.25)
    lab.file.write_text(lab.file.read_text() + '[servers.two]\nserver = "rosbridge"\n')
    assert "was a session and is a server now" in str(lab.reload())
    lab.file.write_text("[daemon]\nstart_limit = 3\n" + SESSION.format(name="one", speed=0.1))
    assert "restart the daemon" in str(lab.reload())
    lab.rest("one")
    assert not lab.session("one").ended


BASE = {
    "robot": {"driver": "sim_arm", "robot": "ur5"},
    "arm": {"model": "ur5"},
    "device": {"driver": "spacemouse"},
    "mapping": {"deadman": "left"},
}


@pytest.mark.parametrize(
    ("new", "found"),
    [
        ({}, {}),
        ({"limits": {"linear_speed_m_s": 0.25}}, {}),
        (
            {"limits": {"linear_speed_m_s": 0.1, "workspace_x_m": [-1.0, 1.0]}},
            {
                "limits.linear_speed_m_s": (0.25, 0.1),
                "limits.workspace_x_m": (None, [-1.0, 1.0]),
            },
        ),
        ({"arm": {"model": "ur10"}}, {"arm.model": ("ur5", "ur10")}),
        (
            {"device": {"driver": "spacemouse", "dead_zone": 0.2, "serial": "A1"}},
            {"device.dead_zone": (0.05, 0.2), "device.serial": ("", "A1")},
        ),
        ({"device": {"driver": "keyboard"}}, {"device.driver": ("spacemouse", "keyboard")}),
        ({"mapping": {"deadman": ["left", "right"]}}, {
            "mapping.deadman": ("left", ["left", "right"]),
        }),
    ],
)  # fmt: skip
def test_the_keys_that_differ(new, found):
    old = parse_config(BASE)
    changes = list(of_session("one", old, parse_config(BASE | new), "x", ()))
    assert {each.key: (each.old, each.new) for each in changes} == found
    assert all((each.name, each.what, each.waits) == ("one", "changed", "x") for each in changes)


def test_a_table_that_comes_or_goes_is_one_change():
    one = parse_config(BASE)
    other = parse_config(BASE | {"network": {}})
    for old, new in ((one, other), (other, one)):
        assert [each.key for each in of_session("one", old, new, "", ())] == ["network"]
    assert [each.key for each in of_session("one", one, one, "", ("network",))] == ["network"]


def test_changes_are_reported_in_words():
    change = Change("one", "mapping.deadman", "changed", "left", ["a", "b"], "x")
    assert change.in_words == 'one mapping.deadman: "left" -> ["a", "b"] (waits x)'
    assert Change("one", "network", "changed").in_words.endswith("none -> none")


@pytest.mark.matrix
def test_files_are_read_in_a_process_of_their_own(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text(SESSION.format(name="one", speed=0.1))
    assert read_daemon_config_in_subprocess([file]) == read_daemon_config([file])
    file.write_text("[demon]\n")
    with pytest.raises(ConfigurationError, match="demon: there is no such key"):
        read_daemon_config_in_subprocess([file])
