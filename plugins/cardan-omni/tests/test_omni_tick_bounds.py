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
from omni_tick_rig import (
    ABOVE,
    BARE,
    BELOW,
    FIXTURES,
    FLOOR,
    NAN,
    PERIOD_S,
    Rig,
    distance,
    rotation,
    size,
)
from tests.examples import examples


def test_the_clamp_keeps_the_direction() -> None:
    rig = Rig(**BARE)
    rig.engage()
    rig.send(force=Vector3(3.0, 0.0, 4.0))
    force = rig.run(0.1)
    assert force == pytest.approx((1.2, 0.0, 1.6))
    assert rig.state.reason == "limited to the largest force"


@settings(max_examples=examples(40))
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.lists(FIXTURES, max_size=4), min_size=1, max_size=6),
    st.booleans(),
)
def test_never_above_the_clamp_and_never_a_step(
    seed: int, scenes: list[list[Fixture]], passivity: bool
) -> None:
    """Scenes, plain forces and positions jump about; the device docks, the source pauses."""
    random = np.random.default_rng(seed)
    rig = Rig(engage_ramp_s=0.0, velocity_gate_m_s=1e9, passivity=passivity)
    rig.tick.enable()
    limits, before, now = rig.limits, ZERO3, np.zeros(3)
    for scene in scenes:
        force = Vector3(*random.normal(0, 3, 3)) if random.random() < 0.5 else ZERO3
        rig.send(fixtures=tuple(scene), force=ZERO3, engaged=False)
        rig.run(0.01, inkwell=False)
        rig.send(fixtures=(), engaged=True)
        rig.run(0.008)
        rig.send(fixtures=tuple(scene), force=force)
        jumpy = random.random() < 0.3
        end = int(random.integers(20, 60))
        for k in range(60):
            now += random.normal(0, 5e-3 if jumpy else 2e-4, 3)
            gap_s = float(random.choice([1e-3, 1e-3, 1e-3, 0.2e-3, 1.9e-3, 3e-3]))
            previous = rig.forces[-1]
            sent = rig.step(
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
    rig = Rig()
    rig.press()
    for world in (
        WorldMap(offset=Vector3(0.0, 0.0, -0.1)),
        WorldMap(),
        WorldMap(rotation=rotation(math.pi / 2, 0.0, 0.0)),  # type: ignore[arg-type]
    ):
        rig.send(world=world)
        for _ in range(40):
            before = rig.forces[-1]
            after = rig.step()
            rate = 50.0 if size(after) > size(before) else 400.0
            assert distance(after, before) <= rate * PERIOD_S * (1 + 1e-6)


def test_force_comes_in_by_a_ramp_after_it_was_small() -> None:
    rig = Rig(**BARE, engage_ramp_s=0.5)
    rig.tick.enable()
    rig.send(fixtures=(FLOOR,))
    assert rig.run(1.0, position=BELOW) == ZERO3, "engaged inside the wall"
    assert "too large to engage" in rig.state.reason
    rig.glide(ABOVE, 0.1)
    rig.run(0.01)
    assert rig.state.reason == "engaging"
    force = rig.glide(BELOW, 0.1)
    assert 0.0 < force.z < 0.8, "a part of it"
    force = rig.run(0.5)
    assert force.z == pytest.approx(1.5)
    assert rig.state.reason == ""


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ({"inkwell": True}, "inkwell"),
        ({"calibrated": False}, "not calibrated"),
        ({"position": Vector3(NAN, 0.0, 0.0)}, "not finite"),
        ({"velocity": Vector3(0.0, 1.5, 0.0)}, "flew"),
        ({"silent": True}, "stopped coming"),
    ],
)
def test_what_forbids_force_has_it_at_zero_within_5_ms(what: dict[str, Any], reason: str) -> None:
    rig = Rig(clamp_n=2.0)
    rig.press()
    rig.send(force=Vector3(0.0, 0.0, 5.0))
    assert size(rig.run(0.02)) == pytest.approx(2.0)
    if what == {"silent": True}:
        for _ in range(19):
            force = rig.step(**what)
        assert size(force) == pytest.approx(2.0), "held for 20 ms"
    assert rig.zero_after(**what) <= 0.005 + 1e-9
    assert reason in rig.state.reason
    assert rig.run(0.05, **what) == ZERO3


