"""Clients that send more than a server can handle, one for each access to a session."""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import struct
import time
from abc import ABC, abstractmethod
from typing import Any, ClassVar

from websockets.frames import Frame, Opcode
from websockets.sync.client import connect

from cardan.bus.network import Network
from cardan.bus.options import BusOptions
from cardan.gateway.arm.requests import Request, encode_request
from cardan.gateway.arm.vocab import Begins
from cardan.gateway.daemon.control import Ask, encode_ask
from cardan.protocols.handheld.frames import JogTwist, OperatorFrame, PhoneFrame, encode_frame
from cardan.protocols.joint_stream.codec import (
    ArmCommand,
    ControlMode,
    decode_state,
    encode_command,
)
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from cardan.protocols.spnav.codes import NEWEST_VERSION
from cardan.protocols.spnav.records import encode_handshake, encode_sensitivity
from cardan.types import Vector3
from cardan_spnav_server.protocol import encode_motion
from tests.gateway.servers.console.bench import PageProgram
from tests.protocols.test_handheld import TELEOP
from tests.waiting import until

ARM = "/left/arm"
TOPIC, TWIST = "/left/servo_node/delta_twist_cmds", "geometry_msgs/msg/TwistStamped"

SPEED_M_S = 0.05
JOINTS, JOINT_RAD_S = 6, 0.1

SEND_S = 0.02
"""Longest wait of a client for a full buffer before it checks its clock: its last byte has to be
sent when its time is up."""

RESTS_S = 0.5
"""A device counts once it was at rest."""

MOST_AT_ONCE = 1000
_page_program: Any = PageProgram
_teleop: Any = TELEOP["data"]
_NO_STAMP = {"sec": 0, "nanosec": 0}


def _twist(way: int) -> dict[str, Any]:
    header = {"stamp": _NO_STAMP, "frame_id": "base_link"}
    return {"header": header, "twist": {"linear": {"x": way * SPEED_M_S}}}


def _cdr(way: int) -> bytes:
    return codec_of(TWIST).encode(completed(TWIST, _twist(way)))


class Client(ABC):
    """Client that can flood a server; `way`, 1 or -1, is the direction of the arm."""

    constant: bytes = b""
    """The message, if all messages are equal."""
    has_left = False
    """True while a part of the current message is still unsent."""

    def __init__(self, endpoint: str, way: int) -> None:
        self.endpoint, self.way = endpoint, way
        self.made = 0

    def message(self) -> bytes:
        """Return the next message, encoded."""
        return self.constant

    @abstractmethod
    def hand(self, count: int) -> int:
        """Hand at most `count` messages to the system, or the rest of previous ones, within SEND_S;
        return how many were begun.

        Raises OSError once the server has closed the connection.
        """

    def rest(self) -> None:  # noqa: B027 - only hands rest
        """Rest for a moment, before the arm moves."""

    @abstractmethod
    def close(self) -> None:
        """Leave like a program that exits regularly."""

    def abort(self) -> None:  # noqa: B027 - without a connection there is nothing to reset
        """Prepare an abrupt exit: the process ends next."""


class _Stream(Client):
    """Client over a byte stream."""

    socket: socket.socket
    _waiting = b""

    def hand(self, count: int) -> int:
        begun = 0
        if not self._waiting:
            begun = min(count, MOST_AT_ONCE)
            if self.constant:
                self._waiting = begun * self.constant
            else:
                self._waiting = b"".join(self.message() for _ in range(begun))
        self.socket.settimeout(SEND_S)
        with contextlib.suppress(TimeoutError):
            self._waiting = self._waiting[self.socket.send(self._waiting) :]
        return begun

    @property
    def has_left(self) -> bool:  # type: ignore[override]
        return bool(self._waiting)

    def close(self) -> None:
        # Other threads read from it: close() alone would not wake them.
        self.socket.shutdown(socket.SHUT_RDWR)

    def abort(self) -> None:
        if self.socket.family != socket.AF_UNIX:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def _text(table: Any) -> bytes:
    return Frame(Opcode.TEXT, json.dumps(table).encode()).serialize(mask=True)


def _binary(data: bytes) -> bytes:
    return Frame(Opcode.BINARY, data).serialize(mask=True)


