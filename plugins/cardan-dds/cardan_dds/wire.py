"""ROS 2 over DDS on the wire: names, user data, headers of services, the announcement of nodes.

Source: rmw_dds_common and rmw_cyclonedds (topic names, ``user_data``, ``ros_discovery_info``, the
header of requests), design.ros2.org "Topic and service names"; vendor ids: OMG DDSI-RTPS 2.5, 9.3.
No function opens a participant.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import NamedTuple

from cardan.protocols.ros2.cdr import ENCAPSULATION, codec_of
from cardan.protocols.ros2.names import dds_type, type_of_dds

DISCOVERY_TOPIC = "ros_discovery_info"
"""Topic on which participants announce their nodes; it has no prefix."""

DISCOVERY_TYPE = "rmw_dds_common/msg/ParticipantEntitiesInfo"

GID_BYTES, HUMBLE_GID_BYTES = 16, 24
"""Length of the ids in announcements, the only field that differs between distributions. Up to
Humble eight zeros follow the GUID; the names of topic and type are the same."""

ENCLAVE = b"enclave=/;"
"""User data of a participant; without them it does not count as ROS 2."""

BARE_NODE = "/_CREATED_BY_BARE_DDS_APP_"
"""ROS 2's node name for an endpoint that no node has announced."""

HEADER = struct.Struct("<Qq")
"""Header of each request and reply: the client's id and the request's number."""

GUID_BYTES = 16

TOPIC, REQUEST, REPLY = "rt", "rq", "rr"
"""Prefixes of DDS topics."""

_SUFFIXES = {TOPIC: "", REQUEST: "Request", REPLY: "Reply"}
_PARTS = {TOPIC: "", REQUEST: "_Request", REPLY: "_Response"}

CYCLONE, FAST_DDS, CONNEXT, RUST_DDS = "Cyclone DDS", "Fast DDS", "RTI Connext", "RustDDS"
_VENDORS = {
    b"\x01\x01": CONNEXT,
    b"\x01\x0f": FAST_DDS,
    b"\x01\x10": CYCLONE,
    b"\x01\x12": RUST_DDS,
}

_LENGTH = struct.Struct("<I")

HEADER_SENDERS = (CYCLONE, RUST_DDS)
"""Vendors whose clients put the header before requests; requests of others would be misread."""

WAYS_OUT = (
    "services do not work between Cyclone DDS and other DDS vendors; commands on topics do, and so "
    "do services with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp for the program that calls, with "
    "rmw_zenoh_cpp, and by rosbridge"
)
"""Advice for users of another DDS."""


def vendor(guid: bytes) -> str:
    """Return the vendor of the DDS with a participant or endpoint of this GUID; empty: unknown.

    By convention of all listed vendors, the first two bytes identify the vendor.
    """
    return _VENDORS.get(guid[:2], "")


# -- names ----------------------------------------------------------------------------------------


class DdsName(NamedTuple):
    """ROS 2's interpretation of a DDS topic."""

    prefix: str
    """TOPIC, REQUEST or REPLY."""
    name: str
    """Absolute name of the topic or service."""
    type_name: str
    """Type of the message, or of the whole service: "std_srvs/srv/Trigger"; empty if it is not a
    ROS type."""


def dds_topic(prefix: str, name: str) -> str:
    """Return the DDS topic of an absolute name: "/gcmp", REQUEST -> "rq/gcmpRequest"."""
    return f"{prefix}{name}{_SUFFIXES[prefix]}"


def dds_type_of(prefix: str, type_name: str) -> str:
    """Return the DDS type of a message, or of a service's request or reply. Raises InterfaceError
    for a string that is not a type name."""
    return dds_type(f"{type_name}{_PARTS[prefix]}")


def ros_name(topic: str, type_name: str) -> DdsName | None:
    """Return ROS 2's interpretation of a DDS topic with a DDS type; None if it has none."""
    prefix, slash, rest = topic.partition("/")
    suffix = _SUFFIXES.get(prefix)
    if suffix is None or not slash or not rest.endswith(suffix):
        return None
    name = rest.removesuffix(suffix)
    ros_type, part = type_of_dds(type_name), _PARTS[prefix]
    ros_type = ros_type.removesuffix(part) if ros_type.endswith(part) else ""
    return DdsName(prefix, f"/{name}", ros_type) if name else None


# -- user data ------------------------------------------------------------------------------------


def user_data(pairs: Mapping[str, str]) -> bytes:
    """Encode the user data of an endpoint: "typehash=RIHS01_...;"."""
    return "".join(f"{key}={value};" for key, value in pairs.items() if value).encode("ascii")


