"""The thesis's studies at reduced length: finite figures, no contact."""

import numpy as np
import pytest

from studies.thesis import arbitrary, collision, eight, faults, line
from studies.thesis.bench import DT_S, Metronome, published_mechanism, signed_delays, table

pytestmark = pytest.mark.matrix


def test_the_published_mechanism_has_the_published_delay():
    result = line.mechanism(0.5)
    assert result.delays.least_error_s == pytest.approx(0.35, abs=0.03)
    assert np.nanmedian(result.delays.per_command_s) == pytest.approx(0.35, abs=0.03)
    assert np.nanmax(result.delays.per_command_s) == pytest.approx(0.5, abs=0.05)


def test_a_quintic_ends_at_rest_at_its_goal():
    times = np.arange(0.0, 2.0, DT_S)
    found = published_mechanism(np.array((0.0,)), np.array(((0.0, 1.0),)), times)
    np.testing.assert_allclose(found, np.tile((0.0, 1.0), (len(times), 1)), atol=1e-9)
    jump = published_mechanism(np.array((0.0, 0.1)), np.array(((0.0,), (1.0,))), times)
    assert jump[-1, 0] == pytest.approx(1.0, abs=1e-4)
    assert jump.max() < 1.05


def test_signed_delays_of_a_shifted_motion():
    times = np.arange(0.0, 5.0, DT_S)
    sent = np.arange(0.5, 3.0, 0.1)
    for shift in (-0.1, 0.0, 0.25):
        output = np.stack((0.1 * (times - shift), 0.0 * times), axis=1)
        commands = np.stack((0.1 * sent, 0.0 * sent), axis=1)
        found = signed_delays(sent, commands, times, output, 1.0)
        np.testing.assert_allclose(found, shift, atol=DT_S)


def test_a_metronome_keeps_its_rate():
    clock = Metronome(20.0)
    beats = [clock.due(i * DT_S) for i in range(500)]
    found = [at for at in beats if at is not None]
    np.testing.assert_allclose(found, np.arange(20) * 0.05)


@pytest.mark.parametrize("drive", ["ideal", "dynamic"])
def test_straight_line(drive):
    result = line.relative(drive, 0, 0.05)
    assert result.refusals == 0
    assert 0.0 <= result.delays.least_error_s < 0.1
    assert np.isfinite(result.errors).all()
    poses = line.absolute(drive, 1, 0.05)
    assert poses.refusals == 0
    assert np.isfinite(poses.errors).all()


def test_eight_course():
    result = eight.run("ideal", True, 5.0)
    assert result.clearance_m > 0.0
    assert result.stops == 0
    assert np.isfinite(result.delays_s).all()
    assert len(result.delays_s) > 20


@pytest.mark.parametrize("drive", ["ideal", "dynamic"])
def test_a_jump_touches_nothing(drive):
    jump = collision.jump(drive)
    assert 0.0 < jump.smallest_m <= jump.final_m
    assert jump.published_m < 0.0


def test_collision():
    stop = collision.into_by_poses("ideal")
    assert stop.smallest_m > 0.0
    assert np.isfinite(stop.retreat_s)


@pytest.mark.parametrize("shaped", [False, True])
def test_arbitrary_movements(shaped):
    result = arbitrary.wander("ideal", shaped, 3.0)
    assert result.refusals == 0
    assert np.isfinite(result.delays_s).all()
    turning = arbitrary.turning("ideal", -1.0, shaped, 0.5)
    assert turning.turns == pytest.approx(-0.5, abs=0.01)


def test_disturbed_stream():
    late = faults.reordering("ideal")
    assert late.reached_m == pytest.approx(0.3, abs=1e-3)
    assert late.refused > 0
    assert late.back_m < 1e-4
    assert faults.silence("ideal", 0.1).run_on_m < 0.02


def test_the_tables_can_be_printed():
    result = line.measure("ideal", 0.02, 1)
    text = table("title", line.rows(result, result, line.simulated(0.02)))
    assert "title" in text
    assert "nan" not in text
    found = [faults.not_a_number("ideal")]
    assert "refused" in table("t", faults.rows(tuple(found), tuple(found)))
