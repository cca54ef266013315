"""Times at which a lost force disengages teleoperation, in virtual time."""

import pytest
from hypothesis import given, strategies as st

from cardan.common.haptics import HapticState, OperatingState
from cardan.gateway.force.watchdog import (
    BEGINS_WITHIN_S,
    DERATED,
    FORCE_LOST_S,
    IN_A_FIXTURE_N,
    IN_DOUBT_S,
    LEAST_DERATING,
    LET_OUT,
    SOURCE_LOST_S,
    ForceWatchdog,
)
from cardan.types import Vector3

PERIOD_S = 0.004
IN = HapticState(state=OperatingState.ENABLED, rendering=True, command_sequence=5)
OUT = IN._replace(rendering=False, reason="the tick was late")


class Bench:
    """A watchdog, engaged at 1 s with the fifth command."""

    def __init__(self):
        self.watchdog = ForceWatchdog(max_age_s=0.1)
        self.now_s = 1.0
        self.watchdog.engage(5, self.now_s)

    def see(self, state, seconds=0.0, fixtures=True, refusal="", source=""):
        """Return the watchdog's reason within `seconds`, and the time until then (or None)."""
        begun_s = self.now_s
        for _ in range(max(1, round(seconds / PERIOD_S))):
            self.now_s += PERIOD_S
            words = self.watchdog.disengage_reason(
                state, self.now_s, fixtures=fixtures, refusal=refusal, source=source
            )
            if words:
                return words, self.now_s - begun_s
        return "", None


def test_a_force_that_is_there_is_never_objected_to():
    bench = Bench()
    assert bench.see(IN, 60.0) == ("", None)
    assert (bench.watchdog.losses, bench.watchdog.out_s) == (0, 0.0)
    assert bench.watchdog.rendered


def test_the_robot_waits_for_a_force_that_has_not_begun_or_is_gone():
    bench = Bench()
    bench.see(OUT)
    assert bench.watchdog.in_doubt
    bench.see(IN)
    assert not bench.watchdog.in_doubt
    bench.see(OUT, 0.008)
    assert not bench.watchdog.in_doubt  # a single late tick does not count
    bench.see(OUT, 0.008)
    assert bench.watchdog.in_doubt
    bench.see(IN)
    assert not bench.watchdog.in_doubt
    bench.watchdog.release()
    assert not bench.watchdog.in_doubt


def test_a_short_gap_is_borne_and_a_long_one_is_not():
    bench = Bench()
    bench.see(IN, 1.0)
    assert bench.see(OUT, 0.9 * FORCE_LOST_S)[0] == ""
    bench.see(IN, 1.0)
    words, after_s = bench.see(OUT, 1.0)
    assert words == "the force is lost: the tick was late"
    assert after_s == pytest.approx(FORCE_LOST_S, abs=2 * PERIOD_S)
    assert bench.watchdog.losses == 1
    assert bench.watchdog.out_s == pytest.approx(1.9 * FORCE_LOST_S, abs=3 * PERIOD_S)


def test_a_force_that_flickers_is_lost():
    bench = Bench()
    bench.see(IN, 1.0)
    for _ in range(50):
        if bench.see(OUT, 0.02)[0]:
            break
        bench.see(IN, 0.02)
    assert bench.watchdog.losses == 1


@given(st.integers(1, 20), st.integers(100, 400))
def test_a_late_tick_now_and_then_is_borne(out, rest):
    bench = Bench()
    bench.see(IN, 1.0)
    for _ in range(10):
        assert bench.see(OUT, out * PERIOD_S)[0] == ""
        assert bench.see(IN, rest * PERIOD_S)[0] == ""


def test_what_was_rendered_before_the_clutch_in_does_not_count():
    bench = Bench()
    assert bench.see(IN._replace(command_sequence=4), 0.5)[0] == ""
    assert not bench.watchdog.rendered


@pytest.mark.parametrize("state", [OperatingState.FAULT, OperatingState.DISABLED])
def test_a_fault_is_no_force_at_once(state):
    bench = Bench()
    bench.see(IN, 1.0)
    words, after_s = bench.see(OUT._replace(state=state, reason="unplugged"), 1.0)
    assert words == "the force is lost: unplugged"
    assert after_s == pytest.approx(PERIOD_S)


def test_what_has_not_begun_within_a_second_will_not():
    bench = Bench()
    words, after_s = bench.see(OUT._replace(reason="engaging is not possible"), 2.0, fixtures=False)
    assert words == "the force has not begun: engaging is not possible"
    assert after_s == pytest.approx(BEGINS_WITHIN_S, abs=2 * PERIOD_S)


