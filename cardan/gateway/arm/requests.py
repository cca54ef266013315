"""Requests to a session and its replies, as packets: one JSON object each.

A request is ``{"id": 7, "source": "pendant", "verb": "movl", "value": [...]}``, for streams with an
optional ``"sequence"``, ``"stamp"`` (when it was sent, s by the sender's clock), ``"begins"``
(``"new"``, ``"going on"`` or ``"rest"``: see :class:`Begins`) and, of a twist or a wrench, its
``"frame"``. Its reply is ``{"reply": 7, "result": ...}`` or ``{"reply": 7, "error": {"kind": ...,
"message": ..., ...}}``; the states of a motion follow as ``{"motion": ...}``. If packets may
overtake each other, a reply also lists the motions that ended before it: ``"ended": [...]``. A
malformed request is answered, too, with its `id`, or null. No I/O; malformed bytes raise
:class:`PacketError` only.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn, TypeVar

from cardan import errors
from cardan.common.value_json import to_json
from cardan.errors import CardanError
from cardan.gateway.arm.status import AuthorityState
from cardan.gateway.arm.validation import brief, checked_sequence, checked_source
from cardan.gateway.arm.verb_results import ControllerStatus, Motion, Outcome, Rehearsal, Stat
from cardan.gateway.arm.verb_table import (
    IN_PACKETS,
    LARGEST_INTEGER,
    NOTHING,
    SEQUENCED,
    VERB_TABLE,
    number as checked_number,
    refuse,
)
from cardan.gateway.arm.vocab import Begins, State, Stream
from cardan.gateway.servo.status import ServoStatus
from cardan.types import Frame, Twist, Vector3, Wrench

_ValueT = TypeVar("_ValueT")

MAX_REQUEST_BYTES = 4096
"""Largest size of a request: the longest, all parameters at once, has a quarter of it."""

CANCELED = "it was canceled before it began"
"""Reason for not beginning a motion that is no longer `wanted`."""


class PacketError(CardanError):
    """A packet that is no request, or no reply; `request` is its id, if it has one."""

    def __init__(self, message: str, request: int | None = None) -> None:
        super().__init__(message)
        self.request = request


class Request(NamedTuple):
    """A request of a source."""

    id: int
    source: str
    verb: str
    value: Any = None
    """The verb's argument, if it has one."""
    sequence: int | None = None
    there: Callable[[], bool] | None = None
    """Return whether the client is still connected; without it a motion without end is ended. None:
    checked elsewhere."""
    stamp_s: float | None = None
    """Stamp of a streamed command: when it was sent, by the sender's clock."""
    begins: Begins | None = None
    """For a streamed command: whether it chooses its own preset if none is chosen; None: never."""
    wanted: Callable[[], bool] | None = None
    """Return whether the request is still to begin; one canceled before its turn is not. None:
    always."""
    since_s: float | None = None
    """Earliest local monotonic time since when it may have waited for the session; None: since the
    session's previous check."""


class MotionNote(NamedTuple):
    """State of a motion."""

    id: int
    """The motion's own id, from the first reply about it."""
    verb: str
    source: str
    ends: bool
    outcome: Outcome
    reason: str
    note: str
    duration_s: float

    def update(self, motion: Motion) -> None:
        """Update the local `motion` to this state."""
        motion.outcome, motion.reason, motion.note = self.outcome, self.reason, self.note
        motion.duration_s = self.duration_s


class Reply(NamedTuple):
    """The result of a request; `error` is None where it was carried out."""

    id: int | None
    result: Any
    error: CardanError | None
    ended: tuple[MotionNote, ...] = ()
    """Motions that ended before this reply."""


LATE_S = 1.0
"""Longest pause or start-up of a process after which it still accepts a request to begin a motion:
after more, the client may have given up or disconnected."""

FRAMED: Mapping[str, Callable[[Vector3, Vector3, Frame], Any]] = {"twist": Twist, "wrench": Wrench}
"""Verbs whose values may have a frame of their own."""

_BEGINS = {begins.name.lower().replace("_", " "): begins for begins in Begins}
_BEGINS_WORDS = {begins: word for word, begins in _BEGINS.items()}
_FRAMES = {"twist": tuple(Frame), "wrench": (Frame.BASE, Frame.TOOL)}


# -- requests -------------------------------------------------------------------------------------


