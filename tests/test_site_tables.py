"""Tables of the site: inserted at each marker; the repository's page has a line in their place."""

from __future__ import annotations

import re
import shlex

import pytest

from cardan.cli.common import page_path
from cardan.common.troubles import AREAS, troubles
from cardan.sim_peers import registry as peers
from tests import docs_tables, site_tables
from tests.command_line import the_command_line
from tests.docs_tables import ROOT
from tests.site_tables import TABLES

MARKER = re.compile(r"<!-- site table: (.*) -->")
PAGES = sorted({table.page for table in TABLES.values()})


def source(page):
    return (ROOT / page).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES)
def test_the_page_has_a_line_in_the_place_of_each_table(page):
    text = source(page)
    assert site_tables.unfilled(page, text) == text, "python -m tests.site_tables rewrites it"


def test_no_page_has_a_marker_that_nothing_fills():
    found = {
        (path.relative_to(ROOT).as_posix(), name)
        for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("plugins/*/*.md"))
        for name in MARKER.findall(path.read_text(encoding="utf-8"))
    }
    assert found == {(table.page, name) for name, table in TABLES.items()}


def tables_of(text):
    """Return the lines of each table in a text."""
    return [each.strip().splitlines() for each in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)]


def cells_of(row):
    return len(re.findall(r"(?<!\\) \| ", row)) + 1


@pytest.mark.parametrize("page", PAGES)
def test_the_site_has_a_table_in_each_place(page):
    text = site_tables.read(page)
    for name, table in TABLES.items():
        if table.page == page:
            _, _, rest = text.partition(site_tables.begin(name))
            made = rest.partition(docs_tables.END)[0]
            assert made.strip() == table.make().strip()
            for head, ruler, *rows in tables_of(made):
                columns = cells_of(head)
                assert ruler == f"|{'---|' * columns}"
                assert rows
                assert {cells_of(row) for row in rows} == {columns}
            assert name == "codes" or any(tables_of(made))
    assert site_tables.unfilled(page, text) == source(page)


@pytest.mark.parametrize("command", sorted({t.command for t in TABLES.values() if t.command}))
def test_the_command_of_a_line_is_one(command):
    words = shlex.split(command)
    assert words.pop(0) == "cardan"
    found = the_command_line()
    while words and not words[0].startswith("--"):
        if not getattr(found, "commands", None):
            words.pop(0)  # an argument, like the protocol of `conform`
            continue
        found = found.commands[words.pop(0)]
    offered = {option for parameter in found.params for option in parameter.opts}
    assert {*words} <= {*offered, "--help"}


@pytest.mark.parametrize("name", docs_tables.ours(peers))
def test_every_peer_has_its_faults_on_its_page(name):
    if name == "keyboard":
        return  # uses those of the gamepad
    title = "serial devices" if name == "spacemouse-serial" else name
    assert TABLES[f"faults of {title}"].page == page_path(peers.load(name).page)


def test_the_page_of_codes_names_each_letter_and_the_site_has_each_code():
    intro, _, codes = site_tables.read("docs/troubleshooting.md").partition("<!-- site table")
    assert re.findall(r"^- ([A-Z]): (.*)$", intro, re.MULTILINE) == [*AREAS.items()]
    assert re.findall(r"^## (.*)$", codes, re.MULTILINE) == [*AREAS.values()]
    assert re.findall(r"^### (.*)$", codes, re.MULTILINE) == [*troubles()]


def test_a_table_is_printed(capsys):
    site_tables.main(["demos"])
    assert capsys.readouterr().out == docs_tables.demos_table()
