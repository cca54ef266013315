"""Core of the SpaceMouse driver in virtual time: plausibility of reports, and texts of states."""

import contextlib
import dataclasses

import pyspacemouse
import pytest
from hypothesis import given, settings, strategies as st
from pyspacemouse.config_helpers import apply_axis_convention
from pyspacemouse.device import SpaceMouseDevice
from pyspacemouse.types import AxisConvention

from cardan.drivers.buttons import MAX_EVENTS
from cardan.drivers.spacemouse import SpaceMouseCore, SpaceMouseOptions
from cardan.drivers.spacemouse.core import GAP_AFTER_S, SETTLE_S, STALE_AFTER_S
from cardan.errors import CommandError, OptionError
from cardan.protocols.connexion.devices import Family, find_model, model_by_key
from cardan.protocols.connexion.reports import (
    decode_input,
    encode_battery,
    encode_buttons,
    encode_keys_down,
    encode_long_press,
    encode_motion,
    encode_rotation,
    encode_translation,
    to_robot_axes,
)
from cardan.types import NEUTRAL, NEVER_S, DeviceLink
from tests.examples import examples

PLAIN = SpaceMouseOptions(dead_zone=0.05)
UP = (0, 0, -175, 0, 0, 0)
ZERO = (0, 0, 0, 0, 0, 0)


class Device:
    """Send reports to a core, and advance the time."""

    def __init__(self, model="spacenavigator", options=PLAIN, family=None):
        self.model = model_by_key(model) if model else None
        self.split = (family or (self.model.family if self.model else Family.SPLIT)) is Family.SPLIT
        self.core = SpaceMouseCore(options, self.model)
        self.now_s = 1000.0
        self.core.on_opened(self.now_s, self.model)

    def motion(self, raw, times=1):
        """Send whole samples, 16 ms each."""
        for _ in range(times):
            if self.split:
                self.report(encode_translation(*raw[:3]), 0.008)
                self.report(encode_rotation(*raw[3:]), 0.008)
            else:
                self.report(encode_motion(*raw), 0.016)
        return self.state

    def report(self, data, after_s=0.0):
        self.now_s += after_s
        self.core.on_report(bytes(data), self.now_s)

    def wait(self, seconds):
        self.now_s += seconds
        return self.state

    def live(self):
        assert self.motion(ZERO, 2).link is DeviceLink.LIVE
        return self

    @property
    def state(self):
        return self.core.state(self.now_s)

    def edges(self):
        return [(event.button, event.pressed) for event in self.core.events()]


@pytest.fixture(params=["spacenavigator", "spacemouse-wireless"])
def device(request):
    return Device(request.param)


# -- neutral first -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "near"),
    [("spacemouse-prp", "spacemouse-pro"), ("SpaceNavigator", "spacenavigator"), ("x", "")],
)
def test_of_a_model_that_nobody_knows_the_nearest_is_named(model, near):
    with pytest.raises(OptionError) as caught:
        SpaceMouseOptions(model=model)
    assert caught.value.key == "model"
    assert str(caught.value).partition("; did you mean ")[2] == (near and f"{near!r}?")


def test_before_opening_it_is_closed():
    state = SpaceMouseCore(PLAIN).state(5.0)
    assert (state.link, state.axes, state.stamp_s) == (DeviceLink.CLOSED, NEUTRAL, NEVER_S)
    assert state.reason


def test_a_silent_device_needs_a_touch(device):
    for _ in range(3):
        state = device.wait(3600.0)
        assert (state.link, state.axes) == (DeviceLink.NEEDS_NEUTRAL, NEUTRAL)
        assert "touch the cap and let go once" in state.reason


def test_a_touch_and_release_makes_it_live(device):
    state = device.motion(UP, 5)
    assert (state.link, state.axes) == (DeviceLink.NEEDS_NEUTRAL, NEUTRAL)
    state = device.motion(ZERO)
    assert (state.link, state.axes, state.reason) == (DeviceLink.LIVE, NEUTRAL, "")
    assert device.motion(UP).axes[2] == pytest.approx((0.5 - 0.05) / 0.95)


