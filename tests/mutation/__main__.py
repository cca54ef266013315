"""Mutation test of the package: ``python -m tests.mutation`` (tools/mutants).

Tests are collected once, and a run with counters records which of them execute which statement. For
each mutant a forked process replaces the code of its function, and runs the tests of the statement
until one fails. A mutant outside functions acts when its module is imported: its process reloads
the tests that import the module, first those that do so directly. The working tree is not changed.
"""

from __future__ import annotations

import argparse
import ast
import builtins
import contextlib
import functools
import gc
import importlib
import importlib.machinery
import importlib.util
import json
import math
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import types
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import pytest

from tests.mutation.areas import AREAS, MATRIX, NO_SURVIVORS, TESTS, equivalents
from tests.mutation.mutants import ROOT, Mutant, instrumented, mutants_of, mutated

PREPARED = (
    *("numpy", "pinocchio", "coal", "daqp", "scipy", "typer", "rich", "websockets", "serial"),
    *("google.protobuf", "zenoh", "cbor2", "asyncio", "unittest.mock"),
)
"""Modules that many tests import, none of the package: loaded once, before the forks."""

KILLED, SURVIVED, ENDLESS, UNSUITED = "killed", "survived", "endless", "unsuited"
"""ENDLESS: time limit exceeded, which counts as killed. UNSUITED: not replaceable in a loaded
function; tried with a reload of its module."""

SLACK_S, SLACK = 15.0, 8.0
"""Time limit of a mutant: SLACK times its tests' usual time, plus SLACK_S."""

MEMORY_BYTES = 4 << 30
"""Memory limit for the tests of a mutant."""

OPTIONS = (
    *("-q", "-o", "addopts=", "--strict-markers", "--tb", "native"),
    *("-p", "no:cacheprovider", "-p", "no:xdist"),
)

Found = dict[str, object]
Tried = TypeVar("Tried", str, int)


class Profile:
    """Plug-in for selection: computing tests and those of MATRIX, with the same examples for each
    mutant and without shrinking."""

    def pytest_ignore_collect(self, collection_path: Path) -> bool | None:
        from conftest import ALL_MATRIX  # loaded by pytest

        if collection_path.is_dir() or str(collection_path.relative_to(ROOT)) in MATRIX:
            return None
        return True if ALL_MATRIX.search(collection_path.read_text(encoding="utf-8")) else None

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        from conftest import part_of

        parts = {str(ROOT / name): ("computing", "matrix") for name in MATRIX}
        items[:] = [
            each for each in items if part_of(each) in parts.get(str(each.path), ("computing",))
        ]

    @pytest.hookimpl(trylast=True)
    def pytest_configure(self) -> None:
        import hypothesis  # Imported late, because pytest rewrites it.

        phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
        hypothesis.settings.register_profile(
            "mutants",
            deadline=None,
            database=None,
            derandomize=True,
            max_examples=25,
            phases=phases,
            suppress_health_check=list(hypothesis.HealthCheck),
        )
        hypothesis.settings.load_profile("mutants")


Functions = dict[tuple[str, tuple[str, int, str]], list[types.FunctionType]]


def functions_that_are_there() -> Functions:
    """Return all loaded functions by file, name, first line and scope."""
    found: Functions = defaultdict(list)
    gc.unfreeze()  # conftest.py freezes objects that collection made.
    for each in gc.get_objects():
        if type(each) is types.FunctionType:
            found[each.__code__.co_filename, _key(each.__code__)].append(each)
    gc.freeze()
    return found


def _key(code: types.CodeType) -> tuple[str, int, str]:
    return code.co_name, code.co_firstlineno, getattr(code, "co_qualname", "")


def codes_of(code: types.CodeType) -> Iterator[types.CodeType]:
    """Yield the nested code objects."""
    for each in code.co_consts:
        if isinstance(each, types.CodeType):
            yield each
            yield from codes_of(each)


def exchange(functions: Functions, path: str, tree: ast.Module) -> bool:
    """Give the file's loaded functions the code of `tree`; return whether that was possible."""
    file, done = str(ROOT / path), False
    for code in codes_of(compile(tree, file, "exec", dont_inherit=True)):
        for function in functions.get((file, _key(code)), ()):
            if function.__code__ != code:
                try:
                    function.__code__ = code
                except ValueError:  # different free variables
                    return False
                done = True
    return done


