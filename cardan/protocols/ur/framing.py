"""Framing of TCP streams: the base of its readers, and scripts that come one after the other.

The interfaces that take scripts have no packets: a program is over with the `end` that closes its
`def` (or `sec`), and a line outside of a program is a command of its own. Lines of comments before
a program belong to it, so that its lines are counted from where its text begins.

Source: UR's script manual (public).
"""

from __future__ import annotations

import re
from typing import Final

OPENING: Final = frozenset(("def", "sec", "thread", "if", "while", "switch"))
"""Words of blocks that `end` closes."""
UNFINISHED_S: Final = 2.0
"""A program of which nothing more has come for so long is taken as it is."""

_WORD = re.compile(r"""\#.*|"[^"]*"?|'[^']*'|(?<![\w.])[A-Za-z_]\w*""")


class StreamReader:
    """Unread bytes of a TCP stream, which a subclass cuts into whole messages by `take`."""

    def __init__(self) -> None:
        self._pending = bytearray()
        self.failure = ""
        """Reason why nothing after this can be read; empty: none."""

    @property
    def pending_bytes(self) -> int:
        """Bytes that wait for the rest of their message."""
        return len(self._pending)

    def feed(self, data: bytes) -> None:
        """Add what came."""
        self._pending += data


def depth_of(line: str) -> int:
    """Return the number of blocks that a line opens less those that it closes."""
    depth = 0
    for word in _WORD.findall(line):
        if word in OPENING:
            depth += 1
        elif word == "end":
            depth -= 1
    return depth


class ScriptReader:
    """Cuts a TCP stream into programs and commands of one line."""

    def __init__(self, largest: int) -> None:
        """`largest`: bytes of a program."""
        self._largest = largest
        self._pending = bytearray()
        """A line that has not all come."""
        self._lines: list[str] = []
        """Lines of the unfinished part: comments, or a program."""
        self._size = 0
        """Bytes of these."""
        self._depth = 0
        self._too_large = False
        """The unfinished part has more bytes than a program may have, and is not kept."""
        self._whole: list[str] = []
        self.refused = 0
        """Programs that had too many bytes; the reporter sets it to 0."""

    @property
    def open(self) -> bool:
        """A program has begun and has not ended."""
        return self._depth > 0

    def feed(self, data: bytes) -> None:
        """Add received bytes."""
        first, *others = data.split(b"\n")
        self._part(first)
        for part in others:
            self._line()
            self._part(part)

    def take(self) -> str | None:
        """Return the next program or command; None: it is not complete."""
        return self._whole.pop(0) if self._whole else None

    def end(self) -> None:
        """Handle the end of the stream: the rest is complete."""
        if self._pending:
            self._line()
        if self.open or self._too_large:
            self._done()
        self._lines, self._size = [], 0

    def _part(self, data: bytes) -> None:
        """Add a part of a line, up to the bytes of a program and one more."""
        self._pending += data[: self._largest + 1 - len(self._pending)]

    def _line(self) -> None:
        data = bytes(self._pending)
        self._pending.clear()
        line = data.rstrip(b"\r").decode("utf-8", "replace")
        words = line.strip()
        if not words and not self._lines and not self._too_large:
            return
        self._size += len(data) + 1
        if self._size > self._largest:
            self._too_large = True
        if self._too_large:
            self._lines = []
        else:
            self._lines.append(line)
        if not self.open and (not words or words.startswith("#")):
            return
        self._depth = max(self._depth + depth_of(line), 0)
        if not self.open:
            self._done()

    def _done(self) -> None:
        if self._too_large:
            self.refused += 1
        else:
            self._whole.append("\n".join(self._lines) + "\n")
        self._lines, self._size, self._depth, self._too_large = [], 0, 0, False
