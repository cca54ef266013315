"""Releases: one version everywhere, notes for it, and no automatic upload or tag."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import cardan
from tests.test_docs_site import tool

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_version_stands_in_one_place():
    project = tomllib.loads(text("pyproject.toml"))
    assert "version" in project["project"]["dynamic"]
    assert project["tool"]["hatch"]["version"]["path"] == "cardan/__init__.py"
    assert tool("release").version() == cardan.__version__


def test_changes_and_citation_are_of_this_version():
    heading, notes = tool("release").notes()
    assert re.fullmatch(
        rf"{re.escape(cardan.__version__)}, (unreleased|\d{{4}}-\d\d-\d\d)", heading
    )
    assert notes
    assert f"\nversion: {cardan.__version__}\n" in text("CITATION.cff")


def test_a_dry_run_tells_the_tag_and_makes_none():
    release = tool("release")
    tag, before = f"v{cardan.__version__}", release.git("tag")
    done = subprocess.run(
        [sys.executable, ROOT / "tools" / "release", "--check"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert f"git tag --sign {tag}" in done.stdout
    assert "Nothing was uploaded." in done.stdout
    assert release.git("tag") == before


def test_what_is_not_ready_is_not_uploaded(monkeypatch, capsys):
    release = tool("release")
    monkeypatch.setattr(sys, "argv", ["release", "--upload"])
    monkeypatch.setattr(release, "obstacles", lambda tag, heading: ["the tree is not clean"])
    monkeypatch.setattr(release.subprocess, "run", lambda *_, **__: pytest.fail("it ran something"))
    assert release.main() == 1
    assert "tools/release: the tree is not clean" in capsys.readouterr().err


def test_the_archive_has_what_its_pages_link():
    included = tomllib.loads(text("pyproject.toml"))["tool"]["hatch"]["build"]["targets"]["sdist"]
    there = {path.name for path in ROOT.glob("*.md")} | {"CITATION.cff", "LICENSE", "docs"}
    assert there <= set(included["include"])


@pytest.mark.parametrize(
    "path", sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.md")), ids=lambda path: path.stem
)
def test_issue_templates_have_a_name_and_say_when(path):
    head = text(str(path.relative_to(ROOT))).split("---\n")[1]
    assert re.search(r"^name: \S", head, re.MULTILINE)
    assert re.search(r"^about: \S", head, re.MULTILINE)
