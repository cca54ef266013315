"""Numbers of the spacenavd protocol: requests, event masks, device types.

Source: spacenavd's and libspnav's description of the protocol (FreeSpacenav).
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from types import MappingProxyType

DEFAULT_SOCKET = "/var/run/spnav.sock"
"""Socket of spacenavd and its clients, unless SPNAV_SOCKET names another path."""

NEWEST_VERSION = 1
"""Version 0 has no handshake, motion and buttons only; version 1 adds requests."""

REQUEST_TAG = 0x7FAA0000
"""Upper half of a request's first word, set by libspnav and ignored by servers."""


class Code(enum.IntEnum):
    """Code of a request: the lower half of its first word."""

    SET_NAME = 0x1000
    SET_SENS = 0x1001
    GET_SENS = 0x1002
    SET_EVMASK = 0x1003
    GET_EVMASK = 0x1004
    DEV_NAME = 0x2000
    DEV_PATH = 0x2001
    DEV_NAXES = 0x2002
    DEV_NBUTTONS = 0x2003
    DEV_USBID = 0x2004
    DEV_TYPE = 0x2005
    SCFG_SENS = 0x3000
    GCFG_SENS = 0x3001
    SCFG_SENS_AXIS = 0x3002
    GCFG_SENS_AXIS = 0x3003
    SCFG_DEADZONE = 0x3004
    GCFG_DEADZONE = 0x3005
    SCFG_INVERT = 0x3006
    GCFG_INVERT = 0x3007
    SCFG_AXISMAP = 0x3008
    GCFG_AXISMAP = 0x3009
    SCFG_BNMAP = 0x300A
    GCFG_BNMAP = 0x300B
    SCFG_BNACTION = 0x300C
    GCFG_BNACTION = 0x300D
    SCFG_KBMAP = 0x300E
    GCFG_KBMAP = 0x300F
    SCFG_SWAPYZ = 0x3010
    GCFG_SWAPYZ = 0x3011
    SCFG_LED = 0x3012
    GCFG_LED = 0x3013
    SCFG_GRAB = 0x3014
    GCFG_GRAB = 0x3015
    SCFG_SERDEV = 0x3016
    GCFG_SERDEV = 0x3017
    SCFG_REPEAT = 0x3018
    GCFG_REPEAT = 0x3019
    CFG_SAVE = 0x3FFE
    CFG_RESTORE = 0x3FFF
    CFG_RESET = 0x4000


class EventMask(enum.IntFlag):
    """Events that a client of version 1 gets."""

    MOTION = 0x01
    BUTTON = 0x02
    DEVICE = 0x04
    CONFIG = 0x08
    RAW_AXIS = 0x10
    RAW_BUTTON = 0x20


MASK_V1 = EventMask.MOTION | EventMask.BUTTON | EventMask.DEVICE
"""Events of a client after the handshake, until it sets its own mask."""


class LedMode(enum.IntEnum):
    """Values of SCFG_LED and GCFG_LED."""

    OFF = 0
    ON = 1
    AUTO = 2
    """LED on while a client is connected."""


UNKNOWN_DEVICE = 0

_SERIAL_DEVICES = (
    "Spaceball 1003/2003", "Spaceball 3003", "Spaceball 4000 FLX", "Magellan SpaceMouse",
    "Spaceball 5000 (serial)", "CadMan (serial)",
)  # fmt: skip
_USB_DEVICES = (
    "SpaceMouse Plus XT", "CadMan", "SpaceMouse Classic", "Spaceball 5000", "SpaceTraveler",
    "SpacePilot", "SpaceNavigator", "SpaceExplorer", "SpaceNavigator for Notebooks",
    "SpacePilot Pro", "SpaceMouse Pro", "NuLOOQ", "SpaceMouse Wireless", "SpaceMouse Pro Wireless",
    "SpaceMouse Enterprise", "SpaceMouse Compact", "SpaceMouse Module",
)  # fmt: skip

DEVICE_TYPES: Mapping[int, str] = MappingProxyType(
    {
        UNKNOWN_DEVICE: "unknown",
        **dict(enumerate(_SERIAL_DEVICES, 0x100)),
        **dict(enumerate(_USB_DEVICES, 0x200)),
    }
)
"""Answers to DEV_TYPE."""
