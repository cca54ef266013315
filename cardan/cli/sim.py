"""``cardan sim``: a command for each simulated peer, made of what the peer declares."""

from __future__ import annotations

import dataclasses
import enum
import inspect
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperGroup

from cardan.bounds import ANY_PORT
from cardan.cli.common import (
    Level,
    LogLevel,
    Seconds,
    Verbose,
    begin_serving,
    print_table,
    print_unusable,
)
from cardan.errors import ConfigurationError, OptionError
from cardan.plugins import reason
from cardan.sim_peers import registry
from cardan.sim_peers.base import parse_faults
from cardan.sim_peers.command import Option, PeerCommand, name_and_unit, option_of

Script = Annotated[str, typer.Option(metavar="NAME|FILE", help="Its motion; see --list-scripts.")]
Fault = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        metavar="NAME[=VALUE]",
        help="A fault to have (repeatable); see --list-faults.",
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]


class _Commands(Mapping[str, Any]):
    """The commands by the peers' names; a peer is imported when its command is asked for."""

    def __init__(self) -> None:
        self._made: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._made:
            if name not in registry.names():
                raise KeyError(name)
            try:
                with registry.using(name, "simulated peer"):
                    self._made[name] = _command(name, registry.load(name))
            except ConfigurationError as error:
                self._made[name] = _broken(name, error)
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(registry.names())

    def __len__(self) -> int:
        return len(registry.names())


class _Peers(TyperGroup):
    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: Any = _Commands()


sim = typer.Typer(name="sim", cls=_Peers, no_args_is_help=True, rich_markup_mode="rich")


def _list_peers(wanted: bool) -> None:
    if wanted:
        found = registry.load_all()
        rows = (
            (name, inspect.cleandoc(peer.__doc__ or "")) for name, peer in found.classes.items()
        )
        print_table(("peer", "stands in for"), rows)
        print_unusable(found)
        raise typer.Exit


@sim.callback()
def _sim(
    _list: Annotated[
        bool,
        typer.Option(
            "--list", callback=_list_peers, is_eager=True, help="Print the peers, then end."
        ),
    ] = False,
) -> None:
    """Stand in for a piece of hardware, speaking its real protocol."""


class _Given(NamedTuple):
    """A field of an options dataclass that the command line sets."""

    field: dataclasses.Field[Any]
    type: Any
    option: Option
    owner: type
    """The dataclass that the field belongs to."""

    @property
    def flag(self) -> str:
        """The option as it is written."""
        return f"--{self.option.name or name_and_unit(self.field.name)[0]}"

    @property
    def choices(self) -> dict[str, Any]:
        """The values of an enum's or a Literal's type by their names; none for other types."""
        found: dict[str, Any] = {}
        for each in (self.type, *get_args(self.type)):
            if isinstance(each, type) and issubclass(each, enum.Enum):
                found.update({str(member.value): member for member in each})
            elif get_origin(each) is Literal:
                found.update({str(value): value for value in get_args(each)})
        return found

    @property
    def default_port(self) -> int:
        """The port of an option HOST:PORT where none is given."""
        defaults: dict[str, Any] = {
            each.name: each.default for each in dataclasses.fields(self.owner)
        }
        port: int = defaults[self.option.port_field]
        return port

    @property
    def parameter(self) -> inspect.Parameter:
        """The parameter for typer. Its default is the field's, or None where `read` makes the
        value."""
        option, default = self.option, self.field.default
        kind: Any = self.type
        if kind is bool:
            default, kind = False, bool
        elif option.positional or option.repeatable:
            default, kind = None, list[str] | None
        elif option.port_field:
            default, kind = f"{default}:{self.default_port}", str
        elif self.choices:
            default, kind = getattr(default, "value", default), str | None
        elif option.read is not None:
            default, kind = None, str | None
        metavar = option.metavar or "|".join(self.choices) or name_and_unit(self.field.name)[1]
        if kind is bool:
            metavar = ""
        shown: dict[str, Any] = {"metavar": metavar or None, "help": option.help}
        shown["show_default"] = kind is not bool and default not in (None, "")
        told = typer.Argument(**shown) if option.positional else typer.Option(self.flag, **shown)
        return _parameter(self.field.name, Annotated[kind, told], default)

    def values(self, given: Any) -> dict[str, Any]:
        """Values of the fields that `given` sets; empty where it keeps the defaults."""
        name, option = self.field.name, self.option
        if self.type is bool:
            return {name: not self.field.default} if given else {}
        if given is None:
            return {}
        if option.positional:
            return {name: tuple(given)}
        if option.port_field:
            host, port = self._host_and_port(given)
            return {name: host, option.port_field: port}
        if self.choices:
            if given not in self.choices:
                allowed = ", ".join(self.choices)
                raise ConfigurationError(self.flag, f"{given!r} is unknown; allowed: {allowed}")
            return {name: self.choices[given]}
        if option.repeatable:
            return {name: tuple(self._read(text) for text in given)}
        return {name: given if option.read is None else self._read(given)}

    def _read(self, text: str) -> Any:
        assert self.option.read is not None, f"{self.field.name} needs a function that reads it"
        try:
            return self.option.read(text)
        except ValueError as error:
            raise ConfigurationError(self.flag, str(error)) from None

    def _host_and_port(self, text: str) -> tuple[str, int]:
        host, colon, port = text.rpartition(":")
        if not (colon and host and port.isdecimal() and int(port) in ANY_PORT):
            example = f"{self.field.default}:{self.default_port}"
            raise ConfigurationError(self.flag, f"{text!r} is not HOST:PORT, as {example}")
        return host, int(port)


