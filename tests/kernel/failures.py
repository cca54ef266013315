"""A pytest plug-in that prints each failure and its reason at once, not only after all tests.

A virtual machine that is killed at its time limit never reaches the end, where pytest prints the
details.
"""

from __future__ import annotations

import pytest

LINES = 6
"""Greatest number of lines of a reason printed at once; the end has all of them."""


def reason(report: pytest.TestReport) -> str:
    """Return the location and reason of a failure."""
    crash = getattr(report.longrepr, "reprcrash", None)
    if crash is None:
        said = report.longreprtext
    else:
        said = f"{crash.path}:{crash.lineno}: {crash.message}"
    return "\n    ".join(said.splitlines()[:LINES])


class AtOnce:
    """Prints each failure as soon as the test has ended."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        terminal = self._config.pluginmanager.get_plugin("terminalreporter")
        if report.failed and terminal is not None:
            took = f"{report.when}, {report.duration:.1f} s"
            terminal.ensure_newline()
            terminal.write_line(f"FAILED {report.nodeid} ({took}): {reason(report)}")


def pytest_configure(config: pytest.Config) -> None:
    """Register the plug-in."""
    config.pluginmanager.register(AtOnce(config), "failures at once")
