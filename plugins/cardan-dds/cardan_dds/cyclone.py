"""Interface to Cyclone DDS for ROS 2's messages: raw CDR in and out, no type information.

The package's own classes encode and describe each message by a Python class. Here a message is
bytes; Cyclone knows only the name of its type, and one byte. The reader's codec checks messages:
Cyclone would drop a malformed one with a line on standard error. (It also does not report
big-endian messages, which no platform of ROS 2 sends.)
"""

from __future__ import annotations

import contextlib
import ctypes
import mmap
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

from cardan.bus.dds_options import DdsOptions
from cardan.common.extras import missing_extra
from cardan.errors import ConfigurationError, DriverError
from cardan.protocols.ros2.interfaces import Field, InterfaceError, message_type
from cardan.protocols.ros2.names import type_of_dds
from cardan.protocols.ros2.zenoh import Qos
from cardan_dds.wire import ENCLAVE, Endpoint, padded

MOST_PARTICIPANTS = 62
"""Participants of a domain on this computer, at least; in the highest domain, more have no
ports."""

LOOPBACK = f"""
<CycloneDDS xmlns="https://cdds.io/config"><Domain Id="any">
  <General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>{MOST_PARTICIPANTS}</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers></Discovery>
  <Internal><GenerateKeyhash>true</GenerateKeyhash>
    <WriterLingerDuration>20 ms</WriterLingerDuration></Internal>
</Domain></CycloneDDS>
"""
"""Configuration for this computer alone. Peers are met by multicast and by unicast on loopback,
which includes all local configurations of ROS 2. Without key hashes Fast DDS keeps a deleted
endpoint as long as its participant. A deleted writer waits for the acknowledgment of its last
messages, by default for a second, even if its reader has crashed."""

CONFIG_VARIABLE = "CYCLONEDDS_URI"

BLOCKED_MS = 10
"""Longest time that a full reliable writer blocks, and holds the interpreter. A writer that keeps
the last messages does not block at all."""

TAKEN_AT_ONCE = 64
"""Most samples that are taken from a reader in one turn."""

ROSOUT, ROSOUT_LIFESPAN_S = "rt/rosout", 10
"""Log messages are kept for late subscribers, but not for long."""

MATCHES = 256
"""Most matched endpoints that are queried."""

_ANY = 0xFFFF
"""All states of samples, views and instances."""

_UNREAD = 2 | 4 | 8 | 16 | 32 | 64
"""Samples not yet read, of all views and instances."""

_ALIVE = 16

_HANDLE = 0xFFFF_FFFF_FFFF_FFFF
"""Handles are unsigned; the package returns some as negative."""

_TABLE_POINTERS = 14
_DESCRIBING = 8, 9, 10
"""Places of type_id, type_map and type_info in the table of a sertype's operations
(ddsi_sertype.h): version, arg, free, zero_samples, realloc_samples, free_samples, equal, hash,
type_id, type_map, type_info, derive_sertype, get_serialized_size, serialize_into."""

_TEST_TOPIC, _TEST_TYPE = "cardan_type_test", "cardan::msg::dds_::TypeTest_"
_TEST_S, _TEST_LOOK_S = 2.0, 0.001


class Sample(NamedTuple):
    """A message that a reader received."""

    data: bytes
    """Message with its encapsulation, perhaps padded."""
    source_ns: int
    """Time of writing, ns since the epoch."""
    writer: int
    """Handle of the writer."""