def _parameter(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, kind, default=default, annotation=annotation)


def _all_given(options: type) -> Iterator[_Given]:
    """The fields that `option` made, those of dataclasses inside included."""
    types = get_type_hints(options)
    for each in dataclasses.fields(options):
        if (option := option_of(each)) is not None:
            yield _Given(each, types[each.name], option, options)
        elif dataclasses.is_dataclass(types[each.name]):
            yield from _all_given(types[each.name])


def _made(options: type, values: Mapping[type, Mapping[str, Any]]) -> Any:
    """`options` and its nested dataclasses, each made with its own values."""
    types = get_type_hints(options)
    inside = {
        each.name: _made(types[each.name], values)
        for each in dataclasses.fields(options)
        if dataclasses.is_dataclass(types[each.name])
    }
    return options(**inside, **values.get(options, {}))


def _named(error: ConfigurationError, own: Mapping[str, _Given]) -> ConfigurationError:
    """The same error, of the flags that set the fields it is of."""
    flags = {each.option.port_field: each.flag for each in own.values() if each.option.port_field}
    flags.update({field: each.flag for field, each in own.items()})
    keys = [key.rpartition(".")[2] for key in error.key.split(", ")]
    if not all(key in flags for key in keys):
        return error
    named = ", ".join(flags[key] for key in keys)
    if isinstance(error, OptionError):
        return OptionError(named, error.value, error.allowed)
    return ConfigurationError(named, error.message)


def _broken(name: str, error: ConfigurationError) -> Any:
    """The command of a peer that cannot be loaded, which says why."""

    def run() -> None:
        raise error

    app = typer.Typer(add_completion=False)
    settings = {"allow_extra_args": True, "ignore_unknown_options": True}
    app.command(name, help=f"cannot be loaded: {reason(error)}", context_settings=settings)(run)
    return typer.main.get_command(app)


def _command(name: str, peer: type[PeerCommand[Any]]) -> Any:
    """The command of a peer, as typer makes it of a function."""
    own = {each.field.name: each for each in _all_given(peer.Options)}
    fields = {each.name: each for each in dataclasses.fields(peer.Options)}
    parameters = {name: each.parameter for name, each in own.items()}
    parameters["seconds"] = _parameter("seconds", Seconds, None)
    parameters["verbose"] = _parameter("verbose", Verbose, False)
    parameters["log_level"] = _parameter("log_level", Level, None)
    for field, annotation in (("script", Script), ("faults", Fault), ("seed", Seed)):
        if field in fields:
            default = None if field == "faults" else fields[field].default
            shared = _parameter(field, annotation, default)
            parameters[field] = parameters.pop(field, shared)  # Keeps the common order.
    lists = _lists(peer, own, fields)
    for flag, (help_, _) in lists.items():
        wanted = Annotated[bool, typer.Option(f"--list-{flag}", help=help_)]
        parameters[f"list_{flag}"] = _parameter(f"list_{flag}", wanted, False)

    def run(**given: Any) -> None:
        listed = [flag for flag in lists if given.pop(f"list_{flag}")]
        seconds, verbose, level = (given.pop(name) for name in ("seconds", "verbose", "log_level"))
        for flag in listed:
            for line in lists[flag][1](given):
                print(line)
        if listed:
            return
        values: defaultdict[type, dict[str, Any]] = defaultdict(dict)
        for field, value in given.items():
            if field in own:
                values[own[field].owner].update(own[field].values(value))
            elif field == "faults":
                faults = parse_faults(value or (), peer.faults_with(given))
                values[peer.Options][field] = faults
            else:
                values[peer.Options][field] = value
        begin_serving(verbose, level, LogLevel.INFO)
        try:
            code = peer.run(_made(peer.Options, values), seconds)
        except ConfigurationError as error:
            raise _named(error, own) from None
        if code:
            raise typer.Exit(code)

    run.__signature__ = inspect.Signature(list(parameters.values()))  # type: ignore[attr-defined]
    run.__annotations__ = {key: each.annotation for key, each in parameters.items()}
    app = typer.Typer(add_completion=False, rich_markup_mode="rich")
    # What follows a program's name is the program's.
    interspersed = not any(each.option.positional for each in own.values())
    app.command(
        name,
        help=peer.__doc__,
        epilog=peer.epilog,
        context_settings={"allow_interspersed_args": interspersed},
    )(run)
    return typer.main.get_command(app)


Lines = Callable[[Mapping[str, Any]], Iterator[str]]
"""Lines to print, where these options are given."""


def _lists(
    peer: type[PeerCommand[Any]], own: Mapping[str, _Given], fields: Mapping[str, Any]
) -> dict[str, tuple[str, Lines]]:
    """What ``--list-...`` prints: help and lines, by the rest of the option's name."""

    def values(listed: Sequence[tuple[str, str]]) -> Lines:
        width = max(16, *(len(value) for value, _ in listed))
        return lambda _given: (f"{value:{width}} {text}" for value, text in listed)

    def faults(given: Mapping[str, Any]) -> Iterator[str]:
        for fault in peer.faults_with(given):
            yield f"{fault.name:16} {fault.help} (default {fault.default:g})"

    def scripts(_given: Mapping[str, Any]) -> Iterator[str]:
        for name, text in peer.scripts.items():
            first = text.strip().splitlines()[0]
            yield f"{name:16} {first.lstrip('# ') if first.startswith('#') else ''}"
        yield "\na file has a line a step, SECONDS and then one of:"
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
