"""Tutorials from the first file to the last command, for a reader with a wheel, an empty folder and
nothing else."""

from __future__ import annotations

import pytest

from tests.tutorials import PAGES, STAND_INS, Reader, follow, steps


@pytest.mark.matrix
@pytest.mark.timeout(900)
@pytest.mark.real("one-device-one-robot")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_tutorial_works(page, tmp_path, wheel, sdist, record_property):
    reader = Reader(tmp_path, wheel, sdist)
    found = list(steps(page.read_text(encoding="utf-8")))
    typed = [line for step in found if not step.aside for line in step.commands]
    asides = {line for step in found if step.aside for line in step.commands}
    said = dict(follow(page, reader))
    assert [line for line in typed if line not in asides] == list(said)
    assert reader.place_of_cardan().parts[-3:] == ("site-packages", "cardan", "__init__.py")
    for line, words in said.items():
        if line.startswith("cardan run") and "--seconds" in line:
            assert "the session's time limit is reached" in words
    for name, what in STAND_INS.items():
        if any(name in step.text for step in found):
            record_property("stand-in", f"{page.stem}: in place of {name}, {what}")


def test_steps_are_files_and_commands_in_their_order():
    page = (
        "Some `word`.\n\n`a.toml`:\n\n```toml\nx = 1\n```\n\nIn a separate terminal:\n\n```\n"
        "cardan sim gamepad\n```\n\n```\ncardan check a.toml\n```\n\n```python\nshown()\n```\n"
    )
    found = [(step.file, step.text, step.aside) for step in steps(page)]
    assert found == [
        ("a.toml", "x = 1\n", False),
        ("", "cardan sim gamepad\n", True),
        ("", "cardan check a.toml\n", False),
    ]
