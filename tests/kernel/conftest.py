"""These tests need a kernel of their own: tools/kernel-vm boots one and runs the tests in it."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import pytest

INSIDE = os.environ.get("CARDAN_KERNEL_VM") == "1"

collect_ignore_glob = [] if INSIDE else ["test_*.py"]
"""Collect nothing outside of the virtual machine."""

FAULT_ROW = "fault-row "
"""Prefix of a line with a session's result on a bad network, as JSON: ``python -m
tests.process_faults --kernel LOG`` copies these lines into its tables."""

_fault_rows: list[dict[str, Any]] = []

_checked: list[tuple[str, str, str]] = []


def load_module(name: str, *parameters: str) -> None:
    """Load a kernel module from the unpacked kernel."""
    folder = os.environ["CARDAN_KERNEL_MODULES"]
    command = ["modprobe", "-d", folder, name, *parameters]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    if done.returncode:
        pytest.fail(f"{' '.join(command)}: {done.stderr.strip()}")


@pytest.fixture
def modules() -> Iterator[Callable[..., None]]:
    """Load kernel modules by name; they stay loaded."""

    def load(*names: str) -> None:
        for name in names:
            load_module(name)

    return load


@pytest.fixture
def fault_rows() -> list[dict[str, Any]]:
    """Rows to be printed at the end."""
    return _fault_rows


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    outcome = yield
    report = outcome.get_result()
    marker = item.get_closest_marker("judged")
    if marker is not None and report.when == "call" and report.passed:
        words = marker.kwargs
        _checked.append((words["device"], words["transport"], words["by"]))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the rows for the fault table, and the kernel paths that the tests used."""
    if _fault_rows:
        terminalreporter.section("for the fault table")
        for row in _fault_rows:
            terminalreporter.line(FAULT_ROW + json.dumps(row))
    if _checked:
        terminalreporter.section("shown against the Linux kernel")
        for device, transport, by in dict.fromkeys(_checked):
            terminalreporter.line(f"{device:14} {transport:32} judged by {by}")
