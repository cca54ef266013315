"""Fast check that a datagram is as valid as a previous one, for the statistics of a capture.

Only its tags, the lengths and widths of numbers, its type, and finite doubles decide whether a
datagram can be decoded. A datagram that shares these with a decoded one is therefore valid. Any
other needs the full decoder.
"""

from __future__ import annotations

from typing import NamedTuple

from cardan.protocols.egm import schema
from cardan.protocols.egm.messages import EgmRobot, EgmSensor, EgmSensorPathCorr
from cardan.protocols.egm.reader import UnusualError, leaves, number

_SEQNO, _TM, _MTYPE = (1, 1), (1, 2), (1, 3)
"""Field numbers in all three messages."""

_EXPONENT = 0x7FF0_0000_0000_0000
"""Bits of a double's exponent."""

_from_bytes = int.from_bytes


class Outline(NamedTuple):
    """Common bits of datagrams of a certain length, each field a little-endian number."""

    looked_at: int
    """Mask of the bits that must be equal, and of the exponents of the doubles."""
    lowest: int
    """Summand that carries an exponent of ones (infinity and NaN) into the sign."""
    mask: int
    """Mask of the bits that must be equal, and of the signs of the doubles."""
    fixed: int
    seqno: slice
    tm: slice

    def header(self, data: bytes) -> tuple[int, int] | None:
        """Return sequence number and clock (ms; 0 if absent) of a datagram that is as valid as the
        learned one; None for any other."""
        looked_at, lowest, mask, fixed, seqno, tm = self
        if (_from_bytes(data, "little") & looked_at) + lowest & mask != fixed:
            return None
        return number(data[seqno]) & 0xFFFFFFFF, number(data[tm]) & 0xFFFFFFFF


def outline(data: bytes, value: EgmRobot | EgmSensor | EgmSensorPathCorr) -> Outline | None:
    """Learn the outline of `data`, which was decoded to `value`; None if it is too unusual or has
    no sequence number."""
    if isinstance(value, EgmRobot):
        force = value.measured_force
        message = schema.RobotRW6 if force is not None and force.fc_active is None else schema.Robot
    else:
        message = schema.Sensor if isinstance(value, EgmSensor) else schema.SensorPathCorr
    mask = bytearray(b"\xff" * len(data))
    exponents = 0
    places: dict[tuple[int, ...], slice] = {_TM: slice(0)}
    try:
        for path, at, size, is_double in leaves(data, message.DESCRIPTOR):
            if is_double:
                mask[at : at + size] = bytes(size)
                exponents |= _EXPONENT << 8 * at
            elif path != _MTYPE:
                mask[at : at + size] = b"\x80" * size
            places[path] = slice(at, at + size)
    except (UnusualError, IndexError):
        return None
    if _SEQNO not in places:
        return None
    ones = _from_bytes(mask, "little")
    lowest = exponents & ~(exponents << 1)
    fixed = _from_bytes(data, "little") & ones
    retained = ones | lowest << 11
    return Outline(ones | exponents, lowest, retained, fixed, places[_SEQNO], places[_TM])
