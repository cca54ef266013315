"""Reports: written, read back, incomplete, and compared."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

from cardan.errors import ConfigurationError, ExtraMissingError
from studies import comparison, conditions, document, report as reporting
from studies.comparison import Verdict
from studies.document import Heading, Paragraph, Picture, Points
from studies.report import Part, Report
from studies.result import Figure, Result, Table, known, spread_of, table_of
from studies.studies import STUDIES, Study, chosen

TABLE = Table(
    "A <table>", ("", "pub|lished"), (("**bold**", "`code|`"), ("a_b", "<1 & 2>")), "note"
)


class Fake(Study):
    """A study that returns or raises the given value."""

    def run(self, quick):
        if isinstance(self.module, Exception):
            raise self.module
        return self.module


def fake(what, name="thesis"):
    return Fake(name, f"title of {name}", f"source of {name}", what)


def result(*figures, **more):
    return Result("how it was", (TABLE,), figures, **more)


def evaluated(folder, *studies, quick=True):
    said = []
    found = reporting.evaluate(studies, quick, folder, said.append)
    return found, said


# -- documents ---------------------------------------------------------------------------------


def test_markdown_marks_what_is_meant_and_nothing_else():
    text = document.markdown([Heading(2, "a|b"), Points(("one", "**two**")), TABLE])
    assert text.startswith(
        "## a\\|b\n\n- one\n- **two**\n\n**A \\<table\\>**\n\n|  | pub\\|lished |\n"
    )
    assert "| **bold** | `code\\|` |\n| a\\_b | \\<1 & 2\\> |\n\nnote\n" in text


def test_the_page_needs_no_other_file(tmp_path):
    (tmp_path / "one.svg").write_text("<svg/>")
    blocks = [Heading(1, "T"), Paragraph("`x` < **y**"), Picture("one", "a 'picture'"), TABLE]
    page = document.page("<T>", blocks, tmp_path)
    assert "<title>&lt;T&gt;</title>" in page
    assert "<p><code>x</code> &lt; <strong>y</strong></p>" in page
    assert 'src="data:image/svg+xml;base64,PHN2Zy8+"' in page
    assert "<td>&lt;1 &amp; 2&gt;</td>" in page
    assert "http" not in page


def test_a_markdown_table_is_read_as_values():
    found = table_of("t", "| a | b |\n|---|---|\n| 1 | |\n| **2** | x |\n")
    assert found == Table("t", ("a", "b"), (("1", ""), ("**2**", "x")))


def test_what_is_not_finite_is_not_known():
    assert [known(x) for x in (None, float("nan"), float("inf"), 0.0)] == [None, None, None, 0.0]
    assert spread_of([3.0, 1.0, float("nan")]) == 2.0
    assert spread_of([], 0.5) == spread_of([1.0], 0.5) == 0.5


# -- reports -----------------------------------------------------------------------------------


def test_a_report_says_how_and_where_it_was_measured(tmp_path):
    study = fake(
        result(seeds=("x: 7",), shortened=("half of it",), left_out=("a rocket: no fuel",))
    )
    _, said = evaluated(tmp_path, study)
    text = (tmp_path / "report.md").read_text("utf-8")
    for words in (
        "how it was",
        "- seed of x: 7",
        "- shortened by --quick: half of it",
        "- **left out here:** a rocket: no fuel",
        "| thesis | source of thesis | measured, parts left out |",
        f"| processors | {conditions.machine()['processors']} |",
        f"| python | {conditions.versions()['python']} |",
        "length: --quick: shorter",
    ):
        assert words in text
    assert said[0] == "thesis: title of thesis"
    assert "pub|lished" in (tmp_path / "report.html").read_text("utf-8")


def test_what_is_missing_or_breaks_off_is_said_and_the_rest_is_measured(tmp_path):
    found, said = evaluated(
        tmp_path,
        fake(ExtraMissingError("flying", "wings", "air", "no wings"), "thesis"),
        fake(ValueError("the joint is stuck"), "motoros"),
        fake(result(Figure("f", 1.0)), "devices"),
    )
    missing, failed, measured = found.parts
    assert 'pip install "cardan[air]"' in missing.missing
    assert failed.failed == "ValueError: the joint is stuck"
    assert found.failed == [failed]
    assert measured.figures == [Figure("f", 1.0)]
    text = (tmp_path / "report.md").read_text("utf-8")
    assert "**Not measured here:** flying needs wings" in text
    assert "**It broke off:** ValueError: the joint is stuck" in text
    assert any(line.startswith("motoros: NOT MEASURED") for line in said)


def test_without_matplotlib_there_are_tables_and_it_is_said(tmp_path):
    def draw():
        raise ExtraMissingError("a report's pictures", "matplotlib", "evaluate", "none")

    found, _ = evaluated(tmp_path, fake(result(draw=draw)), fake(result(draw=draw), "haptics"))
    assert [part.pictures for part in found.parts] == [[], []]
    text = (tmp_path / "report.md").read_text("utf-8")
    assert text.count("**No pictures:** a report's pictures needs matplotlib") == 1
    assert "| **bold** |" in text


def test_what_was_measured_is_kept_where_its_picture_cannot_be_drawn(tmp_path):
    pytest.importorskip("matplotlib", reason='matplotlib is not installed: "cardan[evaluate]"')

    def draw():
        raise IndexError("no such point")

    found, _ = evaluated(tmp_path, fake(result(draw=draw)))
    assert found.parts[0].failed == "IndexError: no such point"
    text = (tmp_path / "report.md").read_text("utf-8")
    assert "**It broke off:** IndexError: no such point\n\nhow it was\n" in text
    assert "| **bold** |" in text


def test_what_was_measured_before_an_end_is_kept(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        evaluated(
            tmp_path, fake(result()), SimpleNamespace(name="x", title="", source="", run=stop)
        )
    assert [part.name for part in reporting.read(tmp_path).parts] == ["thesis"]


def stop(_quick):
    raise KeyboardInterrupt


def test_one_that_ends_before_anything_is_measured_leaves_no_empty_report(tmp_path):
    endless = SimpleNamespace(name="x", title="", source="", run=stop)
    with pytest.raises(KeyboardInterrupt):
        evaluated(tmp_path, endless)
    assert [*tmp_path.iterdir()] == []
    (tmp_path / "report.json").write_text("of before")
    with pytest.raises(KeyboardInterrupt):
        evaluated(tmp_path, endless)
    assert (tmp_path / "report.json").read_text() == "of before"


def test_a_report_is_read_back_as_it_was_written(tmp_path):
    figures = Figure("f", 1.5, "ms", "more", None, 2.0), Figure("g", None)
    found, _ = evaluated(tmp_path, fake(result(*figures, seeds=("s",))))
    assert reporting.read(tmp_path) == reporting.read(tmp_path / "report.json") == found


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "cannot read"),
        ("{", "is no report"),
        ("[]", "of this format"),
        (json.dumps({"format": 0}), "of this format"),
        (json.dumps({"format": reporting.FORMAT, "parts": [{}]}), "is damaged"),
    ],
)
def test_what_is_no_report_is_refused(tmp_path, text, words):
    if text is not None:
        (tmp_path / "report.json").write_text(text)
    with pytest.raises(ConfigurationError, match=words):
        reporting.read(tmp_path / "report.json")


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="nothing can be written"):
        evaluated(tmp_path / "file", fake(result()))


def test_studies_are_chosen_by_name():
    assert [study.name for study in chosen("")] == list(STUDIES)
    assert [study.name for study in chosen("haptics, thesis")] == ["thesis", "haptics"]
    with pytest.raises(ConfigurationError, match="no study 'dance'; allowed: thesis, motoros"):
        chosen("thesis,dance")


# -- two of them -------------------------------------------------------------------------------


def one(*figures, quick=True, load=0.5, **more):
    part = Part("thesis", "t", "s", load=load, figures=list(figures), **more)
    return Report(quick, "then", {"processors": "2"}, {"cardan": "1"}, [part])


@pytest.mark.parametrize(
    ("old", "new", "verdict"),
    [
        (Figure("f", 10.0, "ms", "less", 1.0), Figure("f", 10.9, "ms", "less", 0.5), Verdict.SAME),
        (Figure("f", 10.0, "ms", "less", 1.0), Figure("f", 11.1, "ms", "less", 0.5), Verdict.WORSE),
        (Figure("f", 10.0, "ms", "less", 0.1), Figure("f", 9.0, "ms", "less", 0.5), Verdict.BETTER),
        (Figure("f", 10.0, "ms", "less", 0.1), Figure("f", 9.0, "ms", "less", 2.0), Verdict.SAME),
        (Figure("f", 1.0, "", "more", 0.0), Figure("f", 2.0, "", "more", 0.0), Verdict.BETTER),
        (Figure("f", 1.0, "", "", 0.0), Figure("f", 2.0, "", "", 0.0), Verdict.CHANGED),
        (Figure("f", 1.0, "", "less", None), Figure("f", 9.0, "", "less", 1.0), Verdict.ONCE),
        (Figure("f", 1.0), Figure("f", 1.0 + 1e-12), Verdict.SAME),
        (Figure("f", None), Figure("f", None), Verdict.SAME),
        (Figure("f", None), Figure("f", 0.0), Verdict.NEW),
        (Figure("f", 0.0), Figure("f", None), Verdict.GONE),
    ],
)
def test_a_figure_is_judged_by_its_spread(old, new, verdict):
    (found,) = comparison.compare(one(old), one(new))
    assert found.verdict is verdict


def test_figures_and_studies_that_one_report_lacks():
    found = comparison.compare(one(Figure("a", 1.0)), one(Figure("b", 1.0)))
    assert {each.name: each.verdict for each in found} == {"a": Verdict.GONE, "b": Verdict.NEW}
    broken = one(Figure("a", 1.0), failed="no")
    assert comparison.compare(one(Figure("a", 1.0)), broken) == []
    assert "thesis was not measured in the new report" in comparison.differences(one(), broken)


def test_what_else_is_different_is_said():
    new = one(quick=False, load=3.0)
    new.versions = {"cardan": "2"}
    words = comparison.differences(one(), new)
    assert "version, cardan: 1, then 2" in words
    assert "**length: --quick, then whole: figures differ for that alone**" in words
    assert "load before thesis: 0.5, then 3.0" in words


def test_a_comparison_as_a_document(tmp_path):
    old, new = (
        one(Figure("f", 10.0, "ms", "less", 1.0, 350.0)),
        one(Figure("f", 20.0, "ms", published=350.0)),
    )
    found = comparison.compare(old, new)
    comparison.write(tmp_path / "x", comparison.as_blocks(old, new, found))
    text = (tmp_path / "x" / "comparison.md").read_text("utf-8")
    assert "- 0 better, 1 worse, 0 the same, 0 not judged" in text
    assert "| f | ms | 350 | 10 | 20 | +10 | 1 | **WORSE** |" in text
    assert "<strong>WORSE</strong>" in (tmp_path / "x" / "comparison.html").read_text("utf-8")
