"""Requests to a session and its replies, as packets: one JSON object each.

A request is ``{"id": 7, "source": "pendant", "verb": "movl", "value": [...]}``, for streams with an
optional ``"sequence"``, ``"stamp"`` (when it was sent, s by the sender's clock), ``"begins"``
(``"new"``, ``"going on"`` or ``"rest"``: see :class:`Begins`) and, of a twist or a wrench, its
``"frame"``. Its reply is ``{"reply": 7, "result": ...}`` or ``{"reply": 7, "error":
{"kind": ..., "message": ..., ...}}``; the states of a motion follow as ``{"motion": ...}``. Where a
packet may overtake another, a reply has the ends of motions before it, too: ``"ended": [...]``. A
packet that is no request is answered, too, with the `id` that it has, or null. Nothing here opens
anything, and no bytes raise anything but :class:`PacketError`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn, TypeVar

from cardan import errors
from cardan.common.value_json import to_json
from cardan.errors import CardanError, ConfigurationError, MotionRefusedError
from cardan.gateway.arm import parameters as prm
from cardan.gateway.arm.authority import AuthorityState
from cardan.gateway.arm.checks import (
    LARGEST_SEQUENCE,
    brief,
    checked_action,
    checked_name,
    checked_pose,
    checked_sequence,
    checked_source,
    checked_timeout,
    joint_numbers,
    six_numbers,
)
from cardan.gateway.arm.codes import PRESETS, Begins, State, Stream
from cardan.gateway.arm.motion import ControllerStatus, Motion, Outcome, Rehearsal, Stat
from cardan.gateway.servo.status import ServoStatus
from cardan.types import Frame, Pose, Quaternion, Twist, Vector3, Wrench

_ValueT = TypeVar("_ValueT")

MAX_REQUEST_BYTES = 4096
"""Largest size of a request: the longest, all parameters at once, has a quarter of it."""

MAX_NUMBERS = 32
"""Longest list: no arm has more joints."""

LARGEST_ID = LARGEST_SEQUENCE
"""The largest integer that every reader of JSON keeps exactly."""


CANCELLED = "it was cancelled before it began"
"""Why a motion was not begun that is not `wanted` any more."""


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
    """The verb's argument, where it has one."""
    sequence: int | None = None
    there: Callable[[], bool] | None = None
    """Whether who asked is still there, without whom a motion without end ends; None: that is
    watched otherwise."""
    stamp_s: float | None = None
    """Of a streamed command: when it was sent, by the sender's clock."""
    begins: Begins | None = None
    """Of a streamed command: whether it chooses its own where none is chosen; None: never."""
    wanted: Callable[[], bool] | None = None
    """Whether it is still to begin: what was cancelled before its turn is not; None: always."""
    since_s: float | None = None
    """Local monotonic time: it can have waited since then until it came to the session; None: since
    the session looked before, at most."""


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
        """Bring `motion`, which stands for it here, to the same state."""
        motion.outcome, motion.reason, motion.note = self.outcome, self.reason, self.note
        motion.duration_s = self.duration_s


class Reply(NamedTuple):
    """The result of a request; `error` is None where it was carried out."""

    id: int | None
    result: Any
    error: CardanError | None
    ended: tuple[MotionNote, ...] = ()
    """Motions that had ended before."""


# -- arguments ------------------------------------------------------------------------------------


def _refuse(verb: str, why: str) -> NoReturn:
    raise MotionRefusedError(f"{verb}: {why}")


def _numbers(verb: str, value: Any, count: tuple[int, ...] = ()) -> list[float]:
    if not isinstance(value, list) or len(value) > MAX_NUMBERS:
        _refuse(verb, f"takes a list of numbers, not {brief(value)}")
    if count and len(value) not in count:
        _refuse(verb, f"takes {' or '.join(map(str, count))} numbers, not {len(value)}")
    return [_number(verb, each) for each in value]


def _number(verb: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        _refuse(verb, f"takes numbers, not {brief(value)}")
    if not -LARGEST_ID <= value <= LARGEST_ID:
        _refuse(verb, f"{brief(value)} is too large a number")
    return float(value)


def _code(verb: str, value: Any) -> int | str:
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) <= LARGEST_ID:
        return value
    return checked_name(verb, value)


def _pose_out(verb: str, value: Any) -> list[float]:
    pose = checked_pose(verb, value)
    return [*pose.position, *pose.orientation]


def _pose_in(verb: str, value: Any) -> Pose | list[float]:
    numbers = _numbers(verb, value, (6, 7))
    if len(numbers) == 6:
        return numbers
    return Pose(Vector3(*numbers[:3]), Quaternion(*numbers[3:]), Frame.BASE)


def _six_out(verb: str, value: Any) -> list[float]:
    return list(six_numbers(verb, value))


