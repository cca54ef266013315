"""From snapshots of the tick to the operator's state, in virtual time beside the compiled tick."""

import math

import pytest

from cardan import spatial
from cardan.common.haptics import Calibration, HapticCommand, HapticState, OperatingState
from cardan.types import NEVER_S, ZERO3, DeviceLink, Pose, Quaternion, Vector3
from cardan_omni.driver.core import BUTTONS, OmniCore
from cardan_omni.driver.options import OmniOptions
from omni_rig import LOOK_S, TOUCH, Rig

NEUTRAL = (0.0,) * 6


def edges(rig):
    return [(event.button, event.pressed) for event in rig.core.events()]


# -- the link ----------------------------------------------------------------------------------


def test_it_is_live_once_it_ticks_and_is_calibrated():
    rig = Rig()
    assert rig.state.link is DeviceLink.NEEDS_NEUTRAL
    rig.live()
    state = rig.state
    assert state.pose == Pose(Vector3(0.0, 0.0, 0.0), Quaternion(1.0, 0.0, 0.0, 0.0))
    assert (state.axes, state.buttons, state.reason) == (NEUTRAL, frozenset(), "")
    assert state.stamp_s == pytest.approx(rig.now_s, abs=LOOK_S)


def test_without_a_first_tick_it_is_stale():
    rig = Rig()
    rig.ticking = False
    rig.run(0.1)
    assert rig.state.link is DeviceLink.STALE
    assert rig.state.stamp_s == NEVER_S
    assert not rig.core.heard


def test_ticks_that_stop_take_the_pose_away_within_20_ms():
    rig = Rig().live()
    rig.ticking = False
    while rig.state.pose is not None:
        rig.run(0.001)
        assert rig.now_s - rig.state.stamp_s < 0.03
    assert rig.state.link is DeviceLink.STALE
    assert "20 ms" in rig.state.reason
    assert rig.core.metrics(rig.now_s)["silences"] == 1


def test_how_long_silence_may_last_is_an_option():
    rig = Rig(OmniOptions(stale_after_s=0.06)).live()
    rig.ticking = False
    rig.run(0.05)
    assert rig.state.link is DeviceLink.LIVE
    rig.run(0.02)
    assert rig.state.link is DeviceLink.STALE


def test_a_cold_device_wants_the_inkwell_first_and_then_to_be_taken_out():
    rig = Rig()
    rig.answer = Calibration.NEEDS_MANUAL_INPUT
    rig.run(0.3)
    assert rig.state.link is DeviceLink.NEEDS_NEUTRAL
    assert "inkwell" in rig.state.reason
    assert rig.core.snapshot.calibration is Calibration.NEEDS_MANUAL_INPUT
    assert "inkwell" in rig.core.force_obstacle(rig.now_s)
    rig.inkwell, rig.answer = True, Calibration.NEEDS_UPDATE
    rig.run(LOOK_S)
    assert rig.updates == 1
    rig.answer = Calibration.OK
    rig.run(0.3)
    assert rig.core.force_obstacle(rig.now_s) == ""
    assert rig.state.link is DeviceLink.NEEDS_NEUTRAL
    assert "take it out" in rig.state.reason
    rig.inkwell = False
    rig.run(0.05)
    assert rig.state.link is DeviceLink.LIVE


def test_a_broken_inkwell_switch_can_be_left_out():
    rig = Rig(OmniOptions(inkwell_switch=False))
    rig.inkwell = True
    rig.live()


def test_a_lost_calibration_takes_pose_and_force_until_it_has_settled():
    rig = Rig().live()
    rig.answer = Calibration.NEEDS_MANUAL_INPUT
    rig.run(LOOK_S)
    assert rig.state.pose is None
    assert rig.core.force_obstacle(rig.now_s)
    rig.answer = Calibration.OK
    rig.run(0.05)
    assert rig.state.pose is None
    rig.run(0.1)
    assert rig.state.link is DeviceLink.LIVE
    assert any("calibration was lost" in words for words in rig.core.diagnosis(rig.now_s))


@pytest.mark.parametrize("position", [None, math.nan, math.inf])
def test_no_position_is_no_pose(position):
    rig = Rig().live()
    good = rig.tick.snapshot()
    pose = None if position is None else Pose(Vector3(0.0, position, 0.0), good.pose.orientation)
    rig.core.on_snapshot(good._replace(pose=pose), rig.now_s)
    assert rig.state.pose is None
    assert rig.state.link is DeviceLink.STALE
    rig.run(0.05)
    assert rig.state.link is DeviceLink.LIVE


