"""Sources of an arm's authority on the bus: each program is one, by the name of its node. While the
node is on the bus, another one of the same name is another source."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable

from cardan.bus.node import LEASE_MS, Received, ServiceRequest
from cardan.common.bounds import LONGEST_BLIND_S
from cardan.gateway.arm.validation import LONGEST_NAME
from cardan.gateway.bus.liveliness import Identity, LivelinessMonitor
from cardan.types import NEVER_S

STREAM_RETENTION_S = LONGEST_BLIND_S
"""Silence after which a publisher loses its stream, and one without a node its name: no stream is
fresh for longer, with any streamTimeout."""

BEGINS_S = 3.0
"""Time from its first message in which a stream may choose its preset: opening the arm's model
takes a second, and waiting for the lease of a source that is gone two. Later, a running stream must
not move an arm unexpectedly."""

NAMED_WITHIN_S = 0.2
"""Longest wait of a packet for its sender's token, because tokens and packets travel by different
queues of Zenoh: less than the allowed delay of a streamed command. A stop does not wait."""

MAX_UNNAMED = 256
"""Most endpoints without a token that are remembered, so that each waits once; the longest silent
one is forgotten first."""

MAX_SOURCES = 64
"""Most programs known at a time; the longest silent one is dropped first."""

_PER_PROCESS = re.compile(r"(/_ros2cli|/rqt_gui_(?:py|cpp)_node)_\d+$")
"""Names of nodes of ROS 2's own tools that end with their process's id: the same command, run
again, is the same source."""

TELLING_DIGITS = 8
"""Length of the mark that distinguishes sources of the same name."""

LONGEST_WORDS = LONGEST_NAME - TELLING_DIGITS - 2
"""Characters of a source's name without its mark."""


class Source:
    """A program that commands the arm, and its stream."""

    def __init__(self, identity: Identity, now_s: float) -> None:
        self.identity, self._met_s = identity, now_s
        self.name = ""
        """Its name in the arm's authority."""
        self.heard_s = NEVER_S
        """Time of its newest command."""
        self._publisher: Hashable = None
        """Its streaming publisher."""
        self._streamed_s = self._may_begin_s = NEVER_S
        self._rests = False

    def gone(self, now_s: float) -> bool:
        """Return whether another program may take its name. A killed program is present until its
        computer closes its connections, which it does at once."""
        presence = self.identity.presence
        if presence is None:
            return now_s - self.heard_s > STREAM_RETENTION_S
        return not presence.there()

    def connected_s(self, now_s: float) -> float:
        """Return the time that it has been on the bus; infinite if unknown."""
        presence = self.identity.presence
        return math.inf if presence is None else now_s - min(presence.since_s, self._met_s)

    def stream(self, publisher: Hashable, now_s: float) -> bool:
        """Return whether this publisher may stream now, as the only one."""
        silent = now_s - self._streamed_s > STREAM_RETENTION_S
        begins = silent or publisher != self._publisher
        if begins and not silent and not self._rests:
            return False
        self._publisher, self._streamed_s, self._rests = publisher, now_s, False
        if begins:
            self._may_begin_s = now_s + BEGINS_S
        return True

    def rest(self, now_s: float) -> None:
        """Record that the newest message of its stream requests no motion."""
        self._rests, self._may_begin_s = True, now_s + BEGINS_S

    def may_begin(self, now_s: float) -> bool:
        """Return whether its stream has just begun: a stopped stream does not restart by itself."""
        return now_s <= self._may_begin_s

    def spend(self) -> None:
        """Record that a message was accepted, or the arm stopped: the stream counts as begun."""
        self._may_begin_s = NEVER_S


