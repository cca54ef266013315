"""Strings of the spacenavd protocol: 24 bytes per record, and the number of records left."""

from __future__ import annotations

import struct

from cardan.protocols.spnav.records import encode_reply

CHUNK_BYTES = 24
CONTINUED = 0x10000
"""Bit set in the last word of every record of a string but the first."""
LONGEST_BYTES = 0xFFFF

_SIX = struct.Struct("=6i")


def encode_string(word: int, text: str) -> list[bytes]:
    """Encode `text` (UTF-8, truncated at `LONGEST_BYTES`) as records with the first word `word`, in
    the form of both clients and servers."""
    left = text.encode()[:LONGEST_BYTES]
    records: list[bytes] = []
    while left or not records:
        chunk = left[:CHUNK_BYTES].ljust(CHUNK_BYTES, b"\0")
        status = len(left) | (CONTINUED if records else 0)
        records.append(encode_reply(word, _SIX.unpack(chunk), status))
        left = left[CHUNK_BYTES:]
    return records
