"""Scenario in which a Spaceball is reset and set up, and the user moves it."""

from __future__ import annotations

from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Script, mark
from cardan_serial_mice.conform.puck.scenario import REST_S, PuckScenario
from cardan_serial_mice.conform.spaceball.packets import UNKNOWN, SpaceballMeaning
from cardan_serial_mice.protocol.spaceball import (
    BINARY,
    QUERY_KEYS,
    RATE_20_HZ,
    RESET,
    SEND_VECTORS,
)

BOOT_S = 2.0
"""Time from power, which the open port supplies, until the device has reported its identity."""
RESET_S = 2.5


class SpaceballScenario(PuckScenario):
    """Without a command a Spaceball reports its buttons only; motion needs level 1."""

    def __init__(self, level: Level, seconds: float) -> None:
        super().__init__(level, seconds, SpaceballMeaning())

    def script(self) -> Script:
        yield from self._begin(BOOT_S)
        yield from self._keys()
        if self._level >= Level.HOLD:
            yield mark("reset")
            yield from self._send_command(RESET, RESET_S)
            yield Pause(0.1)
            yield from self._asked((BINARY, RATE_20_HZ, SEND_VECTORS, QUERY_KEYS, UNKNOWN))
            yield from self._motions(REST_S)
        if self._level >= Level.BY_HAND:
            yield from self._unplugged()
