"""Makes the table of floods in docs/faults.md: how long after a client's last byte a server still
passes on what the client published.

Real sockets; the server and the client are processes of their own. To write it anew, in more than
six minutes: ``make flood-table``, or ``python -m tests.flood_table``.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from websockets.frames import Frame, Opcode
from websockets.sync.client import ClientConnection, connect

from cardan.protocols.foxglove import SUBPROTOCOLS
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import default_message
from tests.docs_tables import markdown, replaced
from tests.fault_table import PAGE
from tests.gateway.faces.console.rig import console
from tests.gateway.faces.foxglove_rig import foxglove_face
from tests.gateway.faces.memory_network import MemoryNetwork
from tests.gateway.faces.rig import rosbridge
from tests.protocols.test_handheld import TELEOP

BEGIN = "<!-- made by tests/flood_table.py -->\n"
TOPIC, TWIST = "/cmd", "geometry_msgs/msg/Twist"

LATE_S = 0.3
"""Longest time for which a server may pass on what is there when the client ends: with
`stream_timeout` after it the arm is at rest."""

FLOOD_S = 2.0
"""Longer than a backlog is tolerated for."""
STOPPED_S = 1.0
PORTION_S = 0.005
SETTLED_S = 1.5
"""How long the server is watched after the client's last byte."""
COUNTED = 2000
"""Messages by which it is measured how many are handled in a second."""
SEND_S = 0.02
"""Longest time that a client of a flood is held up by a full socket before it looks at its clock:
its last byte has to be handed over when its time is up."""

RATES = (0.5, 2.0, 10.0)
"""Times what can be handled."""


class Server(NamedTuple):
    """A server, and how it is flooded."""

    make: Callable[[MemoryNetwork, Path], contextlib.AbstractContextManager]
    path: str
    begin: tuple[str, ...]
    """What a client sends first."""
    message: bytes
    """One message, as it is on the wire."""
    foxglove: bool = False


def _text(text: str) -> bytes:
    return Frame(Opcode.TEXT, text.encode()).serialize(mask=True)


_ADVERTISE = json.dumps({"op": "advertise", "topic": TOPIC, "type": TWIST})
_PUBLISH = json.dumps({"op": "publish", "topic": TOPIC, "msg": {"linear": {"x": 0.1}}})
_PARTS = [
    {"op": "fragment", "id": "1", "num": number, "total": 2, "data": part}
    for number, part in enumerate((_PUBLISH[:30], _PUBLISH[30:]))
]
_CHANNEL = {"id": 1, "topic": TOPIC, "encoding": "cdr", "schemaName": TWIST}
_CDR = codec_of(TWIST).encode(default_message(TWIST))

SERVERS = {
    "rosbridge, JSON": Server(
        lambda network, _folder: rosbridge(network), "/", (_ADVERTISE,), _text(_PUBLISH)
    ),
    "rosbridge, fragments": Server(
        lambda network, _folder: rosbridge(network),
        "/",
        (_ADVERTISE,),
        b"".join(_text(json.dumps(part)) for part in _PARTS),
    ),
    "Foxglove": Server(
        lambda network, _folder: foxglove_face(network),
        "/",
        (json.dumps({"op": "advertise", "channels": [_CHANNEL]}),),
        Frame(Opcode.BINARY, b"\x01" + struct.pack("<I", 1) + _CDR).serialize(mask=True),
        foxglove=True,
    ),
    "page, teleop": Server(console, "/ws", (), _text(json.dumps(TELEOP))),
}

ENDS = ("silence", "close", "abort", "client stopped for 1 s", "server stopped for 1 s")


class Row(NamedTuple):
    """What one flood did."""

    server: str
    rate: float
    end: str
    late_s: float
    """How long after the client's last byte the server still passed something on; 0: it did not."""
    passed: int
    ended_by_server: bool


# -- processes -----------------------------------------------------------------------------------


def serve(name: str) -> None:
    """A server, until the end of standard input; each line there is answered with the number of
    messages that it passed on, and when the newest one was (monotonic, s)."""
    network = MemoryNetwork()
    newest_s = [0.0]
    passed = [0]

    def send(*_given: object) -> None:
        newest_s[0] = time.monotonic()
        passed[0] += 1

    network.send = send  # type: ignore[method-assign]
    with (
        tempfile.TemporaryDirectory() as folder,
        SERVERS[name].make(network, Path(folder)) as running,
    ):
        print(running.port, flush=True)
        for _ in sys.stdin:
            print(passed[0], newest_s[0], flush=True)


