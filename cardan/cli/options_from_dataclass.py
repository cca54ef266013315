"""Commands made of options dataclasses: their fields become options.

``cardan sim`` and ``cardan net server`` are such groups of commands.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import enum
import inspect
import textwrap
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    Protocol,
    get_args,
    get_origin,
    get_type_hints,
)

import typer

from cardan.cli.common import (
    Level,
    LogLevel,
    Seconds,
    Verbose,
    begin_serving,
    closing,
    print_table,
    print_unusable,
)
from cardan.common.bounds import ANY_PORT
from cardan.common.options import CODE_ONLY, suggestion
from cardan.common.plugins import Loaded, is_lack, not_installed, reason
from cardan.errors import ConfigurationError, OptionError
from cardan.sim_peers.command import Option, name_and_unit, option_of


class Registry(Protocol):
    """Classes by name: drivers, simulated peers, servers."""

    def names(self) -> tuple[str, ...]:
        """Return all names that can be loaded."""

    def load(self, name: str) -> Any:
        """Load the class `name`. Raises ConfigurationError."""

    def load_all(self) -> Loaded[Any]:
        """Load every class, and collect the reasons why others cannot be loaded."""

    def using(self, name: str, key: str) -> AbstractContextManager[None]:
        """Raise errors of another package's class inside as a ConfigurationError of `key`."""


class Given(NamedTuple):
    """Field of an options dataclass that is set on the command line."""

    field: dataclasses.Field[Any]
    type: Any
    option: Option
    owner: type
    """The dataclass that the field belongs to."""

    @property
    def flag(self) -> str:
        """Return the option as it is typed."""
        return f"--{self.option.name or name_and_unit(self.field.name)[0]}"

    @property
    def choices(self) -> dict[str, Any]:
        """Return the values of an enum or Literal type by name; empty for other types."""
        found: dict[str, Any] = {}
        for each in (self.type, *get_args(self.type)):
            if isinstance(each, type) and issubclass(each, enum.Enum):
                found.update({str(member.value): member for member in each})
            elif get_origin(each) is Literal:
                found.update({str(value): value for value in get_args(each)})
        return found

    @property
    def default_port(self) -> int:
        """Return the default port of an option HOST:PORT."""
        defaults: dict[str, Any] = {
            each.name: each.default for each in dataclasses.fields(self.owner)
        }
        port: int = defaults[self.option.port_field]
        return port

    @property
    def parameter(self) -> inspect.Parameter:
        """Return the parameter for typer. Its default is the field's, or None if `read` makes the
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
        spec = typer.Argument(**shown) if option.positional else typer.Option(self.flag, **shown)
        return parameter_of(self.field.name, Annotated[kind, spec], default)

    def values(self, given: Any) -> dict[str, Any]:
        """Return the values of the fields that `given` sets; empty if it keeps the defaults."""
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
                allowed = ", ".join(self.choices) + suggestion(given, self.choices)
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
        if not (colon and host and port.isdecimal() and len(port) <= 5 and int(port) in ANY_PORT):
            example = f"{self.field.default}:{self.default_port}"
            raise ConfigurationError(self.flag, f"{text!r} is not HOST:PORT, as {example}")
        return host, int(port)


def parameter_of(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, kind, default=default, annotation=annotation)


def all_given(options: type, described: bool = False) -> Iterator[Given]:
    """Yield the fields made by `option`, also those of nested dataclasses. With `described`, yield
    the other fields too, each with the text below it."""
    types = get_type_hints(options)
    texts = texts_below(options) if described else {}
    for each in dataclasses.fields(options):
        if (option := option_of(each)) is not None:
            yield Given(each, types[each.name], option, options)
        elif dataclasses.is_dataclass(types[each.name]):
            yield from all_given(types[each.name], described)
        elif described and not (CODE_ONLY.items() <= each.metadata.items()):
            option = _described(each, types[each.name], texts.get(each.name, ""))
            yield Given(each, types[each.name], option, options)


def _described(field: dataclasses.Field[Any], kind: Any, text: str) -> Option:
    """Return the option of a field with the help `text`. A tuple's items are given one by one."""
    if get_origin(kind) is tuple:
        shown = f" [default: {', '.join(field.default)}]" if field.default else ""  # type: ignore[arg-type]
        return Option(help=f"{text}{shown} (repeatable)", read=str, repeatable=True)
    # The flag turns off a default of True.
    name = f"no-{name_and_unit(field.name)[0]}" if kind is bool and field.default else ""
    return Option(help=text, name=name)


def texts_below(options: type) -> dict[str, str]:
    """Return the text below each field, those of inherited classes included."""
    found: dict[str, str] = {}
    for each in reversed(options.__mro__):
        if dataclasses.is_dataclass(each):
            # Without source, as in some packed programs, options have no help.
            with contextlib.suppress(OSError):
                found.update(_texts_of(inspect.getsource(each)))
    return found


def _texts_of(source: str) -> dict[str, str]:
    """Return the text below each field of a class."""
    body = ast.parse(textwrap.dedent(source)).body[0]
    assert isinstance(body, ast.ClassDef)
    return {
        ast.unparse(field.target): _text(below.value)
        for field, below in zip(body.body, body.body[1:], strict=False)
        if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr)
    }


