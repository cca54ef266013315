"""Meaning of a SpaceOrb's packets for checks."""

from __future__ import annotations

from cardan_serial_mice.conform.puck.decoded import PacketMeaning, PuckTraffic
from cardan_serial_mice.protocol import OrbKeys, OrbMotion, OrbPacket, OrbReader, OrbText

OrbTraffic = PuckTraffic[OrbPacket]
POLL = b"d"
"""Request for one motion."""
NULL_REGION = b"n"


class SpaceOrbMeaning(PacketMeaning[OrbPacket]):
    """Meaning of the packets: `?` is answered with information, `n` with the null region, `d` with
    a motion."""

    def reader(self) -> OrbReader:
        return OrbReader()

    def counts(self, value: OrbPacket) -> tuple[int, ...]:
        return tuple(value[1:]) if isinstance(value, OrbMotion) else ()

    def mask(self, value: OrbPacket) -> int | None:
        return value.status if isinstance(value, OrbKeys) else None

    def answers(self, value: OrbPacket, command: bytes) -> bool:
        if command == POLL:
            return isinstance(value, OrbMotion)
        letters = {b"?": b"!", NULL_REGION: b"N"}
        return isinstance(value, OrbText) and bytes((value.letter,)) == letters.get(command)
