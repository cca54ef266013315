"""Scenario for an arm over the joint stream: greet, hold, and move every joint a little."""

from __future__ import annotations

from collections.abc import Iterator

from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Scenario, Script, Step, ask, mark, open_, send
from cardan.conform.timeline import Kind, WireEvent
from cardan.protocols.joint_stream.codec import (
    ArmCommand,
    ArmState,
    ControlMode,
    decode_state,
    encode_command,
)

STEP_RAD = 3.5e-4
"""Step of every joint at once: 0.02 degrees, less than a millimeter at the TCP of any arm."""
STEP_S = 0.5
SPEED_RAD_S = 2e-3
MOVING_S = 0.15
COME_S = 2.0
FAR_RAD = 1e3
"""Outside of every range."""
HAND_S = 60.0
FOREIGN_SESSIONS = 7
"""Offsets of foreign session numbers from the arm's."""


class JointStreamScenario(Scenario):
    """A client that answers every state with a command."""

    def __init__(self, level: Level, seconds: float) -> None:
        self._level = level
        self._seconds = seconds
        self._state: ArmState | None = None
        self._heard_s = 0.0
        self._sequence = 0
        self._mode: ControlMode | None = None
        """Mode of the command that answers every state; None: no answer."""
        self._at: tuple[float, ...] = ()
        self._speed = 0.0

    def answer(self, event: WireEvent) -> Iterator[Step]:
        if event.kind is not Kind.DATA:
            return
        state = decode_state(event.data)
        if not isinstance(state, ArmState):
            return
        self._state, self._heard_s = state, self.now_s
        if self._mode is not None:
            yield self._command(self._mode, state)

    def _command(self, mode: ControlMode, state: ArmState, session: int | None = None) -> Step:
        self._sequence += 1
        joints = len(state.positions)
        values: tuple[float, ...] = ()
        forward: tuple[float, ...] = ()
        if mode is ControlMode.POSITION:
            self._at = self._at or state.positions
            values, forward = self._at, (0.0,) * joints
        elif mode is ControlMode.VELOCITY:
            values = (self._speed,) * joints
        number = state.session if session is None else session
        command = ArmCommand(number, self._sequence, self.now_s, mode, values, forward)
        return send(encode_command(command, joints))

    def _greeting(self) -> Step:
        self._sequence = 1
        greeting = ArmCommand(0, 1, self.now_s, ControlMode.HOLD)
        return send(encode_command(greeting, 1))

    def script(self) -> Script:
        yield open_("")
        yield mark("listen")
        yield Pause(0.3)
        if self._level < Level.HOLD:
            return
        yield mark("greet")
        yield self._greeting()
        yield Pause(COME_S, lambda: self._state is not None)
        if self._state is None:
            return
        yield mark("idle")
        yield Pause(0.3)
        self._mode = ControlMode.POSITION
        yield mark("settle")
        yield Pause(0.4)
        yield mark("hold")
        yield Pause(self._seconds)
        yield from self._refused()
        yield mark("silence")
        self._mode = None
        yield Pause(1.5)
        yield mark("quiet")
        yield Pause(0.3)
        yield mark("greet-again")
        self._at = ()
        yield self._greeting()
        yield Pause(0.2)
        if self._level >= Level.MOVE:
            yield from self._moving()
        if self._level >= Level.BY_HAND:
            self._mode = ControlMode.POSITION
            yield mark("estop")
            yield ask("estop", "Stop the arm by its emergency stop.")
            yield Pause(HAND_S, lambda: bool(self._state and self._state.reason))
            yield Pause(0.3)

    def _refused(self) -> Script:
        """Send datagrams that change nothing or are refused."""
        state = self._state
        assert state is not None
        yield mark("junk")
        for data in (b"CJST", b"\x00" * 24, b"GET / HTTP/1.1\r\n\r\n"):
            yield send(data)
            yield Pause(0.02)
        yield mark("foreign")
        self._mode, self._speed = None, SPEED_RAD_S
        other = (state.session + FOREIGN_SESSIONS) & 0xFFFFFFFF
        for _ in range(3):
            yield self._command(ControlMode.VELOCITY, state, session=other)
            yield Pause(0.02)
        self._mode = ControlMode.POSITION
        yield Pause(0.05)
        yield mark("beyond")
        held, self._at = self._at, (FAR_RAD,) * len(state.positions)
        self._mode = None
        yield self._command(ControlMode.POSITION, state)
        yield Pause(0.05)
        self._at, self._mode = held, ControlMode.POSITION
        yield Pause(0.1)

    def _moving(self) -> Script:
        self._mode = ControlMode.POSITION
        yield mark("before")
        yield Pause(STEP_S)
        for name, sign in (("out", 1.0), ("back", -1.0)):
            yield mark(name)
            self._at = tuple(q + sign * STEP_RAD for q in self._at)
            yield Pause(STEP_S)
        yield mark("speed")
        self._mode, self._speed = ControlMode.VELOCITY, SPEED_RAD_S
        yield Pause(MOVING_S)
        yield mark("stop")
        self._speed = 0.0
        yield Pause(0.1)
        yield mark("deserted")
        self._speed = SPEED_RAD_S
        yield Pause(0.05)
        self._mode = None
        yield Pause(0.5)
