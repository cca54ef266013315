"""Declaration of a simulated peer, from which ``cardan sim`` makes its command."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, dataclass, field
from typing import Any, ClassVar, Generic, TypeVar

from cardan.sim_peers.base import FaultSwitch, serve

OptionsT = TypeVar("OptionsT")
V = TypeVar("V")

UNITS = {
    "_deg_s": "DEG/S",
    "_m_s": "M/S",
    "_deg": "DEG",
    "_rad": "RAD",
    "_hz": "HZ",
    "_kg": "KG",
    "_ms": "MS",
    "_mm": "MM",
    "_m": "M",
    "_n": "N",
    "_s": "S",
}
"""Suffixes of fields' names that are units, and their form in the help; the first match counts. An
option's name is its field's without the unit."""

_KEY = "cardan option"


@dataclass(frozen=True, kw_only=True)
class Option:
    """How one field is given on the command line; set by `option`."""

    help: str
    name: str = ""
    """Without the leading dashes; empty: the field's name, without its unit."""
    metavar: str = ""
    """Placeholder of the value in the help; empty: the choices or the unit, if there are any."""
    read: Callable[[str], Any] | None = None
    """Parser of the value; ValueError says what is wrong. None: the field's type parses it."""
    repeatable: bool = False
    """May be given several times; the field is a tuple of the values parsed by `read`."""
    port_field: str = ""
    """The field for the port: this one is the host of HOST:PORT."""
    listed: Sequence[tuple[str, str]] = ()
    """Possible values, each with a short description: ``--list-NAMEs`` prints them."""
    positional: bool = False
    """Words after the options, dashes included: a program and its arguments."""


def option(default: V, text: str, **how: Any) -> V:
    """Return a dataclass's field that is an option of the peer's command; `text` is its help, and
    `how` has the other fields of `Option`.

    A bool is a flag, which turns the default around. A field of an enum's or a Literal's type takes
    one of its values. A field that is itself a dataclass needs no `option`: its own fields count.
    """
    return field(default=default, metadata={_KEY: Option(help=text, **how)})


def listen_option(what: str) -> str:
    """Return the field `host` of a peer that listens there, by default on loopback; `what` listens,
    for its help. The port is in the field ``port``."""
    text = f"{what}; port 0: any."
    return option("127.0.0.1", text, name="listen", metavar="HOST:PORT", port_field="port")


def option_of(of: Field[Any]) -> Option | None:
    """Return how the field is given on the command line; None if it is not an option."""
    found: Option | None = of.metadata.get(_KEY)
    return found


def name_and_unit(field_name: str) -> tuple[str, str]:
    """Split a field's name into the option's name and its unit, which may be empty."""
    for ending, unit in UNITS.items():
        if field_name.endswith(ending):
            return field_name.removesuffix(ending).replace("_", "-"), unit
    return field_name.replace("_", "-"), ""


def numbers(text: str, count: int) -> tuple[float, ...]:
    """Parse `count` numbers with commas between them. Raises ValueError."""
    try:
        found = tuple(float(word) for word in text.split(","))
    except ValueError:
        found = ()
    if len(found) != count:
        raise ValueError(f"{text!r} is not {count} numbers with commas")
    return found


class PeerCommand(Generic[OptionsT]):
    """Command of a simulated peer for ``cardan sim``. It is never instantiated; the class's
    docstring names the simulated hardware, and is the command's summary.

    Fields of `Options` that are made by `option` are its options. Three names add options:
    ``faults`` (by name, as `parse_faults` gives them) it has ``--fault`` and ``--list-faults``,
    with ``script`` ``--script`` and ``--list-scripts``, with ``seed`` ``--seed``.
    """

    Options: ClassVar[type]
    """A frozen dataclass. All fields have defaults."""
    page: ClassVar[str] = ""
    """Documentation: a page relative to Cardan's docs/, or a URL."""
    speaks: ClassVar[str] = ""
    """Protocol and transport, for documentation tables (Markdown, links as in docs/)."""
    Peer: ClassVar[type]
    """Class of the peer, which takes the options, unless the command has its own `run`."""
    epilog: ClassVar[str] = ""
    """Text below the options in the help: when it prints READY, and the output after it."""
    example: ClassVar[str] = ""
    """Words after ``cardan sim NAME`` in the example at the end of the help."""
    faults: ClassVar[Sequence[FaultSwitch]] = ()
    scripts: ClassVar[Mapping[str, str]] = {}
    """Built-in scripts. ``--list-scripts`` prints the comments in their first lines."""
    verbs: ClassVar[Mapping[str, str]] = {}
    """Usage of each verb of a script."""

    @classmethod
    def run(cls, options: OptionsT, seconds: float | None) -> int | None:
        """Run the peer until `seconds` are over (None: until it is interrupted). Return the
        command's exit code; None: 0."""
        serve(cls.Peer(options), seconds)
        return None
