"""The tick's states, buttons and snapshots."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from cardan.common.haptics import (
    Calibration,
    OperatingState,
)
from cardan.errors import CommandError
from cardan.types import ZERO3, Vector3
from cardan_omni.driver import values
from omni_tick_bench import (
    NAN,
    Bench,
    rotation,
    size,
)


@pytest.mark.parametrize(
    ("start", "verb", "end"),
    [
        ("disabled", "enable", "enabled"),
        ("disabled", "disable", "disabled"),
        ("disabled", "pause", None),
        ("disabled", "resume", None),
        ("enabled", "enable", "enabled"),
        ("enabled", "disable", "disabled"),
        ("enabled", "pause", "paused"),
        ("enabled", "resume", None),
        ("paused", "enable", None),
        ("paused", "disable", "disabled"),
        ("paused", "pause", "paused"),
        ("paused", "resume", "enabled"),
        ("fault", "enable", "enabled"),
        ("fault", "disable", "disabled"),
        ("fault", "pause", None),
        ("fault", "resume", None),
    ],
)
def test_state_commands(start: str, verb: str, end: str | None) -> None:
    bench = Bench()
    if start != "disabled":
        bench.tick.enable()
    if start == "paused":
        bench.tick.pause()
    if start == "fault":
        bench.step(position=Vector3(NAN, 0.0, 0.0))
    assert bench.state.state is OperatingState(start)
    if end is None:
        with pytest.raises(CommandError, match=f"{verb} is not possible in state {start}"):
            getattr(bench.tick, verb)()
    else:
        getattr(bench.tick, verb)()
    assert bench.tick.state is bench.state.state is OperatingState(end or start)
    bench.step(position=ZERO3)
    assert bench.state.state is OperatingState(end or start)


def test_disabled_and_enabled_between_two_ticks_engages_anew() -> None:
    bench = Bench()
    bench.press()
    bench.tick.disable()
    bench.tick.enable()
    assert bench.zero_after() <= 0.005 + 1e-9
    assert "too large to engage" in bench.state.reason


def test_a_clutch_released_and_pressed_between_two_ticks_engages_anew() -> None:
    bench = Bench()
    bench.press()
    bench.send(engaged=False)
    bench.send(engaged=True)
    assert bench.zero_after() <= 0.005 + 1e-9


def test_the_account_is_closed_only_once_the_force_is_gone() -> None:
    bench = Bench()
    bench.press()
    bench.send(engaged=False)
    bench.send(engaged=True, fixtures=())
    while bench.state.energy_j != 0.0:
        assert len(bench.forces) < 10_000
        before = bench.forces[-1]
        bench.step()
    assert before == ZERO3


@pytest.mark.parametrize("bounce_ms", [0, 1, 3, 5, 10, 20])
def test_a_bouncing_button_is_pressed_once_and_at_once(bounce_ms: int) -> None:
    bench = Bench()
    bench.run(0.05)
    for press in range(1, 5):
        bench.step(buttons=2)
        assert bench.state.presses == (0, press), "the first edge counts"
        for k in range(bounce_ms):
            bench.step(buttons=2 * (k % 2))
        bench.run(0.06, buttons=2)
        assert bench.state.buttons == 2
        bench.step(buttons=0)
        assert bench.state.buttons == 0
        for k in range(bounce_ms):
            bench.step(buttons=2 * ((k + 1) % 2))
        bench.run(0.06, buttons=0)
        assert (bench.state.presses, bench.state.buttons) == ((0, press), 0)


def test_buttons_do_not_hold_each_other_up_and_time_counts_not_ticks() -> None:
    bench = Bench()
    bench.run(0.05)
    bench.step(buttons=1)
    bench.step(buttons=3)
    assert bench.state.presses == (1, 1)
    bench.step(buttons=0, gap_s=0.024)
    assert bench.state.buttons == 2, "25 ms from its own edge"
    bench.step(buttons=0, gap_s=0.002)
    assert bench.state.buttons == 0


def test_a_snapshot_tells_what_the_device_reported() -> None:
    bench = Bench()
    assert bench.state.pose is None
    turn = rotation(0.4, -1.2, 2.9)
    bench.run(
        0.01,
        position=Vector3(0.01, 0.02, 0.03),
        rotation=turn,
        joints_rad=Vector3(0.1, 0.2, 0.3),
        gimbal_rad=Vector3(1.1, 1.2, 1.3),
        temperature=0.4,
        encoders=(1, 2, 3, -4, 5, 6),
        buttons=2,
    )
    state = bench.state
    assert state.pose is not None
    w, x, y, z = state.pose.orientation
    again = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    assert again == pytest.approx(turn)
    assert state.pose.position == (0.01, 0.02, 0.03)
    assert state.joints_rad == (0.1, 0.2, 0.3)
    assert state.gimbal_rad == (1.1, 1.2, 1.3)
    assert state.temperature == 0.4
    assert state.buttons == 2
    assert state.calibration is Calibration.OK
    assert state.ticks == 10
    assert state.stamp_s == pytest.approx(bench.now_s)
    assert state.rate_hz == pytest.approx(1000.0)
    assert bench.tick.details().encoders == (1, 2, 3, -4, 5, 6)


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).filter(
        lambda q: sum(x * x for x in q) > 0.01
    )
)
def test_every_orientation_survives(q: list[float]) -> None:
    w, x, y, z = (v / size(q) for v in q)
    matrix = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    again = values.quaternion_of(matrix)
    assert abs(sum(a * b for a, b in zip(again, (w, x, y, z), strict=True))) == pytest.approx(1.0)
