"""Requests to a session and its replies, as packets: one JSON object each.

A request is ``{"id": 7, "source": "pendant", "verb": "movl", "value": [...]}``, for streams with an
optional ``"sequence"``. Its reply is ``{"reply": 7, "result": ...}`` or ``{"reply": 7, "error":
{"kind": ..., "message": ..., ...}}``; the states of a motion follow as ``{"motion": ...}``. A
packet that is no request is answered, too, with the `id` that it has, or null. Nothing here opens
anything, and no bytes raise anything but :class:`PacketError`.
"""

from __future__ import annotations

import enum
import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn

from cardan import errors
from cardan.errors import CardanError, ConfigurationError, MotionRefusedError
from cardan.gateway.arm import parameters as prm
from cardan.gateway.arm.authority import HAND, AuthorityState
from cardan.gateway.arm.checks import LARGEST_NUMBER, checked_pose, six_numbers
from cardan.gateway.arm.codes import State, Stream
from cardan.gateway.arm.motion import ControllerStatus, Motion, Outcome, Stat
from cardan.types import Frame, Pose, Quaternion, Vector3

MAX_REQUEST_BYTES = 4096
"""Largest size of a request: the longest, all parameters at once, has a quarter of it."""

MAX_TEXT = 64
"""Characters of a name."""

MAX_NUMBERS = 32
"""Longest list: no arm has more joints."""

LARGEST_ID = 1 << 53
"""The largest integer that every reader of JSON keeps exactly."""


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


class Reply(NamedTuple):
    """The result of a request; `error` is None where it was carried out."""

    id: int | None
    result: Any
    error: CardanError | None


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


# -- arguments ------------------------------------------------------------------------------------


def _refuse(verb: str, why: str) -> NoReturn:
    raise MotionRefusedError(f"{verb}: {why}")


def _numbers(verb: str, value: Any, count: tuple[int, ...] = ()) -> list[float]:
    if not isinstance(value, list) or len(value) > MAX_NUMBERS:
        _refuse(verb, f"takes a list of numbers, not {_shown(value)}")
    if count and len(value) not in count:
        _refuse(verb, f"takes {' or '.join(map(str, count))} numbers, not {len(value)}")
    return [_number(verb, each) for each in value]


def _number(verb: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        _refuse(verb, f"takes numbers, not {_shown(value)}")
    if not -LARGEST_ID <= value <= LARGEST_ID:
        _refuse(verb, f"{_shown(value)} is too large a number")
    return float(value)


def _text(verb: str, value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= MAX_TEXT:
        _refuse(verb, f"takes a name of 1 to {MAX_TEXT} characters, not {_shown(value)}")
    return value


def _code(verb: str, value: Any) -> int | str:
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) <= LARGEST_ID:
        return value
    return _text(verb, value)


def _shown(value: Any) -> str:
    words = repr(value)
    return words if len(words) <= MAX_TEXT else f"{words[:MAX_TEXT]}…"


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
    try:
        rates = [float(each) for each in value]
    except (TypeError, ValueError, OverflowError):
        _refuse(verb, f"takes numbers, not {_shown(value)}")
    if not all(abs(rate) <= LARGEST_NUMBER for rate in rates):
        _refuse(verb, f"takes finite numbers, not {_shown(tuple(rates))}")
    return rates


def _seconds_out(verb: str, value: Any) -> float:
    if not 0.0 <= value < math.inf:
        _refuse(verb, f"a timeout is a number >= 0, not {value}")
    return float(value)


def _code_out(verb: str, value: Any) -> int | str:
    return _code(verb, int(value) if isinstance(value, enum.IntEnum) else value)


def _key_out(_verb: str, value: Any) -> int:
    return int(prm.find_rule(value).key)


def _values_out(_verb: str, values: Mapping[prm.Key, prm.Value]) -> list[list[float]]:
    return [[int(key), value] for key, value in prm.checked_group(values).items()]


def _values_in(verb: str, value: Any) -> dict[prm.Key, prm.Value]:
    if not isinstance(value, list) or not all(
        isinstance(pair, list) and len(pair) == 2 for pair in value
    ):
        _refuse(verb, f"takes pairs of a key and a value, not {_shown(value)}")
    found: dict[prm.Key, prm.Value] = {}
    for key, each in value:
        known = prm.find_rule(_code(verb, key))
        if known.key in found:
            raise ConfigurationError(known.name, "is given twice")
        found[known.key] = _text(verb, each) if isinstance(each, str) else _number(verb, each)
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
    "hand_over": _Argument(_text, _text),
    "release": None,
    "get_parameter": _Argument(_key_out, _code),
    "get_parameters": None,
    "set_parameters": _Argument(_values_out, _values_in),
    "status": None,
}
"""All verbs, and what each takes."""

SEQUENCED = frozenset({"pose", "jog", "twist", "wrench", "joints"})
"""Verbs that may carry a sequence number."""


