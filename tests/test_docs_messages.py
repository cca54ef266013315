"""The pages of messages: current, of all sources, and with every message that the pages show."""

import re
from pathlib import Path

import pytest

from tests import docs_messages
from tests.docs_commands import BLOCK
from tests.docs_messages import FOLDER, KINDS, PACKAGE, PAGES, ROOT, home
from tests.test_errors import TREE, parents


@pytest.fixture(scope="module")
def made():
    return docs_messages.pages()


def test_the_pages_are_current(made):
    for name, text in made.items():
        written = (FOLDER / f"{name}.md").read_text(encoding="utf-8")
        assert written == text, "make docs-tables writes it anew"


def test_there_are_no_other_pages():
    assert {path.stem for path in FOLDER.iterdir()} == set(PAGES)
    index = (FOLDER.parent / "messages.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\(messages/(\w+)\.md\)", index)) == set(PAGES)


def test_every_source_belongs_to_a_page_or_says_nothing():
    homeless = [path for path in sorted(PACKAGE.rglob("*.py")) if home(path) is None]
    assert [str(path) for path in homeless if docs_messages.messages_of(path)] == []


def test_every_kind_of_error_has_its_advice():
    bases = {"CardanError", "DriverError"}
    """What to do depends on the message."""
    assert set(KINDS) == set(parents(TREE)) - bases


def patterns(pages):
    """For each message a pattern: names in capitals are values."""
    for text in pages.values():
        for line in text.splitlines():
            cells = re.split(r"(?<!\\)\|", line)
            if len(cells) == 4 and "---" not in line:
                words = re.sub(r"\\(.)", r"\1", cells[1].strip())
                yield re.sub(r"(?:[A-Z][A-Z0-9_]+|\\\.\\\.\\\.)", ".*", re.escape(words))


SHOWN = re.compile(r"^ *cardan(?: \w+)?: (?!WARNING)(\S.*)$", re.MULTILINE)


def test_messages_that_pages_show_are_there(made):
    shown = {
        message: path.name
        for path in [*(ROOT / "docs").glob("*.md")]
        for language, block in BLOCK.findall(path.read_text(encoding="utf-8"))
        for message in SHOWN.findall(block)
        if not language
    }
    assert len(shown) > 15
    anything = re.compile("|".join(sorted(set(patterns(made)), key=len, reverse=True)))
    missing = {message: page for message, page in shown.items() if not anything.search(message)}
    assert missing == {}


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("raise DriverError('no robot at all')", "no robot at all"),
        (
            "raise DriverError(f'no {self._robot.name} within {limit_s:.1f} s')",
            "no NAME within LIMIT s",
        ),
        (
            "raise OptionError('size', 3, 'at most 2')",
            "size: VALUE is not allowed; it must be at most 2",
        ),
        ("WHY_REASON = 'let go of the device once'", "let go of the device once"),
        ("def why():\n    return f'{age_s} s too ' + 'old for this'", "AGE s too old for this"),
    ],
)
def test_a_message_is_found_and_its_values_are_named(source, message, tmp_path, monkeypatch):
    monkeypatch.setattr(docs_messages, "PACKAGE", tmp_path)
    path = tmp_path / "some.py"
    path.write_text(source, encoding="utf-8")
    assert [found.text for found in docs_messages.messages_of(path)] == [message]


@pytest.mark.parametrize(
    "source",
    [
        "def f():\n    '''What is said of a function here.'''",
        "app.command(help='Shows what there is here.')",
        "assert fine, 'this never comes to a user'",
        "PROGRAM = 'texts of some other kind'",
    ],
)
def test_texts_that_are_no_messages_are_left_out(source, tmp_path, monkeypatch):
    monkeypatch.setattr(docs_messages, "PACKAGE", tmp_path)
    path = tmp_path / "some.py"
    path.write_text(source, encoding="utf-8")
    assert docs_messages.messages_of(path) == []


def test_the_pages_name_no_path_of_a_computer(made):
    assert not [text for text in made.values() if re.search(r"/(?:tmp|root|work)/", text)]
    assert Path(PACKAGE).is_dir()
