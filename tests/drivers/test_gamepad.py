"""Core of the gamepad driver: layouts, buttons, models, rest."""

import pytest
from hypothesis import given, strategies as st

from cardan.drivers.evdev.nodes import EvdevDeviceInfo, EvdevState
from cardan.drivers.gamepad import GamepadCore, GamepadOptions
from cardan.protocols.evdev import codes as c
from cardan.protocols.evdev.events import InputEvent, encode_events
from cardan.protocols.evdev.requests import AbsInfo
from cardan.types import DeviceLink
from tests.drivers.evdev_bench import REST, Bench

PADS = ("xbox-360", "xbox-one", "dualshock-4", "dualshock-4-generic", "dualsense-generic")
GENERIC = PADS[3:]
NOT_RESTING = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("model", PADS)
@pytest.mark.parametrize(
    ("layout", "controls", "shifted", "axes"),
    [
        # Axes of both sticks, right and up, and triggers.
        ("sticks", (0.4, 0.8, -0.6, 0.2, 0.5, 0.0), False, (0.8, -0.4, 0.2, 0.0, 0.0, 0.6)),
        ("sticks", (0.4, 0.8, -0.6, 0.2, 0.0, 0.0), True, (0.0, 0.0, 0.2, 0.4, 0.8, 0.6)),
        ("swapped", (-0.6, 0.2, 0.4, 0.8, 0.0, 0.0), False, (0.8, -0.4, 0.2, 0.0, 0.0, 0.6)),
        ("swapped", (-0.6, 0.2, 0.4, 0.8, 0.0, 0.0), True, (0.0, 0.0, 0.2, 0.4, 0.8, 0.6)),
        ("triggers", (0.4, 0.8, -0.6, 0.2, 0.2, 0.6), False, (0.8, -0.4, 0.4, 0.0, 0.2, 0.6)),
        ("triggers", (0.4, 0.8, -0.6, 0.2, 0.2, 0.6), True, (0.8, -0.4, 0.4, -0.6, 0.2, 0.0)),
    ],
)
def test_layouts(model, layout, controls, shifted, axes):
    bench = Bench(model, GamepadOptions(layout=layout, dead_zone=0.0))
    assert bench.run(0.02).link is DeviceLink.LIVE
    if shifted:
        bench.press("right-shoulder")
    state = bench.run(0.1, controls)
    assert state.link is DeviceLink.LIVE
    assert state.axes == pytest.approx(axes, abs=0.02)


@pytest.mark.parametrize("model", PADS)
def test_every_button_is_heard_by_its_place(model):
    """West is west on an Xbox pad, too, where other pads use its code for north."""
    bench = Bench(model)
    labels = [label for label in bench.device.labels if not label.endswith("-trigger")]
    for label in labels:
        assert label in bench.press(label).buttons
        assert not bench.release(label).buttons
    edges = [(event.button, event.pressed) for event in bench.core.events()]
    assert edges == [(label, pressed) for label in labels for pressed in (True, False)]
    assert set(labels) <= set(bench.core.buttons)


def test_triggers_are_buttons_unless_they_are_axes():
    bench = Bench()
    assert not bench.run(0.1, (0, 0, 0, 0, 0.0, 0.45)).buttons
    assert bench.run(0.1, (0, 0, 0, 0, 0.0, 0.55)).buttons == {"right-trigger"}
    assert bench.run(0.1, (0, 0, 0, 0, 0.0, 0.35)).buttons == {"right-trigger"}, "no flutter"
    assert not bench.run(0.1, (0, 0, 0, 0, 0.0, 0.25)).buttons
    bench = Bench(options=GamepadOptions(layout="triggers"))
    assert not bench.run(0.1, (0, 0, 0, 0, 0.0, 1.0)).buttons
    assert "right-trigger" not in bench.core.buttons


