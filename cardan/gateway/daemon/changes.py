"""Changes in the files: by key for a session, as a whole for a server."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Final, NamedTuple

from cardan.common.tables import keys_of, plain, read_table
from cardan.drivers import registry
from cardan.drivers.registry import DriverTable
from cardan.gateway.daemon.config import ServerEntry
from cardan.gateway.session.config import SessionConfig

REMOVED: Final = "removed"
"""Change of a session or server that was removed from the files."""

UNTIL_FREE: Final = "until no source has authority"
UNTIL_START: Final = "until it starts"
"""Conditions that changes wait for: for an engaged session, and for a session that does not run."""


class Change(NamedTuple):
    """A changed key of the files."""

    name: str
    """Name of the session or server."""
    key: str
    """The key; empty: all of it."""
    what: str
    """Kind of the change: ``added``, ``removed``, ``changed``, or ``taken back``: it waited, and
    waits no more."""
    old: Any = None
    """Old value of a session's key; None also if there was none."""
    new: Any = None
    waits: str = ""
    """Condition that it waits for; empty: none."""

    @property
    def in_words(self) -> str:
        """Return the change as a line."""
        key = f" {self.key}" if self.key else ""
        what = self.what
        if self.key and what == "changed":
            what = f"{_shown(self.old)} -> {_shown(self.new)}"
        waits = f" (waits {self.waits})" if self.waits else ""
        return f"{self.name}{key}: {what}{waits}"


def _shown(value: Any) -> str:
    return "none" if value is None else json.dumps(value, ensure_ascii=False)


def of_servers(old: Mapping[str, ServerEntry], new: Mapping[str, ServerEntry]) -> Iterator[Change]:
    """Return servers that are added, removed, or have other options."""
    for name in old.keys() - new.keys():
        yield Change(name, "", REMOVED)
    for name, server in new.items():
        if name not in old:
            yield Change(name, "", "added")
        elif (old[name].server, old[name].words) != (server.server, server.words):
            yield Change(name, "", "changed")


def of_session(
    name: str, old: SessionConfig, new: SessionConfig, waits: str, waited: Iterable[str]
) -> Iterator[Change]:
    """Return the keys that differ, and those that `waited` and have their old values again."""
    changed = set()
    for key, was, now in _differences(old, new):
        changed.add(key)
        yield Change(name, key, "changed", plain(was), plain(now), waits)
    for key in waited:
        if key not in changed:
            yield Change(name, key, "taken back")


def _differences(old: SessionConfig, new: SessionConfig) -> Iterator[tuple[str, Any, Any]]:
    """Return the keys that differ, with both values."""
    for table in keys_of(SessionConfig):
        was, now = getattr(old, table), getattr(new, table)
        if was == now:
            continue
        if isinstance(was, DriverTable) and isinstance(now, DriverTable):
            if was.driver == now.driver:
                yield from _options(table, was, now)
            else:
                yield f"{table}.driver", was.driver, now.driver
        elif is_dataclass(was) and type(was) is type(now):
            for key in keys_of(type(was)):
                before, after = getattr(was, key), getattr(now, key)
                if before != after:
                    yield f"{table}.{key}", before, after
        else:
            yield table, was, now


def _options(table: str, was: DriverTable, now: DriverTable) -> Iterator[tuple[str, Any, Any]]:
    kind: Any = registry.load(was.driver).Options
    before, after = (read_table(kind, each.options, table) for each in (was, now))
    for each in fields(kind):
        values = getattr(before, each.name), getattr(after, each.name)
        if values[0] != values[1]:
            yield f"{table}.{each.name}", *values


def in_words(changes: Iterable[Change]) -> str:
    """Return all changes as a line."""
    return "; ".join(change.in_words for change in changes) or "nothing has changed"
