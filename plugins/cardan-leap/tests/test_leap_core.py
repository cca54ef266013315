"""Device states of the driver from the service's messages, in virtual time."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings, strategies as st

from cardan.spatial import from_rotation_vector, norm, rotation_between, subtract
from cardan.types import DeviceLink, Vector3
from cardan_leap.driver import LeapOptions
from cardan_leap.protocol import DeviceEvent, Hand, Malformed, TrackingFrame, Version
from leap_frames import HOME, PERIOD_S, PLUGGED, Bench, engaged, hand
from tests.examples import examples

FIST = {"grab_strength": 1.0}
PINCH = {"pinch_strength": 1.0}


def moved(x=0.0, y=0.0, z=0.0):
    return Vector3(HOME.x + x, HOME.y + y, HOME.z + z)


class TestLink:
    def test_before_opening(self):
        bench = Bench()
        bench.core.on_closed(bench.now_s)
        assert bench.state.link is DeviceLink.CLOSED
        bench.frame(hand())
        assert bench.state.link is DeviceLink.CLOSED

    def test_empty_frames_make_it_live(self):
        bench = Bench()
        assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
        assert bench.state.reason == "connected, no frame yet"
        state = bench.frame()
        assert (state.link, state.reason) == (DeviceLink.LIVE, "")
        assert state.stamp_s == bench.now_s
        assert bench.core.heard

    def test_it_stays_live_while_nobody_is_in_view(self):
        bench = Bench()
        assert bench.frames(5.0).link is DeviceLink.LIVE

    def test_without_any_frame_it_is_stale(self):
        bench = Bench()
        state = bench.wait(0.1)
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
        bench = Bench(clutch=clutch)
        state = bench.frames(2.0, hand(**posture))
        assert state.link is (DeviceLink.LIVE if rests else DeviceLink.NEEDS_NEUTRAL)
        assert "clutch" not in state.buttons
        if not rests:
            assert state.pose is None
            assert state.buttons == frozenset()
            assert "once" in state.reason
            assert bench.frame().link is DeviceLink.LIVE

    def test_the_other_hand_is_no_obstacle(self):
        bench = Bench(hand="right")
        assert bench.frame(hand(type="left")).link is DeviceLink.LIVE
        other = Bench(hand="right")
        assert other.frame(hand(type="")).link is DeviceLink.NEEDS_NEUTRAL

    def test_a_service_without_devices_is_believed(self):
        bench = Bench()
        bench.core.on_opened(bench.now_s)
        assert bench.frame().link is DeviceLink.LIVE


class TestClutch:
    def test_still(self):
        bench = Bench()
        bench.frame()
        bench.frames(0.25, hand())
        assert bench.state.buttons == {"hand"}
        assert bench.state.pose is not None
        bench.frames(0.1, hand())
        assert bench.state.buttons == {"hand", "clutch"}
        bench.frame(hand(position=moved(0.05)))
        bench.frame(hand(position=moved(0.1), grab_strength=1.0))
        assert bench.state.buttons == {"hand", "clutch", "grab"}
        bench.frame()
        assert bench.state.buttons == frozenset()
        assert bench.state.pose is None
        assert bench.state.link is DeviceLink.LIVE
        assert bench.edges() == ["+hand", "+clutch", "+grab", "-clutch", "-grab", "-hand"]

    def test_a_moving_hand_is_not_still(self):
        bench = Bench()
        bench.frame()
        for step in range(200):
            state = bench.frame(hand(position=moved(0.1 * math.sin(0.05 * step))))
            assert state.buttons == {"hand"}

    @pytest.mark.parametrize("clutch", ["still", "open"])
    @pytest.mark.parametrize("speed_m_s", [0.02, 0.06, 0.2])
    def test_a_hand_that_passes_by_is_not_still(self, clutch, speed_m_s):
        bench = Bench(clutch=clutch)
        bench.frames(0.2, *([hand(**FIST)] if clutch == "open" else []))
        bench.frame()
        for step in range(round(0.4 / speed_m_s / PERIOD_S)):
            state = bench.frame(hand(position=moved(step * PERIOD_S * speed_m_s - 0.2)))
            assert "clutch" not in state.buttons

    def test_a_hand_that_trembles_is_still(self):
        bench = Bench()
        bench.frame()
        for step in range(60):
            bench.frame(hand(position=moved(0.002 * math.sin(step), 0.002 * math.cos(2.0 * step))))
        assert "clutch" in bench.state.buttons

    def test_a_fist_that_was_made_meanwhile_is_no_press(self):
        bench = Bench(clutch="open")
        assert bench.frames(0.2, hand(**FIST)).link is DeviceLink.LIVE
        assert bench.edges() == ["+hand"]
        bench.wait(0.2)
        bench.frames(0.2, hand(**FIST))
        assert bench.state.buttons == {"hand"}
        bench.frame(hand())
        assert "grab" in bench.frame(hand(**FIST)).buttons

    def test_open(self):
        bench = Bench(clutch="open")
        bench.frame()
        bench.frames(1.0, hand(**FIST))
        assert bench.state.buttons == {"hand", "grab"}
        bench.frames(0.25, hand())
        assert bench.state.buttons == {"hand"}
        bench.frames(0.1, hand())
        assert "clutch" in bench.state.buttons
        bench.frame(hand(grab_strength=0.4))
        assert "clutch" in bench.state.buttons
        bench.frame(hand(grab_strength=0.6))
        assert "clutch" not in bench.state.buttons
        bench.frames(0.25, hand())
        assert "clutch" not in bench.state.buttons

    @pytest.mark.parametrize("clutch", ["grab", "pinch"])
    def test_grab_and_pinch_with_hysteresis(self, clutch):
        bench = Bench(clutch=clutch)
        bench.frame()
        strength = f"{clutch}_strength"
        held = []
        for value in (0.0, 0.5, 0.79, 0.81, 0.5, 0.31, 0.29, 0.5, 0.9):
            state = bench.frame(hand(**{strength: value}))
            held.append("clutch" in state.buttons)
            assert (clutch in state.buttons) == held[-1]
        assert held == [False, False, False, True, True, True, False, False, True]

    def test_a_fist_that_comes_into_view_has_to_open_first(self):
        bench = Bench(clutch="grab")
        bench.frame()
        assert bench.frames(1.0, hand(**FIST)).buttons == {"hand", "grab"}
        bench.frame(hand())
        assert "clutch" in bench.frame(hand(**FIST)).buttons

    def test_a_fist_is_no_pinch(self):
        bench = Bench()
        bench.frame()
        bench.frame(hand(grab_strength=0.9, pinch_strength=0.9))
        assert bench.state.buttons == {"hand", "grab"}

    def test_the_pose_is_there_in_every_state_with_the_clutch(self):
        bench = engaged("grab")
        for step in range(300):
            closed = {"grab_strength": 0.5 + 0.5 * math.sin(0.3 * step)}
            hands = [hand(**closed)] * (step % 7 > 0)
            state = bench.frame(*hands, unreadable=step % 7 == 0)
            assert "clutch" not in state.buttons or state.pose is not None


class TestHands:
    def test_a_new_id_engages_anew_and_never_jumps(self):
        bench = engaged()
        before = bench.state.pose
        bench.frame(hand(2, moved(0.3)))
        assert bench.state.buttons == {"hand"}
        assert bench.state.pose is not None
        assert before is not None
        assert bench.state.pose.position == pytest.approx(moved(0.3))
        assert bench.edges() == ["-clutch"]
        bench.frames(0.35, hand(2, moved(0.3)))
        assert bench.edges() == ["+clutch"]

    def test_the_hand_that_came_first_is_followed_whatever_the_order(self):
        bench = Bench()
        bench.frame()
        bench.frames(0.3, hand(5))
        for _ in range(20):
            bench.frame(hand(2, moved(0.0, 0.1)), hand(5))
        assert bench.state.pose is not None
        assert bench.state.pose.position == pytest.approx(HOME)
        bench.frames(0.1, hand(2, moved(0.0, 0.1)))
        assert bench.state.pose is not None
        assert bench.state.pose.position.y == pytest.approx(0.1)

    def test_left_or_right(self):
        bench = Bench(hand="left")
        bench.frame()
        bench.frames(0.5, hand(1))
        assert bench.state.buttons == frozenset()
        assert any("right hand is in view" in line for line in bench.core.diagnosis(bench.now_s))
        bench.frames(0.5, hand(1), hand(2, type="left"))
        assert bench.state.buttons == {"hand", "clutch"}
        bench.frame(hand(1), hand(2, type="right"))
        assert bench.state.buttons == frozenset()

    def test_time_in_view(self):
        bench = Bench()
        bench.frame()
        assert bench.frames(0.1, hand(time_visible_s=0.1)).buttons == frozenset()
        assert bench.frame(hand(time_visible_s=0.2)).buttons == {"hand"}

    def test_time_in_view_by_our_own_clock(self):
        bench = Bench()
        bench.frame()
        unknown = hand(time_visible_s=None, confidence=None)
        assert bench.frames(0.19, unknown).buttons == frozenset()
        assert bench.frames(0.03, unknown).buttons == {"hand"}

    def test_confidence(self):
        bench = Bench(min_confidence=0.5)
        bench.frame()
        assert bench.frames(0.5, hand(confidence=0.4)).buttons == frozenset()
        assert "confidence of only 0.40" in bench.core.diagnosis(bench.now_s)[0]
        assert bench.frame(hand(confidence=0.5)).buttons == {"hand"}

    def test_a_hand_without_type_needs_hand_first(self):
        bare = Hand(3, Vector3(0, 200, 0), Vector3(0, -1, 0), Vector3(0, 0, -1))
        bench = Bench()
        bench.tell(Version(1))
        bench.frame()
        assert bench.frames(0.6, bare).buttons == {"hand", "clutch"}
        assert any("version 1" in line for line in bench.core.diagnosis(bench.now_s))
        other = Bench(hand="left")
        other.frame()
        assert other.frames(0.6, bare).buttons == frozenset()


class TestPose:
    def test_axes_and_attitude(self):
        turn = from_rotation_vector(Vector3(0.1, -0.2, 0.3))
        bench = Bench(cutoff_hz=0.0)
        bench.frame()
        state = bench.frames(0.1, hand(position=Vector3(0.03, -0.0125, 0.21), orientation=turn))
        assert state.pose is not None
        assert state.pose.position == pytest.approx((0.03, -0.0125, 0.21))
        assert norm(rotation_between(state.pose.orientation, turn)) < 1e-6
        assert state.axes == (0.0,) * 6

    def test_it_follows_no_faster_than_it_may(self):
        bench = Bench(cutoff_hz=0.0, max_speed_m_s=0.5)
        bench.frame()
        bench.frames(0.1, hand())
        last = HOME
        for _ in range(10):
            state = bench.frame(hand(position=moved(0.08)))
            assert state.pose is not None
            assert norm(subtract(state.pose.position, last)) <= 0.5 * PERIOD_S * 1.001
            last = state.pose.position
        assert last.x > 0.04

    @pytest.mark.parametrize("rate_hz", [30.0, 110.0, 200.0])
    def test_the_filter_acts_in_true_time(self, rate_hz):
        bench = Bench(cutoff_hz=2.0, cutoff_rise_1_m=0.0)
        bench.frame()
        bench.frames(0.1, hand())
        start_s = bench.now_s
        stamp_us = round(bench.now_s * 1e6)
        for step in range(1, int(0.2 * rate_hz) + 1):
            bench.now_s = start_s + step / rate_hz
            frame_us = stamp_us + round(1e6 * step / rate_hz)
            bench.tell(TrackingFrame(1000 + step, frame_us, rate_hz, (hand(position=moved(0.05)),)))
        state = bench.state
        assert state.pose is not None
        expected = 0.05 * (1.0 - math.exp(-math.tau * 2.0 * (bench.now_s - start_s)))
        assert state.pose.position.x == pytest.approx(expected, rel=0.02)

    def test_noise_is_smoothed_at_rest_and_motion_followed(self):
        bench = Bench()
        bench.frame()
        spread = 0.0
        for step in range(300):
            state = bench.frame(hand(position=moved(0.001 * (-1) ** step)))
            if step > 100 and state.pose is not None:
                spread = max(spread, abs(state.pose.position.x))
        assert spread < 0.0004
        for step in range(110):
            state = bench.frame(hand(position=moved(0.5 * step * PERIOD_S)))
        assert state.pose is not None
        assert 0.5 * 109 * PERIOD_S - state.pose.position.x < 0.02


class TestDiagnosis:
    def test_counts_and_figures(self):
        bench = engaged()
        bench.tell(Malformed("that are not JSON"), Malformed("that are not JSON"))
        bench.frame(unreadable=1)
        bench.frame(hand(), frame_id=1)
        bench.frame(hand(position=Vector3(0.0, 0.0, 5.0)))
        bench.frame(hand(position=moved(0.5)))
        bench.frame(hand(confidence=0.1))
        figures = bench.core.metrics(bench.now_s)
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
        lines = bench.core.diagnosis(bench.now_s)
        assert "2 messages that are not JSON, ignored" in lines
        assert "clutch" in bench.state.buttons

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
    bench = Bench(clutch=clutch, min_visible_s=0.0)
    held: set[str] = set()
    good_s = bench.now_s
    for pause_s, message in story:
        bench.now_s += pause_s
        if message is not None:
            bench.tell(message)
        state = bench.state
        if isinstance(message, TrackingFrame):
            good_s = bench.now_s
        for event in bench.core.events():
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
            assert bench.now_s - good_s <= 0.1


@pytest.mark.parametrize("clutch", ["grab", "pinch", "open"])
def test_a_hand_in_view_is_reported_when_the_service_is_back(clutch):
    shown = {"open": FIST}.get(clutch, {})
    bench = Bench(clutch=clutch)
    assert bench.frames(1.0, hand(**shown)).link is DeviceLink.LIVE
    bench.core.on_lost("gone", bench.now_s)
    bench.core.on_opened(bench.now_s)
    bench.tell(PLUGGED)
    state = bench.frames(1.0, hand(**shown))
    assert state.link is DeviceLink.LIVE
    assert "hand" in state.buttons
    assert "clutch" not in state.buttons
