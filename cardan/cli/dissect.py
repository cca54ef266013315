"""``cardan dissect``, with the options of every dissector there is."""

from __future__ import annotations

import inspect
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from cardan.dissect import registry
from cardan.dissect.reader import Numbers


def add_dissect(app: typer.Typer) -> None:
    """Adds the command: the options of all captures, and those of each protocol."""
    dissectors = registry.dissectors()
    numbers = [option for dissector in dissectors for option in dissector.options]

    def dissect(
        file: Annotated[Path, typer.Argument(metavar="FILE", help="A pcap or pcapng file.")],
        limit: Annotated[
            int | None, typer.Option(min=1, help="Print at most this many packets.")
        ] = None,
        summary: Annotated[
            bool, typer.Option("--summary", help="Print the figures of each flow only.")
        ] = False,
        **given: list[int] | None,
    ) -> None:
        from cardan.dissect import dissect_file

        places = {key: found or () for key, found in given.items()}
        dissect_file(file, sys.stdout, limit=limit, summary=summary, **places)

    file, *rest = list(inspect.signature(dissect, eval_str=True).parameters.values())[:-1]
    parameters = [file, *map(_parameter, numbers), *rest]
    # typer makes the command's options of both.
    dissect.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    dissect.__annotations__ = {each.name: each.annotation for each in parameters}
    lines = (f"{each.name}: {inspect.getdoc(each)}" for each in dissectors)
    app.command(help="\n\n".join(("Print a capture, field by field.", *lines)))(dissect)


def _parameter(numbers: Numbers) -> inspect.Parameter:
    option: Any = typer.Option(
        f"--{numbers.flag}",
        metavar=numbers.metavar,
        min=numbers.allowed[0],
        max=numbers.allowed[-1],
        help=f"{numbers.help} (repeatable).",
    )
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    annotation = Annotated[list[int] | None, option]
    return inspect.Parameter(numbers.key, kind, default=None, annotation=annotation)
