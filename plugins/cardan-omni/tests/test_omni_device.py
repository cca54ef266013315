"""The driver and the simulated libHD, briefly and in real time: open, render, lose, close."""

import itertools
import math
import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from cardan import spatial
from cardan.common.haptics import HapticCommand, OperatingState, Sphere
from cardan.drivers import access
from cardan.drivers.ihaptic import IHapticDevice
from cardan.drivers.udev import udev_rules
from cardan.errors import (
    CommandError,
    DeviceAccessError,
    DeviceNotFoundError,
    DriverError,
    NotOpenError,
)
from cardan.types import (
    IDENTITY,
    ZERO3,
    DeviceFeedback,
    DeviceLink,
    Frame,
    Pose,
    Quaternion,
    Vector3,
    Wrench,
)
from cardan_omni.driver import BUTTONS, Omni, OmniOptions, device, library
from cardan_omni.driver.servo import Servo
from cardan_omni.driver.tick import Tick
from cardan_omni.peer import (
    OmniFault,
    OmniSettings,
    SimulatedOmni,
    available,
    library_path,
    load_motion,
)
from cardan_omni.protocol import Capability, Error, State
from tests.waiting import until

pytestmark = [
    pytest.mark.skipif(not available(), reason="the simulated libHD was not compiled"),
    pytest.mark.matrix,
]

PATIENCE_S = 5.0
PAGE = Path(__file__).parents[1] / "README.md"


class Bench:
    """A simulated Omni held by a hand, and devices that are closed at the end."""

    def __init__(self):
        self.sim = None
        self.devices = []

    def power(self, **settings):
        for each in self.devices:
            each.close()
        self.sim = SimulatedOmni(OmniSettings(**settings))
        self.sim.hand(ZERO3)
        return self.sim

    def device(self, **options):
        # A stall of the machine under test is no fault of the driver.
        options = {"library": str(library_path()), "stale_after_s": 0.1, **options}
        made = Omni(OmniOptions(**options))
        made.yarp = IHapticDevice(made)
        self.devices.append(made)
        return made

    def live(self, **options):
        made = self.device(**options)
        made.open()
        until(lambda: made.state().link is DeviceLink.LIVE, "it never was live")
        return made

    def enabled(self, **options):
        """Return a live, enabled device, once the loop is fast enough for force."""
        made = self.live(engage_ramp_s=0.02, **options)

        def enabled():
            try:
                made.enable()
            except CommandError as error:
                if re.search("loop runs at|rate .* is known|no tick", str(error)):
                    return False
                raise
            return True

        until(enabled, "the loop never was fast")
        return made

    def rendering(self, force=(0.15, 0.0, 0.0), **options):
        """Return a device that renders a small force, and the function that repeats the command."""
        made = self.enabled(hold_s=0.1, pause_s=0.3, **options)

        def repeat():
            made.yarp.set_feedback(Vector3(*force))
            return spatial.norm(self.sim.truth().commanded_n) > 0.1

        until(repeat, "no force ever came")
        return made, repeat


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.delenv("CARDAN_LIBHD", raising=False)
    monkeypatch.delenv("CARDAN_OMNI", raising=False)
    made = Bench()
    made.power()
    yield made
    for each in made.devices:
        each.close()


# -- opening -----------------------------------------------------------------------------------


@pytest.mark.real
@pytest.mark.judged(device="Omni", transport="HDAPI (libHD)", by="simulated peer")
def test_open_to_live_with_pose_and_identity(bench):
    bench.sim.hand((0.01, 0.02, 0.03), (0.0, 0.2, 0.0))
    omni = bench.live()

    def settled():
        truth = bench.sim.truth().position_m
        shown = omni.state().pose.position
        return math.dist(shown, truth) < 2e-4 and math.dist(truth, (0.01, 0.02, 0.03)) < 5e-3

    until(settled)
    pose = omni.state().pose
    assert spatial.norm(spatial.rotation_between(pose.orientation, IDENTITY)) > 0.1
    assert omni.identity.model == "PHANTOM Omni"
    assert omni.identity.max_force_n == pytest.approx(3.3)
    assert omni.identity.continuous_force_n == pytest.approx(0.88)
    assert omni.identity.max_stiffness_n_m == pytest.approx(500.0)
    assert omni.identity.usable_upper_m == pytest.approx((0.035, 0.08, 0.06))
    assert omni.capabilities.gives_pose
    assert omni.capabilities.gives_axes
    assert omni.capabilities.buttons == BUTTONS
    omni.open()  # A second call is harmless.
    assert omni.haptics().state is OperatingState.DISABLED


