"""Configuration files of the daemon: its sessions and servers, and its own options.

A file with a table ``[robot]`` is one session, as ``cardan run`` takes it, and has the file's name.
Other files may have, together or each for itself::

    [daemon]                 # the daemon's own options
    [devices.left]           # operator devices by name
    driver = "spacemouse"
    serial = "A1"
    [robots.gofa]            # robots by name
    driver = "abb_egm"
    [[sessions]]             # sessions; device and robot are names, or tables
    name = "gofa"
    device = "left"
    robot = "gofa"
    [servers.rosbridge]        # servers by name, with their options
    port = 9090
"""

from __future__ import annotations

import contextlib
import json
import pickle
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from cardan.bus.node import router_config
from cardan.bus.router import router_addresses
from cardan.common import bounds
from cardan.common.options import (
    OTHER_KEYS,
    Options,
    check_value,
    hints,
    require,
    suggestion,
)
from cardan.common.places import in_file, place_of
from cardan.common.tables import read_table, read_toml, resolved
from cardan.drivers.registry import DriverTable
from cardan.errors import CardanError, ConfigurationError, ExtraMissingError, about, below
from cardan.gateway.servers import registry as server_registry
from cardan.gateway.servers.router import RouterOptions
from cardan.gateway.session.assembly import checked_config
from cardan.gateway.session.config import SessionConfig

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,62}")

_NAMES = "letters (a to z), digits, and _ . - within, 63 at most"

_EVENT_LOG = bounds.Located("(?!none$)(?P<path>.+)", is_read=False)

_TOP = frozenset({"daemon", "devices", "robots", "sessions", "servers"})
"""Keys of a file of the daemon; all others belong to a session."""


@dataclass(frozen=True, kw_only=True)
class DaemonOptions(Options):
    """``[daemon]``: the daemon itself."""

    socket: Annotated[str, bounds.PATH] = ""
    """Control socket; empty: cardan.sock in the user's runtime folder."""
    group: str = ""
    """Group whose members may also connect; empty: only its own user."""
    group_role: Literal["viewer", "operator", "admin"] = "operator"
    """Role of the group's members."""
    event_log: Annotated[str, _EVENT_LOG] = ""
    """Event log, a JSON object a line; empty: events.jsonl in the folder for the user's
    (a service's) state; "none": none."""
    start_limit: Annotated[int, bounds.STARTS] = 8
    """Number of short starts in a row (less than a minute) after which a failing process stays
    stopped until a request starts it."""


@dataclass(frozen=True, kw_only=True)
class ServerTable(Options):
    """Table ``[servers.NAME]``; all other keys are the server's options."""

    server: str = ""
    """Kind of server; empty: the name."""
    start: bool = True
    """Start it with the daemon."""
    options: Mapping[str, Any] = field(default_factory=dict, metadata=OTHER_KEYS)


@dataclass(frozen=True, kw_only=True)
class SessionTable(Options):
    """Table of ``[[sessions]]``; all other keys are those of a session's file."""

    name: str
    file: Annotated[str, bounds.FILE] = ""
    """A session's file, relative to this one; the keys given here replace its own."""
    start: bool = True
    """Start it with the daemon."""
    session: Mapping[str, Any] = field(default_factory=dict, metadata=OTHER_KEYS)

    @classmethod
    def kind_of_others(cls, _table: Mapping[str, Any]) -> Any:
        """Return the type of the other keys: a session's file."""
        return SessionConfig


@dataclass(frozen=True, kw_only=True)
class DaemonFile(Options):
    """A file of the daemon."""

    daemon: DaemonOptions | None = None
    devices: Mapping[str, Any] = field(default_factory=dict)
    robots: Mapping[str, Any] = field(default_factory=dict)
    sessions: tuple[SessionTable, ...] = ()
    servers: Mapping[str, Any] = field(default_factory=dict)


class SessionEntry(NamedTuple):
    """A session of the daemon."""

    config: SessionConfig
    start: bool
    file: Path
    device: str = ""
    """Name of its device, which is shared by all sessions with that name."""


class ServerEntry(NamedTuple):
    """A server of the daemon."""

    server: str
    words: tuple[str, ...]
    """Options of ``cardan net server``."""
    start: bool
    file: Path
    routed: frozenset[tuple[str, int]] = frozenset()
    """Addresses of this computer at which it is a router, as of `router_address`."""


class DaemonConfig(NamedTuple):
    """Configuration of all that the daemon runs."""

    daemon: DaemonOptions
    sessions: Mapping[str, SessionEntry]
    servers: Mapping[str, ServerEntry]


def is_of_daemon(tables: Mapping[str, Any]) -> bool:
    """Return whether these tables are of a file of the daemon, and not of one session."""
    return "faces" in tables or ("robot" not in tables and not _TOP.isdisjoint(tables))


def read_daemon_config(paths: Iterable[Path]) -> DaemonConfig:
    """Read files, and the .toml files of folders, and check all of them.

    Raises ConfigurationError, which names file and key; nothing is opened.
    """
    return _Reading(_files(paths)).config()


