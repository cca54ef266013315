"""Topics of a ROS 2 arm on the bus, for `cardan.conform.live`."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator

from cardan.bus.node import BusNode, Publisher, WaitingSubscription
from cardan.bus.options import BusOptions
from cardan.conform.ros2_arm.names import COMMANDS, DESCRIPTION, TOPICS
from cardan.conform.wires import Wire, Wires
from cardan.protocols.ros2.zenoh import DEFAULT_QOS, LATCHED_QOS

NODE = "cardan_conform"
DEPTH = 1000
LOOK_S = 0.1


class _Commands(Wire):
    """A publisher."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self._ours, self._theirs = socket.socketpair()

    def fileno(self) -> int:
        return self._ours.fileno()

    def read(self) -> Iterator[tuple[bytes, str]]:
        return iter(())

    def write(self, data: bytes) -> None:
        self._publisher.put(data, time.time_ns())

    def close(self) -> None:
        self._publisher.close()
        self._ours.close()
        self._theirs.close()


class _Topic(Wire):
    """A subscription; a thread waits for it, and wakes `select` up."""

    def __init__(self, subscription: WaitingSubscription) -> None:
        self._subscription = subscription
        self._ours, self._theirs = socket.socketpair()
        self._ours.setblocking(False)
        self._waiting: list[tuple[bytes, str]] = []
        self._lock = threading.Lock()
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
            with self._lock:
                self._waiting.append((received.data, note))
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
        """Nothing is sent here."""

    def close(self) -> None:
        self._open = False
        self._thread.join()
        self._subscription.close()
        self._ours.close()
        self._theirs.close()


class ArmOnTheBus(Wires):
    """The arm's topics, by way of a router."""

    def __init__(self, router: str) -> None:
        self._router = router
        self._node: BusNode | None = None

    def open(self, channel: str) -> Wire:
        if self._node is None:
            self._node = BusNode(BusOptions(router=self._router), NODE)
            self._node.open()
        topic, type_name = TOPICS[channel]
        if channel == COMMANDS:
            return _Commands(self._node.publisher(topic, type_name))
        qos = LATCHED_QOS if channel == DESCRIPTION else DEFAULT_QOS
        return _Topic(self._node.waiting_subscription(topic, type_name, DEPTH, qos))

    def close(self) -> None:
        if self._node is not None:
            self._node.close()
            self._node = None
