"""Faults of gamepads and keyboards: neutral within 100 ms, and motion only after rest."""

import itertools

import pytest

from cardan.drivers.gamepad import GamepadOptions
from cardan.protocols.evdev.events import InputEvent, encode_events
from cardan.protocols.evdev.requests import BUS_BLUETOOTH, BUS_USB
from cardan.types import DeviceLink
from tests.drivers.evdev_bench import REST, STEP_S, Bench

pytestmark = pytest.mark.matrix

PUSHED = (0.0, 0.8, 0.0, 0.0, 0.0, 0.0)


def deflected(model, **settings):
    """Return a bench whose operator holds the dead-man and moves."""
    bench = Bench(model, **settings)
    bench.run(0.1)
    bench.press("left-shoulder" if bench.model.is_gamepad else "space")
    push(bench)
    state = bench.run(0.1)
    assert any(state.axes), state
    assert state.buttons
    return bench


def push(bench):
    if bench.model.is_gamepad:
        bench.device.set_controls(PUSHED)
    else:
        bench.device.press("a")


def let_go(bench):
    if bench.model.is_gamepad:
        bench.device.set_controls(REST)
    else:
        bench.device.release("a")


def assert_neutral(state):
    assert (state.axes, state.pose, state.buttons) == (REST, None, frozenset())
    assert state.link is not DeviceLink.LIVE
    assert state.reason


def assert_rearms_only_after_rest(bench):
    """Check that a held deflection moves nothing, and that a new push after rest does, with the
    dead-man pressed again."""
    assert not any(any(state.axes) for state in held_states(bench, 1.0))
    let_go(bench)
    bench.run(0.05)
    dead_man = "left-shoulder" if bench.model.is_gamepad else "space"
    assert bench.run(0.05).link is DeviceLink.LIVE
    assert not bench.states[-1].buttons, "held since before: not a new grip"
    bench.release(dead_man)
    assert bench.press(dead_man).buttons == {dead_man}
    push(bench)
    assert any(bench.run(0.1).axes)


def held_states(bench, seconds):
    before = len(bench.states)
    bench.run(seconds)
    return bench.states[before:]


both = pytest.mark.parametrize("model", ["xbox-360", "keyboard"])


@both
def test_unplugged_and_replugged_while_held(model):
    """The kernel forgets held keys; the first frame reports them like new presses."""
    bench = deflected(model)
    bench.core.events()
    bench.device.unplug()
    bench.run(STEP_S)
    assert_neutral(bench.states[-1])
    assert bench.states[-1].link is DeviceLink.LOST
    assert [event.pressed for event in bench.core.events()] == [False]
    bench.run(0.2)
    bench.device.replug()
    assert_rearms_only_after_rest(bench)


@both
def test_the_system_drops_events(model):
    """A lost event may be a release."""
    bench = deflected(model)
    let_go(bench)
    bench.mangle = lambda packet: [
        encode_events([InputEvent(0, 0, 0, 3, 0), InputEvent(0, 0, 0, 0, 0)])
    ]
    state = bench.run(0.1)
    assert state.axes == REST
    assert bench.core.metrics(bench.now_s)["dropped"] == 1
    bench.mangle = lambda packet: [packet]
    assert state.link is DeviceLink.LIVE, "the device was asked, and rests"
    assert not state.buttons
    assert any("dropped" in words for words in bench.core.diagnosis(bench.now_s))
    bench.core.on_packet(encode_events([InputEvent(0, 0, 0, 3, 0)]), bench.now_s)
    bench.open()
    state = bench.press("start" if bench.model.is_gamepad else "f5")
    assert state.link is DeviceLink.LIVE, "the first frame after opening counts"


@both
def test_the_system_drops_events_and_the_hand_holds_on(model):
    bench = deflected(model)
    bench.core.on_packet(encode_events([InputEvent(0, 0, 0, 3, 0)]), bench.now_s)
    assert_neutral(bench.core.state(bench.now_s))
    bench.run(0.02)
    assert_neutral(bench.states[-1])
    bench.core.on_packet(encode_events([InputEvent(0, 0, 0, 0, 0)]), bench.now_s)
    assert_rearms_only_after_rest(bench)


def test_events_between_drop_and_report_are_not_believed():
    bench = deflected("xbox-360")
    events = [(0, 3, 0), (3, 0, 32767), (1, 0x130, 1), (0, 0, 0)]
    bench.core.on_packet(encode_events(InputEvent(0, 0, *e) for e in events), bench.now_s)
    bench.run(0.02)
    assert "south" not in {event.button for event in bench.core.events()}