def test_a_device_by_its_name(bench):
    bench.power(device="left hand")
    bench.live(device="left hand")
    bench.power()
    with pytest.raises(DeviceNotFoundError, match="'nobody'"):
        bench.device(device="nobody").open()


@pytest.mark.parametrize(
    ("fault", "kind", "words"),
    [
        (OmniFault("comm-error"), DeviceNotFoundError, "does not answer.*internal -28"),
        (OmniFault("unplug"), DeviceNotFoundError, "plugged in"),
        (OmniFault("no-license"), DeviceAccessError, "license"),
        (OmniFault("init-fails", 0x0303), DeviceNotFoundError, "not configured"),
    ],
)
def test_what_stands_in_the_way_of_opening_is_said(bench, fault, kind, words):
    bench.power(faults=(fault,))
    omni = bench.device()
    with pytest.raises(kind, match=words):
        omni.open()
    state = omni.state()
    assert (state.link, state.pose) == (DeviceLink.CLOSED, None)


def test_a_device_that_comes_later_is_picked_up(bench):
    bench.sim.fault("comm-error")
    omni = bench.device(wait_for_device=True)
    omni.open()
    assert omni.state().link is DeviceLink.LOST
    with pytest.raises(CommandError, match="does not answer"):
        omni.enable()
    omni.render(
        HapticCommand(1, time.monotonic())
    )  # Without a device the command is not rendered, and raises nothing.
    bench.sim.fault("comm-error", 0)
    until(lambda: omni.state().link is DeviceLink.LIVE)


def test_the_device_is_never_pushed_beyond_what_it_bears(bench):
    omni = bench.live(clamp_n=3.3, slew_fall_n_s=700.0, continuous_n=1.5)
    limits = omni._tick.limits
    assert limits.clamp_n <= omni.identity.max_force_n
    assert limits.continuous_n == pytest.approx(omni.identity.continuous_force_n)
    assert limits.workspace_lower_m == pytest.approx(OmniOptions().workspace_lower_m)
    bench.power()
    lower, upper = (-0.01, -0.02, -0.03), (0.03, 0.02, 0.01)
    omni = bench.live(workspace_lower_m=lower, workspace_upper_m=upper)
    assert omni._tick.limits.workspace_upper_m == upper


def test_a_slow_loop_is_asked_to_be_fast(bench):
    bench.power(rate_hz=500)
    bench.enabled()


# -- calibration -------------------------------------------------------------------------------


def test_from_a_cold_start_through_the_inkwell_to_force(bench):
    bench.power(cold=True)
    omni = bench.device()
    omni.open()
    until(lambda: "put the stylus into the inkwell" in omni.state().reason)
    assert omni.state().link is DeviceLink.NEEDS_NEUTRAL
    with pytest.raises(CommandError, match="cannot be enabled: put the stylus into the inkwell"):
        omni.enable()
    bench.sim.hand(docked=True)
    until(lambda: "take it out" in omni.state().reason)
    omni.enable()
    bench.sim.hand(ZERO3)
    until(lambda: omni.state().link is DeviceLink.LIVE)
    assert omni.haptics().state is OperatingState.ENABLED


def test_open_waits_for_the_calibration_if_it_is_asked_to(bench):
    omni = bench.device(calibration_wait_s=5.0)
    omni.open()
    until(lambda: omni.haptics().calibration.value == "ok")
    assert omni._core.calibration.usable(time.monotonic())


def test_a_calibration_lost_while_force_is_rendered_ends_it(bench):
    omni, repeat = bench.rendering()
    bench.sim.fault("uncalibrated")

    def off():
        repeat()
        return bench.sim.truth().commanded_n == ZERO3

    until(off)
    until(lambda: not bench.sim.truth().amplifier or omni.state().pose is None)
    assert "inkwell" in until(lambda: omni.state().reason)
    bench.sim.fault("uncalibrated", 0)


# -- force -------------------------------------------------------------------------------------


