"""Force feedback: stability, Z-width, force on the hand after faults, and timing.

    python -m bench haptics [--pages] [--plots DIR] [--virtual]

Everything except the timing runs in virtual time: the simulated Omni, its libHD and the compiled
tick, with a robot at a wall behind a channel with delay, jitter and loss. The timing runs in real
time. The tables of docs/stability.md and docs/measurements.md are printed in the pages' order;
`--pages` also writes them there, `--plots` draws the pictures, and `--virtual` leaves out the
timing, e.g. on a busy machine.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from bench import pages
from cardan.errors import ExtraMissingError
from studies.haptics import earlier, far, faults, stability, timing, zwidth
from studies.haptics.stability import HELD, LIGHTLY, PUSHES, compare

DOCS = Path(__file__).parents[1] / "docs"


def main() -> None:
    """Print the tables; write them and draw the pictures if the options say so."""
    directory = _directory(sys.argv[1:])
    began_s = time.monotonic()
    pushed = [
        (push, compare(push.hand, *push.calm), compare(push.hand, *push.pushed)) for push in PUSHES
    ]
    stable: dict[str, str] = {}
    _show(stable, "plain and ours", stability.table(pushed))
    grids = [stability.grid(hand) for hand in (HELD, LIGHTLY)]
    channel, sampling = stability.channel_grid(), stability.sampling_grid()
    lines = [stability.summary("stiffness and delay", points) for points in grids]
    lines.append(stability.summary("jitter and loss", channel))
    lines.append(stability.summary("stiffness and sampling", sampling))
    _show(stable, "grids", "\n".join(f"- {line}" for line in lines))
    _show(stable, "earlier", earlier.table(earlier.measure()))
    widths = zwidth.measure()
    _show(stable, "zwidth", zwidth.table(widths))
    responses = [faults.feel(fault) for fault in faults.FAULTS]
    _show(stable, "faults", faults.table(responses))
    afar = far.measure()
    _show(stable, "far", far.table(afar))
    measured = {"stability.md": stable}
    if "--virtual" not in sys.argv[1:]:
        _show(measured.setdefault("measurements.md", {}), "timing", timing.measure())
    if "--pages" in sys.argv[1:]:
        for page, parts in measured.items():
            pages.rewrite(DOCS / page, parts)
            print(f"docs/{page} has these numbers")
    if directory is not None:
        try:
            from studies import plotting
            from studies.haptics import plots
        except ExtraMissingError as error:
            print(f"no plots: {error}")
        else:
            plotting.save(directory, plots.draw(grids, channel, sampling, widths, responses, afar))
            print(f"plots are in {directory}")
    print(f"took {time.monotonic() - began_s:.0f} s")


def _show(parts: dict[str, str], name: str, body: str) -> None:
    parts[name] = body
    print(pages.marked(name, body), end="\n\n", flush=True)


def _directory(words: list[str]) -> Path | None:
    if "--plots" not in words:
        return None
    index = words.index("--plots") + 1
    if index == len(words):
        sys.exit("--plots: a directory has to follow")
    return Path(words[index])
