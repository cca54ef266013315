"""Our own driver with selected defects, and a scenario in virtual time."""

from __future__ import annotations

import math
from collections.abc import Mapping

from cardan.conform.runner import Exchange
from cardan.conform.simulation import DriverSimulation
from cardan.drivers.robot_core import WAKE_S
from cardan.drivers.sim_arm.options import SimArmOptions
from cardan.drivers.sim_arm.session import SimArmSession
from cardan.protocols.joint_stream.codec import (
    ArmCommand,
    ArmState,
    ControlMode,
    MalformedDatagram,
    decode_command,
    decode_state,
    encode_command,
)
from cardan.sim_peers.base import strikes
from cardan.types import HoldCommand, JointCommand, RobotCommand, RobotState
from cardan_conform_arms.joint_stream_driver.faults import FAULTS
from cardan_conform_arms.joint_stream_driver.requirements import PERIOD_S, ROBOT

NETWORK_S = 2e-4
WAY_RAD, SWING_S = 0.02, 1.0
EVERY = 50
SILENT_S = 0.05
JOINTS_AT = 7


class JointStreamDriverSimulation(DriverSimulation):
    """Connects the scenario with the driver's core: states one way, commands the other."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int = 0) -> None:
        super().__init__(exchange, faults, FAULTS)
        options = SimArmOptions(robot=ROBOT, period_s=PERIOD_S)
        self._session = SimArmSession(options)
        self._said_s = -math.inf
        self._heard_s = math.inf
        self._chatter_s = 0.0
        self._listens = self._ended = self._moves = self._lost = False
        self._reported = self._asked = self._sequence = 0
        self._first = 0
        """First session of the arm that was heard; 0: none yet."""
        self._from: tuple[float, tuple[float, ...], int] | None = None
        """Time, place and session of the start of motion."""
        self._target: tuple[float, ...] = ()

    def _open(self, channel: str) -> None:
        super()._open(channel)
        self._listens = True

    # -- what the driver is asked to do -----------------------------------------------------------

    def _wanted(self, state: RobotState) -> RobotCommand:
        """Return the command: every joint swings back and forth, from its position when commands
        began to act."""
        if state.hold_reason:
            self._from = None
            return HoldCommand()
        if self._from is None or self._from[2] != state.session:
            self._from = self._now_s, state.joints, state.session
        began_s, at, _ = self._from
        turn = 2.0 * math.pi / SWING_S
        phase = turn * (self._now_s - began_s)
        way, speed = WAY_RAD * (1.0 - math.cos(phase)), WAY_RAD * turn * math.sin(phase)
        self._target = tuple(q + way for q in at)
        return JointCommand(self._target, (speed,) * len(at))

    # -- datagrams --------------------------------------------------------------------------------

    def _take(self, data: bytes, channel: str) -> None:
        faults, session, now_s = self._faults, self._session, self._now_s
        if self._ended or "mute" in faults:
            return
        found = decode_state(data)
        if isinstance(found, MalformedDatagram):
            self._ended = "gives-up" in faults
            session.receive(data, now_s)
            return
        self._heard_s = now_s
        self._first = self._first or found.session
        other = "one-session" in faults and found.session != self._first
        if other or ("loses-heart" in faults and self._lost):
            return
        state = session.receive(data, now_s)
        if state is None:
            self._answer_old(found)
            return
        self._said_s = now_s
        self._asked += 1
        if "lazy" in faults and not strikes(faults, "lazy", self._asked):
            return
        command = session.command(self._wanted(state), now_s)
        if command is not None:
            self._say(command, found)
            if strikes(faults, "twice", self._asked):
                self._say(command, found)

    def _answer_old(self, state: ArmState) -> None:
        """Answer an outdated state, as a driver with a fault does."""
        newest = self._session.message
        if newest is None:
            return
        earlier = state.session != newest.session
        if ("answers-earlier" if earlier else "answers-old") in self._faults:
            joints = len(newest.positions)
            hold = ArmCommand(newest.session, 0, self._now_s, ControlMode.HOLD)
            self._say(encode_command(hold, joints), newest)

    def _say(self, data: bytes, state: ArmState | None = None) -> None:
        """Send a command as a driver with these defects would."""
        if self._faults:
            command = decode_command(data)
            assert isinstance(command, ArmCommand)
            data = self._spoilt(command, data[JOINTS_AT], state)
        late_s = 1e-3 * self._faults.get("late", 0.0)
        self._later(late_s + NETWORK_S, lambda: self._hear("", data))

    def _spoilt(self, command: ArmCommand, joints: int, state: ArmState | None) -> bytes:
        faults = self._faults
        self._reported += 1
        self._sequence += int(faults.get("step-2", 1.0))
        session, mode = command.session, command.mode
        values, forward = command.values, command.feed_forward
        if session == 0 and "presumes" in faults:
            session = 1
        elif session and "old-session" in faults:
            session = self._first
        stopped = state is not None and bool(state.reason)
        if stopped and "obstinate" in faults and self._target:
            mode, forward = ControlMode.POSITION, (0.0,) * joints
            values = tuple(q + faults["obstinate"] for q in self._target)
        if mode is ControlMode.POSITION:
            values, forward = self._spoilt_positions(values, forward, state)
        if mode is ControlMode.HOLD and session and "joints" in faults:
            joints = int(faults["joints"])
        stamp_s = faults.get("clock", 1.0) * command.stamp_s
        # Only a greeting lets a client restart its count.
        reported = ArmCommand(session, self._sequence, stamp_s, mode, values, forward)
        data = encode_command(reported, joints)
        return data[:-5] if strikes(faults, "truncated", self._reported) else data

    def _spoilt_positions(
        self, values: tuple[float, ...], forward: tuple[float, ...], state: ArmState | None
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        faults = self._faults
        begins = not self._moves
        self._moves = True
        if begins and "begins-fast" in faults:
            forward = (faults["begins-fast"],) * len(forward)
        if "stale" in faults and state is not None and state.session != self._first:
            values = tuple(q + 2.0 * WAY_RAD for q in values)
        if self._reported % EVERY == 0:
            by = faults.get("beyond", 0.0) + faults.get("jump", 0.0)
            values = (values[0] + by, *values[1:])
        if "degrees" in faults:
            forward = tuple(faults["degrees"] * v for v in forward)
        return values, forward

    # -- time -------------------------------------------------------------------------------------

    def _turn(self) -> None:
        faults, now_s = self._faults, self._now_s
        if self._ended or not self._listens or "mute" in faults:
            return
        silent_s = now_s - self._heard_s
        self._lost = self._lost or silent_s > 5.0 * SILENT_S
        if now_s - self._said_s >= WAKE_S and self._session.lost(now_s):
            self._said_s, self._from = now_s, None
            if "greets-once" not in faults or not self._first:
                self._say(self._session.keepalive(now_s))
        every_s = 1e-3 * faults.get("chatters", math.inf)
        if silent_s > SILENT_S and now_s >= self._chatter_s + every_s and self._target:
            self._chatter_s = now_s
            command = self._session.command(JointCommand(self._target), now_s)
            assert command is not None
            self._say(command)

    def _by_hand(self, what: str) -> None:
        """End the driver's program."""
        if "leaves-moving" not in self._faults and not self._ended:
            words = self._session.final_command(self._now_s)
            if words is not None:
                self._say(words)
        self._ended = True
