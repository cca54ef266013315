"""The site of the documentation, as far as it can be tested without a build (make docs builds
it)."""

from __future__ import annotations

import re
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]


def tool(name: str) -> ModuleType:
    """Import a program of tools/ as a module."""
    loader = SourceFileLoader(f"tools_{name}", str(ROOT / "tools" / name))
    spec = spec_from_loader(loader.name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    loader.exec_module(module)
    return module


def test_every_page_is_in_the_navigation():
    """Each section of docs/index.md is in the navigation, with the pages that it links."""
    index = ROOT / "docs" / "index.md"
    sections = index.read_text(encoding="utf-8").partition("\n## ")[2]
    linked = {
        (index.parent / target).resolve() for target in re.findall(r"\]\(([^)#]+\.md)\)", sections)
    }
    pages = {
        *ROOT.glob("*.md"),
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "examples").rglob("README.md"),
        *(ROOT / "plugins").rglob("README.md"),
    }
    assert {path.resolve() for path in pages} - {index.resolve()} == linked


@pytest.fixture
def site(tmp_path):
    (tmp_path / "one.html").write_text(
        '<a href="two.html#there">x</a><a href="#here">y</a><p id="here"></p><img src="a.svg">'
        '<a href="https://example.org/nobody-asks">z</a>'
    )
    (tmp_path / "two.html").write_text('<h1 id="there"></h1><a href="one.html">x</a>')
    (tmp_path / "a.svg").write_text("<svg/>")
    return tmp_path


def test_links_that_lead_somewhere_are_fine(site):
    assert list(tool("docs").broken(site)) == []


@pytest.mark.parametrize(
    ("link", "why"),
    [
        ("three.html", "three.html is not there"),
        ("two.html#nowhere", "two.html#nowhere has no such place"),
        ("#nowhere", "#nowhere has no such place"),
        ("pictures/b.png", "pictures/b.png is not there"),
    ],
)
def test_a_link_that_leads_nowhere_is_named(site, link, why):
    with (site / "one.html").open("a") as page:
        page.write(f'<a href="{link}">w</a>')
    assert list(tool("docs").broken(site)) == [f"one.html: {why}"]


def test_the_picture_of_the_demo_moves_and_is_small():
    """make demo-picture updates it."""
    data = (ROOT / "docs" / "images" / "demo.webp").read_bytes()
    assert data[:4] + data[8:12] == b"RIFFWEBP"
    assert data.count(b"ANMF") > 100
    assert len(data) <= 300_000
