"""The simulated device in virtual time: cadence, rest, buttons, LED, battery."""

from __future__ import annotations

import itertools
import math

import pyspacemouse
import pytest
from hypothesis import given, strategies as st
from pyspacemouse.device import SpaceMouseDevice

from cardan.errors import ScriptError
from cardan.protocols.connexion.devices import MODELS
from cardan.protocols.connexion.reports import (
    Battery,
    KeysDown,
    MotionReport,
    decode_input,
    to_robot_axes,
)
from cardan.protocols.hid import MalformedReport
from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse
from tests.sim_peers.spacemouse_virtual import DEFLECTED, NEUTRAL, make, motions, run


@pytest.fixture
def device() -> SimulatedSpaceMouse:
    return make()


def test_rests_in_silence(device: SimulatedSpaceMouse) -> None:
    assert run(device, 3600.0) == []
    assert device.next_due_s == math.inf


def test_split_device_alternates_halves_every_8_ms(device: SimulatedSpaceMouse) -> None:
    device.set_axes(DEFLECTED)
    reports = run(device, 0.1)
    assert [report[0] for _, report in reports] == [1, 2] * 6 + [1]
    assert all(len(report) == 7 for _, report in reports)
    times = [time_s for time_s, _ in reports]
    assert all(b - a == pytest.approx(0.008) for a, b in itertools.pairwise(times))
    # x forward is away from the user (raw -Y), yaw is counter-clockwise (raw -Rz).
    assert reports[0][1] == bytes.fromhex("01 0000 51ff 0000")
    assert reports[1][1] == bytes.fromhex("02 0000 0000 baff")


def test_one_device_sends_whole_motions_every_16_ms() -> None:
    device = make("spacemouse-wireless")
    device.set_axes(DEFLECTED)
    reports = run(device, 0.1)
    assert len(reports) == 7
    assert all(len(report) == 13 and report[0] == 1 for _, report in reports)
    assert reports[-1][0] == pytest.approx(0.096)
    assert decode_input(reports[0][1]) == MotionReport(0, -175, 0, 0, 0, -70)


@pytest.mark.parametrize(
    ("model", "per_sample"), [("spacenavigator", 2), ("spacemouse-wireless", 1)]
)
def test_three_zero_samples_then_silence(model: str, per_sample: int) -> None:
    device = make(model)
    device.set_axes(DEFLECTED)
    run(device, 0.09)
    device.set_axes(NEUTRAL)
    zeros = motions(run(device, 10.0))
    assert len(zeros) == 3 * per_sample
    assert not any(any(report[1:]) for report in zeros)
    assert device.next_due_s == math.inf


def test_release_between_halves_still_gets_three_zero_pairs(device: SimulatedSpaceMouse) -> None:
    device.set_axes(DEFLECTED)
    last = run(device, 0.081)[-1][1]
    assert last[0] == 1
    assert any(last[1:])
    device.set_axes(NEUTRAL)
    assert [report[0] for report in motions(run(device, 10.0))] == [2] + [1, 2] * 3


def test_touch_during_the_zeros_goes_on_without_a_gap(device: SimulatedSpaceMouse) -> None:
    device.set_axes(DEFLECTED)
    run(device, 0.09)
    device.set_axes(NEUTRAL)
    before = run(device, 0.12)
    device.set_axes(DEFLECTED)
    times = [time_s for time_s, _ in before + run(device, 0.2)]
    assert all(b - a == pytest.approx(0.008) for a, b in itertools.pairwise(times))


def test_first_report_after_rest_is_a_translation(device: SimulatedSpaceMouse) -> None:
    assert run(device, 0.013) == []
    device.set_axes(DEFLECTED)
    assert [report[0] for _, report in run(device, 0.04)] == [1, 2, 1, 2]


