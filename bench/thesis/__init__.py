"""The measurements of the 2020 thesis on a universal teleoperation interface, run on Cardan.

    python -m bench thesis [--plots DIR]

Virtual time at 500 Hz on the simulated arm, with ideal drives and with its dynamics; nothing is
random that is not seeded. `--plots` also draws the pictures of docs/thesis.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

from bench.thesis import arbitrary, collision, eight, faults, line
from bench.thesis.rig import DRIVES, table


def main() -> None:
    """Print the tables, and draw where it is asked for."""
    directory = _directory(sys.argv[1:])
    print("\nmet, MISSED: the aim on ideal drives")
    straight = [line.measure(drive) for drive in DRIVES]
    others = line.simulated()
    print(table("1. straight line, UR5", line.rows(straight[0], straight[1], others)))
    courses = [eight.measure(drive) for drive in DRIVES]
    simulated_s = eight.mechanism(eight.DURATION_S + eight.TAIL_S)
    print(table("2. eight-course, UR5", eight.rows(courses[0], courses[1], simulated_s)))
    hits = [collision.measure(drive) for drive in DRIVES]
    print(table("3. collision, UR5", collision.rows(hits[0], hits[1])))
    free = {
        shaped: [arbitrary.measure(drive, shaped) for drive in DRIVES] for shaped in (False, True)
    }
    rows = [
        *arbitrary.rows("Cartesian device", *free[False]),
        *arbitrary.rows("shaper and servo", *free[True]),
    ]
    print(table("4. arbitrary movements, PR2's right arm", rows))
    for refusal in {result.left.refusal for result in free[False]} - {""}:
        print(f"   first refusal: {refusal}")
    broken = [faults.measure(drive) for drive in DRIVES]
    print(table("5. a disturbed stream of poses, 0.3 m in 3 s, UR5", faults.rows(*broken)))
    if directory is not None:
        try:
            from bench.thesis import plots
        except ImportError as error:
            print(f"\nno plots: {error}; pip install 'cardan[bench]'")
            return
        plots.draw(directory, straight, others, courses, simulated_s, hits, free, broken)
        print(f"\nplots are in {directory}")


def _directory(words: list[str]) -> Path | None:
    if "--plots" not in words:
        return None
    index = words.index("--plots") + 1
    if index == len(words):
        sys.exit("--plots: a directory has to follow")
    return Path(words[index])
