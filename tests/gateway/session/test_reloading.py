"""A running session that is given another configuration."""

import socket
import threading
import time

import pytest

from cardan.errors import ConfigurationError
from cardan.gateway.arm.status import Phase
from cardan.gateway.session.changes import Moment
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.heartbeat import BEAT
from cardan.gateway.session.reloading import ANSWER, Found, Reloading, ReloadOrder, packets
from cardan.gateway.session.session import make_session
from cardan.gateway.session.snapshot import MAX_SNAPSHOT_BYTES, Snapshot
from cardan.types import DeviceLink, DeviceState
from tests.serving import PATIENT
from tests.waiting import until

BASE = {"robot": {"driver": "sim_arm", "robot": "ur5"}, "arm": {"model": "ur5"}}


def config(**tables):
    return parse_config(BASE | tables)


class Bench:
    """The thread of a reloading, and a session that takes what is allowed by now."""

    def __init__(self, **tables):
        self.come = {Moment.NOW}
        self.taken = []
        self.told = []
        self.refuses = ""
        self.reloading = Reloading(
            config(**tables), self.check, self.take, self.come.__contains__, self.told.append
        )

    def check(self, made):
        if self.refuses:
            raise ConfigurationError("mapping.deadman", self.refuses)

    def take(self, step):
        if step.moment in self.come:
            self.taken.append(step)
            return True
        return False

    def order(self, number, order, made=None):
        for packet in packets(number, order, made):
            self.reloading.offer(packet)
        if order is ReloadOrder.PREPARE:
            return until(lambda: next(filter(lambda f: f.number == number, self.found), None), "it")
        return None

    @property
    def found(self):
        return [Found.of(packet) for packet in self.told if packet.startswith(ANSWER)]

    def apply(self, number, made):
        found = self.order(number, ReloadOrder.PREPARE, made)
        self.order(number, ReloadOrder.APPLY)
        return found


@pytest.fixture
def bench():
    made = Bench()
    yield made
    made.reloading.close()


TIGHT = {"limits": {"linear_speed_m_s": 0.1, "leash_m": 0.08}}


def test_it_answers_before_anything_changes(bench):
    found = bench.order(1, ReloadOrder.PREPARE, config(**TIGHT))
    assert found.changes == (
        ("limits.linear_speed_m_s", 0.25, 0.1, Moment.NOW, True),
        ("limits.leash_m", 0.05, 0.08, Moment.DISARMED, False),
    )
    bench.order(1, ReloadOrder.DROP)
    bench.order(1, ReloadOrder.APPLY)
    bench.order(2, ReloadOrder.PREPARE, config())
    assert not bench.taken


def test_each_change_is_taken_when_its_moment_has_come(bench):
    bench.apply(1, config(**TIGHT))
    until(lambda: bench.reloading.waits == ("limits.leash_m",), "the first step")
    assert bench.reloading.config.limits.linear_speed_m_s == 0.1
    assert bench.reloading.config.limits.leash_m == 0.05
    assert bench.taken[0].ends == "limits.linear_speed_m_s: tightened by a reload, plan it anew"
    bench.come.add(Moment.DISARMED)
    until(lambda: not bench.reloading.waits, "the second")
    assert bench.reloading.config == config(**TIGHT)


def test_a_later_reload_takes_back_what_waits(bench):
    bench.apply(1, config(**TIGHT))
    until(lambda: bench.reloading.waits == ("limits.leash_m",), "the first step")
    found = bench.apply(2, config(limits={"linear_speed_m_s": 0.1}))
    assert not found.changes
    assert found.taken_back == ("limits.leash_m",)
    until(lambda: not bench.reloading.waits, "its end")
    bench.come.add(Moment.DISARMED)
    bench.order(3, ReloadOrder.PREPARE, config())
    assert [step.moment for step in bench.taken] == [Moment.NOW]


def test_what_needs_a_restart_waits_here_for_ever(bench):
    bench.come |= set(Moment)
    bench.apply(1, config(arm={"model": "ur5", "collisions": False}))
    until(lambda: bench.reloading.waits == ("arm.collisions",), "it")
    assert bench.reloading.config == config()
    assert not bench.taken


def test_a_refusal_has_its_reason_and_changes_nothing(bench):
    bench.refuses = "the device has no button 'z'"
    found = bench.order(1, ReloadOrder.PREPARE, config(**TIGHT))
    assert found.error == "mapping.deadman: the device has no button 'z'"
    bench.order(1, ReloadOrder.APPLY)
    bench.refuses = ""
    bench.order(2, ReloadOrder.PREPARE, config())
    assert not bench.taken


