"""Bounds of the force for any input of the tick, in virtual time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from cardan.common.haptics import (
    Calibration,
    Fixture,
    HapticCommand,
    MeasuredForce,
    OperatingState,
    WorldMap,
)
from cardan.errors import CommandError
from cardan.types import ZERO3, Vector3
from cardan_omni.driver.tick import Tick
from omni_tick_bench import (
    ABOVE,
    BARE,
    BELOW,
    FIXTURES,
    FLOOR,
    NAN,
    PERIOD_S,
    Bench,
    distance,
    rotation,
    size,
)
from tests.examples import examples


def test_the_clamp_keeps_the_direction() -> None:
    bench = Bench(**BARE)
    bench.engage()
    bench.send(force=Vector3(3.0, 0.0, 4.0))
    force = bench.run(0.1)
    assert force == pytest.approx((1.2, 0.0, 1.6))
    assert bench.state.reason == "limited to the largest force"


@settings(max_examples=examples(40))
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.lists(FIXTURES, max_size=4), min_size=1, max_size=6),
    st.booleans(),
)
def test_never_above_the_clamp_and_never_a_step(
    seed: int, scenes: list[list[Fixture]], passivity: bool
) -> None:
    """Fixtures, forces and positions jump; the device docks, the source pauses."""
    random = np.random.default_rng(seed)
    bench = Bench(engage_ramp_s=0.0, velocity_gate_m_s=1e9, passivity=passivity)
    bench.tick.enable()
    limits, before, now = bench.limits, ZERO3, np.zeros(3)
    for scene in scenes:
        force = Vector3(*random.normal(0, 3, 3)) if random.random() < 0.5 else ZERO3
        bench.send(fixtures=tuple(scene), force=ZERO3, engaged=False)
        bench.run(0.01, inkwell=False)
        bench.send(fixtures=(), engaged=True)
        bench.run(0.008)
        bench.send(fixtures=tuple(scene), force=force)
        jumpy = random.random() < 0.3
        end = int(random.integers(20, 60))
        for k in range(60):
            now += random.normal(0, 5e-3 if jumpy else 2e-4, 3)
            gap_s = float(random.choice([1e-3, 1e-3, 1e-3, 0.2e-3, 1.9e-3, 3e-3]))
            previous = bench.forces[-1]
            sent = bench.step(
                silent=k > end and bool(random.random() < 0.9),
                gap_s=gap_s,
                position=Vector3(*now),
                inkwell=k == 55,
            )
            assert size(sent) <= limits.clamp_n
            rate = limits.slew_rise_n_s if size(sent) > size(previous) else limits.slew_fall_n_s
            assert distance(sent, previous) <= rate * gap_s * (1 + 1e-6) + 1e-12
            before = sent
    assert before is not None


def test_new_geometry_gives_no_step() -> None:
    bench = Bench()
    bench.press()
    for world in (
        WorldMap(offset=Vector3(0.0, 0.0, -0.1)),
        WorldMap(),
        WorldMap(rotation=rotation(math.pi / 2, 0.0, 0.0)),  # type: ignore[arg-type]
    ):
        bench.send(world=world)
        for _ in range(40):
            before = bench.forces[-1]
            after = bench.step()
            rate = 50.0 if size(after) > size(before) else 400.0
            assert distance(after, before) <= rate * PERIOD_S * (1 + 1e-6)


def test_force_comes_in_by_a_ramp_after_it_was_small() -> None:
    bench = Bench(**BARE, engage_ramp_s=0.5)
    bench.tick.enable()
    bench.send(fixtures=(FLOOR,))
    assert bench.run(1.0, position=BELOW) == ZERO3, "engaged inside the wall"
    assert "too large to engage" in bench.state.reason
    bench.glide(ABOVE, 0.1)
    bench.run(0.01)
    assert bench.state.reason == "engaging"
    force = bench.glide(BELOW, 0.1)
    assert 0.0 < force.z < 0.8, "a part of the force"
    force = bench.run(0.5)
    assert force.z == pytest.approx(1.5)
    assert bench.state.reason == ""


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ({"inkwell": True}, "inkwell"),
        ({"calibrated": False}, "not calibrated"),
        ({"position": Vector3(NAN, 0.0, 0.0)}, "not finite"),
        ({"velocity": Vector3(0.0, 1.5, 0.0)}, "moved too fast"),
        ({"silent": True}, "stopped coming"),
    ],
)
def test_what_forbids_force_has_it_at_zero_within_5_ms(what: dict[str, Any], reason: str) -> None:
    bench = Bench(clamp_n=2.0)
    bench.press()
    bench.send(force=Vector3(0.0, 0.0, 5.0))
    assert size(bench.run(0.02)) == pytest.approx(2.0)
    if what == {"silent": True}:
        for _ in range(19):
            force = bench.step(**what)
        assert size(force) == pytest.approx(2.0), "held for 20 ms"
    assert bench.zero_after(**what) <= 0.005 + 1e-9
    assert reason in bench.state.reason
    assert bench.run(0.05, **what) == ZERO3


@pytest.mark.parametrize(
    "request_it", [Tick.disable, Tick.pause, lambda tick: None], ids=["disable", "pause", "clutch"]
)
def test_requests_release_within_5_ms(request_it: Callable[[Tick], None]) -> None:
    bench = Bench()
    bench.press()
    request_it(bench.tick)
    if bench.state.state is OperatingState.ENABLED:
        bench.send(engaged=False)
    assert bench.zero_after() <= 0.005 + 1e-9
    assert bench.run(1.0) == ZERO3


def test_a_dead_source_pauses_and_the_next_command_must_be_small_first() -> None:
    bench = Bench()
    bench.press()
    bench.run(0.19, silent=True)
    state = bench.state
    assert state.state is OperatingState.ENABLED
    assert state.stale_commands == 1
    assert bench.run(0.01) != ZERO3, "after a short silence the force returns by itself"
    bench.run(0.205, silent=True)
    assert bench.state.state is OperatingState.PAUSED
    assert bench.run(0.5) == ZERO3, "still deep in the wall"
    assert bench.state.state is OperatingState.ENABLED
    bench.glide(ABOVE, 0.1)
    bench.run(1.1)
    assert bench.glide(BELOW, 0.2).z > 1.0


def test_a_command_with_an_old_stamp_is_as_dead_as_none() -> None:
    bench = Bench()
    bench.press()
    for k in range(40):
        bench.now_s += PERIOD_S
        if k == 0:
            stamp = bench.now_s
        bench.sequence += 1
        bench.tick.command(bench.command._replace(sequence=bench.sequence, stamp_s=stamp))
        force = bench.tick.step(bench.sample._replace(now_s=bench.now_s))
    assert force == ZERO3
    assert bench.state.command_age_s == pytest.approx(39e-3)


def test_a_stamp_of_a_time_to_come_is_not_believed() -> None:
    bench = Bench()
    bench.press()
    bench.tick.command(
        bench.command._replace(sequence=bench.sequence + 1, stamp_s=bench.now_s + 0.9)
    )
    assert bench.zero_after(silent=True) <= 0.005 + 1e-9
    bench.step()
    assert bench.state.dropped_commands == 0, "a stamp in the future does not block later commands"
    assert bench.state.command_age_s == 0.0


@pytest.mark.parametrize("ahead_s", [1.1, 3600.0, 1.7e9, 1e300])
def test_a_stamp_of_another_clock_is_refused_and_changes_nothing(ahead_s: float) -> None:
    bench = Bench()
    bench.press()
    bad = bench.command._replace(sequence=2**60, stamp_s=bench.now_s + ahead_s)
    with pytest.raises(CommandError, match=r"in the future.*monotonic"):
        bench.tick.command(bad)
    for _ in range(100):
        assert bench.step().z == pytest.approx(1.5, abs=0.02)
    assert bench.state.dropped_commands == 0


def test_a_stamp_is_judged_by_the_callers_clock_where_it_has_one() -> None:
    tick = Tick()
    with pytest.raises(CommandError, match="in the future"):
        tick.command(HapticCommand(1, 10.1), now_s=10.0)
    assert tick.command(HapticCommand(1, 10.01), now_s=10.0)


def test_a_stamp_of_another_clock_before_the_first_tick_does_not_block_later_ones() -> None:
    bench = Bench()
    bench.tick.command(bench.command._replace(sequence=2**60, stamp_s=1.7e9))
    bench.press()
    assert bench.state.dropped_commands <= 1


def test_a_stamp_ahead_of_the_clock_makes_no_command_live_longer() -> None:
    bench = Bench()
    bench.press()
    bench.tick.command(
        bench.command._replace(sequence=bench.sequence + 1, stamp_s=bench.now_s + 0.015)
    )
    for _ in range(28):
        force = bench.step(silent=True)
    assert force == ZERO3


def test_stale_commands_are_dropped() -> None:
    tick = Tick()
    assert tick.command(HapticCommand(5, 1.0))
    assert not tick.command(HapticCommand(5, 1.001))
    assert not tick.command(HapticCommand(4, 1.001))
    assert not tick.command(HapticCommand(6, 0.999))
    assert tick.snapshot().dropped_commands == 3
    assert tick.command(HapticCommand(6, 1.0))
    assert tick.command(HapticCommand(1, 1.2)), "another source, after a silence"


def test_a_flying_stylus_is_a_fault_until_enabled() -> None:
    bench = Bench()
    bench.press()
    height = BELOW.z
    for _ in range(30):
        height += 1.2e-3
        bench.step(position=Vector3(0.0, 0.0, height))
    state = bench.state
    assert state.state is OperatingState.FAULT
    assert "moved too fast" in state.reason
    assert state.faults == 1
    assert state.force == ZERO3
    bench.run(1.0)
    assert bench.state.state is OperatingState.FAULT
    bench.tick.enable()
    bench.run(1.1)
    assert bench.state.state is OperatingState.ENABLED
    assert bench.glide(BELOW, 0.3).z > 1.0


def test_a_fast_hand_without_force_is_none() -> None:
    bench = Bench()
    bench.tick.enable()
    bench.send(engaged=False)
    bench.run(0.1, velocity=Vector3(3.0, 0.0, 0.0))
    assert bench.state.state is OperatingState.ENABLED


def test_continuous_force_is_derated_to_what_the_motors_bear() -> None:
    bench = Bench(passivity=False, engage_ramp_s=0.0)
    bench.engage()
    bench.send(force=Vector3(2.0, 0.0, 0.0))
    bench.run(30.0)
    assert size(bench.forces[-1]) == pytest.approx(0.88, abs=0.01)
    state = bench.state
    assert state.thermal_derating == pytest.approx(0.44, abs=0.01)
    assert state.reason == "limited to spare the motors"
    mean = 0.0
    for f in bench.forces:
        mean += (size(f) ** 2 - mean) * PERIOD_S / 10.0
        assert mean <= 0.88**2 * (1 + 1e-3)
    bench.send(force=ZERO3)
    bench.run(15.0)
    assert bench.state.thermal_derating == 1.0


@pytest.mark.parametrize(("temperature", "share"), [(0.6, 1.0), (0.8, 0.5), (0.9, 0.0), (1.0, 0.0)])
def test_warm_motors_get_less(temperature: float, share: float) -> None:
    bench = Bench()
    bench.engage()
    bench.send(force=Vector3(2.0, 0.0, 0.0))
    force = bench.run(0.1, temperature=temperature)
    assert size(force) == pytest.approx(2.0 * share, abs=1e-9)


def test_oscillating_halves_the_force_then_pauses() -> None:
    bench = Bench(passivity=False, damping_n_s_m=0.0)
    bench.press()
    halved = False
    for k in range(1000):  # noqa: B007
        bench.step(
            position=Vector3(0.0, 0.0, BELOW.z + 2e-4 * math.sin(2 * math.pi * 60 * bench.now_s))
        )
        state = bench.state
        halved = halved or state.reason == "it oscillated: force reduced"
        if state.state is OperatingState.PAUSED:
            break
    assert halved
    assert 0.05 < k * PERIOD_S < 0.4
    assert bench.tick.details().oscillations == 2
    bench.glide(ABOVE, 0.5)
    assert bench.state.state is OperatingState.PAUSED, "it does not resume by itself"
    bench.send(engaged=False)
    bench.run(0.01)
    bench.send(engaged=True)
    bench.run(1.1)
    assert bench.glide(BELOW, 0.2).z > 1.0


def test_a_late_tick_asks_for_no_force_and_a_long_gap_pauses() -> None:
    bench = Bench()
    bench.press()
    assert bench.step(gap_s=0.0021).z == pytest.approx(1.5 - 0.4, abs=0.02)
    assert bench.state.reason == "the tick was late"
    assert bench.run(0.009).z == pytest.approx(1.5, abs=0.02), "no hole of 40 ms"
    assert bench.run(0.1).z == pytest.approx(1.5, abs=0.02)
    assert bench.step(gap_s=0.006) == ZERO3
    assert bench.state.late_ticks == 2
    bench.run(0.1)
    assert bench.step(gap_s=0.025) == ZERO3
    assert bench.state.state is OperatingState.PAUSED
    assert not bench.state.rendering


@pytest.mark.parametrize("what", ["silence", "late tick", "unsound"])
def test_after_an_interruption_the_force_comes_back_by_the_ramp(what: str) -> None:
    bench = Bench()
    bench.press()
    if what == "silence":
        for _ in range(40):
            bench.step(silent=True)
    elif what == "late tick":
        bench.step(gap_s=0.006)
    else:
        for _ in range(6):
            bench.step(unsound=True)
        bench.sample = bench.sample._replace(unsound=False)
    assert bench.forces[-1] == ZERO3
    assert bench.state.state is OperatingState.ENABLED
    start = len(bench.forces)
    bench.run(0.12)
    back = [round(force.z, 9) for force in bench.forces[start:]]
    assert back[29] < 0.3 * 1.5 + 0.1, "the ramp is slower than the slew limit"
    assert back[-1] == pytest.approx(1.5, abs=0.02)
    assert back == sorted(back)


def test_a_source_that_stutters_is_paused_and_begins_small_once_it_is_steady() -> None:
    """A command every 71 ms would otherwise render a sawtooth of 14 Hz for ever."""
    bench = Bench()
    bench.press()
    before = bench.state.energy_j
    for _ in range(6):
        bench.step()
        for _ in range(70):
            bench.step(silent=True)
    state = bench.state
    assert state.state is OperatingState.PAUSED
    assert "too irregular" in state.reason
    assert all(force == ZERO3 for force in bench.forces[-2 * 71 :])
    bench.run(0.4)
    assert bench.state.state is OperatingState.PAUSED, "not steady for long enough"
    bench.run(0.2)
    assert bench.state.state is OperatingState.ENABLED
    assert bench.run(0.5) == ZERO3
    assert "too large to engage" in bench.state.reason
    bench.glide(ABOVE, 0.1)
    bench.run(1.1)
    assert bench.glide(BELOW, 0.2).z > 1.0
    assert before > 0.0


def test_late_ticks_again_and_again_are_paused_too() -> None:
    bench = Bench()
    bench.press()
    for k in range(400):
        bench.step(gap_s=0.006 if k % 100 == 99 else PERIOD_S)
    assert "too irregular" in bench.state.reason


def test_a_few_interruptions_far_from_each_other_are_none() -> None:
    bench = Bench()
    bench.press()
    for _ in range(8):
        bench.run(0.4)
        bench.step(gap_s=0.006)
    assert bench.state.state is OperatingState.ENABLED


def test_interruptions_are_of_the_same_engagement() -> None:
    bench = Bench(passivity=False)
    bench.press()
    before = bench.state.given_peak_j, bench.state.energy_j
    for _ in range(6):
        bench.step()
        for _ in range(70):
            bench.step(silent=True)
    bench.run(0.6)
    assert bench.state.energy_j == pytest.approx(before[1], abs=1e-4)
    assert bench.state.given_peak_j == before[0]


@pytest.mark.parametrize("rate_hz", [500, 700, 880])
def test_a_slow_loop_gives_no_force_and_engages_anew(rate_hz: int) -> None:
    bench = Bench()
    bench.press()
    for _ in range(rate_hz // 2):
        bench.step(gap_s=1.0 / rate_hz)
        assert distance(bench.forces[-1], bench.forces[-2]) <= 0.4 / rate_hz * 1000 + 1e-9
    state = bench.state
    assert state.force == ZERO3
    assert not state.rendering
    assert state.reason in ("the force loop is too slow for force", "the tick was late")
    assert bench.run(0.5) == ZERO3
    assert "too large to engage" in bench.state.reason
    bench.glide(ABOVE, 0.1)
    bench.run(1.1)
    assert bench.glide(BELOW, 0.2).z > 1.0


def test_around_the_lowest_rate_the_force_does_not_flutter() -> None:
    bench = Bench()
    bench.press()
    changes, before = 0, True
    for k in range(3000):
        bench.step(gap_s=1.0 / (895.0 if k // 100 % 2 else 910.0))
        rendering = bench.state.rendering
        changes += rendering is not before
        before = rendering
    assert changes <= 1


def test_one_stall_is_no_slow_loop() -> None:
    bench = Bench()
    bench.press()
    bench.step(gap_s=0.019)
    bench.run(0.02)
    bench.step(gap_s=0.015)
    reasons = set()
    for _ in range(200):
        bench.step()
        reasons.add(bench.state.reason)
    assert "the force loop is too slow for force" not in reasons
    assert bench.forces[-1].z == pytest.approx(1.5, abs=0.02)


def test_while_the_motors_are_off_nothing_is_asked_of_them() -> None:
    bench = Bench()
    bench.press()
    bench.tick.allow(False)
    assert bench.zero_after() <= 0.005 + 1e-9
    assert bench.state.reason == "the motors are not on"
    assert not bench.state.rendering
    bench.tick.allow(True)
    assert bench.run(0.3) == ZERO3, "a new engagement begins"


def test_what_was_lost_is_a_fault_until_enabled() -> None:
    bench = Bench()
    bench.press()
    bench.tick.lose()
    state = bench.state
    assert (state.state, state.faults) == (OperatingState.FAULT, 1)
    assert "lost" in state.reason
    bench.tick.lose()
    assert bench.state.faults == 1
    assert bench.zero_after() <= 0.005 + 1e-9
    bench.glide(ABOVE, 0.1)
    bench.run(1.2)
    assert bench.glide(BELOW, 0.2) == ZERO3
    # A lost tick has no clock: commands are ordered by their sequence only.
    bench.tick.lose()
    assert bench.tick.command(bench.command._replace(sequence=10**6, stamp_s=bench.now_s + 3600.0))


def test_readings_that_fail_are_no_readings() -> None:
    bench = Bench()
    bench.press()
    good = bench.state
    before = bench.now_s
    for k in range(120):
        bench.step(unsound=True, position=Vector3(0.3, 0.3, 0.3), buttons=3, calibrated=False)
        state = bench.state
        assert state.stamp_s == pytest.approx(before)
        assert (state.pose, state.presses) == (good.pose, good.presses)
        assert state.calibration is Calibration.OK
        assert (state.state is OperatingState.FAULT) is (k >= 100)
        if k >= 6:
            assert state.force == ZERO3
    assert "readings fail" in bench.state.reason
    assert bench.tick.details().bad_readings == 120


def test_before_the_first_sound_reading_there_is_none() -> None:
    bench = Bench()
    bench.step(unsound=True, position=Vector3(0.3, 0.3, 0.3))
    assert (bench.state.pose, bench.state.stamp_s) == (None, -math.inf)


def test_after_a_short_stall_the_force_is_back_within_a_tenth_of_a_second() -> None:
    """The hand leaning on the wall has begun to fall, and would otherwise never get a small
    force."""
    bench = Bench()
    bench.press()
    bench.step(gap_s=0.025)
    norms = [round(bench.run(0.01).z, 9) for _ in range(13)]
    assert norms == sorted(norms)
    assert norms[3] < 0.8
    assert norms[-1] == pytest.approx(1.5, abs=0.02)
    assert bench.state.state is OperatingState.ENABLED
    assert bench.state.rendering
    assert bench.state.given_peak_j <= bench.limits.energy_budget_j


def stall_and_then(bench: Bench, what: str) -> str:
    """Stall for 25 ms and continue by `what`, or stall by `what`; return the state's reason."""
    if what == "gap of 10 s":
        bench.step(gap_s=10.0)
        return bench.state.reason
    if what == "gap of 210 ms":
        bench.step(gap_s=0.21)
        return bench.state.reason
    if what == "gaps for 0.3 s":
        for _ in range(12):
            bench.step(gap_s=0.025)
        return bench.state.reason
    bench.tick.allow(what != "motors off")
    elsewhere = {"docked": {"inkwell": True}, "not calibrated": {"calibrated": False}}.get(what, {})
    bench.step(gap_s=0.025, silent=what.startswith("silence"), **elsewhere)
    assert bench.state.state is OperatingState.PAUSED
    if what == "silence of 10 s":
        for _ in range(10_000):
            bench.step(silent=True)
    elif what == "silence of 0.2 s":
        for _ in range(180):
            bench.step(silent=True)
    elif what == "fault":
        bench.step(silent=True, position=Vector3(NAN, 0.0, 0.0))
        bench.tick.enable()
        bench.sample = bench.sample._replace(position=BELOW)
    reason = bench.state.reason
    bench.tick.allow(True)
    bench.sample = bench.sample._replace(inkwell=False, calibrated=True)
    return reason


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("gap of 10 s", "stalled"),
        ("gap of 210 ms", "stalled"),
        ("gaps for 0.3 s", "stalled"),
        ("silence of 10 s", "commands stopped coming"),
        ("silence of 0.2 s", "commands stopped coming"),
        ("docked", "stalled"),
        ("not calibrated", "stalled"),
        ("motors off", "stalled"),
        ("fault", ""),
    ],
)
def test_after_more_than_a_short_stall_the_force_must_be_small_first(
    what: str, reason: str
) -> None:
    bench = Bench()
    bench.press()
    assert reason in stall_and_then(bench, what)
    assert bench.forces[-1] == ZERO3
    assert bench.run(1.0) == ZERO3, "still deep in the wall"
    assert bench.state.state is OperatingState.ENABLED
    assert "too large to engage" in bench.state.reason
    bench.glide(ABOVE, 0.1)
    bench.run(0.01)
    assert bench.state.reason == "engaging"
    assert bench.glide(BELOW, 0.1).z < 0.5, "the whole engagement ramp applies"
    bench.run(1.0)
    assert bench.forces[-1].z == pytest.approx(1.5, abs=0.02)


