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
"""Ends of fields' names that are units, and how the help writes them; the first that fits counts.
An option's name is its field's without the unit."""

_KEY = "cardan option"


@dataclass(frozen=True, kw_only=True)
class Option:
    """How one field is given on the command line; `option` puts it there."""

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
    """The values there are, each with a few words about it: ``--list-NAMEs`` prints them."""
    positional: bool = False
    """The words after the options, dashes and all: a program and its arguments."""


def option(default: V, text: str, **how: Any) -> V:
    """A dataclass's field that is an option of the peer's command; `text` is its help, and `how` is
    as `Option` has the rest.

    A bool is a flag, which turns the default around. A field of an enum's or a Literal's type takes
    one of its values. A field that is itself a dataclass needs no `option`: its own fields count.
    """
    return field(default=default, metadata={_KEY: Option(help=text, **how)})


def listen_option(what: str) -> str:
    """The field `host` of a peer that listens there, by default on the loopback interface; `what`
    listens for is its help. The port is in the field ``port``."""
    text = f"{what}; port 0: any."
    return option("127.0.0.1", text, name="listen", metavar="HOST:PORT", port_field="port")


def option_of(of: Field[Any]) -> Option | None:
    """How the field is given on the command line; None: it is not."""
    found: Option | None = of.metadata.get(_KEY)
    return found


def name_and_unit(field_name: str) -> tuple[str, str]:
    """The option's name and its unit, as a field's name has them; the unit may be empty."""
    for ending, unit in UNITS.items():
        if field_name.endswith(ending):
            return field_name.removesuffix(ending).replace("_", "-"), unit
    return field_name.replace("_", "-"), ""


def numbers(text: str, count: int) -> tuple[float, ...]:
    """Reads `count` numbers with commas between them, as options have them; ValueError."""
    try:
        found = tuple(float(word) for word in text.split(","))
    except ValueError:
        found = ()
    if len(found) != count:
        raise ValueError(f"{text!r} is not {count} numbers with commas")
    return found


class PeerCommand(Generic[OptionsT]):
    """A simulated peer as ``cardan sim`` has it. It is never instantiated; the class's docstring
    says what it stands in for, and is the command's summary.

    Fields of `Options` that are made by `option` are its options. Three are so by their names: with
    ``faults`` (by name, as `parse_faults` gives them) it has ``--fault`` and ``--list-faults``,
    with ``script`` ``--script`` and ``--list-scripts``, with ``seed`` ``--seed``.
    """

    Options: ClassVar[type]
    """A frozen dataclass. All fields have defaults."""
    page: ClassVar[str] = ""
    """Its documentation: a page as seen from Cardan's docs/, or a URL."""
    speaks: ClassVar[str] = ""
    """Protocol and transport, for documentation tables (Markdown, links as in docs/)."""
    Peer: ClassVar[type]
    """The class of the peer, which takes the options; unless `run` is the command's own."""
    epilog: ClassVar[str] = ""
    """Text below the options in the help: when it prints READY, and the output after it."""
    example: ClassVar[str] = ""
    """Words that are typed after ``cardan sim NAME`` in the example that ends the help."""
    faults: ClassVar[Sequence[FaultSwitch]] = ()
    scripts: ClassVar[Mapping[str, str]] = {}
    """The built-in ones. Where their first lines are comments, ``--list-scripts`` prints them."""
    verbs: ClassVar[Mapping[str, str]] = {}
    """Usage of each verb of a script."""

    @classmethod
    def run(cls, options: OptionsT, seconds: float | None) -> int | None:
        """Run the peer until `seconds` are over (None: until it is interrupted). The command's exit
        code; None: 0."""
        serve(cls.Peer(options), seconds)
        return None
