"""The verbs of the Cartesian interface, as words of a command line."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from cardan.errors import ConfigurationError

if TYPE_CHECKING:
    from cardan.gateway.arm.interface import CartesianArm
    from cardan.gateway.arm.motion import Motion

LOOK_S: Final = 0.05
"""How often it looks whether a motion has ended."""


_ACTIONS: Final = {"open": "acog", "close": "accg", "stop": "acsg"}
"""Actions of the gripper in words, and as the interface spells them."""


MOST_JOINTS: Final = 32
"""No arm has more."""


class _Verb(NamedTuple):
    """A verb: what it takes, and what calls it."""

    takes: str
    counts: tuple[int, ...]
    call: Callable[[Any, list[Any]], Any]


def _six(name: str) -> Callable[[Any, list[Any]], Any]:
    return lambda arm, values: getattr(arm, name)(values)


def _none(name: str) -> Callable[[Any, list[Any]], Any]:
    return lambda arm, _values: getattr(arm, name)()


_POSE = "x y z (m) and a rotation vector (rad), or x y z and a quaternion w x y z"
_TWIST = "vx vy vz (m/s) wx wy wz (rad/s)"

_NUMBERS: dict[str, _Verb] = {
    "inv": _Verb(_POSE, (6, 7), _six("inv")),
    "rehearse_line": _Verb(_POSE, (6, 7), _six("rehearse_line")),
    "rehearse_joints": _Verb(
        "the positions of all joints (rad or m)",
        tuple(range(1, MOST_JOINTS + 1)),
        _six("rehearse_joints"),
    ),
    "movj": _Verb(_POSE, (6, 7), _six("movj")),
    "relj": _Verb(_POSE, (6, 7), _six("relj")),
    "movl": _Verb(_POSE, (6, 7), _six("movl")),
    "movv": _Verb(_TWIST, (6,), _six("movv")),
    "forc": _Verb("fx fy fz (N) tx ty tz (N·m)", (6,), _six("forc")),
    "tool": _Verb(_POSE, (6, 7), _six("tool")),
    "stat": _Verb("nothing", (0,), _none("stat")),
    "gcmp": _Verb("nothing", (0,), _none("gcmp")),
    "stop": _Verb("nothing", (0,), _none("stop")),
    "wait": _Verb("nothing, or a timeout in s", (0, 1), lambda arm, v: arm.wait(*v)),
    "acknowledge": _Verb("nothing", (0,), _none("acknowledge")),
    "acquire": _Verb("nothing", (0,), _none("acquire")),
    "release": _Verb("nothing", (0,), _none("release")),
    "status": _Verb("nothing", (0,), _none("status")),
    "get_parameters": _Verb("nothing", (0,), _none("get_parameters")),
}

_TEXTS: dict[str, _Verb] = {
    "act": _Verb("open, close or stop", (1,), lambda arm, v: arm.act(_ACTIONS.get(v[0], v[0]))),
    "hand_over": _Verb("a source", (1,), lambda arm, v: arm.hand_over(v[0])),
    "get_parameter": _Verb("a parameter", (1,), lambda arm, v: arm.get_parameter(v[0])),
    "set_parameter": _Verb(
        "a parameter and its value", (2,), lambda arm, v: arm.set_parameter(v[0], _value(v[1]))
    ),
}

TAKES: Final = {name: verb.takes for name, verb in (_NUMBERS | _TEXTS).items()}
"""All verbs, and what each takes, in words."""


def carry_out(arm: CartesianArm, verb: str, words: Sequence[str], wait: bool) -> tuple[Any, bool]:
    """Carry out a verb of `arm`; its result, and whether a motion that was waited for arrived.

    Raises ConfigurationError for what is no verb or not what it takes, and what the verb raises.
    """
    known = _NUMBERS.get(verb) or _TEXTS.get(verb)
    if known is None:
        allowed = ", ".join(TAKES)
        raise ConfigurationError("VERB", f"there is no {verb!r}; allowed: {allowed}")
    if len(words) not in known.counts:
        given = "1 value" if len(words) == 1 else f"{len(words)} values"
        raise ConfigurationError(verb, f"takes {known.takes}, not {given}: {' '.join(words)}")
    values: list[Any] = [_number(verb, word) for word in words] if verb in _NUMBERS else [*words]
    result = known.call(arm, values)
    motion = result if hasattr(result, "outcome") else None
    if motion is None:
        return result, result is not False
    if not wait and motion.ends:
        return motion, True
    return motion, _awaited(arm, motion)


def _awaited(arm: CartesianArm, motion: Motion) -> bool:
    """Wait for the end of a motion, and whether it arrived; whoever interrupts that stops the
    arm."""
    try:
        while not motion.over:
            time.sleep(LOOK_S)
    except BaseException:
        arm.stop()
        raise
    return motion.outcome.value == "done"


def in_words(result: Any) -> str:
    """The result of a verb, for people."""
    return _motion(result) if hasattr(result, "outcome") else _shown(result)


def as_plain(result: Any) -> Any:
    """The result of a verb, for programs: a motion as its state."""
    if not hasattr(result, "outcome"):
        return result
    keys = ("verb", "source", "ends", "outcome", "reason", "note", "duration_s")
    return {key: getattr(result, key) for key in keys}


def _motion(motion: Motion) -> str:
    said = ": ".join(filter(None, (motion.outcome.value, motion.reason)))
    planned = f", planned {motion.duration_s:.2f} s" if math.isfinite(motion.duration_s) else ""
    note = f" ({motion.note})" if motion.note else ""
    return f"{motion.verb}: {said}{planned}{note}"


def _number(verb: str, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ConfigurationError(verb, f"{word!r} is no number") from None


def _value(word: str) -> float | str:
    """A parameter's value: a number, or a word as configuration files have it."""
    try:
        return float(word)
    except ValueError:
        return word


def _shown(result: Any) -> str:
    """A result in lines of text."""
    if result is None or result is True:
        return ""
    if result is False:
        return "it did not arrive"
    if isinstance(result, dict):
        return "\n".join(f"{key} {_shown(value)}" for key, value in result.items())
    if hasattr(result, "_asdict"):
        return "\n".join(f"{key} {_shown(value)}" for key, value in result._asdict().items())
    if isinstance(result, (tuple, list)):
        return " ".join(_shown(each) for each in result)
    if isinstance(result, float):
        return f"{result:.6g}"
    return str(getattr(result, "name", result)).lower() if hasattr(result, "name") else str(result)
