"""Universal Robots driver: sockets around :class:`UrSession`."""

from __future__ import annotations

from time import monotonic
from typing import ClassVar

from cardan.drivers.base import Endpoint
from cardan.drivers.simulated import LOOPBACK, OWN
from cardan.drivers.tcp_robot import TcpRobot
from cardan.drivers.ur_rtde.options import UrRtdeOptions
from cardan.drivers.ur_rtde.session import CHANNELS, Channel, Task, UrSession
from cardan.protocols.ur.dashboard import greets
from cardan.protocols.ur.rtde import ask_version, speaks_rtde
from cardan.types import RobotCommand


class UrRtde(TcpRobot[UrSession, Channel, Task]):
    """Universal Robots controller (CB3, e-Series), over RTDE and a program that the driver sends.

    Motion starts only on `enable()` (or once, with the option enable = "at-start"): power is
    switched on, the brakes are released and the program is started. After anything that ended it,
    `enable()` is needed again.
    """

    Options: ClassVar[type[UrRtdeOptions]] = UrRtdeOptions
    summary = "Universal Robots arms over RTDE"
    page = "universal-robots.md"
    peer = "ur"
    simulated = ({"host": LOOPBACK, "rtde_port": OWN, "primary_port": OWN, "dashboard_port": OWN},)
    options: UrRtdeOptions
    title = "the UR driver"
    channels = CHANNELS

    def _make_session(self) -> UrSession:
        return UrSession(self.options)

    def _port(self, channel: Channel) -> int:
        options = self.options
        if channel == "rtde":
            return options.rtde_port
        return options.primary_port if channel == "primary" else options.dashboard_port

    def send(self, command: RobotCommand) -> None:
        session, now_s = self._require_open(), monotonic()
        if session.reply_pending and session.late(now_s):
            session.check(command)
            # The arm has moved since the state that this command was computed from.
            self._wait(session, 0.0)
            now_s = monotonic()
        session.command(command, now_s)
        self._flush(session)
        session.account()

    def enable(self) -> None:
        """Switch power on, release the brakes and start the program. The loop executes it;
        `hold_reason` of the states reports the progress."""
        self._ask("enable")

    def disable(self) -> None:
        """Brake along a ramp, then end the program. The loop executes it."""
        self._ask("disable")

    def unlock_protective_stop(self) -> None:
        """Unlock a protective stop, at the earliest 5 s after it. The loop executes it. Call it
        only after a person has checked the cause; Cardan itself never does. Motion must be enabled
        afterwards."""
        self._ask("unlock")

    @property
    def enabled(self) -> bool:
        """True while commands move the robot, or would if they came."""
        return self._open and self._session.enabled

    def endpoints(self) -> tuple[Endpoint, ...]:
        """RTDE and the dashboard server, which serve several clients; the primary interface would
        start to send its states."""
        options = self.options
        return (
            Endpoint(
                "tcp",
                options.host,
                options.rtde_port,
                request=ask_version(),
                speaks=speaks_rtde,
            ),
            Endpoint("tcp", options.host, options.dashboard_port, speaks=greets),
        )

    def metrics(self) -> dict[str, float]:
        return self._session.metrics()

    def protocol_errors(self) -> dict[str, int]:
        return self._session.protocol_errors()