class Anew(importlib.machinery.SourceFileLoader):
    """Finder and loader of one module, from a syntax tree."""

    def __init__(self, path: str, tree: ast.Module) -> None:
        super().__init__(module_of(path), str(ROOT / path))
        self._tree = tree

    def find_spec(self, name: str, path: object = None, target: object = None):
        return importlib.util.spec_from_loader(name, self) if name == self.name else None

    def get_code(self, name: str) -> types.CodeType:
        return compile(self._tree, self.path, "exec", dont_inherit=True)


class Processes:
    """Pool of forked processes, each with its own callback."""

    def __init__(self, number: int, scratch: Path) -> None:
        self._number, self._scratch = number, scratch
        scratch.mkdir(parents=True)
        self._running: dict[int, tuple[float, Path, Callable[[str, str], None]]] = {}
        self._made = 0

    def start(
        self, work: Callable[[], int], limit_s: float, done: Callable[[str, str], None]
    ) -> None:
        """Run `work` in a process; `done` gets its result, and the text that it wrote."""
        while len(self._running) >= self._number:
            self._wait()
        self._made += 1
        folder = self._scratch / str(self._made)
        folder.mkdir()
        pid = os.fork()
        if pid == 0:
            status = 70
            try:
                os.setsid()
                self._prepare(folder)
                status = work()
            except BaseException:
                say(traceback.format_exc())
            finally:
                os._exit(status)
        self._running[pid] = time.monotonic() + limit_s, folder, done

    @staticmethod
    def _prepare(folder: Path) -> None:
        os.environ["PYTEST_DEBUG_TEMPROOT"] = os.environ["TMPDIR"] = tempfile.tempdir = str(folder)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES,) * 2)
        silence()

    def _wait(self) -> None:
        while True:
            for pid, (end_s, folder, done) in list(self._running.items()):
                ended, status = os.waitpid(pid, os.WNOHANG)
                late = time.monotonic() > end_s
                if not ended and not late:
                    continue
                with contextlib.suppress(ProcessLookupError):  # with all its children
                    os.killpg(pid, signal.SIGKILL)
                if not ended:
                    os.waitpid(pid, 0)
                del self._running[pid]
                code = os.waitstatus_to_exitcode(status) if ended else 0
                text = folder / "told"
                reported = text.read_text() if text.exists() else ""
                shutil.rmtree(folder, ignore_errors=True)
                known = {0: SURVIVED, 3: UNSUITED}
                done(known.get(code, KILLED) if ended else ENDLESS, reported)
                return
            time.sleep(0.005)

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, kind: object, error: object, where: object) -> None:
        """Wait for all, or kill them after an error."""
        for pid in self._running if kind else ():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)
        if not kind:
            self.join()

    def join(self) -> None:
        """Wait for all processes."""
        while self._running:
            self._wait()


def tell(text: str) -> None:
    """Leave `text` for the parent process."""
    Path(os.environ["TMPDIR"], "told").write_text(text, encoding="utf-8")


