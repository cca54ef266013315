"""Simulated JR3 force-torque sensor: the board, the loads on it, and its node on a CAN bus."""

from cardan_jr3.peer.core import (
    SimulatedJr3 as SimulatedJr3,
)
from cardan_jr3.peer.faults import (
    FAULTS as FAULTS,
)
from cardan_jr3.peer.motion_script import (
    SCRIPT_VERBS as SCRIPT_VERBS,
    SCRIPTS as SCRIPTS,
    ScriptedJr3 as ScriptedJr3,
)
from cardan_jr3.peer.peer import (
    Jr3Peer as Jr3Peer,
    Jr3PeerOptions as Jr3PeerOptions,
)
