"""The proximity rule in virtual time."""

import re

import pytest
from hypothesis import given, strategies as st

from cardan.types import NEVER_S, ZERO_TWIST, Frame, Twist, Vector3
from cardan_filters.listener import Sender
from cardan_filters.proximity import (
    MAX_SENDERS,
    PeakFilter,
    ProximityFilter,
    ProximityOptions,
)
from filter_states import robot_at
from test_filters_readings import flat, skin_text

ASKED = Twist(Vector3(0.1, -0.02, 0.03), Vector3(0.4, 0.0, -0.2), Frame.TOOL)
HALF = Twist(Vector3(0.05, -0.01, 0.015), Vector3(0.2, 0.0, -0.1), Frame.TOOL)


def guard(*readings, at_s=10.0, **options):
    made = ProximityFilter(ProximityOptions(**{"peak_filter": False, **options}))
    for data in readings:
        made.listener.take(data, at_s)
    return made


def test_without_options_it_is_the_published_rule():
    options = ProximityOptions()
    assert (options.alert_high, options.alert_low) == (800, 100)
    assert (options.half_speed, options.peak_filter, options.when_stale) == (True, True, "stop")


@pytest.mark.parametrize(
    ("level", "result", "words"),
    [
        (b"0", ASKED, ""),
        (b"100", ASKED, ""),
        (b"100.5", HALF, "above 100: half speed"),
        (b"3 800 5", HALF, "proximity 800, above 100: half speed"),
        (b"3 801 5", ZERO_TWIST, "proximity 801, above 800: stopped"),
        (skin_text(flat(0x383)), ZERO_TWIST, "proximity 899, above 800: stopped"),
    ],
)
def test_the_largest_value_decides(level, result, words):
    made = guard(level)
    assert made.apply(ASKED, robot_at(10.1)) == result
    assert words in made.status()
    assert bool(made.status()) is bool(words)


def test_half_speed_can_be_switched_off():
    made = guard(b"800", half_speed=False)
    assert made.apply(ASKED, robot_at(10.1)) is ASKED
    assert made.status() == ""


def test_the_newest_reading_counts():
    made = guard(b"900", b"0")
    assert made.apply(ASKED, robot_at(10.1)) is ASKED


@pytest.mark.parametrize(
    ("when_stale", "result", "words"),
    [("stop", ZERO_TWIST, "stopped"), ("half", HALF, "half speed"), ("pass", ASKED, "not watched")],
)
def test_silent_sensors(when_stale, result, words):
    made = guard(b"0", when_stale=when_stale)
    assert made.apply(ASKED, robot_at(10.25)) is ASKED
    assert made.apply(ASKED, robot_at(10.5)) == result
    assert made.status() == f"the proximity sensors have been silent for 0.5 s: {words}"
    made.listener.take(b"0", 10.5)
    assert made.apply(ASKED, robot_at(10.5)) is ASKED
    assert made.status() == ""


def test_sensors_never_heard_stop():
    made = guard()
    assert made.status() == "no proximity reading yet: stopped"
    assert made.apply(ASKED, robot_at(10.0)) == ZERO_TWIST


def test_a_silent_sensor_does_not_keep_what_it_said_last():
    made = guard(b"900", when_stale="pass")
    assert made.apply(ASKED, robot_at(11.0)) is ASKED


def test_a_time_that_is_not_a_number_is_stale():
    assert guard(b"0").apply(ASKED, robot_at(float("nan"))) == ZERO_TWIST


def test_bad_bytes_change_nothing_and_keep_nothing_fresh():
    made = guard(b"0")
    made.listener.take(b"900 what", 10.4)
    assert made.apply(ASKED, robot_at(10.2)) is ASKED
    assert made.apply(ASKED, robot_at(10.5)) == ZERO_TWIST
    assert "'what' is not a number" in made.diagnosis()[0]


def test_closing_forgets():
    made = guard(b"0")
    made.close()
    assert made.apply(ASKED, robot_at(10.1)) == ZERO_TWIST


def test_a_spike_is_held_back_and_a_rise_passes_after_four_readings():
    peaks = PeakFilter()
    for _ in range(5):
        assert peaks.apply((10.0, 20.0)) == (10.0, 20.0)
    assert peaks.apply((900.0, 100.0)) == (10.0, 100.0)
    for _ in range(5):
        assert peaks.apply((10.0, 20.0)) == (10.0, 20.0)
    smooth = [peaks.apply((900.0, 20.0))[0] for _ in range(8)]
    assert smooth == [10.0] * 4 + [900.0] * 4


