"""From snapshots of the tick to device states, in virtual time with the compiled tick."""

import math

import pytest

from cardan import spatial
from cardan.common.haptics import Calibration, HapticCommand, HapticState, OperatingState
from cardan.types import NEVER_S, ZERO3, DeviceLink, Pose, Quaternion, Vector3
from cardan_omni.driver.core import BUTTONS, OmniCore
from cardan_omni.driver.options import OmniOptions
from omni_bench import LOOK_S, TOUCH, Bench

NEUTRAL = (0.0,) * 6


def edges(bench):
    return [(event.button, event.pressed) for event in bench.core.events()]


# -- the link ----------------------------------------------------------------------------------


def test_it_is_live_once_it_ticks_and_is_calibrated():
    bench = Bench()
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    bench.live()
    state = bench.state
    assert state.pose == Pose(Vector3(0.0, 0.0, 0.0), Quaternion(1.0, 0.0, 0.0, 0.0))
    assert (state.axes, state.buttons, state.reason) == (NEUTRAL, frozenset(), "")
    assert state.stamp_s == pytest.approx(bench.now_s, abs=LOOK_S)


def test_without_a_first_tick_it_is_stale():
    bench = Bench()
    bench.ticking = False
    bench.run(0.1)
    assert bench.state.link is DeviceLink.STALE
    assert bench.state.stamp_s == NEVER_S
    assert not bench.core.heard


def test_ticks_that_stop_take_the_pose_away_within_20_ms():
    bench = Bench().live()
    bench.ticking = False
    while bench.state.pose is not None:
        bench.run(0.001)
        assert bench.now_s - bench.state.stamp_s < 0.03
    assert bench.state.link is DeviceLink.STALE
    assert "20 ms" in bench.state.reason
    assert bench.core.metrics(bench.now_s)["silences"] == 1


def test_how_long_silence_may_last_is_an_option():
    bench = Bench(OmniOptions(stale_after_s=0.06)).live()
    bench.ticking = False
    bench.run(0.05)
    assert bench.state.link is DeviceLink.LIVE
    bench.run(0.02)
    assert bench.state.link is DeviceLink.STALE


def test_a_cold_device_wants_the_inkwell_first_and_then_to_be_taken_out():
    bench = Bench()
    bench.answer = Calibration.NEEDS_MANUAL_INPUT
    bench.run(0.3)
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    assert "inkwell" in bench.state.reason
    assert bench.core.snapshot.calibration is Calibration.NEEDS_MANUAL_INPUT
    assert "inkwell" in bench.core.force_obstacle(bench.now_s)
    bench.inkwell, bench.answer = True, Calibration.NEEDS_UPDATE
    bench.run(LOOK_S)
    assert bench.updates == 1
    bench.answer = Calibration.OK
    bench.run(0.3)
    assert bench.core.force_obstacle(bench.now_s) == ""
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    assert "take it out" in bench.state.reason
    bench.inkwell = False
    bench.run(0.05)
    assert bench.state.link is DeviceLink.LIVE


def test_a_broken_inkwell_switch_can_be_left_out():
    bench = Bench(OmniOptions(inkwell_switch=False))
    bench.inkwell = True
    bench.live()


def test_a_lost_calibration_takes_pose_and_force_until_it_has_settled():
    bench = Bench().live()
    bench.answer = Calibration.NEEDS_MANUAL_INPUT
    bench.run(LOOK_S)
    assert bench.state.pose is None
    assert bench.core.force_obstacle(bench.now_s)
    bench.answer = Calibration.OK
    bench.run(0.05)
    assert bench.state.pose is None
    bench.run(0.1)
    assert bench.state.link is DeviceLink.LIVE
    assert any("calibration was lost" in words for words in bench.core.diagnosis(bench.now_s))


@pytest.mark.parametrize("position", [None, math.nan, math.inf])
def test_no_position_is_no_pose(position):
    bench = Bench().live()
    good = bench.tick.snapshot()
    pose = None if position is None else Pose(Vector3(0.0, position, 0.0), good.pose.orientation)
    bench.core.on_snapshot(good._replace(pose=pose), bench.now_s)
    assert bench.state.pose is None
    assert bench.state.link is DeviceLink.STALE
    bench.run(0.05)
    assert bench.state.link is DeviceLink.LIVE


def test_lost_and_closed_are_reported_and_ticks_change_nothing_then():
    bench = Bench().live()
    bench.core.on_lost("unplugged", bench.now_s)
    bench.run(0.1)
    assert (bench.state.link, bench.state.reason) == (DeviceLink.LOST, "unplugged")
    assert bench.core.diagnosis(bench.now_s) == ["unplugged"]
    bench.core.on_closed(bench.now_s)
    bench.run(0.1)
    assert (bench.state.link, bench.state.pose) == (DeviceLink.CLOSED, None)


