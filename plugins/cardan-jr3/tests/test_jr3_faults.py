"""Faults of the sensor: neutral within 100 ms, and no motion until the sensor has been at rest."""

import math

import pytest

from cardan.types import DeviceLink
from cardan_jr3.driver import Jr3Options
from jr3_bench import STEP_S, Bench

pytestmark = pytest.mark.matrix

REST = (0.0,) * 6
PUSH = (6.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def pushed(options=None, **board):
    """A live sensor pushed by a hand."""
    bench = Bench(options, **board)
    bench.live()
    bench.board.set_wrench(PUSH)
    assert bench.run(0.5).axes[0] > 0.4
    return bench


def neutral_within(bench, seconds=0.1):
    """Run and return the last state; check that the device is neutral by then."""
    bench.run(seconds)
    state = bench.states[-1]
    assert state.axes == REST
    assert state.link is not DeviceLink.LIVE
    assert state.reason
    return state


def live_only_at_rest(bench):
    """Check that the device stays neutral while the hand pushes, and becomes live after a time at
    rest."""
    bench.run(3.0)
    assert {state.axes for state in bench.states} == {REST}
    assert bench.states[-1].link is DeviceLink.NEEDS_NEUTRAL
    bench.board.set_wrench(REST)
    bench.run(1.0)
    assert {state.axes for state in bench.states} == {REST}
    assert bench.states[-1].link is DeviceLink.LIVE
    bench.board.set_wrench(PUSH)
    assert bench.run(0.5).axes[0] > 0.4


@pytest.mark.parametrize("period_s", [0.001, 0.01, 0.04])
def test_silence(period_s):
    bench = pushed(Jr3Options(period_s=period_s))
    newest_s = bench.states[-1].stamp_s
    bench.board.hang()
    state = neutral_within(bench, 0.1 + newest_s - bench.now_s)
    assert state.link is DeviceLink.STALE
    assert state.wrench is None
    assert "no new sample for 0.09 s" in state.reason


def test_a_short_silence_needs_rest():
    bench = pushed(Jr3Options(zero_on_open=False))
    bench.board.hang()
    bench.run(0.2)
    bench.board.recover()
    live_only_at_rest(bench)


def test_a_silence_that_nobody_looked_at_needs_rest_all_the_same():
    bench = pushed()
    bench.board.reports(bench.now_s + 0.3)  # lost while no state is read
    bench.now_s += 0.3
    state = bench.run(0.05)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert state.axes == REST
    assert bench.core.metrics(bench.now_s)["silences"] == 1


def test_a_long_silence_brings_the_board_up_again():
    bench = pushed()
    bench.board.hang()
    state = bench.run(3.0)
    assert state.link is DeviceLink.LOST
    bench.board.set_wrench(REST)
    bench.board.recover()
    assert bench.run(3.0).link is DeviceLink.LIVE


def test_power_failure():
    """The hand keeps pushing: its force must not become the new zero, and the arm must not run
    away."""
    bench = pushed(boot_s=0.5, offset=(4, -3, -8, 0.2, -0.1, 0.05))
    bench.board.power_off()
    neutral_within(bench)
    bench.board.power_on()
    state = bench.run(3.0)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert "zero is lost" in state.reason
    assert state.wrench is None
    assert bench.core.zeros == 1
    assert bench.core.metrics(bench.now_s)["boots"] == 2
    bench.board.set_wrench(REST)
    assert bench.run(2.0).link is DeviceLink.NEEDS_NEUTRAL
    assert {state.axes for state in bench.states} == {REST}
    bench.core.ask_zero(bench.now_s)
    assert bench.run(1.0).link is DeviceLink.LIVE
    assert {state.axes for state in bench.states} == {REST}
    bench.core.on_closed(bench.now_s)
    assert bench.live().link is DeviceLink.LIVE


def test_a_power_failure_that_nobody_heard_of_is_no_rest():
    """The BOOTUP frame is lost: the offset of the sensor without its zero looks like a push."""
    bench = pushed(offset=(4, -3, -8, 0.2, -0.1, 0.05))
    bench.board.power_off()
    bench.run(1.0)
    bench.mangle = lambda frame: None if frame.arbitration_id == 0x721 else frame
    bench.board.power_on()
    bench.board.set_wrench(REST)
    state = bench.run(4.0)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert "zero is lost" in state.reason
    assert {state.axes for state in bench.states} == {REST}


WEIGHT = (0.0, 0.0, -8.0, 0.0, 0.0, 0.0)


def neutral_while_the_weight_is_carried(bench):
    """A hand carrying the tool makes the wrench look like rest, then releases it."""
    bench.board.set_wrench((0.0, 0.0, 8.0, 0.0, 0.0, 0.0))
    bench.run(1.0)
    bench.board.set_wrench(REST)
    bench.run(1.0)
    return {(state.axes, state.link) for state in bench.states} == {
        (REST, DeviceLink.NEEDS_NEUTRAL)
    }


def test_a_boot_that_nobody_heard_of_costs_the_zero():
    bench = Bench(offset=WEIGHT)
    bench.live()
    bench.mangle = lambda frame: None if frame.arbitration_id == 0x721 else frame
    bench.board.power_off()
    bench.run(0.3)
    bench.board.power_on()
    bench.run(3.0)
    assert bench.core.metrics(bench.now_s)["boots"] == 1
    assert neutral_while_the_weight_is_carried(bench)
    bench.core.ask_zero(bench.now_s)
    assert bench.run(1.0).link is DeviceLink.LIVE


@pytest.mark.parametrize("options", [Jr3Options(), Jr3Options(mode="sync")])
def test_a_boot_while_the_bus_was_lost_costs_the_zero(options):
    bench = Bench(options, offset=WEIGHT)
    bench.live()
    bench.core.on_lost("unplugged", bench.now_s)
    bench.board.power_off()
    bench.board.power_on()
    bench.board.reports(bench.now_s + 0.5)
    bench.now_s += 0.5
    bench.open()
    bench.run(3.0)
    assert neutral_while_the_weight_is_carried(bench)
    assert "zero is lost" in bench.states[-1].reason
    assert bench.core.zeros == 1


def test_a_board_that_another_program_started_has_booted_all_the_same():
    bench = Bench(offset=WEIGHT)
    bench.live()
    bench.core.on_lost("unplugged", bench.now_s)
    bench.board.power_off()
    bench.board.power_on()
    bench.board.reports(bench.now_s + 0.5)
    bench.now_s += 0.5
    for frame in bench.sent:
        bench.board.receive(*frame, bench.now_s)
        if frame.arbitration_id == 0x200 + 33:  # the start command
            break
    bench.open()
    bench.run(3.0)
    assert bench.states[-1].link is DeviceLink.NEEDS_NEUTRAL
    assert "zero is lost" in bench.states[-1].reason


@pytest.mark.parametrize("mode", ["async", "sync"])
@pytest.mark.parametrize("away_s", [0.3, 5.0, 20.0])
def test_a_board_that_went_on_while_the_bus_was_lost_keeps_its_zero(mode, away_s):
    bench = Bench(Jr3Options(mode=mode), offset=WEIGHT)
    bench.live()
    bench.core.on_lost("unplugged", bench.now_s)
    bench.board.reports(bench.now_s + away_s)
    bench.now_s += away_s
    bench.open()
    assert bench.run(2.0).link is DeviceLink.LIVE
    assert bench.core.zeros == 1


def test_a_boot_in_midstream_is_neutral_at_once():
    bench = pushed(boot_s=0.0)
    bench.board.power_off()
    bench.board.power_on()
    state = bench.run(0.01)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert "restarted" in state.reason
    assert state.axes == REST


def test_the_sensor_is_unplugged_from_a_board_that_goes_on_sending():
    bench = pushed()
    bench.board.unplug_sensor()
    state = neutral_within(bench, 0.12)
    assert state.link is DeviceLink.STALE
    assert bench.core.metrics(bench.now_s)["repeated_samples"] > 0
    bench.board.plug_sensor()
    bench.run(0.3)
    assert bench.states[-1].link is DeviceLink.NEEDS_NEUTRAL


def test_another_program_stops_the_board():
    bench = pushed()
    bench.board.receive(0x280 + 33, b"", bench.now_s)
    neutral_within(bench, 0.12)
    bench.board.set_wrench(REST)
    state = bench.run(3.0)
    # A stopped board looks like a restarted one.
    assert (state.link, state.wrench) == (DeviceLink.NEEDS_NEUTRAL, None)
    assert "zero is lost" in state.reason
    assert bench.core.metrics(bench.now_s)["unexpected_acks"] == 1
    bench.core.ask_zero(bench.now_s)
    assert bench.run(1.0).link is DeviceLink.LIVE


def test_overload():
    bench = pushed()
    bench.board.set_wrench((0, 0, 250, 0, 0, 0))
    state = bench.run(0.2)
    assert state.axes == REST
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert "Fz is at 135 % of full scale" in state.reason
    assert state.wrench.force.z > 185
    bench.board.set_wrench(PUSH)
    live_only_at_rest(bench)


def test_zero_is_not_taken_of_an_overload():
    bench = Bench()
    bench.board.set_wrench((0, 0, 250, 0, 0, 0))
    bench.open()
    state = bench.run(2.0)
    assert "overloaded" in state.reason
    assert bench.core.zeros == 0
    bench.board.set_wrench(REST)
    assert bench.run(1.0).link is DeviceLink.LIVE


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
    bench = pushed()
    bench.mangle = MANGLED[how]
    neutral_within(bench, 0.12)
    bench.mangle = lambda frame: frame
    bench.run(0.3)
    assert {state.axes for state in bench.states} == {REST}
    bench.board.set_wrench(REST)
    assert bench.run(2.0).link is DeviceLink.LIVE


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
    bench = Bench(Jr3Options(period_s=0.005), faults=faults, seed=3)
    bench.open()
    bench.run(4.0)
    bench.board.set_wrench(PUSH)
    state = bench.run(0.5)
    assert state.link is DeviceLink.LIVE
    assert state.axes[0] == pytest.approx(0.5, abs=0.02)
    assert any(
        "lost" in line or "ignored" in line or "repeat" in line
        for line in bench.core.diagnosis(bench.now_s)
    )


def test_old_samples_are_not_taken_for_new_ones():
    """A stream stalls, then delivers a second's worth at once: only fresh samples count."""
    bench = pushed(Jr3Options(period_s=0.01))
    held = []
    for _ in range(1000):
        bench.now_s += STEP_S
        held += bench.board.reports(bench.now_s)
        bench.core.state(bench.now_s)
    axes = set()
    for frame in held:
        bench.core.on_frame(*frame, bench.now_s)
        axes.add(bench.core.state(bench.now_s).axes)
    assert axes == {REST}
    assert bench.core.metrics(bench.now_s)["late_samples"] > 80
    assert bench.core.state(bench.now_s).link is DeviceLink.NEEDS_NEUTRAL
    assert bench.now_s - bench.core.state(bench.now_s).stamp_s < 0.02


def test_a_clock_that_runs_otherwise_is_not_late():
    """The board's clock may be off: samples keep counting as timely for a minute."""
    for drift in (-0.015, 0.015):
        bench = pushed(Jr3Options(period_s=0.01))
        start_s = bench.now_s
        for _ in range(6000):
            bench.now_s += 0.01
            for frame in bench.board.reports(start_s + (bench.now_s - start_s) * (1.0 + drift)):
                bench.core.on_frame(*frame, bench.now_s)
            bench.core.poll(bench.now_s)
            assert bench.core.state(bench.now_s).link is DeviceLink.LIVE
        assert bench.core.metrics(bench.now_s)["late_samples"] == 0


def test_the_bus_is_lost_and_found():
    bench = pushed(offset=(4, -3, -8, 0.2, -0.1, 0.05))
    bench.core.on_lost("unplugged", bench.now_s)
    state = bench.core.state(bench.now_s)
    assert (state.link, state.axes, state.wrench) == (DeviceLink.LOST, REST, None)
    assert math.isinf(bench.core.next_due_s)
    bench.open()
    live_only_at_rest(bench)  # The pushing force did not become the new zero.
    assert bench.core.zeros == 1
