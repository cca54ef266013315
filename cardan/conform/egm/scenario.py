"""Scenario for an EGM controller: listen, hold, step by half a millimeter, stop by hand."""

from __future__ import annotations

import math
from collections.abc import Iterator

from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Scenario, Script, Step, ask, mark, open_, send
from cardan.conform.timeline import Kind, WireEvent
from cardan.protocols.egm import decode, encode, messages as m

STEP_M = 0.0005
STEP_RAD = math.radians(0.1)
"""Step of the last joint; the program's mode decides which of the two steps acts."""
STEP_S = 1.2
"""Five time constants of the default gain."""
QUIET_S = 0.5
"""A run is over after this time without a datagram."""
ENDS_S = 3.0
"""An unanswered run ends in this time, and the next begins: three times RAPID's CommTimeout."""
HAND_S = 60.0
"""Time for the operator to follow an instruction."""

JUNK = (b"\x00", b"GET / HTTP/1.1\r\n\r\n", bytes(range(255, 55, -1)), b"\x0a\x06\x08")
"""Nothing, another protocol, noise, and the beginning of a message."""


class EgmScenario(Scenario):
    """A harmless PC. It answers each datagram at once, with the position that it holds."""

    def __init__(self, level: Level, seconds: float) -> None:
        self._level = level
        self._seconds = seconds
        self._answering = False
        self._shift = 0.0
        """Commanded share of the step."""
        self._hold: m.EgmMotion | None = None
        self._newest: m.EgmRobot | None = None
        self._newest_s = -math.inf
        self._seqno = 0

    def script(self) -> Script:
        yield open_("")
        yield mark("listen")
        # Long enough to meet the next run if the run before times out without answers.
        yield Pause(0.6 * self._seconds)
        if self._level >= Level.HOLD:
            yield from self._holding()
        if self._level >= Level.MOVE:
            self._answering = True
            yield mark("step")
            self._shift = 1.0
            yield Pause(STEP_S)
            yield mark("back")
            self._shift = 0.0
            yield Pause(STEP_S)
        if self._level >= Level.BY_HAND:
            yield mark("estop")
            yield ask("estop", "Press the emergency stop.")
            yield Pause(HAND_S, lambda: self._quiet() or not self._motors())
            yield Pause(QUIET_S)
            yield mark("released")
            instruction = "Release it, switch the motors on and start the program."
            yield ask("release", instruction)
            yield Pause(HAND_S, self._runs)
            yield Pause(QUIET_S)

    def _holding(self) -> Script:
        patience_s = max(self._seconds, ENDS_S)
        yield mark("hold")
        self._answering = True
        yield Pause(patience_s, self._runs)
        yield Pause(self._seconds)
        yield mark("junk")
        for data in JUNK:
            yield send(data)
            yield Pause(0.05)
        yield mark("silence")
        self._answering = False
        yield Pause(patience_s, lambda: self._quiet() or not self._runs())
        yield mark("again")
        self._hold = None
        self._answering = True
        yield Pause(patience_s, self._runs)
        yield Pause(QUIET_S)

    def answer(self, event: WireEvent) -> Iterator[Step]:
        if event.kind is not Kind.DATA:
            return
        message = decode.decode_robot(event.data)
        if not isinstance(message, m.EgmRobot):
            return
        begins = message.header is not None and message.header.seqno == 0
        if self._quiet() or begins or message.mci_state != m.MCIState.RUNNING:
            self._hold = None
        self._newest, self._newest_s = message, self.now_s
        if self._answering and message.feed_back is not None and message.header is not None:
            self._hold = self._hold or message.feed_back
            self._seqno += 1
            header = m.EgmHeader(self._seqno, message.header.tm_ms, m.EgmMessageType.CORRECTION)
            yield send(encode.encode_sensor(m.EgmSensor(header, self._reference(self._hold))))

    def _reference(self, held: m.EgmMotion) -> m.EgmMotion:
        joints, pose = held.joints, held.cartesian
        if joints is not None and len(joints) >= 6:
            joints = (*joints[:5], joints[5] + self._shift * STEP_RAD, *joints[6:])
        if pose is not None and pose.pos is not None:
            x, y, z = pose.pos
            lifted = type(pose.pos)(x, y, z + self._shift * STEP_M)
            pose = pose._replace(pos=lifted, euler=None)
        return m.EgmMotion(joints, pose, held.external_joints)

    def _quiet(self) -> bool:
        return self.now_s - self._newest_s > QUIET_S

    def _runs(self) -> bool:
        newest = self._newest
        return newest is not None and not self._quiet() and newest.mci_state == m.MCIState.RUNNING

    def _motors(self) -> bool:
        return self._newest is not None and self._newest.motor_state == m.MotorState.ON