# -- requests -------------------------------------------------------------------------------------


def encode_request(request: Request) -> bytes:
    """As one packet. Raises what the verb raises for an argument that it does not take."""
    argument = ARGUMENTS[request.verb]
    table: dict[str, Any] = {"id": request.id, "source": request.source, "verb": request.verb}
    if argument is not None:
        table["value"] = argument.out(request.verb, request.value)
    sequence = request.sequence
    if sequence is not None:
        if isinstance(sequence, bool) or not isinstance(sequence, int):
            _refuse(request.verb, f"the sequence number {sequence!r} is not an integer")
        table["sequence"] = sequence
    return _packed(table)


def decode_request(packet: bytes) -> Request:
    """From one packet. Raises PacketError."""
    if len(packet) > MAX_REQUEST_BYTES:
        raise PacketError(f"a request has at most {MAX_REQUEST_BYTES} bytes")
    table = _unpacked(packet)
    number = table.pop("id", None)
    if not _is_id(number):
        raise PacketError(f"id: {_shown(number)} is no integer from 0 to {LARGEST_ID}")
    try:
        return _request(number, table)
    except CardanError as error:
        raise PacketError(str(error), number) from error


def _request(number: int, table: dict[str, Any]) -> Request:
    source, verb = _text("source", table.pop("source", None)), table.pop("verb", None)
    if source == HAND:
        _refuse("source", f"{HAND!r} is the operator device beside the session")
    if not isinstance(verb, str) or verb not in ARGUMENTS:
        _refuse("verb", f"there is no {_shown(verb)}; allowed: {', '.join(ARGUMENTS)}")
    argument, value, sequence = ARGUMENTS[verb], None, None
    if argument is not None:
        value = argument.back(verb, table.pop("value", None))
    if verb in SEQUENCED:
        sequence = table.pop("sequence", None)
        if sequence is not None and not _is_id(sequence):
            _refuse(verb, f"the sequence number {_shown(sequence)} is not valid")
    if table:
        _refuse(verb, f"takes no {', '.join(map(_shown, table))}")
    return Request(number, source, verb, value, sequence)


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
        raise PacketError(f"it is no object: {_shown(table)}")
    return table


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is no finite number")


def _finite(word: str) -> float:
    value = float(word)
    return value if math.isfinite(value) else _no_number(_shown(word))


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


def encode_reply(number: int | None, result: Any) -> bytes:
    """That a request was carried out; `result` is the verb's result, a motion as its note."""
    return _packed({"reply": number, "result": _plain(result)})


def encode_error(number: int | None, error: CardanError) -> bytes:
    """That a request was refused, and why."""
    kind = next(each for each in type(error).__mro__ if each in _FIELDS)
    told = {"kind": kind.__name__, "message": str(error)}
    told |= {name: _plain(getattr(error, name)) for name in _FIELDS[kind]}
    return _packed({"reply": number, "error": told})


def encode_note(note: MotionNote) -> bytes:
    """State of a motion."""
    return _packed({"motion": _plain(note)})


def _plain(value: Any) -> Any:
    """In JSON's types; numbers that are not finite as strings, which float() reads."""
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else str(float(value))
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {key: _plain(item) for key, item in value._asdict().items()}
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return value


def decode_answer(packet: bytes) -> Reply | MotionNote | None:
    """A reply or a motion's note; None for what is neither, as a snapshot is. Raises PacketError
    for one that is broken."""
    if not packet.startswith((b'{"reply":', b'{"motion":')):
        return None
    table = _unpacked(packet)
    try:
        if "motion" in table:
            return _note(table["motion"])
        error = table.get("error")
        number = table["reply"]
        if number is not None and not _is_id(number):
            raise ValueError(number)
        return Reply(number, table.get("result"), None if error is None else _error(error))
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise PacketError(f"it is no reply: {error!r}") from None


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
    except (LookupError, TypeError, ValueError) as error:
        raise PacketError(f"no answer of {verb}: {error!r}") from None
    return result


def _stat(table: Mapping[str, Any]) -> Stat:
    return Stat(_floats(table["pose"]), State(table["state"]), table["stamp_s"])


def _floats(values: Sequence[Any]) -> Any:
    return tuple(map(float, values))


def _status(table: Mapping[str, Any]) -> ControllerStatus:
    from cardan.gateway.servo.servo import ServoStatus  # Who never asks does without Pinocchio.

    return ControllerStatus(
        **{
            **table,
            "state": State(table["state"]),
            "stream": Stream(table["stream"]),
            "stream_age_s": float(table["stream_age_s"]),
            "pose": None if table["pose"] is None else _floats(table["pose"]),
            "servo": ServoStatus(**{key: _number_or_names(v) for key, v in table["servo"].items()}),
            "authority": _authority(table["authority"]),
        }
    )


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
    **dict.fromkeys(("movj", "relj", "movl", "movv", "gcmp", "forc"), _note),
}