def test_a_snapshot_of_before_the_opening_is_not_of_this_device():
    bench = Bench().live()
    old = bench.tick.snapshot()
    bench.now_s += 1.0
    bench.core.on_opened(TOUCH, bench.now_s)
    bench.core.on_snapshot(old, bench.now_s)
    assert not bench.core.heard
    assert bench.state.pose is None


# -- buttons -----------------------------------------------------------------------------------


def test_a_click_between_two_looks_is_two_edges():
    bench = Bench().live()
    bench.click(1)
    bench.run(0.02)
    assert edges(bench) == [("button_1", True), ("button_1", False)]
    assert bench.state.buttons == frozenset()


def test_every_click_is_there_however_seldom_anybody_looks():
    bench = Bench(OmniOptions(stale_after_s=0.1)).live()
    look, bench.look = bench.look, lambda: None
    bench.click(2, 5)
    bench.buttons = 2
    bench.run(0.03)
    bench.look = look
    bench.run(0.02)
    assert edges(bench) == [("button_2", True), ("button_2", False)] * 5 + [("button_2", True)]
    assert bench.state.buttons == {"button_2"}


def test_both_buttons_have_their_names_by_bit():
    bench = Bench().live()
    bench.buttons = 3
    bench.run(0.03)
    assert bench.state.buttons == set(BUTTONS)
    bench.buttons = 2
    bench.run(0.03)
    assert bench.state.buttons == {"button_2"}


def test_a_button_held_through_trouble_is_up_until_it_was_let_go():
    bench = Bench().live()
    bench.buttons = 1
    bench.run(0.03)
    bench.ticking = False
    bench.run(0.05)
    assert bench.state.buttons == frozenset()
    assert edges(bench) == [("button_1", True), ("button_1", False)]
    bench.ticking = True
    bench.run(0.3)
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    assert "let go of the buttons" in bench.state.reason
    bench.buttons = 0
    bench.run(0.03)
    assert bench.state.link is DeviceLink.LIVE
    assert edges(bench) == []
    bench.buttons = 1
    bench.run(0.03)
    assert edges(bench) == [("button_1", True)]


@pytest.mark.parametrize("gap_s", [0.05, 0.15, 0.5])
def test_a_gap_that_nobody_saw_is_a_loss_all_the_same(gap_s):
    """The whole process was stopped: no tick and no reading during the gap."""
    bench = Bench().live()
    bench.buttons = 1
    bench.run(0.05)
    assert bench.state.buttons == {"button_1"}
    bench.core.events()
    bench.now_s += gap_s
    bench.run(0.01)
    assert bench.state.link is DeviceLink.STALE
    assert (bench.state.pose, bench.state.buttons) == (None, frozenset())
    assert "no tick of the force loop" in bench.state.reason
    bench.run(0.2)
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    bench.buttons = 0
    bench.run(0.05)
    assert bench.state.link is DeviceLink.LIVE
    assert edges(bench) == [("button_1", False)]
    assert bench.core.metrics(bench.now_s)["silences"] == 1


def test_a_counter_that_jumps_is_no_thousand_clicks():
    bench = Bench().live()
    snapshot = bench.tick.snapshot()
    bench.core.on_snapshot(snapshot._replace(presses=(2**32 - 1, 0)), bench.now_s)
    assert len(bench.core.events()) <= 200
    bench.core.on_snapshot(snapshot, bench.now_s)
    assert bench.core.events() == [] or not bench.core.events()[-1].pressed


# -- axes --------------------------------------------------------------------------------------