def parsed_user_data(data: bytes) -> dict[str, str]:
    """Parse user data into pairs; malformed parts are skipped."""
    pairs = (each.partition("=") for each in data.decode("ascii", "replace").split(";"))
    return {key: value for key, equals, value in pairs if equals}


def service_id(participant: bytes, number: int) -> str:
    """Return the id that the two endpoints of a server or client share: 16 bytes in hex."""
    data = participant[:12] + number.to_bytes(4, "big")
    return ".".join(f"{each:x}" for each in data)


# -- payloads -------------------------------------------------------------------------------------


def padded(cdr: bytes | bytearray) -> bytes:
    """Return a message in the form that Cyclone DDS writes: its length is a multiple of four."""
    return bytes(cdr) + bytes(-len(cdr) % 4)


def exact(type_name: str, data: bytes) -> bytes:
    """Return a message of a known type without padding, as on Zenoh; its encapsulation header
    announces no padding."""
    data = ENCAPSULATION + data[4:] if data[:2] == ENCAPSULATION[:2] != data[2:4] else data
    return codec_of(type_name).exact(data)


class ServicePacket(NamedTuple):
    """A request or a reply."""

    client: int
    """Id of the client."""
    sequence: int
    """Number of the request, counted by the client."""
    cdr: bytes
    """The message with its encapsulation."""

    def encode(self) -> bytes:
        """Encode the packet for sending: padded, with its header inside the body."""
        head, body = self.cdr[:4], self.cdr[4:]
        return padded(head + HEADER.pack(self.client, self.sequence) + body)

    @classmethod
    def decode(cls, data: bytes) -> ServicePacket | None:
        """Decode a received packet; None if it has no header."""
        if len(data) < 4 + HEADER.size or data[:2] != ENCAPSULATION[:2]:
            return None
        client, sequence = HEADER.unpack_from(data, 4)
        return cls(client, sequence, ENCAPSULATION + data[4 + HEADER.size :])


# -- the announcement of nodes --------------------------------------------------------------------


class NodeInfo(NamedTuple):
    """Node in the announcement of its participant."""

    name: str
    """Full name: "/ns/node"."""
    readers: tuple[bytes, ...] = ()
    """GUIDs, 16 bytes each."""
    writers: tuple[bytes, ...] = ()


class Announcement(NamedTuple):
    """All nodes of a participant."""

    participant: bytes
    """GUID."""
    nodes: tuple[NodeInfo, ...] = ()

    def encode(self, gid_bytes: int = GID_BYTES) -> bytes:
        """Encode the announcement as CDR."""
        body = bytearray(self.participant.ljust(gid_bytes, b"\0"))

        def count(number: int) -> None:
            body.extend(bytes(-len(body) % 4) + _LENGTH.pack(number))

        def text(words: str) -> None:
            data = words.encode() + b"\0"
            count(len(data))
            body.extend(data)

        count(len(self.nodes))
        for node in self.nodes:
            namespace, _, name = node.name.rpartition("/")
            text(namespace or "/")
            text(name)
            for guids in (node.readers, node.writers):
                count(len(guids))
                for guid in guids:
                    body.extend(guid.ljust(gid_bytes, b"\0"))
        return padded(ENCAPSULATION + body)

    @classmethod
    def decode(cls, data: bytes, gid_bytes: int = GID_BYTES) -> Announcement | None:
        """Decode CDR; return None for other data, such as ids of the other length."""
        body, position = data[4:], 0

        def take(length: int) -> bytes:
            nonlocal position
            found = body[position : position + length]
            if len(found) < length:
                raise ValueError(length)
            position += length
            return found

        def count() -> int:
            take(-position % 4)
            number: int = _LENGTH.unpack(take(4))[0]
            if number > len(body):
                raise ValueError(number)
            return number

        def text() -> str:
            return take(count()).rstrip(b"\0").decode()

        def guid() -> bytes:
            return take(gid_bytes)[:GUID_BYTES]

        def guids() -> tuple[bytes, ...]:
            return tuple([guid() for _ in range(count())])

        def node() -> NodeInfo:
            namespace, name = text().rstrip("/"), text()
            return NodeInfo(f"{namespace}/{name}", guids(), guids())

        try:
            announced = cls(guid(), tuple([node() for _ in range(count())]))
        except ValueError:  # UnicodeDecodeError is a ValueError.
            return None
        good = data[:2] == ENCAPSULATION[:2] and len(body) - position <= 3
        return announced if good else None


