"""Commands to a haptic device in each cycle, in virtual time."""

import itertools
import math

import pytest

from cardan.common.haptics import HapticState, OperatingState, Plane, WorldMap
from cardan.errors import CommandError
from cardan.gateway.force.conditioning import Conditioner, Conditioning
from cardan.gateway.force.figures import ContactFigures, HapticFigures
from cardan.gateway.force.fixtures import FixtureSet, matrix_of
from cardan.gateway.force.input import ForceInput
from cardan.gateway.force.rendering import ForceRenderer
from cardan.gateway.force.sources import MeasuredSource, SensorSource
from cardan.gateway.force.stability import fixture_warning, loop_warning, stable_stiffness_n_m
from cardan.gateway.force.tables import PlaneTable, SphereTable
from cardan.gateway.session.snapshot import Snapshot
from cardan.spatial import from_euler_zyx, subtract
from cardan.types import IDENTITY, DeviceLink, DeviceState, Pose, RobotLink, Vector3
from tests.gateway.force.fakes import PERIOD_S, REST, FakeHaptic, FakeSensor, robot_state

SPHERE = SphereTable(center_m=(0.3, 0.0, 0.4), radius_m=0.1, stiffness_n_m=100.0)
HAND = Pose(Vector3(0.0, 0.0, 0.05), IDENTITY)
SHIFTED = WorldMap(offset=Vector3(0.5, 0.0, 0.3))
QUIET = Conditioning(scale=0.1, deadband_n=0.0, tare=False)


class Bench:
    """A renderer, its device, and virtual time that advances by one cycle of the robot."""

    def __init__(
        self,
        fixtures=(),
        source=None,
        conditioning=QUIET,
        rendering=True,
        shaped=False,
        **options,
    ):
        self.device = FakeHaptic()
        conditioner = Conditioner(conditioning, shaped=shaped)
        self.renderer = ForceRenderer(
            self.device,
            FixtureSet(fixtures),
            None if source is None else ForceInput(source, conditioner, **options),
            rendering=rendering,
        )
        self.renderer.start(lambda state: state.pose)
        self.now_s = 1.0

    def cycle(self, world=SHIFTED, count=1, hand=HAND, at_rest=True, **fields):
        for _ in range(count):
            self.now_s += PERIOD_S
            state = robot_state(self.now_s, **fields)
            looked = DeviceState(self.now_s, DeviceLink.LIVE, REST, frozenset(), hand)
            self.renderer.cycle(state, looked, world, at_rest)
        return self.device.commands[-1]


def test_fixtures_go_as_geometry_with_the_map_and_the_robots_stamp():
    bench = Bench([SPHERE])
    command = bench.cycle()
    assert command.engaged
    assert command.world is SHIFTED
    assert command.stamp_s == bench.now_s
    assert [each.stiffness_n_m for each in command.fixtures] == [100.0]
    assert command.measured is None
    bench.cycle(count=3)
    assert [each.sequence for each in bench.device.commands] == [1, 2, 3, 4]
    assert bench.device.commands[-1].fixtures is command.fixtures


def test_clutched_out_nothing_is_felt_and_nothing_was_enabled_before():
    bench = Bench([SPHERE])
    assert not bench.cycle(world=None, count=50).engaged
    assert bench.device.calls == []
    assert bench.cycle().engaged
    assert bench.device.calls == ["enable"]
    assert not bench.cycle(world=None).engaged
    bench.cycle()
    assert bench.device.calls == ["enable"]  # already enabled


def test_a_latched_fault_takes_a_new_clutch_in():
    bench = Bench([SPHERE])
    bench.cycle()
    bench.device.haptic_state = HapticState(state=OperatingState.FAULT, reason="let go")
    bench.cycle(count=100)
    assert bench.device.calls == ["enable"]
    bench.cycle(world=None)
    bench.cycle()
    assert bench.device.calls == ["enable", "enable"]