@pytest.mark.parametrize(
    "request_it", [Tick.disable, Tick.pause, lambda tick: None], ids=["disable", "pause", "clutch"]
)
def test_requests_release_within_5_ms(request_it: Callable[[Tick], None]) -> None:
    rig = Rig()
    rig.press()
    request_it(rig.tick)
    if rig.state.state is OperatingState.ENABLED:
        rig.send(engaged=False)
    assert rig.zero_after() <= 0.005 + 1e-9
    assert rig.run(1.0) == ZERO3


def test_a_dead_source_pauses_and_the_next_command_must_be_small_first() -> None:
    rig = Rig()
    rig.press()
    rig.run(0.19, silent=True)
    state = rig.state
    assert state.state is OperatingState.ENABLED
    assert state.stale_commands == 1
    assert rig.run(0.01) != ZERO3, "a short silence: it comes back by itself"
    rig.run(0.205, silent=True)
    assert rig.state.state is OperatingState.PAUSED
    assert rig.run(0.5) == ZERO3, "still deep in the wall"
    assert rig.state.state is OperatingState.ENABLED
    rig.glide(ABOVE, 0.1)
    rig.run(1.1)
    assert rig.glide(BELOW, 0.2).z > 1.0


def test_a_command_with_an_old_stamp_is_as_dead_as_none() -> None:
    rig = Rig()
    rig.press()
    for k in range(40):
        rig.now_s += PERIOD_S
        if k == 0:
            stamp = rig.now_s
        rig.sequence += 1
        rig.tick.command(rig.command._replace(sequence=rig.sequence, stamp_s=stamp))
        force = rig.tick.step(rig.sample._replace(now_s=rig.now_s))
    assert force == ZERO3
    assert rig.state.command_age_s == pytest.approx(39e-3)


def test_a_stamp_of_a_time_to_come_is_not_believed() -> None:
    rig = Rig()
    rig.press()
    rig.tick.command(rig.command._replace(sequence=rig.sequence + 1, stamp_s=rig.now_s + 0.9))
    assert rig.zero_after(silent=True) <= 0.005 + 1e-9
    rig.step()
    assert rig.state.dropped_commands == 0, "nor does it stand in the way of others"
    assert rig.state.command_age_s == 0.0


@pytest.mark.parametrize("ahead_s", [1.1, 3600.0, 1.7e9, 1e300])
def test_a_stamp_of_another_clock_is_refused_and_changes_nothing(ahead_s: float) -> None:
    rig = Rig()
    rig.press()
    bad = rig.command._replace(sequence=2**60, stamp_s=rig.now_s + ahead_s)
    with pytest.raises(CommandError, match=r"in the future.*monotonic"):
        rig.tick.command(bad)
    for _ in range(100):
        assert rig.step().z == pytest.approx(1.5, abs=0.02)
    assert rig.state.dropped_commands == 0


def test_a_stamp_is_judged_by_the_callers_clock_where_it_has_one() -> None:
    tick = Tick()
    with pytest.raises(CommandError, match="in the future"):
        tick.command(HapticCommand(1, 10.1), now_s=10.0)
    assert tick.command(HapticCommand(1, 10.01), now_s=10.0)


def test_a_stamp_of_another_clock_before_the_first_tick_does_not_block_later_ones() -> None:
    rig = Rig()
    rig.tick.command(rig.command._replace(sequence=2**60, stamp_s=1.7e9))
    rig.press()
    assert rig.state.dropped_commands <= 1


def test_a_stamp_ahead_of_the_clock_makes_no_command_live_longer() -> None:
    rig = Rig()
    rig.press()
    rig.tick.command(rig.command._replace(sequence=rig.sequence + 1, stamp_s=rig.now_s + 0.015))
    for _ in range(28):
        force = rig.step(silent=True)
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
    rig = Rig()
    rig.press()
    height = BELOW.z
    for _ in range(30):
        height += 1.2e-3
        rig.step(position=Vector3(0.0, 0.0, height))
    state = rig.state
    assert state.state is OperatingState.FAULT
    assert "flew" in state.reason
    assert state.faults == 1
    assert state.force == ZERO3
    rig.run(1.0)
    assert rig.state.state is OperatingState.FAULT
    rig.tick.enable()
    rig.run(1.1)
    assert rig.state.state is OperatingState.ENABLED
    assert rig.glide(BELOW, 0.3).z > 1.0


