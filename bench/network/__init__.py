"""Cost and latency of the network: publication, sessions, commands, clients of rosbridge.

    python -m bench network [--pages] [--publication] [--session] [--command] [--clients]

Runs all four, or the named ones, and prints the tables of docs/measurements.md. `--pages` also
writes them between the page's markers. Each table compares what was measured in one run.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from bench import pages
from bench.network import clients, publication, session
from studies.cartesian import command

PAGE = Path(__file__).parents[2] / "docs/measurements.md"

PARTS = {
    "publication": lambda: publication.table(
        [publication.measure(rate_hz) for rate_hz in publication.RATES_HZ]
    ),
    "session": lambda: session.table(session.measure()),
    "command": lambda: command.table(command.measure()),
    "clients": lambda: clients.table(clients.measure()),
}


def main() -> None:
    """Measure and print; with `--pages`, write the tables into the page."""
    chosen = [name for name in PARTS if f"--{name}" in sys.argv[1:]] or list(PARTS)
    measured = {}
    for name in chosen:
        before = os.getloadavg()[0]
        body = PARTS[name]()
        if name == "command" and (words := command.left_out()):
            print(f"left out: {words}")
        processors = os.cpu_count()
        body += f"\n\nLoad in the minute before: {before:.1f} on {processors} processors."
        measured[f"network {name}"] = body
        print(pages.marked(f"network {name}", body), end="\n\n", flush=True)
    if "--pages" in sys.argv[1:]:
        pages.rewrite(PAGE, measured)
        print(f"docs/{PAGE.name} has these numbers")