def test_no_shift_button():
    bench = Bench(options=GamepadOptions(shift="", dead_zone=0.0))
    bench.press("right-shoulder")
    assert bench.run(0.1, (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)).axes == (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("model", GENERIC)
@pytest.mark.parametrize("layout", ["sticks", "swapped", "triggers"])
def test_triggers_are_not_taken_for_a_stick(model, layout):
    """Half-pressed triggers report a stick's middle; their release must not cause motion."""
    bench = Bench(model, GamepadOptions(layout=layout), touched=False)
    bench.run(0.02, (0.0, 0.0, 0.0, 0.0, 0.5, 0.5))
    bench.touch()
    assert bench.run(0.1).axes == REST
    bench.run(0.1, REST)
    state = bench.touch()
    assert (state.link, state.axes) == (DeviceLink.LIVE, REST)
    bench.run(0.1, (0.0, 0.0, 0.0, 0.0, 1.0, 0.5))
    moved = bench.states[-1].axes
    assert moved.z == pytest.approx(-0.5 if layout == "triggers" else 0.0, abs=0.1)
    assert (moved.x, moved.y, moved.roll, moved.pitch, moved.yaw) == (0.0,) * 5
    assert bench.run(0.1, REST).axes == REST


def feed(core, *events):
    core.on_packet(encode_events(InputEvent(0, 0, *event) for event in (*events, (0, 0, 0))), 0.0)


def tap(core):
    feed(core, (1, c.BTN_SOUTH, 1))
    feed(core, (1, c.BTN_SOUTH, 0))


def bluetooth_xbox():
    """Set up a pad with its right stick on Z and RZ, and its triggers on BRAKE and GAS."""
    stick, trigger = AbsInfo(0, 0, 65535, 255, 4095, 0), AbsInfo(0, 0, 1023, 3, 63, 0)
    axes = dict.fromkeys((c.ABS_X, c.ABS_Y, c.ABS_Z, c.ABS_RZ), stick)
    axes |= dict.fromkeys((c.ABS_BRAKE, c.ABS_GAS), trigger)
    keys = frozenset({c.BTN_SOUTH, c.BTN_NORTH})
    return EvdevDeviceInfo("Xbox Wireless Controller", 0x045E, 0x0B13, keys, axes, frozenset())


def test_a_pad_with_its_right_stick_elsewhere():
    core = GamepadCore(GamepadOptions(layout="triggers"))
    values = dict.fromkeys((c.ABS_X, c.ABS_Y, c.ABS_Z, c.ABS_RZ), 32768)
    core.on_opened(
        bluetooth_xbox(), EvdevState(frozenset(), {**values, c.ABS_BRAKE: 0, c.ABS_GAS: 0}), 0.0
    )
    tap(core)
    assert core.state(0.0).link is DeviceLink.LIVE
    feed(core, (3, c.ABS_RZ, 0), (3, c.ABS_Z, 0), (3, c.ABS_GAS, 1023), (1, c.BTN_NORTH, 1))
    state = core.state(0.0)
    assert state.axes == (0.0, 0.0, 1.0, 0.0, 1.0, 1.0)
    assert state.buttons == {"west"}


BYTE = AbsInfo(0, 0, 255, 0, 0, 0)
SIX = (c.ABS_X, c.ABS_Y, c.ABS_Z, c.ABS_RX, c.ABS_RY, c.ABS_RZ)
RIGHT_AT = {"RX": (c.ABS_RX, c.ABS_RY), "Z": (c.ABS_Z, c.ABS_RZ)}


def unknown_pad(keys=(c.BTN_SOUTH,), axes=None, vendor=0x1234, product=1, driver="hid-generic"):
    axes = axes or dict.fromkeys(SIX, BYTE)
    return EvdevDeviceInfo("Pad", vendor, product, frozenset(keys), axes, frozenset(), driver)


def at_rest(right):
    """Return axis values with the triggers at 0 and the others in the middle."""
    return {code: 128 if code in (c.ABS_X, c.ABS_Y, *right) else 0 for code in SIX}


@pytest.mark.parametrize("right", RIGHT_AT.values(), ids=RIGHT_AT)
@pytest.mark.parametrize("heard", [False, True], ids=["not heard before", "heard before"])
def test_an_unknown_pads_axes_are_reported_by_where_they_rest(right, heard):
    """The kernel reports 0 for all axes before the first report."""
    core = GamepadCore(GamepadOptions())
    rest = at_rest(right)
    before = rest if heard else dict.fromkeys(SIX, 0)
    core.on_opened(unknown_pad(), EvdevState(frozenset(), before), 0.0)
    feed(core, (1, c.BTN_SOUTH, 1), *((3, code, value) for code, value in rest.items()))
    feed(core, (1, c.BTN_SOUTH, 0))
    assert core.state(0.0).link is DeviceLink.LIVE
    feed(core, (3, right[1], 0))
    assert core.state(0.0).axes == (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    # The assignment found at rest is kept for all later positions.
    feed(core, *((3, code, 128) for code in SIX), (3, right[0], 0), (3, right[1], 0))
    assert core.state(0.0).axes == (0.0, 0.0, 1.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("right", RIGHT_AT.values(), ids=RIGHT_AT)
@pytest.mark.parametrize("held", [(0, 128), (0, 0), (255, 255)])
def test_a_stick_that_is_held_while_it_is_opened_is_no_trigger(right, held):
    core = GamepadCore(GamepadOptions())
    deflected = at_rest(right) | dict(zip(right, held, strict=True))
    core.on_opened(unknown_pad(), EvdevState(frozenset(), deflected), 0.0)
    tap(core)
    assert core.state(0.0).link is DeviceLink.NEEDS_NEUTRAL
    assert "stick" in core.state(0.0).reason
    assert core.state(0.0).buttons == set()
    feed(core, *((3, code, 128) for code in right))
    assert core.state(0.0).link is DeviceLink.LIVE
    feed(core, (3, right[1], 255))
    assert core.state(0.0).axes == (0.0, 0.0, -1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("right", RIGHT_AT.values(), ids=RIGHT_AT)
@pytest.mark.parametrize("pressed", [128, 255])
def test_a_trigger_that_is_held_while_it_is_opened_is_no_stick(right, pressed):
    core = GamepadCore(GamepadOptions())
    trigger = next(code for code in (c.ABS_RX, c.ABS_Z) if code not in right)
    held = EvdevState(frozenset(), at_rest(right) | {trigger: pressed})
    core.on_opened(unknown_pad(), held, 0.0)
    tap(core)
    assert core.state(0.0).link is DeviceLink.LIVE
    feed(core, (3, right[1], 255))
    state = core.state(0.0)
    assert state.axes == (0.0, 0.0, -1.0, 0.0, 0.0, 0.0)
    feed(core, (3, trigger, 0))
    feed(core, (3, trigger, 255))
    assert core.state(0.0).buttons == {"left-trigger"}


@pytest.mark.parametrize("driver", ["playstation", "sony", "xpad", "xone-gip-gamepad"])
def test_the_kernels_own_drivers_say_what_is_what(driver):
    """Held controls do not matter: here half-pressed triggers, and a stick in its corner."""
    core = GamepadCore(GamepadOptions())
    held = dict.fromkeys(SIX, 128) | {c.ABS_RX: 0, c.ABS_RY: 0}
    core.on_opened(
        unknown_pad(vendor=0x054C, product=0x09CC, driver=driver),
        EvdevState(frozenset(), held),
        0.0,
    )
    tap(core)
    assert core.state(0.0).link is DeviceLink.NEEDS_NEUTRAL
    feed(core, *((3, code, value) for code, value in at_rest((c.ABS_RX, c.ABS_RY)).items()))
    assert core.state(0.0).link is DeviceLink.LIVE


@pytest.mark.parametrize(
    ("vendor", "driver", "exchanged"),
    [
        (0x0E6F, "xone-gip-gamepad", True),  # PDP
        (0x0E6F, "xpad", True),
        (0x045E, "xone-gip-gamepad", True),
        (0x2DC8, "xpadneo", True),  # 8BitDo
        (0x28DE, "hid-steam", True),
        (0x045E, "hid-generic", True),
        (0x0E6F, "hid-generic", False),
        (0x057E, "nintendo", False),
    ],
)
def test_north_and_west_are_where_they_are_with_each_driver_of_the_pad(vendor, driver, exchanged):
    core = GamepadCore(GamepadOptions())
    keys = (c.BTN_SOUTH, c.BTN_NORTH, c.BTN_WEST)
    pad = unknown_pad(keys, vendor=vendor, driver=driver)
    core.on_opened(pad, EvdevState(frozenset(), at_rest((c.ABS_RX, c.ABS_RY))), 0.0)
    tap(core)
    for code, label in ((c.BTN_NORTH, "north"), (c.BTN_WEST, "west")):
        feed(core, (1, code, 1))
        other = {"north": "west", "west": "north"}[label]
        assert core.state(0.0).buttons == {other if exchanged else label}
        feed(core, (1, code, 0))


COUNTED = range(c.BTN_SOUTH, c.BTN_SOUTH + 14)


@pytest.mark.parametrize(
    ("vendor", "product", "labels"),
    [
        *((0x054C, product, {0: "west", 1: "south", 6: "left-trigger", 12: "mode"})
          for product in (0x05C4, 0x09CC, 0x0BA0, 0x0CE6, 0x0DF2)),
        (0x045E, 0x02E0, {0: "south", 2: "west", 3: "north", 4: "left-shoulder", 7: "start"}),
    ],
)  # fmt: skip
def test_buttons_that_were_counted_are_those_of_the_pad(vendor, product, labels):
    core = GamepadCore(GamepadOptions())
    rest = at_rest(RIGHT_AT["Z" if vendor == 0x054C else "RX"])
    core.on_opened(unknown_pad(COUNTED, None, vendor, product), EvdevState(frozenset(), rest), 0.0)
    tap(core)
    for at, label in labels.items():
        feed(core, (1, c.BTN_SOUTH + at, 1))
        assert core.state(0.0).buttons == {label}
        feed(core, (1, c.BTN_SOUTH + at, 0))
    assert core.diagnosis(0.0) == []


def test_counted_buttons_of_an_unknown_pad_are_said_to_be_a_guess():
    core = GamepadCore(GamepadOptions())
    core.on_opened(unknown_pad(COUNTED), EvdevState(frozenset(), at_rest(RIGHT_AT["Z"])), 0.0)
    tap(core)
    assert any("try the dead-man" in words for words in core.diagnosis(0.0))


def test_triggers_that_are_buttons_move_all_the_same():
    axes = dict.fromkeys((c.ABS_X, c.ABS_Y, c.ABS_RX, c.ABS_RY), AbsInfo(0, -100, 100, 0, 0, 0))
    keys = frozenset({c.BTN_SOUTH, c.BTN_TL2, c.BTN_TR2})
    core = GamepadCore(GamepadOptions(layout="triggers"))
    core.on_opened(
        EvdevDeviceInfo("Pro Controller", 0x057E, 0x2009, keys, axes, frozenset()),
        EvdevState(frozenset(), dict.fromkeys(axes, 0)),
        0.0,
    )
    feed(core, (1, c.BTN_TL2, 1))
    assert "let go of the sticks and triggers" in core.state(0.0).reason
    feed(core, (1, c.BTN_TL2, 0))
    tap(core)
    feed(core, (1, c.BTN_TL2, 1))
    assert core.state(0.0).axes == (0.0, 0.0, -1.0, 0.0, 0.0, 0.0)


def test_a_stick_held_while_it_is_opened_does_not_move():
    bench = Bench()
    bench.run(0.1, NOT_RESTING)
    bench.open()
    state = bench.run(1.0)
    assert (state.link, state.axes) == (DeviceLink.NEEDS_NEUTRAL, REST)
    assert "left stick, left and right: +0.50" in state.reason
    assert bench.run(0.1, REST).link is DeviceLink.LIVE
    assert bench.run(0.1, NOT_RESTING).axes[1] == pytest.approx(-0.5, abs=0.01)


def test_a_button_held_while_it_is_opened_counts_once_it_was_up():
    """A release of the dead-man before the opening would have been missed."""
    bench = Bench()
    bench.press("left-shoulder")
    bench.core.events()
    bench.open()
    bench.touch()
    state = bench.run(0.1)
    assert (state.link, state.buttons) == (DeviceLink.LIVE, frozenset())
    bench.release("left-shoulder")
    assert bench.core.events() == []
    assert bench.press("left-shoulder").buttons == {"left-shoulder"}
    assert [event.pressed for event in bench.core.events()] == [True]


@pytest.mark.parametrize("model", [*PADS, "keyboard"])
def test_nothing_is_believed_of_a_device_that_nobody_touched(model):
    """Before the first frame the kernel's values are only a guess: all zero."""
    bench = Bench(model, touched=False)
    state = bench.run(1.0)
    assert (state.link, state.axes) == (DeviceLink.NEEDS_NEUTRAL, REST)
    assert "once" in state.reason
    dead_man = "left-shoulder" if bench.model.is_gamepad else "space"
    state = bench.press(dead_man)
    assert (state.link, state.buttons) == (DeviceLink.LIVE, frozenset()), "possibly held before"
    bench.release(dead_man)
    assert bench.core.events() == []
    assert bench.press(dead_man).buttons == {dead_man}


def test_a_press_and_its_release_in_one_frame_are_two_edges():
    bench = Bench()
    frame = [(1, c.BTN_SOUTH, 1), (1, c.BTN_SOUTH, 0), (0, 0, 0)]
    bench.core.on_packet(encode_events(InputEvent(0, 0, *event) for event in frame), 0.0)
    assert [event.pressed for event in bench.core.events()] == [True, False]


def test_a_frame_counts_when_it_is_whole():
    bench = Bench()
    event = InputEvent(0, 0, 3, c.ABS_X, 32767)
    bench.core.on_packet(encode_events([event]), 0.0)
    assert bench.core.state(0.0).axes == REST
    bench.core.on_packet(encode_events([InputEvent(0, 0, 0, 0, 0)]), 0.0)
    assert bench.core.state(0.0).axes[1] == -1.0


def test_the_stamp_is_that_of_the_newest_look():
    """A deflected device may be silent; an old stamp would make the gateway stop."""
    bench = Bench()
    state = bench.run(2.0, NOT_RESTING)
    assert state.link is DeviceLink.LIVE
    assert any(state.axes)
    assert state.stamp_s == pytest.approx(bench.now_s)


def test_drift_within_the_dead_zone_is_rest_and_beyond_is_named():
    assert Bench(faults={"drift": 0.08}, options=GamepadOptions()).run(0.1).axes == REST
    state = Bench(faults={"drift": 0.15}, options=GamepadOptions()).run(0.1)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert "0.15" in state.reason


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4, st.floats(0.0, 1.0), st.floats(0.0, 1.0)))
def test_deflections_stay_in_range(controls):
    for layout in ("sticks", "swapped", "triggers"):
        axes = Bench(options=GamepadOptions(layout=layout)).run(0.05, controls).axes
        assert all(-1.0 <= value <= 1.0 for value in axes)


@given(st.binary(max_size=120), st.integers(0, 300))
def test_random_bytes_never_raise(data, at):
    bench = Bench()
    bench.run(0.02, NOT_RESTING)
    bench.core.on_packet(data, bench.now_s)
    state = bench.core.state(bench.now_s)
    assert all(-1.0 <= value <= 1.0 for value in state.axes)
    if len(data) % 24 and data:
        assert state.axes == REST
    assert bench.core.diagnosis(bench.now_s) is not None


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"transport": "usb"}, "it must be one of evdev, socket"),
        ({"transport": "socket"}, "it must be the path"),
        ({"layout": "both"}, "it must be one of sticks, swapped, triggers"),
        ({"shift": "turbo"}, "shift: 'turbo' is not allowed"),
        ({"stale_after_s": -1.0}, "0 \\(off\\) to 60 s"),
        ({"dead_zone": 1.0}, "dead_zone: 1.0 is not allowed"),
    ],
)
def test_options_that_are_not_allowed(settings, words):
    with pytest.raises(ValueError, match=words):
        GamepadOptions(**settings)