class _Library:
    """Package cyclonedds, and functions of its C library that the package lacks."""

    def __init__(self) -> None:
        """Raises ExtraMissingError."""
        try:
            from cyclonedds import _clayer, builtin, core, domain, idl, internal, pub, sub, topic
            from cyclonedds.idl import types
        except ImportError as error:
            raise missing_extra("DDS", "cyclonedds", "dds", error) from error
        self.raw, self.builtin, self.core, self.domain = _clayer, builtin, core, domain
        self.idl, self.types, self.pub, self.sub, self.topic = idl, types, pub, sub, topic
        c = ctypes.CDLL(internal.load_cyclonedds()._name)
        entity = ctypes.c_int32
        for name, *arguments in (
            ("dds_waitset_attach", entity, entity, ctypes.c_ssize_t),
            ("dds_waitset_detach", entity, entity),
            ("dds_waitset_wait", entity, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int64),
            ("dds_get_matched_subscriptions", entity, ctypes.c_void_p, ctypes.c_size_t),
            ("dds_get_matched_publications", entity, ctypes.c_void_p, ctypes.c_size_t),
        ):
            getattr(c, name).argtypes = arguments
        self.c = c
        self.domains: dict[int, tuple[str, Any]] = {}
        """Domains configured in this process, with their configuration; deleting a domain deletes
        its participants."""
        self.lock = threading.Lock()
        """Lock for domains, and for making, deleting and discovering endpoints: Cyclone DDS reads
        the user data of an endpoint that another thread makes or deletes from invalid memory."""
        self._table: Any = None
        self._describing: list[int] = []

    def find_table(self, topic: Any) -> None:
        """Find the functions by which the package describes types, from any topic, and make them
        removable. No change if that is impossible."""
        find = getattr(self.c, "dds_get_entity_sertype", None)
        sertype = ctypes.c_void_p()
        if find is None or find(ctypes.c_int32(topic._ref), ctypes.byref(sertype)) != 0:
            return
        address = ctypes.cast(sertype.value or 0, ctypes.POINTER(ctypes.c_void_p))[0] or 0
        table = (ctypes.c_void_p * _TABLE_POINTERS).from_address(address)
        if _make_writable(address, ctypes.sizeof(table)):
            self._table = table
            self._describing = [table[place] or 0 for place in _DESCRIBING]

    def forget_table(self) -> None:
        """Leave the table unchanged from now on."""
        self._table = None

    @contextlib.contextmanager
    def without_types(self) -> Iterator[None]:
        """Publish readers and writers made in this context without a description of their type.
        Topics cannot be made in it.

        This changes the table of all topics, because types that differ by their tables alone are
        mistaken for each other when one of them is freed.
        """
        table = self._table
        if table is None:
            yield
            return
        for place in _DESCRIBING:
            table[place] = None
        try:
            yield
        finally:
            for place, function in zip(_DESCRIBING, self._describing, strict=True):
                table[place] = function


def _make_writable(address: int, size: int) -> bool:
    """Make memory of a library writable that the loader has made read-only."""
    if not sys.platform.startswith("linux"):
        return False
    first = address - address % mmap.PAGESIZE
    result: int = ctypes.CDLL(None).mprotect(
        ctypes.c_void_p(first),
        ctypes.c_size_t(address + size - first),
        mmap.PROT_READ | mmap.PROT_WRITE,
    )
    return result == 0


@cache
def _library() -> _Library:
    return _Library()


@cache
def _one_byte_type(name: str) -> Any:
    """Return Cyclone's type of that name with one byte as content. Bytes after it are ignored."""
    library = _library()
    fields = {"structure_needs_at_least_one_member": library.types.uint8}
    return library.idl.make_idl_struct("Raw", name.replace("::", "."), fields)


@cache
def _whole_type(name: str) -> Any:
    """Return a complete ROS type, for comparison by its description. Raises InterfaceError."""
    ros_type = type_of_dds(name)
    is_part = ros_type.endswith(("_Request", "_Response")) and "/msg/" not in ros_type
    return _struct(ros_type, name, header=is_part)


def _struct(ros_type: str, name: str, header: bool = False) -> Any:
    library = _library()
    types = library.types
    fields: dict[str, Any] = {"guid": types.uint64, "seq": types.int64} if header else {}
    for field in message_type(ros_type).fields:
        fields[field.name] = _field_type(types, field)
    return library.idl.make_idl_struct("Whole", name.replace("::", "."), fields)


def _field_type(types: Any, field: Field) -> Any:
    if field.nested:
        package, kind, last = field.base.split("/")
        base = _struct(field.base, f"{package}::{kind}::dds_::{last}_")
    elif field.base == "string":
        base = types.bounded_str[field.most_characters] if field.most_characters else str
    elif field.base == "bool":
        base = bool
    else:
        base = getattr(types, {"char": "uint8", "byte": "uint8"}.get(field.base, field.base))
    if field.array == "fixed":
        return types.array[base, field.length]
    if field.array == "bounded":
        return types.sequence[base, field.length]
    return types.sequence[base] if field.array else base