def read_daemon_config_in_subprocess(paths: Iterable[Path]) -> DaemonConfig:
    """Call :func:`read_daemon_config` in a separate process, which loads the arms' models without
    delaying this process. Raises ConfigurationError."""
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "cardan.common.resource_errors",
            "cardan.gateway.daemon.config",
            *map(str, paths),
        ],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        start_new_session=True,
        check=False,
    )
    if done.returncode:
        last = done.stderr.decode(errors="backslashreplace").strip().rpartition("\n")[2]
        raise ConfigurationError("", f"the files could not be read: {last or done.returncode}")
    made: DaemonConfig | CardanError = pickle.loads(done.stdout)
    if isinstance(made, CardanError):
        raise made
    return made


def sharers(sessions: Mapping[str, SessionEntry]) -> dict[str, list[str]]:
    """Return the devices that several sessions name, and these sessions in the files' order."""
    found: dict[str, list[str]] = {}
    for name, entry in sessions.items():
        if entry.device:
            found.setdefault(entry.device, []).append(name)
    return {device: names for device, names in found.items() if len(names) > 1}


def _check_shared(device: str, config: SessionConfig) -> None:
    """Raise ConfigurationError if a session cannot take its device later."""
    if config.gives_force:
        raise ConfigurationError(
            "force", f"the device {device!r} serves several sessions, which excludes force feedback"
        )


def _files(paths: Iterable[Path]) -> list[Path]:
    found: list[Path] = []
    for path in paths:
        if not path.is_dir():
            found.append(path)
            continue
        inside = sorted(each for each in path.glob("*.toml") if not each.name.startswith("."))
        if not inside:
            raise ConfigurationError("", f"the folder {path} has no .toml file")
        found += inside
    if not found:
        raise ConfigurationError(
            "", "no file was given: `cardan daemon run FILE` or a folder of files"
        )
    return list(dict.fromkeys(found))


class _Named(NamedTuple):
    table: Any
    file: Path
    key: str
    """Place in the file."""


class _Reading:
    """The tables of all files, by their names."""

    def __init__(self, files: Iterable[Path]) -> None:
        self._daemon: tuple[DaemonOptions, Path] | None = None
        self._devices: dict[str, _Named] = {}
        self._robots: dict[str, _Named] = {}
        self._servers: dict[str, _Named] = {}
        self._sessions: dict[str, tuple[SessionTable, Path, str]] = {}
        for file in files:
            with about(file), in_file(file):
                self._read(file)

    def _read(self, file: Path) -> None:
        tables = read_toml(file)
        if "faces" in tables:
            raise ConfigurationError(
                "faces", "is now: servers, and `face` in it is `server`; rename them"
            )
        if "robot" in tables:
            if mixed := sorted(_TOP & tables.keys()):
                raise ConfigurationError(
                    mixed[0],
                    "is the daemon's, and [robot] makes this file one session: put it into a file "
                    "of its own",
                )
            if NAME.fullmatch(file.stem) is None:
                raise ConfigurationError(
                    "",
                    f"{file.stem!r}, the file's name, is the session's, and must be {_NAMES}: "
                    "rename the file",
                )
            session = resolved(SessionConfig, tables, file)
            self._add_session(SessionTable(name=file.stem, session=session), file)
            return
        read = read_table(DaemonFile, resolved(DaemonFile, tables, file))
        if read.daemon is not None:
            if self._daemon is not None:
                raise ConfigurationError("daemon", f"is in {self._daemon[1]} already")
            self._daemon = read.daemon, file
        for kind, found, into in (
            ("devices", read.devices, self._devices),
            ("robots", read.robots, self._robots),
            ("servers", read.servers, self._servers),
        ):
            for name, given in found.items():
                _check_name(f"{kind}.{name}", name)
                if name in into:
                    raise ConfigurationError(
                        f"{kind}.{name}", f"this name is in {into[name].file} already"
                    )
                table, key = given, f"{kind}.{name}"
                kinds: Iterable[Any] = (DriverTable,)
                if kind == "servers" and isinstance(table, Mapping):  # As a command's options.
                    table = {word.replace("-", "_"): value for word, value in table.items()}
                    if "face" in table:
                        raise ConfigurationError(f"{key}.face", "is now: server")
                    server = table.get("server", name)
                    check_value(f"{key}.server", server, str)
                    kinds = _server_kinds(server)
                for each in kinds:
                    table = resolved(each, table, file, key)
                into[name] = _Named(table, file, key)
        for number, session in enumerate(read.sessions):
            self._add_session(session, file, f"sessions.{number}")

    def _add_session(self, session: SessionTable, file: Path, key: str = "") -> None:
        _check_name("sessions.name", session.name)
        if session.name in self._sessions:
            other = self._sessions[session.name][1]
            raise ConfigurationError(
                "sessions.name", f"{session.name!r} is the name of a session in {other} already"
            )
        self._sessions[session.name] = session, file, key

    def config(self) -> DaemonConfig:
        """Return the whole configuration, checked."""
        options = DaemonOptions() if self._daemon is None else self._daemon[0]
        sessions = {name: self._session(*each) for name, each in self._sessions.items()}
        servers = {name: self._server(name, each) for name, each in self._servers.items()}
        if both := sorted(sessions.keys() & servers.keys()):
            raise ConfigurationError(
                f"servers.{both[0]}", "a session has this name: commands would not tell them apart"
            )
        if not sessions and not servers:
            raise ConfigurationError("sessions", "there is neither a session nor a server to run")
        for device, names in sharers(sessions).items():
            for name in names:
                with below(f"{sessions[name].file}: {name}"):
                    _check_shared(device, sessions[name].config)
        return DaemonConfig(options, sessions, servers)

    def _session(self, table: SessionTable, file: Path, key: str) -> SessionEntry:
        stands = {name: (file, f"{key}.{name}".lstrip(".")) for name in table.session}
        with _placed(table.name, stands, file, key):
            tables = dict(table.session)
            if table.file:
                base = Path(table.file)
                with in_file(base):
                    tables = resolved(SessionConfig, read_toml(base), base) | tables
                stands |= {name: (base, name) for name in tables.keys() - stands.keys()}
            device = tables.get("device")
            device = device if isinstance(device, str) else ""
            for kind, known in (("device", self._devices), ("robot", self._robots)):
                if isinstance(name := tables.get(kind), str):
                    named = _named(kind, name, known)
                    tables[kind], stands[kind] = named.table, (named.file, named.key)
            config = checked_config(tables)
        return SessionEntry(config, table.start, file, device)

    def _server(self, name: str, named: _Named) -> ServerEntry:
        with _placed(named.key, {}, named.file, named.key):
            table = read_table(ServerTable, named.table)
            server = table.server or name
            server_registry.load(server)
            words = tuple(_words(table.options))
            routed = _routed(table.options) if server == "router" else frozenset()
        return ServerEntry(server, words, table.start, named.file, routed)


