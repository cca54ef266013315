"""Faults of a simulated input device."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.errors import ScriptError
from cardan.sim_peers import base
from cardan.sim_peers.base import FaultSwitch
from cardan.sim_peers.evdev.models import InputDeviceModel

FAULTS = (
    FaultSwitch("unplug", "the device vanishes at VALUE s, whatever it is doing", 3.0),
    FaultSwitch("replug", "the device that vanished is back at VALUE s", 4.0, after="unplug"),
    FaultSwitch("silence", "no more events from VALUE s on, without any notice", 3.0),
    FaultSwitch("stuck-axis", "the left stick stays where it is at VALUE s", 3.0),
    FaultSwitch("stuck-button", "what is down at VALUE s stays down", 3.0),
    FaultSwitch("drift", "the sticks rest VALUE of the full scale off center", 0.2, -1.0, 1.0),
    FaultSwitch("dropped", "SYN_DROPPED in the place of every VALUE-th frame", 50.0, 1.0),
    FaultSwitch("short", "every VALUE-th packet is cut short", 50.0, 1.0),
    FaultSwitch("garbage", "before every VALUE-th packet one of random bytes", 50.0, 1.0),
    FaultSwitch("refuse-rumble", "takes no effects"),
)

SOCKET_ONLY = frozenset({"dropped", "short", "garbage", "refuse-rumble"})
"""Faults in the kernel's part, which do not apply to a uinput device."""
_STICK_FAULTS = ("stuck-axis", "drift", "refuse-rumble")


def check_faults(faults: Mapping[str, float], model: InputDeviceModel, *, uinput: bool) -> None:
    """Raise ScriptError for an unknown fault, or one that this device cannot have."""
    base.check_faults(faults, FAULTS)
    for name in faults:
        if uinput and name in SOCKET_ONLY:
            raise ScriptError(f"fault {name}: the kernel does not let a uinput device have it")
        if name in _STICK_FAULTS and not model.is_gamepad:
            raise ScriptError(f"fault {name}: {model.name} has neither sticks nor motors")
