"""The suite of a JR3 sensor on a CAN bus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.requirements import Level
from cardan.conform.runner import Exchange
from cardan.conform.suite import Suite, SuiteTransport
from cardan.conform.timeline import WireTimeline
from cardan.conform.transports import Wires
from cardan.errors import ConfigurationError
from cardan_jr3.conform.decoded import Jr3Traffic
from cardan_jr3.conform.frames import unpack
from cardan_jr3.conform.requirements import requires
from cardan_jr3.conform.scenario import Jr3Scenario
from cardan_jr3.conform.simulated import Jr3Simulation
from cardan_jr3.conform.wire import CanInterface
from cardan_jr3.protocol import (
    MAX_NODE_ID,
    NODE_MASK,
    TEO_NODE_IDS,
    decode_from_board,
    decode_from_host,
)


class Jr3(Suite[Jr3Traffic]):
    """A JR3 force-torque sensor behind uc3m's board."""

    name = "jr3"
    judges = "the board"
    speaks = "CAN frames of jr3-mbed-firmware"
    target = "INTERFACE[:NODE], as can0:33; Linux only"
    peer = "jr3"
    requirements = requires.all()
    transport = SuiteTransport("can")
    seconds = 2.0
    # Times count from the command to acquire.
    fault_test_values: ClassVar[Mapping[str, float]] = {
        "sensor-unplug": 1.5,
        "power-cycle": 1.5,
        "silence": 1.5,
        "stopped": 1.5,
    }

    def __init__(self) -> None:
        self._node_id = TEO_NODE_IDS["right-hand"]

    def decode(self, timeline: WireTimeline) -> Jr3Traffic:
        return Jr3Traffic(timeline, self._node_id)

    def scenario(self, level: Level, seconds: float) -> Jr3Scenario:
        return Jr3Scenario(level, seconds, self._node_id)

    def simulate(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        Jr3Simulation(exchange, self._node_id, faults, seed).run()

    def asks_it(self, frame: bytes) -> bool | None:
        found = unpack(frame)
        if found is None or found.arbitration_id & NODE_MASK not in (0, self._node_id):
            return None
        if decode_from_board(*found) is not None:
            return False
        return None if decode_from_host(*found) is None else True

    def wires(self, target: str) -> Wires:
        name, colon, node = target.partition(":")
        if colon:
            if not node.isdigit() or not 0 < int(node) <= MAX_NODE_ID:
                raise ConfigurationError(
                    "--target", f"{node!r} is not a node of 1 to {MAX_NODE_ID}"
                )
            self._node_id = int(node)
        return CanInterface(name)
