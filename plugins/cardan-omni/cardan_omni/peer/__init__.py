"""Simulated Phantom Omni behind libHD's own functions, its settings, and the hand that holds it.
libHD.so is compiled from the C sources beside this file; any program that loads libHD can use it.
"""

from cardan_omni.peer.hand import (
    SCRIPT_VERBS as SCRIPT_VERBS,
    SCRIPTS as SCRIPTS,
    compile_script as compile_script,
    load_motion as load_motion,
)
from cardan_omni.peer.library import (
    LIBRARY_NAMES as LIBRARY_NAMES,
    LIBRARY_VARIABLE as LIBRARY_VARIABLE,
    SETTINGS_VARIABLE as SETTINGS_VARIABLE,
    OmniTruth as OmniTruth,
    SimulatedOmni as SimulatedOmni,
    available as available,
    library_path as library_path,
)
from cardan_omni.peer.program import (
    environment as environment,
    missing_log as missing_log,
    run_program as run_program,
)
from cardan_omni.peer.settings import (
    FAULTS as FAULTS,
    GIMBAL_NOISE_LSB as GIMBAL_NOISE_LSB,
    INKWELL_M as INKWELL_M,
    MODELS as MODELS,
    HandMotion as HandMotion,
    OmniFault as OmniFault,
    OmniSettings as OmniSettings,
    Waypoint as Waypoint,
    parse_omni_faults as parse_omni_faults,
)
