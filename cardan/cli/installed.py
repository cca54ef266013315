"""Commands of other packages: a function, as typer has it, for each entry point of the group."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperGroup

from cardan.cli.common import EPILOG
from cardan.cli.declared import Commands
from cardan.common.plugins import Finder, entry_points
from cardan.errors import ConfigurationError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

ENTRY_POINT_GROUP = "cardan.commands"


def _installed() -> EntryPoints:
    return entry_points(group=ENTRY_POINT_GROUP)


class _Functions(Finder[Any]):
    def _check(self, loaded: Any, of: str) -> None:
        if not callable(loaded):
            raise ConfigurationError(self._word, f"{of} is no function")


def _command(name: str, function: Callable[..., None]) -> Any:
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
        own = super().list_commands(ctx)
        return [*own, *(name for name in self._others if name not in own)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        return super().get_command(ctx, cmd_name) or self._others.get(cmd_name)
