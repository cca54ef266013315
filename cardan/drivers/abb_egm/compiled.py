"""Compiled cycle of the EGM driver: one call receives a datagram, another one answers it.

Receiving covers :class:`cardan.protocols.egm.reader.FeedbackReader` and the session's handling of a
usual datagram. Answering covers the command's range check, the limiter and the message:
:mod:`cardan.drivers.limiters` and :mod:`cardan.protocols.egm.replies`. The Python code gives the
same result to the last bit; it handles rare cases, and all cases if nothing was compiled. Both
languages share the memory.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import socket
import struct
from collections.abc import Callable, Sequence
from ctypes import c_char_p, c_double, c_int32, c_int64, c_uint8, c_uint32, c_void_p
from pathlib import Path
from typing import Any, ClassVar

from cardan.common.bounds import (
    ANGULAR_VELOCITY_RAD_S,
    COORDINATE_M,
    JOINT_POSITION,
    JOINT_VELOCITY,
    LINEAR_VELOCITY_M_S,
    ROTATION_LENGTH,
)
from cardan.common.native import (
    NativePartError,
    allotted,
    layout_of,
    load_own_library,
    native_call,
)
from cardan.drivers.limiters import JointLimiter, OrientationLimiter, PointLimiter
from cardan.protocols.egm.messages import EgmFeedback, MalformedEgmMessage
from cardan.protocols.egm.reader import DatagramLayout, FeedbackReader
from cardan.types import (
    Frame,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    Pose,
    PoseCommand,
    Quaternion,
    RobotCommand,
    RobotLink,
    RobotState,
    TwistCommand,
    Vector3,
    Wrench,
)

JOINTS = 6
_REPLY_MAX = 160
_THREE, _FOUR, _SIX = c_double * 3, c_double * 4, c_double * JOINTS
_STATES = c_int32 * 3
_SAYS_POSITION, _SAYS_SPEED = 1, 2
_new = tuple.__new__
"""Makes a named tuple in half the time of its constructor, for objects made in every cycle."""


class CAnswer(ctypes.Structure):
    """Struct of kernel/answer.h."""

    _fields_ = (
        ("lower", _SIX),
        ("upper", _SIX),
        ("inner_lower", _SIX),
        ("inner_upper", _SIX),
        ("speed", _SIX),
        ("acceleration", _SIX),
        ("largest_position", c_double),
        ("largest_velocity", c_double),
        ("delay_s", c_double),
        ("target", _SIX),
        ("reference", _SIX),
        ("velocity", _SIX),
        ("positions", _SIX),
        ("velocities", _SIX),
        ("measured", _SIX),
        ("has_target", c_int32),
        ("says", c_int32),
        ("moving", c_int32),
        ("relocates", c_int32),
        ("reply", c_uint8 * _REPLY_MAX),
    )


class CPoint(ctypes.Structure):
    """Struct of kernel/pose.h, as are the next two."""

    _fields_ = (
        ("lower", _THREE),
        ("upper", _THREE),
        ("speed", c_double),
        ("acceleration", c_double),
        ("target", _THREE),
        ("reference", _THREE),
        ("velocity", _THREE),
        ("has_box", c_int32),
        ("has_target", c_int32),
    )


class CTurn(ctypes.Structure):
    _fields_ = (
        ("speed", c_double),
        ("acceleration", c_double),
        ("target", _FOUR),
        ("reference", _FOUR),
        ("velocity", _THREE),
        ("has_target", c_int32),
    )


class CPoseAnswer(ctypes.Structure):
    _fields_ = (
        ("largest_position", c_double),
        ("largest_linear", c_double),
        ("largest_angular", c_double),
        ("shortest_squared", c_double),
        ("longest_squared", c_double),
        ("delay_s", c_double),
        ("point", CPoint),
        ("turn", CTurn),
        ("position", _THREE),
        ("orientation", _FOUR),
        ("linear", _THREE),
        ("angular", _THREE),
        ("measured_position", _THREE),
        ("measured_orientation", _FOUR),
        ("says", c_int32),
        ("moving", c_int32),
        ("relocates", c_int32),
        ("reply", c_uint8 * _REPLY_MAX),
    )


LAYOUTS, LENGTH_MAX, VALUES, FORCES = 16, 512, 17, 6
_PLACES = c_int32 * (VALUES + FORCES + 1)


class CLayout(ctypes.Structure):
    """Struct of kernel/read.h, as is the next."""

    _fields_ = (
        ("length", c_int32),
        ("forces", c_int32),
        ("has_rate", c_int32),
        ("states", _STATES),
        ("place", _PLACES),
        ("size", _PLACES),
        ("mask", c_uint8 * LENGTH_MAX),
        ("fixed", c_uint8 * LENGTH_MAX),
    )


class CReader(ctypes.Structure):
    _fields_ = (
        ("joints", _SIX),
        ("position", c_double * 3),
        ("orientation", c_double * 4),
        ("rate", c_double),
        ("forces", c_double * FORCES),
        ("time_us", c_int64),
        ("seqno", c_uint32),
        ("tm_ms", c_uint32),
        ("newest", c_int32),
        ("layouts", CLayout * LAYOUTS),
    )


class CCycle(ctypes.Structure):
    """Struct of kernel/take.h."""

    _fields_ = (
        ("nominal_s", c_double),
        ("lost_after_s", c_double),
        ("late_after_s", c_double),
        ("longest_gap_s", c_double),
        ("jump", c_double),
        ("jump_per_s", c_double),
        ("usual", c_double),
        ("rounding", c_double),
        ("shortest_squared", c_double),
        ("longest_squared", c_double),
        ("slack_s", c_double),
        ("most_credit_s", c_double),
        ("by_joints", c_int32),
        ("states", _STATES),
        ("tm_ms", c_int64),
        ("time_us", c_int64),
        ("last_step_s", c_double),
        ("since_reply_s", c_double),
        ("credit_s", c_double),
        ("replied_s", c_double),
        ("out_seqno", c_uint32),
        ("said_speed", c_int32),
        ("steady", c_int32),
        ("known", c_int32),
        ("last_s", c_double),
        ("joints", _SIX),
        ("position", _THREE),
        ("orientation", _FOUR),
        ("seqno", c_uint32),
        ("layout", c_int32),
        ("jitter_s", c_double),
        ("turned", _FOUR),
    )


_FOUND = struct.Struct("14d48xqII")
"""CReader's fields up to the layouts, but for the forces."""


