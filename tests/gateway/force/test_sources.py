"""Sources of forces, and the processing from source to device."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.errors import DriverError
from cardan.gateway.force.conditioning import Conditioner, Conditioning, LowPass, without_band
from cardan.gateway.force.sources import (
    ContactSource,
    MeasuredSource,
    Reading,
    SensorSource,
    contact_force,
)
from cardan.gateway.force.tables import PlaneContactTable, SphereContactTable
from cardan.spatial import from_euler_zyx, norm
from cardan.types import IDENTITY, Frame, Pose, RobotLink, Vector3
from tests.gateway.force.fakes import PERIOD_S, FakeSensor, robot_state

TABLE_TOP = PlaneContactTable(
    point_m=(0.0, 0.0, 0.4),
    normal=(0.0, 0.0, 1.0),
    stiffness_n_m=1000.0,
    damping_n_s_m=5.0,
    friction=0.2,
)
NO_TARE = Conditioning(scale=1.0, deadband_n=0.0, tare=False)
HERE = Pose(Vector3(0.5, 0.0, 0.4), IDENTITY)


def test_what_the_robot_exerts_the_world_gives_back():
    state = robot_state(1.0, force=(1.0, -2.0, 3.0), frame=Frame.TOOL)
    assert MeasuredSource().read(state, None) == Reading(1.0, (-1.0, 2.0, -3.0), Frame.TOOL)
    assert MeasuredSource(reaction=True).read(state, None).force == (1.0, -2.0, 3.0)


def test_a_robot_without_a_force_says_so():
    source = MeasuredSource()
    assert source.read(robot_state(1.0), None) is None
    assert source.diagnosis() == ("no measured force: the robot reports none",)
    assert source.read(robot_state(1.0, link=RobotLink.LOST), None) is None
    assert source.diagnosis() == ()
    assert source.read(robot_state(1.0, force=(math.nan, 0.0, 0.0)), None) is None
    assert "not a number" in source.reason


def test_a_sensor_is_opened_zeroed_and_closed_with_its_source():
    sensor = FakeSensor()
    with SensorSource(sensor, zero=True) as source:
        assert source.read(robot_state(1.0), None) is None
        assert source.diagnosis() == ("no measured force: unplugged", "force sensor: it is fake")
        sensor.measure(0.998, 1.0, 2.0, 3.0)
        assert source.read(robot_state(1.0), None) == Reading(0.998, (1.0, 2.0, 3.0), Frame.TOOL)
    assert sensor.calls == ["open", "zero", "close"]


@pytest.mark.parametrize(
    ("stamp_s", "force", "words"),
    [
        (60.0, (0.0, 0.0, 50.0), "the sensor gives a time 49.9 s in the future"),
        (10.1, (0.0, 0.0, 1e30), "the sensor gives 1e+30 N; more than 1000 N is rejected"),
        (10.1, (800.0, 800.0, 0.0), "more than 1000 N"),
        (10.1, (math.inf, 0.0, 0.0), "not a number"),
    ],
)
def test_a_reading_that_cannot_be_true_is_none_and_the_one_before_stands(stamp_s, force, words):
    sensor = FakeSensor()
    source = SensorSource(sensor)
    sensor.measure(stamp_s, *force)
    assert source.read(robot_state(10.1), None) is None
    sensor.measure(10.1, 1.0, 2.0, 3.0)
    good = source.read(robot_state(10.1), None)
    assert good.force == (1.0, 2.0, 3.0)
    assert source.reason == ""
    sensor.measure(stamp_s + 0.001, *force)
    for k in range(3):
        assert source.read(robot_state(10.101 + k * PERIOD_S), None) is good
    assert words in source.reason or "s in the future" in source.reason
    assert "readings of a force refused: 2" in source.diagnosis()
    sensor.measure(10.2, 1.0, 0.0, 0.0)
    assert source.read(robot_state(10.2), None).force == (1.0, 0.0, 0.0)
    sensor.measure(stamp_s + 0.2, *force)
    sensor.sensed = sensor.sensed._replace(wrench=None, reason="unplugged")
    assert source.read(robot_state(10.2), None) is None
    assert source.reason == "unplugged"


def test_a_stamp_a_little_ahead_is_of_a_clock_that_runs_with_this_one():
    sensor = FakeSensor()
    sensor.measure(10.09, 1.0, 0.0, 0.0)
    assert SensorSource(sensor).read(robot_state(10.0), None).stamp_s == 10.09


def test_a_robot_that_reports_a_huge_force_is_not_believed():
    source = MeasuredSource(reaction=True)
    assert source.read(robot_state(1.0, force=(0.0, 0.0, 1e300)), None) is None
    assert source.diagnosis() == (
        "no measured force: the robot gives 1e+300 N; more than 1000 N is rejected",
        "readings of a force refused: 1",
    )


def test_a_sensor_that_takes_no_zero_is_closed_again(monkeypatch):
    sensor = FakeSensor()

    def refuse():
        raise DriverError("zero was not taken")

    monkeypatch.setattr(sensor, "zero", refuse)
    with pytest.raises(DriverError), SensorSource(sensor, zero=True):
        pass
    assert sensor.calls == ["open", "close"]


def test_a_computed_contact_pushes_damps_and_rubs():
    top = TABLE_TOP
    above, below = Vector3(0.5, 0.0, 0.41), Vector3(0.5, 0.0, 0.39)
    still = Vector3(0.0, 0.0, 0.0)
    assert contact_force(top, above, still) == (0.0, 0.0, 0.0)
    assert contact_force(top, below, still) == pytest.approx((0.0, 0.0, 10.0))
    assert contact_force(top, below, Vector3(0.0, 0.0, -0.2)).z == pytest.approx(11.0)
    assert contact_force(top, below, Vector3(0.0, 0.0, 5.0)) == (0.0, 0.0, 0.0)
    sliding = contact_force(top, below, Vector3(0.1, 0.0, 0.0))
    assert sliding == pytest.approx((-2.0, 0.0, 10.0))
    creeping = contact_force(top, below, Vector3(0.0025, 0.0, 0.0))
    assert creeping == pytest.approx((-1.0, 0.0, 10.0))
    ball = SphereContactTable(center_m=(0.5, 0.0, 0.3), radius_m=0.1, stiffness_n_m=100.0)
    assert contact_force(ball, below, still) == pytest.approx((0.0, 0.0, 1.0))


def test_a_contact_source_takes_its_velocity_from_the_tcp():
    source = ContactSource([TABLE_TOP])
    assert source.read(robot_state(0.0), None) is None
    for k in range(100):
        place = Vector3(0.5 + 0.1 * k * PERIOD_S, 0.0, 0.39)
        state = robot_state(1.0 + k * PERIOD_S, place)
        reading = source.read(state, state.pose)
    assert reading.force == pytest.approx((-2.0, 0.0, 10.0), rel=1e-3)
    assert reading.frame is Frame.BASE
    # a jump of the robot's pose does not count as a velocity
    jumped = robot_state(1.5, (5.0, 0.0, 0.39))
    assert source.read(jumped, jumped.pose).force == pytest.approx((0.0, 0.0, 10.0))


def feed(conditioner, force, start_s=1.0, seconds=1.0, at_rest=True, frame=Frame.BASE, tcp=HERE):
    good = []
    for k in range(round(seconds / PERIOD_S)):
        reading = Reading(start_s + k * PERIOD_S, Vector3(*force), frame)
        good.append(conditioner.add(reading, at_rest, tcp))
    return good


def test_the_bias_of_a_sensor_at_rest_is_not_felt():
    conditioner = Conditioner(Conditioning(scale=0.1, deadband_n=0.0))
    good = feed(conditioner, (5.0, -3.0, 20.0))
    assert good.index(True) == pytest.approx(0.5 / PERIOD_S, abs=2)
    assert conditioner.filtered.value == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    feed(conditioner, (5.0, -3.0, 30.0), start_s=2.0, at_rest=False)
    assert conditioner.filtered.value == pytest.approx((0.0, 0.0, 1.0))
    assert conditioner.contact == pytest.approx((0.0, 0.0, 10.0))


def test_no_tare_is_taken_of_a_robot_that_moves_or_is_touched():
    conditioner = Conditioner(Conditioning())
    assert not any(feed(conditioner, (5.0, 0.0, 0.0), at_rest=False))
    assert "its zero is being taken" in conditioner.reason
    for k in range(200):
        force = Vector3(5.0 if k % 20 else 15.0, 0.0, 0.0)
        assert not conditioner.add(Reading(3.0 + k * PERIOD_S, force, Frame.BASE), True, HERE)


@pytest.mark.parametrize("between", [{"force": (5.0, 0.0, 0.0), "at_rest": False},
                                     {"force": (25.0, 0.0, 0.0), "at_rest": True}])  # fmt: skip
def test_after_a_motion_or_a_touch_the_tare_begins_anew(between):
    conditioner = Conditioner(Conditioning())
    assert not any(feed(conditioner, (5.0, 0.0, 0.0), seconds=0.4))
    assert feed(conditioner, start_s=1.4, seconds=PERIOD_S, **between) == [False]
    good = feed(conditioner, (8.0, 0.0, 0.0), start_s=1.4 + PERIOD_S)
    assert good.index(True) == pytest.approx(0.5 / PERIOD_S, abs=2)
    assert conditioner.tare.value == pytest.approx((8.0, 0.0, 0.0))


def test_what_needs_no_tare_takes_none():
    assert all(feed(Conditioner(Conditioning(), rests_at_zero=True), (5.0, 0.0, 0.0)))
    shaped = Conditioner(Conditioning(), shaped=True)
    assert all(feed(shaped, (1.0, 0.0, 0.05)))
    assert shaped.filtered.value == pytest.approx((1.0, 0.0, 0.05))


def test_forces_along_the_tools_axes_are_turned_by_its_measured_orientation():
    tcp = Pose(Vector3(0.5, 0.0, 0.4), from_euler_zyx(math.pi, 0.0, 0.0))
    conditioner = Conditioner(NO_TARE)
    assert all(feed(conditioner, (1.0, 2.0, 3.0), frame=Frame.TOOL, tcp=tcp))
    assert conditioner.filtered.value == pytest.approx((1.0, -2.0, -3.0))
    assert not any(feed(Conditioner(NO_TARE), (1.0, 2.0, 3.0), frame=Frame.TOOL, tcp=None))


def test_the_papers_dead_band_is_per_axis():
    conditioner = Conditioner(Conditioning(scale=1.0, tare=False))
    feed(conditioner, (0.09, -0.6, 1.1))
    assert conditioner.filtered.value == pytest.approx((0.0, -0.5, 1.0))


@given(st.floats(-50, 50), st.floats(0, 5), st.floats(-1e-3, 1e-3))
def test_a_dead_band_has_no_step(value, band, little):
    assert abs(without_band(value + little, band) - without_band(value, band)) <= abs(little) + 1e-9
    assert abs(without_band(value, band)) <= abs(value)


@given(st.lists(st.tuples(*[st.floats(-1000.0, 1000.0)] * 3), min_size=1, max_size=20))
def test_going_on_with_the_rate_at_most_doubles_the_force(forces):
    conditioner = Conditioner(NO_TARE)
    for k, force in enumerate(forces):
        conditioner.add(Reading(1.0 + k * PERIOD_S, Vector3(*force), Frame.BASE), False, HERE)
        felt = norm(conditioner.filtered.value)
        assert norm(conditioner.rate) * 0.008 <= felt * (1.0 + 1e-9)


def test_the_filter_has_its_cutoff_and_tells_the_rate():
    low_pass = LowPass(40.0)
    low_pass.add(Vector3(0.0, 0.0, 0.0), 0.0)
    low_pass.add(Vector3(0.0, 0.0, 1.0), 1.0 / (2.0 * math.pi * 40.0))
    assert low_pass.value.z == pytest.approx(1.0 - math.exp(-1.0))
    ramp = LowPass(40.0)
    for k in range(500):
        ramp.add(Vector3(2.0 * k * PERIOD_S, 0.0, 0.0), k * PERIOD_S)
    assert ramp.rate.x == pytest.approx(2.0)
    before = ramp.value
    ramp.add(Vector3(9.0, 9.0, 9.0), 498 * PERIOD_S)  # older than the newest
    assert ramp.value == before
    ramp.add(Vector3(9.0, 9.0, 9.0), 5.0)  # after a silence the ramp restarts
    assert (ramp.value.x, ramp.rate.x) == (9.0, 0.0)
