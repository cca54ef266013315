"""Tables that only the documentation's site has, not the pages in the repository.

Each is generated from declarations in the code or the tests. In the page its place has a marker,
and a line with the command that prints the same; `filled` puts the table there, for the site
(docs/site/conf.py) and for the tests that read pages. Tables of results that take a run to get are
read from tests/results (result_tables).

``python -m tests.site_tables`` writes those lines, and with a table's name prints that table.
"""

from __future__ import annotations

import posixpath
import sys
from collections.abc import Callable, Iterator
from typing import NamedTuple

from cardan.cli.common import page_path
from cardan.conform import registry as suites
from cardan.sim_peers import registry as peers
from cardan.sim_peers.ur_controller import UrController
from tests import conformance_tables, device_table, docs_tables, network_table, result_tables
from tests.docs_tables import ROOT, markdown, replaced
from tests.result_tables import Results


class SiteTable(NamedTuple):
    """Table of a page of the site."""

    page: str
    """Relative to the repository."""
    what: str
    """Contents, as a noun phrase."""
    make: Callable[[], str]
    command: str = ""
    """Command that prints the same; empty: this module does."""
    file: str = ""
    """File that contains it, in place of a command: relative to the repository."""

    def line(self, name: str) -> str:
        """Return the line in its place in the repository's page."""
        if self.file:
            file = posixpath.relpath(self.file, posixpath.dirname(self.page))
            return f"On the site: {self.what}. In the repository: [file]({file}).\n"
        command = self.command or f'python -m tests.site_tables "{name}"'
        where = "a terminal" if self.command else "a checkout"
        return f"On the site: {self.what}. In {where}: `{command}`.\n"


def begin(name: str) -> str:
    """Return the line before the place of that table."""
    return f"<!-- site table: {name} -->\n"


SCRIPTED = ("abb-gofa", "spacemouse", "wiimote", "leap", "gamepad", "keyboard", "jr3", "omni")
"""Simulated peers with their own scripts. Other devices use those of the SpaceMouse."""


def _driver_options() -> Iterator[tuple[str, SiteTable]]:
    for name, driver in docs_tables.DRIVERS.items():
        yield (
            f"options of driver {name}",
            SiteTable(
                page_path(driver.page),
                "the options of the driver, with defaults and ranges",
                docs_tables.driver_options_of(name),
                f"cardan devices drivers {name}",
            ),
        )


def _faults() -> Iterator[tuple[str, SiteTable]]:
    """Return the faults of each simulated peer; commands with equal faults share a section."""
    for name in docs_tables.ours(peers):
        if name == "keyboard":  # the section of the gamepad covers both
            continue
        peer = peers.load(name)
        title = "serial devices" if name == "spacemouse-serial" else name
        yield (
            f"faults of {title}",
            SiteTable(
                page_path(peer.page),
                "its faults, the default of each and what happens",
                docs_tables.faults_of(name),
                f"cardan sim {name} --list-faults",
            ),
        )


def _options() -> Iterator[tuple[str, SiteTable]]:
    """Return the options of each simulated peer, and its own scripts with their verbs."""
    for name, peer in docs_tables.ours(peers).items():
        if name not in ("keyboard", "phone"):  # these have the scripts of the gamepad and of `xr`
            yield (
                f"options of {name}",
                SiteTable(
                    page_path(peer.page),
                    "its own options",
                    docs_tables.options_of(name),
                    f"cardan sim {name} --help",
                ),
            )
        if name in SCRIPTED:
            yield (
                f"scripts of {name}",
                SiteTable(
                    page_path(peer.page),
                    "the built-in scripts, and the verbs of a script",
                    docs_tables.scripts_of(name),
                    f"cardan sim {name} --list-scripts",
                ),
            )


def _requirements() -> Iterator[tuple[str, SiteTable]]:
    for name in suites.names():
        count = len(suites.load(name).requirements)
        yield (
            f"requirements of {name}",
            SiteTable(
                result_tables.of_suite(name).page,
                f"the {count} requirements, with the level and source of each",
                conformance_tables.requirements_of(name),
                f"cardan conform {name} --requirements",
            ),
        )


def _written(results: Results, what: str) -> SiteTable:
    return SiteTable(results.page, what, results.read, file=results.file)


