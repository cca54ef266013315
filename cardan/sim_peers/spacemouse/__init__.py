"""A simulated 3Dconnexion device: the puck, the hands that move it, and the ways to open it."""

from cardan.sim_peers.spacemouse.core import (
    SimulatedSpaceMouse as SimulatedSpaceMouse,
)
from cardan.sim_peers.spacemouse.faults import (
    FAULTS as FAULTS,
)
from cardan.sim_peers.spacemouse.hand import (
    SCRIPT_VERBS as SCRIPT_VERBS,
    SCRIPTS as SCRIPTS,
    ScriptedPuck as ScriptedPuck,
)
from cardan.sim_peers.spacemouse.keyboard import (
    KeyboardHand as KeyboardHand,
)
from cardan.sim_peers.spacemouse.peer import (
    SpaceMousePeer as SpaceMousePeer,
    SpaceMousePeerOptions as SpaceMousePeerOptions,
)
