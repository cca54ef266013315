"""Structures of tick.h as ctypes and as flat numbers."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterable, Mapping
from ctypes import c_double, c_int32, c_int64, c_uint32, c_uint64
from operator import itemgetter
from typing import Any, Generic, NamedTuple, TypeVar, get_type_hints

from cardan.common.haptics import MAX_FIXTURES
from cardan.common.native import layout_of
from cardan.types import Vector3
from cardan_omni.driver.limits import TickLimits, UncheckedLimits

T = TypeVar("T", bound=NamedTuple)


def _structure(name: str, fields: list[tuple[str, Any]]) -> type[ctypes.Structure]:
    return type(name, (ctypes.Structure,), {"_fields_": fields})


C_VECTOR3, C_MATRIX3 = c_double * 3, c_double * 9
_C_TYPES: dict[Any, Any] = {
    float: c_double,
    tuple[float, float, float]: C_VECTOR3,
    int: c_int32,
    bool: c_int32,
}
_C_LIMITS = sorted(
    ((name, kind) for name, kind in get_type_hints(TickLimits).items()),
    key=lambda limit: (limit[1] in (int, bool), limit[1] is bool),
)
"""C has whole numbers behind the others, and flags last."""

_FROM_C: dict[Any, Callable[..., Any]] = {bool: bool, Vector3: Vector3._make}

CLimits = _structure(
    "TickLimits",
    [*((name, _C_TYPES[kind]) for name, kind in _C_LIMITS), ("unchecked", c_int32)],
)
CFixture = _structure(
    "TickFixture",
    [
        ("kind", c_int32),
        ("inside", c_int32),
        ("point", C_VECTOR3),
        ("axis", C_VECTOR3),
        ("rotation", C_MATRIX3),
        ("radius_m", c_double),
        ("stiffness_n_m", c_double),
        ("cap_n", c_double),
        ("damping_n_s_m", c_double),
    ],
)
CCommand = _structure(
    "TickCommand",
    [
        ("sequence", c_uint64),
        ("stamp_s", c_double),
        ("engaged", c_int32),
        ("fixture_count", c_int32),
        ("has_measured", c_int32),
        ("has_torques", c_int32),
        ("linear", C_MATRIX3),
        ("offset", C_VECTOR3),
        ("rotation", C_MATRIX3),
        ("force", C_VECTOR3),
        ("force_scale", c_double),
        ("torques_n_m", C_VECTOR3),
        ("measured_force", C_VECTOR3),
        ("measured_stamp_s", c_double),
        ("measured_rate_n_s", C_VECTOR3),
        ("measured_position", C_VECTOR3),
        ("measured_stiffness_n_m", c_double),
        ("fixtures", CFixture * MAX_FIXTURES),
    ],
)
CSample = _structure(
    "TickSample",
    [
        ("now_s", c_double),
        ("position", C_VECTOR3),
        ("velocity", C_VECTOR3),
        ("rotation", C_MATRIX3),
        ("joints_rad", C_VECTOR3),
        ("gimbal_rad", C_VECTOR3),
        ("jacobian", C_MATRIX3),
        ("temperature", c_double),
        ("cost_s", c_double),
        ("encoders", c_int64 * 6),
        ("buttons", c_int32),
        ("inkwell", c_int32),
        ("calibrated", c_int32),
        ("calibration", c_int32),
        ("by_torque", c_int32),
        ("unsound", c_int32),
    ],
)
COutput = _structure(
    "TickOutput",
    [
        ("force", C_VECTOR3),
        ("torques_n_m", C_VECTOR3),
        ("torque_mode", c_int32),
        ("state", c_int32),
    ],
)
CSnapshot = _structure(
    "TickSnapshot",
    [
        ("stamp_s", c_double),
        ("ticks", c_uint64),
        ("state", c_int32),
        ("reason", c_int32),
        ("position", C_VECTOR3),
        ("velocity", C_VECTOR3),
        ("rotation", C_MATRIX3),
        ("joints_rad", C_VECTOR3),
        ("gimbal_rad", C_VECTOR3),
        ("force_commanded", C_VECTOR3),
        ("force", C_VECTOR3),
        ("torques_n_m", C_VECTOR3),
        ("energy_j", c_double),
        ("delivered_j", c_double),
        ("passivity_damping_n_s_m", c_double),
        ("thermal_derating", c_double),
        ("temperature", c_double),
        ("command_sequence", c_uint64),
        ("command_age_s", c_double),
        ("force_age_s", c_double),
        ("gap_s", c_double),
        ("tick_cost_s", c_double),
        ("rate_hz", c_double),
        ("encoders", c_int64 * 6),
        ("buttons", c_int32),
        ("inkwell", c_int32),
        ("calibrated", c_int32),
        ("calibration", c_int32),
        ("presses", c_uint32 * 2),
        ("late_ticks", c_uint32),
        ("stale_commands", c_uint32),
        ("faults", c_uint32),
        ("oscillations", c_uint32),
        ("errors", c_uint32),
        ("force_errors", c_uint32),
        ("error", c_uint32),
        ("internal_error", c_int32),
        ("realtime", c_int32),
        ("finished", c_int32),
        ("peak_n", c_double),
        ("given_peak_j", c_double),
        ("rendering", c_int32),
        ("bad_readings", c_uint32),
    ],
)


class Flat:
    """Layout of a structure as flat numbers: packing these is many times faster than setting
    fields."""

    def __init__(self, structure: Any, without: str = "") -> None:
        self.places: dict[str, int | slice] = {}
        """Position of each field's numbers among all."""
        codes, at = "", 0
        for name, kind, *_ in structure._fields_:
            if name == without:
                continue
            count = getattr(kind, "_length_", 0)
            self.places[name] = slice(at, at + count) if count else at
            at += count or 1
            codes += f"{count or 1}{getattr(kind._type_, '_type_', kind._type_)}"
        self.struct = struct.Struct(codes)