class Runs:
    """Plug-in that runs the collected tests for each mutant instead of once."""

    def __init__(
        self, mutants: Sequence[Mutant], processes: int, scratch: Path, most_s: float
    ) -> None:
        self.mutants, self.number, self.scratch = mutants, processes, scratch
        self.most_s = most_s
        self.hit: dict[tuple[str, int], set[int]] = defaultdict(set)
        self.took_s: dict[int, float] = {}
        self.results: dict[Mutant, tuple[str, str]] = {}
        self.bad: list[str] = []

    def pytest_internalerror(self, excrepr: object) -> None:
        say(str(excrepr))

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self.items, self.functions = session.items, functions_that_are_there()
        session.testsfailed = 0
        say(f"{len(self.items)} tests read; they are run once, counted")
        with Processes(self.number, self.scratch / "counted") as processes:
            for part in range(self.number):
                processes.start(lambda p=part: self._count(session, p), 3600.0, self._counted)
        with Processes(self.number, self.scratch / "tried") as processes:
            for mutant in self.mutants:
                chosen = self._chosen(mutant)
                if mutant.function and chosen:
                    processes.start(
                        lambda m=mutant, c=chosen: self._try(session, m, c),
                        SLACK_S + SLACK * sum(self.took_s[each] for each in chosen),
                        lambda outcome, reported, m=mutant: self._note(m, outcome, reported),
                    )
                else:
                    self.results[mutant] = UNSUITED, ""
        return True

    def _run(self, session: pytest.Session, numbers: Sequence[int]) -> Iterator[int]:
        for place, number in enumerate(numbers):
            after = self.items[numbers[place + 1]] if place + 1 < len(numbers) else None
            item = self.items[number]
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            yield number

    def _count(self, session: pytest.Session, part: int) -> int:
        """Record the statements that each test runs; leave failing tests out."""
        hits: set[tuple[str, int]] = set()
        builtins._mutant_hit = lambda path, index: hits.add((path, index))  # type: ignore[attr-defined]
        for path in {mutant.path for mutant in self.mutants}:
            exchange(self.functions, path, instrumented(path))
        # Consecutive tests of a module share its fixtures.
        files = sorted({str(item.path) for item in self.items})
        mine = set(files[part :: self.number])
        reported = []
        began_s = time.monotonic()
        wanted = [n for n, item in enumerate(self.items) if str(item.path) in mine]
        for number in self._run(session, wanted):
            now_s = time.monotonic()
            if not session.testsfailed:
                reported.append((number, now_s - began_s, sorted(hits.copy())))
            else:
                reported.append((number, -1.0, []))
            began_s, session.testsfailed = now_s, 0
            hits.clear()
        tell(json.dumps(reported))
        return 0

    def _counted(self, outcome: str, reported: str) -> None:
        if outcome != SURVIVED or not reported:
            raise RuntimeError(f"the run without mutants did not end well: {outcome}")
        for number, took_s, hits in json.loads(reported):
            if took_s < 0:
                say(f"left out, as it fails when it is counted: {self.items[number].nodeid}")
                self.bad.append(self.items[number].nodeid)
                continue
            self.took_s[number] = took_s
            for path, index in hits:
                self.hit[path, index].add(number)

    def seconds(self) -> dict[str, float]:
        """Return the duration of each file's tests."""
        sums: dict[str, float] = defaultdict(float)
        for number, took_s in self.took_s.items():
            sums[str(self.items[number].path)] += took_s
        return dict(sums)

    def _chosen(self, mutant: Mutant) -> list[int]:
        """Return the tests that run its statement: as many as the time allows, file by file, the
        fastest file first."""
        numbers = self.hit.get((mutant.path, mutant.statement), ())
        quickest = sorted(numbers, key=lambda n: (self.took_s[n], n))
        most_s = math.inf if may_not_survive(mutant) else self.most_s
        numbers = within(quickest, self.took_s, most_s)
        sums: dict[str, float] = defaultdict(float)
        for number in numbers:
            sums[str(self.items[number].path)] += self.took_s[number]
        return sorted(numbers, key=lambda n: (sums[str(self.items[n].path)], n))

    def _try(self, session: pytest.Session, mutant: Mutant, numbers: Sequence[int]) -> int:
        if not exchange(self.functions, mutant.path, mutated(mutant)):
            return 3
        for number in self._run(session, numbers):
            if session.testsfailed:
                tell(self.items[number].nodeid)
                return 1
        return 0

    def _note(self, mutant: Mutant, outcome: str, reported: str) -> None:
        self.results[mutant] = outcome, reported
        if outcome == SURVIVED:
            say(f"survived: {mutant.path}:{mutant.line} {mutant.function}: {mutant.change}")


def within(each: Sequence[Tried], took_s: Mapping[Tried, float], most_s: float) -> list[Tried]:
    """Return the first tests that fit into a total of `most_s`, but at least one."""
    found: list[Tried] = []
    for one in each:
        if not found or took_s[one] <= most_s:
            found.append(one)
            most_s -= took_s[one]
    return found


def may_not_survive(mutant: Mutant) -> bool:
    """Return whether its area allows no survivors, in which case all of its tests run."""
    return any(mutant.name.startswith(AREAS[area]) for area in NO_SURVIVORS)


def module_of(path: str) -> str:
    """Return the import name of the file at `path`."""
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


@functools.cache
def imported(path: str) -> frozenset[str]:
    """Yield the modules that the file at `path` imports."""
    found: set[str] = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            found.add(node.module)
            found.update(f"{node.module}.{each.name}" for each in node.names)
    return frozenset(found)


