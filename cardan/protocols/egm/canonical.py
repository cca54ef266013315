"""The short way through a controller's usual datagram.

Protobuf leaves a writer many choices; controllers always make the same ones: each field once, in
order of number, repeated doubles unpacked. So the datagram begins with bytes that are mostly
constant, and one comparison under a mask and one ``struct`` call do the work of some fifty
protobuf fields, in a third of the time. This runs in every control cycle.

Anything else leaves here by NotCanonicalError, IndexError or struct.error, for the general
decoder to judge. So does every value that it might refuse.
"""

from __future__ import annotations

import math
import struct

from cardan.protocols.egm.messages import (
    EgmHeader,
    EgmMotion,
    EgmPose,
    EgmRobot,
    MCIState,
    MessageType,
    MotorState,
    RapidState,
)
from cardan.protocols.egm.units import MM_PER_M, RAD_PER_DEG
from cardan.types import Quaternion, Vector3

MOTOR_STATES = tuple(MotorState)
MCI_STATES = tuple(MCIState)
RAPID_STATES = tuple(RapidState)
"""The members by number."""


class NotCanonicalError(Exception):
    """The datagram is not of the layout that is known here; it may well be legal."""


def _block(pattern: str) -> tuple[int, int, struct.Struct]:
    """Bytes of which some are constant: a mask of those, their values, and how to read the rest.

    `pattern` has hex digits for a constant byte and a letter for what is read: ``d`` a double,
    ``?`` a bool, ``n`` the last and ``c`` an earlier byte of a varint. Mask and values are
    little-endian numbers.
    """
    mask = expected = b""
    form = "<"
    for word in pattern.split():
        if word in _VARIABLE:
            word_mask, word_expected, word_form = _VARIABLE[word]
        else:
            word_mask, word_expected, word_form = b"\xff", bytes.fromhex(word), "x"
        mask += word_mask
        expected += word_expected
        form += word_form
    return _from_bytes(mask, "little"), _from_bytes(expected, "little"), struct.Struct(form)


_VARIABLE = {
    "d": (bytes(8), bytes(8), "d"),
    "?": (b"\x80", b"\0", "?"),
    "n": (b"\x80", b"\0", "B"),
    "c": (b"\x80", b"\x80", "B"),
}

_new = tuple.__new__
_from_bytes = int.from_bytes
_isfinite = math.isfinite
_DATA = MessageType.DATA

_JOINTS = "0a 36" + " 09 d" * 6
_POSITION = "0a 1b 09 d 11 d 19 d"
_ORIENT = "12 24 09 d 11 d 19 d 21 d"
_EULER = "1a 1b 09 d 11 d 19 d"
# Five bytes of seconds reach from 1978 to 3058; three of microseconds are all but the first 16 ms
# of each second, which the general decoder gets.
_TIME = "22 0a 08 c c c c n 10 c c n"
_STATES = "22 02 08 n 2a 02 08 n 30 ? 42 02 08 n"
_WITH_EULER = f"a6 01 {_JOINTS} 12 60 {_POSITION} {_ORIENT} {_EULER} {_TIME}"
_WITHOUT_EULER = f"89 01 {_JOINTS} 12 43 {_POSITION} {_ORIENT} {_TIME}"
_BODIES = {
    0xA6: _block(f"12 {_WITH_EULER} 1a {_WITH_EULER} {_STATES}"),
    0x89: _block(f"12 {_WITHOUT_EULER} 1a {_WITHOUT_EULER} {_STATES}"),
}
"""feedBack, planned and states, by the low byte of feedBack's length."""
_VALUES_WITH_EULER = 24
"""How many values a motion has when Euler angles are among them."""


def decode_canonical_start(data: bytes) -> tuple[EgmRobot, int]:
    """An EgmRobot's header, feedBack and planned (six joints, pose, time) and states.

    Second: where they end. The fields that may follow begin there.
    """
    if data[0] != 0x0A or data[2] != 0x08:
        raise NotCanonicalError
    seqno, at = _varint(data, 3)
    if data[at] != 0x10:
        raise NotCanonicalError
    tm_ms, at = _varint(data, at + 1)
    # mtype DATA ends the header, whose length is the second byte.
    if data[at : at + 2] != b"\x18\x02" or data[1] != at:
        raise NotCanonicalError
    at += 2
    body = _BODIES.get(data[at + 1])
    if body is None:
        raise NotCanonicalError
    mask, expected, form = body
    values = form.unpack_from(data, at)
    end = at + form.size
    # A NaN or an infinity makes the sum one, too.
    if _from_bytes(data[at:end], "little") & mask != expected or not _isfinite(sum(values)):
        raise NotCanonicalError
    motor, mci, converged, rapid = values[-4:]
    middle = len(values) // 2 - 2
    robot = EgmRobot(
        _new(EgmHeader, (seqno, tm_ms, _DATA)),
        _motion(values[:middle]),
        _motion(values[middle:-4]),
        MOTOR_STATES[motor],
        MCI_STATES[mci],
        converged,
        None,
        RAPID_STATES[rapid],
    )
    return robot, end


def _motion(values: tuple[float, ...]) -> EgmMotion:
    """A motion from the values of its joints, its pose and the bytes of its clock."""
    if len(values) == _VALUES_WITH_EULER:
        (j1, j2, j3, j4, j5, j6, x, y, z, u0, u1, u2, u3, ex, ey, ez,
         s0, s1, s2, s3, s4, t0, t1, t2) = values  # fmt: skip
        euler = _new(Vector3, (ex * RAD_PER_DEG, ey * RAD_PER_DEG, ez * RAD_PER_DEG))
    else:
        (j1, j2, j3, j4, j5, j6, x, y, z, u0, u1, u2, u3,
         s0, s1, s2, s3, s4, t0, t1, t2) = values  # fmt: skip
        euler = None
    joints = (
        j1 * RAD_PER_DEG,
        j2 * RAD_PER_DEG,
        j3 * RAD_PER_DEG,
        j4 * RAD_PER_DEG,
        j5 * RAD_PER_DEG,
        j6 * RAD_PER_DEG,
    )
    pos = _new(Vector3, (x / MM_PER_M, y / MM_PER_M, z / MM_PER_M))
    pose = _new(EgmPose, (pos, _new(Quaternion, (u0, u1, u2, u3)), euler))
    # Seven bits a byte, without the marks of the bytes that are not the last.
    sec = s0 + s1 * 0x80 + s2 * 0x4000 + s3 * 0x20_0000 + s4 * 0x1000_0000 - 0x1020_4080
    usec = t0 + t1 * 0x80 + t2 * 0x4000 - 0x4080
    return _new(EgmMotion, (joints, pose, None, sec * 1_000_000 + usec, None))


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """The number below 2^32 at `at`, in at most five bytes, and where it ends."""
    a = data[at]
    if a < 0x80:
        return a, at + 1
    b = data[at + 1]
    if b < 0x80:
        return a + (b << 7) - 0x80, at + 2
    c = data[at + 2]
    if c < 0x80:
        return a + (b << 7) + (c << 14) - 0x4080, at + 3
    d = data[at + 3]
    if d < 0x80:
        return a + (b << 7) + (c << 14) + (d << 21) - 0x204080, at + 4
    e = data[at + 4]
    if e < 0x10:
        return a + (b << 7) + (c << 14) + (d << 21) + (e << 28) - 0x10204080, at + 5
    raise NotCanonicalError
