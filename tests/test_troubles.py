"""Codes of messages: their table, the sources of the messages, and `cardan explain`."""

from __future__ import annotations

import ast
import io
import json
import re
from itertools import pairwise

import pytest
from rich.console import Console

from cardan.cli import main
from cardan.cli.common import page_path
from cardan.cli.doctor import _lines
from cardan.common import troubles
from cardan.common.tables import parse_toml
from cardan.doctor.base import caution
from cardan.gateway.daemon.view import why
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.terminal_view import plain, render
from tests import message_texts
from tests.docs_commands import BLOCK
from tests.message_texts import VALUE
from tests.sentences import LONGEST, begun_with_a_pronoun, sentences

TABLE = troubles.troubles()
WRITTEN = parse_toml(troubles.FILE.read_text(encoding="utf-8"), troubles.FILE)
"""The same entries with all keys of the file."""


@pytest.fixture(scope="module")
def said():
    return message_texts.messages()


def test_codes_are_in_order_and_none_is_used_again():
    written = dict(WRITTEN)
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
    entry = WRITTEN[code]
    assert tuple(entry) == troubles.Trouble._fields[1:]
    assert entry["words"]
    for key in ("cause", "now", "do"):
        assert entry[key].endswith("."), key
        assert entry[key][0].isupper() or not entry[key][0].isalpha(), key
        assert 4 <= len(entry[key]) <= 240, key
        assert max(map(len, sentences(entry[key]))) <= LONGEST, key
        assert begun_with_a_pronoun(entry[key]) == [], key


def codes_in(text):
    """Return the codes in a text, without the quick test of `code_of`."""
    sayings = troubles.sayings()
    return {code for words, _, code in sayings if troubles.pattern(words).search(text)}


def test_each_of_their_messages_is_said_somewhere(said):
    together = "\n".join(said)  # each is a single line
    unsaid = [
        (code, words)
        for words, _, code in troubles.sayings()
        if not re.search(troubles.pattern(words).pattern, together, re.MULTILINE)
    ]
    assert unsaid == []


def test_a_message_has_one_code_at_most_and_it_is_found(said):
    doubts = {}
    for text, place in said.items():
        codes = codes_in(text)
        if len(codes) > 1 or {troubles.code_of(text)} - {None} != codes:
            doubts[text] = (place, codes)
    assert doubts == {}


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


SHOWN = re.compile(r"^ *cardan(?: \w+)?: (?!WARNING)(\S.*)$", re.MULTILINE)


def is_said(words, said):
    """Return whether the sources contain this message, with any values."""
    return any(
        max(parts, key=len) in words and re.search(".*".join(map(re.escape, parts)), words)
        for parts in (text.split(VALUE) for text in said)
        if len(re.findall(r"[a-z]{2,}", " ".join(parts))) > 1
    )


def test_messages_that_pages_show_are_said_and_have_their_codes(said):
    shown = {
        message: path.name
        for path in (message_texts.ROOT / "docs").glob("*.md")
        for language, block in BLOCK.findall(path.read_text(encoding="utf-8"))
        for message in SHOWN.findall(block)
        if not language
    }
    assert len(shown) > 15
    bare = {message: re.sub(r" \[[A-Z]\d{3}\]$", "", message) for message in shown}
    assert {each: troubles.coded(bare[each]) for each in shown} == {each: each for each in shown}
    # For a disallowed value, the rest is a separate text: the allowed values.
    parts = {each.partition("is not allowed; it must be ")[2] or each for each in bare.values()}
    assert {part for part in parts if not is_said(part, said)} == set()


def test_people_are_shown_the_code():
    """Codes are also shown where no error ends the command: in the views of sessions and of the
    daemon."""
    off = "the motors are off"
    ends = f"{off} [{troubles.code_of(off)}]"
    snapshot = Snapshot.of(
        {
            "diagnosis": ["the cap rests off zero, at (1, 2) counts: re-zero"],
            "arm": {"message": off},
        }
    )
    console = Console(file=io.StringIO(), width=140)
    console.print(render(snapshot))
    assert ends in console.file.getvalue()
    assert plain(snapshot).endswith(f"| {ends}")
    assert why({"reason": "", "why": off, "state": "running"}) == ends


def test_a_code_that_is_there_is_not_said_again():
    once = troubles.coded("nothing can be done: there is no such key; did you mean 'x'?")
    assert once.endswith(" [S002]")
    assert troubles.coded(once) == once


def test_a_finding_of_the_doctor_has_both_codes():
    finding = caution("real-time", "real-time scheduling is not allowed", "why", "mend")
    assert _lines(finding)[0].plain.endswith("is not allowed  [real-time, S021]")


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
    for text in (entry.cause, entry.now, entry.do, page_path(entry.page)):
        assert text in printed.out


def test_explain_as_json(monkeypatch, capsys):
    _, printed = run(monkeypatch, capsys, "explain", "S001", "--json")
    assert json.loads(printed.out) == {**TABLE["S001"]._asdict(), "words": [*TABLE["S001"].words]}


@pytest.mark.parametrize(
    ("asked", "near"), [("S0001", "S001"), ("R999", "R009"), ("motors off", "R004")]
)
def test_explain_names_what_is_near(monkeypatch, capsys, asked, near):
    code, printed = run(monkeypatch, capsys, "explain", asked)
    assert code == 2
    assert printed.err.startswith(f"cardan: no entry is known for {asked!r}; near it: ")
    assert near in printed.err
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
