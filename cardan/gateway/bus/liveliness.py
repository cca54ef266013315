"""Participants of the bus, by liveliness tokens: monitors whether the client of a motion is still
connected. A token disappears with its process: at once if the process ends, for any reason, because
the computer then closes its connections; after the lease of its Zenoh session if the computer or
the cable fails."""

from __future__ import annotations

from collections.abc import Hashable
from typing import NamedTuple

from cardan.bus.node import Received, ServiceRequest, gid_of_token
from cardan.protocols.ros2.zenoh import LIVELINESS, Entity

UNKNOWN = (
    "this motion has no end, and its sender has no liveliness token, so its loss would "
    "go unnoticed: send it from a node of ROS 2 over rmw_zenoh, from a Zenoh session that has "
    "timestamping and a liveliness token, or by cardan.network_arm; or set "
    "endless_without_watch in [network]"
)
"""Reason for refusing a motion without end."""


class Presence:
    """Presence of an endpoint, a node or a Zenoh session, from its first token to its last: after a
    return it is another presence."""

    def __init__(self, since_s: float) -> None:
        self.since_s = since_s
        """Time of its first token."""
        self.tokens = 0
        """Count of its tokens."""

    def there(self) -> bool:
        """True while it is on the bus. From any thread."""
        return self.tokens > 0


class Identity(NamedTuple):
    """Identity of a program on the bus."""

    key: Hashable
    """Its node, else its session, else its endpoint."""
    node: str
    """Full name of the node; empty: it has none."""
    presence: Presence | None
    """None if its end could not be seen."""
    mark: str
    """Distinguishes it from others of the same name."""


class _Token(NamedTuple):
    text: str
    owners: tuple[Presence, ...]
    """Presences of the endpoint, its node and its session."""


class LivelinessMonitor:
    """All endpoints, nodes and sessions of other programs. `take` is for one thread, the rest for
    any; unknown values are None."""

    def __init__(self, own: str) -> None:
        """`own`: id of the local Zenoh session. It gives its own id to samples without a timestamp,
        so that this id does not identify a client."""
        self._own = own
        self._tokens: dict[bytes, _Token] = {}
        """Tokens by GID."""
        self._owners: dict[str, Presence] = {}
        """Sessions by "ZID", nodes by "ZID/NODE"."""

    def take(self, token: str, there: bool, now_s: float) -> None:
        """Record that a liveliness token appeared or disappeared now, perhaps twice; tokens other
        than ROS 2's are ignored."""
        parts = token.split("/", 4)
        if len(parts) < 5 or parts[0] != LIVELINESS or parts[2] == self._own:
            return
        gid = gid_of_token(token)
        names = f"{parts[2]}/{parts[3]}", parts[2]
        if there and gid not in self._tokens:
            owners = (
                Presence(now_s),
                *(self._owners.setdefault(name, Presence(now_s)) for name in names),
            )
            for each in owners:
                each.tokens += 1
            self._tokens[gid] = _Token(token, owners)
        elif not there and gid in self._tokens:
            for each in self._tokens.pop(gid).owners:
                each.tokens -= 1
            for name in names:
                if not self._owners[name].there():
                    del self._owners[name]

    def endpoint(self, gid: bytes) -> Presence | None:
        """Return the publisher or client with this GID."""
        token = self._tokens.get(gid)
        return None if token is None else token.owners[0]

    def node(self, gid: bytes) -> Presence | None:
        """Return the node that has the endpoint with this GID."""
        token = self._tokens.get(gid)
        return None if token is None else token.owners[1]

    def knows(self, packet: Received | ServiceRequest) -> bool:
        """Return whether the token of a packet's sender is there, or the sender cannot be known."""
        if packet.attachment is not None:
            return packet.attachment.gid in self._tokens
        zid = packet.zid if isinstance(packet, Received) else ""
        return not zid or zid in self._owners

    def session(self, zid: str) -> Presence | None:
        """Return the Zenoh session with this id."""
        return self._owners.get(zid)

    def identity(self, packet: Received | ServiceRequest) -> Identity:
        """Return the sender of a packet: the node that has its GID; the session for an unknown GID
        (old releases of rmw_zenoh name publishers at random) or another session's."""
        gid = b"" if packet.attachment is None else packet.attachment.gid
        zid = packet.zid if isinstance(packet, Received) else ""
        session = self._owners.get(zid)
        token = self._tokens.get(gid)
        entity = None if token is None else Entity.parse(token.text)
        if token is not None and entity is not None and (session is None or zid == entity.zid):
            node = token.owners[1]
            return Identity(node, entity.full_node, node, f"{entity.zid}{entity.node_id}")
        if session is not None:
            return Identity(session, self._only_node(zid), session, zid)
        return Identity(gid or zid, "", None, gid.hex() or zid)

    def _only_node(self, zid: str) -> str:
        """Return the full name of the only node of a session; empty if it has none or several."""
        found = {
            entity.full_node
            for entity in map(Entity.parse, [each.text for each in tuple(self._tokens.values())])
            if entity is not None and entity.zid == zid
        }
        return found.pop() if len(found) == 1 else ""
