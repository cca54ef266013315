"""The driver of the simulated arm.

It is the one driver that imports a simulated peer: with transport "in-process" its hardware is the
simulated arm, and there is nothing else to open. Datagrams are exchanged all the same, so both
transports go through the same code and have the same faults.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Generator
from typing import Any, Protocol

from cardan.drivers.robot_core import WAKE_S, LoopingRobot
from cardan.drivers.sim_arm.options import SimArmOptions
from cardan.drivers.sim_arm.session import SimArmSession
from cardan.drivers.simulated import LOOPBACK
from cardan.protocols.joint_stream import MAX_DATAGRAM_BYTES
from cardan.sim_peers.arm import SimulatedArm
from cardan.sockets import opened, waiting
from cardan.types import HoldCommand, RobotCommand, RobotLink, RobotState

_monotonic = time.monotonic


class _Transport(Protocol):
    """What joins the driver to the arm."""

    def now(self) -> float:
        """The time of the stamps."""

    def send(self, data: bytes) -> None: ...

    def wait(self) -> list[bytes]:
        """What came in by the next control instant, oldest first; empty at least every WAKE_S."""

    def waiting(self) -> list[bytes]:
        """What is there already, oldest first."""

    def close(self) -> None: ...


_MAKE_WAY_S = 1e-5
"""Pause in each virtual cycle while the process has other threads. A loop that never waits keeps
the interpreter for 5 ms at every call of theirs that lets go of it: what takes them 20 ms alone
would take half a minute."""


class _InProcess:
    """The arm in this process, which runs while somebody waits for its next cycle."""

    def __init__(self, options: SimArmOptions) -> None:
        self.arm = SimulatedArm(options.arm_options)
        self._period_s = options.period_s
        self._virtual = options.pacing == "virtual"
        self._cycle_s = 0.0 if self._virtual else _monotonic()
        self._heard_s = self._cycle_s

    def now(self) -> float:
        return self._cycle_s if self._virtual else _monotonic()

    def send(self, data: bytes) -> None:
        self.arm.receive(data, self.now())

    def wait(self) -> list[bytes]:
        while True:
            if self._virtual:
                self._cycle_s += self._period_s
                if threading.active_count() > 1:
                    time.sleep(_MAKE_WAY_S)
            else:
                self._next_deadline()
            data = list(self.arm.cycle(self._cycle_s))
            if data or self._cycle_s - self._heard_s >= WAKE_S:
                self._heard_s = self._cycle_s
                return data

    def waiting(self) -> list[bytes]:
        return []  # The arm runs in `wait` only.

    def _next_deadline(self) -> None:
        """Sleep until the next instant of the absolute schedule; those missed are left out."""
        self._cycle_s += self._period_s
        ahead_s = self._cycle_s - _monotonic()
        if ahead_s > 0.0:
            time.sleep(ahead_s)
        elif ahead_s < -self._period_s:
            self._cycle_s += int(-ahead_s / self._period_s) * self._period_s

    def close(self) -> None:
        pass


class _Udp:
    """A served arm."""

    def __init__(self, options: SimArmOptions) -> None:
        problem = f"endpoint {options.endpoint}"
        join = socket.socket.connect
        self._socket = opened(*options.address, socket.SOCK_DGRAM, join, problem)

    def now(self) -> float:
        return _monotonic()

    def send(self, data: bytes) -> None:
        # Refused while nobody listens there; the silence says so.
        with contextlib.suppress(OSError):
            self._socket.send(data)

    def wait(self) -> list[bytes]:
        found: list[bytes] = []
        deadline_s = _monotonic() + WAKE_S
        while not found and (left_s := deadline_s - _monotonic()) > 0.0:
            try:
                ready = select.select([self._socket], [], [], left_s)[0]
            except (OSError, ValueError):  # closed by another thread
                break
            if not ready:
                break
            found = self.waiting()
        return found

    def waiting(self) -> list[bytes]:
        return [data for data, _ in waiting(self._socket, MAX_DATAGRAM_BYTES + 1)]

    def close(self) -> None:
        self._socket.close()


class SimArm(LoopingRobot[SimArmSession]):
    """A simulated joint-controlled arm, for everything that can be done without hardware.

    It takes joint positions, joint speeds and (with dynamic drives) torques. A state that the
    application does not answer is answered with a hold; `close` leaves a hold too. In process the
    simulated time runs in `cycles` only. `RobotState.wrench` is what the TCP exerts on the world,
    base axes. With pacing "virtual" stamps count from 0 and nothing ever sleeps.
    """

    Options = SimArmOptions
    summary = "a simulated arm"
    page = "simulated-arm.md"
    peer = "arm"
    simulated = (
        {"transport": ("in-process",)},
        {"transport": ("udp",), "endpoint": LOOPBACK},
    )
    options: SimArmOptions
    title = "the simulated arm's driver"

    def __init__(self, options: SimArmOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._session = SimArmSession(self.options)
        self._transport: _Transport | None = None
        self._owes_answer = False

    @property
    def arm(self) -> SimulatedArm | None:
        """The arm in this process, to look at or to disturb; None while closed and over UDP."""
        transport = self._transport
        return transport.arm if isinstance(transport, _InProcess) else None

    def _acquire(self) -> None:
        options = self.options
        self._session = SimArmSession(options)
        udp = options.transport == "udp"
        self._transport = _Udp(options) if udp else _InProcess(options)
        self._owes_answer = False

    def _release(self) -> None:
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def _joined(self) -> _Transport:
        if self._transport is None:
            raise self._not_open()
        return self._transport

    def _now_s(self) -> float:
        return self._joined().now()

    def _leave_within_s(self) -> float:
        return WAKE_S

    def _states(self, loop: int) -> Generator[RobotState, None, None]:
        session, transport = self._session, self._transport
        if transport is None or self._loop != loop:
            return
        said_s = transport.now()
        transport.send(session.greeting(said_s))
        with self._looping(loop):
            while self._loop == loop:
                state = None
                for data in transport.wait():
                    state = session.receive(data, transport.now()) or state
                if self._loop != loop:
                    return
                now_s = transport.now()
                if state is not None:
                    said_s = now_s
                    self._owes_answer = True
                    yield state
                    if self._loop == loop and self._owes_answer:
                        self.send(HoldCommand())
                elif now_s - said_s >= WAKE_S and session.lost(now_s):
                    said_s = now_s
                    transport.send(session.greeting(now_s))
                    yield session.silence(now_s)

    def _leave(self) -> None:
        transport = self._joined()
        data = self._session.command(HoldCommand(), transport.now())
        self._owes_answer = False
        if data is not None:
            transport.send(data)

    def send(self, command: RobotCommand) -> None:
        """Command the arm; the last of several calls for one state counts."""
        transport, session = self._joined(), self._session
        if not self._owes_answer and session.lost(transport.now()):
            session.check(command)
            return
        if session.late(transport.now()):
            # The arm is not where it was when this command was thought of.
            for data in transport.waiting():
                session.receive(data, transport.now())
        answer = session.command(command, transport.now())
        self._owes_answer = False
        if answer is not None:
            transport.send(answer)

    @property
    def link(self) -> RobotLink:
        """Whether the arm is heard now."""
        if self._transport is None or not self._session.accepted:
            return RobotLink.WAITING
        lost = self._session.lost(self._transport.now())
        return RobotLink.LOST if lost else RobotLink.LIVE

    def metrics(self) -> dict[str, float]:
        return self._session.metrics()
