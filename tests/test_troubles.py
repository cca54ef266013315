"""Codes of messages: the table, the sources that say the messages, and `cardan explain`."""

from __future__ import annotations

import ast
import json
from itertools import pairwise

import pytest

from cardan.cli import main
from cardan.common import troubles
from cardan.common.tables import parse_toml
from tests import message_texts
from tests.message_texts import VALUE

TABLE = troubles.troubles()


@pytest.fixture(scope="module")
def said():
    return message_texts.messages()


def test_codes_are_in_order_and_none_is_used_again():
    written = parse_toml(troubles.FILE.read_text(encoding="utf-8"), troubles.FILE)
    retired = written.pop("retired")
    assert list(written) == list(TABLE)
    assert not set(retired) & set(TABLE)
    areas = list(dict.fromkeys(code[0] for code in TABLE))
    assert areas == list(troubles.AREAS)
    for area in areas:
        numbers = [int(code[1:]) for code in TABLE if code[0] == area]
        assert all(low < high for low, high in pairwise(numbers))
        gone = [int(code[1:]) for code in retired if code[0] == area]
        assert sorted(numbers + gone) == [*range(1, len(numbers + gone) + 1)]
        assert all(code == f"{area}{int(code[1:]):03}" for code in TABLE if code[0] == area)


@pytest.mark.parametrize("code", TABLE)
def test_an_entry_says_all(code):
    entry = parse_toml(troubles.FILE.read_text(encoding="utf-8"), troubles.FILE)[code]
    assert tuple(entry) == troubles.Trouble._fields[1:]
    assert entry["words"]
    for key in ("cause", "now", "do"):
        assert entry[key].endswith("."), key
        assert entry[key][0].isupper() or not entry[key][0].isalpha(), key
        assert 4 <= len(entry[key]) <= 240, key


def test_each_of_their_messages_is_said_somewhere(said):
    unsaid = [
        (code, pattern.pattern)
        for _, pattern, code in troubles.patterns()
        if not any(pattern.search(text) for text in said)
    ]
    assert unsaid == []


def test_no_message_has_two_codes(said):
    doubts = {}
    for text, place in said.items():
        codes = {code for _, pattern, code in troubles.patterns() if pattern.search(text)}
        if len(codes) > 1:
            doubts[text] = (place, codes)
    assert doubts == {}


def test_the_quick_look_finds_what_the_patterns_find(said):
    for text in said:
        codes = {code for _, pattern, code in troubles.patterns() if pattern.search(text)}
        assert {troubles.code_of(text)} - {None} == codes


def test_values_are_left_out():
    message = "cell.toml:27:1: limits.workspace_x_m: (0.7, 0.3) is not allowed; it must be two ends"
    assert troubles.coded(message) == f"{message} [S004]"
    assert troubles.coded("all is well") == "all is well"


def test_the_first_words_that_are_known_count():
    off, moves = "the motors are off", "resynchronizing with the robot; any button ends it"
    assert troubles.code_of(f"{off}; {moves}") == troubles.code_of(off)
    assert troubles.code_of(f"{moves}; {off}") == troubles.code_of(moves) != troubles.code_of(off)


def test_a_message_of_several_lines_has_a_code_in_each():
    lines = "a.b: there is no such key; allowed: c\nd\na.e: is missing: the table needs it"
    assert troubles.coded(lines).split("\n") == [
        "a.b: there is no such key; allowed: c [S002]",
        "d",
        "a.e: is missing: the table needs it [S003]",
    ]


def run(monkeypatch, capsys, *words):
    monkeypatch.setattr("sys.argv", ["cardan", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code, capsys.readouterr()


@pytest.mark.parametrize("asked", ["S002", "s002", "[S002]", "limits.a: there is no such key; b"])
def test_explain_by_code_and_by_words(monkeypatch, capsys, asked):
    code, printed = run(monkeypatch, capsys, "explain", asked)
    assert code == 0
    entry = TABLE["S002"]
    assert printed.out.startswith("S002: ")
    for text in (entry.cause, entry.now, entry.do, f"docs/{entry.page}"):
        assert text in printed.out


def test_explain_as_json(monkeypatch, capsys):
    _, printed = run(monkeypatch, capsys, "explain", "S001", "--json")
    assert json.loads(printed.out) == {**TABLE["S001"]._asdict(), "words": [*TABLE["S001"].words]}


@pytest.mark.parametrize("asked", ["S0001", "there is no such kye"])
def test_explain_names_what_is_near(monkeypatch, capsys, asked):
    code, printed = run(monkeypatch, capsys, "explain", asked)
    assert code == 2
    assert "no entry is known for" in printed.err
    assert "S00" in printed.err
    assert printed.out == ""


@pytest.mark.parametrize(
    ("source", "texts"),
    [
        ("raise E(f'no {a.b} within {c:.1f} s')", [f"no {VALUE} within {VALUE} s"]),
        ("def f():\n    '''Said of a function.'''\n    return 'too ' + old", [f"too {VALUE}"]),
        ("x = f'{a or \"nothing\"} is there'", [f"{VALUE} is there", "nothing"]),
    ],
)
def test_texts_of_a_source(source, texts):
    assert list(message_texts.texts_of(ast.parse(source))) == texts