def send(name: str, port: int, per_s: float, seconds: float, end: str) -> None:
    """A client that floods; prints when it began, and then when it handed over its last byte and
    whether the server had ended the connection."""
    server = SERVERS[name]
    with client(server, port) as connection:
        for each in server.begin:
            connection.send(each)
        time.sleep(0.3)
        raw: socket.socket = connection.socket
        waiting = b""
        began_s = ended_s = time.monotonic()
        print(began_s, flush=True)
        raw.settimeout(SEND_S)
        handed, cut = 0, False
        try:
            while time.monotonic() - began_s < seconds:
                due = per_s * (time.monotonic() - began_s) - handed
                if not waiting and due >= 1:
                    count = int(min(due, 1000))
                    waiting, handed = count * server.message, handed + count
                if waiting:
                    with contextlib.suppress(TimeoutError):
                        waiting = waiting[raw.send(waiting) :]
                        ended_s = time.monotonic()
                else:
                    time.sleep(PORTION_S)
        except OSError:
            cut = True
        print(ended_s, int(cut), flush=True)
        if end == "abort" and not cut:
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        if end in ("abort", "close"):
            raw.close()
            os._exit(0)
        sys.stdin.read()
        os._exit(0)


def client(server: Server, port: int) -> ClientConnection:
    """A connection to a server."""
    kinds = [SUBPROTOCOLS[0]] if server.foxglove else None
    return connect(f"ws://127.0.0.1:{port}{server.path}", compression=None, subprotocols=kinds)


@contextlib.contextmanager
def process(*given: object) -> Iterator[subprocess.Popen[str]]:
    """This program with other arguments, ended at the end."""
    with subprocess.Popen(
        [sys.executable, "-m", "tests.flood_table", *map(str, given)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[1],
    ) as started:
        try:
            yield started
        finally:
            started.send_signal(signal.SIGCONT)
            started.kill()


def line(of: subprocess.Popen[str]) -> list[float]:
    """The numbers of a process's next line."""
    assert of.stdout is not None
    return [float(each) for each in of.stdout.readline().split()]


def passed(server: subprocess.Popen[str]) -> tuple[int, float]:
    """How many messages a server passed on, and when the newest one."""
    assert server.stdin is not None
    server.stdin.write("\n")
    server.stdin.flush()
    count, newest_s = line(server)
    return int(count), newest_s


# -- measuring -----------------------------------------------------------------------------------


def handled_per_s(name: str) -> float:
    """How many messages a server handles in a second, when they are all there."""
    with process("serve", name) as server:
        (port,) = line(server)
        with process("send", name, int(port), COUNTED / 0.05, 0.05, "silence") as sender:
            (began_s,), _ended = line(sender), line(sender)
            time.sleep(2.0)
            count, newest_s = passed(server)
    assert count, f"{name}: nothing is passed on"
    return count / (newest_s - began_s)


def flooded(name: str, rate: float, end: str, per_s: float) -> Row:
    """One flood of so many messages a second."""
    with process("serve", name) as server:
        (port,) = line(server)
        seconds = FLOOD_S + (0.2 if end.startswith("server") else 0.0)
        seconds += STOPPED_S if end.startswith("client") else 0.0
        with process("send", name, int(port), per_s, seconds, end) as sender:
            (began_s,) = line(sender)
            late_s = 0.0
            if "stopped" in end:
                at_s = began_s + (FLOOD_S if end.startswith("server") else FLOOD_S / 2)
                time.sleep(max(0.0, at_s - time.monotonic()))
                stopped = server if end.startswith("server") else sender
                stopped.send_signal(signal.SIGSTOP)
                stopped_s = time.monotonic()
                time.sleep(STOPPED_S)
                if stopped is sender:
                    late_s = max(0.0, passed(server)[1] - stopped_s)
                stopped.send_signal(signal.SIGCONT)
            ended_s, cut = line(sender)
            time.sleep(max(0.0, ended_s + SETTLED_S - time.monotonic()))
            count, newest_s = passed(server)
    return Row(name, rate, end, max(late_s, newest_s - ended_s, 0.0), count, bool(cut))


def rows(
    names: Iterable[str] = SERVERS, rates: Iterable[float] = RATES, ends: Iterable[str] = ENDS
) -> Iterator[Row]:
    """All floods."""
    for name in names:
        per_s = max(handled_per_s(name) for _ in range(3))  # Others may have delayed one.
        for rate in rates:
            for end in ends:
                yield flooded(name, rate, end, rate * per_s)


def table(found: Iterable[Row]) -> str:
    """What stands in the page: ms, and a star where the server ended the connection."""
    cells: dict[tuple[str, float], dict[str, str]] = {}
    for row in found:
        star = "*" if row.ended_by_server else ""
        cells.setdefault((row.server, row.rate), {})[row.end] = f"{1e3 * row.late_s:.0f}{star}"
    columns = ("server", "times what is handled", *ENDS)
    return markdown(
        columns,
        ((name, f"{rate:g}", *(of[end] for end in ENDS)) for (name, rate), of in cells.items()),
    )


def main() -> None:
    """Measure, and write the page."""
    found = []
    for row in rows():
        print(row, flush=True)
        found.append(row)
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(replaced(page, BEGIN, table(found)), encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        serve(sys.argv[2])
    elif sys.argv[1:2] == ["send"]:
        send(sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), float(sys.argv[5]), sys.argv[6])
    else:
        main()
