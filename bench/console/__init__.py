"""Console page: latency from a press to the robot's datagram, and cost of viewers for a session.

    python -m bench console [--pages] [--finger] [--viewers]

Runs both benchmarks, or the named one, and prints the tables of docs/measurements.md. `--pages`
also writes them between the page's markers.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from bench import pages
from bench.console import finger, viewers

PAGE = Path(__file__).parents[2] / "docs/measurements.md"

PARTS = {
    "finger": lambda: finger.table(finger.measure()),
    "viewers": lambda: viewers.table(viewers.measure()),
}


def main() -> None:
    """Measure and print; with `--pages`, write the tables into the page."""
    chosen = [name for name in PARTS if f"--{name}" in sys.argv[1:]] or list(PARTS)
    measured = {}
    for name in chosen:
        before = os.getloadavg()[0]
        body = PARTS[name]()
        body += f"\n\nLoad in the minute before: {before:.1f} on {os.cpu_count()} processors."
        measured[f"console {name}"] = body
        print(pages.marked(f"console {name}", body), end="\n\n", flush=True)
    if "--pages" in sys.argv[1:]:
        pages.rewrite(PAGE, measured)
        print(f"docs/{PAGE.name} has these numbers")
