"""The verbs of the Cartesian interface in one table: the argument, result and effect of each.

The packets of :mod:`cardan.gateway.arm.requests`,
:class:`~cardan.gateway.arm.verb_server.VerbServer`, the worker of a session, ROS 2 and the command
line read it. A new verb is an entry here, a method of
:class:`~cardan.gateway.arm.verb_methods.ArmVerbs`, and for programs its typed form in
:class:`~cardan.gateway.arm.interface.CartesianArm`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn

from cardan.errors import ConfigurationError, MotionRefusedError
from cardan.gateway.arm import parameters as prm
from cardan.gateway.arm.validation import (
    LARGEST_SEQUENCE,
    brief,
    checked_action,
    checked_distance,
    checked_name,
    checked_pose,
    checked_timeout,
    joint_numbers,
    six_numbers,
)
from cardan.gateway.arm.verb_results import ControllerStatus, Motion, Rehearsal, Stat
from cardan.gateway.arm.vocab import Stream
from cardan.types import Frame, Pose, Quaternion, Vector3

MAX_NUMBERS = 32
"""Longest list: no arm has more joints."""

LARGEST_INTEGER = LARGEST_SEQUENCE
"""The largest integer that every reader of JSON keeps exactly."""

_ACTIONS = {"open": "acog", "close": "accg", "stop": "acsg"}
"""Actions of the gripper in words, and as the interface spells them."""


# -- arguments as JSON has them -------------------------------------------------------------------


def refuse(verb: str, why: str) -> NoReturn:
    """Raise MotionRefusedError."""
    raise MotionRefusedError(f"{verb}: {why}")


def number(verb: str, value: Any) -> float:
    """Return `value` as a finite float. Raises MotionRefusedError."""
    is_nan = isinstance(value, float) and math.isnan(value)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or is_nan:
        refuse(verb, f"takes numbers, not {brief(value)}")
    if not -LARGEST_INTEGER <= value <= LARGEST_INTEGER:
        refuse(verb, f"{brief(value)} is too large a number")
    return float(value)


def _numbers(verb: str, value: Any, count: tuple[int, ...] = ()) -> list[float]:
    if not isinstance(value, list) or len(value) > MAX_NUMBERS:
        refuse(verb, f"takes a list of numbers, not {brief(value)}")
    if count and len(value) not in count:
        refuse(verb, f"takes {' or '.join(map(str, count))} numbers, not {len(value)}")
    return [number(verb, each) for each in value]


def _code(verb: str, value: Any) -> int | str:
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) <= LARGEST_INTEGER:
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
    return min(checked_timeout(verb, value), float(LARGEST_INTEGER))


def _values_out(_verb: str, values: Mapping[prm.Key, prm.Value]) -> list[list[float]]:
    return [[int(key), value] for key, value in prm.checked_group(values).items()]


def _values_in(verb: str, value: Any) -> dict[prm.Key, prm.Value]:
    if not isinstance(value, list) or not all(
        isinstance(pair, list) and len(pair) == 2 for pair in value
    ):
        refuse(verb, f"takes pairs of a key and a value, not {brief(value)}")
    found: dict[prm.Key, prm.Value] = {}
    for key, each in value:
        known = prm.find_rule(_code(verb, key))
        if known.key in found:
            raise ConfigurationError(known.name, "is given twice")
        text = isinstance(each, str)
        found[known.key] = checked_name(verb, each) if text else number(verb, each)
    return found


# -- arguments as a command line has them ---------------------------------------------------------


def _word_number(verb: str, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ConfigurationError(verb, f"{word!r} is not a number") from None


def _word_numbers(verb: str, words: Sequence[str]) -> list[float]:
    return [_word_number(verb, word) for word in words]


def _word_or_number(word: str) -> float | str:
    """A parameter's value: a number, or a word as configuration files have it."""
    try:
        return float(word)
    except ValueError:
        return word


class Takes(NamedTuple):
    """Argument of a verb: for people, as JSON, and on a command line."""

    words: str
    """For people, with units."""
    counts: Sequence[int]
    """Possible numbers of its words on a command line."""
    encode: Callable[[str, Any], Any]
    """Encode the argument of the verb of this name as JSON; a wrong argument raises the verb's own
    error."""
    decode: Callable[[str, Any], Any]
    """Decode the argument from JSON; raises MotionRefusedError or ConfigurationError."""
    read: Callable[[str, Sequence[str]], Any] = _word_numbers
    """Reader of the words of a command line, as JSON has it."""


NOTHING = Takes("nothing", (0,), lambda _verb, _value: None, lambda _verb, _value: None)
POSE = Takes(
    "x y z (m) and a rotation vector (rad), or x y z and a quaternion w x y z",
    (6, 7), _pose_out, _pose_in,
)  # fmt: skip
TWIST = Takes("vx vy vz (m/s) wx wy wz (rad/s)", (6,), _six_out, _six_in)
WRENCH = Takes("fx fy fz (N) tx ty tz (N·m)", (6,), _six_out, _six_in)
POSITIONS = Takes(
    "the positions of all joints (rad or m)", range(1, MAX_NUMBERS + 1), _joints_out, _numbers
)
RATES = Takes(
    "the speeds of all joints (rad/s or m/s)", range(1, MAX_NUMBERS + 1), _joints_out, _numbers
)
DISTANCE = Takes(
    "a distance (m)", (1,), checked_distance, number, lambda verb, w: _word_number(verb, w[0])
)
SECONDS = Takes(
    "nothing, or a timeout in s", (0, 1), _seconds_out, number,
    lambda verb, words: _word_number(verb, words[0]) if words else 0.0,
)  # fmt: skip
ACTION = Takes(
    "open, close or stop", (1,), lambda _verb, value: int(checked_action(value)), _code,
    lambda _verb, words: _ACTIONS.get(words[0], words[0]),
)  # fmt: skip
SOURCE = Takes("a source", (1,), checked_name, checked_name, lambda _verb, words: words[0])
KEY = Takes(
    "a parameter", (1,), lambda _verb, value: int(prm.find_rule(value).key), _code,
    lambda _verb, words: words[0],
)  # fmt: skip
VALUES = Takes(
    "parameters, each with its value", range(2, 2 * len(prm.RULES) + 1, 2), _values_out, _values_in,
    lambda _verb, words: [
        [key, _word_or_number(value)] for key, value in zip(words[::2], words[1::2], strict=True)
    ],
)  # fmt: skip

