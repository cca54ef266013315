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
from collections.abc import Iterator
from typing import Any, Protocol

from cardan.drivers.base import RobotDriver
from cardan.drivers.sim_arm.options import SimArmOptions
from cardan.drivers.sim_arm.session import SimArmSession
from cardan.errors import AddressError, NotOpenError
from cardan.protocols.joint_stream import MAX_DATAGRAM_BYTES
from cardan.sim_peers.arm import SimulatedArm
from cardan.types import HoldCommand, RobotCapabilities, RobotCommand, RobotLink, RobotState

_WAKE_S = 0.1
"""A silent robot is reported at least this often (contract of `cycles`)."""
_DRAIN_AT_MOST = 256

_monotonic = time.monotonic


class _Transport(Protocol):
    """What joins the driver to the arm."""

    def now(self) -> float:
        """The time of the stamps."""

    def send(self, data: bytes) -> None: ...

    def wait(self) -> list[bytes]:
        """What came in by the next control instant, oldest first; empty at least every _WAKE_S."""

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
            if data or self._cycle_s - self._heard_s >= _WAKE_S:
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
        host, port = options.address
        link = None
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                host, port, family=socket.AF_INET, type=socket.SOCK_DGRAM
            )[0]
            link = socket.socket(family, kind, protocol)
            link.connect(address)
        except (OSError, UnicodeError) as error:
            if link is not None:
                link.close()
            raise AddressError(f"endpoint {options.endpoint}: {error}") from None
        link.setblocking(False)
        self._socket = link

    def now(self) -> float:
        return _monotonic()

    def send(self, data: bytes) -> None:
        # Refused while nobody listens there; the silence says so.
        with contextlib.suppress(OSError):
            self._socket.send(data)

    def wait(self) -> list[bytes]:
        found: list[bytes] = []
        deadline_s = _monotonic() + _WAKE_S
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
        found: list[bytes] = []
        for _ in range(_DRAIN_AT_MOST):
            try:
                found.append(self._socket.recv(MAX_DATAGRAM_BYTES + 1))
            except BlockingIOError:
                break
            except OSError:
                continue
        return found

    def close(self) -> None:
        self._socket.close()


class SimArm(RobotDriver):
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
    options: SimArmOptions

    def __init__(self, options: SimArmOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._session = SimArmSession(self.options)
        self._transport: _Transport | None = None
        self._owes_answer = False
        self._loop = 0

    @property
    def capabilities(self) -> RobotCapabilities:
        return self._session.capabilities

    @property
    def arm(self) -> SimulatedArm | None:
        """The arm in this process, to look at or to disturb; None while closed and over UDP."""
        transport = self._transport
        return transport.arm if isinstance(transport, _InProcess) else None

    def open(self) -> None:
        if self._transport is None:
            self._session = SimArmSession(self.options)
            options = self.options
            udp = options.transport == "udp"
            self._transport = _Udp(options) if udp else _InProcess(options)
            self._owes_answer = False

    def close(self) -> None:
        transport, self._transport = self._transport, None
        self._loop += 1
        if transport is not None:
            with contextlib.suppress(Exception):
                data = self._session.command(HoldCommand(), transport.now())
                if data is not None:
                    transport.send(data)
            transport.close()

    def cycles(self) -> Iterator[RobotState]:
        transport = self._opened()
        self._loop += 1
        return self._run(transport, self._loop)

    def _run(self, transport: _Transport, loop: int) -> Iterator[RobotState]:
        session = self._session
        said_s = transport.now()
        transport.send(session.greeting(said_s))
        try:
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
                elif now_s - said_s >= _WAKE_S and session.lost(now_s):
                    said_s = now_s
                    transport.send(session.greeting(now_s))
                    yield session.silence(now_s)
        finally:
            if self._loop == loop and self._transport is transport:
                self.send(HoldCommand())

    def send(self, command: RobotCommand) -> None:
        """Command the arm; the last of several calls for one state counts."""
        transport = self._opened()
        if not self._owes_answer and self._session.lost(transport.now()):
            self._session.check(command)
            return
        session = self._session
        if session.late(transport.now()):
            # The arm is not where it was when this command was thought of.
            for data in transport.waiting():
                session.receive(data, transport.now())
        answer = session.command(command, transport.now())
        self._owes_answer = False
        if answer is not None:
            transport.send(answer)

    def _opened(self) -> _Transport:
        if self._transport is None:
            raise NotOpenError("the simulated arm's driver is not open; call open(), or use `with`")
        return self._transport

    @property
    def link(self) -> RobotLink:
        """Whether the arm is heard now."""
        if self._transport is None or not self._session.accepted:
            return RobotLink.WAITING
        lost = self._session.lost(self._transport.now())
        return RobotLink.LOST if lost else RobotLink.LIVE

    def metrics(self) -> dict[str, float]:
        return self._session.metrics()

    def diagnosis(self) -> tuple[str, ...]:
        if self._transport is None:
            return ("the simulated arm's driver is not open",)
        return self._session.diagnosis(self._transport.now())
