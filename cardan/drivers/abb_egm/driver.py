"""The ABB EGM driver: a socket around :class:`EgmSession`."""

from __future__ import annotations

import math
import os
import select
import socket
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar

from cardan.drivers.abb_egm.address import bind_udp, resolve
from cardan.drivers.abb_egm.compiled import datagrams
from cardan.drivers.abb_egm.options import AbbEgmOptions
from cardan.drivers.abb_egm.session import Address, EgmSession
from cardan.drivers.abb_egm.stream import EgmStream
from cardan.drivers.base import Endpoint, RobotDriver
from cardan.drivers.datagram_robot import BRAKE_WITHIN_S, AnswerMixin
from cardan.drivers.robot_core import WAKE_S
from cardan.drivers.simulated import LOOPBACK, OWN
from cardan.errors import DriverError
from cardan.protocols.egm.decode import decode_robot
from cardan.protocols.egm.messages import (
    MAX_DATAGRAM_BYTES,
    EgmRapidData,
    EgmRobot,
    MalformedEgmMessage,
)
from cardan.types import NEVER_S, RobotCommand, RobotState

_RECEIVE_BYTES = MAX_DATAGRAM_BYTES + 1
"""One byte more than the longest datagram, so that an oversized one is recognized."""

_DRAIN_MAX = 256
"""Most datagrams read in one wake-up: more than the kernel's buffer holds."""

_BACKLOG_STALE = 25
"""Waiting datagrams (0.1 s of them) from which on the kernel may have dropped newer ones."""

_monotonic = time.monotonic


def _speaks_egm(data: bytes) -> bool:
    return not isinstance(decode_robot(data), MalformedEgmMessage)