def _six_in(verb: str, value: Any) -> list[float]:
    return _numbers(verb, value, (6,))


def _joints_out(verb: str, value: Any) -> list[float]:
    return list(joint_numbers(verb, value, None))


def _seconds_out(verb: str, value: Any) -> float:
    return min(checked_timeout(verb, value), float(LARGEST_ID))


def _code_out(_verb: str, value: Any) -> int:
    return int(checked_action(value))


def _key_out(_verb: str, value: Any) -> int:
    return int(prm.find_rule(value).key)


def _values_out(_verb: str, values: Mapping[prm.Key, prm.Value]) -> list[list[float]]:
    return [[int(key), value] for key, value in prm.checked_group(values).items()]


def _values_in(verb: str, value: Any) -> dict[prm.Key, prm.Value]:
    if not isinstance(value, list) or not all(
        isinstance(pair, list) and len(pair) == 2 for pair in value
    ):
        _refuse(verb, f"takes pairs of a key and a value, not {brief(value)}")
    found: dict[prm.Key, prm.Value] = {}
    for key, each in value:
        known = prm.find_rule(_code(verb, key))
        if known.key in found:
            raise ConfigurationError(known.name, "is given twice")
        text = isinstance(each, str)
        found[known.key] = checked_name(verb, each) if text else _number(verb, each)
    return found


class _Argument(NamedTuple):
    """Encoder and decoder of a verb's argument; both raise where it is not one."""

    out: Callable[[str, Any], Any]
    back: Callable[[str, Any], Any]


_POSE = _Argument(_pose_out, _pose_in)
_SIX = _Argument(_six_out, _six_in)
_CODE = _Argument(_code_out, _code)

ARGUMENTS: dict[str, _Argument | None] = {
    "stat": None,
    "inv": _POSE,
    "rehearse_line": _POSE,
    "rehearse_joints": _Argument(_joints_out, _numbers),
    "movj": _POSE,
    "relj": _POSE,
    "movl": _POSE,
    "movv": _SIX,
    "gcmp": None,
    "forc": _SIX,
    "wait": _Argument(_seconds_out, _number),
    "stop": None,
    "tool": _POSE,
    "act": _CODE,
    "pose": _POSE,
    "jog": _POSE,
    "twist": _SIX,
    "wrench": _SIX,
    "joints": _Argument(_joints_out, _numbers),
    "acknowledge": None,
    "acquire": None,
    "hand_over": _Argument(checked_name, checked_name),
    "release": None,
    "get_parameter": _Argument(_key_out, _code),
    "get_parameters": None,
    "set_parameters": _Argument(_values_out, _values_in),
    "status": None,
}
"""All verbs, and what each takes."""

ENDLESS = frozenset({"movv", "gcmp", "forc"})
"""Verbs whose motions do not end by themselves."""

NEW_MOTION = frozenset({"movj", "relj", "movl", "movv", "gcmp", "forc", "trajectory"})
"""Verbs that begin a motion."""

LATE_S = 1.0
"""Longest time for which a process may have stood still, or may have been starting, when it finds a
request to begin a motion: who asked may have given up, or be gone, since."""

SEQUENCED = frozenset(PRESETS)
"""Verbs that may carry a sequence number, a stamp, and whether they begin a stream."""

FRAMED: Mapping[str, Callable[[Vector3, Vector3, Frame], Any]] = {"twist": Twist, "wrench": Wrench}
"""Verbs whose numbers may have a frame of their own."""

_BEGINS = {begins.name.lower().replace("_", " "): begins for begins in Begins}
_BEGINS_WORDS = {begins: word for word, begins in _BEGINS.items()}
_FRAMES = {"twist": tuple(Frame), "wrench": (Frame.BASE, Frame.TOOL)}


# -- requests -------------------------------------------------------------------------------------


def encode_request(request: Request) -> bytes:
    """As one packet. Raises what the verb raises for an argument that it does not take."""
    argument = ARGUMENTS[request.verb]
    checked_source(request.verb, request.source)
    table: dict[str, Any] = {"id": request.id, "source": request.source, "verb": request.verb}
    value = request.value
    if isinstance(value, (Twist, Wrench)):
        table["frame"] = value.frame.value
        value = [*value[0], *value[1]]
    if argument is not None:
        table["value"] = argument.out(request.verb, value)
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
    """From one packet. Raises PacketError."""
    if len(packet) > MAX_REQUEST_BYTES:
        raise PacketError(f"a request has at most {MAX_REQUEST_BYTES} bytes")
    table = _unpacked(packet)
    number = table.pop("id", None)
    if not _is_id(number):
        raise PacketError(f"id: {brief(number)} is no integer from 0 to {LARGEST_ID}")
    try:
        return _request(number, table)
    except CardanError as error:
        raise PacketError(str(error), number) from error


