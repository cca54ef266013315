"""What holds for every test."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Generator

import pytest
from hypothesis import settings

# How fast an example runs says how busy the machine is; what CI chooses otherwise stays.
settings.register_profile("cardan", settings(deadline=None))
settings.load_profile("cardan")

ALL_IS_THERE = os.environ.get("CI") == "true" or os.environ.get("CARDAN_KERNEL_VM") == "1"
"""Whether nothing may be missing: in continuous integration, and in the virtual machine, which
brings what its tests need."""

INSTALLABLE = re.compile(r"\binstall(ed)?\b|\bDebian package")
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
        if must_be_shown(reason, item.get_closest_marker("judged") is not None):
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


@pytest.fixture(autouse=True, scope="session")
def signals_act_as_in_the_foreground():
    """A shell ignores SIGINT and SIGQUIT for what it starts in the background, nohup SIGHUP, and
    what is ignored stays so in all that is started: tests send these to themselves and to others.
    """
    acting = {signal.SIGINT: signal.default_int_handler}
    acting |= dict.fromkeys((signal.SIGQUIT, signal.SIGHUP, signal.SIGTERM), signal.SIG_DFL)
    ignored = [each for each in acting if signal.getsignal(each) is signal.SIG_IGN]
    for each in ignored:
        signal.signal(each, acting[each])
    yield
    for each in ignored:
        signal.signal(each, signal.SIG_IGN)


@pytest.fixture(autouse=True)
def the_scheduling_of_the_tests_is_left_alone():
    """One that made pytest a real-time process would starve whatever the tests after it start."""
    before = os.sched_getscheduler(0)
    yield
    after = os.sched_getscheduler(0)
    if after != before:
        os.sched_setscheduler(0, before, os.sched_param(0))
    assert after == before
