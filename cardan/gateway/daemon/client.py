"""Client of the daemon: rows, orders, and the verbs of an arm that it runs."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import socket
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Final

from cardan.common.sockets import UntrustedServerError, absence, connected, hang_up, runtime_path
from cardan.errors import AddressError, CardanError, DriverError
from cardan.gateway.arm.remote_arm import RemoteArm
from cardan.gateway.arm.requests import Request
from cardan.gateway.arm.status import VERBS
from cardan.gateway.daemon.control import (
    Ask,
    ControlError,
    LineReader,
    Response,
    decode_response,
    encode_ask,
)
from cardan.gateway.session.supervisor_heartbeat import BEAT_PERIOD_S

ANSWER_S: Final = 10.0
"""Longest wait for an answer."""

RELOAD_S: Final = 120.0
"""Longest wait for a reload, which loads every arm's model."""

SYSTEM_SOCKET: Final = "/run/cardan/cardan.sock"
"""Socket of the daemon that `cardan daemon service install --system` starts."""

SOCKET_VARIABLE: Final = "CARDAN_SOCKET"
"""The environment variable with the daemon's socket; set for the daemon's servers."""

ANSWER_BYTES: Final = 1 << 24
"""Longest answer: all lines kept by the daemon."""


class ControlClient:
    """A connection to the daemon. For one thread."""

    def __init__(self, path: str = "", timeout_s: float | None = ANSWER_S) -> None:
        """`path`: of its socket; empty: that of the environment's CARDAN_SOCKET, else of this
        user's daemon, else of the computer's. Raises AddressError."""
        path = path or os.environ.get(SOCKET_VARIABLE, "")
        self.path = path or runtime_path("cardan.sock")
        if not path and not os.path.exists(self.path) and os.path.exists(SYSTEM_SOCKET):
            self.path = SYSTEM_SOCKET
        if why := absence(self.path):
            raise AddressError(f"no daemon runs here ({why}): start one with `cardan daemon run`")
        try:
            self._sock = connected(self.path, socket.SOCK_STREAM, timeout_s)
        except OSError as error:
            advice = ""
            if isinstance(error, PermissionError) and not isinstance(error, UntrustedServerError):
                advice = ": it is another user's, who may let you in by daemon.group"
            raise AddressError(
                f"the daemon at {self.path} does not answer: {error.strerror or error}{advice}"
            ) from None
        self._ids = itertools.count(1)
        self._reader = LineReader(ANSWER_BYTES)
        self._lines: list[bytes] = []

    def close(self) -> None:
        """Disconnect. Never raises; idempotent."""
        hang_up(self._sock)

    def __enter__(self) -> ControlClient:
        return self

    def __exit__(self, *_exception: object) -> None:
        self.close()

    def ask(self, do: str, name: str = "", value: Any = None) -> Any:
        """Send a request and return its result. Raises ControlError if it is refused, and
        AddressError if the daemon has ended."""
        number = next(self._ids)
        self.send(Ask(number, do, name, value))
        for response in self._answers(number):
            if response.kind == "result":
                return response.value
        raise AddressError("the daemon has ended")

    def events(self, do: str, name: str = "", value: Any = None) -> Iterator[Any]:
        """Yield the values of a continuing request until the daemon ends. Raises the errors of
        `ask`."""
        number = next(self._ids)
        self.send(Ask(number, do, name, value))
        for response in self._answers(number):
            yield response.value

    def send(self, ask: Ask) -> None:
        """Send a request. Raises AddressError."""
        try:
            self._sock.sendall(encode_ask(ask))
        except OSError as error:
            raise AddressError(f"the daemon takes no requests: {error.strerror}") from None

    def receive(self) -> Response | None:
        """Return the next answer; None: the daemon has ended. Raises AddressError if none arrives
        in time."""
        while not self._lines:
            try:
                data = self._sock.recv(65536)
            except TimeoutError:
                raise AddressError(
                    f"the daemon at {self.path} has not answered for {self._sock.gettimeout():g} s"
                ) from None
            except OSError:
                data = b""
            if not data:
                return None
            self._lines = self._reader.take(data)
        return decode_response(self._lines.pop(0))

    def _answers(self, number: int) -> Iterator[Response]:
        while (response := self.receive()) is not None:
            if response.id not in (number, None):
                continue
            if response.kind == "error":
                raise ControlError(response.value, response.id)
            yield response


def daemon_arm(name: str, *, path: str = "", source: str = VERBS) -> RemoteArm:
    """Connect to the arm of the daemon's session `name`.

    ::

        with daemon_arm("gofa") as arm:
            arm.movj([0.4, 0.1, 0.4, 3.14, 0.0, 0.0])
            arm.wait()

    When this program ends, or is suspended for 0.5 s, its streams and motions without end are
    ended; `close` leaves the arm to the daemon. `path`: of the daemon's socket. `source`: name of
    this client, which gets the authority. Raises ConfigurationError; `open` raises AddressError, or
    DriverError if the session takes no requests.
    """
    return RemoteArm(partial(_connect, name, path), source)


def _connect(name: str, path: str, arm: RemoteArm) -> Callable[[], None]:
    with ControlClient(path) as asked:
        row = asked.ask("units", name)[0]
    if row["kind"] != "session" or row["state"] != "running":
        reason = f": {row['reason']}" if row["reason"] else ""
        raise DriverError(f"the {row['kind']} {name} is {row['state']}{reason}")
    client = ControlClient(path, timeout_s=None)
    sending = threading.Lock()

    def send(_request: Request, packet: bytes) -> None:
        request = json.loads(packet)
        with sending:
            client.send(Ask(request["id"], "ask", name, request))

    over = threading.Event()

    def beat() -> None:
        with contextlib.suppress(AddressError):  # The reader reports the end.
            while not over.wait(BEAT_PERIOD_S):
                if arm.endless:
                    with sending:
                        client.send(Ask(0, "beat"))  # No request of the arm has this id.

    def read() -> None:
        why = "the daemon has ended"
        try:
            while (response := client.receive()) is not None:
                if response.kind == "error":
                    arm.fail(response.id, response.value)
                else:
                    arm.take(json.dumps(response.value, separators=(",", ":")).encode())
        except CardanError as error:
            why = str(error)
        finally:
            over.set()
            arm.end(why)

    arm.begin(send)
    reader = threading.Thread(target=read, name="cardan-daemon", daemon=True)
    reader.start()
    beats = threading.Thread(target=beat, name="cardan-beats", daemon=True)
    beats.start()

    def disconnect() -> None:
        with contextlib.suppress(OSError):
            client._sock.shutdown(socket.SHUT_RDWR)
        reader.join()
        beats.join()
        client.close()

    return disconnect