def test_both_halves_have_to_rest():
    device = Device()
    device.report(encode_translation(0, 0, 0), 0.008)
    assert device.state.link is DeviceLink.NEEDS_NEUTRAL
    device.report(encode_rotation(0, 0, 90), 0.008)
    device.report(encode_translation(0, 0, 0), 0.008)
    assert device.state.link is DeviceLink.NEEDS_NEUTRAL
    device.report(encode_rotation(0, 0, 2), 0.008)
    assert device.state.link is DeviceLink.LIVE


def test_rest_counts_only_after_the_deflection():
    device = Device()
    device.report(encode_rotation(0, 0, 0), 0.008)
    device.report(encode_translation(0, 0, 90), 0.008)
    device.report(encode_translation(0, 0, 0), 0.016)
    assert device.state.link is DeviceLink.NEEDS_NEUTRAL
    device.report(encode_rotation(0, 0, 0), 0.008)
    assert device.state.link is DeviceLink.LIVE


def test_worked_sample():
    device = Device(options=SpaceMouseOptions(dead_zone=0.0)).live()
    device.report(bytes.fromhex("01 78 00 d3 ff 2c 01"), 0.008)
    device.report(bytes.fromhex("02 a2 fe 08 00 40 00"), 0.008)
    expected = (0.1286, -0.3429, -0.8571, -0.0229, 1.0, -0.1829)
    assert device.state.axes == pytest.approx(expected, abs=1e-4)
    assert device.state.stamp_s == device.now_s


# -- silence -----------------------------------------------------------------------------------


def test_silence_at_rest_is_rest(device):
    device.live()
    state = device.wait(7200.0)
    assert (state.link, state.axes) == (DeviceLink.LIVE, NEUTRAL)


def test_silence_inside_the_dead_zone_is_rest(device):
    device.live()
    device.motion((9, -9, 9, -9, 9, -9))
    assert device.wait(60.0).link is DeviceLink.LIVE


def test_motion_after_a_long_rest_is_believed(device):
    device.live()
    device.wait(600.0)
    assert device.motion(UP).link is DeviceLink.LIVE
    assert device.state.axes[2] > 0.4


def test_silence_while_deflected_is_trouble(device):
    device.live()
    device.motion(UP, 3)
    older_s = 0.008 if device.split else 0.0
    assert device.wait(STALE_AFTER_S - older_s - 1e-6).link is DeviceLink.LIVE
    state = device.wait(2e-6)
    assert (state.link, state.axes) == (DeviceLink.STALE, NEUTRAL)
    assert "no motion report for 0.09 s" in state.reason
    assert device.wait(3600.0).link is DeviceLink.STALE


def test_after_trouble_only_rest_makes_it_live(device):
    device.live()
    device.motion(UP, 3)
    device.wait(1.0)
    for _ in range(3):
        state = device.motion(UP, 20)
        assert (state.link, state.axes) == (DeviceLink.NEEDS_NEUTRAL, NEUTRAL)
        assert "let go" in state.reason
    assert device.motion(ZERO).link is DeviceLink.LIVE
    assert device.core.metrics(device.now_s)["silences"] == 1


def test_trouble_is_noticed_by_the_next_report_too(device):
    device.live()
    device.motion(UP, 3)
    device.now_s += 0.5
    state = device.motion(UP)
    assert (state.link, state.axes) == (DeviceLink.NEEDS_NEUTRAL, NEUTRAL)


def test_rest_that_queued_up_during_a_stall_is_not_believed(device):
    device.live()
    device.motion(UP, 3)
    device.now_s += 0.5
    stalled_s = device.now_s
    for raw in (UP, UP, ZERO, ZERO, ZERO):
        device.motion(raw)
        device.now_s = stalled_s
    assert device.state.link is DeviceLink.NEEDS_NEUTRAL
    device.now_s = stalled_s + 2 * SETTLE_S
    assert device.motion(ZERO).link is DeviceLink.LIVE


@pytest.mark.parametrize("retained", ["translation", "rotation"])
def test_a_half_that_stops_is_noticed(retained):
    device = Device().live()
    device.motion((0, 0, -175, 0, 0, 100), 3)
    links, reasons = set(), []
    for _ in range(20):
        if retained == "translation":
            device.report(encode_translation(0, 0, -175), 0.0)
        else:
            device.report(encode_rotation(0, 0, 100), 0.0)
        for _ in range(16):
            state = device.wait(0.001)
            links.add(state.link)
            reasons.append(state.reason)
    other = "rotation" if retained == "translation" else "translation"
    assert DeviceLink.LIVE in links
    assert device.state.link is not DeviceLink.LIVE
    metrics = device.core.metrics(device.now_s)
    assert metrics[f"{other}_age_s"] > 0.3
    assert metrics[f"{retained}_age_s"] == pytest.approx(0.016)
    assert metrics["unpaired_halves"] > 3
    reasons = [words for words in reasons if "deflected, but" in words]
    assert reasons
    assert all(f"no {other} report" in words for words in reasons)