@contextlib.contextmanager
def _placed(
    name: str, stands: Mapping[str, tuple[Path, str]], file: Path, key: str
) -> Iterator[None]:
    """Add the place in the files to errors of `name` raised inside: `stands` has file and key of
    the top-level keys; all others are in the table `key` of `file`."""
    try:
        yield
    except ConfigurationError as error:

        def placed(error: ConfigurationError) -> ConfigurationError:
            if not error.key:
                return error.below(f"{file}: {name}")
            top, dot, rest = error.key.partition(".")
            at, above = stands.get(top, (file, f"{key}.{top}".lstrip(".")))
            return error.below(name).placed(place_of(at, f"{above}{dot}{rest}"))

        raise error.each(placed) from None


def _check_name(key: str, name: str) -> None:
    require(NAME.fullmatch(name), key, name, _NAMES)


def _named(key: str, name: str, known: Mapping[str, _Named]) -> _Named:
    if name not in known:
        allowed = ", ".join(known) or "none is named"
        raise ConfigurationError(
            key, f"there is no [{key}s.{name}]; allowed: {allowed}{suggestion(name, known)}"
        )
    return known[name]


def _server_kinds(server: str) -> Iterator[Any]:
    """Return the dataclasses with the options of a server; none if it cannot be loaded."""
    kinds: list[Any] = []
    with contextlib.suppress(ConfigurationError, ExtraMissingError):
        kinds.append(server_registry.load(server).Options)
    while kinds:
        yield (kind := kinds.pop())
        kinds += filter(is_dataclass, hints(kind).values())


def _routed(options: Mapping[str, Any]) -> frozenset[tuple[str, int]]:
    """Return where a router of these options serves. Its own process reports what is wrong."""
    endpoints: Any = options.get("endpoint", RouterOptions.endpoint)
    if file := options.get("zenoh_config"):
        try:
            config = router_config((), (), str(file))
        except (ConfigurationError, ExtraMissingError):
            return frozenset()
        endpoints = json.loads(config.get_json("listen/endpoints"))
        if isinstance(endpoints, dict):  # by Zenoh's modes
            endpoints = endpoints.get("router", ())
    return router_addresses(
        map(str, endpoints if isinstance(endpoints, (list, tuple)) else [endpoints])
    )


def _words(options: Mapping[str, Any]) -> Iterable[str]:
    """Return a command's options for the keys of a table: port = 9090 is --port 9090."""
    for key, value in options.items():
        flag = f"--{key.replace('_', '-')}"
        if isinstance(value, bool):
            if value:
                yield flag
            continue
        for each in value if isinstance(value, list) else [value]:
            if isinstance(each, (Mapping, list)):
                raise ConfigurationError(
                    key, "is a table; options of a server are texts and numbers"
                )
            yield flag
            yield str(each)


def main() -> None:
    """Read the named files, and write the configuration, or the error, for
    :func:`read_daemon_config_in_subprocess`."""
    made: DaemonConfig | CardanError
    try:
        made = read_daemon_config(map(Path, sys.argv[1:]))
    except CardanError as error:
        made = error
    sys.stdout.buffer.write(pickle.dumps(made))
