"""The simulated board's place on a CAN bus by python-can (LGPL, so an extra: imported late)."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

from cardan.errors import AddressError
from cardan.protocols.jr3_can import CanFrame

if TYPE_CHECKING:
    import can

_DRAIN_AT_MOST = 256


class PythonCanBus:
    """A bus of python-can's `interface`; `extra` are that interface's own arguments."""

    def __init__(self, interface: str, channel: str, extra: dict[str, Any]) -> None:
        self._interface, self._channel, self._extra = interface, channel, extra
        self._bus: can.BusABC | None = None
        self.garbled = 0
        """Frames that python-can could not read."""

    @property
    def endpoint(self) -> str:
        """INTERFACE CHANNEL."""
        port = self._extra.get("port")
        return f"{self._interface} {self._channel}" + (f":{port}" if port else "")

    def open(self) -> None:
        """Open the bus; AddressError when that cannot be."""
        try:
            import can
        except ImportError:
            raise AddressError('python-can is not installed: pip install "cardan[can]"') from None
        try:
            self._bus = can.Bus(
                channel=self._channel, interface=self._interface, ignore_config=True, **self._extra
            )
        except (
            can.CanError,
            NotImplementedError,
            OSError,
            ValueError,
            TypeError,
            ImportError,
        ) as error:
            hint = ""
            if "msgpack" in str(error):
                hint = '; pip install "cardan[can]"'
            elif self._interface == "udp_multicast":
                hint = (
                    "; this computer may have no route for multicast: "
                    "sudo ip route add 239.0.0.0/8 dev lo, or serve socketcand"
                )
            raise AddressError(
                f"cannot open the CAN bus {self._channel!r} by {self._interface}: {error}{hint}"
            ) from None

    def close(self) -> None:
        """Let go of the bus."""
        bus, self._bus = self._bus, None
        if bus is not None:
            with contextlib.suppress(Exception):
                bus.shutdown()

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """The data frames that have come, once there is one or after `timeout_s`."""
        import can

        bus = self._bus
        assert bus is not None, "receive() before open()"
        frames = []
        for _ in range(_DRAIN_AT_MOST):
            try:
                message = bus.recv(timeout_s)
            except can.CanError as error:
                if error.__cause__ is None or isinstance(error.__cause__, OSError):
                    raise AddressError(f"the CAN bus is gone: {error}") from None
                self.garbled += 1
                continue
            if message is None:
                break
            timeout_s = 0.0
            if not (message.is_extended_id or message.is_remote_frame or message.is_error_frame):
                frames.append(CanFrame(message.arbitration_id, bytes(message.data)))
        return frames

    def send(self, frame: CanFrame) -> None:
        """Send `frame`; one that the bus does not take is lost, as on a bus without listeners."""
        import can

        assert self._bus is not None, "send() before open()"
        arbitration_id, data = frame
        with contextlib.suppress(can.CanError):
            self._bus.send(
                can.Message(arbitration_id=arbitration_id, data=data, is_extended_id=False)
            )
