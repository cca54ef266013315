"""The same targets under atheris, which follows the branches that an input takes.

atheris (Apache-2.0) is installed for development where it has a wheel; `python -m fuzz --engine
atheris` asks for it. Its process ends itself, so that the outcome is written on the way.
"""

from __future__ import annotations

import json
import logging
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from fuzz.run import Finding, Outcome, _place, table_of


def run_guided(name: str, seed: str, inputs: int) -> None:
    """Run a share; its outcome is the last line of the output."""
    import atheris

    with atheris.instrument_imports(include=["cardan"]):
        from fuzz.run import population_of
        from fuzz.targets import target_named

        target = target_named(name)
    from fuzz.target import joined, packets_of, split, tried

    folder = Path(tempfile.mkdtemp(prefix="cardan-fuzz-"))
    for number, given in enumerate(population_of(target)):
        (folder / str(number)).write_bytes(joined(given) if isinstance(given, tuple) else given)
    outcome = Outcome(name)
    seen: set[object] = set()
    places: set[str] = set()
    begin_s = time.process_time()

    def one(data: bytes) -> None:
        given: Any = split(data) if packets_of(target) else data[: target.longest]
        outcome.inputs += 1
        try:
            seen.add(tried(target, given))
        except Exception as error:
            where = _place(error)
            if where not in places:
                places.add(where)
                what = f"{type(error).__name__}: {error}"
                outcome.findings.append(Finding(name, what[:400], where, given))
        if outcome.inputs == inputs:
            outcome.seconds, outcome.kinds = time.process_time() - begin_s, len(seen)
            print(json.dumps(table_of(outcome)), flush=True)

    number = str(sum(seed.encode()) + 1)
    words = [f"-runs={inputs}", f"-seed={number}", f"-max_len={target.longest}", str(folder)]
    atheris.Setup([sys.argv[0], *words], one)
    atheris.Fuzz()


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    run_guided(sys.argv[1], sys.argv[2], int(sys.argv[3]))