def test_a_device_that_cannot_be_enabled_says_why():
    bench = Bench([SPHERE])
    bench.device.obstacle = "the device is not calibrated"
    bench.cycle()
    assert bench.renderer.diagnosis() == ("no force: the device is not calibrated",)
    bench.cycle(count=100)
    asked = len(bench.device.calls)
    assert asked <= 1 + 100 * PERIOD_S / 0.05 + 1, "not in every cycle"
    bench.device.obstacle = ""
    bench.cycle(count=20)
    assert bench.renderer.diagnosis() == ()
    assert bench.device.haptic_state.state is OperatingState.ENABLED


def test_a_fault_of_after_the_clutch_in_needs_another_one():
    bench = Bench([SPHERE])
    bench.device.obstacle = "not ready yet"
    bench.cycle()
    bench.device.obstacle = ""
    bench.device.haptic_state = bench.device.haptic_state._replace(
        state=OperatingState.FAULT, faults=1
    )
    bench.cycle(count=100)
    assert bench.device.haptic_state.state is OperatingState.FAULT
    bench.cycle(world=None)
    bench.cycle()
    assert bench.device.haptic_state.state is OperatingState.ENABLED


def test_a_command_that_was_not_taken_is_reported_until_one_is(monkeypatch):
    bench = Bench([SPHERE])
    bench.cycle()
    take = bench.device.render

    def refuse(command):
        raise CommandError("the map is no map")

    monkeypatch.setattr(bench.device, "render", refuse)
    bench.cycle()
    assert bench.renderer.diagnosis() == ("the haptic device takes no command: the map is no map",)
    monkeypatch.setattr(bench.device, "render", take)
    bench.cycle()
    assert bench.renderer.diagnosis() == ()


def test_a_map_that_jumps_is_rendered_without_the_jump():
    bench = Bench([SPHERE])
    bench.cycle(count=10)
    jumped = SHIFTED._replace(offset=Vector3(0.48, 0.0, 0.3))
    assert bench.cycle(world=jumped).world.offset == pytest.approx(SHIFTED.offset)
    assert bench.cycle(world=jumped, count=25).world.offset.x == pytest.approx(0.499)
    bench.cycle(world=None)
    assert bench.cycle(world=jumped).world is jumped


def test_one_stamp_of_the_future_does_not_keep_a_force_for_ever():
    sensor = FakeSensor()
    bench = Bench(source=SensorSource(sensor))
    for k in range(200):
        sensor.measure(bench.now_s + (50.0 if k == 150 else 0.0), 0.0, 0.0, 10.0)
        bench.cycle()
        assert k < 130 or bench.device.commands[-1].measured.force.z == pytest.approx(1.0)
    assert bench.renderer.diagnosis()[0] == "readings of a force refused: 1"
    for _ in range(100):
        sensor.measure(bench.now_s, 0.0, 0.0, 0.0)
        bench.cycle()
    assert bench.device.commands[-1].measured.force.z == pytest.approx(0.0, abs=1e-6)


def test_the_rate_of_a_force_is_bounded_by_the_force():
    bench = Bench(
        source=MeasuredSource(reaction=True), conditioning=Conditioning(scale=1.0, tare=False)
    )
    bench.cycle(count=200, force=(0.0, 0.0, 1.0))
    measured = bench.cycle(force=(0.0, 0.0, -3.0)).measured
    assert abs(measured.rate_n_s.z) * 0.008 <= abs(measured.force.z) + 1e-9


def test_a_hand_without_a_pose_is_not_engaged():
    bench = Bench([SPHERE])
    assert not bench.cycle(hand=None).engaged


def test_the_sequence_goes_on_where_the_device_is():
    device = FakeHaptic()
    device.haptic_state = HapticState(command_sequence=41)
    renderer = ForceRenderer(device, FixtureSet([SPHERE]))
    renderer.start(lambda state: state.pose)
    looked = DeviceState(1.0, DeviceLink.LIVE, REST, frozenset(), HAND)
    renderer.cycle(robot_state(1.0), looked, None, True)
    assert device.commands[-1].sequence == 42