def test_gaps_are_counted(device):
    device.live()
    device.motion(UP, 3)
    device.wait(GAP_AFTER_S)
    device.motion(UP)
    device.wait(3600.0 if device.motion(ZERO).link is DeviceLink.LIVE else 0.0)
    device.motion(UP)
    assert device.core.metrics(device.now_s)["gaps"] == 1
    words = f"gaps of more than {1e3 * GAP_AFTER_S:.0f} ms"
    assert any(words in each for each in device.core.diagnosis(device.now_s))


# -- loss and closing --------------------------------------------------------------------------


def test_lost_while_moving(device):
    device.live()
    device.report(encode_buttons(0, 3))
    device.report(encode_buttons(0b11, 3))
    device.motion(UP, 3)
    device.core.on_lost("unplugged", device.now_s)
    state = device.state
    assert (state.link, state.axes, state.buttons) == (DeviceLink.LOST, NEUTRAL, frozenset())
    assert state.reason == "unplugged"
    assert device.edges() == [("left", True), ("right", True), ("left", False), ("right", False)]
    device.motion(UP)
    assert device.state == state
    device.core.on_opened(device.now_s, device.model)
    assert device.motion(UP, 3).link is DeviceLink.NEEDS_NEUTRAL
    assert device.motion(ZERO).link is DeviceLink.LIVE


def test_closing_releases_buttons(device):
    device.report(encode_buttons(0b01, 3))
    device.core.on_closed(device.now_s)
    assert device.edges() == [("left", True), ("left", False)]
    assert device.state.link is DeviceLink.CLOSED


def test_a_reopened_device_has_said_nothing():
    device = Device().live()
    device.core.on_lost("unplugged", device.now_s)
    device.core.on_opened(device.now_s, device.model)
    assert not device.core.heard
    device.report(encode_translation(0, 0, 0))
    assert device.core.heard
    assert device.state.link is DeviceLink.NEEDS_NEUTRAL


# -- families ----------------------------------------------------------------------------------


@pytest.mark.parametrize("family", Family)
@pytest.mark.parametrize("model", ["spacenavigator", "spacemouse-wireless-bt", None])
def test_the_reports_decide_the_family(model, family):
    device = Device(model, family=family).live()
    state = device.motion((0, 0, 0, 0, 0, -175))
    assert state.axes[5] == pytest.approx((0.5 - 0.05) / 0.95)
    notes = [words for words in device.core.diagnosis(device.now_s) if "unlike" in words]
    assert bool(notes) == (device.model is not None and family is not device.model.family)


def test_zero_filled_halves_do_not_reset_the_rotation():
    device = Device()
    for raw in (ZERO, ZERO, (0, 0, 100, 0, 0, 100)):
        device.report(encode_translation(*raw[:3]) + bytes(57), 0.008)
        device.report(encode_rotation(*raw[3:]) + bytes(57), 0.008)
    device.report(encode_translation(0, 0, 100) + bytes(57), 0.008)
    assert device.state.link is DeviceLink.LIVE
    assert device.state.axes[5] < -0.2
    assert device.core.metrics(device.now_s)["unusual_lengths"] == 7


def test_zero_filled_first_half_is_no_proof_of_rest():
    device = Device()
    device.report(encode_translation(0, 0, 0) + bytes(57))
    assert device.state.link is DeviceLink.NEEDS_NEUTRAL


def test_serial_axes_are_turned():
    device = Device("spacemouse-plus-xt", SpaceMouseOptions(dead_zone=0.0)).live()
    device.motion((35, 70, 105, 0, 0, 0))  # right, up, away
    assert device.state.axes[:3] == pytest.approx((0.3, -0.1, 0.2))


