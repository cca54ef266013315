"""Decoded packets of Magellan's protocol for checks."""

from __future__ import annotations

from cardan_serial_mice.conform.puck.decoded import PacketMeaning, PuckTraffic
from cardan_serial_mice.protocol import (
    MagellanError,
    MagellanKeys,
    MagellanMotion,
    MagellanPacket,
    MagellanReader,
    MagellanVersion,
)

MagellanTraffic = PuckTraffic[MagellanPacket]


class MagellanMeaning(PacketMeaning[MagellanPacket]):
    """Meaning of the packets: an answer begins with its command's letter."""

    def reader(self) -> MagellanReader:
        return MagellanReader()

    def counts(self, value: MagellanPacket) -> tuple[int, ...]:
        return tuple(value) if isinstance(value, MagellanMotion) else ()

    def mask(self, value: MagellanPacket) -> int | None:
        return value.mask if isinstance(value, MagellanKeys) else None

    def answers(self, value: MagellanPacket, command: bytes) -> bool:
        for kind, letter in _LETTERS:
            if isinstance(value, kind):
                return letter == command[:1]
        said: bytes = getattr(value, "command", b"")
        return bool(said) and said[:1] == command[:1]


_LETTERS = ((MagellanVersion, b"v"), (MagellanKeys, b"k"), (MagellanError, b"e"))