class Participant:
    """Participant that makes readers and writers of raw messages. From any thread."""

    def __init__(self, options: DdsOptions) -> None:
        """Raises ExtraMissingError, ConfigurationError and DriverError."""
        self.options = options
        library = self._library = _library()
        core = library.core
        number = options.number
        try:
            with library.lock:
                self._configure(number)
            self._participant = library.domain.DomainParticipant(
                number, qos=core.Qos(core.Policy.Userdata(ENCLAVE))
            )
        except core.DDSException as error:
            raise DriverError(f"domain {number} of DDS cannot be joined: {_words(error)}") from None
        self.guid: bytes = self._participant.guid.bytes
        self._publisher = library.pub.Publisher(self._participant)
        self._subscriber = library.sub.Subscriber(self._participant)
        self._closing = threading.Lock()
        self.typeless = True
        """True if its readers and writers are published without type information."""
        self.typeless = _hides_types(self)

    def _configure(self, number: int) -> None:
        """Configure the domain, once in a process."""
        config, domains = self.options.dds_config, self._library.domains
        if not config and os.environ.get(CONFIG_VARIABLE):
            return
        config = config or LOOPBACK
        if number in domains:
            if domains[number][0] != config:
                raise ConfigurationError(
                    "dds_config", f"domain {number} is configured otherwise in this process already"
                )
            return
        try:
            domains[number] = config, self._library.domain.Domain(number, config)
        except (self._library.core.DDSException, UnicodeEncodeError) as error:
            if not self.options.dds_config:
                raise DriverError(
                    f"domain {number} of DDS cannot be joined: {_words(error)}; there is room for "
                    f"{MOST_PARTICIPANTS} participants of it on this computer: end some, or choose "
                    "another domain"
                ) from None
            raise ConfigurationError(
                "dds_config",
                f"domain {number} cannot be configured by it, or is in use in this process "
                f"already: {_words(error)}",
            ) from None

    def close(self) -> None:
        """Leave DDS, and delete all that was made here. May be called twice."""
        with self._closing:
            participant, self._participant = self._participant, None
        if participant is not None:
            with self._library.lock:
                participant.__del__()

    def _make(self, topic: str, type_name: str, make: Callable[[Any], Any]) -> Any:
        """Return a reader or writer of a topic. Raises DriverError and InterfaceError."""
        participant, library = self._participant, self._library
        if participant is None:
            raise DriverError("DDS is closed")
        data_type = (_one_byte_type if self.typeless else _whole_type)(type_name)
        try:
            with library.lock:
                made = library.topic.Topic(participant, topic, data_type)
                with library.without_types():
                    return make(made)
        except library.core.DDSException as error:
            raise DriverError(f"{topic} on DDS: {_words(error)}") from None

    def hide_types(self, topic: str, type_name: str) -> None:
        """Publish everything made from now on without a description of its type, if that is
        possible; uses a topic made for this."""
        self._make(topic, type_name, self._library.find_table)

    def writer(self, topic: str, type_name: str, qos: Qos, user: bytes = b"") -> Writer:
        """Return a writer; both names are DDS's. Raises DriverError and InterfaceError."""
        policies = self._qos(topic, qos, user, writes=True)
        make = self._library.pub.DataWriter
        entity = self._make(topic, type_name, lambda on: make(self._publisher, on, qos=policies))
        return Writer(self._library, entity)

    def reader(
        self, topic: str, type_name: str, qos: Qos, user: bytes = b"", deaf: bool = False
    ) -> Reader:
        """Return a reader; `deaf`: ignore this participant's own writers. Raises DriverError and
        InterfaceError."""
        policies = self._qos(topic, qos, user, writes=False)
        if deaf:
            policies += self._library.core.Qos(self._library.core.Policy.IgnoreLocal.Participant)
        make = self._library.sub.DataReader
        entity = self._make(topic, type_name, lambda on: make(self._subscriber, on, qos=policies))
        return Reader(self._library, entity)

    def _qos(self, topic: str, qos: Qos, user: bytes, writes: bool) -> Any:
        policy = self._library.core.Policy
        history = policy.History.KeepAll if qos.keep_all else policy.History.KeepLast(qos.depth)
        policies = [
            policy.Reliability.Reliable(BLOCKED_MS * 1_000_000)
            if qos.reliable
            else policy.Reliability.BestEffort,
            history,
            policy.Durability.TransientLocal if qos.transient_local else policy.Durability.Volatile,
            policy.DataRepresentation(
                use_cdrv0_representation=True, use_xcdrv2_representation=False
            ),
            policy.Userdata(user),
        ]
        if writes:
            policies.append(policy.WriterDataLifecycle(autodispose=False))
            if qos.transient_local:
                # It determines the messages for late subscribers in Cyclone.
                policies.append(policy.DurabilityService(0, history, -1, -1, -1))
            if topic == ROSOUT:
                policies.append(policy.Lifespan(ROSOUT_LIFESPAN_S * 1_000_000_000))
        return self._library.core.Qos(*policies)

    def discovery(self) -> Discovery:
        """Return an observer of participants. Raises DriverError."""
        return Discovery(self._library, self._participant)

    def waiter(self) -> Waiter:
        """Return a waiter for readers."""
        return Waiter(self._library, self._participant)


