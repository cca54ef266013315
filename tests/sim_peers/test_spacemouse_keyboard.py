"""Device motion from keys: its logic in virtual time, and a real pseudo-terminal."""

from __future__ import annotations

import math
import os
import termios

import pytest

from cardan.errors import ScriptError
from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse
from cardan.sim_peers.spacemouse.keyboard import (
    KEY_AXES,
    KEY_BUTTONS,
    KEY_DEFLECTION,
    KEY_HOLD_S,
    KEY_SPEED,
    KeyboardMotion,
    Terminal,
    status_line,
)
from tests.sim_peers.spacemouse_virtual import make

RAMP_S = KEY_DEFLECTION / KEY_SPEED


def at(motion: KeyboardMotion, device: SimulatedSpaceMouse, now_s: float) -> tuple[float, ...]:
    motion.advance(now_s, device)
    return device.axes


@pytest.mark.parametrize("key", KEY_AXES)
def test_each_key_deflects_one_axis_and_decays(key: str) -> None:
    motion, device = KeyboardMotion(), make()
    motion.feed(key, 5.0)
    axis, sign = KEY_AXES[key]
    assert at(motion, device, 5.0) == (0.0,) * 6
    deflected = at(motion, device, 5.0 + KEY_HOLD_S)
    assert deflected[axis] == pytest.approx(sign * KEY_DEFLECTION)
    assert sum(map(abs, deflected)) == pytest.approx(KEY_DEFLECTION)
    halfway = at(motion, device, 5.0 + KEY_HOLD_S + RAMP_S / 2)
    assert halfway[axis] == pytest.approx(sign * KEY_DEFLECTION / 2)
    assert at(motion, device, 5.0 + KEY_HOLD_S + 2 * RAMP_S) == (0.0,) * 6
    assert motion.next_due_s == math.inf


def test_a_repeating_key_holds() -> None:
    motion, device = KeyboardMotion(), make()
    for repeat in range(30):
        motion.feed("w", repeat / 30)
        if repeat > 4:
            assert at(motion, device, repeat / 30)[0] == pytest.approx(KEY_DEFLECTION)


def test_one_late_look_is_the_same_as_many() -> None:
    coarse, fine, device = KeyboardMotion(), KeyboardMotion(), make()
    for motion in (coarse, fine):
        motion.feed("u", 1.0)
    for step in range(200):
        at(fine, device, 1.0 + step * 0.001)
    assert at(coarse, device, 1.199) == pytest.approx(device.axes)


def test_capitals_deflect_fully_and_the_opposite_key_turns_round() -> None:
    motion, device = KeyboardMotion(), make()
    for step in range(10):
        motion.feed("A", step * 0.05)
    assert at(motion, device, 0.45)[1] == 1.0
    motion.feed("d", 0.46)
    assert at(motion, device, 0.47)[1] < 1.0


def test_the_deflection_never_jumps() -> None:
    motion, device = KeyboardMotion(), make()
    before = device.axes
    for step in range(1, 400):
        if step % 7 == 0:
            motion.feed("wWsS"[step // 7 % 4], step * 0.008)
        after = at(motion, device, step * 0.008)
        assert abs(after[0] - before[0]) <= KEY_SPEED * 0.008 + 1e-9
        before = after


@pytest.mark.parametrize(("key", "label"), [(" ", "left"), ("\n", "right"), ("\r", "right")])
def test_buttons_toggle(key: str, label: str) -> None:
    assert key in KEY_BUTTONS
    motion, device = KeyboardMotion(), make()
    motion.feed(key, 1.0)
    assert motion.next_due_s == 1.0
    motion.advance(1.0, device)
    assert device.held == (label,)
    motion.feed(key, 2.0)
    motion.advance(2.0, device)
    assert device.held == ()
    assert len(device.reports(2.0)) == 2


def test_two_strokes_in_one_read_are_two_edges() -> None:
    motion, device = KeyboardMotion(), make()
    motion.feed("  ", 1.0)
    motion.advance(1.0, device)
    assert [report[1] for report in device.reports(1.0)] == [1, 0]


def test_cursor_keys_and_others_do_nothing() -> None:
    motion, device = KeyboardMotion(), make()
    motion.feed("\x1b[A\x1b[1;5D\x1bOAzé7", 1.0)
    assert motion.next_due_s == math.inf
    assert at(motion, device, 1.1) == (0.0,) * 6


def test_status_line_shows_led_axes_and_buttons() -> None:
    device = make()
    device.set_axes((0.5, 0, 0, 0, 0, -0.25))
    device.press("left")
    line = status_line(device)
    assert line.startswith("LED on ")
    assert "x +0.50" in line
    assert "rz -0.25" in line
    assert line.endswith("left")
    device.output(b"\x04\x00", 0.0)
    assert status_line(device).startswith("LED off")


def test_terminal_gives_keys_at_once_and_is_given_back() -> None:
    keyboard, screen = os.openpty()
    try:
        before = termios.tcgetattr(screen)
        terminal = Terminal(screen)
        terminal.open()
        os.write(keyboard, b"w ")
        assert terminal.read() == "w "
        assert not termios.tcgetattr(screen)[3] & (termios.ECHO | termios.ICANON)
        assert termios.tcgetattr(screen)[3] & termios.ISIG
        terminal.close()
        terminal.close()
        assert termios.tcgetattr(screen) == before
    finally:
        os.close(keyboard)
        os.close(screen)


def test_no_terminal_is_said() -> None:
    read_end, write_end = os.pipe()
    try:
        with pytest.raises(ScriptError, match="not a terminal; give a script"):
            Terminal(read_end).open()
    finally:
        os.close(read_end)
        os.close(write_end)
