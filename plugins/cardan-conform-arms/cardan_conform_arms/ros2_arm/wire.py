"""Topics and services of a ROS 2 arm on the bus, for `cardan.conform.live`."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator, Mapping

from cardan.bus.node import BusNode, Client, Publisher, WaitingSubscription
from cardan.bus.options import BusOptions
from cardan.conform.transports import TargetWire, Wires
from cardan.protocols.ros2.zenoh import DEFAULT_QOS, LATCHED_QOS
from cardan_conform_arms.ros2_arm.names import Channel

NODE = "cardan_conform"
DEPTH = 1000
LOOK_S = 0.1
CALL_S = 60.0
"""Longest wait for a response: a goal's result arrives after its end."""


class _Waking(TargetWire):
    """Queue that other threads fill with `_put`; it wakes `select` up."""

    def __init__(self) -> None:
        self._ours, self._theirs = socket.socketpair()
        self._ours.setblocking(False)
        self._waiting: list[tuple[bytes, str]] = []
        self._lock = threading.Lock()

    def _put(self, data: bytes, note: str) -> None:
        with self._lock:
            self._waiting.append((data, note))
        with contextlib.suppress(OSError):
            self._theirs.send(b"x")

    def fileno(self) -> int:
        return self._ours.fileno()

    def read(self) -> Iterator[tuple[bytes, str]]:
        with contextlib.suppress(OSError):
            self._ours.recv(65536)
        with self._lock:
            found, self._waiting = self._waiting, []
        return iter(found)

    def write(self, data: bytes) -> None:
        """Send nothing, unless a subclass does."""

    def close(self) -> None:
        self._ours.close()
        self._theirs.close()


class _Commands(_Waking):
    """Publisher of commands."""

    def __init__(self, publisher: Publisher) -> None:
        super().__init__()
        self._publisher = publisher

    def write(self, data: bytes) -> None:
        self._publisher.put(data, time.time_ns())

    def close(self) -> None:
        self._publisher.close()
        super().close()


class _Calls(_Waking):
    """Client of a service. A response's note is the number of its request, from 1."""

    def __init__(self, client: Client) -> None:
        super().__init__()
        self._client = client
        self._asked = 0

    def write(self, data: bytes) -> None:
        self._asked += 1
        number = str(self._asked)
        self._client.ask(data, lambda response: self._put(response, number), CALL_S)

    def close(self) -> None:
        self._client.close()
        super().close()


class _Topic(_Waking):
    """Subscription that a thread waits for."""

    def __init__(self, subscription: WaitingSubscription) -> None:
        super().__init__()
        self._subscription = subscription
        self._open = True
        self._thread = threading.Thread(target=self._wait, name="cardan-conform-topic")
        self._thread.start()

    def _wait(self) -> None:
        while self._open:
            received = self._subscription.wait(LOOK_S)
            if received is None:
                continue
            note = ""
            if received.attachment is not None:
                note = f"{received.attachment.gid.hex()}:{received.attachment.sequence}"
            self._put(received.data, note)

    def close(self) -> None:
        self._open = False
        self._thread.join()
        self._subscription.close()
        super().close()


class RosWires(Wires):
    """Topics and services through a router."""

    def __init__(self, router: str, channels: Mapping[str, Channel]) -> None:
        self._router, self._channels = router, channels
        self._node: BusNode | None = None

    def open(self, channel: str) -> TargetWire:
        if self._node is None:
            self._node = BusNode(BusOptions(router=self._router), NODE)
            self._node.open()
        name, type_name, way = self._channels[channel]
        if way == "sent":
            return _Commands(self._node.publisher(name, type_name))
        if way == "called":
            return _Calls(self._node.client(name, type_name))
        qos = LATCHED_QOS if way == "latched" else DEFAULT_QOS
        return _Topic(self._node.waiting_subscription(name, type_name, DEPTH, qos))

    def close(self) -> None:
        if self._node is not None:
            self._node.close()
            self._node = None
