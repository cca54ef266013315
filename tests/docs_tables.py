"""Tables from the declarations of drivers, simulated peers and messages, and short ones of results.

The site inserts them into its pages (site_tables). README.md alone contains them, between the lines
`begin` and END, because it is read without a site. test_docs_tables compares it; ``make
docs-tables`` updates it.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable, Iterable, Sequence
from enum import Enum
from itertools import pairwise
from pathlib import Path
from typing import Any, get_type_hints

from click import Command, Context

from cardan.cli.common import page_path
from cardan.cli.driver_options import driver_options
from cardan.common.troubles import AREAS, troubles
from cardan.demos.examples import find_demos
from cardan.drivers import registry as drivers
from cardan.drivers.base import Driver, OperatorDevice
from cardan.drivers.spacemouse import SpaceMouse
from cardan.gateway.arm.states import States
from cardan.protocols.connexion.devices import MODELS
from cardan.sim_peers import registry as peers
from cardan_serial_mice.driver import SpaceMouseSerial
from cardan_serial_mice.protocol import SERIAL_MODELS
from cardan_spnav_server import identity_of
from tests.command_line import the_command_line
from tests.result_tables import FAULTS, PROCESS_FAULTS, REMOTE_FAULTS

ROOT = Path(__file__).parents[1]
END = "<!-- end -->\n"


def begin(name: str) -> str:
    """Return the line before the table of that name."""
    return f"<!-- made by tests/docs_tables.py: {name} -->\n"


def replaced(page: str, marker: str, made: str) -> str:
    """Return `page` with `made` between the line `marker` and END."""
    head, found, rest = page.partition(marker)
    _, ended, tail = rest.partition(END)
    if not (found and ended):
        raise ValueError(f"there is no {marker.strip()} ... {END.strip()}")
    return f"{head}{marker}\n{made}\n{END}{tail}"


def markdown(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown; an empty cell is a dash."""
    lines = [f"| {' | '.join(cell or '–' for cell in line)} |\n" for line in (columns, *rows)]
    return "".join([lines[0], f"|{'---|' * len(columns)}\n", *lines[1:]])


PLUGINS = {
    path.parent.name: path.parents[1] for path in ROOT.glob("plugins/cardan-*/*/__init__.py")
}
"""Folder of each plug-in in this repository, by its package."""


def plugin_of(kind: type[Any]) -> str:
    """Return " (PLUG-IN)" for the class of a plug-in; empty for one of Cardan itself."""
    folder = PLUGINS.get(kind.__module__.partition(".")[0])
    return f" (plug-in `{folder.name}`)" if folder else ""


def ours(registry: Any) -> dict[str, Any]:
    """Return the classes of a registry by name: Cardan's own, then those of its plug-ins."""
    names = dict.fromkeys((*registry.BUILT_IN, *registry.names()))
    found = {name: registry.load(name) for name in names}
    return {
        name: kind
        for name, kind in found.items()
        if kind.__module__.partition(".")[0] in {"cardan", *PLUGINS}
    }


def link(kind: type[Driver], page: str, section: str = "") -> str:
    """Return a driver's summary, linked to its `page`, relative to the page with the link."""
    return f"[{kind.summary}]({page}{section}){plugin_of(kind)}"


DRIVERS: dict[str, type[Driver]] = ours(drivers)
DEVICES = {name: kind for name, kind in DRIVERS.items() if issubclass(kind, OperatorDevice)}
ROBOTS = {name: kind for name, kind in DRIVERS.items() if name not in DEVICES}


def _overview() -> str:
    rows = [
        (
            link(kind, page_path(kind.page)),
            f"`{name}`",
            f"`cardan sim {kind.peer}`",
            ", ".join(f"`{each}`" for each, demo in find_demos().items() if name in demo.drivers),
        )
        for name, kind in (DEVICES | ROBOTS).items()
    ]
    return markdown(("device or robot", "driver", "simulated by", "`cardan demo`"), rows)


def devices_table() -> str:
    """Return a table of the operator devices: inputs, feedback, and recommended mapping."""
    rows = [
        (link(kind, kind.page), f"`{name}`", kind.gives, kind.takes_back, kind.suits)
        for name, kind in DEVICES.items()
    ]
    return markdown(("device", "driver", "gives", "takes back", "mapping"), rows)


def options_table() -> str:
    """Return a table of the drivers, and the pages with their options."""
    rows = [
        (f"`[{table}]`", f"`{name}`", link(kind, kind.page, "#options"))
        for table, kinds in (("device", DEVICES), ("robot", ROBOTS))
        for name, kind in kinds.items()
    ]
    return markdown(("table", "driver", "options"), rows)