def test_a_loop_that_never_hears_of_the_clutch_in_gives_no_force():
    bench = Bench()
    stale = HapticState(state=OperatingState.ENABLED, command_sequence=4, reason="no tick")
    assert bench.see(stale, 2.0)[0] == "the force has not begun: no tick"


def test_the_share_that_warm_motors_leave():
    bench = Bench()
    pressed = {"force": Vector3(0.7, 0, 0), "force_commanded": Vector3(0.7, 0, 0)}
    assert bench.see(IN._replace(thermal_derating=0.36, **pressed), 10.0)[0] == ""
    assert "let them cool down" in bench.see(IN._replace(thermal_derating=0.19, **pressed), 1.0)[0]


def test_a_force_of_long_pressing_is_not_taken_for_one_of_warm_motors():
    bench = Bench()
    strong = {"force": Vector3(0.88, 0, 0), "force_commanded": Vector3(2.0, 0, 0)}
    assert bench.see(IN._replace(thermal_derating=0.44, **strong), 10.0)[0] == ""


def test_a_measured_force_that_ends_is_missed_and_one_that_never_was_is_not():
    bench = Bench()
    assert bench.see(IN, 5.0)[0] == ""
    bench.watchdog.give(bench.now_s)
    words, after_s = bench.see(IN, 5.0, source="the robot reports none")
    assert words.endswith(", the robot reports none")
    assert after_s == pytest.approx(0.2, abs=2 * PERIOD_S)
    bench.watchdog.release()
    assert bench.see(IN, 5.0)[0] == ""
    bench.watchdog.engage(6, bench.now_s)
    assert bench.see(IN._replace(command_sequence=6), 5.0)[0] == ""
    assert bench.watchdog.losses == 1


def test_a_device_that_cannot_be_enabled_may_become_ready_within_a_second():
    bench = Bench()
    disabled = OUT._replace(state=OperatingState.DISABLED)
    assert bench.see(disabled, 0.5, refusal="no force: a moment")[0] == ""
    assert bench.watchdog.in_doubt
    assert bench.see(IN, 1.0)[0] == ""
    bench.watchdog.engage(5, bench.now_s)
    words, after_s = bench.see(disabled, 2.0, refusal="no force: it is not calibrated")
    assert words == "there is no force: it is not calibrated"
    assert after_s == pytest.approx(BEGINS_WITHIN_S, abs=2 * PERIOD_S)


# -- exact time limits, counted from an engagement at zero ---------------------------------------

LATER_S = 0.001


class Exact:
    """A watchdog, engaged at zero, which gets states at chosen times."""

    def __init__(self, *rendered_at_s):
        self.watchdog = ForceWatchdog(max_age_s=0.0)
        self.watchdog.engage(5, 0.0)
        for now_s in rendered_at_s:
            assert self.at(now_s, IN) == ""

    def at(self, now_s, state, *, fixtures=True, refusal="", source=""):
        return self.watchdog.disengage_reason(
            state, now_s, fixtures=fixtures, refusal=refusal, source=source
        )


def pushing(given_n, of_n, **known):
    """A device that renders this share of the commanded force."""
    return IN._replace(
        force=Vector3(given_n, 0.0, 0.0), force_commanded=Vector3(of_n, 0.0, 0.0), **known
    )


def test_a_guard_that_nobody_engaged_says_nothing():
    watchdog = ForceWatchdog(max_age_s=0.1)
    for now_s in (0.0, 60.0):
        words = watchdog.disengage_reason(OUT, now_s, fixtures=True, refusal="", source="")
        assert (words, watchdog.lost_reason, watchdog.losses, watchdog.out_s) == ("", "", 0, 0.0)
        assert (watchdog.rendered, watchdog.in_doubt, watchdog.heard) == (False, False, False)


def test_what_was_seen_before_the_clutch_out_does_not_count_after_it():
    warm = pushing(0.1, 1.0, thermal_derating=0.9 * DERATED)
    for state in (OUT, warm):
        bench = Exact(0.0)
        assert bench.at(FORCE_LOST_S, state) == ""
        bench.watchdog.engage(5, 1.0)
        assert bench.at(1.0, IN) == ""
        assert bench.at(1.0 + 0.5 * IN_DOUBT_S, state) == ""
        assert not bench.watchdog.in_doubt
    bench.watchdog.release()
    assert bench.at(9.0, OUT) == ""


