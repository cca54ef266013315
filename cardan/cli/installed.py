"""Commands of other packages: for each entry point of the group a function, as typer has it, or a
class of commands, which makes its options when it is asked for them."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand, TyperGroup

from cardan.cli.common import EPILOG
from cardan.cli.declared import Commands
from cardan.common.plugins import Finder, entry_points
from cardan.errors import ConfigurationError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

ENTRY_POINT_GROUP = "cardan.commands"

GROUPS = {
    "Run": "demo check run arm",
    "Devices and robots": "devices drivers udev share doctor explain robots force haptic spnav",
    "Network": "network net echo hz messages face",
    "Record": "record replay plot export",
    "Daemon": "serve ps top log events start stop restart switch reload service",
    "Test": "sim conform dissect evaluate",
}
"""The help's groups of commands, in order."""
OTHERS = "Of other packages"


def _installed() -> EntryPoints:
    return entry_points(group=ENTRY_POINT_GROUP)


class _Functions(Finder[Any]):
    def _check(self, loaded: Any, of: str) -> None:
        if not callable(loaded):
            raise ConfigurationError(self._word, f"{of} is no function")


def _command(name: str, function: Callable[..., Any]) -> Any:
    if isinstance(function, type) and issubclass(function, TyperCommand):
        return function(name, help=inspect.getdoc(function))
    app = typer.Typer(add_completion=False, rich_markup_mode="rich")
    app.command(name, epilog=EPILOG)(function)
    return typer.main.get_command(app)


class CardanCommands(TyperGroup):
    """Cardan's own commands, then those of other packages, which are imported when asked for."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        finder = _Functions(object, "command", {}, _installed)
        self._others = Commands(finder, "command", _command)

    def list_commands(self, ctx: Any) -> list[str]:
        there = dict.fromkeys((*super().list_commands(ctx), *self._others))
        grouped = (name for names in GROUPS.values() for name in names.split())
        return [*dict.fromkeys(name for name in (*grouped, *there) if name in there)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        command: Any = super().get_command(ctx, cmd_name) or self._others.get(cmd_name)
        if command is not None:
            groups = (group for group, names in GROUPS.items() if cmd_name in names.split())
            command.rich_help_panel = next(groups, OTHERS)
            command.short_help = _first_sentence(command.help or "")
        return command


def _first_sentence(text: str) -> str:
    """The first of a docstring, or what comes before its colon, on one line."""
    return re.split(r"[.:](?=\s|$)", " ".join(text.split()), maxsplit=1)[0]
