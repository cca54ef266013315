"""A pytest plug-in: what failed and why is said at once, not only when all tests have ended.

A machine that is killed at its limit never comes to the end, where pytest has the details.
"""

from __future__ import annotations

import pytest

LINES = 6
"""So many lines of a reason are shown; all are, at the end."""


def reason(report: pytest.TestReport) -> str:
    """Where and why a test failed."""
    crash = getattr(report.longrepr, "reprcrash", None)
    if crash is None:
        said = report.longreprtext
    else:
        said = f"{crash.path}:{crash.lineno}: {crash.message}"
    return "\n    ".join(said.splitlines()[:LINES])


class AtOnce:
    """Says each failure when it is there."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        terminal = self._config.pluginmanager.get_plugin("terminalreporter")
        if report.failed and terminal is not None:
            took = f"{report.when}, {report.duration:.1f} s"
            terminal.ensure_newline()
            terminal.write_line(f"FAILED {report.nodeid} ({took}): {reason(report)}")


def pytest_configure(config: pytest.Config) -> None:
    """Register it with the run's terminal."""
    config.pluginmanager.register(AtOnce(config), "failures at once")
