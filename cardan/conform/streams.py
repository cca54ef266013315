"""The bytes of channels, cut into what is whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from cardan.conform.timeline import Event


class Streams:
    """A reader for each channel. One that fails is left for a new one."""

    def __init__(self, made: Callable[[str], Any], failed: Callable[[int, str, str], None]) -> None:
        """`made` makes of a channel's name its reader, with `feed`, `take`, `pending_bytes` and
        `failure`; `failed` gets the number of the event by which one failed, the channel, and
        why."""
        self._made, self._failed = made, failed
        self._readers: dict[str, Any] = {}
        self._begun_s: dict[str, float] = {}
        """When the first bytes came of what is not whole yet."""

    def begin(self, channel: str) -> None:
        """What comes from now on has nothing to do with what came before."""
        self._readers[channel] = self._made(channel)
        self._begun_s.pop(channel, None)

    def reader(self, channel: str) -> Any:
        """That of a channel."""
        if channel not in self._readers:
            self.begin(channel)
        return self._readers[channel]

    def whole(self, number: int, event: Event) -> Iterator[tuple[float, Any]]:
        """What is whole now of what comes on a channel, and when the first bytes of each came, s.
        `number` is the event's."""
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
