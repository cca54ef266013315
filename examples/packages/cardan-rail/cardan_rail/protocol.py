"""Datagrams of the rail's controller, little-endian. Decoding returns a value, or a reason.

The controller sends a state in each of its cycles; a command answers a state and repeats its
number. The command has the positions for the next cycle. Without a command the axes keep their
speed; after 40 ms they brake, and no command acts until they rest and a new session begins.
"""

from __future__ import annotations

import enum
import math
import struct
from typing import NamedTuple

PERIOD_S = 0.008
BRAKES_AFTER_S = 0.04
"""Time without a command after which the controller brakes."""

Positions = tuple[float, float, float]

_STATE = struct.Struct("<4sIIB3d")
_COMMAND = struct.Struct("<4sIIB3d")
_STATE_MAGIC, _COMMAND_MAGIC = b"RLS1", b"RLC1"
LARGEST_STATE = _STATE.size


class Condition(enum.IntEnum):
    """State of the controller; it decides whether commands act."""

    FOLLOWING = 0
    """Commands act."""
    BRAKING = 1
    EMERGENCY_STOP = 2
    TOO_FAST = 3
    """An axis was commanded to exceed its speed; cleared by a restart."""


class RailState(NamedTuple):
    """Measurement of the controller in one cycle."""

    session: int
    """Incremented at every start of the controller, and after a braking by itself; wraps at 2^32.
    Commands of another session do not act."""
    sequence: int
    """Number of the cycle in the session; wraps at 2^32."""
    condition: Condition
    positions: Positions
    """Axis positions, m."""


class RailCommand(NamedTuple):
    """Answer to a state."""

    session: int
    """Session of the state; 0 in the greeting, which requests states and moves nothing."""
    sequence: int
    positions: Positions | None
    """Axis positions for the next cycle, m; None: brake and rest."""


def encode_state(state: RailState) -> bytes:
    return _STATE.pack(_STATE_MAGIC, *state[:3], *state.positions)


def decode_state(data: bytes) -> RailState | str:
    if len(data) != _STATE.size:
        return f"{len(data)} bytes; a state has {_STATE.size}"
    magic, session, sequence, condition, x, y, z = _STATE.unpack(data)
    if magic != _STATE_MAGIC:
        return "not a state of the rail"
    if condition not in tuple(Condition):
        return f"there is no condition {condition}"
    if not all(map(math.isfinite, (x, y, z))):
        return "positions that are not numbers"
    return RailState(session, sequence, Condition(condition), (x, y, z))


def encode_command(command: RailCommand) -> bytes:
    follow, positions = command.positions is not None, command.positions or (0.0, 0.0, 0.0)
    return _COMMAND.pack(_COMMAND_MAGIC, command.session, command.sequence, follow, *positions)


def decode_command(data: bytes) -> RailCommand | str:
    if len(data) != _COMMAND.size:
        return f"{len(data)} bytes; a command has {_COMMAND.size}"
    magic, session, sequence, follow, x, y, z = _COMMAND.unpack(data)
    if magic != _COMMAND_MAGIC:
        return "not a command to the rail"
    if not all(map(math.isfinite, (x, y, z))):
        return "positions that are not numbers"
    return RailCommand(session, sequence, (x, y, z) if follow else None)
