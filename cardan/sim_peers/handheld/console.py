"""Page of the console on the wire: WebSocket, clock synchronization, frames."""

from __future__ import annotations

import contextlib
import json
import os
import struct
import time

from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI
from websockets.sync.client import connect

from cardan.errors import AddressError, DriverError

CHANNEL = 1

CONNECT_WITHIN_S = 5.0

LOOK_S = 0.005
"""Poll period for the server's messages: its requests for the time are answered within it."""

TOKEN_VARIABLE = "CARDAN_SERVER_TOKEN"

_CHANNEL_AT, _TIME_AT = 3, 8
"""Offsets in the header of a frame."""


class ConsolePage:
    """Open page with one channel for a device. Its clock is this computer's."""

    def __init__(self, url: str, topic: str) -> None:
        """Open the page, to send frames for `topic`. Raises AddressError and DriverError."""
        token = os.environ.get(TOKEN_VARIABLE, "").strip()
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._leaving = contextlib.ExitStack()
        try:
            self._socket = self._leaving.enter_context(
                connect(
                    f"{url.rstrip('/')}/ws",
                    open_timeout=CONNECT_WITHIN_S,
                    additional_headers=headers,
                    compression=None,
                )
            )
        except (InvalidURI, ValueError) as error:
            raise AddressError(
                f"--console: {url} is not a WebSocket URL such as ws://127.0.0.1:8443 ({error})"
            ) from None
        except (OSError, InvalidHandshake, TimeoutError) as error:
            raise DriverError(f"cannot be a page of {url}: {error}") from None
        self.ready = False
        """True if the channel is open and the server has synchronized the clock."""
        self.rumble = 0.0
        self.why = ""
        """Reason of a refusal."""
        self.grip = ""
        """Newest message of the server about the hold."""
        self.due_s = 0.0
        self._opened = False
        self._tell(op="cardan.open", channel=CHANNEL, device=topic)

    def _tell(self, **fields: object) -> None:
        try:
            self._socket.send(json.dumps(fields))
        except ConnectionClosed:
            self.ready = False

    def send(self, frame: bytes, age_s: float) -> None:
        """Send a frame that was made `age_s` ago."""
        data = bytearray(frame)
        data[_CHANNEL_AT] = CHANNEL
        struct.pack_into("<Q", data, _TIME_AT, int(1e6 * (time.monotonic() - age_s)))
        try:
            self._socket.send(bytes(data))
        except ConnectionClosed:
            self.ready = False

    def run_due(self, now_s: float) -> None:
        """Handle the server's messages."""
        self.due_s = now_s + LOOK_S
        try:
            while True:
                self._take(json.loads(self._socket.recv(timeout=0)))
        except TimeoutError:
            pass
        except ConnectionClosed:
            self.ready = False

    def _take(self, message: dict[str, object]) -> None:
        op = message.get("op")
        if op == "cardan.ping":
            page_us = int(1e6 * time.monotonic())
            self._tell(op="cardan.pong", server_us=message["server_us"], page_us=page_us)
            self.ready = self._opened
        elif op == "cardan.opened":
            self._opened = True
        elif op == "cardan.refused":
            self.why = str(message["why"])
        elif op == "cardan.input":
            self.grip = str(message["grip"])
        elif op == "cardan.feedback":
            self.rumble = float(str(message["intensity"]))

    def close(self) -> None:
        """Close it."""
        self._leaving.close()
