"""The kept corpus: a file of JSON lines for each target, with a name for each input.

``{"name": "...", "text": "..."}``, ``{"name": "...", "hex": "..."}``, for what is long
``{"name": "...", "parts": [["9", 5000], ...]}``, texts and how often each is repeated; of a
sequence of packets ``{"name": "...", "packets": [{"text": "..."}, ...]}``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from fuzz.target import Input

FOLDER = Path(__file__).parent / "corpus"


class StoredInput(NamedTuple):
    """An input that is kept: it has found something, or is a form of its own."""

    name: str
    """Description of the input."""
    given: Input


def stored(target: str) -> Iterator[StoredInput]:
    """The kept inputs of a target."""
    path = FOLDER / f"{target}.jsonl"
    if not path.exists():
        return
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.strip():
            table = json.loads(line)
            yield StoredInput(table["name"], input_of(table))


def input_of(table: dict[str, Any]) -> Input:
    """Of a line."""
    if "packets" in table:
        return tuple(map(_bytes, table["packets"]))
    return _bytes(table)


def _bytes(table: Any) -> bytes:
    if "parts" in table:
        return b"".join(text.encode() * times for text, times in table["parts"])
    if "text" in table:
        return str(table["text"]).encode()
    return bytes.fromhex(table["hex"])


def line_of(name: str, given: Input) -> str:
    """A line for a corpus file."""
    if isinstance(given, tuple):
        table: dict[str, Any] = {"packets": [_table(each) for each in given]}
    else:
        table = _table(given)
    return json.dumps({"name": name, **table}, ensure_ascii=False)


def _table(given: bytes) -> dict[str, str]:
    try:
        text = given.decode()
    except UnicodeDecodeError:
        return {"hex": given.hex()}
    if all(each.isprintable() or each in "\r\n\t" for each in text):
        return {"text": text}
    return {"hex": given.hex()}