class AbbEgm(AnswerMixin[EgmSession], RobotDriver):
    """An ABB controller in Externally Guided Motion, over UDP.

    An instance serves one motion task on one port; a process may have several. Each datagram of the
    controller gets exactly one answer, sent from within `send`. If the application does not answer,
    the driver answers with a hold. When the loop ends (by an exception, a `break`, or `close`), the
    driver first brakes the robot within its limits; the last message says zero speed.

    An application that cannot keep up with the controller's cycle uses `stream`.

    Source: ABB Application manual, Externally Guided Motion, RobotWare 7.16.
    """

    Options: ClassVar[type[AbbEgmOptions]] = AbbEgmOptions
    summary = "ABB robots over EGM"
    page = "abb-egm.md"
    peer = "abb-gofa"
    simulated = ({"listen_host": LOOPBACK, "listen_port": OWN},)
    options: AbbEgmOptions
    title = "the EGM driver"
    brakes_within_s = BRAKE_WITHIN_S
    no_final_command_after_s = math.inf
    """The session detects the end of the controller's run."""

    def __init__(self, options: AbbEgmOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._session = EgmSession(self.options, _monotonic())
        self._socket: socket.socket | None = None
        self._recvfrom: Callable[[int], tuple[bytes, Address]]
        self._sendto: Callable[[bytes, Address], object]
        self._poll = select.poll()
        self._drained_s = NEVER_S
        """Last time that the socket was empty; datagrams read now arrived after it."""
        self._woken_s = NEVER_S
        """Last time that a datagram came, or a wait for one timed out."""
        self._patience_ms = 0.0
        """Longest wait for the next datagram while the robot is braked."""
        self._wake_s = min(WAKE_S, self.options.lost_after_s)
        self._period_s = self.options.period_s
        self._late_after_s = self.options.late_after_s

    @property
    def endpoint(self) -> tuple[str, int]:
        """Local address and port. Raises NotOpenError while closed."""
        address: tuple[str, int] = self._open_socket().getsockname()
        return address

    @property
    def message(self) -> EgmRobot | None:
        """Newest message in full, with fields that RobotState lacks."""
        return self._session.message

    @property
    def rapid_data(self) -> EgmRapidData | None:
        """Newest data of the RAPID program (RobotWare 7.7 and later)."""
        message = self._session.message
        return None if message is None else message.rapid_from_robot

    @property
    def force_control_active(self) -> bool | None:
        """True if the measured wrench is force control's, False if it is the sensor's raw reading,
        None if the controller does not report which."""
        message = self._session.message
        if message is None or message.measured_force is None:
            return None
        return message.measured_force.fc_active

    # -- opening and closing --------------------------------------------------------------------

    def _acquire(self) -> None:
        options = self.options
        controller = None if options.controller_host is None else resolve(options.controller_host)
        sock = bind_udp(options.listen_host, options.listen_port)
        # A timeout of the socket itself saves one system call of settimeout().
        sock.setsockopt(
            socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 0, int(self._wake_s * 1e6))
        )
        if not os.get_blocking(sock.fileno()):  # gevent's, which has no such timeout: poll() waits
            sock.setblocking(False)
        self._session = EgmSession(options, _monotonic(), controller)
        self._session.port = sock.getsockname()[1]
        self._poll = select.poll()
        self._poll.register(sock, select.POLLIN)
        self._recvfrom, self._sendto = datagrams(sock)
        self._socket = sock
        self._woken_s = _monotonic()

    def _release(self) -> None:
        sock, self._socket = self._socket, None
        if sock is not None:
            sock.close()

    def _forget(self) -> None:
        self._session.reply_pending = False
        self._release()

    def _open_socket(self) -> socket.socket:
        if self._socket is None:
            raise self._not_open()
        return self._socket

    def _now_s(self) -> float:
        return _monotonic()

    def _connection(self) -> socket.socket | None:
        return self._socket

    # -- the control loop -----------------------------------------------------------------------

    def _hear(self) -> RobotState | None:
        try:
            came = self._recvfrom(_RECEIVE_BYTES)
        except BlockingIOError:  # the socket's timeout
            return self._wait()
        except OSError as error:
            self._failed(error)
            return None
        self._woken_s = now_s = _monotonic()
        # If a datagram waited for less than a period, no newer one is behind it.
        more = now_s - self._drained_s > self._period_s and self._poll.poll(0)
        state = self._take(came, now_s)
        if more:
            session = self._session
            taken = session.counters.accepted
            state = self._drain() or state
            if session.counters.accepted - taken >= _BACKLOG_STALE:
                session.skip()
                return None
        return state

    def _failed(self, error: OSError) -> None:
        """Raise DriverError, unless another thread has closed the driver."""
        if self._socket is not None:
            raise DriverError(f"the EGM socket failed: {error}") from error

    def _wait(self) -> RobotState | None:
        """Wait if the socket's own timeout was too short; return the state of a silence."""
        left_s = self._woken_s + self._wake_s - _monotonic()
        if left_s > 0.0 and self._poll.poll(1e3 * left_s):
            return None
        self._woken_s = now_s = _monotonic()
        return self._session.tick(now_s)

    def send(self, command: RobotCommand) -> None:
        """Answer the last yielded datagram, once.

        A command later than the option `command_timeout_s` is not sent: the robot brakes, and the
        call returns when it rests.
        """
        session = self._session
        sock = self._socket
        if sock is None:
            raise self._not_open()
        state = session.state
        if state is None or not session.reply_pending:
            session.check(command)
            return
        now_s = _monotonic()
        age_s = now_s - state.stamp_s
        if age_s > self._late_after_s:
            session.check(command)
            self._brake()
            return
        if age_s > self._period_s:
            # The robot has moved on since the state that this command was computed from.
            self._drain()
            if not self._owed():
                session.check(command)
                return
        self._transmit(session.reply(command, now_s))

    def _owed(self) -> bool:
        """True if a datagram waits for its answer; a run that is over gets none."""
        session = self._session
        if session.reply_pending and session.is_over(_monotonic()):
            session.skip()
        return session.reply_pending

    def _transmit(self, answer: bytes) -> None:
        session = self._session
        if self._say(answer):
            now_s = _monotonic()
            if not self._poll.poll(0):
                self._drained_s = now_s
            session.answered(now_s)

    def _say(self, data: bytes | None, to: Address | None = None) -> bool:
        to = to or self._session.peer
        if data is None or to is None:
            return False
        try:
            self._sendto(data, to)
        except OSError as error:
            self._session.send_failed(error.strerror or str(error))
            return False
        if (callback := self.raw_packet_callback) is not None:
            callback(data, True, "")
        return True

    def _take(self, came: tuple[bytes, Address], now_s: float) -> RobotState | None:
        """Return the session's state for a datagram, and notify a previous port of the
        controller."""
        data, source = came
        if (callback := self.raw_packet_callback) is not None:
            callback(data, False, "")
        session = self._session
        state = session.receive(data, source, now_s)
        if session.handover is not None:
            last_words, port_before = session.handover
            session.handover = None
            self._say(last_words, port_before)
        return state

    def _waiting(self) -> Iterator[tuple[bytes, Address]]:
        for _ in range(_DRAIN_MAX):
            sock = self._socket
            if sock is None or not self._poll.poll(0):
                return
            try:
                yield sock.recvfrom(_RECEIVE_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:  # a datagram with a bad checksum was discarded
                return
            except OSError as error:
                self._failed(error)
                return

    def _hold(self) -> None:
        state = self._session.state
        if state is not None and _monotonic() - state.stamp_s > self._late_after_s:
            self._brake()
        else:
            self._answer_with_hold()

    def _answer_with_hold(self) -> None:
        if self._owed():
            self._transmit(self._session.hold(_monotonic()))

    def _brake(self) -> None:
        # A silence that was noticed already needs no wait: the final message must not be late.
        self._patience_ms = 0.0 if self._session.silent else 1e3 * self.options.lost_after_s
        self._drain()
        self._answer_with_hold()
        super()._brake()

    def _hear_while_braking(self) -> bool:
        if not self._poll.poll(self._patience_ms):
            return False
        self._drain()
        return True

    # -- the rest -------------------------------------------------------------------------------

    def stream(self) -> EgmStream:
        """Start a thread that answers every datagram at once, for applications slower than the
        robot.

        Use it in `with` on an open driver, instead of cycles() and send().
        """
        self._open_socket()
        return EgmStream(self)

    def set_outputs(self, digital: bool | None = None, values: Sequence[float] = ()) -> None:
        self._session.set_outputs(digital, values)

    def output_values(self) -> tuple[float, ...]:
        return self._session.outputs.dnum

    def cautions(self) -> tuple[str, ...]:
        caution = self.options.caution
        return (caution,) if caution else ()

    def endpoints(self) -> tuple[Endpoint, ...]:
        own = self.options
        return (
            Endpoint(
                "udp",
                own.listen_host,
                own.listen_port,
                True,
                own.controller_host,
                speaks=_speaks_egm,
            ),
        )
