"""Verbs of the Cartesian interface as words of a command line."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from cardan.errors import ConfigurationError
from cardan.gateway.arm.verb_table import NOTHING, VALUES, VERB_TABLE, Takes

if TYPE_CHECKING:
    from cardan.gateway.arm.interface import CartesianArm
    from cardan.gateway.arm.verb_results import Motion

LOOK_S: Final = 0.05
"""Period of checks whether a motion has ended."""


SET_ONE: Final = "set_parameter"
"""Verb of the command line that sets one parameter by the programs' verb `set_parameters`."""


def offered() -> Mapping[str, Takes]:
    """Return the verbs of the command line, each with its arguments."""
    verbs = {v.name: v.takes for v in VERB_TABLE.values() if v.in_packets and v.preset is None}
    return {**verbs, SET_ONE: VALUES._replace(words="a parameter and its value", counts=(2,))}


def carry_out(arm: CartesianArm, verb: str, words: Sequence[str], wait: bool) -> tuple[Any, bool]:
    """Execute a verb of `arm`; return its result, and whether an awaited motion arrived.

    Raises ConfigurationError for an unknown verb or wrong words, and any error of the verb.
    """
    verbs = offered()
    if verb not in verbs:
        allowed = ", ".join(verbs)
        raise ConfigurationError("VERB", f"there is no {verb!r}; allowed: {allowed}")
    takes = verbs[verb]
    if len(words) not in takes.counts:
        given = "1 value" if len(words) == 1 else f"{len(words)} values"
        raise ConfigurationError(verb, f"takes {takes.words}, not {given}: {' '.join(words)}")
    call = getattr(arm, "set_parameters" if verb == SET_ONE else verb)
    given_one = takes is not NOTHING
    result = call(takes.decode(verb, takes.read(verb, words))) if given_one else call()
    motion = result if hasattr(result, "outcome") else None
    if motion is None:
        return result, result is not False
    if not wait and motion.ends:
        return motion, True
    return motion, _awaited(arm, motion)


def _awaited(arm: CartesianArm, motion: Motion) -> bool:
    """Wait for the end of a motion; return True if it arrived. An interrupt stops the arm."""
    try:
        while not motion.over:
            time.sleep(LOOK_S)
    except BaseException:
        arm.stop()
        raise
    return motion.outcome.value == "done"


def in_words(result: Any) -> str:
    """Return the result of a verb as text."""
    return _motion(result) if hasattr(result, "outcome") else _shown(result)


def as_plain(result: Any) -> Any:
    """Return the result of a verb for programs: a motion as its state."""
    if not hasattr(result, "outcome"):
        return result
    keys = ("verb", "source", "ends", "outcome", "reason", "note", "duration_s")
    return {key: getattr(result, key) for key in keys}


def _motion(motion: Motion) -> str:
    said = ": ".join(filter(None, (motion.outcome.value, motion.reason)))
    planned = f", planned {motion.duration_s:.2f} s" if math.isfinite(motion.duration_s) else ""
    note = f" ({motion.note})" if motion.note else ""
    return f"{motion.verb}: {said}{planned}{note}"


def _shown(result: Any) -> str:
    """Return a result in lines of text."""
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
