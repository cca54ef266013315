"""A simulated Wii Remote: its memory and sensors, the hand that holds it, and ways to reach it."""

from cardan.sim_peers.wiimote.core import (
    ExtensionName as ExtensionName,
    LogEntry as LogEntry,
    SimulatedWiimote as SimulatedWiimote,
)
from cardan.sim_peers.wiimote.faults import (
    FAULTS as FAULTS,
)
from cardan.sim_peers.wiimote.hand import (
    SCRIPT_VERBS as SCRIPT_VERBS,
    SCRIPTS as SCRIPTS,
    ScriptedHand as ScriptedHand,
)
from cardan.sim_peers.wiimote.peer import (
    WiimotePeer as WiimotePeer,
    WiimotePeerOptions as WiimotePeerOptions,
)
