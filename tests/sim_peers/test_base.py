"""Scripts and fault switches: valid ones, and invalid ones with the reason."""

import contextlib
import gc

import pytest
from hypothesis import given, strategies as st

from cardan.errors import ScriptError
from cardan.sim_peers import base
from cardan.sim_peers.base import (
    FaultSwitch,
    ScriptStep,
    SimulatedPeer,
    TimedActions,
    check_faults,
    load_script,
    parse_faults,
    parse_script,
    serve,
)

VERBS = {"go": "go SPEED", "stop": "stop"}
SWITCHES = (FaultSwitch("drop", "share lost", 0.05, 0.0, 1.0), FaultSwitch("late", "s"))


def test_a_script():
    text = "# a comment\n\n0.5 go 3   # fast\n1 go 'a b'\n1 stop\n"
    assert parse_script(text, VERBS) == (
        ScriptStep(0.5, "go", ("3",)),
        ScriptStep(1.0, "go", ("a b",)),
        ScriptStep(1.0, "stop", ()),
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("soon go", "line 1: 'soon' is not a time"),
        ("1 fly", "go SPEED; stop"),
        ("1", "after the time comes one of"),
        ("2 stop\n1 stop", "line 2: time 1.0 s is before"),
        ("nan stop", "'nan' is not a time"),
        ("-1 stop", "'-1' is not a time"),
        ("1 go 'open", "line 1"),
    ],
)
def test_what_is_no_script(text, words):
    with pytest.raises(ScriptError, match=words):
        parse_script(text, VERBS)


@given(st.text(max_size=60))
def test_any_text_is_a_script_or_a_script_error(text):
    with contextlib.suppress(ScriptError):
        assert all(step.verb in VERBS for step in parse_script(text, VERBS))


def test_scripts_by_name_and_by_file(tmp_path):
    file = tmp_path / "mine"
    file.write_text("1 stop")
    assert load_script("one", {"one": "1 stop"}, VERBS) == load_script(str(file), {}, VERBS)
    with pytest.raises(ScriptError, match=r"'two' is neither a file .* nor one of: one"):
        load_script("two", {"one": ""}, VERBS)


def test_faults():
    assert parse_faults(["drop", "late=0.5"], SWITCHES) == {"drop": 0.05, "late": 0.5}


@pytest.mark.parametrize(
    ("word", "words"),
    [
        ("lose", "there is no fault 'lose'; there are: drop, late"),
        ("lat", "there is no fault 'lat'; there are: drop, late; did you mean 'late'"),
        ("drop=2", "2 is not in 0 to 1"),
        ("drop=nan", "nan is not in"),
        ("drop=", "'' is not a number"),
    ],
)
def test_wrong_faults(word, words):
    with pytest.raises(ScriptError, match=words):
        parse_faults([word], SWITCHES)


def test_a_fault_that_ends_another_needs_it_at_an_earlier_time():
    switches = (
        FaultSwitch("gone", "is away", 3.0),
        FaultSwitch("back", "is here", 4.0, after="gone"),
    )
    assert parse_faults(["gone", "back"], switches) == {"gone": 3.0, "back": 4.0}
    for words in (["back"], ["gone=4", "back"], ["back=2", "gone"]):
        with pytest.raises(ScriptError, match="fault back: needs the fault gone, at an earlier"):
            parse_faults(words, switches)


def test_values_that_did_not_come_from_words_are_checked_too():
    with pytest.raises(ScriptError, match="late"):
        check_faults({"late": -1.0}, SWITCHES)


def test_what_is_done_at_a_time_is_done_once_and_in_order():
    done = []
    actions = {name: lambda name=name: done.append(name) for name in ("estop", "restart", "cut")}
    timed = TimedActions({"estop": 3.0, "restart": 1.0, "drop": 0.5}, actions, (2.0, done.clear))
    assert timed.next_s == 1.0
    assert list(timed.due(0.9)) == []
    times = []
    for time_s, act in timed.due(5.0):
        times.append(time_s)
        act()
    assert times == [1.0, 2.0, 3.0]
    assert done == ["estop"]
    assert timed.next_s == float("inf")
    assert list(timed.due(9.0)) == []


def test_times_count_from_the_start():
    assert TimedActions({"cut": 0.5}, {"cut": print}, start_s=100.0).next_s == 100.5


def test_switches_of_a_kind_have_its_words_and_range():
    assert FaultSwitch.at("estop", "emergency stop").help == "emergency stop at this time, s"
    share = FaultSwitch.share("drop", "share of datagrams lost", 0.1)
    assert share == FaultSwitch("drop", "share of datagrams lost (0..1)", 0.1, 0.0, 1.0)
    assert FaultSwitch.flag("split", "in pieces").help == "in pieces (1: yes)"


class Idle(SimulatedPeer):
    """Peer without clients."""

    endpoint = "nowhere"

    def open(self):
        self.steps = 0

    def step(self, until_s):
        self.steps += 1

    def close(self): ...


def test_what_a_program_has_frozen_stays_so_when_it_has_served(monkeypatch):
    monkeypatch.setattr(base, "ask_for_real_time", lambda: None)
    gc.freeze()
    before = gc.get_freeze_count()
    serve(peer := Idle(), 0.0)
    assert gc.get_freeze_count() > 0.9 * before > 1000
    gc.unfreeze()
    try:
        serve(peer, 0.0)
        assert gc.get_freeze_count() == 0
    finally:
        gc.freeze()