def encode_request(request: Request) -> bytes:
    """Encode as one packet. Raises the verb's error for an invalid argument."""
    takes = VERB_TABLE[request.verb].takes
    checked_source(request.verb, request.source)
    table: dict[str, Any] = {"id": request.id, "source": request.source, "verb": request.verb}
    value = request.value
    if isinstance(value, (Twist, Wrench)):
        table["frame"] = value.frame.value
        value = [*value[0], *value[1]]
    if takes is not NOTHING:
        table["value"] = takes.encode(request.verb, value)
    if request.sequence is not None:
        table["sequence"] = checked_sequence(request.verb, request.sequence)
    if request.stamp_s is not None:
        table["stamp"] = request.stamp_s
    if request.begins is not None:
        table["begins"] = _BEGINS_WORDS[request.begins]
    if request.since_s is not None:
        table["since"] = request.since_s
    return _packed(table)


def decode_request(packet: bytes) -> Request:
    """Decode from one packet. Raises PacketError."""
    if len(packet) > MAX_REQUEST_BYTES:
        raise PacketError(f"a request has at most {MAX_REQUEST_BYTES} bytes")
    table = _unpacked(packet)
    number = table.pop("id", None)
    if not _is_id(number):
        raise PacketError(f"id: {brief(number)} is not an integer from 0 to {LARGEST_INTEGER}")
    try:
        return _request(number, table)
    except CardanError as error:
        raise PacketError(str(error), number) from error


def _request(number: int, table: dict[str, Any]) -> Request:
    source, verb = checked_source("source", table.pop("source", None)), table.pop("verb", None)
    if not isinstance(verb, str) or verb not in IN_PACKETS:
        refuse("verb", f"there is no {brief(verb)}; allowed: {', '.join(IN_PACKETS)}")
    takes, sequence = VERB_TABLE[verb].takes, None
    value: Any = None
    if takes is not NOTHING:
        value = takes.decode(verb, table.pop("value", None))
    stamp_s, begins = None, None
    since_s = checked_number("since", table.pop("since")) if "since" in table else None
    if verb in SEQUENCED:
        sequence = table.pop("sequence", None)
        if sequence is not None:
            checked_sequence(verb, sequence)
        if "stamp" in table:
            stamp_s = checked_number(f"{verb}: stamp", table.pop("stamp"))
        if "begins" in table:
            begins = _one_of(_BEGINS, verb, "begins", table.pop("begins"))
    if verb in FRAMED and "frame" in table:
        frames = {frame.value: frame for frame in _FRAMES[verb]}
        frame = _one_of(frames, verb, "frame", table.pop("frame"))
        value = FRAMED[verb](Vector3(*value[:3]), Vector3(*value[3:]), frame)
    if table:
        refuse(verb, f"takes no {', '.join(map(brief, table))}")
    return Request(
        number, source, verb, value, sequence, stamp_s=stamp_s, begins=begins, since_s=since_s
    )


def _one_of(known: Mapping[str, _ValueT], verb: str, key: str, given: Any) -> _ValueT:
    if not isinstance(given, str) or given not in known:
        refuse(verb, f"{key} is {brief(given)}; allowed: {', '.join(known)}")
    return known[given]


