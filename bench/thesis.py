"""The measurements of the 2020 thesis on a universal teleoperation interface, run on Cardan.

    python -m bench thesis [--plots DIR]

Virtual time at 500 Hz on the simulated arm, with ideal drives and with its dynamics; all random
numbers are seeded. `--plots` also draws the pictures of docs/evaluation.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

from cardan.errors import ExtraMissingError
from studies.thesis import study
from studies.thesis.bench import table


def main() -> None:
    """Print the tables; with `--plots`, draw the pictures."""
    directory = _directory(sys.argv[1:])
    print("\nmet, MISSED: the aim on ideal drives")
    found = study.measure()
    for number, (title, rows) in enumerate(study.tables(found), 1):
        print(table(f"{number}. {title}", rows))
    for refusal in {result.left.refusal for result in found.free[False]} - {""}:
        print(f"   first refusal of a turn: {refusal}")
    if directory is not None:
        try:
            from studies import plotting
            from studies.thesis import plots
        except ExtraMissingError as error:
            print(f"\nno plots: {error}")
            return
        plotting.save(directory, plots.draw(*found))
        print(f"\nplots are in {directory}")


def _directory(words: list[str]) -> Path | None:
    if "--plots" not in words:
        return None
    index = words.index("--plots") + 1
    if index == len(words):
        sys.exit("--plots: a directory has to follow")
    return Path(words[index])
