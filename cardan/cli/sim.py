"""``cardan sim``: a command for each simulated peer, made of the peer's options."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any

import typer

from cardan.cli.common import AsJson
from cardan.cli.installed import CommandGroup
from cardan.cli.options_from_dataclass import (
    SERVING,
    Commands,
    Given,
    all_given,
    collected,
    command_of,
    listed,
    made,
    parameter_of,
    run_logged,
    serving_parameters,
)
from cardan.sim_peers import registry
from cardan.sim_peers.base import parse_faults
from cardan.sim_peers.command import PeerCommand

Script = Annotated[str, typer.Option(metavar="NAME|FILE", help="Script; see --list-scripts.")]
Fault = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        metavar="NAME[=VALUE]",
        help="A fault to simulate (repeatable); see --list-faults.",
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")]


class _Peers(CommandGroup):
    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: Any = Commands(registry, "simulated peer", _command)


sim = typer.Typer(name="sim", cls=_Peers, no_args_is_help=True, rich_markup_mode=None)


@sim.callback(invoke_without_command=True)
def _sim(
    context: typer.Context,
    list_: Annotated[bool, typer.Option("--list", help="Print the peers, then end.")] = False,
    as_json: AsJson = False,
) -> None:
    """Simulate a controller, device or client over its real protocol."""
    listed(context, list_, registry, ("peer", "stands in for"), as_json)


def _command(name: str, peer: type[PeerCommand[Any]]) -> Any:
    """Return the command of a peer, for typer."""
    own = {each.field.name: each for each in all_given(peer.Options)}
    fields = {each.name: each for each in dataclasses.fields(peer.Options)}
    parameters = {name: each.parameter for name, each in own.items()}
    parameters |= serving_parameters()
    for field, annotation in (("script", Script), ("faults", Fault), ("seed", Seed)):
        if field in fields:
            default = None if field == "faults" else fields[field].default
            shared = parameter_of(field, annotation, default)
            parameters[field] = parameters.pop(field, shared)  # Keep the common order.
    lists = _lists(peer, own, fields)
    for flag, (help_, _) in lists.items():
        wanted = Annotated[bool, typer.Option(f"--list-{flag}", help=help_)]
        parameters[f"list_{flag}"] = parameter_of(f"list_{flag}", wanted, False)

    def run(**given: Any) -> None:
        listed = [flag for flag in lists if given.pop(f"list_{flag}")]
        seconds, verbose, level = (given.pop(name) for name in SERVING)
        for flag in listed:
            for line in lists[flag][1]():
                print(line)
        if listed:
            return
        values = collected(own, given)
        for field, value in given.items():
            if field in own:
                continue
            if field == "faults":
                value = parse_faults(value or (), peer.faults)
            values[peer.Options][field] = value
        run_logged(lambda: peer.run(made(peer.Options, values), seconds), own, verbose, level)

    return command_of("cardan sim", name, peer, own, parameters, run)


Lines = Callable[[], Iterator[str]]
"""Lines to print."""


def _lists(
    peer: type[PeerCommand[Any]], own: Mapping[str, Given], fields: Mapping[str, Any]
) -> dict[str, tuple[str, Lines]]:
    """Return help and printed lines of each ``--list-...``, by the rest of the option's name."""

    def values(listed: Sequence[tuple[str, str]]) -> Lines:
        width = max(16, *(len(value) for value, _ in listed))
        return lambda: (f"{value:{width}} {text}" for value, text in listed)

    def faults() -> Iterator[str]:
        for fault in peer.faults:
            yield f"{fault.name:16} {fault.help} (default {fault.default:g})"

    def scripts() -> Iterator[str]:
        for name, text in peer.scripts.items():
            first = text.strip().splitlines()[0]
            yield f"{name:16} {first.lstrip('# ') if first.startswith('#') else ''}"
        yield "\na file has one step a line: SECONDS, then one of:"
        yield from (f"  {usage}" for usage in peer.verbs.values())

    found: dict[str, tuple[str, Lines]] = {}
    if "faults" in fields:
        found["faults"] = ("Print the faults, then end.", faults)
    if "script" in fields:
        found["scripts"] = ("Print the built-in scripts, then end.", scripts)
    for name, each in own.items():
        if each.option.listed:
            found[f"{name}s"] = (f"Print the {name}s, then end.", values(each.option.listed))
    return found
