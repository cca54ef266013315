"""JSON tables of arms' models: the built-in arms for programs without Pinocchio, and a cache of all
others, which reloads one within milliseconds."""

from __future__ import annotations

import enum
import json
from collections.abc import Sequence
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin

from cardan.common import tables
from cardan.common.cache import cache_text, cached_text, content_key
from cardan.common.options import hints
from cardan.robots.arm_model import ArmModel

_SOURCES = (
    "arm_bodies.py",
    "arm_chain.py",
    "arm_choices.py",
    "arm_file.py",
    "arm_limits.py",
    "arm_model.py",
    "arm_reader.py",
    "fitting.py",
    "meshes.py",
    "telescope.py",
    "urdf.py",
)
"""Modules that convert files to a model: a cached model is void when one of them changes."""
KIND = "arms"
_T = TypeVar("_T")


def to_table(arm: ArmModel, key: str, urdf: str) -> str:
    """Serialize an arm built from files with this `content_key`, including the text `urdf`."""
    table = {name: _plain(value) for name, value in arm._asdict().items() if value != urdf}
    rows = ",\n".join(f"{json.dumps(name)}: {json.dumps(value)}" for name, value in table.items())
    return f'{{"of": {json.dumps(key)},\n{rows}}}\n'


def from_table(text: str, key: str, urdf: str) -> ArmModel | None:
    """Return the arm; None if the text is from files with another key, or damaged."""
    try:
        table = json.loads(text)
        if table.pop("of") != key:
            return None
        arm: ArmModel = _made(ArmModel, {"urdf": urdf, **table})
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        return None
    return arm


def plain_text(value: Any) -> str:
    """Serialize a value of named tuples, tables and shapes as JSON."""
    return json.dumps(_plain(value))


def made_from(kind: type[_T], text: str) -> _T | None:
    """Return the value of type `kind` that `plain_text` serialized; None if it is invalid."""
    try:
        made: _T = _made(kind, json.loads(text))
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        return None
    return made


def stored_arm(parts: Sequence[str | bytes], urdf: str) -> ArmModel | None:
    """Return the cached model of these files; None if there is none."""
    key = content_key((*parts, *_sources()))
    text = cached_text(KIND, key)
    return None if text is None else from_table(text, key, urdf)


def keep_arm(parts: Sequence[str | bytes], urdf: str, arm: ArmModel) -> None:
    """Cache the model for `stored_arm`, if the user has a writable cache folder."""
    key = content_key((*parts, *_sources()))
    cache_text(KIND, key, to_table(arm, key, urdf))


@cache
def _sources() -> tuple[str, ...]:
    folder = Path(__file__).parent
    return tuple((folder / name).read_text(encoding="utf-8") for name in _SOURCES)


def _plain(value: Any) -> Any:
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, frozenset):
        return sorted(map(_plain, value))
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return tables.as_table(value) if is_dataclass(value) else value


def _made(kind: Any, value: Any) -> Any:
    """Return the value of type `kind` from which `_plain` made this."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is UnionType:  # Shapes are distinguished by their number of parts.
        (kind,) = (each for each in inner if len(each._fields) == len(value))
    if hasattr(kind, "_fields"):
        names, types = kind._fields, hints(kind)
        parts = [value[name] for name in names] if isinstance(value, dict) else value
        return kind(*(_made(types[n], part) for n, part in zip(names, parts, strict=True)))
    if origin is frozenset:
        return frozenset(_made(inner[0], each) for each in value)
    if origin is tuple:
        kinds = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        return tuple(_made(each, part) for each, part in zip(kinds, value, strict=True))
    if isinstance(kind, type) and is_dataclass(kind):
        return tables.read_table(kind, value)
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        return kind(value)
    if not isinstance(value, kind):
        raise TypeError
    return value
