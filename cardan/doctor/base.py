"""Interface of a check: its declaration, its subject, and its findings."""

from __future__ import annotations

import dataclasses
import os
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

from cardan.bus.options import BusOptions
from cardan.common.files import text_or_empty
from cardan.drivers.base import Driver, FoundDevice
from cardan.errors import CardanError
from cardan.gateway.daemon.config import DaemonConfig, DaemonOptions, ServerEntry, SessionEntry
from cardan.gateway.servers import registry as server_registry
from cardan.gateway.session.driver_assembly import make_driver

COMMAND_S: Final = 3.0
"""Longest wait for another program's answer."""


class FindingLevel(str, Enum):
    """Severity of a finding."""

    GOOD = "good"
    CAUTION = "caution"
    """It works with limits or not always, or the device or peer looked for is absent."""
    FAILURE = "failure"
    """A configuration that cannot work."""


class Finding(NamedTuple):
    """Result of a check."""

    level: FindingLevel
    code: str
    """Code of the finding, which its page explains: "real-time"."""
    what: str
    """The result in one line."""
    why: str = ""
    """Why it matters."""
    mend: str = ""
    """Command or instructions that fix it."""


def good(code: str, what: str) -> Finding:
    """Return a finding without a problem."""
    return Finding(FindingLevel.GOOD, code, what)


def caution(code: str, what: str, why: str, mend: str) -> Finding:
    """Return a finding that should be fixed but breaks nothing."""
    return Finding(FindingLevel.CAUTION, code, what, why, mend)


def failure(code: str, what: str, why: str, mend: str) -> Finding:
    """Return a finding that keeps something from working."""
    return Finding(FindingLevel.FAILURE, code, what, why, mend)


def run(words: Sequence[str]) -> str | None:
    """Return the output of another program; None if it is missing, fails, or takes longer than
    COMMAND_S."""
    try:
        done = subprocess.run(
            words, capture_output=True, text=True, timeout=COMMAND_S, check=False, errors="replace"
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return None if done.returncode else done.stdout


class Used(NamedTuple):
    """Driver that a session of the files uses, not opened."""

    session: str
    key: str
    """ "device" or "robot"."""
    name: str
    """Name of the driver."""
    driver: Driver


NOTHING: Final = DaemonConfig(DaemonOptions(), {}, {})
"""Configuration without any files."""


def _no_devices() -> Sequence[FoundDevice]:
    return ()


@dataclass(frozen=True)
class Subject:
    """Subject of an examination: the computer and the given files."""

    files: tuple[Path, ...] = ()
    config: DaemonConfig = NOTHING
    """The readable part of the files."""
    unreadable: str = ""
    """Reason why the files cannot be used; empty if they can."""
    devices: Callable[[], Sequence[FoundDevice]] = _no_devices
    """:func:`cardan.devices`."""
    root: Path = Path("/")
    """Parent folder of /proc, /sys, /dev and /etc."""
    environment: Mapping[str, str] = field(default_factory=lambda: os.environ)
    run: Callable[[Sequence[str]], str | None] = run
    """Runs another program, which only reads."""
    socket: str = ""
    """Socket of the daemon; empty: this user's."""

    @property
    def sessions(self) -> Mapping[str, SessionEntry]:
        """The sessions of the files by name."""
        return self.config.sessions

    @property
    def servers(self) -> Mapping[str, ServerEntry]:
        """The servers of the files by name."""
        return self.config.servers

    def used(self) -> Iterator[Used]:
        """Yield the drivers of all sessions, without those that cannot be made: the check of the
        files reports these."""
        for session, entry in self.sessions.items():
            for key in ("device", "robot"):
                if (table := getattr(entry.config, key)) is None:
                    continue
                try:
                    made = make_driver(table, key)
                except CardanError:
                    continue
                yield Used(session, key, table.driver, made)

    def buses(self) -> dict[BusOptions, str]:
        """Return the options by which the files' sessions, drivers and servers join the bus, each
        with its first user."""
        found: dict[BusOptions, str] = {}
        for name, entry in self.sessions.items():
            if entry.config.network is not None:
                found.setdefault(entry.config.network, f"session {name}")
        for each in self.used():
            if isinstance(options := each.driver.options, BusOptions):
                found.setdefault(options, f"{each.key} of {each.session}")
        for name, server in self.servers.items():
            if (bus := _bus_of(server)) is not None:
                found.setdefault(bus, f"server {name}")
        return found

    def read(self, path: str) -> str:
        """Return the text of a file of the system below `root`; empty if it cannot be read."""
        return self.read_path(self.root / path)

    def read_path(self, path: Path) -> str:
        """Return the text of a file by its whole path; empty if it cannot be read."""
        return text_or_empty(path)


class Check(ABC):
    """Check of the computer or the files. It is never instantiated; the class's docstring says what
    it examines.

    Other packages add checks by the entry-point group ``cardan.checks``.
    """

    group: ClassVar[str] = ""
    """Heading of its findings."""
    tells: ClassVar[tuple[str, ...]] = ()
    """Codes of all its findings."""

    @classmethod
    @abstractmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        """Return the findings, within seconds. A check changes nothing and sends nothing to a
        robot."""


def server_option(entry: ServerEntry, name: str, default: Any = "") -> str:
    """Return the value of a server's option, such as "token-file", or `default`."""
    words = entry.words
    found = [words[at + 1] for at in range(len(words) - 1) if words[at] == f"--{name}"]
    return found[-1] if found else str(default)


def server_defaults(entry: ServerEntry) -> dict[str, Any]:
    """Return the options of a server and their defaults; empty if it cannot be loaded."""
    try:
        options = server_registry.load(entry.server).Options()
    except CardanError:
        return {}
    return _fields(options)


def _fields(options: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for each in dataclasses.fields(options):
        value = getattr(options, each.name)
        found.update(_fields(value) if dataclasses.is_dataclass(value) else {each.name: value})
    return found


def _bus_of(entry: ServerEntry) -> BusOptions | None:
    """Return the options by which a server joins the bus. None if it does not join, or if its
    options are wrong, which it reports at its start."""
    defaults = server_defaults(entry)
    if not {"domain", "router"} <= defaults.keys():
        return None
    words = {
        name: server_option(entry, name.replace("_", "-"), defaults[name])
        for name in ("router", "mode", "zenoh_config")
    }
    try:
        domain = int(server_option(entry, "domain", defaults["domain"]))
        return BusOptions(domain=domain, **words)  # type: ignore[arg-type]
    except ValueError:
        return None
