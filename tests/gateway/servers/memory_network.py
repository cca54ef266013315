"""A network within one process: replaces the network behind rosbridge in tests."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from cardan.bus.network import Failure, NetworkError, ServiceInfo, Topic
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.interfaces import name_on_the_wire, service_type
from cardan.protocols.ros2.messages import completed

TEST_NODE, SERVER = "/arm", "/rosbridge"


class _Handle:
    def __init__(self, close: Callable[[], None]) -> None:
        self._close = close
        self.closed = False

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            self._close()


class _Publisher(_Handle):
    def __init__(self, close: Callable[[], None], publish: Callable[[bytes], None]) -> None:
        super().__init__(close)
        self._publish = publish

    def publish(self, cdr: bytes, sent_ns: int = 0) -> None:
        assert not self.closed
        self._publish(cdr)


class MemoryNetwork:
    """Calls callbacks at once in the publishing thread, which need not be the server's."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.known: dict[str, str] = {}
        """Types of the topics of the test's node."""
        self.latched: dict[str, bytes] = {}
        self.subscriptions: list[tuple[str, str | None, Any]] = []
        self.publishers: list[tuple[str, str, bool]] = []
        self.servers: dict[str, tuple[str, str, Any]] = {}
        self.published: list[tuple[str, dict]] = []
        """Messages published by the server, decoded."""
        self.called: list[str] = []
        self.refuses = ""

    # -- Network ---------------------------------------------------------------------------------

    def part(self, _name):
        return self

    def close(self):
        pass

    def topics(self):
        with self.lock:
            found = {
                name: Topic(name_on_the_wire(kind), (TEST_NODE,), (), name in self.latched)
                for name, kind in self.known.items()
            }
            for topic, kind, _ in self.publishers:
                found.setdefault(topic, Topic(kind, (SERVER,)))
            for topic, kind, _ in self.subscriptions:
                if topic in found:
                    found[topic] = found[topic]._replace(subscribers=(SERVER,))
                elif kind:
                    found[topic] = Topic(kind, (), (SERVER,))
            return found

    def services(self):
        with self.lock:
            return {
                name: ServiceInfo(kind, (node,)) for name, (kind, node, _) in self.servers.items()
            }

    def nodes(self):
        return [TEST_NODE, SERVER]

    def subscribe(self, topic, type_name, heard):
        if self.refuses:
            raise NetworkError(self.refuses)
        entry = (topic, type_name, heard)
        with self.lock:
            self.subscriptions.append(entry)
        if topic in self.latched:
            heard(self.latched[topic], time.time_ns())
        return _Handle(lambda: self.subscriptions.remove(entry))

    def advertise(self, topic, type_name, latched):
        entry = (topic, type_name, latched)
        with self.lock:
            self.publishers.append(entry)

        def publish(cdr: bytes) -> None:
            self.published.append((topic, codec_of(type_name).decode(cdr)))
            self.send(topic, cdr)

        return _Publisher(lambda: self.publishers.remove(entry), publish)

    def call(self, service, type_name, request, answered, timeout_s):
        self.called.append(service)
        kind, _node, asked = self.servers[service]
        assert kind == type_name
        asked(request, answered)

    def serve(self, service, type_name, asked, node=SERVER):
        with self.lock:
            self.servers[service] = (type_name, node, asked)
        return _Handle(lambda: self.servers.pop(service))

    # -- actions of a test -----------------------------------------------------------------------

    def publish(self, topic: str, type_name: str, stamp_ns: int = 1_500_000_000, **fields) -> None:
        """Publish from another node."""
        self.known[topic] = type_name
        data = codec_of(type_name).encode(completed(type_name, fields))
        self.send(topic, data, stamp_ns)

    def latch(self, topic: str, type_name: str, **fields) -> None:
        """Publish, also for later subscriptions."""
        self.latched[topic] = codec_of(type_name).encode(completed(type_name, fields))
        self.publish(topic, type_name, **fields)

    def send(self, topic: str, cdr: bytes, stamp_ns: int = 1_500_000_000) -> None:
        with self.lock:
            heard = [each for name, _, each in self.subscriptions if name == topic]
        for each in heard:
            each(cdr, stamp_ns)

    def offer(self, service: str, type_name: str, answer: Callable[[dict], Any]) -> None:
        """Offer a service of another node. `answer` returns the response's fields, a Failure, or
        None for no response."""
        kind = service_type(type_name)

        def asked(request: bytes, answered: Any) -> None:
            response = answer(codec_of(kind.request).decode(request))
            if isinstance(response, Failure):
                answered(response)
            elif response is not None:
                answered(codec_of(kind.response).encode(completed(kind.response, response)))

        self.serve(service, type_name, asked, TEST_NODE)

    def ask(self, service: str, **fields) -> Any:
        """Call a service and wait: the response, or a Failure."""
        kind = service_type(self.servers[service][0])
        there = threading.Event()
        found = []

        def answered(reply: Any) -> None:
            found.append(reply)
            there.set()

        request = codec_of(kind.request).encode(completed(kind.request, fields))
        self.call(service, kind.name, request, answered, None)
        assert there.wait(10)
        return (
            found[0] if isinstance(found[0], Failure) else codec_of(kind.response).decode(found[0])
        )