@pytest.mark.parametrize(
    ("setting", "descriptor", "expected"),
    [(None, None, 350), (None, 500, 500), (420.0, 500, 420), (None, 1, 350), (None, 32767, 350)],
)
def test_full_scale(setting, descriptor, expected):
    core = SpaceMouseCore(SpaceMouseOptions(dead_zone=0.0, full_scale=setting))
    core.on_opened(0.0, model_by_key("spacemouse-wireless"), descriptor)
    core.on_report(encode_motion(*ZERO), 0.1)
    core.on_report(encode_motion(-100, 0, 0, 0, 0, 0), 0.2)
    assert core.full_scale == expected
    assert core.state(0.2).axes[1] == pytest.approx(100 / expected)


def test_beyond_full_scale_is_clamped(device):
    device.live()
    assert device.motion((-420, 0, 0, 0, 420, 0)).axes == (0.0, 1.0, 0.0, -1.0, 0.0, 0.0)


def test_radial_dead_zone_decides_rest():
    options = SpaceMouseOptions(dead_zone=0.1, dead_zone_shape="radial")
    device = Device(options=options).live()
    device.motion((24, 24, 0, 0, 0, 0), 2)  # length 33.9 of 350
    assert device.wait(1.0).link is DeviceLink.LIVE
    device.motion((26, 26, 0, 0, 0, 0), 2)  # 36.8
    assert device.wait(1.0).link is DeviceLink.STALE


# -- buttons -----------------------------------------------------------------------------------


def test_edges_keep_their_order():
    device = Device()
    for mask in (1, 3, 2, 3, 0, 1, 1, 0):
        device.report(encode_buttons(mask, 3), 0.001)
    assert device.edges() == [
        ("left", True), ("right", True), ("left", False), ("left", True),
        ("left", False), ("right", False), ("left", True), ("left", False),
    ]  # fmt: skip
    assert device.edges() == []


def test_edges_carry_the_time_of_their_report():
    device = Device()
    device.report(encode_buttons(1, 3), 0.5)
    pressed_s = device.now_s
    device.motion(UP, 4)
    assert [event.stamp_s for event in device.core.events()] == [pressed_s]


def test_pro_labels():
    device = Device("spacemouse-pro-wireless")
    device.report(encode_buttons(0, 7))
    device.report(bytes.fromhex("03 00 10 00 02 00 00"))
    assert device.state.buttons == {"1", "ctrl"}
    device.report(b"\x03\x10")  # a short report 3: the missing bytes are zero
    assert device.state.buttons == {"right"}


def test_bits_and_key_arrays_are_merged():
    device = Device("spacemouse-enterprise")
    device.report(encode_keys_down([]))
    device.report(encode_buttons(1 << 12, 5))
    device.report(encode_keys_down([13, 103]))
    device.report(encode_keys_down([103]))
    assert device.state.buttons == {"1", "v1"}
    device.report(encode_buttons(0, 5))
    device.report(encode_keys_down([]))
    assert device.edges() == [("1", True), ("v1", True), ("1", False), ("v1", False)]


def test_the_first_report_that_names_several_buttons_presses_none():
    device = Device("spacenavigator")
    device.report(encode_buttons(0b11, 3))
    assert device.core.events() == []
    device.report(encode_buttons(0b10, 3))
    device.report(encode_buttons(0b11, 3))
    assert device.edges() == [("left", True)]
    device.core.on_lost("unplugged", device.now_s)
    device.core.on_opened(device.now_s, device.model)
    device.core.events()
    device.report(encode_buttons(0b11, 3))
    assert device.core.state(device.now_s).buttons == frozenset()


def test_a_key_that_only_the_array_names_is_no_press_when_it_was_down_before():
    """The other key first appears in report 3, where v1 has no bit."""
    device = Device("spacemouse-enterprise")
    device.report(encode_buttons(1 << 12, 5))
    device.report(encode_keys_down([13, 103]))
    assert "v1" not in {event.button for event in device.core.events()}
    assert "v1" not in device.core.state(device.now_s).buttons
    device.report(encode_buttons(0, 5))
    device.report(encode_keys_down([]))
    device.core.events()
    device.report(encode_keys_down([103]))
    assert device.core.state(device.now_s).buttons == {"v1"}


