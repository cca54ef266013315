"""The structures of tick.h, as ctypes declares them and as flat numbers."""

from __future__ import annotations

import ctypes
import dataclasses
import struct
from ctypes import c_double, c_int32, c_int64, c_uint32, c_uint64
from typing import Any

from cardan.drivers.omni.limits import TickLimits, UncheckedLimits
from cardan.haptics import MAX_FIXTURES


def _structure(name: str, fields: list[tuple[str, Any]]) -> type[ctypes.Structure]:
    return type(name, (ctypes.Structure,), {"_fields_": fields})


C_VECTOR3, C_MATRIX3 = c_double * 3, c_double * 9
_LIMIT_NAMES: tuple[tuple[str, Any], ...] = (
    ("clamp_n", c_double),
    ("slew_rise_n_s", c_double),
    ("slew_fall_n_s", c_double),
    ("release_s", c_double),
    ("engage_ramp_s", c_double),
    ("engage_below_n", c_double),
    ("hold_s", c_double),
    ("pause_s", c_double),
    ("measured_hold_s", c_double),
    ("velocity_gate_m_s", c_double),
    ("damping_n_s_m", c_double),
    ("velocity_cutoff_hz", c_double),
    ("continuous_n", c_double),
    ("continuous_window_s", c_double),
    ("thermal_derating_s", c_double),
    ("temperature_limit", c_double),
    ("alpha_max_n_s_m", c_double),
    ("energy_budget_j", c_double),
    ("prediction_error_m", c_double),
    ("leak_s", c_double),
    ("workspace_lower_m", C_VECTOR3),
    ("workspace_upper_m", C_VECTOR3),
    ("edge_stiffness_n_m", c_double),
    ("extrapolate_s", c_double),
    ("overrun_gap_s", c_double),
    ("pause_gap_s", c_double),
    ("oscillation_window_s", c_double),
    ("oscillation_speed_m_s", c_double),
    ("force_error_wait_s", c_double),
    ("torque_limit_n_m", c_double),
    ("lowest_rate_hz", c_double),
    ("engage_ticks", c_int32),
    ("oscillation_reversals", c_int32),
    ("passivity", c_int32),
)

CLimits = _structure("TickLimits", [*_LIMIT_NAMES, ("unchecked", c_int32)])
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
        ("commanded", C_VECTOR3),
        ("force", C_VECTOR3),
        ("torques_n_m", C_VECTOR3),
        ("energy_j", c_double),
        ("delivered_j", c_double),
        ("alpha_n_s_m", c_double),
        ("thermal_derating", c_double),
        ("temperature", c_double),
        ("command_sequence", c_uint64),
        ("command_age_s", c_double),
        ("force_age_s", c_double),
        ("gap_s", c_double),
        ("cost_s", c_double),
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

# The same structures as flat numbers: packing these is many times faster than setting fields.
COMMAND = struct.Struct("=Qd4i9d3d9d3dd3d3dd3d3dd")
FIXTURE = struct.Struct("=2i3d3d9d4d")
SAMPLE = struct.Struct("=d3d3d9d3d3d9dd")
SAMPLE_REST = struct.Struct("=d6q6i")
SNAPSHOT = struct.Struct("=dQ2i3d3d9d3d3d3d3d3d5dQ5d6q4i2I7Ii2i2diI")


def expected_layout() -> list[int]:
    """Sizes and field offsets as `tick_layout` of the compiled library must give them."""
    expected = []
    for structure in (CLimits, CFixture, CCommand, CSample, COutput, CSnapshot):
        expected.append(ctypes.sizeof(structure))
        expected += [getattr(structure, field[0]).offset for field in structure._fields_]
    return expected


def c_limits(limits: TickLimits) -> Any:
    """`limits` as a TickLimits structure."""
    values = dataclasses.asdict(limits)
    return CLimits(
        unchecked=isinstance(limits, UncheckedLimits),
        **{
            name: kind(*values[name]) if kind is C_VECTOR3 else values[name]
            for name, kind in _LIMIT_NAMES
        },
    )
