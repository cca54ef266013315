"""Checks the given files, as ``cardan check`` and ``cardan daemon run`` do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from cardan.doctor.base import NOTHING, Check, Finding, Subject, caution, failure, good
from cardan.errors import CardanError, ConfigurationError
from cardan.gateway.daemon.config import DaemonConfig, read_daemon_config
from cardan.gateway.session.cautions import cautions

GROUP = "files"


def read_files(paths: Sequence[Path]) -> tuple[DaemonConfig, str]:
    """Return the configuration of the files, and why they cannot be used (empty if they can).

    If a file is wrong, the configuration has the readable part of each.
    """
    if not paths:
        return NOTHING, ""
    try:
        return read_daemon_config(paths), ""
    except CardanError as error:
        wrong = " ".join(str(error).split())
    sessions, servers = dict(NOTHING.sessions), dict(NOTHING.servers)
    for path in _each(paths):
        try:
            one = read_daemon_config([path])
        except CardanError:
            continue
        sessions.update(one.sessions)
        servers.update(one.servers)
    return DaemonConfig(NOTHING.daemon, sessions, servers), wrong


def _each(paths: Iterable[Path]) -> list[Path]:
    """Return the files, and those in the folders."""
    return [
        file
        for path in paths
        for file in (sorted(path.glob("*.toml")) if path.is_dir() else [path])
    ]


class Files(Check):
    """Given files: every key, and warnings of drivers."""

    group, tells = GROUP, ("file", "caution")

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        if subject.unreadable:
            mend = f"edit it, then: cardan doctor {' '.join(map(str, subject.files))}"
            yield failure("file", subject.unreadable, "no session of it can start", mend)
        for name, entry in subject.sessions.items():
            try:
                warned = cautions(entry.config)
            except ConfigurationError as error:
                warned = [str(error)]
            for words in warned:
                yield caution(
                    "caution",
                    f"{name}: {words}",
                    "the options allow it, and a robot's cell rarely should",
                    f"edit {entry.file}, then: cardan doctor {entry.file}",
                )
            if not warned:
                yield good("file", f"{entry.file}: session {name} is fine")
        for name, server in subject.servers.items():
            yield good("file", f"{server.file}: server {name} is fine")