class Reader(Generic[T]):
    """Reader of a structure's bytes into a NamedTuple.

    A field comes from the structure's field of the same name, in the type of its annotation
    (vectors, flags). `made` has the exceptions: a function, and the fields of the structure that
    are its arguments. `beside` are fields whose values are given at each call.
    """

    def __init__(
        self,
        structure: type[ctypes.Structure],
        kind: type[T],
        made: Mapping[str, tuple[Callable[..., Any], tuple[str, ...]]],
        beside: tuple[str, ...] = (),
    ) -> None:
        flat = Flat(structure)
        self._unpack = flat.struct.unpack_from
        places = flat.places | {name: i - len(beside) for i, name in enumerate(beside)}
        first: list[int | slice] = []
        self._changes: list[tuple[int, Callable[..., Any]]] = []
        self._joined: list[tuple[int, Callable[..., Any], Callable[[Any], Any]]] = []
        for index, (name, hint) in enumerate(get_type_hints(kind).items()):
            function, sources = made.get(name, (_FROM_C.get(hint), (name,)))
            at = [places[source] for source in sources]
            first.append(at[0])
            if function is not None and len(at) > 1:
                self._joined.append((index, function, itemgetter(*at)))
            elif function is not None:
                self._changes.append((index, function))
        self._pick = itemgetter(*first)
        self._make: Callable[[Iterable[Any]], T] = kind._make

    def __call__(self, buffer: bytearray, *beside: Any) -> T:
        numbers = self._unpack(buffer) + beside
        values = list(self._pick(numbers))
        for index, change in self._changes:
            values[index] = change(values[index])
        for index, join, sources in self._joined:
            values[index] = join(*sources(numbers))
        return self._make(values)


def expected_layout() -> list[int]:
    """Return sizes and field offsets, which must equal `tick_layout` of the compiled library."""
    return layout_of(CLimits, CFixture, CCommand, CSample, COutput, CSnapshot)


def c_limits(limits: TickLimits) -> Any:
    """Return `limits` as a TickLimits structure."""
    given = CLimits(unchecked=isinstance(limits, UncheckedLimits))
    for name, kind in _C_LIMITS:
        value = getattr(limits, name)
        setattr(given, name, value if kind in (float, int, bool) else C_VECTOR3(*value))
    return given
