"""Device states of the driver from the service's messages, in virtual time."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings, strategies as st

from cardan.spatial import from_rotation_vector, norm, rotation_between, subtract
from cardan.types import DeviceLink, Vector3
from cardan_leap.driver import LeapOptions
from cardan_leap.protocol import DeviceEvent, Hand, Malformed, TrackingFrame, Version
from leap_frames import HOME, PERIOD_S, PLUGGED, Rig, engaged, hand
from tests.examples import examples

FIST = {"grab_strength": 1.0}
PINCH = {"pinch_strength": 1.0}


def moved(x=0.0, y=0.0, z=0.0):
    return Vector3(HOME.x + x, HOME.y + y, HOME.z + z)


class TestLink:
    def test_before_opening(self):
        rig = Rig()
        rig.core.on_closed(rig.now_s)
        assert rig.state.link is DeviceLink.CLOSED
        rig.frame(hand())
        assert rig.state.link is DeviceLink.CLOSED

    def test_empty_frames_make_it_live(self):
        rig = Rig()
        assert rig.state.link is DeviceLink.NEEDS_NEUTRAL
        assert rig.state.reason == "connected, no frame yet"
        state = rig.frame()
        assert (state.link, state.reason) == (DeviceLink.LIVE, "")
        assert state.stamp_s == rig.now_s
        assert rig.core.heard

    def test_it_stays_live_while_nobody_is_in_view(self):
        rig = Rig()
        assert rig.frames(5.0).link is DeviceLink.LIVE

    def test_without_any_frame_it_is_stale(self):
        rig = Rig()
        state = rig.wait(0.1)
        assert state.link is DeviceLink.STALE
        assert "no frame" in state.reason

    @pytest.mark.parametrize(
        ("clutch", "posture", "rests"),
        [
            ("still", {}, False),
            ("still", FIST, False),
            ("grab", {}, True),
            ("grab", FIST, False),
            ("grab", {"grab_strength": 0.5}, False),
            ("pinch", {}, True),
            ("pinch", PINCH, False),
            ("open", {}, False),
            ("open", FIST, True),
        ],
    )
    def test_a_hand_that_could_engage_by_staying_is_not_neutral(self, clutch, posture, rests):
        rig = Rig(clutch=clutch)
        state = rig.frames(2.0, hand(**posture))
        assert state.link is (DeviceLink.LIVE if rests else DeviceLink.NEEDS_NEUTRAL)
        assert "clutch" not in state.buttons
        if not rests:
            assert state.pose is None
            assert state.buttons == frozenset()
            assert "once" in state.reason
            assert rig.frame().link is DeviceLink.LIVE

    def test_the_other_hand_is_no_obstacle(self):
        rig = Rig(hand="right")
        assert rig.frame(hand(type="left")).link is DeviceLink.LIVE
        other = Rig(hand="right")
        assert other.frame(hand(type="")).link is DeviceLink.NEEDS_NEUTRAL

    def test_a_service_without_devices_is_believed(self):
        rig = Rig()
        rig.core.on_opened(rig.now_s)
        assert rig.frame().link is DeviceLink.LIVE


class TestClutch:
    def test_still(self):
        rig = Rig()
        rig.frame()
        rig.frames(0.25, hand())
        assert rig.state.buttons == {"hand"}
        assert rig.state.pose is not None
        rig.frames(0.1, hand())
        assert rig.state.buttons == {"hand", "clutch"}
        rig.frame(hand(position=moved(0.05)))
        rig.frame(hand(position=moved(0.1), grab_strength=1.0))
        assert rig.state.buttons == {"hand", "clutch", "grab"}
        rig.frame()
        assert rig.state.buttons == frozenset()
        assert rig.state.pose is None
        assert rig.state.link is DeviceLink.LIVE
        assert rig.edges() == ["+hand", "+clutch", "+grab", "-clutch", "-grab", "-hand"]

    def test_a_moving_hand_is_not_still(self):
        rig = Rig()
        rig.frame()
        for step in range(200):
            state = rig.frame(hand(position=moved(0.1 * math.sin(0.05 * step))))
            assert state.buttons == {"hand"}

    @pytest.mark.parametrize("clutch", ["still", "open"])
    @pytest.mark.parametrize("speed_m_s", [0.02, 0.06, 0.2])
    def test_a_hand_that_passes_by_is_not_still(self, clutch, speed_m_s):
        rig = Rig(clutch=clutch)
        rig.frames(0.2, *([hand(**FIST)] if clutch == "open" else []))
        rig.frame()
        for step in range(round(0.4 / speed_m_s / PERIOD_S)):
            state = rig.frame(hand(position=moved(step * PERIOD_S * speed_m_s - 0.2)))
            assert "clutch" not in state.buttons

    def test_a_hand_that_trembles_is_still(self):
        rig = Rig()
        rig.frame()
        for step in range(60):
            rig.frame(hand(position=moved(0.002 * math.sin(step), 0.002 * math.cos(2.0 * step))))
        assert "clutch" in rig.state.buttons

    def test_a_fist_that_was_made_meanwhile_is_no_press(self):
        rig = Rig(clutch="open")
        assert rig.frames(0.2, hand(**FIST)).link is DeviceLink.LIVE
        assert rig.edges() == ["+hand"]
        rig.wait(0.2)
        rig.frames(0.2, hand(**FIST))
        assert rig.state.buttons == {"hand"}
        rig.frame(hand())
        assert "grab" in rig.frame(hand(**FIST)).buttons

    def test_open(self):
        rig = Rig(clutch="open")
        rig.frame()
        rig.frames(1.0, hand(**FIST))
        assert rig.state.buttons == {"hand", "grab"}
        rig.frames(0.25, hand())
        assert rig.state.buttons == {"hand"}
        rig.frames(0.1, hand())
        assert "clutch" in rig.state.buttons
        rig.frame(hand(grab_strength=0.4))
        assert "clutch" in rig.state.buttons
        rig.frame(hand(grab_strength=0.6))
        assert "clutch" not in rig.state.buttons
        rig.frames(0.25, hand())
        assert "clutch" not in rig.state.buttons

    @pytest.mark.parametrize("clutch", ["grab", "pinch"])
    def test_grab_and_pinch_with_hysteresis(self, clutch):
        rig = Rig(clutch=clutch)
        rig.frame()
        strength = f"{clutch}_strength"
        held = []
        for value in (0.0, 0.5, 0.79, 0.81, 0.5, 0.31, 0.29, 0.5, 0.9):
            state = rig.frame(hand(**{strength: value}))
            held.append("clutch" in state.buttons)
            assert (clutch in state.buttons) == held[-1]
        assert held == [False, False, False, True, True, True, False, False, True]

    def test_a_fist_that_comes_into_view_has_to_open_first(self):
        rig = Rig(clutch="grab")
        rig.frame()
        assert rig.frames(1.0, hand(**FIST)).buttons == {"hand", "grab"}
        rig.frame(hand())
        assert "clutch" in rig.frame(hand(**FIST)).buttons

    def test_a_fist_is_no_pinch(self):
        rig = Rig()
        rig.frame()
        rig.frame(hand(grab_strength=0.9, pinch_strength=0.9))
        assert rig.state.buttons == {"hand", "grab"}

    def test_the_pose_is_there_in_every_state_with_the_clutch(self):
        rig = engaged("grab")
        for step in range(300):
            closed = {"grab_strength": 0.5 + 0.5 * math.sin(0.3 * step)}
            hands = [hand(**closed)] * (step % 7 > 0)
            state = rig.frame(*hands, unreadable=step % 7 == 0)
            assert "clutch" not in state.buttons or state.pose is not None


class TestHands:
    def test_a_new_id_engages_anew_and_never_jumps(self):
        rig = engaged()
        before = rig.state.pose
        rig.frame(hand(2, moved(0.3)))
        assert rig.state.buttons == {"hand"}
        assert rig.state.pose is not None
        assert before is not None
        assert rig.state.pose.position == pytest.approx(moved(0.3))
        assert rig.edges() == ["-clutch"]
        rig.frames(0.35, hand(2, moved(0.3)))
        assert rig.edges() == ["+clutch"]

    def test_the_hand_that_came_first_is_followed_whatever_the_order(self):
        rig = Rig()
        rig.frame()
        rig.frames(0.3, hand(5))
        for _ in range(20):
            rig.frame(hand(2, moved(0.0, 0.1)), hand(5))
        assert rig.state.pose is not None
        assert rig.state.pose.position == pytest.approx(HOME)
        rig.frames(0.1, hand(2, moved(0.0, 0.1)))
        assert rig.state.pose is not None
        assert rig.state.pose.position.y == pytest.approx(0.1)

    def test_left_or_right(self):
        rig = Rig(hand="left")
        rig.frame()
        rig.frames(0.5, hand(1))
        assert rig.state.buttons == frozenset()
        assert any("right hand is in view" in line for line in rig.core.diagnosis(rig.now_s))
        rig.frames(0.5, hand(1), hand(2, type="left"))
        assert rig.state.buttons == {"hand", "clutch"}
        rig.frame(hand(1), hand(2, type="right"))
        assert rig.state.buttons == frozenset()

    def test_time_in_view(self):
        rig = Rig()
        rig.frame()
        assert rig.frames(0.1, hand(time_visible_s=0.1)).buttons == frozenset()
        assert rig.frame(hand(time_visible_s=0.2)).buttons == {"hand"}

    def test_time_in_view_by_our_own_clock(self):
        rig = Rig()
        rig.frame()
        unknown = hand(time_visible_s=None, confidence=None)
        assert rig.frames(0.19, unknown).buttons == frozenset()
        assert rig.frames(0.03, unknown).buttons == {"hand"}

    def test_confidence(self):
        rig = Rig(min_confidence=0.5)
        rig.frame()
        assert rig.frames(0.5, hand(confidence=0.4)).buttons == frozenset()
        assert "confidence of only 0.40" in rig.core.diagnosis(rig.now_s)[0]
        assert rig.frame(hand(confidence=0.5)).buttons == {"hand"}

    def test_a_hand_without_type_needs_hand_first(self):
        bare = Hand(3, Vector3(0, 200, 0), Vector3(0, -1, 0), Vector3(0, 0, -1))
        rig = Rig()
        rig.tell(Version(1))
        rig.frame()
        assert rig.frames(0.6, bare).buttons == {"hand", "clutch"}
        assert any("version 1" in line for line in rig.core.diagnosis(rig.now_s))
        other = Rig(hand="left")
        other.frame()
        assert other.frames(0.6, bare).buttons == frozenset()


class TestPose:
    def test_axes_and_attitude(self):
        turn = from_rotation_vector(Vector3(0.1, -0.2, 0.3))
        rig = Rig(cutoff_hz=0.0)
        rig.frame()
        state = rig.frames(0.1, hand(position=Vector3(0.03, -0.0125, 0.21), orientation=turn))
        assert state.pose is not None
        assert state.pose.position == pytest.approx((0.03, -0.0125, 0.21))
        assert norm(rotation_between(state.pose.orientation, turn)) < 1e-6
        assert state.axes == (0.0,) * 6

    def test_it_follows_no_faster_than_it_may(self):
        rig = Rig(cutoff_hz=0.0, max_speed_m_s=0.5)
        rig.frame()
        rig.frames(0.1, hand())
        last = HOME
        for _ in range(10):
            state = rig.frame(hand(position=moved(0.08)))
            assert state.pose is not None
            assert norm(subtract(state.pose.position, last)) <= 0.5 * PERIOD_S * 1.001
            last = state.pose.position
        assert last.x > 0.04

    @pytest.mark.parametrize("rate_hz", [30.0, 110.0, 200.0])
    def test_the_filter_acts_in_true_time(self, rate_hz):
        rig = Rig(cutoff_hz=2.0, cutoff_rise_1_m=0.0)
        rig.frame()
        rig.frames(0.1, hand())
        start_s = rig.now_s
        stamp_us = round(rig.now_s * 1e6)
        for step in range(1, int(0.2 * rate_hz) + 1):
            rig.now_s = start_s + step / rate_hz
            frame_us = stamp_us + round(1e6 * step / rate_hz)
            rig.tell(TrackingFrame(1000 + step, frame_us, rate_hz, (hand(position=moved(0.05)),)))
        state = rig.state
        assert state.pose is not None
        expected = 0.05 * (1.0 - math.exp(-math.tau * 2.0 * (rig.now_s - start_s)))
        assert state.pose.position.x == pytest.approx(expected, rel=0.02)

    def test_noise_is_smoothed_at_rest_and_motion_followed(self):
        rig = Rig()
        rig.frame()
        spread = 0.0
        for step in range(300):
            state = rig.frame(hand(position=moved(0.001 * (-1) ** step)))
            if step > 100 and state.pose is not None:
                spread = max(spread, abs(state.pose.position.x))
        assert spread < 0.0004
        for step in range(110):
            state = rig.frame(hand(position=moved(0.5 * step * PERIOD_S)))
        assert state.pose is not None
        assert 0.5 * 109 * PERIOD_S - state.pose.position.x < 0.02


class TestDiagnosis:
    def test_counts_and_figures(self):
        rig = engaged()
        rig.tell(Malformed("that are not JSON"), Malformed("that are not JSON"))
        rig.frame(unreadable=1)
        rig.frame(hand(), frame_id=1)
        rig.frame(hand(position=Vector3(0.0, 0.0, 5.0)))
        rig.frame(hand(position=moved(0.5)))
        rig.frame(hand(confidence=0.1))
        figures = rig.core.metrics(rig.now_s)
        for name, count in (
            ("malformed_messages", 2),
            ("unreadable", 1),
            ("old_frames", 1),
            ("absurd", 1),
            ("jumps", 1),
            ("unsure", 1),
            ("hands_lost", 0),
        ):
            assert figures[name] == count, name
        assert figures["frame_age_s"] == pytest.approx(0.0)
        assert figures["service_rate_hz"] == 110.0
        lines = rig.core.diagnosis(rig.now_s)
        assert "2 messages that are not JSON, ignored" in lines
        assert "clutch" in rig.state.buttons

    def test_in_good_order_there_is_nothing_to_say(self):
        assert engaged().core.diagnosis(0.0) == []


class TestOptions:
    @pytest.mark.parametrize(
        ("field", "value", "words"),
        [
            ("hand", "both", "it must be one of first, left, right"),
            ("clutch", "fist", "it must be one of still, open, grab, pinch"),
            ("host", "", "host: '' is not allowed"),
            ("port", 0, "it must be 1 to 65535"),
            ("version", 8, "it must be 1 to 7"),
            ("min_confidence", 1.5, "it must be 0 to 1"),
            ("min_visible_s", -1.0, "it must be 0 to 10"),
            ("cutoff_hz", math.nan, "cutoff_hz: nan is not allowed"),
            ("cutoff_rise_1_m", -1.0, "cutoff_rise_1_m: -1.0 is not allowed"),
            ("max_speed_m_s", 0.0, "it must be above 0, at most 10 m/s"),
            ("max_speed_m_s", math.inf, "it must be above 0, at most 10 m/s"),
        ],
    )
    def test_what_is_not_allowed(self, field, value, words):
        with pytest.raises(ValueError, match=words):
            LeapOptions(**{field: value})


messages = st.one_of(
    st.builds(
        TrackingFrame,
        st.none() | st.integers(0, 50),
        st.none() | st.integers(0, 10**7),
        st.none(),
        st.lists(
            st.builds(
                hand,
                st.integers(1, 3),
                st.builds(Vector3, *[st.floats(-3.0, 3.0)] * 3),
                grab_strength=st.none() | st.floats(-1.0, 2.0),
                pinch_strength=st.none() | st.floats(0.0, 1.0),
                confidence=st.none() | st.floats(0.0, 1.0),
                type=st.sampled_from(["left", "right", ""]),
                time_visible_s=st.none() | st.floats(0.0, 1.0),
            ),
            max_size=2,
        ).map(tuple),
        st.integers(0, 1),
    ),
    st.builds(DeviceEvent, st.just("LP1"), st.just(""), st.booleans(), st.booleans()),
    st.just(Malformed("that are not JSON")),
    st.none(),
)


@settings(max_examples=examples(60))
@given(
    st.sampled_from(["still", "open", "grab", "pinch"]),
    st.lists(st.tuples(st.floats(0.0, 0.15), messages), max_size=60),
)
def test_whatever_comes_the_state_is_consistent(clutch, story):
    rig = Rig(clutch=clutch, min_visible_s=0.0)
    held: set[str] = set()
    good_s = rig.now_s
    for pause_s, message in story:
        rig.now_s += pause_s
        if message is not None:
            rig.tell(message)
        state = rig.state
        if isinstance(message, TrackingFrame):
            good_s = rig.now_s
        for event in rig.core.events():
            assert (event.button in held) != event.pressed
            held ^= {event.button}
        assert held == state.buttons
        assert state.axes == (0.0,) * 6
        assert bool(state.reason) == (state.link is not DeviceLink.LIVE)
        if state.link is not DeviceLink.LIVE:
            assert state.pose is None
            assert not state.buttons
        if "clutch" in state.buttons:
            assert state.pose is not None
            assert rig.now_s - good_s <= 0.1


@pytest.mark.parametrize("clutch", ["grab", "pinch", "open"])
def test_a_hand_in_view_is_told_when_the_service_is_back(clutch):
    shown = {"open": FIST}.get(clutch, {})
    rig = Rig(clutch=clutch)
    assert rig.frames(1.0, hand(**shown)).link is DeviceLink.LIVE
    rig.core.on_lost("gone", rig.now_s)
    rig.core.on_opened(rig.now_s)
    rig.tell(PLUGGED)
    state = rig.frames(1.0, hand(**shown))
    assert state.link is DeviceLink.LIVE
    assert "hand" in state.buttons
    assert "clutch" not in state.buttons
