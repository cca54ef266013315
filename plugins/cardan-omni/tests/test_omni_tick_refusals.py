"""Invalid numbers and commands are refused and change nothing; limits are checked twice."""

from __future__ import annotations

import ctypes
import dataclasses
import math
from typing import Any

import pytest

from cardan.common.haptics import (
    Box,
    Cylinder,
    MeasuredForce,
    OperatingState,
    Sphere,
    Spring,
    WorldMap,
)
from cardan.errors import CommandError, OptionError
from cardan.types import ZERO3, Vector3
from cardan_omni.driver import native, structures
from cardan_omni.driver.limits import TickLimits, UncheckedLimits
from cardan_omni.driver.tick import Tick
from omni_tick_bench import (
    BARE,
    FLOOR,
    NAN,
    PERIOD_S,
    Bench,
    size,
)
from tests.ranges import ranges


@pytest.mark.parametrize("bad", [NAN, math.inf, -math.inf])
@pytest.mark.parametrize(
    "field",
    ["now_s", "position", "velocity", "rotation", "joints_rad", "gimbal_rad", "temperature"],
)
def test_a_sample_that_is_no_number_is_a_fault_and_no_force(field: str, bad: float) -> None:
    bench = Bench()
    bench.press()
    good = bench.sample
    value = getattr(good, field)
    if isinstance(value, tuple):
        value = (*value[:-1], bad)
    else:
        value = bad
    before = bench.forces[-1]
    for k in range(6):
        bench.now_s += PERIOD_S
        sample = good._replace(now_s=bench.now_s)
        if k == 0:
            sample = sample._replace(**{field: value})
        force = bench.tick.step(sample)
        assert size(force) <= size(before)
        before = force
    assert force == ZERO3
    state = bench.state
    assert state.state is OperatingState.FAULT
    assert "not finite" in state.reason
    assert all(math.isfinite(x) for x in (*state.force, *state.velocity, state.energy_j))
    bench.tick.enable()
    bench.step()
    assert bench.state.state is OperatingState.ENABLED


def test_forces_that_overflow_are_a_fault() -> None:
    bench = Bench()
    bench.press()
    bench.send(
        force=Vector3(1.7e308, 0.0, 0.0),
        measured=MeasuredForce(ZERO3, bench.now_s),
        world=WorldMap(linear=(1.7e308,) * 9),
        fixtures=(Spring(ZERO3, 1e300, 1e300),),
    )
    assert bench.zero_after() <= 0.005 + 1e-9
    assert bench.state.state is OperatingState.FAULT


MEASURED = MeasuredForce(ZERO3, 1.0)
BAD_COMMANDS: list[tuple[dict[str, Any], str]] = [
    ({"stamp_s": NAN}, "not finite"),
    ({"force": Vector3(0.0, math.inf, 0.0)}, "not finite"),
    ({"force_scale": NAN}, "not finite"),
    ({"force_scale": -1.0}, "negative"),
    ({"joint_torques_n_m": Vector3(NAN, 0.0, 0.0)}, "not finite"),
    ({"world": WorldMap(offset=Vector3(NAN, 0.0, 0.0))}, "not finite"),
    ({"world": WorldMap(linear=(NAN,) * 9)}, "not finite"),
    ({"world": WorldMap(rotation=(1.0, 0, 0, 0, 1.0, 0, 0, 0, -1.0))}, "not a rotation"),
    ({"world": WorldMap(rotation=(2.0, 0, 0, 0, 1.0, 0, 0, 0, 0.5))}, "not a rotation"),
    ({"measured": MEASURED._replace(force=Vector3(NAN, 0.0, 0.0))}, "not finite"),
    ({"measured": MEASURED._replace(stamp_s=NAN)}, "not finite"),
    ({"measured": MEASURED._replace(rate_n_s=Vector3(NAN, 0.0, 0.0))}, "not finite"),
    ({"measured": MEASURED._replace(position=Vector3(NAN, 0.0, 0.0))}, "not finite"),
    ({"measured": MEASURED._replace(stiffness_n_m=-1.0)}, "negative"),
    ({"fixtures": (FLOOR,) * 9}, "more than 8"),
    ({"fixtures": (FLOOR._replace(stiffness_n_m=NAN),)}, "not finite"),
    ({"fixtures": (FLOOR, FLOOR._replace(cap_n=-1.0))}, "negative"),
    ({"fixtures": (FLOOR._replace(normal=Vector3(0.0, 0.0, 2.0)),)}, "not of length 1"),
    ({"fixtures": (Cylinder(ZERO3, ZERO3, 1.0, 1.0),)}, "not of length 1"),
    ({"fixtures": (Box(ZERO3, Vector3(1, 1, -1), 1.0),)}, "negative"),
    ({"fixtures": (Box(ZERO3, ZERO3, 1.0, rotation=(0.0,) * 9),)}, "not a rotation"),
    ({"fixtures": (Sphere(ZERO3, -0.1, 1.0),)}, "negative"),
    ({"fixtures": ("wall",)}, "not a fixture"),
    ({"sequence": -1}, "is refused"),
    ({"force": ("a", "b", "c")}, "is refused"),
]


