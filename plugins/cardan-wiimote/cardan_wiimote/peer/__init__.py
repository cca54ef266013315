"""A simulated Wii Remote: its memory and sensors, its motion scripts, and ways to reach it."""

from cardan_wiimote.peer.core import (
    ExtensionName as ExtensionName,
    LogEntry as LogEntry,
    SimulatedWiimote as SimulatedWiimote,
)
from cardan_wiimote.peer.faults import (
    FAULTS as FAULTS,
)
from cardan_wiimote.peer.motion_script import (
    SCRIPT_VERBS as SCRIPT_VERBS,
    SCRIPTS as SCRIPTS,
    ScriptedWiimote as ScriptedWiimote,
)
from cardan_wiimote.peer.peer import (
    WiimotePeer as WiimotePeer,
    WiimotePeerOptions as WiimotePeerOptions,
)