@pytest.mark.real
def test_a_wrench_is_felt_while_it_is_repeated_and_no_longer(bench):
    omni = bench.enabled()
    wrench = DeviceFeedback(wrench=Wrench(Vector3(0.0, 0.15, 0.0), ZERO3, Frame.BASE))

    def felt():
        omni.feedback(wrench)
        return bench.sim.truth().commanded_n.y > 0.1

    until(felt)
    until(lambda: bench.sim.truth().commanded_n == ZERO3, "it was felt for ever")
    until(lambda: omni.haptics().stale_commands)


def test_a_wrench_along_the_stylus_is_turned(bench):
    bench.sim.hand(ZERO3, (0.0, 0.0, 0.5))
    omni = bench.enabled(hold_s=0.1, damping_n_s_m=0.0)

    def felt():
        omni.feedback(DeviceFeedback(wrench=Wrench(Vector3(0.18, 0, 0), ZERO3, Frame.TOOL)))
        return spatial.norm(omni.haptics().force_commanded) > 0.17

    until(felt)
    force, turn = omni.haptics().force_commanded, omni.state().pose.orientation
    assert force == pytest.approx(spatial.rotate(turn, Vector3(0.18, 0.0, 0.0)), abs=0.01)
    assert force.y > 0.02


def test_a_sphere_pushes_the_hand_out(bench):
    omni = bench.enabled(hold_s=0.1, pause_s=0.3)
    sphere = Sphere(Vector3(0.05, 0.0, 0.0), 0.03, 100.0)
    sequence = iter(range(1, 10**6))

    def render():
        now_s = time.monotonic()
        omni.render(HapticCommand(next(sequence), now_s, engaged=True, fixtures=(sphere,)))
        return omni.haptics().reason in ("", "limited to stay passive")

    until(render)
    bench.sim.hand((0.035, 0.0, 0.0))
    until(lambda: render() and omni.haptics().force.x < -0.3)
    with pytest.raises(CommandError, match="not finite"):
        omni.render(HapticCommand(10**7, time.monotonic(), True, force=Vector3(math.nan, 0, 0)))


def test_the_light(bench):
    omni = bench.live()
    assert "led" in omni.capabilities.feedback
    omni.feedback(DeviceFeedback(led=True))
    omni.feedback(DeviceFeedback(led=False))
    bench.power()
    omni = bench.live(status_light=False)
    assert omni.capabilities.feedback == {"wrench"}
    with pytest.raises(CommandError, match="no led"):
        omni.feedback(DeviceFeedback(led=True))


def test_the_operating_states_are_left_by_command_only(bench):
    omni = bench.live()
    with pytest.raises(CommandError):
        omni.pause()
    omni.enable()
    with pytest.raises(CommandError):
        omni.resume()
    omni.pause()
    until(lambda: omni.haptics().state is OperatingState.PAUSED)
    with pytest.raises(CommandError):
        omni.enable()
    omni.resume()
    until(lambda: omni.haptics().state is OperatingState.ENABLED)
    omni.disable()
    until(lambda: omni.haptics().state is OperatingState.DISABLED)


# -- IHapticDevice -----------------------------------------------------------------------------