class _Web(_Stream):
    """Client over a WebSocket."""

    path = "/"
    protocols: ClassVar[Any] = None

    def __init__(self, endpoint: str, way: int) -> None:
        super().__init__(endpoint, way)
        (port,) = re.findall(r":(\d+)", endpoint)
        url = f"ws://127.0.0.1:{port}{self.path}"
        self.connection = connect(
            url, compression=None, subprotocols=self.protocols, max_queue=None
        )
        self.socket = self.connection.socket
        self.begin()

    def begin(self) -> None:
        """Send the first messages."""

    def send(self, **fields: Any) -> None:
        self.connection.send(json.dumps(fields))


class Rosbridge(_Web):
    """rosbridge client with JSON."""

    compression = "none"

    def begin(self) -> None:
        self.send(op="advertise", topic=TOPIC, type=TWIST)
        if self.compression != "none":
            # Clients send JSON: the other encodings exist only towards clients.
            self.send(op="subscribe", topic="/left/joint_states", compression=self.compression)
        self.constant = self.made_of({"op": "publish", "topic": TOPIC, "msg": _twist(self.way)})

    def made_of(self, publication: dict[str, Any]) -> bytes:
        """Encode messages as frames."""
        return _text(publication)


class RosbridgeCbor(Rosbridge):
    """rosbridge client that receives CBOR meanwhile."""

    compression = "cbor"


class RosbridgePng(Rosbridge):
    """rosbridge client that receives PNG meanwhile."""

    compression = "png"


class RosbridgeFragments(Rosbridge):
    """rosbridge client that sends each publication in two fragments."""

    def made_of(self, publication: dict[str, Any]) -> bytes:
        text = json.dumps(publication)
        parts = text[:30], text[30:]
        return b"".join(
            _text({"op": "fragment", "id": "1", "num": number, "total": 2, "data": part})
            for number, part in enumerate(parts)
        )


class Foxglove(_Web):
    """Foxglove client with CDR."""

    protocols = ("foxglove.sdk.v1",)

    def begin(self) -> None:
        channel = {"id": 1, "topic": TOPIC, "encoding": "cdr", "schemaName": TWIST}
        self.send(op="advertise", channels=[channel])
        self.constant = _binary(b"\x01" + struct.pack("<I", 1) + _cdr(self.way))


class PageJson(Rosbridge):
    """Client of the page's socket, which accepts rosbridge operations, too."""

    path = "/ws"


class _Held(_Web):
    """Client of the page's socket with a device that rests first and then holds the dead-man."""

    path = "/ws"
    _began_s = 0.0

    def rest(self) -> None:
        self._began_s = 0.0

    def passed_s(self) -> float:
        """Time since the hold began; negative while the device rests."""
        self._began_s = self._began_s or time.monotonic()
        return time.monotonic() - self._began_s - RESTS_S


class _PageFrames(_Held):
    """Sends the page's operator frames, in binary."""

    target: ClassVar[dict[str, str]]

    def begin(self) -> None:
        page: Any = _page_program(self.connection)
        page.begin()
        page.open(1, **self.target)

    @abstractmethod
    def body(self, passed_s: float) -> Any:
        """Return the contents of a frame."""

    def message(self) -> bytes:
        self.made += 1
        now_us, passed_s = int(time.monotonic() * 1e6), self.passed_s()
        frame = OperatorFrame(
            self.body(max(0.0, passed_s)),
            passed_s > 0.0,
            channel=1,
            sequence=self.made,
            time_us=now_us,
        )
        return _binary(encode_frame(frame))


class PagePhone(_PageFrames):
    """Phone that is tilted while held: slowly, because a sudden rotation would count as a jump."""

    target: ClassVar = {"device": "/phone"}

    def body(self, passed_s: float) -> PhoneFrame:
        return PhoneFrame(Vector3(0.0, self.way * min(15.0, 30.0 * passed_s), 0.0))


class PageJog(_PageFrames):
    """Button of the page that jogs the arm along an axis while it is held."""

    target: ClassVar = {"arm": ARM}

    def body(self, passed_s: float) -> JogTwist:
        speed_m_s = self.way * SPEED_M_S if passed_s > 0.0 else 0.0
        return JogTwist(Vector3(speed_m_s, 0.0, 0.0), Vector3(0.0, 0.0, 0.0))


class PageTeleop(_Held):
    """Public page `teleop`: the phone moves away from its start."""

    def message(self) -> bytes:
        passed_s = self.passed_s()
        place = {"x": 0.0, "y": 1.2, "z": -self.way * min(0.05, 0.1 * max(0.0, passed_s))}
        data = {**_teleop, "position": place, "move": passed_s > 0.0}
        return _text({"type": "pose", "data": data})


