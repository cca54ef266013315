"""What the commands of ``cardan sim`` share: the application, their options, the serving."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable, Mapping
from typing import Annotated

import typer

from cardan.sim_peers.base import FaultSwitch, SimulatedPeer, serve

sim = typer.Typer(
    name="sim",
    help="Stand in for a piece of hardware, speaking its real protocol.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)

Script = Annotated[
    str | None, typer.Option(metavar="NAME|FILE", help="Its motion; see --list-scripts.")
]
Fault = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME[=VALUE]", help="A fault to have (repeatable); see --list-faults."),
]
ListFaults = Annotated[bool, typer.Option("--list-faults", help="Print the faults, then end.")]
ListScripts = Annotated[
    bool, typer.Option("--list-scripts", help="Print the built-in scripts, then end.")
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]


def listed(
    list_faults: bool,
    faults: Iterable[FaultSwitch],
    list_scripts: bool,
    scripts: Mapping[str, str],
    verbs: Mapping[str, str],
) -> bool:
    """Print what was asked for; True when that is all there is to do."""
    if list_faults:
        for fault in faults:
            print(f"{fault.name:16} {fault.help} (default {fault.default:g})")
    if list_scripts:
        for name, text in scripts.items():
            first = text.strip().splitlines()[0]
            print(f"{name:16} {first.lstrip('# ') if first.startswith('#') else ''}")
        print("\na file has a line a step, SECONDS and then one of:")
        for usage in verbs.values():
            print(f"  {usage}")
    return list_faults or list_scripts


def serve_peer(peer: SimulatedPeer, seconds: float | None) -> None:
    """Serve `peer` as commands do, with what happens to it on standard error."""
    logging.basicConfig(
        stream=sys.stderr, level=logging.INFO, format="%(asctime)s %(name)s: %(message)s"
    )
    serve(peer, seconds)
