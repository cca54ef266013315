"""Subscriptions of the clients of a rosbridge server: each message is encoded once for all clients
that want it in the same form."""

from __future__ import annotations

import logging
import time
from collections import Counter, deque

from cardan.bus.network import Network
from cardan.gateway.servers.calls import Mailbox
from cardan.gateway.servers.connection import SendLoop, ready
from cardan.gateway.servers.send_queue import TopicQueue
from cardan.gateway.servers.subscriptions import SharedSubscriptions, TopicSubscription
from cardan.protocols.ros2.interfaces import InterfaceError
from cardan.protocols.rosbridge.delivery import Delivery
from cardan.protocols.rosbridge.forms import EncodedMessage, UnreadableError

DEPTH = 100
"""Most messages of a topic that wait for this process; beyond, the oldest are lost."""

_log = logging.getLogger(__name__)


ClientStream = TopicQueue[Delivery, EncodedMessage]
Receiver = SendLoop[Delivery, EncodedMessage]


class RosbridgeSubscription(TopicSubscription[ClientStream, Receiver]):
    """A topic for clients of rosbridge, each message encoded once for all of them."""

    def __init__(
        self,
        network: Network,
        mailbox: Mailbox,
        counts: Counter[str],
        topic: str,
        type_name: str | None,
    ) -> None:
        super().__init__(network, topic, type_name)
        self._mailbox, self._counts = mailbox, counts
        self._heard: deque[EncodedMessage] = deque(maxlen=DEPTH)
        self._woken = False
        self._unreadable = False
        self._late = 0
        """Count of messages that newer ones replaced before their turn."""

    def close(self) -> None:
        """Leave the network."""
        super().close()
        self._counts["superseded"] += self._late
        self._late = 0

    def encoded(self, sample: EncodedMessage, stream: ClientStream) -> tuple[str | bytes, ...]:
        """Return the frames of a message for a stream; none, and counted, if it is malformed."""
        delivery = stream.delivery
        try:
            return sample.frames(stream.topic, delivery.compression, delivery.fragment_size)
        except (UnreadableError, InterfaceError) as error:
            self._counts["unreadable"] += 1
            if not self._unreadable:
                self._unreadable = True
                _log.warning("%s: its messages cannot be decoded: %s", self.topic, error)
            return ()

    def _hear(self, cdr: bytes, stamp_ns: int) -> None:
        """Handle a message. In any thread."""
        self._late += len(self._heard) == DEPTH
        self._heard.append(EncodedMessage(self.type, cdr, stamp_ns))
        if not self._woken:
            self._woken = True
            self._mailbox.put(self._deliver)

    def _deliver(self) -> None:
        self._woken = False
        now_s = time.monotonic()
        while self._heard:
            self._deliver_one(self._heard.popleft(), now_s)

    def _deliver_one(self, sample: EncodedMessage, now_s: float) -> None:
        at_once: dict[tuple[str, str, int], tuple[ClientStream, list[Receiver]]] = {}
        for stream, receiver in self.receivers.items():
            if receiver.outbox.offer(stream, sample, now_s, receiver.free):
                delivery = stream.delivery
                key = (stream.topic, delivery.compression, delivery.fragment_size)
                at_once.setdefault(key, (stream, []))[1].append(receiver)
            else:
                receiver.wake()
        for stream, receivers in at_once.values():
            for frame in self.encoded(sample, stream):
                what = ready(frame)
                for receiver in receivers:
                    receiver.put(what)


RosbridgeSubscriptions = SharedSubscriptions[RosbridgeSubscription]


def shared_subscriptions(
    network: Network, mailbox: Mailbox, counts: Counter[str]
) -> RosbridgeSubscriptions:
    """Return the subscriptions of a server."""
    return SharedSubscriptions(
        lambda topic, type_name: RosbridgeSubscription(network, mailbox, counts, topic, type_name)
    )
