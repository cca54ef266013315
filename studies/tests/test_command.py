"""``cardan evaluate`` from the user's side."""

from __future__ import annotations

import sys

import pytest

from cardan import cli
from studies.report import Part, Report, read, write
from studies.result import Figure
from studies.thesis import study

pytestmark = pytest.mark.matrix


def cardan(*words, monkeypatch):
    """Run the command; return its exit code."""
    monkeypatch.setattr(sys, "argv", ["cardan", *map(str, words)])
    return cli._run()


@pytest.fixture
def evaluated(short_thesis, monkeypatch, tmp_path):
    """Run the thesis, which is short, into a folder."""
    asked = []
    monkeypatch.setattr(study, "measure", lambda quick: asked.append(quick) or short_thesis)

    def run(name, *words):
        folder = tmp_path / name
        code = cardan("evaluate", *words, "--only", "thesis", "-o", folder, monkeypatch=monkeypatch)
        return code, folder

    run.asked = asked
    return run


def test_a_study_becomes_a_report_with_pictures(evaluated, capsys):
    pytest.importorskip("matplotlib", reason='matplotlib is not installed: "cardan[evaluate]"')
    code, folder = evaluated("report", "--quick")
    assert (code, evaluated.asked) == (0, [True])
    assert capsys.readouterr().out.splitlines()[-1] == str(folder / "report.html")
    files = {path.name for path in folder.iterdir()}
    pictures = {f"thesis-{name}.{ending}" for ending in ("svg", "png")
                for name in ("line", "eight", "collision", "arbitrary", "faults")}  # fmt: skip
    assert files == {"report.html", "report.md", "report.json", *pictures}
    text = (folder / "report.md").read_text("utf-8")
    for name in pictures:
        assert (f"({name})" in text) is name.endswith(".png")
    assert "of 0.05 m instead of 0.5 m" in text
    assert (folder / "report.html").read_text("utf-8").count("data:image/svg+xml") == 5
    (part,) = read(folder).parts
    assert part.seeds[0] == "eight-course's camera: 2020"


def test_two_reports_are_compared(monkeypatch, capsys, tmp_path):
    def report(name, value):
        part = Part("thesis", "t", "s", figures=[Figure("delay", value, "ms", "less", 2.0, 350.0)])
        (tmp_path / name).mkdir()
        write(Report(True, "then", {}, {}, [part]), tmp_path / name)
        return tmp_path / name

    old, new = report("old", 30.0), report("new", 12.0)
    assert cardan("evaluate", "--compare", old, new, monkeypatch=monkeypatch) == 0
    said = capsys.readouterr().out
    assert "better" in said
    assert said.splitlines()[-1] == "1 better, 0 worse, 0 the same, 0 not judged"
    folder = tmp_path / "compared"
    words = ("evaluate", "--compare", new, old, "-o", folder)
    assert cardan(*words, monkeypatch=monkeypatch) == 0
    assert "**WORSE**" in (folder / "comparison.md").read_text("utf-8")


def test_what_is_no_study_or_makes_no_sense_is_refused(monkeypatch, capsys, tmp_path):
    for words, said in (
        (("--only", "dance"), "there is no study 'dance'; allowed: thesis, motoros"),
        (("--compare", tmp_path, tmp_path, "--quick"), "leave --quick and --only out"),
        (("--compare", tmp_path, tmp_path), "cannot read"),
    ):
        assert cardan("evaluate", *words, "-o", tmp_path / "x", monkeypatch=monkeypatch) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
