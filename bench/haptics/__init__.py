"""Force feedback: stability, Z-width, faults as the hand feels them, and timing.

    python -m bench haptics [--plots DIR]

The first three run in virtual time: the simulated Omni, its libHD and the compiled tick, with a
robot at a wall behind a channel that is late, uneven and lossy. The timing is real. Everything is
printed as the tables of docs/stability.md and docs/measurements.md; `--plots` also draws the
pictures, and nothing else is written.
"""

from __future__ import annotations

import sys
from pathlib import Path

from bench.haptics import faults, stability, timing, zwidth
from bench.haptics.stability import HELD, LIGHTLY, PUSHES, compare


def main() -> None:
    """Print the tables, and draw where it is asked for."""
    directory = _directory(sys.argv[1:])
    pushed = [
        (push, compare(push.hand, *push.calm), compare(push.hand, *push.pushed)) for push in PUSHES
    ]
    print(f"\n### Plain and ours\n\n{stability.table(pushed)}\n")
    grids = [stability.grid(hand) for hand in (HELD, LIGHTLY)]
    channel, sampling = stability.channel_grid(), stability.sampling_grid()
    for points in grids:
        print(f"- {stability.summary('stiffness and delay', points)}")
    print(f"- {stability.summary('jitter and loss', channel)}")
    print(f"- {stability.summary('stiffness and sampling', sampling)}")
    widths = zwidth.measure()
    print(f"\n### Z-width, N/m\n\n{zwidth.table(widths)}")
    felt = [faults.feel(fault) for fault in faults.FAULTS]
    print(f"\n### What the hand feels\n\n{faults.table(felt)}")
    print(f"\n### Timing\n\n{timing.measure()}")
    if directory is not None:
        try:
            from bench.haptics import plots
        except ImportError as error:
            print(f"\nno plots: {error}; pip install 'cardan[bench]'")
            return
        plots.draw(directory, grids, channel, sampling, widths, felt)
        print(f"\nplots are in {directory}")


def _directory(words: list[str]) -> Path | None:
    if "--plots" not in words:
        return None
    index = words.index("--plots") + 1
    if index == len(words):
        sys.exit("--plots: a directory has to follow")
    return Path(words[index])