@pytest.mark.parametrize("what", ["gap of 190 ms", "silence of 0.15 s"])
def test_a_stall_shorter_than_the_pause_resumes(what: str) -> None:
    bench = Bench()
    bench.press()
    if what == "gap of 190 ms":
        bench.step(gap_s=0.19)
    else:
        bench.step(gap_s=0.025, silent=True)
        for _ in range(125):
            bench.step(silent=True)
    assert bench.state.state is OperatingState.PAUSED
    bench.step()
    assert bench.state.reason == "engaging"
    assert bench.run(0.13).z == pytest.approx(1.5, abs=0.02)


def test_a_long_gap_while_nothing_was_let_out_changes_nothing_of_that() -> None:
    bench = Bench()
    bench.press()
    bench.tick.pause()
    bench.run(0.02)
    bench.step(gap_s=0.025)
    bench.tick.resume()
    assert bench.run(0.5) == ZERO3
    assert "too large to engage" in bench.state.reason


def test_the_largest_force_is_remembered() -> None:
    bench = Bench()
    bench.press()
    bench.tick.disable()
    bench.run(0.1)
    assert bench.state.force == ZERO3
    assert bench.state.peak_n == pytest.approx(1.5, abs=0.05)


def test_a_clock_that_stands_still_or_goes_back_gives_no_step() -> None:
    bench = Bench()
    before = bench.press()
    bench.send(force=Vector3(0.0, 5.0, 0.0))
    assert bench.step(gap_s=0.0) == before
    assert bench.step(gap_s=-0.5, silent=True) == before


