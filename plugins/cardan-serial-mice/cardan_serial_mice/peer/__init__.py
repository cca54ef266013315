"""Simulated serial devices."""

from cardan_serial_mice.peer.core import (
    SimulatedSerialPuck as SimulatedSerialPuck,
    simulated_serial_puck as simulated_serial_puck,
)
from cardan_serial_mice.peer.line import (
    SERIAL_FAULTS as SERIAL_FAULTS,
)
from cardan_serial_mice.peer.peer import (
    SerialPuckPeer as SerialPuckPeer,
    SerialPuckPeerOptions as SerialPuckPeerOptions,
)
