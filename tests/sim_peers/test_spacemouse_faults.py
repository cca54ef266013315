"""Faults of the simulated SpaceMouse, in virtual time."""

from __future__ import annotations

import itertools

import pytest

from cardan.errors import ScriptError
from cardan.sim_peers.base import parse_faults
from cardan.sim_peers.spacemouse.faults import FAULTS
from tests.sim_peers.spacemouse_virtual import DEFLECTED, NEUTRAL, Stamped, make, motions, run


def deflected(until_s: float, model: str = "spacenavigator", **faults: float) -> Stamped:
    device = make(model, faults={name.replace("_", "-"): v for name, v in faults.items()})
    device.set_axes(DEFLECTED)
    return run(device, until_s)


def test_unplug_ends_everything_mid_motion() -> None:
    device = make(faults={"unplug": 0.5})
    device.set_axes(DEFLECTED)
    reports = run(device, 2.0)
    assert reports[-1][0] == pytest.approx(0.496)
    assert not device.plugged


def test_replug_brings_it_back_still_deflected() -> None:
    device = make(faults={"unplug": 0.5, "replug": 1.0})
    device.set_axes(DEFLECTED)
    times = [time_s for time_s, _ in run(device, 1.5)]
    gaps = [(a, b) for a, b in itertools.pairwise(times) if b - a > 0.01]
    assert gaps == [(pytest.approx(0.496), pytest.approx(1.008))]
    assert device.plugged


def test_plug_faults_act_even_when_time_moves_in_one_go() -> None:
    device = make(faults={"unplug": 0.5, "replug": 1.0})
    device.set_axes(DEFLECTED)
    assert device.reports(1.5) == [r for _, r in deflected(1.5, unplug=0.5, replug=1.0)]


def test_silence_begins_with_a_deflection_in_the_last_report() -> None:
    device = make(faults={"silence": 0.2})
    assert run(device, 1.0) == []
    device.set_axes(DEFLECTED)
    reports = run(device, 5.0)
    assert len(reports) == 1
    assert any(reports[0][1][1:])
    device.set_axes(NEUTRAL)
    device.press("left")
    assert run(device, 9.0) == []


def test_seized_device_never_sends() -> None:
    device = make(faults={"seized": 1.0})
    device.set_axes(DEFLECTED)
    device.press("left")
    assert run(device, 5.0) == []


@pytest.mark.parametrize(("model", "full"), [("spacenavigator", 7), ("spacemouse-wireless", 13)])
def test_short_reports(model: str, full: int) -> None:
    reports = motions(deflected(1.0, model, short_report=5))
    lengths = [len(report) for report in reports]
    assert all(1 <= n <= 6 for n in lengths[4::5])
    assert {n for i, n in enumerate(lengths) if i % 5 != 4} == {full}


def test_unknown_ids_come_between_and_change_nothing_else() -> None:
    plain = [r for _, r in deflected(1.0)]
    mixed = [r for _, r in deflected(1.0, unknown_id=4)]
    assert [r for r in mixed if r[0] in (1, 2)] == plain
    assert len(mixed) == len(plain) + len(plain) // 4


def test_padded_reports_are_zero_filled() -> None:
    plain, padded = deflected(0.2), deflected(0.2, padded_report=64)
    assert [r.ljust(64, b"\0") for _, r in plain] == [r for _, r in padded]


def test_lost_halves() -> None:
    ids = [r[0] for r in motions(deflected(1.0, lost_half=3))]
    assert ids[:13] == [1, 2, 1, 2, 1, 1, 2, 1, 2, 1, 1, 2, 1]


def test_duplicate_halves() -> None:
    ids = [r[0] for r in motions(deflected(1.0, duplicate_half=3))]
    assert ids[:14] == [1, 2, 1, 2, 1, 2, 2, 1, 2, 1, 2, 1, 2, 2]


