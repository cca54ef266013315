"""What has changed between two layouts, and when each change takes effect."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from cardan.gateway.daemon.layout import Layout
from cardan.gateway.session.changes import EFFECTS, WAITS, Effect, staged
from cardan.gateway.session.config import SessionConfig
from cardan.gateway.session.reloading import Found

UNTIL_START: Final = "until it starts"
"""What changes of a session that does not run wait for."""


class Change(NamedTuple):
    """A key of the files that is another than before."""

    name: str
    """Session or face."""
    key: str
    """Empty: all of it."""
    effect: Effect
    what: str
    """``added``, ``removed``, ``changed``, or ``taken back``: it waited, and waits no more."""
    old: Any = None
    """Of a session's key; None also where there was none."""
    new: Any = None
    waits: str = ""
    """For what; empty: for nothing."""

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> Change:
        """From its fields."""
        return cls(**{**table, "effect": Effect(table["effect"])})

    @property
    def in_words(self) -> str:
        """As a line."""
        key = f" {self.key}" if self.key else ""
        what = self.what
        if self.key and what == "changed":
            what = f"{_shown(self.old)} -> {_shown(self.new)}"
        waits = f" (waits {self.waits})" if self.waits else ""
        return f"{self.name}{key}: {what}, {self.effect.value}{waits}"


def _shown(value: Any) -> str:
    return "none" if value is None else json.dumps(value, ensure_ascii=False)


def of_layouts(old: Layout, new: Layout) -> Iterator[Change]:
    """What comes, what goes, and faces with other options."""
    for before, after in ((old.sessions, new.sessions), (old.faces, new.faces)):
        for name in before.keys() - after.keys():
            yield Change(name, "", Effect.LIVE, "removed")
        for name in after:
            if name not in before:
                yield Change(name, "", Effect.LIVE, "added")
    for name, face in new.faces.items():
        was = old.faces.get(name)
        if was is not None and (was.face, was.words) != (face.face, face.words):
            yield Change(name, "", Effect.LIVE, "changed")


def of_session(name: str, found: Found) -> Iterator[Change]:
    """Of a session that runs and has looked."""
    for key, old, new, moment, come in found.changes:
        waits = "" if come else WAITS[moment]
        yield Change(name, key, EFFECTS[moment], "changed", old, new, waits)
    for key in found.taken_back:
        yield Change(name, key, Effect.LIVE, "taken back")


def of_resting(name: str, old: SessionConfig, new: SessionConfig, waits: str) -> Iterator[Change]:
    """Of a session that does not run: all of it comes with its next start."""
    for each in staged(old, new).changes:
        yield Change(name, each.key, each.effect, "changed", each.old, each.new, waits)


def in_words(changes: Iterable[Change]) -> str:
    """All of them, as a line."""
    return "; ".join(change.in_words for change in changes) or "nothing has changed"
