"""A lab under random faults for hours.

    python -m bench soak --hours 2 --seed 1 --output FOLDER

A daemon with four simulated arms, three simulated devices and two servers, each a separate process.
Random scripts move the devices, programs contend for the arms, and processes are killed, stopped,
unplugged and fed with garbage. The rules are checked continuously. The report in the folder is
updated regularly; SIGINT ends the run. Exit status 1: a rule was broken. ``--page`` copies the
report of an earlier run into docs/measurements.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path


def main(words: Sequence[str] | None = None) -> None:
    """Run the soak, and print the report's path."""
    from bench.soak.page import rewrite_page
    from bench.soak.soak import Soak
    from cardan.common.signals import on_ending

    parser = argparse.ArgumentParser("python -m bench soak", description="A lab under faults.")
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--output", type=Path, default=Path("soak"), metavar="FOLDER", help="a new one"
    )
    parser.add_argument(
        "--page", action="store_true", help="put its report in docs/measurements.md"
    )
    options = parser.parse_args(words)
    if options.page:
        rewrite_page(options.output)
        return
    if options.output.exists() and any(options.output.iterdir()):
        parser.error(f"--output: {options.output} has files already: give a new folder")
    soak = Soak(options.output, options.seed, options.hours)
    with on_ending(soak.end):
        broken = soak.run()
    report = soak.watch.folder / "report.md"
    print(report.read_text())
    print(f"{report}: rules broken {broken} times, {len(soak.report.errors)} errors of the soak")
    sys.exit(1 if broken or soak.report.errors else 0)