def nearest(path: str, seconds: Mapping[str, float]) -> list[str]:
    """Return the test files in `seconds` that import the module at `path`.

    Direct imports come first, then those through one other module and so on; equal distances are
    ordered by duration.
    """
    package = [str(each.relative_to(ROOT)) for each in (ROOT / "cardan").rglob("*.py")]
    found: list[str] = []
    names, left, modules = {module_of(path)}, set(seconds), set(package)
    while names and left:
        reached = [each for each in left if names & imported(os.path.relpath(each, ROOT))]
        found += sorted(reached, key=lambda each: (seconds[each], each))
        left.difference_update(reached)
        through = {each for each in modules if names & imported(each)}
        modules -= through
        names = {module_of(each) for each in through}
    return found + sorted(left)


def try_anew(
    mutants: Sequence[Mutant],
    seconds: Mapping[str, float],
    bad: Sequence[str],
    processes: Processes,
    most_s: float,
) -> dict[Mutant, tuple[str, str]]:
    """Try the mutants that act at import.

    `seconds`: duration of each test file; `bad`: tests to leave out.
    """
    results: dict[Mutant, tuple[str, str]] = {}
    but = [word for name in bad for word in ("--deselect", name)]

    def work(path: str, tree: ast.Module | None) -> int:
        if tree is not None:
            sys.meta_path.insert(0, Anew(path, tree))
        files = within(nearest(path, seconds), seconds, most_s)
        code = pytest.main([*OPTIONS, "-x", *but, *files], plugins=[Profile()])
        return 0 if code == 0 else 1

    def check(path: str, outcome: str) -> None:
        if outcome != SURVIVED:
            raise SystemExit(f"the tests of {path} fail without a mutant")

    def note(mutant: Mutant, outcome: str, reported: str) -> None:
        results[mutant] = outcome, reported
        if outcome == SURVIVED:
            say(f"survived: {mutant.path}:{mutant.line} {mutant.function}: {mutant.change}")

    took_s: dict[str, float] = {}
    with processes:
        for mutant in mutants:
            path = mutant.path
            if path not in took_s:
                processes.join()
                began_s = time.monotonic()
                processes.start(
                    lambda p=path: work(p, None), 900.0, lambda o, t, p=path: check(p, o)
                )
                processes.join()
                took_s[path] = time.monotonic() - began_s
            processes.start(
                lambda m=mutant: work(m.path, mutated(m)),
                SLACK_S + SLACK * took_s[path],
                lambda o, t, m=mutant: note(m, o, t),
            )
    return results


def silence() -> None:
    """Redirect input and output, except for those of `say`."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(nothing, number)


def say(text: str) -> None:
    """Print on the terminal, bypassing pytest's capture."""
    os.write(_OUT, f"{text}\n".encode())


_OUT = os.dup(2)


def matching(only: Sequence[str]) -> list[str]:
    """Return the files of the areas, or those below the given paths; `path::function` is a part."""
    asked = only or [path for paths in AREAS.values() for path in paths]
    found: set[str] = set()
    for each in asked:
        place = ROOT / each.partition("::")[0]
        if not place.exists():
            raise SystemExit(f"{each}: there is no such file or folder in {ROOT}")
        files = place.rglob("*.py") if place.is_dir() else [place]
        found.update(str(file.relative_to(ROOT)) for file in files)
    return sorted(found)


def with_tests(paths: Iterable[str]) -> list[str]:
    """Return the paths of the files' tests."""
    found: dict[str, None] = {}
    for path in paths:
        for beginning, tests in TESTS.items():
            if path.startswith(beginning):
                found.update(dict.fromkeys(tests))
                break
        else:
            raise SystemExit(f"{path}: tests/mutation/areas.py does not say which tests it has")
    return list(found)