def test_a_long_configuration_comes_in_pieces(bench):
    obstacles = [{"name": f"wall {i}", "plane": [[0.0, 0.0, 1.0], -9.0]} for i in range(150)]
    made = config(obstacles=obstacles)
    assert len(list(packets(1, ReloadOrder.PREPARE, made))) > 3
    (change,) = bench.order(1, ReloadOrder.PREPARE, made).changes
    assert change[0] == "obstacles"


# -- a whole session -------------------------------------------------------------------------------


class Running:
    """A session whose operator holds the dead-man and pushes, from the tenth cycle on."""

    def __init__(self, **tables):
        self.tables = {
            "device": {"driver": "fake_device", "deflection": 0.1},
            "robot": {"driver": "sim_arm", "robot": "ur5", "period_s": 0.004},
            "arm": {"model": "ur5"},
            "mapping": {"deadman": "go"},
            "watchdogs": PATIENT,
        } | tables
        self.channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.theirs = theirs
        theirs.setblocking(False)
        self.session = make_session(parse_config(self.tables, from_file=False), theirs)
        self.costs_s = []
        do = self.session._link.do

        def measured(errand):
            def timed():
                begin_s = time.thread_time()
                errand()
                self.costs_s.append(time.thread_time() - begin_s)

            do(timed)

        self.session._link.do = measured
        self.snapshot = Snapshot()
        self.found = []
        self.over = threading.Event()
        self.threads = [
            threading.Thread(target=work, daemon=True)
            for work in (self.session.run, self.read, self.beat)
        ]
        for thread in self.threads:
            thread.start()
        until(lambda: self.snapshot.phase == "moving", "the motion")

    def read(self):
        while packet := self.channel.recv(MAX_SNAPSHOT_BYTES):
            if packet.startswith(ANSWER):
                self.found.append(Found.of(packet))
                continue
            self.snapshot = Snapshot.from_bytes(packet)
            if self.snapshot.finished:
                return

    def beat(self):
        while not self.over.wait(0.05):
            self.channel.send(BEAT)

    def prepare(self, number, **tables):
        merged = {
            key: {**self.tables.get(key, {}), **tables.get(key, {})}
            for key in {*self.tables, *tables}
        }
        for packet in packets(number, ReloadOrder.PREPARE, parse_config(merged, from_file=False)):
            self.channel.send(packet)
        return until(lambda: next((f for f in self.found if f.number == number), None), "it")

    def reload(self, number, **tables):
        found = self.prepare(number, **tables)
        for packet in packets(number, ReloadOrder.APPLY):
            self.channel.send(packet)
        return found

    def end(self):
        self.session.stop("the test is over")
        for thread in self.threads[:2]:
            thread.join()
        self.over.set()
        self.threads[2].join()
        self.channel.close()
        self.theirs.close()


@pytest.fixture
def running(fake_drivers):
    made = Running()
    yield made
    made.end()


@pytest.mark.matrix
def test_a_session_that_is_driven_takes_what_is_tighter_and_nothing_else(running):
    controller = running.session.controller
    assert running.prepare(1, mapping={"deadman": "z"}).error == (
        "mapping.deadman: the device has no button 'z'; it has: go, grip"
    )
    found = running.reload(
        2,
        limits={"linear_speed_m_s": 0.1, "angular_speed_rad_s": 1.5},
        arm={"speed_share": 0.5},
        mapping={"deadman": "grip", "linear_speed_m_s": 0.2},
        feedback={"led": False},
    )
    waiting = {each[0] for each in found.changes if not each[4]}
    assert waiting == {"limits.angular_speed_rad_s", "mapping.deadman"}
    until(lambda: set(running.snapshot.changes_wait) == waiting, "the first step")
    assert controller.reference.limits.linear_speed_m_s == 0.1
    assert controller.reference.limits.angular_speed_rad_s == 1.0
    assert controller.body.servo.options.speed_share == 0.5
    assert controller.hand.mapping.options.linear_speed_m_s == 0.2
    assert controller.hand.mapping.options.deadman == "go"
    assert running.snapshot.message == ""
    assert running.snapshot.phase == "moving"
    # The hand lets go; its lease ends.
    running.session.device.state = lambda: DeviceState(
        time.monotonic(), DeviceLink.LIVE, (0.0,) * 6, frozenset()
    )
    until(lambda: not running.snapshot.changes_wait, "the rest")
    assert controller.reference.limits.angular_speed_rad_s == 1.5
    assert controller.hand.mapping.options.deadman == "grip"
    assert running.snapshot.trips == 0
    until(lambda: controller.phase is Phase.DISARMED, "the next tick, which says so")
    # In the loop's turn, after the answer: a small part of a cycle.
    assert len(running.costs_s) >= 3
    assert max(running.costs_s) < 0.002
