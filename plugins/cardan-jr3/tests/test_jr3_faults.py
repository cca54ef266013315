"""Faults of the sensor: neutral within 100 ms, and no motion before it was at rest."""

import math

import pytest

from cardan.types import DeviceLink
from cardan_jr3.driver import Jr3Options
from jr3_rig import STEP_S, Rig

pytestmark = pytest.mark.matrix

REST = (0.0,) * 6
PUSH = (6.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def pushed(options=None, **board):
    """A live sensor with a hand on it."""
    rig = Rig(options, **board)
    rig.live()
    rig.board.set_wrench(PUSH)
    assert rig.run(0.5).axes[0] > 0.4
    return rig


def neutral_within(rig, seconds=0.1):
    """Runs on, and says in which link it became neutral in time; it must stay neutral."""
    rig.run(seconds)
    state = rig.states[-1]
    assert state.axes == REST
    assert state.link is not DeviceLink.LIVE
    assert state.reason
    return state


def live_only_at_rest(rig):
    """The hand is still on it: it stays neutral until the hand has let go for a while."""
    rig.run(3.0)
    assert {state.axes for state in rig.states} == {REST}
    assert rig.states[-1].link is DeviceLink.NEEDS_NEUTRAL
    rig.board.set_wrench(REST)
    rig.run(1.0)
    assert {state.axes for state in rig.states} == {REST}
    assert rig.states[-1].link is DeviceLink.LIVE
    rig.board.set_wrench(PUSH)
    assert rig.run(0.5).axes[0] > 0.4


@pytest.mark.parametrize("period_s", [0.001, 0.01, 0.04])
def test_silence(period_s):
    rig = pushed(Jr3Options(period_s=period_s))
    newest_s = rig.states[-1].stamp_s
    rig.board.hang()
    state = neutral_within(rig, 0.1 + newest_s - rig.now_s)
    assert state.link is DeviceLink.STALE
    assert state.wrench is None
    assert "no new sample for 0.09 s" in state.reason


def test_a_short_silence_needs_rest():
    rig = pushed(Jr3Options(zero_on_open=False))
    rig.board.hang()
    rig.run(0.2)
    rig.board.recover()
    live_only_at_rest(rig)


def test_a_silence_that_nobody_looked_at_needs_rest_all_the_same():
    rig = pushed()
    rig.board.reports(rig.now_s + 0.3)  # lost, while nobody asks for the state
    rig.now_s += 0.3
    state = rig.run(0.05)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert state.axes == REST
    assert rig.core.metrics(rig.now_s)["silences"] == 1


def test_a_long_silence_brings_the_board_up_again():
    rig = pushed()
    rig.board.hang()
    state = rig.run(3.0)
    assert state.link is DeviceLink.LOST
    rig.board.set_wrench(REST)
    rig.board.recover()
    assert rig.run(3.0).link is DeviceLink.LIVE


def test_power_failure():
    """The hand goes on pushing: it must not become the new zero, and the arm not run away."""
    rig = pushed(boot_s=0.5, offset=(4, -3, -8, 0.2, -0.1, 0.05))
    rig.board.power_off()
    neutral_within(rig)
    rig.board.power_on()
    state = rig.run(3.0)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert "zero is lost" in state.reason
    assert state.wrench is None
    assert rig.core.zeros == 1
    assert rig.core.metrics(rig.now_s)["boots"] == 2
    rig.board.set_wrench(REST)
    assert rig.run(2.0).link is DeviceLink.NEEDS_NEUTRAL
    assert {state.axes for state in rig.states} == {REST}
    rig.core.ask_zero(rig.now_s)
    assert rig.run(1.0).link is DeviceLink.LIVE
    assert {state.axes for state in rig.states} == {REST}
    rig.core.on_closed(rig.now_s)
    assert rig.live().link is DeviceLink.LIVE


def test_a_power_failure_that_nobody_heard_of_is_no_rest():
    """The boot is lost: what the sensor shows without its zero is taken for a hand."""
    rig = pushed(offset=(4, -3, -8, 0.2, -0.1, 0.05))
    rig.board.power_off()
    rig.run(1.0)
    rig.mangle = lambda frame: None if frame.arbitration_id == 0x721 else frame
    rig.board.power_on()
    rig.board.set_wrench(REST)
    state = rig.run(4.0)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert "zero is lost" in state.reason
    assert {state.axes for state in rig.states} == {REST}


WEIGHT = (0.0, 0.0, -8.0, 0.0, 0.0, 0.0)


def neutral_while_the_weight_is_carried(rig):
    """A hand that carries the tool makes it look like rest, and lets go."""
    rig.board.set_wrench((0.0, 0.0, 8.0, 0.0, 0.0, 0.0))
    rig.run(1.0)
    rig.board.set_wrench(REST)
    rig.run(1.0)
    return {(state.axes, state.link) for state in rig.states} == {(REST, DeviceLink.NEEDS_NEUTRAL)}


def test_a_boot_that_nobody_heard_of_costs_the_zero():
    rig = Rig(offset=WEIGHT)
    rig.live()
    rig.mangle = lambda frame: None if frame.arbitration_id == 0x721 else frame
    rig.board.power_off()
    rig.run(0.3)
    rig.board.power_on()
    rig.run(3.0)
    assert rig.core.metrics(rig.now_s)["boots"] == 1
    assert neutral_while_the_weight_is_carried(rig)
    rig.core.ask_zero(rig.now_s)
    assert rig.run(1.0).link is DeviceLink.LIVE


@pytest.mark.parametrize("options", [Jr3Options(), Jr3Options(mode="sync")])
def test_a_boot_while_the_bus_was_lost_costs_the_zero(options):
    rig = Rig(options, offset=WEIGHT)
    rig.live()
    rig.core.on_lost("unplugged", rig.now_s)
    rig.board.power_off()
    rig.board.power_on()
    rig.board.reports(rig.now_s + 0.5)
    rig.now_s += 0.5
    rig.open()
    rig.run(3.0)
    assert neutral_while_the_weight_is_carried(rig)
    assert "zero is lost" in rig.states[-1].reason
    assert rig.core.zeros == 1


def test_a_board_that_another_program_started_has_booted_all_the_same():
    rig = Rig(offset=WEIGHT)
    rig.live()
    rig.core.on_lost("unplugged", rig.now_s)
    rig.board.power_off()
    rig.board.power_on()
    rig.board.reports(rig.now_s + 0.5)
    rig.now_s += 0.5
    for frame in rig.sent:
        rig.board.receive(*frame, rig.now_s)
        if frame.arbitration_id == 0x200 + 33:  # it is told to start
            break
    rig.open()
    rig.run(3.0)
    assert rig.states[-1].link is DeviceLink.NEEDS_NEUTRAL
    assert "zero is lost" in rig.states[-1].reason


@pytest.mark.parametrize("mode", ["async", "sync"])
@pytest.mark.parametrize("away_s", [0.3, 5.0, 20.0])
def test_a_board_that_went_on_while_the_bus_was_lost_keeps_its_zero(mode, away_s):
    rig = Rig(Jr3Options(mode=mode), offset=WEIGHT)
    rig.live()
    rig.core.on_lost("unplugged", rig.now_s)
    rig.board.reports(rig.now_s + away_s)
    rig.now_s += away_s
    rig.open()
    assert rig.run(2.0).link is DeviceLink.LIVE
    assert rig.core.zeros == 1


def test_a_boot_in_midstream_is_neutral_at_once():
    rig = pushed(boot_s=0.0)
    rig.board.power_off()
    rig.board.power_on()
    state = rig.run(0.01)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert "restarted" in state.reason
    assert state.axes == REST


def test_the_sensor_is_unplugged_from_a_board_that_goes_on_sending():
    rig = pushed()
    rig.board.unplug_sensor()
    state = neutral_within(rig, 0.12)
    assert state.link is DeviceLink.STALE
    assert rig.core.metrics(rig.now_s)["repeated_samples"] > 0
    rig.board.plug_sensor()
    rig.run(0.3)
    assert rig.states[-1].link is DeviceLink.NEEDS_NEUTRAL


def test_another_program_stops_the_board():
    rig = pushed()
    rig.board.receive(0x280 + 33, b"", rig.now_s)
    neutral_within(rig, 0.12)
    rig.board.set_wrench(REST)
    state = rig.run(3.0)
    # A board that was stopped looks like one that has booted.
    assert (state.link, state.wrench) == (DeviceLink.NEEDS_NEUTRAL, None)
    assert "zero is lost" in state.reason
    assert rig.core.metrics(rig.now_s)["unexpected_acks"] == 1
    rig.core.ask_zero(rig.now_s)
    assert rig.run(1.0).link is DeviceLink.LIVE


def test_overload():
    rig = pushed()
    rig.board.set_wrench((0, 0, 250, 0, 0, 0))
    state = rig.run(0.2)
    assert state.axes == REST
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert "Fz is at 135 % of full scale" in state.reason
    assert state.wrench.force.z > 185
    rig.board.set_wrench(PUSH)
    live_only_at_rest(rig)


def test_zero_is_not_taken_of_an_overload():
    rig = Rig()
    rig.board.set_wrench((0, 0, 250, 0, 0, 0))
    rig.open()
    state = rig.run(2.0)
    assert "overloaded" in state.reason
    assert rig.core.zeros == 0
    rig.board.set_wrench(REST)
    assert rig.run(1.0).link is DeviceLink.LIVE


MANGLED = {
    "short": lambda frame: frame._replace(data=frame.data[:5]),
    "long": lambda frame: frame._replace(data=frame.data + b"\0"),
    "without moments": lambda frame: None if frame.arbitration_id == 0x6A1 else frame,
    "without forces": lambda frame: None if frame.arbitration_id == 0x621 else frame,
    "of two samples": lambda frame: (
        frame._replace(data=frame.data[:6] + b"\1\2") if frame.arbitration_id == 0x6A1 else frame
    ),
    "of an unknown kind": lambda frame: frame._replace(arbitration_id=0x7A1),
}


@pytest.mark.parametrize("how", MANGLED)
def test_garbled_samples_are_as_good_as_none(how):
    rig = pushed()
    rig.mangle = MANGLED[how]
    neutral_within(rig, 0.12)
    rig.mangle = lambda frame: frame
    rig.run(0.3)
    assert {state.axes for state in rig.states} == {REST}
    rig.board.set_wrench(REST)
    assert rig.run(2.0).link is DeviceLink.LIVE


@pytest.mark.parametrize(
    "faults",
    [
        {"lost": 0.2},
        {"short-frame": 3.0},
        {"unknown-frame": 2.0},
        {"duplicate": 1.0},
        {"lost-moments": 4.0},
        {"wrong-counter": 4.0},
    ],
    ids=lambda faults: next(iter(faults)),
)
def test_some_bad_frames_are_counted_and_change_nothing(faults):
    rig = Rig(Jr3Options(period_s=0.005), faults=faults, seed=3)
    rig.open()
    rig.run(4.0)
    rig.board.set_wrench(PUSH)
    state = rig.run(0.5)
    assert state.link is DeviceLink.LIVE
    assert state.axes[0] == pytest.approx(0.5, abs=0.02)
    assert any(
        "lost" in line or "ignored" in line or "repeat" in line
        for line in rig.core.diagnosis(rig.now_s)
    )


def test_old_samples_are_not_taken_for_new_ones():
    """A stream stands still, then delivers a second's worth at once: only what is fresh counts."""
    rig = pushed(Jr3Options(period_s=0.01))
    held = []
    for _ in range(1000):
        rig.now_s += STEP_S
        held += rig.board.reports(rig.now_s)
        rig.core.state(rig.now_s)
    axes = set()
    for frame in held:
        rig.core.on_frame(*frame, rig.now_s)
        axes.add(rig.core.state(rig.now_s).axes)
    assert axes == {REST}
    assert rig.core.metrics(rig.now_s)["late_samples"] > 80
    assert rig.core.state(rig.now_s).link is DeviceLink.NEEDS_NEUTRAL
    assert rig.now_s - rig.core.state(rig.now_s).stamp_s < 0.02


def test_a_clock_that_runs_otherwise_is_not_late():
    """The board's crystal may be off: seen over a minute, samples keep coming in time."""
    for drift in (-0.015, 0.015):
        rig = pushed(Jr3Options(period_s=0.01))
        start_s = rig.now_s
        for _ in range(6000):
            rig.now_s += 0.01
            for frame in rig.board.reports(start_s + (rig.now_s - start_s) * (1.0 + drift)):
                rig.core.on_frame(*frame, rig.now_s)
            rig.core.poll(rig.now_s)
            assert rig.core.state(rig.now_s).link is DeviceLink.LIVE
        assert rig.core.metrics(rig.now_s)["late_samples"] == 0


def test_the_bus_is_lost_and_found():
    rig = pushed(offset=(4, -3, -8, 0.2, -0.1, 0.05))
    rig.core.on_lost("unplugged", rig.now_s)
    state = rig.core.state(rig.now_s)
    assert (state.link, state.axes, state.wrench) == (DeviceLink.LOST, REST, None)
    assert math.isinf(rig.core.next_due_s)
    rig.open()
    live_only_at_rest(rig)  # the hand that was on it did not become the new zero
    assert rig.core.zeros == 1
