"""docs/evaluation.md has a part for each measured table, and shows every picture of its folder."""

from __future__ import annotations

from bench import pages
from studies.report import Part, Report
from studies.result import Figure
from studies.tests.docs_evaluation import IMAGES, PAGE, PICTURES, parts


def test_each_part_has_its_place_in_the_page():
    figures = [Figure("delay", 12.0, "ms", published=350.0), Figure("other", 1.0)]
    report = Report(
        True, "then", {"processors": "2"}, {"cardan": "1", "python": "3"},
        [Part("thesis", "t", "s", seconds=3.0, shortened=["all"], figures=figures)],
    )  # fmt: skip
    page = PAGE.read_text("utf-8")
    for name, body in parts(report).items():
        page = pages.replaced(page, name, body)
    assert "`cardan evaluate --quick` on 2 processors" in page
    assert "| thesis | 3 s | 0.0 | all |" in page
    assert "| thesis | delay | 350 ms | 12 ms |" in page
    assert "| other |" not in page


def test_the_pictures_are_those_of_the_page():
    assert {path.stem for path in IMAGES.iterdir()} == {*PICTURES}
    page = PAGE.read_text("utf-8")
    assert all(f"(images/evaluation/{name}.webp)" in page for name in PICTURES)