@pytest.mark.parametrize(("change", "words"), BAD_COMMANDS, ids=[str(c) for c, _ in BAD_COMMANDS])
def test_bad_commands_are_refused_and_change_nothing(change: dict[str, Any], words: str) -> None:
    bench = Bench(**BARE)
    bench.send(force=Vector3(0.0, 0.0, 1.0))
    good = bench.command
    bench.step(silent=True)
    with pytest.raises(CommandError, match=words):
        bench.tick.command(good._replace(**{"sequence": 99, "stamp_s": 200.0, **change}))
    bench.step(silent=True)
    assert bench.state.force_commanded == (0.0, 0.0, 1.0)
    assert bench.state.command_sequence == 1
    assert bench.tick.command(good._replace(sequence=2, stamp_s=bench.now_s)), (
        "refused: no later one is stale"
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"clamp_n": 4.0}, "3.3"),
        ({"clamp_n": 0.0}, "0.01 to 3.3 N"),
        ({"clamp_n": NAN}, "0.01 to 3.3 N"),
        ({"slew_fall_n_s": 300.0}, "clamp_n / release_s"),
        ({"pause_s": 0.01}, "at least hold_s"),
        ({"pause_gap_s": 0.002, "overrun_gap_s": 0.003}, "at least overrun_gap_s"),
        ({"damping_n_s_m": -0.1}, "0 to 3 N"),
        ({"energy_budget_j": "much"}, "0 to 0.2 J"),
        ({"workspace_lower_m": (0.0, 0.0)}, "3 values"),
        ({"workspace_lower_m": (0.0, 0.0, 0.3)}, "workspace_upper_m"),
        ({"engage_ticks": 0}, "1 to 10000"),
        ({"clamp_n": True}, "0.01 to 3.3 N"),
        ({"clamp_n": 10**400}, "0.01 to 3.3 N"),
        ({"passivity": "no"}, "true or false"),
        ({"passivity": 1}, "true or false"),
        ({"engage_ticks": 2.5}, "1 to 10000, whole"),
        ({"engage_ticks": True}, "1 to 10000, whole"),
        ({"workspace_upper_m": ("a", 0, 0)}, "-1 to 1 m"),
        ({"workspace_upper_m": None}, "3 values"),
        ({"workspace_upper_m": (50.0, 50.0, 50.0)}, "-1 to 1 m"),
        ({"hold_s": 0.5, "pause_s": 0.9}, "dead program"),
        ({"velocity_gate_m_s": 1e9}, "0.2 to 2"),
        ({"energy_budget_j": 1e9}, "0 to 0.2"),
        ({"oscillation_reversals": 50}, "2 to 32"),
    ],
)
def test_limits_that_make_no_sense_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(OptionError, match=words) as caught:
        TickLimits(**change)
    assert caught.value.key in {*change, "workspace_upper_m"}


NUMBERS = {
    name: allowed
    for name, allowed in ranges(TickLimits).items()
    if isinstance(getattr(TickLimits(), name), float)
}


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("end", [0, 1])
def test_both_languages_refuse_what_a_device_may_not_be_driven_with(name: str, end: int) -> None:
    allowed = NUMBERS[name]
    edge = (allowed.lowest, allowed.highest)[end]
    beyond = edge * (1.001 if end else 0.999) - (1e-9 if edge == 0.0 else 0.0)
    with pytest.raises(OptionError, match=name):
        TickLimits(**{name: beyond})
    assert allowed.reason
    wide: dict[str, Any] = {"slew_fall_n_s": 3300.0, "release_s": 0.05, "pause_s": 0.9}
    wide |= {"pause_gap_s": 0.09, "overrun_gap_s": 0.0012, "hold_s": 0.001}
    for value, taken in ((edge, True), (beyond, False)):
        limits = structures.c_limits(TickLimits(**wide))
        setattr(limits, name, value)
        if name == "pause_s":
            limits.hold_s = min(limits.hold_s, value)
        elif name == "slew_fall_n_s" and not end:
            continue  # too slow for any release within the force's range
        elif name == "release_s" and not end:
            limits.clamp_n = 2.0
        pointer = native.tick_library().tick_create(ctypes.byref(limits))
        assert bool(pointer) is taken, (name, value)
        if pointer:
            native.tick_library().tick_destroy(pointer)


