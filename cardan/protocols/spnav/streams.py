"""Both directions of a spacenavd connection as byte streams, cut into values."""

from __future__ import annotations

from typing import NamedTuple

from cardan.protocols.spnav.codes import NEWEST_VERSION
from cardan.protocols.spnav.records import (
    RECORD_BYTES,
    WORD_BYTES,
    Malformed,
    Request,
    ServerRecord,
    decode_handshake,
    decode_request,
    decode_sensitivity,
    decode_server_record,
)


class Handshake(NamedTuple):
    """The version that a client asks for, or a server grants."""

    version: int


class Sensitivity(NamedTuple):
    """What a client of version 0 wants its motion multiplied by; NaN is possible."""

    value: float


class ServerReader:
    """Reads what a server sends, whatever pieces it comes in; at most 31 bytes are kept."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[ServerRecord | Handshake]:
        """The values that `data` completes. Never raises."""
        buffer = self._buffer + data
        values: list[ServerRecord | Handshake] = []
        at = 0
        while len(buffer) - at >= WORD_BYTES:
            # A grant is one word between records, however late a server answers.
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


class ClientReader:
    """Reads what a client sends, whatever pieces it comes in; at most 31 bytes are kept.

    `newest` is the newest version to speak: 0 takes every handshake for a sensitivity, NaN.
    """

    def __init__(self, newest: int = NEWEST_VERSION) -> None:
        self._newest = newest
        self.version = 0
        """The version in force."""
        self._buffer = b""

    def feed(self, data: bytes) -> list[Request | Handshake | Sensitivity | Malformed]:
        """The values that `data` completes. Never raises.

        `Handshake.version` is what to grant; it is in force for the bytes that follow.
        """
        buffer = self._buffer + data
        values: list[Request | Handshake | Sensitivity | Malformed] = []
        at = 0
        while True:
            size = RECORD_BYTES if self.version else WORD_BYTES
            if len(buffer) - at < size:
                break
            piece = buffer[at : at + size]
            at += size
            if self.version:
                values.append(decode_request(piece))
            elif self._newest and (asked := decode_handshake(piece)) is not None:
                self.version = min(asked, self._newest)
                values.append(Handshake(self.version))
            else:
                values.append(Sensitivity(decode_sensitivity(piece)))
        self._buffer = buffer[at:]
        return values
