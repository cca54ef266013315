"""Core of the keyboard driver: keys, ramp, modifiers, release of the keyboard."""

import pytest

from cardan.drivers.keyboard import KeyboardOptions
from cardan.drivers.keyboard.core import MOTION_KEYS, KeyboardCore
from cardan.protocols.evdev.codes import KEYS
from cardan.types import DeviceLink
from tests.drivers.evdev_bench import REST, Bench


def unit(axis, sign):
    return tuple(sign if index == axis else 0.0 for index in range(6))


@pytest.mark.parametrize("layout", MOTION_KEYS)
def test_each_key_moves_along_its_axis(layout):
    bench = Bench("keyboard", KeyboardOptions(layout=layout, ramp_s=0.0))
    for code, (axis, sign) in MOTION_KEYS[layout].items():
        assert bench.press(KEYS[code]).axes == unit(axis, sign)
        assert bench.release(KEYS[code]).axes == REST
    assert {pair[0] for pair in MOTION_KEYS[layout].values()} == set(range(6))


def test_the_letters_are_those_of_the_published_program():
    motion = {KEYS[code]: pair for code, pair in MOTION_KEYS["letters"].items()}
    assert [motion[key] for key in "azsxdc"] == [(a, s) for a in range(3) for s in (1.0, -1.0)]
    assert [motion[key] for key in "fvgbhn"] == [(a, s) for a in range(3, 6) for s in (1.0, -1.0)]


def test_both_keys_of_an_axis_cancel():
    bench = Bench("keyboard")
    assert bench.press("a", "z").axes == REST
    assert bench.release("z").axes == unit(0, 1.0)


def test_deflection_ramps_up_and_drops_at_once():
    bench = Bench("keyboard", KeyboardOptions(ramp_s=0.4))
    bench.device.press("s")
    assert 0.3 < bench.run(0.2).axes[1] < 0.6
    assert bench.run(0.3).axes[1] == 1.0
    bench.device.release("s")
    assert bench.run(0.02).axes == REST
    assert 0.0 < bench.press("s").axes[1] < 0.1, "each press begins a new ramp"


def test_a_held_key_stays_live_in_spite_of_the_kernels_repetition():
    bench = Bench("keyboard")
    bench.press("a")
    assert bench.run(3.0).axes == unit(0, 1.0)
    assert bench.core.events() == []


def test_other_keys_are_buttons():
    bench = Bench("keyboard")
    assert bench.press("space", "a", "f5").buttons == {"space", "f5"}
    assert "space" in bench.core.buttons
    assert "a" not in bench.core.buttons
    assert {"space", "f5"} < set(KeyboardCore(KeyboardOptions()).buttons)  # without a keyboard
    bench.release("f5")
    edges = [(event.button, event.pressed) for event in bench.core.events()]
    assert edges == [("space", True), ("f5", True), ("f5", False)]


@pytest.mark.parametrize("modifier", ["left-ctrl", "right-alt", "left-meta"])
def test_keys_together_with_a_modifier_do_not_move(modifier):
    """Ctrl-C in the terminal is no command for the robot."""
    bench = Bench("keyboard")
    assert bench.press(modifier, "c").axes == REST
    assert bench.release(modifier).axes == REST, "nor during the release"
    assert bench.release("c").axes == REST
    assert bench.press("c").axes == unit(2, -1.0)
    assert bench.press(modifier).axes == REST
    bench.device.release(modifier)
    bench.device.release("c")
    bench.open()
    bench.touch()
    assert bench.press("c").axes == unit(2, -1.0), "its release was not seen"


def test_a_key_held_while_it_is_opened_does_not_move():
    bench = Bench("keyboard")
    bench.press("a")
    bench.open()
    state = bench.run(0.5)
    assert (state.link, state.axes) == (DeviceLink.NEEDS_NEUTRAL, REST)
    assert "(a)" in state.reason
    assert bench.release("a").link is DeviceLink.LIVE
    assert bench.press("a").axes == unit(0, 1.0)


def test_esc_gives_the_keyboard_back_and_f12_takes_it_again():
    bench = Bench("keyboard", KeyboardOptions(grab=True, ramp_s=0.0))
    assert bench.core.wants_grab
    bench.press("a")
    state = bench.press("esc")
    assert not bench.core.wants_grab
    assert (state.link, state.axes) == (DeviceLink.NEEDS_NEUTRAL, REST)
    assert "F12" in state.reason
    bench.release("esc", "a")
    assert bench.press("a").axes == REST, "typed for another program"
    assert bench.press("f12").link is DeviceLink.NEEDS_NEUTRAL
    assert bench.core.wants_grab
    assert not bench.core.nothing_down
    assert bench.release("a", "f12").link is DeviceLink.LIVE
    assert bench.core.nothing_down
    assert bench.press("a").axes == unit(0, 1.0)


def test_esc_is_any_button_without_grab():
    bench = Bench("keyboard")
    state = bench.press("esc")
    assert (state.link, state.buttons) == (DeviceLink.LIVE, {"esc"})


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"layout": "dvorak"}, "it must be one of letters, arrows"),
        ({"ramp_s": 9.0}, "it must be 0 to 5 s"),
        ({"transport": "terminal"}, "it must be one of evdev, socket"),
    ],
)
def test_options_that_are_not_allowed(settings, words):
    with pytest.raises(ValueError, match=words):
        KeyboardOptions(**settings)