def test_axes_are_the_displacement_from_the_center_and_count_once_it_was_there():
    bench = Bench(OmniOptions(range_m=0.05, dead_zone=0.1, center_m=(0.02, 0.0, 0.03)))
    bench.position = (0.07, 0.0, 0.03)
    bench.live()
    assert bench.state.axes == NEUTRAL
    bench.position = (0.022, 0.0, 0.03)
    bench.run(0.03)
    assert bench.state.axes == NEUTRAL
    bench.position = (0.07, 0.0, 0.03)
    bench.run(0.03)
    assert bench.state.axes == pytest.approx((1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    bench.position = (0.02, -0.0275, 0.03)
    bench.run(0.03)
    assert bench.state.axes == pytest.approx((0.0, -0.5, 0.0, 0.0, 0.0, 0.0))


def test_axes_stay_within_one_far_outside():
    bench = Bench(OmniOptions(range_m=0.01)).live()
    bench.position = (0.05, 0.1, -0.08)
    bench.run(0.03)
    assert bench.state.axes == (1.0, 1.0, -1.0, 0.0, 0.0, 0.0)


def test_rotation_is_from_the_orientation_that_is_the_center():
    options = OmniOptions(rotation=True, range_deg=30.0, dead_zone=0.0, center_rpy_deg=(0, -40, 0))
    core = OmniCore(options)
    core.on_opened(TOUCH, 0.0)

    def show(rpy_deg, now_s):
        turn = spatial.from_euler_zyx(*map(math.radians, rpy_deg))
        pose = Pose(Vector3(0.0, 0.0, 0.0), turn)
        core.on_snapshot(HapticState(now_s, 1, pose=pose, calibration=Calibration.OK), now_s)
        return core.state(now_s)

    show((0, 0, 0), 0.15)
    assert show((0, -40, 0), 0.3).axes == pytest.approx(NEUTRAL, abs=1e-9)
    assert show((0, -40, 15), 0.31).axes == pytest.approx((0, 0, 0, 0, 0, 0.5))


# -- messages ----------------------------------------------------------------------------------


def checked_snapshot(bench):
    return " | ".join(bench.core.diagnosis(bench.now_s))


def test_a_loop_of_500_hz_gives_a_pose_but_never_force():
    bench = Bench()
    bench.every = 2
    for _ in range(100):
        bench.run(0.01)
        assert bench.core.force_obstacle(bench.now_s)
    assert bench.state.link is DeviceLink.LIVE
    assert "no force: the library's loop runs at 500 Hz" in checked_snapshot(bench)
    bench.every = 1
    bench.run(0.5)
    assert bench.core.force_obstacle(bench.now_s) == ""


def test_a_loop_that_gets_slow_ends_the_force_and_a_stall_does_not():
    bench = Bench().live()
    bench.ticking = False
    bench.run(0.1)
    bench.ticking = True
    bench.run(0.1)
    assert bench.core.force_obstacle(bench.now_s) == ""
    bench.every = 3
    bench.run(1.0)
    assert "runs at 33" in bench.core.force_obstacle(bench.now_s)


def test_how_slow_a_loop_may_be_is_an_option():
    bench = Bench(OmniOptions(lowest_rate_hz=800.0)).live()
    bench.core.on_snapshot(bench.tick.snapshot()._replace(rate_hz=850.0), bench.now_s)
    bench.core.on_snapshot(bench.tick.snapshot()._replace(rate_hz=850.0), bench.now_s + 0.4)
    assert bench.core.force_obstacle(bench.now_s) == ""


def test_a_device_without_motors_gives_no_force():
    bench = Bench(identity=TOUCH._replace(output_dof=0)).live()
    assert "gives 0 forces" in bench.core.force_obstacle(bench.now_s)


def test_what_deserves_attention_is_said():
    bench = Bench().live()
    assert "the force is disabled" in checked_snapshot(bench)
    bench.tick.enable()
    bench.temperature = 0.85
    bench.core.hint = "no real-time priority"
    bench.run(0.5)
    words = checked_snapshot(bench)
    assert "motors are warm (85%" in words
    assert "no real-time priority" in words
    assert "disabled" not in words
    bench.ticking = False
    bench.run(0.05)
    bench.ticking = True
    bench.run(0.2)
    assert "ticks came late" in checked_snapshot(bench)
    bench.tick.pause()
    bench.run(0.05)
    assert bench.core.diagnosis(bench.now_s)[0] == "no force: paused on request"


def test_a_fault_is_reported_with_its_reason_and_what_to_do():
    bench = Bench().live()
    bench.tick.enable()
    bench.run(0.05)
    bench.position = (math.nan, 0.0, 0.0)
    bench.run(0.02)
    assert bench.core.snapshot.state is OperatingState.FAULT
    bench.position = (0.0, 0.0, 0.0)
    bench.run(0.1)
    assert "no force until it is enabled again; fault: a number was not finite" in checked_snapshot(
        bench
    )


def test_errors_of_the_library_are_reported():
    bench = Bench().live()
    bench.core.errors, bench.core.bad_readings = 7, 3
    assert "3 times the device could not be read" in checked_snapshot(bench)
    assert "7 errors of the library" in checked_snapshot(bench)
    metrics = bench.core.metrics(bench.now_s)
    assert (metrics["library_errors"], metrics["bad_readings"]) == (7, 3)


def test_a_callback_that_nearly_fills_its_millisecond_is_reported():
    bench = Bench().live()
    snapshot = bench.tick.snapshot()
    bench.core.on_snapshot(snapshot._replace(tick_cost_s=0.8e-3), bench.now_s)
    assert "a tick of the force loop took" not in checked_snapshot(bench)
    bench.core.on_snapshot(snapshot._replace(tick_cost_s=0.85e-3), bench.now_s)
    bench.core.on_snapshot(snapshot, bench.now_s)
    bench.core.taken(bench.now_s)
    assert "a tick of the force loop took 0.85 ms, of 1 ms there is" in checked_snapshot(bench)


def test_numbers_of_another_locale_are_reported_whether_or_not_it_is_open():
    bench = Bench().live()
    bench.core.numbers_hint = "LC_NUMERIC must be C"
    assert "LC_NUMERIC must be C" in checked_snapshot(bench)
    bench.core.on_lost("no valid license", bench.now_s)
    assert bench.core.diagnosis(bench.now_s) == ["no valid license", "LC_NUMERIC must be C"]
    bench.core.on_lost("it cannot be opened; LC_NUMERIC must be C", bench.now_s)
    assert bench.core.diagnosis(bench.now_s) == ["it cannot be opened; LC_NUMERIC must be C"]


def test_metrics_are_numbers_with_units_in_their_names():
    metrics = Bench().live().core.metrics(0.3)
    assert all(isinstance(value, (int, float)) for value in metrics.values())
    for name in (
        "rate_hz",
        "longest_gap_s",
        "longest_tick_s",
        "temperature",
        "energy_j",
        "command_age_s",
        "force_age_s",
        "late_ticks",
    ):
        assert name in metrics
    assert metrics["rate_hz"] == pytest.approx(1000.0, rel=0.02)


def test_gaps_are_kept_for_each_reader_of_the_snapshot():
    bench = Bench().live()
    bench.core.taken(bench.now_s)
    snapshot = bench.tick.snapshot()
    for gap_s in (0.001, 0.016, 0.002):
        bench.core.on_snapshot(snapshot._replace(gap_s=gap_s, tick_cost_s=0.1 * gap_s), bench.now_s)
    taken = bench.core.taken(bench.now_s)
    assert (taken.gap_s, taken.tick_cost_s) == pytest.approx((0.016, 0.0016))
    bench.core.on_snapshot(snapshot._replace(gap_s=0.001), bench.now_s)
    assert bench.core.taken(bench.now_s).gap_s == 0.001
    assert bench.core.metrics(bench.now_s)["longest_gap_s"] == 0.016


# -- reports of the force ----------------------------------------------------------------------


def rendering(bench):
    """Enable the force, and render a constant one."""
    bench.tick.enable()
    for k in range(130):
        bench.tick.command(HapticCommand(k + 1, bench.now_s, True, force=Vector3(0.1, 0.0, 0.0)))
        bench.run(0.01)
    bench.look()
    snapshot = bench.core.checked_snapshot(bench.now_s)
    assert snapshot.rendering
    assert snapshot.force.x == pytest.approx(0.1, abs=1e-3)
    return bench


def test_a_snapshot_that_is_too_old_tells_no_force():
    bench = rendering(Bench().live())
    bench.ticking = False
    bench.run(0.019)
    assert bench.core.checked_snapshot(bench.now_s).force.x > 0.05
    bench.run(0.003)
    snapshot = bench.core.checked_snapshot(bench.now_s)
    assert (
        snapshot.force,
        snapshot.force_commanded,
        snapshot.rendering,
    ) == (ZERO3, ZERO3, False)
    assert "20 ms" in snapshot.reason
    assert bench.core.taken(bench.now_s).force == ZERO3
    assert bench.core.metrics(bench.now_s)["force_n"] == 0.0


def test_a_fault_keeps_its_reason_when_nothing_ticks_any_more():
    bench = rendering(Bench().live())
    bench.position = (math.nan, 0.0, 0.0)
    bench.run(0.02)
    bench.ticking = False
    bench.run(0.1)
    snapshot = bench.core.checked_snapshot(bench.now_s)
    assert snapshot.state is OperatingState.FAULT
    assert snapshot.reason == "fault: a number was not finite"


def test_a_loop_that_is_too_slow_is_reported_as_no_force():
    bench = rendering(Bench().live())
    snapshot = bench.tick.snapshot()
    for _ in range(40):
        bench.now_s += LOOK_S
        bench.core.on_snapshot(
            snapshot._replace(stamp_s=bench.now_s, rate_hz=500.0, calibration=Calibration.OK),
            bench.now_s,
        )
    snapshot = bench.core.checked_snapshot(bench.now_s)
    assert snapshot.state is OperatingState.ENABLED
    assert (snapshot.force, snapshot.rendering) == (ZERO3, False)
    assert "Hz, and force needs 1000" in snapshot.reason


def test_no_rate_is_reported_a_loop_that_stands_still():
    bench = Bench().live()
    assert bench.tick.snapshot().rate_hz == pytest.approx(1000.0, rel=0.02)
    bench.core.on_lost("unplugged", bench.now_s)
    bench.now_s += 1.0
    bench.core.on_opened(TOUCH, bench.now_s)
    bench.ticking = False
    bench.run(1.0)
    obstacle = bench.core.force_obstacle(bench.now_s)
    assert "Hz" not in obstacle
    assert "no tick" in obstacle
