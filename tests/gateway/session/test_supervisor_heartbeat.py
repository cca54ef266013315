"""A session whose supervisor is silent does not move the arm."""

from hypothesis import given, strategies as st

from cardan.gateway.arm.supervision import Watchdogs
from cardan.gateway.session.supervisor_heartbeat import BEAT_PERIOD_S, SupervisorHeartbeat


def test_it_counts_from_when_the_session_began():
    heartbeat = SupervisorHeartbeat(0.5, 10.0)
    assert heartbeat.fault(10.5) == ""
    assert "was silent for 0.6 s" in heartbeat.fault(10.6)


def test_a_beat_ends_the_fault():
    heartbeat = SupervisorHeartbeat(0.5, 10.0)
    assert heartbeat.fault(20.0)
    heartbeat.heard(20.0)
    assert heartbeat.fault(20.4) == ""
    assert "it is stopped, or its output is not read" in heartbeat.fault(20.51)


def test_four_beats_may_be_missed_with_the_watchdogs_of_a_session():
    silence_s = Watchdogs().heartbeat_s
    heartbeat = SupervisorHeartbeat(silence_s, 0.0)
    assert heartbeat.fault(4 * BEAT_PERIOD_S) == ""
    assert heartbeat.fault(6 * BEAT_PERIOD_S)


@given(st.lists(st.floats(0.0, 1.0), min_size=1))
def test_it_is_a_fault_exactly_while_the_last_beat_is_too_old(gaps):
    heartbeat, now_s = SupervisorHeartbeat(0.5, 0.0), 0.0
    for gap_s in gaps:
        before_s, now_s = now_s, now_s + gap_s
        assert (heartbeat.fault(now_s) == "") is (now_s - before_s <= 0.5)
        heartbeat.heard(now_s)
        assert heartbeat.fault(now_s) == ""
