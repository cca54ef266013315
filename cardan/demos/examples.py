"""Example files, and the demos among them.

The examples of a package that has drivers are the .toml files in its folder ``examples``, or in the
one beside it (a source tree). An example that runs without hardware says how in a block of comments
that holds TOML, in the form of PEP 723; a session takes no notice of it::

    # /// demo
    # name = "gofa"
    # description = "simulated SpaceMouse -> gateway -> simulated GoFa"
    # success_message = "the device moved the robot"
    # launch = [
    #   "sim spacemouse --hid {device.path} --script demo",
    #   "sim abb-gofa --to 127.0.0.1:{robot.listen_port}",
    # ]
    # files = ["device.path"]
    # ports = ["robot.listen_port"]
    # ///

In braces stand keys of the file itself, ``{examples}``, the folder that it is in, and, where the
block has them, ``{delay_ms}`` and the names of `peer_ports`.
"""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import re
import shlex
import socket
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from cardan.common import bounds
from cardan.common.options import CODE_ONLY, Options, require
from cardan.common.plugins import reason
from cardan.common.tables import parse_toml, read_table, read_text, read_toml
from cardan.drivers import registry
from cardan.errors import ConfigurationError, DriverError, OptionError

DELAY_MS = bounds.Range(0.0, 200.0, "ms", "with more there is no force, and an arm stops")

_BLOCK = re.compile(r"^# /// demo\n((?:#(?: .*)?\n)*?)# ///$", re.MULTILINE)
_ENDPOINT = re.compile(r"(tcp/[^/]+:)\d+")
_KEY = re.compile(r"\{([\w.]+)\}")


@dataclass(frozen=True, kw_only=True)
class Demo(Options):
    """Example that runs without hardware, declared in its block of comments."""

    file: Path = field(default=Path(), metadata=CODE_ONLY)
    """Example file: the configuration of a session or of the daemon."""
    name: str
    """Argument of ``cardan demo NAME``; by default the file's name without "-simulated"."""
    description: str
    """The connected programs, such as "simulated SpaceMouse -> gateway -> simulated GoFa"."""
    success_message: str
    """Message after success."""
    launch: tuple[str, ...] = ()
    """Arguments of ``cardan``, one process each, started in this order before the session in a
    separate folder. Each prints READY once it serves, and takes ``--seconds``."""
    launcher: str = ""
    """Arguments of ``cardan`` before "--" that run the session with its simulated device inside."""
    files: tuple[str, ...] = ()
    """Keys of the configuration that become paths in the demo's own folder."""
    ports: tuple[str, ...] = ()
    """Keys of the configuration that get consecutive free ports; in a Zenoh endpoint, the port
    alone."""
    peer_ports: tuple[str, ...] = ()
    """Names of further free ports, in braces in `launch`: between programs that it launches."""
    servers: tuple[Literal["console", "rosbridge"], ...] = ()
    """Servers that run beside the session; their addresses are printed."""
    invitation: str = ""
    """Actions that the user may take, printed before the session starts. If a demo has one, an arm
    that does not move is not a problem."""
    extras: tuple[str, ...] = ()
    """Extras of Cardan needed beside ``arm``, such as ``network``; ``make demo`` installs them."""
    delay_ms: Annotated[float, DELAY_MS] | None = None
    """One-way delay of its simulated network; None: it has none."""
    shortest_s: Annotated[float, bounds.POSITIVE] = 3.0
    """A shorter run has nothing to show."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for key, commands in (("launch", self.launch), ("launcher", (self.launcher,))):
            for command in commands:
                try:
                    words = shlex.split(command)
                except ValueError as error:
                    raise OptionError(key, command, f"words as in a shell ({error})") from None
                require(words or key == "launcher", key, command, "words of a `cardan` command")

    @property
    def is_lab(self) -> bool:
        """True if its file is one of the daemon's, with several sessions."""
        return "sessions" in read_toml(self.file)

    @property
    def drivers(self) -> frozenset[str]:
        """Return the names of the drivers in its configuration."""
        tables = read_toml(self.file)
        places = (
            *(tables.get("device"), tables.get("robot"), tables.get("force", {}).get("sensor")),
            *tables.get("devices", {}).values(),
            *tables.get("robots", {}).values(),
        )
        return frozenset(table["driver"] for table in places if table)

    @property
    def shared_file(self) -> Path | None:
        """Return the file whose device it shares by ``devices share``; None if it shares none."""
        for words in map(shlex.split, self.launch):
            if "share" in words:
                return Path(words[-1].replace("{examples}", str(self.file.parent)))
        return None

    def prepare(self, folder: Path) -> tuple[dict[str, Any], list[list[str]]]:
        """Return the tables of the configuration and the words of each launch, with files in
        `folder` and currently free ports."""
        tables = read_toml(self.file)
        for key in self.files:
            table, name = self._place(tables, key)
            said = table.get(name, name)
            if not isinstance(said, str) or Path(said).name in ("", ".."):
                raise self._wrong("files", key, said, "a path")
            table[name] = str(folder / Path(said).name)
        count = len(self.ports) + len(self.peer_ports)
        first = free_ports(count) if count else 0
        between = dict(
            zip(self.peer_ports, range(first + len(self.ports), first + count), strict=True)
        )
        for port, key in enumerate(self.ports, first):
            table, name = self._place(tables, key)
            said = table.get(name, 0)
            if isinstance(said, str) and (endpoint := _ENDPOINT.fullmatch(said)):
                table[name] = f"{endpoint[1]}{port}"
            elif isinstance(said, int) and not isinstance(said, bool):
                table[name] = port
            else:
                raise self._wrong("ports", key, said, "a port")

        def value(found: re.Match[str]) -> str:
            if found[1] == "examples":
                return str(self.file.parent)
            if found[1] == "delay_ms" and self.delay_ms is not None:
                return f"{self.delay_ms:g}"
            if found[1] in between:
                return str(between[found[1]])
            table, name = self._place(tables, found[1])
            if name not in table:
                raise ConfigurationError(f"{self.file}: demo.launch", f"no key {found[1]!r}")
            return str(table[name])

        words = [
            [_KEY.sub(value, word) for word in shlex.split(command)] for command in self.launch
        ]
        return tables, words

    def _wrong(self, list_: str, key: str, value: object, allowed: str) -> ConfigurationError:
        return ConfigurationError(
            f"{self.file}: demo.{list_}", f"{key} is {value!r:.60}; it must be {allowed}"
        )

    def _place(self, tables: dict[str, Any], key: str) -> tuple[dict[str, Any], str]:
        """Return the table that has the key, and the key's name in it."""
        *path, name = key.split(".")
        for word in path:
            found = tables.get(word)
            if not isinstance(found, dict):
                raise ConfigurationError(f"{self.file}: demo", f"{key!r}: there is no [{word}]")
            tables = found
        return tables, name