def test_a_surface_at_the_start_and_one_at_clutch_in():
    surfaces = [
        PlaneTable(at=at, normal=(0.0, 0.0, 1.0), stiffness_n_m=100.0)
        for at in ("start", "clutch-in")
    ]
    bench = Bench(surfaces)
    assert bench.cycle(world=None, hold_reason="motors are off").fixtures == ()
    start = bench.cycle(world=None, place=(0.5, 0.0, 0.4)).fixtures
    assert [each.point for each in start] == [(0.5, 0.0, 0.4)]
    both = bench.cycle(place=(0.6, 0.0, 0.4)).fixtures
    assert all(isinstance(each, Plane) for each in both)
    # at the place of the stylus in the world, so that no force begins with a jump
    assert [each.point for each in both] == [(0.5, 0.0, 0.4), pytest.approx((0.5, 0.0, 0.35))]


def test_a_measured_force_is_turned_into_the_hands_axes_and_scaled():
    quarter = matrix_of(from_euler_zyx(0.0, 0.0, math.pi / 2))
    world = WorldMap(quarter, rotation=quarter)
    bench = Bench(source=MeasuredSource(reaction=True), stiffness_n_m=30.0)
    measured = bench.cycle(count=130, world=world, force=(0.0, 10.0, 5.0)).measured
    assert measured.force == pytest.approx((1.0, 0.0, 0.5))
    assert measured.rate_n_s == (0.0, 0.0, 0.0)
    assert (measured.stamp_s, measured.position) == (bench.now_s, HAND.position)
    assert measured.stiffness_n_m == 30.0
    for k in range(300):
        measured = bench.cycle(world=world, force=(0.0, 10.0 + k * PERIOD_S, 5.0)).measured
    assert measured.rate_n_s == pytest.approx((0.1, 0.0, 0.0), abs=1e-6)


def test_what_is_touched_absorbs_what_the_hand_pushes_in_until_it_is_clutched_out():
    """A device on another computer needs this energy, because its passivity law covers both
    ends."""
    bench = Bench(source=MeasuredSource(reaction=True))
    pressed = {"force": (0.0, 0.0, 10.0)}
    assert bench.cycle(count=200, **pressed).measured.absorbed_j == 0.0
    deeper = HAND._replace(position=subtract(HAND.position, Vector3(0.0, 0.0, 0.01)))
    assert bench.cycle(hand=deeper, **pressed).measured.absorbed_j == pytest.approx(0.01)
    assert bench.cycle(**pressed).measured.absorbed_j == pytest.approx(0.0)
    bench.cycle(hand=deeper, **pressed)
    bench.cycle(world=None)
    assert bench.cycle(count=200, **pressed).measured.absorbed_j == 0.0


def test_a_measured_force_is_zero_until_force_is_let_out_and_then_fades_in():
    """Clutching in while the tool presses: a device begins with a small force."""
    bench = Bench(source=MeasuredSource(reaction=True), stiffness_n_m=100.0)
    pressed = {"force": (0.0, 0.0, 20.0)}
    bench.device.lets_out = False
    for measured in (bench.cycle(**pressed).measured for _ in range(50)):
        assert measured.force == (0.0, 0.0, 0.0)
        assert (measured.rate_n_s, measured.stiffness_n_m) == ((0.0, 0.0, 0.0), 0.0)
    bench.device.lets_out = True
    forces = [bench.cycle(**pressed).measured.force.z for _ in range(150)]
    assert max(b - a for a, b in itertools.pairwise(forces)) < 0.017
    assert forces[62] == pytest.approx(1.0, abs=0.05)
    assert forces[-1] == pytest.approx(2.0)
    bench.cycle(world=None)
    assert bench.cycle(**pressed).measured.force == (0.0, 0.0, 0.0)


def test_a_robot_that_stops_reporting_gives_no_old_force():
    bench = Bench(source=MeasuredSource())
    assert bench.cycle(force=(0.0, 0.0, -10.0)).measured is not None
    assert bench.cycle().measured is None
    assert bench.renderer.diagnosis() == ("no measured force: the robot reports none",)
    lost = bench.cycle(world=None, link=RobotLink.LOST, pose=None)
    assert not lost.engaged
    assert lost.measured is None