def _request(number: int, table: dict[str, Any]) -> Request:
    source, verb = checked_source("source", table.pop("source", None)), table.pop("verb", None)
    if not isinstance(verb, str) or verb not in ARGUMENTS:
        _refuse("verb", f"there is no {brief(verb)}; allowed: {', '.join(ARGUMENTS)}")
    argument, sequence = ARGUMENTS[verb], None
    value: Any = None
    if argument is not None:
        value = argument.back(verb, table.pop("value", None))
    stamp_s, begins = None, None
    since_s = _number("since", table.pop("since")) if "since" in table else None
    if verb in SEQUENCED:
        sequence = table.pop("sequence", None)
        if sequence is not None:
            checked_sequence(verb, sequence)
        if "stamp" in table:
            stamp_s = _number(f"{verb}: stamp", table.pop("stamp"))
        if "begins" in table:
            begins = _one_of(_BEGINS, verb, "begins", table.pop("begins"))
    if verb in FRAMED and "frame" in table:
        frames = {frame.value: frame for frame in _FRAMES[verb]}
        frame = _one_of(frames, verb, "frame", table.pop("frame"))
        value = FRAMED[verb](Vector3(*value[:3]), Vector3(*value[3:]), frame)
    if table:
        _refuse(verb, f"takes no {', '.join(map(brief, table))}")
    return Request(
        number, source, verb, value, sequence, stamp_s=stamp_s, begins=begins, since_s=since_s
    )


def _one_of(known: Mapping[str, _ValueT], verb: str, key: str, given: Any) -> _ValueT:
    if not isinstance(given, str) or given not in known:
        _refuse(verb, f"{key} is {brief(given)}; allowed: {', '.join(known)}")
    return known[given]


def _is_id(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= LARGEST_ID


def _packed(table: Mapping[str, Any]) -> bytes:
    return json.dumps(table, separators=(",", ":"), allow_nan=False).encode()


def _unpacked(packet: bytes) -> dict[str, Any]:
    try:
        table = json.loads(packet, parse_constant=_no_number, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise PacketError(f"it is no JSON: {error}") from None
    if not isinstance(table, dict):
        raise PacketError(f"it is no object: {brief(table)}")
    return table


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is no finite number")


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
"""The errors that are encoded by name, and their fields; others are sent as their nearest base."""

_KINDS = {kind.__name__: kind for kind in _FIELDS}


def encode_reply(number: int | None, result: Any, ended: Sequence[MotionNote] = ()) -> bytes:
    """That a request was carried out; `result` is the verb's result, a motion as its note; `ended`:
    motions that had ended before."""
    return _packed({"reply": number, "result": to_json(result), **_ended(ended)})


def encode_error(number: int | None, error: CardanError, ended: Sequence[MotionNote] = ()) -> bytes:
    """That a request was refused, and why."""
    kind = next(each for each in type(error).__mro__ if each in _FIELDS)
    told = {"kind": kind.__name__, "message": str(error)}
    told |= {name: to_json(getattr(error, name)) for name in _FIELDS[kind]}
    return _packed({"reply": number, "error": told, **_ended(ended)})


def _ended(notes: Sequence[MotionNote]) -> dict[str, Any]:
    return {"ended": to_json(list(notes))} if notes else {}


def encode_note(note: MotionNote) -> bytes:
    """State of a motion."""
    return _packed({"motion": to_json(note)})


_ANSWERS = b'{"reply":', b'{"motion":'

_BROKEN = (LookupError, TypeError, ValueError, AttributeError, OverflowError)
"""What a reply with wrong values in it leads to. OverflowError: a whole number that is too large
for a float."""


def is_answer(packet: bytes) -> bool:
    """Whether a packet is a reply or a motion's note."""
    return packet.startswith(_ANSWERS)


def decode_answer(packet: bytes) -> Reply | MotionNote | None:
    """A reply or a motion's note; None for what is neither, as a snapshot is. Raises PacketError
    for one that is broken."""
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
        raise PacketError(f"it is no reply: {error!r:.200}") from None


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


# -- what replies carry ---------------------------------------------------------------------------


def result_of(verb: str, result: Any) -> Any:
    """The result of a reply as `verb` answers it; a motion as its note. Raises PacketError."""
    try:
        if verb in _RESULTS:
            return _RESULTS[verb](result)
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


_RESULTS: dict[str, Callable[[Any], Any]] = {
    "stat": _stat,
    "inv": _floats,
    "status": _status,
    **dict.fromkeys(("rehearse_line", "rehearse_joints"), _rehearsal),
    **dict.fromkeys(("movj", "relj", "movl", "movv", "gcmp", "forc"), _note),
}
