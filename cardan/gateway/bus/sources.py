"""Sources of an arm's authority on the bus: each program is one, by the name of its node.

A name alone moves nothing: while the node that has it is on the bus, another one of the same name
is another source.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable

from cardan.bus.node import LEASE_MS, Received, ServiceRequest
from cardan.common.bounds import LONGEST_BLIND_S
from cardan.gateway.arm.validation import LONGEST_NAME
from cardan.gateway.bus.liveliness import Identity, LivelinessMonitor
from cardan.types import NEVER_S

STREAM_KEPT_S = LONGEST_BLIND_S
"""How long a publisher keeps its stream, and one without a node its name, after its newest message:
no stream is fresh for longer, whatever streamTimeout says."""

BEGINS_S = 3.0
"""How long a stream that chooses its preset tries to, from its first message on: opening the arm's
model takes a second, and waiting for the lease of a source that is gone two. A stream that goes on
for longer does not move an arm unexpectedly later."""

NAMED_WITHIN_S = 0.2
"""How long a packet waits for its sender's token, because tokens and packets travel by different
queues of Zenoh: less than a streamed command may be on its way. A stop does not wait."""

UNNAMED_KEPT = 256
"""Endpoints without a token that are remembered, so that each waits once; that which sent longest
ago is forgotten first."""

SOURCES_KEPT = 64
"""Programs that are known at a time; the longest silent one is dropped first."""

_PER_PROCESS = re.compile(r"(/_ros2cli|/rqt_gui_(?:py|cpp)_node)_\d+$")
"""Names of nodes that ROS 2's own tools end with their process's id: the same command that is
given again is the same source."""

TELLING_DIGITS = 8
"""Length of the mark that distinguishes sources of the same name."""

LONGEST_WORDS = LONGEST_NAME - TELLING_DIGITS - 2
"""Characters of a source's name without its mark."""


class Source:
    """A program that commands the arm, and its stream."""

    def __init__(self, identity: Identity, now_s: float) -> None:
        self.identity, self._met_s = identity, now_s
        self.name = ""
        """In the arm's authority."""
        self.heard_s = NEVER_S
        """When its newest command came."""
        self._publisher: Hashable = None
        """Its streaming publisher."""
        self._streamed_s = self._may_begin_s = NEVER_S
        self._rests = False

    def gone(self, now_s: float) -> bool:
        """True if another program may take its name. A killed program is present until its computer
        closes its connections, which it does at once."""
        presence = self.identity.presence
        if presence is None:
            return now_s - self.heard_s > STREAM_KEPT_S
        return not presence.there()

    def connected_s(self, now_s: float) -> float:
        """For how long it has been on the bus; infinite where that is not known."""
        presence = self.identity.presence
        return math.inf if presence is None else now_s - min(presence.since_s, self._met_s)

    def stream(self, publisher: Hashable, now_s: float) -> bool:
        """Whether this one of its publishers may stream now, alone."""
        silent = now_s - self._streamed_s > STREAM_KEPT_S
        begins = silent or publisher != self._publisher
        if begins and not silent and not self._rests:
            return False
        self._publisher, self._streamed_s, self._rests = publisher, now_s, False
        if begins:
            self._may_begin_s = now_s + BEGINS_S
        return True

    def rest(self, now_s: float) -> None:
        """The newest message of its stream asks for no motion."""
        self._rests, self._may_begin_s = True, now_s + BEGINS_S

    def may_begin(self, now_s: float) -> bool:
        """Whether its stream has just begun: a stopped stream does not go on by itself."""
        return now_s <= self._may_begin_s

    def spend(self) -> None:
        """A message was taken, or the arm was stopped: its stream does not begin any more."""
        self._may_begin_s = NEVER_S


class Unnamed:
    """Endpoints whose tokens have not come, and until when their packets wait for them."""

    def __init__(self) -> None:
        self._until_s: dict[Hashable, float] = {}

    def until_s(self, endpoint: Hashable, now_s: float) -> float:
        """When a packet of `endpoint`, whose token is not there, waits no longer: once for all of
        its packets."""
        until_s = self._until_s.pop(endpoint, now_s + NAMED_WITHIN_S)
        if len(self._until_s) >= UNNAMED_KEPT:
            del self._until_s[next(iter(self._until_s))]
        self._until_s[endpoint] = until_s
        return until_s


class Sources:
    """All programs that command the arm. For one thread, but for `spend`."""

    def __init__(
        self, network: str, liveliness: LivelinessMonitor, owner: Callable[[], str]
    ) -> None:
        """`network`: the name of all of them, to which each one's own is added; `owner`: the source
        that has the authority now, which keeps its name."""
        self._network, self._liveliness, self._owner = network, liveliness, owner
        self._sources: dict[Hashable, Source] = {}
        self._names: dict[str, Source] = {}

    def of(self, packet: Received | ServiceRequest, now_s: float) -> Source:
        """The source that sent a packet."""
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
        """Note that a packet of `source` has come; it gets its name when it begins, and after a
        silence."""
        key = source.identity.key
        if self._sources.pop(key, None) is None and len(self._sources) >= SOURCES_KEPT:
            self._forget(next(iter(self._sources)))
        self._sources[key] = source
        if now_s - source.heard_s > STREAM_KEPT_S:
            self._rename(source, now_s)
        source.heard_s = now_s
        return source

    def _rename(self, source: Source, now_s: float) -> None:
        if not source.name or source.name != self._owner():
            source.name = self._name(source, now_s)

    def claim(self, name: str, packet: ServiceRequest, now_s: float) -> str:
        """Why the program that sent `packet` may not be the source `name`, which it chose; empty
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
        """The arm was stopped: no stream that has begun begins again by itself."""
        for source in tuple(self._sources.values()):
            source.spend()
