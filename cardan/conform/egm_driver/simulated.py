"""Our own driver with selected defects, and a scenario in virtual time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial

from cardan.conform.egm_driver.scenario import FIRST, SECOND
from cardan.conform.runner import Exchange
from cardan.conform.simulation import DriverSimulation
from cardan.drivers.abb_egm.options import AbbEgmOptions
from cardan.drivers.abb_egm.session import EgmSession
from cardan.protocols.egm.decode import decode_robot
from cardan.sim_peers.egm_client import FAULTS, EgmClientDefects
from cardan.types import HoldCommand

_PORTS = {FIRST: 49_152, SECOND: 49_153}
_CHANNELS = {port: channel for channel, port in _PORTS.items()}


class EgmDriverSimulation(DriverSimulation):
    """Connects the driver's core to the scenario, with the defects between them."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        super().__init__(exchange, faults, FAULTS)
        self._session = EgmSession(AbbEgmOptions(comm_timeout_s=5.0), 0.0)
        self._defects = EgmClientDefects(faults)

    def _take(self, data: bytes, channel: str) -> None:
        session, now_s = self._session, self._now_s
        message = decode_robot(data)
        if not self._defects.hears(message, channel == FIRST, now_s):
            return
        state = session.receive(data, ("127.0.0.1", _PORTS[channel]), now_s)
        if session.handover is not None:
            words, (_, port) = session.handover
            session.handover = None
            self._send((words,), _CHANNELS[port])
        session.tick(now_s)
        if state is None:
            self._send(self._defects.ignored(message), channel)
            return
        answer = session.reply(HoldCommand(), now_s)
        session.answered(now_s)
        self._send(self._defects.said(answer, message), channel)

    def _send(self, found: Iterable[bytes], channel: str) -> None:
        for data in found:
            late_s = 1e-3 * self._faults.get("late", 0.2)
            self._later(late_s, partial(self._hear, channel, data))

    def _turn(self) -> None:
        self._send(self._defects.unasked(self._now_s), FIRST)

    def _by_hand(self, what: str) -> None:
        """End the driver's program, with a last message if an answer is pending."""
        words = self._defects.last(self._session.final_command(self._now_s))
        if words is not None:
            self._send((words,), SECOND)