def test_late_halves_come_after_the_next_translation_but_do_come() -> None:
    reports = deflected(0.2, late_half=3)
    assert [r[0] for _, r in reports][:9] == [1, 2, 1, 2, 1, 1, 2, 2, 1]
    device = make(faults={"late-half": 1})
    device.set_axes(DEFLECTED)
    run(device, 0.09)
    device.set_axes(NEUTRAL)
    assert run(device, 1.0)[-1][1] == bytes([2, 0, 0, 0, 0, 0, 0])


def test_burst_holds_everything_back_and_loses_nothing() -> None:
    plain, burst = deflected(2.0), deflected(2.0, burst=0.5)
    assert [r for _, r in burst] == [r for _, r in plain][: len(burst)]
    at_once = [time_s for time_s, _ in burst if time_s == 1.0]
    assert len(at_once) == 63
    assert not [time_s for time_s, _ in burst if 0.5 < time_s < 1.0]


def test_wrong_family() -> None:
    assert {len(r) for _, r in deflected(0.2, "spacemouse-wireless", wrong_family=1)} == {7}
    assert {len(r) for _, r in deflected(0.2, wrong_family=1)} == {13}


def test_drift_never_falls_silent() -> None:
    device = make(faults={"drift": 4})
    assert run(device, 1.001)[-2][1] == bytes([1, 4, 0, 4, 0, 4, 0])
    assert device.next_due_s < 1.01


def test_overrange_goes_beyond_the_declared_range() -> None:
    device = make(faults={"overrange": 420})
    device.set_axes((-1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert device.reports(0.0) == [b"\x01\x00\x00" + (420).to_bytes(2, "little") + b"\x00\x00"]


def test_stuck_button_stays_down_once_pressed() -> None:
    device = make(faults={"stuck-button": 0})
    device.press("right")
    device.release("right")
    device.press("left")
    device.release("left")
    device.press("right")
    masks = [report[1] for _, report in run(device, 1.0)]
    assert masks == [2, 0, 1, 3]


def test_low_battery() -> None:
    device = make("spacemouse-wireless", faults={"low-battery": 5})
    device.set_axes(DEFLECTED)
    run(device, 0.1)
    device.set_axes(NEUTRAL)
    assert run(device, 1.0)[-1][1] == bytes([0x17, 5, 0])


def test_the_same_seed_gives_the_same_faults() -> None:
    def record(seed: int) -> Stamped:
        device = make(faults={"unknown-id": 3, "short-report": 2}, seed=seed)
        device.set_axes(DEFLECTED)
        return run(device, 1.0)

    assert record(1) == record(1)
    assert record(1) != record(2)


@pytest.mark.parametrize("switch", FAULTS, ids=lambda switch: switch.name)
def test_every_fault_works_with_its_default(switch: object) -> None:
    name = switch.name  # type: ignore[attr-defined]
    model = "spacemouse-wireless" if name == "low-battery" else "spacenavigator"
    words = ["unplug=1", name] if name == "replug" else [name]
    device = make(model, faults=parse_faults(words, FAULTS))
    device.set_axes(DEFLECTED)
    run(device, 6.0)


@pytest.mark.parametrize(
    ("model", "faults", "message"),
    [
        ("spacenavigator", {"explode": 1.0}, "there is no fault 'explode'; there are: burst"),
        ("spacenavigator", {"short-report": 0.0}, "fault short-report: 0 is not in 1 to"),
        ("spacenavigator", {"stuck-button": 7.0}, "no button of bit 7; it has: 0, 1"),
        ("spacenavigator", {"low-battery": 5.0}, "SpaceNavigator has no battery"),
        ("spacemouse-wireless", {"low-battery": 101.0}, "101 is not in 0 to 100"),
        ("spacemouse-wireless", {"late-half": 3.0}, "sends whole reports, not pairs"),
        ("spacenavigator", {"replug": 3.0}, "needs the fault unplug"),
    ],
)
def test_faults_that_do_not_fit_are_refused(
    model: str, faults: dict[str, float], message: str
) -> None:
    with pytest.raises(ScriptError, match=message):
        make(model, faults=faults)
