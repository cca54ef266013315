"""The Leap Motion driver: a thread that listens to the tracking service and feeds the core."""

from __future__ import annotations

import contextlib
import errno
import threading
import time
from typing import Any, ClassVar

from cardan.drivers.access import usb_devices
from cardan.drivers.base import Endpoint, FoundDevice
from cardan.drivers.reader_thread import ReadDevice
from cardan.drivers.simulated import LOOPBACK, OWN
from cardan.errors import DriverError
from cardan.types import DeviceCapabilities
from cardan_leap.driver.connection import Connection, connect
from cardan_leap.driver.core import BUTTONS, LeapCore
from cardan_leap.driver.options import LeapOptions
from cardan_leap.protocol import (
    FOCUS_SINCE,
    HEARTBEAT_PERIOD_S,
    HEARTBEAT_VERSIONS,
    HMD_SINCE,
    ClientOptions,
    DeviceEvent,
    decode_service,
    encode_options,
)

OPEN_TIMEOUT_S = 1.5
"""Time from the first packet to the service's version message."""

READ_TIMEOUT_S = 0.05
"""Longest wait for a message; in between the reader sends heartbeats and checks for a request to
stop."""

PING_AFTER_S, DEAD_AFTER_S = 1.0, 3.0
"""Silence after which a ping is sent, and after which the connection is given up."""

LOOK_S = 0.4
"""Time for which `find` listens."""

USB_VENDORS = frozenset({"f182", "2936"})
"""USB vendor ids of Leap Motion and Ultraleap."""


class Leap(ReadDevice[LeapCore]):
    """Operator device that gives the pose of a hand above a Leap Motion Controller.

    It needs the vendor's tracking service with its WebSocket, and no SDK. See :mod:`.core` for when
    the pose is valid. A lost connection is restored automatically.
    """

    Options: ClassVar[type[LeapOptions]] = LeapOptions
    summary = "Leap Motion"
    page = "../plugins/cardan-leap/README.md"
    peer = "leap"
    simulated = ({"host": LOOPBACK, "port": OWN},)
    gives = "pose of the palm, grab, pinch"
    suits = "position, base frame"
    options: LeapOptions
    _kind = "tracking service"

    def __init__(self, options: LeapOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = LeapCore(self.options)
        self._connection: Connection | None = None
        self._version = 0

    @property
    def capabilities(self) -> DeviceCapabilities:
        """Describe the capabilities: a pose and four buttons of the hand's posture; no feedback."""
        return DeviceCapabilities(
            gives_pose=True,
            buttons=BUTTONS,
            feedback=frozenset(),
            battery=False,
            gives_axes=False,
        )

    def endpoints(self) -> tuple[Endpoint, ...]:
        """Address of the tracking service."""
        return (Endpoint("tcp", self.options.host, self.options.port),)

    @classmethod
    def find(cls) -> list[FoundDevice]:
        """Return the trackers of this computer's service; without a service, the trackers on
        USB."""
        options = LeapOptions()
        path = f"{options.host}:{options.port}"
        try:
            service, trackers = _look(options)
        except (DriverError, OSError) as error:
            return [
                FoundDevice(
                    usb.name or "Leap Motion tracker",
                    f"{usb.vendor_id}:{usb.product_id}",
                    "usb",
                    "",
                    str(error),
                )
                for usb in usb_devices()
                if usb.vendor_id in USB_VENDORS
            ]
        if not trackers:
            return [FoundDevice(service, "", "websocket", path, "it reports no tracker")]
        return [
            FoundDevice(f"{service}, tracker", event.id, "websocket", path, _obstacle(event))
            for event in trackers
        ]

    def _connect(self) -> None:
        options = self.options
        connection, version, others = connect(
            options.host, options.port, options.version, OPEN_TIMEOUT_S
        )
        self._connection, self._version = connection, version.version
        try:
            for text in encode_options(_client_options(options, self._version)):
                connection.send(text)
        except OSError:
            # The reader sees the same end at once, and reports it.
            pass
        now_s = time.monotonic()
        with self._lock:
            self._core.on_opened(now_s)
            for message in (version, *others):
                self._core.on_message(message, now_s)

    def _serve(self, stop: threading.Event) -> None:
        connection = self._connection
        assert connection is not None
        heartbeats = self._version in HEARTBEAT_VERSIONS
        (heartbeat,) = encode_options(ClientOptions(heartbeat=True))
        due_s = pinged_s = 0.0
        while not stop.is_set():
            for text in connection.receive(READ_TIMEOUT_S):
                # Parsing JSON is slow: the lock is not held meanwhile.
                message = decode_service(text)
                now_s = time.monotonic()
                if (callback := self.raw_packet_callback) is not None:
                    callback(text, False, "")
                with self._lock:
                    self._core.on_message(message, now_s)
            self._notify()
            now_s = time.monotonic()
            with self._lock:
                failure = self._core.failure(now_s)
            if failure:
                raise OSError(errno.ETIMEDOUT, failure)
            if heartbeats and now_s >= due_s:
                due_s = now_s + HEARTBEAT_PERIOD_S - 0.5 * READ_TIMEOUT_S
                connection.send(heartbeat)
            silent_s = now_s - connection.heard_s
            if silent_s > DEAD_AFTER_S:
                raise OSError(f"the service does not answer for {DEAD_AFTER_S:g} s")
            if silent_s > PING_AFTER_S and now_s - pinged_s > PING_AFTER_S:
                pinged_s = now_s
                connection.ping()

    def _release(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()


def _client_options(options: LeapOptions, version: int) -> ClientOptions:
    """Return the options sent to the service: frames also without the focus."""
    focus = True if version >= FOCUS_SINCE else None
    hmd = options.optimize_hmd if version >= HMD_SINCE else None
    return ClientOptions(focused=focus, background=focus, optimize_hmd=hmd)


def _look(options: LeapOptions) -> tuple[str, list[DeviceEvent]]:
    """Return the service's name and its trackers' events. Raises DriverError, OSError."""
    connection, version, messages = connect(options.host, options.port, options.version, LOOK_S)
    with contextlib.closing(connection):
        until_s = time.monotonic() + LOOK_S
        while not any(isinstance(message, DeviceEvent) for message in messages):
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                break
            messages += map(decode_service, connection.receive(left_s))
    trackers = {event.id: event for event in messages if isinstance(event, DeviceEvent)}
    return (
        f"Leap Motion service {version.service_version}".rstrip(),
        [event for event in trackers.values() if event.attached],
    )


def _obstacle(event: DeviceEvent) -> str:
    return "" if event.streaming else "it sends no frames: tracking is paused"
