"""Conditions of a hold on a page, and the page's clock, in virtual time."""

import math

import pytest

from cardan.gateway.servers.console.hold_to_run import (
    FRESH_S,
    LONGEST_S,
    Grip,
    Hold,
    HoldVerdict,
)
from cardan.protocols.handheld.frames import JogTwist, OperatorFrame
from cardan.types import Vector3

BODY = JogTwist(Vector3(0.1, 0.0, 0.0), Vector3(0.0, 0.0, 0.0))


class Hand:
    """Frames of a page whose clock equals ours."""

    def __init__(self, longest_s=math.inf):
        self.hold = Hold(longest_s)
        self.now_s, self.sequence = 100.0, 0

    def frame(self, hold=True, after_s=0.016, late_s=0.0, **more):
        """A frame that arrives `late_s` after it was sent."""
        self.now_s += after_s
        self.sequence += 1
        sequence = more.pop("sequence", self.sequence)
        frame = OperatorFrame(BODY, hold, sequence=sequence, **more)
        return self.hold.take(frame, self.now_s - late_s, self.now_s)

    def held(self):
        assert self.frame(False) is HoldVerdict.REST
        assert self.frame(True) is HoldVerdict.BEGINS
        return self


def test_a_hold_begins_goes_on_and_ends():
    hand = Hand()
    assert hand.frame(False) is HoldVerdict.REST
    assert [hand.frame(True) for _ in range(3)] == [
        HoldVerdict.BEGINS,
        *[HoldVerdict.GOES_ON] * 2,
    ]
    assert hand.frame(False) is HoldVerdict.REST
    assert hand.hold.grip is Grip.FREE
    assert hand.frame(True) is HoldVerdict.BEGINS


def test_what_is_held_from_the_beginning_has_to_be_let_go_of():
    hand = Hand()
    assert hand.frame(True) is HoldVerdict.REST
    assert "let go" in hand.hold.why
    assert hand.frame(False) is HoldVerdict.REST
    assert hand.frame(True) is HoldVerdict.BEGINS


@pytest.mark.parametrize("more", [{"visible": False}, {"tracking": False}])
def test_a_hidden_page_or_lost_tracking_ends_it_until_the_hand_lets_go(more):
    hand = Hand().held()
    assert hand.frame(True, **more) is HoldVerdict.REST
    assert hand.frame(True) is HoldVerdict.REST
    assert hand.hold.grip is Grip.LOST
    assert hand.frame(False) is HoldVerdict.REST
    assert hand.frame(True) is HoldVerdict.BEGINS


def test_silence_ends_it_and_frames_that_go_on_do_not_begin_it_again():
    hand = Hand().held()
    until_s = hand.hold.until_s
    assert until_s == pytest.approx(hand.now_s + FRESH_S)
    assert not hand.hold.look(until_s - 0.001)
    assert hand.hold.look(until_s)
    assert hand.hold.until_s is None
    assert hand.frame(True, after_s=0.3) is HoldVerdict.REST
    assert "no frame" in hand.hold.why


def test_silence_is_noticed_with_the_next_frame_too():
    hand = Hand().held()
    assert hand.frame(True, after_s=FRESH_S + 0.001) is HoldVerdict.REST


def test_old_frames_are_dropped_and_keep_nothing_alive():
    hand = Hand().held()
    for _ in range(20):
        assert hand.frame(True, late_s=FRESH_S + 0.01) in (
            HoldVerdict.DROPPED,
            HoldVerdict.REST,
        )
    assert hand.hold.grip is Grip.LOST
    assert hand.hold.counts["old"] == 20


def test_a_late_frame_keeps_it_no_longer_than_it_is_fresh():
    hand = Hand().held()
    assert hand.frame(True, late_s=0.1) is HoldVerdict.GOES_ON
    assert hand.hold.until_s == pytest.approx(hand.now_s + FRESH_S - 0.1)


