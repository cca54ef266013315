"""When a lost force disengages teleoperation, in virtual time."""

import pytest
from hypothesis import given, strategies as st

from cardan.common.haptics import HapticState, OperatingState
from cardan.gateway.force.watchdog import BEGINS_WITHIN_S, FORCE_LOST_S, ForceGuard
from cardan.types import Vector3

PERIOD_S = 0.004
IN = HapticState(state=OperatingState.ENABLED, rendering=True, command_sequence=5)
OUT = IN._replace(rendering=False, reason="the tick was late")


class Rig:
    """A guard whose hand was taken up at 1 s with the fifth command."""

    def __init__(self):
        self.guard = ForceGuard(max_age_s=0.1)
        self.now_s = 1.0
        self.guard.engage(5, self.now_s)

    def see(self, state, seconds=0.0, fixtures=True, refusal="", source=""):
        """What the guard says at the end of so long, and when it began to."""
        begun_s = self.now_s
        for _ in range(max(1, round(seconds / PERIOD_S))):
            self.now_s += PERIOD_S
            words = self.guard.disengage_reason(
                state, self.now_s, fixtures=fixtures, refusal=refusal, source=source
            )
            if words:
                return words, self.now_s - begun_s
        return "", None


def test_a_force_that_is_there_is_never_objected_to():
    rig = Rig()
    assert rig.see(IN, 60.0) == ("", None)
    assert (rig.guard.losses, rig.guard.out_s) == (0, 0.0)
    assert rig.guard.rendered


def test_the_robot_waits_for_a_force_that_has_not_begun_or_is_gone():
    rig = Rig()
    rig.see(OUT)
    assert rig.guard.in_doubt
    rig.see(IN)
    assert not rig.guard.in_doubt
    rig.see(OUT, 0.008)
    assert not rig.guard.in_doubt  # One tick that was late is nothing.
    rig.see(OUT, 0.008)
    assert rig.guard.in_doubt
    rig.see(IN)
    assert not rig.guard.in_doubt
    rig.guard.release()
    assert not rig.guard.in_doubt


def test_a_short_gap_is_borne_and_a_long_one_is_not():
    rig = Rig()
    rig.see(IN, 1.0)
    assert rig.see(OUT, 0.9 * FORCE_LOST_S)[0] == ""
    rig.see(IN, 1.0)
    words, after_s = rig.see(OUT, 1.0)
    assert words == "the force is lost: the tick was late"
    assert after_s == pytest.approx(FORCE_LOST_S, abs=2 * PERIOD_S)
    assert rig.guard.losses == 1
    assert rig.guard.out_s == pytest.approx(1.9 * FORCE_LOST_S, abs=3 * PERIOD_S)


def test_a_force_that_flickers_is_lost():
    rig = Rig()
    rig.see(IN, 1.0)
    for _ in range(50):
        if rig.see(OUT, 0.02)[0]:
            break
        rig.see(IN, 0.02)
    assert rig.guard.losses == 1


@given(st.integers(1, 20), st.integers(100, 400))
def test_a_late_tick_now_and_then_is_borne(out, rest):
    rig = Rig()
    rig.see(IN, 1.0)
    for _ in range(10):
        assert rig.see(OUT, out * PERIOD_S)[0] == ""
        assert rig.see(IN, rest * PERIOD_S)[0] == ""


def test_what_was_rendered_before_the_clutch_in_does_not_count():
    rig = Rig()
    assert rig.see(IN._replace(command_sequence=4), 0.5)[0] == ""
    assert not rig.guard.rendered


@pytest.mark.parametrize("state", [OperatingState.FAULT, OperatingState.DISABLED])
def test_a_fault_is_no_force_at_once(state):
    rig = Rig()
    rig.see(IN, 1.0)
    words, after_s = rig.see(OUT._replace(state=state, reason="unplugged"), 1.0)
    assert words == "the force is lost: unplugged"
    assert after_s == pytest.approx(PERIOD_S)


def test_what_has_not_begun_within_a_second_will_not():
    rig = Rig()
    words, after_s = rig.see(OUT._replace(reason="engaging is not possible"), 2.0, fixtures=False)
    assert words == "the force has not begun: engaging is not possible"
    assert after_s == pytest.approx(BEGINS_WITHIN_S, abs=2 * PERIOD_S)


def test_a_loop_that_never_hears_of_the_clutch_in_gives_no_force():
    rig = Rig()
    stale = HapticState(state=OperatingState.ENABLED, command_sequence=4, reason="no tick")
    assert rig.see(stale, 2.0)[0] == "the force has not begun: no tick"


def test_the_share_that_warm_motors_leave():
    rig = Rig()
    pressed = {"force": Vector3(0.7, 0, 0), "force_commanded": Vector3(0.7, 0, 0)}
    assert rig.see(IN._replace(thermal_derating=0.36, **pressed), 10.0)[0] == ""
    assert "let them cool down" in rig.see(IN._replace(thermal_derating=0.19, **pressed), 1.0)[0]


def test_a_force_of_long_pressing_is_not_taken_for_one_of_warm_motors():
    rig = Rig()
    strong = {"force": Vector3(0.88, 0, 0), "force_commanded": Vector3(2.0, 0, 0)}
    assert rig.see(IN._replace(thermal_derating=0.44, **strong), 10.0)[0] == ""


def test_a_measured_force_that_ends_is_missed_and_one_that_never_was_is_not():
    rig = Rig()
    assert rig.see(IN, 5.0)[0] == ""
    rig.guard.give(rig.now_s)
    words, after_s = rig.see(IN, 5.0, source="the robot reports none")
    assert words.endswith(", the robot reports none")
    assert after_s == pytest.approx(0.2, abs=2 * PERIOD_S)
    rig.guard.release()
    assert rig.see(IN, 5.0)[0] == ""
    rig.guard.engage(6, rig.now_s)
    assert rig.see(IN._replace(command_sequence=6), 5.0)[0] == ""
    assert rig.guard.losses == 1


def test_a_device_that_cannot_be_enabled_may_become_ready_within_a_second():
    rig = Rig()
    disabled = OUT._replace(state=OperatingState.DISABLED)
    assert rig.see(disabled, 0.5, refusal="no force: a moment")[0] == ""
    assert rig.guard.in_doubt
    assert rig.see(IN, 1.0)[0] == ""
    rig.guard.engage(5, rig.now_s)
    words, after_s = rig.see(disabled, 2.0, refusal="no force: it is not calibrated")
    assert words == "there is no force: it is not calibrated"
    assert after_s == pytest.approx(BEGINS_WITHIN_S, abs=2 * PERIOD_S)