def test_a_rise_from_nothing_is_not_held_back_for_ever():
    made = guard(*[b"0"] * 5, peak_filter=True)
    for count in range(5):
        assert made.apply(ASKED, robot_at(10.1)) is ASKED, count
        made.listener.take(b"900", 10.0)
    assert made.apply(ASKED, robot_at(10.1)) == ZERO_TWIST


def test_a_reading_of_another_length_starts_anew():
    peaks = PeakFilter()
    for _ in range(5):
        peaks.apply((1.0,))
    assert peaks.apply((900.0, 900.0)) == (900.0, 900.0)


@given(st.lists(st.tuples(*[st.floats(0, 4094)] * 3), max_size=20))
def test_the_peak_filter_only_gives_what_was_read(readings):
    peaks = PeakFilter()
    for count, values in enumerate(readings):
        for index, value in enumerate(peaks.apply(values)):
            recent = [values[index] for values in readings[max(0, count - 5) : count + 1]]
            assert value in recent


@given(st.floats(0, 5000), st.floats(0, 2), st.sampled_from(["stop", "half"]))
def test_it_never_makes_a_motion_faster(level, age_s, when_stale):
    made = guard(f"{level:f}".encode(), when_stale=when_stale)
    assert made.apply(ASKED, robot_at(10.0 + age_s)) in (ASKED, HALF, ZERO_TWIST)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"host": "skin.local"}, "host: 'skin.local' is not allowed"),
        ({"port": 0}, "port: 0 is not allowed; it must be 1 to 65535"),
        (
            {"alert_low": 900},
            "alert_low: 900 is not allowed; it must be 0 to alert_high, which is 800",
        ),
        ({"alert_low": -1}, "alert_low: -1 is not allowed"),
        ({"alert_high": float("nan")}, "alert_high: nan is not allowed"),
        ({"alert_high": float("inf")}, "alert_high: inf is not allowed"),
        ({"max_age_s": 0}, "max_age_s: 0 is not allowed"),
        ({"max_age_s": 1.5}, "max_age_s: 1.5 is not allowed"),
        (
            {"when_stale": "go"},
            "when_stale: 'go' is not allowed; it must be one of stop, half, pass",
        ),
    ],
)
def test_options_are_checked(options, words):
    with pytest.raises(ValueError, match="allowed") as caught:
        ProximityOptions(**options)
    assert words in str(caught.value)


def test_it_says_what_it_would_do():
    assert guard(port=6601).describe() == (
        "stop above 800, half speed above 100, stop without a reading for 0.3 s, "
        "readings on UDP 127.0.0.1:6601"
    )
    assert guard(socket="/run/skin").describe().endswith("readings on /run/skin")
    assert guard().describe().endswith("/cardan-proximity.sock")


SKIN, OTHER = Sender("", 100), Sender("127.0.0.1", 50000)


class Senders:
    """A filter in virtual time: each sender repeats its reading 20 times a second."""

    def __init__(self, **options):
        self.filter = guard(**options)
        self.now_s = 10.0

    def run(self, seconds, says, asked=ASKED):
        """Return the motion after `seconds` in which every sender repeats its reading."""
        for tick in range(round(seconds / 0.004)):
            self.now_s += 0.004
            if tick % 12 == 0:
                for sender, level in says.items():
                    self.filter.listener.take(level, self.now_s, sender)
            result = self.filter.apply(asked, robot_at(self.now_s))
        return result


@pytest.mark.parametrize("real", [SKIN, OTHER], ids=["the first", "the second"])
@pytest.mark.parametrize("level", [(b"900", ZERO_TWIST), (b"250", HALF), (b"20", ASKED)])
def test_of_several_senders_the_most_cautious_one_decides(real, level):
    foreign = OTHER if real is SKIN else SKIN
    senders = Senders()
    assert senders.run(5.0, {real: level[0], foreign: b"20"}) == level[1]
    (words,) = (line for line in senders.filter.diagnosis() if "most cautious" in line)
    assert "process 100" in words
    assert "127.0.0.1:50000" in words


def test_a_sensor_that_falls_silent_is_not_replaced_by_another_sender():
    senders = Senders()
    senders.run(1.0, {SKIN: b"900", OTHER: b"20"})
    for _ in range(20):
        assert senders.run(1.0, {OTHER: b"20"}) == ZERO_TWIST
    assert senders.filter.status() == (
        "one of 2 senders of proximity readings has been silent for 20.0 s: stopped; to go on "
        "without it, ask for no motion for 1 s"
    )


def test_neither_is_one_that_saw_nothing():
    senders = Senders()
    senders.run(1.0, {SKIN: b"0", OTHER: b"20"})
    assert senders.run(0.2, {OTHER: b"20"}) is ASKED
    assert senders.run(0.4, {OTHER: b"20"}) == ZERO_TWIST