class Unnamed:
    """Endpoints without a token yet, and the times until which their packets wait."""

    def __init__(self) -> None:
        self._until_s: dict[Hashable, float] = {}

    def until_s(self, endpoint: Hashable, now_s: float) -> float:
        """Return the time until which a packet of `endpoint`, whose token is missing, waits: once
        for all of its packets."""
        until_s = self._until_s.pop(endpoint, now_s + NAMED_WITHIN_S)
        if len(self._until_s) >= MAX_UNNAMED:
            del self._until_s[next(iter(self._until_s))]
        self._until_s[endpoint] = until_s
        return until_s


class Sources:
    """All programs that command the arm. For one thread, except `spend`."""

    def __init__(
        self, network: str, liveliness: LivelinessMonitor, owner: Callable[[], str]
    ) -> None:
        """`network`: common first word of their names; `owner`: the source that has the authority
        now, which keeps its name."""
        self._network, self._liveliness, self._owner = network, liveliness, owner
        self._sources: dict[Hashable, Source] = {}
        self._names: dict[str, Source] = {}

    def of(self, packet: Received | ServiceRequest, now_s: float) -> Source:
        """Return the source that sent a packet."""
        identity = self._liveliness.identity(packet)
        if identity.presence is None and not isinstance(packet, Received):
            # It may be of any program without a token, also of the one that streams.
            source = Source(identity, now_s)
            source.name = self._network
            return source
        return self._identified(identity, packet, now_s)

    def _identified(
        self, identity: Identity, packet: Received | ServiceRequest, now_s: float
    ) -> Source:
        source = self._sources.get(identity.key)
        if source is None and packet.attachment is not None:
            # Its token came after its first packet.
            source = self._sources.pop(packet.attachment.gid, None)
            if source is not None:
                source.identity = identity
                self._rename(source, now_s)
        return self.heard(source or Source(identity, now_s), now_s)

    def heard(self, source: Source, now_s: float) -> Source:
        """Record that a packet of `source` has arrived; it gets its name at its begin, and after a
        silence."""
        key = source.identity.key
        if self._sources.pop(key, None) is None and len(self._sources) >= MAX_SOURCES:
            self._forget(next(iter(self._sources)))
        self._sources[key] = source
        if now_s - source.heard_s > STREAM_RETENTION_S:
            self._rename(source, now_s)
        source.heard_s = now_s
        return source

    def _rename(self, source: Source, now_s: float) -> None:
        if not source.name or source.name != self._owner():
            source.name = self._name(source, now_s)

    def claim(self, name: str, packet: ServiceRequest, now_s: float) -> str:
        """Return why the sender of `packet` may not be the source `name`, which it chose; empty
        when it may."""
        if name == self._network or name.startswith(f"{self._network} "):
            return f"{name!r} is the name of a node of ROS 2: choose another one"
        source = self._identified(self._liveliness.identity(packet), packet, now_s)
        if self._take_name(name, source, now_s):
            return ""
        return (
            f"another program is the source {name!r}: choose another name; where it is one that "
            f"has died, or whose computer is gone, the name is free after {LEASE_MS / 1000:g} s"
        )

    def _take_name(self, name: str, source: Source, now_s: float) -> bool:
        holder = self._names.get(name)
        if holder is not None and holder is not source and not holder.gone(now_s):
            return False
        self._names[name] = source
        return True

    def _forget(self, key: Hashable) -> None:
        gone = self._sources.pop(key)
        for name in [name for name, holder in self._names.items() if holder is gone]:
            del self._names[name]

    def _name(self, source: Source, now_s: float) -> str:
        identity = source.identity
        node = _PER_PROCESS.sub(r"\1", identity.node)
        words = f"{self._network} {node}".rstrip()
        if len(words) > LONGEST_WORDS:
            words = f"{words[: LONGEST_WORDS - 1]}…"
        if self._take_name(words, source, now_s):
            return words
        return f"{words}{'' if node else ' '}#{identity.mark[:TELLING_DIGITS]}"

    def spend(self) -> None:
        """Record a stop of the arm: no stream restarts by itself."""
        for source in tuple(self._sources.values()):
            source.spend()
