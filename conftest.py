"""What holds for every test."""

from __future__ import annotations

import functools
import gc
import os
import re
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol
from hypothesis import settings

import tests.examples  # noqa: F401 - has the profiles
from tests.foreground import signals_act

settings.load_profile("cardan")

ALL_IS_THERE = os.environ.get("CI") == "true" or os.environ.get("CARDAN_KERNEL_VM") == "1"
"""Whether nothing may be missing: in continuous integration, and in the virtual machine, which
brings what its tests need."""

INSTALLABLE = re.compile(r"\binstall(ed)?\b|\bDebian package|\bnot built\b")
"""A reason to skip that somebody can do something about."""

ANOTHER_MACHINE = re.compile(r"endian|64-bit|\bcompiled\b|\bcompiler\b|\bLinux only\b")
"""A reason that lies in what the machine is."""


def must_be_shown(reason: str, judged: bool) -> bool:
    """Whether a test that is skipped for `reason` has to fail where nothing may be missing."""
    if INSTALLABLE.search(reason):
        return True
    return judged and not ANOTHER_MACHINE.search(reason)


def _accusation(reason: str) -> str:
    return f"left out, where nothing may be missing (CI=true): {reason}"


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, None, None]:
    """Turn the skip of a test whose judge is missing into a failure, in CI."""
    excinfo = call.excinfo
    if ALL_IS_THERE and excinfo is not None and isinstance(excinfo.value, pytest.skip.Exception):
        reason = str(excinfo.value)
        judged = any(map(item.get_closest_marker, ("judged", "shown_on")))
        if must_be_shown(reason, judged):
            try:
                pytest.fail(_accusation(reason), pytrace=False)
            except pytest.fail.Exception:
                call.excinfo = pytest.ExceptionInfo.from_current()
    yield


@pytest.hookimpl(hookwrapper=True)
def pytest_make_collect_report() -> Generator[None, None, None]:
    """The same for a module that skips itself."""
    outcome = yield
    report = outcome.get_result()
    if ALL_IS_THERE and report.skipped and isinstance(report.longrepr, tuple):
        reason = report.longrepr[2].removeprefix("Skipped: ")
        if must_be_shown(reason, judged=False):
            report.outcome, report.longrepr = "failed", _accusation(reason)


PARTS = ("computing", "real", "matrix")
"""Where a test runs, by its mark, or that of its file where it has none of its own.

``computing``  no mark: in ``make test``, on all cores, under every Python
``real``       in ``make test``, last: one for each mechanism that needs real clocks, sockets,
               processes or other people's programs; ``real("id", ...)`` for these parameters only
``matrix``     in ``make test-matrix``: all the others of that kind, and what computes for long
"""

REAL_AT_MOST = 150
"""Most tests of ``make test`` that wait for something real."""

LONGEST = (
    "tests/sweep/test_sweep.py",
    "tests/test_ending.py",
    "tests/gateway/daemon/test_serve.py",
    "tests/gateway/session/test_remote_device.py",
    "tests/sim_peers/test_ur_public_client.py",
    "plugins/cardan-serial-mice/tests/test_serial_checks.py",
    "tests/gateway/session/test_parent_death.py",
)
"""Files whose ``real`` tests take longest, which begin first: else the other worker waits for the
last of them, whatever it does."""

WAITS_S = 300.0
"""Longest time for a test that waits for something real: each wait has a limit of its own, which a
computer that works never reaches, and a test may have many. The others have `timeout` in
pyproject.toml."""

LONG_S = 0.5
"""What is to be seen among the longest."""

OUR_MARKS = ("real", "matrix", "judged", "shown_on")

ALL_MATRIX = re.compile(r"^pytestmark = .*mark\.matrix|^    pytest\.mark\.matrix,$", re.MULTILINE)
"""What stands in a file of which a test is in the matrix where its own mark says no other thing."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--part``."""
    parser.addoption("--part", choices=PARTS, help="the tests that run there, by their mark")


def parts_of(item: pytest.Item, marks: Iterable[pytest.Mark]) -> list[str]:
    """Where `marks` say that a test runs, in their order."""
    spec = getattr(item, "callspec", None)
    return [
        mark.name
        for mark in marks
        if mark.name in PARTS and (not mark.args or (spec is not None and spec.id in mark.args))
    ]