def test_a_transformation_moves_positions_and_only_turns_forces(bench):
    bench.sim.hand((0.02, 0.01, 0.0))
    omni, _ = bench.rendering(damping_n_s_m=0.0)
    quarter = Quaternion(math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
    omni.yarp.set_transformation(Pose(Vector3(10.0, 20.0, 30.0), quarter))
    assert omni.yarp.get_transformation().position == (10.0, 20.0, 30.0)
    x, y, z = until(omni.state).pose.position
    assert omni.yarp.get_position() == pytest.approx((10.0 - y, 20.0 + x, 30.0 + z), abs=2e-3)
    assert omni.yarp.get_orientation().z == pytest.approx(0.5 * math.pi, abs=0.05)

    def felt():
        omni.yarp.set_feedback(Vector3(0.0, 0.15, 0.0))
        return omni.haptics().force_commanded == pytest.approx((0.15, 0.0, 0.0), abs=0.02)

    until(felt, "the force was not turned back")
    for bad in (
        Pose(Vector3(math.inf, 0.0, 0.0), IDENTITY),
        Pose(ZERO3, Quaternion(0.0, 0.0, 0.0, 0.0)),
    ):
        with pytest.raises(CommandError):
            omni.yarp.set_transformation(bad)
    assert omni.yarp.get_transformation().orientation == quarter


def test_too_much_feedback_is_shortened_and_keeps_its_direction(bench):
    omni = bench.enabled(hold_s=0.1, pause_s=0.3, clamp_n=1.0, damping_n_s_m=0.0)
    assert omni.yarp.get_max_feedback() == (1.0, 1.0, 1.0)
    sizes = []

    def felt(n):
        omni.yarp.set_feedback(Vector3(n, n, n))
        sizes.append(spatial.norm(omni.haptics().force))
        return sizes[-1]

    until(lambda: felt(0.1) > 0.15)
    until(lambda: felt(4.0) > 0.95)
    assert max(sizes) <= 1.0 + 1e-9
    assert "largest force" in omni.haptics().reason
    x, y, z = omni.haptics().force
    assert x == pytest.approx(y, rel=0.2)
    assert x == pytest.approx(z, rel=0.2)


def test_joint_torques_instead_of_forces(bench):
    omni = bench.live(engage_ramp_s=0.02, hold_s=0.1, force_mode="joint")
    assert not omni.yarp.is_cartesian_force_mode_enabled()
    assert omni.yarp.get_max_feedback() == (0.35, 0.35, 0.35)
    omni.enable()

    def felt():
        omni.yarp.set_feedback(Vector3(0.015, 0.0, 0.0))
        return spatial.norm(bench.sim.truth().commanded_n) > 0.02

    until(felt)
    omni.yarp.set_cartesian_force_mode()
    assert omni.yarp.is_cartesian_force_mode_enabled()
    until(lambda: bench.sim.truth().commanded_n == ZERO3)
    omni.yarp.stop_feedback()
    omni.yarp.set_joint_torque_mode()
    assert not omni.yarp.is_cartesian_force_mode_enabled()


@pytest.mark.parametrize(
    ("drive_by", "used", "other"),
    [
        ("force", State.CURRENT_FORCE, State.CURRENT_JOINT_TORQUE),
        ("joint_torques", State.CURRENT_JOINT_TORQUE, State.CURRENT_FORCE),
    ],
)
def test_the_loop_hands_over_forces_or_joint_torques(bench, drive_by, used, other):
    omni, repeat = bench.rendering((0.15, 0.05, -0.05), drive_by=drive_by, damping_n_s_m=0.0)

    def handed(what):
        repeat()
        return any(omni._hd.doubles(omni._handle, what, 3))  # Value in the newest frame.

    def felt():
        repeat()
        return bench.sim.truth().commanded_n == pytest.approx((0.15, 0.05, -0.05), abs=5e-3)

    until(lambda: handed(used))
    assert not any(handed(other) for _ in range(50))
    until(felt, "the same force either way")


def test_how_the_loop_drives_is_one_of_two():
    with pytest.raises(ValueError, match=r"drive_by: 'torque' is not allowed.*joint_torques"):
        OmniOptions(drive_by="torque")


def test_buttons_by_event_and_by_level(bench):
    omni = bench.live()
    bench.sim.hand(ZERO3, buttons=2)
    until(lambda: omni.yarp.get_buttons() == (False, True))
    bench.sim.hand(ZERO3, buttons=1)
    until(lambda: omni.yarp.get_buttons() == (True, False))
    bench.sim.hand(ZERO3)
    until(lambda: omni.yarp.get_buttons() == (False, False))
    events = [(event.button, event.pressed) for event in omni.button_events()]
    assert events[0] == ("button_2", True)
    assert sorted(events) == [(b, p) for b in BUTTONS for p in (False, True)]


def test_no_position_is_better_than_an_old_one(bench):
    bench.power(cold=True)
    omni = bench.device(wait_for_device=True)
    omni.open()
    until(lambda: "put the stylus" in omni.state().reason)
    with pytest.raises(DriverError, match="put the stylus into the inkwell"):
        omni.yarp.get_position()
    bench.power()
    omni = bench.live()
    omni.yarp.get_position()
    bench.sim.fault("comm-error")
    until(lambda: omni.state().link is DeviceLink.LOST)
    with pytest.raises(DriverError, match="does not answer"):
        omni.yarp.get_orientation()


def test_nothing_can_be_asked_of_what_is_not_open(bench):
    omni = bench.device()
    calls = [
        lambda: omni.render(HapticCommand(1, 0.0)),
        lambda: omni.yarp.set_feedback(ZERO3),
        omni.yarp.stop_feedback,
        omni.enable,
        omni.disable,
        omni.pause,
        omni.resume,
        omni.yarp.get_position,
        omni.details,
    ]
    for call in calls:
        with pytest.raises(NotOpenError):
            call()
    assert omni.haptics().state is OperatingState.DISABLED
    assert omni.haptics().reason == "not opened"
    omni.feedback(DeviceFeedback(wrench=Wrench(ZERO3, ZERO3, Frame.BASE)))
    assert omni.yarp.get_buttons() == (False, False)


def test_details_have_the_encoders_the_torques_and_the_newest_error(bench):
    bench.sim.hand((0.02, 0.03, 0.01), (0.1, 0.2, 0.3))
    omni, repeat = bench.rendering()
    details = omni.details()
    assert len(details.encoders) == 6
    assert any(details.encoders[:3])
    assert any(details.encoders[3:])
    until(lambda: repeat() and any(omni.details().torques_n_m))
    assert (details.error, details.errors) == (0, 0)
    bench.sim.fault("warm-motors")

    def warm():
        repeat()
        return omni.details().error == Error.WARM_MOTORS

    until(warm)
    assert omni.details().force_errors >= 1
    bench.sim.fault("warm-motors", 0)


def test_three_threads_that_command_at_once_keep_within_the_limits(bench):
    """Commands of several threads are rendered in turn, with ramps in between."""
    limits = {"clamp_n": 0.15, "slew_rise_n_s": 10.0, "slew_fall_n_s": 40.0}
    omni, _ = bench.rendering(**limits, damping_n_s_m=0.0, energy_budget_j=0.2)
    stop, failures, sequence = threading.Event(), [], itertools.count(1)
    wrench = DeviceFeedback(wrench=Wrench(Vector3(0.0, 0.0, 0.19), ZERO3, Frame.BASE))

    def render():
        now_s = time.monotonic()
        omni.render(HapticCommand(next(sequence), now_s, True, force=Vector3(0.0, 0.19, 0.0)))

    def again(call):
        try:
            while not stop.wait(0.001):
                call()
        except Exception as error:
            failures.append(error)

    calls = (
        render,
        lambda: omni.yarp.set_feedback(Vector3(0.19, 0.0, 0.0)),
        lambda: omni.feedback(wrench),
    )
    threads = [threading.Thread(target=again, args=(each,)) for each in calls]
    for thread in threads:
        thread.start()
    seen = []

    def watched():
        seen.append(omni.haptics())
        assert spatial.norm(bench.sim.truth().commanded_n) <= 0.15 + 1e-9
        let_out = [each for each in seen if each.rendering and each.force != ZERO3]
        return len(let_out) > 200 and seen[-1].dropped_commands > 20

    try:
        until(watched)
    finally:
        stop.set()
        for thread in threads:
            thread.join(PATIENCE_S)
    assert failures == []
    assert 0.1 < seen[-1].peak_n <= 0.15 + 1e-9
    for before, after in itertools.pairwise(each for each in seen if each.rendering):
        step_n = math.dist(before.force, after.force)
        assert step_n <= 40.0 * (after.stamp_s - before.stamp_s) + 1e-9
    dropped = omni.haptics().dropped_commands
    omni.yarp.set_feedback(Vector3(0.19, 0.0, 0.0))
    omni.render(HapticCommand(1, time.monotonic(), True, force=Vector3(0.0, 0.19, 0.0)))
    assert omni.haptics().dropped_commands == dropped + 1


# -- trouble -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("comm-error", "does not answer"),
        ("unplug", "is not there"),
        ("dead-scheduler", "stalled|no tick"),
    ],
)
def test_a_device_that_goes_is_lost_and_comes_back_without_force(bench, fault, words):
    omni, repeat = bench.rendering()
    bench.sim.fault(fault)
    until(lambda: omni.state().link is DeviceLink.LOST)
    state = omni.state()
    assert (state.pose, state.buttons) == (None, frozenset())
    assert re.search(words, state.reason)
    assert spatial.norm(bench.sim.truth().delivered_n) == 0.0
    bench.sim.fault(fault, 0)
    if fault == "unplug":  # Without power the device has lost its position.
        until(lambda: "put the stylus into the inkwell" in omni.state().reason)
        bench.sim.hand(docked=True)
        until(lambda: "take it out" in omni.state().reason)
        bench.sim.hand(ZERO3)
    until(lambda: omni.state().link is DeviceLink.LIVE)
    repeat()
    assert omni.haptics().state is OperatingState.FAULT
    assert "device is lost" in omni.haptics().reason
    for _ in range(40):
        assert not repeat()
        time.sleep(0.005)
    omni.enable(wait_s=1.0)
    until(lambda: omni.haptics().state is OperatingState.ENABLED)