class _Entity:
    """DDS entity, until it is closed."""

    def __init__(self, library: _Library, entity: Any) -> None:
        self._library, self._entity = library, entity
        self.ref: int = entity._ref
        self.guid: bytes = entity.guid.bytes
        """Its 16 bytes."""
        self.handle: int = entity.instance_handle & _HANDLE
        """Its instance handle."""
        self._buffer = (ctypes.c_uint64 * MATCHES)()

    def _matched(self, function: Any) -> list[int]:
        count = function(self.ref, self._buffer, MATCHES)
        return list(self._buffer[: min(max(count, 0), MATCHES)])

    def close(self) -> None:
        """Delete it from DDS; may be called twice."""
        with self._library.lock:
            entity, self._entity = self._entity, None
            if entity is not None:
                # The package deletes an entity with its last reference; here it is deleted now.
                entity.__del__()


class Writer(_Entity):
    """Writer of raw messages."""

    def write(self, cdr: bytes | bytearray) -> bool:
        """Write a message with its encapsulation; return False if DDS did not accept it."""
        result: int = self._library.raw.ddspy_write(self.ref, padded(cdr))
        return result >= 0

    def matched(self) -> list[int]:
        """Return the handles of the matched readers."""
        return self._matched(self._library.c.dds_get_matched_subscriptions)


class Reader(_Entity):
    """Reader of raw messages."""

    def __init__(self, library: _Library, entity: Any) -> None:
        super().__init__(library, entity)
        self._condition = library.core.ReadCondition(entity, _UNREAD)
        self.condition: int = self._condition._ref

    def take(self) -> list[Sample]:
        """Return the available messages, oldest first, TAKEN_AT_ONCE at most. Never blocks."""
        found = self._library.raw.ddspy_take(self.ref, _ANY, TAKEN_AT_ONCE)
        if isinstance(found, int):  # Error: it was closed meanwhile.
            return []
        return [
            Sample(data, info.source_timestamp, info.publication_handle)
            for data, info in found
            if info.valid_data
        ]

    def matched(self) -> list[int]:
        """Return the handles of the matched writers."""
        return self._matched(self._library.c.dds_get_matched_publications)

    def close(self) -> None:
        """Delete it from DDS; may be called twice."""
        condition, self._condition = self._condition, None
        if condition is not None:
            condition.__del__()
        super().close()