def peers_table() -> str:
    """Return a table of the simulated peers and their protocols."""
    rows = [
        (
            f"`cardan sim {name}`",
            " ".join((peer.__doc__ or "").split()) + plugin_of(peer),
            peer.speaks,
        )
        for name, peer in ours(peers).items()
    ]
    return markdown(("command", "stands in for", "protocol and transport"), rows)


def faults_of(peer: str) -> Callable[[], str]:
    """Return a table of the faults of a peer."""

    def table() -> str:
        rows = [
            (f"`{fault.name}`", f"{fault.default:g}", fault.help)
            for fault in peers.load(peer).faults
        ]
        return markdown(("fault", "default", "what happens"), rows)

    return table


COMMON = {"--seconds", "--verbose", "--log-level", "--script", "--fault", "--seed", "--list-faults"}
"""Options of all peers, which the page describes once."""


def _cell(text: str) -> str:
    """Escape text for a cell of a table."""
    return text.replace("|", "\\|")


def options_of(peer: str) -> Callable[[], str]:
    """Return a table of the options that are specific to a peer."""

    def table() -> str:
        rows = []
        for parameter in the_command_line().commands["sim"].commands[peer].params:
            flag = parameter.opts[0]
            if flag in {*COMMON, "--list-scripts"} or not flag.startswith("--"):
                continue
            default = parameter.default
            if isinstance(default, (bool, list, tuple)) or default is None:
                default = ""
            if isinstance(default, Enum):
                default = default.value
            if isinstance(default, float):
                default = f"{default:g}"
            values = "" if parameter.is_flag else parameter.make_metavar(Context(Command(None)))
            rows.append(
                (
                    f"`{flag} {_cell(values)}`".replace(" `", "`"),
                    f"`{default}`" if default != "" else "",
                    _cell(parameter.help or ""),
                )
            )
        return markdown(("option", "default", "what it does"), rows)

    return table


def driver_options_of(driver: str) -> Callable[[], str]:
    """Return a table of the options of a driver, by their configuration keys."""

    def code(word: str) -> str:
        return f"`{word}`" if word.startswith(('"', "[")) else word

    def table() -> str:
        rows = [
            (
                f"`{each.name}`",
                code(each.default),
                _cell(", ".join(map(code, each.allowed.split(", ")))),
                _cell(each.meaning),
            )
            for each in driver_options(DRIVERS[driver].Options)
        ]
        return markdown(("option", "default", "allowed", "meaning"), rows)

    return table


def scripts_of(peer: str) -> Callable[[], str]:
    """Return a table of the built-in scripts of a peer, and one of its script verbs."""

    def table() -> str:
        kind = peers.load(peer)
        firsts = ((name, text.strip().splitlines()[0]) for name, text in kind.scripts.items())
        rows = [
            (f"`{name}`", _cell(first.lstrip("# ") if first.startswith("#") else ""))
            for name, first in firsts
        ]
        for usage in kind.verbs.values():
            words, _, about = usage.partition(" (")
            rows.append((f"`{_cell(words)}`", _cell(about.removesuffix(")"))))
        return markdown(("script or verb", "what it does"), rows)

    return table


def demos_table() -> str:
    """Return a table of the demos and their files."""
    rows = [
        (
            f"`cardan demo {name}`",
            demo.description.replace("<", "&lt;"),
            f"[example](../{demo.file.relative_to(ROOT)})",
        )
        for name, demo in find_demos().items()
    ]
    return markdown(("command", "what is joined", "the same by hand"), rows)


def connexion_models() -> str:
    """Return a table of the 3Dconnexion devices and their reports."""
    rows = [
        (
            model.name,
            f"{model.vendor_id:04x}:{model.product_id:04x}",
            f"`{model.key}`",
            model.family.value,
            str(len(model.buttons) or ""),
            "yes" if model.led else "",
            "yes" if model.battery else "",
        )
        for model in MODELS
    ]
    return markdown(("device", "id", "`model`", "motion", "buttons", "LED", "battery"), rows)