def _is_id(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= LARGEST_INTEGER


def _packed(table: Mapping[str, Any]) -> bytes:
    return json.dumps(table, separators=(",", ":"), allow_nan=False).encode()


def _unpacked(packet: bytes) -> dict[str, Any]:
    try:
        table = json.loads(packet, parse_constant=_no_number, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise PacketError(f"it is not JSON: {error}") from None
    if not isinstance(table, dict):
        raise PacketError(f"it is not an object: {brief(table)}")
    return table


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is not a finite number")


def _finite(word: str) -> float:
    value = float(word)
    return value if math.isfinite(value) else _no_number(brief(word))


# -- replies --------------------------------------------------------------------------------------

_FIELDS: dict[type[CardanError], tuple[str, ...]] = {
    errors.OutOfReachError: ("distance_m", "angle_rad"),
    errors.JointLimitError: ("joint", "value", "limit"),
    errors.CollisionError: ("pair", "share"),
    errors.MotionRefusedError: (),
    errors.MotionLoopError: (),
    errors.ConfigurationError: ("key",),
    PacketError: (),
    CardanError: (),
}
"""Errors that are encoded by name, with their fields; others are sent as their nearest base."""

_KINDS = {kind.__name__: kind for kind in _FIELDS}


def encode_reply(number: int | None, result: Any, ended: Sequence[MotionNote] = ()) -> bytes:
    """Encode the reply to a request that was carried out. `result` is the verb's result, a motion
    as its note; `ended`: motions that ended before."""
    return _packed({"reply": number, "result": to_json(result), **_ended(ended)})


def encode_error(number: int | None, error: CardanError, ended: Sequence[MotionNote] = ()) -> bytes:
    """Encode the reply to a request that was refused, with the reason."""
    kind = next(each for each in type(error).__mro__ if each in _FIELDS)
    table = {"kind": kind.__name__, "message": str(error)}
    table |= {name: to_json(getattr(error, name)) for name in _FIELDS[kind]}
    return _packed({"reply": number, "error": table, **_ended(ended)})


def _ended(notes: Sequence[MotionNote]) -> dict[str, Any]:
    return {"ended": to_json(list(notes))} if notes else {}


def encode_note(note: MotionNote) -> bytes:
    """Encode the state of a motion."""
    return _packed({"motion": to_json(note)})


_ANSWERS = b'{"reply":', b'{"motion":'

_BROKEN = (LookupError, TypeError, ValueError, AttributeError, OverflowError)
"""Errors from a reply with wrong values. OverflowError: an integer that is too large for a float.
"""


def is_answer(packet: bytes) -> bool:
    """Return whether a packet is a reply or a motion's note."""
    return packet.startswith(_ANSWERS)


def decode_answer(packet: bytes) -> Reply | MotionNote | None:
    """Decode a reply or a motion's note; None for any other packet, such as a snapshot. Raises
    PacketError for a malformed packet."""
    if not is_answer(packet):
        return None
    table = _unpacked(packet)
    try:
        if "motion" in table:
            return _note(table["motion"])
        error = table.get("error")
        number = table["reply"]
        if number is not None and not _is_id(number):
            raise ValueError(number)
        ended = tuple(map(_note, table.get("ended", ())))
        return Reply(number, table.get("result"), None if error is None else _error(error), ended)
    except _BROKEN as error:
        raise PacketError(f"not a reply: {error!r:.200}") from None


def _note(table: Mapping[str, Any]) -> MotionNote:
    return MotionNote(
        **{
            **table,
            "outcome": Outcome(table["outcome"]),
            "duration_s": float(table["duration_s"]),
        }
    )


def _error(table: Mapping[str, Any]) -> CardanError:
    kind = _KINDS.get(table["kind"], CardanError)
    error = kind.__new__(kind)
    Exception.__init__(error, str(table["message"]))
    for name in _FIELDS[kind]:
        value = table[name]
        setattr(error, name, tuple(value) if isinstance(value, list) else value)
    return error


# -- content of replies ---------------------------------------------------------------------------


def result_of(verb: str, result: Any) -> Any:
    """Convert the result of a reply to the result of `verb`; a motion as its note. Raises
    PacketError."""
    try:
        if (decode := _RESULTS.get(VERB_TABLE[verb].answers)) is not None:
            return decode(result)
    except _BROKEN as error:
        raise PacketError(f"no answer of {verb}: {error!r:.200}") from None
    return result


def _stat(table: Mapping[str, Any]) -> Stat:
    target = table.get("target")
    return Stat(
        _floats(table["pose"]),
        State(table["state"]),
        table["stamp_s"],
        _floats(table.get("joints", ())),
        None if target is None else _floats(target),
        _floats(table.get("twist", (0.0,) * 6)),
        bool(table.get("heard", True)),
    )


def _rehearsal(table: Mapping[str, Any]) -> Rehearsal:
    return Rehearsal(**{**table, "duration_s": float(table["duration_s"])})


def _floats(values: Sequence[Any]) -> Any:
    return tuple(map(float, values))


def _status(table: Mapping[str, Any]) -> ControllerStatus:
    return ControllerStatus(
        **{
            **table,
            "state": State(table["state"]),
            "stream": Stream(table["stream"]),
            "stream_age_s": float(table["stream_age_s"]),
            "pose": None if table["pose"] is None else _floats(table["pose"]),
            "servo": _servo_status(table["servo"]),
            "authority": _authority(table["authority"]),
        }
    )


def _servo_status(table: Mapping[str, Any]) -> ServoStatus:
    numbers = {key: _number_or_names(value) for key, value in table.items() if key != "refused"}
    return ServoStatus(**numbers, refused=table["refused"])


def _number_or_names(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(value)
    return float(value) if isinstance(value, str) else value


def _authority(table: Mapping[str, Any]) -> AuthorityState:
    return AuthorityState(**{**table, "since_s": float(table["since_s"])})


_RESULTS: dict[type | None, Callable[[Any], Any]] = {
    Stat: _stat,
    tuple: _floats,
    Rehearsal: _rehearsal,
    Motion: _note,
    ControllerStatus: _status,
}
