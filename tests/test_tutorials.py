"""The tutorials, from the first file to the last command, as a person goes through them."""

from __future__ import annotations

import re

import pytest

from tests.docs_commands import AT_ONCE, BY_HAND, RUN
from tests.tutorials import PAGES, follow, steps

pytestmark = pytest.mark.matrix

ELSEWHERE = re.compile(
    r"cardan (?:demo|devices|dissect|doctor|net (?:list|plot|replay)|sim omni)\b|.*\blever\b|pip |"
    r"cp |.*--console\b"
)
"""Commands that other tests run, or that need what is not here: tests/docs_commands.py."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_tutorial_works(page, tmp_path):
    text = page.read_text(encoding="utf-8")
    lines = [line for step in steps(text) for line in step.commands]
    elsewhere = {line for line in lines if ELSEWHERE.match(line)}
    said = dict(follow(page, tmp_path, elsewhere))
    asides = {line for step in steps(text) if step.aside for line in step.commands}
    assert said.keys() | asides | elsewhere == set(lines)
    for line, words in said.items():
        if line.startswith("cardan run"):
            assert "the session's time is over" in words


def test_what_is_left_out_is_in_the_ledger():
    for page in PAGES:
        for step in steps(page.read_text(encoding="utf-8")):
            for line in step.commands:
                if ELSEWHERE.match(line):
                    assert AT_ONCE.match(line) or any(
                        re.match(each, line) for each in (*RUN, *BY_HAND)
                    ), line


def test_steps_are_files_and_commands_in_their_order():
    page = (
        "Some `word`.\n\n`a.toml`:\n\n```toml\nx = 1\n```\n\nIn a terminal of its own:\n\n```\n"
        "cardan sim gamepad\n```\n\n```\ncardan check a.toml\n```\n\n```python\nshown()\n```\n"
    )
    found = [(step.file, step.text, step.aside) for step in steps(page)]
    assert found == [
        ("a.toml", "x = 1\n", False),
        ("", "cardan sim gamepad\n", True),
        ("", "cardan check a.toml\n", False),
    ]
