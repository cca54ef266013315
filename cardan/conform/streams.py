"""Reassembly of the byte streams of channels into whole messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from cardan.conform.timeline import WireEvent


class ChannelReaders:
    """A message reader for each channel. A reader that fails is replaced by a new one."""

    def __init__(self, made: Callable[[str], Any], failed: Callable[[int, str, str], None]) -> None:
        """`made` returns the reader for a channel's name, with `feed`, `take`, `pending_bytes` and
        `failure`; `failed` gets the number of the event by which a reader failed, the channel, and
        the reason."""
        self._made, self._failed = made, failed
        self._readers: dict[str, Any] = {}
        self._begun_s: dict[str, float] = {}
        """Arrival of the first bytes of each channel's incomplete message."""

    def begin(self, channel: str) -> None:
        """Restart the channel: later bytes do not continue earlier ones."""
        self._readers[channel] = self._made(channel)
        self._begun_s.pop(channel, None)

    def reader(self, channel: str) -> Any:
        """Return the reader of a channel."""
        if channel not in self._readers:
            self.begin(channel)
        return self._readers[channel]

    def whole(self, number: int, event: WireEvent) -> Iterator[tuple[float, Any]]:
        """Yield the messages that `event` completes on its channel, each after the arrival time of
        its first bytes, s. `number` is the event's."""
        channel, reader = event.channel, self.reader(event.channel)
        begun_s = self._begun_s.pop(channel, event.time_s)
        reader.feed(event.data)
        while (found := reader.take()) is not None:
            yield begun_s, found
            begun_s = event.time_s
        if reader.pending_bytes:
            self._begun_s[channel] = begun_s
        if reader.failure:
            self._failed(number, channel, reader.failure)
            self.begin(channel)