class Discovery:
    """Participants and endpoints discovered by DDS, including local ones."""

    def __init__(self, library: _Library, participant: Any) -> None:
        builtin, core = library.builtin, library.core
        self._library = library
        self._policy = core.Policy
        self._sides = [
            (builtin.BuiltinDataReader(participant, topic), writes)
            for topic, writes in (
                (builtin.BuiltinTopicDcpsPublication, True),
                (builtin.BuiltinTopicDcpsSubscription, False),
            )
        ]
        self._participants = builtin.BuiltinDataReader(
            participant, builtin.BuiltinTopicDcpsParticipant
        )
        readers = (*(each for each, _ in self._sides), self._participants)
        self._conditions = [core.ReadCondition(each, _UNREAD) for each in readers]
        self.conditions: list[int] = [each._ref for each in self._conditions]

    def endpoints(self) -> Iterator[Endpoint | bytes]:
        """Yield endpoints that are new or have changed, and the GUIDs of those that are gone."""
        for reader, writes in self._sides:
            with self._library.lock:
                found = reader.take(TAKEN_AT_ONCE)
            for each in found:
                there = each.sample_info.instance_state == _ALIVE and each.qos is not None
                yield self._endpoint(each, writes) if there else each.key.bytes

    def departed(self) -> list[bytes]:
        """Return the GUIDs of the participants that have left."""
        with self._library.lock:
            reported = self._participants.take(TAKEN_AT_ONCE)
        return [each.key.bytes for each in reported if each.sample_info.instance_state != _ALIVE]

    def _endpoint(self, reported: Any, writes: bool) -> Endpoint:
        policy, qos = self._policy, reported.qos
        reliability, user = qos[policy.Reliability], qos[policy.Userdata]
        return Endpoint(
            reported.key.bytes,
            reported.participant_key.bytes,
            writes,
            reported.topic_name,
            reported.type_name,
            reported.sample_info.instance_handle & _HANDLE,
            reliability is not None and reliability != policy.Reliability.BestEffort,
            qos[policy.Durability] not in (None, policy.Durability.Volatile),
            b"" if user is None else bytes(user.data),
            reported.type_id is not None,
        )

    def close(self) -> None:
        """Stop discovery."""
        self._conditions.clear()
        self._sides.clear()


class Waiter:
    """Waits in one thread for data of many readers, without the interpreter."""

    MOST = 256
    """Most readers that one wait reports; the next one reports the others."""

    def __init__(self, library: _Library, participant: Any) -> None:
        self._library = library
        self._waitset = library.core.WaitSet(participant)
        self._guard = library.core.GuardCondition(participant)
        self._found = (ctypes.c_ssize_t * self.MOST)()
        self._closing = threading.Lock()
        self._closed = False
        self.add(self._guard._ref, 0)

    def add(self, condition: int, number: int) -> None:
        """Also wait for a condition; `number` is its number in `wait`'s result, from 1 on."""
        self._library.c.dds_waitset_attach(self._waitset._ref, condition, number)

    def remove(self, condition: int) -> None:
        """Stop waiting for a condition."""
        self._library.c.dds_waitset_detach(self._waitset._ref, condition)

    def wait(self, timeout_s: float) -> Sequence[int]:
        """Return the numbers of the triggered conditions; empty if none was in time."""
        count = self._library.c.dds_waitset_wait(
            self._waitset._ref, self._found, self.MOST, int(max(timeout_s, 0.0) * 1e9)
        )
        found = self._found[: min(max(count, 0), self.MOST)]
        if 0 in found:
            self._guard.set(False)
        return [each for each in found if each]

    def wake(self) -> None:
        """End a wait in another thread; without effect once it is closed."""
        with self._closing:
            if not self._closed:
                self._guard.set(True)

    def close(self) -> None:
        """Close the waiter; idempotent."""
        with self._closing:
            if not self._closed:
                self._closed = True
                self._waitset.__del__()
                self._guard.__del__()


_TESTING = threading.Lock()
_HIDDEN: list[bool] = []
"""True if type information is hidden, once known; it depends on the library only."""


def _hides_types(participant: Participant) -> bool:
    """Return True if local topics are published without type information, by DDS's own report."""
    with _TESTING:
        if not _HIDDEN:
            participant.hide_types(_TEST_TOPIC, _TEST_TYPE)
            _HIDDEN.append(_tested(participant))
            if not _HIDDEN[0]:
                _library().forget_table()
        return _HIDDEN[0]


def _tested(participant: Participant) -> bool:
    reader = participant.reader(_TEST_TOPIC, _TEST_TYPE, Qos())
    discovery = participant.discovery()
    end_s = time.monotonic() + _TEST_S
    try:
        while time.monotonic() < end_s:
            for each in discovery.endpoints():
                if isinstance(each, Endpoint) and each.guid == reader.guid:
                    return not each.described
            time.sleep(_TEST_LOOK_S)
    finally:
        discovery.close()
        reader.close()
    return False


def type_is_usable(participant: Participant, type_name: str) -> str:
    """Return why a DDS type cannot be used here; empty if it can."""
    if participant.typeless:
        return ""
    try:
        _whole_type(type_name)
    except InterfaceError as error:
        return str(error)
    return ""


def _words(error: Exception) -> str:
    return " ".join(str(error).split())[:300]