def test_a_callback_that_goes_is_lost_and_scheduled_anew(bench):
    omni, _ = bench.rendering()
    hd = omni._hd
    with hd.current(omni._handle) as raw:
        raw.hdUnschedule(omni._scheduled)  # The tick is not informed.
    until(lambda: "without an error" in omni.state().reason)
    until(lambda: omni.state().link is DeviceLink.LIVE)
    assert omni.haptics().state is OperatingState.FAULT


def test_a_slow_loop_lets_the_force_go_before_the_motors_are_off(bench):
    """Afterwards no force returns without the tick."""
    sim = bench.sim
    omni, repeat = bench.rendering((0.19, 0.0, 0.0), energy_budget_j=0.2)
    seen = []

    def delivered():
        repeat()
        truth = sim.truth()
        seen.append((truth.ticks, spatial.norm(truth.delivered_n), spatial.norm(truth.commanded_n)))
        return seen[-1][1]

    until(lambda: delivered() > 0.15)
    sim.fault("slow-ticks", 700)
    until(lambda: delivered() == 0.0 and "Hz, and force" in omni.haptics().reason)
    for _ in range(250):  # By now the motors are off.
        delivered()
        assert seen[-1][2] == 0.0, "the tick still sends a force"
        time.sleep(0.002)
    assert not omni._force_allowed
    assert not omni.haptics().rendering
    assert omni.haptics().force == ZERO3
    sim.fault("slow-ticks", 0)
    seen.clear()
    until(lambda: delivered() > 0.15)
    for before, after in itertools.pairwise(seen):
        assert after[1] - before[1] <= 0.05 * (after[0] - before[0]) + 1e-6