def part_of(item: pytest.Item) -> str:
    """Where a test runs: the mark nearest to it decides."""
    return (*parts_of(item, item.iter_markers()), "computing")[0]


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out a file that has no test of the part that is asked for: reading and compiling all
    files takes each worker half a minute."""
    asked = config.getoption("--part")
    if asked is None or not collection_path.match("test_*.py"):
        return None
    text = collection_path.read_text(encoding="utf-8")
    if asked == "computing":
        return True if ALL_MATRIX.search(text) else None
    return None if f"mark.{asked}" in text else True


@functools.cache
def words_of(path: Path) -> frozenset[str]:
    """The words that stand in a file."""
    return frozenset(re.findall(r"\w+", path.read_text(encoding="utf-8")))


def check_marks(items: Sequence[pytest.Item]) -> None:
    """Raise UsageError where a test has its mark from elsewhere, as nobody would find it, or two of
    one place that say where it runs, or where too many are ``real``."""
    for item in items:
        names = {name for name in OUR_MARKS if item.get_closest_marker(name) is not None}
        if strange := names - words_of(item.path):
            raise pytest.UsageError(f"{item.path}: write the marks {strange} of its tests into it")
        places = parts_of(item, (mark for mark in item.own_markers if not mark.args))
        if len(places) > 1:
            raise pytest.UsageError(f"{item.nodeid} has {places}: one mark says where a test runs")
    real = sum(part_of(item) == "real" for item in items)
    if real > REAL_AT_MOST:
        raise pytest.UsageError(f"{real} tests are marked real, of {REAL_AT_MOST}: move some")


def check_ids(items: Sequence[pytest.Item]) -> None:
    """Raise UsageError where a mark names parameters that its test has not, among all tests."""
    asked, there = set(), set()
    for item in items:
        test = item.nodeid.partition("[")[0]
        if spec := getattr(item, "callspec", None):
            there.add((test, spec.id))
        asked.update(
            (test, name) for mark in item.own_markers if mark.name in PARTS for name in mark.args
        )
    if missing := asked - there:
        raise pytest.UsageError(f"marks name parameters that are not there: {sorted(missing)}")


def place_of(file: str) -> int:
    """When a file with ``real`` tests begins."""
    return LONGEST.index(file) if file in LONGEST else len(LONGEST)


def give_time(items: Iterable[pytest.Item]) -> None:
    """Give each test that waits for something real the time for it, unless it has its own."""
    for item in items:
        if part_of(item) != "computing" and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(WAITS_S))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the part that is asked for."""
    check_marks(items)
    if config.args_source is config.ArgsSource.TESTPATHS:
        check_ids(items)
    give_time(items)
    asked = config.getoption("--part")
    if asked is not None:
        left_out = [item for item in items if part_of(item) != asked]
        items[:] = [item for item in items if part_of(item) == asked]
        if asked == "real":
            items.sort(key=lambda item: place_of(item.nodeid.partition("::")[0]))
        config.hook.pytest_deselected(items=left_out)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Let xdist's workers report of a test's set-up and end only what failed or took long: most
    tests are quicker than the messages about them."""
    if not hasattr(item.config, "workerinput") or part_of(item) != "computing":
        return None
    for report in runtestprotocol(item, nextitem=nextitem, log=False):
        if report.when == "call" or not report.passed or report.duration > LONG_S:
            item.ihook.pytest_runtest_logreport(report=report)
    return True


GARBAGE = (10_000, 20, 20)
"""New objects until garbage is looked for, and how many such looks until longer ones: Python's own
700, 10, 10 are for programs that keep less."""


@pytest.hookimpl(hookwrapper=True)
def pytest_collection() -> Generator[None, None, None]:
    """Let garbage collection pass over what collecting makes, which stays until the end: it would
    look through all tests and modules again and again, also while the tests run."""
    gc.disable()
    yield
    gc.collect()
    gc.freeze()
    gc.set_threshold(*GARBAGE)
    gc.enable()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say once what was left out for want of a program, and what installs it; and what took the
    place of what a page says."""
    for report in terminalreporter.getreports("passed"):
        for name, reported in report.user_properties:
            if name == "stand-in" and report.when == "call":
                terminalreporter.write_line(f"STAND-IN: {reported}")
    missing = Counter(
        report.longrepr[2].removeprefix("Skipped: ")
        for report in terminalreporter.getreports("skipped")
        if isinstance(report.longrepr, tuple) and INSTALLABLE.search(report.longrepr[2])
    )
    if missing:
        reasons = "; ".join(f"{reason} ({number})" for reason, number in sorted(missing.items()))
        terminalreporter.write_line(
            f"LEFT OUT, {missing.total()} tests; tools/debian-packages judges installs what Debian "
            f"has: {reasons}"
        )


@pytest.fixture(autouse=True, scope="session")
def signals_act_as_in_the_foreground():
    """Tests send them to themselves and to others."""
    with signals_act():
        yield


@pytest.fixture(autouse=True, scope="session")
def the_cache_is_that_of_the_tests(tmp_path_factory):
    """What they load is not kept for the user who runs them."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("CACHE_DIRECTORY", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True)
def the_scheduling_of_the_tests_is_left_alone():
    """One that made pytest a real-time process would starve whatever the tests after it start."""
    before = os.sched_getscheduler(0)
    yield
    after = os.sched_getscheduler(0)
    if after != before:
        os.sched_setscheduler(0, before, os.sched_param(0))
    assert after == before
