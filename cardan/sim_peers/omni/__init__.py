"""A simulated Phantom Omni behind libHD's own functions, its settings, and the hand that holds it.

libHD.so is compiled from the C sources beside this file; any program that loads libHD can load it.
"""

from cardan.sim_peers.omni.hand import SCRIPT_VERBS, SCRIPTS, compile_script, load_motion
from cardan.sim_peers.omni.library import (
    LIBRARY_NAMES,
    LIBRARY_VARIABLE,
    SETTINGS_VARIABLE,
    OmniTruth,
    SimulatedOmni,
    available,
    library_path,
)
from cardan.sim_peers.omni.program import environment, missing_log, run_program
from cardan.sim_peers.omni.settings import (
    FAULTS,
    GIMBAL_NOISE_LSB,
    INKWELL_M,
    MODELS,
    HandMotion,
    OmniFault,
    OmniSettings,
    Waypoint,
    parse_omni_faults,
)

__all__ = [
    "FAULTS",
    "GIMBAL_NOISE_LSB",
    "INKWELL_M",
    "LIBRARY_NAMES",
    "LIBRARY_VARIABLE",
    "MODELS",
    "SCRIPTS",
    "SCRIPT_VERBS",
    "SETTINGS_VARIABLE",
    "HandMotion",
    "OmniFault",
    "OmniSettings",
    "OmniTruth",
    "SimulatedOmni",
    "Waypoint",
    "available",
    "compile_script",
    "environment",
    "library_path",
    "load_motion",
    "missing_log",
    "parse_omni_faults",
    "run_program",
]