def test_jitter_only_while_deflected_and_within_range() -> None:
    device = make("spacemouse-wireless", jitter_lsb=2, seed=1)
    device.set_axes((1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    values = [decode_input(report) for report in motions(run(device, 1.0))]
    assert {value[1] for value in values} == {-350, -349, -348}
    assert {value[0] for value in values} == {-2, -1, 0, 1, 2}
    device.set_axes(NEUTRAL)
    assert not any(any(report[1:]) for report in motions(run(device, 2.0)))


def test_jitter_repeats_with_the_seed() -> None:
    def record(seed: int) -> object:
        device = make(jitter_lsb=1, seed=seed)
        device.set_axes(DEFLECTED)
        return run(device, 0.5)

    assert record(3) == record(3)
    assert record(3) != record(4)


@given(st.tuples(*[st.floats(-2.0, 2.0)] * 6))
def test_deflection_is_clamped_and_keeps_the_robot_frame(axes: tuple[float, ...]) -> None:
    device = make("spacemouse-wireless")
    device.set_axes(axes)
    reports = motions(run(device, 0.0))
    raw = decode_input(reports[0]) if reports else (0,) * 6
    for value, axis in zip(to_robot_axes(raw, 350), axes, strict=True):
        assert value == pytest.approx(min(1.0, max(-1.0, axis)), abs=0.6 / 350)


@pytest.mark.parametrize("axes", [(0.0,) * 5, (0.0,) * 5 + (math.nan,), (math.inf,) + (0.0,) * 5])
def test_axes_must_be_six_finite_numbers(axes: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="six finite numbers"):
        make().set_axes(axes)


def test_button_reports_only_on_change(device: SimulatedSpaceMouse) -> None:
    device.press("left")
    device.press("left")
    device.press("right")
    assert [report for _, report in run(device, 5.0)] == [b"\x03\x01\x00", b"\x03\x03\x00"]
    device.release("left")
    device.release("left")
    assert [report for _, report in run(device, 10.0)] == [b"\x03\x02\x00"]
    assert device.held == ("right",)


def test_pro_buttons_are_seven_bytes_of_sparse_bits() -> None:
    device = make("spacemouse-pro")
    device.press("1")
    device.press("ctrl")
    assert device.reports(0.0)[-1] == bytes.fromhex("03 00 10 00 02 00 00")


def test_enterprise_sends_bits_arrays_of_keys_and_long_presses() -> None:
    device = make("spacemouse-enterprise")
    device.press("1")
    device.press("right")
    device.press("v1")  # no bit in report 3
    reports = run(device, 5.0)
    assert [report.hex() for _, report in reports] == [
        "0300100000",
        "1c0d00" + "00" * 10,
        "0310100000",
        "1c0d000500" + "00" * 8,
        "1c0d0005006700" + "00" * 6,
        "1d0d0004008b00" + "00" * 6,
    ]
    assert reports[-1][0] == pytest.approx(1.0)
    for label in ("1", "right", "v1"):
        device.release(label)
    assert [report.hex() for _, report in run(device, 9.0)] == [
        "0310000000",
        "1c05006700" + "00" * 8,
        "1d04008b00" + "00" * 8,
        "0300000000",
        "1c6700" + "00" * 10,
        "1d8b00" + "00" * 10,
        "1c" + "00" * 12,
        "1d" + "00" * 12,
    ]


@pytest.mark.judged(device="SpaceMouse", transport="HID reports", by="PySpaceMouse")
def test_pyspacemouse_sees_the_keys_of_the_enterprise() -> None:
    """It reads report 3 only, and reports those keys as the only ones."""
    spec = pyspacemouse.get_device_specs()["SpaceMouseEnterprise"]
    other = SpaceMouseDevice(spec)
    device = make("spacemouse-enterprise")
    seen = {}
    for label in device.model.buttons.values():
        for act in (device.press, device.release):
            act(label)
            for report in device.reports(0.0):
                other._process(report)
            down = [
                name for name, on in zip(spec.button_names, other._state.buttons, strict=True) if on
            ]
            if act == device.press and down:
                seen[label] = down
            else:
                assert down == []
    theirs = {"roll-cw": "ROLL_CW", "rotate-lock": "LOCK"}
    unseen = {"enter", "delete", "11", "12", "v1", "v2", "v3", "tab", "space"}
    assert seen == {
        label: [f"BTN_{label}" if label.isdigit() else theirs.get(label, label.upper())]
        for label in set(device.model.buttons.values()) - unseen
    }


def test_enterprise_shows_six_keys_at_most() -> None:
    device = make("spacemouse-enterprise")
    for label in ("1", "2", "3", "4", "esc", "alt", "shift"):
        device.press(label)
    value = decode_input(device.reports(0.0)[-1])
    assert value == KeysDown((13, 14, 15, 16, 23, 24))
    device.release("1")
    assert decode_input(device.reports(0.1)[-1]) == KeysDown((14, 15, 16, 23, 24, 25))


def test_unknown_button_names_those_there_are() -> None:
    with pytest.raises(
        ScriptError, match=r"SpaceNavigator has no button 'fire'; it has: left, right"
    ):
        make().press("fire")


def test_led_obeys_and_bad_outputs_are_refused(device: SimulatedSpaceMouse) -> None:
    assert device.led
    device.output(b"\x04\x00", 1.5)
    assert not device.led
    assert device.led_changed_s == 1.5
    for refused in (b"", b"\x04", b"\x00\x04\x01", b"\x05\x01"):
        device.output(refused, 2.0)
    assert device.refused_outputs == 4
    assert not device.led
    device.output(b"\x04\x01", 3.0)
    assert device.led


def test_compact_switches_off_only_after_it_was_switched_on() -> None:
    device = make("spacemouse-compact")
    device.output(b"\x04\x00", 0.1)
    assert device.led
    device.output(b"\x04\x01", 0.2)
    device.output(b"\x04\x00", 0.3)
    assert not device.led
    device.unplug()
    device.replug()
    device.output(b"\x04\x00", 0.4)
    assert device.led


def test_battery_report_follows_motion_on_wireless_models_only() -> None:
    for model, expected in (("spacemouse-wireless", True), ("spacenavigator", False)):
        device = make(model)
        reports = []
        for start in range(10):
            device.set_axes(DEFLECTED)
            reports += run(device, start + 0.3)
            device.set_axes(NEUTRAL)
            reports += run(device, start + 1.0)
        found = [index for index, (_, r) in enumerate(reports) if r[0] == 0x17]
        assert bool(found) == expected
        assert len(found) < 10
        for index in found:
            assert decode_input(reports[index][1]) == Battery(85, False)
            assert not any(reports[index - 1][1][1:])


def test_unplugged_device_is_silent_and_comes_back_with_its_led_on(
    device: SimulatedSpaceMouse,
) -> None:
    device.output(b"\x04\x00", 0.0)
    device.set_axes(DEFLECTED)
    device.press("left")
    run(device, 0.1)
    device.unplug()
    device.release("left")
    assert run(device, 1.0) == []
    device.output(b"\x04\x01", 1.0)
    assert not device.led
    device.replug()
    assert device.led
    reports = run(device, 1.1)
    assert [report[0] for _, report in reports] == [1, 2] * 6
    assert reports[0][0] > 1.0


def test_silenced_device_goes_on_when_reported(device: SimulatedSpaceMouse) -> None:
    device.set_axes(DEFLECTED)
    run(device, 0.1)
    device.silence()
    assert run(device, 1.0) == []
    device.resume()
    assert len(run(device, 1.1)) >= 12


def test_skipping_leaves_the_missed_time_out_and_the_zeros_in(device: SimulatedSpaceMouse) -> None:
    device.set_axes(DEFLECTED)
    run(device, 0.1)
    device.set_axes(NEUTRAL)
    device.skip_to(7.0)
    reports = run(device, 8.0)
    assert [report[0] for _, report in reports] == [1, 2] * 3
    assert reports[0][0] >= 7.0


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.key)
def test_every_model_speaks_what_the_codec_reads(model: object) -> None:
    device = SimulatedSpaceMouse(model, jitter_lsb=1)  # type: ignore[arg-type]
    device.set_axes(DEFLECTED)
    for label in model.buttons.values():  # type: ignore[attr-defined]
        device.press(label)
    reports = run(device, 2.0)
    assert reports
    assert not [r for _, r in reports if isinstance(decode_input(r), MalformedReport)]