def test_two_keys_that_are_held_long_stay_down():
    device = Device("spacemouse-enterprise")
    for codes in ([13], [13, 26]):
        device.report(encode_buttons(sum(1 << code - 1 for code in codes), 5))
        device.report(encode_keys_down(codes))
    device.report(encode_long_press([13, 26]))
    assert device.edges() == [("1", True), ("ctrl", True)]


def test_the_first_report_that_names_one_button_is_a_press():
    device = Device("spacenavigator")
    device.report(encode_buttons(0b10, 3))
    assert device.core.state(device.now_s).buttons == {"right"}
    device.report(encode_buttons(0b11, 3))
    assert device.core.state(device.now_s).buttons == {"left", "right"}


@pytest.mark.parametrize("outage", ["silence", "unplugged"])
def test_another_report_does_not_bring_back_a_button_held_through_an_outage(device, outage):
    device.motion(ZERO, 2)
    device.report(encode_buttons(1, 3))
    device.motion(UP, 5)
    if outage == "silence":
        assert device.wait(0.2).link is DeviceLink.STALE
    else:
        device.core.on_lost("unplugged", device.now_s)
        device.core.on_opened(device.now_s, device.model)
    device.core.events()
    device.motion(ZERO, 5)
    # Reports of another type do not change it.
    device.report(encode_keys_down([]))
    device.report(encode_long_press([]))
    device.report(encode_buttons(0b11, 3))
    device.report(encode_buttons(0b01, 3))
    assert ("left", True) not in device.edges()
    device.report(encode_buttons(0, 3))
    device.report(encode_buttons(1, 3))
    assert device.state.buttons == {"left"}


def test_long_press_is_a_button_of_its_own():
    device = Device("spacemouse-enterprise")
    device.report(encode_keys_down([3]))
    device.report(encode_long_press([3]))
    assert device.state.buttons == {"top", "bottom"}
    device.report(encode_long_press([7]))  # the long press's meaning in place of the key: the same
    assert device.state.buttons == {"top", "bottom"}
    device.report(encode_keys_down([]))
    assert device.state.buttons == frozenset()


def test_long_press_bits():
    device = Device("spacemouse-pro")
    device.report(encode_buttons(1 << 2, 7))
    device.report(encode_buttons(1 << 2 | 1 << 22, 7))
    device.report(bytes.fromhex("16 04 00 40 00"))
    assert device.state.buttons == {"top", "bottom", "esc"}
    device.report(encode_buttons(0, 7))
    assert device.state.buttons == frozenset()


@pytest.mark.parametrize(
    ("model", "length", "labels"),
    [
        (None, 3, {"left", "right"}),
        (None, 7, {"menu", "fit"}),
        ("universal-receiver", 3, {"left", "right"}),
        ("universal-receiver", 7, {"menu", "fit"}),
        ("spacemouse-wireless", 7, {"left", "right"}),
    ],
)
def test_what_is_paired_shows_in_the_buttons(model, length, labels):
    device = Device(model)
    device.report(encode_buttons(0b01, length))
    device.report(encode_buttons(0b11, length))
    assert device.state.buttons == labels
    assert labels <= set(device.core.labels or labels)


def test_unknown_buttons_have_a_name():
    device = Device()
    device.report(encode_buttons(1 << 9, 3))
    device.report(encode_keys_down([999]))
    assert device.state.buttons == {"button-9", "key-999"}


def test_trouble_releases_buttons(device):
    device.live()
    device.report(encode_buttons(1, 3))
    device.motion(UP, 2)
    assert device.state.buttons == {"left"}
    assert device.wait(1.0).buttons == frozenset()
    assert device.edges() == [("left", True), ("left", False)]
    device.motion(ZERO, 3)
    assert device.state.buttons == frozenset()
    device.report(encode_buttons(0, 3))
    device.report(encode_buttons(1, 3))
    assert device.edges() == [("left", True)]


def test_events_that_nobody_takes_are_bounded_and_counted():
    device = Device()
    for count in range(MAX_EVENTS + 10):
        device.report(encode_buttons(1 - count % 2, 3))
    assert len(device.core.events()) == MAX_EVENTS
    assert any("10 button edges" in words for words in device.core.diagnosis(device.now_s))


# -- battery, drift, bad bytes -----------------------------------------------------------------


