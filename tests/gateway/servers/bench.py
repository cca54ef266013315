"""A server in a separate thread, and a plain rosbridge client."""

from __future__ import annotations

import asyncio
import itertools
import json
import threading
from contextlib import contextmanager, suppress

from websockets.sync.client import connect

from cardan.gateway.servers.rosbridge import RosbridgeOptions, RosbridgeServer
from tests.waiting import WITHIN_S

WAIT_S = WITHIN_S
"""Longest wait for an expected message."""


class Running:
    """A running server."""

    def __init__(self, server, loop, ended):
        self.server, self.loop, self.ended = server, loop, ended
        self.port = server.port


def rosbridge(network, **options):
    """A rosbridge server for `network` at a free port."""
    return served(lambda: RosbridgeServer(network, RosbridgeOptions(**{"port": 0, **options})))


@contextmanager
def served(make):
    """Run the server that `make` returns, in the thread of its loop."""
    ready = threading.Event()
    found, failed = [], []

    async def run():
        ended = asyncio.Event()
        async with make() as server:
            found.append(Running(server, asyncio.get_running_loop(), ended))
            ready.set()
            await ended.wait()

    def in_thread():
        try:
            asyncio.run(run())
        except BaseException as error:
            failed.append(error)
        finally:
            ready.set()

    thread = threading.Thread(target=in_thread)
    thread.start()
    assert ready.wait(WAIT_S)
    if not found:
        thread.join()
        raise failed[0]
    (running,) = found
    try:
        yield running
    finally:
        with suppress(RuntimeError):  # the server has already ended
            running.loop.call_soon_threadsafe(running.ended.set)
        thread.join(WAIT_S)
        assert not thread.is_alive()
        if failed:
            raise failed[0]


class PlainClient:
    """Sends operations, and stores other messages while it waits for one."""

    def __init__(self, connection):
        self.connection = connection
        self.ids = itertools.count(1)
        self.heard = []

    def send(self, op, **fields):
        self.connection.send(json.dumps({"op": op, **fields}))

    def receive(self):
        """Next frame: a JSON object, or bytes."""
        if self.heard:
            return self.heard.pop(0)
        return self._next()

    def _next(self):
        frame = self.connection.recv(timeout=WAIT_S)
        return frame if isinstance(frame, bytes) else json.loads(frame)

    def call(self, service, args=None, **fields):
        """Call a service; return the whole response."""
        identity = f"call:{next(self.ids)}"
        given = {} if args is None else {"args": args}
        self.send("call_service", id=identity, service=service, **given, **fields)
        while True:
            frame = self._next()
            answer = isinstance(frame, dict) and frame["op"] == "service_response"
            if answer and frame["id"] == identity:
                return frame
            self.heard.append(frame)

    def subscribe(self, topic="/chatter", kind="std_msgs/msg/String", **fields):
        """Subscribe, and wait until the server has done so."""
        self.send("subscribe", topic=topic, type=kind, **fields)
        self.settle()

    def settle(self):
        """Wait until the server has processed all earlier messages."""
        answer = self.call("/rosapi/get_time")
        assert answer["result"]


@contextmanager
def plain_client(running, path="/", **options):
    """A client that uses no ROS library."""
    with connect(f"ws://127.0.0.1:{running.port}{path}", compression=None, **options) as connection:
        yield PlainClient(connection)