@pytest.mark.parametrize("round_", range(5))
def test_two_threads_may_close_at_once_and_open_meanwhile(bench, round_):
    omni = bench.live()
    failures = []

    def call(function):
        try:
            function()
        except Exception as error:
            failures.append(error)

    threads = [
        threading.Thread(target=call, args=(each,)) for each in (omni.close, omni.close, omni.open)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
        assert not thread.is_alive()
    assert failures == []
    omni.close()
    omni.open()
    until(lambda: omni.state().link is DeviceLink.LIVE)
    omni.enable(wait_s=1.0)


def test_enable_never_waits_unless_asked_to(bench):
    omni = bench.device()
    omni.open()
    began_s = time.monotonic()
    with pytest.raises(CommandError, match="not ready yet"):
        omni.enable()
    assert time.monotonic() - began_s < 0.4
    omni.enable(wait_s=2.0)
    assert omni.haptics().state is OperatingState.ENABLED


def test_disable_ends_an_enable_that_waits(bench, monkeypatch):
    omni = bench.device()
    omni.open()
    failures, waits = [], threading.Event()

    def settling(_now_s):
        waits.set()
        return True

    def enable():
        try:
            omni.enable(wait_s=PATIENCE_S)
        except CommandError as error:
            failures.append(str(error))

    waiting = threading.Thread(target=enable)
    with monkeypatch.context() as never_ready:
        never_ready.setattr(omni._core, "force_obstacle", lambda _now_s: "it settles")
        never_ready.setattr(omni._core, "settling", settling)
        waiting.start()
        assert waits.wait(PATIENCE_S)
        omni.disable()
        waiting.join(PATIENCE_S)
    assert not waiting.is_alive()
    assert failures == ["the force is not enabled: it was disabled meanwhile"]
    assert omni.haptics().state is OperatingState.DISABLED
    omni.enable(wait_s=2.0)
    assert omni.haptics().state is OperatingState.ENABLED


@pytest.mark.parametrize(
    "bad", [(1, 2), None, ("a", 1, 2), (10**400, 0, 0), (math.nan, 0, 0), (1, 2, 3, 4), "abc"]
)
@pytest.mark.parametrize("mode", ["cartesian", "joint"])
def test_feedback_that_is_none_is_refused(bench, bad, mode):
    omni = bench.device(force_mode=mode)
    omni.open()
    with pytest.raises(CommandError, match="feedback"):
        omni.yarp.set_feedback(bad)


def test_a_command_of_another_clock_is_refused_and_blocks_nothing(bench):
    omni, repeat = bench.rendering()
    with pytest.raises(CommandError, match="in the future"):
        omni.render(HapticCommand(2**40, time.time() + 1e6, True))
    for _ in range(20):
        until(repeat)  # On a machine that stalls the force is absent for a moment.
    assert omni.haptics().dropped_commands == 0


def is_unknown(reading):
    try:
        reading()
    except DriverError:
        return True
    return False


def test_a_wrench_along_a_stylus_that_nobody_sees_is_none(bench):
    omni, _ = bench.rendering()
    bench.sim.fault("dead-scheduler")
    until(lambda: is_unknown(omni.yarp.get_position))
    sequence = omni._sequence
    omni.feedback(DeviceFeedback(wrench=Wrench(Vector3(0.1, 0, 0), ZERO3, Frame.TOOL)))
    assert omni._sequence == sequence
    bench.sim.fault("dead-scheduler", 0)


def test_a_force_lasts_one_frame_whatever_becomes_of_the_program(bench):
    """After kill -9 no program sets the next frame's force, so there is none."""
    sim = bench.power(virtual=True)
    hd = library.load(str(library_path()))
    handle = hd.init_device("")
    tick = Tick(OmniOptions(engage_ramp_s=0.02).limits())
    servo = Servo(tick, hd.functions, handle, clock=sim.address("simNow"), realtime=False)
    hd.enable(handle, Capability.FORCE_OUTPUT, True)
    scheduled = hd.schedule(servo.callback, servo.user, handle)
    tick.enable()
    for sequence in range(1, 300):
        command = HapticCommand(sequence, sim.now_s, True, force=Vector3(0.15, 0.0, 0.0))
        tick.command(command)
        sim.step(10)
        if spatial.norm(sim.truth().delivered_n) > 0.1:
            break
    assert spatial.norm(sim.truth().delivered_n) > 0.1
    with hd.current(handle) as raw:
        raw.hdUnschedule(scheduled)
    sim.step(1)
    assert sim.truth().delivered_n == ZERO3
    hd.unschedule(scheduled, handle)
    hd.disable_device(handle)
    servo.close()
    tick.close()


def test_warm_motors_are_reported(bench):
    omni, repeat = bench.rendering()
    bench.sim.fault("warm-motors")
    until(lambda: repeat() or omni.haptics().force == ZERO3)
    until(lambda: repeat() or any("warm" in words for words in omni.diagnosis()))
    bench.sim.fault("warm-motors", 0)


def test_numbers_of_another_locale_are_reported_also_after_a_failure(bench, monkeypatch):
    omni = bench.live()
    assert not any("LC_NUMERIC" in words for words in omni.diagnosis())
    omni.close()
    monkeypatch.setattr(library.locale, "localeconv", lambda: {"decimal_point": ","})
    omni.open()
    assert any('LC_NUMERIC must be C, with "."' in words for words in omni.diagnosis())
    for fault, kind in (("no-license", DeviceAccessError), ("unplug", DeviceNotFoundError)):
        bench.power(faults=(OmniFault(fault),))
        omni = bench.device()
        with pytest.raises(kind):
            omni.open()
        assert sum("LC_NUMERIC" in words for words in omni.diagnosis()) == 1


# -- closing -----------------------------------------------------------------------------------


@pytest.mark.real
def test_close_takes_the_force_down_and_opens_again(bench):
    omni, _ = bench.rendering()
    omni.close()
    assert bench.sim.truth().commanded_n == ZERO3
    assert omni.state().link is DeviceLink.CLOSED
    assert omni.haptics().reason == "closed"
    omni.close()
    omni.open()
    until(lambda: omni.state().link is DeviceLink.LIVE)
    assert omni.haptics().state is OperatingState.DISABLED


FORGETFUL = """
import sys, time
from cardan.drivers.ihaptic import IHapticDevice
from cardan_omni.driver import Omni, OmniOptions
from cardan.errors import CommandError
omni = Omni(OmniOptions(engage_ramp_s=0.02, stale_after_s=0.1))
omni.open()
while omni.state().link.value != "live":
    time.sleep(0.002)
while omni.haptics().state.value != "enabled":
    try:
        omni.enable(wait_s=2.0)
    except CommandError:  # A busy machine: the loop is too slow for force.
        time.sleep(0.01)
yarp = IHapticDevice(omni)
until_s = time.monotonic() + 5.0
while omni.haptics().force.x < 0.1:
    assert time.monotonic() < until_s
    yarp.set_feedback((0.15, 0.0, 0.0))
    time.sleep(0.002)
{end}
"""


@pytest.mark.parametrize("end", ["", "sys.exit(3)", "raise KeyboardInterrupt"])
def test_a_program_that_forgets_to_close_leaves_no_force(tmp_path, end):
    log = tmp_path / "log.csv"
    settings = tmp_path / "omni.txt"
    settings.write_text(OmniSettings(log=str(log)).text, encoding="utf-8")
    environment = {**os.environ, "CARDAN_OMNI": str(settings), "CARDAN_LIBHD": str(library_path())}
    done = subprocess.run(
        [sys.executable, "-c", FORGETFUL.format(end=end)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert done.returncode in (0, 3, 1, -2, 130), done.stderr
    assert ("Error" in done.stderr) is False, done.stderr
    head, *rows = log.read_text(encoding="utf-8").splitlines()
    columns = [i for i, name in enumerate(head.split(",")) if "commanded" in name]
    assert len(columns) == 3
    forces = [math.hypot(*(float(row.split(",")[i]) for i in columns)) for row in rows]
    assert max(forces) > 0.1
    assert forces[-1] == 0.0


# -- discovery ---------------------------------------------------------------------------------


def usb(folder, name, vendor, product):
    (folder / name).mkdir(parents=True)
    (folder / name / "idVendor").write_text(f"{vendor}\n")
    (folder / name / "idProduct").write_text(f"{product}\n")


def test_find_tells_of_plugged_devices_and_of_the_library(tmp_path, monkeypatch):
    monkeypatch.setattr(access, "USB_DEVICES", tmp_path)
    monkeypatch.setattr(library, "NAMES", ("libHD-nowhere.so",))
    monkeypatch.delenv("CARDAN_LIBHD", raising=False)
    assert Omni.find() == []
    usb(tmp_path, "1-1", "2988", "0302")
    usb(tmp_path, "1-2", "1234", "0302")
    (found,) = Omni.find()
    assert (found.name, found.identity, found.transport) == ("Touch (USB)", "2988:0302", "usb")
    assert "there is no libHD" in found.obstacle
    monkeypatch.setenv("CARDAN_LIBHD", str(library_path()))
    (found,) = Omni.find()
    assert found.obstacle == ""
    usb(tmp_path, "1-3", "2988", "0304")
    assert len(Omni.find()) == 2


def test_find_tells_of_a_library_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(access, "USB_DEVICES", tmp_path)
    monkeypatch.setenv("CARDAN_LIBHD", str(library_path()))
    (found,) = Omni.find()
    assert found.transport == "library"
    assert found.path == str(library_path())
    monkeypatch.setenv("CARDAN_LIBHD", "/nowhere/libHD.so")
    (found,) = Omni.find()
    assert "there is no file" in found.obstacle


def test_the_udev_rules_cover_what_find_knows():
    rules = udev_rules()
    for vendor, product in device.USB_IDS:
        assert f'ATTRS{{idVendor}}=="{vendor}", ATTRS{{idProduct}}=="{product}"' in rules


# -- the page ----------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [0, 1])
def test_the_examples_of_the_page_run(tmp_path, number):
    blocks = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    settings = tmp_path / "omni.txt"
    settings.write_text(OmniSettings(motion=load_motion("rest")).text, encoding="utf-8")
    environment = {**os.environ, "CARDAN_OMNI": str(settings), "CARDAN_LIBHD": str(library_path())}
    done = subprocess.run(
        [sys.executable, "-c", blocks[number]],
        env=environment,
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert done.stdout


def test_the_page_has_every_metric():
    page = PAGE.read_text(encoding="utf-8")
    metrics = Omni(OmniOptions()).metrics()
    assert [name for name in metrics if f"`{name}`" not in page] == []
