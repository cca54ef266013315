"""A reload by the daemon, with sessions that answer as they are told."""

import errno
import time

import pytest

from cardan.errors import CardanError, ConfigurationError
from cardan.gateway.daemon import daemon as daemon_module, kept
from cardan.gateway.daemon.changes import Change
from cardan.gateway.daemon.control import ControlError
from cardan.gateway.daemon.daemon import Daemon
from cardan.gateway.daemon.keeping import Ended
from cardan.gateway.daemon.layout import read_layout, read_layout_beside
from cardan.gateway.daemon.processes import RunningSession
from cardan.gateway.session.changes import Effect, Moment, staged
from cardan.gateway.session.reloading import Found, ReloadOrder
from cardan.gateway.session.snapshot import Snapshot
from cardan.inbox import InboxEmptyError

SESSION = """
[[sessions]]
name = "{name}"
robot = {{ driver = "sim_arm", robot = "ur5" }}
[sessions.arm]
model = "ur5"
[sessions.limits]
linear_speed_m_s = {speed}
"""


class Answering(RunningSession):
    """A session that runs, without a process."""

    def __init__(self, config, say, over, answered, found, has_device=True):
        self.config, self.over, self.found = config, over, found
        self.snapshot = Snapshot(phase="moving", authority="verbs")
        self.due_s = time.monotonic()
        self.orders = []
        self.refuses = ""
        self.silent = False
        self.back = ()
        self.ended = False

    pid = 4711

    def reload(self, number, order, config=None):
        self.orders.append(order)
        if order is ReloadOrder.PREPARE and not self.silent:
            changes = tuple(
                (each.key, each.old, each.new, each.moment, each.moment is Moment.NOW)
                for each in staged(self.config, config).changes
            )
            self.found(Found(number, self.refuses, () if self.refuses else changes, self.back))

    def stop(self):
        self.ended = True


class Lab:
    def __init__(self, folder, monkeypatch):
        monkeypatch.setattr(kept, "RunningSession", Answering)
        self.file = folder / "lab.toml"
        self.write(one=0.25, two=0.25)
        self.daemon = Daemon(read_layout([self.file]), lambda: read_layout([self.file]))
        self.daemon._look_after(time.monotonic())
        self.told = []

    def write(self, **speeds):
        self.file.write_text(
            "".join(SESSION.format(name=name, speed=speed) for name, speed in speeds.items())
        )

    def kept(self, name):
        return self.daemon._kept[name]

    def session(self, name):
        return self.kept(name).process

    def reload(self, check_only=False):
        """Its outcome; None where it is under way still."""
        self.told = []
        self.daemon.reload(self.told.append, check_only)
        self.turn(wait_s=30.0)
        return self.told[0] if self.told else None

    def turn(self, wait_s=0.0):
        try:
            while True:
                self.daemon._events.get(wait_s)()
                wait_s = 0.0 if self.told else 0.2
        except InboxEmptyError:
            pass

    def look(self, now_s):
        self.daemon._look_after_reload(self.daemon._reload, now_s)
        return self.told[0]


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


def test_all_sessions_are_asked_before_one_changes(lab):
    lab.write(one=0.1, two=0.4)
    assert words(lab.reload()) == [
        "one limits.linear_speed_m_s: 0.25 -> 0.1, live",
        "two limits.linear_speed_m_s: 0.25 -> 0.4, when disarmed (waits until disarmed)",
    ]
    for name in ("one", "two"):
        assert lab.session(name).orders == [ReloadOrder.PREPARE, ReloadOrder.APPLY]
    assert lab.daemon.layout.sessions["two"].config.limits.linear_speed_m_s == 0.4


def test_one_refusal_is_the_refusal_of_all(lab):
    lab.session("two").refuses = "mapping.deadman: the device has no button 'z'"
    lab.write(one=0.1, two=0.4, three=0.1)
    outcome = lab.reload()
    assert isinstance(outcome, ConfigurationError)
    assert str(outcome) == "two: mapping.deadman: the device has no button 'z'"
    for name in ("one", "two"):
        assert lab.session(name).orders == [ReloadOrder.PREPARE, ReloadOrder.DROP]
        assert lab.kept(name).entry.config.limits.linear_speed_m_s == 0.25
    assert "three" not in lab.daemon._kept
    assert "three" not in lab.daemon.layout.sessions


def test_a_check_changes_nothing(lab):
    lab.write(one=0.1, two=0.25, three=0.1)
    assert words(lab.reload(check_only=True)) == [
        "three: added, live",
        "one limits.linear_speed_m_s: 0.25 -> 0.1, live",
    ]
    assert lab.session("one").orders == [ReloadOrder.PREPARE, ReloadOrder.DROP]
    assert not lab.session("two").orders
    assert "three" not in lab.daemon._kept
    assert lab.kept("one").entry.config.limits.linear_speed_m_s == 0.25


def test_a_session_that_does_not_answer_refuses(lab):
    lab.session("two").silent = True
    lab.write(one=0.1, two=0.1)
    assert lab.reload() is None
    with pytest.raises(ControlError, match="a reload is under way"):
        lab.daemon.reload(lab.told.append)
    now_s = time.monotonic()
    outcome = lab.look(now_s + daemon_module.LOOKS_WITHIN_S)
    assert str(outcome) == "two: it did not answer within 5 s"
    assert lab.session("one").orders[-1] is ReloadOrder.DROP