def test_lost_and_closed_are_told_and_ticks_change_nothing_then():
    rig = Rig().live()
    rig.core.on_lost("unplugged", rig.now_s)
    rig.run(0.1)
    assert (rig.state.link, rig.state.reason) == (DeviceLink.LOST, "unplugged")
    assert rig.core.diagnosis(rig.now_s) == ["unplugged"]
    rig.core.on_closed(rig.now_s)
    rig.run(0.1)
    assert (rig.state.link, rig.state.pose) == (DeviceLink.CLOSED, None)


def test_a_snapshot_of_before_the_opening_is_not_of_this_device():
    rig = Rig().live()
    old = rig.tick.snapshot()
    rig.now_s += 1.0
    rig.core.on_opened(TOUCH, rig.now_s)
    rig.core.on_snapshot(old, rig.now_s)
    assert not rig.core.heard
    assert rig.state.pose is None


# -- buttons -----------------------------------------------------------------------------------


def test_a_click_between_two_looks_is_two_edges():
    rig = Rig().live()
    rig.click(1)
    rig.run(0.02)
    assert edges(rig) == [("button_1", True), ("button_1", False)]
    assert rig.state.buttons == frozenset()


def test_every_click_is_there_however_seldom_anybody_looks():
    rig = Rig(OmniOptions(stale_after_s=0.1)).live()
    look, rig.look = rig.look, lambda: None
    rig.click(2, 5)
    rig.buttons = 2
    rig.run(0.03)
    rig.look = look
    rig.run(0.02)
    assert edges(rig) == [("button_2", True), ("button_2", False)] * 5 + [("button_2", True)]
    assert rig.state.buttons == {"button_2"}


def test_both_buttons_have_their_names_by_bit():
    rig = Rig().live()
    rig.buttons = 3
    rig.run(0.03)
    assert rig.state.buttons == set(BUTTONS)
    rig.buttons = 2
    rig.run(0.03)
    assert rig.state.buttons == {"button_2"}


def test_a_button_held_through_trouble_is_up_until_it_was_let_go():
    rig = Rig().live()
    rig.buttons = 1
    rig.run(0.03)
    rig.ticking = False
    rig.run(0.05)
    assert rig.state.buttons == frozenset()
    assert edges(rig) == [("button_1", True), ("button_1", False)]
    rig.ticking = True
    rig.run(0.3)
    assert rig.state.link is DeviceLink.NEEDS_NEUTRAL
    assert "let go of the buttons" in rig.state.reason
    rig.buttons = 0
    rig.run(0.03)
    assert rig.state.link is DeviceLink.LIVE
    assert edges(rig) == []
    rig.buttons = 1
    rig.run(0.03)
    assert edges(rig) == [("button_1", True)]


@pytest.mark.parametrize("gap_s", [0.05, 0.15, 0.5])
def test_a_gap_that_nobody_saw_is_a_loss_all_the_same(gap_s):
    """The whole process was stopped: nobody looked while nothing ticked."""
    rig = Rig().live()
    rig.buttons = 1
    rig.run(0.05)
    assert rig.state.buttons == {"button_1"}
    rig.core.events()
    rig.now_s += gap_s
    rig.run(0.01)
    assert rig.state.link is DeviceLink.STALE
    assert (rig.state.pose, rig.state.buttons) == (None, frozenset())
    assert "no tick of the force loop" in rig.state.reason
    rig.run(0.2)
    assert rig.state.link is DeviceLink.NEEDS_NEUTRAL
    rig.buttons = 0
    rig.run(0.05)
    assert rig.state.link is DeviceLink.LIVE
    assert edges(rig) == [("button_1", False)]
    assert rig.core.metrics(rig.now_s)["silences"] == 1


def test_a_counter_that_jumps_is_no_thousand_clicks():
    rig = Rig().live()
    snapshot = rig.tick.snapshot()
    rig.core.on_snapshot(snapshot._replace(presses=(2**32 - 1, 0)), rig.now_s)
    assert len(rig.core.events()) <= 200
    rig.core.on_snapshot(snapshot, rig.now_s)
    assert rig.core.events() == [] or not rig.core.events()[-1].pressed


# -- axes --------------------------------------------------------------------------------------


