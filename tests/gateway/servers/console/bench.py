"""A console server with a small site, and a program in place of a page."""

from __future__ import annotations

import json
import time
from contextlib import contextmanager

from websockets.sync.client import connect

from cardan.gateway.arm.requests import decode_request, encode_error, encode_reply
from cardan.gateway.servers.console.server import ConsoleOptions, ConsoleServer
from cardan.gateway.servers.console.site import Site
from cardan.protocols.handheld.frames import JogTwist, OperatorFrame, encode_frame
from cardan.types import Vector3
from tests.gateway.servers.bench import WAIT_S, served

ARM, ASK = "/arm", "cardan_msgs/srv/Ask"
VIEWER, OPERATOR = "viewers-0123456789", "operators-0123456789"


def token_file(folder):
    """Path of a file with these two tokens."""
    tokens = folder / "tokens"
    tokens.write_text(f"viewer {VIEWER}\noperator {OPERATOR}\n")
    tokens.chmod(0o600)
    return str(tokens)


def small_site(folder):
    """A site with one page."""
    folder.mkdir(exist_ok=True)
    for suffix in ("", ".br", ".gz"):
        (folder / f"index.html{suffix}").write_bytes(f"<p>page{suffix}</p>".encode())
    about = {"type": "text/html; charset=utf-8", "sha256": "0" * 64}
    manifest = {"sources": "0", "files": {"index.html": about}}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return Site(folder)


@contextmanager
def console(network, folder, **options):
    """A console server at a free port."""
    site = small_site(folder / "page")
    made = ConsoleOptions(**{"port": 0, **options})
    with served(lambda: ConsoleServer(network, made, site)) as running:
        yield running


class FakeArm:
    """Replies to `ask` requests on a memory network, and stores them."""

    def __init__(self, network, name=ARM):
        self.requests = []
        self.refuses = ""
        self.error = None
        network.offer(f"{name}/ask", ASK, self._answer)

    def _answer(self, message):
        request = decode_request(message["request"].encode())
        self.requests.append(request)
        if self.error is not None:
            return {"reply": encode_error(request.id, self.error).decode()}
        moves = request.verb in ("twist", "joints") and _moves(request.value)
        return {"reply": encode_reply(request.id, self.refuses if moves else "").decode()}

    def verbs(self):
        return [each.verb for each in self.requests]


def _moves(value):
    return any((*value[0], *value[1])) if hasattr(value, "linear") else any(value)


class PageProgram:
    """A page at protocol level, with this program's clock."""

    def __init__(self, connection):
        self.connection = connection
        self.sequence = 0
        self.tells_time = True
        self.heard = []

    def ask(self, op, **fields):
        self.connection.send(json.dumps({"op": op, **fields}))

    def next(self, op, **wanted):
        """Next message of this kind with these fields; replies to pings meanwhile."""
        end_s = time.monotonic() + WAIT_S
        while True:
            frame = json.loads(self.connection.recv(timeout=max(0.0, end_s - time.monotonic())))
            if frame["op"] == "cardan.ping" and self.tells_time:
                page_us = int(time.monotonic() * 1e6)
                self.ask("cardan.pong", server_us=frame["server_us"], page_us=page_us)
            if frame["op"] == op and all(frame.get(key) == value for key, value in wanted.items()):
                return frame
            self.heard.append(frame)

    def begin(self):
        """Send hello, and wait until the server has synchronized the clocks."""
        self.ask("cardan.hello", id=1)
        hello = self.next("cardan.hello")
        self.next_clock()
        return hello

    def next_clock(self):
        # The server's first ping may have arrived already: the next one ensures the
        # synchronization.
        if not any(each["op"] == "cardan.ping" for each in self.heard):
            self.next("cardan.ping")
        self.ask("cardan.ping", id="settle")
        self.next("cardan.pong", id="settle")

    def open(self, channel, **target):
        self.ask("cardan.open", channel=channel, **target)
        return self.next("cardan.opened")

    def frame(self, body, hold=True, *, channel=1, late_s=0.0, **more):
        self.sequence += 1
        time_us = int((time.monotonic() - late_s) * 1e6)
        sequence = more.pop("sequence", self.sequence)
        made = OperatorFrame(
            body, hold, channel=channel, sequence=sequence, time_us=time_us, **more
        )
        self.connection.send(encode_frame(made))

    def jog(self, hold=True, x=0.1, **more):
        self.frame(JogTwist(Vector3(x, 0.0, 0.0), Vector3(0.0, 0.0, 0.0)), hold, **more)

    def settle(self):
        """Wait until the server has processed all earlier messages."""
        self.ask("cardan.ping", id="settled")
        self.next("cardan.pong", id="settled")

    def press(self):
        """Release the arm, wait until the server reports that, and hold it."""
        self.jog(False)
        self.grip("free")
        self.jog()

    def refused(self, op, **fields):
        """Reason why the server refuses this message."""
        self.ask(op, id="refused", **fields)
        return self.next("cardan.refused", id="refused")["why"]

    def grip(self, wanted):
        """Wait until the server reports this state of the hold; return the message."""
        return self.next("cardan.input", grip=wanted)


@contextmanager
def page_program(running, path="/ws", **options):
    """A page connected to the server."""
    with connect(f"ws://127.0.0.1:{running.port}{path}", compression=None, **options) as connection:
        yield PageProgram(connection)
