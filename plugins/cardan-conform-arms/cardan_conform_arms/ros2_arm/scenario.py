"""Scenario for a ROS 2 arm: listen, hold it in place, and move every joint a little."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Scenario, Script, Step, ask, mark, open_, send
from cardan.conform.timeline import Kind, WireEvent
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.messages import default_message
from cardan_conform_arms.ros2_arm.names import COMMANDS, DESCRIPTION, STATES, TOPICS, joints_of

STEP_RAD = 3.5e-4
"""Step of every joint at once: 0.02 degrees, less than a millimeter at the TCP of any arm."""
STEP_S = 0.6
COMMAND_S = 0.02
HAND_S = 60.0
_STATE = codec_of(TOPICS[STATES].type)
_TEXT = codec_of(TOPICS[DESCRIPTION].type)
_COMMAND = codec_of(TOPICS[COMMANDS].type)


class RosArmScenario(Scenario):
    """Program that commands positions, joint by joint in the description's order."""

    def __init__(self, level: Level, seconds: float) -> None:
        self._level = level
        self._seconds = seconds
        self._order: dict[str, str] = {}
        self._positions: dict[str, float] = {}
        self._at: list[float] = []
        self._heard_s = 0.0

    def answer(self, event: WireEvent) -> Iterator[Step]:
        if event.kind is Kind.DATA and event.channel == DESCRIPTION:
            text = _TEXT.decode(event.data)
            if not isinstance(text, MalformedCdr):
                self._order = joints_of(text["data"])
        elif event.kind is Kind.DATA and event.channel == STATES:
            message = _STATE.decode(event.data)
            if not isinstance(message, MalformedCdr):
                self._heard_s = self.now_s
                pairs = zip(message["name"], message["position"], strict=False)
                self._positions.update((k, v) for k, v in pairs if math.isfinite(v))
        return iter(())

    def _command(self, positions: Sequence[float]) -> Step:
        message = default_message(TOPICS[COMMANDS].type) | {"data": list(positions)}
        return send(_COMMAND.encode(message), COMMANDS)

    def _holding(self, seconds: float) -> Script:
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            yield self._command(self._at)
            yield Pause(COMMAND_S)

    def script(self) -> Script:
        yield open_(STATES)
        yield open_(DESCRIPTION)
        yield mark("listen")
        yield Pause(self._seconds)
        names = [name for name in self._order if name in self._positions]
        if self._level < Level.HOLD or not names:
            return
        yield open_(COMMANDS)
        yield Pause(0.2)
        self._at = [self._positions[name] for name in names]
        yield mark("hold")
        yield from self._holding(self._seconds)
        if self._level >= Level.MOVE:
            for name, sign in (("out", 1.0), ("back", -1.0)):
                yield mark(name)
                self._at = [q + sign * STEP_RAD for q in self._at]
                yield from self._holding(STEP_S)
        if self._level >= Level.BY_HAND:
            yield mark("gone")
            yield ask("end", "End the nodes of the arm.")
            yield Pause(HAND_S, lambda: self.now_s - self._heard_s > 0.5)
