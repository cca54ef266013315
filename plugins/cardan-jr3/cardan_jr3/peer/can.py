"""Simulated node on a CAN bus by python-can (LGPL, therefore an extra: imported late)."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

from cardan.common.extras import missing_extra
from cardan.errors import AddressError
from cardan.sim_peers.backends.base import DeviceBackend, Shell
from cardan_jr3.protocol import CanFrame

if TYPE_CHECKING:
    import can

_DRAIN_AT_MOST = 256


class CanNode(Protocol):
    """Simulated device on a CAN bus."""

    node_id: int

    def receive(self, arbitration_id: int, data: bytes, now_s: float) -> None:
        """Receive a data frame from another node."""


class CanBackend(DeviceBackend[CanFrame]):
    """Connection of `node` to a CAN bus while the peer is open."""

    awaits_program = False

    def __init__(self, node: CanNode) -> None:
        self._node = node

    @property
    def there(self) -> bool:
        """Raise: a node cannot be unplugged."""
        return True

    def appear(self) -> None:
        """Do nothing: the node is always connected."""

    def vanish(self) -> None:
        """Do nothing: the connection stays."""

    def _take(self, frame: CanFrame) -> None:
        """Pass a received frame to the node."""
        self._node.receive(*frame, self.shell.device_s())


class PythonCanBus(CanBackend):
    """Bus of python-can's `interface`; `extra` are that interface's own arguments."""

    def __init__(self, node: CanNode, interface: str, channel: str, extra: dict[str, Any]) -> None:
        super().__init__(node)
        self._interface, self._channel, self._extra = interface, channel, extra
        self._bus: can.BusABC | None = None
        self.garbled = 0
        """Number of frames that python-can could not read."""

    @property
    def endpoint(self) -> str:
        """Interface, channel and node, for messages."""
        port = f":{self._extra['port']}" if self._extra.get("port") else ""
        return f"{self._interface} {self._channel}{port} node {self._node.node_id}"

    def open(self, shell: Shell) -> None:
        """Open the bus. Raises AddressError if that is impossible."""
        super().open(shell)
        try:
            import can
        except ImportError as error:
            raise missing_extra("a CAN bus", "python-can", "can", error) from error
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
            if "msgpack" in str(error):
                raise missing_extra(self._interface, "msgpack", "can", error) from error
            hint = ""
            if self._interface == "udp_multicast":
                hint = (
                    "; this computer may have no route for multicast: "
                    "sudo ip route add 239.0.0.0/8 dev lo, or serve socketcand"
                )
            raise AddressError(
                f"cannot open the CAN bus {self._channel!r} by {self._interface}: {error}{hint}"
            ) from None

    def close(self) -> None:
        """Close the bus."""
        bus, self._bus = self._bus, None
        if bus is not None:
            with contextlib.suppress(Exception):
                bus.shutdown()

    def wait(self, timeout_s: float) -> None:
        """Wait for frames and process all that have arrived. Raises AddressError if the bus is
        gone."""
        import can

        bus = self._bus
        assert bus is not None, "wait() before open()"
        for _ in range(_DRAIN_AT_MOST):
            try:
                message = bus.recv(timeout_s)
            except can.CanError as error:
                if error.__cause__ is None or isinstance(error.__cause__, OSError):
                    raise AddressError(f"the CAN bus is gone: {error}") from None
                self.garbled += 1
                continue
            if message is None:
                return
            timeout_s = 0.0
            if not (message.is_extended_id or message.is_remote_frame or message.is_error_frame):
                self._take(CanFrame(message.arbitration_id, bytes(message.data)))

    def send(self, messages: Sequence[CanFrame]) -> None:
        """Send frames; a frame that the bus rejects is lost, as on a bus without listeners."""
        import can

        assert self._bus is not None, "send() before open()"
        for arbitration_id, data in messages:
            with contextlib.suppress(can.CanError):
                self._bus.send(
                    can.Message(arbitration_id=arbitration_id, data=data, is_extended_id=False)
                )
