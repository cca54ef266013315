"""A device that several sessions share, in virtual time, with sessions that obey."""

import pytest

from cardan.gateway.daemon.device_sharing import Order, SessionState, SharedDevice
from cardan.gateway.daemon.services import why_nothing_moves
from cardan.gateway.session.snapshot import Snapshot
from tests.snapshots import changed


class Arm:
    """A session that opens or closes the device one poll after the order, and brakes for three
    polls."""

    def __init__(self, held):
        self.wanted = self.running = True
        self.held = held
        self.phase = "disarmed"
        self.passes = 0
        self.reported = None
        self.brakes = 0

    def turn(self):
        if self.reported is Order.GIVE and self.held:
            self.held = False
            if self.phase == "moving":
                self.phase, self.brakes = "braking", 3
        elif self.reported is Order.TAKE:
            self.held = True
        self.reported = None
        if self.phase == "braking":
            self.brakes -= 1
            if self.brakes == 0:
                self.phase = "disarmed"

    def end(self, wanted=False):
        self.running, self.wanted = False, wanted

    @property
    def seen(self):
        return SessionState(self.wanted, self.running, self.held, self.phase, self.passes)


class Bench:
    def __init__(self, *names):
        self.shared = SharedDevice("mouse", names)
        self.arms = {name: Arm(name == names[0]) for name in names}

    def run(self, polls=8):
        for _ in range(polls):
            for name, order in self.shared.poll(lambda name: self.arms[name].seen):
                self.arms[name].reported = order
            for arm in self.arms.values():
                arm.turn()
            # At most one session has the device open, and only while no other arm moves.
            holding = [arm for arm in self.arms.values() if arm.held and arm.running]
            assert len(holding) <= 1
            moving = [arm for arm in self.arms.values() if arm.phase != "disarmed" and arm.running]
            assert all(arm in moving for arm in holding) or not moving

    def ends_with(self, name):
        """True if the session has the device in the end."""
        self.run()
        return self.holder == name

    @property
    def holder(self):
        (name,) = [name for name, arm in self.arms.items() if arm.held and arm.running]
        return name


@pytest.fixture
def bench():
    return Bench("one", "two", "three")


def test_the_first_begins_with_it(bench):
    assert bench.ends_with("one")


def test_a_button_passes_it_on_in_a_round(bench):
    for expected in ("two", "three", "one"):
        bench.arms[bench.holder].passes += 1
        assert bench.ends_with(expected)


def test_it_is_passed_on_through_rest(bench):
    bench.arms["one"].phase = "moving"
    bench.shared.pass_to("three")
    bench.run(2)
    assert bench.arms["one"].phase == "braking"
    assert not bench.arms["three"].held
    assert bench.ends_with("three")


def test_two_presses_do_not_skip_one(bench):
    bench.arms["one"].passes = 2
    assert bench.ends_with("two")


def test_a_press_of_one_that_does_not_have_it_counts_nothing(bench):
    bench.arms["two"].passes = 1
    assert bench.ends_with("one")
    bench.shared.pass_to("two")
    assert bench.ends_with("two")


def test_one_that_is_passed_to_itself_keeps_it(bench):
    bench.shared.pass_to("one")
    assert bench.ends_with("one")


def test_a_session_that_is_stopped_leaves_it_to_the_next_that_runs(bench):
    bench.arms["two"].end()
    bench.arms["one"].end()
    assert bench.ends_with("three")


def test_a_session_that_dies_and_comes_back_has_it_again(bench):
    bench.run()
    bench.arms["one"].end(wanted=True)
    bench.arms["one"].held = False
    bench.run()
    assert bench.shared.holder == "one"
    bench.arms["one"].running = True
    assert bench.ends_with("one")


def test_while_nobody_runs_it_is_nobodys(bench):
    for arm in bench.arms.values():
        arm.end()
    bench.run()
    bench.arms["three"].running = bench.arms["three"].wanted = True
    bench.arms["three"].held = False
    assert bench.ends_with("three")


def test_one_that_dies_while_it_gives_does_not_keep_it_from_the_next(bench):
    bench.arms["one"].phase = "moving"
    bench.shared.pass_to("two")
    bench.run(1)
    bench.arms["one"].end(wanted=True)
    assert bench.ends_with("two")
    bench.arms["one"].running = True
    bench.arms["one"].phase = "disarmed"
    assert bench.ends_with("two")


def test_a_robot_that_is_not_ready_is_reported_before_a_device_that_is_elsewhere():
    there = "its device serves gofa"
    away = Snapshot.of(
        {"device": {"held": False, "reason": "closed"}, "arm": {"message": "closed"}}
    )
    assert why_nothing_moves(away, there) == there
    unready = changed(away, robot__hold_reason="the robot is not ready")
    assert why_nothing_moves(unready, there) == "the robot is not ready"
    asked = Snapshot.of({"arm": {"message": "press 'left' to move"}})
    assert why_nothing_moves(asked, "") == "press 'left' to move"


def test_who_has_it_keeps_it_when_other_sessions_come_to_share_it(bench):
    bench.arms["one"].passes = 1
    assert bench.ends_with("two")
    bench.shared.serve(["two", "one"])
    assert bench.ends_with("two")
    bench.shared.serve(["one", "three"])
    bench.arms["two"].held = False
    assert bench.ends_with("one")
