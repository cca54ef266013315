"""Split of both byte streams of a spacenavd connection into values."""

from __future__ import annotations

from typing import NamedTuple

from cardan.protocols.spnav.records import (
    RECORD_BYTES,
    WORD_BYTES,
    ServerRecord,
    decode_handshake,
    decode_server_record,
)


class Handshake(NamedTuple):
    """Version that a client requests, or a server grants."""

    version: int


class ServerReader:
    """Reader of a server's stream, in pieces of any length; keeps at most 31 bytes."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[ServerRecord | Handshake]:
        """Return the values that `data` completes. Never raises."""
        buffer = self._buffer + data
        values: list[ServerRecord | Handshake] = []
        at = 0
        while len(buffer) - at >= WORD_BYTES:
            # A grant is a single word between records, even if the server answers late.
            version = decode_handshake(buffer[at : at + WORD_BYTES])
            if version is not None:
                values.append(Handshake(version))
                at += WORD_BYTES
                continue
            if len(buffer) - at < RECORD_BYTES:
                break
            values.append(decode_server_record(buffer[at : at + RECORD_BYTES]))
            at += RECORD_BYTES
        self._buffer = buffer[at:]
        return values
