"""The JR3 driver: a thread that reads the CAN bus, feeds the core and sends its requests."""

from __future__ import annotations

import threading
import time
from typing import Any, ClassVar

from cardan.drivers.base import FoundDevice
from cardan.drivers.reader_thread import ReadDevice
from cardan.drivers.simulated import LOOPBACK, OWN
from cardan.errors import DeviceNotFoundError, DriverError
from cardan.types import DeviceCapabilities
from cardan_jr3.driver.bus import CanBus, Unusable, can_interfaces, in_use, open_bus
from cardan_jr3.driver.core import Jr3Core
from cardan_jr3.driver.options import Jr3Options

READ_TIMEOUT_S = 0.05
"""Longest wait for a frame; the reader checks in between for a request to stop."""

ANSWER_TIMEOUT_S = 1.2
"""Time that open() waits for the board: a ping, and another one if the first is lost."""

DRAIN_AT_MOST = 64
"""Most frames processed before the core is polled for frames to send."""

ZERO_TIMEOUT_S = 2.0
"""Time for all tries of the request, and the pauses between them."""
_POLL_S = 0.005

_CAPABILITIES = DeviceCapabilities(
    gives_pose=False, buttons=(), feedback=frozenset(), battery=False
)


class Jr3(ReadDevice[Jr3Core]):
    """JR3 six-axis force-torque sensor, whose wrench deflects the axes: hand guiding.
    `state().wrench` is the wrench on the sensor's tool side since zero was taken, about the TCP
    along the tool's axes; it includes the weight of a tool that has turned since. See :mod:`.core`.
    """

    Options: ClassVar[type[Jr3Options]] = Jr3Options
    summary = "JR3 force-torque sensor"
    page = "../plugins/cardan-jr3/README.md"
    peer = "jr3"
    simulated = (
        {"interface": ("udp_multicast",), "hop_limit": (0,)},
        {"interface": ("virtual",)},
        {"interface": ("socketcand",), "host": LOOPBACK, "port": OWN},
    )
    gives = "wrench"
    suits = "rate, tool frame (hand guiding)"
    options: Jr3Options
    _kind = "JR3 sensor"

    def __init__(self, options: Jr3Options | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = Jr3Core(self.options)
        self._bus: CanBus | None = None

    @classmethod
    def find(cls) -> list[FoundDevice]:
        """Return the CAN interfaces of this computer. Nodes on a bus are visible only when
        addressed."""
        return can_interfaces()

    @property
    def capabilities(self) -> DeviceCapabilities:
        """Describe the capabilities: no buttons, no feedback."""
        return _CAPABILITIES

    def zero(self) -> None:
        """Take the present measurement as zero; returns once that is done.

        The axes are zero until the wrench has been at rest afterwards. Raises CommandError while
        the force changes, NotOpenError, or DriverError if the board does not take it.
        """
        self._check_open("zero()")
        deadline_s = time.monotonic() + ZERO_TIMEOUT_S
        due: int | None = None
        while (now_s := time.monotonic()) < deadline_s:
            with self._lock:
                if due is None and not self._core.watching:
                    due = self._core.ask_zero(now_s)
                if due is not None and self._core.zeros >= due:
                    return
            time.sleep(_POLL_S)
        with self._lock:
            reason = self._core.state(time.monotonic()).reason
        raise DriverError(f"zero was not taken: {reason}")

    # -- the reader ----------------------------------------------------------------------------

    def _connect(self) -> None:
        self._bus = open_bus(self.options)
        with self._lock:
            self._core.on_opened(time.monotonic())
        deadline_s = time.monotonic() + ANSWER_TIMEOUT_S
        try:
            while not self._core.answered and not self._stop.is_set():
                if time.monotonic() >= deadline_s:
                    self._not_there()
                self._turn(self._bus)
        except OSError as error:
            raise in_use(self.options, error) from None

    def _not_there(self) -> None:
        options = self.options
        with self._lock:
            reason = self._core.state(time.monotonic()).reason
        raise DeviceNotFoundError(
            f"on the CAN bus {options.channel!r} by {options.interface}: {reason}"
        )

    def _serve(self, stop: threading.Event) -> None:
        bus = self._bus
        assert bus is not None
        while not stop.is_set():
            self._turn(bus)
        with self._lock:
            frames = self._core.final_command()
        for frame in frames:
            bus.send(frame)

    def _turn(self, bus: CanBus) -> None:
        """Send due frames, then wait for frames and process them."""
        with self._lock:
            now_s = time.monotonic()
            frames = self._core.poll(now_s)
            wait_s = self._core.next_due_s - now_s
        for frame in frames:
            bus.send(frame)
            if (callback := self.raw_packet_callback) is not None:
                callback(frame.data, True, f"can 0x{frame.arbitration_id:03x}")
        timeout_s = max(0.0, min(READ_TIMEOUT_S, wait_s))
        for _ in range(DRAIN_AT_MOST):
            received = bus.receive(timeout_s)
            if received is None:
                break
            if (callback := self.raw_packet_callback) is not None and not isinstance(
                received, Unusable
            ):
                callback(received.data, False, f"can 0x{received.arbitration_id:03x}")
            with self._lock:
                if isinstance(received, Unusable):
                    self._core.on_unusable(received.kind)
                else:
                    self._core.on_frame(*received, time.monotonic())
            timeout_s = 0.0
        self._notify()

    def _release(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()
