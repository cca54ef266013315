"""Driver of the simulated arm.

As the only driver it imports a simulated peer: with transport "in-process" the simulated arm is its
hardware. Datagrams are exchanged all the same, so both transports use the same code and have the
same faults.
"""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, ClassVar

from cardan.common.histogram import LatencyHistogram
from cardan.drivers.datagram_robot import DatagramRobot, DatagramTransport, UdpTransport
from cardan.drivers.robot_core import WAKE_S
from cardan.drivers.sim_arm.options import SimArmOptions
from cardan.drivers.sim_arm.session import SimArmSession
from cardan.drivers.simulated import LOOPBACK
from cardan.protocols.joint_stream.codec import MAX_DATAGRAM_BYTES

if TYPE_CHECKING:  # Imports Pinocchio, which only the arm in this process needs.
    from cardan.sim_peers.arm.controller import SimulatedArm

_monotonic = time.monotonic


_YIELD_S = 1e-5
"""Pause in each virtual cycle while the process has other threads. A loop that never waits holds
the interpreter for 5 ms at each of their calls that release the GIL: 20 ms of their work would take
half a minute."""


class _InProcess:
    """Arm in this process, which runs while the driver waits for its next cycle."""

    def __init__(self, options: SimArmOptions) -> None:
        from cardan.sim_peers.arm.controller import SimulatedArm

        self.arm = SimulatedArm(options.arm_options)
        self.lateness = LatencyHistogram()
        """Lateness at the start of each cycle."""
        self.missed = 0
        """Instants skipped because the next one was already due."""
        self._period_s = options.period_s
        self._virtual = options.pacing == "virtual"
        self._cycle_s = 0.0 if self._virtual else _monotonic()

    def now(self) -> float:
        return self._cycle_s if self._virtual else _monotonic()

    def send(self, data: bytes) -> None:
        self.arm.receive(data, self.now())

    def wait(self) -> list[bytes]:
        begun_s = self._cycle_s
        while True:
            if self._virtual:
                self._cycle_s += self._period_s
                if threading.active_count() > 1:
                    time.sleep(_YIELD_S)
            else:
                self._next_deadline()
            data = list(self.arm.cycle(self._cycle_s))
            if data or self._cycle_s - begun_s >= WAKE_S:
                return data

    def waiting(self) -> list[bytes]:
        return []  # The arm runs only in `wait`.

    def _next_deadline(self) -> None:
        """Sleep until the next instant of the absolute schedule; missed instants are skipped."""
        self._cycle_s += self._period_s
        ahead_s = self._cycle_s - _monotonic()
        if ahead_s > 0.0:
            time.sleep(ahead_s)
        late_s = _monotonic() - self._cycle_s
        self.lateness.add(late_s)
        if late_s >= self._period_s:
            missed = int(late_s / self._period_s)
            self.missed += missed
            self._cycle_s += missed * self._period_s

    def close(self) -> None:
        pass


class SimArm(DatagramRobot[SimArmSession]):
    """A simulated joint-controlled arm, for work without hardware.

    It takes joint positions, joint speeds and (with dynamic drives) torques. A state that the
    application does not answer is answered with a hold; `close` sends a hold, too. In process the
    simulated time runs only in `cycles`. `RobotState.wrench` is the wrench of the TCP on its
    environment, in base axes. With pacing "virtual" stamps count from 0 and nothing sleeps.
    """

    Options: ClassVar[type[SimArmOptions]] = SimArmOptions
    summary = "a simulated arm"
    page = "simulated-peers.md"
    peer = "arm"
    simulated = (
        {"transport": ("in-process",)},
        {"transport": ("udp",), "endpoint": LOOPBACK},
    )
    options: SimArmOptions
    title = "the simulated arm's driver"

    @property
    def arm(self) -> SimulatedArm | None:
        """Arm in this process, for observation or disturbances; None while closed and over UDP."""
        transport = self._transport
        return transport.arm if isinstance(transport, _InProcess) else None

    def metrics(self) -> dict[str, float]:
        """Return counts, and in process in real time the accuracy of the period."""
        found, transport = super().metrics(), self._transport
        if isinstance(transport, _InProcess) and self.options.pacing == "real-time":
            lateness = transport.lateness
            found |= {
                "late_p50_s": lateness.percentile(50.0),
                "late_p99_s": lateness.percentile(99.0),
                "late_max_s": lateness.max,
                "instants": float(lateness.count + transport.missed),
                "superseded": float(transport.missed),
            }
        return found

    def _make_session(self) -> SimArmSession:
        return SimArmSession(self.options)

    def _join(self) -> DatagramTransport:
        options = self.options
        if options.transport == "in-process":
            return _InProcess(options)
        problem = f"endpoint {options.endpoint}"
        return UdpTransport(*options.address, problem, MAX_DATAGRAM_BYTES)
