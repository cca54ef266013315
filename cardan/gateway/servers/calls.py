"""Service calls on the network behind a server, for an asyncio loop."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from cardan.bus.network import Failure, Network
from cardan.protocols.ros2.cdr import MalformedCdr, Message, codec_of
from cardan.protocols.ros2.interfaces import service_type


class CallError(Exception):
    """Error: a service gave no answer; the text says why."""


class Mailbox:
    """Runs calls from other threads in an asyncio loop, in order, many at a time."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._lock = threading.Lock()
        self._calls: deque[Callable[[], None]] = deque()
        self._closed = False

    def put(self, call: Callable[[], None]) -> None:
        """Schedule `call`. From any thread; no effect after `close`."""
        with self._lock:
            if self._closed:
                return
            self._calls.append(call)
            if len(self._calls) == 1:
                self._loop.call_soon_threadsafe(self._run)

    def close(self) -> None:
        """Accept no further calls. Must be called before the loop ends."""
        with self._lock:
            self._closed = True

    def _run(self) -> None:
        with self._lock:
            calls, self._calls = self._calls, deque()
        for call in calls:
            call()


class ServiceCaller:
    """Calls services from the thread of the loop."""

    def __init__(self, network: Network, mailbox: Mailbox) -> None:
        self._network, self._mailbox = network, mailbox

    def start(
        self, service: str, type_name: str, request: Mapping[str, Any], timeout_s: float | None
    ) -> asyncio.Future[Message]:
        """Send a complete request of the type; the future gets the response, or a CallError. Raises
        NetworkError, CdrError and InterfaceError."""
        kind = service_type(type_name)
        data = codec_of(kind.request).encode(request)
        future: asyncio.Future[Message] = asyncio.get_running_loop().create_future()

        def answered(reply: bytes | Failure) -> None:
            self._mailbox.put(lambda: _settle(future, service, kind.response, reply))

        self._network.call(service, type_name, data, answered, timeout_s)
        return future


def _settle(
    future: asyncio.Future[Message], service: str, response: str, reply: bytes | Failure
) -> None:
    if future.done():
        return
    if isinstance(reply, Failure):
        future.set_exception(CallError(reply.reason))
        return
    decoded = codec_of(response).decode(reply)
    if isinstance(decoded, MalformedCdr):
        future.set_exception(CallError(f"{service}: its reply is malformed: {decoded.reason}"))
    else:
        future.set_result(decoded)