def test_battery():
    device = Device("spacemouse-wireless").live()
    assert device.state.battery is None
    device.report(encode_battery(85, False))
    assert device.state.battery == 0.85
    assert device.core.diagnosis(device.now_s) == []
    device.report(encode_battery(10, False))
    assert device.core.diagnosis(device.now_s) == ["battery at 10 %: charge it"]
    device.report(encode_battery(8, True))
    assert device.core.diagnosis(device.now_s) == []
    device.report(encode_battery(8, False))
    device.core.on_opened(device.now_s, device.model)
    assert device.state.battery is None
    assert not any("battery" in words for words in device.core.diagnosis(device.now_s))


OFF = (25, 0, -24, 0, 0, 0)


def test_drift_is_distinguished_from_a_hand(device):
    device.motion(OFF, 350)
    assert any("rests off zero" in words for words in device.core.diagnosis(device.now_s))
    device.core.on_lost("unplugged", device.now_s)
    device.core.on_opened(device.now_s, device.model)
    assert not any("rests off zero" in words for words in device.core.diagnosis(device.now_s))
    device.motion(OFF, 350)
    device.motion((0, 60, 0, 0, 0, 0), 20)
    assert not any("rests off zero" in words for words in device.core.diagnosis(device.now_s))


def test_a_firm_hand_is_no_drift(device):
    device.live()
    device.motion((120, 0, 0, 0, 0, 0), 700)
    assert device.core.diagnosis(device.now_s) == []


def test_rezero_ends_the_drift(device):
    device.motion(OFF, 350)
    assert device.state.link is DeviceLink.NEEDS_NEUTRAL
    device.core.rezero(device.now_s)
    assert not any("off zero" in words for words in device.core.diagnosis(device.now_s))
    assert device.motion(OFF, 2).link is DeviceLink.LIVE
    assert device.state.axes == NEUTRAL
    x, y, z = device.motion((25 - 70, 0, -24, 0, 0, 0)).axes[:3]
    assert (x, z) == (0.0, 0.0)
    assert y == pytest.approx((0.2 - 0.05) / 0.95)
    device.core.on_lost("unplugged", device.now_s)
    device.core.on_opened(device.now_s, device.model)
    assert device.motion(OFF, 3).link is DeviceLink.NEEDS_NEUTRAL


def test_rezero_twice_adds_up(device):
    device.motion(OFF, 350)
    device.core.rezero(device.now_s)
    device.motion((50, 0, -24, 0, 0, 0), 350)
    device.core.rezero(device.now_s)
    assert device.core.state(device.now_s).axes == NEUTRAL
    device.report(encode_rotation(0, 0, 0), 0.008)
    device.wait(1.0)
    assert device.state.link is not DeviceLink.STALE
    assert device.motion((50, 0, -24, 0, 0, 0), 2).link is DeviceLink.LIVE


def test_rezero_in_silence_takes_the_last_rest(device):
    device.live()
    device.motion((8, 0, 0, 0, 0, 0), 3)
    device.wait(1.0)
    device.core.rezero(device.now_s)
    device.motion((8, 0, 0, 0, 0, 0), 2)
    assert device.state.link is DeviceLink.LIVE


def test_rezero_takes_only_what_was_reported_since_it_was_opened():
    device = Device(options=SpaceMouseOptions(dead_zone=0.0)).live()
    device.motion((5, 5, 5, 5, 5, 5))
    device.core.on_opened(device.now_s, device.model)
    device.report(encode_translation(0, 0, 0), 0.008)
    device.wait(1.0)
    device.core.rezero(device.now_s)
    assert device.live().state.axes == NEUTRAL


def test_rezero_refuses_a_hand(device):
    with pytest.raises(CommandError, match="has not reported"):
        device.core.rezero(device.now_s)
    device.live()
    device.motion(UP, 3)
    with pytest.raises(CommandError, match="let go of it"):
        device.core.rezero(device.now_s)
    for raw in ((0, 20, 0, 0, 0, 0), (0, 10, 0, 0, 0, 0)):
        device.motion(raw, 3)
        with pytest.raises(CommandError, match="let go of it"):
            device.core.rezero(device.now_s)


@given(st.binary(max_size=70))
def test_bad_bytes_change_nothing(data):
    device = Device().live()
    device.report(encode_buttons(1, 3))
    before = device.motion(UP)
    malformed = type(decode_input(data)).__name__ == "MalformedReport"
    device.report(data)
    if malformed:
        assert device.state is before
        assert device.core.metrics(device.now_s)["malformed_reports"] == 1
        assert any("ignored" in words for words in device.core.diagnosis(device.now_s))


