"""Sanitizer of external text for a terminal: from a network, a device, a plug-in or a file.
Terminals obey control characters: such text could recolor or erase other output, or send input in
the user's name. It is stored unchanged, and made printable on output to the terminal."""

from __future__ import annotations


def printable(text: str, keep: str = "") -> str:
    """Return `text` with each character that is not printable, line ends too, escaped as in Python
    (``\x1b``), except those in `keep`."""
    if text.isprintable():
        return text
    return "".join(
        each if each.isprintable() or each in keep else repr(each)[1:-1] for each in text
    )