def test_a_sensors_program_that_starts_anew_goes_on_once_the_operator_has_let_go():
    senders, again = Senders(), Sender("", 101)
    senders.run(1.0, {SKIN: b"0"})
    assert senders.run(5.0, {again: b"0"}) == ZERO_TWIST
    senders.run(0.9, {again: b"0"}, ZERO_TWIST)
    assert senders.run(0.1, {again: b"0"}) == ZERO_TWIST
    senders.run(1.1, {again: b"0"}, ZERO_TWIST)
    assert senders.run(0.1, {again: b"0"}) is ASKED
    assert senders.filter.status() == ""


def test_the_rest_that_is_asked_for_is_enough():
    senders = Senders()
    senders.run(1.0, {SKIN: b"0", OTHER: b"20"})
    assert senders.run(0.6, {OTHER: b"20"}) == ZERO_TWIST
    asked_for = re.search(r"for no motion for ([0-9.]+) s", senders.filter.status())
    assert asked_for is not None
    rest_s = float(asked_for[1])
    assert 1.0 < rest_s < 2.0
    senders.run(rest_s, {OTHER: b"20"}, ZERO_TWIST)
    assert senders.run(0.1, {OTHER: b"20"}) is ASKED


def test_a_short_silence_while_the_operator_rests_forgets_nobody():
    senders = Senders()
    senders.run(1.0, {SKIN: b"900", OTHER: b"20"})
    senders.run(1.9, {OTHER: b"20"}, ZERO_TWIST)
    assert senders.run(0.2, {OTHER: b"20"}) == ZERO_TWIST
    assert senders.run(0.2, {OTHER: b"20", SKIN: b"900"}) == ZERO_TWIST


def test_nobody_is_forgotten_while_nobody_is_heard():
    senders = Senders()
    senders.run(1.0, {SKIN: b"0", OTHER: b"20"})
    senders.run(10.0, {}, ZERO_TWIST)
    assert senders.run(0.1, {}) == ZERO_TWIST
    assert "the proximity sensors have been silent" in senders.filter.status()
    assert senders.run(0.1, {SKIN: b"0"}) == ZERO_TWIST
    assert senders.run(0.1, {SKIN: b"0", OTHER: b"20"}) is ASKED


@pytest.mark.parametrize(
    ("when_stale", "level", "result"),
    [
        ("half", b"20", HALF),
        ("half", b"900", ZERO_TWIST),
        ("pass", b"20", ASKED),
        ("pass", b"250", HALF),
        ("pass", b"900", ZERO_TWIST),
    ],
)
def test_what_one_silent_sender_does_is_the_users_to_say(when_stale, level, result):
    senders = Senders(when_stale=when_stale)
    senders.run(1.0, {SKIN: b"900", OTHER: level})
    assert senders.run(1.0, {OTHER: level}) == result


def test_too_many_senders_stop_it_and_a_crowd_that_is_gone_is_forgotten():
    senders = Senders()
    crowd = {Sender("", number): b"0" for number in range(MAX_SENDERS + 1)}
    assert senders.run(1.0, crowd) == ZERO_TWIST
    assert senders.filter.status() == "more than 8 programs send proximity readings: stopped"
    assert senders.run(5.0, {SKIN: b"0"}) == ZERO_TWIST
    senders.run(5.0, {SKIN: b"0"}, ZERO_TWIST)
    assert senders.run(0.1, {SKIN: b"0"}) is ASKED


def test_a_reading_of_unknown_age_makes_no_sender():
    made = guard()
    made.listener.take(b"0", NEVER_S, SKIN)
    assert made.apply(ASKED, robot_at(10.0)) == ZERO_TWIST
    assert made.status() == "no proximity reading yet: stopped"


@given(
    st.lists(
        st.tuples(st.sampled_from([SKIN, OTHER]), st.floats(0, 5000), st.floats(0, 0.5)),
        max_size=30,
    )
)
def test_a_second_sender_never_makes_a_motion_faster(readings):
    """Readings of a second sender never make the motion faster than with the skin alone."""
    alone, both = guard(), guard()
    now_s = 10.0
    for sender, level, wait_s in readings:
        now_s += wait_s
        data = f"{level:f}".encode()
        both.listener.take(data, now_s, sender)
        if sender == SKIN:
            alone.listener.take(data, now_s, sender)
        results = [each.apply(ASKED, robot_at(now_s)).linear.x for each in (alone, both)]
        if alone.listener.heard:
            assert results[1] <= results[0]
