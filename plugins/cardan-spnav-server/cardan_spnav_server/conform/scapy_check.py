"""The scapy layers as a second decoder of the daemon's records, if they are installed."""

from __future__ import annotations

from typing import Any

from cardan.conform.requirements import Verdict, failed, not_seen, passed
from cardan.conform.second_reading import second_description
from cardan.protocols.spnav.records import (
    RECORD_BYTES,
    Button,
    ConfigChange,
    DeviceChange,
    MalformedRecord,
    MotionEvent,
    RawAxis,
    RawButton,
    ServerReply,
)
from cardan.protocols.spnav.streams import Handshake
from cardan_spnav_server.conform.decoded import Record, SpnavTraffic

WORD_BYTES = 4
COMPARED = 2000
"""Most records of a connection that are read twice."""


def readings_differ(decoded: SpnavTraffic) -> Verdict:
    """Check if the layers split and read the daemon's streams as the codec does."""
    layers = second_description("spnav")
    count = 0
    for channel, stream in decoded.streams.items():
        at = 0
        for each in decoded.during(channel)[:COMPARED]:
            word = layers.SpnavFromServer(stream[at : at + WORD_BYTES])
            greets = isinstance(word, layers.SpnavHandshake)
            size = WORD_BYTES if greets else RECORD_BYTES
            layer = word if greets else layers.SpnavFromServer(stream[at : at + size])
            at += size
            broken = isinstance(layer, layers.SpnavBroken)
            if broken != isinstance(each.value, MalformedRecord):
                return failed("one of them cannot read it", [each.number])
            if not broken and not _alike(each, _flat(layer.fields.values())):
                return failed("they read other numbers", [each.number])
            count += 1
    return passed(f"{count} records read twice") if count else not_seen("no records came")


def _flat(values: Any) -> list[int]:
    numbers: list[int] = []
    for each in values:
        numbers += each if isinstance(each, list) else [each]
    return numbers


def _alike(record: Record, read: list[int]) -> bool:
    """Return True if the layer's fields begin with the codec's values."""
    value = record.value
    words: tuple[int, ...] = ()
    if isinstance(value, Handshake):
        words = (value.version,)
    elif isinstance(value, ServerReply):
        words = (value.code, value.word >> 16, *value.data)
    elif isinstance(value, MotionEvent):
        words = (0, *value)
    elif isinstance(value, Button):
        words = (1 if value.pressed else 2, value.number)
    elif isinstance(value, DeviceChange):
        words = (3, int(not value.added), *value[1:])
    elif isinstance(value, ConfigChange):
        words = (4, value.code, *value.data)
    elif isinstance(value, (RawAxis, RawButton)):
        words = (5 if isinstance(value, RawAxis) else 6, *map(int, value))
    return tuple(read[: len(words)]) == words