def test_experiments_may_go_beyond_and_say_so() -> None:
    limits = UncheckedLimits(engage_ramp_s=0.0, velocity_gate_m_s=100.0)
    Tick(limits).close()
    assert isinstance(dataclasses.replace(limits, passivity=False), UncheckedLimits)
    UncheckedLimits(workspace_lower_m=(-9.0, -9.0, -9.0), velocity_gate_m_s=1e299)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"clamp_n": 3.4}, "above 0, at most 3.3 N"),
        ({"clamp_n": 0.0}, "above 0"),
        ({"clamp_n": NAN}, "above 0"),
        ({"release_s": 0.06}, "above 0, at most 0.05 s"),
        ({"velocity_gate_m_s": math.inf}, "above 0"),
        ({"velocity_gate_m_s": 10**400}, "above 0"),
        ({"damping_n_s_m": -0.1}, "it must be 0 to"),
        ({"engage_ramp_s": -0.1}, "it must be 0 to"),
        ({"energy_budget_j": "much"}, "it must be 0 to"),
        ({"hold_s": 0.5}, "at least hold_s"),
        ({"engage_ticks": 10_001}, "1 to 10000"),
        ({"oscillation_reversals": 50}, "2 to 32"),
        ({"passivity": 1}, "true or false"),
        ({"workspace_lower_m": (0.0, 0.0)}, "3 values"),
        ({"workspace_lower_m": (0.0, 0.0, NAN)}, "it must be"),
        ({"workspace_lower_m": (0.0, 0.0, 0.3)}, "workspace_upper_m"),
    ],
)
def test_experiments_make_sense_all_the_same(change: dict[str, Any], words: str) -> None:
    with pytest.raises(OptionError, match=words):
        UncheckedLimits(**change)


@pytest.mark.parametrize("name", NUMBERS)
def test_both_languages_agree_on_what_makes_sense(name: str) -> None:
    """C and Python both refuse 0, or both accept it; the limits are unchecked, so that C
    decides."""
    limits = structures.c_limits(UncheckedLimits())
    setattr(limits, name, 0.0)
    pointer = native.tick_library().tick_create(ctypes.byref(limits))
    if pointer:
        native.tick_library().tick_destroy(pointer)
        if name != "lowest_rate_hz":  # C accepts it: no loop is too slow.
            UncheckedLimits(**{name: 0.0})
    else:
        with pytest.raises(OptionError, match=name):
            UncheckedLimits(**{name: 0.0})


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(TickLimits)])
def test_every_limit_arrives(name: str) -> None:
    """Only the changed limit differs in the C structure."""
    value = getattr(TickLimits(), name)
    change: Any
    if name == "passivity":
        change = False
    elif isinstance(value, tuple):
        change = tuple(0.9 * x for x in value)
    elif isinstance(value, int) or name in ("slew_fall_n_s", "pause_s", "pause_gap_s", "release_s"):
        change = 2 * value
        if name == "release_s":
            change = value  # Its only effect is the minimum of slew_fall_n_s.
    else:
        change = 0.9 * value
    if name == "temperature_limit":
        change = 0.8
    a, b = (structures.c_limits(limits) for limits in (TickLimits(), TickLimits(**{name: change})))
    for field, *_ in a._fields_:
        first, second = (getattr(x, field) for x in (a, b))
        if isinstance(value, tuple) and field == name:
            assert tuple(second) == pytest.approx(change)
        elif field == name:
            assert second == pytest.approx(float(change))
        elif hasattr(first, "_length_"):
            assert tuple(first) == tuple(second)
        else:
            assert first == second


def test_limits_can_change_while_it_runs() -> None:
    bench = Bench()
    bench.press()
    bench.tick.set_limits(dataclasses.replace(bench.limits, clamp_n=1.0))
    force = bench.run(0.01)
    assert size(force) == pytest.approx(1.0)


def test_a_list_is_taken_as_the_tuple_that_it_stands_for():
    assert UncheckedLimits(workspace_lower_m=[-9.0] * 3).workspace_lower_m == (-9.0,) * 3