def test_the_robot_waits_after_and_not_at_the_time_of_doubt():
    warm = pushing(0.1, 1.0, thermal_derating=0.9 * DERATED)
    for state in (OUT, warm):
        bench = Exact(0.0)
        bench.at(IN_DOUBT_S, state)
        assert not bench.watchdog.in_doubt
        bench.at(IN_DOUBT_S + LATER_S, state)
        assert bench.watchdog.in_doubt


def test_a_force_is_lost_after_and_not_at_its_time():
    bench = Exact(0.0)
    assert bench.at(FORCE_LOST_S, OUT) == ""
    assert bench.watchdog.lost_reason == "the tick was late"
    assert bench.at(FORCE_LOST_S + LATER_S, OUT) == "the force is lost: the tick was late"
    assert bench.watchdog.lost_reason == "the force is lost: the tick was late"
    bench = Exact(0.0)
    assert bench.at(LATER_S, OUT._replace(reason="")) == ""
    assert bench.watchdog.lost_reason == "the device gives none"


def test_a_quarter_of_the_time_with_force_makes_up_for_time_without():
    for with_s, lost in ((0.16, True), (0.24, False)):
        bench = Exact(0.0)
        assert bench.at(0.14, OUT) == ""
        assert bench.at(0.14 + with_s, IN) == ""
        assert bool(bench.at(0.14 + with_s + 0.06, OUT)) is lost


def test_force_may_begin_until_and_at_a_second():
    bench = Exact()
    assert bench.at(BEGINS_WITHIN_S, OUT) == ""
    assert bench.at(BEGINS_WITHIN_S + LATER_S, OUT) == "the force has not begun: the tick was late"


@pytest.mark.parametrize(
    ("asked_n", "fixtures", "state", "words"),
    [
        (1.4 * IN_A_FIXTURE_N, True, OperatingState.ENABLED, "would push with 0.1 N at once"),
        (15.0 * IN_A_FIXTURE_N, True, OperatingState.ENABLED, "would push with 1.5 N at once"),
        (IN_A_FIXTURE_N, True, OperatingState.ENABLED, "the force has not begun"),
        (15.0 * IN_A_FIXTURE_N, False, OperatingState.ENABLED, "the force has not begun"),
        (15.0 * IN_A_FIXTURE_N, True, OperatingState.PAUSED, "the force has not begun"),
        (15.0 * IN_A_FIXTURE_N, True, OperatingState.DISABLED, "there is no force"),
    ],
)
def test_a_fixture_that_would_push_at_once_is_named(asked_n, fixtures, state, words):
    asked = OUT._replace(state=state, force_commanded=Vector3(asked_n, 0.0, 0.0))
    assert words in Exact().at(2.0 * BEGINS_WITHIN_S, asked, fixtures=fixtures)


def test_the_least_share_of_warm_motors_is_still_enough():
    assert Exact(0.0).at(0.1, pushing(0.0, 0.0, thermal_derating=LEAST_DERATING)) == ""
    warm = pushing(0.0, 0.0, thermal_derating=0.99 * LEAST_DERATING)
    assert "is limited to 20% of the largest" in Exact(0.0).at(0.1, warm)


@pytest.mark.parametrize(
    ("left", "given_n", "lost"),
    [
        (0.99 * DERATED, 0.99 * LET_OUT, True),
        (DERATED, 0.99 * LET_OUT, False),
        (0.99 * DERATED, LET_OUT, False),
    ],
)
def test_warm_motors_that_give_too_little_of_what_is_asked_lose_the_force(left, given_n, lost):
    bench, warm = Exact(0.0), pushing(given_n, 1.0, thermal_derating=left)
    assert bench.at(FORCE_LOST_S, warm) == ""
    assert ("let them cool down" in bench.at(FORCE_LOST_S + LATER_S, warm)) is lost
    assert bench.watchdog.in_doubt is lost


def test_motors_that_are_cool_in_between_begin_anew():
    bench, warm = Exact(0.0), pushing(0.1, 1.0, thermal_derating=0.9 * DERATED)
    assert bench.at(0.1, warm) == ""
    assert bench.at(0.11, pushing(1.0, 1.0)) == ""
    assert bench.at(0.22, warm) == ""


def test_a_measured_force_is_lost_after_and_not_at_its_time():
    bench = Exact(0.0)
    bench.watchdog.give(0.0)
    assert bench.at(SOURCE_LOST_S, IN) == ""
    assert bench.at(0.2, IN) == "the measured force is lost: none for 0.20 s"
    bench = Exact(1.0)
    bench.watchdog.give(1.0)
    assert bench.at(1.25, IN, source="gone") == (
        "the measured force is lost: none for 0.25 s, gone"
    )
