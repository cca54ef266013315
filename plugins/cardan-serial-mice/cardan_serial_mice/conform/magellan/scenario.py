"""Scenario in which the user moves a Magellan; it requests identity and settings."""

from __future__ import annotations

from cardan.conform.hands import HandScenario
from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Script, mark, send
from cardan.conform.timeline import WireEvent
from cardan_serial_mice.protocol import (
    MagellanKeys,
    MagellanMotion,
    MagellanReader,
    Malformed,
)
from cardan_serial_mice.protocol.magellan import (
    EXTENDED_COMPRESSED,
    MODE_3D,
    QUERY_EXTENDED,
    QUERY_KEYS,
    QUERY_VERSION,
)

BOOT_S = 1.2
"""Time from power, which the open port supplies, until a device receives commands."""
REST_S = 0.6
ANSWER_S = 0.6
UNKNOWN = b"y0"
"""Not a valid command."""


class MagellanScenario(HandScenario):
    """Reads the packets; from level 1 on it also sends commands."""

    def __init__(self, level: Level, seconds: float) -> None:
        super().__init__(level, seconds)
        self._reader = MagellanReader()
        self._answered = False

    def _note(self, event: WireEvent) -> None:
        for value in self._reader.feed(event.data):
            if isinstance(value, MagellanMotion):
                self._moved = self._moved or any(value)
            elif isinstance(value, MagellanKeys):
                self._pressed = True
            if not isinstance(value, (MagellanMotion, Malformed)):
                self._answered = True

    def script(self) -> Script:
        yield from self._begin(BOOT_S)
        yield from self._motions(REST_S)
        yield from self._keys()
        if self._level >= Level.HOLD:
            yield mark("ask")
            # An empty command ends one that another program may have begun.
            yield send(b"\r")
            yield Pause(0.05)
            for command in (QUERY_VERSION, MODE_3D, EXTENDED_COMPRESSED, QUERY_KEYS, UNKNOWN):
                yield from self._send_command(command)
            yield from self._again()
            yield mark("ask-again")
            yield from self._send_command(QUERY_EXTENDED)
        if self._level >= Level.BY_HAND:
            yield from self._unplugged()

    def _send_command(self, command: bytes) -> Script:
        self._answered = False
        yield send(command + b"\r")
        yield Pause(ANSWER_S, lambda: self._answered or self._gone)
        yield Pause(0.02)