def main() -> int:
    """Return 0 if no mutant survived in the areas without survivors."""
    parser = argparse.ArgumentParser("tools/mutants", description=__doc__)
    parser.add_argument("--sample", type=int, help="so many of the mutants; without it, all")
    parser.add_argument("--seed", type=int, default=0, help="another seed: another sample")
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="PATH", help="file, folder, FILE::FUNCTION"
    )
    parser.add_argument("--area", nargs="+", default=[], choices=AREAS)
    parser.add_argument("--survivors", type=Path, help="of a report; with --tests, of others")
    parser.add_argument("--tests", nargs="+", metavar="PATH", help="those that are run")
    parser.add_argument(
        "--at-most-s", type=float, default=math.inf, help="of tests for each that may survive"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--report", type=Path, help="write the outcome of each as JSON")
    parser.add_argument("--list", action="store_true", help="only say which there are")
    asked = parser.parse_args()
    os.chdir(ROOT)
    parts = (*asked.only, *(path for area in asked.area for path in AREAS[area]))
    parts = parts or tuple(path for paths in AREAS.values() for path in paths)
    paths = matching(parts)
    equal = equivalents()
    mutants = [m for path in paths for m in mutants_of(path)]
    mutants = [m for m in mutants if m.name.startswith(parts) and m.name not in equal]
    there = len(mutants)
    if asked.sample is not None and asked.sample < there:
        mutants = sorted(random.Random(asked.seed).sample(mutants, asked.sample))
    if asked.survivors is not None:
        reported = json.loads(asked.survivors.read_text())
        identity = ("path", "function", "change")
        alive = {
            tuple(each[k] for k in identity) for each in reported if each["outcome"] == SURVIVED
        }
        mutants = [each for each in mutants if (each.path, each.function, each.change) in alive]
    say(f"{len(mutants)} of {there} mutants of {len(paths)} files")
    if asked.list:
        print(*(f"{m.path}:{m.line} {m.name.partition('::')[2]}" for m in mutants), sep="\n")
        return 0
    tests = asked.tests or with_tests(paths)
    return carry_out(mutants, tests, asked.jobs, asked.report, asked.at_most_s)


def carry_out(
    mutants: list[Mutant], tests: list[str], jobs: int, report: Path | None, most_s: float
) -> int:
    """Run all mutants, and report the results."""
    began_s = time.monotonic()
    for name in PREPARED:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    with tempfile.TemporaryDirectory() as folder:
        # A mutant that writes to a wrong path must not reach the user's files.
        for name in ("HOME", "XDG_STATE_HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
            os.environ[name] = folder
        scratch = Path(folder)
        done = scratch / "functions.json"

        pid = os.fork()
        if pid == 0:
            try:
                silence()
                runs = Runs(mutants, jobs, scratch / "functions", most_s)
                pytest.main([*OPTIONS, *tests], plugins=[Profile(), runs])
                if not runs.results:
                    os._exit(1)
                rows = [(list(each), *runs.results[each]) for each in mutants]
                done.write_text(json.dumps([rows, runs.seconds(), runs.bad]))
            except BaseException:
                say(traceback.format_exc())
            finally:
                os._exit(0)
        os.waitpid(pid, 0)
        if not done.exists():
            raise SystemExit("the tests could not be read or run")
        reported, seconds, bad = json.loads(done.read_text())
        results = {Mutant(*each): (outcome, by) for each, outcome, by in reported}
        later = [each for each in mutants if results[each][0] == UNSUITED]
        say(f"{len(later)} act when their module is imported: their tests are read anew")
        processes = Processes(jobs, scratch / "anew")
        results |= try_anew(later, seconds, bad, processes, most_s)
    if report is not None:
        rows: list[Found] = [
            {**each._asdict(), "outcome": results[each][0], "by": results[each][1]}
            for each in mutants
        ]
        report.write_text(json.dumps(rows, indent=1) + "\n")
    return summary(mutants, results, time.monotonic() - began_s)


def summary(
    mutants: Sequence[Mutant], results: dict[Mutant, tuple[str, str]], took_s: float
) -> int:
    """Print the figures; return 1 if a mutant survived in an area without survivors."""
    bad = 0
    for area, paths in [*AREAS.items(), ("all", ("",))]:
        mine = [m for m in mutants if m.name.startswith(paths)]
        alive = [m for m in mine if results[m][0] == SURVIVED]
        if mine:
            share = 100.0 * (len(mine) - len(alive)) / len(mine)
            print(f"{area:12} {len(mine):6} run {share:6.1f} % killed {len(alive):4} survived")
        bad += len(alive) if area in NO_SURVIVORS else 0
    for mutant in mutants:
        if results[mutant][0] == SURVIVED:
            print(f"  {mutant.path}:{mutant.line} {mutant.function}: {mutant.change}")
    print(f"{took_s:.0f} s")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