class _Bus(Client):
    """Client with its own node."""

    def __init__(self, endpoint: str, way: int) -> None:
        super().__init__(endpoint, way)
        self.network = self.joined()
        there = lambda: getattr(self.network.topics().get(TOPIC), "subscribers", ())  # noqa: E731
        until(there, f"somebody who takes {TOPIC}")
        self.publisher = self.network.advertise(TOPIC, TWIST, False)
        self.constant = _cdr(way)

    @abstractmethod
    def joined(self) -> Network:
        """Connect to the network."""

    def hand(self, count: int) -> int:
        end_s = time.monotonic() + SEND_S
        for number in range(min(count, MOST_AT_ONCE)):
            self.publisher.publish(self.constant)
            if time.monotonic() > end_s:
                return number + 1
        return min(count, MOST_AT_ONCE)

    def close(self) -> None:
        self.network.close()


class Zenoh(_Bus):
    """Node on Zenoh."""

    def joined(self) -> Network:
        from cardan.bus.zenoh_network import BusNetwork

        network = BusNetwork(BusOptions(router=self.endpoint), "flood")
        network.open()
        return network


class Dds(_Bus):
    """Node on DDS."""

    def joined(self) -> Network:
        from cardan.bus.dds_options import DdsOptions
        from cardan_dds.network import DdsNetwork

        network = DdsNetwork(DdsOptions(dds_domain=int(self.endpoint.rpartition("/")[2])), "flood")
        network.open()
        return network


class Daemon(_Stream):
    """Client of the daemon's socket that sends a verb and reads the answers, to stay connected."""

    def __init__(self, endpoint: str, way: int) -> None:
        super().__init__(endpoint, way)
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.socket.connect(endpoint)
        speeds = [way * SPEED_M_S, 0.0, 0.0, 0.0, 0.0, 0.0]
        twist = Request(1, "flood", "twist", speeds, begins=Begins.NEW)
        self.constant = encode_ask(Ask(1, "ask", "left", json.loads(encode_request(twist))))

    def hand(self, count: int) -> int:
        self.socket.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while self.socket.recv(1 << 16):
                pass
        return super().hand(count)


class JointStream(Client):
    """Another driver that connects to the simulated arm itself."""

    def __init__(self, endpoint: str, way: int) -> None:
        super().__init__(endpoint, way)
        host, _, port = endpoint.rpartition(":")
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect((host, int(port)))
        self.socket.settimeout(SEND_S)
        self.session = 0
        until(self._greeted, "a state of the arm")

    def _greeted(self) -> bool:
        """Request a state, which an arm sends once its previous client was silent."""
        self.made = 1
        self.socket.send(encode_command(ArmCommand(0, 1, 0.0, ControlMode.HOLD), JOINTS))
        with contextlib.suppress(TimeoutError):
            self.session = getattr(decode_state(self.socket.recv(1 << 16)), "session", 0)
        return self.session > 0

    def message(self) -> bytes:
        self.made += 1
        speeds = (*(0.0,) * (JOINTS - 1), self.way * JOINT_RAD_S)
        now_s = time.monotonic()
        command = ArmCommand(self.session, self.made, now_s, ControlMode.VELOCITY, speeds)
        return encode_command(command, JOINTS)

    def hand(self, count: int) -> int:
        end_s = time.monotonic() + SEND_S
        for number in range(count):
            self.socket.send(self.message())
            if time.monotonic() > end_s:
                return number + 1
        return count

    def close(self) -> None:
        self.socket.close()


class Spnav(_Stream):
    """spacenavd daemon to which the session's driver connects."""

    def __init__(self, endpoint: str, way: int) -> None:
        super().__init__(endpoint, way)
        with contextlib.suppress(FileNotFoundError):
            os.unlink(endpoint)
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listening:
            listening.bind(endpoint)
            listening.listen()
            listening.settimeout(20.0)
            self.socket, _ = listening.accept()
        # Before it sends requests, a driver takes a silent daemon for one of protocol version 0.
        heard = b""
        while len(heard) < len(encode_handshake(NEWEST_VERSION) + encode_sensitivity(1.0)):
            heard += self.socket.recv(64)

    def rest(self) -> None:
        self.socket.sendall(encode_motion((0,) * 6, 16))
        time.sleep(RESTS_S)

    def message(self) -> bytes:
        # Repeats of one record are a daemon's own, and prove no hand.
        self.made += 1
        counts = (0, 0, self.way * (150 + self.made % 2), 0, 0, 0)
        return encode_motion(counts, 16)
