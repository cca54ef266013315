"""Words of a script's step, and steps as timed actions."""

from __future__ import annotations

import contextlib
import math

import pytest
from hypothesis import given, strategies as st

from cardan.errors import ScriptError
from cardan.sim_peers.base import ScriptStep, parse_script
from cardan.sim_peers.motion_profile import SinePeriods, VectorMotion, VectorRamp
from cardan.sim_peers.scripted import MotionScript, ScriptTimeline, StepWords, calling, moving

VERBS = {"go": "go X Y [over SECONDS]", "note": "note WORD", "loop": "loop"}


def words(text: str) -> StepWords:
    return StepWords(ScriptStep(1.5, "go", tuple(text.split())), VERBS)


def timeline(text: str, start_s: float = 0.0) -> ScriptTimeline[str]:
    def read(words: StepWords) -> list[tuple[float, str]]:
        word = words.word("WORD")
        after_s = words.number("SECONDS", 0.0) if words.keyword("twice") else None
        words.end()
        again = [] if after_s is None else [(words.time_s + after_s, word.upper())]
        return [(words.time_s, word), *again]

    return ScriptTimeline(parse_script(text, VERBS), VERBS, read, start_s)


class TestWords:
    def test_are_taken_in_order(self):
        step = words("here 2 -3.5 over 4 loudly")
        assert step.word("WHERE") == "here"
        assert step.numbers(("X", "Y"), -5.0, 5.0) == (2.0, -3.5)
        assert step.over() == 4.0
        assert step.left == ["loudly"]
        assert step.keyword("quietly") is False
        assert step.keyword("loudly") is True
        step.end()

    def test_over_may_be_left_out(self):
        assert words("").over() == 0.0

    def test_a_swing(self):
        assert words("over 2").swing((1.0,), 0.1) == SinePeriods((1.0,), 2.0)
        assert words("over 2 times 3.9 phase 90").swing((1.0,), 0.1) == SinePeriods(
            (1.0,), 2.0, 3, math.pi / 2
        )
        step = words("over 2 phase 90")
        assert step.swing((1.0,), 0.1, phased=False) == SinePeriods((1.0,), 2.0)
        assert step.left == ["phase", "90"]

    @pytest.mark.parametrize(
        ("text", "take", "message"),
        [
            ("", lambda s: s.word("X"), "X is missing; usage: go X Y [over SECONDS]"),
            ("1", lambda s: s.numbers("XY", 0, 1), "Y is missing; usage: go X Y [over SECONDS]"),
            ("a", lambda s: s.number("X"), "X is 'a', must be a number"),
            ("nan", lambda s: s.number("X"), "X is 'nan', must be a number"),
            ("inf", lambda s: s.number("X", 0), "X is 'inf', must be a number from 0"),
            ("3", lambda s: s.number("X", -1, 2), "X is '3', must be a number from -1 to 2"),
            ("by", lambda s: s.needs("over"), "'over' is missing; usage: go X Y [over SECONDS]"),
            ("over", lambda s: s.over(), "SECONDS is missing; usage: go X Y [over SECONDS]"),
            ("a b", lambda s: s.end(), "'a b' is too much; usage: go X Y [over SECONDS]"),
            (
                "over 0.05",
                lambda s: s.swing((), 0.1),
                "SECONDS is '0.05', must be a number from 0.1",
            ),
        ],
    )
    def test_a_complaint_names_the_step(self, text, take, message):
        with pytest.raises(ScriptError) as error:
            take(words(text))
        assert str(error.value) == f"1.5 s go: {message}"

    @given(st.text(max_size=8), st.floats(-9, 9), st.floats(-9, 9))
    def test_a_number_is_in_its_range_or_refused(self, text, one, other):
        lowest, highest = sorted((one, other))
        step = StepWords(ScriptStep(0.0, "go", (text,)), VERBS)
        with contextlib.suppress(ScriptError):
            assert lowest <= step.number("X", lowest, highest) <= highest


class TestTimeline:
    def test_gives_each_action_once_at_its_time(self):
        script = timeline("1 note a\n1 note b\n3 note c")
        assert script.next_due_s == 1.0
        assert list(script.due(0.9)) == []
        assert list(script.due(2.0)) == [(1.0, "a"), (1.0, "b")]
        assert list(script.due(9.0)) == [(3.0, "c")]
        assert script.next_due_s == math.inf

    def test_a_loop_begins_again_and_cuts_what_lasts_longer(self):
        script = timeline("1 note a twice 5\n1.5 note b\n2 loop")
        assert list(script.due(3.6)) == [(1, "a"), (1.5, "b"), (2, "A"), (3, "a"), (3.5, "b")]
        assert script.next_due_s == 4.0

    def test_waits_for_its_start(self):
        script = timeline("1 note a\n2 loop", math.inf)
        assert script.next_due_s == math.inf
        assert list(script.due(100.0)) == []
        script.start(100.0)
        script.start(200.0)
        assert list(script.due(101.0)) == [(101.0, "a")]

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("0 loop", "0 s loop: must be the last step, after 0 s"),
            ("1 loop\n2 note a", "1 s loop: must be the last step, after 0 s"),
            ("1 loop now", "1 s loop: 'now' is too much; usage: loop"),
            ("1 note", "1 s note: WORD is missing; usage: note WORD"),
        ],
    )
    def test_refuses_nonsense(self, text, message):
        with pytest.raises(ScriptError) as error:
            timeline(text)
        assert str(error.value) == message


def test_a_hand_deflects_and_acts_when_each_is_due():
    class Notes(MotionScript[list[object]]):
        def __init__(self, steps) -> None:
            self.motion = VectorMotion((0.0, 0.0), 0.75)
            super().__init__(steps, VERBS, [self.motion])

        def _hold(self, device: list[object], now_s: float) -> None:
            device.append(self.motion.advance(now_s))

        def _read(self, words):
            if words.verb == "go":
                return moving(self.motion, VectorRamp(words.numbers("XY", -9, 9), words.over()))
            return calling("append", words.word("WORD"))

    steps = parse_script("1 go 1 2 over 1\n1.5 note half\n2 note end", VERBS)
    motion = Notes(steps)
    device: list[object] = []
    due = []
    while motion.next_due_s < math.inf:
        due.append(motion.next_due_s)
        motion.advance(due[-1], device)
    assert due == [1.0, 1.5, 2.0]
    assert device == [(0.0, 0.0), "half", (0.5, 1.0), "end", (1.0, 2.0)]
    with pytest.raises(ScriptError, match="1 s note: 'two' is too much"):
        Notes(parse_script("1 note one two", VERBS))