def read_demo(file: Path) -> Demo | None:
    """Return the demo that an example declares; None: no demo. Raises ConfigurationError."""
    block = _BLOCK.search(read_text(file))
    if block is None:
        return None
    of = f"{file}: demo"
    said = parse_toml("".join(line[2:] + "\n" for line in block[1].splitlines()), of)
    demo = read_table(Demo, {"name": file.stem.removesuffix("-simulated"), **said}, of)
    return replace(demo, file=file)


def example_files() -> list[Path]:
    """Return every example of every package with drivers; built-in ones first."""
    folders: dict[Path, None] = {}
    for package in registry.packages():
        try:
            spec = importlib.util.find_spec(package)
        except (ImportError, ValueError):
            continue
        for home in (spec.submodule_search_locations or ()) if spec else ():
            inside, beside = Path(home) / "examples", Path(home).parent / "examples"
            if inside.is_dir():
                folders[inside.resolve()] = None
            elif (Path(home).parent / "pyproject.toml").is_file():  # Source tree.
                folders[beside.resolve()] = None
    return [file for folder in folders for file in sorted(folder.glob("*.toml"))]


def find_demos() -> dict[str, Demo]:
    """Return the demos by name, the first of each name. A broken file is skipped with a warning in
    the log."""
    found: dict[str, Demo] = {}
    for file in example_files():
        try:
            demo = read_demo(file)
        except ConfigurationError as error:
            logging.getLogger(__name__).warning("example left out: %s", reason(error))
            continue
        if demo is not None:
            found.setdefault(demo.name, demo)
    return dict(sorted(found.items()))


def free_ports(count: int = 1) -> int:
    """Return the first of `count` consecutive ports that are free for both TCP and UDP."""
    for _ in range(100):
        with contextlib.ExitStack() as probes:
            try:
                first = 0
                for offset in range(count):
                    for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
                        probe = probes.enter_context(socket.socket(socket.AF_INET, kind))
                        probe.bind(("127.0.0.1", first + offset if first else 0))
                        first = first or probe.getsockname()[1]
            except (OSError, OverflowError):
                continue
            return first
    raise DriverError(f"there are no {count} free ports in a row")
