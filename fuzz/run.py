"""Runs targets: many inputs in this process, or shares of them in several."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from fuzz.corpus import input_of, line_of, stored
from fuzz.mutate import Mutator
from fuzz.target import HangError, Input, Target, Watch, cpu_s, packets_of, size_of, tried

MAX_INPUTS = 512
"""Inputs with outcomes of their own that are damaged further in one run."""

ROOM_BYTES = 768 << 20
"""Address space that a run may take beyond what it has at its beginning. A length field that is
believed asks for more."""

MOST_FINDINGS = 20
"""Different findings after which a run ends."""


@dataclass
class Finding:
    """An input that broke a property."""

    target: str
    what: str
    where: str
    given: Input

    @property
    def line(self) -> str:
        """For a corpus file, with a name to be made better."""
        return line_of(self.what[:80], self.given)


@dataclass
class Outcome:
    """A run of one target."""

    target: str
    inputs: int = 0
    seconds: float = 0.0
    """CPU time."""
    kinds: int = 0
    """Outcomes that differ in kind."""
    findings: list[Finding] = field(default_factory=list)


def population_of(target: Target) -> list[Input]:
    """Its good inputs and those that are kept."""
    found = [*target.seeds(), *(each.given for each in stored(target.name))]
    return found or [() if packets_of(target) else b""]


def run(target: Target, seed: str, inputs: int, seconds: float = float("inf")) -> Outcome:
    """Give `target` at most `inputs` damaged inputs, in at most `seconds` of this process's time.

    The same `seed` gives the same inputs as long as corpus and target are the same.
    """
    outcome = Outcome(target.name)
    mutator = Mutator(target, Random(seed), population_of(target))
    seen: set[object] = set()
    places: set[str] = set()
    begin_s = time.process_time()
    with Watch() as watch:
        for given in list(mutator.population):
            _try(target, given, outcome, seen, places)
            watch.count += 1
        while outcome.inputs < inputs:
            if not outcome.inputs & 0x3 and time.process_time() - begin_s > seconds:
                break
            given = mutator.next()
            known = len(seen)
            _try(target, given, outcome, seen, places)
            watch.count += 1
            if len(seen) > known and len(seen) < MAX_INPUTS and size_of(given) < 8192:
                mutator.population.append(given)
            if len(outcome.findings) >= MOST_FINDINGS:
                break
    outcome.seconds = time.process_time() - begin_s
    outcome.kinds = len(seen)
    return outcome


def _try(
    target: Target, given: Input, outcome: Outcome, seen: set[object], places: set[str]
) -> None:
    outcome.inputs += 1
    try:
        seen.add(tried(target, given))
    except (Exception, HangError) as error:
        where = _place(error)
        if where not in places:
            places.add(where)
            what = f"{type(error).__name__}: {error}"
            outcome.findings.append(Finding(target.name, what[:400], where, given))


def _place(error: BaseException) -> str:
    """Return the place where an error was raised, by which findings are told apart."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [each for each in frames if f"{os.sep}cardan{os.sep}" in each.filename] or list(frames)
    last = [f"{Path(each.filename).name}:{each.lineno}" for each in own[-2:]]
    return f"{type(error).__name__} at {' < '.join(reversed(last))}"


# -- growth ---------------------------------------------------------------------------------------

GROWN_BYTES = 4096, 16384, 65536
GROWTH_MOST = 9.0
"""Most times that an input four times as long may take: linear is 4, quadratic 16."""
GROWTH_FROM_S = 0.04
"""Shorter times say nothing of growth."""
MEMORY_PER_BYTE = 400
"""Most memory for each byte of an input: a JSON tree takes some 100 for each of its text."""


