"""Permission of force, and messages to the operator, from the results of the library's calibration
check."""

import pytest
from hypothesis import given, strategies as st

from cardan.common.haptics import Calibration
from cardan_omni.driver.calibration import (
    SETTLE_S,
    SLOW_S,
    UPDATE_AGAIN_S,
    CalibrationWatch,
    style_of,
)
from cardan_omni.protocol import CalibrationStyle

OK, UPDATE = Calibration.OK, Calibration.NEEDS_UPDATE
MANUAL, UNKNOWN = Calibration.NEEDS_MANUAL_INPUT, Calibration.UNKNOWN
STEP_S = 0.01


def reported(answers, start_s=0.0, watch=None):
    """Return a calibration watch after these results, 10 ms apart, and the time of the last one."""
    watch = watch or CalibrationWatch()
    now_s = start_s
    for answer in answers:
        now_s += STEP_S
        watch.on_answer(answer, now_s)
    return watch, now_s


def test_nothing_is_believed_before_the_first_answer():
    watch = CalibrationWatch()
    assert watch.state is Calibration.UNKNOWN
    assert not watch.usable(100.0)
    assert "does not say" in watch.reason(0.0)


def test_a_calibrated_device_is_usable_once_it_has_settled():
    watch = CalibrationWatch()
    assert watch.on_answer(OK, 1.0) is False
    assert (watch.state, watch.usable(1.0)) == (Calibration.OK, False)
    assert "waiting for the position to settle" in watch.reason(1.0)
    assert watch.usable(1.0 + SETTLE_S)
    assert watch.reason(1.0 + SETTLE_S) == ""


def test_from_a_cold_start_by_the_inkwell_to_use():
    watch, now_s = reported([MANUAL] * 30)
    assert watch.state is Calibration.NEEDS_MANUAL_INPUT
    assert "put the stylus into the inkwell" in watch.reason(now_s)
    assert watch.on_answer(UPDATE, now_s + 0.01) is True
    assert watch.style is CalibrationStyle.INKWELL
    assert "being calibrated" in watch.reason(now_s + 0.01)
    assert watch.on_answer(OK, now_s + 0.02) is False
    assert not watch.usable(now_s + 0.02)
    assert watch.usable(now_s + 0.03 + SETTLE_S)
    assert watch.changes == 0


def test_an_update_without_effect_is_asked_for_again_but_not_in_every_tick():
    watch = CalibrationWatch()
    asked = [k * STEP_S for k in range(100) if watch.on_answer(UPDATE, k * STEP_S)]
    assert len(asked) == watch.updates == 2
    assert asked[1] - asked[0] == pytest.approx(UPDATE_AGAIN_S, abs=1.5 * STEP_S)


def test_a_lost_calibration_ends_the_use_at_once_and_settles_anew():
    watch, now_s = reported([OK] * 30)
    assert watch.usable(now_s)
    watch.on_answer(MANUAL, now_s + STEP_S)
    assert not watch.usable(now_s + STEP_S)
    watch.on_answer(OK, now_s + 2 * STEP_S)
    assert not watch.usable(now_s + 3 * STEP_S)
    assert watch.usable(now_s + 3 * STEP_S + SETTLE_S)
    assert watch.changes == 1


def test_the_words_grow_where_it_takes_long():
    watch = CalibrationWatch()
    watch.on_answer(MANUAL, 0.0)
    assert "vendor" not in watch.reason(SLOW_S - 1.0)
    assert "vendor's diagnostic tool" in watch.reason(SLOW_S)


def test_an_answer_that_nobody_knows_is_no_calibration():
    watch, now_s = reported([OK] * 30)
    assert watch.on_answer(UNKNOWN, now_s) is False
    assert watch.state is Calibration.UNKNOWN
    assert not watch.usable(now_s + 10.0)


@pytest.mark.parametrize(
    ("styles", "style"),
    [
        (0, CalibrationStyle.INKWELL),
        (1, CalibrationStyle.ENCODER_RESET),
        (2, CalibrationStyle.AUTO),
        (3, CalibrationStyle.AUTO),
        (7, CalibrationStyle.INKWELL),
    ],
)
def test_the_style_is_the_easiest_that_the_device_has(styles, style):
    assert style_of(styles) is style


def test_what_to_do_depends_on_the_style():
    watch = CalibrationWatch(CalibrationStyle.ENCODER_RESET)
    watch.on_answer(MANUAL, 0.0)
    assert "reset position" in watch.reason(0.0)
    watch.on_opened(CalibrationStyle.AUTO)
    assert watch.state is Calibration.UNKNOWN
    watch.on_answer(MANUAL, 0.0)
    assert "move the stylus" in watch.reason(0.0)


@given(st.lists(st.sampled_from([OK, UPDATE, MANUAL, UNKNOWN]), max_size=60))
def test_usable_only_after_a_whole_stretch_of_good_answers(answers):
    watch, now_s = reported(answers)
    tail = 0
    while tail < len(answers) and answers[-1 - tail] == OK:
        tail += 1
    good_s = (tail - 1) * STEP_S if tail else -1.0
    if good_s > SETTLE_S + 1e-9:
        assert watch.usable(now_s)
    if good_s < SETTLE_S - 1e-9:
        assert not watch.usable(now_s)
    assert (watch.reason(now_s) == "") is watch.usable(now_s)
