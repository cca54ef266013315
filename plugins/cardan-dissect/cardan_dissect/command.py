"""``cardan dissect``, with the options of all dissectors."""

from __future__ import annotations

import functools
import inspect
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

if TYPE_CHECKING:
    from cardan_dissect.reader import Numbers


PROGRESS_S = 0.5
"""Period of the progress reports of a long capture."""


class Dissect(TyperCommand):
    """Print a capture, field by field."""

    # Built on first use, so that other commands do not import dissectors of other packages.

    @functools.cached_property
    def _made(self) -> Any:
        from cardan_dissect import registry

        app = typer.Typer(add_completion=False, rich_markup_mode=None)
        dissectors = registry.dissectors()
        lines = (f"{each.name}: {inspect.getdoc(each)}" for each in dissectors)
        numbers = [option for each in dissectors for option in each.options]
        app.command(help="\n\n".join((str(self.help), *lines)))(_function(numbers))
        return typer.main.get_command(app)

    def get_params(self, ctx: Any) -> Any:
        return self._made.get_params(ctx)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        self._made.epilog = self.epilog
        self._made.format_help(ctx, formatter)

    def invoke(self, ctx: Any) -> Any:
        return self._made.invoke(ctx)


def _function(numbers: list[Numbers]) -> Any:
    """Return the function for typer's command: options of all captures, and of protocols."""

    def dissect(
        files: Annotated[
            list[Path],
            typer.Argument(
                metavar="FILE...",
                help="pcap or pcapng files, btsnoop logs, or logs of a CAN bus (candump -L, .asc, "
                ".blf), which are read one after the other; - for a pipe.",
            ),
        ],
        limit: Annotated[
            int | None, typer.Option(min=1, help="Print at most this many packets.")
        ] = None,
        summary: Annotated[
            bool, typer.Option("--summary", help="Print the figures of each flow only.")
        ] = False,
        **given: list[int] | None,
    ) -> None:
        from cardan_dissect import dissect_file

        places = {key: found or () for key, found in given.items()}
        progress = _Progress(sys.stderr.isatty() and (summary or not sys.stdout.isatty()))
        try:
            dissect_file(
                files, sys.stdout, limit=limit, summary=summary, progress=progress.tell, **places
            )
        finally:
            progress.clear()

    files, *rest = list(inspect.signature(dissect, eval_str=True).parameters.values())[:-1]
    parameters = [files, *map(_parameter, numbers), *rest]
    dissect.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    dissect.__annotations__ = {each.name: each.annotation for each in parameters}
    return dissect


class _Progress:
    """Progress of a long capture: a line on a terminal that is overwritten."""

    def __init__(self, shown: bool) -> None:
        self._shown = shown
        self._due_s = time.monotonic() + PROGRESS_S
        self._wide = 0

    def tell(self, packets: int, share: float | None) -> None:
        """Show the number of packets read, and the share of the file."""
        if not self._shown or time.monotonic() < self._due_s:
            return
        self._due_s = time.monotonic() + PROGRESS_S
        line = f"{packets} packets" + ("" if share is None else f", {share:.0%} of the file")
        print(f"\r{line.ljust(self._wide)}", end="", file=sys.stderr, flush=True)
        self._wide = len(line)

    def clear(self) -> None:
        """Clear the line."""
        if self._wide:
            print(f"\r{' ' * self._wide}\r", end="", file=sys.stderr, flush=True)


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
