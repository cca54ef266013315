"""Scripted device motion in virtual time, and the built-in scripts."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pytest

from cardan.errors import ScriptError
from cardan.protocols.connexion.devices import MODELS, model_by_key
from cardan.sim_peers.base import load_script, parse_script
from cardan.sim_peers.scripted import play
from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse
from cardan.sim_peers.spacemouse.motion_script import SCRIPT_VERBS, SCRIPTS, ScriptedPuck
from tests.sim_peers.spacemouse_virtual import make, motions, perform, run

pytestmark = pytest.mark.matrix

FULL_SPEED = (0.1,) * 3 + (0.4,) * 3
"""Speeds at full deflection in the demo, m/s and rad/s."""


def motion(script: str, model: str = "spacenavigator") -> ScriptedPuck:
    return ScriptedPuck(parse_script(script, SCRIPT_VERBS), model_by_key(model))


def trace(name: str, until_s: float) -> list[tuple[float, tuple[float, ...], tuple[str, ...]]]:
    """Return deflection and buttons of a built-in script, every 2 ms."""
    device, script_motion = make(), motion(SCRIPTS[name])
    samples = []
    for step in range(round(until_s / 0.002) + 1):
        script_motion.advance(step * 0.002, device)
        samples.append((step * 0.002, device.axes, device.held))
    return samples


def travel(samples: list[tuple[float, tuple[float, ...], tuple[str, ...]]]) -> list[list[float]]:
    """Return the displacement of each axis over time, m and rad, while the dead-man is held."""
    position = [0.0] * 6
    path = [list(position)]
    for _, axes, held in samples:
        if "left" in held:
            for axis, (value, speed) in enumerate(zip(axes, FULL_SPEED, strict=True)):
                position[axis] += value * speed * 0.002
        path.append(list(position))
    return path


def test_axes_ramp_linearly_from_where_they_are() -> None:
    device, ramp = make(), motion("1 axes 1 0 0 0 0 -0.5 over 2\n 2 axes 0 0 0 0 0 -0.5 over 1")
    for now_s, x, rz in ((0.5, 0.0, 0.0), (1.5, 0.25, -0.125), (2.5, 0.25, -0.375), (9, 0.0, -0.5)):
        ramp.advance(now_s, device)
        assert device.axes == pytest.approx((x, 0, 0, 0, 0, rz))
    assert ramp.next_due_s == math.inf


def test_axes_without_a_time_jump() -> None:
    device, jump = make(), motion("1 axes 0 1 0 0 0 0")
    jump.advance(1.0, device)
    assert device.axes[1] == 1.0


def test_swings_add_up_and_integrate_to_zero() -> None:
    device, swing = (
        make(),
        motion("0 swing 0.5 0 0 0 0 0 over 1 times 2\n0 swing 0.5 0 0 0 0 0 over 2"),
    )
    total = 0.0
    for step in range(2001):
        swing.advance(step * 0.001, device)
        total += device.axes[0]
        expected = 0.5 * math.sin(math.tau * step / 1000) + 0.5 * math.sin(math.pi * step / 1000)
        assert device.axes[0] == pytest.approx(expected, abs=1e-9)
    assert total == pytest.approx(0.0, abs=1e-6)
    assert device.axes == (0.0,) * 6


def test_neutral_ends_a_swing_without_a_jump() -> None:
    device, swing = make(), motion("0 swing 0 0 0.8 0 0 0 over 4\n1 neutral over 1")
    for now_s, z in ((1.0, 0.8), (1.5, 0.4), (2.0, 0.0), (3.0, 0.0)):
        swing.advance(now_s, device)
        assert device.axes[2] == pytest.approx(z)


def test_a_hand_that_moves_wakes_a_resting_device() -> None:
    reports = perform(make(), "5 axes 0 0 1 0 0 0 over 1\n6.5 neutral", 10.0)
    first, last = reports[0][0], reports[-1][0]
    assert 5.0 < first < 5.05
    assert 6.5 < last < 6.57
    times = [time_s for time_s, _ in reports]
    assert all(b - a == pytest.approx(0.008) for a, b in itertools.pairwise(times))


def test_play_gives_the_same_whatever_the_slices() -> None:
    def record(slices: int) -> list[bytes]:
        device, script_motion = make(jitter_lsb=1), motion(SCRIPTS["short"])
        return [
            report
            for index in range(1, slices + 1)
            for report in play(device, script_motion, 6.0 * index / slices)
        ]

    assert record(1) == record(7) == record(600)


def test_buttons_by_label_and_by_order() -> None:
    reports = perform(make("spacemouse-pro"), "0 press first\n1 press roll-cw\n2 release menu", 3.0)
    assert [r[1:3] for _, r in reports] == [b"\x01\x00", b"\x01\x01", b"\x00\x01"]


def test_plug_and_silence_verbs() -> None:
    script = "0 axes 1 0 0 0 0 0\n1 unplug\n2 replug\n3 silence\n4 resume\n5 neutral"
    times = [time_s for time_s, _ in perform(make(), script, 9.0)]
    gaps = [(round(a), round(b)) for a, b in itertools.pairwise(times) if b - a > 0.1]
    assert gaps == [(1, 2), (3, 4)]
    assert times[-1] < 5.1


def test_loop_starts_again() -> None:
    reports = perform(make(), "0 press left\n0.5 release left\n1 loop", 2.6)
    assert [(round(t, 3), r[1]) for t, r in reports] == [
        (0.0, 1), (0.5, 0), (1.0, 1), (1.5, 0), (2.0, 1), (2.5, 0)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("1 axes 0 0 0 0 0", "1 s axes: RZ is missing; usage: axes X Y Z RX RY RZ"),
        ("1 axes 0 0 2 0 0 0", "1 s axes: Z is '2', must be a number from -1 to 1"),
        ("1 axes 0 0 0 0 0 0 in 3", "'in 3' is too much; usage: axes"),
        ("1 axes 0 0 0 0 0 0 over -1", "SECONDS is '-1', must be a number from 0"),
        ("1 swing 0 0 0 0 0 0", "'over' is missing; usage: swing"),
        ("1 swing 0 0 0 0 0 0 over 1 times 0", "N is '0', must be a number from 1"),
        ("1.5 press", "1.5 s press: LABEL is missing; usage: press LABEL"),
        ("1 press fire", "SpaceNavigator has no button 'fire'; it has: left, right"),
        ("1 unplug now", "'now' is too much; usage: unplug"),
        ("1 loop\n2 unplug", "1 s loop: must be the last step"),
        ("1 dance", "line 1: after the time comes one of: axes X"),
    ],
)
def test_wrong_scripts_are_named(script: str, message: str) -> None:
    with pytest.raises(ScriptError, match=message.replace("(", r"\(")):
        motion(script)


def test_scripts_come_from_files_too(tmp_path: Path) -> None:
    file = tmp_path / "mine.txt"
    file.write_text("0.5 press left  # the dead-man\n")
    steps = load_script(str(file), SCRIPTS, SCRIPT_VERBS)
    reports = play(make(), ScriptedPuck(steps, model_by_key("spacenavigator")), 1.0)
    assert reports == [b"\x03\x01\x00"]


@pytest.mark.parametrize("name", SCRIPTS)
@pytest.mark.parametrize("model", [m for m in MODELS if len(m.buttons) > 1], ids=lambda m: m.key)
def test_built_in_scripts_play_on_every_model_with_two_buttons(name: str, model: object) -> None:
    device = SimulatedSpaceMouse(model)  # type: ignore[arg-type]
    steps = load_script(name, SCRIPTS, SCRIPT_VERBS)
    assert play(device, ScriptedPuck(steps, model), 30.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", SCRIPTS)
def test_built_in_scripts_show_a_neutral_puck_before_anything_else(name: str) -> None:
    reports = perform(make(), SCRIPTS[name], 1.0)
    first_button = next((i for i, (_, r) in enumerate(reports) if r[0] == 3), len(reports))
    touched = motions(reports[:first_button])
    assert any(any(r[1:]) for r in touched)
    assert [r[0] for r in touched[-2:]] == [1, 2]
    assert not any(any(r[1:]) for r in touched[-6:])


@pytest.mark.parametrize("name", SCRIPTS)
def test_built_in_scripts_never_jump(name: str) -> None:
    samples = trace(name, 30.0)
    for (_, before, _), (now_s, after, _) in itertools.pairwise(samples):
        jumps = [abs(b - a) for a, b in zip(before, after, strict=True)]
        assert max(jumps) < 0.015, f"{name} jumps at {now_s:.3f} s"


def test_demo_stays_near_its_start_and_comes_back_to_it() -> None:
    samples = trace("demo", 28.0)
    path = travel(samples)
    lowest = [min(p[axis] for p in path) for axis in range(6)]
    highest = [max(p[axis] for p in path) for axis in range(6)]
    assert path[-1] == pytest.approx([0.0] * 6, abs=1e-3)
    for axis in range(3):
        assert lowest[axis] > -0.12
        assert 0.03 < highest[axis] < 0.12
    for axis in range(3, 6):
        assert lowest[axis] > -0.5
        assert 0.05 < highest[axis] < 0.5
    assert samples[-1][1:] == ((0.0,) * 6, ())


def test_demo_lets_the_dead_man_go_while_deflected_and_grips_again_at_rest() -> None:
    samples = trace("demo", 28.0)
    let_go = [
        axes
        for (_, axes, held), (_, _, after) in itertools.pairwise(samples)
        if "left" in held and "left" not in after
    ]
    grips = [
        axes
        for (_, axes, held), (_, _, after) in itertools.pairwise(samples)
        if "left" not in held and "left" in after
    ]
    assert [max(map(abs, axes)) for axes in let_go] == pytest.approx([0.6, 0.0])
    assert grips == [(0.0,) * 6] * 2
    assert any("right" in held and "left" in held for _, _, held in samples)


def test_short_is_over_after_six_seconds() -> None:
    device, script_motion = make(), motion(SCRIPTS["short"])
    play(device, script_motion, 6.0)
    assert script_motion.next_due_s == math.inf
    assert run(device, 60.0) == []
    assert device.held == ()
