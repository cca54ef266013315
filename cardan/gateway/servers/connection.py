"""Sender to one client of a server over its WebSocket, as fast as the client reads."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Generic, NamedTuple

from websockets.asyncio.server import ServerConnection, broadcast
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame as WireFrame, Opcode
from websockets.protocol import State

from cardan.gateway.servers.send_queue import Due, Frame, PaceT, SampleT, SendQueue, TopicQueue

FREE_BYTES = 64 * 1024
"""Unread bytes of a client beyond which only the newest message of each topic is kept."""

_log = logging.getLogger(__name__)


class Ready(NamedTuple):
    """A frame, and its encoding without extensions: the same for all clients."""

    frame: Frame
    wire: bytes


def ready(frame: Frame) -> Ready:
    """Return a frame with its encoding."""
    text = isinstance(frame, str)
    data = frame.encode() if isinstance(frame, str) else frame
    opcode = Opcode.TEXT if text else Opcode.BINARY
    return Ready(frame, WireFrame(opcode, data).serialize(mask=False))


def _in_parts(frame: Frame) -> Frame | Iterable[Frame]:
    """Split a large frame into parts: pings are sent between them, and answered in time."""
    if len(frame) <= FREE_BYTES:
        return frame
    return (frame[at : at + FREE_BYTES] for at in range(0, len(frame), FREE_BYTES))


class SendLoop(Generic[PaceT, SampleT]):
    """Send loop to a client; within its ``async with`` waiting frames are sent."""

    def __init__(
        self,
        connection: ServerConnection,
        peer: str,
        max_bytes: int,
        counts: Counter[str],
        encoded: Callable[[TopicQueue[PaceT, SampleT], SampleT], Iterable[Frame]],
    ) -> None:
        """`max_bytes`: of control frames that the client does not read. `encoded`: encodes a
        publication that has waited."""
        self.outbox: SendQueue[PaceT, SampleT] = SendQueue(max_bytes)
        self._connection, self._peer, self._counts, self._encoded = (
            connection,
            peer,
            counts,
            encoded,
        )
        self._loop = asyncio.get_running_loop()
        self._something = asyncio.Event()
        self._calm = asyncio.Event()
        """Set while no frame waits that must not be dropped."""
        self._calm.set()
        self._put: list[bytes] = []
        self._put_bytes = 0
        self._sending = False
        self._closed = False

    async def __aenter__(self) -> SendLoop[PaceT, SampleT]:
        self._writer = self._loop.create_task(self._write())
        return self

    async def __aexit__(self, *_exception: object) -> None:
        self.close()
        self._writer.cancel()
        self._counts["superseded"] += self.outbox.superseded

    def close(self) -> None:
        """Stop sending. Twice is fine."""
        self._closed = True
        self._calm.set()

    @property
    def free(self) -> bool:
        """True if a frame sent now leaves at once."""
        transport = self._connection.transport
        if self._sending or self._closed or transport.is_closing():
            return False
        return self._put_bytes + transport.get_write_buffer_size() <= FREE_BYTES

    def put(self, what: Ready) -> None:
        """Send a frame now; only while it is free. All frames of one turn of the loop are written
        together, which costs one system call instead of one for each topic."""
        if self._connection.protocol.extensions:  # Each client's bytes are its own.
            broadcast([self._connection], what.frame)
            return
        if not self._put:
            self._loop.call_soon(self._flush)
        self._put.append(what.wire)
        self._put_bytes += len(what.wire)

    def _flush(self) -> None:
        if self._put and self._connection.state is State.OPEN and not self._closed:
            self._connection.transport.writelines(self._put)
        self._put.clear()
        self._put_bytes = 0

    def wake(self) -> None:
        """Signal new data in the outbox."""
        self._something.set()

    def send(self, *frames: Frame) -> None:
        """Send a control frame: at once, or before all waiting publications."""
        for frame in frames:
            if self.free and not self.outbox.has_control and len(frame) <= FREE_BYTES:
                self.put(ready(frame))
                continue
            self.outbox.add_control(frame)
            self._calm.clear()
            self.wake()
            if self.outbox.overflowed and not self._closed:
                _log.warning("%s does not read its answers, and is closed", self._peer)
                self._counts["too slow"] += 1
                self.close()
                self._connection.transport.abort()

    async def calm(self) -> None:
        """Wait until the client has read all control frames, or nearly."""
        await self._calm.wait()

    async def _write(self) -> None:
        """Send waiting frames as fast as the client reads."""
        try:
            while True:
                due = self.outbox.take(self._loop.time())
                if due is None or isinstance(due, Due):
                    self._calm.set()
                if due is None:
                    self._something.clear()
                    await self._wait(self.outbox.due_s())
                    continue
                self._flush()
                self._sending = True
                try:
                    for frame in self._frames_of(due):
                        await self._connection.send(_in_parts(frame))
                finally:
                    self._sending = False
        except ConnectionClosed:
            pass

    def _frames_of(self, due: Due[PaceT, SampleT] | Frame) -> Iterable[Frame]:
        return self._encoded(due.stream, due.sample) if isinstance(due, Due) else (due,)

    async def _wait(self, due_s: float | None) -> None:
        if due_s is None:
            await self._something.wait()
            return
        timer = self._loop.call_at(due_s, self._something.set)
        try:
            await self._something.wait()
        finally:
            timer.cancel()