def spnav_buttons() -> str:
    """Return a table of key numbers for clients of spacenavd."""
    devices: dict[str, list[str]] = {}
    for mouse in (
        *(SpaceMouse(model=model.key) for model in MODELS if model.buttons),
        *(
            SpaceMouseSerial(model=model.key)
            for model in SERIAL_MODELS
            if model.key != "spaceorb"  # spacenavd does not support it
        ),
    ):
        identity = identity_of(mouse)
        keys: dict[int, list[str]] = {}
        for label in mouse.capabilities.buttons:
            keys.setdefault(identity.button_numbers[label], []).append(f"`{label}`")
        reported = ", ".join(f"{number} {' or '.join(keys[number])}" for number in sorted(keys))
        devices.setdefault(reported, []).append(identity.name)
    return markdown(
        ("devices", "N of `button-N`, and the key"),
        ((", ".join(dict.fromkeys(names)), reported) for reported, names in devices.items()),
    )


def states() -> str:
    """Return the state machines of an arm, with the description of each member."""
    rows = []
    for machine in get_type_hints(States).values():
        (reported,) = ast.parse(inspect.getsource(machine)).body
        assert isinstance(reported, ast.ClassDef)
        what = str(inspect.getdoc(machine)).rstrip(".")
        for member, below in pairwise(reported.body):
            match member, below:
                case (
                    ast.Assign(value=ast.Constant(value=str(name))),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ):
                    rows.append((what, f"`{name}`", " ".join(text.split())))
                    what = '"'
        assert len(rows) >= len(machine)
    return markdown(("machine", "state", "meaning"), rows)


def codes_of_messages() -> str:
    """Return the message codes: a section for each area, with an entry for each code."""
    made = []
    for letter, title in AREAS.items():
        made.append(f"## {title}\n\n")
        for code, (_, words, cause, now, do, page) in troubles().items():
            if code[0] == letter:
                said = "  \n".join(f"``{each}``" if "`" in each else f"`{each}`" for each in words)
                path = Path(page.partition("#")[0])
                about = path.parent.name if path.stem == "README" else path.with_suffix("")
                made.append(
                    f"### {code}\n\n{said}\n\n{cause}\n\n- Meanwhile: {now}\n"
                    f"- What to do: {do}\n- [{about}]({page})\n\n"
                )
    return "".join(made)


def _short(rows: Sequence[Sequence[str]], names: Iterable[str]) -> str:
    """Return the rows of a table whose first cell has one of these names."""
    by_name = {row[0]: row for row in rows[1:]}
    return markdown(rows[0], (by_name[name] for name in names))


def short_faults() -> str:
    """Return a table of an arm's reactions to failures of its own parts."""
    (_, *robots), *rows = FAULTS.rows("operator")
    return _short(
        [("fault", *robots), *rows],
        (
            "device or sender silent",
            "process stalls for 100 ms",
            "process killed",
            "controller restarts",
            "motors off",
            "second publisher of the joints",
            "clock stands still",
            "authority taken",
        ),
    )


def short_remote_faults() -> str:
    """Return a table of the arm's reactions to failures of the connection to it."""
    return _short(
        REMOTE_FAULTS.rows(),
        (
            "the hand lets go of the dead-man",
            "the network stands still for 0.5 s",
            "the link is cut",
            "a camera fills a link of 2 Mbit/s",
            "the laptop sleeps for 5 s",
            "`cardan devices share` is killed, and is back in 3 s",
        ),
    )


def short_process_faults() -> str:
    """Return a table of its reactions to a process that dies or is stopped, for one device and
    robot."""
    rows = []
    for group, name in (
        ("session", "SIGKILL"),
        ("session", "stands still for 500 ms"),
        ("daemon", "SIGKILL"),
        ("daemon", "disk full"),
        ("device", "killed: unplugged"),
        ("robot", "stands still for 2 s"),
        ("bus", "its router is killed"),
        ("server", "SIGKILL"),
        ("network", "30 % of all datagrams lost"),
        ("network", "100 ms of delay, each way"),
    ):
        _, *cases = PROCESS_FAULTS.rows(group)
        ((motion, again, to_continue),) = (
            (motion, again, to_continue)
            for fault, pair, motion, again, _said, to_continue in cases
            if (fault, pair) == (name, "SpaceMouse, GoFa (EGM pose)")
        )
        rows.append((group, name, motion, again, to_continue))
    return markdown(("what fails", "how", "ms, mm, mm/s", "again", "to continue"), rows)


TABLES: dict[tuple[str, str], Callable[[], str]] = {("README.md", "overview"): _overview}
"""Tables by page and name."""


def main() -> None:
    """Write the tables into their pages."""
    for (page, name), table in TABLES.items():
        path = ROOT / page
        text = path.read_text(encoding="utf-8")
        path.write_text(replaced(text, begin(name), table()), encoding="utf-8")


if __name__ == "__main__":
    main()
