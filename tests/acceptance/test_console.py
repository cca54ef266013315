"""Simulated user of the console page: problems that it reports, and a run in a browser."""

import threading

import pytest

from cardan.demos.demo import find_remarks
from cardan.gateway.servers.console.site import FOLDER
from tests.acceptance.console import Person, use_console
from tests.console.browser import find_chromium

PICTURES = {"goal", "device", "move", "phone", "plots", "setup"}
SHOWN = "At rest. Enable motion to move it."


def person(tmp_path, done=()):
    """Return a user that has not started and has the steps `done` completed."""
    made = Person("http://127.0.0.1:9/", tmp_path, lambda _line: None, threading.Event())
    made.done += done
    made._shown = SHOWN
    return made


def test_what_was_not_done_at_the_page_is_said_with_what_the_page_said(tmp_path):
    assert person(tmp_path, ["jogged", "at rest", "at the goal"]).problems() == []
    problems = person(tmp_path, ["jogged", "at rest"]).problems()
    assert problems == [f"at the page the arm was never at the goal; it says: {SHOWN}"]
    assert len(person(tmp_path).problems()) == 3


def test_a_browser_that_does_not_start_is_found_fault_with(tmp_path):
    path = tmp_path / "browser"
    path.write_text("#!/bin/sh\nexit 3\n")
    path.chmod(0o755)
    somebody = person(tmp_path)
    somebody.work(str(path))
    assert somebody.problems() == [f"at the page: {path} ended with 3"]


@pytest.mark.real
def test_a_person_moves_the_arm_by_the_page_and_takes_pictures_of_it(tmp_path):
    pytest.importorskip(
        "zenoh", reason="eclipse-zenoh is not installed: pip install cardan[console]"
    )
    if not (FOLDER / "manifest.json").exists():
        pytest.skip("the page is not built: run tools/console")
    browser = find_chromium()
    if browser is None:
        pytest.skip("no Chromium is installed: tools/debian-packages judges")
    lines = []
    last, problems = use_console(browser, tmp_path, 240.0, lines.append, still_s=0.0)
    said = "\n".join(lines)
    # A busy computer misses cycles; that is not what this test checks.
    assert not problems or find_remarks(last), (problems, said)
    assert "X+ was held: the TCP went" in said
    assert "mm above: Reachable" in said
    assert not any("at the page" in each for each in problems), problems
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(made) == {f"console-{name}.png" for name in PICTURES}
    assert all(data.startswith(b"\x89PNG") for data in made.values())
    assert len(set(made.values())) == len(made)
