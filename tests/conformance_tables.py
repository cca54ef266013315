"""Generator of the tables in tests/results that take runs: fault x requirement.

The site's own generator (site_tables) makes those of suites and of requirements. tests/conformance
compares them. To update them: ``python -m tests.conformance_tables``.
"""

from __future__ import annotations

import functools
import posixpath
from collections.abc import Callable
from typing import NamedTuple

from cardan.conform import Level, SuiteReport, registry
from cardan.conform.run import simulated
from tests.docs_tables import markdown
from tests.result_tables import of_suite

PAGE = "docs/conformance.md"
"""Page with the table of all suites, and a section for each suite outside of plug-ins."""

DO_NOT_APPLY = {"HID3D-016"}
"""Requirements that the simulated peer need not meet; docs/conformance.md says why."""


@functools.cache
def sound(suite: str) -> SuiteReport:
    """Return the report on a simulated peer without faults, on all levels."""
    return simulated(registry.load(suite), Level.BY_HAND)[0]


class Tried(NamedTuple):
    """A fault of a simulated peer, and the requirements that caught it."""

    name: str
    value: float
    what: str
    caught: tuple[str, ...]
    """Requirements that fail with it, on the lowest level from 1 on where any fails."""
    why_not: str
    """Reason why no requirement can catch it; empty if none is declared."""


@functools.cache
def tried(suite_name: str) -> tuple[Tried, ...]:
    """Run a suite with each fault switch of its simulated peer."""
    suite = registry.load(suite_name)
    switches = {each.name: each for each in suite.switches()}
    found = []
    for switch in switches.values():
        faults = {switch.name: suite.fault_test_values.get(switch.name, switch.default)}
        if switch.after:
            first = switches[switch.after]
            faults[first.name] = suite.fault_test_values.get(first.name, first.default)
        # Most faults are caught at HOLD, which takes less time.
        levels = (Level.HOLD, Level.MOVE)
        for level in [suite.tried_on[switch.name]] if switch.name in suite.tried_on else levels:
            caught = simulated(suite, level, faults)[0].failed
            if caught:
                break
        why_not = suite.undetectable_faults.get(switch.name, "")
        found.append(Tried(switch.name, faults[switch.name], switch.help, caught, why_not))
    return tuple(found)


def requirements_of(suite: str) -> Callable[[], str]:
    def table() -> str:
        rows = [
            (each.id, str(int(each.level)), each.text, each.source)
            for each in registry.load(suite).requirements
        ]
        return markdown(("id", "level", "requirement", "source"), rows)

    return table


def faults_table(suite: str) -> str:
    """Return a table of a suite's faults, and the requirements that catch each."""
    rows = [
        (f"`{each.name}`", f"{each.value:g}", each.what, ", ".join(each.caught) or each.why_not)
        for each in tried(suite)
    ]
    return markdown(("fault", "tried with", "what happens", "not met then"), rows)


def section_of(suite: str) -> str:
    """Return the link from PAGE to the section of a suite."""
    page = of_suite(suite).page
    if page == PAGE:
        return f"#{suite}"
    return f"{posixpath.relpath(page, posixpath.dirname(PAGE))}#cardan-conform-{suite}"


def suites() -> str:
    rows = []
    for name in registry.names():
        suite = registry.load(name)
        levels = ", ".join(map(str, sorted({int(each.level) for each in suite.requirements})))
        count = str(len(suite.requirements))
        target = suite.target.replace("|", "\\|")
        link = f"[`{name}`]({section_of(name)})"
        rows.append((link, suite.judges, suite.speaks, count, levels, target))
    return markdown(
        ("protocol", "judges", "speaks", "requirements", "levels", "`--target` takes"), rows
    )


def main() -> None:
    """Write the tables."""
    for name in registry.names():
        of_suite(name).write(faults_table(name))


if __name__ == "__main__":
    main()