def test_after_a_late_tick_the_librarys_velocity_is_no_flight() -> None:
    bench = Bench()
    bench.press()
    bench.step(gap_s=0.03, velocity=Vector3(0.0, 0.0, 1.6))
    bench.run(0.02, velocity=Vector3(0.0, 0.0, 1.2))
    assert bench.state.state is not OperatingState.FAULT
    bench.run(0.2)
    bench.step(velocity=Vector3(0.0, 0.0, 1.2))
    assert bench.state.state is OperatingState.FAULT


def test_under_a_clock_that_stands_the_force_goes() -> None:
    bench = Bench()
    assert bench.press().z > 1.4
    for _ in range(19):
        bench.step(gap_s=0.0)
    assert [bench.step(gap_s=0.0).z for _ in range(6)][-1] == 0.0
    assert bench.state.stale_commands == 1


def test_a_new_engagement_does_not_resume_the_old_one() -> None:
    bench = Bench()
    bench.press()
    bench.step(gap_s=0.025)
    bench.tick.disable()
    bench.tick.enable()
    assert bench.run(0.5) == ZERO3
    assert "too large to engage" in bench.state.reason


def test_a_measured_force_of_a_time_to_come_is_not_felt() -> None:
    bench = Bench()
    bench.engage()
    bench.send(measured=MeasuredForce(Vector3(0.0, 0.0, 1.0), bench.now_s + 100.0))
    assert bench.run(0.1) == ZERO3
    assert bench.state.force_age_s == math.inf


def test_maxima_are_since_the_snapshot_before() -> None:
    bench = Bench()
    bench.run(0.01)
    bench.step(gap_s=0.004)
    bench.run(0.01)
    assert bench.state.gap_s == pytest.approx(0.004)
    bench.run(0.01)
    assert bench.state.gap_s == pytest.approx(0.001)