def expected_layout() -> list[int]:
    """Size and field offsets that the compiled library's `egm_layout` must report."""
    return layout_of(CAnswer, CPoint, CTurn, CPoseAnswer, CLayout, CReader, CCycle)


def library_path() -> Path:
    """Path of the compiled part, whether or not it exists."""
    return Path(__file__).with_name("libcardan_egm.so")


@functools.cache
def egm_library() -> Any:
    """Return the compiled part, loaded once. Raises NativePartError with advice."""
    what = "the compiled part of EGM's driver"
    loaded = load_own_library(library_path(), what, "egm", expected_layout())
    loaded.egm_read.restype = c_int32
    loaded.egm_read.argtypes = (c_void_p, c_char_p, c_int64)
    loaded.egm_heard_size.restype, loaded.egm_heard_size.argtypes = ctypes.c_size_t, ()
    return loaded


def _called(name: str, *held: object) -> Callable[..., Any]:
    """The function `name` of kernel/python, bound to its arguments."""
    return native_call(egm_library(), f"egm_call_{name}", *held)


def datagrams(sock: socket.socket) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return `recvfrom` and `sendto` of a socket; compiled versions for a blocking UDP socket over
    IPv4.

    These take half the time: they reuse the sender's address object, and `sendto` takes only
    addresses from `recvfrom`. Both notice that the socket was closed.
    """
    if type(sock) is socket.socket and sock.family == socket.AF_INET and sock.gettimeout() is None:
        with contextlib.suppress(NativePartError):
            shared = (sock.fileno, [None], bytearray(egm_library().egm_heard_size()))
            return _called("recvfrom_ipv4", *shared), _called("sendto_ipv4", *shared)
    return sock.recvfrom, sock.sendto


class CompiledReader(FeedbackReader):
    """Feedback reader with compiled layouts. Raises NativePartError if nothing was compiled."""

    def __init__(self) -> None:
        super().__init__()
        self._call = egm_library().egm_read
        self._shared, self._memory = allotted(CReader)
        self._address = ctypes.addressof(self._shared)
        self._known: list[DatagramLayout | None] = [None] * LAYOUTS
        self._next = 0

    def read(self, data: bytes) -> EgmFeedback | MalformedEgmMessage:
        index = self._call(self._address, data, len(data))
        if index < 0:
            return super().read(data)
        known = self._known[index]
        assert known is not None
        j1, j2, j3, j4, j5, j6, x, y, z, u0, u1, u2, u3, rate, time_us, seqno, tm_ms = (
            _FOUND.unpack_from(self._memory)
        )
        forces = known.forces
        return _new(
            EgmFeedback,
            (
                seqno,
                tm_ms,
                (j1, j2, j3, j4, j5, j6),
                _new(Vector3, (x, y, z)),
                _new(Quaternion, (u0, u1, u2, u3)),
                (),
                time_us,
                known.states,
                tuple(self._shared.forces[:forces]) if forces else (),
                rate if known.has_rate else None,
            ),
        )

    def learn(self) -> None:
        unlearned = self._unlearned
        if unlearned is None:
            return
        super().learn()
        length = len(unlearned[0])
        self._teach(length, self._layouts[length])

    def _teach(self, length: int, layout: DatagramLayout | None) -> None:
        """Read datagrams of `length` by `layout`; None: by the general path."""
        shared = self._shared
        index = next((i for i in range(LAYOUTS) if shared.layouts[i].length == length), None)
        if index is None:
            index, self._next = self._next, (self._next + 1) % LAYOUTS
        into, self._known[index] = shared.layouts[index], layout
        into.length = 0
        if layout is None or length > LENGTH_MAX:
            return
        into.forces, into.has_rate = layout.forces, layout.has_rate
        into.states[:] = layout.states
        for value, (place, size) in enumerate(layout.places):
            into.place[value], into.size[value] = place, size
        into.mask[:length] = layout.mask.to_bytes(length, "little")
        into.fixed[:length] = layout.fixed.to_bytes(length, "little")
        into.length = length

    def compiled_receive(self, cycle: CompiledCycle, force_frame: Frame) -> Callable[..., Any]:
        """Return a compiled `EgmSession.receive` for usual datagrams.

        From the datagram, the time and the previous state it makes the new state, the datagram and
        the jitter, or None for an unusual datagram.
        """
        constants = (
            RobotState,
            Pose,
            Vector3,
            Quaternion,
            Wrench,
            RobotLink.LIVE,
            Frame.BASE,
            force_frame,
            (),
            "",
        )
        return _called("take", cycle.memory, self._memory, *constants)


class CompiledCycle:
    """State that a session keeps between cycles, in memory shared with the compiled part."""

    def __init__(self, **constants: float) -> None:
        """`constants` are fields of CCycle. Raises NativePartError if nothing was compiled."""
        egm_library()
        self.cycle_state, self.memory = allotted(CCycle)
        for name, value in constants.items():
            setattr(self.cycle_state, name, value)
        self.cycle_state.shortest_squared = ROTATION_LENGTH.lowest**2
        self.cycle_state.longest_squared = ROTATION_LENGTH.highest**2


def feedback_reader() -> FeedbackReader:
    """Return the compiled reader if there is one, else the Python one."""
    try:
        return CompiledReader()
    except NativePartError:
        return FeedbackReader()


def _say(shared: Any, says_speed: bool, delay_s: float) -> None:
    """Choose the fields of answers."""
    position, speed = 0 if delay_s else _SAYS_POSITION, _SAYS_SPEED if says_speed else 0
    shared.says, shared.delay_s, shared.relocates = position | speed, delay_s, delay_s > 0.0


ReplyFunction = Callable[[RobotCommand, float, RobotState, bytes], bytes | None]
"""Compiled answer: from the command, the time, the answered state and the end of the message, one
period of the limiters and the message. None, and no change, for unusual and for invalid commands,
which Python handles."""


def no_answer(*_: object) -> None:
    """ReplyFunction if nothing was compiled: always None."""


class AnsweringLimiter(JointLimiter):
    """Limiter of six joints with a compiled answer. Raises NativePartError if nothing was
    compiled."""

    def __init__(
        self,
        lower: Sequence[float],
        upper: Sequence[float],
        speed: Sequence[float],
        acceleration: Sequence[float],
        longest_period_s: float,
        says_speed: bool,
        delay_s: float = 0.0,
    ) -> None:
        """Make a JointLimiter; with `says_speed`, answers have velocity beside position. With a
        `delay_s` (speed control) they have velocity alone, and the reference begins at the arm's
        position after that delay."""
        egm_library()
        self._shared, self._memory = allotted(CAnswer)
        shared = self._shared
        super().__init__(lower, upper, speed, acceleration, longest_period_s)
        shared.lower[:], shared.upper[:] = self._lower, self._upper
        shared.inner_lower[:], shared.inner_upper[:] = self._inner_lower, self._inner_upper
        shared.speed[:], shared.acceleration[:] = self._speed, self._acceleration
        shared.largest_position = JOINT_POSITION.highest
        shared.largest_velocity = JOINT_VELOCITY.highest
        _say(shared, says_speed, delay_s)

    def compiled_reply(self, cycle: CompiledCycle) -> ReplyFunction:
        """Return the compiled answer for the session of `cycle`."""
        return _called(
            "answer_joints",
            cycle.memory,
            self._memory,
            JointCommand,
            JointVelocityCommand,
            HoldCommand,
            Frame.BASE,
            "",
        )

    @property
    def reference(self) -> Any:
        """Positions, rad."""
        return self._shared.reference

    @reference.setter
    def reference(self, positions: Sequence[float]) -> None:
        self._shared.reference[:] = positions

    @property
    def velocity(self) -> Any:
        """rad/s."""
        return self._shared.velocity

    @velocity.setter
    def velocity(self, velocities: Sequence[float]) -> None:
        self._shared.velocity[:] = velocities

    @property
    def _target(self) -> Sequence[float] | None:
        return self._shared.target[:] if self._shared.has_target else None

    @_target.setter
    def _target(self, target: Sequence[float] | None) -> None:
        self._shared.has_target = target is not None
        if target is not None:
            self._shared.target[:] = target


class _Shared:
    """Limiter state in memory shared with the compiled part."""

    __slots__ = ()
    _shared: Any
    _place: ClassVar[type[Any]]
    """Type of the reference."""

    @property
    def reference(self) -> Any:
        return _new(self._place, self._shared.reference)

    @reference.setter
    def reference(self, place: Any) -> None:
        self._shared.reference[:] = place

    @property
    def velocity(self) -> Vector3:
        return _new(Vector3, self._shared.velocity)

    @velocity.setter
    def velocity(self, velocity: Vector3) -> None:
        self._shared.velocity[:] = velocity

    @property
    def _target(self) -> Any:
        return _new(self._place, self._shared.target) if self._shared.has_target else None

    @_target.setter
    def _target(self, target: Any) -> None:
        self._shared.has_target = target is not None
        if target is not None:
            self._shared.target[:] = target


class _SharedPoint(_Shared, PointLimiter):
    __slots__ = ("_shared",)
    _place = Vector3

    def __init__(self, shared: Any, *limits: Any) -> None:
        self._shared = shared
        super().__init__(*limits)
        shared.speed, shared.acceleration = self._speed, self._acceleration
        shared.has_box = self._box is not None
        if self._box is not None:
            shared.lower[:], shared.upper[:] = self._box


class _SharedTurn(_Shared, OrientationLimiter):
    __slots__ = ("_shared",)
    _place = Quaternion

    def __init__(self, shared: Any, *limits: Any) -> None:
        self._shared = shared
        super().__init__(*limits)
        shared.speed, shared.acceleration = self._speed, self._acceleration


class AnsweringPose:
    """Limiters of a pose, with a compiled answer. Raises NativePartError if nothing was
    compiled."""

    def __init__(
        self,
        point: tuple[float, float, Any],
        turn: tuple[float, float],
        says_speed: bool,
        delay_s: float = 0.0,
    ) -> None:
        """Take arguments of PointLimiter and OrientationLimiter; the rest is as for
        AnsweringLimiter."""
        egm_library()
        shared, self._memory = allotted(CPoseAnswer)
        shared.largest_position = COORDINATE_M.highest
        shared.largest_linear = LINEAR_VELOCITY_M_S.highest
        shared.largest_angular = ANGULAR_VELOCITY_RAD_S.highest
        shared.shortest_squared = ROTATION_LENGTH.lowest**2
        shared.longest_squared = ROTATION_LENGTH.highest**2
        _say(shared, says_speed, delay_s)
        self.point: PointLimiter = _SharedPoint(shared.point, *point)
        self.turn: OrientationLimiter = _SharedTurn(shared.turn, *turn)

    def compiled_reply(self, cycle: CompiledCycle) -> ReplyFunction:
        """Return the compiled answer for the session of `cycle`."""
        return _called(
            "answer_pose",
            cycle.memory,
            self._memory,
            PoseCommand,
            TwistCommand,
            HoldCommand,
            Frame.BASE,
            "",
        )