@both
@pytest.mark.parametrize(
    "mangle",
    [lambda packet: [packet[:-5]], lambda packet: [b"?" * 7, packet], lambda packet: [b""]],
    ids=["short", "garbage", "empty"],
)
def test_garbled(model, mangle):
    bench = deflected(model)
    bench.answers = False
    bench.mangle = mangle
    let_go(bench)
    bench.run(0.02)
    assert_neutral(bench.states[-1])
    assert bench.core.metrics(bench.now_s)["garbled"] >= 1
    bench.mangle = lambda packet: [packet]
    push(bench)
    assert_neutral(bench.run(1.0))
    bench.answers = True
    assert_rearms_only_after_rest(bench)


@both
def test_nobody_reads_it(model):
    """A reader hangs, or the computer is overloaded."""
    bench = deflected(model)
    bench.read = False
    states = held_states(bench, 0.3)
    assert states[0].link is DeviceLink.LIVE
    late = states[round(0.1 / STEP_S) + 1 :]
    assert all(state.axes == REST and not state.buttons for state in late)
    assert states[-1].link is DeviceLink.STALE
    bench.read = True
    assert_rearms_only_after_rest(bench)


def test_a_reader_that_was_late_finds_out_by_itself():
    """No state was read meanwhile; queued events cause no motion."""
    bench = deflected("xbox-360")
    bench.now_s += 0.5
    bench.core.on_packet(
        encode_events([InputEvent(0, 0, 3, 0, 20000), InputEvent(0, 0, 0, 0, 0)]), bench.now_s
    )
    assert_neutral(bench.core.state(bench.now_s))


def test_a_reader_that_is_late_at_rest_changes_nothing():
    bench = Bench()
    bench.run(0.1)
    bench.now_s += 5.0
    assert bench.core.state(bench.now_s).link is DeviceLink.LIVE
    bench.run(0.05)
    assert any(bench.run(0.1, PUSHED).axes)


def test_stale_after_catches_a_radio_that_died():
    """Valid for gamepads that report continuously while held."""
    options = GamepadOptions(stale_after_s=0.08)
    bench = deflected("dualshock-4", options=options, jitter_lsb=2)
    assert bench.run(1.0).link is DeviceLink.LIVE
    bench.device.silence()
    states = held_states(bench, 0.3)
    assert not any(any(state.axes) for state in states[round(0.1 / STEP_S) :])
    assert states[-1].link is DeviceLink.STALE
    assert "stale_after_s" in states[-1].reason
    bench.device.resume()
    assert_rearms_only_after_rest(bench)


def test_a_bluetooth_device_says_what_a_lost_radio_means():
    def words(bench, bustype):
        bench.core.description = bench.core.description._replace(bustype=bustype)
        return " ".join(bench.core.diagnosis(bench.now_s))

    for model in ("xbox-360", "keyboard"):
        bench = deflected(model)
        assert words(bench, BUS_USB) == ""
        assert "by Bluetooth" in (said := words(bench, BUS_BLUETOOTH))
        assert "stale_after_s" in said
        assert "dead-man" in said
    bench = deflected("dualshock-4", options=GamepadOptions(stale_after_s=0.1), jitter_lsb=2)
    assert words(bench, BUS_BLUETOOTH) == ""


def test_a_radio_that_died_cannot_be_seen_without_it():
    """Documented: the kernel reports changes only."""
    bench = deflected("xbox-360")
    bench.device.silence()
    assert any(bench.run(10.0).axes)


@pytest.mark.parametrize("fault", ["stuck-axis", "stuck-button"])
def test_what_sticks_stays_until_the_dead_man_goes(fault):
    bench = Bench(faults={fault: 0.5}, options=GamepadOptions(dead_zone=0.0))
    bench.press("left-shoulder")
    bench.run(0.6, PUSHED)
    bench.device.set_controls(REST)
    bench.device.release("left-shoulder")
    state = bench.run(0.2)
    assert any(state.axes) == (fault == "stuck-axis")
    assert bool(state.buttons) == (fault == "stuck-button")


def test_frames_without_an_end_are_cut():
    bench = deflected("xbox-360")
    junk = encode_events(itertools.repeat(InputEvent(0, 0, 3, 0, 9), 64))
    for _ in range(6):
        bench.core.on_packet(junk, bench.now_s)
    assert bench.core.metrics(bench.now_s)["overlong_frames"] >= 1
    assert_neutral(bench.core.state(bench.now_s))


def test_closed():
    bench = deflected("xbox-360")
    bench.core.on_closed(bench.now_s)
    state = bench.core.state(bench.now_s)
    assert_neutral(state)
    assert state.link is DeviceLink.CLOSED
