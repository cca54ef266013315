"""Checks the documentation page of the Cartesian device against the code."""

import re
from pathlib import Path

from cardan.gateway.arm.parameters import RULES
from cardan.gateway.arm.vocab import vocab_text

PAGE = (Path(__file__).parents[3] / "docs" / "cartesian-device.md").read_text(encoding="utf-8")


def test_the_example_runs():
    names = {}
    exec(re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[0], names)
    assert names["arrived"] is True
    assert "out of reach" in names["reason"]
    assert names["answer"] == ""


def test_every_parameter_is_there_with_its_default():
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in PAGE.splitlines()
        if line.startswith("| `cp")
    ]
    assert [(row[0].strip("`"), row[1], row[2].replace("–", ""), row[3]) for row in rows] == [
        (
            vocab_text(rule.key),
            rule.name,
            rule.unit,
            vocab_text(int(rule.default)) if rule.unit == "code" else f"{rule.default:g}",
        )
        for rule in RULES
    ]
