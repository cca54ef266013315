"""``cardan net server``: a command for each server, made of the server's options."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import typer

from cardan.cli.common import AsJson
from cardan.cli.installed import CommandGroup
from cardan.cli.options_from_dataclass import (
    SERVING,
    Commands,
    all_given,
    collected,
    command_of,
    listed,
    made,
    named,
    run_logged,
    serving_parameters,
)
from cardan.errors import ConfigurationError
from cardan.gateway.servers import registry
from cardan.gateway.servers.base import Server


class _Servers(CommandGroup):
    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: Any = Commands(registry, "server", _command)


server = typer.Typer(name="server", cls=_Servers, no_args_is_help=True, rich_markup_mode=None)


@server.callback(invoke_without_command=True)
def _server(
    context: typer.Context,
    list_: Annotated[bool, typer.Option("--list", help="Print the servers, then end.")] = False,
    as_json: AsJson = False,
) -> None:
    """Serve the network in another protocol, or run its router."""
    listed(context, list_, registry, ("server", "what it does"), as_json)


def _command(name: str, declared: type[Server[Any]]) -> Any:
    own = {each.field.name: each for each in all_given(declared.Options, described=True)}
    parameters = {field: each.parameter for field, each in own.items()}
    parameters |= serving_parameters()

    def run(**given: Any) -> None:
        seconds, verbose, level = (given.pop(name) for name in SERVING)
        values = collected(own, given)
        run_logged(
            lambda: declared.run(made(declared.Options, values), seconds), own, verbose, level
        )

    return command_of("cardan net server", name, declared, own, parameters, run)


def check_words(name: str, words: Sequence[str]) -> None:
    """Raise ConfigurationError for words that the command of a server would refuse."""
    declared = registry.load(name)
    own = {each.field.name: each for each in all_given(declared.Options, described=True)}
    try:
        with _command(name, declared).make_context(name, [*words]) as context:
            given = {key: value for key, value in context.params.items() if key in own}
            made(declared.Options, collected(own, given))
    except ConfigurationError as error:
        raise named(error, own) from None
    except Exception as error:
        # The command line's own errors: typer's releases have them in different modules.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        parameter: Any = getattr(error, "param", None)
        option = getattr(error, "option_name", "") or (parameter.opts[0] if parameter else "")
        raise ConfigurationError(option, " ".join(message().split())) from None