def grown(target: Target, given: Input, size: int, rng: Random) -> Input:
    """`given`, a piece of it repeated until it has about `size` bytes."""
    if isinstance(given, tuple):
        if not given:
            return ()
        at = rng.randrange(len(given))
        packet = given[at]
        long = bytes(grown(target, packet, size, rng)) if packet else b""
        return (*given[:at], long, *given[at + 1 :])
    if not given:
        return bytes(size)
    begin = rng.randrange(len(given))
    end = begin + 1 + rng.randrange(min(len(given) - begin, 64))
    piece = given[begin:end]
    times = max(1, (size - len(given)) // len(piece))
    return given[:begin] + piece * times + given[end:]


def check_growth(target: Target, seed: str, rounds: int) -> Outcome:
    """Check that time and memory grow with the input's size and no faster."""
    outcome = Outcome(target.name)
    rng = Random(seed)
    population = population_of(target)
    begin_s = time.process_time()
    for _ in range(rounds):
        given, state = rng.choice(population), rng.getrandbits(64)
        took: list[float] = []
        for size in GROWN_BYTES:
            if size > target.longest:
                break
            long = grown(target, given, size, Random(state))
            outcome.inputs += 1
            try:
                took.append(cpu_s(target, long))
                _check_memory(target, long)
                if len(took) > 1 and took[-1] > max(GROWTH_FROM_S, GROWTH_MOST * took[-2]):
                    again = [cpu_s(target, long) for _ in range(2)]
                    before = grown(target, given, size // 4, Random(state))
                    slower = min(took[-1], *again) / max(cpu_s(target, before), took[-2], 1e-9)
                    assert slower <= GROWTH_MOST, f"4 times as long takes {slower:.1f} times"
            except Exception as error:
                what = f"{type(error).__name__}: {error}"
                outcome.findings.append(Finding(target.name, what[:400], _place(error), long))
                break
    outcome.seconds = time.process_time() - begin_s
    return outcome


def _check_memory(target: Target, given: Input) -> None:
    tracemalloc.start()
    try:
        cpu_s(target, given)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    most = target.memory + MEMORY_PER_BYTE * size_of(given)
    assert peak <= most, f"{peak} bytes of memory for {size_of(given)} of input"


# -- several processes ----------------------------------------------------------------------------


def limit_memory() -> None:
    """Let this process take ROOM_BYTES more than now."""
    with open("/proc/self/statm", encoding="ascii") as file:
        pages = int(file.read().split()[0])
    most = pages * resource.getpagesize() + ROOM_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


class Job:
    """A share of a target's inputs, in a process of its own; `engine` "own" or "atheris"."""

    def __init__(self, target: Target, seed: str, inputs: int, engine: str = "own") -> None:
        self.target, self.seed = target.name, seed
        self._out = tempfile.TemporaryFile()  # noqa: SIM115 - result() closes it
        if engine == "own":
            self._end = self._fork(target, inputs)
        else:
            words = [sys.executable, "-m", "fuzz.guided", target.name, seed, str(inputs)]
            process = subprocess.Popen(
                words, stdout=self._out, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            self._end = process.poll
        self._code: int | None = None

    def _fork(self, target: Target, inputs: int) -> Callable[[], int | None]:
        """A copy of this process, which has all that it needs already."""
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                limit_memory()
                found = json.dumps(table_of(run(target, self.seed, inputs)))
                os.write(self._out.fileno(), found.encode() + b"\n")
                code = 0
            finally:
                os._exit(code)

        def end() -> int | None:
            done, status = os.waitpid(pid, os.WNOHANG)
            return os.waitstatus_to_exitcode(status) if done else None

        return end

    def ended(self) -> bool:
        """Return True once the process has ended; its result is read once."""
        self._code = self._end()
        return self._code is not None

    def result(self) -> Outcome:
        """Return the outcome."""
        with self._out:
            self._out.seek(0)
            lines = self._out.read().decode().splitlines()
        if self._code == 0 and lines:
            return outcome_of(json.loads(lines[-1]))
        code = self._code or 0
        what = "the process ended: " + (signal.Signals(-code).name if code < 0 else f"{code}")
        return Outcome(self.target, findings=[Finding(self.target, what, self.seed, b"")])


def table_of(outcome: Outcome) -> dict[str, Any]:
    """As JSON has it."""
    return {
        "target": outcome.target,
        "inputs": outcome.inputs,
        "seconds": outcome.seconds,
        "kinds": outcome.kinds,
        "findings": [
            {"what": each.what, "where": each.where, "line": line_of(each.what[:80], each.given)}
            for each in outcome.findings
        ],
    }


def outcome_of(table: dict[str, Any]) -> Outcome:
    """From JSON."""
    findings = [
        Finding(table["target"], each["what"], each["where"], input_of(json.loads(each["line"])))
        for each in table["findings"]
    ]
    return Outcome(table["target"], table["inputs"], table["seconds"], table["kinds"], findings)


def shares(total: int, rates: dict[str, float]) -> dict[str, int]:
    """Inputs for each target, `total` in all: by the root of its speed, so that the slow ones get
    more of the time and the fast ones more of the inputs."""
    roots = {name: max(rate, 1.0) ** 0.5 for name, rate in rates.items()}
    whole = sum(roots.values())
    return {name: max(1, round(total * root / whole)) for name, root in roots.items()}


def pieces(target: str, seed: int, inputs: int, most: int) -> Iterator[tuple[str, int]]:
    """Seeds and numbers of the jobs that a target's inputs are done in."""
    for number in range(-(-inputs // most)):
        yield f"{seed}:{target}:{number}", min(most, inputs - number * most)
