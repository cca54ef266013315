"""Scenario in which the user moves a SpaceOrb; it requests the identity."""

from __future__ import annotations

from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Script, mark
from cardan_serial_mice.conform.puck.scenario import REST_S, PuckScenario
from cardan_serial_mice.conform.spaceorb.packets import NULL_REGION, POLL, SpaceOrbMeaning
from cardan_serial_mice.protocol.spaceorb import HEARTBEAT_S, QUERY

BOOT_S = 2.0
"""Time from power, which the open port supplies, until the device has reported its identity."""
BEATS = 2.5
"""Heartbeats of the phase that only listens."""


class SpaceOrbScenario(PuckScenario):
    """Reads the packets; from level 1 on it also sends commands."""

    def __init__(self, level: Level, seconds: float) -> None:
        super().__init__(level, seconds, SpaceOrbMeaning())

    def script(self) -> Script:
        yield from self._begin(BOOT_S)
        yield mark("beats")
        yield Pause(BEATS * HEARTBEAT_S)
        yield from self._motions(REST_S)
        yield from self._keys()
        if self._level >= Level.HOLD:
            yield from self._asked((QUERY, NULL_REGION, POLL))
            yield from self._again()
        if self._level >= Level.BY_HAND:
            yield from self._unplugged()
