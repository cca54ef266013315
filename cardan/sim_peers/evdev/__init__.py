"""Simulated gamepad or keyboard: the hardware, the kernel's part, and motion scripts."""

from cardan.sim_peers.evdev.core import SimulatedInput as SimulatedInput
from cardan.sim_peers.evdev.faults import FAULTS as FAULTS
from cardan.sim_peers.evdev.models import MODELS as MODELS
from cardan.sim_peers.evdev.motion_script import (
    SCRIPT_VERBS as SCRIPT_VERBS,
    SCRIPTS as SCRIPTS,
    ScriptedInput as ScriptedInput,
)
from cardan.sim_peers.evdev.peer import (
    EvdevPeer as EvdevPeer,
    EvdevPeerOptions as EvdevPeerOptions,
)