def test_axes_are_the_displacement_from_the_center_and_count_once_it_was_there():
    rig = Rig(OmniOptions(range_m=0.05, dead_zone=0.1, center_m=(0.02, 0.0, 0.03)))
    rig.position = (0.07, 0.0, 0.03)
    rig.live()
    assert rig.state.axes == NEUTRAL
    rig.position = (0.022, 0.0, 0.03)
    rig.run(0.03)
    assert rig.state.axes == NEUTRAL
    rig.position = (0.07, 0.0, 0.03)
    rig.run(0.03)
    assert rig.state.axes == pytest.approx((1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    rig.position = (0.02, -0.0275, 0.03)
    rig.run(0.03)
    assert rig.state.axes == pytest.approx((0.0, -0.5, 0.0, 0.0, 0.0, 0.0))


def test_axes_stay_within_one_far_outside():
    rig = Rig(OmniOptions(range_m=0.01)).live()
    rig.position = (0.05, 0.1, -0.08)
    rig.run(0.03)
    assert rig.state.axes == (1.0, 1.0, -1.0, 0.0, 0.0, 0.0)


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


# -- words -------------------------------------------------------------------------------------


def told(rig):
    return " | ".join(rig.core.diagnosis(rig.now_s))


def test_a_loop_of_500_hz_gives_a_pose_but_never_force():
    rig = Rig()
    rig.every = 2
    for _ in range(100):
        rig.run(0.01)
        assert rig.core.force_obstacle(rig.now_s)
    assert rig.state.link is DeviceLink.LIVE
    assert "no force: the library's loop runs at 500 Hz" in told(rig)
    rig.every = 1
    rig.run(0.5)
    assert rig.core.force_obstacle(rig.now_s) == ""


def test_a_loop_that_gets_slow_ends_the_force_and_a_stall_does_not():
    rig = Rig().live()
    rig.ticking = False
    rig.run(0.1)
    rig.ticking = True
    rig.run(0.1)
    assert rig.core.force_obstacle(rig.now_s) == ""
    rig.every = 3
    rig.run(1.0)
    assert "runs at 33" in rig.core.force_obstacle(rig.now_s)


def test_how_slow_a_loop_may_be_is_an_option():
    rig = Rig(OmniOptions(lowest_rate_hz=800.0)).live()
    rig.core.on_snapshot(rig.tick.snapshot()._replace(rate_hz=850.0), rig.now_s)
    rig.core.on_snapshot(rig.tick.snapshot()._replace(rate_hz=850.0), rig.now_s + 0.4)
    assert rig.core.force_obstacle(rig.now_s) == ""


def test_a_device_without_motors_gives_no_force():
    rig = Rig(identity=TOUCH._replace(output_dof=0)).live()
    assert "gives 0 forces" in rig.core.force_obstacle(rig.now_s)


def test_what_deserves_attention_is_said():
    rig = Rig().live()
    assert "the force is disabled" in told(rig)
    rig.tick.enable()
    rig.temperature = 0.85
    rig.core.hint = "no real-time priority"
    rig.run(0.5)
    words = told(rig)
    assert "motors are warm (85%" in words
    assert "no real-time priority" in words
    assert "disabled" not in words
    rig.ticking = False
    rig.run(0.05)
    rig.ticking = True
    rig.run(0.2)
    assert "ticks came late" in told(rig)
    rig.tick.pause()
    rig.run(0.05)
    assert rig.core.diagnosis(rig.now_s)[0] == "no force: paused on request"


def test_a_fault_is_told_with_its_reason_and_what_to_do():
    rig = Rig().live()
    rig.tick.enable()
    rig.run(0.05)
    rig.position = (math.nan, 0.0, 0.0)
    rig.run(0.02)
    assert rig.core.snapshot.state is OperatingState.FAULT
    rig.position = (0.0, 0.0, 0.0)
    rig.run(0.1)
    assert "no force until it is enabled again; fault: a number was not finite" in told(rig)


def test_errors_of_the_library_are_told():
    rig = Rig().live()
    rig.core.errors, rig.core.bad_readings = 7, 3
    assert "3 times the device could not be read" in told(rig)
    assert "7 errors of the library" in told(rig)
    metrics = rig.core.metrics(rig.now_s)
    assert (metrics["library_errors"], metrics["bad_readings"]) == (7, 3)


def test_a_callback_that_nearly_fills_its_millisecond_is_told():
    rig = Rig().live()
    snapshot = rig.tick.snapshot()
    rig.core.on_snapshot(snapshot._replace(tick_cost_s=0.8e-3), rig.now_s)
    assert "a tick of the force loop took" not in told(rig)
    rig.core.on_snapshot(snapshot._replace(tick_cost_s=0.85e-3), rig.now_s)
    rig.core.on_snapshot(snapshot, rig.now_s)
    rig.core.taken(rig.now_s)
    assert "a tick of the force loop took 0.85 ms, of 1 ms there is" in told(rig)


def test_numbers_of_another_locale_are_told_whether_or_not_it_is_open():
    rig = Rig().live()
    rig.core.numbers_hint = "LC_NUMERIC must be C"
    assert "LC_NUMERIC must be C" in told(rig)
    rig.core.on_lost("no valid license", rig.now_s)
    assert rig.core.diagnosis(rig.now_s) == ["no valid license", "LC_NUMERIC must be C"]
    rig.core.on_lost("it cannot be opened; LC_NUMERIC must be C", rig.now_s)
    assert rig.core.diagnosis(rig.now_s) == ["it cannot be opened; LC_NUMERIC must be C"]


def test_metrics_are_numbers_with_units_in_their_names():
    metrics = Rig().live().core.metrics(0.3)
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
    rig = Rig().live()
    rig.core.taken(rig.now_s)
    snapshot = rig.tick.snapshot()
    for gap_s in (0.001, 0.016, 0.002):
        rig.core.on_snapshot(snapshot._replace(gap_s=gap_s, tick_cost_s=0.1 * gap_s), rig.now_s)
    taken = rig.core.taken(rig.now_s)
    assert (taken.gap_s, taken.tick_cost_s) == pytest.approx((0.016, 0.0016))
    rig.core.on_snapshot(snapshot._replace(gap_s=0.001), rig.now_s)
    assert rig.core.taken(rig.now_s).gap_s == 0.001
    assert rig.core.metrics(rig.now_s)["longest_gap_s"] == 0.016


# -- reports of the force -------------------------------------------------------------------


def rendering(rig):
    """Let force out, and have a constant one rendered."""
    rig.tick.enable()
    for k in range(130):
        rig.tick.command(HapticCommand(k + 1, rig.now_s, True, force=Vector3(0.1, 0.0, 0.0)))
        rig.run(0.01)
    rig.look()
    told = rig.core.told(rig.now_s)
    assert told.rendering
    assert told.force.x == pytest.approx(0.1, abs=1e-3)
    return rig


def test_a_snapshot_that_is_too_old_tells_no_force():
    rig = rendering(Rig().live())
    rig.ticking = False
    rig.run(0.019)
    assert rig.core.told(rig.now_s).force.x > 0.05
    rig.run(0.003)
    told = rig.core.told(rig.now_s)
    assert (told.force, told.force_commanded, told.rendering) == (ZERO3, ZERO3, False)
    assert "20 ms" in told.reason
    assert rig.core.taken(rig.now_s).force == ZERO3
    assert rig.core.metrics(rig.now_s)["force_n"] == 0.0


def test_a_fault_keeps_its_reason_when_nothing_ticks_any_more():
    rig = rendering(Rig().live())
    rig.position = (math.nan, 0.0, 0.0)
    rig.run(0.02)
    rig.ticking = False
    rig.run(0.1)
    told = rig.core.told(rig.now_s)
    assert told.state is OperatingState.FAULT
    assert told.reason == "fault: a number was not finite"


def test_a_loop_that_is_too_slow_is_told_as_no_force():
    rig = rendering(Rig().live())
    snapshot = rig.tick.snapshot()
    for _ in range(40):
        rig.now_s += LOOK_S
        rig.core.on_snapshot(
            snapshot._replace(stamp_s=rig.now_s, rate_hz=500.0, calibration=Calibration.OK),
            rig.now_s,
        )
    told = rig.core.told(rig.now_s)
    assert told.state is OperatingState.ENABLED
    assert (told.force, told.rendering) == (ZERO3, False)
    assert "Hz, and force needs 1000" in told.reason


def test_no_rate_is_told_of_a_loop_that_stands_still():
    rig = Rig().live()
    assert rig.tick.snapshot().rate_hz == pytest.approx(1000.0, rel=0.02)
    rig.core.on_lost("unplugged", rig.now_s)
    rig.now_s += 1.0
    rig.core.on_opened(TOUCH, rig.now_s)
    rig.ticking = False
    rig.run(1.0)
    obstacle = rig.core.force_obstacle(rig.now_s)
    assert "Hz" not in obstacle
    assert "no tick" in obstacle
