"""Our own driver with selected defects, and a scenario in virtual time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial

from cardan.conform.runner import Exchange
from cardan.conform.simulation import LOOK_S, NETWORK_S, DriverSimulation
from cardan.conform.timeline import Kind
from cardan.drivers.motoros.connections import CHANNELS, Channel
from cardan.drivers.motoros.motion_control import MotionPhase
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.motoros.session import MotorosSession
from cardan.protocols.simple_message import codec, framing, messages as m
from cardan.robots import load_arm
from cardan.sim_peers.motoros_client import FAULTS, MotorosClientDefects, Sent
from cardan.types import HoldCommand, JointVelocityCommand, RobotCommand, RobotState

OPTIONS = MotorosOptions()
SPEED_RAD_S = 0.1
SWING_S = 1.0


class MotorosDriverSimulation(DriverSimulation):
    """Connects the driver's core to the scenario, with the defects between them."""

    def __init__(
        self,
        exchange: Exchange,
        faults: Mapping[str, float],
        seed: int = 0,
        options: MotorosOptions = OPTIONS,
    ) -> None:
        super().__init__(exchange, faults, FAULTS)
        self._options = options
        self._defects = MotorosClientDefects(faults, load_arm(OPTIONS.robot))
        self._session = self._new_session()
        self._listens: set[str] = set()
        self._links: dict[Channel, str] = {}
        """Channels of the open connections."""
        self._joined = 0
        self._readers: dict[str, framing.FrameReader] = {}
        self._ended = self._leaving = False

    def _new_session(self) -> MotorosSession:
        wait_s = self._faults.get("patient", self._options.request_timeout_s)
        return MotorosSession(replace(self._options, request_timeout_s=wait_s))

    # -- connections ------------------------------------------------------------------------------

    def _open(self, channel: str) -> None:
        super()._open(channel)
        self._listens.add(channel)

    def _closed(self, channel: str) -> None:
        self._later(NETWORK_S, lambda: self._hung_up(channel))

    def _hung_up(self, channel: str) -> None:
        kind = self._kind(channel)
        if kind is not None:
            del self._links[kind]
            self._session.disconnected(kind, "the controller closed it", self._now_s)

    @property
    def _order(self) -> framing.ByteOrder:
        return self._session.feed.byte_order or framing.ByteOrder.LITTLE

    def _kind(self, name: str) -> Channel | None:
        return next((kind for kind, each in self._links.items() if each == name), None)

    def _connect(self) -> None:
        faults = self._faults
        for kind in CHANNELS:
            refused = "absent" in faults or ("no-motion" in faults and kind == "motion")
            tired = "gives-up" in faults and self._joined >= len(CHANNELS)
            wanted = kind not in self._links and self._session.wants(kind, self._now_s)
            if refused or tired or kind not in self._listens or not wanted:
                continue
            self._joined += 1
            name = self._links[kind] = f"{kind} {self._joined}"
            self._session.connected(kind, self._now_s)
            self._hear(name, kind=Kind.OPENED)
            self._send(name, self._defects.connected(kind, self._order))

    # -- data of the controller -------------------------------------------------------------------

    def _take(self, data: bytes, channel: str) -> None:
        self._later(NETWORK_S, lambda: self._arrived(channel, data))

    def _arrived(self, channel: str, data: bytes) -> None:
        kind = self._kind(channel)
        if kind is None:
            return
        if not self._faults:
            self._session.received(kind, data, self._now_s)
            return
        if self._defects.ignores_read(data):
            return
        reader = self._readers.setdefault(channel, framing.FrameReader())
        reader.feed(data)
        while (frame := reader.take()) is not None:
            wire = codec.wire(reader.byte_order or framing.ByteOrder.LITTLE)
            message = wire.decode(frame)
            if isinstance(message, m.Message):
                heard = self._defects.heard(message, kind == "state", self._now_s)
                if heard is None:
                    continue
                frame = wire.encode(heard)
            if self._kind(channel) == kind:
                self._session.received(kind, frame, self._now_s)
        if reader.failure:
            del self._readers[channel]
            self._session.received(kind, data, self._now_s)

    # -- data of the driver -----------------------------------------------------------------------

    def _turn(self) -> None:
        if self._ended:
            return
        session, now_s = self._session, self._now_s
        self._connect()
        session.advance(now_s)
        self._carry()
        state = session.due_state(now_s)
        if state is not None:
            if session.reply_pending:
                session.command(self._wanted(state), now_s)
            self._carry()
        self._misbehave()
        if self._leaving and session.left:
            self._leave()

    def _wanted(self, state: RobotState) -> RobotCommand:
        """Return the command: the last joint swings back and forth, or all hold."""
        if state.hold_reason or self._leaving:
            return HoldCommand()
        speed = SPEED_RAD_S * math.sin(2.0 * math.pi * self._now_s / SWING_S)
        return JointVelocityCommand((0.0,) * (len(state.joints) - 1) + (speed,))

    def _next_s(self) -> float:
        if self._ended:
            return self._now_s + LOOK_S
        return min(self._session.next_s, self._now_s + LOOK_S)

    def _misbehave(self) -> None:
        """Do what a driver with these defects does spontaneously."""
        faults, session, now_s = self._faults, self._session, self._now_s
        idle = session.phase is MotionPhase.IDLE and session.requests.idle
        status = session.feed.status
        if "restarts" in faults and idle and session.sessions > 1 and not self._leaving:
            session.enable(now_s)
        if "resets" in faults and idle and status is not None and status.in_error == 1:
            session.ask("reset alarm", now_s)
        for message in self._defects.states_again(now_s):
            session.received("state", codec.wire(self._order).encode(message), now_s)
        name = self._links.get("motion")
        if name is not None:
            self._send(name, self._defects.asked_again(self._order, now_s))

    def _carry(self) -> None:
        """Carry out the driver's writes and closes."""
        session = self._session
        for kind in session.closing():
            name = self._links.pop(kind, None)
            if name is not None:
                self._close(name)
        for kind, data in session.outgoing():
            if kind not in self._links:
                continue
            if not self._faults:
                self._send(self._links[kind], (Sent(data),))
                continue
            message = codec.wire(self._order).decode(data)
            assert not isinstance(message, m.MalformedMessage)
            said = self._defects.said(message, self._order, self._leaving, self._now_s)
            self._send(self._links[kind], said)

    def _close(self, name: str) -> None:
        self._later(NETWORK_S, lambda: self._hear(name, kind=Kind.CLOSED))

    def _send(self, name: str, found: Iterable[Sent]) -> None:
        for each in found:
            late_s = NETWORK_S if each.late_s is None else each.late_s
            self._later(late_s, partial(self._comes, name, each))

    def _comes(self, name: str, sent: Sent) -> None:
        """Deliver a sent message, or give it to the driver as a pretended answer."""
        if not sent.pretended:
            self._hear(name, sent.data)
        elif self._kind(name) == "motion":
            self._session.received("motion", sent.data, self._now_s)

    # -- actions of the operator ------------------------------------------------------------------

    def _by_hand(self, what: str) -> None:
        if what == "enable":
            self._session.enable(self._now_s)
        elif what == "end":
            if "leaves-moving" in self._faults:
                self._leave()
            else:
                self._leaving = True
                self._session.leave(self._now_s)
        else:
            self._ended = self._leaving = False
            self._session = self._new_session()

    def _leave(self) -> None:
        """End the driver's program."""
        self._ended = True
        if "stays" not in self._faults:
            for name in self._links.values():
                self._close(name)
        self._links.clear()
