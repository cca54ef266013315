"""Scenario in which the user moves a serial six-axis device; it requests the identity."""

from __future__ import annotations

from typing import Any

from cardan.conform.hands import HandScenario
from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Script, mark, send
from cardan.conform.timeline import WireEvent
from cardan_serial_mice.conform.puck.decoded import PacketMeaning

REST_S = 0.6
ANSWER_S = 0.6


class PuckScenario(HandScenario):
    """Reads the packets; from level 1 on it also sends commands."""

    def __init__(self, level: Level, seconds: float, meaning: PacketMeaning[Any]) -> None:
        super().__init__(level, seconds)
        self._meaning, self._reader = meaning, meaning.reader()
        self._command = b""
        self._answered = False

    def _note(self, event: WireEvent) -> None:
        for value in self._reader.feed(event.data):
            self._moved = self._moved or any(self._meaning.counts(value))
            mask = self._meaning.mask(value)
            # Some devices report their keys every second, even unchanged.
            if mask is not None and bool(mask) == (self._key == "press"):
                self._pressed = True
            if self._command and self._meaning.answers(value, self._command):
                self._answered = True

    def _send_command(self, command: bytes, within_s: float = ANSWER_S) -> Script:
        self._answered, self._command = False, command
        yield send(command + b"\r")
        yield Pause(within_s, lambda: self._answered or self._gone)
        yield Pause(0.02)

    def _asked(self, commands: tuple[bytes, ...]) -> Script:
        yield mark("ask")
        # An empty command ends one that another program may have begun.
        yield send(b"\r")
        yield Pause(0.05)
        for command in commands:
            yield from self._send_command(command)
