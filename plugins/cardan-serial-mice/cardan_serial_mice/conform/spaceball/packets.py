"""Meaning of a Spaceball's packets for checks."""

from __future__ import annotations

from cardan_serial_mice.conform.puck.decoded import PacketMeaning, PuckTraffic
from cardan_serial_mice.protocol import (
    SpaceballAdvancedKeys,
    SpaceballEcho,
    SpaceballError,
    SpaceballKeys,
    SpaceballMotion,
    SpaceballPacket,
    SpaceballReader,
    SpaceballReset,
)
from cardan_serial_mice.protocol.spaceball import QUERY_KEYS, RESET

BallTraffic = PuckTraffic[SpaceballPacket]
UNKNOWN = b"U0"
"""Not a valid command."""


class SpaceballMeaning(PacketMeaning[SpaceballPacket]):
    """Meaning of the packets: settings are echoed by their letter; a reset ends with its second
    line."""

    def reader(self) -> SpaceballReader:
        return SpaceballReader()

    def counts(self, value: SpaceballPacket) -> tuple[int, ...]:
        return tuple(value[1:]) if isinstance(value, SpaceballMotion) else ()

    def mask(self, value: SpaceballPacket) -> int | None:
        if isinstance(value, SpaceballAdvancedKeys):
            return (value.high & 0x1F) << 8 | value.low & 0xBF
        if not isinstance(value, SpaceballKeys):
            return None
        # The right key of a 3003 is wired to the pick of a 2003 too.
        high = value.high & (0x2F if value.low & 0x20 else 0x3F)
        return high << 8 | value.low & 0x3F

    def answers(self, value: SpaceballPacket, command: bytes) -> bool:
        if command == RESET:
            return isinstance(value, SpaceballReset) and value.text.startswith("2")
        if command == QUERY_KEYS:
            return isinstance(value, SpaceballKeys)
        if command == UNKNOWN:
            return isinstance(value, SpaceballError)
        return isinstance(value, SpaceballEcho) and value.letter == command[0]
