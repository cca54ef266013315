"""Reassembly of operations in several frames: each has a part of the text, numbered from 0."""

from __future__ import annotations

from typing import NamedTuple

from cardan.protocols.rosbridge.operations import Fragment, Id, RefusedOperation

LIFETIME_S = 600.0
"""Time after which the parts of an incomplete operation are dropped, as in rosbridge_suite."""

MAX_OPERATIONS = 16
"""Most incomplete operations of a client."""

MAX_PARTS = 10_000
"""Most parts of an operation."""


class _Parts(NamedTuple):
    first_s: float
    total: int
    texts: dict[int, str]


class Defragmenter:
    """Reassembly of the operations of one client. Time is monotonic, in seconds."""

    def __init__(self, max_characters: int) -> None:
        """Limit all kept text to `max_characters`."""
        self._max_characters = max_characters
        self._partial: dict[Id, _Parts] = {}
        self._characters = 0

    def add(self, part: Fragment, now_s: float) -> str | RefusedOperation | None:
        """Add a part; return the operation's text when it is complete, None before."""
        for identity, gathered in list(self._partial.items()):
            if now_s - gathered.first_s >= LIFETIME_S:
                self._drop(identity)
        if part.total > MAX_PARTS:
            return self._refused(part, f"has {part.total} parts; at most {MAX_PARTS} are taken")
        parts = self._partial.get(part.id)
        if parts is None:
            if len(self._partial) >= MAX_OPERATIONS:
                return self._refused(
                    part, f"is one of more than {MAX_OPERATIONS} that are not complete"
                )
            parts = self._partial[part.id] = _Parts(now_s, part.total, {})
        if parts.total != part.total:
            return self._refused(part, f"had {parts.total} parts, and has {part.total} now")
        if part.number in parts.texts:
            return None
        if self._characters + len(part.data) > self._max_characters:
            return self._refused(part, f"makes more than {self._max_characters} characters")
        parts.texts[part.number] = part.data
        self._characters += len(part.data)
        if len(parts.texts) < part.total:
            return None
        self._drop(part.id)
        return "".join(parts.texts[number] for number in range(part.total))

    def _refused(self, part: Fragment, reason: str) -> RefusedOperation:
        self._drop(part.id)
        return RefusedOperation(f"the fragmented operation {reason}", "fragment", part.id)

    def _drop(self, identity: Id) -> None:
        if parts := self._partial.pop(identity, None):
            self._characters -= sum(map(len, parts.texts.values()))