def test_a_session_that_ends_meanwhile_begins_with_the_new_one(lab):
    lab.session("two").silent = True
    lab.write(one=0.1, two=0.1)
    assert lab.reload() is None
    lab.kept("two").process = None
    assert words(lab.look(time.monotonic())) == ["one limits.linear_speed_m_s: 0.25 -> 0.1, live"]
    assert lab.kept("two").entry.config.limits.linear_speed_m_s == 0.1


def test_a_session_that_does_not_run_takes_it_with_its_start(lab):
    lab.kept("one").process = None
    lab.write(one=0.4, two=0.25)
    assert words(lab.reload()) == [
        "one limits.linear_speed_m_s: 0.25 -> 0.4, when disarmed (waits until it starts)"
    ]
    assert lab.kept("one").entry.config.limits.linear_speed_m_s == 0.4
    assert not lab.kept("one").restart_waits


def test_a_restart_waits_until_nobody_has_the_arm(lab):
    lab.file.write_text(lab.file.read_text().replace('"ur5" }', '"ur5", seed = 3 }', 1))
    assert words(lab.reload()) == [
        "one robot.seed: 0 -> 3, session restarted (waits until disarmed)"
    ]
    kept, now_s = lab.kept("one"), time.monotonic()
    assert kept.restart_waits
    lab.daemon._look_after(now_s)
    assert not lab.session("one").ended
    # It holds, armed, and nobody has the authority.
    lab.session("one").snapshot = Snapshot(phase="holding")
    lab.daemon._look_after(now_s)
    assert lab.session("one").ended


def test_a_restart_that_waits_is_taken_back(lab):
    before = lab.file.read_text()
    lab.file.write_text(before.replace('"ur5" }', '"ur5", seed = 3 }', 1))
    lab.reload()
    one = lab.session("one")
    one.snapshot = Snapshot(phase="moving", authority="verbs", changes_wait=["robot.seed"])
    one.back = ("robot.seed",)
    lab.file.write_text(before)
    assert words(lab.reload()) == ["one robot.seed: taken back, live"]
    assert not lab.kept("one").restart_waits


def test_what_leaves_the_files_stops_and_starts_when_it_is_back(lab):
    lab.write(one=0.25)
    assert words(lab.reload()) == ["two: removed, live"]
    lab.daemon._look_after(time.monotonic())
    assert lab.session("two").ended
    lab.kept("two").unit.ended(Ended.AS_ASKED, "", time.monotonic())
    lab.kept("two").process = None
    lab.write(one=0.25, two=0.1)
    assert words(lab.reload()) == ["two: added, live"]
    lab.daemon._look_after(time.monotonic())
    assert lab.session("two").config.limits.linear_speed_m_s == 0.1


def test_a_session_that_had_failed_is_tried_again_with_what_has_changed(lab):
    unit = lab.kept("one").unit
    unit.ended(Ended.MISCONFIGURED, "mapping.deadman: ...", time.monotonic())
    lab.kept("one").process = None
    lab.write(one=0.25, two=0.1)
    lab.reload()
    assert unit.state.value == "failed"
    lab.write(one=0.1, two=0.1)
    lab.reload()
    lab.daemon._look_after(time.monotonic())
    assert unit.state.value == "running"
    assert lab.session("one").config.limits.linear_speed_m_s == 0.1


def test_what_keeps_the_files_from_being_read_is_said(lab, monkeypatch):
    def read():
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(lab.daemon, "_read", read)
    assert "too many files are open" in str(lab.reload())
    monkeypatch.undo()
    assert lab.daemon._reload is None


def test_what_the_files_say_wrong_is_refused(lab):
    lab.file.write_text("[demon]\n")
    assert "demon: there is no such key" in str(lab.reload())
    lab.write(one=0.25)
    lab.file.write_text(lab.file.read_text() + '[faces.two]\nface = "rosbridge"\n')
    assert "was a session and is a face now" in str(lab.reload())
    lab.file.write_text("[daemon]\nstart_limit = 3\n" + SESSION.format(name="one", speed=0.1))
    assert "restart the daemon" in str(lab.reload())
    assert not lab.session("one").orders


def test_changes_travel_as_tables():
    change = Change("one", "mapping.deadman", Effect.LIVE, "changed", "left", ["a", "b"], "x")
    assert Change.of(change._asdict()) == change
    assert change.in_words == 'one mapping.deadman: "left" -> ["a", "b"], live (waits x)'
    assert Change("one", "network", Effect.RESTARTED, "changed").in_words.endswith(
        "none -> none, session restarted"
    )


@pytest.mark.matrix
def test_files_are_read_in_a_process_of_their_own(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text(SESSION.format(name="one", speed=0.1))
    assert read_layout_beside([file]) == read_layout([file])
    file.write_text("[demon]\n")
    with pytest.raises(ConfigurationError, match="demon: there is no such key"):
        read_layout_beside([file])