TRAJECTORY = Takes("a joint trajectory", (), lambda _verb, _value: None, lambda _verb, _value: None)
"""Argument of a verb that neither packets nor the command line carry."""


# -- the table ------------------------------------------------------------------------------------


class Verb(NamedTuple):
    """A verb of the Cartesian interface."""

    name: str
    takes: Takes = NOTHING
    answers: type | None = None
    """Type of the result; Motion: the verb begins one."""
    changes: bool = True
    """True if it acts on the arm, its parameters or the authority, under its source's name."""
    in_packets: bool = True
    """True if programs may request it by :mod:`cardan.gateway.arm.requests`."""
    endless: bool = False
    """True for a motion that does not end by itself."""
    preset: Stream | None = None
    """Preset that a streamed command needs. It may carry a sequence number, a stamp, and
    whether it begins a stream."""
    quick: bool = False
    """True if it neither plans nor waits."""
    at_rest: bool = False
    """True if it waits for an arm that is coming to rest."""
    without_loop: bool = False
    """True if it is carried out also while no loop drives the arm."""
    recorded: bool = False
    """True if a record has it as it happens, and it can be replayed exactly. A motion cannot: its
    planning overlaps with ticks."""

    @property
    def begins_motion(self) -> bool:
        """True if it begins a motion, other than a streamed one."""
        return self.answers is Motion


def _motion(name: str, takes: Takes = NOTHING, endless: bool = False) -> Verb:
    return Verb(name, takes, Motion, endless=endless)


def _stream(name: str, takes: Takes, preset: Stream, quick: bool = True) -> Verb:
    return Verb(name, takes, str, preset=preset, quick=quick, recorded=True)


def _look(name: str, answers: type, takes: Takes = NOTHING, quick: bool = True) -> Verb:
    return Verb(name, takes, answers, changes=False, quick=quick)


def _authority(name: str, takes: Takes = NOTHING) -> Verb:
    return Verb(name, takes, quick=True, without_loop=True, recorded=True)


VERB_TABLE: Mapping[str, Verb] = {
    verb.name: verb
    for verb in (
        _look("stat", Stat),
        _look("inv", tuple, POSE, quick=False),
        _look("rehearse_line", Rehearsal, POSE, quick=False),
        _look("rehearse_joints", Rehearsal, POSITIONS, quick=False),
        _motion("movj", POSE),
        _motion("relj", POSE),
        _motion("movl", POSE),
        _motion("retract", DISTANCE),
        _motion("movv", TWIST, endless=True),
        _motion("gcmp", endless=True),
        _motion("forc", WRENCH, endless=True),
        # Comes as a trajectory_msgs/JointTrajectory only.
        _motion("trajectory", TRAJECTORY)._replace(in_packets=False),
        Verb("wait", SECONDS, bool, changes=False, without_loop=True),
        Verb("stop", changes=False, without_loop=True),
        Verb("tool", POSE, at_rest=True),
        Verb("act", ACTION),
        # The inverse kinematics of poses take milliseconds.
        _stream("pose", POSE, Stream.POSE, quick=False),
        _stream("jog", POSE, Stream.POSE, quick=False),
        _stream("twist", TWIST, Stream.TWIST),
        _stream("wrench", WRENCH, Stream.WRENCH),
        _stream("joints", RATES, Stream.JOINT),
        Verb("acknowledge", changes=False, quick=True),
        _authority("acquire"),
        _authority("hand_over", SOURCE),
        _authority("release"),
        _look("get_parameter", float, KEY)._replace(without_loop=True),
        _look("get_parameters", dict)._replace(without_loop=True),
        Verb("set_parameters", VALUES, at_rest=True, recorded=True),
        _look("status", ControllerStatus)._replace(without_loop=True),
    )
}
"""All verbs by name."""


def _names(has: Callable[[Verb], bool]) -> frozenset[str]:
    return frozenset(name for name, verb in VERB_TABLE.items() if has(verb))


IN_PACKETS = tuple(name for name, verb in VERB_TABLE.items() if verb.in_packets)
"""The verbs that programs may request."""

CHANGING = _names(lambda verb: verb.changes)
"""Verbs that act under the name of their source."""

NEW_MOTION = _names(lambda verb: verb.begins_motion)
"""Verbs that begin a motion."""

QUICK = _names(lambda verb: verb.quick)
"""Verbs that neither plan nor wait."""

ENDLESS = _names(lambda verb: verb.endless)
"""Verbs whose motions do not end by themselves."""

SEQUENCED = _names(lambda verb: verb.preset is not None)
"""Streamed commands."""


def preset_of(verb: str) -> Stream:
    """The preset that a streamed command needs."""
    preset = VERB_TABLE[verb].preset
    assert preset is not None, verb
    return preset
