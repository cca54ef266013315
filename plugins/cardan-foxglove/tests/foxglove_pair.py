"""A Foxglove server in a thread, and a client written from the protocol's text."""

from __future__ import annotations

import json
import struct
import time
from contextlib import contextmanager, suppress
from types import SimpleNamespace

from websockets.sync.client import connect

from cardan_foxglove.server import FoxgloveOptions, FoxgloveServer
from tests.gateway.servers.bench import WAIT_S, served


def foxglove_server(network, **options):
    """Run a Foxglove server of `network` at a free port."""
    return served(lambda: FoxgloveServer(network, FoxgloveOptions(**{"port": 0, **options})))


class FoxgloveClient:
    """Client written from the protocol's text, with its own ids, JSON and opcodes.

    `channels` and `services` have the server's advertisements by name.
    """

    def __init__(self, connection):
        self.connection = connection
        self.channels, self.services, self.heard = {}, {}, []
        self.numbers = iter(range(100, 1_000_000))
        self.info = self.until(op="serverInfo")

    # -- frames ----------------------------------------------------------------------------------

    def send(self, op, **fields):
        self.connection.send(json.dumps({"op": op, **fields}))

    def _next(self, timeout_s=WAIT_S):
        frame = self.connection.recv(timeout=max(timeout_s, 0.0))
        if isinstance(frame, str):
            said = json.loads(frame)
            op = said["op"]
            if op == "advertise":
                self.channels.update({each["topic"]: each for each in said["channels"]})
            elif op == "unadvertise":
                gone = set(said["channelIds"])
                self.channels = {k: v for k, v in self.channels.items() if v["id"] not in gone}
            elif op == "advertiseServices":
                self.services.update({each["name"]: each for each in said["services"]})
            elif op == "unadvertiseServices":
                gone = set(said["serviceIds"])
                self.services = {k: v for k, v in self.services.items() if v["id"] not in gone}
            return said
        if frame[0] == 1:
            number, stamp_ns = struct.unpack_from("<IQ", frame, 1)
            return {"op": "message", "subscription": number, "time": stamp_ns, "data": frame[13:]}
        if frame[0] == 2:
            return {"op": "time", "time": struct.unpack_from("<Q", frame, 1)[0]}
        if frame[0] == 3:
            _service, call, length = struct.unpack_from("<III", frame, 1)
            encoding = frame[13 : 13 + length].decode()
            data = frame[13 + length :]
            return {"op": "response", "callId": call, "encoding": encoding, "data": data}
        assert frame[0] == 4, frame
        request, status, length = struct.unpack_from("<IBI", frame, 1)
        error = frame[10 : 10 + length].decode()
        return {
            "op": "asset",
            "request": request,
            "error": error if status else None,
            "data": frame[10 + length :],
        }

    def until(self, true=lambda said: True, **fields):
        """Return the next frame with these fields, within WAIT_S; others are kept in `heard`."""
        for index, said in enumerate(self.heard):
            if fields.items() <= said.items() and true(said):
                return self.heard.pop(index)
        end_s = time.monotonic() + WAIT_S
        while True:
            said = self._next(end_s - time.monotonic())
            if fields.items() <= said.items() and true(said):
                return said
            self.heard.append(said)

    def drained(self, timeout_s=0.0):
        """Return all received frames after waiting at most this long for the first one."""
        with suppress(TimeoutError):
            if not self.heard:
                self.heard.append(self._next(timeout_s))
            while True:
                self.heard.append(self._next(0.0))
        found, self.heard = self.heard, []
        return found

    def channel(self, topic):
        """Return the server's advertisement of a topic as soon as it arrives."""
        self._keep_until(lambda: topic in self.channels)
        return self.channels[topic]

    def service(self, name):
        self._keep_until(lambda: name in self.services)
        return self.services[name]

    def _keep_until(self, true):
        """Collect frames in `heard` until the condition holds; at most for WAIT_S."""
        end_s = time.monotonic() + WAIT_S
        while not true():
            self.heard.append(self._next(end_s - time.monotonic()))

    def settle(self):
        """Return after the server has processed everything sent before."""
        number = 4_000_000_000 + next(self.numbers)
        self.send("subscribe", subscriptions=[{"id": number, "channelId": number}])
        self.status(f"Unknown channel ID: {number}")
        self.unsubscribe(number)
        identity = f"settle {number}"
        self.send("getParameters", parameterNames=["/nobody.x"], id=identity)
        self.until(op="parameterValues", id=identity)

    # -- requests of a client --------------------------------------------------------------------

    def subscribe(self, topic):
        number = next(self.numbers)
        channel = self.channel(topic)["id"]
        self.send("subscribe", subscriptions=[{"id": number, "channelId": channel}])
        return number

    def unsubscribe(self, *numbers):
        self.send("unsubscribe", subscriptionIds=list(numbers))

    def message(self, number):
        return self.until(op="message", subscription=number)

    def advertise(self, topic, kind, encoding="cdr"):
        number = next(self.numbers)
        channel = {"id": number, "topic": topic, "encoding": encoding, "schemaName": kind}
        self.send("advertise", channels=[channel])
        return number

    def publish(self, number, data):
        self.connection.send(b"\x01" + struct.pack("<I", number) + data)

    def call(self, name, data, encoding=b"cdr"):
        """Return the answer or the failure."""
        number = next(self.numbers)
        header = struct.pack("<III", self.service(name)["id"], number, len(encoding))
        self.connection.send(b"\x02" + header + encoding + data)
        return self.until(
            lambda said: said["op"] in ("response", "serviceCallFailure"), callId=number
        )

    def get(self, *names):
        identity = f"get {next(self.numbers)}"
        self.send("getParameters", parameterNames=list(names), id=identity)
        return self.until(op="parameterValues", id=identity)["parameters"]

    def set(self, **parameter):
        identity = f"set {next(self.numbers)}"
        self.send("setParameters", parameters=[parameter], id=identity)
        return self.until(op="parameterValues", id=identity)["parameters"]

    def asset(self, uri):
        number = next(self.numbers)
        self.send("fetchAsset", uri=uri, requestId=number)
        return SimpleNamespace(**self.until(op="asset", request=number))

    def status(self, words):
        """Return the next status whose message contains these words."""
        return self.until(lambda said: words in said["message"], op="status")


@contextmanager
def foxglove_client(running, path="/", subprotocol="foxglove.sdk.v1", **options):
    with connect(
        f"ws://127.0.0.1:{running.port}{path}",
        subprotocols=[subprotocol],
        compression=None,
        max_size=None,
        **options,
    ) as connection:
        yield FoxgloveClient(connection)
