"""Numbers are inserted into pages between their markers, completely or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench import pages

pytestmark = pytest.mark.matrix

DOCS = Path(__file__).parents[1] / "docs"
PAGE = "# A\n\n<!-- one -->\n\nold\n\n<!-- end -->\n\ntext\n\n<!-- two -->\nold\n<!-- end -->\n"


def test_a_part_is_replaced_and_nothing_else():
    page = pages.replaced(PAGE, "one", "| new |\n")
    assert page == PAGE.replace("\n\nold\n\n", "\n\n| new |\n\n", 1)
    assert pages.replaced(page, "one", "| new |") == page
    assert pages.marked("one", "| new |") in page


@pytest.mark.parametrize("name", ["three", "end"])
def test_a_part_that_is_not_there_or_is_there_twice(name):
    with pytest.raises(ValueError, match=f"<!-- {name} -->"):
        pages.replaced(PAGE, name, "new")


def test_a_page_is_rewritten_whole_or_not_at_all(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(PAGE, encoding="utf-8")
    with pytest.raises(ValueError, match="three"):
        pages.rewrite(path, {"one": "new", "three": "new"})
    assert path.read_text(encoding="utf-8") == PAGE
    pages.rewrite(path, {"one": "new", "two": "newer"})
    found = path.read_text(encoding="utf-8")
    assert "old" not in found
    assert found.index("new") < found.index("newer")


@pytest.mark.parametrize(
    ("page", "names"),
    [
        ("stability.md", ["plain and ours", "grids", "earlier", "zwidth", "faults"]),
        ("measurements.md", ["timing"]),
    ],
)
def test_the_pages_have_the_parts_in_their_order(page, names):
    text = (DOCS / page).read_text(encoding="utf-8")
    at = [text.index(pages.begin(name)) for name in names]
    assert at == sorted(at)
    for name in names:
        assert "new" in pages.replaced(text, name, "new")