def test_a_force_that_comes_back_grows_slowly():
    bench = Bench(source=MeasuredSource(reaction=True), stiffness_n_m=100.0)
    pushed = {"force": (0.0, 0.0, 10.0)}
    assert bench.cycle(count=130, **pushed).measured.force.z == pytest.approx(1.0)
    assert bench.cycle(count=30).measured is None
    bench.cycle(count=62, **pushed)
    half = bench.device.commands[-1].measured
    assert half.force.z == pytest.approx(0.5, abs=0.01)
    assert half.stiffness_n_m == pytest.approx(50.0, abs=1.0)
    forces = [each.measured.force.z for each in bench.device.commands[-62:]]
    assert max(b - a for a, b in itertools.pairwise(forces)) < 0.01
    assert bench.cycle(count=100, **pushed).measured.force.z == pytest.approx(1.0)


class Slow(MeasuredSource):
    """A source that repeats its last reading."""

    def read(self, state, tcp):
        self.retained = super().read(state, tcp) if state.wrench is not None else self.retained
        return self.retained


def test_a_reading_that_is_too_old_is_not_felt():
    bench = Bench(source=Slow(), max_age_s=0.1)
    bench.cycle(force=(0.0, 0.0, -10.0))
    retained = bench.cycle(count=20)
    assert retained.measured.stamp_s == pytest.approx(bench.now_s - 20 * PERIOD_S)
    assert bench.cycle(count=10).measured is None
    assert "older than 100 ms" in bench.renderer.diagnosis()[0]


def test_the_zero_is_taken_before_the_first_clutch_in():
    bench = Bench(source=MeasuredSource(), conditioning=Conditioning(scale=0.1, deadband_n=0.0))
    bias = {"force": (3.0, 0.0, -20.0)}
    assert bench.cycle(count=5, **bias).measured is None  # clutched in too soon
    assert "its zero is being taken" in bench.renderer.diagnosis()[0]
    bench.cycle(world=None, count=200, **bias)
    assert bench.renderer.diagnosis() == ()
    assert bench.cycle(count=5, **bias).measured.force == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_without_rendering_the_device_is_only_looked_at():
    bench = Bench([SPHERE], rendering=False)
    bench.device.haptic_state = HapticState(force=Vector3(0.0, 0.0, 1.5))
    bench.device.commands.append(None)
    assert bench.cycle(count=10) is None
    bench.renderer.stop()
    assert bench.device.calls == []
    snapshot = Snapshot(force=bench.renderer.report())
    assert (snapshot.force.state, snapshot.force.rendered_n) == ("disabled", 1.5)
    assert snapshot.force.measured_n == ()


def test_the_summary_has_what_was_felt_and_what_was_touched():
    bench = Bench([SPHERE], MeasuredSource(reaction=True), contact_target_n=5.0)
    bench.device.haptic_state = HapticState(
        state=OperatingState.ENABLED,
        force=Vector3(0.0, 0.0, 0.6),
        peak_n=0.7,
        gap_s=0.001,
        tick_cost_s=2e-6,
        force_age_s=0.003,
        delivered_j=-0.002,
        given_peak_j=0.003,
        energy_j=0.001,
    )
    bench.cycle(count=50, force=(0.0, 0.0, 0.0))
    for k in range(500):
        bench.cycle(force=(0.0, 0.0, 6.0), place=(0.3 + 0.05 * k * PERIOD_S, 0.0, 0.4))
    s = Snapshot(force=bench.renderer.report(), contact=bench.renderer.measured.report())
    assert s.force.state == "enabled"
    assert s.force.peak_n == pytest.approx(0.7)
    assert s.contact.path_m == pytest.approx(0.1, rel=0.02)
    assert s.contact.time_s == pytest.approx(2.0, rel=0.02)
    assert s.contact.mean_n == pytest.approx(6.0, rel=0.01)
    assert s.contact.rms_error_n == pytest.approx(1.0, rel=0.1)
    assert s.force.fixture_age_p99_s == pytest.approx(0.001, rel=0.03)
    assert s.force.measured_age_p50_s == pytest.approx(0.003, rel=0.03)
    assert (s.force.energy_given_j, s.force.energy_given_peak_j, s.force.energy_j) == (
        -0.002,
        0.003,
        0.001,
    )
    assert Snapshot.from_bytes(s.to_bytes()) == s


