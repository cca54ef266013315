"""Wire formats of rmw_zenoh: key expressions, attachments and liveliness tokens, as texts and
bytes.

No session is opened. Source: rmw_zenoh's design document, and ROS 2's own implementation as
measured (see docs).
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from cardan.protocols.ros2.interfaces import full_name
from cardan.protocols.ros2.names import dds_type, type_of_dds
from cardan.protocols.ros2.type_hash import UNSUPPORTED, type_hash

LIVELINESS = "@ros2_lv"
"""First part of every liveliness token."""

ATTACHMENT = struct.Struct("<qqB16s")
"""Sequence number, time of sending since the epoch in ns, length of the GID (16), GID."""

_GID_BYTES = 16

_USUAL_DEPTH, _DEPTH_DIGITS = 42, 10
"""Depth of an empty field; longest depth, in digits, that is read: Python converts no longer
number."""

PUBLISHER, SUBSCRIPTION, SERVICE, CLIENT, NODE = "MP", "MS", "SS", "SC", "NN"
"""Kinds of entities in tokens."""

KINDS = (PUBLISHER, SUBSCRIPTION, SERVICE, CLIENT)


class Qos(NamedTuple):
    """Quality of service of an endpoint, as far as Cardan uses it."""

    reliable: bool = True
    transient_local: bool = False
    depth: int = 10
    keep_all: bool = False

    def text(self) -> str:
        """Encode as in tokens; a field is empty if it is rmw_zenoh's default, except the depth: an
        empty one would mean 42."""
        history = "2" if self.keep_all else ""
        return (
            f"{'' if self.reliable else 2}:{1 if self.transient_local else ''}:"
            f"{history},{self.depth}:,:,:,,"
        )

    @classmethod
    def parse(cls, text: str) -> Qos:
        """Parse the QoS of a token. An unreadable value counts as the default."""
        parts = [*text.split(":"), "", "", ""]
        history, _, depth = parts[2].partition(",")
        readable = depth.isdecimal() and len(depth) <= _DEPTH_DIGITS
        return cls(
            parts[0] != "2", parts[1] == "1", int(depth) if readable else _USUAL_DEPTH,
            history == "2",
        )  # fmt: skip


DEFAULT_QOS = Qos()
LATCHED_QOS = Qos(transient_local=True, depth=1)
NEWEST_QOS = Qos(reliable=False, depth=1)
"""Quality of service of values that the next one replaces: a lost one is not sent again."""
PARAMETERS_QOS = Qos(depth=1000)
ROSOUT_QOS = Qos(transient_local=True, depth=1000)


class Attachment(NamedTuple):
    """Attachment of each publication, request and reply."""

    sequence: int
    source_ns: int
    """Time of sending, ns since the epoch by the sender's clock."""
    gid: bytes

    def encode(self) -> bytes:
        """Encode as bytes."""
        return ATTACHMENT.pack(self.sequence, self.source_ns, _GID_BYTES, self.gid)

    @classmethod
    def decode(cls, data: bytes) -> Attachment | None:
        """Decode bytes; None if they are invalid."""
        if len(data) != ATTACHMENT.size:
            return None
        sequence, source_ns, length, gid = ATTACHMENT.unpack(data)
        return cls(sequence, source_ns, gid) if length == _GID_BYTES else None

    def follows(self, sequence: int, source_ns: int) -> bool:
        """True if it was sent after the message of the same GID with the other attachment: a later
        one with a lower number is from a restarted publisher whose Zenoh session id is
        configured."""
        return self.sequence > sequence or self.source_ns > source_ns


def data_key(domain: int, name: str, type_name: str, hashed: bool = True) -> str:
    """Return the key expression of a topic's messages, or of a service's requests.

    `name` is absolute; `type_name` is a message, or a service as a whole. Not `hashed`: Humble's
    form. Raises InterfaceError for an unknown type.
    """
    mark = type_hash(type_name) if hashed else UNSUPPORTED
    return f"{domain}/{name[1:]}/{dds_type(type_name)}/{mark}"


class Entity(NamedTuple):
    """A node, or one of its endpoints, from its liveliness token."""

    zid: str
    """Id of the Zenoh session."""
    node_id: str
    entity_id: str
    kind: str
    namespace: str
    """Namespace: "/" or "/NAME"."""
    node: str
    name: str = ""
    """Absolute name of the topic or service; empty for a node."""
    type_name: str = ""
    """Three-part name; empty for a node, or if it is no ROS type."""
    type_hash: str = ""
    qos: Qos = DEFAULT_QOS

    @property
    def full_node(self) -> str:
        """Full name of the node: "/arm/cardan"."""
        return f"{self.namespace.rstrip('/')}/{self.node}"

    def token(self, domain: int) -> str:
        """Return the key expression of its liveliness token."""
        parts = [LIVELINESS, str(domain), self.zid, self.node_id, self.entity_id, self.kind]
        parts += ["%", mangled(self.namespace), self.node]
        if self.kind != NODE:
            parts += [mangled(self.name), dds_type(self.type_name), self.type_hash]
            parts += [self.qos.text()]
        return "/".join(parts)

    @classmethod
    def parse(cls, token: str) -> Entity | None:
        """Parse the key expression of a token; None if it is invalid."""
        parts = token.split("/")
        if len(parts) < 9 or parts[0] != LIVELINESS:
            return None
        zid, node_id, entity_id, kind = parts[2:6]
        namespace, node = _unmangled(parts[7]) or "/", parts[8]
        if kind == NODE:
            return cls(zid, node_id, entity_id, kind, namespace, node)
        if kind not in KINDS or len(parts) != 13:
            return None
        return cls(
            zid, node_id, entity_id, kind, namespace, node, _unmangled(parts[9]),
            type_of_dds(parts[10]), parts[11], Qos.parse(parts[12]),
        )  # fmt: skip


def token_pattern(domain: int, kind: str, name: str) -> str:
    """Return the key expression of the tokens of all endpoints of a `kind` with an absolute
    name."""
    return f"{LIVELINESS}/{domain}/*/*/*/{kind}/*/*/*/{mangled(name)}/**"


def node_pattern(domain: int, namespace: str, node: str) -> str:
    """Return the key expression of the tokens of all nodes with this name and namespace."""
    return f"{LIVELINESS}/{domain}/*/*/*/{NODE}/*/{mangled(namespace)}/{node}"


def strange_key(entity: Entity, domain: int) -> str:
    """Return the key expression of an entity's endpoint whose type Cardan does not know."""
    return f"{domain}/{entity.name[1:]}/{dds_type(entity.type_name)}/{entity.type_hash}"


def endpoint_hash(type_name: str, hashed: bool = True) -> str:
    """Return the type hash in the token and the key of an endpoint. Raises InterfaceError."""
    return type_hash(full_name(type_name)) if hashed else UNSUPPORTED


def mangled(part: str) -> str:
    """Encode a name as one part of a key: / becomes %, and an empty name is %."""
    return part.replace("/", "%") if part.strip("/") else "%"


def _unmangled(part: str) -> str:
    return "" if part == "%" else part.replace("%", "/")
