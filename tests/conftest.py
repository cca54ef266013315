"""What holds for every test."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Generator, Mapping
from pathlib import Path

import pytest
from hypothesis import settings

from tests.foreground import signals_act

# How fast an example runs says how busy the machine is; what CI chooses otherwise stays.
settings.register_profile("cardan", settings(deadline=None))
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


LONGEST = (
    "test_ending.py",
    "test_device_examples.py",
    "test_fault_table.py",
    "gateway/daemon/test_serve.py",
    "test_distribution.py",
    "test_fault_matrix.py",
    "test_lost_time.py",
    "gateway/session/test_arm_session.py",
    "test_ros2_examples.py",
    "test_process_faults.py",
    "sweep/test_sweep.py",
    "drivers/test_spnav.py",
    "test_cli.py",
)
"""Files that take more than half a minute, the longest first; of those that wait for real clocks,
too."""

OUR_MARKS = ("once", "realtime", "judged", "shown_on")

ONE_MARK = re.compile(r"(\w+)(?: and not \w+)*")
"""What -m says where it asks for the tests that have a mark."""


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out a file in which the mark that is asked for does not stand: reading and compiling
    all files takes each worker half a minute."""
    asked = ONE_MARK.fullmatch(config.option.markexpr)
    if asked is None or not collection_path.match("test_*.py"):
        return None
    return None if asked[1] in words_of(collection_path) else True


@functools.cache
def words_of(path: Path) -> frozenset[str]:
    """The words that stand in a file."""
    return frozenset(re.findall(r"\w+", path.read_text(encoding="utf-8")))


def check_marks(marks: Mapping[Path, set[str]]) -> None:
    """Raise UsageError where a test has its mark from elsewhere: nobody would find it."""
    for path, names in marks.items():
        if strange := names - words_of(path):
            raise pytest.UsageError(f"{path}: write the marks {strange} of its tests into the file")


def marks_of(items: list[pytest.Item]) -> dict[Path, set[str]]:
    """The files of tests, and those of our marks that their tests have."""
    found: dict[Path, set[str]] = {}
    for item in items:
        names = found.setdefault(item.path, set())
        names.update(name for name in OUR_MARKS if item.get_closest_marker(name) is not None)
    return found


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take long, so that no worker is left with one in the end."""
    marks = marks_of(items)
    check_marks(marks)
    place = {Path(__file__).parent / name: number for number, name in enumerate(LONGEST)}
    long = {path for path, names in marks.items() if "once" in names}
    items.sort(key=lambda item: (place.get(item.path, len(place)), item.path not in long))


@pytest.fixture(autouse=True, scope="session")
def signals_act_as_in_the_foreground():
    """Tests send them to themselves and to others."""
    with signals_act():
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
