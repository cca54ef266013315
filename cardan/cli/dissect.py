"""``cardan dissect``, with the options of every dissector there is."""

from __future__ import annotations

import functools
import inspect
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

if TYPE_CHECKING:
    from cardan.dissect.reader import Numbers


class Dissect(TyperCommand):
    """Built on first use, so that other commands do not import dissectors of other packages."""

    @functools.cached_property
    def _made(self) -> Any:
        from cardan.dissect import registry

        app = typer.Typer(add_completion=False, rich_markup_mode="rich")
        dissectors = registry.dissectors()
        lines = (f"{each.name}: {inspect.getdoc(each)}" for each in dissectors)
        numbers = [option for each in dissectors for option in each.options]
        app.command(help="\n\n".join((str(self.help), *lines)))(_function(numbers))
        return typer.main.get_command(app)

    def get_params(self, ctx: Any) -> Any:
        return self._made.get_params(ctx)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        self._made.format_help(ctx, formatter)

    def invoke(self, ctx: Any) -> Any:
        return self._made.invoke(ctx)


def _function(numbers: list[Numbers]) -> Any:
    """The function that typer makes the command of: options of all captures, and of protocols."""

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
    dissect.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    dissect.__annotations__ = {each.name: each.annotation for each in parameters}
    return dissect


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