def _results() -> Iterator[tuple[str, SiteTable]]:
    for name, results, what in (
        ("faults", result_tables.FAULTS, "every fault, for each source and robot"),
        (
            "faults of a device at another computer",
            result_tables.REMOTE_FAULTS,
            "every fault, over each network",
        ),
        (
            "faults of whole programs",
            result_tables.PROCESS_FAULTS,
            "every case, with the message and the action needed to continue",
        ),
        ("floods", result_tables.FLOODS, "every server, at each rate and end of a flood"),
        ("published arms", result_tables.PUBLISHED_ARMS, "each arm, and what was measured of it"),
    ):
        yield name, _written(results, what)
    for name, what, make in (
        ("some faults", "some faults, for each robot", docs_tables.short_faults),
        (
            "some faults of a device at another computer",
            "some faults, over each network",
            docs_tables.short_remote_faults,
        ),
        (
            "some faults of whole programs",
            "some cases of a SpaceMouse and a GoFa",
            docs_tables.short_process_faults,
        ),
    ):
        yield name, SiteTable("docs/faults.md", what, make)
    for name in suites.names():
        results = result_tables.of_suite(name)
        yield (
            f"conformance with faults: {name}",
            _written(results, "each tested fault, and the requirements that it violates"),
        )


def _network() -> str:
    return markdown(("name", "what", "type", *network_table.TRANSPORTS), network_table.table())


def _urscript() -> str:
    """Return the controller's functions, with the default arguments in URScript's syntax."""
    rows = [
        (
            f"`{name}`",
            ", ".join(
                f"`{each}={function.defaults[each]!r}`"
                if each in function.defaults
                else f"`{each}`"
                for each in function.parameters
            ),
        )
        for name, function in sorted(UrController().functions.items())
    ]
    return markdown(("function", "arguments"), rows)


TABLES: dict[str, SiteTable] = {
    "drivers": SiteTable(
        "docs/configuration.md",
        "the drivers and the page with the options of each",
        docs_tables.options_table,
        "cardan devices drivers",
    ),
    "codes": SiteTable(
        "docs/troubleshooting.md",
        "each code, with its messages, cause, what happens meanwhile, and what to do",
        docs_tables.codes_of_messages,
        "cardan explain CODE",
    ),
    "demos": SiteTable(
        "docs/first-ten-minutes.md",
        "all demos and their files",
        docs_tables.demos_table,
        "cardan demo --list",
    ),
    "network": SiteTable(
        "docs/judged.md",
        "every name, its type, and the programs that tested it on each transport",
        _network,
    ),
    "suites": SiteTable(
        "docs/conformance.md",
        "the protocols with scope, levels, and values of `--target`",
        conformance_tables.suites,
        "cardan conform --list",
    ),
    "states": SiteTable(
        "docs/safety-and-access.md", "the machines, and what each state means", docs_tables.states
    ),
    "devices": SiteTable(
        "docs/devices.md",
        "each device, its driver, what it gives and takes back, and the mapping that suits it",
        docs_tables.devices_table,
    ),
    "judges of devices": SiteTable(
        "docs/devices.md", "each device, its transports, and what judged them", device_table.table
    ),
    "buttons": SiteTable(
        "docs/spacemouse.md",
        "the key behind each number, device by device",
        docs_tables.spnav_buttons,
    ),
    "models of 3Dconnexion": SiteTable(
        "docs/spacemouse.md",
        "each device, and what it sends; `cardan sim spacemouse --list-models` has their names",
        docs_tables.connexion_models,
    ),
    "peers": SiteTable(
        "docs/simulated-peers.md",
        "their commands, what each stands in for, and its protocol",
        docs_tables.peers_table,
        "cardan sim --list",
    ),
    "functions of ur": SiteTable(
        "docs/simulated-peers.md", "the functions of URScript that it knows", _urscript
    ),
    **dict(_driver_options()),
    **dict(_options()),
    **dict(_faults()),
    **dict(_requirements()),
    **dict(_results()),
}


def filled(page: str, text: str) -> str:
    """Return the text of a page (relative to the repository) with its tables."""
    for name, table in TABLES.items():
        if table.page == page:
            text = replaced(text, begin(name), table.make())
    return text


def unfilled(page: str, text: str) -> str:
    """Return the text of a page without its tables, like in the repository."""
    for name, table in TABLES.items():
        if table.page == page:
            text = replaced(text, begin(name), table.line(name))
    return text


def read(page: str) -> str:
    """Return a page as shown on the site."""
    return filled(page, (ROOT / page).read_text(encoding="utf-8"))


def main(names: list[str]) -> None:
    """Print the named tables; without a name, write the lines in their places."""
    for name in names:
        print(TABLES[name].make(), end="")
    if not names:
        for page in {table.page for table in TABLES.values()}:
            path = ROOT / page
            path.write_text(unfilled(page, path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
