"""Values of :mod:`cardan.types` to JSON and back, with the unit of each number in its key.

A pose is ``{"position_m": {"x": ..., "y": ..., "z": ...}, "orientation": {"w": ..., "x": ..., "y":
..., "z": ...}, "frame": "base"}``: the order of numbers cannot be confused. A number that JSON
lacks, such as the stamp of an event that has not happened, is a text for ``float()`` ("-inf").
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from types import NoneType, UnionType
from typing import Any, Final, TypeVar, Union, get_args, get_origin

from cardan import types
from cardan.common.options import hints, refusal, suggestion
from cardan.errors import ConfigurationError, OptionError

_T = TypeVar("_T")

_POSITIONS, _SPEEDS = "rad_or_m", "rad_s_or_m_s"
_AXES: Final = {"external_axes": _POSITIONS}
_VELOCITIES: Final = {"velocities": _SPEEDS}
_TORQUES: Final = {"torques": "nm_or_n"}

UNITS: Final[Mapping[type, Mapping[str, str]]] = {
    types.Pose: {"position": "m"},
    types.Twist: {"linear": "m_s", "angular": "rad_s"},
    types.Wrench: {"force": "n", "torque": "nm"},
    types.Inertia: {"acceleration": "m_s2", "rates": "rad_s"},
    types.RobotState: {"joints": _POSITIONS, **_AXES, **_VELOCITIES, **_TORQUES},
    types.JointCommand: {"positions": _POSITIONS, **_VELOCITIES, **_AXES},
    types.PoseCommand: _AXES,
    types.JointVelocityCommand: _VELOCITIES,
    types.TorqueCommand: _TORQUES,
    types.PathCorrectionCommand: {"offset": "m"},
    types.JointLimits: {
        "lower": _POSITIONS,
        "upper": _POSITIONS,
        "velocity": _SPEEDS,
        "acceleration": "rad_s2_or_m_s2",
    },
}
"""Units of fields whose names have none; a name with a unit ("stamp_s") stays."""

_COMMANDS: Final = {
    kind._field_defaults["kind"].value: kind for kind in get_args(types.RobotCommand)
}


def to_json(value: Any) -> Any:
    """Convert `value` to JSON's types: a named tuple becomes an object, whose keys have units."""
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else str(float(value))
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        kind = type(value)
        return {key_of(kind, name): to_json(each) for name, each in value._asdict().items()}
    if isinstance(value, (tuple, list)):
        return [to_json(each) for each in value]
    if isinstance(value, (set, frozenset)):
        return sorted(map(to_json, value))
    if isinstance(value, Mapping):
        return {key: to_json(each) for key, each in value.items()}
    return value


def from_json(kind: type[_T], table: Any) -> _T:
    """Convert the result of `to_json` back to the value of `kind` (:class:`cardan.Pose`,
    :data:`cardan.RobotCommand`). Fields that have a default may be missing. Raises
    ConfigurationError, a ValueError, that names the key."""
    value: _T = _back(kind, table, "")
    return value


def key_of(kind: type, name: str) -> str:
    """Return the key of a field."""
    unit = UNITS.get(kind, {}).get(name)
    return f"{name}_{unit}" if unit else name


def _back(hint: Any, value: Any, key: str) -> Any:
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        if value is None and NoneType in inner:
            return None
        kinds = [each for each in inner if each is not NoneType]
        return _back(kinds[0], value, key) if len(kinds) == 1 else _command(value, key)
    if origin in (tuple, frozenset):
        if not isinstance(value, list):
            raise OptionError(key, value, "a list")
        return origin(_back(inner[0], each, f"{key}[{i}]") for i, each in enumerate(value))
    if hasattr(hint, "_fields"):
        return _named(hint, value, key)
    if issubclass(hint, enum.Enum):
        known = {each.value: each for each in hint}
        if not isinstance(value, str) or value not in known:
            raise OptionError(key, value, f"one of {', '.join(known)}")
        return known[value]
    if hint is str and isinstance(value, str):
        return value
    if hint is float and value in ("inf", "-inf", "nan"):
        return float(value)
    if allowed := refusal(hint, value):
        raise OptionError(key, value, allowed)
    return hint(value)


def _named(kind: Any, table: Any, key: str) -> Any:
    if not isinstance(table, Mapping):
        raise OptionError(key, table, "an object")
    names = {key_of(kind, name): name for name in kind._fields}
    before = f"{key}." if key else ""
    for each in table:
        if each not in names:
            near = suggestion(str(each), names)
            raise ConfigurationError(f"{before}{each}", f"a {kind.__name__} has no such key{near}")
    for each, name in names.items():
        if each not in table and name not in kind._field_defaults:
            raise ConfigurationError(f"{before}{each}", f"a {kind.__name__} needs it")
    allowed = hints(kind)
    found = {
        names[each]: _back(allowed[names[each]], value, f"{before}{each}")
        for each, value in table.items()
    }
    if found.get("kind", made := kind._field_defaults.get("kind")) is not made:
        raise OptionError(f"{before}kind", table["kind"], f"{made.value} in {kind.__name__}")
    return kind(**found)


def _command(table: Any, key: str) -> Any:
    known = table.get("kind") if isinstance(table, Mapping) else None
    if not isinstance(known, str) or known not in _COMMANDS:
        raise OptionError(f"{key}.kind" if key else "kind", known, f"one of {', '.join(_COMMANDS)}")
    return _named(_COMMANDS[known], table, key)
