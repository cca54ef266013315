"""Framing of TCP streams: base of the readers, and a reader of consecutive scripts.

The interfaces that take scripts have no packets: a program ends with the `end` that closes its
`def` (or `sec`), and a line outside a program is a command. Comment lines before a program belong
to it and count in its line numbers. Source: UR's script manual (public).
"""

from __future__ import annotations

import re
from typing import Final

OPENING: Final = frozenset(("def", "sec", "thread", "if", "while", "switch"))
"""Keywords of blocks that `end` closes."""
UNFINISHED_S: Final = 2.0
"""Time without further bytes after which an incomplete program is executed as it is, s."""

_WORD = re.compile(r"""\#.*|"[^"]*"?|'[^']*'|(?<![\w.])[A-Za-z_]\w*""")


class StreamReader:
    """Unread bytes of a TCP stream, which a subclass splits into messages by `take`."""

    def __init__(self) -> None:
        self._pending = bytearray()
        self.failure = ""
        """Reason why the rest cannot be read; empty if there is none."""

    @property
    def pending_bytes(self) -> int:
        """Bytes received of an incomplete message."""
        return len(self._pending)

    def feed(self, data: bytes) -> None:
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
    """Splitter of a TCP stream into programs and one-line commands."""

    def __init__(self, largest: int) -> None:
        """Limit a program to `largest` bytes."""
        self._largest = largest
        self._pending = bytearray()
        """Incomplete line."""
        self._lines: list[str] = []
        """Lines of the incomplete part: comments, or a program."""
        self._size = 0
        """Bytes of these lines."""
        self._depth = 0
        self._too_large = False
        """True if the incomplete part is larger than a program may be, and is discarded."""
        self._whole: list[str] = []
        self.refused = 0
        """Count of programs that were too large; the reporter resets it to 0."""

    @property
    def open(self) -> bool:
        """True while a program is incomplete."""
        return self._depth > 0

    def feed(self, data: bytes) -> None:
        first, *others = data.split(b"\n")
        self._part(first)
        for part in others:
            self._line()
            self._part(part)

    def take(self) -> str | None:
        """Return the next program or command; None if it is incomplete."""
        return self._whole.pop(0) if self._whole else None

    def end(self) -> None:
        """Handle the end of the stream: the rest counts as complete."""
        if self._pending:
            self._line()
        if self.open or self._too_large:
            self._done()

    def _part(self, data: bytes) -> None:
        """Add a part of a line, up to one byte more than a program may have."""
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