counts = st.integers(-500, 500) | st.sampled_from([0, 0, 0])
triple = st.tuples(counts, counts, counts)
actions = st.one_of(
    triple.map(lambda t: encode_translation(*t)),
    triple.map(lambda t: encode_rotation(*t)),
    st.tuples(triple, triple).map(lambda p: encode_motion(*p[0], *p[1])),
    st.integers(0, 7).map(lambda mask: encode_buttons(mask, 3)),
    st.lists(st.integers(1, 40), max_size=6).map(encode_keys_down),
    st.lists(st.integers(1, 40), max_size=6).map(encode_long_press),
    st.binary(max_size=20),
    st.sampled_from(["lost", "opened", "closed", "rezero", "diagnosis"]),
)
pauses = st.sampled_from([0.0, 0.008, 0.016, 0.05, 0.11, 6.0])


@settings(max_examples=examples(300))
@given(st.lists(st.tuples(pauses, actions), max_size=60), st.sampled_from(["axis", "radial"]))
def test_invariants(steps, shape):
    core = SpaceMouseCore(SpaceMouseOptions(dead_zone_shape=shape))
    now_s = 0.0
    down = set()
    core.on_opened(now_s)
    for pause_s, action in steps:
        now_s += pause_s
        core.state(now_s)
        if action == "lost":
            core.on_lost("unplugged", now_s)
        elif action == "opened":
            core.on_opened(now_s)
        elif action == "closed":
            core.on_closed(now_s)
        elif action == "rezero":
            with contextlib.suppress(CommandError):
                core.rezero(now_s)
        elif action == "diagnosis":
            assert all(isinstance(words, str) and words for words in core.diagnosis(now_s))
        else:
            core.on_report(action, now_s)
        state = core.state(now_s)
        assert all(-1.0 <= u <= 1.0 for u in state.axes)
        assert (state.reason == "") == (state.link is DeviceLink.LIVE)
        if state.link is not DeviceLink.LIVE:
            assert state.axes == NEUTRAL
        if state.link in (DeviceLink.LOST, DeviceLink.CLOSED, DeviceLink.STALE):
            assert state.link is DeviceLink.STALE or not state.buttons
        if any(state.axes):
            metrics = core.metrics(now_s)
            assert min(metrics["translation_age_s"], metrics["rotation_age_s"]) <= STALE_AFTER_S
            assert core.state(now_s + STALE_AFTER_S + 0.001).link is DeviceLink.STALE
        for event in core.events():
            assert (event.button in down) is not event.pressed
            (down.add if event.pressed else down.discard)(event.button)
        assert core.state(now_s).buttons == down


# -- against PySpaceMouse ----------------------------------------------------------------------


def _shared_specs():
    for spec in pyspacemouse.get_device_specs().values():
        model = find_model(spec.vendor_id, spec.product_id)
        if model is not None:
            yield pytest.param(spec, model, id=model.key)


@pytest.mark.judged(device="SpaceMouse", transport="HID reports", by="PySpaceMouse")
@pytest.mark.parametrize(("spec", "model"), list(_shared_specs()))
@settings(max_examples=15)
@given(raw=st.tuples(*[st.integers(-350, 350)] * 6))
def test_axes_agree_with_pyspacemouse(spec, model, raw):
    """Compared in its ROS convention, which is our robot frame."""
    other = SpaceMouseDevice(apply_axis_convention(spec, AxisConvention.ROS))
    device = Device(model.key, SpaceMouseOptions(dead_zone=0.0)).live()
    if model.family is Family.SPLIT:
        reports = [encode_translation(*raw[:3]), encode_rotation(*raw[3:])]
    else:
        reports = [encode_motion(*raw)]
    for report in reports:
        other._process(report)
        device.report(report, 0.008)
    theirs = [getattr(other._state, axis) for axis in ("x", "y", "z", "roll", "pitch", "yaw")]
    assert device.state.axes == pytest.approx(theirs, abs=1e-12)
    assert device.state.axes == to_robot_axes(raw, 350)


def test_options_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        PLAIN.dead_zone = 0.5