def test_a_fast_hand_without_force_is_none() -> None:
    rig = Rig()
    rig.tick.enable()
    rig.send(engaged=False)
    rig.run(0.1, velocity=Vector3(3.0, 0.0, 0.0))
    assert rig.state.state is OperatingState.ENABLED


def test_continuous_force_is_derated_to_what_the_motors_bear() -> None:
    rig = Rig(passivity=False, engage_ramp_s=0.0)
    rig.engage()
    rig.send(force=Vector3(2.0, 0.0, 0.0))
    rig.run(30.0)
    assert size(rig.forces[-1]) == pytest.approx(0.88, abs=0.01)
    state = rig.state
    assert state.thermal_derating == pytest.approx(0.44, abs=0.01)
    assert state.reason == "limited to spare the motors"
    mean = 0.0
    for f in rig.forces:
        mean += (size(f) ** 2 - mean) * PERIOD_S / 10.0
        assert mean <= 0.88**2 * (1 + 1e-3)
    rig.send(force=ZERO3)
    rig.run(15.0)
    assert rig.state.thermal_derating == 1.0


@pytest.mark.parametrize(("temperature", "share"), [(0.6, 1.0), (0.8, 0.5), (0.9, 0.0), (1.0, 0.0)])
def test_warm_motors_get_less(temperature: float, share: float) -> None:
    rig = Rig()
    rig.engage()
    rig.send(force=Vector3(2.0, 0.0, 0.0))
    force = rig.run(0.1, temperature=temperature)
    assert size(force) == pytest.approx(2.0 * share, abs=1e-9)


def test_oscillating_halves_the_force_then_pauses() -> None:
    rig = Rig(passivity=False, damping_n_s_m=0.0)
    rig.press()
    halved = False
    for k in range(1000):  # noqa: B007
        rig.step(
            position=Vector3(0.0, 0.0, BELOW.z + 2e-4 * math.sin(2 * math.pi * 60 * rig.now_s))
        )
        state = rig.state
        halved = halved or state.reason == "it oscillated: force reduced"
        if state.state is OperatingState.PAUSED:
            break
    assert halved
    assert 0.05 < k * PERIOD_S < 0.4
    assert rig.tick.details().oscillations == 2
    rig.glide(ABOVE, 0.5)
    assert rig.state.state is OperatingState.PAUSED, "not by itself"
    rig.send(engaged=False)
    rig.run(0.01)
    rig.send(engaged=True)
    rig.run(1.1)
    assert rig.glide(BELOW, 0.2).z > 1.0


def test_a_late_tick_asks_for_no_force_and_a_long_gap_pauses() -> None:
    rig = Rig()
    rig.press()
    assert rig.step(gap_s=0.0021).z == pytest.approx(1.5 - 0.4, abs=0.02)
    assert rig.state.reason == "the tick was late"
    assert rig.run(0.009).z == pytest.approx(1.5, abs=0.02), "no hole of 40 ms"
    assert rig.run(0.1).z == pytest.approx(1.5, abs=0.02)
    assert rig.step(gap_s=0.006) == ZERO3
    assert rig.state.late_ticks == 2
    rig.run(0.1)
    assert rig.step(gap_s=0.025) == ZERO3
    assert rig.state.state is OperatingState.PAUSED
    assert not rig.state.rendering


@pytest.mark.parametrize("what", ["silence", "late tick", "unsound"])
def test_after_an_interruption_the_force_comes_back_by_the_ramp(what: str) -> None:
    rig = Rig()
    rig.press()
    if what == "silence":
        for _ in range(40):
            rig.step(silent=True)
    elif what == "late tick":
        rig.step(gap_s=0.006)
    else:
        for _ in range(6):
            rig.step(unsound=True)
        rig.sample = rig.sample._replace(unsound=False)
    assert rig.forces[-1] == ZERO3
    assert rig.state.state is OperatingState.ENABLED
    start = len(rig.forces)
    rig.run(0.12)
    back = [round(force.z, 9) for force in rig.forces[start:]]
    assert back[29] < 0.3 * 1.5 + 0.1, "at the slew limit it would be all there"
    assert back[-1] == pytest.approx(1.5, abs=0.02)
    assert back == sorted(back)


