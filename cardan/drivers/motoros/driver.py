"""MotoROS driver: sockets around :class:`MotorosSession`."""

from __future__ import annotations

import contextlib
import threading
from typing import Any, ClassVar

from cardan.drivers.base import Endpoint
from cardan.drivers.motoros.connections import CHANNELS, Channel
from cardan.drivers.motoros.io_client import IoClient
from cardan.drivers.motoros.motion_control import Task
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.session import MotorosSession
from cardan.drivers.simulated import LOOPBACK, OWN
from cardan.drivers.tcp_robot import TcpRobot
from cardan.errors import CardanError, NotOpenError
from cardan.protocols.simple_message.framing import ByteOrder, speaks_simple_message


class Motoros(TcpRobot[MotorosSession, Channel, Task]):
    """A Yaskawa Motoman controller that runs MotoROS (1.9), over its TCP ports.

    Motion starts only on `enable()` (or once, with the option enable = "at-start"); after anything
    that ended it, `enable()` is needed again.

    The driver moves one control group, without the messages for several (2016, 2017, 2041). Inputs,
    outputs and registers are behind `io`.
    """

    Options: ClassVar[type[MotorosOptions]] = MotorosOptions
    summary = "Motoman robots over MotoROS"
    page = "motoman.md"
    peer = "motoman-gp8"
    simulated = ({"host": LOOPBACK, "motion_port": OWN, "state_port": OWN, "io_port": OWN},)
    options: MotorosOptions
    title = "the MotoROS driver"
    channels = CHANNELS

    def __init__(self, options: MotorosOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._io: IoClient | None = None
        self._io_lock = threading.Lock()
        self._record_failure = ""

    def _make_session(self) -> MotorosSession:
        return MotorosSession(self.options)

    def _port(self, channel: Channel) -> int:
        options = self.options
        return options.motion_port if channel == "motion" else options.state_port

    def _acquire(self) -> None:
        super()._acquire()
        self._record_failure = ""

    def _release(self) -> None:
        super()._release()
        with self._io_lock:
            io, self._io = self._io, None
        if io is not None:
            with contextlib.suppress(Exception):
                io.close()
        try:
            self._session.control.record.write()
        except CardanError as error:
            self._record_failure = str(error)

    # -- requests of the application --------------------------------------------------------------

    def enable(self) -> None:
        """Start motion (START_VEL_MODE or START_TRAJ_MODE), which also resets alarms and switches
        servos on. The loop executes it; `hold_reason` of the states reports the outcome."""
        self._ask("enable")

    def disable(self) -> None:
        """Brake along a ramp, then leave the controller's mode. The loop executes it."""
        self._ask("disable")

    def stop(self) -> None:
        """Send STOP_MOTION, without our ramp: a trajectory stops dead, velocity mode ramps down at
        the controller's own acceleration. The loop executes it, after any pending reply; it does
        not replace an emergency stop."""
        self._ask("stop")

    def reset_alarm(self) -> None:
        """Reset alarm and error. The loop executes it, like the next two."""
        self._ask("reset alarm")

    def servo_on(self) -> None:
        """Switch the servos on; nothing moves."""
        self._ask("servo on")

    def servo_off(self) -> None:
        """Brake along a ramp, then switch the servos off."""
        self._ask("servo off")

    @property
    def enabled(self) -> bool:
        """True while commands move the robot, or would if they came."""
        return self._open and self._session.control.enabled

    @property
    def io(self) -> IoClient:
        """Inputs, outputs and registers, on a connection of their own; its calls wait for replies.

        Raises NotOpenError while the byte order of the controller is not known: before its first
        state, unless the option `byte_order` is set.
        """
        session = self._require_open()
        with self._io_lock:
            if self._io is None:
                order = session.feed.byte_order
                if order is None:
                    raise NotOpenError(
                        "the controller's byte order is not known yet: wait for its first state, "
                        "or set byte_order"
                    )
                options = self.options
                self._io = IoClient(
                    self._address,
                    options.io_port,
                    "big" if order is ByteOrder.BIG else "little",
                    options.request_timeout_s,
                )
            return self._io

    # -- diagnosis --------------------------------------------------------------------------------

    def endpoints(self) -> tuple[Endpoint, ...]:
        """State port, which serves several clients; the motion port serves only one."""
        options = self.options
        return (Endpoint("tcp", options.host, options.state_port, speaks=speaks_simple_message),)

    def metrics(self) -> dict[str, float]:
        return self._session.metrics(self._now_s())

    def protocol_errors(self) -> dict[str, int]:
        return self._session.protocol_errors()

    def diagnosis(self) -> tuple[str, ...]:
        return (*super().diagnosis(), *((self._record_failure,) if self._record_failure else ()))
