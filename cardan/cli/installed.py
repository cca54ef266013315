"""Groups of commands: Cardan's own by purpose, then those of other packages. An entry point of the
group is a function, as typer takes it, or a class of commands, whose options are made when it is
loaded."""

from __future__ import annotations

import inspect
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand, TyperGroup

from cardan.cli.common import EPILOG, closing
from cardan.cli.examples import EXAMPLES
from cardan.cli.moved import now_called
from cardan.cli.options_from_dataclass import Commands
from cardan.common.plugins import Finder, entry_points
from cardan.common.text_sanitizer import printable
from cardan.errors import ConfigurationError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

ENTRY_POINT_GROUP = "cardan.commands"

TOP = "cardan"

SECTIONS = {
    TOP: {
        "Run": "demo check run daemon",
        "Devices, robots, network": "devices robots net doctor",
        "Test": "sim conform dissect evaluate",
    },
    "daemon": {
        "The daemon": "run reload service",
        "Its sessions and servers": "ps top log events start stop restart",
        "Its arms and devices": "arm switch",
    },
    "devices": {
        "Find and open them": "list drivers udev",
        "Serve one to other programs": "share force haptic spnav",
    },
    "net": {
        "Look": "list echo hz",
        "Join": "pair server messages",
        "Records": "record replay plot export",
    },
}
"""Groups of commands that other packages may add to, and the sections of their help, in order."""
OTHERS = "Of other packages"


def _installed() -> EntryPoints:
    return entry_points(group=ENTRY_POINT_GROUP)


class _Functions(Finder[Any]):
    def _check(self, loaded: Any, of: str) -> None:
        if not callable(loaded):
            raise ConfigurationError(self._word, f"{of} is not a function")


def _command(point: str, function: Callable[..., Any]) -> Any:
    """Load the command of an entry point, NAME or GROUP.NAME. Raises ConfigurationError."""
    group, _, name = point.rpartition(".")
    if group and group not in SECTIONS:
        there = ", ".join(each for each in SECTIONS if each != TOP)
        raise ConfigurationError("command", f"{point!r}: there is no group {group!r}, but {there}")
    if isinstance(function, type) and issubclass(function, TyperCommand):
        return function(name, help=inspect.getdoc(function))
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(name, epilog=EPILOG)(function)
    return typer.main.get_command(app)


class CommandGroup(TyperGroup):
    """Group whose help lists each command in sections, and then its options. The help of a command
    of `EXAMPLES` ends with the example and the exit codes."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        # The help of all commands below is as wide as the terminal.
        self.context_settings.setdefault("max_content_width", sys.maxsize)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        command: Any = super().get_command(ctx, cmd_name)
        return None if command is None else self._described(command, cmd_name)

    def _described(self, command: Any, name: str) -> Any:
        # Commands of a registry have a one-sentence help, which is listed whole.
        whole = isinstance(self.commands, Commands)
        command.short_help = _summary(command) if whole else _on_a_line(command)
        if example := EXAMPLES.get(f"{self.name} {name}"):
            command.epilog = closing(example)
        return command

    def format_options(self, ctx: Any, formatter: Any) -> None:
        rows = defaultdict(list)
        for name in self.list_commands(ctx):
            if (command := self.get_command(ctx, name)) is not None and not command.hidden:
                rows[self.section_of(name)].append((name, printable(command.short_help)))
        rows["Options"] = [
            row for each in self.get_params(ctx) if (row := each.get_help_record(ctx)) is not None
        ]
        for title, lines in rows.items():
            with formatter.section(title):
                formatter.write_dl(lines)

    def section_of(self, name: str) -> str:
        """Return the section of the help that lists the command."""
        return "Commands"


class OpenGroup(CommandGroup):
    """Group of `SECTIONS`: Cardan's own commands, then those of other packages, which are imported
    on use."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        finder = _Functions(object, "command", {}, _installed)
        self._others = Commands(finder, "command", _command)
        self._sections = SECTIONS[self.name or TOP]

    def _point(self, name: str) -> str:
        """Return the entry point of a command."""
        return name if self.name == TOP else f"{self.name}.{name}"

    def _found(self) -> Iterator[str]:
        """Yield the commands of other packages; those of an unknown group are listed at the top
        with a remark."""
        for point in self._others:
            group, _, name = point.rpartition(".")
            if group == self.name:
                yield name
            elif self.name == TOP and group not in SECTIONS:
                yield point

    def list_commands(self, ctx: Any) -> list[str]:
        there = dict.fromkeys((*super().list_commands(ctx), *self._found()))
        listed = (name for names in self._sections.values() for name in names.split())
        return [*dict.fromkeys(name for name in (*listed, *there) if name in there)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        command: Any = super().get_command(ctx, cmd_name)
        if command is None and (other := self._others.get(self._point(cmd_name))) is not None:
            return self._described(other, cmd_name)
        return command

    def section_of(self, name: str) -> str:
        return next(
            (each for each, names in self._sections.items() if name in names.split()), OTHERS
        )

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        # No messages during shell completion.
        group = "" if self.name == TOP else self.name or ""
        said = now_called(args, group) if args and not ctx.resilient_parsing else ""
        if said and self.get_command(ctx, args[0]) is None:
            raise ConfigurationError("command", said)
        return super().resolve_command(ctx, args)


def _on_a_line(command: Any) -> str:
    """Describe a command in a list: the first sentence of its help, or the part before its
    colon."""
    return re.split(r"[.:](?=\s|$)", _summary(command), maxsplit=1)[0]


def _summary(command: Any) -> str:
    """Return the help of a command on one line."""
    return " ".join((command.help or "").split())