# -- the graph ------------------------------------------------------------------------------------


class Endpoint(NamedTuple):
    """Reader or writer discovered by DDS."""

    guid: bytes
    participant: bytes
    """GUID of its participant."""
    writes: bool
    topic: str
    type_name: str
    """DDS's type name."""
    handle: int = 0
    """`publication_handle` of this writer's samples."""
    reliable: bool = True
    transient_local: bool = False
    user: bytes = b""
    described: bool = False
    """True if it is published with a description of its type."""

    @property
    def ros(self) -> DdsName | None:
        """ROS 2's interpretation of its topic."""
        return ros_name(self.topic, self.type_name)

    @property
    def vendor(self) -> str:
        """Vendor of its DDS."""
        return vendor(self.guid)

    def property_of(self, key: str) -> str:
        """Return a value of its user data: "serviceid", "clientid", "typehash"; empty if it has
        none."""
        return parsed_user_data(self.user).get(key, "")

    def belongs(self, other: Endpoint, key: str) -> bool:
        """Return True if another endpoint has the same server ("serviceid") or client ("clientid").
        An endpoint without user data may have: Cyclone DDS sometimes reports one without."""
        own, others = self.property_of(key), other.property_of(key)
        return other.participant == self.participant and (own == others or not own or not others)


class DdsGraph:
    """All endpoints and nodes of a domain. Endpoints may be added twice."""

    def __init__(self) -> None:
        self._endpoints: dict[bytes, Endpoint] = {}
        self._handles: dict[int, Endpoint] = {}
        self._ros: dict[tuple[str, str], dict[bytes, Endpoint]] = {}
        """Endpoints by prefix and ROS name."""
        self._announced: dict[bytes, Announcement] = {}
        self._nodes: dict[bytes, str] = {}
        """Node names by endpoints."""

    def add(self, endpoint: Endpoint) -> None:
        """Add or update an endpoint."""
        self._endpoints[endpoint.guid] = self._handles[endpoint.handle] = endpoint
        ros = endpoint.ros
        if ros is not None:
            self._ros.setdefault((ros.prefix, ros.name), {})[endpoint.guid] = endpoint

    def remove(self, guid: bytes) -> Endpoint | None:
        """Remove an endpoint, and return it."""
        endpoint = self._endpoints.pop(guid, None)
        if endpoint is None:
            return None
        self._handles.pop(endpoint.handle, None)
        ros = endpoint.ros
        if ros is not None:
            there = self._ros[ros.prefix, ros.name]
            del there[guid]
            if not there:
                del self._ros[ros.prefix, ros.name]
        return endpoint

    def announce(self, announcement: Announcement) -> None:
        """Record the announcement of a participant's nodes."""
        self.forget(announcement.participant)
        self._announced[announcement.participant] = announcement
        for node in announcement.nodes:
            for guid in (*node.readers, *node.writers):
                self._nodes[guid] = node.name

    def forget(self, participant: bytes) -> None:
        """Remove a participant, and the nodes that it announced."""
        announcement = self._announced.pop(participant, None)
        for node in () if announcement is None else announcement.nodes:
            for guid in (*node.readers, *node.writers):
                self._nodes.pop(guid, None)

    def by_handle(self, handle: int) -> Endpoint | None:
        """Return the endpoint with this instance handle."""
        return self._handles.get(handle)

    def nodes(self) -> list[str]:
        """Return the full names of all announced nodes, sorted."""
        return sorted(
            {node.name for announcement in self._announced.values() for node in announcement.nodes}
        )

    def having_node(self, name: str) -> list[bytes]:
        """Return the GUIDs of the participants that have announced a node of this full name."""
        return [
            guid
            for guid, announcement in self._announced.items()
            if any(node.name == name for node in announcement.nodes)
        ]

    def node_of(self, endpoint: Endpoint) -> str:
        """Return the full name of the node that has an endpoint."""
        return self._nodes.get(endpoint.guid, BARE_NODE)

    def having(self, prefix: str, name: str, writes: bool) -> list[Endpoint]:
        """Return the writers, or the readers, of a ROS name."""
        there = self._ros.get((prefix, name), {})
        return [each for each in there.values() if each.writes is writes]

    def participants(self) -> set[bytes]:
        """Return the GUIDs of the participants that have endpoints."""
        return {each.participant for each in self._endpoints.values()}

    def names(self, prefix: str) -> list[str]:
        """Return the ROS names that have endpoints, sorted."""
        return sorted(name for kind, name in self._ros if kind == prefix)