def test_letting_go_counts_however_late_it_comes():
    hand = Hand().held()
    assert hand.frame(False, late_s=5.0) is HoldVerdict.REST
    assert hand.hold.grip is Grip.FREE


def test_frames_that_come_twice_or_after_a_newer_one_are_dropped():
    hand = Hand().held()
    assert hand.frame(True, sequence=hand.sequence) is HoldVerdict.DROPPED
    assert hand.frame(False, sequence=hand.sequence - 2) is HoldVerdict.DROPPED
    assert hand.hold.grip is Grip.HELD
    assert hand.hold.counts["late"] == 2


def test_numbers_go_round():
    hand = Hand()
    hand.sequence = 2**32 - 3
    hand.held()
    assert hand.frame(True, sequence=0) is HoldVerdict.GOES_ON
    assert hand.frame(True, sequence=1) is HoldVerdict.GOES_ON


def test_frames_of_an_unknown_clock_hold_nothing():
    hold = Hold()
    assert hold.take(OperatorFrame(BODY, False, sequence=1), None, 1.0) is HoldVerdict.REST
    assert hold.take(OperatorFrame(BODY, True, sequence=2), None, 1.0) is HoldVerdict.DROPPED
    assert hold.take(OperatorFrame(BODY, True, sequence=3), 1.2, 1.0) is HoldVerdict.DROPPED
    assert hold.counts["unknown"] == 2


def until_lost(hand, longest_s, moves=lambda hand, held_s: None):
    """Continue the hold until it is lost; return the time until then, s, at most `longest_s`."""
    began_s = hand.now_s
    while hand.hold.grip is Grip.HELD and hand.now_s - began_s < longest_s:
        moves(hand, hand.now_s - began_s)
        hand.frame(True, after_s=0.02)
    return hand.now_s - began_s


def test_a_jog_that_nobody_renews_ends_in_time_and_takes_a_new_press():
    """The browser hangs, and its page keeps reporting a hold."""
    hand = Hand(LONGEST_S).held()
    assert until_lost(hand, 60.0) == pytest.approx(LONGEST_S, abs=0.05)
    assert "without a sign" in hand.hold.why
    assert hand.frame(True) is HoldVerdict.REST
    hand.hold.renew(hand.now_s)
    assert hand.frame(True) is HoldVerdict.REST
    assert hand.frame(False) is HoldVerdict.REST
    assert hand.frame(True) is HoldVerdict.BEGINS
    assert hand.hold.left_s(hand.now_s) == LONGEST_S


def test_what_a_person_does_renews_a_hold():
    hand = Hand(LONGEST_S).held()

    def moves(hand, held_s):
        if held_s < 30.0:
            hand.hold.renew(hand.now_s)

    assert until_lost(hand, 90.0, moves) == pytest.approx(30.0 + LONGEST_S, abs=0.05)


def test_a_frame_that_does_not_come_ends_a_renewed_hold_as_any_other():
    hand = Hand(LONGEST_S).held()
    hand.hold.renew(hand.now_s)
    assert hand.hold.look(hand.now_s + FRESH_S)
    assert "no frame" in hand.hold.why


def test_speeds_that_a_page_computes_renew_no_jog():
    """During a motion to a goal the speeds change without the operator."""
    hand = Hand(LONGEST_S).held()
    while hand.hold.grip is Grip.HELD and hand.now_s < 200.0:
        hand.now_s += 0.02
        hand.sequence += 1
        body = JogTwist(Vector3(1e-4 * hand.sequence, 0.0, 0.0), Vector3(0.0, 0.0, 0.0))
        hand.hold.take(OperatorFrame(body, True, sequence=hand.sequence), hand.now_s, hand.now_s)
    assert hand.now_s == pytest.approx(100.0 + LONGEST_S, abs=0.1)


def test_what_is_no_jog_is_held_without_end():
    hand = Hand().held()
    assert until_lost(hand, 100.0) >= 100.0
    assert hand.hold.left_s(hand.now_s) is None
