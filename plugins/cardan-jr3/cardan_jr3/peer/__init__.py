"""A simulated JR3 force-torque sensor: the board, the loads on it, and its place on a CAN bus."""

from cardan.sim_peers.jr3.core import (
    SimulatedJr3 as SimulatedJr3,
)
from cardan.sim_peers.jr3.faults import (
    FAULTS as FAULTS,
)
from cardan.sim_peers.jr3.hand import (
    SCRIPT_VERBS as SCRIPT_VERBS,
    SCRIPTS as SCRIPTS,
    ScriptedHand as ScriptedHand,
)
from cardan.sim_peers.jr3.peer import (
    Jr3Peer as Jr3Peer,
    Jr3PeerOptions as Jr3PeerOptions,
)