def test_the_stiffness_felt_is_force_over_the_depth_of_the_hand():
    bench = Bench([], MeasuredSource(reaction=True))
    bench.device.haptic_state = HapticState(state=OperatingState.ENABLED, rendering=True)
    bench.cycle(count=50, force=(0.0, 0.0, 0.0))
    assert bench.renderer.report().rendered_stiffness_n_m is None
    # Pressed down by 0 to 20 mm against 60 N/m, then lifted and moved in free air.
    for k in range(501):
        depth_m = 4e-5 * k
        bench.device.haptic_state = bench.device.haptic_state._replace(
            force=Vector3(0.0, 0.0, 60.0 * depth_m)
        )
        hand = Pose(Vector3(0.01, 0.0, 0.05 - depth_m), IDENTITY)
        bench.cycle(force=(0.0, 0.0, 6.0), hand=hand)
    bench.device.haptic_state = bench.device.haptic_state._replace(force=Vector3(0.0, 0.0, 0.5))
    bench.cycle(count=100, force=(0.0, 0.0, 0.0))
    bench.cycle(count=500, force=(0.0, 0.0, 0.0), hand=Pose(Vector3(0.01, 0.0, 0.0), IDENTITY))
    report = bench.renderer.report()
    # The contact force is low-pass filtered: the first touch is detected up to 0.1 s late.
    assert report.rendered_stiffness_n_m == pytest.approx(60.0, rel=0.1)
    assert report.rendered_depth_m == pytest.approx(0.02, abs=0.001)


def test_noise_is_no_contact_and_draws_nothing():
    figures = ContactFigures()
    for k in range(2000):
        noise = Vector3(0.3 * math.sin(7.0 * k), 0.3 * math.cos(5.0 * k), 0.3 * math.sin(3.0 * k))
        figures.add(noise, k * PERIOD_S, Vector3(0.001 * k, 0.0, 0.0))
    assert (figures.time_s, figures.path_m, figures.mean_n) == (0.0, 0.0, 0.0)
    assert figures.rms_error_n(5.0) == 0.0
    for k in range(2000, 3000):
        trembling = Vector3(0.0001 * math.sin(k), 0.0, 0.0)
        figures.add(Vector3(0.0, 0.0, 5.0), k * PERIOD_S, trembling)
    assert figures.touching
    assert figures.path_m == 0.0
    figures.lift()
    assert not figures.touching
    assert figures.rms_error_n(None) < 0.5


def test_ages_count_only_while_engaged():
    figures = HapticFigures()
    state = HapticState(gap_s=0.001, peak_n=5.0)
    figures.add(state, False, False)
    assert (figures.peak_n, figures.fixture_age.count) == (5.0, 0)
    figures.add(state, True, True)
    assert (figures.fixture_age.count, figures.measured_age.count) == (1, 0)


def test_the_rule_of_stability_has_the_numbers_of_the_literature():
    assert stable_stiffness_n_m(0.1, 0.001, 0.0) == pytest.approx(200.0)
    assert stable_stiffness_n_m(5.0, 0.02, 0.02) == pytest.approx(167.0, rel=0.01)
    assert stable_stiffness_n_m(5.0, 0.004, 0.05) == pytest.approx(96.0, rel=0.01)


def test_a_loop_that_will_not_do_is_reported_with_its_numbers():
    loop = {
        "motion_scale": 1.0,
        "environment_stiffness_n_m": 10_000.0,
        "device_damping_n_s_m": 0.5,
        "period_s": 0.004,
        "delay_s": 0.02,
        "cutoff_hz": 40.0,
    }
    assert loop_warning(force_scale=0.01, **loop) == ""
    said = loop_warning(force_scale=0.05, **loop)
    assert "the rendered stiffness is 500 N/m" in said
    assert "183 N/m are stable: set force.scale to 0.018 or less" in said
    assert fixture_warning(0, 1.0, 500.0) == ""
    assert "fixtures.2 has a rendered stiffness of 1e+03 N/m" in fixture_warning(2, 2.0, 500.0)