def test_a_source_that_stutters_is_paused_and_begins_small_once_it_is_steady() -> None:
    """A command each 71 ms would be a sawtooth of 14 Hz for ever."""
    rig = Rig()
    rig.press()
    before = rig.state.energy_j
    for _ in range(6):
        rig.step()
        for _ in range(70):
            rig.step(silent=True)
    state = rig.state
    assert state.state is OperatingState.PAUSED
    assert "too irregular" in state.reason
    assert all(force == ZERO3 for force in rig.forces[-2 * 71 :])
    rig.run(0.4)
    assert rig.state.state is OperatingState.PAUSED, "not calm for long enough"
    rig.run(0.2)
    assert rig.state.state is OperatingState.ENABLED
    assert rig.run(0.5) == ZERO3
    assert "too large to engage" in rig.state.reason
    rig.glide(ABOVE, 0.1)
    rig.run(1.1)
    assert rig.glide(BELOW, 0.2).z > 1.0
    assert before > 0.0


def test_late_ticks_again_and_again_are_paused_too() -> None:
    rig = Rig()
    rig.press()
    for k in range(400):
        rig.step(gap_s=0.006 if k % 100 == 99 else PERIOD_S)
    assert "too irregular" in rig.state.reason


def test_a_few_interruptions_far_from_each_other_are_none() -> None:
    rig = Rig()
    rig.press()
    for _ in range(8):
        rig.run(0.4)
        rig.step(gap_s=0.006)
    assert rig.state.state is OperatingState.ENABLED


def test_interruptions_are_of_the_same_engagement() -> None:
    rig = Rig(passivity=False)
    rig.press()
    before = rig.state.given_peak_j, rig.state.energy_j
    for _ in range(6):
        rig.step()
        for _ in range(70):
            rig.step(silent=True)
    rig.run(0.6)
    assert rig.state.energy_j == pytest.approx(before[1], abs=1e-4)
    assert rig.state.given_peak_j == before[0]