def _text(node: ast.expr) -> str:
    text = node.value if isinstance(node, ast.Constant) else ""
    return " ".join(text.split()) if isinstance(text, str) else ""


def made(options: type, values: Mapping[type, Mapping[str, Any]]) -> Any:
    """Return `options` with its nested dataclasses, each made with its own values."""
    types = get_type_hints(options)
    inside = {
        each.name: made(types[each.name], values)
        for each in dataclasses.fields(options)
        if dataclasses.is_dataclass(types[each.name])
    }
    return options(**inside, **values.get(options, {}))


def named(error: ConfigurationError, own: Mapping[str, Given]) -> ConfigurationError:
    """Replace the names of fields in the error by flags, if all of them have one."""
    flags = {each.option.port_field: each.flag for each in own.values() if each.option.port_field}
    flags.update({field: each.flag for field, each in own.items()})
    keys = [key.rpartition(".")[2] for key in error.key.split(", ")]
    if not all(key in flags for key in keys):
        return error
    named = ", ".join(flags[key] for key in keys)
    if isinstance(error, OptionError):
        return OptionError(named, error.value, error.allowed)
    return ConfigurationError(named, error.message)


def broken(name: str, error: Exception) -> Any:
    """Return a command for a class that cannot be loaded; it prints the reason."""

    def run() -> None:
        raise error

    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    settings = {"allow_extra_args": True, "ignore_unknown_options": True}
    app.command(name, help=f"cannot be loaded: {reason(error)}", context_settings=settings)(run)
    return typer.main.get_command(app)


class Commands(Mapping[str, Any]):
    """The commands of a registry by name; a class is imported when its command is looked up."""

    def __init__(self, registry: Registry, word: str, make: Callable[[str, Any], Any]) -> None:
        """`make` makes the command of a name and its class; `word` is the term for an entry.
        Commands that only the source tree has print the place, and are not listed."""
        self._registry, self._word, self._make = registry, word, make
        self._made: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._made:
            if name not in self._registry.names() and not not_installed(self._word, name):
                raise KeyError(name)
            try:
                with self._registry.using(name, self._word):
                    self._made[name] = self._make(name, self._registry.load(name))
            except Exception as error:
                if not isinstance(error, ConfigurationError) and not is_lack(error):
                    raise
                self._made[name] = broken(name, error)
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._registry.names())

    def __len__(self) -> int:
        return len(self._registry.names())


def collected(
    own: Mapping[str, Given], given: Mapping[str, Any]
) -> defaultdict[type, dict[str, Any]]:
    """Collect the values of fields from the command line, by the dataclasses that own them."""
    values: defaultdict[type, dict[str, Any]] = defaultdict(dict)
    for field, value in given.items():
        if field in own:
            values[own[field].owner].update(own[field].values(value))
    return values


SERVING = {"seconds": (Seconds, None), "verbose": (Verbose, False), "log_level": (Level, None)}
"""Options of every command that serves, besides its own fields, and their defaults."""


def serving_parameters() -> dict[str, inspect.Parameter]:
    """Return the parameters of `SERVING`, for typer."""
    return {name: parameter_of(name, kind, default) for name, (kind, default) in SERVING.items()}


def run_logged(
    run: Callable[[], int | None], own: Mapping[str, Given], verbose: bool, level: LogLevel | None
) -> None:
    """Run a command that serves: log to standard error, name flags in errors of fields. An exit
    code other than 0 is passed on."""
    begin_serving(verbose, level, LogLevel.INFO)
    try:
        code = run()
    except ConfigurationError as error:
        raise named(error, own) from None
    if code:
        raise typer.Exit(code)


def command_of(
    group: str,
    name: str,
    declared: Any,
    own: Mapping[str, Given],
    parameters: Mapping[str, inspect.Parameter],
    run: Callable[..., None],
) -> Any:
    """Return the command `name` of `group`, which calls `run` with `parameters`, including its
    `own` fields; help, epilog and example are those of the class `declared`."""
    run.__signature__ = inspect.Signature(list(parameters.values()))  # type: ignore[attr-defined]
    run.__annotations__ = {key: each.annotation for key, each in parameters.items()}
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    # Words after a program's name belong to the program.
    interspersed = not any(each.option.positional for each in own.values())
    app.command(
        name,
        help=declared.__doc__ or "",
        epilog=f"{declared.epilog}\n\n{closing(f'{group} {name} {declared.example}')}",
        context_settings={"allow_interspersed_args": interspersed},
    )(run)
    return typer.main.get_command(app)


def listed(
    context: typer.Context,
    wanted: bool,
    registry: Registry,
    columns: tuple[str, str],
    as_json: bool,
) -> None:
    """Handle a group without a command. If `wanted`, print its commands with their summaries, and
    unusable ones, and end. Return at once if a command was given."""
    if wanted:
        found = registry.load_all()
        rows = (
            (name, " ".join((each.__doc__ or "").split())) for name, each in found.classes.items()
        )
        print_table(columns, rows, as_json)
        if not as_json:
            print_unusable(found)
        raise typer.Exit
    if as_json:
        raise ConfigurationError("--json", "goes with --list")
    if context.invoked_subcommand is None:
        raise ConfigurationError(context.command_path, "name is missing: --list prints the names")
