"""``python -m fuzz [TARGET...] --inputs N --seed S --jobs J``"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import time
from collections import deque
from pathlib import Path

from fuzz import servers
from fuzz.corpus import FOLDER
from fuzz.run import Job, Outcome, check_growth, pieces, run, shares
from fuzz.targets import targets

MEASURED_S = 0.1
"""CPU time in which a target's speed is measured before the inputs are shared out."""

PIECE = 100_000
"""Most inputs of one process: what one leaves behind ends with it."""


def main() -> None:
    """Fuzz."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help="all, or some by name")
    parser.add_argument("--inputs", type=int, default=10_000_000, help="in all (default: 10^7)")
    parser.add_argument("--seed", type=int, default=1, help="the same seed gives the same inputs")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes at once")
    parser.add_argument("--engine", choices=("own", "atheris"), default="own")
    parser.add_argument("--list", action="store_true", help="name the targets and the servers")
    parser.add_argument("--table", type=Path, help="write a table of the results to this file")
    arguments = parser.parse_args()
    logging.disable(logging.CRITICAL)
    known = targets()
    if arguments.list:
        print("\n".join([*known, *servers.SERVERS]))
        return
    names = arguments.targets or [*known, *servers.SERVERS]
    if wrong := [each for each in names if each not in known and each not in servers.SERVERS]:
        parser.error(f"there is no target {', '.join(wrong)}; --list names them")
    outcomes = fuzz([each for each in names if each in known], arguments)
    for name in names:
        if name in servers.SERVERS:
            outcome = servers.SERVERS[name](f"{arguments.seed}:{name}", servers.CONNECTIONS)
            _say(outcome)
            outcomes.append(outcome)
    _end(outcomes, arguments.table)


def fuzz(names: list[str], arguments: argparse.Namespace) -> list[Outcome]:
    """All inputs of these targets, in several processes."""
    known = targets()
    rates: dict[str, float] = {}
    for name in names:
        tried = run(known[name], f"{arguments.seed}:speed", 10**9, MEASURED_S)
        rates[name] = tried.inputs / max(tried.seconds, 1e-6)
    jobs = deque(
        (name, seed, inputs)
        for name, share in shares(arguments.inputs, rates).items()
        if names
        for seed, inputs in pieces(name, arguments.seed, share, PIECE)
    )
    left = {name: sum(1 for each in jobs if each[0] == name) for name in names}
    found = {name: Outcome(name) for name in names}
    running: list[Job] = []
    while jobs or running:
        while jobs and len(running) < arguments.jobs:
            name, seed, inputs = jobs.popleft()
            running.append(Job(known[name], seed, inputs, arguments.engine))
        time.sleep(0.02)
        for job in [each for each in running if each.ended()]:
            running.remove(job)
            whole, part = found[job.target], job.result()
            whole.inputs += part.inputs
            whole.seconds += part.seconds
            whole.kinds = max(whole.kinds, part.kinds)
            places = {each.where for each in whole.findings}
            whole.findings += [each for each in part.findings if each.where not in places]
            left[job.target] -= 1
            if not left[job.target]:
                grown = check_growth(known[job.target], f"{arguments.seed}:grown", 30)
                whole.findings += grown.findings
                whole.inputs += grown.inputs
                _say(whole)
    return list(found.values())


def _say(outcome: Outcome) -> None:
    rate = outcome.inputs / max(outcome.seconds, 1e-9)
    words = f"{len(outcome.findings)} findings" if outcome.findings else ""
    print(f"{outcome.target:28}{outcome.inputs:10}{rate:10.0f}/s  {words}", flush=True)
    for finding in outcome.findings:
        print(f"    {finding.what[:300]}\n    at {finding.where}\n    {finding.line[:2000]}")


def _end(outcomes: list[Outcome], table: Path | None) -> None:
    inputs = sum(each.inputs for each in outcomes)
    findings = sum(len(each.findings) for each in outcomes)
    print(f"{len(outcomes)} targets, {inputs} inputs, {findings} findings")
    if findings:
        print(f"a finding that is mended is kept in {FOLDER}, as a line of its target's file")
    if table is not None:
        rows = [
            f"| `{each.target}` | {each.inputs} | {each.inputs / max(each.seconds, 1e-9):.0f} "
            f"| {each.kinds} | {len(each.findings)} |"
            for each in outcomes
        ]
        head = [
            "| target | inputs | inputs/s | kinds of outcome | findings |",
            "|---|--:|--:|--:|--:|",
        ]
        table.write_text("\n".join([*head, *rows, ""]))
    sys.exit(1 if findings else 0)


if __name__ == "__main__":
    main()