@pytest.mark.parametrize("rate_hz", [500, 700, 880])
def test_a_slow_loop_gives_no_force_and_engages_anew(rate_hz: int) -> None:
    rig = Rig()
    rig.press()
    for _ in range(rate_hz // 2):
        rig.step(gap_s=1.0 / rate_hz)
        assert distance(rig.forces[-1], rig.forces[-2]) <= 0.4 / rate_hz * 1000 + 1e-9
    state = rig.state
    assert state.force == ZERO3
    assert not state.rendering
    assert state.reason in ("the force loop is too slow for force", "the tick was late")
    assert rig.run(0.5) == ZERO3
    assert "too large to engage" in rig.state.reason
    rig.glide(ABOVE, 0.1)
    rig.run(1.1)
    assert rig.glide(BELOW, 0.2).z > 1.0


def test_around_the_lowest_rate_the_force_does_not_flutter() -> None:
    rig = Rig()
    rig.press()
    changes, before = 0, True
    for k in range(3000):
        rig.step(gap_s=1.0 / (895.0 if k // 100 % 2 else 910.0))
        rendering = rig.state.rendering
        changes += rendering is not before
        before = rendering
    assert changes <= 1


def test_one_stall_is_no_slow_loop() -> None:
    rig = Rig()
    rig.press()
    rig.step(gap_s=0.019)
    rig.run(0.02)
    rig.step(gap_s=0.015)
    reasons = set()
    for _ in range(200):
        rig.step()
        reasons.add(rig.state.reason)
    assert "the force loop is too slow for force" not in reasons
    assert rig.forces[-1].z == pytest.approx(1.5, abs=0.02)


def test_while_the_motors_are_off_nothing_is_asked_of_them() -> None:
    rig = Rig()
    rig.press()
    rig.tick.allow(False)
    assert rig.zero_after() <= 0.005 + 1e-9
    assert rig.state.reason == "the motors are not on"
    assert not rig.state.rendering
    rig.tick.allow(True)
    assert rig.run(0.3) == ZERO3, "it engages anew"


def test_what_was_lost_is_a_fault_until_enabled() -> None:
    rig = Rig()
    rig.press()
    rig.tick.lose()
    state = rig.state
    assert (state.state, state.faults) == (OperatingState.FAULT, 1)
    assert "lost" in state.reason
    rig.tick.lose()
    assert rig.state.faults == 1
    assert rig.zero_after() <= 0.005 + 1e-9
    rig.glide(ABOVE, 0.1)
    rig.run(1.2)
    assert rig.glide(BELOW, 0.2) == ZERO3
    # A tick that is not stepped has no clock: commands are accepted, by their own order.
    rig.tick.lose()
    assert rig.tick.command(rig.command._replace(sequence=10**6, stamp_s=rig.now_s + 3600.0))


def test_readings_that_fail_are_no_readings() -> None:
    rig = Rig()
    rig.press()
    good = rig.state
    before = rig.now_s
    for k in range(120):
        rig.step(unsound=True, position=Vector3(0.3, 0.3, 0.3), buttons=3, calibrated=False)
        state = rig.state
        assert state.stamp_s == pytest.approx(before)
        assert (state.pose, state.presses) == (good.pose, good.presses)
        assert state.calibration is Calibration.OK
        assert (state.state is OperatingState.FAULT) is (k >= 100)
        if k >= 6:
            assert state.force == ZERO3
    assert "readings fail" in rig.state.reason
    assert rig.tick.details().bad_readings == 120


def test_before_the_first_sound_reading_there_is_none() -> None:
    rig = Rig()
    rig.step(unsound=True, position=Vector3(0.3, 0.3, 0.3))
    assert (rig.state.pose, rig.state.stamp_s) == (None, -math.inf)


def test_after_a_short_stall_the_force_is_back_within_a_tenth_of_a_second() -> None:
    """A hand that leant on it has begun to fall: it would never find a small force again."""
    rig = Rig()
    rig.press()
    rig.step(gap_s=0.025)
    norms = [round(rig.run(0.01).z, 9) for _ in range(13)]
    assert norms == sorted(norms)
    assert norms[3] < 0.8
    assert norms[-1] == pytest.approx(1.5, abs=0.02)
    assert rig.state.state is OperatingState.ENABLED
    assert rig.state.rendering
    assert rig.state.given_peak_j <= rig.limits.energy_budget_j


def stall_and_then(rig: Rig, what: str) -> str:
    """Stall for 25 ms and go on by `what`, or stall by `what`; return the reason shown then."""
    if what == "gap of 10 s":
        rig.step(gap_s=10.0)
        return rig.state.reason
    if what == "gap of 210 ms":
        rig.step(gap_s=0.21)
        return rig.state.reason
    if what == "gaps for 0.3 s":
        for _ in range(12):
            rig.step(gap_s=0.025)
        return rig.state.reason
    rig.tick.allow(what != "motors off")
    elsewhere = {"docked": {"inkwell": True}, "not calibrated": {"calibrated": False}}.get(what, {})
    rig.step(gap_s=0.025, silent=what.startswith("silence"), **elsewhere)
    assert rig.state.state is OperatingState.PAUSED
    if what == "silence of 10 s":
        for _ in range(10_000):
            rig.step(silent=True)
    elif what == "silence of 0.2 s":
        for _ in range(180):
            rig.step(silent=True)
    elif what == "fault":
        rig.step(silent=True, position=Vector3(NAN, 0.0, 0.0))
        rig.tick.enable()
        rig.sample = rig.sample._replace(position=BELOW)
    reason = rig.state.reason
    rig.tick.allow(True)
    rig.sample = rig.sample._replace(inkwell=False, calibrated=True)
    return reason


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("gap of 10 s", "stood still"),
        ("gap of 210 ms", "stood still"),
        ("gaps for 0.3 s", "stood still"),
        ("silence of 10 s", "commands stopped coming"),
        ("silence of 0.2 s", "commands stopped coming"),
        ("docked", "stood still"),
        ("not calibrated", "stood still"),
        ("motors off", "stood still"),
        ("fault", ""),
    ],
)
def test_after_more_than_a_short_stall_the_force_must_be_small_first(
    what: str, reason: str
) -> None:
    rig = Rig()
    rig.press()
    assert reason in stall_and_then(rig, what)
    assert rig.forces[-1] == ZERO3
    assert rig.run(1.0) == ZERO3, "still deep in the wall"
    assert rig.state.state is OperatingState.ENABLED
    assert "too large to engage" in rig.state.reason
    rig.glide(ABOVE, 0.1)
    rig.run(0.01)
    assert rig.state.reason == "engaging"
    assert rig.glide(BELOW, 0.1).z < 0.5, "by the whole ramp"
    rig.run(1.0)
    assert rig.forces[-1].z == pytest.approx(1.5, abs=0.02)


@pytest.mark.parametrize("what", ["gap of 190 ms", "silence of 0.15 s"])
def test_a_stall_shorter_than_the_pause_resumes(what: str) -> None:
    rig = Rig()
    rig.press()
    if what == "gap of 190 ms":
        rig.step(gap_s=0.19)
    else:
        rig.step(gap_s=0.025, silent=True)
        for _ in range(125):
            rig.step(silent=True)
    assert rig.state.state is OperatingState.PAUSED
    rig.step()
    assert rig.state.reason == "engaging"
    assert rig.run(0.13).z == pytest.approx(1.5, abs=0.02)


def test_a_long_gap_while_nothing_was_let_out_changes_nothing_of_that() -> None:
    rig = Rig()
    rig.press()
    rig.tick.pause()
    rig.run(0.02)
    rig.step(gap_s=0.025)
    rig.tick.resume()
    assert rig.run(0.5) == ZERO3
    assert "too large to engage" in rig.state.reason


def test_the_largest_force_is_remembered() -> None:
    rig = Rig()
    rig.press()
    rig.tick.disable()
    rig.run(0.1)
    assert rig.state.force == ZERO3
    assert rig.state.peak_n == pytest.approx(1.5, abs=0.05)


def test_a_clock_that_stands_still_or_goes_back_gives_no_step() -> None:
    rig = Rig()
    before = rig.press()
    rig.send(force=Vector3(0.0, 5.0, 0.0))
    assert rig.step(gap_s=0.0) == before
    assert rig.step(gap_s=-0.5, silent=True) == before


def test_after_a_late_tick_the_librarys_velocity_is_no_flight() -> None:
    rig = Rig()
    rig.press()
    rig.step(gap_s=0.03, velocity=Vector3(0.0, 0.0, 1.6))
    rig.run(0.02, velocity=Vector3(0.0, 0.0, 1.2))
    assert rig.state.state is not OperatingState.FAULT
    rig.run(0.2)
    rig.step(velocity=Vector3(0.0, 0.0, 1.2))
    assert rig.state.state is OperatingState.FAULT


def test_under_a_clock_that_stands_the_force_goes() -> None:
    rig = Rig()
    assert rig.press().z > 1.4
    for _ in range(19):
        rig.step(gap_s=0.0)
    assert [rig.step(gap_s=0.0).z for _ in range(6)][-1] == 0.0
    assert rig.state.stale_commands == 1


def test_a_new_engagement_does_not_resume_the_old_one() -> None:
    rig = Rig()
    rig.press()
    rig.step(gap_s=0.025)
    rig.tick.disable()
    rig.tick.enable()
    assert rig.run(0.5) == ZERO3
    assert "too large to engage" in rig.state.reason


def test_a_measured_force_of_a_time_to_come_is_not_felt() -> None:
    rig = Rig()
    rig.engage()
    rig.send(measured=MeasuredForce(Vector3(0.0, 0.0, 1.0), rig.now_s + 100.0))
    assert rig.run(0.1) == ZERO3
    assert rig.state.force_age_s == math.inf


def test_maxima_are_since_the_snapshot_before() -> None:
    rig = Rig()
    rig.run(0.01)
    rig.step(gap_s=0.004)
    rig.run(0.01)
    assert rig.state.gap_s == pytest.approx(0.004)
    rig.run(0.01)
    assert rig.state.gap_s == pytest.approx(0.001)
