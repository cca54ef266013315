"""Sanitizer of foreign text for a terminal: from a wire, a device, a plug-in or a file.

Terminals obey control characters: such text could recolor or erase what Cardan says, or answer in
the user's name. It is kept as it came, and made printable where it leaves for the terminal.
"""

from __future__ import annotations


def printable(text: str, keep: str = "") -> str:
    """`text` with each character that is not printable, line ends too, as Python writes it
    (``\\x1b``); those in `keep` stay."""
    if text.isprintable():
        return text
    return "".join(
        each if each.isprintable() or each in keep else repr(each)[1:-1] for each in text
    )
