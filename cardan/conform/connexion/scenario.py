"""Scenario in which an operator moves a 3Dconnexion device."""

from __future__ import annotations

from cardan.conform.connexion.decoded import MOTIONS
from cardan.conform.hands import HandScenario
from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Script, mark, send
from cardan.conform.timeline import WireEvent
from cardan.protocols.connexion import reports

REST_S = 0.5


class ConnexionScenario(HandScenario):
    """Reads the reports; only from level 1 on it writes, to the LED."""

    def _note(self, event: WireEvent) -> None:
        value = reports.decode_input(event.data)
        if isinstance(value, MOTIONS):
            self._moved = self._moved or any(value)
        elif isinstance(value, (reports.ButtonBits, reports.KeysDown)):
            self._pressed = True

    def script(self) -> Script:
        yield from self._begin(REST_S)
        yield from self._motions(REST_S)
        yield from self._keys()
        if self._level >= Level.HOLD:
            yield mark("led")
            for on in (True, False, True):
                yield send(reports.encode_led(on))
                yield Pause(0.1)
            yield from self._again()
        if self._level >= Level.BY_HAND:
            yield from self._unplugged()
